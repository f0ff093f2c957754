"""Sentences of the Compare tab, which compares two sets of positions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from skincal.modules.health import LayoutRepair
from skincal.taxels.differences import CommonMotion, ModuleDifference, Summary
from skincal.taxels.result import Method
from skincal.words.layout_words import change_words, left_sentences, misfit_sentence
from skincal.words.units import ChannelNames, cell, count, degrees, millimetres, number

MODULE_HEADINGS = ("Module", "Mean, mm", "Shift, mm", "Shape, mm", "Spacing")
MODULE_HINTS = (
    "Number of the module; known / all taxels if some are not known in both sets of positions",
    "Mean distance between the two positions of its taxels",
    "Shift of the whole module: length of the mean difference",
    "Difference that remains after the best rotation and shift (rms); zero if the module only moved",
    "Spacing of neighbouring taxels in the second set, divided by that of the layout",
)
MAX_LISTED_MODULES = 40
"""Longest list of modules, those with the largest difference: 350 lines cannot be read, and each costs time at every poke."""
ARROW_SCALES = (1, 3, 10)  # Scale factors of the arrows that show differences


def difference_words(summary: Summary | None, pair: tuple[str, str], names: ChannelNames, channels: Sequence[int]) -> str:
    """Summarise the difference: `"84 taxels, mean 2.1 mm, largest 6.3 mm (taxel 204)"`."""
    if pair[0] == pair[1]:
        return "Both sets are the same: choose another one."
    if summary is None:
        return "No taxel is in both sets yet."
    largest = f"largest {millimetres(summary.largest)} ({names.taxel(channels[summary.row])})"
    return f"{count(summary.known, 'taxel')}, mean {millimetres(summary.mean)}, {largest}"


def motion_words(motion: CommonMotion | None) -> str:
    """Describe the common motion between two sets of positions and the remaining differences; empty if unknown."""
    if motion is None:
        return ""
    left = f"{millimetres(motion.mean)} mean, {millimetres(motion.largest)} largest"
    moved = f"{millimetres(motion.shift)} shift and {degrees(motion.turn, 1)} rotation"
    return f"All taxels together: {moved}. Difference that remains: {left}."


def listed_modules(modules: Sequence[ModuleDifference]) -> Sequence[ModuleDifference]:
    """Choose the listed modules: all in the order of the layout, or the worst of too many."""
    return (
        modules if len(modules) <= MAX_LISTED_MODULES else sorted(modules, key=lambda module: -module.mean)[:MAX_LISTED_MODULES]
    )


def listed_words(modules: int) -> str:
    """Title of a list of modules that is cut short; empty if the list is complete."""
    return f"The {MAX_LISTED_MODULES} of {modules} modules with the largest difference" if modules > MAX_LISTED_MODULES else ""


def module_cells(module: ModuleDifference, number_of: int, taxels: int, spacing: float) -> tuple[str, ...]:
    """Make the cells of `MODULE_HEADINGS` for a module; `spacing` may be NaN."""
    some = "" if module.known == taxels else f"  {module.known}/{taxels}"
    lengths = (module.mean, module.shift, module.shape)
    return (f"{number_of}{some}", *(cell(length, "m") for length in lengths), number(spacing, 2))


def axes_legend(first: str, second: str) -> str:
    """Explain the axes of two compared sets in the 3D view, by their names; empty for a set without axes."""
    looks = [f"{name} {look}" for name, look in ((first, "thin"), (second, "broad and pale")) if name]
    return f"Axes in the picture: {', '.join(looks)}." if looks else ""


def arrow_words(pair: tuple[str, str], scale: int, *, named: bool) -> str:
    """Describe the arrows: `"arrows true to scale"`; with both ends if `named`."""
    ends = f" from {pair[0]} to {pair[1]}," if named else ""
    return f"arrows{ends} {'true to scale' if scale == 1 else f'{scale} times as long as the differences'}"


def spacing_words(ratios: Mapping[Method, float]) -> str:
    """Compare the spacing of neighbouring taxels with the layout; empty if all are NaN."""
    parts = [f"{number(ratio, 2)} ({method.value})" for method, ratio in ratios.items() if math.isfinite(ratio)]
    return f"Spacing of neighbours, divided by that of the layout: {', '.join(parts)}." if parts else ""


def misfit_words(mend: LayoutRepair, judged: int, method: Method) -> tuple[str, ...]:
    """Describe the modules that do not match the layout, then what a changed layout does not explain.

    `judged` modules are known well enough by `method`.
    """
    if mend.misfits:
        many = count(len(mend.misfits), "module")
        head = f"\N{WARNING SIGN} {many} not as planned ({method.value}). Nothing changes until you save the layout:"
        return (head, *(misfit_sentence(misfit) for misfit in mend.misfits), *left_sentences(mend))
    if not judged:
        return ()
    none = "The one well-known module does not look" if judged == 1 else f"None of {judged} modules looks"
    return (f"{none} mirrored, turned or swapped ({method.value}).",)


def save_hint(mend: LayoutRepair) -> str:
    """Explain the button that saves the corrected layout."""
    changes = "; ".join(change_words(change) for change in mend.changes)
    return f"Writes the layout to a new file with {changes}. The present file is not changed. (Tab, then Enter)"


def saved_words(path: Path, mend: LayoutRepair) -> str:
    """Give the path of the corrected layout and its use."""
    changed = count(len(mend.changes), "module")
    return (
        f"The corrected layout is in {path}, {changed} changed. To solve this session with it: skincal solve SESSION "
        "--layout FILE. For the next session set modules in the [skin] section of the scene file to this file."
    )
