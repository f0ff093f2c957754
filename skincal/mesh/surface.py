"""Surface of triangles with outward normals: its edges, how flat its triangles are, and where a line meets it.

A side of a triangle is numbered h = 3 triangle + side; side s runs from corner s to corner (s + 1) mod 3.

For a line p + s d and a triangle with corners a, b, c wound outward, project everything along d: the line hits the triangle if
its point is inside the projected triangle, and enters there (d . n < 0) if the projection is wound clockwise.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, wraps
from math import inf
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError

SLIVER_MIN_LENGTH_OVER_HEIGHT = 100.0
"""Longest side over height of a triangle that is reported as a sliver: its smallest angle is below 0.6 degrees."""
MAX_KEPT_SKIN_POINTS = 8
"""Answers of `point_on_skin` that are kept for a surface."""
_SWEEP_DIRECTION = np.array([0.4472135954999579, 0.5773502691896258, 0.6831300510639733])
"""Unit direction with which no CAD grid is aligned, so that few points coincide when projected on it."""
Made = TypeVar("Made")


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangle mesh, link frame, metres. Two copies are never equal; compare `sha256`."""

    vertices: FloatArray
    """(nv, 3) float."""
    triangles: IntArray
    """(nt, 3) int, counter-clockwise seen from outside."""
    normals: FloatArray
    """(nt, 3) float, unit, outward."""
    sha256: str
    """Of the file's bytes, hexadecimal."""

    @cached_property
    def size(self) -> float:
        """Longest side of the box around the triangles, metres."""
        return float(np.ptp(self.vertices[self.triangles.ravel()], axis=0).max())

    @cached_property
    def corners(self) -> FloatArray:
        """(nt, 3, 3) float: the vertices of each triangle."""
        return self.vertices[self.triangles]

    @cached_property
    def centres(self) -> FloatArray:
        """(3, nt) float: centres of balls that hold the triangles."""
        return np.ascontiguousarray(self.corners.mean(axis=1).T)

    @cached_property
    def radii(self) -> FloatArray:
        """(nt,) float: radii of those balls, metres."""
        return np.linalg.norm(self.corners - self.centres.T[:, None], axis=2).max(axis=1)

    @cached_property
    def is_sliver(self) -> NDArray[np.bool_]:
        """(nt,) whether a triangle is over `SLIVER_MIN_LENGTH_OVER_HEIGHT` times as long as high."""
        height, longest = triangle_heights(self.corners)
        return longest > SLIVER_MIN_LENGTH_OVER_HEIGHT * height


def make_surface(vertices: FloatArray, triangles: IntArray, sha256: str = "") -> Surface:
    """Make the surface of `triangles` (nt, 3) as wound over `vertices` (nv, 3), metres, link frame; none has zero area."""
    vertices = np.ascontiguousarray(vertices, dtype=float)
    triangles = np.ascontiguousarray(triangles, dtype=np.int64)
    return Surface(vertices, triangles, triangle_normals(vertices[triangles]), sha256)


def cached_per_surface(make: Callable[[Surface], Made]) -> Callable[[Surface], Made]:
    """Decorate `make` to run once for each surface; its result is freed with the surface, and must not refer to it."""
    kept: WeakKeyDictionary[Surface, Made] = WeakKeyDictionary()
    lock = threading.Lock()

    @wraps(make)
    def find_or_make(surface: Surface) -> Made:
        with lock:
            # Made under the lock: another thread that asks for the same waits.
            if surface not in kept:
                kept[surface] = make(surface)
            return kept[surface]

    return find_or_make


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Edges of a set of triangles."""

    open: IntArray
    """(k,) sides of one triangle alone: the rim."""
    non_manifold: int
    """Edges shared by three or more triangles."""
    pairs: IntArray
    """(m, 2) sides that two triangles share."""
    against: IntArray
    """(m,) 1 if both triangles run along the edge in the same direction, so that one is turned; else 0."""


def find_edges(triangles: IntArray) -> Edges:
    """Find the edges of `triangles` (nt, 3)."""
    start, end = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.argsort(low * (int(triangles.max(initial=0)) + 1) + high, kind="stable")
    low, high = low[order], high[order]
    first = np.flatnonzero(np.r_[True, (low[1:] != low[:-1]) | (high[1:] != high[:-1])]) if len(order) else order
    counts = np.diff(np.r_[first, len(order)])
    shared = first[counts == 2]
    pairs = np.stack([order[shared], order[shared + 1]], axis=1)
    against = (start[pairs[:, 0]] == start[pairs[:, 1]]).astype(np.int64)
    return Edges(order[first[counts == 1]], int((counts > 2).sum()), pairs, against)


def neighbours(triangles: IntArray) -> IntArray:
    """Find (nt, 3) for each edge of each triangle the same edge of the adjacent one; -1 at the rim and non-manifold edges."""
    pairs = find_edges(triangles).pairs
    other = np.full(triangles.size, -1, dtype=np.int64)
    other[pairs[:, 0]], other[pairs[:, 1]] = pairs[:, 1], pairs[:, 0]
    return other.reshape(-1, 3)


def triangle_normals(corners: FloatArray) -> FloatArray:
    """Compute (nt, 3) unit normals of `corners` (nt, 3, 3) as wound, right-handed."""
    normals, _ = _normals_and_sides(corners)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def triangle_heights(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the smallest height and the longest side of each triangle of `corners` (nt, 3, 3), metres."""
    normals, longest = _normals_and_sides(corners)
    double_area = np.linalg.norm(normals, axis=1)
    return np.divide(double_area, longest, out=np.zeros_like(longest), where=longest > 0), longest


def _normals_and_sides(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute normals (nt, 3), twice the area long, and the longest sides (nt,).

    The two shortest sides are crossed: they lose the fewest digits for a needle.
    """
    # In columns: numpy is three times as fast with long rows as with rows of three.
    columns = np.ascontiguousarray(corners.transpose(1, 2, 0))
    sides = columns[[1, 2, 0]] - columns
    squares = sides * sides
    lengths = np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2])
    longest = lengths.argmax(axis=0)[None]
    first, second = (np.take_along_axis(sides, ((longest + step) % 3)[:, None], axis=0)[0] for step in (1, 2))
    normals = np.stack([first[i - 2] * second[i - 1] - first[i - 1] * second[i - 2] for i in range(3)], axis=1)
    return normals, np.take_along_axis(lengths, longest, axis=0)[0]


def pairs_within(points: FloatArray, reach: float, most: float = inf) -> IntArray:
    """Find (m, 2) the pairs of `points` (n, 3) within `reach`, metres, each once, by a sweep along one direction; exact.

    All pairs of 4,200 taxels would take 400 MB, and scipy's tree half a second to import.

    Raises InputError: more than `most` pairs are within `reach` along that direction.
    """
    along = points @ _SWEEP_DIRECTION
    order = np.argsort(along, kind="stable")
    along = along[order]
    pairs = [np.empty((0, 2), dtype=np.int64)]
    # A little farther than the reach: rounding loses no pair.
    limit = reach * (1.0 + 1e-9) + 1e-12 * np.abs(along).max(initial=0.0)
    here, step, tried = np.arange(len(order)), 1, 0
    while here.size:
        here = here[here + step < len(order)]
        here = here[along[here + step] - along[here] <= limit]
        tried += len(here)
        if tried > most:
            raise InputError(
                f"Of {len(points)} points more than {most:g} pairs lie within {reach * 1e6:g} um along a line; "
                "points that are spread over a part were expected: export the mesh again, with more digits."
            )
        both = np.stack([order[here], order[here + step]], axis=1)
        pairs.append(both[np.linalg.norm(points[both[:, 0]] - points[both[:, 1]], axis=1) <= reach])
        step += 1
    return np.concatenate(pairs)


def entry_points(surface: Surface, point: FloatArray, direction: FloatArray) -> FloatArray:
    """Find (k, 3) the points, metres, where a line enters the surface from outside, in its order.

    `point` (3,), metres, is on the line; `direction` (3,), unit, is that of the force.
    """
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(helper, direction)
    first /= np.linalg.norm(first)
    across = np.stack([first, np.cross(direction, first)])
    # Few triangles have an enclosing ball that the line meets.
    away = across @ surface.centres - (across @ point)[:, None]
    near = np.flatnonzero(away[0] ** 2 + away[1] ** 2 <= surface.radii**2)
    corners = surface.vertices[surface.triangles[near]]
    a, b, c = np.moveaxis((corners - point) @ across.T, 1, 0)
    # Signed areas that the origin (the line) makes with the sides: all negative means inside, and wound clockwise.
    toward_c, toward_a, toward_b = _area(a, b), _area(b, c), _area(c, a)
    total = toward_a + toward_b + toward_c
    hit = (toward_a <= 0) & (toward_b <= 0) & (toward_c <= 0) & (total < 0)
    share = np.stack([toward_a[hit], toward_b[hit], toward_c[hit]], axis=1) / total[hit, None]
    points = np.einsum("kc,kcx->kx", share, corners[hit])
    return points[np.argsort(points @ direction)]


def _area(p: FloatArray, q: FloatArray) -> FloatArray:
    return p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]


def contact_point(surface: Surface | None, point: FloatArray, direction: FloatArray, near: FloatArray) -> FloatArray:
    """Find the contact point of a poke, (3,) metres: the entry nearest to `near`, else the axis's point nearest to it.

    `point` and `direction` are the force axis; `near` is the position of the taxels that answered, or the part's centre.
    """
    entries = np.empty((0, 3)) if surface is None else entry_points(surface, point, direction)
    if len(entries):
        return entries[np.argmin(np.linalg.norm(entries - near, axis=1))]
    return point + direction * float(direction @ (near - point))


@cached_per_surface
def _newest_points(_surface: Surface) -> dict[tuple[bytes, bytes], FloatArray]:
    """Make the memory of `point_on_skin`."""
    return {}


def point_on_skin(surface: Surface | None, place: FloatArray, normal: FloatArray) -> FloatArray:
    """Find the skin's point over or under a believed position, (3,) metres; the position itself without a surface.

    The newest answers are kept: several views ask for the place of one target.
    """
    if surface is None:
        return contact_point(None, place, -normal, place)
    kept, key = _newest_points(surface), (place.tobytes(), normal.tobytes())
    found = kept.get(key)
    if found is None:
        found = contact_point(surface, place, -normal, place)
        if len(kept) >= MAX_KEPT_SKIN_POINTS:
            kept.clear()
        kept[key] = found
    return found.copy()
