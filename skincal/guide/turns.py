"""Whose turn it is where pokes need no tilt but evenness: round by round, and the way of the hand short.

A poke of its own is a turn, asked for or not. One that was asked for and missed is asked for once more in a round, and no more
often: who cannot be reached must not keep the others waiting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.readings import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """Says which of n taxels is poked next, by how often each was."""

    places: FloatArray
    """(n, 3) float, metres, believed; NaN where nothing is known."""
    modules: IntArray
    """(n,) index of the module, from 0; looked at by `module_taxel` alone."""
    asked: IntArray
    """(n,) how often each was asked for."""
    own: IntArray
    """(n,) pokes that each answered most."""

    def taxel(self, rows: IntArray, seconds: FloatArray) -> int:
        """Return which of the taxels `rows` (m,) is next, each counted by itself: of several the one reached soonest.

        Parameters
        ----------
        seconds : (m,) until the hand has poked there
        """
        first = _first(_rounds(self.asked, self.own)[rows])
        return int(rows[first[seconds[first].argmin()]])

    def module_taxel(self, rows: IntArray, seconds: FloatArray) -> int:
        """Return which of `rows` (m,) is next where modules take turns: of several modules the one reached soonest.

        Pokes side by side do not tell how a module is turned: of its taxels that were poked least, it is the one farthest from
        the others. One that was asked for twice in vain counts as poked.

        Parameters
        ----------
        seconds : (m,) until the hand has poked there
        """
        first = _first(_rounds(np.bincount(self.modules, self.asked), np.bincount(self.modules, self.own))[self.modules[rows]])
        module = self.modules[rows[first[seconds[first].argmin()]]]
        here = first[self.modules[rows[first]] == module]
        each = np.maximum(self.own, self.asked - 1)
        here = here[_first(each[rows[here]])]
        more = (self.modules == module) & (each > each[rows[here[0]]]) & np.isfinite(self.places).all(axis=1)
        if not more.any():
            return int(rows[here[seconds[here].argmin()]])
        off = self.places[rows[here], None] - self.places[more]
        return int(rows[here[np.sum(off * off, axis=2).min(axis=1).argmax()]])


def _first(rounds: FloatArray | IntArray) -> IntArray:
    return np.flatnonzero(rounds == rounds.min())


def _rounds(asked: IntArray | FloatArray, own: IntArray | FloatArray) -> FloatArray:
    return np.maximum(own, np.maximum(np.minimum(asked, own + 1), asked - 1)).astype(np.float64)
