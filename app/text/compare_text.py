"""Sentences of the Compare tab, on two sets of places beside each other: pure functions, without Qt."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from app.state.place_sets import Pair, PlaceOrigin, Source
from app.text.outcomes import METHOD_NAMES
from skincal.modules.health import LayoutMend
from skincal.taxels.differences import CommonMotion, ModuleDifference, Summary
from skincal.taxels.result import Method
from skincal.words.layout_words import change_words, left_sentences, misfit_sentence
from skincal.words.units import TIMES, ChannelNames, cell, count, degrees, millimetres, number

MODULE_HEADINGS = ("Module", "Mean, mm", "Shift, mm", "Shape, mm", "Spacing")
MODULE_HINTS = (
    "Its number, and how many of its taxels are known in both where some are not",
    "Mean length of its taxels' differences",
    "What it is moved by as a whole: the length of the mean difference",
    "What is left after its best turn and shift (rms): a module that is only moved has none",
    "How far its neighbouring taxels lie apart in the second set, in shares of the layout's spacing",
)
MOST_MODULES = 40
"""Modules in the list at most: of more, those that lie farthest apart. Nobody reads 350, and each costs with every poke."""
SCALES = (1, 3, 10)
"""How many times their own length arrows can be drawn."""


def source_words(source: Source) -> str:
    """Return what a set of places is called: `"Layout"`, `"Surface method"`, `"Free before correction"`."""
    if source.origin is PlaceOrigin.TRUTH:
        return "Truth"
    if source.method is None:
        return source.name or "Layout"
    name = METHOD_NAMES[source.method].capitalize()
    return f"{name} method" if source.origin is PlaceOrigin.METHOD else f"{name} {source.origin.value}"


def difference_words(summary: Summary | None, pair: Pair, names: ChannelNames, channels: Sequence[int]) -> str:
    """Return one line on how far two sets lie apart: `"84 taxels, mean 2.1 mm, largest 6.3 mm (17-04)"`."""
    if pair[0] == pair[1]:
        return "The same places twice: choose another set to compare with."
    if summary is None:
        return "No taxel is known in both yet."
    largest = f"largest {millimetres(summary.largest)} ({names.short(channels[summary.row])})"
    return f"{count(summary.known, 'taxel')}, mean {millimetres(summary.mean)}, {largest}"


def motion_words(motion: CommonMotion | None) -> str:
    """Return by which motion of all taxels two sets differ most, and what that leaves; empty where it is not known."""
    if motion is None:
        return ""
    left = f"{millimetres(motion.mean)} mean, {millimetres(motion.largest)} largest"
    return f"All together moved {millimetres(motion.shift)} and turned {degrees(motion.turn, 1)}; without that {left}."


def listed_modules(modules: Sequence[ModuleDifference]) -> Sequence[ModuleDifference]:
    """Return the modules that are listed: all in the layout's order, or of too many the worst, the worst first."""
    return modules if len(modules) <= MOST_MODULES else sorted(modules, key=lambda module: -module.mean)[:MOST_MODULES]


def listed_words(modules: int) -> str:
    """Return what is said over the list of so many modules; nothing where it holds them all."""
    return f"The {MOST_MODULES} of {modules} modules that lie farthest apart" if modules > MOST_MODULES else ""


def module_cells(module: ModuleDifference, number_of: int, taxels: int, spacing: float) -> tuple[str, ...]:
    """Return the cells of `MODULE_HEADINGS` for a module by its id, its taxels, and its spacing over the layout's, or NaN."""
    some = "" if module.known == taxels else f"  {module.known}/{taxels}"
    lengths = (module.mean, module.shift, module.shape)
    return (f"{number_of}{some}", *(cell(length, "m") for length in lengths), number(spacing, 2))


def worst_words(channel: int, length: float, names: ChannelNames) -> str:
    """Return the line of a taxel in the list of the worst."""
    return f"{names.short(channel)}   {millimetres(length)}"


def arrow_words(pair: Pair, scale: int, *, named: bool) -> str:
    """Return what arrows show: `"arrows true to scale"`; where `named` also from where to where they lead."""
    ends = f" from {source_words(pair[0])} to {source_words(pair[1])}," if named else ""
    return f"arrows{ends} {'true to scale' if scale == 1 else f'{scale} times as long as the differences'}"


def scale_choice(scale: int) -> str:
    """Return the same as a choice: `"x 3"`."""
    return f"{TIMES} {scale}"


def spacing_words(ratios: Mapping[Method, float]) -> str:
    """Return how far neighbouring taxels lie apart by each method over the layout's spacing; empty where all are NaN."""
    parts = [f"{number(ratio, 2)} ({METHOD_NAMES[method]})" for method, ratio in ratios.items() if math.isfinite(ratio)]
    return f"Neighbours lie {', '.join(parts)} of the layout's spacing apart." if parts else ""


def misfit_words(mend: LayoutMend, judged: int, method: Method) -> tuple[str, ...]:
    """Return what is said of modules that do not lie as planned, one sentence each; the first with the sign of a warning.

    What cannot be put right by another layout follows. `judged` modules are known well enough by `method` to say it.
    """
    if mend.misfits:
        many = count(len(mend.misfits), "module")
        head = f"\N{WARNING SIGN} {many} not as planned ({METHOD_NAMES[method]}). Nothing is changed by itself:"
        return (head, *(misfit_sentence(misfit) for misfit in mend.misfits), *left_sentences(mend))
    if not judged:
        return ()
    none = "The one module that is known well does not look" if judged == 1 else f"None of {judged} modules looks"
    return (f"{none} mirrored, turned or swapped ({METHOD_NAMES[method]}).",)


def save_hint(mend: LayoutMend) -> str:
    """Return what the button that saves the corrected layout does."""
    changes = "; ".join(change_words(change) for change in mend.changes)
    return (
        f"Writes the layout as a new file in which it says {changes}. The file that was read stays as it is. (Tab, then Enter)"
    )


def saved_words(path: Path, mend: LayoutMend) -> str:
    """Return where the corrected layout is, and how it is used."""
    changed = count(len(mend.changes), "module")
    return (
        f"The corrected layout is in {path}, {changed} changed. This session is solved with it by: skincal solve SESSION "
        "--layout FILE. For the next one name it as modules in the [skin] of the scene file."
    )
