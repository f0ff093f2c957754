"""The optimum on a few triangles once more, in small numbers about a point that is nearly it.

Images of whole triangles carry the rounding of their size, in a metric's heavy rows as well; where the metric hardly sees
a direction, that rounding decides. About an anchor the numbers are as small as what is left to move: with p = anchor + d,

    |root p - offset|^2 = |rest|^2 + f(d),   f(d) = sum_i w_i (2 rest_i + w_i),   w = root d,   rest = root anchor - offset,

and the rounding of `rest` is the same for all triangles, like a change of the offset's last digit. So f tells apart what
the distances cannot. In the plane of a triangle d follows from two columns, by a reflection from their largest element:
rows of very different size keep their digits (Cox and Higham 1998).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.readings import FloatArray, IntArray

_AFTER, _SIDES = np.array([1, 2, 0]), np.array([[0], [1], [2]])
_ROUND = 32 * float(np.finfo(float).eps)
"""Share of a product's size that its rounding is at most."""


@dataclass(frozen=True, slots=True, eq=False)
class Polished:
    """The best points of m triangles."""

    away: FloatArray
    """(3, m) float, metres: from the anchors."""
    corner: IntArray
    """(m,) the corner where the point is one, else -1."""
    rise: FloatArray
    """(m,) f there: how much more than at the anchor |root p - offset|^2 is; below zero where the anchor was not the best."""
    unsure: FloatArray
    """(m,) the rounding of `rise`."""


def polish(rows: FloatArray, rest: FloatArray, corners: FloatArray, normals: FloatArray) -> Polished:
    """Minimise |root (anchor + d) - offset| over each of m triangles.

    Parameters
    ----------
    rows : (3, 3, m) float, the roots: row, component
    rest : (3, m) float, root anchor - offset
    corners : (3, 3, m) float, metres, from the anchors: component, corner
    normals : (3, m) float, unit
    """
    edges = corners[:, _AFTER] - corners
    inside = _inside(rows, rest, corners, edges, normals)
    sides, corner = _on_edges(rows, rest, corners, edges)
    away = np.concatenate([inside[:, None], sides], axis=1)
    image = _apply(rows, away)
    doubled = (rest + rest)[:, None]
    rise = _dot(image, doubled + image)
    # Inside comes first, and so wins where it is equal; NaN where there is none.
    rise[0][np.isnan(rise[0])] = np.inf
    column: IntArray = np.arange(int(rest.shape[1]))
    best = rise.argmin(axis=0)
    away, image = away[:, best, column], image[:, best, column]
    rounding = _ROUND * np.sqrt((rows * rows).sum(axis=1) * _dot(away, away))
    unsure = (rounding * (2.0 * (np.abs(rest) + np.abs(image)) + rounding)).sum(axis=0)
    return Polished(away, np.where(best > 0, corner[best - 1, column], -1), rise[best, column], unsure)


def _inside(rows: FloatArray, rest: FloatArray, corners: FloatArray, edges: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the best points of the planes (3, m), NaN where they are not inside."""
    column: IntArray = np.arange(int(rest.shape[1]))
    squares = _dot(edges, edges)
    longest = squares.argmax(axis=0)
    inward = np.empty_like(edges)
    x, y, z = normals
    inward[0], inward[1], inward[2] = y * edges[2] - z * edges[1], z * edges[0] - x * edges[2], x * edges[1] - y * edges[0]
    length = np.sqrt(squares[longest, column])
    along, aside = edges[:, longest, column] / length, inward[:, longest, column] / length
    # The corner nearest to the anchor leaves the fewest digits behind.
    foot = normals * _dot(normals, corners[:, _dot(corners, corners).argmin(axis=0), column])
    image = _apply(rows, np.stack([along, aside, foot], axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = _two_columns(image[:, 0], image[:, 1], image[:, 2] + rest)
        away = foot + s * along + t * aside
        within = (_dot(inward, away[:, None] - corners) >= 0).all(axis=0)
    return np.where(within, away, np.nan)


def _two_columns(g: FloatArray, k: FloatArray, h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Minimise |s g + t k + h| for columns of three rows; not finite where the columns are dependent."""
    swap = _dot(k, k) > _dot(g, g)
    g, k = np.where(swap, k, g), np.where(swap, g, k)
    column: IntArray = np.arange(int(g.shape[1]))
    lead = np.abs(g).argmax(axis=0)
    first = g[lead, column]
    size = np.copysign(np.sqrt(_dot(g, g)), first)
    g[lead, column] += size
    beta = g / (size * (first + size))
    k, h = k - beta * _dot(g, k), h - beta * _dot(g, h)
    top, right = k[lead, column], h[lead, column]
    k[lead, column] = 0.0
    t = -_dot(k, h) / _dot(k, k)
    s = (right + top * t) / size
    return np.where(swap, t, s), np.where(swap, s, t)


def _on_edges(rows: FloatArray, rest: FloatArray, corners: FloatArray, edges: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the edges' best points (3, 3, m) and the corners (3, m) where they are one, else -1."""
    x, y, z = edges
    # From the lesser of its ends, so that both triangles of an edge find the same bits.
    swap = (x < 0) | ((x == 0) & ((y < 0) | ((y == 0) & (z < 0))))
    begin = np.where(swap, corners[:, _AFTER], corners)
    edge = np.where(swap, -edges, edges)
    start = -_dot(begin, edge) / _dot(edge, edge)
    foot = begin + start * edge
    g, h = _apply(rows, edge), _apply(rows, foot) + rest[:, None]
    steep = _dot(g, g)
    step = np.divide(-_dot(g, h), steep, out=np.zeros_like(steep), where=steep > 0)
    low, high = start + step <= 0, start + step >= 1
    away = foot + step * edge
    at = np.where(low ^ swap, _SIDES, _AFTER[:, None])
    end = low | high
    away = np.where(end, np.where(low ^ swap, corners, corners[:, _AFTER]), away)
    return away, np.where(end, at, -1)


def _apply(rows: FloatArray, v: FloatArray) -> FloatArray:
    """Return (3, ..., m): `rows` (3, 3, m) times the vectors (3, ..., m)."""
    shape = (3,) + (1,) * (v.ndim - 2) + rows.shape[2:]
    return rows[:, 0].reshape(shape) * v[0] + rows[:, 1].reshape(shape) * v[1] + rows[:, 2].reshape(shape) * v[2]


def _dot(p: FloatArray, q: FloatArray) -> FloatArray:
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
