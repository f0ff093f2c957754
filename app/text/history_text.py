"""Lines of the session history."""

from __future__ import annotations

import time
from dataclasses import dataclass

from skincal.session.snapshot import Snapshot
from skincal.session.undo import ActionEntry, HistoryEntry, describe_entry

MAX_HISTORY_LINES = 500  # The list has the newest lines
EARLIER_TIME = "earlier"  # Text in place of an unknown time


@dataclass(frozen=True, slots=True)
class HistoryLine:
    """One entry of the list of the operator's actions and pokes."""

    when: str
    what: str
    back: int
    """Undo steps down to this entry; 0 if it is undone already."""
    again: int
    """Redo steps up to this entry; 0 if it is not undone."""


def history_lines(snapshot: Snapshot, now_s: float) -> list[HistoryLine]:
    """List the history, the newest first, after the undone entries.

    `now_s` is the time of day, seconds since 1970; entries of another day show their date.
    """
    ends = {record.outcome.poke: record.outcome.end_s for record in snapshot.pokes}
    out = {record.outcome.poke for record in snapshot.pokes if record.excluded}

    def when(entry: HistoryEntry) -> str:
        if isinstance(entry, ActionEntry):
            return _time_words(entry.at_s, now_s)
        clock = next((clock for before, clock in reversed(snapshot.clocks) if entry > before), None)
        return EARLIER_TIME if clock is None or entry not in ends else _time_words(clock.at(ends[entry]), now_s)

    # The entry that redo restores last comes first.
    lines = [
        HistoryLine(when(entry), f"{describe_entry(entry)} (undone)", 0, len(snapshot.history.undone) - at)
        for at, entry in enumerate(snapshot.history.undone)
    ]
    # Undo skips a poke excluded by hand: its exclusion is an entry of its own.
    counting = [entry for entry in reversed(snapshot.history.entries) if isinstance(entry, ActionEntry) or entry not in out]
    lines += [
        HistoryLine(when(entry), describe_entry(entry), at + 1, 0) for at, entry in enumerate(counting[:MAX_HISTORY_LINES])
    ]
    return lines


def _time_words(at_s: float, now_s: float) -> str:
    # The clock of an imported recording may be in the future.
    if not at_s <= now_s + 1.0:
        return EARLIER_TIME
    at, now = time.localtime(at_s), time.localtime(now_s)
    return time.strftime("%H:%M:%S" if at[:3] == now[:3] else "%Y-%m-%d %H:%M", at)
