"""The tip's position as a measurement: error against the number of pokes with force axes, with tips, and with both.

A simulated forearm is poked at random. The tip is reported with an error of 0.3 mm (a tracker), 1 mm or 5 mm (a robot), in a
frame that the program does not know. The rig has sensor noise only, or the paper's errors, uncorrected or corrected by pokes
at landmarks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, rotations
from skincal.palette import BLACK, BLUE, GREEN, VERMILION
from skincal.plotting import Figure
from skincal.rig.correction_fit import RigRequest, correct_rig
from skincal.rig.tip_frame import TipPokes, TipState
from skincal.session.session import Session
from skincal.simulation.contacts import TipTracker, poke_landmarks, simulate_contacts, unguided
from skincal.simulation.example_parts import ExamplePart, forearm
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.studies.error_numbers import error_numbers
from skincal.studies.harness import Bench, Findings, Study
from skincal.taxels.result import Estimate, Method

RIG_CASES: Mapping[str, tuple[Callable[[], RigErrors], int]] = {
    "good": (RigErrors.noise, 0),
    "paper": (RigErrors.paper, 0),
    "corrected": (RigErrors.paper, 3),
}
"""Errors, and landmark pokes in each arm pose; the third is the paper's rig with a correction."""
TIP_SDS_MM: tuple[float | None, ...] = (None, 0.3, 1.0, 5.0)
"""`None` for force axes alone."""
GOAL_ERROR_MM = 3.0
TAXELS_WITH_ESTIMATE_MIN_SHARE = 0.95
"""Share of the taxels that must have an estimate before a mean error counts."""
COVERAGE_MIN = 0.90
"""Share of the taxels inside their 95 % regions, on the good rig."""
MEAN_TIP = "tip"
"""Name of the mean of a taxel's tips, without its force axes, among the methods."""


@dataclass(frozen=True, slots=True)
class TipSizes:
    """Numbers of sessions and pokes."""

    seeds: int = 8
    pokes_per_taxel: int = 6
    counts: tuple[int, ...] = (42, 84, 126, 168, 252, 336, 504)
    """Numbers of pokes after which a session is solved."""
    cases: tuple[tuple[str, float | None], ...] = tuple((rig, sd_mm) for rig in RIG_CASES for sd_mm in TIP_SDS_MM)
    """Rigs and tip errors, mm."""


class Task(NamedTuple):
    """One simulated session: rig, error of the tip and seed."""

    rig: str
    sd_mm: float | None
    seed: int
    sizes: TipSizes


def measure(bench: Bench, sizes: TipSizes) -> Findings:
    """Measure.

    Returns
    -------
    JSON: `seeds`, `tip` (a row for each rig and tip error, see `_row`)
    """
    seeds = range(1, 1 + sizes.seeds)
    cases = [(Task(*case, 1, sizes), [Task(*case, seed, sizes) for seed in seeds]) for case in sizes.cases]
    rows = bench.rows(cases, run_session, _row, _row_text)
    return Findings({"seeds": sizes.seeds, "tip": rows}, tip_limits(rows))


def run_session(task: Task) -> dict[int, dict[str, dict[str, Any]]]:
    """Simulate a session and solve it after each of its counts of pokes: the numbers of `error_numbers` by count and method."""
    part = forearm()
    errors, landmark_pokes = RIG_CASES[task.rig]
    simulated = Rig(part.scene, part.surface, errors(), np.random.default_rng(task.seed))
    rng = np.random.default_rng((task.seed, 1))
    contacts = _poke(simulated, task, rng)
    session, found = Session(part.scene, part.surface), dict[int, dict[str, dict[str, Any]]]()
    if landmark_pokes:
        contacts = _corrected(simulated, part, contacts, session, landmark_pokes, rng)
    done = 0
    for count in task.sizes.counts:
        while done < len(contacts) and contacts[done].poke <= count:
            session.add(contacts[done])
            done += 1
        snapshot = session.snapshot()
        places = np.array([simulated.places[simulated.row_of(channel)] for channel in session.channels])
        own: dict[str, Sequence[Estimate]] = {method.value: snapshot.estimates[method] for method in Method}
        found[count] = {name: error_numbers(estimates, places) for name, estimates in own.items()}
        frame = snapshot.tip_frame
        if frame is not None and frame.state is TipState.USED:
            tips, _ = frame.places(TipPokes.of_contacts(contacts[:done]))
            found[count][MEAN_TIP] = _mean_tips(contacts[:done], tips, session.channels, places)
    return found


def _corrected(
    rig: Rig, part: ExamplePart, contacts: Sequence[Contact], session: Session, per_pose: int, rng: np.random.Generator
) -> list[Contact]:
    """Correct contacts by landmark pokes, and tell the session."""
    known = poke_landmarks(rig, part.scene.landmarks, per_pose, rng, len(contacts) + 1000)
    answer = correct_rig(RigRequest(part.scene, part.surface, contacts, known))
    if answer.correction is None:
        return list(contacts)
    session.assume_corrected(answer.correction)
    return [answer.correction.corrected(contact) for contact in contacts]


def _poke(rig: Rig, task: Task, rng: np.random.Generator) -> list[Contact]:
    poses, contacts, first = list(rig.arm_poses), list[Contact](), 1
    fixed = np.eye(4)
    fixed[:3, :3], fixed[:3, 3] = rotations(rng.standard_normal((1, 3)))[0], rng.uniform(-1.0, 1.0, 3)
    for turn in range(task.sizes.pokes_per_taxel):
        pose, pokes = poses[turn % len(poses)], unguided(rig, 1, rng)
        made = simulate_contacts(rig, pokes, rng, pose, first)
        if task.sd_mm is not None:
            made = TipTracker(fixed, task.sd_mm * 1e-3).add_tips(made, pokes, rig.arm_pose(pose), rng, first)
        contacts += made
        first += len(pokes)
    return contacts


def _mean_tips(contacts: Sequence[Contact], tips: FloatArray, channels: Sequence[int], places: FloatArray) -> dict[str, Any]:
    """Compute the error of the mean of each taxel's tips, weighted by its answers."""
    row_of = {channel: row for row, channel in enumerate(channels)}
    sums = np.zeros((len(channels), 4))
    for contact, tip in zip(contacts, tips, strict=True):
        shares = contact.responses / contact.responses.max()
        for channel, share in zip(contact.channels.tolist(), (shares**2).tolist(), strict=True):
            sums[row_of[channel]] += share * np.append(tip, 1.0)
    known = sums[:, 3] > 0.0
    off = np.linalg.norm(sums[known, :3] / sums[known, 3:] - places[known], axis=1)
    return {"mean": float(1e3 * off.mean()), "missing": int((~known).sum())}


def _row(case: Task, found: Sequence[Mapping[int, Mapping[str, Mapping[str, Any]]]]) -> dict[str, Any]:
    """Average over seeds.

    Returns
    -------
    JSON: `rig`, `tip_sd_mm`, and for each method lists over `pokes`: `mean_mm` (`None` while fewer than
    `TAXELS_WITH_ESTIMATE_MIN_SHARE` of the taxels are known), `inside`; and `pokes_to_goal`, `None` if it is not reached
    """
    counts, methods = case.sizes.counts, dict[str, Any]()
    for name in (*(method.value for method in Method), MEAN_TIP):
        numbers = [[session[count].get(name) for session in found] for count in counts]
        means = [_mean_if_known(each) for each in numbers]
        reached = [count for count, mean in zip(counts, means, strict=True) if mean is not None and mean <= GOAL_ERROR_MM]
        inside = [[one["inside"] for one in each if one is not None and "inside" in one] for each in numbers]
        methods[name] = {
            "mean_mm": means,
            "inside": [float(np.nanmean(each)) if each and np.isfinite(each).any() else None for each in inside],
            "pokes_to_goal": min(reached, default=None),
        }
    return {"rig": case.rig, "tip_sd_mm": case.sd_mm, "pokes": list(counts), "methods": methods}


def _mean_if_known(found: Sequence[Mapping[str, Any] | None]) -> float | None:
    taxels = len(forearm().channels)
    known = [each for each in found if each is not None and each["missing"] <= (1.0 - TAXELS_WITH_ESTIMATE_MIN_SHARE) * taxels]
    return float(np.mean([each["mean"] for each in known])) if len(known) == len(found) else None


def tip_limits(rows: Sequence[Mapping[str, Any]]) -> dict[str, tuple[float, str, float]]:
    """List the limits for `check_limits`: pokes to the goal with a tip of 1 mm, and coverage on the good rig."""
    by_case = {(row["rig"], row["tip_sd_mm"]): row["methods"] for row in rows}
    limits: dict[str, tuple[float, str, float]] = {}
    alone, both = (by_case["good", sd]["free"]["pokes_to_goal"] or np.inf for sd in (None, 1.0))
    limits["tip_pokes_to_3mm_share"] = (both / alone if np.isfinite(alone) else both / (2 * rows[0]["pokes"][-1]), "<=", 0.5)
    covered = [
        share for (rig, sd), methods in by_case.items() if rig == "good" and sd is not None
        for method in Method for share in methods[method.value]["inside"] if share is not None
    ]  # fmt: skip
    limits["tip_inside"] = (min(covered), ">=", COVERAGE_MIN)
    return limits


def describe(result: Mapping[str, Any]) -> list[str]:
    """Describe each case."""
    counts = ", ".join(map(str, result["tip"][0]["pokes"]))
    head = f"forearm, {result['seeds']} sessions of each kind, mean error of the free method after {counts} pokes:"
    return [head, *map(_row_text, result["tip"])]


def _row_text(row: Mapping[str, Any]) -> str:
    tip = "axes alone" if row["tip_sd_mm"] is None else f"tip {row['tip_sd_mm']:g} mm"
    free = row["methods"]["free"]
    errors = " ".join("-" if mean is None else f"{mean:.1f}" for mean in free["mean_mm"])
    inside = " ".join("-" if share is None else f"{share:.2f}" for share in free["inside"])
    return f"  {row['rig']} rig, {tip}: {errors} mm; inside {inside}; 3 mm after {free['pokes_to_goal'] or 'more'} pokes"


TIP_COLOURS = dict(zip(TIP_SDS_MM, (BLACK, GREEN, BLUE, VERMILION), strict=True))


def draw(result: Mapping[str, Any], figure: Figure) -> None:
    """Draw the free method's error against the number of pokes, with and without tips; a panel for each rig."""
    panels = figure.subplots(1, len(RIG_CASES), sharey=True)
    for axes, rig in zip(panels, RIG_CASES, strict=True):
        for row in (row for row in result["tip"] if row["rig"] == rig):
            sd = row["tip_sd_mm"]
            label = "force axes alone" if sd is None else f"with a tip of {sd:g} mm"
            for name, style in (("free", "-"), (MEAN_TIP, ":")):
                means = [np.nan if mean is None else mean for mean in row["methods"][name]["mean_mm"]]
                if np.isfinite(means).any():
                    shown = label if name == "free" else f"tip of {sd:g} mm alone"
                    axes.plot(row["pokes"], means, style, color=TIP_COLOURS[sd], marker="o", markersize=3, label=shown)
        axes.axhline(GOAL_ERROR_MM, color="#BBBBBB", linewidth=0.8)
        axes.set_yscale("log")
        axes.set_title(f"{rig} rig, free method")
        axes.set_xlabel("pokes")
        axes.grid(visible=True)
    panels[0].set_ylabel("mean error, mm")
    panels[0].legend()


THIS_STUDY = Study("tip", quick=TipSizes(seeds=2), full=TipSizes(), measure=measure, lines=describe, draw=draw)
