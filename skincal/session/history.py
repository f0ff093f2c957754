"""What undo would take back: one entry for every accepted poke and every action, the newest last, without limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Step:
    """One thing that can be taken back."""

    words: str
    """What it was, for the operator."""
    poke: int | None
    """Number of the poke that this step accepted; None for an action."""
    take_back: Callable[[], None]


class History:
    """The steps of a session. What was taken back leaves the list and is not taken back again."""

    def __init__(self) -> None:
        self._steps: list[Step] = []

    def add(self, step: Step) -> None:
        """Add the newest step."""
        self._steps.append(step)

    def forget_poke(self, poke: int) -> None:
        """Drop the step of a poke that no longer counts."""
        self._steps = [step for step in self._steps if step.poke != poke]

    def last(self, skip: Callable[[int], bool]) -> Step | None:
        """Return the newest step, past pokes that `skip` names."""
        for step in reversed(self._steps):
            if step.poke is None or not skip(step.poke):
                return step
        return None

    def drop(self, step: Step) -> None:
        """Drop a step, and what was skipped above it."""
        while self._steps and self._steps.pop() is not step:
            pass
