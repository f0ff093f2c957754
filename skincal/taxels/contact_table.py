"""What the contacts say about each taxel: a table of contacts, and the rows of the paper's system (5), in the link frame.

For a contact with wrench (f, m), carried into the link frame by eq. (6), a taxel at p has the residual
(f x p + m)/|f| = u x p + m/|f| with u = f/|f|. Its weight is k = t_j / max_y t_y, its three rows in (5) are
k S(u) p = -k m/|f|. Along u they say nothing of p: there stands the pitch (eq. 3) on one side and zero on the other.
So two rows do: with a = u x m/|f| the axis's point nearest to the origin and e_1, e_2 orthonormal across u,

    |u x p + m/|f||^2 = (e_1.(p - a))^2 + (e_2.(p - a))^2 + pitch^2.

The minimum is that of (5). What is gained is digits: a heavy contact's pitch can no longer leak, through the rounding of
a row that should be zero, into a direction that only light contacts determine.

Answers of many taxels lie one after another in the same arrays, cut by `starts`. Beside k stands the trust, 0 to 1, a
factor of the contact's share of the sum of squares (`skincal/solver/source/trust.h`).

`ContactTable` carries each contact into the link frame once and finds it again by taxel. The contacts are the truth and
the table is a cache of them: what it returns depends on the contacts that are in it alone, not on the order in which they
came, nor on what was in it and was dropped again.
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.solver.machine import shared


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The n answers of t taxels, each taxel's in an order that depends on their numbers alone: heaviest first."""

    channels: IntArray
    """(t,) ascending."""
    starts: IntArray
    """(t + 1,): taxel i has the answers starts[i] to starts[i + 1], at least one."""
    taxels: IntArray
    """(n,) index of the taxel that answered, 0 to t - 1."""
    pokes: IntArray
    """(n,) number of the poke."""
    poses: IntArray
    """(n,) equal where the arm's pose has the same name."""
    columns: FloatArray
    """(17, n): u, nearest, |f|, pitch, sensor, e_1, e_2; read by the properties below."""
    weights: FloatArray
    """(n,) float, 0 < k <= 1."""
    trust: FloatArray
    """(n,) float, 0 to 1: how far the contact counts for the taxel; 1 but for outliers."""

    @property
    def directions(self) -> FloatArray:
        """(n, 3) float: u = f/|f|, link frame."""
        return self.columns[0:3].T

    @property
    def nearest(self) -> FloatArray:
        """(n, 3) float, metres: a = u x m/|f|, the axis's point nearest to the link's origin."""
        return self.columns[3:6].T

    @property
    def forces(self) -> FloatArray:
        """(n,) float, N: |f|."""
        return self.columns[6]

    @property
    def pitches(self) -> FloatArray:
        """(n,) float, metres: f . m/|f|^2 about the link's origin, the same about any point."""
        return self.columns[7]

    @property
    def sensors(self) -> FloatArray:
        """(n, 3) float, metres: the sensor's origin in the link frame; the lever p - sensors carries the force's noise."""
        return self.columns[8:11].T

    @property
    def pairs(self) -> FloatArray:
        """(n, 2, 3) float: e_1 and e_2 of each contact, with e_1 x e_2 = u."""
        return self.columns[11:17].reshape(2, 3, -1).transpose(2, 0, 1)

    @property
    def counts(self) -> IntArray:
        """(t,) contacts of each taxel."""
        return self.starts[1:] - self.starts[:-1]

    def doubted(self) -> list[Mapping[int, float]]:
        """Return for each taxel the pokes whose trust is below 1: number to trust."""
        doubted: dict[int, dict[int, float]] = {}
        for place in (self.trust < 1.0).nonzero()[0].tolist():
            doubted.setdefault(int(self.taxels[place]), {})[int(self.pokes[place])] = float(self.trust[place])
        # One for all that doubt nothing: thousands of empty ones would set the garbage collector off.
        none = dict[int, float]()
        return [doubted.get(taxel, none) for taxel in range(len(self.channels))]

    def trusted(self, trust: FloatArray) -> Evidence:
        """Return the same evidence with another trust (n,)."""
        return replace(self, trust=trust)

    def evidence(self, channels: Collection[int]) -> Evidence:
        """Return the evidence of those of `channels` that are in this, as `ContactTable.evidence` gives it."""
        kept = np.isin(self.channels, np.fromiter(channels, np.int64, len(channels)))
        if kept.all():
            return self
        rows = kept[self.taxels]
        return Evidence(
            channels=self.channels[kept],
            starts=np.concatenate([[0], self.counts[kept].cumsum()]),
            taxels=(kept.cumsum() - 1)[self.taxels[rows]],
            pokes=self.pokes[rows],
            poses=self.poses[rows],
            columns=self.columns[:, rows],
            weights=self.weights[rows],
            trust=self.trust[rows],
        )

    def part(self, first: int, last: int) -> Evidence:
        """Return the evidence of taxels `first` to `last` (excluded) alone."""
        begin, end = self.starts[first], self.starts[last]
        return Evidence(
            channels=self.channels[first:last],
            starts=self.starts[first : last + 1] - begin,
            taxels=self.taxels[begin:end] - first,
            pokes=self.pokes[begin:end],
            poses=self.poses[begin:end],
            columns=self.columns[:, begin:end],
            weights=self.weights[begin:end],
            trust=self.trust[begin:end],
        )


def orthonormal_pair(u: FloatArray) -> FloatArray:
    """Return (n, 2, 3): two directions e_1, e_2 with e_1 x e_2 = u, orthonormal, for each of `u` (n, 3), unit."""
    # Duff et al., "Building an orthonormal basis, revisited", 2017: no branch on nearly parallel helpers.
    x, y, z = u.T
    sign = np.copysign(1.0, z)
    k = -1.0 / (sign + z)
    xy = x * y * k
    both = np.empty((len(u), 2, 3))
    both[:, 0, 0], both[:, 0, 1], both[:, 0, 2] = 1.0 + sign * x * x * k, sign * xy, -sign * x
    both[:, 1, 0], both[:, 1, 1], both[:, 1, 2] = xy, sign + y * y * k, -y
    return both


_COLUMNS = 17
"""u (3), nearest point of the axis (3), |f|, pitch, sensor's origin (3), e_1 (3), e_2 (3)."""
_ROOM = 64
"""Rows to begin with; doubled when full."""


class ContactTable:
    """Contacts, to be added and dropped by the number of their poke, and the evidence they give."""

    def __init__(self, contacts: Sequence[Contact] = ()) -> None:
        self._table = np.empty((_COLUMNS, _ROOM))
        self._pokes = np.zeros(_ROOM, dtype=np.int64)
        self._poses = np.zeros(_ROOM, dtype=np.int64)
        self._live = np.zeros(_ROOM, dtype=bool)
        self._total = np.zeros(_ROOM)
        self._owner = np.zeros(_ROOM, dtype=np.int64)
        self._weight = np.empty(_ROOM)
        self._contacts = 0
        self._answers = 0
        self._dropped = 0
        self._rows: dict[int, int] = {}
        self._of_channel: dict[int, array[int]] = {}
        self._pose_names: dict[str, int] = {}
        self.add(contacts)

    def add(self, contacts: Sequence[Contact]) -> None:
        """Take contacts; a contact of a poke that is in already replaces the older one.

        Raises
        ------
        ValueError
            A contact has a number that is not finite, no force, or a response that is not above zero; then none is taken.
        """
        if not contacts:
            return
        columns = _carried(contacts)
        owner, channels, weights = _answers(contacts)
        pokes = [contact.poke for contact in contacts]
        self._drop_all(pokes)
        first, begin = self._contacts, self._answers
        self._contacts, self._answers = first + len(contacts), begin + len(owner)
        self._make_room()
        rows = slice(first, self._contacts)
        self._table[:, rows] = columns
        self._pokes[rows] = pokes
        self._poses[rows] = [self._pose_names.setdefault(contact.pose, len(self._pose_names)) for contact in contacts]
        self._live[rows] = True
        self._total[rows] = np.bincount(owner, weights=weights, minlength=len(contacts))
        self._owner[begin : self._answers] = owner + first
        self._weight[begin : self._answers] = weights
        self._name(pokes, first)
        order = np.argsort(channels, kind="stable")
        channels, answers = channels[order], order + begin
        edges = _starts(channels)
        for start, end in pairwise(edges.tolist()):
            channel = int(channels[start])
            if channel not in self._of_channel:
                self._of_channel[channel] = array("q")
            self._of_channel[channel].frombytes(answers[start:end].tobytes())

    def _drop_all(self, pokes: Sequence[int]) -> None:
        for poke in pokes if self._rows else ():
            self.drop(poke)

    def _name(self, pokes: Sequence[int], first: int) -> None:
        """Note that the pokes, none of which is in, have the rows from `first` on."""
        rows = dict(zip(pokes, range(first, first + len(pokes)), strict=True))
        if len(rows) == len(pokes):
            self._rows.update(rows)
            return
        for row, poke in enumerate(pokes, start=first):
            # One poke given twice in a list: the last counts, as it does in two calls.
            self.drop(poke)
            self._rows[poke] = row

    def drop(self, poke: int) -> None:
        """Leave out the contact of a poke, if there is one."""
        row = self._rows.pop(poke, None)
        if row is not None:
            self._live[row] = False
            self._dropped += 1

    def evidence(self, channels: Collection[int]) -> Evidence:
        """Return the evidence of those of `channels` that answered in a contact."""
        if self._dropped > _ROOM and 2 * self._dropped > self._contacts:
            self._compact()
        known = sorted(channel for channel in channels if channel in self._of_channel)
        lists = [np.frombuffer(self._of_channel[channel], dtype=np.int64) for channel in known]
        counts = np.array([len(answers) for answers in lists], dtype=np.int64)
        answers = np.concatenate(lists) if lists else np.empty(0, dtype=np.int64)
        taxels, owner = np.arange(len(known)).repeat(counts), self._owner.take(answers)
        if self._dropped:
            live = self._live.take(owner)
            answers, taxels, owner = answers[live], taxels[live], owner[live]
            counts = np.bincount(taxels, minlength=len(known))
            if not counts.all():
                known = [channel for channel, count in zip(known, counts.tolist(), strict=True) if count]
                counts = counts[counts > 0]
                taxels = np.arange(len(known)).repeat(counts)
        weights = self._weight.take(answers)
        order = self._order(taxels, weights, owner)
        owner = owner.take(order)
        return Evidence(
            channels=np.array(known, dtype=np.int64),
            starts=np.concatenate([[0], counts.cumsum()]),
            taxels=taxels,
            pokes=self._pokes.take(owner),
            poses=self._poses.take(owner),
            columns=self._table.take(owner, axis=1),
            weights=weights.take(order),
            trust=np.ones(len(weights)),
        )

    def totals(self, pokes: IntArray) -> FloatArray:
        """Return (n,) for each poke the sum of the weights k of all its answers; every poke is in."""
        return self._total[[self._rows[poke] for poke in pokes.tolist()]]

    def _order(self, taxels: IntArray, weights: FloatArray, owner: IntArray) -> IntArray:
        """Return the order of answers: by taxel, heaviest first, then by content: when they came leaves no trace."""
        # One key is quicker than two, since k <= 1. Its last digits are lost, so nearly equal answers are ordered below.
        key = taxels - weights
        order = key.argsort(kind="stable")
        # Every poke has a taxel with k = 1, so many are as heavy. The size of the force orders these; very seldom the whole
        # row must, and the poke's number where the same contact came twice.
        tied = _repeated(key[order])
        if tied.any():
            some = order[tied]
            order[tied] = some[np.lexsort((self._table[6].take(owner[some]), -weights[some], taxels[some]))]
            tied &= _repeated(taxels, weights[order], self._table[6].take(owner[order]))
        if tied.any():
            some = order[tied]
            force = self._table[:, owner[some]]
            order[tied] = some[np.lexsort((self._pokes[owner[some]], *force, -weights[some], taxels[some]))]
        return order

    def _make_room(self) -> None:
        if self._contacts > len(self._live):
            room = max(2 * len(self._live), self._contacts)
            self._table, self._live = _grown(self._table, room), _grown(self._live, room)
            self._pokes, self._poses = _grown(self._pokes, room), _grown(self._poses, room)
            self._total = _grown(self._total, room)
        if self._answers > len(self._owner):
            room = max(2 * len(self._owner), self._answers)
            self._owner, self._weight = _grown(self._owner, room), _grown(self._weight, room)

    def _compact(self) -> None:
        """Forget the rows of dropped contacts: every poke is reported twice (early, then final), so half of all rows are."""
        rows = np.flatnonzero(self._live[: self._contacts])
        renamed = np.full(self._contacts, -1, dtype=np.int64)
        renamed[rows] = np.arange(len(rows))
        owner = renamed[self._owner[: self._answers]]
        kept = owner >= 0
        answer = np.cumsum(kept) - 1
        for channel, old in self._of_channel.items():
            places = np.frombuffer(old, dtype=np.int64)
            self._of_channel[channel] = array("q", answer[places[kept[places]]].tobytes())
        self._contacts, self._answers, self._dropped = len(rows), int(kept.sum()), 0
        self._table[:, : len(rows)] = self._table[:, rows]
        self._pokes[: len(rows)], self._poses[: len(rows)] = self._pokes[rows], self._poses[rows]
        self._total[: len(rows)] = self._total[rows]
        self._live[:] = False
        self._live[: len(rows)] = True
        self._owner[: self._answers], self._weight[: self._answers] = owner[kept], self._weight[: len(kept)][kept]
        self._rows = {poke: row for row, poke in enumerate(self._pokes[: len(rows)].tolist())}


def _starts(ordered: IntArray) -> IntArray:
    """Return where each run of equal numbers begins, and the end."""
    cuts = np.flatnonzero(ordered[1:] != ordered[:-1]) + 1
    return np.concatenate([[0], cuts, [len(ordered)]]) if len(ordered) else np.zeros(1, dtype=np.int64)


def _repeated(*ordered: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which places have the same numbers as a neighbour, in each of some arrays."""
    same = ordered[0][1:] == ordered[0][:-1]
    for numbers in ordered[1:]:
        same &= numbers[1:] == numbers[:-1]
    repeated = np.zeros(len(ordered[0]), dtype=bool)
    repeated[1:] = same
    repeated[:-1] |= same
    return repeated


def _grown(columns: NDArray[Any], room: int) -> NDArray[Any]:
    grown = np.zeros((*columns.shape[:-1], room), dtype=columns.dtype)
    grown[..., : columns.shape[-1]] = columns
    return grown


def _answers(contacts: Sequence[Contact]) -> tuple[IntArray, IntArray, FloatArray]:
    """Return for each answer: index of the contact, channel, weight k = t_j/max_y t_y."""
    answering = [contact.channels for contact in contacts]
    sizes = np.fromiter(map(len, answering), np.int64, len(answering))
    channels = np.concatenate(answering).astype(np.int64)
    responses = np.concatenate([contact.responses for contact in contacts]).astype(float)
    owner = np.repeat(np.arange(len(contacts)), sizes)
    strongest, some = np.zeros(len(contacts)), np.flatnonzero(sizes)
    if len(some):
        strongest[some] = np.maximum.reduceat(responses, (np.cumsum(sizes) - sizes)[some])
    with np.errstate(invalid="ignore", divide="ignore"):
        weights = responses / np.maximum(strongest, 0.0)[owner]
    good = np.isfinite(weights) & (weights > 0)
    if not good.all():
        poke = contacts[int(owner[(~good).argmax()])].poke
        raise ValueError(f"poke {poke}: a taxel's response is not a number above zero")
    return owner, channels, weights


def _carried(contacts: Sequence[Contact]) -> FloatArray:
    """Return (17, n): the columns of contacts, link frame (eq. 6)."""
    count = len(contacts)
    with shared().call() as call:
        forces = call.give(np.array([contact.force for contact in contacts]))
        moments = call.give(np.array([contact.moment for contact in contacts]))
        poses = call.give(np.concatenate([contact.link_from_sensor for contact in contacts]))
        place = call.room((_COLUMNS, count))
        call.run("carry", [count, forces, moments, poses, place])
        columns = call.taken(place)
    # A zero force has no direction.
    good = np.isfinite(columns).all(axis=0)
    if not good.all():
        poke = contacts[int((~good).argmax())].poke
        raise ValueError(f"poke {poke}: its wrench or pose is not finite, or it has no force")
    return columns
