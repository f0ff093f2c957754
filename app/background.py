"""Slow work beside the window: one thread, one piece of work after another, results handed over in the tick.

Nothing of Qt is touched in the thread. An exception in it arrives as a result like any other.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

STOP_S = 2.0
"""Closing waits this long for work that is under way; it is a daemon and dies with the process."""


@dataclass(frozen=True, slots=True)
class _Job:
    work: Callable[[], Any]
    done: Callable[[Any], None]
    failed: Callable[[BaseException], None]


class Background:
    """Run work in a thread and call back from `deliver`."""

    def __init__(self) -> None:
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._closed = False

    def run(self, work: Callable[[], Any], done: Callable[[Any], None], failed: Callable[[BaseException], None]) -> None:
        """Do `work` in the thread; `deliver` then calls `done` with its result, or `failed` with its exception."""
        if self._closed:
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._loop, name="skincal-background", daemon=True)
            self._thread.start()
        self._jobs.put(_Job(work, done, failed))

    def deliver(self) -> bool:
        """Call back for every piece of work that ended; return whether there was one."""
        delivered = False
        while not self._results.empty():
            self._results.get()()
            delivered = True
        return delivered

    def close(self) -> None:
        """End the thread; results that were not delivered are dropped."""
        self._closed = True
        if self._thread is not None:
            self._jobs.put(None)
            self._thread.join(STOP_S)
            self._thread = None

    def _loop(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                result = job.work()
            except BaseException as error:  # noqa: BLE001
                self._results.put(lambda job=job, error=error: job.failed(error))
            else:
                self._results.put(lambda job=job, result=result: job.done(result))
