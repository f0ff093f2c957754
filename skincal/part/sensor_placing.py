"""Poses of a force/torque sensor on a part without a URDF: by three points of its flange, by numbers, or under the part."""

from __future__ import annotations

import numpy as np

from skincal.geometry import FloatArray, tangent_axes
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.words.units import millimetres

FLANGE_POINTS_MIN_TRIANGLE_HEIGHT_M = 0.002
"""m. Height of the triangle of the three points: flatter ones give no plane."""
EDGE_IF_MEAN_NORMAL_SHORTER_THAN = 0.95
"""Length of the mean of unit normals around a corner: 0.95 at an edge of 36 degrees."""
SNAP_TO_EDGE_DISTANCE_OVER_PART_SIZE = 0.04
"""Of the part's longest side: a click this near to an edge means the edge."""
BOTTOM_FACE_HEIGHT_OVER_PART_HEIGHT = 0.02
"""Of the part's height: vertices this near to the lowest one are its bottom face."""


def pose_on_flange(points: FloatArray, part_centre: FloatArray) -> FloatArray:
    """Compute the sensor's pose (4, 4), metres, from three points (3, 3) on the rim of its round flange.

    The origin is the centre of the circle through them, z is across it and points to the part, x points to the first one.

    Raises InputError: the points are nearly on a line.
    """
    a, b, c = points
    u, v = b - a, c - a
    normal = np.cross(u, v)
    longest = max(float(np.linalg.norm(u)), float(np.linalg.norm(v)), float(np.linalg.norm(c - b)))
    height = float(np.linalg.norm(normal)) / max(longest, 1e-12)
    if height < FLANGE_POINTS_MIN_TRIANGLE_HEIGHT_M:
        raise InputError(
            f"The three points are within {millimetres(height)} of a line; pick them far apart around the rim of the flange."
        )
    area = float(normal @ normal)
    centre = a + (np.cross(normal, u) * float(v @ v) + np.cross(v, normal) * float(u @ u)) / (2.0 * area)
    z = normal / np.linalg.norm(normal)
    z = z if float(z @ (part_centre - centre)) >= 0.0 else -z
    return _pose(centre, z, a - centre)


def nearest_edge_point(surface: Surface, point: FloatArray) -> FloatArray:
    """Find the corner on a sharp edge that is nearest to a point, (3,) metres; the same point if no edge is near.

    A click misses the rim of a flange by some pixels, which would tilt the sensor by 15 degrees.
    """
    count = len(surface.vertices)
    corners = surface.triangles.ravel()
    normals = np.repeat(surface.normals, 3, axis=0)
    sums = np.stack([np.bincount(corners, normals[:, axis], count) for axis in range(3)], axis=1)
    mean_lengths = np.linalg.norm(sums, axis=1) / np.maximum(np.bincount(corners, minlength=count), 1)
    sharp = surface.vertices[mean_lengths < EDGE_IF_MEAN_NORMAL_SHORTER_THAN]
    distances = np.linalg.norm(sharp - point, axis=1)
    reach = SNAP_TO_EDGE_DISTANCE_OVER_PART_SIZE * float(np.ptp(surface.vertices, axis=0).max())
    return sharp[distances.argmin()] if len(sharp) and distances.min() <= reach else point


def pose_along(origin: FloatArray, z: FloatArray) -> FloatArray:
    """Compute the pose (4, 4), metres, of a sensor at `origin` (3,) whose z axis points along `z` (3,).

    x is as near to the link's x axis as it can be; see `turned_pose`. Raises InputError: the direction is zero.
    """
    length = float(np.linalg.norm(z))
    if not length > 0.0:
        raise InputError("The direction of the sensor's z axis is 0 0 0; enter a direction, such as 0 0 1.")
    return _pose(origin, z / length, np.array([1.0, 0.0, 0.0]))


def pose_under(surface: Surface, depth: float) -> FloatArray:
    """Compute the pose (4, 4), metres, of a sensor on which the part stands: z up, in the middle of the bottom face.

    `depth` is the distance from the bottom face down to the sensor's origin, metres.
    """
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    bottom = surface.vertices[surface.vertices[:, 2] <= low[2] + BOTTOM_FACE_HEIGHT_OVER_PART_HEIGHT * (high[2] - low[2])]
    middle = (bottom.min(axis=0) + bottom.max(axis=0)) / 2.0
    pose = np.eye(4)
    pose[:3, 3] = middle[0], middle[1], low[2] - depth
    return pose


def turned_pose(pose: FloatArray, axis: int, quarters: int = 1) -> FloatArray:
    """Turn a pose (4, 4) by quarter turns about its own x, y or z axis (0, 1, 2); its origin stays."""
    turned = pose.copy()
    first, second = (axis + 1) % 3, (axis + 2) % 3
    for _ in range(quarters % 4):
        turned[:3, first], turned[:3, second] = turned[:3, second].copy(), -turned[:3, first].copy()
    return turned


def _pose(origin: FloatArray, z: FloatArray, x: FloatArray) -> FloatArray:
    across, other = tangent_axes(x / max(float(np.linalg.norm(x)), 1e-12), z, fallback=True)
    pose = np.eye(4)
    pose[:3] = np.column_stack([across, other, z, origin])
    return pose
