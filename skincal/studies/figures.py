"""The studies' figures: the only place of the core that draws, without a window.

Colours are those of the window (`palette`); what matters is said in words or by a mark's shape as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from skincal.model.errors import InputError
from skincal.palette import BLACK, BLUE, GREEN, METHODS, ORANGE, PINK, SKY, VERMILION

Figure: TypeAlias = Any
"""matplotlib.figure.Figure, whose type hints are too loose for strict checks."""
Axes: TypeAlias = Any
"""matplotlib.axes.Axes."""
Measured: TypeAlias = Mapping[str, Any]

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
    "legend.fontsize": 8.5,
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
    # Only now: a study's processes draw nothing.
    import matplotlib as mpl
    from matplotlib import figure as mpl_figure

    matplotlib: Any = mpl
    figures: Any = mpl_figure
    written: list[Path] = []
    with matplotlib.rc_context(STYLE):
        figure: Figure = figures.Figure(figsize=INCHES, layout="constrained")
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


def _one_legend(figure: Figure, panels: Any, **how: Any) -> None:
    """Name below the figure, once each, what is drawn in any of the panels."""
    found = [panel.get_legend_handles_labels() for panel in panels.axes]
    marks = {label: handle for handles, labels in found for handle, label in zip(handles, labels, strict=True)}
    figure.legend(marks.values(), marks.keys(), loc="outside lower center", **how)


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
    solvers = list(dict.fromkeys(case["solver"] for case in result["cases"]))
    rows = max(sum(case["solver"] == solver for case in result["cases"]) for solver in solvers)
    figure.set_size_inches(24.0, 2.0 + 0.19 * rows)
    for panel, solver in zip(figure.subplots(1, len(solvers), squeeze=False)[0], solvers, strict=True):
        of = ([record for record in result[kind] if record["solver"] == solver] for kind in ("cases", "alternatives"))
        _draw_solver(panel, solver, *of)
    _one_legend(figure, figure, ncols=4)
    figure.suptitle(
        f"Error over the bar. Bar: {result['factor']:g} times what the inputs' last digit does ({result['draws']} draws, "
        f"{result['digits']} digits) + {result['of_size']:g} of the answer. "
        "Right of the line digits are lost that the readings have."
    )


def _draw_solver(panel: Axes, solver: str, cases: Sequence[Measured], others: Sequence[Measured]) -> None:
    place = {case["name"]: -row for row, case in enumerate(cases)}
    every = [record["error_over_bound"] for record in (*cases, *others)]
    right = max(10.0, *(share for share in every if share < SHARE_MAX)) * 3.0

    def put(records: Sequence[Measured], **look: Any) -> None:
        shares = [min(max(record["error_over_bound"], SHARE_MIN), right) for record in records]
        panel.scatter(shares, [place[record["name"]] for record in records], **look)

    for method, (mark, colour) in TRY_LOOKS.items():
        look = {"color": colour} if mark == "x" else {"facecolors": "none", "edgecolors": colour}
        if own := [record for record in others if record["method"] == method]:
            put(own, s=22, marker=mark, label=method, linewidths=1.0, **look)
    put(cases, s=26, color=BLUE, label="shipped", zorder=3)
    panel.axvline(1.0, color=BLACK, linewidth=1.2)
    panel.set_yticks(list(place.values()), list(place), fontsize=7.5)
    panel.grid(visible=True)
    panel.set(
        xscale="log", xlim=(SHARE_MIN / 2, right * 2), ylim=(-len(cases), 1), title=f"{solver}: {len(cases)} cases",
        xlabel=f"error over the bar\n(least {SHARE_MIN:g};\nno number at the right end)",
    )  # fmt: skip


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
    axes.set(xlim=(20, last), xlabel="pokes", ylabel="mean error (mm); a taxel without estimate counts 60", title=title)
    axes.legend()


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
    axes.grid(visible=True, axis="y")
    # Room above the bars for the legend.
    axes.set(ylabel="mean error (mm)", title=f"{method} method in other cases", ylim=(0.0, 1.2 * axes.get_ylim()[1]))
    axes.legend()


# ---- paper ----

CORRECTED_WORDS = "modules, rig corrected by 21 landmark pokes"


def draw_paper(result: dict[str, Any], figure: Figure) -> None:
    """Draw six panels, and below them what is made of rigs that are wrong as nobody models it."""
    figure.set_size_inches(13.0, 19.0)
    figure.suptitle(f"The paper's experiment on {result['seeds']} simulated rigs, each as wrong as the paper's")
    top, bottom = figure.subfigures(2, 1, height_ratios=[14.0, 5.0])
    (alone, averaged), (landmarks, good), (pokes, times) = top.subplots(3, 2)
    _draw_alone(alone, result)
    _draw_averaged(averaged, result)
    _draw_landmarks(landmarks, result)
    _draw_good(good, result)
    course = result["bad_course_mm"]
    shown = {name: numbers for name, numbers in course.items() if name not in ("rigs", "pokes")}
    _lines(pokes, course["pokes"], {name: (course["pokes"], numbers) for name, numbers in shown.items()})
    pokes.set(xlabel="pokes, of all seven arm poses from the first on", title="As wrong as the paper's: error against pokes")
    _draw_times(times, shown, result["bad_course_ms"])
    errors, shares = bottom.subplots(1, 2, sharey=True)
    _draw_unmodelled(errors, shares, result["unmodelled"])


def _method_bars(axes: Axes, names: Sequence[str], rows: Mapping[str, Sequence[Measured]], label: str) -> None:
    """Draw bars of each method beside each other; without deviations their height is written above them."""
    for offset, (method, colour) in enumerate(METHODS.items()):
        places = [place + (offset - 1) * 0.26 for place in range(len(names))]
        sds = [row["sd"] for row in rows[method] if "sd" in row]
        error = {"yerr": sds, "error_kw": {"ecolor": GREY, "elinewidth": 1.0}} if sds else {}
        bars = axes.bar(places, [row["mean"] for row in rows[method]], width=0.26, color=colour, label=method, **error)
        if not sds:
            axes.bar_label(bars, fmt="%.1f", fontsize=8.5)
    axes.set_xticks(range(len(names)), names)
    axes.grid(visible=True, axis="y")
    axes.set_ylabel(label)


OF_TAXELS = "error of 84 taxels (mm): mean and sd"


def _draw_alone(axes: Axes, result: dict[str, Any]) -> None:
    minutes: dict[str, float] = result["minutes"]
    rows = {method: [poses[pose] for pose in minutes] for method, poses in result["per_pose_mm"].items()}
    _method_bars(axes, [f"{pose}\n{length:g} min" for pose, length in minutes.items()], rows, OF_TAXELS)
    for place, (method, (low, high)) in zip((6.75, 6.95), result["published"]["per_pose_mean_mm"].items(), strict=True):
        axes.plot([place, place], [low, high], color=METHODS[method], linewidth=5.0, solid_capstyle="butt")
    axes.text(6.85, -0.02, "paper's\nrange", transform=axes.get_xaxis_transform(), ha="center", va="top", fontsize=8.5)
    axes.set_title("Each arm pose alone (figure 4)")
    axes.set_ylim(top=24.0)
    axes.legend(loc="upper left", ncols=3)


def _draw_averaged(axes: Axes, result: dict[str, Any]) -> None:
    names = [f"1 to {last}" if last > 1 else "1" for last in range(1, 8)]
    _method_bars(axes, names, result["averaged_mm"], OF_TAXELS)
    for method, value in result["published"]["averaged_mean_mm"].items():
        axes.axhline(value, color=METHODS[method], linestyle="--", linewidth=1.2, label=f"paper, {method} {value}")
    axes.set(xlabel="arm poses averaged one after another", title="Averaged (figure 5)")
    axes.legend(loc="upper right")


def _draw_landmarks(axes: Axes, result: dict[str, Any]) -> None:
    some: list[Measured] = [{"landmark_pokes": 0, "mean_mm": result["mean_mm"]}, *result["landmarks"]]
    rows = {method: [{"mean": row["mean_mm"][method]} for row in some] for method in METHODS}
    _method_bars(axes, [f"{row['landmark_pokes']} landmark pokes" for row in some], rows, "mean error (mm), all poses pooled")
    axes.set_title("The rig corrected from pokes at landmarks")
    axes.legend()


def _draw_good(axes: Axes, result: dict[str, Any]) -> None:
    course = result["course_mm"]
    _lines(axes, course["pokes"], {method: (course["pokes"], course[method]) for method in METHODS}, least=0.2)
    times = ", ".join(f"{method} {milliseconds:.0f} ms" for method, milliseconds in result["runtime_ms"].items())
    title = f"A rig that is only noisy\nsolving {result['pokes']:,} pokes: {times}"
    axes.set(xlabel="pokes in one arm pose, unguided", title=title)


def _draw_times(axes: Axes, errors: Mapping[str, Sequence[float | None]], times: dict[str, Any]) -> None:
    seconds = {name: [None if ms is None else ms / 1e3 for ms in times[name]] for name in errors}
    known = [number for some in seconds.values() for number in some if number is not None]
    ticks = [at for at in (0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100) if min(known) / 2 <= at <= 2 * max(known)]
    _lines(axes, ticks, {name: (seconds[name], course) for name, course in errors.items()})
    axes.set_xlabel("processor time (s) of all solves until then, each poke solved as it comes")
    axes.set_title("The same against processor time")


def draw_unmodelled(rows: Sequence[Measured], figure: Figure) -> None:
    """Draw what is made of rigs that are wrong as nobody models it, alone."""
    figure.set_size_inches(13.0, 5.0)
    errors, shares = figure.subplots(1, 2, sharey=True)
    _draw_unmodelled(errors, shares, rows)


UNMODELLED_LOOKS = {21: (BLUE, "o"), 70: (VERMILION, "s")}
"""Colour and mark by landmark pokes."""


def _draw_unmodelled(errors: Axes, shares: Axes, rows: Sequence[Measured]) -> None:
    """Draw for each case the predicted beside the true error, and how many taxels are inside."""
    for offset, (count, (colour, mark)) in zip((0.15, -0.15), UNMODELLED_LOOKS.items(), strict=True):
        places = [offset - row for row in range(len(rows))]
        predicted, true = ([row[f"{name}_{count}"] for row in rows] for name in ("predicted", "true_rms"))
        look = {"color": colour, "marker": mark, "s": 28, "zorder": 3}
        errors.hlines(places, predicted, true, color=colour, linewidth=1.0)
        errors.scatter(true, places, label=f"true, {count} landmark pokes", **look)
        errors.scatter(predicted, places, label="predicted", **{**look, "color": "white", "edgecolors": colour})
        shares.scatter([row[f"inside_{count}"] for row in rows], places, label=f"{count} landmark pokes", **look)
    least = min(row[f"predicted_{count}"] for row in rows for count in UNMODELLED_LOOKS)
    most = max(row[f"true_rms_{count}"] for row in rows for count in UNMODELLED_LOOKS)
    ticks = [at for at in (0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if least / 2.5 <= at <= 2.5 * most]
    errors.set_xscale("log")
    errors.set_xticks(ticks, [f"{at:g}" for at in ticks])
    errors.set_xticks([], minor=True)
    errors.set_yticks([-row for row in range(len(rows))], [row["case"] for row in rows])
    errors.set(
        xlabel="error of the taxels (mm rms), modules method", title="Second simulator: what is predicted and what is true"
    )
    shares.axvline(0.95, color=BLACK, linewidth=1.0)
    shares.axvline(0.80, color=GREY, linewidth=1.0, linestyle="--")
    shares.set(
        xlim=(0.0, 1.02), xlabel="share of taxels inside their 95 % ellipsoid", title="Inside: 0.95 is meant, 0.80 is asked"
    )
    for axes in (errors, shares):
        axes.grid(visible=True)
        axes.legend(loc="best")


def _lines(
    axes: Axes,
    ticks: Sequence[float],
    courses: Mapping[str, tuple[Sequence[float | None], Sequence[float | None]]],
    least: float = 0.5,
) -> None:
    """Draw errors, mm, against another number where both are known; `least` is the lowest tick, mm, of the errors."""
    for name, course in courses.items():
        points = [(at, error) for at, error in zip(*course, strict=True) if at is not None and error is not None]
        own = (
            {"color": METHODS[name], "label": name}
            if name in METHODS
            else {"color": BLACK, "label": CORRECTED_WORDS, "linestyle": "--"}
        )
        axes.plot([at for at, _ in points], [error for _, error in points], marker="o", **own)
    _log(axes, _plain(ticks), _plain([error for error in (0.2, 0.5, 1, 2, 5, 10, 20) if least <= error <= 40 * least]))
    axes.set_ylabel("mean error (mm) of those with an estimate")
    axes.legend()


# ---- run time ----


class MarkLook(NamedTuple):
    """How a method is drawn and named."""

    mark: str
    colour: str
    words: str
    """In the figure."""
    label: str
    """In a table."""


LOOKS: dict[str, MarkLook] = {
    "surface": MarkLook("*", METHODS["surface"], "surface, as shipped", "surface, as shipped"),
    "free": MarkLook("*", METHODS["free"], "free, as shipped", "free, as shipped"),
    "brute": MarkLook("s", ORANGE, "every triangle, closed form", "surface: every triangle, closed form"),
    "facing": MarkLook("p", ORANGE, "those that are pushed", "surface: every triangle that is pushed, closed form"),
    "compiled": MarkLook("X", ORANGE, "pushed ones, compiled", "surface: every triangle that is pushed, compiled"),
    "bounded": MarkLook("D", ORANGE, "every triangle's bound first", "surface: every triangle's bound, then closed form"),
    "quadprog": MarkLook("o", PINK, "the paper's way: quadprog", "surface: each triangle by quadprog"),
    "slsqp": MarkLook("o", BLACK, "the paper's way: SLSQP", "surface: each triangle by SLSQP"),
    "modules": MarkLook("*", METHODS["modules"], "modules, as shipped", "modules, as shipped"),
    "modules-general": MarkLook(
        "d", METHODS["modules"], "modules, scipy's Levenberg-Marquardt", "modules: scipy's Levenberg-Marquardt"
    ),
    "modules-per-pose": MarkLook("^", METHODS["modules"], "modules, poses averaged", "modules: each pose alone, averaged"),
    "surface-per-pose": MarkLook("^", METHODS["surface"], "surface, poses averaged", "surface: each pose alone, averaged"),
    "free-per-pose": MarkLook("^", METHODS["free"], "free, poses averaged", "free: each pose alone, averaged"),
    "lstsq": MarkLook("v", SKY, "numpy lstsq", "free: numpy's lstsq for each taxel"),
    "normal": MarkLook("P", SKY, "normal equations", "free: normal equations"),
}
"""By the method's name in JSON."""
PARTS = {"icub-forearm": "forearm", "whole-body": "whole body"}
GROWTH_AXES = {"triangles": "triangles of the mesh", "taxels": "taxels", "pokes_per_taxel": "pokes per taxel"}
KEY = (
    "Stars: as shipped. Hollow: extrapolated from a sample. Bars: quartiles. Below, dashed lines are the forearm's, "
    "whole lines the whole body's."
)
UNITS_MS = {"\N{MICRO SIGN}s": (1e-3, 1e3), "ms": (1.0, 1e3), "s": (1e3, 60.0), "min": (6e4, 60.0), "h": (3.6e6, 1e4)}
"""Milliseconds in each unit of time, and how many of it make one of the next."""
TICKS_MOST = 8
"""Ticks of an axis of time; where there would be more, only tens of a unit have one."""


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
    _one_legend(figure, above, ncols=5)


def _error_against_time(axes: Axes, rows: Sequence[Measured]) -> None:
    for row in rows:
        mark, colour, words, _ = LOOKS[row["method"]]
        (x, across), (y, along) = _around([row["time_ms"]]), _around([row["error_mm"]])
        axes.errorbar(
            x, y, along, across, color=colour, fmt=mark, label=words, linewidth=1.6, capsize=2.5,
            markersize=16 if mark == "*" else 8, markerfacecolor="white" if row["extrapolated_from"] is not None else colour,
        )  # fmt: skip
    times = [row["time_ms"]["median"] for row in rows]
    _log(axes, time_ticks(min(times) / 5, max(times) * 5))
    axes.yaxis.set_minor_formatter(_minor_tick)
    axes.yaxis.set_major_formatter("{x:g}")
    part = PARTS.get(rows[0]["part"], rows[0]["part"])
    size = "{taxels:,} taxels, {triangles:,} triangles, {pokes_per_taxel} pokes a taxel".format_map(rows[0])
    axes.set(xlabel="time to solve all taxels from their contacts", ylabel="mean error against the truth (mm)")
    axes.set_title(f"{part}: {size}")


def _around(spreads: Sequence[Mapping[str, float]]) -> tuple[list[float], list[list[float]]]:
    """Return medians, and how far down and up their quartiles lie, as `errorbar` takes them."""
    ways = [[spread["median"] - spread["q1"] for spread in spreads], [spread["q3"] - spread["median"] for spread in spreads]]
    return [spread["median"] for spread in spreads], ways


def _minor_tick(value: float, _: int) -> str:
    """Name the twos and fives between the tens."""
    return f"{value:g}" if f"{value:.0e}"[0] in "25" else ""


def time_ticks(low: float, high: float) -> dict[float, str]:
    """Return round times between two, milliseconds, each with its words: `1 min`, `20 ms`."""
    every = {
        count * size: (count, f"{count} {unit}")
        for unit, (size, most) in UNITS_MS.items()
        for count in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
        if count < most and low <= count * size <= high
    }
    few = len(every) <= TICKS_MOST
    return {time: words for time, (count, words) in every.items() if few or count in (1, 10, 100, 1000)}


def _growth(axes: Axes, points: Sequence[Measured], name: str, words: str) -> None:
    series: dict[tuple[str, str], list[Measured]] = {}
    for point in points:
        series.setdefault((point["part"], point["method"]), []).append(point)
    for (part, method), own in series.items():
        mark, colour, *_ = LOOKS[method]
        if len(own) > 1:
            costs, ways = _around([point["us_per_taxel"] for point in own])
            axes.errorbar(
                [point[name] for point in own], costs, ways, color=colour, marker=mark, markersize=9 if mark == "*" else 4.5,
                linewidth=1.4, capsize=2, linestyle="--" if part == "icub-forearm" else "-",
            )  # fmt: skip
    _log(axes)
    low, high = axes.get_ylim()
    ticks = time_ticks(1e-3 * low, 1e-3 * high)
    axes.set_yticks([1e3 * time for time in ticks], list(ticks.values()))
    axes.set_yticks([], minor=True)
    axes.xaxis.set_major_formatter("{x:,.0f}")
    axes.set(xlabel=words, ylabel="time per taxel")
    axes.set_title(f"Cost of a taxel against {words}", fontsize=10)
