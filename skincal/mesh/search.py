"""Nearest point of a surface in a metric, exactly: the optimum over all triangles (paper, II-B).

The metric is given by its root: minimise |root p - offset|^2, so nothing is squared. The search, and why an answer has the same
bits for any start and any other queries: `skincal/solver/source/search.h`.

It goes down a wide tree over the triangles. These are ordered by halving along the longest side of their box. Eight successive
triangles are a node, eight such nodes a node of the next level, and so on. A node has a point of the surface, the centre; the
radius of a ball about it that holds its triangles; the mean of their normals, and the largest angle from it. Surface and tree
are written into the solver's memory once, and freed with the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.surface import Surface, cached_per_surface
from skincal.solver.machine import Machine
from skincal.solver.tables import NODE_CHILDREN, SEARCH_TREE_MAX_DEPTH, SINGLE_PRECISION_MARGIN_SHARE

_HALVINGS_PER_TREE_LEVEL = NODE_CHILDREN.bit_length() - 1
_NORMAL_CONE_MARGIN_SIN = 1e-6
"""Sine of the angle by which a cone of normals is enlarged: ten times the rounding of its numbers."""
_EMPTY_RADIUS_M = -1e15
"""Of a node without triangles: its lower bound exceeds every distance."""
Level = NDArray[np.float32]
"""Nodes of one level in groups of eight with one parent, (groups, 64): x, y and z of their centres (8 each), their radii, the
mean normals (24), their sines. The last group is filled up. A node's triangles surely face a push if push . normal < -sine, and
surely do not if push . normal > sine."""


@dataclass(frozen=True, slots=True, eq=False)
class NearestPoints:
    """Best point of a surface for each of t metrics."""

    points: FloatArray
    """(t, 3) float, metres; NaN without one."""
    triangles: IntArray
    """(t,) int; -1 if no triangle faces the push."""
    values: FloatArray
    """(t,) float, |root p - offset|^2 there; infinite without one."""
    tried: IntArray
    """(t,) int: number of triangles solved."""


def nearest_in_metric(
    surface: Surface, roots: FloatArray, offsets: FloatArray, pushes: FloatArray | None, *, every: bool = False
) -> NearestPoints:
    """Minimise |root p - offset|^2 over the surface's points p, exactly, for each of t metrics.

    Parameters
    ----------
    roots : (t, 3, 3) float, of any rank
    offsets : (t, 3) float
    pushes : (t, 3) float; if given, only triangles with push . normal < 0 count
    every : try every triangle: slower, with the same answer

    Among equally near points it is the one first met by the push, then the triangle that faces it most, then the lowest index.
    """
    count = len(roots)
    machine, place = surface_in_solver(surface)
    nowhere = np.full(count, -1)
    found = machine.run(
        "nearest",
        surface=place,
        metrics=count,
        all=every,
        roots=roots,
        offsets=offsets,
        pushes=pushes,
        starting=nowhere,
        best=None,
        radii=None,
        limits=None,
        points=(count, 3),
        values=(count,),
        triangles=nowhere,
        tried=(count,),
    )
    triangles, tried = found["triangles"].astype(np.int64), found["tried"].astype(np.int64)
    return NearestPoints(found["points"], triangles, found["values"], tried)


def nearest_points(surface: Surface, points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Find for each of `points` (n, 3), metres, the surface's nearest point (n, 3), exactly, and its triangle (n,).

    Of equally near triangles it is the first one.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    found = nearest_in_metric(surface, np.broadcast_to(np.eye(3), (len(points), 3, 3)), points, None)
    return found.points, found.triangles


def nearest_pushed_points(surface: Surface, points: FloatArray, pushes: FloatArray) -> tuple[FloatArray, IntArray]:
    """Find as `nearest_points` does, on the triangles that face `pushes` (n, 3): a push enters a thin wall from outside.

    Where no triangle faces the push, it is the nearest one of all.
    """
    near, triangles = nearest_points(surface, points)
    away = np.flatnonzero(np.einsum("ij,ij->i", surface.normals[triangles], pushes) >= 0.0)
    if len(away):
        turns = np.broadcast_to(np.eye(3), (len(away), 3, 3))
        found = nearest_in_metric(surface, turns, np.asarray(points, dtype=float)[away], pushes[away])
        faced = found.triangles >= 0
        near[away[faced]], triangles[away[faced]] = found.points[faced], found.triangles[faced]
    return near, triangles


@cached_per_surface
def surface_in_solver(surface: Surface) -> tuple[Machine, int]:
    """Write `surface` with its search tree into a machine; return it with the place of the table in it."""
    machine, tree, (starts, fans) = Machine(), build_tree(surface), find_fans(surface)
    triangles, vertices = len(surface.triangles), len(surface.vertices)
    return machine, machine.store(
        "Surface",
        triangle_count=triangles,
        level_count=len(tree.levels),
        levels=list(tree.levels),
        node_counts=np.pad([level.size // 8 for level in tree.levels], (0, SEARCH_TREE_MAX_DEPTH - len(tree.levels))),
        order=tree.order,
        places=tree.places,
        corners=tree.corners,
        vertices=surface.vertices,
        triangles=surface.triangles,
        normals=surface.normals,
        slim=surface.is_sliver,
        fan_starts=starts,
        fans=fans,
        walked=np.zeros(triangles),
        lowest=np.zeros(vertices),
        lowest_stamp=np.zeros(vertices),
        stamp=0,
        origin=tree.origin,
        extent=tree.extent,
    )


@dataclass(frozen=True, slots=True, eq=False)
class SearchTree:
    """Nodes over a surface's nt triangles; node i of a level has the nodes 8 i to 8 i + 7 of the level before."""

    origin: FloatArray
    """(3,) float, metres: centre of the surface's box."""
    extent: float
    """m, largest distance of a vertex from the origin."""
    order: IntArray
    """(nt,) triangle of each node of level 0."""
    places: IntArray
    """(nt,) node of each triangle."""
    corners: FloatArray
    """(nt, 3, 3) float, metres, from the origin, in the order of the nodes."""
    levels: tuple[Level, ...]


def build_tree(surface: Surface) -> SearchTree:
    """Build the tree over a surface's triangles; there is at least one."""
    corners = surface.corners
    points = corners.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    origin = (low + high) / 2
    columns = np.ascontiguousarray(corners.transpose(2, 1, 0)) - origin[:, None, None]
    order = _halved((columns[:, 0] + columns[:, 1] + columns[:, 2]) / 3)
    columns, facing = columns.take(order, axis=2), surface.normals.T.take(order, axis=1)
    levels, size = [_packed(_leaves(columns, facing))], 1
    while size * NODE_CHILDREN < len(order):
        size *= NODE_CHILDREN
        levels.append(_packed(_joined(columns, facing, size)))
    places = np.empty_like(order)
    places[order] = np.arange(len(order))
    extent = float(np.linalg.norm(high - low) / 2)
    return SearchTree(origin, extent, order, places, np.ascontiguousarray(columns.transpose(2, 1, 0)), tuple(levels))


@dataclass(slots=True)
class _Nodes:
    centres: FloatArray
    """(3, n)"""
    radii: FloatArray
    middles: FloatArray
    """(3, n), unit."""
    sines: FloatArray
    """(n,) of the largest angle of a normal from the mean; 2 for a right angle or more."""


def _squares(vectors: FloatArray) -> FloatArray:
    return vectors[0] * vectors[0] + vectors[1] * vectors[1] + vectors[2] * vectors[2]


def _leaves(columns: FloatArray, normals: FloatArray) -> _Nodes:
    """Make each triangle a node: a ball about the middle of its longest side if that holds it, else about its mean."""
    sides = [_squares(columns[:, (i + 1) % 3] - columns[:, i]) for i in range(3)]
    longest = np.argmax(sides, axis=0)
    column = np.arange(len(longest))
    middle = (columns[:, longest, column] + columns[:, (longest + 1) % 3, column]) / 2
    half = np.sqrt(np.maximum.reduce(sides)) / 2
    obtuse = _squares(columns[:, (longest + 2) % 3, column] - middle) <= half * half
    centres = np.where(obtuse, middle, columns.mean(axis=1))
    radii = np.sqrt(np.maximum.reduce([_squares(columns[:, i] - centres) for i in range(3)]))
    return _Nodes(centres, radii, normals, np.zeros(len(radii)))


def _joined(columns: FloatArray, normals: FloatArray, size: int) -> _Nodes:
    """Join each `size` successive triangles: a ball about the corner nearest to their mean."""
    count = int(columns.shape[2])
    groups = -(-count // size)
    # Copies of the last triangle fill up the last group; they enlarge no ball and no cone.
    filled = np.minimum(np.arange(groups * size), count - 1)
    corners = columns.take(filled, axis=2).reshape(3, 3, groups, size).transpose(0, 2, 1, 3).reshape(3, groups, 3 * size)
    normals = normals.take(filled, axis=1).reshape(3, groups, size)
    nearest = _squares(corners - corners.mean(axis=2)[:, :, None]).argmin(axis=1)
    centre = corners[:, np.arange(groups), nearest]
    radii = np.sqrt(_squares(corners - centre[:, :, None]).max(axis=1))
    middle = normals.sum(axis=2)
    length = np.sqrt(_squares(middle))
    middle = np.divide(middle, length, out=np.zeros_like(middle), where=length > 0)
    # From the chord: a cosine near 1 has lost the angle.
    chord = _squares(normals - middle[:, :, None]).max(axis=1)
    sine = np.where((chord < 2) & (length > 0), np.sqrt(chord * np.maximum(1 - chord / 4, 0.0)), 2.0)
    return _Nodes(centre, radii, middle, sine)


def _packed(nodes: _Nodes) -> Level:
    """Round to single precision, outward, and fill up the last group with empty nodes."""
    count = len(nodes.radii)
    groups = -(-count // NODE_CHILDREN)
    filled = np.minimum(np.arange(groups * NODE_CHILDREN), count - 1)
    table = np.empty((8, groups * NODE_CHILDREN))
    table[:3], table[4:7] = nodes.centres.take(filled, axis=1), nodes.middles.take(filled, axis=1)
    table[3], table[7] = (
        nodes.radii.take(filled) * (1 + SINGLE_PRECISION_MARGIN_SHARE),
        nodes.sines.take(filled) + _NORMAL_CONE_MARGIN_SIN,
    )
    table[3, count:] = _EMPTY_RADIUS_M
    single = table.astype(np.float32)
    return np.ascontiguousarray(single.reshape(8, groups, NODE_CHILDREN).transpose(1, 0, 2)).reshape(groups, 8 * NODE_CHILDREN)


def _halved(centres: FloatArray) -> IntArray:
    """Order points (3, n) so that successive ones are near: halve along the longest side, down to 8."""
    count = int(centres.shape[1])
    order, starts = np.arange(count), np.zeros(1, dtype=np.int64)
    while True:
        sizes = np.diff(starts, append=count)
        if sizes.max() <= NODE_CHILDREN:
            return order
        ranked = centres.take(order, axis=1)
        low, high = np.minimum.reduceat(ranked, starts, axis=1), np.maximum.reduceat(ranked, starts, axis=1)
        side = (high - low).argmax(axis=0)
        segment = np.repeat(np.arange(len(starts)), sizes)
        low, high = low[side, np.arange(len(starts))], high[side, np.arange(len(starts))]
        span = np.where(high > low, high - low, 1.0) * 1.001
        # Segment before the decimal point, position in it behind: one sort for all segments.
        key = segment + (ranked[side[segment], np.arange(count)] - low[segment]) / span[segment]
        # Stable: which of equals comes first must not depend on the processor.
        order = order[key.argsort(kind="stable")]
        cut = np.where(sizes > NODE_CHILDREN, starts + _first_half(sizes), count)
        starts = np.sort(np.concatenate([starts, cut[cut < count]]))


def _first_half(sizes: IntArray) -> IntArray:
    """Compute the size of the first half of each of `sizes`, rounded so that it fills whole nodes of 8, 64, 512, ... items."""
    exponent = np.frexp(np.maximum(sizes - 1, 1).astype(float))[1] - 1
    whole = 1 << (exponent // _HALVINGS_PER_TREE_LEVEL * _HALVINGS_PER_TREE_LEVEL)
    return np.where(sizes > 2 * whole, -(-(sizes // 2) // whole) * whole, whole << (exponent % _HALVINGS_PER_TREE_LEVEL))


def find_fans(surface: Surface) -> tuple[IntArray, IntArray]:
    """List the triangles around each vertex: (nv + 1,) their begins in the second array, and that array."""
    flat, count = surface.triangles.ravel(), len(surface.vertices)
    return np.r_[0, np.cumsum(np.bincount(flat, minlength=count))], flat.argsort(kind="stable") // 3
