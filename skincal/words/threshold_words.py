"""The thresholds of a poke for the page that changes them: what each is called, its unit and why it is as it is. No Qt."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

from skincal.contacts.thresholds import ThresholdUse
from skincal.model.scene import RISING, ContactSettings, most_of
from skincal.words.units import UNITS, DisplayUnit, count, number

ABOUT = (
    "What a poke must pass to count. A change holds for pokes that begin from then on, is kept in the session and can be "
    "undone; earlier pokes stay as they are."
)


@dataclass(frozen=True, slots=True)
class ThresholdWords:
    """What is said of one threshold."""

    title: str
    unit: DisplayUnit
    reason: str


_RAW = DisplayUnit(1.0, "raw", 1)

GROUPS: Mapping[str, Mapping[str, ThresholdWords]] = {
    "Force": {
        "force_min": ThresholdWords(
            "Least force",
            UNITS["N"],
            "A softer push leaves its axis uncertain: 1.4\N{DEGREE SIGN} at 4 N and 0.1 N of noise.",
        ),
        "force_max": ThresholdWords("Most force", UNITS["N"], "Above it foam bottoms out, and a hand slides."),
        "touch_force": ThresholdWords(
            "A poke begins above", UNITS["N"], "Ten times the noise of a good sensor; more where noise begins pokes."
        ),
        "release_force": ThresholdWords(
            "A poke ends below", UNITS["N"], "Less than what begins it, so that noise cannot end it."
        ),
    },
    "Holding still": {
        "still_s": ThresholdWords("Held still for", UNITS["s"], "Readings are averaged over it: 15 skin frames at 50 Hz."),
        "still_change": ThresholdWords("The force varies by", UNITS["1"], "At most, as a standard deviation, in that time."),
        "slide_max": ThresholdWords("The axis travels", UNITS["m"], "At most, in that time, where the contact is."),
        "pitch_max": ThresholdWords(
            "Pitch of the axis",
            UNITS["m"],
            "At most; more shows a second contact or a torque. Up to 20 mm where the sensor's matrix is off by 2 %.",
        ),
    },
    "What the skin answers": {
        "taxels_max": ThresholdWords("Taxels that answer", UNITS[""], "At most; a palm or a large tip reaches more."),
        "response_min": ThresholdWords("A taxel answers above", _RAW, "In raw values, beyond its rest; 10 of 255 is usual."),
        "response_noises": ThresholdWords(
            "and above its noise times", DisplayUnit(1.0, "", 1), "So that a noisy taxel does not answer by itself."
        ),
        "gap_factor": ThresholdWords(
            "Neighbours lie within", DisplayUnit(1.0, "spacings", 1), "Taxels farther apart do not answer one tip."
        ),
    },
    "Hands off": {
        "quiet_s": ThresholdWords("Quiet for", UNITS["s"], "Before and after each poke, to tare: 10 skin frames at 50 Hz."),
        "tare_change_max": ThresholdWords(
            "The tare changes by", UNITS["N"], "At most, from before to after a poke; more is drift, or something leans."
        ),
    },
}
"""By the names of `ContactSettings`."""
WORDS = {name: words for group in GROUPS.values() for name, words in group.items()}


def shown_value(name: str, value: float) -> str:
    """Return a threshold, in its SI unit, as the field shows it: without its unit."""
    return f"{value * WORDS[name].unit.factor:.6g}"


def with_unit(name: str, value: float) -> str:
    """Return a threshold with its unit."""
    return f"{shown_value(name, value)} {WORDS[name].unit.text}".rstrip()


def typed_value(name: str, text: str) -> float:
    """Return what was typed into a field in the threshold's SI unit; NaN where it is no number."""
    try:
        # As people write it where the comma is the point; Python alone takes 1_0 for ten.
        return float(text.replace(",", ".").replace("_", "?")) / WORDS[name].unit.factor
    except ValueError:
        return math.nan


def objections(values: Mapping[str, float]) -> dict[str, str]:
    """Return why thresholds, in SI units by their names, cannot be used, by the names of their fields; empty where they can."""
    wrong = {name: sentence for name, value in values.items() if (sentence := _objection(name, value))}
    for low, high in pairwise(RISING):
        if low not in wrong and high not in wrong and not values[low] < values[high]:
            title = WORDS[high].title[0].lower() + WORDS[high].title[1:]
            wrong[low] = f"Expected less than {with_unit(high, values[high])}, which is for: {title}."
    return wrong


def _objection(name: str, value: float) -> str:
    unit = WORDS[name].unit
    if not 0 < value <= most_of(name):
        most = f" and at most {with_unit(name, most_of(name))}" if name.endswith("_s") else ""
        return f"Expected a number above 0{most}, {_in(unit)}."
    whole = isinstance(getattr(ContactSettings(), name), int)
    return "Expected a whole number." if whole and value != round(value) else ""


def _in(unit: DisplayUnit) -> str:
    return f"in {unit.text}" if unit.text else "without a unit"


def use_words(name: str, use: ThresholdUse) -> str:
    """Return how the newest pokes stand against a threshold."""
    if not use.pokes:
        return "No poke yet."
    unit = WORDS[name].unit
    ends = [number(end(use.values) * unit.factor, unit.decimals) for end in (min, max)] if use.values else []
    had = [f"{' to '.join(dict.fromkeys(ends))} {unit.text}".rstrip()] if ends else []
    rejected = f"{use.rejected or 'none'} rejected by it"
    return f"Last {count(use.pokes, 'poke')}: {', '.join([*had, rejected])}."
