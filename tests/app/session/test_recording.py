"""A recording that is paused goes on in the next segment, and where it cannot, nothing is lost."""

import shutil
import time
from pathlib import Path

import pytest

from app.session.opening import OpenRequest
from app.session.recording import Recording, Storage
from skincal.contacts.outcome import Reason
from skincal.journal import writer
from skincal.journal.lock import LOCK_NAME
from skincal.model.actions import Exclude
from skincal.model.errors import InputError
from skincal.model.scene import resource
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from tests.app.window_support import slip
from tests.approved import approved, approved_pattern
from tests.skincal.poke_script import LINKS, as_chunks, killed, some_pokes, write_scene


class Folder:
    """Where a recording lies, as `app.session.recording.Storage` says it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder


@pytest.fixture
def recording(tmp_path, monkeypatch):
    monkeypatch.setattr(Recording, "start", lambda _: None)  # nothing to read: the test feeds the pipeline
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, writer.create_session(tmp_path / "s", scene, LINKS))
    for item in as_chunks(some_pokes(scene, 2).samples):
        pipeline.feed(item)
    yield Recording(pipeline, Folder(tmp_path / "s"))
    pipeline.close()


def segments(folder):
    return sorted(path.name for path in folder.glob("*.mcap"))


def test_no_number_is_skipped_after_a_recovery(recording, tmp_path):
    killed(recording.pipeline)
    pipeline = resume(tmp_path / "s")
    assert (tmp_path / "s" / "segment-0001.mcap.damaged").exists()
    Recording(pipeline, recording.storage).go_on()
    pipeline.close()
    assert segments(tmp_path / "s") == ["segment-0001.mcap", "segment-0002.mcap", "segment-0003.mcap"]
    assert len(replay(tmp_path / "s").snapshot().pokes) == 2
    recording.pipeline.journal = None


def test_a_disk_without_room_for_a_segment_leaves_the_session_alive(recording, tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writer, "JournalWriter", refuse)
    with pytest.raises(InputError, match="No space left"):
        recording.go_on()
    monkeypatch.setattr(writer, "JournalWriter", type(recording.pipeline.journal))
    recording.pipeline.act(Exclude(1), 1)  # still recorded
    recording.go_on()
    recording.pipeline.act(Exclude(2), 2)
    recording.pipeline.close()
    assert segments(tmp_path / "s") == ["segment-0001.mcap", "segment-0002.mcap"]
    assert load(tmp_path / "s").session.excluded == (1, 2)


def test_a_journal_that_failed_is_not_followed_by_another_segment(recording, tmp_path):
    recording.pipeline.journal_failure = "the disk is full"
    with pytest.raises(InputError, match=approved_pattern("session.open_again")):
        recording.go_on()
    assert segments(tmp_path / "s") == ["segment-0001.mcap"]


def test_what_is_kept_in_the_middle_of_a_recording_is_whole(recording, tmp_path, monkeypatch):
    """It goes on while it is copied; lines that speak of bytes that were not copied would not be played."""
    temporary = Storage(OpenRequest(), tmp_path / "documents")
    copy, rest = shutil.copytree, as_chunks(some_pokes(recording.pipeline.scene, 4).samples)
    pipeline = Pipeline(
        recording.pipeline.scene, LINKS, None, writer.create_session(temporary.folder, recording.pipeline.scene, LINKS)
    )

    def slowly(*arguments, **options):
        for _ in range(len(rest) // 2):
            pipeline.feed(rest.pop(0))
        return copy(*arguments, **options)

    for item in as_chunks(some_pokes(pipeline.scene, 1).samples):
        pipeline.feed(item)
    monkeypatch.setattr(shutil, "copytree", slowly)
    kept = temporary.keep()
    monkeypatch.undo()
    loaded, played = load(kept), replay(kept)
    assert len(loaded.session.contacts) == len(played.session.contacts) > 1
    assert not any("missing" in sentence for sentence in played.findings)
    assert not (kept / LOCK_NAME).exists()
    pipeline.close()
    temporary.finish()
    assert len(load(kept).session.contacts) >= 3
    assert replay(kept).findings == ()


def contents(folder: Path) -> dict[str, str]:
    """What each file of a folder holds."""
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Write a session's files as they stand after so many segments."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def write(folder: Path, segments: int) -> dict[str, str]:
        (folder / "scene").mkdir(parents=True, exist_ok=True)
        names = [f"segment-000{n}.{kind}" for n in range(1, segments + 1) for kind in ("mcap", "jsonl")]
        for name in ("scene/scene.toml", *names):
            (folder / name).write_text(f"{name} of {segments}")
        return contents(folder)

    return write


def test_a_temporary_recording_is_kept_whole_and_brought_up_to_date_at_its_end(tmp_path, write):
    storage = Storage(OpenRequest(), tmp_path / "documents")
    assert storage.can_keep
    first = write(storage.folder, 1)
    (storage.folder / LOCK_NAME).write_text("this process")
    kept = storage.keep()
    assert kept == storage.kept
    assert kept.parent == tmp_path / "documents"
    assert contents(kept) == first
    assert not storage.can_keep
    assert str(kept) in storage.words()
    (storage.folder / LOCK_NAME).unlink()
    second = write(storage.folder, 2)
    storage.finish()
    assert contents(kept) == second
    assert not storage.folder.parent.exists()


def test_a_temporary_recording_that_nobody_keeps_goes(tmp_path, write):
    storage = Storage(OpenRequest(), tmp_path / "documents")
    write(storage.folder, 1)
    storage.finish()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["folder", "session"])
def test_a_recording_in_a_folder_of_its_own_stays_there(tmp_path, write, kind):
    storage = Storage(OpenRequest(**{kind: tmp_path / "monday"}), tmp_path / "documents")
    assert storage.folder == tmp_path / "monday"
    assert not storage.can_keep
    held = write(storage.folder, 1)
    storage.finish()
    assert contents(tmp_path / "monday") == held
    assert [path.name for path in tmp_path.iterdir()] == ["monday"]


SAMPLE = resource("sessions/sample")


def test_the_copy_of_a_session_that_ships_may_be_written_though_nobody_may_write_the_installation(tmp_path, monkeypatch):
    installed = tmp_path / "installed"
    shutil.copytree(SAMPLE, installed / "sessions" / "sample")
    for path in (installed, *installed.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    monkeypatch.setattr("skincal.model.scene._resource_folders", lambda: (installed,))
    storage = Storage(OpenRequest(session=installed / "sessions" / "sample"), tmp_path / "documents")
    storage.fetch()
    copied = [storage.folder, *storage.folder.rglob("*")]
    assert {path.name for path in copied} >= {"segment-0001.mcap", "scene.toml", "truth.json"}
    assert all(path.stat().st_mode & 0o200 for path in copied)
    storage.finish()
    assert not storage.folder.exists()


def test_pokes_that_were_all_rejected_are_not_lost_without_a_question_either(bench):
    bench.open(OpenRequest(session=SAMPLE))
    assert bench.controller.would_lose == 0
    session = bench.controller._recording.pipeline.session
    session.add(slip(session.last_poke + 1, Reason.NOT_STILL, 0.21, 0.3, "s"))
    assert bench.controller.would_lose > 0


def test_a_session_that_ships_is_opened_as_a_copy_and_stays_as_it_is(bench):
    before = sorted((path, path.stat().st_mtime_ns) for path in SAMPLE.rglob("*"))
    bench.open(OpenRequest(session=SAMPLE))
    assert approved("session.ships_copied", folder=SAMPLE) in [message.text for message in bench.messages]
    assert bench.controller.would_lose == 0
    assert bench.controller.act(Exclude(bench.accepted()[0].poke))
    assert bench.controller.would_lose > 0
    bench.window.leave()
    assert sorted((path, path.stat().st_mtime_ns) for path in SAMPLE.rglob("*")) == before


SLOW_S = 2.5
"""s. Longer than closing waits for work that nobody would miss."""


@pytest.fixture
def slow_copy(monkeypatch):
    """The next copy of a folder begins late, as on a slow disk."""
    copy = shutil.copytree

    def slowly(*arguments, **options):
        monkeypatch.setattr(shutil, "copytree", copy)
        time.sleep(SLOW_S)
        return copy(*arguments, **options)

    return lambda: monkeypatch.setattr(shutil, "copytree", slowly)


def test_a_copy_that_is_under_way_as_the_window_closes_is_whole(bench, slow_copy):
    bench.open_served("flat-patch")
    temporary = bench.controller._recording.storage.folder
    slow_copy()
    bench.controller.keep()
    bench.window.close()
    assert not temporary.parent.exists()
    (kept,) = bench.documents.iterdir()
    assert replay(kept).findings == ()


def test_a_copy_that_fails_is_said_after_another_session_is_opened_and_costs_nothing(bench, recorded, slow_copy):
    bench.open_served("flat-patch")
    temporary = bench.controller._recording.storage.folder
    bench.documents.write_text("a file where the folder should be")
    slow_copy()
    bench.controller.keep()
    bench.open(OpenRequest(session=recorded))
    bench.until(lambda: any(message.error and str(temporary) in message.text for message in bench.messages), 20_000)
    bench.window.close()
    assert replay(temporary).findings == ()
    shutil.rmtree(temporary.parent)


def test_a_session_that_another_takes_the_place_of_is_ended_before_the_program(bench, recorded, tmp_path, monkeypatch):
    ended = []
    finish = Storage.finish

    def slowly(storage):
        if storage.folder == recorded:
            time.sleep(SLOW_S)
        finish(storage)
        ended.append(storage.folder)

    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    monkeypatch.setattr(Storage, "finish", slowly)
    bench.window.open(OpenRequest(session=tmp_path / "none"))
    bench.window.close()
    assert recorded in ended
