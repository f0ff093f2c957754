"""What a poke must pass to count, one gate a function, each with the number that decides.

A gate returns None or a `Verdict`. They stand in `GATES` in the order in which an operator wants to hear of them: what the
devices did, then what the hand did, then what the skin answered.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import Reason
from skincal.contacts.tare import TARE_AGE_MAX_S
from skincal.readings import FloatArray, IntArray
from skincal.scene import ContactSettings
from skincal.skin import Layout
from skincal.wrench import pitch

GAP_PERIODS = 3.0
"""Periods of the skin. A longer hole between two samples of a poke means that readings were lost; one missing frame is not."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Why a poke does not count: the number that decided, the limit it met and their unit."""

    reason: Reason
    value: float
    limit: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
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


def not_saturated(poke: Evidence) -> Verdict | None:
    """Demand that every reading is within the sensor's range."""
    return Verdict(Reason.SATURATED, poke.saturated, 0, "") if poke.saturated else None


def no_gap(poke: Evidence) -> Verdict | None:
    """Demand that no reading is missing."""
    limit = GAP_PERIODS * poke.period_s
    return Verdict(Reason.READINGS_LOST, poke.gap_s, limit, "s") if poke.gap_s > limit else None


def tare_fresh(poke: Evidence) -> Verdict | None:
    """Demand that the tare before the poke is young enough."""
    return Verdict(Reason.NO_TARE, poke.tare_age, TARE_AGE_MAX_S, "s") if poke.tare_age > TARE_AGE_MAX_S else None


def pose_known(poke: Evidence) -> Verdict | None:
    """Demand that the arm's pose is known: 0 of 1 where it is not."""
    return None if poke.pose_known else Verdict(Reason.NO_POSE, 0, 1, "")


def arm_still(poke: Evidence) -> Verdict | None:
    """Demand that the arm keeps its pose."""
    return Verdict(Reason.ARM_MOVED, poke.moved, poke.turn_max, "rad") if poke.moved > poke.turn_max else None


def hard_enough(poke: Evidence) -> Verdict | None:
    """Demand that the force reaches the force window, and stays there for the still window."""
    force = poke.peak if poke.force is None else float(np.linalg.norm(poke.force))
    limit = poke.settings.force_min
    return Verdict(Reason.TOO_SOFT, force, limit, "N") if force < limit else None


def held_long_enough(poke: Evidence) -> Verdict | None:
    """Demand that the press lasts for a still window."""
    return None if poke.force is not None else Verdict(Reason.NOT_STILL, poke.hold_s, poke.settings.still_s, "s")


def soft_enough(poke: Evidence) -> Verdict | None:
    """Demand that the force stays below the upper end of the force window."""
    if poke.force is None:
        return None
    force, limit = float(np.linalg.norm(poke.force)), poke.settings.force_max
    return Verdict(Reason.TOO_HARD, force, limit, "N") if force > limit else None


def still(poke: Evidence) -> Verdict | None:
    """Demand that the force keeps its size."""
    limit = poke.settings.still_change
    return Verdict(Reason.NOT_STILL, poke.spread, limit, "1") if poke.spread > limit else None


def not_slid(poke: Evidence) -> Verdict | None:
    """Demand that the force axis keeps its place."""
    limit = poke.settings.slide_max
    return Verdict(Reason.SLID, poke.travel, limit, "m") if poke.travel > limit else None


def single_contact(poke: Evidence) -> Verdict | None:
    """Demand one contact without a torque: |f . m|/|f|^2 is small (eq. 3)."""
    if poke.force is None or poke.moment is None:
        return None
    value, limit = abs(float(pitch(poke.force, poke.moment))), poke.settings.pitch_max
    return Verdict(Reason.TWO_CONTACTS, value, limit, "m") if value > limit else None


def some_taxel(poke: Evidence) -> Verdict | None:
    """Demand that at least one taxel answered."""
    return None if len(poke.channels) else Verdict(Reason.NO_TAXEL, 0, 1, "")


def few_taxels(poke: Evidence) -> Verdict | None:
    """Demand that no more taxels answered than one tip can press."""
    count, limit = len(poke.channels), poke.settings.taxels_max
    return Verdict(Reason.TOO_MANY_TAXELS, count, limit, "") if count > limit else None


def connected(poke: Evidence) -> Verdict | None:
    """Demand that the taxels that answered are one group of neighbours; without a layout there is nothing to say."""
    if poke.layout is None or len(poke.channels) < 2:
        return None
    limit = poke.settings.gap_factor * poke.layout.spacing
    value = widest_gap(poke.layout.places[poke.channels])
    return Verdict(Reason.NOT_CONNECTED, value, limit, "m") if value > limit else None


def tare_kept(poke: Evidence) -> Verdict | None:
    """Demand that the sensor stands where it stood before the poke."""
    limit = poke.settings.tare_change_max
    return Verdict(Reason.TARE_CHANGED, poke.tare_change, limit, "N") if poke.tare_change > limit else None


GATES: tuple[Callable[[Evidence], Verdict | None], ...] = (
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


def first_objection(poke: Evidence) -> Verdict | None:
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
