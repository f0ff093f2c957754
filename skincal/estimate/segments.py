"""Sums over the answers of many taxels at once: arrays whose last axis runs over all answers, cut by `starts`.

Each sum sees its own segment alone, so a taxel's numbers do not depend, not by a bit, on which others are solved with it.
"""

from __future__ import annotations

import numpy as np

from skincal.readings import FloatArray, IntArray


def total(values: FloatArray, starts: IntArray) -> FloatArray:
    """Return (..., t) the sums of `values` (..., n) over each segment; `starts` (t + 1,) rises strictly, t > 0."""
    return np.add.reduceat(values, starts[:-1], axis=-1)


def largest(values: FloatArray, starts: IntArray) -> FloatArray:
    """Return (..., t) the largest of `values` (..., n) in each segment."""
    return np.maximum.reduceat(values, starts[:-1], axis=-1)


def spread(values: FloatArray, owners: IntArray) -> FloatArray:
    """Return (..., n): of `values` (..., t) the one of each place's segment, `owners` (n,)."""
    return values.take(owners, axis=-1)


def dot(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return (n,) the products of vectors `p` and `q` (3, n), summed in a fixed order."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return (i, k, t) the matrix products of `p` (i, j, t) and `q` (j, k, t), summed in a fixed order.

    Not `matmul` or `einsum`, whose last digit depends on how many matrices are multiplied at once.
    """
    result = p[:, 0, None] * q[0]
    for j in range(1, len(q)):
        result = result + p[:, j, None] * q[j]
    return result
