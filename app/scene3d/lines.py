"""Points of lines on the skin, for the 3D view and the small pictures. Numbers only; imports no VTK."""

from __future__ import annotations

import numpy as np

from skincal.geometry import FloatArray

DRAWN_TOOL_LENGTH_M = 0.035  # m, of a drawn tool: arrow of the target, stick of the dial, force axis outside the part


def tangents(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors across each normal, (n, 3) float each, that make a right-handed frame with it."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first: FloatArray = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)


def circles(centres: FloatArray, normals: FloatArray, radius: float, sides: int = 24) -> FloatArray:
    """Return the corners of regular polygons about `centres`, (n, 3), across `normals`, (n, 3) unit: (n, sides, 3), metres."""
    first, second = tangents(normals)
    turn = np.arange(sides)[:, None] * (2 * np.pi / sides)
    return centres[:, None] + radius * (np.cos(turn) * first[:, None] + np.sin(turn) * second[:, None])


def closed(corners: FloatArray) -> FloatArray:
    """Return the sides of closed lines, (..., n, 2, 3), from their corners, (..., n, 3)."""
    return np.stack([corners, np.roll(corners, -1, axis=-2)], axis=-2)


def rings(centres: FloatArray, normals: FloatArray, radius: float, sides: int = 24) -> FloatArray:
    """Return the sides of `circles`: (n, sides, 2, 3) segments, metres."""
    return closed(circles(centres, normals, radius, sides))


def crosses(centres: FloatArray, normals: FloatArray, radius: float) -> FloatArray:
    """Return two crossing strokes across each normal, (n, 2, 2, 3) float, as `rings`."""
    strokes = np.stack(tangents(normals), axis=1) * radius
    return np.stack([centres[:, None] - strokes, centres[:, None] + strokes], axis=2)


def cone_rim(direction: FloatArray, angle: float, sides: int = 36) -> FloatArray:
    """Return (sides, 3) float, unit: the directions at an angle, rad, from `direction`, (3,) float, unit."""
    return circles(np.cos(angle) * direction[None], direction[None], float(np.sin(angle)), sides)[0]
