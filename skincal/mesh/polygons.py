"""Triangles of polygons with any number of corners.

A fan about the first corner is right if none of its triangles is turned against the polygon. Other polygons lose one ear after
another, in the plane with Newell's normal (the sum of the fan's area vectors). An ear is a corner that turns as the polygon
does and whose triangle holds no corner that turns the other way.

Meisters, "Polygons have ears", 1975: each polygon that does not cross itself has two.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.findings import FLAT_POLYGON_MAX_OFFSET, MeshFinding

MAX_LOST_AREA_FRACTION = 1e-6
"""Of a polygon's area, turned the wrong way in its triangles: above the rounding of a 32-bit file."""
MAX_EAR_TESTS = 300_000
"""Corners tried as ears in one file, some seconds. A face of 1,000 corners takes about 3,000."""
MAX_PLACED_CORNERS = 20_000_000
"""Corners and vertices of a scene: four million triangles, as many as the largest file may have."""
LAST_ROW_TOLERANCE = 1e-6
"""Of the last row of a node's matrix, in text with six digits."""
EAR_ROUNDING = 1e-12
"""Doubled area of a triangle, over the squared size of its polygon, that counts as zero."""


class Polygons(NamedTuple):
    """Polygons of a file."""

    vertices: FloatArray
    """(nv, 3) float, in the file's unit."""
    corners: IntArray
    """(k,) int: the vertices of all polygons in turn."""
    sizes: IntArray
    """(n,) int: corners of each polygon."""
    findings: tuple[MeshFinding, ...] = ()
    unit: float | None = None
    """Metres per unit of the file; `None` if its format names none."""


def polygons_of(
    vertices: FloatArray, corners: Sequence[int], sizes: Sequence[int], findings: tuple[MeshFinding, ...] = ()
) -> Polygons:
    """Make polygons from lists."""
    return Polygons(vertices, np.array(corners, dtype=np.int64), np.array(sizes, dtype=np.int64), findings)


def triangles_of(vertices: FloatArray, corners: IntArray, findings: tuple[MeshFinding, ...] = ()) -> Polygons:
    """Make polygons of three corners each."""
    return Polygons(vertices, corners.ravel(), np.full(corners.size // 3, 3), findings)


NO_POLYGONS = polygons_of(np.empty((0, 3)), [], [])


def check_corners(polygons: Polygons) -> None:
    """Raise ValueError if a corner names a vertex that is not there."""
    corners, count = polygons.corners, len(polygons.vertices)
    if corners.size and (corners.min() < 0 or corners.max() >= count):
        raise ValueError(f"triangles name vertices {corners.min()} to {corners.max()}, and there are {count}")


def check_matrix(matrix: FloatArray) -> FloatArray:
    """Return a node's matrix (4, 4). Raises ValueError: its last row is not 0 0 0 1, so that it is no motion and no scale."""
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > LAST_ROW_TOLERANCE:
        row = " ".join(f"{number:g}" for number in matrix[3])
        raise ValueError(f"the last row of a node's matrix is {row}; 0 0 0 1 was expected")
    return matrix


def join_by_points(parts: Sequence[Polygons]) -> list[Polygons]:
    """Join the parts that have the same array of vertices: those of several materials."""
    of: dict[int, list[Polygons]] = {}
    for part in parts:
        of.setdefault(id(part.vertices), []).append(part)
    return [
        same[0]._replace(corners=np.concatenate([s.corners for s in same]), sizes=np.concatenate([s.sizes for s in same]))
        for same in of.values()
    ]


def cut_strip(corners: IntArray) -> IntArray:
    """Cut a strip into triangles, (n, 3): every second one is turned."""
    triangles = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1) if len(corners) > 2 else np.empty((0, 3), np.int64)
    triangles[1::2] = triangles[1::2][:, [1, 0, 2]]
    return triangles


def cut_fan(corners: IntArray) -> IntArray:
    """Cut a fan into triangles, (n, 3)."""
    if len(corners) < 3:
        return np.empty((0, 3), dtype=np.int64)
    return np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], axis=1)


def place_polygons(parts: Iterable[tuple[Polygons, FloatArray]], unit: float, findings: tuple[MeshFinding, ...]) -> Polygons:
    """Join parts of a scene, each at its (4, 4) matrix in the file's unit. A mirrored part keeps its outside."""
    vertices, corners, sizes = [NO_POLYGONS.vertices], [NO_POLYGONS.corners], [NO_POLYGONS.sizes]
    vertex_count = corner_count = 0
    for part, matrix in parts:
        corner_count += len(part.corners) + len(part.vertices)
        if corner_count > MAX_PLACED_CORNERS:
            raise ValueError(f"its scene has over {MAX_PLACED_CORNERS} corners: a part names others many times")
        check_corners(part)
        # Vertices that are too large are refused later, with their number.
        with np.errstate(over="ignore", invalid="ignore"):
            is_mirrored = np.linalg.det(matrix[:3, :3]) < 0
            vertices.append(part.vertices @ matrix[:3, :3].T + matrix[:3, 3])
        corners.append((part.corners[::-1] if is_mirrored else part.corners) + vertex_count)
        sizes.append(part.sizes[::-1] if is_mirrored else part.sizes)
        vertex_count += len(part.vertices)
    return Polygons(np.concatenate(vertices), np.concatenate(corners), np.concatenate(sizes), findings, unit)


@dataclass(frozen=True, slots=True, eq=False)
class CutPolygons:
    """Triangles of the polygons of a file."""

    triangles: IntArray
    """(nt, 3) int, in the order of the polygons."""
    not_flat: int
    """Polygons with a corner far off their plane."""
    crossing: int
    """Polygons without triangles: they cross themselves."""
    too_large: int
    """Polygons without triangles: the ears of the file's polygons are too many to try."""


def cut_polygons(vertices: FloatArray, corners: IntArray, sizes: IntArray) -> CutPolygons:
    """Cut polygons into triangles that turn as they do.

    Parameters
    ----------
    vertices : (nv, 3)
    corners : (k,) vertices of all polygons in turn, each below nv
    sizes : (n,) corners of each polygon, at least 3
    """
    if (sizes == 3).all():
        return CutPolygons(corners.reshape(-1, 3), 0, 0, 0)
    first = np.cumsum(sizes) - sizes
    first_triangle = np.cumsum(sizes - 2) - (sizes - 2)
    polygon = np.repeat(np.arange(len(sizes)), sizes - 2)
    second = first[polygon] + np.arange(len(polygon)) - first_triangle[polygon] + 1
    triangles = np.stack([corners[first[polygon]], corners[second], corners[second + 1]], axis=1)
    # Coordinates that are not finite are refused later, with their number.
    with np.errstate(all="ignore"):
        normals, is_fan = _judge_fans(vertices[triangles], polygon, len(sizes))
        not_flat = _count_not_flat(vertices[corners], normals, first, sizes)
        keep = np.ones(len(triangles), dtype=bool)
        crossing, too_large, tests_left = 0, 0, MAX_EAR_TESTS
        for each in np.flatnonzero(~is_fan):
            own = corners[first[each] : first[each] + sizes[each]]
            ears, tests = _cut_ears(_in_plane(vertices[own], normals[each]), tests_left)
            tests_left -= tests
            place = slice(first_triangle[each], first_triangle[each] + sizes[each] - 2)
            if ears is None:
                keep[place] = False
                is_unfinished = tests_left <= 0
                crossing, too_large = crossing + (not is_unfinished), too_large + is_unfinished
            else:
                triangles[place] = own[ears]
    return CutPolygons(triangles[keep], not_flat, crossing, too_large)


def _judge_fans(fans: FloatArray, polygon: IntArray, count: int) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Find the unit normals of the polygons, and those whose fan has no triangle that is turned against the polygon."""
    areas = np.cross(fans[:, 1] - fans[:, 0], fans[:, 2] - fans[:, 0])
    newell = np.stack([np.bincount(polygon, areas[:, axis], count) for axis in range(3)], axis=1)
    length = np.linalg.norm(newell, axis=1, keepdims=True)
    normals = np.divide(newell, length, out=np.zeros_like(newell), where=length > 0)
    size = np.linalg.norm(areas, axis=1)
    along = (areas * normals[polygon]).sum(axis=1)
    total = np.bincount(polygon, size, count)
    lost = np.bincount(polygon, np.maximum(-along, 0.0), count)
    # A polygon that turns as much one way as the other has no normal.
    wrong = (lost > MAX_LOST_AREA_FRACTION * total) | (length[:, 0] < MAX_LOST_AREA_FRACTION * total)
    return normals, ~wrong


def _count_not_flat(points: FloatArray, normals: FloatArray, first: IntArray, sizes: IntArray) -> int:
    polygon = np.repeat(np.arange(len(sizes)), sizes)
    from_middle = points - (np.add.reduceat(points, first) / sizes[:, None])[polygon]
    radius = np.maximum.reduceat(np.linalg.norm(from_middle, axis=1), first)
    offset = np.maximum.reduceat(np.abs((from_middle * normals[polygon]).sum(axis=1)), first)
    return int((offset > FLAT_POLYGON_MAX_OFFSET * radius).sum())


def _in_plane(points: FloatArray, normal: FloatArray) -> FloatArray:
    """Project points along a unit normal, (n, 2): a polygon with this normal turns counter-clockwise."""
    axis = np.eye(3)[np.abs(normal).argmin()]
    x = np.cross(axis, normal)
    x /= np.linalg.norm(x)
    flat = (points - points[0]) @ np.stack([x, np.cross(normal, x)], axis=1)
    return flat / np.abs(flat).max()


def _cut_ears(points: FloatArray, max_tests: int) -> tuple[IntArray | None, int]:
    """Cut ears of a counter-clockwise polygon (n, 2); also count the corners tried. `None`: it crosses itself."""
    if not np.isfinite(points).all():
        return None, 0
    tests = 0
    # First a corner on the border of an ear forbids it; two rings that are joined by a seam need the second try.
    for margin in (-EAR_ROUNDING, EAR_ROUNDING):
        ears, tried = _Ears(points, margin).cut(max_tests - tests)
        tests += tried
        if ears is not None and _keeps_area(points, ears):
            return ears, tests
    return None, tests


def _doubled_area(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Compute twice the signed areas of triangles in the plane; counter-clockwise is positive."""
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])


def _keeps_area(points: FloatArray, triangles: IntArray) -> bool:
    areas = _doubled_area(*points[triangles].transpose(1, 0, 2))
    x, y = points.T
    polygon = float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
    return abs(float(np.abs(areas).sum()) - polygon) <= MAX_LOST_AREA_FRACTION * polygon


class _Ears:
    """One polygon that loses its ears."""

    def __init__(self, points: FloatArray, margin: float) -> None:
        count = len(points)
        self._points, self._margin = points, margin
        self._before, self._after = np.roll(np.arange(count), 1), np.roll(np.arange(count), -1)
        self._turn = _doubled_area(points[self._before], points, points[self._after])
        self._is_reflex = self._turn <= EAR_ROUNDING

    def cut(self, max_tests: int) -> tuple[IntArray | None, int]:
        """Cut until three corners are left, and count the corners tried; `None` without an ear."""
        ears: list[tuple[int, int, int]] = []
        left, at, without_ear = len(self._points), 0, 0
        for tests in range(max_tests):
            before, after = int(self._before[at]), int(self._after[at])
            if left == 3:
                return np.array([*ears, (before, at, after)]), tests
            # After a whole turn without an ear, a corner on a straight side goes: its triangle has no area.
            is_straight = without_ear > left and abs(self._turn[at]) <= EAR_ROUNDING
            if is_straight or self._is_ear(before, at, after):
                ears.append((before, at, after))
                self._remove(before, at, after)
                # Not the next corner: ears all around make better triangles than a fan.
                left, at, without_ear = left - 1, int(self._after[after]), 0
            elif without_ear > 2 * left:
                return None, tests
            else:
                at, without_ear = after, without_ear + 1
        return None, max_tests

    def _is_ear(self, before: int, corner: int, after: int) -> bool:
        if self._is_reflex[corner]:
            return False
        others = np.flatnonzero(self._is_reflex)
        others = others[(others != before) & (others != after)]
        a, b, c, p = self._points[before], self._points[corner], self._points[after], self._points[others]
        # A second corner in the same place is a seam, not an obstacle.
        is_apart = (p != a).any(axis=1) & (p != b).any(axis=1) & (p != c).any(axis=1)
        is_inside = np.minimum.reduce([_doubled_area(a, b, p), _doubled_area(b, c, p), _doubled_area(c, a, p)]) > self._margin
        return not bool((is_inside & is_apart).any())

    def _remove(self, before: int, corner: int, after: int) -> None:
        self._after[before], self._before[after] = after, before
        self._is_reflex[corner] = False
        for each in (before, after):
            ends = self._points[self._before[each]], self._points[each], self._points[self._after[each]]
            self._turn[each] = _doubled_area(*ends)
            self._is_reflex[each] = self._turn[each] <= EAR_ROUNDING
