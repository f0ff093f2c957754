"""Processes for work that would block the window even from a thread: the review of landmark pokes, and single jobs.

The calculation of sensor and arm errors holds Python's lock for tenths of a second. Its process starts with the first landmark
poke and ends with the window. A newer request replaces the one in work. The process imports this module, too.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from PySide6.QtCore import QObject, Signal

from app.workers.threads import LOG, ThreadService, raise_sentences
from skincal.child_environment import protect_children
from skincal.following.review import Review, ReviewRequest, review_packed
from skincal.session.session import Session
from skincal.session.snapshot import PokeRecord, Snapshot

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

    from skincal.files.importers.preview import RecordingFiles, RecordingPreview
    from skincal.files.reference import TaxelPositions
    from skincal.session.importing import Imported, ImportRequest
    from skincal.taxels.result import Method

T = TypeVar("T")
WORKER_NICE_INCREMENT = 5  # The process gives way to the window
KILLED_PROCESS_WAIT_S = 0.7  # Closing waits this long for a killed process, which holds nothing that could be lost
SKIN_POKES_PER_RIG_REVIEW = 10  # A single poke on the skin changes the result by less than is shown


class ProcessLostError(Exception):
    """The process and its replacement ended during a request, or the service is closed."""

    def __repr__(self) -> str:
        return str(self)


class WorkerProcess:
    """One process that answers requests from any thread, one at a time.

    Not `concurrent.futures`: if a worker of its pool is killed during a request, closing the pool hangs for ever with Python
    3.11.2 (docs/decisions/work-beside-the-window.md).
    """

    def __init__(self) -> None:
        self._asking = threading.Lock()
        self._starting = threading.Lock()
        self._process: BaseProcess | None = None
        self._connection: Connection[Any, Any] | None = None
        self._newest_id = 0
        self._shared_id: Any = None  # The same number in shared memory; `None` before the first process
        self._closed = False

    @property
    def pid(self) -> int | None:
        """Process id; `None` before the first process."""
        return None if self._process is None else self._process.pid

    def next_id(self) -> int:
        """Assign a number to the next request, which cancels earlier ones."""
        self._newest_id += 1
        if self._shared_id is not None:
            self._shared_id.value = self._newest_id
        return self._newest_id

    def ask(
        self,
        request_id: int,
        work: Callable[..., Any],
        *arguments: Any,
        on_share: Callable[[float], object] | None = None,
        on_lost: Callable[[], object] | None = None,
    ) -> Any:
        """Run `work(*arguments, progress)` in the process and return its result; blocks, so call it in a thread.

        If the process ends meanwhile, another one without its memory is asked the same once.

        Parameters
        ----------
        request_id : from `next_id`
        work : importable function whose last parameter is a `Progress`; its exceptions are raised here
        on_share : called in this thread with the finished share of the work, 0 to 1
        on_lost : called in this thread if the process ended

        Raises
        ------
        ProcessLostError
            The replacement ended, too, or the service is closed.
        """
        with self._asking:
            for is_last in (False, True):
                try:
                    connection = self._connection or self._start()
                    connection.send((request_id, work, arguments))
                    while isinstance(answer := connection.recv(), float):
                        if on_share is not None:
                            on_share(answer)
                except (EOFError, OSError) as lost:
                    code = self._discard_dead()
                    if on_lost is not None:
                        on_lost()
                    if is_last or self._closed:
                        raise ProcessLostError(f"its process ended (code {code})") from lost
                    LOG.warning("a process ended (code %s) during a request; another one replaces it", code)
                    continue
                result, error = answer
                if error is not None:
                    raise error
                return result
        raise AssertionError

    def close(self) -> None:
        """Kill the process and start no other; a waiting `ask` raises `ProcessLostError`."""
        with self._starting:
            self._closed = True
            process = self._process
        if process is not None:
            process.kill()
            process.join(KILLED_PROCESS_WAIT_S)

    def _start(self) -> Connection[Any, Any]:
        # Imported late: the window starts without it.
        from multiprocessing import get_context

        context = get_context("spawn")
        protect_children()
        # Without a lock: only the window writes, and a late reader only works a little longer.
        self._shared_id = shared_id = context.RawValue("q", 0)
        shared_id.value = self._newest_id
        connection, its_end = context.Pipe()
        with self._starting:
            # The same lock as in `close`: no process starts after it.
            if self._closed:
                raise ProcessLostError("it is closed")
            self._process = process = context.Process(
                target=serve, args=(its_end, shared_id), name="skincal-heavy", daemon=True
            )
            process.start()
        # An open copy of the other end would hide the end of the process.
        its_end.close()
        self._connection = connection
        return connection

    def _discard_dead(self) -> int | None:
        """Forget an ended process and return its exit code."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()
        if self._process is None:
            return None
        self._process.join(KILLED_PROCESS_WAIT_S)
        return self._process.exitcode


class Progress:
    """Reports the progress of work in the process to the window.

    Parameters
    ----------
    newest : shared memory with the number of the newest request
    """

    def __init__(self, connection: Connection[Any, Any], request_id: int, newest: Any) -> None:
        self._connection, self._request_id, self._newest = connection, request_id, newest

    def is_wanted(self) -> bool:
        """Whether there is no newer request."""
        return self._newest.value == self._request_id

    def tell_share(self, share: float) -> bool:
        """Send the finished share, 0 to 1; return whether the rest is wanted: not if the window is gone."""
        try:
            self._connection.send(float(share))
        except OSError:
            return False
        return self.is_wanted()


def serve(connection: Connection[Any, Any], newest: Any) -> None:
    """Answer requests, in the process, until the window's end of the connection closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal is for the window, which ends this process
    if hasattr(os, "nice"):
        os.nice(WORKER_NICE_INCREMENT)
    while True:
        try:
            request_id, work, arguments = connection.recv()
        except (EOFError, OSError):
            return
        try:
            answer = work(*arguments, Progress(connection, request_id, newest)), None
        except Exception as error:  # noqa: BLE001 - raised again where the answer is awaited
            answer = None, error
        try:
            connection.send(answer)
        except OSError:
            return


class JobQueue:
    """Does jobs of some seconds one after another, each in a process of its own."""

    def __init__(self, owner: QObject) -> None:
        self._threads = ThreadService("jobs", owner)
        self.waiting: list[WorkerProcess] = []  # Processes of the unfinished jobs, the one in work first

    def submit(
        self,
        job: Callable[..., T],
        arguments: tuple[Any, ...],
        done: Callable[[T], None],
        failed: Callable[[str], None],
        on_share: Callable[[float], object] | None = None,
        undo: Callable[..., None] | None = None,
    ) -> None:
        """Do `job(*arguments, progress)` in a process; returns at once.

        Parameters
        ----------
        job : importable function whose last parameter is a `Progress`
        done, failed : get the result or a sentence, in the window's thread; not after `renew` or `drop`
        on_share : called with the finished share, 0 to 1, in another thread
        undo : removes traces of the job, in another thread if its process ended, in the window's with a result that is too late
        """
        # Numbered now, so that it can be interrupted before its process starts.
        process = WorkerProcess()
        self.waiting.append(process)
        ask = partial(process.ask, process.next_id(), job, *arguments, on_share=on_share, on_lost=undo)
        self._threads.submit(partial(self._do, process, ask), done, failed, undo)

    def interrupt(self) -> None:
        """Ask running jobs to stop."""
        for process in tuple(self.waiting):
            process.next_id()

    def drop(self) -> None:
        """Kill the jobs; no answer comes."""
        self.renew()
        for process in tuple(self.waiting):
            process.close()

    def renew(self) -> None:
        """Ignore the answers to earlier requests."""
        self._threads.renew()

    def close(self) -> None:
        """Kill the jobs and accept no others."""
        self.drop()
        self._threads.close()

    def _do(self, process: WorkerProcess, ask: Callable[[], Any]) -> Any:
        try:
            with raise_sentences("This failed"):
                return ask()
        finally:
            process.close()
            self.waiting.remove(process)


def report_job(session: Path, path: Path, method: Method, _progress: Progress) -> str:
    """Write a session's report and return its verdict."""
    from skincal.interface.session import Session

    return Session.load(session).report(path, method.value)


def positions_job(path: Path, link: str, channels: Collection[int], _progress: Progress) -> tuple[TaxelPositions, ...]:
    """Read the positions in a file or a session; see `places_for`."""
    from skincal.following.named_places import places_for

    return places_for(path, link, channels)


def preview_job(files: RecordingFiles, progress: Progress) -> RecordingPreview:
    """Preview a recording of another program."""
    from skincal.files.importers.preview import preview_recording

    return preview_recording(files, progress.is_wanted)


def import_job(request: ImportRequest, progress: Progress) -> Imported:
    """Make a session of a recording of another program."""
    from skincal.session.importing import import_recording

    return import_recording(request, progress.tell_share)


def review_job(request: ReviewRequest, progress: Progress) -> Review | None:
    """Review sensor and arm; `None` if a newer request stopped the work."""
    return review_packed(request, progress.is_wanted)


class ReviewClient(QObject):
    """Requests the reviews of a session."""

    reviewed = Signal(object)  # `Review` of the newest request, or of an earlier one that had taken long
    failed = Signal(str)  # A sentence; there are no reviews any more

    def __init__(self, session: Session, process: WorkerProcess, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._session = session
        self._process = process
        self._threads = ThreadService("review", self)
        self._newest: Snapshot | None = None
        self._requested: Snapshot | None = None  # Snapshot of the last request; `None` before the first landmark poke
        self._is_busy = self._must_repeat = False
        self._stopped = False

    def follow_session(self, snapshot: Snapshot) -> None:
        """Request a review if enough has changed since the last one."""
        before, self._newest = self._newest, snapshot
        if self._stopped or not (self._requested or snapshot.at_landmarks) or before is snapshot:
            return
        if self._requested is None or _is_due(self._requested, snapshot):
            self._request(snapshot)

    def stop(self) -> None:
        """Cancel the running review and request no other; returns at once."""
        self._stopped = True
        self._process.next_id()
        self._threads.close(0.0)

    def _request(self, snapshot: Snapshot) -> None:
        self._requested = snapshot
        request_id = self._process.next_id()
        self._must_repeat = self._is_busy
        if self._must_repeat:
            return  # the work in progress gives way, then the newest snapshot is sent
        self._is_busy = True
        request = ReviewRequest.from_session(self._session)
        self._threads.submit(partial(self._ask, request_id, request), self._take_review, self._fail)

    def _ask(self, request_id: int, request: ReviewRequest) -> Review | None:
        with raise_sentences("Sensor and arm are no longer checked", "Open the session again."):
            review: Review | None = self._process.ask(request_id, review_job, request.packed())
        # The window compares corrections by identity.
        return review and replace(review, used=request.used)

    def _take_review(self, review: Review | None) -> None:
        self._is_busy = False
        if review is not None:
            self.reviewed.emit(review)
        if self._must_repeat and self._newest is not None and not self._stopped:
            self._request(self._newest)

    def _fail(self, sentence: str) -> None:
        self._stopped = True
        self.failed.emit(sentence)


def _is_due(asked: Snapshot, now: Snapshot) -> bool:
    """Whether a review is due: after any change of landmark pokes, corrections or exclusions, else every 10 pokes."""

    def facts(snapshot: Snapshot) -> tuple[object, ...]:
        return snapshot.at_landmarks, snapshot.decisions.landmarks, snapshot.decisions.corrections, snapshot.dead

    def has_changed(before: PokeRecord, after: PokeRecord) -> bool:
        has_final_tare = before.outcome is not after.outcome and after.outcome.poke in now.at_landmarks
        return before.excluded != after.excluded or has_final_tare

    if facts(asked) != facts(now) or len(now.pokes) >= len(asked.pokes) + SKIN_POKES_PER_RIG_REVIEW:
        return True
    return any(map(has_changed, asked.pokes, now.pokes))
