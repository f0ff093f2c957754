"""The lowest and highest value per column of a curve, so that ten thousand points draw as a thousand and no peak is lost.

Measured on six curves of 10 000 points: a third of the cost of the plot's own downsampling (`docs`: window).
"""

from __future__ import annotations

import numpy as np

from skincal.geometry.arrays import FloatArray


def envelope(times: FloatArray, values: FloatArray, columns: int, span: float) -> tuple[FloatArray, FloatArray]:
    """Reduce curves to at most two points a column.

    Columns are cut at multiples of `span/columns` on the time axis itself, so that a sample stays in its column while
    the curve moves on and the picture does not shimmer.

    Parameters
    ----------
    times : (n,) float, seconds, ascending
    values : (n, k) float; NaN is a gap
    columns : columns of the whole span, at least 1
    span : seconds

    Returns
    -------
    times : (m,) float, seconds, m <= 2 (columns + 1), or the input where that is not longer
    values : (m, k) float
    """
    if len(times) <= 2 * columns:
        return times, values
    width = span / columns
    column = np.floor(times / width)
    starts = np.flatnonzero(np.diff(column, prepend=column[0] - 1.0))
    low = np.fmin.reduceat(values, starts, axis=0)
    high = np.fmax.reduceat(values, starts, axis=0)
    reduced = np.empty((2 * len(starts), values.shape[1]))
    reduced[0::2], reduced[1::2] = low, high
    edges = column[starts] * width
    return np.repeat(edges, 2) + np.tile((0.0, 0.5 * width), len(starts)), reduced
