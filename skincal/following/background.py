"""Slow work beside an open session: one job at a time for each owner."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

Result = TypeVar("Result")


class Run(Protocol):
    """Does work beside the session and reports its failure."""

    def __call__(self, work: Callable[[], Result], done: Callable[[Result], None], /, *, ended: Callable[[], None]) -> object:
        """Do `work`, hand its result to `done` unless it failed, and call `ended` in both cases."""
        ...


def run_at_once(work: Callable[[], Result], done: Callable[[Result], None], /, *, ended: Callable[[], None]) -> None:
    """Do the work now; raise its failure."""
    try:
        done(work())
    finally:
        ended()


class BackgroundJob:
    """The job of one owner; after a failure the next one can begin."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self.is_busy = False
        """Whether a job is at work: its owner begins no other."""

    def start(self, work: Callable[[], Result], done: Callable[[Result], None]) -> None:
        """Begin a job; `done` gets its result."""
        self.is_busy = True
        self._run(work, done, ended=self._end)

    def _end(self) -> None:
        self.is_busy = False
