"""Outward normals of the smooth part that a mesh stands for, over the footprint of a taxel.

A triangle of a mesh is flat, so its normal differs from the part's by up to half the angle between neighbours: on a coarse mesh
the normals of taxels side by side jump. The corners of the triangles are points of the part. Around a point p on the mesh, let
n be a first normal (the triangle's), u and v two axes across it, and z the height along it, all from p and divided by the reach
h of the patch. The corners of the patch are fitted by the quadric

    z = c + a . (u, v) + (1/2) (u, v) Q (u, v)'

in weighted least squares; its normal at p is n - a, made unit. The fit is repeated once about that normal. Long strips, as CAD
makes of cylinders, have corners at their ends only, which tell no slope from a bend. So the slope of each triangle at its
centre, a + Q (u, v), is fitted, too, with a small weight: it is less exact than the corners.

A patch holds the triangles within the footprint, and the nearest ones beyond it until there are enough corners. It ends at
edges that are sharper than `SHARP_EDGE_MIN_ANGLE_RAD`, so a crease stays a crease, and the inner face of a thin wall is never
part of it.

The standard deviation of a normal is an angle, of two shares. A part that is no quadric turns the fit: its misses
at the corners turn a, and are taken as one error, since corners side by side are missed alike. And with the position's
covariance S across the normal, the normal turns by Q/h times the shift: its variance is trace(Q S Q') / h^2.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np

from skincal.geometry import FloatArray, IntArray, orthonormal_pair
from skincal.mesh.surface import Surface, cached_per_surface, neighbours

SHARP_EDGE_MIN_ANGLE_RAD = np.radians(40.0)
"""rad. Triangles that meet at a larger angle are faces of an edge; at a smaller one they are a coarse mesh of a round part."""
PATCH_MIN_CORNERS = 12
"""Corners of a patch, if the part has them: twice the six unknowns of the quadric."""
PATCH_MAX_TRIANGLES = 400
"""Triangles of a patch: more of them, on a very fine mesh, change no digit that counts."""
SLOPE_WEIGHT = 0.05
"""Of a triangle's slope next to a corner's height. Neighbouring slopes err in opposite directions by a third of their step."""
QUADRIC_FITS = 2
"""Fits about the normal of the one before: the second one starts within a degree."""
QUADRIC_UNKNOWNS = 6
DISTANCE_DECIMALS = 9
"""Nanometres: triangles equally far away come in the order of the mesh, however the part is turned."""


class SmoothNormals(NamedTuple):
    """Normals at n points on a surface."""

    normals: FloatArray
    """(n, 3) float, unit, outward."""
    sd: FloatArray
    """(n,) float, rad: standard deviation of the angle; NaN where there were too few corners to tell."""


def smooth_normals(
    surface: Surface, points: FloatArray, triangles: IntArray, footprint_m: float, covariances: FloatArray | None = None
) -> SmoothNormals:
    """Find the outward normals of the smooth part at points on its mesh.

    Parameters
    ----------
    points : (n, 3) float, metres, link frame
    triangles : (n,) int, the triangle that carries each point
    footprint_m : radius of a taxel's footprint, metres
    covariances : (n, 3, 3) float, m^2, of the points; `None` for exact points
    """
    ways = _smooth_ways(surface)
    normals, sd = np.empty((len(points), 3)), np.empty(len(points))
    for row, (point, triangle) in enumerate(zip(points, triangles.tolist(), strict=True)):
        patch = _patch_around(surface, ways, point, triangle, footprint_m)
        covariance = np.zeros((3, 3)) if covariances is None else covariances[row]
        normals[row], sd[row] = _normal_of_quadric(patch, surface.normals[triangle], covariance)
    return SmoothNormals(normals, sd)


class _Patch(NamedTuple):
    """Corners and triangles around a point, relative to it, metres. A weight falls with the distance over the footprint."""

    corners: FloatArray
    """(k, 3) float."""
    corner_weights: FloatArray
    """(k,) float, of the nearest triangle with that corner."""
    centres: FloatArray
    """(m, 3) float, of the triangles."""
    facets: FloatArray
    """(m, 3) float, their normals."""
    weights: FloatArray
    """(m,) float, of the triangles."""


@cached_per_surface
def _smooth_ways(surface: Surface) -> list[list[int]]:
    """List for each triangle the neighbours that it meets at a blunt edge."""
    sides = neighbours(surface.triangles)
    beside = np.where(sides >= 0, sides // 3, -1)
    cosines = np.einsum("ik,ijk->ij", surface.normals, surface.normals[beside])
    is_smooth = (beside >= 0) & (cosines > np.cos(SHARP_EDGE_MIN_ANGLE_RAD))
    return [row[smooth].tolist() for row, smooth in zip(beside, is_smooth, strict=True)]


def _patch_around(surface: Surface, ways: list[list[int]], point: FloatArray, start: int, footprint_m: float) -> _Patch:
    """Collect the triangles around a point, nearest ones first."""
    seen, waiting = {start}, [(0.0, start)]
    corners, used = dict[int, float](), list[tuple[float, int]]()
    while waiting and len(used) < PATCH_MAX_TRIANGLES:
        if waiting[0][0] > footprint_m and len(corners) >= PATCH_MIN_CORNERS:
            break
        distance, triangle = heapq.heappop(waiting)
        used.append((1.0 / (1.0 + (distance / footprint_m) ** 2), triangle))
        for corner in surface.triangles[triangle].tolist():
            corners.setdefault(corner, used[-1][0])
        for other in ways[triangle]:
            if other not in seen:
                seen.add(other)
                heapq.heappush(waiting, (round(_distance_to_sides(surface.corners[other], point), DISTANCE_DECIMALS), other))
    rows = [triangle for _, triangle in used]
    return _Patch(
        surface.vertices[list(corners)] - point,
        np.array(list(corners.values())),
        surface.corners[rows].mean(axis=1) - point,
        surface.normals[rows],
        np.array([weight for weight, _ in used]),
    )


def _distance_to_sides(corners: FloatArray, point: FloatArray) -> float:
    """Compute the distance from a point to the nearest side of a triangle, `corners` (3, 3)."""
    sides = corners[[1, 2, 0]] - corners
    offsets = point - corners
    along = np.clip(np.einsum("ij,ij->i", offsets, sides) / np.einsum("ij,ij->i", sides, sides), 0.0, 1.0)
    return float(np.linalg.norm(offsets - along[:, None] * sides, axis=1).min())


def _normal_of_quadric(patch: _Patch, normal: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float]:
    """Fit a quadric to a patch; return its outward normal at the point, unit, and its standard deviation, rad."""
    reach = float(np.linalg.norm(patch.corners, axis=1).max())
    first, sd = normal, np.nan
    for _ in range(QUADRIC_FITS):
        across = orthonormal_pair(normal[None])[0]
        rows, values = _quadric_rows(patch, across, normal, reach)
        fitted, _, rank, _ = np.linalg.lstsq(rows, values)
        if rank < QUADRIC_UNKNOWNS:
            break
        normal = normal - fitted[1] * across[0] - fitted[2] * across[1]
        normal = normal / np.linalg.norm(normal)
        bend = np.array([[fitted[3], fitted[4]], [fitted[4], fitted[5]]]) / reach
        misfit = float(np.sum((rows @ fitted - values)[: len(patch.corners)] ** 2))
        slopes = misfit * np.linalg.inv(rows.T @ rows)[1:3, 1:3]
        sd = float(np.sqrt(np.trace(slopes + bend @ (across @ covariance @ across.T) @ bend.T)))
    # A patch that folds over is no graph over its plane: there the triangle's own normal is the better answer.
    is_graph = np.isfinite(sd) and normal @ first > np.cos(SHARP_EDGE_MIN_ANGLE_RAD)
    return (normal, sd) if is_graph else (first, float(np.nan))


def _quadric_rows(patch: _Patch, across: FloatArray, normal: FloatArray, reach: float) -> tuple[FloatArray, FloatArray]:
    """Set up the equations (n, 6) of c, a and Q (uu, uv, vv), and their right sides (n,)."""
    (u, v), z = across @ patch.corners.T / reach, patch.corners @ normal / reach
    one, none = np.ones_like(u), np.zeros(len(patch.weights))
    heights = patch.corner_weights[:, None] * np.stack([one, u, v, u * u / 2, u * v, v * v / 2], axis=1)
    (x, y), (slope_u, slope_v) = across @ patch.centres.T / reach, -(across @ patch.facets.T) / (patch.facets @ normal)
    weights = SLOPE_WEIGHT * patch.weights
    one = np.ones_like(x)
    along_u = weights[:, None] * np.stack([none, one, none, x, y, none], axis=1)
    along_v = weights[:, None] * np.stack([none, none, one, none, x, y], axis=1)
    values = np.concatenate([patch.corner_weights * z, weights * slope_u, weights * slope_v])
    return np.concatenate([heights, along_u, along_v]), values
