"""Sentences of the Rig tab: errors of the rig, and their correction."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from app.state.policies import Offer
from skincal.following.review import Review
from skincal.rig.correction import UsedCorrection
from skincal.session.corrections import used_of
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, Method
from skincal.words.layout_words import distance_sentences
from skincal.words.mistake_words import frame_sentence
from skincal.words.rig_words import correction_sentence, rig_error_sentences, rig_sentences
from skincal.words.taxel_words import rig_name
from skincal.words.units import DASH, cell, count, millimetres


def offer_text(offer: Offer) -> str:
    """Label the button of an available correction."""
    if offer.frame is not None:
        return "Correct the sensor frame"
    rig = rig_name(offer.has_arm)
    return f"Update the correction of {rig}" if offer.replaces else f"Correct {rig}"


def offer_words(offer: Offer) -> str:
    """Describe an available correction, with the error before and after."""
    if offer.frame is None:
        now, then = cell(offer.action.before, "m"), millimetres(offer.action.after)
        lowers = f"the error at landmarks left out of the fit falls from {now} to {then}"
        return f"A correction of {rig_name(offer.has_arm)} is ready: {lowers}."
    perhaps = "" if offer.frame.sure else " Another mistake is almost as likely: press another landmark."
    return frame_sentence(offer.frame, has_arm=offer.has_arm) + perhaps


def offer_news(offer: Offer) -> str:
    """Announce an available correction; its numbers, which later landmark pokes change, are in the Rig tab alone."""
    what = f"A correction of {rig_name(offer.has_arm)} is ready." if offer.frame is None else offer_words(offer)
    return f"{what} C: apply. Rig tab: details and undo."


def corrected_words(offer: Offer) -> str:
    """Announce that a correction is applied."""
    corrected = correction_sentence(used_of(offer.action), has_arm=offer.has_arm)
    return f"{corrected} Backspace undoes it until the next poke, the Rig tab at any time."


def moved_words(review: Review, method: Method, estimates: Sequence[Estimate]) -> str:
    """Give the distance by which a correction moves, or has moved, the taxels of a method; empty if unknown."""
    other = review.before.get(method, review.after.get(method))
    if other is None:
        return ""
    here = {estimate.channel: estimate.position for estimate in estimates}
    places = zip(review.channels.tolist(), other, strict=True)
    lengths = [np.linalg.norm(place - there) for channel, place in places if (there := here.get(channel)) is not None]
    apart = np.array(lengths)[np.isfinite(lengths)]
    if not len(apart):
        return ""
    verb = "has moved" if method in review.before else "would move"
    return f"It {verb} the taxels by {millimetres(float(apart.mean()))} on average, at most {millimetres(float(apart.max()))}."


def review_words(
    review: Review, snapshot: Snapshot, method: Method, estimates: Sequence[Estimate], *, has_arm: bool = True
) -> tuple[str, ...]:
    """List the sentences on errors of the rig, most important first."""
    moved = moved_words(review, method, estimates)
    said = rig_error_sentences(review.frame, snapshot.decisions.corrections, review.rig, moved, has_arm=has_arm)
    return (*said, *distance_sentences(snapshot.tried_distances))


def rig_state(offers: Sequence[Offer], used: Iterable[UsedCorrection], review: Review | None, *, has_arm: bool = True) -> str:
    """Summarise the errors of the rig, which held-out pokes of the skin hardly show."""
    if offers:
        return f"{offer_words(offers[0])} C: apply. Rig tab: details."
    in_use = " ".join(correction_sentence(correction, has_arm=has_arm) for correction in used)
    if in_use:
        return in_use
    if review is not None and len(review.pokes):
        return rig_sentences(review.rig, has_arm=has_arm)[0]
    return f"not checked, since no landmark was pressed: an error of {rig_name(has_arm)} shifts all taxels together"


def named_landmarks_words(found: Mapping[int, str] | None) -> str:
    """Announce pokes that got their landmark; `None` while the part's pose is unknown."""
    if found is None:
        return "The part's pose is not known yet, so no landmark is found. `skincal landmarks` names three by --order or --at."
    if not found:
        return "No further poke is surely at a landmark: the tip or the force axis must be within 20 mm of one alone."
    named = ", ".join(f"{poke} at {name}" for poke, name in found.items())
    return f"{count(len(found), 'poke is', 'pokes are')} at landmarks now: {named}. Backspace undoes them one by one."


def landmark_rows(snapshot: Snapshot, review: Review | None, pose: str) -> list[tuple[str, ...]]:
    """Make the cells for each landmark: name, pokes in the current arm `pose`, all pokes, and their distance.

    The distance is in mm rms: as reported, and with the correction that is offered or in use. One that is not used was fitted
    to these pokes, so it lowers their distances in any case.
    """
    outcomes = {record.outcome.poke: record for record in snapshot.pokes if record.outcome.poke in snapshot.at_landmarks}
    counting = {poke: record.outcome for poke, record in outcomes.items() if not record.excluded}
    of: dict[str, list[int]] = defaultdict(list)
    for poke in counting:
        of[snapshot.at_landmarks[poke]].append(poke)
    rows: list[tuple[str, ...]] = []
    for name in (point.name for point in snapshot.decisions.landmarks):
        here = sum(counting[poke].pose == pose for poke in of[name])
        rows.append((name, str(here), str(len(of[name])), DASH if review is None else _off(of[name], review)))
    return rows


def _off(pokes: Sequence[int], review: Review) -> str:
    reported = [review.reported[poke] for poke in pokes if poke in review.reported]
    found = [review.rig.distances[poke] for poke in pokes if review.rig.used and poke in review.rig.distances]
    if not reported:
        return DASH
    if not found:
        return cell(_rms(reported), "m")
    return f"{cell(_rms(reported), 'm')}, corrected {cell(_rms(found), 'm')}"


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
