"""The closing checks of a session: which pokes were made once more at its end, and what they say; see `skincal.rig.closing`.

A check may be made again, and the last one that found something counts. Pokes of the checks before are left out of it: they
may have been made while something had moved that is fastened by now. Where one poke alone says that something moved, its place
is poked once more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray
from skincal.model.scene import NoiseSettings
from skincal.rig.closing import CHECKED_PLACES, Closing, ClosingPlace, ClosingPlaces, closing_check
from skincal.rig.correction_fit import LandmarkPoke
from skincal.session.decisions import ClosingRound
from skincal.session.landmark_pokes import landmark_pokes
from skincal.session.snapshot import PokeRecord, Snapshot

MAX_POKES_PER_PLACE = 3
"""Pokes for each place of the closing check, after which nothing is asked for any more."""
MIN_CONTACTS_BETWEEN_CHECKS = 10
"""Contacts since the last closing check, from which on another is due: for fewer its three pokes are not worth it."""
MAX_REPEATS = 2
"""How often a place is asked for once more, because one poke alone says that something moved: with it 68 to 81 of 100
movements of 8 mm are told, without it 47 to 67."""


@dataclass(frozen=True, slots=True)
class ClosingSoFar:
    """How far a closing check is."""

    made: frozenset[int] = frozenset()
    """Numbers of its pokes."""
    found: Closing | None = None
    """None where too few places were poked once more."""
    whole: bool = False
    """All its places were poked once more."""
    once_more: ClosingPlace | None = None
    """To be poked once more, because one poke there alone says that something moved."""
    over: bool = False
    """It gets no more pokes."""


_Places: TypeAlias = Mapping[ClosingPlaces, Sequence[LandmarkPoke]]


def closings_of(snapshot: Snapshot, noise: NoiseSettings) -> tuple[Closing, ...]:
    """Return what the closing checks found, in their order; nothing of one with too few places poked once more."""
    return tuple(each.found for each in closing_rounds(snapshot, noise) if each.found is not None)


def closing_rounds(snapshot: Snapshot, noise: NoiseSettings) -> list[ClosingSoFar]:
    """Return how far each closing check is."""
    rounds = list[ClosingSoFar]()
    if not snapshot.decisions.closings:
        return rounds
    every = {ClosingPlaces.LANDMARKS: at_landmarks(snapshot), ClosingPlaces.TAXELS: at_taxels(snapshot)}
    for number, begun in enumerate(snapshot.decisions.closings):
        before = frozenset[int]().union(*(each.made for each in rounds))
        early = {at: [p for p in pokes if p.poke <= begun.after and p.poke not in before] for at, pokes in every.items()}
        rounds.append(_so_far(snapshot, number, early, every, noise))
    return rounds


def _so_far(snapshot: Snapshot, number: int, early: _Places, every: _Places, noise: NoiseSettings) -> ClosingSoFar:
    """Return how far a closing check is, given by its number from 0.

    Its pokes are those that count since it began, until so many places were poked once more that it was made, until it was
    tried often enough, or until the next one began; then those up to each place that is asked for because of one poke. What is
    poked after that is the work again, and may be thousands.
    """
    begun, (known, since) = snapshot.decisions.closings[number], _known_and_since(snapshot, number)
    size, whole = _first_part(known, since)
    tried = size == MAX_POKES_PER_PLACE * CHECKED_PLACES
    while True:
        made = frozenset(poke for poke, _ in since[:size])
        found = _found(begun, made, early, every, noise)
        asked = _asked_once_more(begun, found, made, every)
        if asked is None or not whole:
            break
        tries = [place for _, place in since[size : size + MAX_POKES_PER_PLACE]]
        if asked not in tries:
            asked = asked if len(tries) < MAX_POKES_PER_PLACE else None
            break
        size += tries.index(asked) + 1
    return ClosingSoFar(made, found, whole, asked, asked is None if whole else tried)


def _known_and_since(snapshot: Snapshot, number: int) -> tuple[set[ClosingPlace], list[tuple[int, ClosingPlace | None]]]:
    """Return the places that were poked before a check began, and the pokes since, until the next one, with their places."""
    first, *later = (begun.after for begun in snapshot.decisions.closings[number:])
    known, since = set[ClosingPlace](), list[tuple[int, ClosingPlace | None]]()
    for record in snapshot.pokes:
        poke = record.outcome.poke
        if record.excluded or (later and poke > later[0]):
            continue
        place = _place(snapshot, record)
        if poke > first:
            since.append((poke, place))
        elif place is not None:
            known.add(place)
    return known, since


def _first_part(known: set[ClosingPlace], since: Sequence[tuple[int, ClosingPlace | None]]) -> tuple[int, bool]:
    """Return how many pokes it took until so many places were poked once more, or tried often enough; whether they were."""
    again = set[ClosingPlace]()
    for made, (_, place) in enumerate(since[: MAX_POKES_PER_PLACE * CHECKED_PLACES], 1):
        again |= known & {place}
        if max(sum(each.at is at for each in again) for at in ClosingPlaces) == CHECKED_PLACES:
            return made, True
    return len(since[: MAX_POKES_PER_PLACE * CHECKED_PLACES]), False


def _found(begun: ClosingRound, made: frozenset[int], early: _Places, every: _Places, noise: NoiseSettings) -> Closing | None:
    for at, pokes in every.items():
        then = [poke for poke in pokes if poke.poke in made]
        again = {poke.name for poke in then}
        # Of thousands of pokes on the skin, those at the same taxels; of landmarks all, which tell of the rig.
        before = [poke for poke in early[at] if at is ClosingPlaces.LANDMARKS or poke.name in again]
        closing = closing_check(before, then, at, noise)
        if closing is not None:
            return replace(closing, after=begun.after)
    return None


def _asked_once_more(begun: ClosingRound, found: Closing | None, made: frozenset[int], every: _Places) -> ClosingPlace | None:
    """Return the place of the one poke that says that something moved, so long as it is asked for."""
    if found is None or not found.single_poke_decides or begun.ended:
        return None
    place = ClosingPlace(found.at, found.place)
    again = sum(poke.poke in made and poke.name in found.names for poke in every[found.at])
    asked = again - min(len(found.names), CHECKED_PLACES)
    return place if asked < MAX_REPEATS and place not in begun.skipped else None


def is_due(snapshot: Snapshot, rounds: Sequence[ClosingSoFar]) -> bool:
    """Return whether so much was poked since the newest closing check that another is due; it is over, or there was none."""
    if not rounds:
        return True
    last = max(rounds[-1].made, default=snapshot.decisions.closings[-1].after)
    return sum(contact.poke > last for contact in snapshot.contacts) >= MIN_CONTACTS_BETWEEN_CHECKS


def at_landmarks(snapshot: Snapshot) -> list[LandmarkPoke]:
    """Return the pokes at landmarks that count."""
    counting = (record.outcome for record in snapshot.pokes if not record.excluded)
    return landmark_pokes(counting, snapshot.decisions.landmarks, snapshot.at_landmarks)


def at_taxels(snapshot: Snapshot) -> list[LandmarkPoke]:
    """Return the pokes on the skin that count as pokes at the taxel that answered most, by its channel, where that is known."""
    places = _places(snapshot)
    return [
        LandmarkPoke(c.poke, str(channel), places[channel], c.force, c.moment, c.link_from_sensor, c.pose)
        for c, channel in ((contact, contact.strongest_channel) for contact in snapshot.contacts)
        if channel in places
    ]


def first_names(pokes: Sequence[LandmarkPoke], pose: str, count: int) -> list[str]:
    """List the places that were poked first in an arm pose."""
    return list(dict.fromkeys(poke.name for poke in pokes if poke.pose == pose))[:count]


def _place(snapshot: Snapshot, record: PokeRecord) -> ClosingPlace | None:
    """Return where a poke was; None where it was at no landmark, and no taxel answered."""
    name = snapshot.at_landmarks.get(record.outcome.poke)
    if name is not None:
        return ClosingPlace(ClosingPlaces.LANDMARKS, name)
    if isinstance(record.outcome, Contact):
        return ClosingPlace(ClosingPlaces.TAXELS, str(record.outcome.strongest_channel))
    return None


def _places(snapshot: Snapshot) -> Mapping[int, FloatArray]:
    """Return (3,) float, metres, of the taxels that some method knows, by their channel."""
    found: dict[int, FloatArray] = {}
    for estimates in snapshot.estimates.values():
        found |= {each.channel: each.position for each in estimates if each.position is not None}
    return found
