"""Contacts as rows of the paper's system (5), in the link frame, per taxel.

A contact with wrench (f, m), carried into the link frame by eq. (6), has for a taxel at p the residual
(f x p + m)/|f| = u x p + m/|f| with u = f/|f|. Its weight is k = t_j / max_y t_y, its three rows in (5) are
k S(u) p = -k m/|f|. Along u they do not depend on p: there the pitch (eq. 3) is on one side and zero on the other.
So two rows are enough: with a = u x m/|f| the axis's point nearest to the origin and e_1, e_2 orthonormal to u,

    |u x p + m/|f||^2 = (e_1.(p - a))^2 + (e_2.(p - a))^2 + pitch^2.

The minimum is that of (5), with more digits: the pitch of a heavy contact cannot leak, through the rounding of a row that
should be zero, into a direction that only light contacts determine.

A contact's share of the sum of squares is k^2 times its trust, 0 to 1 (`skincal/solver/source/trust.h`).

`ContactTable` carries each contact into the link frame once and finds it again by taxel. Its answers depend on the contacts in
it alone: not on their order, nor on contacts that were dropped.
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.solver.machine import shared


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The n answers of t taxels, in one order by taxel, heaviest first."""

    channels: IntArray
    """(t,) ascending."""
    starts: IntArray
    """(t + 1,): taxel i has the answers starts[i] to starts[i + 1], at least one."""
    taxels: IntArray
    """(n,) index of the taxel that answered, 0 to t - 1."""
    pokes: IntArray
    """(n,) number of the poke."""
    poses: IntArray
    """(n,) equal for arm poses of the same name."""
    columns: FloatArray
    """(17, n): u, nearest, |f|, pitch, sensor, e_1, e_2; read by the properties below."""
    weights: FloatArray
    """(n,) float, 0 < k <= 1."""
    trust: FloatArray
    """(n,) float, 0 to 1: below 1 for outliers of the taxel."""
    unranked: NDArray[np.bool_]
    """(n,) whether the answer is one of several of its poke at the end of the range: any of them may be the pressed one."""

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
    def sensors(self) -> FloatArray:
        """(n, 3) float, metres, link frame: the sensor's origin; the lever p - sensors carries the force's noise."""
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
        """List for each taxel the pokes whose trust is below 1: number to trust."""
        doubted: dict[int, dict[int, float]] = {}
        for place in (self.trust < 1.0).nonzero()[0].tolist():
            doubted.setdefault(int(self.taxels[place]), {})[int(self.pokes[place])] = float(self.trust[place])
        # One shared empty value: thousands of them would set the garbage collector off.
        none = dict[int, float]()
        return [doubted.get(taxel, none) for taxel in range(len(self.channels))]

    def trusted(self, trust: FloatArray) -> Evidence:
        """Copy with another trust (n,)."""
        return replace(self, trust=trust)

    def evidence(self, channels: Collection[int]) -> Evidence:
        """Select the evidence of the `channels` that this evidence has, as `ContactTable.evidence` does."""
        if list(channels) == self.channels.tolist():
            return self
        kept = np.isin(self.channels, np.fromiter(channels, np.int64, len(channels)))
        return self if kept.all() else self.select(kept[self.taxels], self.channels[kept], self.counts[kept])

    def part(self, first: int, last: int) -> Evidence:
        """Select the evidence of taxels `first` to `last` (excluded)."""
        answers = slice(*self.starts[[first, last]].tolist())
        return self.select(answers, self.channels[first:last], self.counts[first:last])

    def select(self, answers: IntArray | NDArray[np.bool_] | slice, channels: IntArray, counts: IntArray) -> Evidence:
        """Select answers as those of taxels `channels` (t,), `counts` (t,) of each in turn."""
        return Evidence(
            channels,
            _starts_of(counts),
            np.arange(len(counts)).repeat(counts),
            self.pokes[answers],
            self.poses[answers],
            self.columns[:, answers],
            self.weights[answers],
            self.trust[answers],
            self.unranked[answers],
        )


_CONTACT_TABLE_COLUMNS = 17
"""u (3), nearest point of the axis (3), |f|, pitch, sensor's origin (3), e_1 (3), e_2 (3)."""
_INITIAL_TABLE_ROWS = 64
"""Rows to begin with; doubled when full."""
CONTACTS_CARRIED_AT_ONCE = 4096
_CONTACT_ROW = np.dtype([("poke", "i8"), ("pose", "i8"), ("live", "?"), ("total", "f8")])
_ANSWER_ROW = np.dtype([("contact", "i8"), ("weight", "f8"), ("unranked", "?")])


class ContactTable:
    """Contacts, added and dropped by the number of their poke, and their evidence."""

    def __init__(self, contacts: Sequence[Contact] = ()) -> None:
        self._columns = np.empty((_CONTACT_TABLE_COLUMNS, _INITIAL_TABLE_ROWS))
        self._contacts = np.zeros(_INITIAL_TABLE_ROWS, dtype=_CONTACT_ROW)
        self._answers = np.zeros(_INITIAL_TABLE_ROWS, dtype=_ANSWER_ROW)
        self._contact_count = self._answer_count = self._dropped = 0
        self.changes = 0
        """Rises with each change of the contacts."""
        self._row_of: dict[int, int] = {}
        self._answers_of: dict[int, array[int]] = {}
        self._poses: dict[str, int] = {}
        self.add(contacts)

    def add(self, contacts: Sequence[Contact]) -> None:
        """Add contacts; a contact replaces an older one of the same poke.

        Raises
        ------
        ValueError
            A contact has a number that is not finite, no force, or a response that is not above zero; then none is added.
        """
        if not contacts:
            return
        columns, (owner, channels, weights, unranked) = _carry_to_link(contacts), _list_answers(contacts)
        self.changes += 1
        first, begin = self._contact_count, self._answer_count
        self._contact_count, self._answer_count = first + len(contacts), begin + len(owner)
        if self._contact_count > len(self._contacts):
            room = max(2 * len(self._contacts), self._contact_count)
            self._columns, self._contacts = _grow(self._columns, room), _grow(self._contacts, room)
        if self._answer_count > len(self._answers):
            self._answers = _grow(self._answers, max(2 * len(self._answers), self._answer_count))
        self._columns[:, first : self._contact_count] = columns
        rows, answers = self._contacts[first : self._contact_count], self._answers[begin : self._answer_count]
        rows["poke"] = [contact.poke for contact in contacts]
        rows["pose"] = [self._poses.setdefault(contact.pose, len(self._poses)) for contact in contacts]
        rows["live"] = True
        rows["total"] = np.bincount(owner, weights=weights, minlength=len(contacts))
        answers["contact"], answers["weight"], answers["unranked"] = owner + first, weights, unranked
        for row, contact in enumerate(contacts, start=first):
            self.drop(contact.poke)
            self._row_of[contact.poke] = row
        order = np.argsort(channels, kind="stable")
        channels, numbers = channels[order], order + begin
        for start, end in pairwise([*np.flatnonzero(np.diff(channels, prepend=-1)).tolist(), len(channels)]):
            own = self._answers_of.setdefault(int(channels[start]), array("q"))
            own.frombytes(numbers[start:end].tobytes())

    def drop(self, poke: int) -> None:
        """Leave out the contact of a poke, if there is one."""
        row = self._row_of.pop(poke, None)
        if row is not None:
            self._contacts["live"][row] = False
            self._dropped += 1
            self.changes += 1

    def evidence(self, channels: Collection[int]) -> Evidence:
        """Gather the evidence of those of `channels` that answered in a contact."""
        if self._dropped > _INITIAL_TABLE_ROWS and 2 * self._dropped > self._contact_count:
            self._compact()
        known = sorted(channel for channel in channels if channel in self._answers_of)
        lists = [np.frombuffer(self._answers_of[channel], dtype=np.int64) for channel in known]
        counts = np.array([len(answers) for answers in lists], dtype=np.int64)
        answers = self._answers.take(np.concatenate(lists) if lists else np.empty(0, dtype=np.int64))
        taxels = np.arange(len(known)).repeat(counts)
        if self._dropped:
            live = self._contacts["live"][answers["contact"]]
            answers, taxels = answers[live], taxels[live]
            counts = np.bincount(taxels, minlength=len(known))
            if not counts.all():
                known = [channel for channel, count in zip(known, counts.tolist(), strict=True) if count]
                counts = counts[counts > 0]
                taxels = np.arange(len(known)).repeat(counts)
        order = self._order(taxels, answers["weight"], answers["contact"])
        rows = answers["contact"].take(order)
        return Evidence(
            channels=np.array(known, dtype=np.int64),
            starts=_starts_of(counts),
            taxels=taxels,
            # `take` would copy the whole column first, since it is one field of a row.
            pokes=self._contacts["poke"][rows],
            poses=self._contacts["pose"][rows],
            columns=self._columns.take(rows, axis=1),
            weights=answers["weight"].take(order),
            trust=np.ones(len(rows)),
            unranked=answers["unranked"].take(order),
        )

    def totals(self, pokes: IntArray) -> FloatArray:
        """Sum (n,) the weights k of all answers of each poke; every poke is in the table."""
        return self._contacts["total"][[self._row_of[poke] for poke in pokes.tolist()]]

    def _order(self, taxels: IntArray, weights: FloatArray, rows: IntArray) -> IntArray:
        """Order answers by taxel, heaviest first, then by content: when they came leaves no trace."""
        # One key is quicker than two, since k <= 1. Its last digits are lost, so nearly equal answers are ordered below.
        order = (taxels - weights).argsort(kind="stable")
        # Each poke has a taxel with k = 1, so many are equally heavy. The force orders these; very seldom the whole row must,
        # and the poke's number if the same contact came twice.
        tied = _find_repeated((taxels - weights)[order])
        if tied.any():
            some = order[tied]
            order[tied] = some[np.lexsort((self._columns[6].take(rows[some]), -weights[some], taxels[some]))]
            tied &= _find_repeated(taxels, weights[order], self._columns[6].take(rows[order]))
        if tied.any():
            some = order[tied]
            contents = self._contacts["poke"][rows[some]], *self._columns[:, rows[some]]
            order[tied] = some[np.lexsort((*contents, -weights[some], taxels[some]))]
        return order

    def _compact(self) -> None:
        """Forget the rows of dropped contacts: each poke is reported twice (early, then final), so half of all rows are."""
        rows = np.flatnonzero(self._contacts["live"][: self._contact_count])
        renamed = np.full(self._contact_count, -1, dtype=np.int64)
        renamed[rows] = np.arange(len(rows))
        answers = self._answers[: self._answer_count]
        answers["contact"] = renamed[answers["contact"]]
        kept = answers["contact"] >= 0
        number = np.cumsum(kept) - 1
        for channel, old in list(self._answers_of.items()):
            places = np.frombuffer(old, dtype=np.int64)
            if kept[places].any():
                self._answers_of[channel] = array("q", number[places[kept[places]]].tobytes())
            else:
                del self._answers_of[channel]
        self._answers[: int(kept.sum())] = answers[kept]
        self._columns[:, : len(rows)] = self._columns[:, rows]
        self._contacts[: len(rows)] = self._contacts[rows]
        self._contact_count, self._answer_count, self._dropped = len(rows), int(kept.sum()), 0
        self._row_of = {poke: row for row, poke in enumerate(self._contacts["poke"][: len(rows)].tolist())}


class TableState:
    """Reference to the present contacts of a table, which ends with their next change. It keeps no table alive."""

    def __init__(self, table: ContactTable) -> None:
        self._table, self._changes = ref(table), table.changes

    @property
    def unchanged_table(self) -> ContactTable | None:
        """The table; `None` after a change of its contacts, or once it is gone."""
        table = self._table()
        return table if table is not None and table.changes == self._changes else None


def _starts_of(counts: IntArray) -> IntArray:
    starts = np.zeros(len(counts) + 1, dtype=np.int64)
    np.cumsum(counts, out=starts[1:])
    return starts


def _find_repeated(*ordered: NDArray[Any]) -> NDArray[np.bool_]:
    """Find the places with the same numbers as a neighbour in each of some arrays."""
    same = ordered[0][1:] == ordered[0][:-1]
    for numbers in ordered[1:]:
        same &= numbers[1:] == numbers[:-1]
    repeated = np.zeros(len(ordered[0]), dtype=bool)
    repeated[1:] = same
    repeated[:-1] |= same
    return repeated


def _grow(columns: NDArray[Any], room: int) -> NDArray[Any]:
    grown = np.zeros((*columns.shape[:-1], room), dtype=columns.dtype)
    grown[..., : columns.shape[-1]] = columns
    return grown


def _list_answers(contacts: Sequence[Contact]) -> tuple[IntArray, IntArray, FloatArray, NDArray[np.bool_]]:
    """List for each answer the index of its contact, its channel, its weight k = t_j/max_y t_y, and whether it is unranked.

    Answers at the end of the range are lower bounds. Two and more of a contact are the strongest ones in an unknown
    order, so each has the weight 1.
    """
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
    unranked = _find_unranked(contacts, sizes)
    weights[unranked] = 1.0
    return owner, channels, weights, unranked


def _find_unranked(contacts: Sequence[Contact], sizes: IntArray) -> NDArray[np.bool_]:
    """Find the answers that are at the end of the range together with others of their contact; `sizes` counts answers."""
    unranked, begins = np.zeros(int(sizes.sum()), dtype=bool), np.cumsum(sizes) - sizes
    for contact, begin, size in zip(contacts, begins.tolist(), sizes.tolist(), strict=True):
        if contact.clipped is not None and len(contact.clipped) > 1:
            unranked[begin : begin + size] = np.isin(contact.channels, contact.clipped)
    return unranked


def _carry_to_link(contacts: Sequence[Contact]) -> FloatArray:
    """Compute (17, n) the columns of contacts, link frame (eq. 6)."""
    count = len(contacts)
    if count > CONTACTS_CARRIED_AT_ONCE:
        # The solver's memory does not shrink.
        steps = range(0, count, CONTACTS_CARRIED_AT_ONCE)
        return np.concatenate([_carry_to_link(contacts[at : at + CONTACTS_CARRIED_AT_ONCE]) for at in steps], axis=1)
    columns = shared().run(
        "carry",
        contacts=count,
        forces=np.array([contact.force for contact in contacts]),
        moments=np.array([contact.moment for contact in contacts]),
        poses=np.concatenate([contact.link_from_sensor for contact in contacts]),
        columns=(_CONTACT_TABLE_COLUMNS, count),
    )["columns"]
    # A zero force has no direction.
    good = np.isfinite(columns).all(axis=0)
    if not good.all():
        poke = contacts[int((~good).argmax())].poke
        raise ValueError(f"poke {poke}: its wrench or pose is not finite, or it has no force")
    return columns
