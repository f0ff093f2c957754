"""What is said of a rig and of what could put it right."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from app.state.policies import Offer
from skincal.model.actions import Correct
from skincal.rig.correction import RIG, UsedCorrection
from skincal.session.corrections import used_of
from skincal.session.review import Review
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, Method
from skincal.words.layout_words import distance_sentences
from skincal.words.rig_words import correction_sentence, frame_sentence, rig_sentences
from skincal.words.units import DASH, cell, millimetres


def offer_text(offer: Offer) -> str:
    """Return what the button of a correction that could be used says."""
    if offer.frame is not None:
        return "Correct the sensor's frame"
    return "Correct the rig anew" if offer.anew else "Correct the rig"


def offer_words(offer: Offer) -> str:
    """Return what is said of a correction that could be used, with the misses."""
    if offer.frame is None:
        then, now = millimetres(offer.action.after), millimetres(offer.action.before)
        return f"The rig can be corrected: held-out pokes then pass their landmarks at {then}, now at {now}."
    perhaps = "" if offer.frame.sure else " Another mistake would be nearly as likely: poke another landmark."
    return frame_sentence(offer.frame) + perhaps


def offer_news(offer: Offer) -> str:
    """Return what is said once of a correction that could be used."""
    return f"{offer_words(offer)} C uses that; the Rig tab says more, and takes it back."


def corrected_words(action: Correct) -> str:
    """Return what is said when a correction is used."""
    return f"{correction_sentence(used_of(action))} Backspace takes it back until the next poke, the Rig tab at any time."


def moved_words(review: Review, method: Method, estimates: Sequence[Estimate]) -> str:
    """Return how far a correction moves, or has moved, the taxels of a method; empty where nobody knows."""
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
    return f"It {verb} the taxels by {millimetres(float(apart.mean()))} in the mean, {millimetres(float(apart.max()))} at most."


def review_words(review: Review, snapshot: Snapshot, method: Method, estimates: Sequence[Estimate]) -> tuple[str, ...]:
    """Return what is said of the rig, most important first."""
    frame, rig, found = review.frame, review.rig, rig_sentences(review.rig)
    said = [] if frame is None else [frame_sentence(frame)]
    said += [correction_sentence(used) for used in snapshot.decisions.corrections.values()]
    if RIG not in snapshot.decisions.corrections:
        said += found[:1]
    elif not rig.used:
        said.append(f"The landmark pokes that count now do not speak for it any more. {found[0]}")
    moved = moved_words(review, method, estimates)
    return tuple(filter(None, (*said, moved, *found[1:], *distance_sentences(snapshot.tried_distances))))


def rig_state(offers: Sequence[Offer], used: Iterable[UsedCorrection], review: Review | None) -> str:
    """Return what is known of the rig's own errors, which held-out pokes of the skin hardly show."""
    if offers:
        return f"{offer_words(offers[0])} C uses that, the Rig tab says more."
    in_use = " ".join(correction_sentence(correction) for correction in used)
    if in_use:
        return in_use
    if review is not None and review.pokes:
        return rig_sentences(review.rig)[0]
    return "not checked, since landmarks were not poked: an error of the sensor's matrix or of the arm moves all taxels alike"


@dataclass(frozen=True, slots=True)
class LandmarkRow:
    """What a list says of one landmark."""

    name: str
    here: int
    """Pokes in the present arm pose."""
    every: int
    off: str
    """How far its pokes pass it, mm, root mean square, as the rig reports them and under the correction that was found."""


def landmark_rows(snapshot: Snapshot, review: Review | None, pose: str) -> list[LandmarkRow]:
    """Make one row for each landmark; `pose` is the current arm pose."""
    outcomes = {record.outcome.poke: record for record in snapshot.pokes if record.outcome.poke in snapshot.at_landmarks}
    counting = {poke: record.outcome for poke, record in outcomes.items() if not record.excluded}
    of: dict[str, list[int]] = defaultdict(list)
    for poke in counting:
        of[snapshot.at_landmarks[poke]].append(poke)
    rows: list[LandmarkRow] = []
    for name in (point.name for point in snapshot.decisions.landmarks):
        here = sum(counting[poke].pose == pose for poke in of[name])
        rows.append(LandmarkRow(name, here, len(of[name]), DASH if review is None else _off(of[name], review)))
    return rows


def _off(pokes: Sequence[int], review: Review) -> str:
    reported = [review.reported[poke] for poke in pokes if poke in review.reported]
    found = [review.rig.distances[poke] for poke in pokes if poke in review.rig.distances]
    if not reported:
        return DASH
    if not found:
        return cell(_rms(reported), "m")
    return " \N{RIGHTWARDS ARROW} ".join(cell(_rms(values), "m") for values in (reported, found))


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
