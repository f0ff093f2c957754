"""The history of a session in lines: what was done and when; pure functions, without Qt."""

from __future__ import annotations

import time
from dataclasses import dataclass

from skincal.session.snapshot import Snapshot
from skincal.session.undo import ActionEntry, HistoryEntry, describe_entry

LISTED = 500
"""Lines, the newest: older ones are not read."""
EARLIER = "earlier"
"""When something was done at a time that the session does not know."""


@dataclass(frozen=True, slots=True)
class HistoryLine:
    """One entry of the history."""

    when: str
    what: str
    back: int
    """So many steps back take it back, too; 0 where it was taken back already."""
    again: int
    """So many steps forth bring it again; 0 where it was not taken back."""


def history_lines(snapshot: Snapshot, now_s: float) -> list[HistoryLine]:
    """Return the lines of a session's history, the newest first; above them what was taken back.

    `now_s` is the time of day, seconds since 1970: of what was done on another day, the day is told.
    """
    ends = {record.outcome.poke: record.outcome.end_s for record in snapshot.pokes}
    out = {record.outcome.poke for record in snapshot.pokes if record.excluded}

    def when(entry: HistoryEntry) -> str:
        if isinstance(entry, ActionEntry):
            return _time_words(entry.at_s, now_s)
        clock = next((clock for before, clock in reversed(snapshot.clocks) if entry > before), None)
        return EARLIER if clock is None or entry not in ends else _time_words(clock.at(ends[entry]), now_s)

    # The one that comes again last stands first.
    lines = [
        HistoryLine(when(entry), f"{describe_entry(entry)} (taken back)", 0, len(snapshot.history.undone) - at)
        for at, entry in enumerate(snapshot.history.undone)
    ]
    # A poke that was taken out by hand is passed over by undo: its exclusion is a line of its own.
    counting = [entry for entry in reversed(snapshot.history.entries) if isinstance(entry, ActionEntry) or entry not in out]
    lines += [HistoryLine(when(entry), describe_entry(entry), at + 1, 0) for at, entry in enumerate(counting[:LISTED])]
    return lines


def _time_words(at_s: float, now_s: float) -> str:
    # A recording that was imported has a clock of its own, by which things may happen tomorrow.
    if not at_s <= now_s + 1.0:
        return EARLIER
    at, now = time.localtime(at_s), time.localtime(now_s)
    return time.strftime("%H:%M:%S" if at[:3] == now[:3] else "%Y-%m-%d %H:%M", at)
