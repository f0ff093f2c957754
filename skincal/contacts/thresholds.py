"""The newest pokes against each threshold: their values, and how many it rejected."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import Contact, Outcome, Rejection
from skincal.geometry import pitch

NEWEST_POKES_COMPARED = 10
"""Pokes that are compared: a minute of work, in which hand and tool stay the same."""


@dataclass(frozen=True, slots=True)
class ThresholdUse:
    """Values of the newest pokes, and the threshold that limits them."""

    pokes: int
    """Number of pokes compared."""
    rejected: int
    """Number of them that this threshold rejected."""
    values: tuple[float, ...]
    """Their values in the threshold's unit, oldest first; unknown values are left out."""


def threshold_uses(outcomes: Sequence[Outcome], names: Sequence[str]) -> dict[str, ThresholdUse]:
    """Compare the newest of `outcomes`, which are in the order of their numbers, with each threshold of `names`."""
    newest = outcomes[-NEWEST_POKES_COMPARED:]
    rejecting = [outcome.threshold for outcome in newest if isinstance(outcome, Rejection)]
    values = [_measured(outcome) for outcome in newest]
    return {
        name: ThresholdUse(len(newest), rejecting.count(name), tuple(each[name] for each in values if name in each))
        for name in names
    }


def _measured(outcome: Outcome) -> dict[str, float]:
    """Map each threshold to the poke's value that it limits; unknown values are left out."""
    found: dict[str, float] = {}
    force, moment = outcome.force, outcome.moment
    if force is not None and moment is not None and force.any():
        size = float(np.linalg.norm(force))
        found = {"force_min": size, "force_max": size, "pitch_max": abs(float(pitch(force, moment)))}
    if isinstance(outcome, Contact):
        found |= {
            "taxels_max": float(len(outcome.channels)),
            "response_min": float(outcome.responses.max()),
            "tare_change_max": outcome.tare_change,
        }
    elif outcome.threshold != "gap_factor":  # its value is a length, the threshold a factor
        found[outcome.threshold] = outcome.value
    return {name: value for name, value in found.items() if math.isfinite(value)}
