"""What undo would take back and redo bring again: one entry for every accepted poke and every action, without limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from skincal.model.actions import Action, Exclude, Restore


@dataclass(frozen=True, slots=True)
class Step:
    """What can be taken back."""

    words: str
    """What it was, for the operator."""
    take_back: Callable[[], None]


@dataclass(frozen=True, slots=True, eq=False)
class ActionEntry:
    """An action in the history."""

    step: Step
    action: Action
    at_s: float
    """Time of day, seconds since 1970; NaN where nobody knows it."""


class DeedKind(Enum):
    """What the operator did to an entry of the history."""

    DONE = "done"
    UNDONE = "taken back"
    REDONE = "brought again"


@dataclass(frozen=True, slots=True)
class Deed:
    """What the operator did last; an accepted poke is none."""

    number: int
    """Grows with each."""
    kind: DeedKind
    words: str
    """The entry's."""


Entry = ActionEntry | int
"""A poke is its number alone: there are thousands."""


class History:
    """The entries of a session, and those that were taken back.

    What was taken back can be brought again, the newest first, until the operator does something else; a poke that comes
    meanwhile changes nothing of that.

    Parameters
    ----------
    is_excluded : whether a poke, by its number, was taken out already: there is nothing to undo in it
    set_excluded : takes a poke out, which is how an accepted one is undone, or in again
    do : does an action, and returns its step
    """

    def __init__(
        self,
        is_excluded: Callable[[int], bool],
        set_excluded: Callable[[int, bool], None],
        do: Callable[[Action], Step],
    ) -> None:
        self._is_excluded, self._set_excluded, self._do = is_excluded, set_excluded, do
        self._entries: list[Entry] = []
        self._undone: list[Entry] = []
        """The one that was taken back last stands last."""
        self.deed: Deed | None = None

    @property
    def entries(self) -> tuple[Entry, ...]:
        """What can be taken back, the newest last, with pokes that were taken out by hand."""
        return tuple(self._entries)

    @property
    def undone(self) -> tuple[Entry, ...]:
        """What can be brought again, the next last."""
        return tuple(self._undone)

    @property
    def can_undo(self) -> str:
        """What undo would take back, in words; empty where there is nothing."""
        at = self._last()
        return "" if at < 0 else words_of(self._entries[at])

    @property
    def can_redo(self) -> str:
        """What redo would bring again, in words; empty where there is nothing."""
        return words_of(self._undone[-1]) if self._undone else ""

    def add_poke(self, poke: int) -> None:
        """Add the newest accepted poke."""
        self._entries.append(poke)

    def forget_poke(self, poke: int) -> None:
        """Drop a poke that no longer counts."""
        self._entries = [entry for entry in self._entries if entry != poke]
        self._undone = [entry for entry in self._undone if not _is_of(entry, poke)]

    def do(self, action: Action, at_s: float = math.nan, *, found: bool = False) -> None:
        """Do an action and add it.

        Parameters
        ----------
        found : the recording found it, the operator did nothing: what was taken back can still be brought again
        """
        step = self._do(action)
        self._entries.append(ActionEntry(step, action, at_s))
        if not found:
            self._undone = []
            self._note(DeedKind.DONE, step.words)

    def undo(self) -> bool:
        """Take back the newest entry that can be; return whether there was one."""
        at = self._last()
        if at < 0:
            return False
        entry = self._entries[at]
        if isinstance(entry, ActionEntry):
            entry.step.take_back()
        else:
            self._set_excluded(entry, True)
        # What came after it was taken out by hand already.
        del self._entries[at:]
        self._undone.append(entry)
        self._note(DeedKind.UNDONE, words_of(entry))
        return True

    def redo(self) -> bool:
        """Bring again what was taken back last; return whether there was anything.

        Raises
        ------
        InputError
            It fits no more.
        """
        if not self._undone:
            return False
        entry = self._undone[-1]
        if isinstance(entry, ActionEntry):
            self._entries.append(ActionEntry(self._do(entry.action), entry.action, entry.at_s))
        else:
            self._set_excluded(entry, False)
            self._entries.append(entry)
        self._undone.pop()
        self._note(DeedKind.REDONE, words_of(entry))
        return True

    def _note(self, kind: DeedKind, words: str) -> None:
        self.deed = Deed(1 if self.deed is None else self.deed.number + 1, kind, words)

    def _last(self) -> int:
        """Return the index of the newest entry that can be taken back; -1 where there is none."""
        for at in range(len(self._entries) - 1, -1, -1):
            entry = self._entries[at]
            if isinstance(entry, ActionEntry) or not self._is_excluded(entry):
                return at
        return -1


def _is_of(entry: Entry, poke: int) -> bool:
    """Return whether an entry is a poke, or takes it out or in."""
    if isinstance(entry, ActionEntry):
        return isinstance(entry.action, Exclude | Restore) and entry.action.poke == poke
    return entry == poke


def words_of(entry: Entry) -> str:
    """Return what an entry was, for the operator."""
    return entry.step.words if isinstance(entry, ActionEntry) else f"poke {entry}"
