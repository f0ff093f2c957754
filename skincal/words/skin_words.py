"""Sentences on the skin as a whole: drift, noise, range, and pokes that too many taxels answer; each with its remedy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from skincal.contacts.crowding import CrowdKind, find_crowd
from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.words.poke_words import answered_inversely
from skincal.words.units import count

if TYPE_CHECKING:
    from skincal.contacts.crowding import Crowd
    from skincal.contacts.outcome import Outcome
    from skincal.contacts.skin_condition import SkinCondition
    from skincal.model.scene import ContactSettings, Scene

MIN_POKES_TO_JUDGE_SKIN = 6
MIN_DRIFTING_POKES = 3
MIN_SHARE_OF_UNANSWERED_POKES = 0.5
"""Share of the pokes that no taxel answered from which the reason is looked for in the skin's values."""
MIN_CLEAR_POKES_OF_A_GOOD_SKIN = 3
"""Pokes with a clear answer that show a good skin: the unanswered ones were beside its taxels."""
CLEAR_ANSWER_MIN_THRESHOLDS = 2.0
"""Clear answer over the smallest one that counts, `response_noises` times the noise."""
CLIPPED_MIN_SHARE_OF_POKES = 0.02
ANSWER_SHARE_FOR_THRESHOLD = 0.1
"""Proposed `response_min` over the median answer."""
MIN_INVERSE_POKES = 2
"""One alone may be a zero that was taken while something pressed."""


def skin_sentences(condition: SkinCondition, outcomes: Sequence[Outcome], scene: Scene, used: ContactSettings) -> list[str]:
    """Name the faults of the skin that a session shows, with their remedies; empty without one.

    Parameters
    ----------
    outcomes : of all pokes but those at landmarks
    used : thresholds now
    """
    unit, axes = "raw units", scene.skin.axes
    if axes is not None:
        unit = "N" if axes.unit == "N" else unit
    # In the wrong order, or against the polarity, small answers say nothing about the threshold.
    order = None if axes is None else condition.value_order
    has_mistake = axes is not None and order is not None and order.has_no_z(axes.order)
    found = [_clocks_differ(condition) or _inverse(outcomes, scene) or _normalised(condition)]
    if not (has_mistake or found[0]):
        found = [_noisy(condition, outcomes, used, unit) or _small(condition, outcomes, used, unit)]
    found += [_drifting(condition, unit), _clipped(condition), _crowded(find_crowd(outcomes, scene))]
    return [f"skin: {sentence}" for sentence in found if sentence]


def _clocks_differ(condition: SkinCondition) -> str:
    """Name an offset of the skin against the wrench: presses then have no rest before them, or the wrong answers."""
    offset_s = condition.offset_s
    if offset_s is None:
        return ""
    way = "later" if offset_s > 0 else "earlier"
    when = "at other times than the force" if math.isinf(offset_s) else f"{abs(offset_s):.1f} s {way} than the force"
    return (
        f"its answers come {when}, and a poke needs both at once: their clocks differ. Record wrench and skin by one clock, or "
        "correct the times of one of them, and read the recording again."
    )


def _inverse(outcomes: Sequence[Outcome], scene: Scene) -> str:
    """Name the polarity if no more pokes were answered than changed the other way."""
    inverse = sum(isinstance(each, Rejection) and answered_inversely(each) for each in outcomes)
    if inverse < MIN_INVERSE_POKES or sum(isinstance(each, Contact) for each in outcomes) > inverse:
        return ""
    way, other = ("rise", "down") if scene.skin.polarity > 0 else ("fall", "up")
    values = "values" if scene.skin.axes is None else "values of z"
    return (
        f"taxels changed against the polarity in {inverse} of {count(len(outcomes), 'poke')}: by the scene their {values} "
        f'{way} under a push. Write polarity = "{other}" in [skin] of the scene and read the recording again. If it is right, '
        "keep hands off for half a second before each poke."
    )


def _normalised(at: SkinCondition) -> str:
    if not at.is_normalised:
        return ""
    both = f"{at.lowest:g} and {at.highest:g} as its smallest and largest value"
    one = f"{at.highest:g} as its largest value"
    has = "the same mean and spread" if at.is_standardised else f"exactly {one if math.isnan(at.lowest) else both}"
    return (
        f"every frame has {has}: a program normalises each frame alone. "
        "So noise at rest looks like an answer, and answers have no size. Record raw values."
    )


def _unanswered(outcomes: Sequence[Outcome]) -> bool:
    """Whether most pokes found no taxel that answered."""
    silent = sum(isinstance(each, Rejection) and each.reason is Reason.NO_TAXEL for each in outcomes)
    return silent >= max(MIN_POKES_TO_JUDGE_SKIN, MIN_SHARE_OF_UNANSWERED_POKES * len(outcomes))


def _noisy(at: SkinCondition, outcomes: Sequence[Outcome], used: ContactSettings, unit: str) -> str:
    is_small = at.pokes >= MIN_POKES_TO_JUDGE_SKIN and at.answer_over_noise < used.response_noises
    if not (is_small and _unanswered(outcomes)) or _clear_pokes(at, outcomes, used) >= MIN_CLEAR_POKES_OF_A_GOOD_SKIN:
        return ""
    return (
        f"its noise at rest is as large as its answers: the strongest answer of a poke is {at.answer:.3g} {unit} (median), "
        f"{at.answer_over_noise:.1f} times the noise of that taxel; expected {used.response_noises:g} times or more. Check "
        "that raw values are recorded, and the supply, ground and shield of the skin. If its foam is thick, press harder."
    )


def _clear_pokes(at: SkinCondition, outcomes: Sequence[Outcome], used: ContactSettings) -> int:
    """Count the pokes that a taxel answered far above the noise at rest."""
    clear = CLEAR_ANSWER_MIN_THRESHOLDS * used.response_noises * at.noise
    return sum(isinstance(each, Contact) and bool((each.responses >= clear).any()) for each in outcomes)


def _small(at: SkinCondition, outcomes: Sequence[Outcome], used: ContactSettings, unit: str) -> str:
    """Name a lower threshold if answers are clear, but below the threshold."""
    is_clear = at.answer_over_noise >= CLEAR_ANSWER_MIN_THRESHOLDS * used.response_noises or (at.answer > 0 and at.noise == 0)
    if not (_unanswered(outcomes) and at.pokes >= MIN_POKES_TO_JUDGE_SKIN and is_clear and at.answer < used.response_min):
        return ""
    return (
        f"its answers are clear but small: the strongest answer of a poke is {at.answer:.3g} {unit} (median), and a taxel "
        f"answers from {used.response_min:g} on. Write response_min = {ANSWER_SHARE_FOR_THRESHOLD * at.answer:.2g} in "
        "[contacts] of the scene and read the recording again, or press again."
    )


def _drifting(at: SkinCondition, unit: str) -> str:
    if at.drifting < MIN_DRIFTING_POKES:
        return ""
    way = "rise" if at.drift > 0 else "fall"
    return (
        f"its values at rest {way} by {abs(at.drift):.3g} {unit} a second (median of {count(at.drifting, 'poke')}). "
        "Answers of these pokes are measured from the line between the rest before and after them, so they count. To end the "
        "drift, let the skin and its board warm up, and check their supply and reference voltage."
    )


def _clipped(at: SkinCondition) -> str:
    if math.isnan(at.range_end) or at.clipped < max(1.0, CLIPPED_MIN_SHARE_OF_POKES * at.pokes):
        return ""
    together = (
        f" In {at.clipped_together} of them several taxels are there at once, so nothing says which one the tip is nearest to: "
        "these taxels count alike and may be off by half their spacing. "
        "The expected error contains that, but not if modules are placed."
        if at.clipped_together
        else " Only one taxel at a time is there, so positions stay as good."
    )
    return (
        f"pressed taxels reach {at.range_end:g}, the end of its range, in {at.clipped} of {count(at.pokes, 'poke')} that "
        "were held still."
        f"{together} Press softer, or lower the gain of the board."
    )


def _crowded(crowd: Crowd | None) -> str:
    if crowd is None:
        return ""
    begin = f"{crowd.crowded} of {count(crowd.pokes, 'poke')} are rejected because too many taxels answer, "
    if crowd.kind is CrowdKind.GHOSTS:
        software = (
            f"Until then write response_share = {crowd.response_share:g} in [contacts] of the scene and read the recording "
            f"again: then {crowd.passing} of these pokes count."
            if crowd.response_share
            else "The others answer nearly as much as the pressed taxel, so no threshold helps."
        )
        return (
            f"{begin}and they are the row and the column of the strongest one ({crowd.rows} x {crowd.columns}; they answer "
            f"{crowd.ghost_share * 100:.0f} % of it): a matrix without diodes, where current takes other ways. Hold the "
            f"lines that are not read at ground (by an amplifier), or add a diode to each taxel. {software}"
        )
    edge = "The others are mostly at the edge of the skin, so taxels in its middle come out beside their places. "
    rest = edge if crowd.crowded < crowd.pokes else ""
    return (
        f"{begin}{crowd.answers} of them (median; limit {crowd.limit}). {rest}Likeliest, its taxels are close together or its "
        f"cover spreads a press: write taxels_max = {crowd.taxels_max} in [contacts] of the scene and read the recording "
        f"again: then {crowd.passing} of these pokes pass this limit. Else use a smaller tip, and see if the same taxels "
        "answer a poke far away: then they are coupled."
    )
