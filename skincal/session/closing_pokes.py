"""The closing checks of a session: which pokes were made once more at its end, and what they say; see `skincal.rig.closing`.

A check may be made again, and the last one that found something counts. Pokes of the checks before are left out of it: they
may have been made while something had moved that is fastened by now.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray
from skincal.model.scene import NoiseSettings
from skincal.rig.closing import PLACES, Closing, ClosingPlace, ClosingPlaces, closing_check
from skincal.rig.correction_fit import LandmarkPoke
from skincal.session.landmark_pokes import landmark_pokes
from skincal.session.snapshot import PokeRecord, Snapshot

TRIES = 3
"""Pokes for each place of the closing check, after which nothing is asked for any more."""
AGAIN = 10
"""Contacts since the last closing check, from which on another is due: for fewer its three pokes are not worth it."""
StanceOf = Callable[[str, FloatArray | None], str]
"""Gives poses of the arm that are nearly the same the same name: `Stances.key`."""


def closings_of(snapshot: Snapshot, noise: NoiseSettings) -> tuple[Closing, ...]:
    """Return what the closing checks found, in their order; nothing of one with too few places poked once more."""
    found = list[Closing]()
    if not snapshot.closings:
        return ()
    every = ((ClosingPlaces.LANDMARKS, at_landmarks(snapshot)), (ClosingPlaces.TAXELS, at_taxels(snapshot)))
    before = set[int]()
    for number, begun in enumerate(snapshot.closings):
        made, _ = closing_pokes(snapshot, number)
        for at, pokes in every:
            then = [poke for poke in pokes if poke.poke in made]
            again = {poke.name for poke in then}
            # Of thousands of pokes on the skin, those at the same taxels; of landmarks all, which tell of the rig.
            early = [poke for poke in pokes if poke.poke <= begun.after and poke.poke not in before]
            early = [poke for poke in early if at is ClosingPlaces.LANDMARKS or poke.name in again]
            closing = closing_check(early, then, at, noise)
            if closing is not None:
                found.append(replace(closing, after=begun.after))
                break
        before |= made
    return tuple(found)


def closing_pokes(snapshot: Snapshot, number: int) -> tuple[frozenset[int], bool]:
    """Return the pokes of a closing check, given by its number from 0, and whether they are all that it gets.

    They are those that count since it began, until so many places were poked once more that it was made, until it was tried
    often enough, or until the next one began. What is poked after that is the work again, and may be thousands.
    """
    rounds = snapshot.closings
    first, last = rounds[number].after, rounds[number + 1].after if number + 1 < len(rounds) else None
    early, again, made = set[ClosingPlace](), set[ClosingPlace](), list[int]()
    for record in snapshot.pokes:
        poke, place = record.outcome.poke, None if record.excluded else _place(snapshot, record)
        if poke <= first:
            early |= set() if place is None else {place}
        elif not record.excluded and (last is None or poke <= last):
            made.append(poke)
            again |= early & {place}
            done = max(sum(each.at is at for each in again) for at in ClosingPlaces)
            if done == PLACES or len(made) == TRIES * PLACES:
                return frozenset(made), True
    return frozenset(made), False


def is_over(snapshot: Snapshot) -> bool:
    """Return whether the newest closing check was ended, or got all its pokes."""
    return snapshot.closings[-1].ended or closing_pokes(snapshot, len(snapshot.closings) - 1)[1]


def is_due(snapshot: Snapshot) -> bool:
    """Return whether so much was poked since the newest closing check that another is due; it is over, or there was none."""
    if not snapshot.closings:
        return True
    made, _ = closing_pokes(snapshot, len(snapshot.closings) - 1)
    last = max(made, default=snapshot.closings[-1].after)
    return sum(contact.poke > last for contact in snapshot.contacts) >= AGAIN


def at_landmarks(snapshot: Snapshot) -> list[LandmarkPoke]:
    """Return the pokes at landmarks that count."""
    counting = (record.outcome for record in snapshot.pokes if not record.excluded)
    return landmark_pokes(counting, snapshot.landmarks, snapshot.at_landmarks)


def at_taxels(snapshot: Snapshot) -> list[LandmarkPoke]:
    """Return the pokes on the skin that count as pokes at the taxel that answered most, by its channel, where that is known."""
    places = _places(snapshot)
    return [
        LandmarkPoke(c.poke, str(channel), places[channel], c.force, c.moment, c.link_from_sensor, c.pose)
        for c, channel in ((contact, strongest(contact)) for contact in snapshot.contacts)
        if channel in places
    ]


def first_names(pokes: Sequence[LandmarkPoke], stance: str, stance_of: StanceOf, count: int) -> list[str]:
    """Return the places that were poked first in an arm pose, or nearly in it."""
    early = (poke.name for poke in pokes if stance_of(poke.pose, poke.link_from_sensor) == stance)
    return list(dict.fromkeys(early))[:count]


def strongest(contact: Contact) -> int:
    """Return the channel that answered most."""
    return int(contact.channels[contact.responses.argmax()])


def _place(snapshot: Snapshot, record: PokeRecord) -> ClosingPlace | None:
    """Return where a poke was; None where it was at no landmark, and no taxel answered."""
    name = snapshot.at_landmarks.get(record.outcome.poke)
    if name is not None:
        return ClosingPlace(ClosingPlaces.LANDMARKS, name)
    if isinstance(record.outcome, Contact):
        return ClosingPlace(ClosingPlaces.TAXELS, str(strongest(record.outcome)))
    return None


def _places(snapshot: Snapshot) -> Mapping[int, FloatArray]:
    """Return (3,) float, metres, of the taxels that some method knows, by their channel."""
    found: dict[int, FloatArray] = {}
    for estimates in snapshot.estimates.values():
        found |= {each.channel: each.position for each in estimates if each.position is not None}
    return found
