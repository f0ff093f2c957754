"""Ways around a part: a robot's tip travels outside its convex hull, enlarged by a clearance.

A way around a convex body lies in a plane through start and goal. In each of several planes the way follows the corners of the
hull's section from start to goal, and leaves out those between which the straight line stays outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np

from skincal.geometry import FloatArray, length_of, orthonormal_pair
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface

DETOUR_HALF_PLANES_TRIED = 8
"""Half planes through start and goal that are tried."""
PATH_SAMPLE_SPACING_M = 0.004
"""m, between the points of a straight way that are compared with the mesh."""
MIN_PART_DISTANCE_OVER_TARGET_DISTANCE = 0.3
"""A point of an approach is at least this share of its distance from the target away from the part."""
ALWAYS_FREE_PART_DISTANCE_M = 0.006
"""m. A point at least so far from the part is free in any case."""
OUTSIDE_HULL_TOLERANCE_M = 0.003
"""m. A tip so far inside the enlarged hull counts as outside: an arm does not arrive to the last micrometre."""
HULL_ENLARGED_BY_M = 1e-4
"""m. The hull is larger on every side by this."""


@dataclass(frozen=True, slots=True, eq=False)
class ViaPoint:
    """Point of a way and the tool's direction there."""

    position: FloatArray
    """(3,) float, metres."""
    direction: FloatArray
    """(3,) float, unit, towards the part."""


class Clearance:
    """The part's convex hull, enlarged.

    Parameters
    ----------
    surface : mesh of the part; `None` if there is none: then no way is checked
    margin : m, distance that a travelling tip keeps from the hull
    """

    def __init__(self, surface: Surface | None, margin: float) -> None:
        self._surface, self._margin = surface, margin
        self._normals: FloatArray = np.zeros((0, 3))
        self._offsets: FloatArray = np.zeros(0)
        if surface is not None:
            spatial: Any = import_module("scipy.spatial")
            # Thickened: a flat part has no hull, and a sharp edge gets a slanted face, without which its corner lies far away.
            thick = (surface.vertices + HULL_ENLARGED_BY_M * np.concatenate([np.eye(3), -np.eye(3)])[:, None]).reshape(-1, 3)
            hull: Any = spatial.ConvexHull(thick)
            equations: FloatArray = np.asarray(hull.equations, dtype=np.float64).round(9)
            faces = np.unique(equations, axis=0)
            self._normals, self._offsets = faces[:, :3], margin - faces[:, 3]

    def exit_point(self, place: FloatArray, push: FloatArray) -> FloatArray:
        """Find where the line from `place` (3,) against `push` (3,) leaves the enlarged hull.

        Without a mesh it is the margin away.
        """
        return place - (self._distance_out(place, -push) if len(self._offsets) else self._margin) * push

    def is_outside(self, place: FloatArray) -> bool:
        """Whether a point, (3,) metres, is outside the enlarged hull. Without a mesh every point is."""
        return not len(self._offsets) or bool((self._normals @ place > self._offsets - OUTSIDE_HULL_TOLERANCE_M).any())

    def ways(self, start: FloatArray, goal: FloatArray) -> list[list[ViaPoint]]:
        """List ways between two points outside, the shortest first; a straight one has no point between them."""
        inside = self._chord(start, goal)
        if inside is None:
            return [[]]
        middle, along = start + inside * (goal - start), (goal - start) / length_of(goal - start)
        found: list[tuple[float, list[ViaPoint]]] = []
        first, second = orthonormal_pair(along[None])[0]
        for turn in 2.0 * np.pi * np.arange(DETOUR_HALF_PLANES_TRIED) / DETOUR_HALF_PLANES_TRIED:
            aside = np.cos(turn) * first + np.sin(turn) * second
            way = self._cut_corners(start, self._outline(middle, along, aside), goal)
            corners = [start, *(each.position for each in way), goal]
            found.append((sum(length_of(b - a) for a, b in pairwise(corners)), way))
        return [way for _, way in sorted(found, key=lambda item: item[0])]

    def is_approach_free(self, place: FloatArray, start: FloatArray) -> bool:
        """Whether the straight way from `start` (3,) to `place` (3,) touches the part nowhere but at its end."""
        way = start - place
        away = np.arange(PATH_SAMPLE_SPACING_M, length_of(way), PATH_SAMPLE_SPACING_M)
        points = place + away[:, None] * way / length_of(way)
        return bool(
            (
                self._distances(points)
                >= np.minimum(MIN_PART_DISTANCE_OVER_TARGET_DISTANCE * away, ALWAYS_FREE_PART_DISTANCE_M)
            ).all()
        )

    def is_straight_way_free(self, start: FloatArray, goal: FloatArray, least: float) -> bool:
        """Whether the straight way between two points (3,) stays at least `least`, metres, away from the part."""
        count = 2 + int(length_of(goal - start) / PATH_SAMPLE_SPACING_M)
        points = start + np.linspace(0.0, 1.0, count)[:, None] * (goal - start)
        return bool((self._distances(points) >= least).all())

    def _distances(self, points: FloatArray) -> FloatArray:
        """Compute (n,) the distances of points (n, 3) from the mesh, metres; infinite without one."""
        if self._surface is None or not len(points):
            return np.full(len(points), np.inf)
        return np.asarray(np.linalg.norm(points - nearest_points(self._surface, points)[0], axis=1), dtype=np.float64)

    def _distance_out(self, place: FloatArray, out: FloatArray) -> float:
        """Compute the distance from a point inside to the enlarged hull along a unit vector, metres; 0 from outside."""
        slopes = self._normals @ out
        leaving = slopes > 1e-9
        if not leaving.any():
            return 0.0
        return max(0.0, float(((self._offsets - self._normals @ place)[leaving] / slopes[leaving]).min()))

    def _chord(self, start: FloatArray, goal: FloatArray) -> float | None:
        """Find the middle of the straight way's part inside the enlarged hull, as a share; `None` if it stays outside."""
        if not len(self._offsets):
            return None
        from_start, slopes = self._offsets - OUTSIDE_HULL_TOLERANCE_M - self._normals @ start, self._normals @ (goal - start)
        parallel = np.abs(slopes) < 1e-12
        if (parallel & (from_start < 0.0)).any():
            return None
        shares = from_start[~parallel] / slopes[~parallel]
        enters = max(0.0, float(np.max(shares[slopes[~parallel] < 0], initial=0.0)))
        leaves = min(1.0, float(np.min(shares[slopes[~parallel] > 0], initial=1.0)))
        return (enters + leaves) / 2.0 if (leaves - enters) * length_of(goal - start) > 1e-4 else None

    def _outline(self, middle: FloatArray, along: FloatArray, aside: FloatArray) -> list[ViaPoint]:
        """List the corners where a half plane cuts the enlarged hull, ordered along the direction `along`.

        With the origin inside, the lines a x = 1 around a convex polygon are the corners of its dual polygon.
        """
        spatial: Any = import_module("scipy.spatial")
        room = self._offsets - self._normals @ middle
        duals = np.stack([self._normals @ along, self._normals @ aside], axis=1) / room[:, None]
        hull = spatial.ConvexHull(duals)
        corners = np.linalg.solve(duals[hull.simplices], np.ones((len(hull.simplices), 2, 1)))[:, :, 0]
        above = corners[corners[:, 1] > 0.0]
        found = list[ViaPoint]()
        for x, y in above[np.argsort(-np.arctan2(above[:, 1], above[:, 0]))]:
            out = x * along + y * aside
            found.append(ViaPoint(middle + out, -out / length_of(out)))
        return found

    def _cut_corners(self, start: FloatArray, outline: list[ViaPoint], goal: FloatArray) -> list[ViaPoint]:
        """Leave out points between which the straight line stays outside."""
        kept, at, place = list[ViaPoint](), 0, start
        while self._chord(place, goal) is not None and at < len(outline):
            free = [n for n in range(at, len(outline)) if self._chord(place, outline[n].position) is None]
            at = free[-1] if free else at
            kept.append(outline[at])
            place, at = outline[at].position, at + 1
        return kept
