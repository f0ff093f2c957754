"""What a poke must pass to count, and how a finished press ends as a contact or a rejection.

The gates stand in `_objections` in the order in which an operator wants to hear of them: what the devices did, then what the
hand did, then what the skin answered.

A press is summed up at its release (`finish`) and judged from that sum (`judge`), again whenever the tare after it or a dead
channel becomes known. The gates see tared means of the still window alone; single samples are weighed in `press.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Set
from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import RAW, Contact, Outcome, Reason, Rejection
from skincal.contacts.press import Press, StillWindow
from skincal.contacts.tare import TARE_AGE_MAX_S, Tare, force_change, mean_time, wrench_baseline
from skincal.geometry import FloatArray, IntArray, pitch
from skincal.model.scene import ContactSettings, Scene

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
    largest: float = math.nan
    """Raw units above the baseline, of the channel that came nearest to answering; NaN where some answered..."""
    needed: float = math.nan
    """...and what it takes to answer."""
    thresholds: ContactSettings | None = None
    """Those that held as it began; None for the scene's."""


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


def _objections(
    press: FinishedPress, scene: Scene, wrench: FloatArray | None, channels: IntArray, tare_change: float
) -> Iterator[Objection | None]:
    """Yield what each gate has against a press, None where it passes; a gate is tried only where all before it are passed.

    Parameters
    ----------
    wrench : (6,) float, N and N m, tared mean of the still window; None without one
    channels : (k,) those that answered and are used
    tare_change : N; NaN while unknown
    """
    mean, contacts, arm, layout = press.still, press.thresholds or scene.contacts, scene.arm, scene.skin.layout
    size = press.peak if wrench is None else float(np.linalg.norm(wrench[:3]))
    # What the devices did.
    yield _at_most(Reason.SATURATED, press.saturated, 0, "")
    yield _at_most(Reason.READINGS_LOST, press.gap_s, GAP_PERIODS * press.period_s, "s")
    tare_age = (press.end_s if mean is None else mean.time_s) - press.before.end_s
    yield _at_most(Reason.NO_TARE, tare_age, TARE_AGE_MAX_S, "s")
    # 0 of 1 where the arm's pose is unknown.
    yield _at_least(Reason.NO_POSE, int(mean is None or mean.link_from_sensor is not None), 1, "")
    # What the hand did.
    yield _at_most(Reason.ARM_MOVED, press.moved, 0.0 if arm is None else arm.tolerance, "rad")
    yield _at_least(Reason.TOO_SOFT, size, contacts.force_min, "N")
    if mean is None or wrench is None:
        # The press was shorter than a still window, and nothing more is known of it.
        yield Objection(Reason.NOT_STILL, press.end_s - press.start_s, contacts.still_s, "s")
        return
    yield _at_most(Reason.TOO_HARD, size, contacts.force_max, "N")
    yield _at_most(Reason.NOT_STILL, mean.spread, contacts.still_change, "1")
    yield _at_most(Reason.SLID, mean.travel, contacts.slide_max, "m")
    # One contact without a torque has a small |f . m|/|f|^2 (eq. 3).
    yield _at_most(Reason.TWO_CONTACTS, abs(float(pitch(wrench[:3], wrench[3:]))), contacts.pitch_max, "m")
    # What the skin answered.
    yield None if len(channels) else Objection(Reason.NO_TAXEL, press.largest, press.needed, RAW)
    yield _at_most(Reason.TOO_MANY_TAXELS, len(channels), contacts.taxels_max, "")
    if layout is not None and len(channels) >= 2:
        gap = widest_gap(layout.places[channels])
        yield _at_most(Reason.NOT_CONNECTED, gap, contacts.gap_factor * layout.spacing, "m")
    yield _at_most(Reason.TARE_CHANGED, tare_change, contacts.tare_change_max, "N")


def widest_gap(places: FloatArray) -> float:
    """Return the longest step of the shortest tree that joins all places (k, 2), metres: the widest gap between two groups."""
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

    `candidates` are the (c,) channels that are taxels; `noise` is (channels,), raw units, the sd of each channel at rest.
    """
    best = press.best
    channels, responses, largest, needed = np.empty(0, dtype=np.int64), np.empty(0), math.nan, math.nan
    if best is not None:
        response, limit = _response(best, press.tare, scene), answer_limit(press.settings, noise)
        # NaN is not above.
        channels = candidates[(response > limit)[candidates]]
        responses = response[channels]
        if not len(channels):
            largest, needed = _nearest_to_answer(response[candidates], limit[candidates])
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
        largest=largest,
        needed=needed,
        thresholds=None if press.settings == scene.contacts else press.settings,
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


def answer_limit(contacts: ContactSettings, noise: FloatArray) -> FloatArray:
    """Return the response above which each channel answers, raw units: the threshold delta."""
    return np.maximum(contacts.response_min, contacts.response_noises * noise)


def _response(window: StillWindow, tare: Tare, scene: Scene) -> FloatArray:
    """Return the response of each channel above its baseline, (channels,) raw units, the mean of a still window."""
    raw = np.stack([sample.skin for sample in window.samples]).mean(axis=0)
    return scene.skin.polarity * (raw - tare.skin)


def _nearest_to_answer(response: FloatArray, limit: FloatArray) -> tuple[float, float]:
    """Return response and limit of the channel that came nearest to answering, of (c,) raw units each; NaN where unknown."""
    share = np.where(np.isfinite(response), response / limit, -np.inf)
    if not np.isfinite(share).any():
        return math.nan, math.nan
    nearest = int(share.argmax())
    return float(response[nearest]), float(limit[nearest])


def judge(press: FinishedPress, scene: Scene, after: Tare | None, final: bool, unused: Set[int]) -> Outcome:
    """Decide whether a poke counts.

    Parameters
    ----------
    after : the tare after the poke; None while unknown
    final : no other tare will come
    unused : channels whose answers do not count
    """
    used = np.array([int(channel) not in unused for channel in press.channels], dtype=bool)
    mean, channels, tare_change = press.still, press.channels[used], force_change(press.before, after)
    wrench = None if mean is None else mean.wrench - wrench_baseline(press.before, after, mean.time_s)
    objections = _objections(press, scene, wrench, channels, tare_change)
    objection = next((found for found in objections if found is not None), None)
    pose = None if mean is None else mean.link_from_sensor
    # Without a pose the force has no place in the link frame.
    force, moment = (None, None) if wrench is None or pose is None else (wrench[:3], wrench[3:])
    start_s, end_s = (press.start_s, press.end_s) if mean is None else (mean.start_s, mean.end_s)
    name = "" if mean is None else mean.pose
    if objection is not None:
        return Rejection(
            poke=press.number,
            start_s=start_s,
            end_s=end_s,
            reason=objection.reason,
            value=float(objection.value),
            limit=float(objection.limit),
            unit=objection.unit,
            channels=channels,
            final=final,
            force=force,
            moment=moment,
            link_from_sensor=pose,
            pose=name,
        )
    # What passes every gate has a still window and a known pose.
    assert force is not None
    assert moment is not None
    assert pose is not None
    return Contact(
        poke=press.number,
        start_s=start_s,
        end_s=end_s,
        force=force,
        moment=moment,
        channels=channels,
        responses=press.responses[used],
        link_from_sensor=pose,
        pose=name,
        tare_change=tare_change,
        final=final,
    )
