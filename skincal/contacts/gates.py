"""Gates that a poke must pass to count, and the verdict on a finished press.

The gates in `_failed_gates` are in the order in which an operator needs to hear of them: first the devices, then the hand, then
the skin. They see tared means of the still window only; `press.py` looks at single samples. A press is summarized at its
release (`finish`) and judged from the summary (`judge`). It is judged again when the tare after it or a dead channel is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from skincal.contacts.outcome import RAW_UNIT, Contact, Outcome, Reason, Rejection
from skincal.contacts.press import FinishedPress, Press, taxels_at_top
from skincal.contacts.skin_drift import SkinDrift
from skincal.contacts.tare import TARE_AGE_MAX_S, Tare, force_change, window_length, wrench_baseline
from skincal.geometry import FloatArray, IntArray, pitch
from skincal.model.scene import ContactSettings, Scene

MAX_SAMPLE_GAP_IN_SKIN_PERIODS = 3.0
"""Periods of the skin. A longer gap between two samples of a poke means lost readings; one missing frame does not."""


class _GateFailure(NamedTuple):
    reason: Reason
    value: float
    limit: float
    unit: str


def _at_most(reason: Reason, value: float, limit: float, unit: str) -> _GateFailure | None:
    # NaN is a value that is not known yet: it passes.
    return _GateFailure(reason, value, limit, unit) if value > limit else None


def _at_least(reason: Reason, value: float, limit: float, unit: str) -> _GateFailure | None:
    return _GateFailure(reason, value, limit, unit) if value < limit else None


def _failed_gates(
    press: FinishedPress, scene: Scene, wrench: FloatArray | None, channels: IntArray, tare_change: float
) -> Iterator[_GateFailure | None]:
    """Yield the failure of each gate, `None` if the press passes it. A gate may rely on those before it.

    Parameters
    ----------
    wrench : (6,) float, N and N m, tared mean of the still window; `None` without one
    channels : (k,) channels that answered and are used
    tare_change : N; NaN while unknown
    """
    mean, contacts = press.still, press.thresholds or scene.contacts
    size = press.peak if wrench is None else float(np.linalg.norm(wrench[:3]))
    # Devices.
    yield _at_most(Reason.SATURATED, press.saturated, 0, "")
    yield _at_most(Reason.READINGS_LOST, press.gap_s, MAX_SAMPLE_GAP_IN_SKIN_PERIODS * press.period_s, "s")
    tare_age = (press.end_s if mean is None else mean.time_s) - press.before.end_s
    yield _at_most(Reason.NO_TARE, tare_age, TARE_AGE_MAX_S, "s")
    yield _at_least(Reason.NO_POSE, int(mean is None or mean.link_from_sensor is not None), 1, "")
    if press.late is not None:
        yield _GateFailure(Reason.NO_POSE, press.late.age_s, press.late.max_age_s, "s")
    # Hand.
    yield _at_most(Reason.ARM_MOVED, press.moved, largest_turn_during_poke(scene) or 0.0, "rad")
    yield _at_least(Reason.TOO_SOFT, size, contacts.force_min, "N")
    if mean is None or wrench is None:
        # Nothing more is known of it.
        yield _no_still_window(press, contacts)
        return
    yield _at_most(Reason.TOO_HARD, size, contacts.force_max, "N")
    yield _at_most(Reason.NOT_STILL, mean.spread, contacts.still_change, "1")
    # A tip that slips along the skin.
    yield _at_most(Reason.SLID, mean.slide, contacts.slide_max, "m")
    # One contact without a torque has a small |f . m|/|f|^2 (eq. 3).
    yield _at_most(Reason.TWO_CONTACTS, abs(float(pitch(wrench[:3], wrench[3:]))), contacts.pitch_max, "m")
    yield from _failed_gates_of_skin(press, scene, channels)
    yield _at_most(Reason.TARE_CHANGED, tare_change, contacts.tare_change_max, "N")


def _no_still_window(press: FinishedPress, contacts: ContactSettings) -> _GateFailure:
    """Say why a press has no still window: poses of the tool lack, it is too short, or too few samples follow each other."""
    held_s = press.end_s - press.start_s
    if press.unplaced:
        return _GateFailure(Reason.NO_POSE, press.unplaced, 0, "")
    if held_s < contacts.still_s:
        return _GateFailure(Reason.NOT_STILL, held_s, contacts.still_s, "s")
    return _GateFailure(Reason.NOT_STILL, press.in_row, window_length(contacts.still_s, press.period_s), "")


def _failed_gates_of_skin(press: FinishedPress, scene: Scene, channels: IntArray) -> Iterator[_GateFailure | None]:
    contacts, layout = press.thresholds or scene.contacts, scene.skin.layout
    yield None if len(channels) else _GateFailure(Reason.NO_TAXEL, press.largest, press.needed, RAW_UNIT)
    yield _at_most(Reason.TOO_MANY_TAXELS, len(channels), contacts.taxels_max, "")
    if layout is not None and len(channels) >= 2:
        gap = widest_gap(layout.places[channels])
        yield _at_most(Reason.NOT_CONNECTED, gap, contacts.gap_factor * layout.spacing, "m")


def _failed_gates_of_touch(press: FinishedPress, scene: Scene, channels: IntArray) -> Iterator[_GateFailure | None]:
    """Yield the failures of a press without a force sensor, as `_failed_gates`."""
    mean, contacts = press.still, press.thresholds or scene.contacts
    yield _at_most(Reason.READINGS_LOST, press.gap_s, MAX_SAMPLE_GAP_IN_SKIN_PERIODS * press.period_s, "s")
    rest_age = (press.end_s if mean is None else mean.time_s) - press.before.end_s
    yield _at_most(Reason.NO_TARE, rest_age, TARE_AGE_MAX_S, "s")
    if press.late is not None:
        yield _GateFailure(Reason.NO_POSE, press.late.age_s, press.late.max_age_s, "s")
    if mean is None:
        yield _no_still_window(press, contacts)
        return
    yield _at_most(Reason.SLID, mean.slide, contacts.slide_max, "m")
    yield from _failed_gates_of_skin(press, scene, channels)


def largest_turn_during_poke(scene: Scene) -> float | None:
    """Find the largest turn of the arm, or of a tool with a sensor, during a poke, rad; `None` if neither turns."""
    moving = scene.arm or (scene.tool if scene.has_sensor else None)
    return None if moving is None else moving.turn_max


def widest_gap(places: FloatArray) -> float:
    """Compute the widest gap between two groups of positions (k, 2), metres: the longest edge of their minimal tree."""
    # Prim's algorithm.
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


def finish(number: int, press: Press, scene: Scene, noise: FloatArray, period_s: float, drift: SkinDrift) -> FinishedPress:
    """Summarize a press at its release; `noise` is (channels,), raw units, the sd of each channel at rest."""
    best = press.best
    finished = FinishedPress(
        number=number,
        start_s=press.start_s,
        end_s=press.end_s,
        period_s=period_s,
        peak=press.peak,
        saturated=press.saturated,
        gap_s=press.gap_s,
        in_row=press.in_row,
        unplaced=press.unplaced,
        moved=press.moved,
        before=press.tare,
        still=best,
        channels=np.empty(0, dtype=np.int64),
        responses=np.empty(0),
        thresholds=None if press.settings == scene.contacts else press.settings,
        late=press.late,
        skin=press.best_skin,
        limit=np.empty(0) if best is None else answer_limit(press.settings, noise),
        drifted=bool(drift.rate.any()),
    )
    if best is None:
        return finished
    finished = drift.with_first_answers(finished, best.time_s)
    top, at_top = taxels_at_top(drift.answers.watched(press.best_frames), finished.channels, scene.skin.polarity)
    return replace(finished, top=top, at_top=at_top)


def answer_limit(contacts: ContactSettings, noise: FloatArray) -> FloatArray:
    """Compute the response above which each channel answers, raw units: the threshold delta."""
    return np.maximum(contacts.response_min, contacts.response_noises * noise)


def judge(press: FinishedPress, scene: Scene, after: Tare | None, final: bool, ignored: Set[int]) -> Outcome:
    """Decide whether a poke counts.

    Parameters
    ----------
    after : the tare after the poke; `None` while unknown
    final : no other tare will come
    ignored : channels whose answers do not count
    """
    used = np.array([int(channel) not in ignored for channel in press.channels], dtype=bool)
    share = (press.thresholds or scene.contacts).response_share
    if share and used.any():
        used &= press.responses >= share * press.responses[used].max()
    mean, channels, tare_change = press.still, press.channels[used], force_change(press.before, after)
    wrench = None if mean is None else mean.wrench - wrench_baseline(press.before, after, mean.time_s)
    gates = (
        _failed_gates(press, scene, wrench, channels, tare_change)
        if scene.has_sensor
        else _failed_gates_of_touch(press, scene, channels)
    )
    failure = next((found for found in gates if found is not None), None)
    pose = None if mean is None else mean.link_from_sensor
    # Without a pose the force cannot be placed in the link frame.
    force, moment = (None, None) if wrench is None or pose is None else (wrench[:3], wrench[3:])
    common: dict[str, Any] = {
        "poke": press.number,
        "start_s": press.start_s if mean is None else mean.start_s,
        "end_s": press.end_s if mean is None else mean.end_s,
        "channels": channels,
        "final": final,
        "force": force,
        "moment": moment,
        "link_from_sensor": pose,
        "pose": (scene.tool.arm_pose if scene.tool is not None else "") if mean is None else mean.pose,
    }
    if failure is None:
        tip = None if mean is None else mean.tip
        common["vectors"] = None if press.vectors is None else press.vectors[used]
        if scene.tool is not None and scene.has_sensor and mean is not None:
            common["rest_wrench"] = wrench_baseline(press.before, after, mean.time_s)
        return Contact(**common, responses=press.responses[used], tare_change=tare_change, tip=tip)
    value, limit = float(failure.value), float(failure.limit)
    return Rejection(**common, reason=failure.reason, value=value, limit=limit, unit=failure.unit)
