"""How work is timed."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest


@pytest.fixture
def least_time() -> Callable[..., float]:
    """Give a function that measures the least processor time of several runs of some work, seconds.

    What others do on the machine only ever adds to it, and threads of the linear algebra that wait for a core count, too. It
    is measured until it is below a bar: a quiet moment is waited for, the bar stays as it is.
    """

    def measure(work: Callable[[], object], below: float, tries: int = 30) -> float:
        best = float("inf")
        for _ in range(tries):
            begin = time.process_time()
            work()
            best = min(best, time.process_time() - begin)
            if best < below:
                break
            time.sleep(0.1)
        return best

    return measure
