"""Processes for work that would hold the window even from a thread: the review of landmark pokes, and single jobs.

The fit of a rig's errors keeps Python's lock for some tenths of a second. The process starts with the first poke at a landmark
and ends with the window. It does one review at a time, which gives way to a newer request. The process imports this module.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from PySide6.QtCore import QObject, Signal

from app.workers.threads import ThreadService
from skincal.model.errors import InputError
from skincal.session.review import Review, ReviewRequest, SentReview, review_sent
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
LOG = logging.getLogger(__name__)
NICE = 5
"""The process stands back behind the window, which waits for a hand."""
STOP_S = 0.7
"""s. Closing waits this long for the end of a process that was killed. It keeps nothing that could be lost."""


class ProcessLostError(Exception):
    """The process ended while it was asked, and so did the one in its place; or it was closed."""


class ProcessService:
    """One process, asked from any thread; a pool of one, since the window's machine has little to spare.

    Not `concurrent.futures`: where a worker of its pool is killed while a request is on its way, closing the pool hangs for
    ever with Python 3.11.2 (docs/decisions/work-beside-the-window.md).
    """

    def __init__(self) -> None:
        self._asking = threading.Lock()
        """Held while the process is asked: one thing at a time."""
        self._starting = threading.Lock()
        self._process: BaseProcess | None = None
        self._connection: Connection[Any, Any] | None = None
        self._ticket = 0
        self._newest: Any = None
        """The newest ticket in shared memory, once there is a process."""
        self._closed = False

    @property
    def pid(self) -> int | None:
        """Of the process; None while none was started."""
        return None if self._process is None else self._process.pid

    def ticket(self) -> int:
        """Return a number for the next request; work on requests with earlier ones is no longer wanted."""
        self._ticket += 1
        if self._newest is not None:
            self._newest.value = self._ticket
        return self._ticket

    def ask(self, ticket: int, work: Callable[..., Any], *arguments: Any, watch: Watch | None = None) -> Any:
        """Return what `work(*arguments, wanted)` returns in the process; blocks, so call it in a thread.

        Where the process ends meanwhile another takes its place, and is asked the same once. It knows nothing of what the first
        was asked before.

        Parameters
        ----------
        ticket : from `ticket`; `wanted` is a function that returns whether it is the newest
        work : a function of a module, which the process imports; raises whatever it raises there
        watch : hears of the work, in this thread

        Raises
        ------
        ProcessLostError
            The second process ended, too, or the service is closed.
        """
        with self._asking:
            for last in (False, True):
                try:
                    connection = self._connection or self._start()
                    connection.send((ticket, work, arguments))
                    result, error = _answer(connection, watch)
                except (EOFError, OSError) as lost:
                    code = self._bury()
                    if watch is not None:
                        watch.lost()
                    if last or self._closed:
                        raise ProcessLostError(f"its process ended (code {code})") from lost
                    LOG.warning("a process ended (code %s) while it was asked; another takes its place", code)
                    continue
                if error is not None:
                    raise error
                return result
        raise AssertionError

    def close(self) -> None:
        """End the process, by force, and start none any more; who waits for an answer gets a ProcessLostError."""
        with self._starting:
            self._closed = True
            process = self._process
        if process is not None:
            process.kill()
            process.join(STOP_S)

    def _start(self) -> Connection[Any, Any]:
        """Start the process; `multiprocessing` is imported only now, in the asking thread."""
        from multiprocessing import get_context

        context = get_context("spawn")
        # Nothing that lies in the working folder is run.
        os.environ["PYTHONSAFEPATH"] = "1"
        # Without a lock: the window alone writes it, and who reads it late only goes on for a little longer.
        self._newest = newest = context.RawValue("q", 0)
        newest.value = self._ticket
        connection, its_end = context.Pipe()
        with self._starting:
            # Under the same lock as in `close`, so that no process starts behind it.
            if self._closed:
                raise ProcessLostError("it is closed")
            self._process = process = context.Process(target=serve, args=(its_end, newest), name="skincal-heavy", daemon=True)
            process.start()
        # A copy of the other end that stays open here would hide that the process went.
        its_end.close()
        self._connection = connection
        return connection

    def _bury(self) -> int | None:
        """Forget a process that ended; return its exit code."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()
        process = self._process
        if process is None:
            return None
        process.join(STOP_S)
        return process.exitcode


@dataclass(frozen=True, slots=True)
class Watch:
    """Hears of work in a process, in the thread that waits for it."""

    told: Callable[[float], object] = lambda _: None
    """Gets what share of it is done."""
    lost: Callable[[], object] = lambda: None
    """Called where the process ended in the middle of it."""


@dataclass(frozen=True, slots=True)
class Share:
    """What share of the work is done; on its way from the process."""

    value: float


class Wanted:
    """Given to work in the process: whether it is still wanted, and a way to say how far it is.

    Parameters
    ----------
    newest : shared memory whose `value` is the newest ticket
    """

    def __init__(self, connection: Connection[Any, Any], ticket: int, newest: Any) -> None:
        self._connection, self._ticket, self._newest = connection, ticket, newest

    def __call__(self) -> bool:
        """Return whether it is still wanted."""
        return self._newest.value == self._ticket

    def tell(self, share: float) -> bool:
        """Say what share of the work is done; return whether the rest is still wanted: it is not where the window is gone."""
        try:
            self._connection.send(Share(share))
        except OSError:
            return False
        return self()


def _answer(connection: Connection[Any, Any], watch: Watch | None) -> tuple[Any, Exception | None]:
    """Return the answer that comes, and have shares of the work heard until then."""
    while isinstance(answer := connection.recv(), Share):
        if watch is not None:
            watch.told(answer.value)
    return answer


def serve(connection: Connection[Any, Any], newest: Any) -> None:
    """Do what comes, in the process, until the window's end of the connection is closed, however the window ended.

    Parameters
    ----------
    newest : shared memory whose `value` is the newest ticket
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal is for the window, which closes this
    if hasattr(os, "nice"):
        os.nice(NICE)
    while True:
        try:
            ticket, work, arguments = connection.recv()
        except (EOFError, OSError):
            return
        try:
            answer = work(*arguments, Wanted(connection, ticket, newest)), None
        except Exception as error:  # noqa: BLE001 - it is raised where the answer is waited for
            answer = None, error
        try:
            connection.send(answer)
        except OSError:
            return


class JobService:
    """Does single jobs that take seconds, one after another, each in a process of its own that ends with it.

    Apart from the one that reviews the rig: that one has memory of its session, and its work gives way to newer requests.
    """

    def __init__(self, owner: QObject) -> None:
        self._threads = ThreadService("jobs", owner)
        self._waiting: list[ProcessService] = []
        """Of each job that is not done yet, the first in work."""

    def submit(
        self,
        job: Callable[..., T],
        arguments: tuple[Any, ...],
        done: Callable[[T], None],
        failed: Callable[[str], None],
        watch: Watch | None = None,
        dropped: Callable[[T], None] | None = None,
    ) -> None:
        """Do `job(*arguments)` in a process; returns at once.

        Parameters
        ----------
        job : a function of a module, which the process imports
        done : gets its answer, in the window's thread; nothing where something else was opened meanwhile (`renew`)
        failed : gets why there is none, in a sentence
        watch : hears of the job in its thread; the job then gets a `Wanted` as its last argument
        dropped : gets, in place of `done`, an answer that comes after `renew` or `drop`
        """
        # With its ticket, so that it can be interrupted before its process is there.
        process = ProcessService()
        self._waiting.append(process)
        asked = (do_job, job, arguments) if watch is None else (job, *arguments)
        work = partial(process.ask, process.ticket(), *asked, watch=watch)
        self._threads.submit(partial(self._do, process, work), done, failed, dropped)

    def interrupt(self) -> None:
        """Let what is done know that it is not wanted any more; it ends in its own way, and says so."""
        for process in tuple(self._waiting):
            process.ticket()

    def drop(self) -> None:
        """End what is done, by force; no answer comes."""
        self.renew()
        for process in tuple(self._waiting):
            process.close()

    def renew(self) -> None:
        """Begin anew: answers to what was asked before come too late, though what it writes is written."""
        self._threads.renew()

    def close(self) -> None:
        """End what is done, by force, and do nothing any more."""
        self.drop()
        self._threads.close()

    def _do(self, process: ProcessService, ask: Callable[[], Any]) -> Any:
        """Do a job; in a thread. InputError where it cannot be done, whatever the reason is."""
        try:
            return ask()
        except InputError:
            raise
        except ProcessLostError as lost:
            raise InputError(f"It is not done: {lost}. Try again.") from lost
        except Exception as error:
            LOG.exception("a job beside the window failed")
            raise InputError(f"It is not done: {error!r}; details are in the log.") from error
        finally:
            process.close()
            self._waiting.remove(process)


def do_job(job: Callable[..., T], arguments: tuple[Any, ...], _wanted: Callable[[], bool]) -> T:
    """Do a job, in the process."""
    return job(*arguments)


def report_job(session: Path, path: Path, method: Method) -> str:
    """Write a session's report, and return its verdict; in the process, which alone imports what that needs."""
    from skincal.reporting.page import write_report

    return write_report(session, path, method)


def places_job(path: Path, link: str, channels: Collection[int]) -> tuple[TaxelPositions, ...]:
    """Return the places in a file or a session; see `places_for`."""
    from skincal.session.named_places import places_for

    return places_for(path, link, channels)


def look_job(files: RecordingFiles, wanted: Wanted) -> RecordingPreview:
    """Look at a recording of another program."""
    from skincal.files.importers.preview import preview_recording

    return preview_recording(files, wanted)


def import_job(request: ImportRequest, wanted: Wanted) -> Imported:
    """Make a session of a recording of another program."""
    from skincal.session.importing import import_recording

    return import_recording(request, wanted.tell)


SKIN = 10
"""Pokes on the skin after which the rig is reviewed anew: a single poke moves what is found by less than is shown."""


def _rig_facts(snapshot: Snapshot) -> tuple[object, ...]:
    """Everything that a review depends on besides the pokes."""
    return snapshot.at_landmarks, snapshot.decisions.landmarks, snapshot.decisions.corrections, snapshot.dead


class ReviewClient(QObject):
    """Asks for the reviews of a session.

    Parameters
    ----------
    processes : where the work is done
    """

    reviewed = Signal(object)
    """`Review` of the newest request, or of an earlier one that had taken long."""
    failed = Signal(str)
    """A sentence; nothing is reviewed any more."""

    def __init__(self, session: Session, processes: ProcessService, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._session = session
        self._processes = processes
        self._threads = ThreadService("review", self)
        self._seen: Snapshot | None = None
        self._shown: Snapshot | None = None
        """The snapshot whose review was asked for last; None before the first poke at a landmark."""
        self._waits = self._again = False
        self._stopped = False

    def follow(self, snapshot: Snapshot) -> None:
        """Ask for a review of the session where its newest snapshot has enough that is new since the last."""
        seen, self._seen = self._seen, snapshot
        if self._stopped or not (self._shown or snapshot.at_landmarks) or seen is snapshot:
            return
        if self._shown is None or _due(self._shown, snapshot):
            self._ask(snapshot)

    def stop(self) -> None:
        """Ask no more, and hear no answer; what the process works on is given up. Returns at once."""
        self._stopped = True
        self._processes.ticket()
        self._threads.close(0.0)

    def _ask(self, snapshot: Snapshot) -> None:
        self._shown = snapshot
        ticket = self._processes.ticket()
        self._again = self._waits
        if self._again:
            return  # what is worked on gives way; then the newest is asked about
        self._waits = True
        request = ReviewRequest.of(self._session)
        self._threads.submit(partial(_review, self._processes, ticket, request), self._take, self._fail)

    def _take(self, review: Review | None) -> None:
        self._waits = False
        if review is not None:
            self.reviewed.emit(review)
        if self._again and self._seen is not None and not self._stopped:
            self._ask(self._seen)

    def _fail(self, sentence: str) -> None:
        self._stopped = True
        self.failed.emit(sentence)


def _review(processes: ProcessService, ticket: int, request: ReviewRequest) -> Review | None:
    """Have a session reviewed in the process; in a thread. `None` if the work gave way to a newer request.

    Raises
    ------
    InputError
        There will be no reviews, whatever the reason is.
    """
    try:
        review: Review | None = processes.ask(ticket, review_sent, SentReview.of(request))
    except InputError:
        raise
    except ProcessLostError as lost:
        raise InputError(f"The rig is not reviewed any more: {lost}, twice. Open the session again.") from lost
    except Exception as error:
        LOG.exception("a review of the rig failed")
        raise InputError(f"The rig is not reviewed any more: {error!r}; details are in the log.") from error
    # The window compares corrections by identity.
    return review and replace(review, used=request.used)


def _due(asked: Snapshot, now: Snapshot) -> bool:
    """Return whether a session is to be reviewed anew: at once where landmark pokes, corrections or taken out pokes changed."""
    if _rig_facts(asked) != _rig_facts(now) or len(now.pokes) >= len(asked.pokes) + SKIN:
        return True
    return any(_changed(before, after, now) for before, after in zip(asked.pokes, now.pokes, strict=False))


def _changed(before: PokeRecord, now: PokeRecord, snapshot: Snapshot) -> bool:
    """Return whether a poke counts that did not, or no more, or is a landmark poke whose outcome came again."""
    came_again = before.outcome is not now.outcome and now.outcome.poke in snapshot.at_landmarks
    return before.excluded != now.excluded or came_again
