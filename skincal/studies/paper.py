"""The paper's experiment done again, and what rigid modules and landmark pokes make of it.

Table I's seven arm poses are poked for their minutes on the simulated forearm with the rig errors of `RigErrors.paper()`, each
seed another rig. Each pose alone (the paper's figure 4), the poses averaged one after another (figure 5), all pokes pooled, and
pooled with 21 and 70 landmark pokes; and how the error falls with pokes and with the processor's time. Beside it a rig that is
only noisy, and what a correction does where one of the landmark pokes is wrong. All of it but the times is seeded; trials run
side by side, and their numbers do not depend on it.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from skincal.studies.paper_course import NAMES as COURSES
from skincal.studies.paper_course import Course, errors_of, run_course, times_of
from skincal.studies.paper_trials import LANDMARKS, MINUTES, Good, Safety, Spread, Trial, run_good, run_safety, run_trial
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from skincal.studies.figure import Figure

PUBLISHED: dict[str, Any] = {
    "source": "Del Prete et al., IROS 2011, section IV; taxels 84",
    "per_pose_mean_mm": {"free": [8.1, 18.5], "surface": [5.2, 19.3]},
    "per_pose_sd_mm": {"free": [4.2, 8.3], "surface": [3.1, 13.1]},
    "averaged_mean_mm": {"free": 7.2, "surface": 6.6},
    "averaged_sd_mm": {"free": 3.0, "surface": 2.9},
    "averaged_largest_mm": {"free": 18.5, "surface": 19.4},
}
"""What the paper's text says; its figures 4 and 5 give no numbers."""
WITHIN = {"free": (8.0, 19.0), "surface": (5.0, 20.0)}
"""mm: where the errors of most poses are to lie, as published."""
MOST = 0.5
"""Share of the poses of all seeds that counts as most."""
SHARE_SAFE = 0.95
"""Share of the rigs to which a correction may do no harm."""
HARM = 1.0
"""A correction does harm where the error with it is more than this times that without."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """What is run."""

    seeds: int = 20
    share: float = 1.0
    """Of the paper's minutes."""
    safety: int = 40
    good: int = 20
    counts: tuple[int, ...] = (14, 28, 42, 84, 126, 168, 252, 504, 1008)
    """Pokes of the good rig."""
    courses: int = 20
    """Rigs with the paper's errors that are followed from poke to poke."""
    steps: tuple[int, ...] = (14, 28, 84, 168, 336, 672)
    """Pokes after which these are looked at, and after all."""
    timed: tuple[int, int] = (3, 10_000)
    """How many of them are timed, and for how many pokes."""


FULL = Sizes()
QUICK = Sizes(seeds=10, safety=8, good=4, counts=(28, 84, 252), courses=3, steps=(28, 84, 168), timed=(1, 168))


def run(quick: bool, progress: Callable[[str], None], sizes: Sizes | None = None) -> dict[str, Any]:
    """Measure; quick with fewer seeds.

    Returns
    -------
    JSON: `mean_mm` (pooled, mean over taxels and seeds, of each method, and of modules with 21 and 70 landmark pokes),
    `good_rig_mm`, `per_pose_mm`, `averaged_mm`, `landmarks`, `safety`, `course_mm` (the good rig after so many pokes),
    `bad_course_mm` and `bad_course_ms` (the paper's rig after so many, and the processor's time until then), `runtime_ms`,
    `published`, `bars`
    """
    sizes = sizes or (QUICK if quick else FULL)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count() or 1, mp_context=context) as pool:
        trials: list[Trial] = []
        for trial in pool.map(partial(run_trial, share=sizes.share), range(1, sizes.seeds + 1)):
            trials.append(trial)
            progress(_told(trial))
        goods = list(pool.map(partial(run_good, counts=sizes.counts), range(1, sizes.good + 1)))
        progress(f"good rig, {len(goods)} seeds")
        safeties = list(pool.map(run_safety, range(1, sizes.safety + 1)))
        progress(f"corrections tried on {len(safeties)} more rigs")
        courses = [work.result() for work in _courses(pool, sizes)]
        progress(f"{len(courses)} rigs followed from poke to poke")
    result = {
        "study": "paper",
        "quick": quick,
        "seeds": len(trials),
        "pokes": trials[0].pokes,
        "minutes": dict(MINUTES),
        "mean_mm": _means(trials),
        "good_rig_mm": _good_means(goods),
        "per_pose_mm": _per_pose(trials),
        "averaged_mm": _averaged(trials),
        "landmarks": [_landmarks(trials, index) for index in range(len(LANDMARKS))],
        "course_mm": _course(goods),
        "bad_course_mm": errors_of(courses),
        "bad_course_ms": times_of(courses),
        "runtime_ms": _runtimes(trials),
        "safety": _safety(safeties),
        "no_error": {
            "before_mm": _mean([one.before for one in goods]),
            "after_mm": _mean([one.after for one in goods]),
            "ratio": _mean([one.after for one in goods]) / _mean([one.before for one in goods]),
        },
        "trials": [asdict(trial) for trial in trials],
        "published": PUBLISHED,
    }
    return {**result, "bars": _bars(result, trials)}


def _courses(pool: ProcessPoolExecutor, sizes: Sizes) -> list[Future[Course]]:
    """Begin to follow rigs from poke to poke."""
    rigs, pokes = sizes.timed
    return [
        pool.submit(run_course, seed, sizes.steps, sizes.share, pokes if seed <= rigs else 0)
        for seed in range(1, sizes.courses + 1)
    ]


def _told(trial: Trial) -> str:
    pooled = ", ".join(f"{method} {one.mean:.1f}" for method, one in trial.pooled.items())
    with_them = ", ".join(f"{one.landmarks} landmark pokes {one.errors['modules'].mean:.2f}" for one in trial.landmarks)
    return f"rig {trial.seed}, {trial.pokes} pokes: {pooled} mm; modules with {with_them} mm"


def _mean(numbers: Sequence[float]) -> float:
    return float(np.mean(numbers))


def _means(trials: Sequence[Trial]) -> dict[str, float]:
    means = {method.value: _mean([one.pooled[method.value].mean for one in trials]) for method in Method}
    for index, per_pose in enumerate(LANDMARKS):
        means[f"modules_{7 * per_pose}"] = _mean([one.landmarks[index].errors["modules"].mean for one in trials])
    return means


def _good_means(goods: Sequence[Good]) -> dict[str, float]:
    return {method.value: _mean([one.course[252][method.value].mean for one in goods]) for method in Method}


def _per_pose(trials: Sequence[Trial]) -> dict[str, Any]:
    """Return mean and sd of the errors of each pose alone, averaged over seeds, and all means."""
    return {
        method.value: {pose: {**_over([one.alone[method.value][pose] for one in trials])} for pose in MINUTES}
        for method in Method
    }


def _over(spreads: Sequence[Spread]) -> dict[str, Any]:
    means = [one.mean for one in spreads]
    return {
        "mean": _mean(means),
        "sd": _mean([one.sd for one in spreads]),
        "largest": float(np.max([one.largest for one in spreads])),
        "low": float(np.percentile(means, 5)),
        "high": float(np.percentile(means, 95)),
        "missing": _mean([one.missing for one in spreads]),
    }


def _averaged(trials: Sequence[Trial]) -> dict[str, Any]:
    return {
        method.value: [_over([one.averaged[method.value][step] for one in trials]) for step in range(len(MINUTES))]
        for method in Method
    }


def _landmarks(trials: Sequence[Trial], index: int) -> dict[str, Any]:
    some = [one.landmarks[index] for one in trials]
    return {
        "landmark_pokes": some[0].landmarks,
        "used_share": _mean([float(one.used) for one in some]),
        "held_out_before_mm": _mean([one.held_before for one in some]),
        "held_out_after_mm": _mean([one.held_after for one in some]),
        "correction_ms": 1e3 * float(np.median([one.seconds for one in some])),
        "mean_mm": {method.value: _mean([one.errors[method.value].mean for one in some]) for method in Method},
        "worst_mm": {method.value: max(one.errors[method.value].mean for one in some) for method in Method},
    }


def _course(goods: Sequence[Good]) -> dict[str, Any]:
    counts = list(goods[0].course)
    return {
        "pokes": counts,
        **{
            method.value: [_finite([one.course[count][method.value].mean for one in goods]) for count in counts]
            for method in Method
        },
        **{
            f"{method.value}_missing": [_mean([one.course[count][method.value].missing for one in goods]) for count in counts]
            for method in Method
        },
    }


def _finite(numbers: Sequence[float]) -> float | None:
    return _mean(numbers) if np.isfinite(numbers).all() else None


def _runtimes(trials: Sequence[Trial]) -> dict[str, float]:
    return {method.value: 1e3 * float(np.median([one.seconds[method.value] for one in trials])) for method in Method}


def _safety(safeties: Sequence[Safety]) -> dict[str, Any]:
    return {
        "seeds": len(safeties),
        "before_mm": _mean([one.before for one in safeties]),
        "after_mm": _mean([one.after for one in safeties]),
        "after_wrong_mm": _mean([one.after_wrong for one in safeties]),
        "no_worse_share": _mean([float(one.after <= HARM * one.before) for one in safeties]),
        "no_worse_wrong_share": _mean([float(one.after_wrong <= HARM * one.before) for one in safeties]),
        "wrong_told_share": _mean([float(one.wrong_told) for one in safeties]),
        "right_told_mean": _mean([one.others_told / 2 for one in safeties]),
    }


def _bars(result: dict[str, Any], trials: Sequence[Trial]) -> dict[str, dict[str, Any]]:
    mean, good, safety = result["mean_mm"], result["good_rig_mm"], result["safety"]
    numbers = {
        "free_within_published_share": (_within(trials, "free"), ">=", MOST),
        "surface_within_published_share": (_within(trials, "surface"), ">=", MOST),
        "modules_over_surface": (mean["modules"] / mean["surface"], "<=", 1.0),
        "good_modules_over_surface": (good["modules"] / good["surface"], "<=", 0.5),
        "modules_21_mm": (mean["modules_21"], "<=", 3.3),
        "modules_70_mm": (mean["modules_70"], "<=", 1.6),
        "no_worse_share": (safety["no_worse_share"], ">=", SHARE_SAFE),
        "no_worse_wrong_share": (safety["no_worse_wrong_share"], ">=", SHARE_SAFE),
        "no_error_ratio": (result["no_error"]["ratio"], "<=", 1.1),
    }
    return {
        name: {"value": value, "sign": sign, "limit": limit, "holds": bool(value <= limit if sign == "<=" else value >= limit)}
        for name, (value, sign, limit) in numbers.items()
    }


def _within(trials: Sequence[Trial], method: str) -> float:
    """Return the share of the poses of all rigs whose mean error lies where the published ones do."""
    low, high = WITHIN[method]
    means = np.array([one.mean for trial in trials for one in trial.alone[method].values()])
    return float(np.mean((means >= low) & (means <= high)))


def summary(result: dict[str, Any]) -> list[str]:
    """Return lines for a person."""
    mean, good = result["mean_mm"], result["good_rig_mm"]
    lines = [
        f"paper's rig, {result['pokes']} pokes in seven poses, {result['seeds']} rigs, pooled: "
        + ", ".join(f"{name} {value:.2f} mm" for name, value in mean.items()),
        "averaged as in the paper: "
        + ", ".join(f"{name} {course[-1]['mean']:.2f} mm" for name, course in result["averaged_mm"].items())
        + "; published 7.2 free, 6.6 surface",
        "good rig, 252 pokes in one pose: " + ", ".join(f"{name} {value:.2f} mm" for name, value in good.items()),
    ]
    for one in result["landmarks"]:
        lines.append(
            f"{one['landmark_pokes']} landmark pokes: held-out miss {one['held_out_before_mm']:.1f} -> "
            f"{one['held_out_after_mm']:.1f} mm, {one['correction_ms']:.0f} ms; "
            + ", ".join(f"{name} {value:.2f} mm" for name, value in one["mean_mm"].items())
        )
    lines.append(_course_line(result))
    safety = result["safety"]
    lines.append(
        f"{safety['seeds']} more rigs, 21 landmark pokes: {safety['before_mm']:.1f} -> {safety['after_mm']:.2f} mm, "
        f"with one poke 10 mm off {safety['after_wrong_mm']:.2f} mm; that poke is named in {safety['wrong_told_share']:.0%}"
    )
    for name, bar in result["bars"].items():
        holds = "holds" if bar["holds"] else "DOES NOT HOLD"
        lines.append(f"{name}: {bar['value']:.3g}, bar {bar['sign']} {bar['limit']:g}: {holds}")
    return lines


def _course_line(result: dict[str, Any]) -> str:
    """Return the errors and processor times after the last poke that is timed."""
    errors, times = result["bad_course_mm"], result["bad_course_ms"]
    last = max(i for i, value in enumerate(times["free"]) if value is not None)
    found = (f"{name} {errors[name][last]:.2f} mm in {times[name][last] / 1e3:.2f} s" for name in COURSES)
    return f"each of {errors['pokes'][last]} pokes solved as it came, of all poses: " + ", ".join(found)


def draw(result: dict[str, Any], figure: Figure) -> None:
    """Draw the paper's figures 4 and 5, and what came since."""
    from skincal.studies.paper_figure import draw_paper

    draw_paper(result, figure)
