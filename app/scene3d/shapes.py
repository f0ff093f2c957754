"""A layer of the picture, and what layers are made of: points, line segments and triangles whose arrays change in place.

Each shape is one polydata, one mapper and one actor, made once. `set` writes into the arrays that VTK already holds
while the number of points stays, and swaps them otherwise; the actor stays in either case.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkBillboardTextActor3D, vtkPolyDataMapper, vtkProp, vtkProperty, vtkTextActor

from app.scene3d.camera import Sight
from app.scene3d.scene_state import DARK, ColourArray, Look, View3DState
from skincal.geometry import FloatArray, IntArray

HEAD_SHARE = 0.4
"""Of an arrow's length at most in a stroke of its head, so that a short arrow is not all head."""
SPREAD = float(np.radians(28.0))
"""rad. Angle of these strokes with the arrow."""
ALONG = 1e-6
"""Sine. A camera that is turned away by less looks along the arrow."""

Text = TypeVar("Text", vtkTextActor, vtkBillboardTextActor3D)


class Layer:
    """One kind of thing in the picture; its constructor makes what it draws."""

    name: ClassVar[str]
    """What the layer shows, in one word."""

    def __init__(self) -> None:
        self.look = DARK
        self.sight: Sight | None = None
        """From where the picture is seen; None before the first."""

    def props(self) -> Sequence[vtkProp]:
        """Return what goes into the renderer, in the order of drawing: its shapes."""
        return [shape.actor for shape in vars(self).values() if isinstance(shape, DrawnShape)]

    def parts(self) -> Mapping[str, Sequence[vtkProp]]:
        """Return what is switched on and off apart, by its name: the whole layer."""
        return {self.name: self.props()}

    def set_colours(self, look: Look) -> None:
        """Take the colours of a theme; called before the first `show`."""
        self.look = look
        self.draw()

    def show(self, state: View3DState) -> bool:  # noqa: ARG002
        """Change arrays in place for a moment of the session; return whether anything changed."""
        return False

    def fit_to(self, sight: Sight) -> None:
        """Fit what depends on the camera, before each picture."""
        if not sight.same(self.sight):
            self.sight = sight
            self.draw()

    def draw(self) -> None:
        """Write the arrays that depend on the theme or the camera."""


def cells(connectivity: IntArray) -> vtkCellArray:
    """Return the cells whose point indices are the rows of `connectivity`, (n, k) int."""
    count, size = connectivity.shape
    array = vtkCellArray()
    offsets = np.arange(0, count * size + 1, size, dtype=np.int64)
    array.SetData(numpy_to_vtkIdTypeArray(offsets, deep=True), numpy_to_vtkIdTypeArray(connectivity.ravel(), deep=True))
    return array


class DrawnShape(ABC):
    """Coloured points and the actor that draws them as a `vtkProperty` says; subclasses say how points form cells."""

    def __init__(self, **look: float) -> None:
        self.data = vtkPolyData()
        mapper = vtkPolyDataMapper(static=False)
        mapper.SetInputData(self.data)
        mapper.SetColorModeToDirectScalars()
        self.actor = vtkActor(mapper=mapper, property=vtkProperty(**look), visibility=False)
        self._points: NDArray[np.float32] = np.empty((0, 3), dtype=np.float32)
        self._colours: ColourArray = np.empty((0, 3), dtype=np.uint8)

    def set(self, points: FloatArray, colours: ColourArray) -> None:
        """Show other points, (n, 3) float, metres, in colours, (n, 3) uint8, or (3,) for all; n = 0 hides the shape."""
        if len(points) != len(self._points):
            self._allocate(len(points))
        self.actor.SetVisibility(len(points) > 0)
        if len(points) == 0:
            return
        self._points[:] = points
        self._colours[:] = colours
        # VTK sees no writing through numpy, and asks each of these by itself when it was changed last.
        self.data.GetPoints().GetData().Modified()
        self.data.GetPoints().Modified()
        self.data.GetPointData().GetScalars().Modified()
        self.data.Modified()

    def clear(self) -> None:
        """Show nothing."""
        self.set(np.empty((0, 3)), np.zeros(3, np.uint8))

    @abstractmethod
    def connect(self, count: int) -> None:
        """Make the cells for `count` points."""

    def _allocate(self, count: int) -> None:
        self._points = np.zeros((count, 3), dtype=np.float32)
        self._colours = np.zeros((count, 3), dtype=np.uint8)
        points = vtkPoints()
        # Not copied: what `set` writes into these arrays is what VTK draws, so the shape holds them as long as VTK does.
        points.SetData(numpy_to_vtk(self._points))
        self.data.SetPoints(points)
        self.data.GetPointData().SetScalars(numpy_to_vtk(self._colours))
        self.connect(count)


class Dots(DrawnShape):
    """Points drawn as flat dots of one size in pixels."""

    def __init__(self, pixels: float, **look: float) -> None:
        super().__init__(point_size=pixels, **({"lighting": False} | look))

    def connect(self, count: int) -> None:
        """One vertex a point."""
        self.data.SetVerts(cells(np.arange(count).reshape(-1, 1)))


class Balls(Dots):
    """Points drawn as lit balls of one size in pixels; a ball bulges towards the camera, a dot does not."""

    def __init__(self, pixels: float) -> None:
        super().__init__(pixels, lighting=True, render_points_as_spheres=True, ambient=0.35, diffuse=0.75)


class Segments(DrawnShape):
    """Line segments, two points each, not lit."""

    def __init__(self, pixels: float) -> None:
        super().__init__(line_width=pixels, lighting=False)

    def connect(self, count: int) -> None:
        """One segment a pair of points."""
        self.data.SetLines(cells(np.arange(count).reshape(-1, 2)))

    def join(self, ends: FloatArray, colours: ColourArray) -> None:
        """Show segments: `ends` are (n, 2, 3) float, metres, `colours` (n, 3) uint8, or (3,) for all."""
        self.set(ends.reshape(-1, 3), colours if colours.ndim == 1 else np.repeat(colours, 2, axis=0))


def closed(corners: FloatArray) -> FloatArray:
    """Return the sides of closed lines, (..., n, 2, 3), from their corners, (..., n, 3)."""
    return np.stack([corners, np.roll(corners, -1, axis=-2)], axis=-2)


def rings(centres: FloatArray, normals: FloatArray, radius: float, sides: int = 24) -> FloatArray:
    """Return circles about `centres`, (n, 3), across `normals`, (n, 3) unit, as segments, (n, sides, 2, 3); all in metres."""
    first, second = tangents(normals)
    turn = np.arange(sides + 1) * (2 * np.pi / sides)
    around = np.cos(turn)[:, None] * first[:, None] + np.sin(turn)[:, None] * second[:, None]
    corners = centres[:, None] + radius * around
    return np.stack([corners[:, :-1], corners[:, 1:]], axis=2)


def crosses(centres: FloatArray, normals: FloatArray, radius: float) -> FloatArray:
    """Return two crossing strokes across each normal, (n, 2, 2, 3) float, as `rings`."""
    first, second = tangents(normals)
    strokes = np.stack([first + second, first - second], axis=1) * (radius / np.sqrt(2))
    return np.stack([centres[:, None] - strokes, centres[:, None] + strokes], axis=2)


def heads(shafts: FloatArray, towards: FloatArray, longest: float) -> FloatArray:
    """Return the strokes of the heads of arrows, flat to the camera: (k, 2, 3) float, metres, two strokes an arrow.

    An arrow that the camera looks along is seen as a dot and has no head.

    Parameters
    ----------
    shafts : (n, 2, 3) float, metres, each from its tail to its tip
    towards : (3,) float, to the camera
    longest : metres, length of a stroke at most
    """
    ways = shafts[:, 1] - shafts[:, 0]
    lengths = np.sqrt(np.sum(ways * ways, axis=1))
    sides = np.cross(ways, towards)
    widths = np.sqrt(np.sum(sides * sides, axis=1))
    seen = widths > ALONG * lengths
    along = ways[seen] / lengths[seen, None]
    across = sides[seen] / widths[seen, None]
    size = np.minimum(longest, HEAD_SHARE * lengths[seen])[:, None]
    tips = shafts[seen, 1]
    ends = [tips + size * (hand * np.sin(SPREAD) * across - np.cos(SPREAD) * along) for hand in (1.0, -1.0)]
    return np.concatenate([np.stack([end, tips], axis=1) for end in ends])


def tangents(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors across each normal, (n, 3) float each, that make a right-handed frame with it."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first: FloatArray = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second: FloatArray = np.cross(normals, first)
    return first, second


def written(text: Text, words: str = "", letters: int = 14) -> Text:
    """Return a text of so many points, its middle at its position."""
    text.SetInput(words)
    style = text.GetTextProperty()
    style.SetFontSize(letters)
    style.SetJustificationToCentered()
    style.SetVerticalJustificationToCentered()
    return text
