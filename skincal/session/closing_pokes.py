"""The closing check of a session: which pokes were made once more at its end, and what they say; see `skincal.rig.closing`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray
from skincal.model.scene import NoiseSettings
from skincal.rig.closing import PLACES, Closing, ClosingPlaces, closing_check
from skincal.rig.correction_fit import LandmarkPoke
from skincal.session.landmark_pokes import landmark_pokes
from skincal.session.snapshot import Snapshot

TRIES = 3
"""Pokes for each place of the closing check, after which nothing is asked for any more."""


def closing_of(snapshot: Snapshot, noise: NoiseSettings) -> Closing | None:
    """Return what the closing check of a session found; None where none began, or too few places were poked once more."""
    after = snapshot.closing_after
    if after is None:
        return None
    # What is poked once the check was made, or given up, is the work again, and may be thousands.
    made = [record.outcome.poke for record in snapshot.pokes if record.outcome.poke > after][: TRIES * PLACES]
    last = max(made, default=after)
    for at, pokes in ((ClosingPlaces.LANDMARKS, at_landmarks(snapshot)), (ClosingPlaces.TAXELS, at_taxels(snapshot))):
        then = [poke for poke in pokes if after < poke.poke <= last]
        again = {poke.name for poke in then}
        # Of thousands of pokes on the skin, those at the same taxels; of landmarks all, which tell of the rig.
        before = [poke for poke in pokes if poke.poke <= after and (at is ClosingPlaces.LANDMARKS or poke.name in again)]
        found = closing_check(before, then, at, noise)
        if found is not None:
            return found
    return None


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


def first_names(pokes: Sequence[LandmarkPoke], pose: str, after: int | None, count: int) -> list[str]:
    """Return the places that were poked first in an arm pose, until the closing check began after poke `after`."""
    early = (poke.name for poke in pokes if poke.pose == pose and (after is None or poke.poke <= after))
    return list(dict.fromkeys(early))[:count]


def strongest(contact: Contact) -> int:
    """Return the channel that answered most."""
    return int(contact.channels[contact.responses.argmax()])


def _places(snapshot: Snapshot) -> Mapping[int, FloatArray]:
    """Return (3,) float, metres, of the taxels that some method knows, by their channel."""
    found: dict[int, FloatArray] = {}
    for estimates in snapshot.estimates.values():
        found |= {each.channel: each.position for each in estimates if each.position is not None}
    return found
