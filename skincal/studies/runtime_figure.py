"""The runtime study's figure: who is at the bottom left, and what a taxel costs as the problem grows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from skincal.studies.figure import BLACK, BLUE, GREEN, GREY, ORANGE, PINK, SKY, VERMILION, Axes, Figure
from skincal.studies.measures import Row
from skincal.studies.runtime_results import main_rows, time_words

MARKS: dict[str, tuple[str, str, str]] = {
    "surface": ("*", BLUE, "surface,\nas shipped"),
    "free": ("*", VERMILION, "free,\nas shipped"),
    "brute": ("s", SKY, "every triangle,\nclosed form"),
    "facing": ("p", SKY, "those that\nare pushed"),
    "compiled": ("X", SKY, "pushed ones,\ncompiled"),
    "bounded": ("D", SKY, "every triangle's\nbound first"),
    "quadprog": ("o", ORANGE, "the paper's way:\nquadprog"),
    "slsqp": ("o", BLACK, "the paper's way:\nSLSQP"),
    "modules": ("*", GREEN, "modules,\nas shipped"),
    "modules-general": ("d", GREEN, "modules, scipy's\nLevenberg-Marquardt"),
    "modules-per-pose": ("^", GREEN, "modules,\nposes averaged"),
    "surface-per-pose": ("^", BLUE, "surface,\nposes averaged"),
    "free-per-pose": ("^", VERMILION, "free,\nposes averaged"),
    "lstsq": ("v", ORANGE, "numpy lstsq"),
    "normal": ("P", PINK, "normal\nequations"),
}
"""Mark, colour and words of each method."""
PARTS = {"icub-forearm": "forearm", "whole-body": "whole body"}
AXES = {"triangles": "triangles of the mesh", "taxels": "taxels", "pokes_per_taxel": "pokes per taxel"}
KEY = (
    "Stars: as shipped. Hollow: extrapolated from a sample. Bars: quartiles. Below, dashed lines are the forearm's, "
    "whole lines the whole body's."
)
SMALL_PART = "icub-forearm"
"""Its lines are dashed."""
TICKS_MS = {
    1e-1: "0.1 ms", 1.0: "1 ms", 10.0: "10 ms", 100.0: "0.1 s", 1e3: "1 s", 1e4: "10 s", 6e4: "1 min", 6e5: "10 min",
    3.6e6: "1 h", 3.6e7: "10 h", 3.6e8: "100 h",
}  # fmt: skip
SMALL, LARGE = 70.0, 260.0
"""Areas of marks, points squared."""


def draw_runtime(result: dict[str, Any], figure: Figure) -> None:
    """Draw error against run time on both parts above, growth of the cost below."""
    figure.set_size_inches(13.0, 11.0)
    figure.set_layout_engine("none")
    above = figure.add_gridspec(1, 2, left=0.07, right=0.985, bottom=0.42, top=0.9, wspace=0.14)
    below = figure.add_gridspec(1, 3, left=0.07, right=0.985, bottom=0.05, top=0.335, wspace=0.24)
    figure.text(0.012, 0.971, "Error against run time: down is exact, left is fast", fontsize=14, fontweight="bold")
    figure.text(0.012, 0.948, KEY, fontsize=9.5)
    rows = main_rows(result)
    for place, part in enumerate(list(dict.fromkeys(row["part"] for row in rows))[:2]):
        _error_against_time(figure.add_subplot(above[place]), [row for row in rows if row["part"] == part])
    for place, (name, words) in enumerate(AXES.items()):
        _growth(figure.add_subplot(below[place]), result["growth"][name], name, words)


def _error_against_time(axes: Axes, rows: Sequence[Row]) -> None:
    first = rows[0]
    part = PARTS.get(first["part"], first["part"])
    axes.set_title(
        f"{part}: {first['taxels']:,} taxels, {first['triangles']:,} triangles, {first['pokes_per_taxel']} pokes a taxel"
    )
    shown = sorted((row for row in rows if row["error_mm"] is not None), key=lambda row: row["time_ms"]["median"])
    for row in shown:
        _mark(axes, row)
    axes.set_xscale("log")
    axes.set_yscale("log")
    _limits(axes, shown)
    _names(axes, shown)
    axes.set_xlabel("time to solve all taxels from their contacts")
    axes.set_ylabel("mean error against the truth (mm)")
    low, high = axes.get_xlim()
    ticks = {at: words for at, words in TICKS_MS.items() if low <= at <= high}
    axes.set_xticks(list(ticks), list(ticks.values()), fontsize=8.5)
    axes.set_xticks([], minor=True)
    axes.yaxis.set_major_formatter(_tick)
    axes.yaxis.set_minor_formatter(_minor_tick)
    axes.grid(True, which="major")


def _tick(value: float, _: int) -> str:
    return f"{value:g}"


def _minor_tick(value: float, _: int) -> str:
    """Name the twos and fives between the tens."""
    return f"{value:g}" if f"{value:.0e}"[0] in "25" else ""


def _mark(axes: Axes, row: Row) -> None:
    mark, colour, _ = MARKS[row["method"]]
    time, error = row["time_ms"], row["error_mm"]
    axes.errorbar(
        time["median"], error["median"], ecolor=colour, fmt="none", capsize=2.5, elinewidth=1.2, zorder=2,
        xerr=[[time["median"] - time["q1"]], [time["q3"] - time["median"]]],
        yerr=[[error["median"] - error["q1"]], [error["q3"] - error["median"]]],
    )  # fmt: skip
    hollow = row["extrapolated_from"] is not None
    size = LARGE if mark == "*" else SMALL
    axes.scatter(
        time["median"], error["median"], marker=mark, s=size, zorder=4 if mark == "*" else 3, linewidths=1.6,
        facecolors="white" if hollow else colour, edgecolors=colour,
    )  # fmt: skip


def _limits(axes: Axes, rows: Sequence[Row]) -> None:
    """Leave room for the names."""
    times = [row["time_ms"][key] for row in rows for key in ("q1", "q3")]
    errors = [row["error_mm"][key] for row in rows for key in ("q1", "q3")]
    axes.set_xlim(min(times) / 5.0, max(times) * 8.0)
    axes.set_ylim(min(errors) / 18.0, max(errors) * 6.0)


ROW_SHARE = 0.065
"""Of a panel's height, what a row of its legend takes."""
Box = tuple[float, float, float, float]
"""Left, bottom, right, top, in points."""


def _names(axes: Axes, rows: Sequence[Row]) -> None:
    """Write the methods' names beside their marks: those of the free method above, the others below, where there is room."""
    marks = [_at(axes, row) for row in rows]
    taken = [(x - 6, y - 6, x + 6, y + 6) for x, y in marks]
    pairs = list(zip(rows, marks, strict=True))
    for row, (x, y) in sorted(pairs, key=lambda pair: MARKS[pair[0]["method"]][0] != "*"):
        mark, colour, words = MARKS[row["method"]]
        width, height = 5.0 * max(map(len, words.split("\n"))), 11.0 * len(words.split("\n"))
        side = -1 if row["label"].startswith("surface") else 1
        places = [(0.0, side * (10.0 + height / 2 + step)) for step in range(0, 160, 4)]
        if side > 0:
            # Nothing of the free method stands further to the right.
            places.insert(1, (width / 2 + 10.0, 0.0))
        boxes = [(x + dx - width / 2, y + dy - height / 2, x + dx + width / 2, y + dy + height / 2) for dx, dy in places]
        chosen = next((k for k, box in enumerate(boxes) if not any(_overlap(box, other) for other in taken)), 0)
        taken.append(boxes[chosen])
        far = abs(places[chosen][1]) > 20.0 + height / 2
        axes.annotate(
            words, (row["time_ms"]["median"], row["error_mm"]["median"]), places[chosen], textcoords="offset points",
            ha="center", va="center", fontsize=8.5, color=BLUE if colour == SKY else colour, zorder=5,
            fontweight="bold" if mark == "*" else "normal",
            arrowprops={"arrowstyle": "-", "color": GREY, "lw": 0.5, "shrinkA": 0, "shrinkB": 5} if far else None,
        )  # fmt: skip


def _at(axes: Axes, row: Row) -> tuple[float, float]:
    """Return where a mark is, in points."""
    x, y = axes.transData.transform((row["time_ms"]["median"], row["error_mm"]["median"]))
    points = 72.0 / axes.figure.dpi
    return float(x) * points, float(y) * points


def _overlap(box: Box, other: Box) -> bool:
    return box[0] < other[2] and other[0] < box[2] and box[1] < other[3] and other[1] < box[3]


def _growth(axes: Axes, points: Sequence[dict[str, Any]], name: str, words: str) -> None:
    axes.set_title(f"Cost of a taxel against {words}", fontsize=10)
    series: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for point in points:
        series.setdefault((point["part"], point["method"]), []).append(point)
    labelled: set[str] = set()
    for (part, method), of_one in series.items():
        if len(of_one) < 2:
            continue
        _line(axes, part, method, of_one, name, "" if method in labelled else _short(method))
        labelled.add(method)
    axes.set_xscale("log")
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    low, high = min(low, 20.0), max(high, 2_000.0)
    # The legend stands above the curves, two names in a row.
    room = ROW_SHARE * ((len(labelled) + 1) // 2)
    axes.set_ylim(low, high * (high / low) ** (room / (1.0 - room)))
    axes.xaxis.set_major_formatter(_count_tick)
    axes.yaxis.set_major_formatter(_cost_tick)
    axes.set_xlabel(words)
    axes.set_ylabel("time per taxel")
    axes.grid(True, which="major")
    if labelled:
        axes.legend(fontsize=7.0, handlelength=1.8, columnspacing=0.8, ncols=2, loc="upper left")


def _line(axes: Axes, part: str, method: str, points: Sequence[dict[str, Any]], name: str, label: str) -> None:
    mark, colour, _ = MARKS[method]
    cost = [point["us_per_taxel"] for point in points]
    axes.errorbar(
        [point[name] for point in points], [one["median"] for one in cost],
        yerr=[[one["median"] - one["q1"] for one in cost], [one["q3"] - one["median"] for one in cost]],
        color=colour, marker=mark, markersize=9 if mark == "*" else 4.5, linewidth=1.4, capsize=2,
        linestyle="--" if part == SMALL_PART else "-", label=label or None,
    )  # fmt: skip


def _short(method: str) -> str:
    return MARKS[method][2].replace("\n", " ").removeprefix("the ")


def _count_tick(value: float, _: int) -> str:
    return f"{value:,.0f}"


def _cost_tick(value: float, _: int) -> str:
    return f"{value:g} us" if value < 1e3 else time_words(value / 1e3)
