"""Work beside the window: answers in the window's thread, late ones dropped, faults said, and nothing left at the end."""

from __future__ import annotations

import multiprocessing.spawn
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from PySide6.QtCore import QEvent, QObject
from PySide6.QtWidgets import QApplication

from app.workers.processes import ProcessLostError, WorkerProcess
from app.workers.threads import ThreadService
from skincal.model.errors import InputError
from tests.app.workers.process_support import double, end, end_once, is_running, own_pid, refuse, until_unwanted
from tests.approved import approved, approved_pattern


@pytest.fixture
def owner(qapp):
    made = QObject(qapp)
    yield made
    made.deleteLater()


@pytest.fixture
def threads(owner):
    made = ThreadService("test", owner)
    yield made
    made.close()


def names() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name == "skincal-test"]


# In a thread


def test_an_answer_comes_in_the_window_s_thread_and_the_thread_goes(qtbot, threads):
    heard = []
    for number in range(3):
        threads.submit(
            lambda number=number: (number, threading.current_thread().name),
            lambda answer: heard.append((*answer, threading.current_thread() is threading.main_thread())),
        )
    assert heard == [], "never before the window's loop runs"
    qtbot.waitUntil(lambda: len(heard) == 3, timeout=5000)
    assert heard == [(number, "skincal-test", True) for number in range(3)]
    qtbot.waitUntil(lambda: not names(), timeout=5000)
    threads.submit(lambda: "again", heard.append)
    qtbot.waitUntil(lambda: heard[-1] == "again", timeout=5000)


def test_work_is_done_in_turn_and_that_of_two_services_side_by_side(qtbot, owner, threads):
    other, free, heard = ThreadService("test", owner), threading.Event(), []
    threads.submit(free.wait, lambda _: heard.append("first"))
    threads.submit(lambda: None, lambda _: heard.append("second"))
    other.submit(lambda: None, lambda _: heard.append("other"))
    qtbot.waitUntil(lambda: heard == ["other"], timeout=5000)
    free.set()
    qtbot.waitUntil(lambda: heard == ["other", "first", "second"], timeout=5000)


def test_what_was_asked_in_an_earlier_generation_comes_too_late(qtbot, threads):
    heard, back = [], []
    threads.submit(lambda: "old", heard.append, heard.append, back.append)
    threads.submit(lambda: broken(InputError("old")), heard.append, heard.append)
    threads.renew()
    threads.submit(lambda: "new", heard.append)
    qtbot.waitUntil(lambda: bool(heard), timeout=5000)
    assert (heard, back) == (["new"], ["old"])


def broken(error: BaseException) -> None:
    raise error


def test_a_sentence_is_said_and_a_fault_is_raised_where_the_operator_hears_of_it(qtbot, threads):
    said, heard = [], []
    with qtbot.captureExceptions() as faults:
        threads.submit(lambda: broken(InputError("no such file")), heard.append, said.append)
        threads.submit(lambda: broken(InputError("nobody listens")), heard.append)
        threads.submit(lambda: broken(ZeroDivisionError("ours")), heard.append, said.append)
        threads.submit(lambda: "and on", lambda _: broken(KeyError("in the answer's receiver")))
        threads.submit(lambda: "and on", heard.append)
        qtbot.waitUntil(lambda: heard == ["and on"], timeout=5000)
    assert said == ["no such file"]
    assert [kind for kind, *_ in faults] == [InputError, ZeroDivisionError, KeyError]


@pytest.mark.parametrize("error", [None, InputError("no"), ZeroDivisionError("ours")])
@pytest.mark.parametrize("late", [False, True])
def test_who_asked_hears_of_the_end_whatever_became_of_the_work(qtbot, threads, error, late):
    ended = []
    with qtbot.captureExceptions():
        threads.submit(lambda: broken(error) if error else 1, lambda _: None, lambda _: None, ended=lambda: ended.append(1))
        if late:
            threads.renew()
        qtbot.waitUntil(lambda: ended == [1], timeout=5000)


def test_closing_waits_with_a_limit_and_gives_back_what_came_too_late(qtbot, owner, caplog):
    threads, free, heard, back = ThreadService("test", owner), threading.Event(), [], []
    threads.submit(lambda: "done", heard.append, None, back.append)
    threads.submit(lambda: broken(ZeroDivisionError("ours")), heard.append)
    threads.submit(free.wait, heard.append, None, back.append)
    begun = time.monotonic()
    threads.close(0.2)  # without the limit it would wait for `free`
    assert time.monotonic() - begun > 0.1
    assert back == ["done"]
    assert approved("workers.failed_while_closing") in caplog.text
    threads.submit(lambda: "no more", heard.append)
    free.set()
    qtbot.waitUntil(lambda: len(back) == 2, timeout=5000)
    assert heard == []
    assert not names()


def test_closing_lets_what_was_asked_be_done(owner):
    threads, done = ThreadService("test", owner), []
    for number in range(5):
        threads.submit(lambda number=number: [time.sleep(0.02), done.append(number)], lambda _: None)
    threads.close()
    assert done == list(range(5))


def test_nothing_is_called_once_the_owner_is_gone(qtbot):
    owner, free, heard = QObject(), threading.Event(), []
    ThreadService("test", owner).submit(free.wait, heard.append)
    owner.deleteLater()
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    free.set()
    qtbot.waitUntil(lambda: not names(), timeout=5000)
    qtbot.wait(20)
    assert heard == []


# In a process


@pytest.fixture
def processes():
    made = WorkerProcess()
    yield made
    made.close()


def test_a_process_is_there_from_the_first_question_to_the_end(processes):
    assert processes.pid is None
    assert processes.ask(processes.next_id(), double, 21) == 42
    pid = processes.pid
    assert processes.ask(processes.next_id(), own_pid) == pid != os.getpid()
    with pytest.raises(InputError, match="too far"):
        processes.ask(processes.next_id(), refuse, "too far")
    assert processes.ask(processes.next_id(), own_pid) == pid, "it lives on"
    processes.close()
    assert not is_running(pid)
    with pytest.raises(ProcessLostError):
        processes.ask(processes.next_id(), double, 1)
    processes.close()


def test_a_process_that_was_killed_is_replaced_and_asked_again_once(processes, tmp_path):
    first = processes.ask(processes.next_id(), own_pid)
    os.kill(first, signal.SIGKILL)
    second = processes.ask(processes.next_id(), own_pid)
    assert second != first
    assert processes.ask(processes.next_id(), end_once, tmp_path / "ended") == "the second time"
    with pytest.raises(ProcessLostError, match=approved_pattern("workers.gone", code=3)):
        processes.ask(processes.next_id(), end)
    assert processes.ask(processes.next_id(), double, 4) == 8


def test_work_hears_that_something_newer_is_asked(processes, tmp_path):
    heard = []
    ticket = processes.next_id()
    asking = threading.Thread(target=lambda: heard.append(processes.ask(ticket, until_unwanted, tmp_path / "begun")))
    asking.start()
    while not (tmp_path / "begun").exists():
        time.sleep(0.01)
    assert heard == []
    processes.next_id()
    asking.join(5)
    assert heard == ["unwanted"]


@pytest.mark.parametrize("size", [1, 20_000_000], ids=["little", "much"])
def test_closing_ends_the_process_at_once_whatever_it_does(processes, tmp_path, size):
    """Much is still on its way when the process is killed: a pool of `concurrent.futures` hangs then, with Python 3.11.2."""
    heard = []

    def ask():
        with pytest.raises(ProcessLostError) as lost:
            processes.ask(processes.next_id(), until_unwanted, b"x" * size if size > 1 else tmp_path / "begun")
        heard.append(lost.value)

    asking = threading.Thread(target=ask)
    asking.start()
    while processes.pid is None or (size == 1 and not (tmp_path / "begun").exists()):
        time.sleep(0.001)
    pid = processes.pid
    processes.close()
    assert not is_running(pid)
    asking.join(20)
    assert len(heard) == 1


def test_a_process_that_cannot_be_started_is_said(processes, monkeypatch):
    monkeypatch.setattr(multiprocessing.spawn, "_python_exe", os.fsencode("/there-is-no-such-program"))
    with pytest.raises(ProcessLostError):
        processes.ask(processes.next_id(), own_pid)


ORPHAN = """
import os, signal
from app.workers.processes import WorkerProcess
from tests.app.workers.process_support import own_pid
if __name__ == "__main__":
    processes = WorkerProcess()
    print(processes.ask(processes.next_id(), own_pid), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="signals as on Linux and macOS")
def test_a_process_does_not_outlive_a_window_that_was_killed(tmp_path):
    (tmp_path / "orphan.py").write_text(ORPHAN, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(tmp_path / "orphan.py")],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    pid = int(done.stdout)
    end_s = time.monotonic() + 10
    while is_running(pid) and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not is_running(pid)


def test_the_window_imports_no_pool_of_processes_before_it_needs_one():
    code = "import sys, app.run, app.session_view, app.workers.processes;sys.exit('concurrent.futures.process' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.usefixtures("poisoned")
def test_a_process_runs_nothing_of_the_working_folder(processes, tmp_path):
    assert processes.ask(processes.next_id(), double, 3) == 6
    assert not (tmp_path / "ran").exists()
