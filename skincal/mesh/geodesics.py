"""Straight ways over a mesh, many at once: each triangle in a plane of its own, and how to turn into its neighbours' planes.

On a mesh a straight geodesic is straight within each triangle, and at an edge it goes on as it would if both triangles were
unfolded into one plane (Polthier and Schmies, "Straightest geodesics on polyhedral surfaces", 1998). So a walk is worked out
in the two coordinates of the triangle that it is in; at an edge they are turned into those of the next one. Past the rim it
goes on straight in the last triangle's plane. The crossings are worked out one by one in plain numbers: for the dozen pads of a
module that is ten times quicker than by arrays, and a walk has the same bits whichever others are walked with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.surface import Surface, neighbours, once_for_each

_PULL = 1e-9
"""A walk through less than this of a triangle, over the way to its middle, passes a vertex: it is pulled to the middle by that
share, so that it never runs through one. Elsewhere nothing is pulled, and no digit lost."""
_CROSSINGS_MAX = 20_000
"""A walk that crosses more edges goes round in circles at a vertex; it is left where it is."""


_Walk: TypeAlias = tuple[float, ...]
"""Place (2) and direction (2) in a triangle's plane, and how far it still goes, metres."""
_Triangle: TypeAlias = tuple[tuple[float, float], list[tuple[float, ...]]]
"""The middle, and of each side its row of `_table` and the triangle behind it, below zero at the rim."""


@dataclass(frozen=True, slots=True, eq=False)
class Footing:
    """n places on a surface, each with a direction along it."""

    triangles: IntArray
    """(n,)."""
    points: FloatArray
    """(n, 3) float, metres, in the planes of the triangles."""
    x: FloatArray
    """(n, 3) float, unit, in the planes of the triangles."""

    def take(self, rows: IntArray | slice) -> Footing:
        """Return some of them."""
        return Footing(self.triangles[rows], self.points[rows], self.x[rows])


class Geodesics:
    """A surface whose triangles have an area, ready to be walked on."""

    def __init__(self, surface: Surface) -> None:
        # Not the surface itself: what is kept for each must not hold it.
        self._corners, self._normals = surface.corners, surface.normals
        self._over = neighbours(surface.triangles)
        self._known: dict[int, _Triangle] = {}

    @cached_property
    def _frames(self) -> tuple[FloatArray, FloatArray]:
        """Two unit directions in the plane of each triangle, (nt, 3) each, right-handed about its normal."""
        corners = self._corners
        along = corners[:, 1] - corners[:, 0]
        e1: FloatArray = along / _length(along)[:, None]
        return e1, np.asarray(np.cross(self._normals, e1), dtype=np.float64)

    @cached_property
    def _table(self) -> FloatArray:
        """(nt, 3, 7): of each side its outward normal in the triangle's plane, its distance from the first corner, `_turns`."""
        flat = self._flat(self._corners)
        along = flat[:, [1, 2, 0]] - flat
        along = along / np.sqrt(along[..., 0] ** 2 + along[..., 1] ** 2)[..., None]
        away = flat[..., 0] * along[..., 1] - flat[..., 1] * along[..., 0]
        return np.concatenate([np.stack([along[..., 1], -along[..., 0], away], axis=2), self._turns], axis=2)

    @property
    def _turns(self) -> FloatArray:
        """(nt, 3, 4): cosine, sine and shift that carry a triangle's plane into that of the neighbour at each side."""
        e1, e2 = self._frames
        corners = self._corners
        next_at = np.maximum(self._over, 0) // 3
        there_1, there_2 = e1[next_at], e2[next_at]
        edge = corners[:, [1, 2, 0]] - corners
        edge = edge / _length(edge)[..., None]
        # The edge's direction in both planes: the neighbour's is unfolded about it.
        here = _dot(edge, e1[:, None]), _dot(edge, e2[:, None])
        there = _dot(edge, there_1), _dot(edge, there_2)
        cosine, sine = there[0] * here[0] + there[1] * here[1], there[1] * here[0] - there[0] * here[1]
        flat, own = self._flat(corners), corners - corners[next_at, 0]
        x = _dot(own, there_1) - (cosine * flat[..., 0] - sine * flat[..., 1])
        y = _dot(own, there_2) - (sine * flat[..., 0] + cosine * flat[..., 1])
        return np.stack([cosine, sine, x, y], axis=2)

    def _flat(self, points: FloatArray) -> FloatArray:
        """Return (nt, k, 2) of (nt, k, 3): points of each triangle in its plane, from its first corner."""
        e1, e2 = self._frames
        own = points - self._corners[:, :1]
        return np.stack([_dot(own, e1[:, None]), _dot(own, e2[:, None])], axis=2)

    def walk(self, start: Footing, ways: FloatArray) -> Footing:
        """Return where straight walks from each of n places end; x there is the start's x, carried along.

        `ways` are (n, 2) float, metres: how far along the start's x, and along normal x x.
        """
        at = start.triangles.copy()
        e1, e2 = (axes[at] for axes in self._frames)
        own = start.points - self._corners[at, 0]
        c, s = _dot(start.x, e1), _dot(start.x, e2)
        left = np.sqrt(ways[:, 0] ** 2 + ways[:, 1] ** 2)
        far = left > 0
        share = np.divide(ways, left[:, None], out=np.tile([1.0, 0.0], (len(ways), 1)), where=far[:, None])
        walks = np.stack(
            [_dot(own, e1), _dot(own, e2), c * share[:, 0] - s * share[:, 1], s * share[:, 0] + c * share[:, 1], left]
        )
        for i in np.flatnonzero(far).tolist():
            ended, at[i] = self._gone(tuple(walks[:, i].tolist()), int(at[i]))
            walks[:4, i] = ended
        return self._raised(walks, at, share)

    def _gone(self, walk: _Walk, at: int) -> tuple[tuple[float, float, float, float], int]:
        """Return where a walk ends in its last triangle, and which way it looks; and that triangle."""
        x, y, ahead_x, ahead_y, left = walk
        pulled = -1
        for _ in range(_CROSSINGS_MAX):
            (middle_x, middle_y), sides = self._known.get(at) or self._learnt(at)
            way, side = inf, sides[0]
            for tried in sides:
                rate = tried[0] * ahead_x + tried[1] * ahead_y
                if rate > 0.0:
                    gap = tried[2] - tried[0] * x - tried[1] * y
                    if gap < way * rate:
                        way, side = gap / rate, tried
            if way < left and pulled != at and abs(way) < _PULL * (abs(middle_x - x) + abs(middle_y - y)):
                x, y, pulled = x + _PULL * (middle_x - x), y + _PULL * (middle_y - y), at
                continue
            # Below zero from past the rim, and by rounding.
            way = max(way, 0.0)
            over = side[7]
            if way >= left or over < 0:
                return (x + left * ahead_x, y + left * ahead_y, ahead_x, ahead_y), at
            x, y = x + way * ahead_x, y + way * ahead_y
            _, _, _, cosine, sine, shift_x, shift_y, _ = side
            x, y = cosine * x - sine * y + shift_x, sine * x + cosine * y + shift_y
            ahead_x, ahead_y = cosine * ahead_x - sine * ahead_y, sine * ahead_x + cosine * ahead_y
            left -= way
            at = int(over)
        return (x, y, ahead_x, ahead_y), at

    def _learnt(self, at: int) -> _Triangle:
        """Return a triangle's numbers as plain ones, and keep them: few of them are ever walked over."""
        over = (self._over[at] // 3).tolist()
        sides = [(*side, float(other)) for side, other in zip(self._table[at].tolist(), over, strict=True)]
        x, y = self._middles[at].tolist()
        self._known[at] = ((x, y), sides)
        return self._known[at]

    @cached_property
    def _middles(self) -> FloatArray:
        """(nt, 2) the middle of each triangle in its plane."""
        flat = self._flat(self._corners)
        return (flat[:, 0] + flat[:, 1] + flat[:, 2]) / 3.0

    def _raised(self, walks: FloatArray, at: IntArray, share: FloatArray) -> Footing:
        """Return the ends in space."""
        e1, e2 = (axes[at] for axes in self._frames)
        x, y, ahead_x, ahead_y, _ = walks
        points = self._corners[at, 0] + x[:, None] * e1 + y[:, None] * e2
        # The start's x is the way turned back by its angle.
        own_x = share[:, 0] * ahead_x + share[:, 1] * ahead_y
        own_y = share[:, 0] * ahead_y - share[:, 1] * ahead_x
        return Footing(at, points, own_x[:, None] * e1 + own_y[:, None] * e2)


@once_for_each
def geodesics_of(surface: Surface) -> Geodesics:
    """Return the surface ready to be walked on."""
    return Geodesics(surface)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    # Written out: no product of matrices, whose rounding may depend on how many are taken at once.
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def _length(v: FloatArray) -> FloatArray:
    return np.sqrt(_dot(v, v))
