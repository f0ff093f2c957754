"""Slow work beside the window: a thread that is there while there is work, and answers that come back in the window's thread.

Each owner of slow work has a service of its own: its requests are done one after another, those of several services side by
side. The work may touch nothing of Qt.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

from PySide6.QtCore import QObject, Qt, Signal

from skincal.model.errors import InputError

LOG = logging.getLogger(__name__)
STOP_S = 2.0
"""s. Closing waits this long for work that was asked for; the thread is a daemon and dies with the program."""
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ThreadRequest:
    """What is to be done, and who gets the answer."""

    generation: int
    work: Callable[[], Any]
    done: Callable[[Any], None]
    failed: Callable[[str], None] | None
    dropped: Callable[[Any], None] | None
    ended: Callable[[], None] | None


class ThreadService:
    """Does one piece of work after another beside the window. Made and used in the window's thread.

    Parameters
    ----------
    name : of the thread
    owner : with its end this is closed, and nothing is called any more
    """

    def __init__(self, name: str, owner: QObject) -> None:
        owner.destroyed.connect(lambda: self.close(0.0))
        self._name = name
        self._generation = 0
        self._closed = False
        self._bridge = _bridge()
        self._lock = threading.Lock()
        """Held while the next request is looked for: the thread ends only where there is none."""
        self._requests: deque[ThreadRequest] = deque()
        self._thread: threading.Thread | None = None
        self._answers: queue.SimpleQueue[tuple[ThreadRequest, Any, BaseException | None]] = queue.SimpleQueue()

    def submit(
        self,
        work: Callable[[], T],
        done: Callable[[T], None],
        failed: Callable[[str], None] | None = None,
        dropped: Callable[[T], None] | None = None,
        ended: Callable[[], None] | None = None,
    ) -> None:
        """Do `work` in the thread, and give its answer to one of the others in the window's thread. Nothing once it is closed.

        Parameters
        ----------
        work : shares nothing with the window that changes meanwhile
        done : gets what `work` returns
        failed : gets the sentence of an InputError. Without it, and for every other exception, the exception is raised in the
            window's thread, where it reaches the operator
        dropped : gets, in place of `done`, what `work` returns after `renew` or `close`: something to be given back
        ended : called last in every case: after an answer, a failure, and an answer that comes too late
        """
        if self._closed:
            return
        with self._lock:
            self._requests.append(ThreadRequest(self._generation, work, done, failed, dropped, ended))
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=f"skincal-{self._name}", daemon=True)
                self._thread.start()

    def renew(self) -> None:
        """Begin a new generation: answers to what was asked before come too late."""
        self._generation += 1

    def wait(self) -> None:
        """Wait until all that was asked for is done, however long that takes; from any thread."""
        # Taken once: the thread forgets itself as it ends.
        thread = self._thread
        if thread is not None:
            thread.join()

    def close(self, limit_s: float = STOP_S) -> None:
        """Take no more, and wait so long for what was asked; all its answers come too late."""
        self._closed = True
        self.renew()
        thread = self._thread
        if thread is not None:
            thread.join(limit_s)
        self.deliver()

    def deliver(self) -> None:
        """Hand over the answers that wait; the bridge calls it. Where one raises, the rest is handed over all the same."""
        while not self._answers.empty():
            request, result, error = self._answers.get()
            try:
                self._hand_over(request, result, error)
            except BaseException:
                self._bridge.answered.emit(self)
                raise

    def _run(self) -> None:
        while True:
            with self._lock:
                if not self._requests:
                    self._thread = None
                    return
                request = self._requests.popleft()
            result, error = None, None
            try:
                result = request.work()
            except BaseException as raised:  # noqa: BLE001 - it is raised in the window's thread
                error = raised
            self._answers.put((request, result, error))
            self._bridge.answered.emit(self)

    def _hand_over(self, request: ThreadRequest, result: Any, error: BaseException | None) -> None:
        try:
            self._answer(request, result, error)
        finally:
            if request.ended is not None:
                request.ended()

    def _answer(self, request: ThreadRequest, result: Any, error: BaseException | None) -> None:
        late = request.generation != self._generation
        if error is None:
            take = request.dropped if late else request.done
            if take is not None:
                take(result)
        elif late and isinstance(error, InputError):
            return
        elif self._closed:
            LOG.error("work beside the window failed while the window closed", exc_info=error)
        elif request.failed is not None and isinstance(error, InputError):
            request.failed(str(error))
        else:
            raise error


class _Bridge(QObject):
    """Lives in the window's thread, as long as the program: a signal from a thread never meets an object that is gone."""

    answered = Signal(object)
    """`ThreadService` with an answer."""

    def __init__(self) -> None:
        super().__init__()
        self.answered.connect(self._deliver, Qt.ConnectionType.QueuedConnection)

    def _deliver(self, service: ThreadService) -> None:
        service.deliver()


@cache
def _bridge() -> _Bridge:
    return _Bridge()
