"""The pokes of a session as the guide sees them: where each was, which taxel it was meant for, how far it leaned, how it ended.

An outcome arrives twice, at its release and when the tare after it is known, and may be taken out again: what it taught is
counted once, and forgotten when it is gone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.geometry import FloatArray, IntArray, axis_point, move_wrench
from skincal.guide.guidance import Target
from skincal.guide.progress import RECENT, GuideSettings, Tilt

TargetOfPoke: TypeAlias = Callable[[int], Target | None]
"""Gives what a poke, by its number, was asked for; None where nothing is known of that."""
AT = 0.010
"""m. A poke whose axis passes the asked place by less was meant for it: two taxels away is another poke."""


@dataclass(frozen=True, slots=True, eq=False)
class PokeAxis:
    """A poke's force axis, link frame."""

    direction: FloatArray
    """(3,) float, unit: the way it pushes."""
    point: FloatArray
    """(3,) float, metres, on the axis."""

    def away(self, place: FloatArray) -> float:
        """Return how far it passes a place, (3,) metres."""
        off = np.cross(place - self.point, self.direction)
        return float(np.sqrt(off @ off))

    def tilt(self, normal: FloatArray) -> float:
        """Return how far it leans from the skin's inward normal, rad; `normal` (3,) is outward, unit."""
        return float(np.arccos(np.clip(-(self.direction @ normal), -1.0, 1.0)))


def axis_of(poke: Contact | Rejection) -> PokeAxis | None:
    """Return a poke's force axis; None where its force is not known."""
    if poke.force is None or poke.moment is None or poke.link_from_sensor is None:
        return None
    force, moment = move_wrench(poke.link_from_sensor, poke.force, poke.moment)
    size = float(np.sqrt(force @ force))
    return None if not size > 0 else PokeAxis(force / size, axis_point(force, moment))


@dataclass(frozen=True, slots=True, eq=False)
class Felt:
    """Where a poke was by the answers, relative to a taxel, whose own place becomes better known later."""

    row: int
    """Index of the taxel that answered most; -1 where none is a taxel."""
    beside: FloatArray
    """(3,) float, metres; NaN where none is a taxel."""
    tilt: float
    """rad, how far the push leaned from that taxel's normal; NaN where that is not known."""


class PokeHistory:
    """Follows the outcomes of a session on the taxels `channels` (n,), ascending."""

    def __init__(self, channels: IntArray, settings: GuideSettings) -> None:
        self.channels = channels
        self.contacts: dict[int, Contact] = {}
        self._felt: dict[int, Felt] = {}
        # Of each poke what it was counted in, and at which index.
        self._meant: dict[int, list[tuple[IntArray, int]]] = {}
        # Numbers of all pokes there ever were, whatever they ended as.
        self._known = set[int]()
        self.asked: IntArray = np.zeros(len(channels), dtype=np.int64)
        """(n,) how often each taxel was the target of an accepted poke."""
        self.unanswered: IntArray = np.zeros(len(channels), dtype=np.int64)
        """(n,) pokes at each, while it was asked for, in which it did not answer."""
        self.tilt = Tilt(settings)
        self._newest: int | None = None
        self.sensor: FloatArray = np.zeros(3)
        """(3,) float, metres, link frame: the sensor's origin at the last poke."""

    def rows(self, channels: IntArray) -> IntArray:
        """Return (n,) the indices of channels, -1 for those that are no taxels."""
        # `searchsorted` gives a place for unknown channels too.
        at = np.searchsorted(self.channels, channels).clip(max=len(self.channels) - 1)
        return np.where(self.channels[at] == channels, at, -1)

    def follow(
        self,
        contacts: Mapping[int, Contact],
        rejections: Mapping[int, Rejection],
        target: TargetOfPoke | Target | None,
        places: FloatArray,
        normals: FloatArray,
        pulls: FloatArray,
    ) -> tuple[set[int], list[Contact | Rejection], list[int]]:
        """Follow the session to where it stands now.

        Parameters
        ----------
        target : the poke that was asked for before these, or what gives it for each
        places : (n, 3) float, metres, on the plan
        normals : (n, 3) float, unit, outward
        pulls : (n, 3) float, metres: `candidates.pulls`

        Returns
        -------
        touched : indices of taxels whose contacts are new, others than they were, or gone
        fresh : pokes that were not known before, in the order of their numbers
        gone : numbers of contacts that were taken out
        """
        gone = [poke for poke in self.contacts if poke not in contacts]
        # A contact that is another object than before was reported again, with the tare after it.
        new = [poke for poke, contact in contacts.items() if self.contacts.get(poke) is not contact]
        fresh: list[Contact | Rejection] = [contacts[poke] for poke in new if poke not in self._known]
        fresh += [rejection for poke, rejection in rejections.items() if poke not in self._known]
        fresh.sort(key=lambda outcome: outcome.poke)
        self._known.update(outcome.poke for outcome in fresh)
        self._count(gone, -1)
        self._count([poke for poke in new if poke not in self.contacts], 1)
        touched = [self.contacts[poke] for poke in (*gone, *new) if poke in self.contacts]
        self._forget([contact.poke for contact in touched])
        changed = [contacts[poke] for poke in new]
        if changed:
            self._remember(changed, places, normals, pulls)
        self._newest = max(self.contacts, default=None)
        if self._newest is not None:
            self.sensor = self.contacts[self._newest].link_from_sensor[:3, 3]
        self._learn(fresh, target, normals)
        rows = {int(row) for contact in (*touched, *changed) for row in self.rows(contact.channels) if row >= 0}
        return rows, fresh, gone

    def latest(self) -> list[Contact]:
        """Return the last contacts, as many as the pace is measured from, in the order of their numbers."""
        numbers = sorted(islice(reversed(self.contacts), RECENT + 1))
        return [self.contacts[number] for number in numbers]

    def hand(self, places: FloatArray) -> FloatArray | None:
        """Return (3,) where the hand is, at the last poke, metres; None where that is not known."""
        place = None if self._newest not in self._felt else self.place(self._newest, places)
        return place if place is not None and np.isfinite(place).all() else None

    def place(self, poke: int, places: FloatArray) -> FloatArray:
        """Return (3,) where a poke was by the answers, metres; NaN where no taxel answered."""
        felt = self._felt[poke]
        return places[felt.row] + felt.beside

    def _forget(self, pokes: Sequence[int]) -> None:
        felt = [self._felt.pop(poke) for poke in pokes]
        for poke in pokes:
            del self.contacts[poke]
        self.tilt.poked(np.array([each.tilt for each in felt]), slid=False, taken_out=True)

    def _remember(self, contacts: Sequence[Contact], places: FloatArray, normals: FloatArray, pulls: FloatArray) -> None:
        felt = self._where(contacts, places, normals, pulls)
        numbers = [contact.poke for contact in contacts]
        self.contacts.update(zip(numbers, contacts, strict=True))
        self._felt.update(zip(numbers, felt, strict=True))
        self.tilt.poked(np.array([each.tilt for each in felt]), slid=False)

    def _where(self, contacts: Sequence[Contact], places: FloatArray, normals: FloatArray, pulls: FloatArray) -> list[Felt]:
        """Return where pokes were by the answers.

        That is the middle of the taxels that answered, weighted by their answers, less how far that middle is off when the
        strongest taxel is poked at its very place: at the skin's edge nothing answers on the other side.
        """
        sizes = np.array([len(contact.channels) for contact in contacts])
        starts = np.concatenate([[0], sizes.cumsum()])
        owner = np.arange(len(contacts)).repeat(sizes)
        rows = self.rows(np.concatenate([contact.channels for contact in contacts]))
        responses = np.where(rows >= 0, np.concatenate([contact.responses for contact in contacts]), 0.0)
        peaks = rows[[a + int(responses[a:b].argmax()) for a, b in pairwise(starts.tolist())]]
        # The weighted offsets from the strongest taxel, and in the last column the weights.
        sums = np.zeros((len(contacts), 4))
        np.add.at(sums[:, :3], owner, responses[:, None] * np.nan_to_num(places[rows] - places[peaks][owner]))
        np.add.at(sums[:, 3], owner, responses)
        with np.errstate(invalid="ignore"):
            beside = sums[:, :3] / sums[:, 3:] - pulls[peaks]
        poses, forces = (np.array([getattr(contact, name) for contact in contacts]) for name in ("link_from_sensor", "force"))
        pushes, _ = move_wrench(poses, forces, np.zeros_like(forces))
        cosines = -np.sum(pushes * normals[peaks], axis=1) / np.sqrt(np.sum(pushes * pushes, axis=1))
        tilts = np.where(peaks >= 0, np.arccos(np.clip(cosines, -1.0, 1.0)), np.nan)
        return [Felt(*values) for values in zip(peaks.tolist(), beside, tilts.tolist(), strict=True)]

    def _learn(self, fresh: Sequence[Contact | Rejection], target: TargetOfPoke | Target | None, normals: FloatArray) -> None:
        """Learn from new pokes what the hand does, and which taxels they were meant for."""
        if isinstance(target, Target) and len(fresh) > 1:
            # It is unknown which one it was shown for.
            target = None
        for poke in fresh:
            meant = target(poke.poke) if callable(target) else target
            slid = isinstance(poke, Rejection) and poke.reason is Reason.SLID
            axis = axis_of(poke) if slid or meant is not None else None
            if isinstance(poke, Contact):
                self._count_asked(poke, meant)
            elif slid and axis is not None:
                self._slid(poke, axis, meant, normals)
            if meant is not None and axis is not None and axis.away(meant.place) <= AT:
                self._aimed(poke, axis, meant)

    def _count(self, pokes: Sequence[int], sign: int) -> None:
        """Count again which taxels known pokes were meant for; with sign -1 no longer, since they were taken out."""
        for poke in pokes:
            for count, row in self._meant.get(poke, ()):
                count[row] += sign

    def _count_one(self, poke: int, count: IntArray, channel: int) -> None:
        row = int(self.rows(np.array([channel]))[0])
        if row >= 0:
            count[row] += 1
            self._meant.setdefault(poke, []).append((count, row))

    def _count_asked(self, contact: Contact, meant: Target | None) -> None:
        """Count which taxel a new poke was meant for: the target, if there was one, else the taxel that answered most."""
        peak = contact.strongest_channel
        self._count_one(contact.poke, self.asked, peak if meant is None or meant.channel is None else meant.channel)

    def _slid(self, poke: Rejection, axis: PokeAxis, meant: Target | None, normals: FloatArray) -> None:
        rows = self.rows(poke.channels)
        known = [normals[row] for row in rows[rows >= 0].tolist() if np.isfinite(normals[row]).all()]
        if not known and meant is not None:
            known = [meant.normal]
        if known:
            middle = np.sum(known, axis=0)
            self.tilt.poked(np.array([axis.tilt(middle / np.linalg.norm(middle))]), slid=True)

    def _aimed(self, poke: Contact | Rejection, axis: PokeAxis, meant: Target) -> None:
        if isinstance(poke, Contact) or poke.reason is Reason.SLID:
            self.tilt.aimed(meant.tilt, axis.tilt(meant.normal))
        complete = isinstance(poke, Contact) or poke.reason is Reason.NO_TAXEL
        if complete and meant.channel is not None and meant.channel not in poke.channels:
            self._count_one(poke.poke, self.unanswered, meant.channel)
