"""Studies of the program itself: each gives numbers, lines for a person and a figure.

A study is a module with `run(quick, progress)`, which returns what JSON can hold, `summary(result)`, lines for a person,
and `draw(result, figure)`. It is imported when its command runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from skincal.studies.figures import Figure

STUDIES: Mapping[str, tuple[str, str]] = {
    "stability": ("stability", "Every solver against 80-digit arithmetic on stiff and extreme cases."),
    "guidance": ("guidance_study", "Pokes that the guide takes, beside people on their own and a printed recipe."),
    "paper": ("paper", "The paper's experiment done again, with rigid modules and landmark pokes beside its two methods."),
    "runtime": (
        "runtime",
        "Error against run time: the two methods, the paper's way, brute force and other honest alternatives.",
    ),
}
"""Name of each study, its module in this package, and what it shows."""


class Study(Protocol):
    """What a study's module offers."""

    def run(self, quick: bool, progress: Callable[[str], None]) -> dict[str, Any]:
        """Measure, within 45 s if `quick`, and return what JSON can hold, no NaN; `progress` takes a sentence now and then."""
        ...

    def summary(self, result: dict[str, Any]) -> list[str]:
        """Return lines for a person."""
        ...

    def draw(self, result: dict[str, Any], figure: Figure) -> None:
        """Draw the result into an empty figure."""
        ...
