"""Columns of all pokes of a session, so that a question about all of them is a few operations on arrays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.outcome import Contact, Outcome
from skincal.geometry import BoolArray, IntArray

_INITIAL_POKE_ROWS = 64
"""Rows to begin with; doubled when full."""
_POKE_COLUMNS_DTYPE = np.dtype([("number", "i8"), ("strongest", "i8"), ("pose", "i8"), ("counting", "?"), ("excluded", "?")])


@dataclass(frozen=True, slots=True, eq=False)
class PokeColumns:
    """n pokes in the order of their numbers."""

    numbers: IntArray
    """(n,) ascending."""
    counting: BoolArray
    """(n,) accepted and not excluded."""
    excluded: BoolArray
    """(n,)."""
    strongest: IntArray
    """(n,) channel that answered most; -1 for a rejection."""
    poses: IntArray
    """(n,) index in `pose_names`."""
    pose_names: list[str]
    """Names of the arm poses, in the order of their first poke."""

    @staticmethod
    def collect(pokes: Iterable[tuple[Outcome, bool]]) -> PokeColumns:
        """Collect the columns of pokes in the order of their numbers; each comes with whether it is excluded."""
        growing = GrowingPokeColumns()
        for outcome, is_excluded in pokes:
            growing.store(outcome, is_excluded)
        return growing.now()

    def last_rows_of_poses(self, most: int) -> dict[str, int]:
        """Find the row of the last counting poke in each arm pose, in the order of their first pokes.

        Of more than `most` poses those with most counting pokes are kept; of equal ones those that were used first.
        """
        rows = np.flatnonzero(self.counting)
        poses, size = self.poses[rows], len(self.pose_names)
        first, last = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=np.int64)
        # Of repeated indices the last assignment holds.
        first[poses[::-1]], last[poses] = rows[::-1], rows
        counts = np.bincount(poses, minlength=size)
        used = np.flatnonzero(counts)
        often = used[np.lexsort((first[used], -counts[used]))[:most]]
        return {self.pose_names[pose]: int(last[pose]) for pose in often[first[often].argsort()].tolist()}


class GrowingPokeColumns:
    """`PokeColumns` of a session that goes on."""

    def __init__(self) -> None:
        self._rows: NDArray[Any] = np.zeros(_INITIAL_POKE_ROWS, dtype=_POKE_COLUMNS_DTYPE)
        self._count = 0
        self._shared = 0
        """Rows that a `PokeColumns` has as views."""
        self._pose_names: list[str] = []
        self._pose_of: dict[str, int] = {}

    def store(self, outcome: Outcome, is_excluded: bool) -> None:
        """Store a poke, in place of an earlier one with its number."""
        row = self._count
        if row and outcome.poke <= self._rows["number"][row - 1]:
            row = int(np.searchsorted(self._rows["number"][: self._count], outcome.poke))
        if row < self._shared:
            self._rows, self._shared = self._rows.copy(), 0
        if row == self._count or self._rows["number"][row] != outcome.poke:
            self._insert(row)
        if outcome.pose not in self._pose_of:
            self._pose_of[outcome.pose] = len(self._pose_names)
            self._pose_names.append(outcome.pose)
        is_contact = isinstance(outcome, Contact)
        strongest = outcome.strongest_channel if is_contact else -1
        counts = is_contact and not is_excluded
        self._rows[row] = outcome.poke, strongest, self._pose_of[outcome.pose], counts, is_excluded

    def _insert(self, row: int) -> None:
        if self._count == len(self._rows):
            self._rows, self._shared = np.concatenate([self._rows, np.zeros_like(self._rows)]), 0
        self._count += 1
        self._rows[row + 1 : self._count] = self._rows[row : self._count - 1].copy()

    def now(self) -> PokeColumns:
        """Show the present columns, which later pokes do not change."""
        self._shared = self._count
        rows = self._rows[: self._count]
        return PokeColumns(
            rows["number"], rows["counting"], rows["excluded"], rows["strongest"], rows["pose"], self._pose_names
        )
