"""What is under the mouse: taxels projected to the screen, and the line of sight through the part; no picker and no render."""

from __future__ import annotations

import numpy as np
from vtkmodules.vtkRenderingCore import vtkRenderer

from app.scene3d.camera import eye_of
from app.scene3d.entry import entry_points
from skincal.geometry.arrays import FloatArray
from skincal.mesh.surface import Surface

REACH = 14.0
"""Pixels. A click this near to a ball means it: half a finger's width on a common screen."""


def project(renderer: vtkRenderer, points: FloatArray) -> FloatArray:
    """Return where points appear.

    Parameters
    ----------
    points : (n, 3) float, metres

    Returns
    -------
    (n, 3) float: x and y in pixels from the lower left, depth from -1 (near) to 1; outside of that, not in the picture
    """
    camera = renderer.GetActiveCamera()
    matrix = camera.GetCompositeProjectionTransformMatrix(renderer.GetTiledAspectRatio(), -1, 1)
    transform = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)])
    clip = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ transform.T
    normal = clip[:, :3] / np.where(clip[:, 3:] > 0, clip[:, 3:], np.nan)
    width, height = renderer.GetSize()
    return np.stack([(normal[:, 0] + 1) * width / 2, (normal[:, 1] + 1) * height / 2, normal[:, 2]], axis=1)


def nearest_at(screen: FloatArray, x: float, y: float, ball: float) -> int | None:
    """Return the row of the point that a click means.

    Parameters
    ----------
    screen : (n, 3) float, from `project`
    x, y : pixels from the lower left
    ball : pixels, radius of a drawn ball

    Returns
    -------
    The foremost of the balls that the click hits; else the nearest within `REACH`; else None.
    """
    away = np.hypot(screen[:, 0] - x, screen[:, 1] - y)
    away[~(np.abs(screen[:, 2]) <= 1.0)] = np.inf
    hit = np.flatnonzero(away <= ball)
    if len(hit):
        return int(hit[np.argmin(screen[hit, 2])])
    if len(away) == 0 or not away.min() <= REACH:
        return None
    return int(np.argmin(away))


def ray(renderer: vtkRenderer, x: float, y: float) -> tuple[FloatArray, FloatArray]:
    """Return the line of sight through a place of the picture: the camera's place, (3,) metres, and (3,) unit, away from it.

    Parameters
    ----------
    x, y : pixels from the lower left
    """
    camera = renderer.GetActiveCamera()
    width, height = renderer.GetSize()
    eye, ahead = eye_of(camera), np.array(camera.GetDirectionOfProjection())
    half = np.tan(np.radians(camera.GetViewAngle() / 2))
    aside = half * ((2 * x - width) / height * eye.right + (2 * y / height - 1) * eye.up)
    direction = ahead + aside
    return np.array(camera.GetPosition()), direction / np.linalg.norm(direction)


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
    """Return the one of (n, 3) points on a line that is nearest before an eye there; None where none is before it."""
    away = (points - place) @ direction
    away[away <= 0.0] = np.inf
    return points[away.argmin()] if np.isfinite(away).any() else None
