"""How long something takes, with its spread: the CPU time of the thread that does it, the garbage collector at rest.

On an idle machine that is the time that passes, and on a busy one it is what would. Everything that is measured runs in
one thread. Where the system's clock of a thread is too coarse (Windows: 16 ms) it is the time that passes.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

Result = TypeVar("Result")

FINE_S = 1e-6
"""s. A clock that steps by more cannot tell the pieces that are measured."""
CPU_TIME = time.get_clock_info("thread_time").resolution <= FINE_S
clock: Callable[[], float] = time.thread_time if CPU_TIME else time.perf_counter
CLOCK = (
    "time.thread_time, the CPU time of one thread" if CPU_TIME else "time.perf_counter"
) + "; no garbage is collected within"
"""The clock in words."""


@dataclass(frozen=True, slots=True)
class Spread:
    """A median and its quartiles."""

    median: float
    q1: float
    q3: float
    count: int
    """How many numbers it is of."""

    @classmethod
    def of(cls, numbers: Sequence[float]) -> Spread:
        """Return the spread of at least one number."""
        low, middle, high = np.percentile(np.asarray(numbers, dtype=float), [25, 50, 75])
        return cls(float(middle), float(low), float(high), len(numbers))

    def times(self, factor: float) -> Spread:
        """Return the spread of the numbers times `factor`."""
        return Spread(self.median * factor, self.q1 * factor, self.q3 * factor, self.count)

    def plus(self, number: float) -> Spread:
        """Return the spread of the numbers plus `number`."""
        return Spread(self.median + number, self.q1 + number, self.q3 + number, self.count)

    def json(self) -> dict[str, Any]:
        """Return what JSON can hold."""
        return {"median": self.median, "q1": self.q1, "q3": self.q3, "count": self.count}


@contextmanager
def at_rest() -> Generator[None]:
    """Collect no garbage within."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def timed(work: Callable[[], Result], repeats: int) -> tuple[list[float], Result]:
    """Return the seconds of each of `repeats` runs, at least one, and what the last one gave."""
    seconds: list[float] = []
    with at_rest():
        while True:
            start = clock()
            result = work()
            seconds.append(clock() - start)
            if len(seconds) >= repeats:
                return seconds, result


def sampled(works: Iterable[Callable[[], object]], budget_s: float) -> list[float]:
    """Run one piece of work after another until `budget_s` has passed, or all are done; return the seconds of each."""
    seconds: list[float] = []
    end = time.perf_counter() + budget_s
    with at_rest():
        for work in works:
            if seconds and time.perf_counter() >= end:
                break
            start = clock()
            work()
            seconds.append(clock() - start)
    return seconds
