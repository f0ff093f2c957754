"""Sentences on pokes: why one was rejected, and why a recording has none."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skincal.contacts.outcome import BeforePokes, Rejection
from skincal.model.actions import MissedLandmark
from skincal.model.errors import plural
from skincal.model.scene import ContactSettings

if TYPE_CHECKING:
    pass


def rejection_words(outcome: Rejection) -> str:
    """Return why a poke does not count: `"too soft (2.1, limit 4 N)"`."""
    return f"{outcome.reason.value} ({f'{outcome.value:.4g}, limit {outcome.limit:.4g} {outcome.unit}'.rstrip()})"


def missed_words(missed: MissedLandmark) -> str:
    """Return how far a poke passed the landmark that was asked for: `"passes wrist, top at 52 mm, at most 34 mm"`."""
    if missed.behind:
        return f"pushes at another side than that of {missed.name}"
    return f"passes {missed.name} at {missed.miss * 1e3:.0f} mm, at most {missed.limit * 1e3:.0f} mm"


def no_poke_sentence(seen: BeforePokes, thresholds: ContactSettings) -> str:
    """Return what a recording without a poke showed, what a poke would have been, and what may be put right."""
    if not seen.samples:
        return (
            "No poke was found: no skin frame has a wrench of its time; expected both to be recorded at the same time. "
            "Check that the recordings belong together."
        )
    looked = f"No poke was found in {plural(seen.samples, 'frame')} of the skin with their wrenches, over {seen.seconds:.0f} s"
    if not seen.tared:
        return (
            f"{looked}: the force never rested; expected {thresholds.quiet_s:g} s without a touch before a poke. Check the "
            "force sensor's noise and the unit of its readings."
        )
    if seen.answered:
        skin, check = f"{plural(seen.answered, 'taxel')} answered", "the unit of the wrenches"
    elif seen.fell:
        skin = f"no taxel answered, but {seen.fell} fell below their rest"
        check = "the skin's polarity in the scene and the unit of the wrenches"
    else:
        skin, check = "no taxel answered", "that the part was poked, and the unit of the wrenches"
    return (
        f"{looked}: the strongest force beside its rest is {seen.strongest:.2g} N, and {skin}; expected a touch of "
        f"{thresholds.touch_force:g} N or more. Check {check}, or lower touch_force in the scene's [contacts]."
    )
