"""Closing checks of a session: which pokes belong to each, and what they show; see `skincal.rig.closing`.

A check can be repeated, and the last one with a result counts. It ignores the pokes of earlier checks: something may have been
loose then that is fastened now. If a single poke decides that something moved, its place is repeated again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.model.scene import NoiseSettings
from skincal.pokes import LandmarkPokes, Pokes
from skincal.rig.closing import CLOSING_CHECK_PLACES, Closing, ClosingPlace, ClosingPlaces, closing_check
from skincal.session.decisions import ClosingRound
from skincal.session.snapshot import PokeRecord, Snapshot

CLOSING_CHECK_MAX_POKES_PER_PLACE = 3
"""Largest number of pokes for each place in a closing check."""
MIN_CONTACTS_BETWEEN_CLOSING_CHECKS = 10
"""Contacts since the last closing check until the next one: fewer are not worth its three pokes."""
MAX_REPEATS_OF_DECIDING_PLACE = 2
"""Repeats of a place after a single deciding poke: 68 to 81 of 100 movements of 8 mm are reported, without them 47 to 67."""


@dataclass(frozen=True, slots=True)
class ClosingProgress:
    """Progress of a closing check."""

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


def closings_of(snapshot: Snapshot, noise: NoiseSettings) -> tuple[Closing, ...]:
    """List the results of the final checks for movement, oldest first; one with too few repeated places is left out."""
    return tuple(each.found for each in closing_rounds(snapshot, noise) if each.found is not None)


def closing_rounds(snapshot: Snapshot, noise: NoiseSettings) -> list[ClosingProgress]:
    """Determine the progress of each closing check."""
    rounds = list[ClosingProgress]()
    if snapshot.decisions.closings:
        every = {ClosingPlaces.LANDMARKS: snapshot.counting_landmark_pokes, ClosingPlaces.TAXELS: taxel_pokes(snapshot)}
        for number in range(len(snapshot.decisions.closings)):
            earlier = frozenset[int]().union(*(each.pokes for each in rounds))
            rounds.append(_progress(snapshot, number, earlier, every, noise))
    return rounds


def _progress(
    snapshot: Snapshot,
    number: int,
    earlier: frozenset[int],
    every: dict[ClosingPlaces, LandmarkPokes],
    noise: NoiseSettings,
) -> ClosingProgress:
    """Determine the progress of a check, given by its index; `earlier` are the pokes of the checks before.

    Its pokes are the counting pokes after it began, until three places are repeated, nine pokes are made, or the next check
    begins. Later pokes belong to it only up to a place that had to be repeated.
    """
    begun, *later = snapshot.decisions.closings[number:]
    places = [
        (record.outcome.poke, _place(snapshot, record))
        for record in snapshot.pokes
        if not record.excluded and (not later or record.outcome.poke <= later[0].after)
    ]
    known = {place for poke, place in places if poke <= begun.after}
    since = [(poke, place) for poke, place in places if poke > begun.after]
    again, size, is_complete = set[ClosingPlace | None](), 0, False
    while not is_complete and size < min(len(since), CLOSING_CHECK_MAX_POKES_PER_PLACE * CLOSING_CHECK_PLACES):
        again |= (known & {since[size][1]}) - {None}
        size += 1
        is_complete = (
            max(sum(each is not None and each.at is at for each in again) for at in ClosingPlaces) == CLOSING_CHECK_PLACES
        )
    tried = size == CLOSING_CHECK_MAX_POKES_PER_PLACE * CLOSING_CHECK_PLACES
    while True:
        pokes = frozenset(poke for poke, _ in since[:size])
        found = _result(begun, pokes, earlier, every, noise)
        asked = _place_to_repeat(begun, found, pokes, every)
        if asked is None or not is_complete:
            break
        tries = [place for _, place in since[size : size + CLOSING_CHECK_MAX_POKES_PER_PLACE]]
        if asked not in tries:
            asked = asked if len(tries) < CLOSING_CHECK_MAX_POKES_PER_PLACE else None
            break
        size += tries.index(asked) + 1
    return ClosingProgress(pokes, found, is_complete, asked, asked is None if is_complete else tried)


def _result(
    begun: ClosingRound,
    pokes: frozenset[int],
    earlier: frozenset[int],
    every: dict[ClosingPlaces, LandmarkPokes],
    noise: NoiseSettings,
) -> Closing | None:
    for at, of_kind in every.items():
        then, first = of_kind[np.isin(of_kind.number, list(pokes))], pokes_before(of_kind, begun, earlier)
        # Of thousands of skin pokes, those at the same taxels; of landmark pokes all, which show the rig's errors.
        before = first if at is ClosingPlaces.LANDMARKS else first[np.isin(first.name, then.name)]
        closing = closing_check(before, then, at, noise)
        if closing is not None:
            return replace(closing, after=begun.after)
    return None


def pokes_before(pokes: LandmarkPokes, begun: ClosingRound, earlier: frozenset[int]) -> LandmarkPokes:
    """Select the pokes before a check began, without the pokes `earlier` of the checks before."""
    return pokes[(pokes.number <= begun.after) & ~np.isin(pokes.number, list(earlier))]


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
    return sum(contact.poke > last for contact in snapshot.contacts) >= MIN_CONTACTS_BETWEEN_CLOSING_CHECKS


def taxel_pokes(snapshot: Snapshot) -> LandmarkPokes:
    """Collect the skin pokes that count, as pokes at the taxel that answered most, named by its channel, if it is known."""
    places = {
        each.channel: each.position
        for estimates in snapshot.estimates.values()
        for each in estimates
        if each.position is not None
    }
    strongest = ((contact, contact.strongest_channel) for contact in snapshot.contacts)
    known = [(contact, channel) for contact, channel in strongest if channel in places]
    pokes = Pokes.collect(contact for contact, _ in known)
    return LandmarkPokes.at(pokes, [str(channel) for _, channel in known], [places[channel] for _, channel in known])


def _place(snapshot: Snapshot, record: PokeRecord) -> ClosingPlace | None:
    """Place of a poke; `None` if it was at no landmark and no taxel answered."""
    name = snapshot.at_landmarks.get(record.outcome.poke)
    if name is not None:
        return ClosingPlace(ClosingPlaces.LANDMARKS, name)
    if isinstance(record.outcome, Contact):
        return ClosingPlace(ClosingPlaces.TAXELS, str(record.outcome.strongest_channel))
    return None
