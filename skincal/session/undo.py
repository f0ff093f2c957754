"""What undo would take back: one entry for every accepted poke and every action, the newest last, without limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Step:
    """What can be taken back."""

    words: str
    """What it was, for the operator."""
    take_back: Callable[[], None]


class History:
    """The steps of a session. What was taken back leaves the list and is not taken back again.

    Parameters
    ----------
    is_excluded : whether a poke, by its number, was taken out already: there is nothing to undo in it
    exclude : takes a poke out, which is how an accepted one is undone
    """

    def __init__(self, is_excluded: Callable[[int], bool], exclude: Callable[[int], None]) -> None:
        self._is_excluded, self._exclude = is_excluded, exclude
        # A poke is its number alone: there are thousands.
        self._steps: list[Step | int] = []

    def add(self, step: Step | int) -> None:
        """Add the newest action, or the number of the newest accepted poke."""
        self._steps.append(step)

    def forget_poke(self, poke: int) -> None:
        """Drop the step of a poke that no longer counts."""
        self._steps = [step for step in self._steps if step != poke]

    def last(self, *, drop: bool = False) -> Step | None:
        """Return the newest step that can be undone; with `drop` it leaves the list, and so does what came after it."""
        for at in range(len(self._steps) - 1, -1, -1):
            step = self._steps[at]
            if isinstance(step, Step):
                found = step
            elif not self._is_excluded(step):
                found = Step(f"poke {step}", lambda poke=step: self._exclude(poke))
            else:
                continue
            if drop:
                del self._steps[at:]
            return found
        return None
