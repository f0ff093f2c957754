"""Ways around a part: a robot's tip travels outside its convex hull, enlarged by a clearance.

A way around a convex body lies in a plane through start and goal. In each of several planes the way follows the corners of the
hull's section from start to goal, and leaves out those between which the straight line stays outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np

from skincal.geometry import FloatArray, IntArray, length_of, orthonormal_pair
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
MIN_CHORD_M = 1e-4
"""m. A straight way that is inside the enlarged hull for less is free."""
SECTION_MIN_ROOM_M = 1e-9
"""m. The middle of a section counts as at least so far inside each face: the dual of a line through it would be infinite."""


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
        inside = float(self._chords(start, goal[None])[0])
        if np.isnan(inside):
            return [[]]
        middle, along = start + inside * (goal - start), (goal - start) / length_of(goal - start)
        found: list[tuple[float, list[ViaPoint]]] = []
        first, second = orthonormal_pair(along[None])[0]
        for turn in 2.0 * np.pi * np.arange(DETOUR_HALF_PLANES_TRIED) / DETOUR_HALF_PLANES_TRIED:
            aside = np.cos(turn) * first + np.sin(turn) * second
            faces = self._faces_around(middle, along, aside)
            way = self._cut_corners(start, self._outline(middle, along, aside), goal, faces)
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

    def _chords(self, start: FloatArray, goals: FloatArray, faces: IntArray | None = None) -> FloatArray:
        """Find the middle of the part inside the enlarged hull of each straight way from `start` (3,) to `goals` (n, 3).

        `faces` are the ones that count; `None` for all of them.

        Returns
        -------
        (n,) float: as a share of the way; NaN if it stays outside
        """
        if not len(self._offsets):
            return np.full(len(goals), np.nan)
        normals, offsets = (self._normals, self._offsets) if faces is None else (self._normals[faces], self._offsets[faces])
        ways = goals - start
        room, slopes = offsets - OUTSIDE_HULL_TOLERANCE_M - normals @ start, ways @ normals.T
        parallel = np.abs(slopes) < 1e-12
        shares = room / np.where(parallel, 1.0, slopes)
        enters = np.where(~parallel & (slopes < 0), shares, 0.0).max(axis=1, initial=0.0)
        leaves = np.where(~parallel & (slopes > 0), shares, 1.0).min(axis=1, initial=1.0)
        inside = (leaves - enters) * np.linalg.norm(ways, axis=1) > MIN_CHORD_M
        return np.where(inside & ~(parallel & (room < 0.0)).any(axis=1), (enters + leaves) / 2.0, np.nan)

    def _dual_section(self, middle: FloatArray, along: FloatArray, aside: FloatArray, inset: float) -> tuple[FloatArray, Any]:
        """Cut the enlarged hull, smaller by `inset` metres, with a plane.

        With the origin inside, the lines a x = 1 around a convex polygon are the corners of its dual polygon.

        Returns
        -------
        (faces, 2) float, a of each face's line; the convex hull of these
        """
        spatial: Any = import_module("scipy.spatial")
        room = np.maximum(self._offsets - inset - self._normals @ middle, SECTION_MIN_ROOM_M)
        duals = np.stack([self._normals @ along, self._normals @ aside], axis=1) / room[:, None]
        return duals, spatial.ConvexHull(duals)

    def _faces_around(self, middle: FloatArray, along: FloatArray, aside: FloatArray) -> IntArray:
        """List the faces that bound the section inside which a way in this plane is not free; the others lie outside it."""
        return np.asarray(self._dual_section(middle, along, aside, OUTSIDE_HULL_TOLERANCE_M)[1].vertices, dtype=np.int64)

    def _outline(self, middle: FloatArray, along: FloatArray, aside: FloatArray) -> list[ViaPoint]:
        """List the corners where a half plane cuts the enlarged hull, ordered along the direction `along`."""
        duals, hull = self._dual_section(middle, along, aside, inset=0.0)
        corners = np.linalg.solve(duals[hull.simplices], np.ones((len(hull.simplices), 2, 1)))[:, :, 0]
        above = corners[corners[:, 1] > 0.0]
        found = list[ViaPoint]()
        for x, y in above[np.argsort(-np.arctan2(above[:, 1], above[:, 0]))]:
            out = x * along + y * aside
            found.append(ViaPoint(middle + out, -out / length_of(out)))
        return found

    def _cut_corners(self, start: FloatArray, outline: Sequence[ViaPoint], goal: FloatArray, faces: IntArray) -> list[ViaPoint]:
        """Leave out points between which the straight line stays outside."""
        kept, at, place = list[ViaPoint](), 0, start
        places = np.stack([*(corner.position for corner in outline), goal])
        while at < len(outline):
            free = np.flatnonzero(np.isnan(self._chords(place, places[at:], faces))).tolist()
            if free and at + free[-1] == len(outline):
                break
            at += free[-1] if free else 0
            kept.append(outline[at])
            place, at = outline[at].position, at + 1
        return kept
