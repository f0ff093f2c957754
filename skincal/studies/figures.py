"""The studies' figures: the only place of the core that draws, without a window.

Colours are those of Okabe and Ito (2008), which people with any colour vision tell apart; what matters is said in words
or by a mark's shape as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib as mpl
from matplotlib import figure as mpl_figure

from skincal.model.errors import InputError
from skincal.studies.measuring import time_words

Figure: TypeAlias = Any
"""matplotlib.figure.Figure, whose type hints are too loose for strict checks."""
Axes: TypeAlias = Any
"""matplotlib.axes.Axes."""
Measured: TypeAlias = Mapping[str, Any]
_matplotlib: Any = mpl
_figures: Any = mpl_figure

BLACK, ORANGE, SKY, GREEN, YELLOW = "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442"
BLUE, VERMILION, PINK = "#0072B2", "#D55E00", "#CC79A7"
GREY = "#767676"
"""For what stands aside; 4.5 : 1 against white."""
DOTS_PER_INCH = 130
INCHES = (12.0, 7.0)
"""Width and height, unless a study sets its own."""
STYLE: dict[str, Any] = {
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.titlesize": 11,
    "font.size": 9.5,
    "legend.frameon": False,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    # The same result gives the same bytes.
    "svg.hashsalt": "skincal",
    "svg.fonttype": "none",
}


def write_figure(draw: Callable[[Figure], None], folder: Path, name: str) -> list[Path]:
    """Draw a figure and write it as SVG, for print, and PNG; return the files.

    Parameters
    ----------
    draw : fills an empty figure; may set its size
    folder : there already
    name : of the files, without their ending

    Raises
    ------
    InputError
        A file cannot be written.
    """
    written: list[Path] = []
    with _matplotlib.rc_context(STYLE):
        figure: Figure = _figures.Figure(figsize=INCHES, layout="constrained")
        draw(figure)
        for ending, metadata in (("svg", {"Date": None}), ("png", {"Software": None})):
            path, data = folder / f"{name}.{ending}", BytesIO()
            figure.savefig(data, format=ending, dpi=DOTS_PER_INCH, metadata=metadata)
            try:
                path.write_bytes(data.getvalue())
            except OSError as error:
                raise InputError(f"{path}: cannot be written ({error.strerror}); choose another folder by --out.") from None
            written.append(path)
    return written


def _log(axes: Axes, x: Mapping[float, str] | None = None, y: Mapping[float, str] | None = None) -> None:
    """Count both axes in powers of ten, with these ticks and words where there are some."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    for ticks, set_ticks in ((x, axes.set_xticks), (y, axes.set_yticks)):
        if ticks is not None:
            set_ticks(list(ticks), list(ticks.values()))
            set_ticks([], minor=True)
    axes.grid(visible=True)


def _plain(numbers: Sequence[float]) -> dict[float, str]:
    return {number: f"{number:,g}" if number < 1e4 else f"{number:,.0f}" for number in numbers}


# ---- stability ----

TRY_LOOKS = {
    "normal equations": ("x", VERMILION), "QR, rows as they come": ("v", ORANGE),
    "QR, three rows a contact, as they come": ("^", PINK), "lstsq, three rows a contact": ("s", SKY),
    "sorted and pivoted QR, three rows a contact": ("D", GREEN), "least_squares, differenced": ("v", BLACK),
}  # fmt: skip
"""Mark and colour of each other way."""
SHARE_MIN, SHARE_MAX = 1e-4, 1e300
"""Shares of the bar below the one are drawn at it; one as large as the other is no number."""


def draw_stability(result: dict[str, Any], figure: Figure) -> None:
    """Draw each case's share of the bar, shipped and other ways, one panel a solver."""
    solvers = list(dict.fromkeys(one["solver"] for one in result["cases"]))
    rows = max(sum(one["solver"] == solver for one in result["cases"]) for solver in solvers)
    figure.set_size_inches(22.0, 2.0 + 0.19 * rows)
    for panel, solver in zip(figure.subplots(1, len(solvers), squeeze=False)[0], solvers, strict=True):
        of = ([one for one in result[kind] if one["solver"] == solver] for kind in ("cases", "alternatives"))
        _draw_solver(panel, solver, *of)
    found = [panel.get_legend_handles_labels() for panel in figure.axes]
    marks = {label: handle for handles, labels in found for handle, label in zip(handles, labels, strict=True)}
    figure.legend(marks.values(), marks.keys(), loc="outside lower center", ncols=4)
    figure.suptitle(
        f"Error over the bar. Bar: {result['factor']:g} times what the inputs' last digit does ({result['draws']} draws, "
        f"{result['digits']} digits) + {result['of_size']:g} of the answer. "
        "Right of the line digits are lost that the readings have."
    )


def _draw_solver(panel: Axes, solver: str, cases: Sequence[Measured], others: Sequence[Measured]) -> None:
    place = {one["name"]: -row for row, one in enumerate(cases)}
    numbers = [one["error_over_bound"] for one in (*cases, *others) if one["error_over_bound"] < SHARE_MAX]
    right = max(10.0, *numbers) * 3.0

    def put(records: Sequence[Measured], **look: Any) -> None:
        shares = [min(max(one["error_over_bound"], SHARE_MIN), right) for one in records]
        panel.scatter(shares, [place[one["name"]] for one in records], **look)

    for method, (mark, colour) in TRY_LOOKS.items():
        look = {"color": colour} if mark == "x" else {"facecolors": "none", "edgecolors": colour}
        if own := [one for one in others if one["method"] == method]:
            put(own, s=22, marker=mark, label=method, linewidths=1.0, **look)
    put(cases, s=26, color=BLUE, label="shipped", zorder=3)
    panel.axvline(1.0, color=BLACK, linewidth=1.2)
    panel.set_xscale("log")
    panel.set_xlim(SHARE_MIN / 2, right * 2)
    panel.set_yticks(list(place.values()), list(place), fontsize=7.5)
    panel.set_ylim(-len(cases), 1)
    panel.grid(visible=True)
    panel.set_title(f"{solver}: {len(cases)} cases")
    panel.set_xlabel(f"error over the bar\n(least {SHARE_MIN:g}; no number at the right end)")


# ---- guidance ----

WAY_LOOKS: dict[str, tuple[str, str, str]] = {
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
POKES = (20, 50, 84, 168, 252, 504, 1008, 2016, 4032)


def draw_guidance(result: dict[str, Any], figure: Figure) -> None:
    """Draw the standard case of all methods side by side, and the other cases below."""
    figure.set_size_inches(17.0, 10.0)
    figure.suptitle("Mean error of 84 taxels against pokes: the lower left is reached by few pokes")
    top, bottom = figure.subfigures(2, 1, height_ratios=[1.5, 1.0])
    for method, axes in zip(("free", "surface", "modules"), top.subplots(1, 3), strict=True):
        rows = [row for row in result["table"] if (row["case"], row["method"]) == ("standard", method)]
        _draw_courses(axes, rows, f"{method} method, standard case")
    for method, axes in zip(("free", "surface"), bottom.subplots(1, 2), strict=True):
        _draw_cases(axes, [row for row in result["table"] if row["method"] == method], method)


def _draw_courses(axes: Axes, rows: Sequence[Mapping[str, Any]], title: str) -> None:
    for row in rows:
        colour, line, words = WAY_LOOKS[row["way"]]
        width = 2.4 if row["way"] == "guided" else 1.4
        axes.plot(row["pokes"], row["mean_mm"], color=colour, linestyle=line, linewidth=width, label=words)
    for error in (5.0, 3.0):
        axes.axhline(error, color=GREY, linewidth=0.8)
    last = max(row["pokes"][-1] for row in rows)
    _log(axes, _plain([at for at in POKES if at <= last]), _plain((0.5, 1, 2, 3, 5, 10, 20, 50)))
    axes.set_xlim(20, last)
    axes.set_xlabel("pokes")
    axes.set_ylabel("mean error (mm); a taxel without estimate counts 60")
    axes.set_title(title)
    axes.legend(fontsize=8.5)


def _draw_cases(axes: Axes, rows: Sequence[Mapping[str, Any]], method: str) -> None:
    """Draw the errors after as many pokes as all courses have."""
    cases = list(dict.fromkeys(row["case"] for row in rows))
    pokes = min(row["pokes"][-1] for row in rows)
    baseline = "tilt_recipe" if method == "free" else "round_robin"
    for offset, way in ((-0.15, "guided"), (0.15, baseline)):
        colour, _, words = WAY_LOOKS[way]
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


# ---- paper ----

METHOD_LOOKS: dict[str, tuple[str, str]] = {
    "free": (BLUE, "free"),
    "surface": (VERMILION, "surface"),
    "modules": (GREEN, "modules"),
}
"""Colour and words of each method."""
COURSE_LOOKS: dict[str, tuple[str, str, str]] = {
    **{name: (colour, words, "-") for name, (colour, words) in METHOD_LOOKS.items()},
    "modules_21": (BLACK, "modules, rig corrected by 21 landmark pokes", "--"),
}
"""Colour, words and line of each course."""


def draw_paper(result: dict[str, Any], figure: Figure) -> None:
    """Draw six panels."""
    figure.set_size_inches(13.0, 14.0)
    figure.suptitle(f"The paper's experiment on {result['seeds']} simulated rigs, each as wrong as the paper's")
    (alone, averaged), (landmarks, good), (pokes, times) = figure.subplots(3, 2)
    _draw_alone(alone, result)
    _draw_averaged(averaged, result)
    _draw_landmarks(landmarks, result)
    _draw_good(good, result)
    _draw_pokes(pokes, result)
    _draw_times(times, result)


def _mean_bars(axes: Axes, rows: dict[str, list[dict[str, Any]]], names: list[str]) -> None:
    for offset, (method, (colour, words)) in enumerate(METHOD_LOOKS.items()):
        places = [place + (offset - 1) * 0.26 for place in range(len(names))]
        means, sds = [row["mean"] for row in rows[method]], [row["sd"] for row in rows[method]]
        axes.bar(places, means, width=0.26, color=colour, label=words)
        axes.errorbar(places, means, yerr=sds, fmt="none", ecolor=GREY, elinewidth=1.0)
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel("error of 84 taxels (mm): mean and sd")
    axes.grid(visible=True, axis="y")


def _draw_alone(axes: Axes, result: dict[str, Any]) -> None:
    poses = list(result["minutes"])
    rows = {method: [result["per_pose_mm"][method][pose] for pose in poses] for method in METHOD_LOOKS}
    _mean_bars(axes, rows, [f"{pose}\n{result['minutes'][pose]:g} min" for pose in poses])
    for place, (method, (low, high)) in zip((6.75, 6.95), result["published"]["per_pose_mean_mm"].items(), strict=True):
        axes.plot([place, place], [low, high], color=METHOD_LOOKS[method][0], linewidth=5.0, solid_capstyle="butt")
    axes.text(6.85, -0.02, "paper's\nrange", transform=axes.get_xaxis_transform(), ha="center", va="top", fontsize=8.5)
    axes.set_title("Each arm pose alone (figure 4)")
    axes.set_ylim(top=24.0)
    axes.legend(fontsize=8.5, loc="upper left", ncols=3)


def _draw_averaged(axes: Axes, result: dict[str, Any]) -> None:
    rows = {method: result["averaged_mm"][method] for method in METHOD_LOOKS}
    _mean_bars(axes, rows, [f"1 to {last}" if last > 1 else "1" for last in range(1, 8)])
    for method, value in result["published"]["averaged_mean_mm"].items():
        axes.axhline(value, color=METHOD_LOOKS[method][0], linestyle="--", linewidth=1.2, label=f"paper, {method} {value}")
    axes.set_xlabel("arm poses averaged one after another")
    axes.set_title("Averaged (figure 5)")
    axes.legend(fontsize=8.5, loc="upper right")


def _draw_landmarks(axes: Axes, result: dict[str, Any]) -> None:
    counts = [0, *(one["landmark_pokes"] for one in result["landmarks"])]
    for offset, (method, (colour, words)) in enumerate(METHOD_LOOKS.items()):
        values = [result["mean_mm"][method], *(one["mean_mm"][method] for one in result["landmarks"])]
        places = [place + (offset - 1) * 0.26 for place in range(len(counts))]
        axes.bar(places, values, width=0.26, color=colour, label=words)
        for place, value in zip(places, values, strict=True):
            axes.text(place, value, f"{value:.1f}", ha="center", va="bottom", fontsize=8.5)
    axes.set_xticks(range(len(counts)), [f"{count} landmark pokes" for count in counts])
    axes.set_ylabel("mean error (mm), all poses pooled")
    axes.set_title("The rig corrected from pokes at landmarks")
    axes.grid(visible=True, axis="y")
    axes.legend(fontsize=8.5)


def _draw_good(axes: Axes, result: dict[str, Any]) -> None:
    course = result["course_mm"]
    for method, (colour, words) in METHOD_LOOKS.items():
        known = [(pokes, error) for pokes, error in zip(course["pokes"], course[method], strict=True) if error is not None]
        axes.plot([pokes for pokes, _ in known], [error for _, error in known], color=colour, marker="o", label=words)
    _log(axes, _plain(course["pokes"]), _plain((0.2, 0.5, 1, 2, 5, 10)))
    axes.set_xlabel("pokes in one arm pose, unguided")
    axes.set_ylabel("mean error (mm) of those with an estimate")
    times = ", ".join(
        f"{METHOD_LOOKS[method][1]} {milliseconds:.0f} ms" for method, milliseconds in result["runtime_ms"].items()
    )
    axes.set_title(f"A rig that is only noisy\nsolving {result['pokes']:,} pokes: {times}")
    axes.legend(fontsize=8.5)


def _draw_pokes(axes: Axes, result: dict[str, Any]) -> None:
    course = result["bad_course_mm"]
    _lines(axes, course["pokes"], {name: (course["pokes"], course[name]) for name in COURSE_LOOKS})
    axes.set_xlabel("pokes, of all seven arm poses from the first on")
    axes.set_title("As wrong as the paper's: error against pokes")


def _draw_times(axes: Axes, result: dict[str, Any]) -> None:
    course, times = result["bad_course_mm"], result["bad_course_ms"]
    until = {name: ([None if one is None else one / 1e3 for one in times[name]], course[name]) for name in COURSE_LOOKS}
    every = [one for some, _ in until.values() for one in some if one is not None]
    ticks = [at for at in (0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100) if min(every) / 2 <= at <= 2 * max(every)]
    _lines(axes, ticks, until)
    axes.set_xlabel("processor time (s) of all solves until then, each poke solved as it comes")
    axes.set_title("The same against processor time")


def _lines(
    axes: Axes, ticks: Sequence[float], courses: Mapping[str, tuple[Sequence[float | None], Sequence[float | None]]]
) -> None:
    """Draw errors, mm, of each of `COURSE_LOOKS`, where both numbers are known."""
    for name, (colour, words, line) in COURSE_LOOKS.items():
        known = [(at, error) for at, error in zip(*courses[name], strict=True) if at is not None and error is not None]
        axes.plot([at for at, _ in known], [error for _, error in known], line, color=colour, marker="o", label=words)
    _log(axes, _plain(ticks), _plain((0.5, 1, 2, 5, 10, 20)))
    axes.set_ylabel("mean error (mm) of those with an estimate")
    axes.legend(fontsize=8.5)


# ---- run time ----

MARKS: dict[str, tuple[str, str, str]] = {
    "surface": ("*", BLUE, "surface, as shipped"),
    "free": ("*", VERMILION, "free, as shipped"),
    "brute": ("s", SKY, "every triangle, closed form"),
    "facing": ("p", SKY, "those that are pushed"),
    "compiled": ("X", SKY, "pushed ones, compiled"),
    "bounded": ("D", SKY, "every triangle's bound first"),
    "quadprog": ("o", ORANGE, "the paper's way: quadprog"),
    "slsqp": ("o", BLACK, "the paper's way: SLSQP"),
    "modules": ("*", GREEN, "modules, as shipped"),
    "modules-general": ("d", GREEN, "modules, scipy's Levenberg-Marquardt"),
    "modules-per-pose": ("^", GREEN, "modules, poses averaged"),
    "surface-per-pose": ("^", BLUE, "surface, poses averaged"),
    "free-per-pose": ("^", VERMILION, "free, poses averaged"),
    "lstsq": ("v", ORANGE, "numpy lstsq"),
    "normal": ("P", PINK, "normal equations"),
}
"""Mark, colour and words of each method."""
PARTS = {"icub-forearm": "forearm", "whole-body": "whole body"}
GROWTH_AXES = {"triangles": "triangles of the mesh", "taxels": "taxels", "pokes_per_taxel": "pokes per taxel"}
KEY = (
    "Stars: as shipped. Hollow: extrapolated from a sample. Bars: quartiles. Below, dashed lines are the forearm's, "
    "whole lines the whole body's."
)
TIMES_MS = (0.1, 1.0, 10.0, 100.0, 1e3, 1e4, 6e4, 6e5, 3.6e6, 3.6e7, 3.6e8)


def draw_runtime(result: dict[str, Any], rows: Sequence[Measured], figure: Figure) -> None:
    """Draw error against run time of `rows` on both parts above, growth of the cost below, one legend for all."""
    figure.set_size_inches(13.0, 12.0)
    figure.suptitle(f"Error against run time: down is exact, left is fast\n{KEY}")
    above, below = figure.subfigures(2, 1, height_ratios=[1.3, 1.0])
    parts = list(dict.fromkeys(row["part"] for row in rows))[:2]
    for part, axes in zip(parts, above.subplots(1, len(parts), squeeze=False)[0], strict=True):
        _error_against_time(axes, [row for row in rows if row["part"] == part and row["error_mm"] is not None])
    for (name, words), axes in zip(GROWTH_AXES.items(), below.subplots(1, 3), strict=True):
        _growth(axes, result["growth"][name], name, words)
    handles = {label: handle for axes in above.axes for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, fontsize=8.5)


def _error_against_time(axes: Axes, rows: Sequence[Measured]) -> None:
    for row in rows:
        mark, colour, words = MARKS[row["method"]]
        axes.errorbar(
            *_bars_around(row["time_ms"], row["error_mm"]), color=colour, fmt=mark, label=words, linewidth=1.6, capsize=2.5,
            markersize=16 if mark == "*" else 8, markerfacecolor="white" if row["extrapolated_from"] is not None else colour,
        )  # fmt: skip
    times = [row["time_ms"]["median"] for row in rows]
    _log(axes, {at: time_words(at) for at in TIMES_MS if min(times) / 5 <= at <= max(times) * 5})
    axes.yaxis.set_minor_formatter(_minor_tick)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("time to solve all taxels from their contacts")
    axes.set_ylabel("mean error against the truth (mm)")
    first = rows[0]
    size = f"{first['taxels']:,} taxels, {first['triangles']:,} triangles, {first['pokes_per_taxel']} pokes a taxel"
    axes.set_title(f"{PARTS.get(first['part'], first['part'])}: {size}")


def _bars_around(*spreads: Mapping[str, float]) -> tuple[Any, ...]:
    """Return x, y and how far down and up the quartiles of y and of x lie, as `errorbar` takes them."""
    x, y = ([[one["median"] - one["q1"]], [one["q3"] - one["median"]]] for one in spreads)
    return (*(one["median"] for one in spreads), y, x)


def _minor_tick(value: float, _: int) -> str:
    """Name the twos and fives between the tens."""
    return f"{value:g}" if f"{value:.0e}"[0] in "25" else ""


def _growth(axes: Axes, points: Sequence[Measured], name: str, words: str) -> None:
    series: dict[tuple[str, str], list[Measured]] = {}
    for point in points:
        series.setdefault((point["part"], point["method"]), []).append(point)
    for (part, method), own in series.items():
        mark, colour, _ = MARKS[method]
        cost = [point["us_per_taxel"] for point in own]
        if len(own) > 1:
            axes.errorbar(
                [point[name] for point in own], [one["median"] for one in cost],
                yerr=[[one["median"] - one["q1"] for one in cost], [one["q3"] - one["median"] for one in cost]],
                color=colour, marker=mark, markersize=9 if mark == "*" else 4.5, linewidth=1.4, capsize=2,
                linestyle="--" if part == "icub-forearm" else "-",
            )  # fmt: skip
    _log(axes)
    axes.xaxis.set_major_formatter("{x:,.0f}")
    axes.yaxis.set_major_formatter(_cost_tick)
    axes.set_xlabel(words)
    axes.set_ylabel("time per taxel")
    axes.set_title(f"Cost of a taxel against {words}", fontsize=10)


def _cost_tick(value: float, _: int) -> str:
    return f"{value:g} us" if value < 1e3 else time_words(value / 1e3)
