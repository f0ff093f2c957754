"""Sets of places over each other: a dot for each taxel and set, and arrows from one set to another.

Everything is drawn before the part: a difference that goes into the part must be seen along its whole length. What lies on
the part's far side is left out instead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkRenderer

from app.scene3d.camera import Sight
from app.scene3d.estimates import FAR_SIDE
from app.scene3d.shapes import Dots, Layer, Segments
from app.scene3d.static_scene import DARK, ColourArray, Comparison, Look, StaticScene, Tint, View3DState
from skincal.geometry.arrays import FloatArray

DOT = 1.5e-3
"""m. Diameter of a dot: half of an estimate's ball, so that dots of several sets are seen beside each other."""
DOT_PIXELS = (4.0, 9.0)
"""Smallest and largest dot on the screen."""
HEAD = 2.4e-3
"""m. Length of each of the two strokes of an arrow's head at most."""
HEAD_SHARE = 0.4
"""Of an arrow's length at most, so that a short arrow is not all head."""
SPREAD = float(np.radians(28.0))
"""rad. Angle of these strokes with the arrow."""
ALONG = 1e-6
"""Sine. An arrow that the camera looks along has no head: it is a dot."""


class CompareLayer(Layer):
    """The dots and the arrows of a comparison; nothing while nothing is compared."""

    name = "compare"

    def __init__(self, renderer: vtkRenderer, static: StaticScene) -> None:
        self.dots = Dots(pixels=DOT_PIXELS[1])
        self.arrows = Segments(pixels=2.0)
        self.dots.actor.GetProperty().SetRenderPointsAsSpheres(True)
        self._look = DARK
        self._shown: Comparison | None = None
        self._sight: Sight | None = None
        self._part = static.extent
        self._normals = static.skin_normals
        for shape in (self.arrows, self.dots):
            renderer.AddActor(shape.actor)

    def set_colours(self, look: Look) -> None:
        """Take the colours of a theme."""
        self._look = look
        if self._shown is not None:
            self._draw(self._shown)

    def show(self, state: View3DState) -> bool:
        """Show what is compared in a moment; return whether anything changed."""
        if state.comparison is self._shown:
            return False
        self._shown = state.comparison
        if self._shown is not None:
            self._draw(self._shown)
        else:
            self.dots.clear()
            self.arrows.clear()
        return True

    def fit_to(self, sight: Sight) -> None:
        """Keep the dots' size on the part, all before it, and the arrows' heads flat to the camera; leave out the far side."""
        if self._shown is None or sight.same(self._sight):
            return
        self._sight = sight
        self.dots.actor.GetProperty().SetPointSize(float(np.clip(DOT * sight.scale, *DOT_PIXELS)))
        self._draw(self._shown)

    def _draw(self, shown: Comparison) -> None:
        sight = self._sight
        if sight is None:
            return
        near = ~(self._normals @ sight.towards < FAR_SIDE)
        dots = [_known(cloud.places, near) for cloud in shown.clouds]
        tints = [np.tile(self._colour(cloud.tint), (len(places), 1)) for cloud, places in zip(shown.clouds, dots, strict=True)]
        self.dots.set(sight.bring_before(np.concatenate(dots), self._part), np.concatenate(tints))
        shafts = _known(shown.arrows.reshape(-1, 6), near).reshape(-1, 2, 3)
        strokes = np.concatenate([shafts, heads(shafts, sight.towards)])
        self.arrows.join(sight.bring_before(strokes, self._part), self._colour(Tint.TO))

    def _colour(self, tint: Tint) -> ColourArray:
        return np.array(self._look.tints[tint], np.uint8)


def _known(rows: FloatArray, near: NDArray[np.bool_]) -> FloatArray:
    return rows[near & np.isfinite(rows).all(axis=1)]


def heads(shafts: FloatArray, towards: FloatArray) -> FloatArray:
    """Return the strokes of the heads of arrows, flat to the camera.

    Parameters
    ----------
    shafts : (n, 2, 3) float, metres, each from its tail to its tip
    towards : (3,) float, to the camera

    Returns
    -------
    (k, 2, 3) float, metres, two strokes an arrow; none of one that the camera looks along
    """
    ways = shafts[:, 1] - shafts[:, 0]
    lengths = np.sqrt(np.sum(ways * ways, axis=1))
    sides = np.cross(ways, towards)
    widths = np.sqrt(np.sum(sides * sides, axis=1))
    seen = widths > ALONG * lengths
    along = ways[seen] / lengths[seen, None]
    across = sides[seen] / widths[seen, None]
    size = np.minimum(HEAD, HEAD_SHARE * lengths[seen])[:, None]
    tips = shafts[seen, 1]
    ends = [tips + size * (hand * np.sin(SPREAD) * across - np.cos(SPREAD) * along) for hand in (1.0, -1.0)]
    return np.concatenate([np.stack([end, tips], axis=1) for end in ends])
