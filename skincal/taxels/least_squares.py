"""Least squares with rows of very different size and columns that are nearly dependent: Householder QR.

Rows are sorted and columns pivoted; `skincal/solver/source/factor.h` says why.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, sqrt

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.solver.machine import INTEGER, shared


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """The essence of t systems: |A p - b|^2 = |root p - offset|^2 + a constant, for each."""

    roots: FloatArray
    """(t, 3, 3) float: triangular but for the order of its columns, which is that of p."""
    offsets: FloatArray
    """(t, 3) float."""
    ranks: IntArray
    """(t,): how many directions of p the rows determine."""
    solutions: FloatArray
    """(t, 3) float: the p of least squares; of the smallest norm where the rows determine fewer than three directions."""
    blind: FloatArray
    """(t, 3) float, unit: the direction that the rows say nothing of, where the rank is 2; else zeros."""


def factor(a: FloatArray, b: FloatArray, starts: IntArray) -> Factors:
    """Minimise |A p - b| over p for each of t systems.

    Parameters
    ----------
    a : (m, 3) float, the rows A of all systems, one after another
    b : (m,) float
    starts : (t + 1,) int: system i has the rows starts[i] to starts[i + 1], at least one
    """
    count = len(starts) - 1
    with shared().call() as call:
        asked = [count, len(b), call.give(starts, INTEGER), call.give(np.concatenate([a.T, b[None]]))]
        roots, rest = call.room((count, 3, 3)), [call.room((count, 3)) for _ in range(3)]
        ranks = call.room((count,), INTEGER)
        call.run("factor", [*asked, roots, *rest, ranks])
        offsets, solutions, blind = (call.taken(place) for place in rest)
        return Factors(call.taken(roots), offsets, call.taken(ranks).astype(np.int64), solutions, blind)


def triangle(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return (d, d + 1) R | c with |A p - b|^2 = |R p - c|^2 + a constant, of a (m, d) and b (m,): `factor` for any d.

    R is triangular but for the order of its columns, which is that of p.
    """
    unknowns = a.shape[1]
    rows = np.zeros((max(len(a), unknowns), unknowns + 1))
    rows[: len(a), :unknowns], rows[: len(a), unknowns] = a, b
    rows[: len(a)] = rows[np.argsort(-np.sum(a * a, axis=1), kind="stable")]
    for k in range(unknowns):
        # Columns that are done are zero here.
        left = rows[k:]
        squares = np.einsum("ij,ij->j", left[:, :unknowns], left[:, :unknowns])
        pivot = int(squares.argmax())
        size, v = sqrt(squares[pivot]), left[:, pivot].copy()
        if size == 0.0:
            break
        if k == unknowns - 1:
            # A plain projection, as in `factor.h`.
            left[0, unknowns] = v @ left[:, unknowns] / size
            left[0, pivot] = size
        else:
            alpha = copysign(size, v[0])
            v[0] += alpha
            left -= v[:, None] * (v @ left / (alpha * v[0]))
            left[1:, pivot], left[0, pivot] = 0.0, -alpha
    return rows[:unknowns]
