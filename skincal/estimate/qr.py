"""Least squares with rows of very different size and columns that are nearly dependent: Householder QR.

Rows are sorted by size, largest first, and columns are exchanged so that the largest remaining one comes next. With
both, each row's backward error is rounding times that row's own size, so rows weighted 1e-12 keep their digits beside
rows weighted 1 (Powell and Reid 1968; Cox and Higham 1998; Bjoerck 1996, section 4.4). Normal equations lose half of
all digits where columns are nearly dependent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.readings import FloatArray

NO_RANK = 1e-14
"""A triangular factor's diagonal below this share of its largest is rounding: it determines nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """The system's essence: |A p - b|^2 = |root p - offset|^2 + a constant."""

    root: FloatArray
    """(3, 3) float: the triangular factor, columns in the order of p."""
    offset: FloatArray
    """(3,) float."""
    solution: FloatArray | None
    """(3,) float: the p of least squares; None where the rows do not determine one."""


def factor(a: FloatArray, b: FloatArray) -> Factor:
    """Minimise |A p - b| over p.

    Parameters
    ----------
    a : (n, 3) float, A
    b : (n,) float
    """
    # Stable, so that equal rows keep the order of the evidence, which depends on its content only.
    order = np.argsort(-np.abs(a).max(axis=1), kind="stable")
    work = np.zeros((max(len(b), 3), 4))
    work[: len(b), :3], work[: len(b), 3] = a[order], b[order]
    columns = [0, 1, 2]
    for k in range(3):
        rest = work[k:, k:3]
        swap = k + int(np.argmax(np.einsum("ij,ij->j", rest, rest)))
        if swap != k:
            work[:, [k, swap]] = work[:, [swap, k]]
            columns[k], columns[swap] = columns[swap], columns[k]
        _reflect(work, k)
    triangle, offset = np.triu(work[:3, :3]), work[:3, 3].copy()
    root = np.empty((3, 3))
    root[:, columns] = triangle
    return Factor(root, offset, _back(triangle, offset, columns))


def _reflect(work: FloatArray, k: int) -> None:
    """Make column k zero below its diagonal by a reflection of the rows from k on."""
    v = work[k:, k].copy()
    size = float(np.sqrt(v @ v))
    if size == 0.0:
        return
    # The sign that adds: no digits cancel.
    v[0] += np.copysign(size, v[0])
    work[k:, k:] -= np.outer(v, (2.0 / (v @ v)) * (v @ work[k:, k:]))


def _back(triangle: FloatArray, offset: FloatArray, columns: list[int]) -> FloatArray | None:
    diagonal = np.abs(np.diag(triangle))
    if diagonal.min() <= NO_RANK * diagonal.max():
        return None
    p = np.empty(3)
    for i in (2, 1, 0):
        done = columns[i + 1 :]
        p[columns[i]] = (offset[i] - triangle[i, i + 1 :] @ p[done]) / triangle[i, i]
    return p
