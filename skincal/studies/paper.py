"""Repeat the paper's experiment, and add the modules method and landmark corrections.

Table I's seven arm poses are poked for their minutes on the simulated forearm with the rig errors of `RigErrors.paper()`, each
seed another rig. Each pose alone is the paper's figure 4, the poses averaged one after another are its figure 5. Added are all
pokes pooled, 21 and 70 landmark pokes, one wrong landmark poke, a rig that is only noisy, and the error against pokes. All but
the times is seeded. The program was developed with this simulator; the study `unmodelled` has another.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray
from skincal.methods import estimate_taxels
from skincal.palette import BLACK
from skincal.palette import METHODS as METHOD_HUES
from skincal.plotting import GREY, Axes, Figure, set_log_scales, tick_labels
from skincal.pokes import LandmarkPokes
from skincal.rig.correction_fit import REPORT_LANDMARK_POKES_WITH_TRUST_BELOW, RigRequest, correct_rig
from skincal.simulation.contacts import poke_landmarks
from skincal.simulation.example_parts import forearm
from skincal.simulation.poking_strategies import TABLE_I, poke_rounds, poke_table
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.studies.harness import Bench, Findings, Limits, Study, finite, side_by_side
from skincal.taxels.result import Method

Measured: TypeAlias = dict[str, Any]
"""JSON. Errors are those of `error_statistics`."""
METHODS = tuple(Method)
NAMES = tuple(method.value for method in Method)
LANDMARKS_PER_POSE = (3, 10)
"""Landmark pokes in each of the seven arm poses: 21 and 70."""
WRONG_LANDMARK_POKE_OFFSET_M = 0.010
"""Distance of the wrong landmark poke from its landmark."""
FIRST_LANDMARK_POKE_NUMBER = 100_001
POKES_ON_GOOD_RIG = 252
"""Of a good rig: three a taxel."""
CORRECTED_NAME = "modules_21"
"""Name of the modules method on a rig that 21 landmark pokes correct."""
PUBLISHED_ERRORS: dict[str, Any] = {
    "source": "Del Prete et al., IROS 2011, section IV; taxels 84",
    "per_pose_mean_mm": {"free": [8.1, 18.5], "surface": [5.2, 19.3]},
    "per_pose_sd_mm": {"free": [4.2, 8.3], "surface": [3.1, 13.1]},
    "averaged_mean_mm": {"free": 7.2, "surface": 6.6},
    "averaged_sd_mm": {"free": 3.0, "surface": 2.9},
    "averaged_largest_mm": {"free": 18.5, "surface": 19.4},
}
"""From the paper's text; its figures 4 and 5 give no numbers."""
PUBLISHED_RANGE_MM = {"free": (8.0, 19.0), "surface": (5.0, 20.0)}
"""Errors of most poses, as published."""
MAJORITY_SHARE_OF_POSES = 0.5
"""Share of the poses of all seeds that counts as most."""
MIN_SHARE_OF_RIGS_NOT_WORSENED = 0.95
"""Share of the rigs whose error is no larger with a correction."""


@dataclass(frozen=True, slots=True)
class PaperSizes:
    """Numbers of rigs and pokes."""

    seeds: int = 20
    share: float = 1.0
    """Of the paper's minutes."""
    safety: int = 40
    good: int = 20
    counts: tuple[int, ...] = (14, 28, 42, 84, 126, 168, 252, 504, 1008)
    """Pokes of the good rig."""
    courses: int = 20
    """Rigs with the paper's errors that are evaluated after each of `steps` pokes, and after all."""
    steps: tuple[int, ...] = (14, 28, 84, 168, 336, 672)


FULL_SIZES = PaperSizes()
QUICK_SIZES = PaperSizes(seeds=10, safety=8, good=4, counts=(28, 84, 252), courses=3, steps=(28, 84, 168))


def measure(bench: Bench, sizes: PaperSizes) -> Findings:
    """Measure.

    Returns
    -------
    JSON: `mean_mm` (pooled, mean over taxels and seeds, of each method, and of modules with 21 and 70 landmark pokes),
    `good_rig_mm`, `per_pose_mm`, `averaged_mm`, `landmarks`, `safety`, `course_mm` (the good rig after so many pokes),
    `bad_course_mm` (the paper's rig after so many), `runtime_ms`, `published`
    """
    trials: list[Measured] = []
    for trial in bench.each(partial(run_trial, share=sizes.share), range(1, sizes.seeds + 1)):
        trials.append(trial)
        bench.say(_trial_text(trial))
    goods = list(bench.each(partial(run_good, counts=sizes.counts), range(1, sizes.good + 1)))
    bench.say(f"good rig, {len(goods)} seeds")
    safeties = list(bench.each(run_safety, range(1, sizes.safety + 1)))
    bench.say(f"corrections tried on {len(safeties)} more rigs")
    follow = partial(run_course, counts=sizes.steps, share=sizes.share)
    courses = list(bench.each(follow, range(1, sizes.courses + 1)))
    bench.say(f"{len(courses)} rigs followed from poke to poke")
    rig, good = side_by_side(trials), side_by_side(goods)
    pooled = {**rig["pooled"], **{f"modules_{some['landmarks'][0]}": some["errors"]["modules"] for some in rig["landmarks"]}}
    before, after = _mean(good["before"]), _mean(good["after"])
    result = {
        "seeds": len(trials),
        "pokes": trials[0]["pokes"],
        "minutes": dict(TABLE_I),
        "mean_mm": {name: _mean(errors["mean"]) for name, errors in pooled.items()},
        "good_rig_mm": {name: _mean(good["course"][POKES_ON_GOOD_RIG][name]["mean"]) for name in NAMES},
        "per_pose_mm": {name: {pose: _mean_errors(errors) for pose, errors in of.items()} for name, of in rig["alone"].items()},
        "averaged_mm": {name: [_mean_errors(errors) for errors in steps] for name, steps in rig["averaged"].items()},
        "landmarks": [_landmarks(some) for some in rig["landmarks"]],
        "course_mm": _good_course(good["course"]),
        "bad_course_mm": _course_means(courses),
        "runtime_ms": {name: 1e3 * float(np.median(seconds)) for name, seconds in rig["seconds"].items()},
        "safety": {"seeds": len(safeties), **{name: _mean(numbers) for name, numbers in side_by_side(safeties).items()}},
        "no_error": {"before_mm": before, "after_mm": after, "ratio": after / before},
        "trials": trials,
        "published": PUBLISHED_ERRORS,
    }
    return Findings(result, _limits(result, rig["alone"]))


# ---- one rig; results are JSON, errors by method ----


def error_statistics(off: FloatArray) -> dict[str, float]:
    """Return mean, standard deviation and maximum (mm) of errors (n,), metres, and the number of missing ones (NaN)."""
    known = 1e3 * off[np.isfinite(off)]
    of = (known.mean(), known.std(), known.max()) if len(known) else (np.nan, np.nan, np.nan)
    return {**dict(zip(("mean", "sd", "largest"), map(float, of), strict=True)), "missing": len(off) - len(known)}


def solve_positions(contacts: Sequence[Contact], rig: Rig, methods: Sequence[Method] = METHODS) -> dict[str, FloatArray]:
    """Solve for the positions (n, 3), metres, of the rig's taxels by each method; NaN without an estimate."""
    part, nowhere = forearm(), np.full(3, np.nan)
    channels = rig.channels.tolist()
    found = estimate_taxels(contacts, channels, methods, part.scene.noise, part.surface, model=part.model)
    return {
        method.value: np.array([nowhere if estimate.position is None else estimate.position for estimate in estimates.values()])
        for method, estimates in found.items()
    }


def _off(positions: FloatArray, rig: Rig) -> dict[str, float]:
    return error_statistics(np.linalg.norm(positions - rig.places, axis=1))


def _errors(contacts: Sequence[Contact], rig: Rig, methods: Sequence[Method] = METHODS) -> Measured:
    return {name: _off(found, rig) for name, found in solve_positions(contacts, rig, methods).items()}


def _modules_error_mm(contacts: Sequence[Contact], rig: Rig) -> float:
    return _errors(contacts, rig, [Method.MODULES])["modules"]["mean"]


def _make_rig(seed: int, stream: int, errors: RigErrors) -> tuple[Rig, np.random.Generator]:
    """Make a rig, and the random generator of its pokes."""
    part = forearm()
    rig = Rig(part.scene, part.surface, errors, np.random.default_rng([seed, stream]))
    return rig, np.random.default_rng([seed, 2000 + stream])


def _poke_landmarks(
    rig: Rig, rng: np.random.Generator, each: int = LANDMARKS_PER_POSE[0], off: FloatArray | None = None
) -> LandmarkPokes:
    return poke_landmarks(rig, forearm().scene.landmarks, each, rng, FIRST_LANDMARK_POKE_NUMBER, off)


def _poke_all_poses(rig: Rig, each: int, rng: np.random.Generator) -> list[Contact]:
    return [contact for k, pose in enumerate(TABLE_I) for contact in poke_rounds(rig, pose, each, rng, 1 + k * each)]


def corrected(rig: Rig, contacts: Sequence[Contact], known: LandmarkPokes, methods: Sequence[Method] = METHODS) -> Measured:
    """Correct a rig by landmark pokes, and solve the pokes on its skin.

    Returns
    -------
    `held_before` and `held_after`, mm: misses of held-out landmark pokes; `doubted` landmark pokes; `errors`, those without a
    correction if it is not used; `seconds` of processor time of the correction alone
    """
    begin = time.process_time()
    answer = correct_rig(RigRequest(forearm().scene, forearm().surface, contacts, known))
    seconds = time.process_time() - begin
    right = contacts
    if answer.used and answer.correction is not None:
        right = [answer.correction.corrected(contact) for contact in contacts]
    return {
        "landmarks": len(known), "used": answer.used, "held_before": 1e3 * answer.before, "held_after": 1e3 * answer.after,
        "doubted": tuple(poke for poke, trust in answer.trust.items() if trust < REPORT_LANDMARK_POKES_WITH_TRUST_BELOW),
        "errors": _errors(right, rig, methods), "seconds": seconds,
    }  # fmt: skip


def run_trial(seed: int, share: float = 1.0) -> Measured:
    """Poke a rig with the paper's errors for `share` of the paper's minutes.

    Returns
    -------
    errors of each arm pose `alone`, `averaged` over the poses so far (IV-B), `pooled`; `landmarks`, see `corrected`; `seconds`
    of processor time of a solve of all contacts
    """
    rig, rng = _make_rig(seed, 11, RigErrors.paper())
    of_pose = poke_table(rig, share, rng)
    places = {pose: solve_positions(contacts, rig) for pose, contacts in of_pose.items()}
    every = [contact for contacts in of_pose.values() for contact in contacts]
    pooled, seconds = dict[str, dict[str, float]](), dict[str, float]()
    for method in METHODS:
        begin = time.process_time()
        found = solve_positions(every, rig, [method])[method.value]
        seconds[method.value] = time.process_time() - begin
        pooled[method.value] = _off(found, rig)
    known = [_poke_landmarks(rig, rng, each) for each in LANDMARKS_PER_POSE]
    return {
        "seed": seed, "pokes": len(every),
        "alone": {name: {pose: _off(found[name], rig) for pose, found in places.items()} for name in NAMES},
        "averaged": {name: _averaged([found[name] for found in places.values()], rig) for name in NAMES},
        "pooled": pooled, "landmarks": [corrected(rig, every, some) for some in known], "seconds": seconds,
    }  # fmt: skip


def _averaged(places: Sequence[FloatArray], rig: Rig) -> list[dict[str, float]]:
    """Average the positions of the arm poses so far. Return the errors after each of them."""
    sums, counts = np.zeros_like(rig.places), np.zeros((len(rig.places), 1))
    course: list[dict[str, float]] = []
    for found in places:
        known = np.isfinite(found).all(axis=1, keepdims=True)
        sums, counts = sums + np.where(known, found, 0.0), counts + known
        with np.errstate(invalid="ignore"):
            course.append(_off(sums / np.where(counts > 0, counts, np.nan), rig))
    return course


def run_course(seed: int, counts: Sequence[int], share: float) -> Measured:
    """Solve the rig of `run_trial` after each of `counts` pokes and after all, in an order that mixes the arm poses.

    Returns
    -------
    `pokes`; `errors` by method and `CORRECTED_NAME`: mm, the mean of the taxels that have an estimate
    """
    rig, rng = _make_rig(seed, 11, RigErrors.paper())
    every = [contact for some in poke_table(rig, share, rng).values() for contact in some]
    known = _poke_landmarks(rig, rng)
    order: list[int] = np.random.default_rng([seed, 2014]).permutation(len(every)).tolist()
    mixed = [every[i] for i in order]
    steps = [*(count for count in counts if count < len(mixed)), len(mixed)]
    plain = side_by_side([_errors(mixed[:count], rig) for count in steps])
    right = side_by_side([corrected(rig, mixed[:count], known, [Method.MODULES]) for count in steps])
    errors = {name: plain[name]["mean"] for name in NAMES} | {CORRECTED_NAME: right["errors"]["modules"]["mean"]}
    return {"pokes": steps, "errors": errors}


def run_safety(seed: int, pokes: int = 84) -> dict[str, float]:
    """Correct a rig with the paper's errors by 21 landmark pokes, once all right, once with a wrong one.

    Returns
    -------
    the modules' mean errors, mm; whether they are no worse; the numbers of wrong and right landmark pokes that are doubted
    """
    rig, rng = _make_rig(seed, 12, RigErrors.paper())
    contacts = _poke_all_poses(rig, pokes, rng)
    wrong = np.zeros(len(TABLE_I) * LANDMARKS_PER_POSE[0])
    bad = int(rng.integers(len(wrong)))
    wrong[bad] = WRONG_LANDMARK_POKE_OFFSET_M
    before = _modules_error_mm(contacts, rig)
    clean, mixed = (corrected(rig, contacts, _poke_landmarks(rig, rng, off=off), [Method.MODULES]) for off in (None, wrong))
    after, after_wrong = (answer["errors"]["modules"]["mean"] for answer in (clean, mixed))
    others = len(clean["doubted"]) + len(set(mixed["doubted"]) - {FIRST_LANDMARK_POKE_NUMBER + bad})
    return {
        "before_mm": before, "after_mm": after, "after_wrong_mm": after_wrong,
        "no_worse_share": float(after <= before), "no_worse_wrong_share": float(after_wrong <= before),
        "wrong_told_share": float(FIRST_LANDMARK_POKE_NUMBER + bad in mixed["doubted"]), "right_told_mean": others / 2,
    }  # fmt: skip


def run_good(seed: int, counts: Sequence[int]) -> Measured:
    """Poke a rig with sensor noise alone in one arm pose; then in all of them, with landmarks.

    Returns
    -------
    `course`, the errors after so many pokes; the modules' mean errors, mm, over all arm poses `before` and `after` a correction
    """
    rig, rng = _make_rig(seed, 13, RigErrors.noise())
    contacts = poke_rounds(rig, "2", max(*counts, POKES_ON_GOOD_RIG), rng, 1)
    course = {count: _errors(contacts[:count], rig) for count in counts}
    every = _poke_all_poses(rig, POKES_ON_GOOD_RIG // len(TABLE_I), rng)
    before = _modules_error_mm(every, rig)
    after = corrected(rig, every, _poke_landmarks(rig, rng), [Method.MODULES])["errors"]["modules"]["mean"]
    return {"course": course, "before": before, "after": after}


# ---- means over rigs, limits, text ----


def _trial_text(trial: Measured) -> str:
    pooled = ", ".join(f"{method} {errors['mean']:.1f}" for method, errors in trial["pooled"].items())
    with_them = [f"{rig['landmarks']} landmark pokes {rig['errors']['modules']['mean']:.2f}" for rig in trial["landmarks"]]
    return f"rig {trial['seed']}, {trial['pokes']} pokes: {pooled} mm; modules with {', '.join(with_them)} mm"


def _mean(numbers: Sequence[float]) -> float:
    return float(np.mean(numbers))


def _mean_errors(errors: Measured) -> dict[str, float]:
    low, high = (float(np.percentile(errors["mean"], share)) for share in (5, 95))
    return {
        "mean": _mean(errors["mean"]), "sd": _mean(errors["sd"]), "largest": max(errors["largest"]), "low": low, "high": high,
        "missing": _mean(errors["missing"]),
    }  # fmt: skip


def _landmarks(some: Measured) -> Measured:
    means = {name: errors["mean"] for name, errors in some["errors"].items()}
    return {
        "landmark_pokes": some["landmarks"][0],
        "used_share": _mean(some["used"]),
        "held_out_before_mm": _mean(some["held_before"]),
        "held_out_after_mm": _mean(some["held_after"]),
        "correction_ms": 1e3 * float(np.median(some["seconds"])),
        "mean_mm": {name: _mean(own) for name, own in means.items()},
        "worst_mm": {name: max(own) for name, own in means.items()},
    }


def _good_course(course: Mapping[int, Measured]) -> Measured:
    found: dict[str, Any] = {"pokes": list(course)}
    for name in NAMES:
        found[name] = [finite(_mean(errors[name]["mean"])) for errors in course.values()]
        found[f"{name}_missing"] = [_mean(errors[name]["missing"]) for errors in course.values()]
    return found


def _course_means(courses: Sequence[Measured]) -> Measured:
    means = {name: np.mean([own["errors"][name] for own in courses], axis=0).tolist() for name in (*NAMES, CORRECTED_NAME)}
    finite_means = {name: [finite(value) for value in own] for name, own in means.items()}
    return {"rigs": len(courses), "pokes": courses[0]["pokes"], **finite_means}


def _limits(result: Measured, alone: Measured) -> Limits:
    mean, good, safety = result["mean_mm"], result["good_rig_mm"], result["safety"]
    # The share of the poses of all rigs whose mean error lies where the published ones do.
    within = {
        name: _mean([low <= mean <= high for errors in alone[name].values() for mean in errors["mean"]])
        for name, (low, high) in PUBLISHED_RANGE_MM.items()
    }
    return {
        "free_within_published_share": (within["free"], ">=", MAJORITY_SHARE_OF_POSES),
        "surface_within_published_share": (within["surface"], ">=", MAJORITY_SHARE_OF_POSES),
        "modules_over_surface": (mean["modules"] / mean["surface"], "<=", 1.0),
        "good_modules_over_surface": (good["modules"] / good["surface"], "<=", 0.5),
        "modules_21_mm": (mean["modules_21"], "<=", 3.3),
        "modules_70_mm": (mean["modules_70"], "<=", 1.6),
        "no_worse_share": (safety["no_worse_share"], ">=", MIN_SHARE_OF_RIGS_NOT_WORSENED),
        "no_worse_wrong_share": (safety["no_worse_wrong_share"], ">=", MIN_SHARE_OF_RIGS_NOT_WORSENED),
        "no_error_ratio": (result["no_error"]["ratio"], "<=", 1.1),
    }  # fmt: skip


def describe(result: Mapping[str, Any]) -> list[str]:
    """Describe the errors."""

    def mm(values: Mapping[str, float]) -> str:
        return ", ".join(f"{name} {value:.2f} mm" for name, value in values.items())

    safety, last = result["safety"], {name: course[-1]["mean"] for name, course in result["averaged_mm"].items()}
    return [
        f"paper's rig, {result['pokes']} pokes in seven poses, {result['seeds']} rigs, pooled: {mm(result['mean_mm'])}",
        f"averaged as in the paper: {mm(last)}; published 7.2 free, 6.6 surface",
        f"good rig, 252 pokes in one pose: {mm(result['good_rig_mm'])}",
        *(
            f"{row['landmark_pokes']} landmark pokes: held-out miss {row['held_out_before_mm']:.1f} -> "
            f"{row['held_out_after_mm']:.1f} mm, {row['correction_ms']:.0f} ms; {mm(row['mean_mm'])}"
            for row in result["landmarks"]
        ),
        f"{safety['seeds']} more rigs, 21 landmark pokes: {safety['before_mm']:.1f} -> {safety['after_mm']:.2f} mm, "
        f"with one poke 10 mm off {safety['after_wrong_mm']:.2f} mm; that poke is named in {safety['wrong_told_share']:.0%}",
    ]


# ---- figure ----

CORRECTED_LABEL = "modules, rig corrected by 21 landmark pokes"


def draw(result: Mapping[str, Any], figure: Figure) -> None:
    """Draw five panels."""
    figure.set_size_inches(13.0, 14.0)
    figure.suptitle(f"The paper's experiment on {result['seeds']} simulated rigs, each as wrong as the paper's")
    (alone, averaged), (landmarks, good), (pokes, unused) = figure.subplots(3, 2)
    unused.remove()
    _draw_alone(alone, result)
    _draw_averaged(averaged, result)
    _draw_landmarks(landmarks, result)
    _draw_good(good, result)
    course = result["bad_course_mm"]
    _draw_lines(pokes, course["pokes"], {name: course[name] for name in (*NAMES, CORRECTED_NAME)})
    pokes.set(xlabel="pokes, of all seven arm poses from the first on", title="As wrong as the paper's: error against pokes")


def _method_bars(axes: Axes, names: Sequence[str], rows: Mapping[str, Sequence[Measured]], label: str) -> None:
    """Draw grouped bars of the methods. Bars without deviations have their height above them."""
    for offset, (method, colour) in enumerate(METHOD_HUES.items()):
        places = [place + (offset - 1) * 0.26 for place in range(len(names))]
        sds = [row["sd"] for row in rows[method] if "sd" in row]
        error = {"yerr": sds, "error_kw": {"ecolor": GREY, "elinewidth": 1.0}} if sds else {}
        bars = axes.bar(places, [row["mean"] for row in rows[method]], width=0.26, color=colour, label=method, **error)
        if not sds:
            axes.bar_label(bars, fmt="%.1f", fontsize=8.5)
    axes.set_xticks(range(len(names)), names)
    axes.grid(visible=True, axis="y")
    axes.set_ylabel(label)


ERROR_LABEL = "error of 84 taxels (mm): mean and sd"


def _draw_alone(axes: Axes, result: Mapping[str, Any]) -> None:
    minutes: dict[str, float] = result["minutes"]
    rows = {method: [poses[pose] for pose in minutes] for method, poses in result["per_pose_mm"].items()}
    _method_bars(axes, [f"{pose}\n{length:g} min" for pose, length in minutes.items()], rows, ERROR_LABEL)
    for place, (method, (low, high)) in zip((6.75, 6.95), result["published"]["per_pose_mean_mm"].items(), strict=True):
        axes.plot([place, place], [low, high], color=METHOD_HUES[method], linewidth=5.0, solid_capstyle="butt")
    axes.text(6.85, -0.02, "paper's\nrange", transform=axes.get_xaxis_transform(), ha="center", va="top", fontsize=8.5)
    axes.set_title("Each arm pose alone (figure 4)")
    axes.set_ylim(0.0, 1.15 * axes.get_ylim()[1])
    axes.legend(loc="upper left", ncols=3)


def _draw_averaged(axes: Axes, result: Mapping[str, Any]) -> None:
    names = [f"1 to {last}" if last > 1 else "1" for last in range(1, 8)]
    _method_bars(axes, names, result["averaged_mm"], ERROR_LABEL)
    for method, value in result["published"]["averaged_mean_mm"].items():
        axes.axhline(value, color=METHOD_HUES[method], linestyle="--", linewidth=1.2, label=f"paper, {method} {value}")
    axes.set(xlabel="arm poses averaged one after another", title="Averaged (figure 5)")
    axes.legend(loc="upper right")


def _draw_landmarks(axes: Axes, result: Mapping[str, Any]) -> None:
    some: list[Measured] = [{"landmark_pokes": 0, "mean_mm": result["mean_mm"]}, *result["landmarks"]]
    rows = {method: [{"mean": row["mean_mm"][method]} for row in some] for method in METHOD_HUES}
    _method_bars(axes, [f"{row['landmark_pokes']} landmark pokes" for row in some], rows, "mean error (mm), all poses pooled")
    axes.set_title("The rig corrected from pokes at landmarks")
    axes.legend()


def _draw_good(axes: Axes, result: Mapping[str, Any]) -> None:
    course = result["course_mm"]
    _draw_lines(axes, course["pokes"], {method: course[method] for method in METHOD_HUES}, least=0.2)
    times = ", ".join(f"{method} {milliseconds:.0f} ms" for method, milliseconds in result["runtime_ms"].items())
    title = f"A rig that is only noisy\nsolving {result['pokes']:,} pokes: {times}"
    axes.set(xlabel="pokes in one arm pose, unguided", title=title)


def _draw_lines(axes: Axes, pokes: Sequence[float], courses: Mapping[str, Sequence[float | None]], least: float = 0.5) -> None:
    """Draw known errors, mm, against pokes; `least` is the lowest tick, mm."""
    for name, course in courses.items():
        points = [(at, error) for at, error in zip(pokes, course, strict=True) if error is not None]
        own = (
            {"color": METHOD_HUES[name], "label": name}
            if name in METHOD_HUES
            else {"color": BLACK, "label": CORRECTED_LABEL, "linestyle": "--"}
        )
        axes.plot([at for at, _ in points], [error for _, error in points], marker="o", **own)
    set_log_scales(
        axes, tick_labels(pokes), tick_labels([error for error in (0.2, 0.5, 1, 2, 5, 10, 20) if least <= error <= 40 * least])
    )
    axes.set_ylabel("mean error (mm) of those with an estimate")
    axes.legend()


THIS_STUDY = Study("paper", quick=QUICK_SIZES, full=FULL_SIZES, measure=measure, lines=describe, draw=draw)
