"""A window records on while a thread forces the journal onto the disk."""

import os
import threading

import pytest

from skincal.contacts.outcome import Contact
from skincal.journal.disk_sync import DiskSync
from skincal.journal.line_file import lines_path
from skincal.session.replay import load
from tests.skincal.journal.journal_support import assert_same, feed, new_session, refuse
from tests.skincal.poke_script import some_pokes, write_scene


class Disk:
    """A disk that forces nothing before `go_on`; `forced` are the threads, the endings of the files and their sizes."""

    def __init__(self, folder, monkeypatch):
        self._names = {path.stat().st_ino: path.suffix for path in folder.glob("segment-*")}
        self.begun, self._may_work, self._force = threading.Event(), threading.Event(), os.fsync
        self.forced = []
        monkeypatch.setattr(os, "fsync", self.force)

    def force(self, descriptor):
        if threading.current_thread() is not threading.main_thread():
            self.begun.set()
            assert self._may_work.wait(60.0)
        self._force(descriptor)
        stat = os.fstat(descriptor)
        self.forced.append((threading.current_thread().name, self._names[stat.st_ino], stat.st_size))

    def go_on(self):
        self._may_work.set()


@pytest.fixture
def live(tmp_path):
    """A pipeline as a window has it."""
    pipeline = new_session(write_scene(tmp_path / "source"), tmp_path / "s")
    pipeline.syncs_in_background = True
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
    by_thread = [(thread, suffix) for thread, suffix, _ in disk.forced]
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
        live.journal.sync_in_background()
        live.journal.disk.wait()
    live.close()
    assert "No space left" in live.journal_failure


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
