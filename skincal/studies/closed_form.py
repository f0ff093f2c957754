"""The point of a triangle nearest to the origin, in closed form, for many triangles at once.

It holds for needles and for triangles without area, which a metric that does not see one direction makes of good ones.
The interior point comes from an orthogonalised pair of edges, longest first (error: rounding times length over height,
where the usual determinant formula squares the ratio); each edge's point from a clamped projection. The best of the
four is taken by its true distance, so a badly determined interior point can never win wrongly.

Every product is written out, component by component: a triangle's answer has the same bits whatever is solved beside
it, and arrays of one component each are what numpy goes through fastest.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from skincal.geometry.arrays import FloatArray, IntArray

_AT_ONCE = 1 << 11
"""Triangles solved at once: their intermediate numbers, 1 MB, stay in the cache of a core."""
_NOUGHT = 1e-300
"""A squared length below this is nought, as is whatever is divided by it."""


def closest_in_triangles(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find for each triangle of `corners` (n, 3, 3) its point nearest to the origin.

    Returns
    -------
    shares : (n, 3) float, barycentric: the point is `shares @ corners`
    squared : (n,) float, its squared distance
    """
    found = closest_in_columns(np.ascontiguousarray(corners.transpose(2, 1, 0)))
    return np.ascontiguousarray(found.shares().T), found.squared


@dataclass(frozen=True, slots=True, eq=False)
class Closest:
    """The nearest points of n triangles, each as the better of a point on a side and one inside."""

    squared: FloatArray
    """(n,) float: squared distance from the origin."""
    within: FloatArray
    """(n,) float: that of the plane's nearest point; infinite where it is outside the triangle."""
    side: IntArray
    """(n,) the side with the nearest point of the outline; side s runs from corner s to corner (s + 1) mod 3."""
    along: FloatArray
    """(n,) where on that side, 0 to 1."""
    longest: IntArray
    """(n,) the longest side, from which u and v are taken."""
    u: FloatArray
    v: FloatArray

    def shares(self) -> FloatArray:
        """Return (3, n) the barycentric coordinates of the points."""
        inside = self.within <= self.squared
        first = np.where(inside, self.longest, self.side)
        u, v = np.where(inside, self.u, self.along), np.where(inside, self.v, 0.0)
        shares = np.empty((3, len(u)))
        column = np.arange(len(u))
        shares[first, column] = 1.0 - u - v
        shares[_AFTER[first], column], shares[_BEFORE[first], column] = u, v
        return shares


_AFTER = np.array([1, 2, 0])
_BEFORE = np.array([2, 0, 1])


def closest_in_columns(corners: FloatArray) -> Closest:
    """Do the same for `corners` (3, 3, n): component, corner, triangle."""
    count = corners.shape[2]
    if count <= _AT_ONCE:
        return _closest(corners)
    parts = [_closest(np.ascontiguousarray(corners[:, :, at : at + _AT_ONCE])) for at in range(0, count, _AT_ONCE)]
    return Closest(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Closest)))


def _closest(corners: FloatArray) -> Closest:
    count = int(corners.shape[2])
    column = np.arange(count)
    edges = np.empty_like(corners)
    np.subtract(corners[:, 1:], corners[:, :2], out=edges[:, :2])
    np.subtract(corners[:, 0], corners[:, 2], out=edges[:, 2])
    lengths = _dot(edges, edges)
    starts = -_dot(corners, edges)
    starts /= lengths.clip(_NOUGHT)
    along = starts.clip(0.0, 1.0)
    on_edges = edges * along
    on_edges += corners
    squared = _dot(on_edges, on_edges)
    longest = _second_or_third(lengths[1] > lengths[0], lengths[2] > np.maximum(lengths[0], lengths[1]))
    best = np.minimum(squared[0], squared[1])
    side = _second_or_third(squared[1] < squared[0], squared[2] < best)
    np.minimum(best, squared[2], out=best)
    at = longest * count + column
    flat = corners.reshape(3, -1), edges.reshape(3, -1)
    u, v, within = _interior(
        flat[0].take(at, axis=1, mode="clip"),
        flat[1].take(at, axis=1, mode="clip"),
        -flat[1].take(_BEFORE[longest] * count + column, axis=1, mode="clip"),
        lengths.ravel().take(at, mode="clip"),
        starts.ravel().take(at, mode="clip"),
    )
    along = along.ravel().take(side * count + column, mode="clip")
    return Closest(np.minimum(best, within), within, side, along, longest, u, v)


def _second_or_third(second: NDArray[np.bool_], third: NDArray[np.bool_]) -> IntArray:
    """Return 2 where `third`, else 1 where `second`, else 0."""
    return np.maximum(second.view(np.int8), third.view(np.int8) * np.int8(2)).astype(np.intp)


def _dot(p: FloatArray, q: FloatArray) -> FloatArray:
    sums = p[0] * q[0]
    sums += p[1] * q[1]
    sums += p[2] * q[2]
    return sums


def _interior(
    a: FloatArray, along: FloatArray, across: FloatArray, length: FloatArray, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the shares u, v (n,) of the plane's nearest point and its squared distance; infinite where it is outside.

    Parameters
    ----------
    a : (3, n) float: the corner from which the longest side leaves
    along, across : (3, n) float: the sides that leave it, the longest first
    length, start : (n,) float: the longest side's squared length, and where on it its line is nearest
    """
    length = length.clip(_NOUGHT)
    tilt = _dot(across, along)
    tilt /= length
    across -= tilt * along
    # Once more, since the first pass leaves rounding of the long edge's size.
    again = _dot(across, along)
    again /= length
    across -= again * along
    tilt += again
    height = _dot(across, across)
    aside = start * along
    aside += a
    v = -_dot(aside, across)
    v /= height.clip(_NOUGHT)
    u = start - v * tilt
    across *= v
    across += aside
    within = _dot(across, across)
    outside = (u < 0) | (v < 0) | (u + v > 1) | (height <= 0)
    within[outside] = np.inf
    return u, v, within
