"""The surface's point nearest to a target in a metric, exactly: the optimum over all triangles (paper, II-B).

The metric is given by its root: minimise |root p - offset|^2, so nothing is squared. Each triangle lies in a ball of
centre c and radius r, so |root p - offset| >= |root c - offset| - |root|_2 r for all its points: whatever cannot be
the best by that bound is left out, the rest is solved in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.readings import FloatArray, IntArray
from skincal.surface.closest import closest_in_triangles
from skincal.surface.mesh import Surface

GRAZING = 1e-12
"""A triangle faces a push when push . normal is below minus this (both unit): what is tangent to the last digit is out,
however the rounding falls."""
TIE = 1e-12
"""m. Points whose distances in the metric, over its largest stretch, differ by less are equally near: rounding."""
_SAME_DEPTH = 1e-9
"""m. Equally near points whose depth along the push differs by less are one place."""
_SEEDS = 32
"""Triangles solved first to tighten the bound where many are left."""
_NO_RANK = 1e-15
"""Eigenvalues of a metric below this share of the largest are zero: rounding of the sums that made it."""


@dataclass(frozen=True, slots=True, eq=False)
class Nearest:
    """The best point of a surface."""

    point: FloatArray
    """(3,) float, metres."""
    triangle: int
    value: float
    """(p - t)' M (p - t) there, or |root p - offset|^2."""


def nearest_in_metric(
    surface: Surface, metric: FloatArray, target: FloatArray, push: FloatArray | None = None
) -> Nearest | None:
    """Minimise (p - t)' M (p - t) over the surface's points p, exactly.

    Parameters
    ----------
    metric : (3, 3) float, M: symmetric, positive semi-definite, of any rank
    target : (3,) float, t, metres
    push : (3,) float or None; where given, only triangles with push . normal < 0 count

    Returns
    -------
    Among equally near points the one first met by the push, then the triangle that faces it most, then the lowest
    index; None where no triangle faces the push.
    """
    values, axes = np.linalg.eigh(metric)
    values = np.where(values > _NO_RANK * values[-1], values, 0.0)
    root = np.sqrt(values)[:, None] * axes.T
    return nearest_to_rows(surface, root, root @ target, push)


def nearest_to_rows(surface: Surface, root: FloatArray, offset: FloatArray, push: FloatArray | None = None) -> Nearest | None:
    """Minimise |root p - offset|^2 over the surface's points p, exactly; else as `nearest_in_metric`.

    Parameters
    ----------
    root : (3, 3) float, of any rank
    offset : (3,) float
    push : (3,) float or None
    """
    allowed = None if push is None else facing(surface, push)
    if allowed is not None and not allowed.any():
        return None
    stretch = float(np.linalg.norm(root, 2))
    left = _candidates(surface, root, offset, allowed, stretch)
    shares, squared = _solve(surface, root, offset, left)
    distance = np.sqrt(squared)
    tied = np.flatnonzero(distance <= distance.min() + TIE * stretch)
    points = (shares[tied, :, None] * surface.corners[left[tied]]).sum(axis=1)
    chosen = _first_met(points, surface.normals[left[tied]], push)
    return Nearest(points[chosen], int(left[tied[chosen]]), float(squared[tied[chosen]]))


def facing(surface: Surface, push: FloatArray) -> NDArray[np.bool_]:
    """Return (nt,) True for the triangles that `push` (3,) can act on: push . normal < 0."""
    return surface.normals @ (push / np.linalg.norm(push)) < -GRAZING


def _solve(surface: Surface, root: FloatArray, offset: FloatArray, which: IntArray) -> tuple[FloatArray, FloatArray]:
    return closest_in_triangles(surface.corners[which] @ root.T - offset)


def _candidates(
    surface: Surface, root: FloatArray, offset: FloatArray, allowed: NDArray[np.bool_] | None, stretch: float
) -> IntArray:
    """Return the triangles, ascending, that may hold the minimum or tie with it."""
    image = root @ surface.centres - offset[:, None]
    distance = np.sqrt(image[0] * image[0] + image[1] * image[1] + image[2] * image[2])
    if allowed is not None:
        distance = np.where(allowed, distance, np.inf)
    lower = distance - stretch * surface.radii
    # A centre is a point of its triangle, so its distance is a bound from above.
    upper = float(distance.min())
    left = np.flatnonzero(lower <= upper + 2 * TIE * stretch)
    if len(left) > 2 * _SEEDS:
        seeds = left[np.argpartition(lower[left], _SEEDS)[:_SEEDS]]
        upper = min(upper, float(np.sqrt(_solve(surface, root, offset, seeds)[1].min())))
        left = left[lower[left] <= upper + 2 * TIE * stretch]
    return left


def _first_met(points: FloatArray, normals: FloatArray, push: FloatArray | None) -> int:
    """Return the index of the point that the push meets first; of the normal most against it, where they are one place."""
    if push is None or len(points) == 1:
        return 0
    along = push / np.linalg.norm(push)
    depth = points @ along
    first = np.flatnonzero(depth <= depth.min() + _SAME_DEPTH)
    against = normals[first] @ along
    # The lowest index wins among equals; ties of normals are equal to rounding.
    return int(first[np.flatnonzero(against <= against.min() + _SAME_DEPTH)[0]])


def nearest_points(surface: Surface, points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Find for each of `points` (n, 3), metres, the surface's nearest point, exactly.

    Candidates come from a search tree of centres. A triangle whose ball has radius r is nearer than the best so far only
    if its centre is nearer than that plus r; triangles are searched by octaves of r, so that few large ones do not make
    the bound useless for all.

    Returns
    -------
    nearest : (n, 3) float, metres
    triangles : (n,) int
    """
    # Imported here: it takes 0.3 s, and most runs of the program never ask.
    spatial: Any = import_module("scipy.spatial")
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    best = np.full(len(points), np.inf)
    nearest, triangles = np.zeros_like(points), np.zeros(len(points), dtype=np.int64)
    octave = np.floor(np.log2(surface.radii / surface.radii.min())).astype(np.int64)
    for size in np.unique(octave):
        members = np.flatnonzero(octave == size)
        tree = spatial.cKDTree(surface.centres[:, members].T)
        reach = float(surface.radii[members].max())
        left, count = np.arange(len(points)), 8
        while left.size:
            count = min(count, len(members))
            away, found = tree.query(points[left], np.arange(1, count + 1))
            for part in range(0, len(left), max(1, _AT_ONCE // count)):
                rows = slice(part, part + max(1, _AT_ONCE // count))
                _improve(surface, points, left[rows], members[found[rows]], best, nearest, triangles)
            uncertain = away[:, -1] - reach < np.sqrt(best[left])
            left = left[uncertain] if count < len(members) else left[:0]
            count *= 4
    return nearest, triangles


_AT_ONCE = 100_000
"""Triangles solved at once: 20 MB of intermediate numbers."""


def _improve(
    surface: Surface,
    points: FloatArray,
    which: IntArray,
    found: IntArray,
    best: FloatArray,
    nearest: FloatArray,
    triangles: IntArray,
) -> None:
    """Try the triangles `found` (m, k) for the points `which` (m,), and keep what is nearer."""
    corners = surface.corners[found]
    shares, squared = closest_in_triangles((corners - points[which][:, None, None]).reshape(-1, 3, 3))
    squared, shares = squared.reshape(found.shape), shares.reshape(*found.shape, 3)
    row, winner = np.arange(len(which)), squared.argmin(axis=1)
    nearer = squared[row, winner] < best[which]
    row, winner, which = row[nearer], winner[nearer], which[nearer]
    best[which] = squared[row, winner]
    triangles[which] = found[row, winner]
    nearest[which] = (shares[row, winner, :, None] * corners[row, winner]).sum(axis=1)
