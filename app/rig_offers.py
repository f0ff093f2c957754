"""What the window offers to put right of a rig, and what it says of it; pure functions, without Qt."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from app.display_units import DASH, in_millimetres, millimetres, number
from skincal.contacts.outcome import Outcome
from skincal.rig.correction import FRAME, RIG
from skincal.sentences import correction_sentence, frame_sentence, rig_sentences
from skincal.session.actions import Correct
from skincal.session.corrections import offered
from skincal.session.review import Review
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, Method


@dataclass(frozen=True, slots=True)
class Offer:
    """A correction that could be used."""

    text: str
    """What a button says."""
    words: str
    """What the operator is told of it, with the misses."""
    action: Correct


def offers_of(review: Review | None, snapshot: Snapshot) -> tuple[Offer, ...]:
    """Return what could be put right: the sensor's frame first, since all else was found under it."""
    if review is None or review.used is not snapshot.corrections:
        return ()
    frame, rig, pokes = review.frame, review.rig, len(review.pokes)
    action = offered(frame, rig, pokes, review.used)
    if action is None:
        return ()
    if action.of == FRAME and frame is not None:
        perhaps = "" if frame.sure else " Another mistake would be nearly as likely: poke another landmark."
        return (Offer("Correct the sensor's frame", frame_sentence(frame) + perhaps, action),)
    used = snapshot.corrections.get(RIG)
    if used is not None and used.pokes == pokes:
        return ()
    text = "Correct the rig" if used is None else "Correct the rig anew"
    return (Offer(text, rig_words(rig.before, rig.after), action),)


def rig_words(before: float, after: float) -> str:
    """Return what a correction of the rig would do, with the misses of held-out pokes, metres."""
    now, told = millimetres(after), millimetres(before)
    return f"The rig can be corrected: held-out pokes then pass their landmarks at {now}, now at {told}."


def moved_words(review: Review, method: Method, estimates: Sequence[Estimate]) -> str:
    """Return how far a correction moves, or has moved, the taxels of a method; empty where nobody knows."""
    other = review.before.get(method, review.after.get(method))
    if other is None:
        return ""
    here = {one.channel: one.position for one in estimates}
    pairs = [
        (place, there)
        for channel, place in zip(review.channels.tolist(), other, strict=True)
        if (there := here.get(channel)) is not None and np.isfinite(place).all()
    ]
    if not pairs:
        return ""
    apart = np.array([np.linalg.norm(one - two) for one, two in pairs])
    verb = "has moved" if method in review.before else "would move"
    return f"It {verb} the taxels by {millimetres(float(apart.mean()))} in the mean, {millimetres(float(apart.max()))} at most."


def review_words(review: Review, snapshot: Snapshot, method: Method, estimates: Sequence[Estimate]) -> tuple[str, ...]:
    """Return what is said of the rig, most important first."""
    frame, rig, found = review.frame, review.rig, rig_sentences(review.rig)
    said = [] if frame is None else [frame_sentence(frame)]
    said += [correction_sentence(used) for used in snapshot.corrections.values()]
    if RIG not in snapshot.corrections:
        said += found[:1]
    elif not rig.used:
        said.append(f"The landmark pokes that count now do not speak for it any more. {found[0]}")
    moved = moved_words(review, method, estimates)
    return tuple(filter(None, (*said, moved, *found[1:])))


@dataclass(frozen=True, slots=True)
class LandmarkRow:
    """What a list says of one landmark."""

    name: str
    here: int
    """Pokes in the present arm pose."""
    every: int
    off: str
    """How far its pokes pass it, root mean square, as told and under the correction that was found."""


def landmark_rows(snapshot: Snapshot, review: Review | None) -> list[LandmarkRow]:
    """Return one row for each landmark."""
    outcomes = {one.outcome.poke: one for one in snapshot.pokes if one.outcome.poke in snapshot.at_landmarks}
    counting = {poke: one.outcome for poke, one in outcomes.items() if not one.excluded}
    of: dict[str, list[int]] = defaultdict(list)
    for poke in counting:
        of[snapshot.at_landmarks[poke]].append(poke)
    return [_landmark_row(one.name, of[one.name], counting, snapshot.pose, review) for one in snapshot.landmarks]


def _landmark_row(
    name: str, pokes: Sequence[int], outcomes: Mapping[int, Outcome], pose: str, review: Review | None
) -> LandmarkRow:
    told, found = ({}, {}) if review is None else (review.told, review.rig.distances)
    off = _off([told[poke] for poke in pokes if poke in told], [found[poke] for poke in pokes if poke in found])
    return LandmarkRow(name, sum(outcomes[poke].pose == pose for poke in pokes), len(pokes), off)


def _off(told: Sequence[float], found: Sequence[float]) -> str:
    if not told:
        return DASH
    if not found:
        return millimetres(_rms(told))
    return f"{number(in_millimetres(_rms(told)), 1)} \N{RIGHTWARDS ARROW} {millimetres(_rms(found))}"


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
