"""The history of a session in lines: what was done and when; pure functions, without Qt."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from skincal.session.snapshot import Snapshot
from skincal.session.undo import ActionEntry, Entry, words_of

LISTED = 500
"""Lines, the newest: older ones are not read."""
EARLIER = "earlier"
"""When something was done before the session was opened here: clocks of other days are not known."""


@dataclass(frozen=True, slots=True)
class HistoryLine:
    """One entry of the history."""

    when: str
    what: str
    back: int
    """So many steps back take it back, too; 0 where it was taken back already."""
    again: int
    """So many steps forth bring it again; 0 where it was not taken back."""


def history_lines(snapshot: Snapshot, clock_offset: float, opened_s: float) -> list[HistoryLine]:
    """Return the lines of a session's history, the newest first; above them what was taken back.

    Parameters
    ----------
    clock_offset : s, to add to the monotonic clock for the time of day
    opened_s : host's monotonic clock, seconds, when the session was opened here
    """
    ends = {record.outcome.poke: record.outcome.end_s for record in snapshot.pokes}
    out = {record.outcome.poke for record in snapshot.pokes if record.excluded}

    def when(entry: Entry) -> str:
        at_s = entry.at_s if isinstance(entry, ActionEntry) else ends.get(entry, math.nan)
        return time.strftime("%H:%M:%S", time.localtime(at_s + clock_offset)) if at_s >= opened_s else EARLIER

    # The one that comes again last stands first.
    lines = [
        HistoryLine(when(entry), f"{words_of(entry)} (taken back)", 0, len(snapshot.undone) - at)
        for at, entry in enumerate(snapshot.undone)
    ]
    # A poke that was taken out by hand is passed over by undo: its exclusion is a line of its own.
    counting = [entry for entry in reversed(snapshot.history) if isinstance(entry, ActionEntry) or entry not in out]
    lines += [HistoryLine(when(entry), words_of(entry), at + 1, 0) for at, entry in enumerate(counting[:LISTED])]
    return lines
