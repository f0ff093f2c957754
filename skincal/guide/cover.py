"""Where to poke while nobody knows where the taxels are: evenly over the surface, around those that showed themselves first."""

from __future__ import annotations

from collections.abc import Collection
from importlib import import_module
from typing import Any

import numpy as np

from skincal.estimate.evidence import across
from skincal.guide.pokes import Axis
from skincal.readings import FloatArray, IntArray
from skincal.surface.mesh import Surface
from skincal.surface.nearest import nearest_to_rows

SPACING = 0.008
"""m, between neighbouring places: a tip is felt within it, and taxels are hardly farther apart."""
APART = 0.8
"""Share of the spacing that two places are apart at least."""
AROUND = 2.2 * SPACING
"""m. Places this near to one that answered come first: skin is where skin is."""
ASTRAY = 0.025
"""m. Elsewhere a place farther than this from every poke is tried: the smallest patches of skin are larger."""


class Cover:
    """Places spread evenly over a surface, and which of them are still to be poked.

    Parameters
    ----------
    surface : of the part
    """

    def __init__(self, surface: Surface) -> None:
        self._surface = surface
        self.places, triangles = spread(surface, SPACING)
        self.normals: FloatArray = surface.normals[triangles]
        self._poked: FloatArray = np.full(len(self.places), np.inf)
        self._answered: FloatArray = np.full(len(self.places), np.inf)
        """(n,) float, metres, from each place to the nearest poke, and to the nearest that was answered."""
        self._pokes: dict[int, tuple[FloatArray, bool]] = {}
        """Where each poke was, (3,) metres, and whether a taxel answered."""
        self._counted = set[int]()
        self._left_out = np.zeros(len(self.places), dtype=bool)

    def poked(self, number: int, axis: Axis, *, answered: bool) -> None:
        """Take a poke: it touched where its axis passes the surface nearest, on the side that faces it."""
        root = np.vstack([across(axis.direction[None])[0], np.zeros(3)])
        found = nearest_to_rows(self._surface, root[None], (root @ axis.point)[None], axis.direction[None])
        if found.triangles[0] >= 0:
            self._pokes[number] = found.points[0], answered

    def keep(self, numbers: Collection[int]) -> None:
        """Let those of the pokes count that are among `numbers`: others were taken back."""
        there = self._pokes.keys() & set(numbers)
        if not self._counted <= there:
            self._counted = set[int]()
            self._poked[:] = self._answered[:] = np.inf
        for number in sorted(there - self._counted):
            self._mark(*self._pokes[number])
        self._counted = set(there)

    def _mark(self, place: FloatArray, answered: bool) -> None:
        apart = np.sqrt(np.sum((self.places - place) ** 2, axis=1))
        self._poked = np.minimum(self._poked, apart)
        if answered:
            self._answered = np.minimum(self._answered, apart)

    def leave_out(self, index: int) -> None:
        """Ask for this place no more: the operator skipped it."""
        self._left_out[index] = True

    def next(self, hand: FloatArray | None) -> int | None:
        """Return which place to poke; None where all are covered.

        Parameters
        ----------
        hand : (3,) float, metres, where the last poke was
        """
        waiting = (self._poked > SPACING) & ~self._left_out
        near = np.flatnonzero(waiting & (self._answered <= AROUND))
        if near.size:
            here = self.places[near[0]] if hand is None else hand
            return int(near[int(np.sum((self.places[near] - here) ** 2, axis=1).argmin())])
        far = np.flatnonzero(waiting & (self._poked > ASTRAY))
        if not far.size:
            return None
        if not np.isfinite(self._poked[far]).all():
            # Nothing was poked yet: begin in the middle of the part.
            middle = self.places.mean(axis=0)
            return int(far[int(np.sum((self.places[far] - middle) ** 2, axis=1).argmin())])
        return int(far[int(self._poked[far].argmax())])


def spread(surface: Surface, spacing: float) -> tuple[FloatArray, IntArray]:
    """Return places spread over a surface, none nearer than `APART` of `spacing` to another, and their triangles.

    Returns
    -------
    places : (n, 3) float, metres
    triangles : (n,) int
    """
    corners = surface.corners
    longest = np.sqrt(np.sum((corners - np.roll(corners, 1, axis=1)) ** 2, axis=2)).max(axis=1)
    steps = np.ceil(2.0 * longest / spacing).astype(np.int64).clip(min=1)
    places, triangles = list[FloatArray](), list[IntArray]()
    for count in np.unique(steps).tolist():
        rows = np.flatnonzero(steps == count)
        shares = _lattice(count)
        places.append((shares @ corners[rows]).reshape(-1, 3))
        triangles.append(rows.repeat(len(shares)))
    every, owners = np.concatenate(places), np.concatenate(triangles)
    kept = _thinned(every, APART * spacing)
    return every[kept], owners[kept]


def _thinned(places: FloatArray, apart: float) -> IntArray:
    """Return which of `places` (n, 3) to keep, one after another, so that none is nearer than `apart` to one kept before."""
    # Only now, and beside the window: a scene with a layout needs none of it.
    spatial: Any = import_module("scipy.spatial")
    tree = spatial.cKDTree(places)
    waiting = np.ones(len(places), dtype=bool)
    kept = list[int]()
    for row in np.lexsort(places.T).tolist():
        if waiting[row]:
            kept.append(row)
            waiting[tree.query_ball_point(places[row], apart)] = False
    return np.array(sorted(kept), dtype=np.int64)


def _lattice(count: int) -> FloatArray:
    """Return (n, 3) barycentric shares of the middles of `count`^2 like triangles that one is cut into."""
    up = [(i, j) for i in range(count) for j in range(count - i)]
    down = [(i, j) for i in range(count - 1) for j in range(count - 1 - i)]
    pairs = np.array([(i + 1 / 3, j + 1 / 3) for i, j in up] + [(i + 2 / 3, j + 2 / 3) for i, j in down]) / count
    return np.column_stack([1.0 - pairs.sum(axis=1), pairs])
