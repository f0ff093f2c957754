"""One writer a session: a second process is refused with a sentence, and a reader changes nothing."""

import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from skincal.cli import main
from skincal.journal import lock
from skincal.journal.lock import LOCK_NAME, SessionLock, writer_of
from skincal.journal.writer import create_session
from skincal.model.errors import InputError
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from tests.approved import approved, approved_pattern
from tests.skincal.poke_script import LINKS, as_chunks, killed, next_segment, outcome_key, some_pokes, write_scene

ROOT = Path(__file__).resolve().parents[3]
RECORDER = """
import sys
from pathlib import Path
from skincal.journal.writer import create_session
from skincal.session.pipeline import Pipeline
from tests.skincal.poke_script import LINKS, as_chunks, some_pokes, write_scene
folder = Path(sys.argv[1])
scene = write_scene(folder / "source")
pipeline = Pipeline(scene, LINKS, None, create_session(folder / "s", scene, LINKS))
items = as_chunks(some_pokes(scene, 4).samples)
for item in items[: len(items) * 2 // 3]:
    pipeline.feed(item)
print(len(pipeline.session.contacts), flush=True)
sys.stdin.readline()
for item in items[len(items) * 2 // 3 :]:
    pipeline.feed(item)
pipeline.close()
print(len(pipeline.session.contacts), flush=True)
"""
OPENER = """
import sys
from pathlib import Path
from skincal.model.errors import InputError
from skincal.session.replay import resume
try:
    resume(Path(sys.argv[1]))
except InputError as error:
    print(error)
"""


def state_of(folder):
    return {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture
def recording(tmp_path):
    """A process in the middle of a recording in `tmp_path / "s"`; a line on its stdin lets it record the rest."""
    write_scene(tmp_path / "source")
    process = subprocess.Popen(
        [sys.executable, "-c", RECORDER, str(tmp_path)],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert int(process.stdout.readline()) >= 2
    yield process
    process.kill()
    process.wait()
    process.stdin.close()
    process.stdout.close()


def rest_of(process):
    process.stdin.write("go on\n")
    process.stdin.flush()
    said = int(process.stdout.readline())
    process.wait(30)
    return said


def test_a_second_writer_is_refused_and_nothing_is_lost(recording, tmp_path):
    before = state_of(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", OPENER, str(tmp_path / "s")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=True,
    )
    assert approved("session.recorded_by_since", pid=recording.pid, host=socket.gethostname()) in done.stdout
    assert state_of(tmp_path) == before
    assert rest_of(recording) == 4
    assert len(load(tmp_path / "s").session.contacts) == len(replay(tmp_path / "s").session.contacts) == 4
    resume(tmp_path / "s").close()


def test_a_command_that_would_write_ends_with_2(recording, tmp_path, capsys):
    arguments = ["record", "--wrench", "file:none", "--skin", "file:none", "--scene", str(tmp_path / "source" / "patch.toml")]
    before = state_of(tmp_path)
    assert main([*arguments, "--out", str(tmp_path / "s")]) == 2
    assert approved("session.recorder", pid=recording.pid, host=socket.gethostname()) in capsys.readouterr().err
    assert state_of(tmp_path) == before
    assert rest_of(recording) == 4


def test_a_reader_sees_what_is_written_changes_nothing_and_says_so(recording, tmp_path, capsys):
    before = state_of(tmp_path / "s")
    loaded, played = load(tmp_path / "s"), replay(tmp_path / "s")
    assert len(loaded.session.contacts) >= 2
    for pipeline in (loaded, played):
        (said,) = pipeline.findings
        assert approved("session.recorded_by", pid=recording.pid) in said
    assert main(["solve", str(tmp_path / "s")]) == 0
    assert approved("session.recorded_by_begin") in capsys.readouterr().out
    assert main(["export", str(tmp_path / "s"), "--format", "csv", "--out", str(tmp_path / "c.csv")]) == 0
    assert approved("session.recorded_by_begin") in capsys.readouterr().out
    assert state_of(tmp_path / "s") == before
    assert rest_of(recording) == 4


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no kill -9")
def test_a_killed_writer_holds_no_lock(recording, tmp_path):
    recording.kill()
    recording.wait()
    assert (tmp_path / "s" / LOCK_NAME).exists()
    assert writer_of(tmp_path / "s") == ""
    pipeline = resume(tmp_path / "s")
    assert len(pipeline.session.contacts) >= 2
    pipeline.close()


def test_within_one_process_too(tmp_path):
    scene = write_scene(tmp_path / "source")
    journal = create_session(tmp_path / "s", scene, LINKS)
    for opener in (lambda: resume(tmp_path / "s"), lambda: next_segment(tmp_path / "s", scene, LINKS)):
        with pytest.raises(InputError, match=approved_pattern("session.recorded_by", pid=os.getpid())):
            opener()
    with pytest.raises(InputError, match="is being recorded"):
        create_session(tmp_path / "s", scene, LINKS)
    following = journal.open_next(scene, LINKS)
    journal.close()
    with pytest.raises(InputError, match="is being recorded"):
        resume(tmp_path / "s")
    following.close()
    assert not (tmp_path / "s" / LOCK_NAME).exists()
    resume(tmp_path / "s").close()


def refuse(_):
    raise OSError(28, "No space left on device")


def test_a_refused_opening_leaves_no_lock(tmp_path, monkeypatch):
    scene = write_scene(tmp_path / "source")
    create_session(tmp_path / "s", scene, LINKS).close()
    for opener in (lambda: resume(tmp_path / "s"), lambda: next_segment(tmp_path / "s", scene, LINKS)):
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", refuse)
            with pytest.raises(InputError, match="No space left"):
                opener()
        assert not (tmp_path / "s" / LOCK_NAME).exists()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", refuse)
        with pytest.raises(InputError, match="No space left"):
            create_session(tmp_path / "t", scene, LINKS)
    assert not (tmp_path / "t" / LOCK_NAME).exists()


def test_a_segment_that_finds_no_room_leaves_the_lock_where_it_was(tmp_path, monkeypatch):
    scene = write_scene(tmp_path / "source")
    journal = create_session(tmp_path / "s", scene, LINKS)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", refuse)
        with pytest.raises(InputError, match="No space left"):
            journal.open_next(scene, LINKS)
    with pytest.raises(InputError, match="is being recorded"):
        resume(tmp_path / "s")
    journal.close()
    assert writer_of(tmp_path / "s") == ""


def test_a_disk_that_refuses_lets_the_session_go(tmp_path, monkeypatch):
    scene = write_scene(tmp_path / "source")
    journal = create_session(tmp_path / "s", scene, LINKS)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", refuse)
        with pytest.raises(Exception, match="cannot be written"):
            journal.sync()
    with pytest.raises(InputError, match=approved_pattern("session.not_written")):
        journal.open_next(scene, LINKS)
    assert not (tmp_path / "s" / "segment-0002.mcap").exists()
    SessionLock(tmp_path / "s").release()


def test_many_openers_at_once_and_one_gets_it(tmp_path, monkeypatch):
    """Each takes the lock away with its file: nobody may hold one that lies on no file."""
    monkeypatch.setattr(lock, "_PATIENCE_S", 0.0)
    held = []
    for _ in range(50):
        first = SessionLock(tmp_path)
        held.append(writer_of(tmp_path))
        with pytest.raises(InputError):
            SessionLock(tmp_path)
        first.release()
        first.release()
    assert all(held)
    assert list(tmp_path.iterdir()) == []


def test_a_session_that_cannot_be_written_is_read(tmp_path):
    """A read-only disk: any attempt to open a file for writing, to rename or to make one fails."""
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    for item in as_chunks(some_pokes(scene, 3).samples):
        pipeline.feed(item)
    killed(pipeline)
    folder = shutil.copytree(tmp_path / "s", tmp_path / "r")
    before = state_of(folder)
    for path in (folder, folder / "scene"):
        path.chmod(0o555)
    opened = []

    def watch(event, arguments):
        if event == "open" and str(arguments[0]).startswith(str(folder)) and opened is not None:
            opened.append((arguments[0], arguments[1], arguments[2]))

    sys.addaudithook(watch)
    try:
        for way in (load, replay):
            contacts = way(folder).session.contacts
            assert [outcome_key(contact) for contact in contacts] == [
                outcome_key(contact) for contact in pipeline.session.contacts
            ]
    finally:
        for path in (folder, folder / "scene"):
            path.chmod(0o755)
    assert opened
    assert all(not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) for _, _, flags in opened)
    assert state_of(folder) == before
    opened = None


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_a_lock_that_is_a_link_is_refused_and_what_it_leads_to_stays(tmp_path):
    """A session of a stranger may hold links: nothing beyond its folder is written."""
    letter = tmp_path / "letter"
    letter.write_text("dear", encoding="utf-8")
    folder = tmp_path / "s"
    folder.mkdir()
    (folder / LOCK_NAME).symlink_to(letter)
    with pytest.raises(InputError, match="cannot be locked"):
        SessionLock(folder)
    assert letter.read_text(encoding="utf-8") == "dear"


def test_a_lock_with_a_second_name_elsewhere_is_refused_and_stays_as_it_is(tmp_path):
    letter, folder = tmp_path / "letter", tmp_path / "s"
    letter.write_text("dear", encoding="utf-8")
    folder.mkdir()
    (folder / LOCK_NAME).hardlink_to(letter)
    with pytest.raises(InputError, match=approved_pattern("session.lock_elsewhere")):
        SessionLock(folder)
    assert letter.read_text(encoding="utf-8") == "dear"
    (folder / LOCK_NAME).unlink()
    SessionLock(folder).release()


@pytest.mark.skipif(os.name == "nt", reason="files that are open cannot be linked there")
def test_a_backup_of_hard_links_does_not_hide_who_records(tmp_path):
    """Some tools link a folder's files while it is recorded; its lock has two names then."""
    scene = write_scene(tmp_path / "source")
    journal = create_session(tmp_path / "s", scene, LINKS)
    shutil.copytree(tmp_path / "s", tmp_path / "backup", copy_function=os.link)
    assert str(os.getpid()) in writer_of(tmp_path / "s")
    with pytest.raises(InputError, match="is being recorded"):
        resume(tmp_path / "s")
    journal.close()
    assert len(load(tmp_path / "backup").session.contacts) == 0


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_recovery_writes_through_no_link(tmp_path):
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    for item in as_chunks(some_pokes(scene, 3).samples):
        pipeline.feed(item)
    killed(pipeline)
    folder = tmp_path / "s"
    letter = tmp_path / "letter"
    letter.write_text("dear", encoding="utf-8")
    for name in ("segment-0001.mcap.recovering", "segment-0001.mcap.damaged", "segment-0001.jsonl.damaged"):
        (folder / name).symlink_to(letter)
    resume(folder).close()
    assert letter.read_text(encoding="utf-8") == "dear"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names")
def test_a_pipe_in_the_place_of_the_lock_keeps_nobody_waiting(tmp_path):
    os.mkfifo(tmp_path / LOCK_NAME)
    assert writer_of(tmp_path) == ""
    with pytest.raises(InputError):
        SessionLock(tmp_path)
