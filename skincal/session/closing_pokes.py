"""Closing checks of a session: which pokes belong to each, and what they show; see `skincal.rig.closing`.

A check can be repeated, and the last one with a result counts. It ignores the pokes of earlier checks: something may have been
loose then that is fastened now. If a single poke decides that something moved, its place is repeated again.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile, zip_longest
from math import inf
from typing import NamedTuple

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import BoolArray, FloatArray, IntArray
from skincal.model.scene import NoiseSettings
from skincal.pokes import LandmarkPokes, Pokes
from skincal.rig.closing import CLOSING_CHECK_PLACES, Closing, ClosingPlace, ClosingPlaces, closing_check
from skincal.session.decisions import ClosingRound
from skincal.session.snapshot import PokeRecord, Snapshot

CLOSING_CHECK_MAX_POKES_PER_PLACE = 3
"""Largest number of pokes for each place in a closing check."""
MIN_CONTACTS_BETWEEN_CLOSING_CHECKS = 10
"""Contacts since the last closing check until the next one: fewer are not worth its three pokes..."""
MIN_SHARE_BETWEEN_CLOSING_CHECKS = 0.1
"""...and neither are those that are a smaller share of the contacts before them. So the number of checks grows with the
logarithm of the contacts of a robot that pokes for days."""
MAX_REPEATS_OF_DECIDING_PLACE = 2
"""Repeats of a place after a single deciding poke: 68 to 81 of 100 movements of 8 mm are reported, without them 47 to 67."""


@dataclass(frozen=True, slots=True)
class ClosingProgress:
    """Progress of a closing check."""

    begun: ClosingRound
    """Its request and skips."""
    earlier: frozenset[int] = frozenset()
    """Numbers of the pokes of the checks before it."""
    pokes: frozenset[int] = frozenset()
    """Numbers of its pokes."""
    found: Closing | None = None
    """`None` while too few places are repeated."""
    is_complete: bool = False
    """All its places are repeated."""
    repeat_place: ClosingPlace | None = None
    """Place to repeat, because a single poke there decides that something moved."""
    is_finished: bool = False
    """It gets no more pokes."""

    def is_before(self, numbers: IntArray) -> BoolArray:
        """Whether each of some pokes was made before the check began, and for no earlier check."""
        return (numbers <= self.begun.after) & ~np.isin(numbers, list(self.earlier))


def closings_of(snapshot: Snapshot, noise: NoiseSettings) -> tuple[Closing, ...]:
    """List the results of the final checks for movement, oldest first; one with too few repeated places is left out."""
    return tuple(each.found for each in closing_rounds(snapshot, noise) if each.found is not None)


def closing_rounds(snapshot: Snapshot, noise: NoiseSettings) -> list[ClosingProgress]:
    """Determine the progress of each closing check."""
    return ClosingRounds(noise).list_rounds(snapshot)


class _KnownRound(NamedTuple):
    """A closing check with what it was determined from."""

    progress: ClosingProgress
    channels: frozenset[int]
    """Of its taxels."""
    places: dict[int, bytes]
    """Position of each of them that has one, as bytes."""
    last: int | None
    """Later pokes change nothing; `None` while any poke may."""


class ClosingRounds:
    """Progress of the closing checks from snapshot to snapshot of a session.

    A check that is over is kept while nothing that it reads has changed: decisions, the pokes until its end, and the positions
    of its taxels. A robot that pokes for days makes a dozen checks, of 3 ms each.
    """

    def __init__(self, noise: NoiseSettings) -> None:
        self._noise = noise
        self._seen: Snapshot | None = None
        self._rounds: list[_KnownRound] = []

    def list_rounds(self, snapshot: Snapshot) -> list[ClosingProgress]:
        """Determine the progress of each check."""
        kept, closings = self._unchanged(snapshot), snapshot.decisions.closings
        # Each check leaves out the pokes of those before it.
        self._rounds = [
            *takewhile(lambda known: known.places == _places_of(snapshot, known.channels), self._rounds[:kept]),
        ]
        for begun, following in list(zip_longest(closings, closings[1:]))[len(self._rounds) :]:
            check = begin_check(begun, [known.progress for known in self._rounds])
            progress = _progress(snapshot, check, following, self._noise)
            last = int(snapshot.columns.numbers.max(initial=0)) if progress.is_finished else None
            last = last if following is None else following.after
            channels = frozenset(strongest_of(snapshot, progress.pokes))
            self._rounds.append(_KnownRound(progress, channels, _places_of(snapshot, channels), last))
        self._seen = snapshot
        return [known.progress for known in self._rounds]

    def _unchanged(self, snapshot: Snapshot) -> int:
        """Count the first checks whose pokes and decisions are those of the last snapshot."""
        seen = self._seen
        if seen is None or seen.decisions is not snapshot.decisions or seen.landmark_pokes is not snapshot.landmark_pokes:
            return 0
        first = min(snapshot.changes_since(seen), default=inf)
        return len(list(takewhile(lambda known: known.last is not None and known.last < first, self._rounds)))


def _places_of(snapshot: Snapshot, channels: Collection[int]) -> dict[int, bytes]:
    """Look up the positions of some channels, as bytes."""
    return {channel: position.tobytes() for channel, position in positions_of(snapshot, channels).items()}


def begin_check(begun: ClosingRound, rounds: Sequence[ClosingProgress]) -> ClosingProgress:
    """Begin a closing check after the checks `rounds`."""
    return ClosingProgress(begun, frozenset[int]().union(*(each.pokes for each in rounds)))


def _progress(
    snapshot: Snapshot, check: ClosingProgress, following: ClosingRound | None, noise: NoiseSettings
) -> ClosingProgress:
    """Determine the progress of a check without pokes so far, up to the `following` check.

    Its pokes are the counting pokes after it began, until three places are repeated, nine pokes are made, or the next check
    begins. Later pokes belong to it only up to a place that had to be repeated.
    """
    begun = check.begun
    numbers = snapshot.columns.numbers
    is_of_check = ~snapshot.columns.excluded & (numbers > begun.after)
    if following is not None:
        is_of_check &= numbers <= following.after
    since: list[int] = np.flatnonzero(is_of_check).tolist()
    again, size, is_complete = set[ClosingPlace](), 0, False
    while not is_complete and size < min(len(since), CLOSING_CHECK_MAX_POKES_PER_PLACE * CLOSING_CHECK_PLACES):
        place = _place(snapshot, snapshot.pokes[since[size]])
        if place is not None and _was_poked(snapshot, place, begun):
            again.add(place)
        size += 1
        is_complete = max(sum(each.at is at for each in again) for at in ClosingPlaces) == CLOSING_CHECK_PLACES
    tried = size == CLOSING_CHECK_MAX_POKES_PER_PLACE * CLOSING_CHECK_PLACES
    while True:
        pokes = frozenset(snapshot.pokes[row].outcome.poke for row in since[:size])
        every = _pokes_at_places_of(snapshot, pokes)
        found = _result(check, pokes, every, noise)
        asked = _place_to_repeat(begun, found, pokes, every)
        if asked is None or not is_complete:
            break
        tries = [_place(snapshot, snapshot.pokes[row]) for row in since[size : size + CLOSING_CHECK_MAX_POKES_PER_PLACE]]
        if asked not in tries:
            asked = asked if len(tries) < CLOSING_CHECK_MAX_POKES_PER_PLACE else None
            break
        size += tries.index(asked) + 1
    return replace(
        check,
        pokes=pokes,
        found=found,
        is_complete=is_complete,
        repeat_place=asked,
        is_finished=asked is None if is_complete else tried,
    )


def _was_poked(snapshot: Snapshot, place: ClosingPlace, begun: ClosingRound) -> bool:
    """Whether a place was poked before a check began."""
    columns = snapshot.columns
    before = ~columns.excluded & (columns.numbers <= begun.after)
    at_landmarks = np.isin(columns.numbers, list(snapshot.at_landmarks))
    if place.at is ClosingPlaces.TAXELS:
        return bool(np.any(before & ~at_landmarks & (columns.strongest == int(place.name))))
    pokes = columns.numbers[before & at_landmarks].tolist()
    return any(snapshot.at_landmarks[poke] == place.name for poke in pokes)


def _pokes_at_places_of(snapshot: Snapshot, pokes: frozenset[int]) -> dict[ClosingPlaces, LandmarkPokes]:
    """Collect all landmark pokes, and of thousands of skin pokes those at the same taxels as `pokes`."""
    at_taxels = taxel_pokes(snapshot, strongest_of(snapshot, pokes))
    marked = snapshot.counting_landmark_pokes
    # A robot that drives to a landmark touches the same place again although the part has moved.
    marked = marked[~np.isin(marked.number, list(snapshot.decisions.driven_to_landmarks))]
    return {ClosingPlaces.LANDMARKS: marked, ClosingPlaces.TAXELS: at_taxels}


def _result(
    check: ClosingProgress, pokes: frozenset[int], every: dict[ClosingPlaces, LandmarkPokes], noise: NoiseSettings
) -> Closing | None:
    for at, of_kind in every.items():
        then, before = of_kind[np.isin(of_kind.number, list(pokes))], of_kind[check.is_before(of_kind.number)]
        # Of the skin pokes those at the same taxels; of landmark pokes all, which show the rig's errors.
        before = before if at is ClosingPlaces.LANDMARKS else before[np.isin(before.name, then.name)]
        closing = closing_check(before, then, at, noise)
        if closing is not None:
            return replace(closing, after=check.begun.after)
    return None


def _place_to_repeat(
    begun: ClosingRound, found: Closing | None, pokes: frozenset[int], every: dict[ClosingPlaces, LandmarkPokes]
) -> ClosingPlace | None:
    """Place of the single poke that decides; `None` if there is none, or it was repeated or skipped."""
    if found is None or not found.single_poke_decides or begun.ended:
        return None
    place = ClosingPlace(found.at, found.place)
    of_kind = every[found.at]
    again = int(np.sum(np.isin(of_kind.number, list(pokes)) & np.isin(of_kind.name, found.names)))
    asked = again - min(len(found.names), CLOSING_CHECK_PLACES)
    return place if asked < MAX_REPEATS_OF_DECIDING_PLACE and place not in begun.skipped else None


def is_due(snapshot: Snapshot, rounds: Sequence[ClosingProgress]) -> bool:
    """Whether it is time for a closing check: there was none, or enough was poked since the last one."""
    if not rounds:
        return True
    last = max(rounds[-1].pokes, default=snapshot.decisions.closings[-1].after)
    counting = snapshot.columns.numbers[snapshot.columns.counting]
    new = int(np.count_nonzero(counting > last))
    return new >= max(MIN_CONTACTS_BETWEEN_CLOSING_CHECKS, MIN_SHARE_BETWEEN_CLOSING_CHECKS * (len(counting) - new))


def strongest_of(snapshot: Snapshot, pokes: Collection[int]) -> set[int]:
    """Collect the channels that answered those of some pokes most that count."""
    columns = snapshot.columns
    return set(columns.strongest[columns.counting & np.isin(columns.numbers, list(pokes))].tolist())


def taxel_pokes(snapshot: Snapshot, channels: Collection[int]) -> LandmarkPokes:
    """Collect the skin pokes that count and that some taxels answered most, named by its channel, if it has a position."""
    places = positions_of(snapshot, channels)
    columns = snapshot.columns
    rows = np.flatnonzero(columns.counting & np.isin(columns.strongest, list(places)))
    pokes = Pokes.collect(snapshot.pokes[row].outcome for row in rows.tolist())
    names = columns.strongest[rows].tolist()
    return LandmarkPokes.at(pokes, list(map(str, names)), [places[channel] for channel in names])


def first_taxels(snapshot: Snapshot, check: ClosingProgress, pose: str) -> list[int]:
    """List the first taxels with a position that were poked in an arm pose before a check began, as many as it needs."""
    columns, found = snapshot.columns, list[int]()
    if pose not in columns.pose_names:
        return found
    is_before = columns.counting & check.is_before(columns.numbers)
    waiting = columns.strongest[is_before & (columns.poses == columns.pose_names.index(pose))]
    while len(waiting) and len(found) < CLOSING_CHECK_PLACES:
        channel = int(waiting[0])
        found += list(positions_of(snapshot, [channel]))
        waiting = waiting[waiting != channel]
    return found


def positions_of(snapshot: Snapshot, channels: Collection[int]) -> dict[int, FloatArray]:
    """Look up the positions of some channels, (3,) float, metres, by the last method that has one."""
    found = ((channel, snapshot.estimate_of(channel, method)) for method in snapshot.estimates for channel in channels)
    return {channel: each.position for channel, each in found if each is not None and each.position is not None}


def _place(snapshot: Snapshot, record: PokeRecord) -> ClosingPlace | None:
    """Place of a poke; `None` if it was at no landmark and no taxel answered."""
    name = snapshot.at_landmarks.get(record.outcome.poke)
    if name is not None:
        return ClosingPlace(ClosingPlaces.LANDMARKS, name)
    if isinstance(record.outcome, Contact):
        return ClosingPlace(ClosingPlaces.TAXELS, str(record.outcome.strongest_channel))
    return None
