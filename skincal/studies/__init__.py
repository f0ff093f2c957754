"""Studies of the program itself: each gives numbers, lines of text and a figure.

To add a study, write a module with a `Study` (`harness.py`) named `THIS_STUDY` and enter it in `STUDIES`. It is imported when
its command runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, NamedTuple

from skincal.model.errors import InputError

if TYPE_CHECKING:
    from skincal.studies.harness import Study


class Entry(NamedTuple):
    """Module of a study in this package, its purpose for the help, and a package of the extra `study` that it needs."""

    module: str
    purpose: str
    package: str | None = None


STUDIES: Mapping[str, Entry] = {
    "axes": Entry("axes_study", "The turn of taxels of three axes: error against pokes, module or taxel, and mistakes."),
    "stability": Entry("stability", "Every solver against 80-digit arithmetic on stiff and extreme cases.", "mpmath"),
    "guidance": Entry("guidance_study", "How many pokes are needed: guided, unguided, and with a printed recipe."),
    "paper": Entry("paper", "Repeat the paper's experiment. Add the modules method and landmark corrections."),
    "runtime": Entry(
        "runtime", "Error against run time: the program's methods, the paper's solvers, brute force and general solvers."
    ),
    "robot": Entry("robot", "A robot pokes without a hand, in MuJoCo: an ideal rig, and one with real imperfections."),
    "tip": Entry("tip_study", "Positions of the tip from a robot or a tracker, together with the force axes."),
    "tool": Entry("tool_study", "A cobot or a tracked probe pokes a still part; the sensor is on the tool, or there is none."),
    "unmodelled": Entry("unmodelled", "Rigs with errors that the program does not model, from an independent simulator."),
}
"""By the study's name."""


def load_study(name: str) -> Study[Any]:
    """Import a study by its name. Raises InputError: a package that it needs is not installed."""
    entry = STUDIES[name]
    if entry.package is not None and find_spec(entry.package) is None:
        raise InputError(
            f"the study {name} needs the package {entry.package}, which is not installed; install it: "
            f"python -m pip install 'skincal[study]' (or python3 start.py --study study {name})"
        )
    return import_module(f"skincal.studies.{entry.module}").THIS_STUDY
