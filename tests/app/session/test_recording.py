"""A recording that is paused goes on in the next segment, and where it cannot, nothing is lost."""

import shutil
import time
from pathlib import Path

import pytest

from app.session.opening import OpenRequest
from app.session.recording import Recording, SessionFolder
from app.state.running import Running
from app.text.message import copy_words
from skincal.contacts.outcome import Reason
from skincal.journal import writer
from skincal.model.actions import Exclude
from skincal.model.errors import InputError
from skincal.model.scene import resource
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from tests.app.window_support import slip
from tests.approved import approved_pattern
from tests.skincal.poke_script import LINKS, as_chunks, killed, some_pokes, write_scene


class Folder:
    """Where a recording lies, as `SessionFolder` says it."""

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
    Recording(pipeline, recording.storage).resume()
    pipeline.close()
    assert segments(tmp_path / "s") == ["segment-0001.mcap", "segment-0002.mcap", "segment-0003.mcap"]
    assert len(replay(tmp_path / "s").snapshot().pokes) == 2
    recording.pipeline.journal = None


def test_a_disk_without_room_for_a_segment_leaves_the_session_alive(recording, tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writer, "JournalWriter", refuse)
    with pytest.raises(InputError, match="No space left"):
        recording.resume()
    monkeypatch.setattr(writer, "JournalWriter", type(recording.pipeline.journal))
    recording.pipeline.act(Exclude(1), 1)  # still recorded
    recording.resume()
    recording.pipeline.act(Exclude(2), 2)
    recording.pipeline.close()
    assert segments(tmp_path / "s") == ["segment-0001.mcap", "segment-0002.mcap"]
    assert load(tmp_path / "s").session.excluded == (1, 2)


def test_a_journal_that_failed_is_not_followed_by_another_segment(recording, tmp_path):
    recording.pipeline.journal_failure = "the disk is full"
    with pytest.raises(InputError, match=approved_pattern("session.open_again")):
        recording.resume()
    assert segments(tmp_path / "s") == ["segment-0001.mcap"]


def refuse(*_, **__):
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("discarded", [False, True])
def test_a_disk_that_refuses_the_end_of_a_session_is_named_unless_the_session_goes(tmp_path, monkeypatch, discarded):
    storage = SessionFolder(OpenRequest(), tmp_path / "documents")
    scene = write_scene(tmp_path / "source")
    recording = Recording(Pipeline(scene, LINKS, None, writer.create_session(storage.prepare(), scene, LINKS)), storage)
    if discarded:
        storage.discard()
    monkeypatch.setattr("os.fsync", refuse)
    if discarded:
        recording.end()
    else:
        with pytest.raises(InputError, match=r"No space left on device.* look at its last pokes"):
            recording.end()


def contents(folder: Path) -> dict[str, bytes]:
    """What each file of a folder holds."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def provisional(tmp_path: Path) -> SessionFolder:
    """A recording that nobody named a folder for."""
    storage = SessionFolder(OpenRequest(), tmp_path / "documents")
    scene = write_scene(tmp_path / "source")
    writer.create_session(storage.prepare(), scene, LINKS).close()
    return storage


@pytest.mark.parametrize("choice", ["none", "keep", "discard"])
def test_a_provisional_recording_lies_in_the_documents_from_the_start_and_goes_only_if_discarded(tmp_path, choice):
    storage = provisional(tmp_path)
    assert storage.is_provisional
    assert storage.folder.parent == tmp_path / "documents"
    assert str(storage.folder) in storage.sentence()
    if choice == "keep":
        storage.keep()
        storage.discard()
    elif choice == "discard":
        storage.discard()
    storage.finish()
    assert storage.folder.exists() == storage.folder.parent.exists() == (choice != "discard")


def test_files_that_others_put_into_a_discarded_recording_stay(tmp_path):
    storage = provisional(tmp_path)
    (storage.folder / "positions.csv").write_text("mine")
    storage.discard()
    storage.finish()
    assert list(contents(storage.folder)) == ["positions.csv"]


@pytest.mark.parametrize("kind", ["folder", "session"])
def test_a_recording_in_a_named_folder_is_never_discarded(tmp_path, kind):
    storage = SessionFolder(OpenRequest(**{kind: tmp_path / "monday"}), tmp_path / "documents")
    assert storage.prepare() == tmp_path / "monday"
    assert not storage.is_provisional
    writer.create_session(storage.folder, write_scene(tmp_path / "source"), LINKS).close()
    held = contents(storage.folder)
    storage.discard()
    storage.finish()
    assert contents(storage.folder) == held


@pytest.mark.parametrize(("is_there", "goes"), [(False, True), (True, False)])
def test_an_empty_session_goes_with_its_folder_unless_that_was_there(tmp_path, is_there, goes):
    folder = tmp_path / "a" / "monday"
    if is_there:
        folder.mkdir(parents=True)
    storage = SessionFolder(OpenRequest(folder=folder), tmp_path / "documents")
    writer.create_session(storage.prepare(), write_scene(tmp_path / "source"), LINKS).close()
    assert storage.discard_empty() is goes
    storage.finish()
    assert folder.exists() is folder.parent.exists() is not goes
    opened = SessionFolder(OpenRequest(session=folder), tmp_path / "documents")
    assert opened.prepare() == folder
    assert not opened.discard_empty()


SAMPLE = resource("sessions/sample")


def test_the_copy_of_a_session_that_ships_may_be_written_though_nobody_may_write_the_installation(tmp_path, monkeypatch):
    installed = tmp_path / "installed"
    shutil.copytree(SAMPLE, installed / "sessions" / "sample")
    for path in (installed, *installed.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    monkeypatch.setattr("skincal.model.scene._resource_folders", lambda: (installed,))
    storage = SessionFolder(OpenRequest(session=installed / "sessions" / "sample"), tmp_path / "documents")
    storage.prepare()
    copied = [storage.folder, *storage.folder.rglob("*")]
    assert {path.name for path in copied} >= {"segment-0001.mcap", "scene.toml", "truth.json"}
    assert all(path.stat().st_mode & 0o200 for path in copied)
    storage.discard()
    storage.finish()
    assert not storage.folder.exists()


def test_a_session_that_ships_is_opened_as_a_copy_and_stays_as_it_is(bench):
    before = sorted((path, path.stat().st_mtime_ns) for path in SAMPLE.rglob("*"))
    bench.open(OpenRequest(session=SAMPLE))
    assert copy_words(SAMPLE) in [message.text for message in bench.messages]
    assert bench.controller.unsaved_pokes == 0
    session = bench.recording.pipeline.session
    session.add(slip(session.last_poke + 1, Reason.NOT_STILL, 0.21, 0.3, "s"))
    assert bench.controller.unsaved_pokes > 0, "rejected pokes are not lost without a question either"
    assert bench.controller.act(Exclude(bench.accepted()[0].poke))
    folder = bench.recording.storage.folder
    bench.window.leave()
    assert load(folder).session.excluded, "nobody was asked, so the copy stays"
    assert sorted((path, path.stat().st_mtime_ns) for path in SAMPLE.rglob("*")) == before


def failures(bench):
    return [message.text for message in bench.messages if "No space left" in message.text]


def test_a_disk_that_refuses_is_named_once_with_or_without_devices_and_at_the_end(bench, recorded, monkeypatch):
    bench.open(OpenRequest(session=recorded))
    assert bench.controller.running is Running.OFFLINE
    monkeypatch.setattr("os.fsync", refuse)
    assert bench.controller.act(Exclude(bench.accepted()[0].poke))
    bench.until(lambda: failures(bench))
    bench.qtbot.wait(100)
    bench.controller.leave()
    bench.until(lambda: bench.controller._endings._thread is None)
    bench.qtbot.wait(50)
    assert len(failures(bench)) == 1
    monkeypatch.undo()
    bench.open(OpenRequest(session=recorded))
    monkeypatch.setattr("os.fsync", refuse)
    bench.controller.leave()
    bench.until(lambda: len(failures(bench)) == 2)


SLOW_S = 2.5  # s. Longer than closing waits for work that nobody would miss.


def test_a_session_that_another_takes_the_place_of_is_ended_before_the_program(bench, recorded, tmp_path, monkeypatch):
    ended = []
    finish = SessionFolder.finish

    def slowly(storage):
        if storage.folder == recorded:
            time.sleep(SLOW_S)
        finish(storage)
        ended.append(storage.folder)

    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    monkeypatch.setattr(SessionFolder, "finish", slowly)
    bench.window.open(OpenRequest(session=tmp_path / "none"))
    bench.window.close()
    assert recorded in ended
