"""Titles, units and reasons of the poke thresholds, and problems with typed values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

from skincal.contacts.thresholds import ThresholdUse
from skincal.model.scene import FORCE_ORDER, ContactSettings, setting_limit
from skincal.words.units import UNITS, DisplayUnit, count, number

THRESHOLDS_INTRODUCTION = (
    "Conditions for a poke to count. A change applies to later pokes only, is saved in the session and can be undone."
)


@dataclass(frozen=True, slots=True)
class ThresholdWords:
    """Name, unit and explanation of one threshold, for the operator."""

    title: str
    unit: DisplayUnit
    reason: str


_RAW_UNIT = DisplayUnit(1.0, "raw", 1)

THRESHOLD_GROUPS: Mapping[str, Mapping[str, ThresholdWords]] = {
    "Force": {
        "force_min": ThresholdWords(
            "Least force",
            UNITS["N"],
            "A softer press makes the force axis uncertain: 1.4\N{DEGREE SIGN} at 4 N with 0.1 N noise.",
        ),
        "force_max": ThresholdWords("Most force", UNITS["N"], "Above it the foam is fully compressed and the tip slides."),
        "touch_force": ThresholdWords(
            "A poke begins above", UNITS["N"], "Ten times the noise of a good sensor. Increase it if noise starts pokes."
        ),
        "release_force": ThresholdWords(
            "A poke ends below", UNITS["N"], "Below the start force, so that noise does not end the poke."
        ),
    },
    "Holding still": {
        "still_s": ThresholdWords("Held still for", UNITS["s"], "Readings are averaged over it: 15 skin readings at 50 Hz."),
        "still_change": ThresholdWords(
            "The force varies by", UNITS["1"], "Maximum standard deviation of the force over that time."
        ),
        "slide_max": ThresholdWords("The axis slides by", UNITS["m"], "Maximum movement of the contact over that time."),
        "pitch_max": ThresholdWords(
            "Pitch of the axis",
            UNITS["m"],
            "Maximum; more means a second contact or a twist. Up to 20 mm if the sensor matrix has 2 % error.",
        ),
    },
    "What the skin answers": {
        "taxels_max": ThresholdWords("Taxels that answer", UNITS[""], "Maximum; a palm or a large tip reaches more."),
        "response_min": ThresholdWords(
            "A taxel answers above", _RAW_UNIT, "In raw values above the baseline; 10 of 255 is common."
        ),
        "response_noises": ThresholdWords(
            "and above its noise times", DisplayUnit(1.0, "", 1), "Keeps a noisy taxel from answering without a touch."
        ),
        "response_share": ThresholdWords(
            "and above its share of the strongest",
            UNITS["1"],
            "0 counts all. Above the share of the ghosts, it leaves out those of a matrix without diodes.",
        ),
        "gap_factor": ThresholdWords(
            "Neighbours lie within", DisplayUnit(1.0, "spacings", 1), "Taxels farther apart cannot answer the same tip."
        ),
    },
    "Hands off": {
        "quiet_s": ThresholdWords(
            "Hands-off pause of", UNITS["s"], "Around each poke, to zero the sensor: 10 skin readings at 50 Hz."
        ),
        "tare_change_max": ThresholdWords(
            "The zero changes by", UNITS["N"], "Maximum change from before to after a poke; more is drift or a second touch."
        ),
    },
}
"""By the names of `ContactSettings`."""
_WITHOUT_SENSOR = {
    "slide_max": ThresholdWords("The tip moves by", UNITS["m"], "Maximum movement of the tip over that time."),
    "quiet_s": ThresholdWords("Pause of", UNITS["s"], "Before each poke, with the tip off the skin: it is measured at rest."),
}
"""Words of a rig without a force sensor, where they differ."""
_OF_FORCE = frozenset((*FORCE_ORDER, "still_change", "pitch_max", "tare_change_max"))


def threshold_groups(*, has_sensor: bool) -> dict[str, dict[str, ThresholdWords]]:
    """List the thresholds that a rig uses, by group: without a force sensor those of the force have no effect."""
    if has_sensor:
        return {title: dict(group) for title, group in THRESHOLD_GROUPS.items()}
    used = {
        "Pause" if title == "Hands off" else title: {
            name: _WITHOUT_SENSOR.get(name, words) for name, words in group.items() if name not in _OF_FORCE
        }
        for title, group in THRESHOLD_GROUPS.items()
    }
    return {title: group for title, group in used.items() if group}


THRESHOLD_WORDS = {name: words for group in THRESHOLD_GROUPS.values() for name, words in group.items()}


def shown_value(name: str, value: float) -> str:
    """Format a threshold for its field, without the unit."""
    return f"{value * THRESHOLD_WORDS[name].unit.factor:.6g}"


def with_unit(name: str, value: float) -> str:
    """Format a threshold with its unit."""
    return f"{shown_value(name, value)} {THRESHOLD_WORDS[name].unit.text}".rstrip()


def typed_value(name: str, text: str) -> float:
    """Parse a typed value into the threshold's SI unit; NaN if it is no number."""
    try:
        # As people write it where the comma is the point; Python alone takes 1_0 for ten.
        return float(text.replace(",", ".").replace("_", "?")) / THRESHOLD_WORDS[name].unit.factor
    except ValueError:
        return math.nan


def objections(values: Mapping[str, float]) -> dict[str, str]:
    """Say why thresholds (SI units, by name) cannot be used, by name; empty if they can."""
    wrong = {name: sentence for name, value in values.items() if (sentence := _objection(name, value))}
    for low, high in pairwise(FORCE_ORDER):
        if low not in wrong and high not in wrong and not values[low] < values[high]:
            title = THRESHOLD_WORDS[high].title[0].lower() + THRESHOLD_WORDS[high].title[1:]
            wrong[low] = f"Expected less than {with_unit(high, values[high])}, the value of: {title}."
    return wrong


def _objection(name: str, value: float) -> str:
    unit = THRESHOLD_WORDS[name].unit
    may_be_0 = getattr(ContactSettings(), name) == 0
    if not (0 < value <= setting_limit(name) or (may_be_0 and value == 0)):
        most = f" and at most {with_unit(name, setting_limit(name))}" if name.endswith("_s") else ""
        return f"Expected a number above 0{most}, {f'in {unit.text}' if unit.text else 'without a unit'}."
    whole = isinstance(getattr(ContactSettings(), name), int)
    return "Expected a whole number." if whole and value != round(value) else ""


def use_words(name: str, use: ThresholdUse) -> str:
    """Compare the newest pokes with a threshold."""
    if not use.pokes:
        return "No poke yet."
    unit = THRESHOLD_WORDS[name].unit
    ends = [number(end(use.values) * unit.factor, unit.decimals) for end in (min, max)] if use.values else []
    had = [f"{' to '.join(dict.fromkeys(ends))} {unit.text}".rstrip()] if ends else []
    rejected = f"{use.rejected or 'none'} rejected by it"
    return f"Last {count(use.pokes, 'poke')}: {', '.join([*had, rejected])}."
