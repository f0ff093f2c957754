"""Search for taxels on a part without a layout: places spread evenly over the surface, first around taxels that answered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from skincal.geometry import FloatArray, IntArray, orthonormal_pair
from skincal.mesh.search import nearest_in_metric
from skincal.mesh.surface import Surface
from skincal.pokes import Pokes

SEARCH_PLACE_SPACING_M = 0.008
"""Between neighbouring places: a tip is felt within it, and taxels are hardly farther apart."""
MIN_PLACE_DISTANCE_OVER_SPACING = 0.8
"""Two places are at least this share of the spacing apart."""
SKIN_NEIGHBOUR_M = 2.2 * SEARCH_PLACE_SPACING_M
"""Places this near to an answered poke come first: where skin is, more skin is likely."""
MAX_UNPOKED_DISTANCE_M = 0.025
"""Elsewhere a place farther than this from each poke is tried: the smallest patches of skin are larger."""


class SurfaceSearch:
    """Places on a part's surface where taxels may be, and which of them are still to be poked.

    Parameters
    ----------
    places, normals : (n, 3) float, metres and unit, of an earlier search; `None` to spread them
    """

    def __init__(self, surface: Surface, places: FloatArray | None = None, normals: FloatArray | None = None) -> None:
        self._surface = surface
        if places is None or normals is None:
            places, triangles = spread_over(surface, SEARCH_PLACE_SPACING_M)
            normals = surface.normals[triangles]
        self.places, self.normals = places, normals
        self._pokes: dict[int, tuple[FloatArray, bool]] = {}
        """By number: position, (3,) metres, and whether a taxel answered."""
        self._counted = set[int]()
        self._poked, self._answered = (np.full(len(self.places), np.inf) for _ in range(2))
        """(n,) metres: distance of each place to the nearest poke that counts, and to the nearest that was answered."""
        self._skipped = np.zeros(len(self.places), dtype=bool)

    def unpoked(self) -> SurfaceSearch:
        """Copy the places, none of them poked or skipped."""
        return SurfaceSearch(self._surface, self.places, self.normals)

    def add_poke(self, poke: Pokes, *, answered: bool) -> None:
        """Record a single poke at the surface point nearest to its force axis, on the side that faces the push."""
        root = np.vstack([orthonormal_pair(poke.direction[None])[0], np.zeros(3)])
        found = nearest_in_metric(self._surface, root[None], (root @ poke.axis_point)[None], poke.direction[None])
        if found.triangles[0] >= 0:
            self._pokes[int(poke.number)] = found.points[0], answered

    def count_pokes(self, counts: Mapping[int, bool]) -> None:
        """Count pokes from now on, by their numbers, or no longer: those were undone."""
        known = {number: is_counted for number, is_counted in counts.items() if number in self._pokes}
        more = {number for number, is_counted in known.items() if is_counted} - self._counted
        less = {number for number, is_counted in known.items() if not is_counted} & self._counted
        self._counted = (self._counted | more) - less
        if less:
            self._poked[:] = self._answered[:] = np.inf
        self._approach([self._pokes[number] for number in (self._counted if less else more)])

    def _approach(self, pokes: Sequence[tuple[FloatArray, bool]]) -> None:
        """Lower the distances by more pokes."""
        every, answered = [point for point, _ in pokes], [point for point, has_answer in pokes if has_answer]
        spatial: Any = import_module("scipy.spatial")
        for distances, points in ((self._poked, every), (self._answered, answered)):
            if points:
                np.minimum(distances, spatial.cKDTree(np.array(points)).query(self.places)[0], out=distances)

    def skip(self, place: FloatArray) -> None:
        """Leave a place, (3,) metres, out of the search from now on."""
        self._skipped[int(np.sum((self.places - place) ** 2, axis=1).argmin())] = True

    def next_place(self, hand: FloatArray | None) -> int | None:
        """Choose the next place, given the last poke's position `hand` (3,), metres; `None` if all are covered."""
        poked, answered = self._poked, self._answered
        waiting = (poked > SEARCH_PLACE_SPACING_M) & ~self._skipped
        near = np.flatnonzero(waiting & (answered <= SKIN_NEIGHBOUR_M))
        if near.size:
            return self._nearest(near, self.places[near[0]] if hand is None else hand)
        far = np.flatnonzero(waiting & (poked > MAX_UNPOKED_DISTANCE_M))
        if not far.size:
            return None
        if not np.isfinite(poked[far]).all():
            return self._nearest(far, self.places.mean(axis=0))
        return int(far[int(poked[far].argmax())])

    def _nearest(self, rows: IntArray, place: FloatArray) -> int:
        return int(rows[int(np.sum((self.places[rows] - place) ** 2, axis=1).argmin())])


def spread_over(surface: Surface, spacing: float) -> tuple[FloatArray, IntArray]:
    """Spread places (n, 3) over a surface, `MIN_PLACE_DISTANCE_OVER_SPACING` times `spacing` apart, with their triangles."""
    corners = surface.corners
    longest = np.sqrt(np.sum((corners - np.roll(corners, 1, axis=1)) ** 2, axis=2)).max(axis=1)
    # Pieces of at most half the spacing, thinned out afterwards.
    steps = np.ceil(2.0 * longest / spacing).astype(np.int64).clip(min=1)
    places, triangles = list[FloatArray](), list[IntArray]()
    for count in np.unique(steps).tolist():
        rows, shares = np.flatnonzero(steps == count), _piece_centres(count)
        places.append((shares @ corners[rows]).reshape(-1, 3))
        triangles.append(rows.repeat(len(shares)))
    every, owners = np.concatenate(places), np.concatenate(triangles)
    kept = _thin_out(every, MIN_PLACE_DISTANCE_OVER_SPACING * spacing)
    return every[kept], owners[kept]


def _thin_out(places: FloatArray, apart: float) -> IntArray:
    """Select places (n, 3) in a fixed order each at least `apart` from those selected before."""
    # Imported late and in the background: a scene with a layout needs none of it.
    spatial: Any = import_module("scipy.spatial")
    tree = spatial.cKDTree(places)
    waiting = np.ones(len(places), dtype=bool)
    kept = list[int]()
    for row in np.lexsort(places.T).tolist():
        if waiting[row]:
            kept.append(row)
            waiting[tree.query_ball_point(places[row], apart)] = False
    return np.array(sorted(kept), dtype=np.int64)


def _piece_centres(count: int) -> FloatArray:
    """Compute (n, 3) the barycentric centres of the `count`^2 equal triangles into which a triangle is cut."""
    upright = [(i, j) for i in range(count) for j in range(count - i)]
    turned = [(i, j) for i in range(count - 1) for j in range(count - 1 - i)]
    pairs = np.array([(i + 1 / 3, j + 1 / 3) for i, j in upright] + [(i + 2 / 3, j + 2 / 3) for i, j in turned]) / count
    return np.column_stack([1.0 - pairs.sum(axis=1), pairs])
