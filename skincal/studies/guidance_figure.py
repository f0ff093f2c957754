"""The guidance study's figure: error against pokes of every way, and what other conditions do to the guide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from skincal.studies.figure import BLACK, BLUE, GREEN, GREY, ORANGE, PINK, SKY, VERMILION, Axes, Figure

LOOKS: dict[str, tuple[str, str, str]] = {
    "guided": (BLUE, "-", "the guide"),
    "optimal": (SKY, "-", "A-optimal without an end"),
    "diversity": (GREEN, "-", "least spread of the axes first"),
    "tilt_recipe": (ORANGE, "--", "round by round, tilted by a recipe"),
    "random_sides": (PINK, "--", "anywhere, from any side"),
    "round_robin": (VERMILION, "--", "round by round, along the normal"),
    "random": (BLACK, ":", "anywhere, along the normal"),
    "clumped": (GREY, ":", "favourite places, along the normal"),
}
"""Colour, line and words of each way; dashed and dotted ones follow no measurement."""
TICKS = (20, 50, 84, 168, 252, 504, 1008, 2016, 4032)
ERRORS = (0.5, 1, 2, 3, 5, 10, 20, 50)
STANDARD = "standard"


def draw_guidance(result: dict[str, Any], figure: Figure) -> None:
    """Draw the standard case of all methods side by side, and the other cases below."""
    figure.set_size_inches(17.0, 10.0)
    figure.suptitle("Mean error of 84 taxels against pokes: the lower left is reached by few pokes")
    top, bottom = figure.subfigures(2, 1, height_ratios=[1.5, 1.0])
    for method, axes in zip(("free", "surface", "modules"), top.subplots(1, 3), strict=True):
        rows = [row for row in result["table"] if (row["case"], row["method"]) == (STANDARD, method)]
        _draw_courses(axes, rows, f"{method} method, standard case")
    for method, axes in zip(("free", "surface"), bottom.subplots(1, 2), strict=True):
        _draw_cases(axes, [row for row in result["table"] if row["method"] == method], method)


def _draw_courses(axes: Axes, rows: Sequence[Mapping[str, Any]], title: str) -> None:
    for row in rows:
        colour, line, words = LOOKS[row["way"]]
        width = 2.4 if row["way"] == "guided" else 1.4
        axes.plot(row["pokes"], row["mean_mm"], color=colour, linestyle=line, linewidth=width, label=words)
    for error in (5.0, 3.0):
        axes.axhline(error, color=GREY, linewidth=0.8)
    axes.set_xscale("log")
    axes.set_yscale("log")
    last = max(row["pokes"][-1] for row in rows)
    axes.set_xlim(20, last)
    ticks = [at for at in TICKS if at <= last]
    axes.set_xticks(ticks, [f"{at:,}" for at in ticks])
    axes.set_xticks([], minor=True)
    axes.set_yticks(ERRORS, [f"{at:g}" for at in ERRORS])
    axes.set_yticks([], minor=True)
    axes.set_xlabel("pokes")
    axes.set_ylabel("mean error (mm); a taxel without estimate counts 60")
    axes.set_title(title)
    axes.grid(visible=True)
    axes.legend(fontsize=8.5)


def _draw_cases(axes: Axes, rows: Sequence[Mapping[str, Any]], method: str) -> None:
    """Draw the errors after as many pokes as all courses have."""
    cases = list(dict.fromkeys(row["case"] for row in rows))
    pokes = min(row["pokes"][-1] for row in rows)
    baseline = "tilt_recipe" if method == "free" else "round_robin"
    for offset, way in ((-0.15, "guided"), (0.15, baseline)):
        colour, _, words = LOOKS[way]
        own = {row["case"]: row for row in rows if row["way"] == way}
        places = [place + offset for place, case in enumerate(cases) if case in own]
        errors = [own[case]["mean_mm"][own[case]["pokes"].index(pokes)] for case in cases if case in own]
        axes.bar(places, errors, width=0.28, color=colour, label=f"{words}, after {pokes} pokes")
    axes.set_xticks(range(len(cases)), cases, rotation=20, ha="right", fontsize=8.5)
    axes.set_ylabel("mean error (mm)")
    axes.set_title(f"{method} method in other cases")
    axes.grid(visible=True, axis="y")
    # Room above the bars for the legend.
    axes.set_ylim(0.0, 1.2 * axes.get_ylim()[1])
    axes.legend(fontsize=8.5)
