"""An event that a signal's handler may set."""

from __future__ import annotations

import contextlib
import queue
import threading


class StopEvent(threading.Event):
    """Event whose `set` may interrupt `wait` in the same thread.

    The handler of a signal runs between two steps of the main thread. `threading.Event.set` takes a lock that an interrupted
    `wait` may hold, and would never return. `SimpleQueue.put` is reentrant (documentation of `queue`).
    """

    def __init__(self) -> None:
        super().__init__()
        self._is_set = False
        self._wake = queue.SimpleQueue[None]()

    def is_set(self) -> bool:
        return self._is_set

    def set(self) -> None:
        self._is_set = True
        self._wake.put(None)

    def wait(self, timeout: float | None = None) -> bool:
        if not self._is_set:
            with contextlib.suppress(queue.Empty):
                self._wake.get(timeout=timeout)
                self._wake.put(None)  # for others who wait
        return self._is_set
