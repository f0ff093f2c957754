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
from skincal.journal.lock import LOCK_NAME, SessionLock, describe_lock_holder
from skincal.journal.writer import create_session
from skincal.model.errors import InputError
from skincal.session.replay import load, replay, resume
from tests.approved import approved, approved_pattern
from tests.skincal.journal.journal_support import contacts_of, files_of, process, record, refuse
from tests.skincal.poke_script import LINKS, killed, next_segment, write_scene

RECORDER = """
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
try:
    resume(folder / "s")
except InputError as error:
    print(error)
"""


@pytest.fixture
def recording(tmp_path):
    """A process in the middle of a recording in `tmp_path / "s"`; a line on its stdin lets it record the rest."""
    with process(RECORDER, tmp_path, stdin=subprocess.PIPE) as recorder:
        assert int(recorder.stdout.readline()) >= 2
        yield recorder
        recorder.kill()


def rest_of(recorder):
    recorder.stdin.write("go on\n")
    recorder.stdin.flush()
    return int(recorder.stdout.readline())


def test_a_second_writer_is_refused_and_nothing_is_lost(recording, tmp_path):
    before = files_of(tmp_path)
    said, _ = process(OPENER, tmp_path).communicate()
    assert approved("session.recorded_by_since", pid=recording.pid, host=socket.gethostname()) in said
    assert files_of(tmp_path) == before
    assert rest_of(recording) == 4
    assert len(load(tmp_path / "s").session.contacts) == len(replay(tmp_path / "s").session.contacts) == 4
    resume(tmp_path / "s").close()


def test_a_command_that_would_write_ends_with_2(recording, tmp_path, capsys):
    arguments = ["record", "--wrench", "file:none", "--skin", "file:none", "--scene", str(tmp_path / "source" / "patch.toml")]
    before = files_of(tmp_path)
    assert main([*arguments, "--out", str(tmp_path / "s")]) == 2
    assert approved("session.recorder", pid=recording.pid, host=socket.gethostname()) in capsys.readouterr().err
    assert files_of(tmp_path) == before
    assert rest_of(recording) == 4


def test_a_reader_sees_what_is_written_changes_nothing_and_says_so(recording, tmp_path, capsys):
    before = files_of(tmp_path / "s")
    loaded, played = load(tmp_path / "s"), replay(tmp_path / "s")
    assert len(loaded.session.contacts) >= 2
    for pipeline in (loaded, played):
        (said,) = pipeline.findings
        assert approved("session.recorded_by", pid=recording.pid) in said
    assert main(["solve", str(tmp_path / "s")]) == 0
    assert approved("session.recorded_by_begin") in capsys.readouterr().out
    assert main(["export", str(tmp_path / "s"), "--format", "csv", "--out", str(tmp_path / "c.csv")]) == 0
    assert approved("session.recorded_by_begin") in capsys.readouterr().out
    assert files_of(tmp_path / "s") == before
    assert rest_of(recording) == 4


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no kill -9")
def test_a_killed_writer_holds_no_lock(recording, tmp_path):
    recording.kill()
    recording.wait()
    assert (tmp_path / "s" / LOCK_NAME).exists()
    assert describe_lock_holder(tmp_path / "s") == ""
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
    assert describe_lock_holder(tmp_path / "s") == ""


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
    monkeypatch.setattr(lock, "RETRY_FOR_S", 0.0)
    held = []
    for _ in range(50):
        first = SessionLock(tmp_path)
        held.append(describe_lock_holder(tmp_path))
        with pytest.raises(InputError):
            SessionLock(tmp_path)
        first.release()
        first.release()
    assert all(held)
    assert list(tmp_path.iterdir()) == []


def test_a_session_that_cannot_be_written_is_read(tmp_path):
    """A read-only disk: any attempt to open a file for writing, to rename or to make one fails."""
    scene = write_scene(tmp_path / "source")
    pipeline = killed(record(scene, tmp_path / "s", 3))
    folder = shutil.copytree(tmp_path / "s", tmp_path / "r")
    before = files_of(folder)
    for path in (folder, folder / "scene"):
        path.chmod(0o555)
    opened = []

    def watch(event, arguments):
        if event == "open" and str(arguments[0]).startswith(str(folder)) and opened is not None:
            opened.append((arguments[0], arguments[1], arguments[2]))

    sys.addaudithook(watch)
    try:
        for way in (load, replay):
            assert contacts_of(way(folder)) == contacts_of(pipeline)
    finally:
        for path in (folder, folder / "scene"):
            path.chmod(0o755)
    assert opened
    assert all(not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) for _, _, flags in opened)
    assert files_of(folder) == before
    opened = None


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
@pytest.mark.parametrize(
    ("link", "sentence"),
    [(Path.symlink_to, "cannot be locked"), (Path.hardlink_to, approved_pattern("session.lock_elsewhere"))],
)
def test_a_lock_that_is_a_file_elsewhere_is_refused_and_the_file_stays(tmp_path, link, sentence):
    """A session of a stranger may hold links: nothing beyond its folder is written."""
    letter, folder = tmp_path / "letter", tmp_path / "s"
    letter.write_text("dear", encoding="utf-8")
    folder.mkdir()
    link(folder / LOCK_NAME, letter)
    with pytest.raises(InputError, match=sentence):
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
    assert str(os.getpid()) in describe_lock_holder(tmp_path / "s")
    with pytest.raises(InputError, match="is being recorded"):
        resume(tmp_path / "s")
    journal.close()
    assert len(load(tmp_path / "backup").session.contacts) == 0


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names")
def test_a_pipe_in_the_place_of_the_lock_keeps_nobody_waiting(tmp_path):
    os.mkfifo(tmp_path / LOCK_NAME)
    assert describe_lock_holder(tmp_path) == ""
    with pytest.raises(InputError):
        SessionLock(tmp_path)
