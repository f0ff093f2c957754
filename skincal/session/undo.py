"""History of a session for undo and redo."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import overload

from skincal.model.actions import Action, Exclude, Restore
from skincal.session.decisions import Decisions, describe_action


@dataclass(frozen=True, slots=True, eq=False)
class ActionEntry:
    """An action in the history."""

    action: Action
    before: Decisions
    """The decisions that it was applied to."""
    at_s: float = math.nan
    """Time of day, seconds since 1970; NaN if unknown."""


HistoryEntry = ActionEntry | int
"""A poke is its number alone: there are thousands."""


class Entries(Sequence[HistoryEntry]):
    """Entries in a row that never change. One with one more shares their list, so that a long history is not copied."""

    __slots__ = ("_count", "_items")

    def __init__(self, entries: Iterable[HistoryEntry] = ()) -> None:
        self._items = list(entries)
        self._count = len(self._items)

    def with_entry(self, entry: HistoryEntry) -> Entries:
        """Add an entry."""
        # A list that another row uses farther stays as it is.
        items = self._items if len(self._items) == self._count else self._items[: self._count]
        items.append(entry)
        return self._first(items, self._count + 1)

    @staticmethod
    def _first(items: list[HistoryEntry], count: int) -> Entries:
        entries = Entries()
        entries._items, entries._count = items, count
        return entries

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, at: int) -> HistoryEntry: ...
    @overload
    def __getitem__(self, at: slice) -> Entries: ...
    def __getitem__(self, at: int | slice) -> HistoryEntry | Entries:
        if isinstance(at, slice):
            return Entries(self._items[: self._count][at])
        return self._items[range(self._count)[at]]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Entries) or other._count != self._count:
            return False
        return other._items is self._items or tuple(self) == tuple(other)


def describe_entry(entry: HistoryEntry) -> str:
    """Describe an entry of the history for the operator."""
    return describe_action(entry.action) if isinstance(entry, ActionEntry) else f"poke {entry}"


class OperationKind(Enum):
    """Kind of the operator's action on an entry of the history."""

    DONE = "done"
    UNDONE = "undone"
    REDONE = "redone"


@dataclass(frozen=True, slots=True)
class LastOperation:
    """The operator's last action. An accepted poke is no operation."""

    number: int
    """Grows with each."""
    kind: OperationKind
    name: str
    """Description of the entry."""


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Entries that can be undone, and undone entries that can be redone until the operator does something else.

    A poke that arrives meanwhile leaves the undone entries alone.
    """

    entries: Entries = field(default_factory=Entries)
    """The newest last, with pokes that were excluded by hand."""
    undone: tuple[HistoryEntry, ...] = ()
    """The next one to redo last."""
    last: LastOperation | None = None

    def undoable(self, excluded: Collection[int]) -> int:
        """Index of the newest entry that can be undone, -1 without one. Excluded pokes cannot."""
        for at in range(len(self.entries) - 1, -1, -1):
            entry = self.entries[at]
            if isinstance(entry, ActionEntry) or entry not in excluded:
                return at
        return -1

    def with_poke(self, poke: int) -> History:
        """Add an accepted poke."""
        return replace(self, entries=self.entries.with_entry(poke))

    def without_poke(self, poke: int) -> History:
        """Drop the entries of a poke that is no longer accepted."""
        entries = Entries(entry for entry in self.entries if entry != poke)
        return replace(self, entries=entries, undone=tuple(entry for entry in self.undone if not _is_of(entry, poke)))

    def with_action(self, entry: ActionEntry, *, is_operator: bool) -> History:
        """Add an action; one that the pipeline found leaves the undone entries alone."""
        done = replace(self, entries=self.entries.with_entry(entry))
        return _with_operation(done, OperationKind.DONE, entry, undone=()) if is_operator else done

    def after_undo(self, at: int) -> History:
        """Move the entry of an index to the undone ones. Entries after it were excluded pokes."""
        entry = self.entries[at]
        done = replace(self, entries=self.entries[:at])
        return _with_operation(done, OperationKind.UNDONE, entry, undone=(*self.undone, entry))

    def after_redo(self, entry: HistoryEntry) -> History:
        """Move the newest undone entry back, as `entry`."""
        done = replace(self, entries=self.entries.with_entry(entry))
        return _with_operation(done, OperationKind.REDONE, entry, undone=self.undone[:-1])


def _with_operation(history: History, kind: OperationKind, entry: HistoryEntry, undone: tuple[HistoryEntry, ...]) -> History:
    number = 1 if history.last is None else history.last.number + 1
    return replace(history, undone=undone, last=LastOperation(number, kind, describe_entry(entry)))


def _is_of(entry: HistoryEntry, poke: int) -> bool:
    """Whether an entry is a poke, or excludes or restores it."""
    if isinstance(entry, ActionEntry):
        return isinstance(entry.action, Exclude | Restore) and entry.action.poke == poke
    return entry == poke
