"""The point of a triangle nearest to the origin, in closed form, for many triangles at once.

It holds for needles and for triangles without area, which a metric that does not see one direction makes of good ones.
The interior point comes from an orthogonalised pair of edges, longest first (error: rounding times length over height,
where the usual determinant formula squares the ratio); each edge's point from a clamped projection. The best of the
four is taken by its true distance, so a badly determined interior point can never win wrongly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skincal.readings import FloatArray, IntArray

_NEXT = np.array([1, 2, 0])


def closest_in_triangles(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find for each triangle of `corners` (n, 3, 3) its point nearest to the origin.

    Returns
    -------
    shares : (n, 3) float, barycentric: the point is `shares @ corners`
    squared : (n,) float, its squared distance
    """
    edges = corners[:, _NEXT] - corners
    lengths = _dot(edges, edges)
    starts = -_ratio(_dot(corners, edges), lengths)
    along = np.clip(starts, 0.0, 1.0)
    on_edges = corners + along[:, :, None] * edges
    squared = np.empty((len(corners), 4))
    squared[:, :3] = _dot(on_edges, on_edges)
    longest = lengths.argmax(axis=1)
    interior, squared[:, 3] = _interior(corners, edges, lengths, starts, longest)
    best = squared.argmin(axis=1)
    row = np.arange(len(corners))
    shares = np.zeros_like(starts)
    side = np.minimum(best, 2)
    shares[row, _NEXT[side]] = along[row, side]
    shares[row, side] = 1.0 - along[row, side]
    within = best == 3
    shares[within] = interior[within]
    return shares, squared[row, best]


def _dot(p: FloatArray, q: FloatArray) -> FloatArray:
    return np.einsum("...i,...i->...", p, q)


def _ratio(top: FloatArray, bottom: FloatArray) -> FloatArray:
    return np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 0)


def _interior(
    corners: FloatArray, edges: FloatArray, lengths: FloatArray, starts: FloatArray, longest: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the shares (n, 3) of the plane's nearest point and its squared distance; infinite where it is outside."""
    row = np.arange(len(corners))
    a, along, across = corners[row, longest], edges[row, longest], -edges[row, _NEXT[_NEXT[longest]]]
    length, start = lengths[row, longest], starts[row, longest]
    tilt = _ratio(_dot(across, along), length)
    across = across - tilt[:, None] * along
    # Once more, since the first pass leaves rounding of the long edge's size.
    again = _ratio(_dot(across, along), length)
    across, tilt = across - again[:, None] * along, tilt + again
    height = _dot(across, across)
    aside = a + start[:, None] * along
    v = -_ratio(_dot(aside, across), height)
    u = start - v * tilt
    point = aside + v[:, None] * across
    inside: NDArray[np.bool_] = (u >= 0) & (v >= 0) & (u + v <= 1) & (height > 0)
    shares = np.empty_like(starts)
    shares[row, longest], shares[row, _NEXT[longest]], shares[row, _NEXT[_NEXT[longest]]] = 1.0 - u - v, u, v
    return shares, np.where(inside, _dot(point, point), np.inf)
