"""Turns of taxels of three axes, as the guide follows them: which are open, how to push there, and what a poke gains.

The turn in the plane of the skin needs pokes that lean. The lean is that of the goals of `skincal study axes`; successive pokes
lean to other sides, since these show the ratio of the gains, too.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from skincal.axes.turn_gain import in_plane_sds
from skincal.geometry import BoolArray, FloatArray, IntArray
from skincal.guide.candidates import PUSH_AZIMUTHS_TRIED, TILT_SHARES
from skincal.guide.progress import GuideSettings

if TYPE_CHECKING:
    from skincal.axes.session_turns import SessionTurns, ShownTurn

LEAN_MIN_RAD = float(np.radians(12.0))
"""A push of less lean shows a turn slowly: of the tilts that are tried the smallest above it is taken, else the largest."""
AZIMUTH_STEP_IN_EIGHTH_TURNS = 3
"""Eighths of a turn between successive pushes at a taxel, as for modules without a mesh."""
POKES_OF_UNKNOWN_TURN = 4
"""Leaning pokes that bring an unknown turn to `GuideSettings.turn_wanted`: 5 of up to 15 degrees leave 2.4 degrees."""


class TurnNeeds:
    """The turns of the taxels `channels` (n,), followed from one moment of a session to the next."""

    def __init__(self, channels: IntArray, settings: GuideSettings) -> None:
        self._channels, self._settings = channels, settings
        self._turns: SessionTurns | None = None
        self.is_open: BoolArray = np.ones(len(channels), dtype=bool)
        """(n,) taxels whose turn is not known well enough."""

    def update(self, turns: SessionTurns | None) -> IntArray:
        """Follow the turns; return the indices of the taxels that opened or closed, ascending."""
        if turns is self._turns:
            return np.empty(0, dtype=np.int64)
        self._turns = turns
        now = np.array([self._is_open(self._turn(row)) for row in range(len(self._channels))], dtype=bool)
        changed = np.flatnonzero(now != self.is_open)
        self.is_open = now
        return changed

    def _turn(self, row: int) -> ShownTurn | None:
        return None if self._turns is None else self._turns.of_channel(int(self._channels[row]))

    def _is_open(self, turn: ShownTurn | None) -> bool:
        return turn is None or not max(turn.fit.normal_sd, turn.in_plane_sd) <= self._settings.turn_wanted

    def leaning_pushes(self, row: int, usable_tilt: float) -> list[int]:
        """Order the leaning pushes of `candidate_pushes` at a taxel, the next one first."""
        shares = [share for share in TILT_SHARES if share * usable_tilt >= LEAN_MIN_RAD] or [TILT_SHARES[-1]]
        first = 1 + PUSH_AZIMUTHS_TRIED * TILT_SHARES.index(shares[0])
        turn = self._turn(row)
        begin = AZIMUTH_STEP_IN_EIGHTH_TURNS * (0 if turn is None else turn.turn.pokes)
        return [first + (begin + step) % PUSH_AZIMUTHS_TRIED for step in range(PUSH_AZIMUTHS_TRIED)]

    def gain(self, row: int, normal: FloatArray, push: FloatArray) -> tuple[float, float]:
        """Predict the sd of a taxel's turn in the plane before and after a push, rad; both NaN if its turn is not open.

        Infinite while it is unknown.
        """
        turn = self._turn(row)
        if not self.is_open[row] or self._turns is None:
            return (math.inf, math.nan) if self.is_open[row] else (math.nan, math.nan)
        shown = None if turn is None else turn.turn
        now, after = in_plane_sds(shown, self._turns.skin.noise, normal, push[None])
        is_known = turn is not None and turn.is_in_plane_known
        return now if is_known else math.inf, float(after[0])

    def count_pokes_left(self, open_: BoolArray, modules: IntArray) -> int:
        """Predict the leaning pokes until no turn of the taxels `open_` (n,) is open; taxels of one turn are counted once.

        `modules` (n,) are the indices of their modules. A module counts once until its taxels have turns of their own.
        """
        wanted: dict[tuple[int, int], int] = {}
        for row in np.flatnonzero(open_ & self.is_open).tolist():
            turn, module = self._turn(row), int(modules[row])
            group = (module, row) if self._has_own_turn(row) else (module, -1)
            wanted[group] = max(wanted.get(group, 0), self._pokes_wanted(turn))
        return sum(wanted.values())

    def _has_own_turn(self, row: int) -> bool:
        """Whether a taxel is on no module, or on one whose taxels have turns of their own."""
        if self._turns is None:
            return False
        number = self._turns.module_of.get(int(self._channels[row]))
        return number is None or (number in self._turns.modules and self._turns.modules[number].is_separate)

    def _pokes_wanted(self, turn: ShownTurn | None) -> int:
        if turn is None or not turn.is_in_plane_known:
            return POKES_OF_UNKNOWN_TURN
        # The variance falls as one over the pokes.
        share = (max(turn.fit.normal_sd, turn.in_plane_sd) / self._settings.turn_wanted) ** 2 - 1.0
        return max(1, math.ceil(turn.turn.pokes * share))
