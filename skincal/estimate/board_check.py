"""How far a poke lies from where its module's other pokes foretell it: each poke left out in turn, without a new search.

At the minimum the rows' gradients cancel, sum t A'r = 0 with A and r the slopes and misses of a poke in standard deviations of
its own noise and t its trust. Without poke i the information is N_i = sum t A'A - t_i A_i'A_i, and the minimum moves so that

    r_i becomes r_i + t_i A_i N_i^-1 A_i' r_i,   with the covariance I + A_i N_i^-1 A_i',

exactly where the middle moves straight with the board's unknowns, as it nearly does over a millimetre. How far the
contact lies beside the middle of its pads is in the noise (`board_fit.py`). The others' trust is what it is with the poke.
"""

from __future__ import annotations

import numpy as np

from skincal.estimate.board_fit import NO_RANK, Fitted, whitened
from skincal.estimate.result import SD_MAX
from skincal.estimate.touches import Touches
from skincal.readings import FloatArray, IntArray
from skincal.scene import NoiseSettings

OTHERS = 2
"""Other pokes of its module that a poke needs: from one nothing is foretold of how a board is turned."""


def foretold_squares(touches: Touches, fitted: Fitted, noise: NoiseSettings, at: IntArray) -> FloatArray:
    """Return (n,) the squared distance of pokes from where the others of their module foretell them, in standard deviations.

    NaN where the others do not tell: too few, or the place worse than `SD_MAX`. Where the predicted errors are true it is a
    chi-squared of two degrees of freedom.

    Parameters
    ----------
    touches, fitted : all pokes, and the boards as these put them
    at : (n,) indices of the touches
    """
    if not len(at):
        return np.empty(0)
    rows, gradients = whitened(touches, fitted.pads, noise), touches.middles(fitted.pads)[1][at]
    slopes, misses, trust = rows.slopes[at], rows.misses[at], fitted.trust[at, None, None]
    every = fitted.trust[:, None, None] * (rows.slopes.transpose(0, 2, 1) @ rows.slopes)
    whole = np.add.reduceat(every, np.searchsorted(touches.of, np.arange(len(touches.boards))), axis=0)
    others = whole[touches.of[at]] - trust * (slopes.transpose(0, 2, 1) @ slopes)
    values, axes = np.linalg.eigh(others)
    # A direction that the others do not tell is nothing but rounding, of either sign.
    known = (values[:, 0] > NO_RANK * values[:, -1]) & (np.bincount(touches.of)[touches.of[at]] > OTHERS)
    values = np.where(known[:, None], values, 1.0)
    roots = axes / np.sqrt(values)[:, None]
    spread = gradients @ roots
    sds = np.sqrt(np.linalg.eigvalsh(spread @ spread.transpose(0, 2, 1))[:, -1])
    seen = slopes @ roots
    leverage = seen @ seen.transpose(0, 2, 1)
    off = misses[:, :, None] + trust * (leverage @ misses[:, :, None])
    squares = np.sum(off * np.linalg.solve(np.eye(2) + leverage, off), axis=(1, 2))
    return np.where(known & (sds <= SD_MAX), squares, np.nan)
