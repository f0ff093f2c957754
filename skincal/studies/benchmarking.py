"""Timers of the studies.

Times are the CPU time of the whole process, all its threads together, with the garbage collector off. Other programs on a busy
machine do not count. Work that two threads share counts in full, so that it compares with work of one thread. Where the
system's clock of a process is too coarse (Windows: 16 ms), wall time is used.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.session.session import Session

Result = TypeVar("Result")

MAX_CLOCK_RESOLUTION_S = 1e-6
"""s. A coarser clock cannot time the pieces that are measured."""
CPU_TIME = time.get_clock_info("process_time").resolution <= MAX_CLOCK_RESOLUTION_S
clock: Callable[[], float] = time.process_time if CPU_TIME else time.perf_counter
CLOCK_NAME = ("time.process_time, the CPU time of all threads" if CPU_TIME else "time.perf_counter") + "; garbage collector off"


def quartiles(numbers: Sequence[float]) -> dict[str, Any]:
    """Summarise at least one number: median, quartiles, count."""
    low, middle, high = np.percentile(np.asarray(numbers, dtype=float), [25, 50, 75]).tolist()
    return {"median": middle, "q1": low, "q3": high, "count": len(numbers)}


@contextmanager
def gc_disabled() -> Generator[None]:
    """Switch the garbage collector off."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def timed(works: Iterable[Callable[[], Result]], budget_s: float = float("inf")) -> tuple[list[float], list[Result]]:
    """Time pieces of work in turn, at least one, until `budget_s` of wall time is used; returns seconds and results."""
    seconds: list[float] = []
    results: list[Result] = []
    end = time.perf_counter() + budget_s
    with gc_disabled():
        for work in works:
            if seconds and time.perf_counter() >= end:
                break
            start = clock()
            results.append(work())
            seconds.append(clock() - start)
    return seconds, results


def time_session_pokes(session: Session, contacts: Iterable[Contact]) -> list[float]:
    """Time each contact: added to the session, solved, in a snapshot."""

    def poke(contact: Contact) -> None:
        session.add(contact)
        session.snapshot()

    return timed([partial(poke, contact) for contact in contacts])[0]


def time_words(ms: float) -> str:
    """Write a time with three digits and its unit."""
    for unit, size in (("h", 3.6e6), ("min", 6e4), ("s", 1e3)):
        if ms >= 2 * size or (unit == "s" and ms >= size):
            return f"{ms / size:.3g} {unit}"
    return f"{ms:.3g} ms"
