"""What landmark pokes say of the open session's rig: which corrections are offered, and which offers were announced."""

from __future__ import annotations

import re
from dataclasses import dataclass

from skincal.model.actions import Correct
from skincal.rig.correction import FRAME, RIG
from skincal.rig.frame_check import FrameDiagnosis
from skincal.sentences import frame_sentence
from skincal.session.corrections import offered
from skincal.session.review import Review
from skincal.session.snapshot import Snapshot


@dataclass(frozen=True, slots=True, eq=False)
class Offer:
    """A correction that could be used."""

    action: Correct
    frame: FrameDiagnosis | None = None
    """What it is found from, where it is of the sensor's frame."""
    anew: bool = False
    """Another correction of the rig is in use, found from fewer pokes or others."""


def offers_of(review: Review | None, snapshot: Snapshot) -> tuple[Offer, ...]:
    """Return what could be put right: the sensor's frame first, since all else was found under it."""
    if review is None or review.used is not snapshot.corrections:
        return ()
    frame, rig, pokes = review.frame, review.rig, len(review.pokes)
    action = offered(frame, rig, pokes, review.used)
    if action is None:
        return ()
    if action.of == FRAME and frame is not None:
        return (Offer(action, frame),)
    used = snapshot.corrections.get(RIG)
    if used is not None and used.pokes == pokes:
        return ()
    return (Offer(action, anew=used is not None),)


class RigReview:
    """Remembers the newest review and announces what it offers once."""

    def __init__(self) -> None:
        self.review: Review | None = None
        self._announced = set[tuple[str, bool, bool, str]]()
        """Kinds of offers that the operator knows of."""
        self._made: tuple[Review | None, object, tuple[Offer, ...]] = (None, None, ())
        """What the newest offers were made from, and they."""

    def shown(self, snapshot: Snapshot) -> Review | None:
        """Return the review, unless the session uses other corrections than those that it was made under."""
        review = self.review
        return review if review is not None and review.used is snapshot.corrections else None

    def offers(self, snapshot: Snapshot) -> tuple[Offer, ...]:
        """Return what could be put right; the same objects until something changes."""
        review, used, _ = self._made
        if review is not self.review or used is not snapshot.corrections:
            self._made = self.review, snapshot.corrections, offers_of(self.review, snapshot)
        return self._made[2]

    def news(self, snapshot: Snapshot) -> Offer | None:
        """Return an offer that is of another kind than those before, once."""
        offer = next(iter(self.offers(snapshot)), None)
        if offer is None:
            return None
        frame = offer.frame
        # Another number in the same words is no news.
        words = "" if frame is None else re.sub(r"[\d.]+", "", frame_sentence(frame))
        kind = offer.action.of, offer.anew, frame is not None and frame.sure, words
        if kind in self._announced:
            return None
        self._announced.add(kind)
        return offer
