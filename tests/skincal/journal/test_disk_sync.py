"""A window records on while a thread forces the journal onto the disk."""

import os
import shutil
import sys
import threading
from pathlib import Path

import pytest

from app.session.recording import Recording
from skincal.contacts.outcome import Contact
from skincal.journal import writer
from skincal.journal.disk_sync import DiskSync
from skincal.journal.line_file import lines_path
from skincal.journal.lock import SessionLock
from skincal.model.actions import Exclude
from skincal.model.errors import InputError
from skincal.session.replay import load
from tests.approved import approved_pattern
from tests.skincal.journal.journal_support import assert_same, feed, new_session, refuse
from tests.skincal.poke_script import as_chunks, some_pokes, write_scene


class Disk:
    """A disk that forces nothing before `go_on`; `forced` are the threads, the names of the files and their sizes."""

    def __init__(self, folder, monkeypatch):
        self._folder = folder
        self.begun, self._may_work, self._force = threading.Event(), threading.Event(), os.fsync
        self.forced = []
        monkeypatch.setattr(os, "fsync", self.force)

    def force(self, descriptor):
        if threading.current_thread() is not threading.main_thread():
            self.begun.set()
            assert self._may_work.wait(60.0)
        self._force(descriptor)
        stat = os.fstat(descriptor)
        (name,) = (path.name for path in self._folder.glob("segment-*") if path.stat().st_ino == stat.st_ino)
        self.forced.append((threading.current_thread().name, name, stat.st_size))

    def go_on(self):
        self._may_work.set()


@pytest.fixture
def live(tmp_path):
    """A pipeline as a window has it."""
    pipeline = new_session(write_scene(tmp_path / "source"), tmp_path / "s")
    pipeline.journal.syncs_in_background = True
    return pipeline


def test_a_slow_disk_does_not_delay_pokes_and_gets_the_bytes_first(live, tmp_path, monkeypatch):
    disk = Disk(tmp_path / "s", monkeypatch)
    feed(live, some_pokes(live.scene, 2))
    assert sum(isinstance(record.outcome, Contact) for record in live.snapshot().pokes) == 2
    assert disk.forced == []
    # A program that is killed now has lost no poke.
    assert_same(live, load(tmp_path / "s"))
    lines = lines_path(tmp_path / "s" / "segment-0001.mcap")
    confirmed = lines.stat().st_size
    disk.go_on()
    live.journal.disk.wait()
    by_thread = [(thread, Path(name).suffix) for thread, name, _ in disk.forced]
    # How many requests become one depends on when the thread begins.
    assert by_thread == [("skincal-disk", ".mcap"), ("skincal-disk", ".jsonl")] * (len(by_thread) // 2)
    assert disk.forced[-1][2] == confirmed
    live.close()
    assert [thread for thread, _, _ in disk.forced[len(by_thread) :]] == ["MainThread"] * 2


def test_closing_waits_for_the_disk(live, tmp_path, monkeypatch):
    disk = Disk(tmp_path / "s", monkeypatch)
    feed(live, some_pokes(live.scene, 1))
    wait = DiskSync.wait

    def go_on_and_wait(sync):
        disk.go_on()
        wait(sync)

    monkeypatch.setattr(DiskSync, "wait", go_on_and_wait)
    live.close()
    threads = [thread for thread, _, _ in disk.forced]
    assert threads[-2:] == ["MainThread"] * 2
    assert set(threads[:-2]) == {"skincal-disk"}
    assert_same(live, load(tmp_path / "s"))


def into_next_segment(live, how, monkeypatch):
    """Let the next segment begin: after a pause, or because this one is long enough."""
    if how == "pause":
        monkeypatch.setattr(Recording, "start", lambda _: None)
        Recording(live, None).resume()
    else:
        monkeypatch.setattr(writer, "SEGMENT_MAX_DURATION_NS", 0)


@pytest.mark.parametrize("how", ["pause", "length"])
def test_the_next_segment_does_not_wait_for_the_disk(live, tmp_path, monkeypatch, how):
    feed(live, some_pokes(live.scene, 1))
    live.journal.disk.wait()
    disk = Disk(tmp_path / "s", monkeypatch)
    into_next_segment(live, how, monkeypatch)
    live.act(Exclude(1), 10**12)
    assert (tmp_path / "s" / "segment-0002.mcap").exists()
    assert disk.forced == []
    # Another program, also after this one is killed, reads both.
    assert load(tmp_path / "s").session.excluded == (1,)
    disk.go_on()
    live.journal.disk.wait()
    names = [name for _, name, _ in disk.forced]
    assert names[names.index("segment-0001.mcap") + 1] == "segment-0001.jsonl"
    assert names[-2:] == ["segment-0002.mcap", "segment-0002.jsonl"]
    live.close()
    assert_same(live, load(tmp_path / "s"))


@pytest.mark.parametrize("how", ["pause", "length"])
def test_a_disk_that_refuses_the_end_of_a_segment_ends_the_recording(live, monkeypatch, how):
    feed(live, some_pokes(live.scene, 1))
    live.journal.disk.wait()
    may_refuse = threading.Event()

    def refuse_then(_):
        assert may_refuse.wait(60.0)
        refuse()

    monkeypatch.setattr(os, "fsync", refuse_then)
    into_next_segment(live, how, monkeypatch)
    journal = live.journal
    # As many as fill a segment without a length.
    for chunk in as_chunks(some_pokes(live.scene, 1, seed=6).samples):
        live.feed(chunk)
        if journal.path.name != "segment-0001.mcap":
            break
    may_refuse.set()
    journal.disk.wait()
    live.tick(10**12)
    assert journal.path.name != "segment-0001.mcap"
    assert "No space left" in live.journal_failure
    live.close()


def test_a_disk_that_refuses_while_the_next_segment_opens_ends_the_recording(live, tmp_path, monkeypatch):
    open_next = writer.JournalWriter.open_next

    def opened(journal, *given):
        following = open_next(journal, *given)
        following.disk.wait()
        return following

    monkeypatch.setattr(writer.JournalWriter, "open_next", opened)
    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(InputError, match=approved_pattern("session.open_again")):
        into_next_segment(live, "pause", monkeypatch)
    assert "No space left" in live.journal_failure
    SessionLock(tmp_path / "s").release()


def test_requests_during_an_earlier_one_become_one(tmp_path, monkeypatch):
    file = (tmp_path / "segment-0001.mcap").open("wb")
    disk, sync = Disk(tmp_path, monkeypatch), DiskSync()
    sync.request(file.fileno())
    assert disk.begun.wait(60.0)
    for _ in range(3):
        sync.request(file.fileno())
    disk.go_on()
    sync.wait()
    assert [thread for thread, _, _ in disk.forced] == ["skincal-disk"] * 2
    file.close()


def test_a_disk_that_refuses_in_the_background_ends_the_recording_and_says_so_once(live, monkeypatch):
    monkeypatch.setattr(os, "fsync", refuse)
    feed(live, some_pokes(live.scene, 1))
    journal = live.journal
    if journal is not None:
        journal.disk.wait()
        live.tick(10**12)
    assert "No space left" in live.journal_failure
    assert live.journal is None
    feed(live, some_pokes(live.scene, 1, seed=6))
    live.close()


def test_a_disk_that_refused_before_the_end_is_noticed_at_the_end(live, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", refuse)
        live.journal.sync()
        live.journal.disk.wait()
    live.close()
    assert "No space left" in live.journal_failure


@pytest.mark.skipif(sys.platform == "win32", reason="Windows deletes no open file")
def test_a_folder_that_is_deleted_just_before_the_end_is_noticed_at_the_end(live, tmp_path):
    feed(live, some_pokes(live.scene, 1))
    live.journal.disk.wait()
    shutil.rmtree(tmp_path / "s")
    live.close()
    assert "deleted, moved or unmounted" in live.journal_failure


def test_no_thread_stays(tmp_path):
    sync, file = DiskSync(), (tmp_path / "file").open("wb")
    for _ in range(3):
        sync.request(file.fileno())
        sync.wait()
        sync.raise_error()
    # A thread without a request is listed for another moment.
    for thread in threading.enumerate():
        if thread.name == "skincal-disk":
            thread.join(60.0)
            assert not thread.is_alive()
    file.close()
