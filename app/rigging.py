"""What landmark pokes tell of the open session's rig, and what of it was offered already."""

from __future__ import annotations

import re

from app.rig_offers import Offer, offers_of
from skincal.session.review import Review
from skincal.session.snapshot import Snapshot


class Rigging:
    """Remembers the newest review and makes its offers once."""

    def __init__(self) -> None:
        self.review: Review | None = None
        self._told = set[str]()
        """Words of offers that the operator was told of, without their numbers."""
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

    def news(self, snapshot: Snapshot) -> str:
        """Return what the operator is told of a new offer, once; empty where there is none."""
        offer = next(iter(self.offers(snapshot)), None)
        kind = "" if offer is None else re.sub(r"[\d.]+", "", offer.text + offer.words)
        if offer is None or kind in self._told:
            return ""
        self._told.add(kind)
        return f"{offer.words} C uses that; the Rig tab says more, and takes it back."
