"""Least squares with rows of very different size and columns that are nearly dependent: Householder QR, many at once.

Rows are sorted by size, largest first, and the largest remaining column comes next. With both, each row's backward error
is rounding times that row's own size, so rows weighted 1e-12 keep their digits beside rows weighted 1 (Powell and Reid
1968; Cox and Higham 1998; Bjoerck 1996, section 4.4). Normal equations lose half of all digits where columns are nearly
dependent. See `docs/decisions/least-squares.md`.

Columns are not moved: the pivot's place is remembered, and the triangular factor's rows stand in the order of p.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.estimate.segments import dot, spread, total
from skincal.readings import FloatArray, IntArray

NO_RANK = 1e-14
"""A triangular factor's diagonal below this share of the size of the rows it was made of is rounding: it determines
nothing. The rows that are left at each step, not all of them: beside a heavy row, light ones may determine the rest."""
_SORTED = 1.0 + 1e-9
"""Rows that are longer than the one before them by less than this count as sorted: rounding of a length."""


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """The essence of t systems: |A p - b|^2 = |root p - offset|^2 + a constant, for each."""

    roots: FloatArray
    """(t, 3, 3) float: triangular but for the order of its columns, which is that of p."""
    offsets: FloatArray
    """(t, 3) float."""
    order: IntArray
    """(t, 3): the columns in the order of elimination; roots[i][:, order[i]] is upper triangular."""
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
    starts : (t + 1,) int: system i has the rows starts[i] to starts[i + 1], at least one; t > 0
    """
    systems = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    work = np.concatenate([a.T, b[None]])
    _sort_rows(work, starts, systems)
    count = len(starts) - 1
    noises = _noises(work, starts)
    roots, offsets = np.empty((3, 3, count)), np.empty((3, count))
    order = np.empty((3, count), dtype=np.int64)
    left = np.ones((3, count), dtype=bool)
    for k in range(2):
        row, order[k] = _eliminate(work, starts, systems, k, left)
        roots[k], offsets[k] = row[:3], row[3]
    roots[2], offsets[2], order[2] = _project(work, starts, systems, left)
    triangles = roots[:, order, np.arange(count)]
    ranks, solutions, blind = _solve(triangles, offsets, order, noises)
    return Factors(roots.transpose(2, 0, 1), offsets.T, order.T, ranks, solutions, blind)


def _sort_rows(work: FloatArray, starts: IntArray, systems: IntArray) -> None:
    """Sort the rows of each system, largest first, in place; stable, so that equal rows keep their order."""
    squares = dot(work[:3], work[:3])
    rises = np.flatnonzero(squares[1:] > squares[:-1] * _SORTED) + 1
    # Evidence comes sorted, so few systems are not: those with doubted contacts.
    unsorted = np.zeros(len(starts) - 1, dtype=bool)
    unsorted[systems[rises[systems[rises] == systems[rises - 1]]]] = True
    if unsorted.any():
        some = np.flatnonzero(unsorted[systems])
        work[:, some] = work[:, some[np.lexsort((-squares[some], systems[some]))]]


def _eliminate(
    work: FloatArray, starts: IntArray, systems: IntArray, k: int, left: NDArray[np.bool_]
) -> tuple[FloatArray, IntArray]:
    """Reflect the rows from k on so that the pivot column is zero below; return the factor's row (4, t) and the pivots (t,).

    `work` keeps the rows that are left, its row k set to zero; `left` (3, t) the columns that are. The others hold rounding.
    """
    squares = np.where(left, total(work[:3] * work[:3], starts), -1.0)
    pivot = np.argmax(squares, axis=0)
    size = np.sqrt(squares.max(axis=0))
    system = np.arange(len(pivot))
    v = _column(work, pivot, systems)
    # A system with fewer rows than k has none left: its size is nought, and any row of it will do.
    first = np.minimum(starts[:-1] + k, starts[1:] - 1)
    lead = v[first]
    # The sign that adds: no digits cancel. v'v = 2 size (size + |lead|).
    alpha = np.copysign(size, lead)
    v[first] = lead + alpha
    beta = np.divide(1.0, size * (size + np.abs(lead)), out=np.zeros_like(size), where=size > 0)
    work -= v * spread(beta * total(v * work, starts), systems)
    row = work[:, first]
    row[pivot, system] = -alpha
    row[:3][~left] = 0.0
    row[:, size == 0.0] = 0.0
    left[pivot, system] = False
    work[:, first] = 0.0
    return row, pivot


def _project(
    work: FloatArray, starts: IntArray, systems: IntArray, left: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the factor's last row (3, t), its side (t,) and its column (t,), where one column is left.

    A plain projection: a reflection would add a heavy row's first number to a column that is light, and lose its digits.
    """
    pivot = np.argmax(left, axis=0)
    v = _column(work, pivot, systems)
    squares, along = total(np.stack([v * v, v * work[3]]), starts)
    size = np.sqrt(squares)
    return np.where(left, size, 0.0), np.divide(along, size, out=np.zeros_like(size), where=size > 0), pivot


def _column(work: FloatArray, pivot: IntArray, systems: IntArray) -> FloatArray:
    """Return (m,) column `pivot` (t,) of each system, one below the other."""
    rows = work.shape[1]
    return work.ravel()[rows * pivot[systems] + np.arange(rows)]


def _noises(work: FloatArray, starts: IntArray) -> FloatArray:
    """Return (3, t): below which a diagonal of the factor is rounding of the rows that are left at its step."""
    squares = dot(work[:3], work[:3])
    left = np.empty((3, len(starts) - 1))
    for k in range(3):
        left[k] = total(squares, starts)
        # Not subtracted from the sum: what is left may be 1e-24 of it.
        squares[np.minimum(starts[:-1] + k, starts[1:] - 1)] = 0.0
    return NO_RANK * np.sqrt(left)


def _solve(
    triangles: FloatArray, offsets: FloatArray, order: IntArray, noises: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Solve `triangles` (3, 3, t) upper triangular x = `offsets` (3, t); returns ranks, solutions and blind directions."""
    ranks = (np.abs(triangles[[0, 1, 2], [0, 1, 2]]) > noises).sum(axis=0)
    x, blind = np.empty_like(offsets), np.zeros((offsets.shape[1], 3))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        x[2] = offsets[2] / triangles[2, 2]
        x[1] = (offsets[1] - triangles[1, 2] * x[2]) / triangles[1, 1]
        x[0] = (offsets[0] - triangles[0, 1] * x[1] - triangles[0, 2] * x[2]) / triangles[0, 0]
    for i in np.flatnonzero(ranks < 3):
        x[:, i], blind[i, order[:, i]] = _smallest(triangles[: ranks[i], :, i], offsets[: ranks[i], i])
    solutions = np.empty_like(x)
    solutions[order, np.arange(order.shape[1])] = x
    return ranks, solutions.T, blind


def _smallest(rows: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the solution of smallest norm of fewer than three rows, (3,), and the blind direction of two."""
    x = np.linalg.pinv(rows) @ offset
    if len(rows) != 2:
        return x, np.zeros(3)
    blind = np.cross(rows[0], rows[1])
    return x, blind / np.linalg.norm(blind)
