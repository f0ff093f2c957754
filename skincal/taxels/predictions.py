"""Pokes that are predicted by the others, for the check by held-out pokes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray

MIN_OTHER_POKES_TO_PREDICT = 2
"""Other pokes of its module or sheet for a prediction: a single one does not determine the turn."""


@dataclass(frozen=True, slots=True, eq=False)
class PokePredictions:
    """Distances of n pokes from where the others of their taxel, module or sheet predict them."""

    rows: IntArray
    """(n,) an answer of each poke in the evidence."""
    levers: FloatArray
    """(n, 3) float, metres, from the sensor's origin to the taxel, or to the centre of the taxels that answered."""
    misses: FloatArray
    """(n, 2) float, metres, along the pairs of the pokes; NaN without a prediction, or if its sd is beyond
    `POSITION_MAX_SD_M`."""
    covariances: FloatArray
    """(n, 2, 2) float, m^2, of the misses: of the prediction and of the poke's own noise."""
    own: FloatArray
    """(n, 2, 2) float, m^2, of each poke's own noise."""

    @classmethod
    def none(cls) -> PokePredictions:
        """Make the predictions of no poke."""
        square = np.empty((0, 2, 2))
        return cls(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 2)), square, square)
