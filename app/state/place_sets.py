"""Sets of places that can be laid over each other: the layout, each method also before and after a correction, and others.

Others are a simulated rig's truth, files, and other sessions, as they were offered.

Pure: which sets there are and what they hold follows from the views' state. Places stand in the order of the part's channels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np

from app.state.view_state import ViewState
from skincal.geometry import FloatArray, IntArray
from skincal.session.review import Review
from skincal.taxels.differences import places_of
from skincal.taxels.result import Method


class PlaceOrigin(Enum):
    """Where places come from."""

    LAYOUT = "layout"
    METHOD = "method"
    BEFORE = "before correction"
    AFTER = "after correction"
    TRUTH = "truth"
    OTHER = "other"
    """A file, or another session."""


@dataclass(frozen=True, slots=True)
class Source:
    """One set of places."""

    origin: PlaceOrigin
    method: Method | None = None
    """None for the layout, the truth and others."""
    name: str = ""
    """Of another one."""
    path: Path | None = None
    """From where another one was read; None where nobody says."""


LAYOUT = Source(PlaceOrigin.LAYOUT)


def other_source(name: str, path: Path, known: Sequence[Source]) -> Source:
    """Return the source of places read from `path`, with a name that no known source from elsewhere has.

    Two sessions of a day may both be called `session`: then the folder that the later one lies in tells them apart.
    """
    taken = {source.name for source in known if source.path != path}
    named = (name, f"{name} ({path.parent.name})", f"{name} ({path.parent})")
    return Source(PlaceOrigin.OTHER, name=next((each for each in named if each not in taken), f"{name} ({path})"), path=path)


UNKNOWN = np.full(3, np.nan)
"""Where a taxel is that a set does not know."""
Pair = tuple[Source, Source]


def sources_of(
    methods: Sequence[Method], review: Review | None, *, laid: bool, others: Sequence[Source] = ()
) -> tuple[Source, ...]:
    """Return the sets of places that there are, methods in their order; the layout where it is `laid` on the part."""
    found = [LAYOUT] if laid else []
    found += [Source(PlaceOrigin.METHOD, method) for method in methods]
    if review is not None:
        reviewed = [method for method in methods if method in review.before or method in review.after]
        found += [Source(origin, method) for origin in (PlaceOrigin.BEFORE, PlaceOrigin.AFTER) for method in reviewed]
    return (*found, *others)


def default_pair(sources: Sequence[Source], shown: Method) -> Pair:
    """Return what is compared while the operator chose nothing: the layout with the shown method, or free with surface."""
    free, surface = Source(PlaceOrigin.METHOD, Method.FREE), Source(PlaceOrigin.METHOD, Method.SURFACE)
    if LAYOUT in sources:
        return LAYOUT, Source(PlaceOrigin.METHOD, shown)
    return free, surface if surface in sources else next((source for source in sources if source != free), free)


class Places:
    """Where each source puts the taxels of a part, worked out once for what it follows from.

    `laid` is the layout's place of each channel, (width, 3) float, metres; None where it has none on the part.
    """

    def __init__(self, channels: IntArray, laid: FloatArray | None) -> None:
        self.channels = channels
        self._laid = None if laid is None or not np.isfinite(laid[channels]).any() else laid[channels]
        self._kept: dict[Source, tuple[object, FloatArray]] = {}
        self._others: dict[Source, FloatArray] = {}

    @property
    def laid(self) -> bool:
        """Whether the layout has a place on the part."""
        return self._laid is not None

    @property
    def others(self) -> tuple[Source, ...]:
        """The sets that were offered, in that order."""
        return tuple(self._others)

    def offer(self, source: Source, places: Mapping[int, FloatArray]) -> None:
        """Take a set of places, (3,) float, metres, link frame, by channel, in place of another of its name."""
        self._others[source] = np.array([places.get(channel, UNKNOWN) for channel in self.channels.tolist()]).reshape(-1, 3)

    def find(self, source: Source, state: ViewState) -> FloatArray:
        """Return the places of a source at a tick, (n, 3) float, metres, link frame; NaN where unknown."""
        if source in self._others:
            return self._others[source]
        if source.method is None:
            return self._unknown() if self._laid is None else self._laid
        review = state.review
        reviewed = None if review is None else _reviewed(source, source.method, review)
        found = state.snapshot.estimates.get(source.method, ()) if reviewed is None else reviewed
        kept, places = self._kept.get(source, (None, None))
        # The same estimates, by identity, give the same places.
        if kept is not found or places is None:
            if review is not None and reviewed is not None:
                places = self._in_order(review.channels, reviewed)
            else:
                estimates = state.snapshot.estimates.get(source.method, ())
                places = places_of(estimates) if len(estimates) == len(self.channels) else self._unknown()
            self._kept[source] = found, places
        return places

    def _in_order(self, channels: IntArray, found: FloatArray) -> FloatArray:
        places = self._unknown()
        _, own, theirs = np.intersect1d(self.channels, channels, assume_unique=True, return_indices=True)
        places[own] = found[theirs]
        return places

    def _unknown(self) -> FloatArray:
        return np.full((len(self.channels), 3), np.nan)


def _reviewed(source: Source, method: Method, review: Review) -> FloatArray | None:
    """Return the places that a review holds of a source; None where the session's own estimates are these.

    While a correction is in use the session's estimates are those after it, else those before it; the review holds the others.
    """
    if source.origin is PlaceOrigin.METHOD:
        return None
    return (review.before if source.origin is PlaceOrigin.BEFORE else review.after).get(method)
