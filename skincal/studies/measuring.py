"""How the studies measure: bars, work side by side, and how long something takes.

Times are the CPU time of the thread that works, the garbage collector at rest: on an idle machine that is the time that passes,
and on a busy one it is what would. Where the system's clock of a thread is too coarse (Windows: 16 ms) it is the time that
passes.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import numpy as np


def bars_of(numbers: Mapping[str, tuple[float, str, float]]) -> dict[str, dict[str, Any]]:
    """Return each bar of a study: its value (None: not reached), on which side of its limit it must be, and whether it is.

    Parameters
    ----------
    numbers : name to value, ">=" or "<=", and limit
    """
    return {
        name: {
            "value": float(value) if np.isfinite(value) else None, "sign": sign, "limit": limit,
            "holds": bool(value >= limit if sign == ">=" else value <= limit),
        }
        for name, (value, sign, limit) in numbers.items()
    }  # fmt: skip


def bar_lines(bars: Mapping[str, Mapping[str, Any]], digits: int = 3) -> list[str]:
    """Return each bar in words."""
    lines: list[str] = []
    for name, bar in bars.items():
        value = "not reached" if bar["value"] is None else f"{bar['value']:.{digits}g}"
        lines.append(f"{name}: {value}, bar {bar['sign']} {bar['limit']:g}: {'holds' if bar['holds'] else 'DOES NOT HOLD'}")
    return lines


def processes() -> ProcessPoolExecutor:
    """Return as many processes as the machine has cores; what they compute does not depend on how many."""
    return ProcessPoolExecutor(os.cpu_count() or 1, mp_context=multiprocessing.get_context("spawn"))


# ---- times ----

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
class Quartiles:
    """A median and its quartiles."""

    median: float
    q1: float
    q3: float
    count: int
    """How many numbers it is of."""

    @classmethod
    def of(cls, numbers: Sequence[float]) -> Quartiles:
        """Return the spread of at least one number."""
        low, middle, high = np.percentile(np.asarray(numbers, dtype=float), [25, 50, 75])
        return cls(float(middle), float(low), float(high), len(numbers))

    def times(self, factor: float) -> Quartiles:
        """Return the spread of the numbers times `factor`."""
        return Quartiles(self.median * factor, self.q1 * factor, self.q3 * factor, self.count)

    def plus(self, number: float) -> Quartiles:
        """Return the spread of the numbers plus `number`."""
        return Quartiles(self.median + number, self.q1 + number, self.q3 + number, self.count)

    def json(self) -> dict[str, Any]:
        """Return what JSON can hold."""
        return asdict(self)


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


def time_words(ms: float) -> str:
    """Return a time with three digits in the unit that suits it."""
    for unit, size in (("h", 3.6e6), ("min", 6e4), ("s", 1e3)):
        if ms >= 2 * size or (unit == "s" and ms >= size):
            return f"{ms / size:.3g} {unit}"
    return f"{ms:.3g} ms"
