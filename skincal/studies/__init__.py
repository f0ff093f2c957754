"""Studies of the program itself: each gives numbers, lines of text and a figure.

To add a study, write a module with the functions of `Study` and enter it in `STUDIES`. It is imported when its command runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from skincal.plotting import Figure

STUDIES: Mapping[str, tuple[str, str]] = {
    "stability": ("stability", "Every solver against 80-digit arithmetic on stiff and extreme cases."),
    "guidance": ("guidance_study", "How many pokes are needed: guided, unguided, and with a printed recipe."),
    "paper": ("paper", "Repeat the paper's experiment. Add the modules method and landmark corrections."),
    "runtime": (
        "runtime",
        "Error against run time: the program's methods, the paper's solvers, brute force and general solvers.",
    ),
    "robot": (
        "robot",
        "A robot pokes without a hand, in MuJoCo: an ideal rig, and one with real imperfections.",
    ),
    "tip": ("tip_study", "Positions of the tip from a robot or a tracker, together with the force axes."),
    "unmodelled": ("unmodelled", "Rigs with errors that the program does not model, from an independent simulator."),
}
"""By the study's name: its module in this package, and its purpose for the help."""


class Study(Protocol):
    """Functions of a study's module."""

    def run(self, quick: bool, progress: Callable[[str], None]) -> dict[str, Any]:
        """Measure, within 90 s on two idle cores if `quick`. Return JSON without NaN; `progress` gets sentences.

        A list `misses` in it names faults of the program: unless it is empty, the command ends with exit code 1.
        """
        ...

    def summary(self, result: dict[str, Any]) -> list[str]:
        """Describe the result in lines of text."""
        ...

    def draw(self, result: dict[str, Any], figure: Figure) -> None:
        """Draw the result into an empty figure."""
        ...
