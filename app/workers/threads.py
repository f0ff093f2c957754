"""Threads for slow work; answers come back in the window's thread.

Each owner of slow work has a service with one thread at most, which does its requests in order. The work must not use Qt.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

from PySide6.QtCore import QObject, Qt, Signal

from skincal.model.errors import InputError

LOG = logging.getLogger(__name__)
THREAD_STOP_TIMEOUT_S = 2.0
"""Closing waits this long for requested work; the thread is a daemon and ends with the program."""
T = TypeVar("T")


@contextmanager
def raise_sentences(failure: str, advice: str = "Try again.") -> Iterator[None]:
    """Raise every exception as an `InputError` that begins with `failure`; log those that are not one already."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        LOG.exception("work in the background failed")
        raise InputError(f"{failure} ({error!r}). {advice} Details are in the log.") from error


@dataclass(frozen=True, slots=True)
class ThreadRequest:
    """Work, and the receivers of its answer."""

    generation: int
    work: Callable[[], Any]
    done: Callable[[Any], None]
    failed: Callable[[str], None] | None
    dropped: Callable[[Any], None] | None
    ended: Callable[[], None] | None


class ThreadService:
    """Does requests in order in a thread, which exists while there is work. Made and used in the window's thread.

    Parameters
    ----------
    name : of the thread
    owner : its end closes the service, and no receiver is called after it
    """

    def __init__(self, name: str, owner: QObject) -> None:
        owner.destroyed.connect(lambda: self.close(0.0))
        self._name = name
        self._generation = 0
        self._closed = False
        self._bridge = _bridge()
        self._lock = threading.Lock()  # Held while the thread gets its next request or ends
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
        """Do `work` in the thread, and call one receiver in the window's thread; no effect after `close`.

        Parameters
        ----------
        work : must not share changing data with the window
        done : gets the result
        failed : gets the sentence of an `InputError`. Any other exception, or without `failed` every one, is raised in the
            window's thread, which shows it to the operator
        dropped : gets a result that comes after `renew` or `close`, to release it
        ended : called last in every case
        """
        if self._closed:
            return
        with self._lock:
            self._requests.append(ThreadRequest(self._generation, work, done, failed, dropped, ended))
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=f"skincal-{self._name}", daemon=True)
                self._thread.start()

    def renew(self) -> None:
        """Ignore the answers to earlier requests."""
        self._generation += 1

    def wait(self) -> None:
        """Wait without limit for all requested work; from any thread."""
        # Read once: the thread clears it at its end.
        thread = self._thread
        if thread is not None:
            thread.join()

    def close(self, limit_s: float = THREAD_STOP_TIMEOUT_S) -> None:
        """Accept no more, wait for requested work up to a limit, and ignore its answers."""
        self._closed = True
        self.renew()
        thread = self._thread
        if thread is not None:
            thread.join(limit_s)
        self.deliver()

    def deliver(self) -> None:
        """Call the receivers of waiting answers; if one raises, the others follow."""
        while not self._answers.empty():
            request, result, error = self._answers.get()
            try:
                self._answer(request, result, error)
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
            except BaseException as raised:  # noqa: BLE001 - raised again in the window's thread
                error = raised
            self._answers.put((request, result, error))
            self._bridge.answered.emit(self)

    def _answer(self, request: ThreadRequest, result: Any, error: BaseException | None) -> None:
        is_late = request.generation != self._generation
        try:
            if error is None:
                take = request.dropped if is_late else request.done
                if take is not None:
                    take(result)
            elif self._closed and not isinstance(error, InputError):
                LOG.error("work in the background failed while the window closed", exc_info=error)
            elif not isinstance(error, InputError) or (request.failed is None and not is_late):
                raise error
            elif request.failed is not None and not is_late:
                request.failed(str(error))
        finally:
            if request.ended is not None:
                request.ended()


class _Bridge(QObject):
    """Receiver of the threads' answers in the window's thread; never deleted, so that signals stay valid."""

    answered = Signal(object)  # `ThreadService` with an answer

    def __init__(self) -> None:
        super().__init__()
        self.answered.connect(self._deliver, Qt.ConnectionType.QueuedConnection)

    def _deliver(self, service: ThreadService) -> None:
        service.deliver()


@cache
def _bridge() -> _Bridge:
    return _Bridge()
