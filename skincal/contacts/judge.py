"""From a finished press and its tares to a contact or a rejection."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

import numpy as np

from skincal.contacts.gates import Evidence, Verdict, first_objection
from skincal.contacts.outcome import Contact, Outcome, Rejection
from skincal.contacts.press import Press, StillWindow
from skincal.contacts.tare import Tare, force_change, wrench_baseline
from skincal.readings import FloatArray, IntArray
from skincal.scene import Scene


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
class Poke:
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


def finish(number: int, press: Press, scene: Scene, candidates: IntArray, noise: FloatArray, period_s: float) -> Poke:
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
    return Poke(
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


def judge(poke: Poke, scene: Scene, after: Tare | None, final: bool, unused: Set[int]) -> Outcome:
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
        Evidence(
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


def _tared(poke: Poke, after: Tare | None) -> tuple[FloatArray | None, FloatArray | None]:
    if poke.still is None:
        return None, None
    wrench = poke.still.wrench - wrench_baseline(poke.before, after, poke.still.time_s)
    return wrench[:3], wrench[3:]


def _reject(
    poke: Poke, verdict: Verdict | None, channels: IntArray, final: bool, force: FloatArray | None, moment: FloatArray | None
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
