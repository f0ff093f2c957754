"""Where a line meets the part: a force axis, or a line of sight.

For a line p + s d and a triangle with corners a, b, c wound outward, project everything along d: the line hits the triangle
if its point lies within the projected triangle, and enters there (d . n < 0) if the projection is wound clockwise.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry.arrays import FloatArray
from skincal.mesh.surface import Surface


def entry_points(surface: Surface, point: FloatArray, direction: FloatArray) -> FloatArray:
    """Return every point where a line enters the surface, in the line's order.

    Parameters
    ----------
    point : (3,) float, metres, on the line
    direction : (3,) float, unit, the way the force pushes

    Returns
    -------
    (k, 3) float, metres; empty where the line misses, or meets inner sides only
    """
    across = _across(direction)
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


def _across(direction: FloatArray) -> FloatArray:
    """(2, 3) unit vectors u, v across `direction` with u x v = direction."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(helper, direction)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def _area(p: FloatArray, q: FloatArray) -> FloatArray:
    return p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]


def contact_point(surface: Surface | None, point: FloatArray, direction: FloatArray, near: FloatArray) -> FloatArray:
    """Return where a poke touches: the entry nearest to `near`, else the axis's own point nearest to it.

    Parameters
    ----------
    point, direction : (3,) float, metres and unit: the force axis
    near : (3,) float, metres: where the taxels are that answered, or the middle of the part

    Returns
    -------
    (3,) float, metres
    """
    entries = np.empty((0, 3)) if surface is None else entry_points(surface, point, direction)
    if len(entries):
        return entries[np.argmin(np.linalg.norm(entries - near, axis=1))]
    return point + direction * float(direction @ (near - point))


def skin_point(surface: Surface | None, place: FloatArray, normal: FloatArray) -> FloatArray:
    """Return the skin's point over or under a believed place, (3,) float, metres; the place itself without a surface."""
    return contact_point(surface, place, -normal, place)


def seen_point(surface: Surface, place: FloatArray, direction: FloatArray) -> FloatArray | None:
    """Return where a line of sight meets the outer side of a part, exactly; None where it misses, or sees an inner side first.

    Parameters
    ----------
    place, direction : (3,) float, metres and unit: where the eye is, and which way it looks

    Returns
    -------
    (3,) float, metres
    """
    outer, inner = (_first(entry_points(surface, place, way), place, direction) for way in (direction, -direction))
    if outer is None or (inner is not None and (inner - place) @ direction < (outer - place) @ direction):
        return None
    return outer


def _first(points: FloatArray, place: FloatArray, direction: FloatArray) -> FloatArray | None:
    """Return which of (n, 3) points on a line is nearest before an eye there; None where none is before it."""
    away = (points - place) @ direction
    away[away <= 0.0] = np.inf
    return points[away.argmin()] if np.isfinite(away).any() else None
