"""What a poke must pass to count, one gate a function, each with the number that decides.

A gate returns None or a `Verdict`. They stand in `GATES` in the order in which an operator wants to hear of them: what the
devices did, then what the hand did, then what the skin answered.

From a finished press and its tares to a contact or a rejection.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import Contact, Outcome, Reason, Rejection
from skincal.contacts.press import Press, StillWindow
from skincal.contacts.tare import TARE_AGE_MAX_S, Tare, force_change, wrench_baseline
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.geometry.wrench import pitch
from skincal.model.scene import ContactSettings, Scene
from skincal.model.skin import Layout

GAP_PERIODS = 3.0
"""Periods of the skin. A longer hole between two samples of a poke means that readings were lost; one missing frame is not."""


@dataclass(frozen=True, slots=True)
class Objection:
    """Why a poke does not count: the number that decided, the limit it met and their unit."""

    reason: Reason
    value: float
    limit: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class GatedPoke:
    """One poke as the gates see it."""

    settings: ContactSettings
    layout: Layout | None
    turn_max: float
    """rad, tolerance of the arm's joints."""
    period_s: float
    """s, time between samples."""
    hold_s: float
    """s, time from touch to release."""
    peak: float
    """N, largest force."""
    saturated: int
    """Samples with a saturated or invalid reading."""
    gap_s: float
    """s, longest hole between two samples."""
    moved: float
    """rad, how far the arm turned."""
    tare_age: float
    """s, from the tare before to the still window."""
    tare_change: float
    """N, difference of the tares before and after; NaN while unknown."""
    pose_known: bool
    force: FloatArray | None
    """(3,) float, N, tared mean of the still window; None where the poke had no still window."""
    moment: FloatArray | None
    """(3,) float, N m."""
    spread: float
    """1, relative spread of the force in the still window."""
    travel: float
    """m, travel of the force axis in the still window."""
    channels: IntArray
    """(k,) channels that answered."""


def not_saturated(poke: GatedPoke) -> Objection | None:
    """Demand that every reading is within the sensor's range."""
    return Objection(Reason.SATURATED, poke.saturated, 0, "") if poke.saturated else None


def no_gap(poke: GatedPoke) -> Objection | None:
    """Demand that no reading is missing."""
    limit = GAP_PERIODS * poke.period_s
    return Objection(Reason.READINGS_LOST, poke.gap_s, limit, "s") if poke.gap_s > limit else None


def tare_fresh(poke: GatedPoke) -> Objection | None:
    """Demand that the tare before the poke is young enough."""
    return Objection(Reason.NO_TARE, poke.tare_age, TARE_AGE_MAX_S, "s") if poke.tare_age > TARE_AGE_MAX_S else None


def pose_known(poke: GatedPoke) -> Objection | None:
    """Demand that the arm's pose is known: 0 of 1 where it is not."""
    return None if poke.pose_known else Objection(Reason.NO_POSE, 0, 1, "")


def arm_still(poke: GatedPoke) -> Objection | None:
    """Demand that the arm keeps its pose."""
    return Objection(Reason.ARM_MOVED, poke.moved, poke.turn_max, "rad") if poke.moved > poke.turn_max else None


def hard_enough(poke: GatedPoke) -> Objection | None:
    """Demand that the force reaches the force window, and stays there for the still window."""
    force = poke.peak if poke.force is None else float(np.linalg.norm(poke.force))
    limit = poke.settings.force_min
    return Objection(Reason.TOO_SOFT, force, limit, "N") if force < limit else None


def held_long_enough(poke: GatedPoke) -> Objection | None:
    """Demand that the press lasts for a still window."""
    return None if poke.force is not None else Objection(Reason.NOT_STILL, poke.hold_s, poke.settings.still_s, "s")


def soft_enough(poke: GatedPoke) -> Objection | None:
    """Demand that the force stays below the upper end of the force window."""
    if poke.force is None:
        return None
    force, limit = float(np.linalg.norm(poke.force)), poke.settings.force_max
    return Objection(Reason.TOO_HARD, force, limit, "N") if force > limit else None


def still(poke: GatedPoke) -> Objection | None:
    """Demand that the force keeps its size."""
    limit = poke.settings.still_change
    return Objection(Reason.NOT_STILL, poke.spread, limit, "1") if poke.spread > limit else None


def not_slid(poke: GatedPoke) -> Objection | None:
    """Demand that the force axis keeps its place."""
    limit = poke.settings.slide_max
    return Objection(Reason.SLID, poke.travel, limit, "m") if poke.travel > limit else None


def single_contact(poke: GatedPoke) -> Objection | None:
    """Demand one contact without a torque: |f . m|/|f|^2 is small (eq. 3)."""
    if poke.force is None or poke.moment is None:
        return None
    value, limit = abs(float(pitch(poke.force, poke.moment))), poke.settings.pitch_max
    return Objection(Reason.TWO_CONTACTS, value, limit, "m") if value > limit else None


def some_taxel(poke: GatedPoke) -> Objection | None:
    """Demand that at least one taxel answered."""
    return None if len(poke.channels) else Objection(Reason.NO_TAXEL, 0, 1, "")


def few_taxels(poke: GatedPoke) -> Objection | None:
    """Demand that no more taxels answered than one tip can press."""
    count, limit = len(poke.channels), poke.settings.taxels_max
    return Objection(Reason.TOO_MANY_TAXELS, count, limit, "") if count > limit else None


def connected(poke: GatedPoke) -> Objection | None:
    """Demand that the taxels that answered are one group of neighbours; without a layout there is nothing to say."""
    if poke.layout is None or len(poke.channels) < 2:
        return None
    limit = poke.settings.gap_factor * poke.layout.spacing
    value = widest_gap(poke.layout.places[poke.channels])
    return Objection(Reason.NOT_CONNECTED, value, limit, "m") if value > limit else None


def tare_kept(poke: GatedPoke) -> Objection | None:
    """Demand that the sensor stands where it stood before the poke."""
    limit = poke.settings.tare_change_max
    return Objection(Reason.TARE_CHANGED, poke.tare_change, limit, "N") if poke.tare_change > limit else None


GATES: tuple[Callable[[GatedPoke], Objection | None], ...] = (
    not_saturated,
    no_gap,
    tare_fresh,
    pose_known,
    arm_still,
    hard_enough,
    held_long_enough,
    soft_enough,
    still,
    not_slid,
    single_contact,
    some_taxel,
    few_taxels,
    connected,
    tare_kept,
)


def first_objection(poke: GatedPoke) -> Objection | None:
    """Return the verdict of the first gate that the poke does not pass; None if it counts."""
    for gate in GATES:
        verdict = gate(poke)
        if verdict is not None:
            return verdict
    return None


def widest_gap(places: FloatArray) -> float:
    """Return the longest step of the shortest tree that joins all places: the widest gap between two groups.

    Parameters
    ----------
    places : (k, 2) float, metres, k >= 1
    """
    distance = np.linalg.norm(places[0] - places, axis=1)
    inside = np.zeros(len(places), dtype=bool)
    inside[0] = True
    widest = 0.0
    for _ in range(len(places) - 1):
        nearest = int(np.argmin(np.where(inside, np.inf, distance)))
        widest = max(widest, float(distance[nearest]))
        inside[nearest] = True
        distance = np.minimum(distance, np.linalg.norm(places[nearest] - places, axis=1))
    return widest


@dataclass(frozen=True, slots=True, eq=False)
class StillMean:
    """The still window's means, raw."""

    start_s: float
    end_s: float
    time_s: float
    """Mean time of the samples."""
    wrench: FloatArray
    """(6,) float, N and N m, not tared, sensor frame."""
    link_from_sensor: FloatArray | None
    pose: str
    spread: float
    travel: float


@dataclass(frozen=True, slots=True, eq=False)
class FinishedPress:
    """What is kept of a press after its release: enough to judge it again, and small."""

    number: int
    start_s: float
    end_s: float
    period_s: float
    peak: float
    saturated: int
    gap_s: float
    moved: float
    before: Tare
    still: StillMean | None
    channels: IntArray
    """(k,) every channel that answered, ascending."""
    responses: FloatArray
    """(k,) float, raw units above the baseline."""


def finish(number: int, press: Press, scene: Scene, candidates: IntArray, noise: FloatArray, period_s: float) -> FinishedPress:
    """Sum up a press at its release.

    Parameters
    ----------
    number : the poke's number
    candidates : (c,) channels that are taxels
    noise : (channels,) float, raw units, sd of each channel at rest
    """
    best = press.best
    channels, responses = np.empty(0, dtype=np.int64), np.empty(0)
    if best is not None:
        channels, responses = _answers(best, press.tare, scene, candidates, noise)
    return FinishedPress(
        number=number,
        start_s=press.start_s,
        end_s=press.end_s,
        period_s=period_s,
        peak=press.peak,
        saturated=press.saturated,
        gap_s=press.gap_s,
        moved=press.moved,
        before=press.tare,
        still=None if best is None else _means(best),
        channels=channels,
        responses=responses,
    )


def _means(window: StillWindow) -> StillMean:
    samples = window.samples
    middle = window.poses[len(samples) // 2]
    first = samples[0].host_s
    return StillMean(
        start_s=first,
        end_s=samples[-1].host_s,
        time_s=first + sum(sample.host_s - first for sample in samples) / len(samples),
        wrench=np.array([sample.wrench for sample in samples]).mean(axis=0),
        link_from_sensor=middle.link_from_sensor,
        pose=middle.name,
        spread=window.spread,
        travel=window.travel,
    )


def answer_limit(scene: Scene, noise: FloatArray) -> FloatArray:
    """Return the response above which each channel answers, raw units: the threshold delta."""
    return np.maximum(scene.contacts.response_min, scene.contacts.response_noises * noise)


def _answers(
    window: StillWindow, tare: Tare, scene: Scene, candidates: IntArray, noise: FloatArray
) -> tuple[IntArray, FloatArray]:
    raw = np.stack([sample.skin for sample in window.samples]).mean(axis=0)
    response = scene.skin.polarity * (raw - tare.skin)
    above = response > answer_limit(scene, noise)  # NaN is not above
    channels = candidates[above[candidates]]
    return channels, response[channels]


def judge(poke: FinishedPress, scene: Scene, after: Tare | None, final: bool, unused: Set[int]) -> Outcome:
    """Decide whether a poke counts.

    Parameters
    ----------
    after : the tare after the poke; None while unknown
    final : no other tare will come
    unused : channels whose answers do not count
    """
    used = np.array([int(channel) not in unused for channel in poke.channels], dtype=bool)
    channels, responses = poke.channels[used], poke.responses[used]
    force, moment = _tared(poke, after)
    change = force_change(poke.before, after)
    still = poke.still
    verdict = first_objection(
        GatedPoke(
            settings=scene.contacts,
            layout=scene.skin.layout,
            turn_max=0.0 if scene.arm is None else scene.arm.tolerance,
            period_s=poke.period_s,
            hold_s=poke.end_s - poke.start_s,
            peak=poke.peak,
            saturated=poke.saturated,
            gap_s=poke.gap_s,
            moved=poke.moved,
            tare_age=(poke.end_s if still is None else still.time_s) - poke.before.end_s,
            tare_change=change,
            pose_known=still is None or still.link_from_sensor is not None,
            force=force,
            moment=moment,
            spread=0.0 if still is None else still.spread,
            travel=0.0 if still is None else still.travel,
            channels=channels,
        )
    )
    if verdict is not None or still is None or force is None or moment is None or still.link_from_sensor is None:
        return _reject(poke, verdict, channels, final, force, moment)
    return Contact(
        poke=poke.number,
        start_s=still.start_s,
        end_s=still.end_s,
        force=force,
        moment=moment,
        channels=channels,
        responses=responses,
        link_from_sensor=still.link_from_sensor,
        pose=still.pose,
        tare_change=change,
        final=final,
    )


def _tared(poke: FinishedPress, after: Tare | None) -> tuple[FloatArray | None, FloatArray | None]:
    if poke.still is None:
        return None, None
    wrench = poke.still.wrench - wrench_baseline(poke.before, after, poke.still.time_s)
    return wrench[:3], wrench[3:]


def _reject(
    poke: FinishedPress,
    verdict: Objection | None,
    channels: IntArray,
    final: bool,
    force: FloatArray | None,
    moment: FloatArray | None,
) -> Rejection:
    if verdict is None:
        raise AssertionError("a poke without a still window or pose passes no gate")
    start, end = (poke.start_s, poke.end_s) if poke.still is None else (poke.still.start_s, poke.still.end_s)
    pose = None if poke.still is None else poke.still.link_from_sensor
    return Rejection(
        poke=poke.number,
        start_s=start,
        end_s=end,
        reason=verdict.reason,
        value=float(verdict.value),
        limit=float(verdict.limit),
        unit=verdict.unit,
        channels=channels,
        final=final,
        force=None if pose is None else force,
        moment=None if pose is None else moment,
        link_from_sensor=pose,
        pose="" if poke.still is None else poke.still.pose,
    )
