"""Pokes of a session as the guide sees them: position, target, tilt and outcome of each.

An outcome comes twice, at the release and after the next tare, and may be excluded later. Each poke is counted once, and no
longer once it is excluded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import islice, pairwise
from typing import NamedTuple, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact, Outcome, Reason, Rejection
from skincal.geometry import FloatArray, IntArray
from skincal.guide.guidance import Target
from skincal.guide.progress import POKES_PER_INTERVAL_ESTIMATE, GuideSettings
from skincal.guide.tilt_limit import TiltLimit
from skincal.pokes import Pokes

TargetOfPoke: TypeAlias = Callable[[int], Target | None]
"""Target that was shown for a poke, by its number; `None` if there was none."""
POKE_MAX_DISTANCE_FROM_TARGET_M = 0.010
"""A poke was meant for its target if its axis passes that at no more: two taxels away it is another poke."""


def with_axis(poke: Contact | Rejection) -> Pokes | None:
    """Give the single poke with its force axis; `None` without a force."""
    found = Pokes.collect([poke])
    return found[0] if len(found) and found.force_size[0] > 0 else None


class PokePosition(NamedTuple):
    """Position of a poke, estimated from its answers, relative to a taxel."""

    row: int
    """Index of the taxel that answered most; -1 if no taxel answered."""
    offset: FloatArray
    """(3,) float, metres; NaN if no taxel answered."""
    tilt: float
    """rad, angle of the push from that taxel's normal; NaN if unknown."""


class PokeChanges(NamedTuple):
    """Difference between two states of a session."""

    taxels: set[int]
    """Indices of the taxels with new, changed or removed contacts."""
    added: list[Contact | Rejection]
    """Outcomes of new pokes, by number."""
    removed: list[int]
    """Numbers of contacts that no longer count."""


class PokeHistory:
    """Follows the outcomes of a session on the taxels `channels` (n,), ascending."""

    def __init__(self, channels: IntArray, settings: GuideSettings) -> None:
        self.channels = channels
        self.contacts: dict[int, Contact] = {}
        self._positions: dict[int, PokePosition] = {}
        self._known = set[int]()
        self._target_rows: dict[int, int] = {}
        self._missed_rows: dict[int, int] = {}
        self.asked: IntArray = np.zeros(len(channels), dtype=np.int64)
        """(n,) accepted pokes that were meant for each taxel."""
        self.unanswered: IntArray = np.zeros(len(channels), dtype=np.int64)
        """(n,) pokes at each taxel as target that it did not answer."""
        self.tilt = TiltLimit(settings)
        self._newest = 0
        self.ended = set[int]()
        """Numbers of the pokes that are rejected, or count."""
        self.sensor: FloatArray = np.zeros(3)
        """(3,) float, metres, link frame: the sensor's origin at the last poke."""

    def rows(self, channels: IntArray) -> IntArray:
        """Find (n,) the indices of channels, -1 for those that are no taxels."""
        # `searchsorted` gives an index for unknown channels too.
        at = np.searchsorted(self.channels, channels).clip(max=len(self.channels) - 1)
        return np.where(self.channels[at] == channels, at, -1)

    def update(
        self,
        outcomes: Mapping[int, Outcome | None],
        target_of: TargetOfPoke,
        places: FloatArray,
        normals: FloatArray,
        answer_offsets: FloatArray,
    ) -> PokeChanges:
        """Follow the session to its present state.

        Parameters
        ----------
        outcomes : pokes that may have changed, by number, ascending; `None` for a contact that no longer counts
        places, normals : (n, 3) float, metres and unit, outward, of the taxels by the plan
        answer_offsets : (n, 3) float, metres: `candidates.answer_offsets`
        """
        contacts = {poke: each for poke, each in outcomes.items() if isinstance(each, Contact)}
        removed = [poke for poke in outcomes if poke in self.contacts and poke not in contacts]
        # A contact that is another object than before was reported again, after the next tare.
        changed = [contact for poke, contact in contacts.items() if self.contacts.get(poke) is not contact]
        added = [each for poke, each in outcomes.items() if each is not None and poke not in self._known]
        self._known.update(outcome.poke for outcome in added)
        self._count_tries(outcomes, -1)
        former = [self.contacts[poke] for poke in (*removed, *(each.poke for each in changed)) if poke in self.contacts]
        self._forget([contact.poke for contact in former])
        if changed:
            self._remember(changed, places, normals, answer_offsets)
        if self._newest in self.contacts:
            self._newest = max(self._newest, *contacts, 0)
        else:
            self._newest = max(self.contacts, default=0)
        if self._newest:
            self.sensor = self.contacts[self._newest].link_from_sensor[:3, 3]
        self.ended.difference_update(poke for poke, each in outcomes.items() if each is None)
        self.ended.update(poke for poke, each in outcomes.items() if each is not None)
        self._learn(added, target_of, normals)
        self._count_tries(outcomes, 1)
        rows = {int(row) for contact in (*former, *changed) for row in self.rows(contact.channels) if row >= 0}
        return PokeChanges(rows, added, removed)

    def _count_tries(self, pokes: Iterable[int], by: int) -> None:
        """Add `by` to the tries at the targets of those of `pokes` that count at present."""
        for poke in pokes:
            if poke in self.contacts and poke in self._target_rows:
                self.asked[self._target_rows[poke]] += by
            if poke in self.ended and poke in self._missed_rows:
                self.unanswered[self._missed_rows[poke]] += by

    def latest_starts(self) -> FloatArray:
        """Start times of the last contacts, seconds, by number: as many as `poke_interval` uses."""
        numbers = sorted(islice(reversed(self.contacts), POKES_PER_INTERVAL_ESTIMATE + 1))
        return np.array([self.contacts[number].start_s for number in numbers])

    def hand(self, places: FloatArray) -> FloatArray | None:
        """Position of the last poke, (3,) metres; `None` if unknown."""
        place = self.place(self._newest, places) if self._newest else None
        return place if place is not None and np.isfinite(place).all() else None

    def place(self, poke: int, places: FloatArray) -> FloatArray:
        """Position of a poke by its answers, (3,) metres; NaN if no taxel answered."""
        found = self._positions[poke]
        return places[found.row] + found.offset

    def _forget(self, pokes: Sequence[int]) -> None:
        found = [self._positions.pop(poke) for poke in pokes]
        for poke in pokes:
            del self.contacts[poke]
        self.tilt.add_pokes(np.array([each.tilt for each in found]), slid=False, remove=True)

    def _remember(
        self, contacts: Sequence[Contact], places: FloatArray, normals: FloatArray, answer_offsets: FloatArray
    ) -> None:
        """Keep contacts with their positions.

        A position is the mean of the taxels that answered, weighted by their answers, less its bias for a poke exactly at the
        strongest taxel: at the skin's edge nothing answers on the other side.
        """
        sizes = np.array([len(contact.channels) for contact in contacts])
        starts = np.concatenate([[0], sizes.cumsum()])
        owner = np.arange(len(contacts)).repeat(sizes)
        rows = self.rows(np.concatenate([contact.channels for contact in contacts]))
        responses = np.where(rows >= 0, np.concatenate([contact.responses for contact in contacts]), 0.0)
        peaks = rows[[a + int(responses[a:b].argmax()) for a, b in pairwise(starts.tolist())]]
        # Weighted offsets from the strongest taxel, and in the last column the weights.
        sums = np.zeros((len(contacts), 4))
        np.add.at(sums[:, :3], owner, responses[:, None] * np.nan_to_num(places[rows] - places[peaks][owner]))
        np.add.at(sums[:, 3], owner, responses)
        with np.errstate(invalid="ignore"):
            offsets = sums[:, :3] / sums[:, 3:] - answer_offsets[peaks]
        pushes = Pokes.collect(contacts).link_force
        cosines = -np.sum(pushes * normals[peaks], axis=1) / np.sqrt(np.sum(pushes * pushes, axis=1))
        tilts = np.where(peaks >= 0, np.arccos(np.clip(cosines, -1.0, 1.0)), np.nan)
        for contact, *values in zip(contacts, peaks.tolist(), offsets, tilts.tolist(), strict=True):
            self.contacts[contact.poke], self._positions[contact.poke] = contact, PokePosition(*values)
        self.tilt.add_pokes(tilts, slid=False)

    def _learn(self, added: Sequence[Contact | Rejection], target_of: TargetOfPoke, normals: FloatArray) -> None:
        """Learn from new pokes how the hand tilts, and for which taxels they were meant."""
        for poke in added:
            target, is_contact = target_of(poke.poke), isinstance(poke, Contact)
            slid = isinstance(poke, Rejection) and poke.reason is Reason.SLID
            axis = with_axis(poke) if slid or target is not None else None
            if isinstance(poke, Contact):
                peak = poke.strongest_channel
                self._assign_row(
                    self._target_rows, poke.poke, peak if target is None or target.channel is None else target.channel
                )
            elif slid and axis is not None:
                self._add_slide(poke, axis, target, normals)
            if target is None or axis is None or not axis.miss(target.place) <= POKE_MAX_DISTANCE_FROM_TARGET_M:
                continue
            if is_contact or slid:
                self.tilt.compare_aim(target.tilt, float(axis.tilt(target.normal)))
            complete = isinstance(poke, Contact) or poke.reason is Reason.NO_TAXEL
            if complete and target.channel is not None and target.channel not in poke.channels:
                self._assign_row(self._missed_rows, poke.poke, target.channel)

    def _assign_row(self, row_of: dict[int, int], poke: int, channel: int) -> None:
        row = int(self.rows(np.array([channel]))[0])
        if row >= 0:
            row_of[poke] = row

    def _add_slide(self, poke: Rejection, axis: Pokes, target: Target | None, normals: FloatArray) -> None:
        rows = self.rows(poke.channels)
        known = [normals[row] for row in rows[rows >= 0].tolist() if np.isfinite(normals[row]).all()]
        if not known and target is not None:
            known = [target.normal]
        if known:
            mean = np.sum(known, axis=0)
            self.tilt.add_pokes(np.array([axis.tilt(mean / np.linalg.norm(mean))]), slid=True)
