"""Sentences on sensor and arm: corrections, landmarks and the final check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt

from skincal.rig.closing import Closing, ClosingPlaces
from skincal.rig.correction import FRAME, RIG, UsedCorrection
from skincal.rig.correction_fit import (
    MAX_HELD_OUT_ERROR_RATIO_TO_CORRECT,
    MIN_LANDMARK_POKES,
    MIN_LANDMARKS,
    REPORT_LANDMARK_POKES_WITH_TRUST_BELOW,
    RigAnswer,
)
from skincal.rig.frame_check import FrameDiagnosis
from skincal.words.mistake_words import frame_sentence
from skincal.words.taxel_words import rig_name
from skincal.words.units import millimetres


def closing_sentence(closing: Closing, *, has_tool: bool = False) -> str:
    """Say whether anything moved between the first pokes of a session and their repetition at its end."""
    moved, limit = millimetres(closing.shift), millimetres(closing.limit)
    across = "" if closing.observable_directions == 3 else ", measured only across the direction of the press"
    where = f"{len(closing.names)} {closing.at.value} pressed again{across}"
    things = ["the part", "the tip on its tool"] if has_tool else ["the sensor", "the arm"]
    things += ["the skin"] if closing.at is ClosingPlaces.TAXELS else []
    what = f"{', '.join(things[:-1])} or {things[-1]}"
    if closing.single_poke_decides:
        place = closing.place if closing.at is ClosingPlaces.LANDMARKS else f"taxel {closing.place}"
        return (
            f"Only poke {closing.poke} at {place} indicates that {what} moved by {moved} since the start ({where}; noise "
            f"explains up to {limit}). The tip may have slid: press {place} again, or repeat the final check."
        )
    if not closing.has_moved:
        return f"Nothing has moved since the start: {moved} at {where} (noise explains up to {limit})."
    return (
        f"Since the start {what} has moved by {moved} ({where}; noise explains up to {limit}). Fasten it, and repeat the final "
        "check."
    )


def earlier_closings(closings: Sequence[Closing]) -> list[str]:
    """Summarise the final checks before the last one in a sentence; empty if there was only one."""
    found = [f"{millimetres(each.shift)} after poke {each.after}{_judged(each)}" for each in closings[:-1]]
    return [f"Earlier checks: {', '.join(found)}."] if found else []


def _judged(closing: Closing) -> str:
    if closing.single_poke_decides:
        return f" (only poke {closing.poke})"
    return " (moved)" if closing.has_moved else ""


def correction_words(used: UsedCorrection, *, has_arm: bool) -> str:
    """Describe a correction, with the error before and after; without a full stop, since files use it in comments."""
    after, before = millimetres(used.after), millimetres(used.before)
    if used.of == FRAME:
        # The axis of a force stays with an inverted sign.
        falls = f"their error falls from {before} to {after}"
        why = f"the pushes show its sign, their error at landmarks ({after}) cannot" if before == after else falls
        return f"the sensor frame is corrected from {used.pokes} landmark pokes: {why}"
    errors = f"the error at landmarks left out of the fit falls from {before} to {after}"
    verb = "are" if has_arm else "is"
    return f"{rig_name(has_arm)} {verb} corrected from {used.pokes} landmark pokes: {errors}"


def correction_sentence(used: UsedCorrection, *, has_arm: bool) -> str:
    """Make a sentence of `correction_words`."""
    words = correction_words(used, has_arm=has_arm)
    return f"{words[0].upper()}{words[1:]}."


def rig_sentences(answer: RigAnswer, *, has_arm: bool) -> tuple[str, ...]:
    """Say whether sensor and arm can be corrected, then which landmark pokes count less."""
    if answer.correction is None:
        needs = f"it needs {MIN_LANDMARK_POKES} pokes at {MIN_LANDMARKS} different landmarks"
        return (f"No correction of errors of the rig: {needs}; there are {len(answer.trust)} pokes at {answer.points}.",)
    before, after = millimetres(answer.before), millimetres(answer.after)
    errors = f"the error at landmarks left out of the fit is {after}, without a correction {before}"
    first = f"A correction of {rig_name(has_arm)} is ready: {errors}."
    if not answer.used:
        wanted = answer.before * sqrt(MAX_HELD_OUT_ERROR_RATIO_TO_CORRECT)
        # A correction that would be good enough is not offered if the pose of the part is wrong.
        needs = f"; below {millimetres(wanted)} a correction would be offered" if not answer.after < wanted else ""
        errors = f"with a correction the error at landmarks left out of the fit would be {after}, without one it is {before}"
        first = f"Errors of the rig are not corrected: {errors}{needs}."
    doubted = [
        f"Landmark poke {poke} is {millimetres(answer.distances[poke], 0)} from its landmark and "
        + ("does not count: was it another point?" if trust <= 0 else f"counts {trust:.0%}.")
        for poke, trust in answer.trust.items()
        if trust < REPORT_LANDMARK_POKES_WITH_TRUST_BELOW
    ]
    return (first, *doubted)


def rig_error_sentences(
    frame: FrameDiagnosis | None,
    used: Mapping[str, UsedCorrection],
    answer: RigAnswer | None,
    moved: str = "",
    *,
    has_arm: bool,
) -> list[str]:
    """List the errors of the rig that landmark pokes show, most important first.

    Parameters
    ----------
    used : corrections in use
    answer : fit of the rig's correction; `None` without landmark pokes
    moved : sentence on the taxels that a correction moves
    """
    said = [] if frame is None else [frame_sentence(frame, has_arm=has_arm)]
    said += [correction_sentence(each, has_arm=has_arm) for each in used.values()]
    if answer is None:
        return [*said, *filter(None, [moved])]
    offer, *doubted = rig_sentences(answer, has_arm=has_arm)
    if RIG not in used:
        said.append(offer)
    elif not answer.used:
        said.append(f"The present landmark pokes no longer support the correction. {offer}")
    return [*said, *filter(None, [moved]), *doubted]
