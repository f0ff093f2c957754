"""Outward normals of the smooth part that a mesh stands for, at points on the mesh, with their errors.

A triangle is a chord of the part: its corners are points of the part, and its normal is wrong by up to half the angle to the
next triangle. Two estimates are made, and the one with the smaller error counts.

**By the triangle.** The part is taken as a quadric through the three corners of the triangle that carries the point. With x in
the triangle's plane, in units that make the triangle equilateral, and z the height over that plane,

    z = q(x) - p(x),   q(x) = x'Qx / 2,   p the plane through q at the three corners.

Only the bend Q is unknown. Corners x_k of the triangles around give z_k, and z_k / (|x_k|^2 / 2) is a bend that they show. Q is
fitted to these bends. A corner counts by the area of its triangles, at most as much as one of the triangle itself: next to a
large flat face the strips of a fillet do not count for the face. Corners nearer to the triangle than half its size say nothing
either, nor do those farther than three times its size. Bends that contradict each other make Q small (`_shrink`): a triangle
between a flat face and a fillet keeps its normal.

**By the footprint.** Where the triangles are small and their bends contradict each other, as on a scanned part, a quadric is
fitted in least squares to all corners within the footprint of the taxel.

Around a triangle only those triangles count that one reaches without an edge sharper than `SHARP_EDGE_MIN_ANGLE_RAD`, and whose
normal is within `PATCH_MAX_ANGLE_RAD` of its own. So a crease stays a crease, and the inner face of a thin wall never counts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skincal.geometry import FloatArray, IntArray, orthonormal_pair
from skincal.mesh.surface import Surface, cached_per_surface, neighbours, triangle_heights

SHARP_EDGE_MIN_ANGLE_RAD = float(np.radians(32.0))
"""rad. Triangles that meet at a larger angle are faces of an edge; at a smaller one, maybe a coarse mesh of a round part."""
PATCH_MAX_ANGLE_RAD = float(np.radians(45.0))
"""rad, from the normal of the triangle that carries the point: a quadric is no wider."""
PATCH_STEPS = 5
"""Edges to cross to the farthest triangle of the patch: two rings of a regular mesh."""
NEAREST_CORNER, FARTHEST_CORNER = 0.75, 3.5
"""Distances from the triangle's middle, in sides of it: its own corners are 0.58 away, those of its neighbours 1.15."""
LEAST_CORNERS = 4
"""One more than the bend has numbers."""
BEND_RIDGE_SHARE = 0.01
"""Share of the corners' weight that holds the bend at zero: strips have no corner that shows their bend along them."""
FOOTPRINT_CORNERS = 16
"""Corners in a footprint: the ten unknowns of a cubic, and some to tell the noise."""
CUBIC_BY_NOISE = 6.0
"""Square of the turn by the cubic terms, over the variance of the normal, that noise explains."""
FOOTPRINT_TRIED_FROM_RAD = float(np.radians(0.5))
"""rad. Below this error by the triangle the footprint is not tried."""
AGREE_MAX_SDS = 3.0
"""Of both errors: farther apart, something in the footprint is no quadric."""
UNSURE_SHARE, LEFT_OUT_SHARE = 0.0025, 0.25
"""Squares of a twentieth of the turn that is made, and of half of the one that is not: facets may be faces."""
FOOTPRINT_STEPS = 60
"""Edges to cross within a footprint: on a finer mesh a part of it is enough."""
FULL_WEIGHT = 3.0
"""Corners of full weight from which on a bend counts fully."""
NOISE_SHARE = 0.5
"""Of the noise of the corners: less of it is noise on a smooth part with irregular triangles."""
CUBIC_SHARE = 0.01
"""Square of the slope at a triangle's corner by a change of the bend, 1 along a side of it."""
THIN_MIN_RATIO, BETTER_RATIO = 6.0, 0.5
"""Length over height of a triangle from which on another one is looked for, and that of the other one over it."""
MOVES_OFF_THIN_TRIANGLES = 3
CHUNK_FLAGS = 20_000_000
"""Triangles times points that are marked at once, one byte each."""
_UNIT_CORNERS = np.array([[-0.5, -0.5 / np.sqrt(3.0)], [0.5, -0.5 / np.sqrt(3.0)], [0.0, 1.0 / np.sqrt(3.0)]])
"""Of an equilateral triangle with sides of 1 and its middle at 0."""
_UNIT_EDGES = (_UNIT_CORNERS[1:] - _UNIT_CORNERS[0]).T


class SmoothNormals(NamedTuple):
    """Normals at n points on a surface."""

    normals: FloatArray
    """(n, 3) float, unit, outward."""
    sd: FloatArray
    """(n,) float, rad: standard deviation of the angle to the part's normal. It leaves out edges that are taken as sharp."""


class _Found(NamedTuple):
    """Normals of n points by one of the two estimates."""

    normals: FloatArray
    """(n, 3) float, unit."""
    variances: FloatArray
    """(n,) float, rad^2, of the angle; infinite where there is no estimate."""
    bends: FloatArray
    """(n, 3, 3) float, 1/m: a step along the surface times it turns the normal."""


def smooth_normals(
    surface: Surface, points: FloatArray, triangles: IntArray, footprint_m: float, covariances: FloatArray | None = None
) -> SmoothNormals:
    """Estimate the outward normals of the smooth part at points on its mesh.

    Parameters
    ----------
    points : (n, 3) float, metres, link frame
    triangles : (n,) int, the triangle that carries each point
    footprint_m : radius of a taxel's footprint, metres
    covariances : (n, 3, 3) float, m^2, of the points; `None` for exact points
    """
    points, triangles = np.asarray(points, dtype=float), np.asarray(triangles, dtype=np.int64)
    normals, sd = np.empty((len(points), 3)), np.empty(len(points))
    step = max(1, CHUNK_FLAGS // len(surface.triangles))
    for begin in range(0, len(points), step):
        rows = slice(begin, begin + step)
        found = _some_normals(surface, points[rows], triangles[rows], footprint_m)
        variances = found.variances
        if covariances is not None:
            turned = found.bends @ covariances[rows] @ found.bends.transpose(0, 2, 1)
            variances = variances + np.trace(turned, axis1=1, axis2=2)
        normals[rows], sd[rows] = found.normals, np.sqrt(variances)
    return SmoothNormals(normals, sd)


def _some_normals(surface: Surface, points: FloatArray, triangles: IntArray, footprint_m: float) -> _Found:
    starts = _better_shaped(surface, triangles)
    found = _by_triangle(surface, points, starts)
    normals, variances = found.normals, found.variances
    rows = np.flatnonzero(variances > FOOTPRINT_TRIED_FROM_RAD**2)
    if len(rows):
        other = _by_footprint(surface, points[rows], starts[rows], footprint_m)
        apart = np.sum((other.normals - normals[rows]) ** 2, axis=1)
        better = (other.variances < variances[rows]) & (apart < AGREE_MAX_SDS**2 * (other.variances + variances[rows]))
        for values, others in zip(found, other, strict=True):
            values[rows[better]] = others[better]
    return found


@cached_per_surface
def _ways(surface: Surface) -> IntArray:
    """Find (nt, 3) the neighbour at each side of each triangle, -1 at a rim and at a sharp edge. Slivers have no sharp edge."""
    sides = neighbours(surface.triangles)
    beside = np.where(sides >= 0, sides // 3, -1)
    cosines = np.einsum("ik,ijk->ij", surface.normals, surface.normals[beside])
    slim = surface.is_sliver
    is_smooth = (cosines > np.cos(SHARP_EDGE_MIN_ANGLE_RAD)) | slim[:, None] | slim[beside]
    return np.where((beside >= 0) & is_smooth, beside, -1)


def _better_shaped(surface: Surface, triangles: IntArray) -> IntArray:
    """Replace thin triangles, whose normals err most, by a much better one at their longest side. Strips have none."""
    ways, ratios, starts = _ways(surface), _ratios(surface), triangles.copy()
    for _ in range(MOVES_OFF_THIN_TRIANGLES):
        rows = np.flatnonzero(ratios[starts] > THIN_MIN_RATIO)
        corners = surface.corners[starts[rows]]
        longest = np.linalg.norm(corners[:, [1, 2, 0]] - corners, axis=2).argmax(axis=1)
        other = ways[starts[rows], longest]
        better = (other >= 0) & (ratios[other] < BETTER_RATIO * ratios[starts[rows]])
        starts[rows[better]] = other[better]
    return starts


@cached_per_surface
def _ratios(surface: Surface) -> FloatArray:
    """Compute (nt,) the longest side of each triangle over its height."""
    height, longest = triangle_heights(surface.corners)
    return longest / np.maximum(height, 1e-9 * longest)


class _Patches(NamedTuple):
    """Triangles around the points, and their corners; one row a pair of point and triangle or corner."""

    owners: IntArray
    """(k,) point of each corner, ascending."""
    corners: IntArray
    """(k,) vertex of the surface."""
    areas: FloatArray
    """(k,) m^2, of the triangles of the patch at the corner."""


def _collect(surface: Surface, starts: IntArray, steps: int, points: FloatArray, radius_m: float) -> _Patches:
    """Collect the triangles that `steps` smooth edges reach and that have a corner within a radius of the point."""
    ways, slim, count, total = _ways(surface), surface.is_sliver, len(starts), len(surface.triangles)
    seen = np.zeros((count, total), dtype=np.bool_)
    owners, here = np.arange(count), starts
    seen[owners, here] = True
    # The last triangle that is no sliver: from it to the next one there must be no sharp edge.
    found: list[tuple[IntArray, IntArray, IntArray]] = [(owners, here, starts)]
    for _ in range(steps):
        owners, here, before = found[-1]
        owners, before, here = np.repeat(owners, 3), np.repeat(before, 3), ways[here].ravel()
        kept = here >= 0
        kept[kept] &= ~seen[owners[kept], here[kept]]
        owners, before, here = owners[kept], before[kept], here[kept]
        turned = [np.einsum("ij,ij->i", surface.normals[here], surface.normals[other]) for other in (before, starts[owners])]
        kept = (turned[0] > np.cos(SHARP_EDGE_MIN_ANGLE_RAD)) & (turned[1] > np.cos(PATCH_MAX_ANGLE_RAD)) | slim[here]
        if np.isfinite(radius_m):
            off = surface.corners[here] - points[owners, None]
            kept &= np.einsum("ijk,ijk->ij", off, off).min(axis=1) <= radius_m**2
        if not kept.any():
            break
        _, first = np.unique(owners[kept] * total + here[kept], return_index=True)
        owners, before, here = owners[kept][first], before[kept][first], here[kept][first]
        seen[owners, here] = True
        found.append((owners, here, np.where(slim[here], before, here)))
    owners, here = (np.concatenate([each[i] for each in found]) for i in (0, 1))
    vertices = len(surface.vertices)
    keys, where = np.unique((owners[:, None] * vertices + surface.triangles[here]).ravel(), return_inverse=True)
    areas = _sums(where.ravel(), np.repeat(_areas(surface)[here], 3), len(keys))
    return _Patches(keys // vertices, keys % vertices, areas)


@cached_per_surface
def _areas(surface: Surface) -> FloatArray:
    a, b, c = surface.corners.transpose(1, 0, 2)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2, dtype=np.float64)


def _bend_terms(x: FloatArray) -> FloatArray:
    """Compute (..., 3) the terms xx/2, xy, yy/2 of places (..., 2)."""
    u, v = x[..., 0], x[..., 1]
    return np.stack([u * u / 2, u * v, v * v / 2], axis=-1)


_TERM_PLANES: FloatArray = np.asarray(
    np.linalg.inv(np.c_[np.ones(3), _UNIT_CORNERS]) @ _bend_terms(_UNIT_CORNERS), dtype=np.float64
)
"""(3, 3): planes through each of the terms at the three corners: constant, slopes along x and y."""


def _slopes_of_terms(x: FloatArray) -> FloatArray:
    """Compute (..., 2, 3) the slopes of the terms less their planes."""
    u, v, none = x[..., 0], x[..., 1], np.zeros(x.shape[:-1])
    own = np.stack([np.stack([u, v, none], axis=-1), np.stack([none, u, v], axis=-1)], axis=-2)
    return own - _TERM_PLANES[1:]


def _by_triangle(surface: Surface, points: FloatArray, starts: IntArray) -> _Found:
    count, patches = len(points), _collect(surface, starts, PATCH_STEPS, points, np.inf)
    normal, middle, of = surface.normals[starts], surface.corners[starts].mean(axis=1), patches.owners
    across = orthonormal_pair(normal)
    to_units = _units(across, surface.corners[starts])
    off = surface.vertices[patches.corners] - middle[of]
    x, z = _turn(to_units[of], _turn(across[of], off)), np.sum(off * normal[of], axis=1)
    size = np.linalg.norm(x, axis=1)
    share = np.minimum(patches.areas / _areas(surface)[starts][of], 1.0)
    weights = share**2 * ((size > NEAREST_CORNER) & (size < FARTHEST_CORNER))
    scale = np.maximum(size * size / 2, 0.1)
    terms = (_bend_terms(x) - _TERM_PLANES[0] - x @ _TERM_PLANES[1:]) / scale[:, None]
    shown, total = z / scale, np.bincount(of, weights, count)
    matrix = _products(of, weights, terms, count) + (BEND_RIDGE_SHARE * total + 1e-9)[:, None, None] * np.eye(3)
    pull = _sums(of, (weights * shown)[:, None] * terms, count)
    fitted = _solve(matrix, pull)
    errors = weights * (shown - np.sum(terms * fitted[of], axis=1)) ** 2
    left = _sums(of, errors, count)
    enough = np.bincount(of, weights > 0.1, count) >= LEAST_CORNERS
    kept = np.where(enough, _shrink(np.sum(pull * fitted, axis=1), left) * np.minimum(total / FULL_WEIGHT, 1.0), 0.0)
    bend = kept[:, None] * fitted
    place = _turn(to_units, _turn(across, points - middle))
    slopes = to_units.transpose(0, 2, 1) @ _slopes_of_terms(place)
    slope, whole = _turn(slopes, bend), _turn(slopes, fitted)
    by_fit = np.einsum("naj,njk,nak->n", slopes, np.linalg.inv(matrix), slopes) * left / np.maximum(total - 1.5, 0.5)
    noise, cubic = _two_parts(of, errors, weights, np.stack([1.0 / scale**2, size**2], axis=1), count)
    steep = to_units.transpose(0, 2, 1) @ _EDGE_SLOPES
    by_corners = NOISE_SHARE * noise * np.sum(steep**2, axis=(1, 2)) + CUBIC_SHARE * cubic * np.sum(to_units**2, axis=(1, 2))
    by_doubt = UNSURE_SHARE * np.sum(slope**2, axis=1) + LEFT_OUT_SHARE * np.sum((whole - slope) ** 2, axis=1)
    # Far outside a triangle its quadric says nothing.
    steep_slope = np.sum(slope**2, axis=1) > np.tan(SHARP_EDGE_MIN_ANGLE_RAD) ** 2
    slope = np.where(steep_slope[:, None], 0.0, slope)
    normals = normal - np.einsum("na,nab->nb", slope, across)
    tangent = across.transpose(0, 2, 1) @ to_units.transpose(0, 2, 1)
    return _Found(
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        np.where(enough, by_fit, 0.0) + by_corners + by_doubt,
        tangent @ _as_matrix(bend) @ tangent.transpose(0, 2, 1),
    )


def _units(across: FloatArray, corners: FloatArray) -> FloatArray:
    """Find (n, 2, 2) the map from the plane of each triangle to a plane where it is equilateral with sides of 1."""
    a, b = ((corners[:, i] - corners[:, 0])[:, None] @ across.transpose(0, 2, 1) for i in (1, 2))
    (ax, ay), (bx, by) = a[:, 0].T, b[:, 0].T
    area = np.maximum(ax * by - ay * bx, 1e-12 * (ax * ax + ay * ay + bx * bx + by * by) + 1e-300)
    from_edges = np.stack([np.stack([by, -bx], axis=1), np.stack([-ay, ax], axis=1)], axis=1) / area[:, None, None]
    return _UNIT_EDGES @ from_edges


def _shrink(explained: FloatArray, left: FloatArray) -> FloatArray:
    """Share of a bend that counts: 1 if the corners agree on it, 0 if they do not."""
    whole = explained + left
    share = np.divide(explained, whole, out=np.zeros_like(whole), where=whole > 1e-30)
    return np.clip((share - 0.5) / 0.4, 0.0, 1.0)


def _solve(matrices: FloatArray, sides: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(matrices, sides[:, :, None])[:, :, 0], dtype=np.float64)


def _two_parts(
    owners: IntArray, errors: FloatArray, weights: FloatArray, parts: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """Fit weighted squares of errors (k,) by two `parts` (k, 2); return the sizes (n,) of both, none below zero.

    Noise of the corners errs most in the bends that near corners show, a change of the bend in those of far corners.
    """
    matrix, side = _products(owners, weights, parts, count), _sums(owners, errors[:, None] * parts, count)
    alone = side / np.maximum(matrix[:, [0, 1], [0, 1]], 1e-300)
    small = 1e-9 * np.trace(matrix, axis1=1, axis2=2) + 1e-300
    both = _solve(matrix + small[:, None, None] * np.eye(2), side)
    noise = np.where(both[:, 1] < 0.0, alone[:, 0], np.maximum(both[:, 0], 0.0))
    return noise, np.where(both[:, 0] < 0.0, alone[:, 1], np.maximum(both[:, 1], 0.0))


_EDGE_SLOPES: FloatArray = np.asarray(np.linalg.inv(np.c_[np.ones(3), _UNIT_CORNERS])[1:], dtype=np.float64)
"""(2, 3): slopes of the plane through heights at the corners of the equilateral triangle."""


def _as_matrix(bend: FloatArray) -> FloatArray:
    return bend[:, [[0, 1], [1, 2]]]


def _sums(owners: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Sum values (k, ...) by their owner: (count, ...)."""
    flat = values.reshape(len(values), -1)
    columns = [np.bincount(owners, column, count) for column in flat.T]
    return np.stack(columns, axis=1, dtype=np.float64).reshape(count, *values.shape[1:])


def _products(owners: IntArray, weights: FloatArray, terms: FloatArray, count: int) -> FloatArray:
    """Sum the weighted products of terms (k, d) by their owner: (count, d, d)."""
    return _sums(owners, weights[:, None, None] * terms[:, :, None] * terms[:, None], count)


def _turn(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Multiply n matrices (n, a, b) with a vector each, (n, b)."""
    return (matrices @ vectors[:, :, None])[:, :, 0]


def _by_footprint(surface: Surface, points: FloatArray, starts: IntArray, footprint_m: float) -> _Found:
    count, patches = len(points), _collect(surface, starts, FOOTPRINT_STEPS, points, footprint_m)
    of, off = patches.owners, surface.vertices[patches.corners] - points[patches.owners]
    distance = np.linalg.norm(off, axis=1) / footprint_m
    weights = np.maximum(1.0 - distance**2, 0.0) ** 2 * patches.areas / footprint_m**2
    start, used, total = surface.normals[starts], np.bincount(of, distance < 1.0, count), np.bincount(of, weights, count)
    ridge = (1e-6 * total + 1e-12)[:, None, None]

    def fit(terms: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the unknowns (n, d) and their matrices."""
        matrix = _products(of, weights, terms, count) + ridge * np.eye(terms.shape[1])
        return _solve(matrix, _sums(of, (weights * values)[:, None] * terms, count)), matrix

    def fit_about(about: FloatArray) -> tuple[FloatArray, ...]:
        """Fit heights over the planes across `about`: new normals, axes, places, heights, terms, unknowns, matrices."""
        across = orthonormal_pair(about)
        x, z = _turn(across[of], off) / footprint_m, np.sum(off * about[of], axis=1) / footprint_m
        terms = np.c_[np.ones(len(x)), x, _bend_terms(x)]
        fitted, matrix = fit(terms, z)
        normals = about - np.einsum("na,nab->nb", fitted[:, 1:3], across)
        return normals / np.linalg.norm(normals, axis=1, keepdims=True), across, x, z, terms, fitted, matrix

    # A second time, about the first normal.
    normals, across, x, z, terms, fitted, matrix = fit_about(fit_about(start)[0])
    left = z - np.sum(terms * fitted[of], axis=1)
    squares = np.bincount(of, weights * left**2, count) / np.maximum(total, 1e-300) * used / np.maximum(used - 6.0, 1.0)
    inverse = np.linalg.inv(matrix)
    spread = (inverse @ _products(of, weights**2, terms, count) @ inverse)[:, 1:3, 1:3]
    variances = squares * np.trace(spread, axis1=1, axis2=2)
    # Where cubic terms turn the normal by more than the noise would, the part is no quadric: the border of a fillet.
    u, v = x.T
    more = np.c_[terms, u**3 / 6, u * u * v / 2, u * v * v / 2, v**3 / 6]
    turned = fit(more, left)[0][:, 1:3]
    variances = variances + np.maximum(np.sum(turned**2, axis=1) - CUBIC_BY_NOISE * variances, 0.0)
    good = (used >= FOOTPRINT_CORNERS) & (np.sum(normals * start, axis=1) > np.cos(PATCH_MAX_ANGLE_RAD))
    bends = across.transpose(0, 2, 1) @ _as_matrix(fitted[:, 3:] / footprint_m) @ across
    return _Found(normals, np.where(good, variances, np.inf), bends)
