"""Pokes needed by the guide, by a printed recipe, and by people without guidance.

Strategies, hand, rig and the errors over a session are in `skincal/simulation/poking_strategies.py`. Everything is seeded.
Courses run in parallel, and their numbers do not depend on it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from skincal.geometry import FloatArray
from skincal.palette import BLACK, BLUE, ORANGE, VERMILION
from skincal.plotting import GREY, Axes, Figure, set_log_scales, tick_labels
from skincal.simulation.example_parts import forearm
from skincal.simulation.poking_strategies import CAREFUL_HABITS, STRATEGIES, Conditions, ErrorCourse, run_course
from skincal.studies.harness import Bench, Findings, Limits, Row, Study, finite
from skincal.taxels.result import Method

STANDARD_CASE = "standard"
POKES_TO_5_MM_MAX, POKES_TO_3_MM_MAX = 87.0, 200.0
"""Pokes of the guide until the free method's mean error is 5 and 3 mm."""
RANDOM_RATIO_MIN, RECIPE_RATIO_MIN = 4.0, 1.3
"""Unguided pokes, and those of the recipe, over the guide's, to 5 mm."""
MAX_GUIDED_OVER_ROUND_ROBIN_ERROR = 1.1
"""Error of the surface method over round-robin's, at any count of pokes from one a taxel on."""
MAX_ERROR_RATIO_WITH_DRIFT = 1.15
"""Error with 0.25 N of drift over that without."""
MAX_FALSELY_FINISHED_SHARE = 0.02
"""Share of the taxels that are called finished and are not."""
COMPARED_COURSES = (
    ("guided", Method.FREE), ("tilt_recipe", Method.FREE), ("guided", Method.SURFACE), ("round_robin", Method.SURFACE),
)  # fmt: skip
"""In all conditions but the standard one: the guide, and the best strategy without measurements."""
SIMULATED_TAXEL_COUNT = 84


@dataclass(frozen=True, slots=True)
class CourseTask:
    """One simulated session of the study: strategy, operator and seed."""

    way: str
    method: Method
    case: str
    conditions: Conditions
    seed: int
    limit: int


@dataclass(frozen=True, slots=True)
class GuidanceSizes:
    """Numbers of seeds and pokes."""

    seeds: int = 20
    """Of the guide in standard conditions."""
    other_seeds: int = 20
    """Of the other strategies."""
    case_seeds: int = 10
    """Of the other conditions."""
    guided_limit: int = 756
    """Pokes of the guide in standard conditions, free method: nearly all it needs."""
    free_limit: int = 252
    """Pokes in the other conditions, free method."""
    surface_limit: int = 1008
    modules_limit: int = 252
    modules_seeds: int = 20
    long: int = 4032
    """Pokes of strategies without measurements, free method."""
    cases: Mapping[str, Conditions] = field(default_factory=dict[str, Conditions])


FULL_SIZES = GuidanceSizes(cases={
    **{f"drift {drift:g} N": Conditions(drift=drift) for drift in (0.1, 0.25, 0.5)},
    "8 % double contacts": Conditions(replace(CAREFUL_HABITS, double_rate=0.08)),
    **{f"aim {1e3 * aim:g} mm": Conditions(replace(CAREFUL_HABITS, aim=aim)) for aim in (0.001, 0.004)},
    **{f"tilt {tilt} degrees": Conditions(replace(CAREFUL_HABITS, cone=float(np.radians(tilt)))) for tilt in (10, 20, 45)},
})  # fmt: skip
QUICK_SIZES = GuidanceSizes(
    seeds=6, other_seeds=2, case_seeds=2, guided_limit=220, free_limit=220, surface_limit=252,
    modules_limit=60, modules_seeds=2, long=1008,
    cases={"drift 0.25 N": Conditions(drift=0.25)},
)  # fmt: skip


def measure(bench: Bench, sizes: GuidanceSizes) -> Findings:
    """Measure.

    Returns
    -------
    JSON: `table` with a row for each strategy, method and conditions; `pokes_to_5mm` and `pokes_to_3mm` in standard conditions
    by the free method, null above `limits`
    """
    kept: dict[tuple[str, str, str], list[ErrorCourse]] = {}

    def row(task: CourseTask, courses: list[ErrorCourse]) -> Row:
        kept[task.case, task.method.value, task.way] = courses
        return _row(task, courses)

    rows = bench.rows(_cases(sizes), _run, row, _row_text)
    free = {row["way"]: row for row in rows if (row["case"], row["method"]) == (STANDARD_CASE, "free")}
    numbers = {
        "table": rows,
        "pokes_to_5mm": {way: row["pokes_to_5mm"]["median"] for way, row in free.items()},
        "pokes_to_3mm": {way: row["pokes_to_3mm"]["median"] for way, row in free.items()},
        "limits": {way: row["limit"] for way, row in free.items()},
    }
    return Findings(numbers, _limits(free, rows, kept))


def _cases(sizes: GuidanceSizes) -> Iterator[tuple[CourseTask, list[CourseTask]]]:
    """Yield each strategy with a method and conditions, and the sessions of its seeds."""

    def seeds(
        way: str, method: Method, count: int, limit: int, case: str = STANDARD_CASE
    ) -> tuple[CourseTask, list[CourseTask]]:
        first = CourseTask(way, method, case, sizes.cases.get(case, Conditions()), 1, limit)
        return first, [replace(first, seed=seed) for seed in range(1, count + 1)]

    yield seeds("guided", Method.FREE, sizes.seeds, sizes.guided_limit)
    for way in STRATEGIES:
        yield seeds(way, Method.FREE, sizes.other_seeds, sizes.long)
    ways = ("guided", "round_robin", "random", "clumped")
    for way in ways:
        # These two are compared to a tenth, which takes more seeds.
        count = sizes.seeds if way in ("guided", "round_robin") else sizes.other_seeds
        yield seeds(way, Method.SURFACE, count, sizes.surface_limit)
    for way in ways:
        yield seeds(way, Method.MODULES, sizes.modules_seeds, sizes.modules_limit)
    for case in sizes.cases:
        for way, method in COMPARED_COURSES:
            yield seeds(way, method, sizes.case_seeds, sizes.free_limit, case)


def _run(task: CourseTask) -> ErrorCourse:
    return run_course(forearm(), task.way, task.method, task.conditions, task.seed, task.limit)


def _row(task: CourseTask, courses: Sequence[ErrorCourse]) -> dict[str, Any]:
    """Summarise courses: medians over seeds with 95 % intervals, and the mean error against pokes."""
    thresholds = {"pokes_to_5mm": (0.005, False), "pokes_to_3mm": (0.003, False), "pokes_to_p95_8mm": (0.008, True)}
    return {
        "case": task.case, "conditions": asdict(task.conditions), "method": task.method.value, "way": task.way,
        "seeds": len(courses), "limit": task.limit,
        **{name: _interval([course.pokes_to(*wanted) for course in courses]) for name, wanted in thresholds.items()},
        "seconds_to_5mm": _interval([_seconds_to(course, 0.005) for course in courses]),
        "pokes": courses[0].pokes.tolist(), "mean_mm": (1e3 * _mean_over_seeds(courses, "mean")).round(4).tolist(),
        "p95_mm": (1e3 * _mean_over_seeds(courses, "p95")).round(4).tolist(),
        "pokes_to_enough": _interval([course.enough for course in courses]),
        "given_up": float(np.mean([course.given_up for course in courses])),
        "done": float(np.mean([course.done for course in courses])),
        "falsely_done_share": float(np.sum([course.falsely for course in courses]) / (len(courses) * SIMULATED_TAXEL_COUNT)),
    }  # fmt: skip


def _mean_over_seeds(courses: Sequence[ErrorCourse], name: str) -> FloatArray:
    return np.mean([getattr(course, name) for course in courses], axis=0)


def _seconds_to(course: ErrorCourse, error: float) -> float:
    pokes = course.pokes_to(error)
    return float("inf") if np.isinf(pokes) else float(course.seconds[np.searchsorted(course.pokes, pokes)])


def _interval(numbers: Sequence[float]) -> dict[str, float | None]:
    """Return the median and its 95 % interval by binomial ranks; `None` if it is not reached."""
    ordered = np.sort(np.array(numbers, dtype=float))
    count = len(ordered)
    reach = 1.96 * np.sqrt(count) / 2.0
    low, high = max(int(np.floor(count / 2 - reach)), 0), min(int(np.ceil(count / 2 + reach)), count - 1)
    middle = float(np.median(ordered)) if np.isfinite(ordered).all() else float(ordered[count // 2])
    return {"median": finite(middle), "low": finite(ordered[low]), "high": finite(ordered[high])}


def _limits(free: Mapping[str, Row], rows: Sequence[Row], kept: Mapping[tuple[str, str, str], list[ErrorCourse]]) -> Limits:
    to = {way: row["pokes_to_5mm"]["median"] for way, row in free.items()}
    guided, to_3 = to["guided"] or np.inf, free["guided"]["pokes_to_3mm"]["median"] or np.inf
    # A strategy that does not get there takes more than its limit.
    times = {way: (to[way] or free[way]["limit"]) / guided for way in ("random", "round_robin", "tilt_recipe")}
    ours, theirs = (kept[STANDARD_CASE, "surface", way] for way in ("guided", "round_robin"))
    late = ours[0].pokes >= SIMULATED_TAXEL_COUNT
    surface = float((_mean_over_seeds(ours, "mean")[late] / _mean_over_seeds(theirs, "mean")[late]).max())
    # At the last poke with drift, over the seeds that both cases have.
    drifting = kept["drift 0.25 N", "free", "guided"]
    still = [course.mean_at(drifting[0].pokes[-1]) for course in kept[STANDARD_CASE, "free", "guided"][: len(drifting)]]
    return {
        "guided_pokes_to_5mm": (guided, "<=", POKES_TO_5_MM_MAX),
        "guided_pokes_to_3mm": (to_3, "<=", POKES_TO_3_MM_MAX),
        "random_over_guided": (times["random"], ">=", RANDOM_RATIO_MIN),
        "round_robin_over_guided": (times["round_robin"], ">=", RANDOM_RATIO_MIN),
        "tilt_recipe_over_guided": (times["tilt_recipe"], ">=", RECIPE_RATIO_MIN),
        "surface_over_round_robin": (surface, "<=", MAX_GUIDED_OVER_ROUND_ROBIN_ERROR),
        "drift_over_none": (
            float(np.mean([course.mean[-1] for course in drifting]) / np.mean(still)), "<=", MAX_ERROR_RATIO_WITH_DRIFT
        ),
        "falsely_done_share": (max(row["falsely_done_share"] for row in rows), "<=", MAX_FALSELY_FINISHED_SHARE),
    }  # fmt: skip


def _row_text(row: Mapping[str, Any]) -> str:
    def pokes(name: str) -> str:
        count = row[name]["median"]
        return f"over {row['limit']}" if count is None else f"{count:.0f}"

    enough = "" if row["pokes_to_enough"]["median"] is None else f"enough after {row['pokes_to_enough']['median']:.0f}, "
    return (
        f"{row['case']}, {row['method']}, {row['way'].replace('_', ' ')}: {pokes('pokes_to_5mm')} pokes to 5 mm, "
        f"{pokes('pokes_to_3mm')} to 3 mm; {enough}{row['mean_mm'][-1]:.2f} mm after {row['pokes'][-1]} ({row['seeds']} seeds)"
    )


def describe(result: Mapping[str, Any]) -> list[str]:
    """Describe each row."""
    return list(map(_row_text, result["table"]))


# ---- figure ----

WAY_LOOKS: dict[str, tuple[str, str, str]] = {
    "guided": (BLUE, "-", "the guide"),
    "tilt_recipe": (ORANGE, "--", "round by round, tilted by a recipe"),
    "round_robin": (VERMILION, "--", "round by round, along the normal"),
    "random": (BLACK, ":", "anywhere, along the normal"),
    "clumped": (GREY, ":", "favourite places, along the normal"),
}
"""Colour, line and label of each strategy; dashed and dotted ones follow no measurement."""
POKE_TICKS = (20, 50, 84, 168, 252, 504, 1008, 2016, 4032)


def draw(result: Mapping[str, Any], figure: Figure) -> None:
    """Draw the standard conditions of all methods, and the other conditions below."""
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
    set_log_scales(axes, tick_labels([at for at in POKE_TICKS if at <= last]), tick_labels((0.5, 1, 2, 3, 5, 10, 20, 50)))
    axes.set(xlim=(20, last), xlabel="pokes", ylabel="mean error (mm); a taxel without estimate counts 60", title=title)
    axes.legend()


def _mean_after(row: Mapping[str, Any], pokes: int) -> float:
    # Interpolated: courses with different limits share no number of pokes.
    counts, means = (np.array(row[name], dtype=float) for name in ("pokes", "mean_mm"))
    return float(np.interp(pokes, counts, means))


def _draw_cases(axes: Axes, rows: Sequence[Mapping[str, Any]], method: str) -> None:
    cases = list(dict.fromkeys(row["case"] for row in rows))
    pokes = min(row["pokes"][-1] for row in rows)
    baseline = "tilt_recipe" if method == "free" else "round_robin"
    for offset, way in ((-0.15, "guided"), (0.15, baseline)):
        colour, _, words = WAY_LOOKS[way]
        own = {row["case"]: row for row in rows if row["way"] == way}
        places = [place + offset for place, case in enumerate(cases) if case in own]
        errors = [_mean_after(own[case], pokes) for case in cases if case in own]
        axes.bar(places, errors, width=0.28, color=colour, label=f"{words}, after {pokes} pokes")
    axes.set_xticks(range(len(cases)), cases, rotation=20, ha="right", fontsize=8.5)
    axes.grid(visible=True, axis="y")
    # Room above the bars for the legend.
    axes.set(ylabel="mean error (mm)", title=f"{method} method in other cases", ylim=(0.0, 1.2 * axes.get_ylim()[1]))
    axes.legend()


THIS_STUDY = Study("guidance", quick=QUICK_SIZES, full=FULL_SIZES, measure=measure, lines=describe, draw=draw)
