"""Whose turn it is where pokes need no tilt but evenness: round by round, of several the one that is reached soonest.

A poke of its own is a turn, asked for or not. One that was asked for and missed is asked for once more in a round, and no more
often: who cannot be reached must not keep the others waiting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.readings import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """Of n taxels."""

    places: FloatArray
    """(n, 3) float, metres, believed."""
    modules: IntArray
    """(n,) index of the module, from 0; looked at by `module_taxel` alone."""
    asked: IntArray
    """(n,) how often each was asked for."""
    own: IntArray
    """(n,) pokes that each answered most."""

    def taxel(self, rows: IntArray, seconds: FloatArray) -> int:
        """Return which of the taxels `rows` (m,) is next, each counted by itself.

        Parameters
        ----------
        seconds : (m,) until the hand has poked there
        """
        first = _first(_rounds(self.asked, self.own)[rows])
        return int(rows[first[seconds[first].argmin()]])

    def module_taxel(self, rows: IntArray, seconds: FloatArray) -> int:
        """Return which of `rows` (m,) is next where modules take turns: of its module, the one farthest from those poked.

        Pokes side by side do not tell how a module is turned. A taxel that was asked for twice in vain counts as poked.

        Parameters
        ----------
        seconds : (m,) until the hand has poked there
        """
        first = _first(_rounds(np.bincount(self.modules, self.asked), np.bincount(self.modules, self.own))[self.modules[rows]])
        module = self.modules[rows[first[seconds[first].argmin()]]]
        here = first[self.modules[rows[first]] == module]
        poked = self.places[(self.modules == module) & ((self.own > 0) | (self.asked > 1))]
        if not len(poked):
            return int(rows[here[seconds[here].argmin()]])
        apart = np.sqrt(np.sum((self.places[rows[here], None] - poked) ** 2, axis=2)).min(axis=1)
        return int(rows[here[np.nan_to_num(apart).argmax()]])


def _first(rounds: FloatArray) -> IntArray:
    return np.flatnonzero(rounds == rounds.min())


def _rounds(asked: IntArray | FloatArray, own: IntArray | FloatArray) -> FloatArray:
    return np.maximum(own, np.maximum(np.minimum(asked, own + 1), asked - 1)).astype(np.float64)
