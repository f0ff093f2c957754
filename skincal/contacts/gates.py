"""What a poke must pass to count, one gate a function, and how a finished press ends as a contact or a rejection.

A gate returns None, or the objection with the number that decides. The gates stand in `GATES` in the order in which an operator
wants to hear of them: what the devices did, then what the hand did, then what the skin answered.

A press is summed up at its release (`finish`) and judged from that sum (`judge`), again whenever the tare after it or a dead
channel becomes known. The gates see tared means of the still window alone; single samples are weighed in `press.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import Contact, Outcome, Reason, Rejection
from skincal.contacts.press import Press, StillWindow
from skincal.contacts.tare import TARE_AGE_MAX_S, Tare, force_change, mean_time, wrench_baseline
from skincal.geometry import FloatArray, IntArray, pitch
from skincal.model.scene import Scene

GAP_PERIODS = 3.0
"""Periods of the skin. A longer hole between two samples of a poke means that readings were lost; one missing frame is not."""


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
    """1, relative spread of the force."""
    travel: float
    """m, travel of the force axis."""


@dataclass(frozen=True, slots=True, eq=False)
class FinishedPress:
    """What is kept of a press after its release: enough to judge it again, and small."""

    number: int
    start_s: float
    end_s: float
    period_s: float
    """s, time between samples."""
    peak: float
    """N, largest force."""
    saturated: int
    """Samples with a saturated or invalid reading."""
    gap_s: float
    """s, longest hole between two samples."""
    moved: float
    """rad, how far the arm turned."""
    before: Tare
    still: StillMean | None
    """None where the press was shorter than a still window."""
    channels: IntArray
    """(k,) every channel that answered, ascending."""
    responses: FloatArray
    """(k,) float, raw units above the baseline."""


@dataclass(frozen=True, slots=True, eq=False)
class GatedPoke:
    """A finished press as the gates see it: tared, without the answers of unused channels."""

    press: FinishedPress
    scene: Scene
    force: FloatArray | None
    """(3,) float, N, tared mean of the still window; None without one."""
    moment: FloatArray | None
    """(3,) float, N m."""
    tare_change: float
    """N, difference of the tares before and after; NaN while unknown."""
    channels: IntArray
    """(k,) channels that answered and are used."""


@dataclass(frozen=True, slots=True)
class Objection:
    """Why a poke does not count: the number that decided, the limit it met and their unit."""

    reason: Reason
    value: float
    limit: float
    unit: str


def _at_most(reason: Reason, value: float, limit: float, unit: str) -> Objection | None:
    # NaN, which stands for what is not known yet, is no objection.
    return Objection(reason, value, limit, unit) if value > limit else None


def _at_least(reason: Reason, value: float, limit: float, unit: str) -> Objection | None:
    return Objection(reason, value, limit, unit) if value < limit else None


def not_saturated(poke: GatedPoke) -> Objection | None:
    """Demand that every reading is within the sensor's range."""
    return _at_most(Reason.SATURATED, poke.press.saturated, 0, "")


def no_gap(poke: GatedPoke) -> Objection | None:
    """Demand that no reading is missing."""
    return _at_most(Reason.READINGS_LOST, poke.press.gap_s, GAP_PERIODS * poke.press.period_s, "s")


def tare_fresh(poke: GatedPoke) -> Objection | None:
    """Demand that the tare before the poke is young enough."""
    still = poke.press.still
    age = (poke.press.end_s if still is None else still.time_s) - poke.press.before.end_s
    return _at_most(Reason.NO_TARE, age, TARE_AGE_MAX_S, "s")


def pose_known(poke: GatedPoke) -> Objection | None:
    """Demand that the arm's pose is known: 0 of 1 where it is not."""
    still = poke.press.still
    return _at_least(Reason.NO_POSE, int(still is None or still.link_from_sensor is not None), 1, "")


def arm_still(poke: GatedPoke) -> Objection | None:
    """Demand that the arm keeps its pose."""
    arm = poke.scene.arm
    return _at_most(Reason.ARM_MOVED, poke.press.moved, 0.0 if arm is None else arm.tolerance, "rad")


def hard_enough(poke: GatedPoke) -> Objection | None:
    """Demand that the force reaches the force window, and stays there for the still window."""
    force = poke.press.peak if poke.force is None else float(np.linalg.norm(poke.force))
    return _at_least(Reason.TOO_SOFT, force, poke.scene.contacts.force_min, "N")


def held_long_enough(poke: GatedPoke) -> Objection | None:
    """Demand that the press lasts for a still window."""
    if poke.force is not None:
        return None
    return Objection(Reason.NOT_STILL, poke.press.end_s - poke.press.start_s, poke.scene.contacts.still_s, "s")


def soft_enough(poke: GatedPoke) -> Objection | None:
    """Demand that the force stays below the upper end of the force window."""
    if poke.force is None:
        return None
    return _at_most(Reason.TOO_HARD, float(np.linalg.norm(poke.force)), poke.scene.contacts.force_max, "N")


def still(poke: GatedPoke) -> Objection | None:
    """Demand that the force keeps its size."""
    mean = poke.press.still
    return None if mean is None else _at_most(Reason.NOT_STILL, mean.spread, poke.scene.contacts.still_change, "1")


def not_slid(poke: GatedPoke) -> Objection | None:
    """Demand that the force axis keeps its place."""
    mean = poke.press.still
    return None if mean is None else _at_most(Reason.SLID, mean.travel, poke.scene.contacts.slide_max, "m")


def single_contact(poke: GatedPoke) -> Objection | None:
    """Demand one contact without a torque: |f . m|/|f|^2 is small (eq. 3)."""
    if poke.force is None or poke.moment is None:
        return None
    return _at_most(Reason.TWO_CONTACTS, abs(float(pitch(poke.force, poke.moment))), poke.scene.contacts.pitch_max, "m")


def some_taxel(poke: GatedPoke) -> Objection | None:
    """Demand that at least one taxel answered."""
    return _at_least(Reason.NO_TAXEL, len(poke.channels), 1, "")


def few_taxels(poke: GatedPoke) -> Objection | None:
    """Demand that no more taxels answered than one tip can press."""
    return _at_most(Reason.TOO_MANY_TAXELS, len(poke.channels), poke.scene.contacts.taxels_max, "")


def connected(poke: GatedPoke) -> Objection | None:
    """Demand that the taxels that answered are one group of neighbours; without a layout there is nothing to say."""
    layout = poke.scene.skin.layout
    if layout is None or len(poke.channels) < 2:
        return None
    limit = poke.scene.contacts.gap_factor * layout.spacing
    return _at_most(Reason.NOT_CONNECTED, widest_gap(layout.places[poke.channels]), limit, "m")


def tare_kept(poke: GatedPoke) -> Objection | None:
    """Demand that the sensor stands where it stood before the poke."""
    return _at_most(Reason.TARE_CHANGED, poke.tare_change, poke.scene.contacts.tare_change_max, "N")


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


def widest_gap(places: FloatArray) -> float:
    """Return the longest step of the shortest tree that joins all places: the widest gap between two groups.

    Parameters
    ----------
    places : (k, 2) float, metres, k >= 1
    """
    # Prim's algorithm: the place nearest to the tree joins it, and brings its own distances.
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
    # The arm hardly moves within the window; the pose of its middle stands for all.
    middle = window.poses[len(samples) // 2]
    return StillMean(
        start_s=samples[0].host_s,
        end_s=samples[-1].host_s,
        time_s=mean_time(samples),
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


def judge(press: FinishedPress, scene: Scene, after: Tare | None, final: bool, unused: Set[int]) -> Outcome:
    """Decide whether a poke counts.

    Parameters
    ----------
    after : the tare after the poke; None while unknown
    final : no other tare will come
    unused : channels whose answers do not count
    """
    used = np.array([int(channel) not in unused for channel in press.channels], dtype=bool)
    force, moment = _tared(press, after)
    poke = GatedPoke(press, scene, force, moment, force_change(press.before, after), press.channels[used])
    objection = next((found for gate in GATES if (found := gate(poke)) is not None), None)
    if objection is not None:
        return _rejected(poke, objection, final)
    # What passes every gate has a still window and a known pose.
    assert press.still is not None
    assert press.still.link_from_sensor is not None
    assert force is not None
    assert moment is not None
    return Contact(
        poke=press.number,
        start_s=press.still.start_s,
        end_s=press.still.end_s,
        force=force,
        moment=moment,
        channels=poke.channels,
        responses=press.responses[used],
        link_from_sensor=press.still.link_from_sensor,
        pose=press.still.pose,
        tare_change=poke.tare_change,
        final=final,
    )


def _tared(press: FinishedPress, after: Tare | None) -> tuple[FloatArray | None, FloatArray | None]:
    if press.still is None:
        return None, None
    wrench = press.still.wrench - wrench_baseline(press.before, after, press.still.time_s)
    return wrench[:3], wrench[3:]


def _rejected(poke: GatedPoke, objection: Objection, final: bool) -> Rejection:
    press, mean = poke.press, poke.press.still
    pose = None if mean is None else mean.link_from_sensor
    return Rejection(
        poke=press.number,
        start_s=press.start_s if mean is None else mean.start_s,
        end_s=press.end_s if mean is None else mean.end_s,
        reason=objection.reason,
        value=float(objection.value),
        limit=float(objection.limit),
        unit=objection.unit,
        channels=poke.channels,
        final=final,
        # Without a pose the force has no place in the link frame.
        force=None if pose is None else poke.force,
        moment=None if pose is None else poke.moment,
        link_from_sensor=pose,
        pose="" if mean is None else mean.pose,
    )
