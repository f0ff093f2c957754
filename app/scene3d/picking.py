"""Which taxel is under the mouse: points projected to the screen, no picker and no render."""

from __future__ import annotations

import numpy as np
from vtkmodules.vtkRenderingCore import vtkRenderer

from skincal.readings import FloatArray

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
