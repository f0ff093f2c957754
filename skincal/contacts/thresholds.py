"""How the newest pokes stand against each threshold: what each had, and which were rejected by it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import Contact, Outcome, Reason, Rejection
from skincal.geometry import pitch

NEWEST = 10
"""Pokes that are looked at: a minute of work, in which the hand and the tool stay the same."""
_DECIDES = {
    Reason.TOO_SOFT: "force_min",
    Reason.TOO_HARD: "force_max",
    Reason.NOT_STILL: "still_change",
    Reason.SLID: "slide_max",
    Reason.TWO_CONTACTS: "pitch_max",
    Reason.TOO_MANY_TAXELS: "taxels_max",
    Reason.TARE_CHANGED: "tare_change_max",
    Reason.NO_TAXEL: "response_min",
}
"""Of the reasons whose number is in the threshold's own unit; taxels far apart are rejected by a multiple of it."""


@dataclass(frozen=True, slots=True)
class ThresholdUse:
    """The newest pokes against one threshold."""

    pokes: int
    """How many were looked at."""
    rejected: int
    """How many of them it rejected."""
    values: tuple[float, ...]
    """What pokes had, in the threshold's unit, in their order; of some it is not known."""


def rejected_by(outcome: Outcome) -> str:
    """Return the name of the threshold that rejected a poke, as in `ContactSettings`; empty where none did."""
    if not isinstance(outcome, Rejection):
        return ""
    if outcome.reason is Reason.NOT_STILL and outcome.unit == "s":
        return "still_s"
    return "gap_factor" if outcome.reason is Reason.NOT_CONNECTED else _DECIDES.get(outcome.reason, "")


def threshold_uses(outcomes: Sequence[Outcome], names: Sequence[str]) -> dict[str, ThresholdUse]:
    """Return how the newest of `outcomes`, in the order of their numbers, stand against each threshold of `names`."""
    newest = outcomes[-NEWEST:]
    uses: dict[str, ThresholdUse] = {}
    for name in names:
        values = [value for outcome in newest if math.isfinite(value := _value(name, outcome))]
        uses[name] = ThresholdUse(len(newest), sum(rejected_by(outcome) == name for outcome in newest), tuple(values))
    return uses


def _value(name: str, outcome: Outcome) -> float:
    """Return what a poke had of what a threshold limits, in its unit; NaN where that is not known."""
    if isinstance(outcome, Rejection) and rejected_by(outcome) == name and name != "gap_factor":
        return outcome.value
    force, moment = outcome.force, outcome.moment
    if name in ("force_min", "force_max", "pitch_max") and force is not None and moment is not None and force.any():
        return float(abs(pitch(force, moment)) if name == "pitch_max" else np.linalg.norm(force))
    if isinstance(outcome, Contact):
        return _answered(name, outcome)
    return math.nan


def _answered(name: str, contact: Contact) -> float:
    found = {
        "taxels_max": len(contact.channels),
        "response_min": contact.responses.max(),
        "tare_change_max": contact.tare_change,
    }
    return float(found.get(name, math.nan))
