"""When the next tick comes and whether it shows a picture: thirty a second, fewer while there is work, none for nothing."""

from __future__ import annotations

TICK_MS = 33
"""One picture a tick: 30 a second."""
BEHIND_MS = 4
"""The next tick comes this soon while readings still wait, or taxels to be solved."""
DRAW_S = 0.010
"""s. Pictures come no faster than this. Well below a tick: after a long one the timer comes early, to keep its pace, and that
picture must not be left out."""
DRAW_BEHIND_S = 0.1
"""s. While there is work, pictures come no faster than this: readings go before pictures."""
IDLE_S = 0.5
"""s. While nothing arrives the links are looked at this often, to say that one fell silent."""
SOLVING_S = 0.4
"""s. Solving that lasts longer is said."""


class Pace:
    """Knows when the last picture was shown, and since when taxels wait to be solved; host's monotonic clock."""

    def __init__(self) -> None:
        self._shown_ns = 0
        self._solving_ns = 0
        """0 where none do."""

    def is_due(self, now_ns: int, *, behind: bool, news: bool) -> bool:
        """Return whether a picture is due that shows what is shown already.

        Parameters
        ----------
        behind : readings wait, or taxels
        news : something arrived
        """
        pause_s = DRAW_BEHIND_S if behind else DRAW_S if news else IDLE_S
        return (now_ns - self._shown_ns) * 1e-9 >= pause_s

    def show(self, now_ns: int) -> None:
        """Note that a picture is shown now."""
        self._shown_ns = now_ns

    def worth_saying(self, unsolved: int, now_ns: int) -> int:
        """Return how many taxels wait to be solved, once some have waited for long."""
        self._solving_ns = (self._solving_ns or now_ns) if unsolved else 0
        return unsolved if (now_ns - self._solving_ns) * 1e-9 >= SOLVING_S else 0
