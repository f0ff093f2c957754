"""What undo would take back: one entry for every accepted poke and every action, the newest last, without limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Step:
    """An action that can be taken back."""

    words: str
    """What it was, for the operator."""
    take_back: Callable[[], None]


@dataclass(frozen=True, slots=True)
class PokeStep:
    """A poke that was accepted; it is taken back by its exclusion."""

    poke: int

    @property
    def words(self) -> str:
        """What it was, for the operator."""
        return f"poke {self.poke}"


class History:
    """The steps of a session. What was taken back leaves the list and is not taken back again."""

    def __init__(self) -> None:
        # A poke is its number alone: there are thousands.
        self._steps: list[Step | int] = []

    def add(self, step: Step) -> None:
        """Add the newest action."""
        self._steps.append(step)

    def add_poke(self, poke: int) -> None:
        """Add the newest accepted poke."""
        self._steps.append(poke)

    def forget_poke(self, poke: int) -> None:
        """Drop the step of a poke that no longer counts."""
        for place in range(len(self._steps) - 1, -1, -1):
            if self._steps[place] == poke:
                del self._steps[place]

    def last(self, skip: Callable[[int], bool]) -> Step | PokeStep | None:
        """Return the newest step, past pokes that `skip` names."""
        for step in reversed(self._steps):
            if isinstance(step, Step):
                return step
            if not skip(step):
                return PokeStep(step)
        return None

    def drop_last(self, skip: Callable[[int], bool]) -> Step | PokeStep | None:
        """Return the newest step past pokes that `skip` names, and drop it with what was skipped."""
        while self._steps:
            step = self._steps.pop()
            if isinstance(step, Step):
                return step
            if not skip(step):
                return PokeStep(step)
        return None
