"""A scale bar and the link's axes, drawn flat over the picture."""

from __future__ import annotations

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D, vtkRenderer, vtkTextActor

from app.scene3d.camera import Sight
from app.scene3d.shapes import Layer, cells, written
from app.scene3d.static_scene import Look, unit
from skincal.geometry.arrays import FloatArray

EDGE = 26
"""Pixels between the hints and the edge of the picture."""
ARM = 30
"""Pixels, length of an axis that lies in the picture's plane."""
BAR = 120.0
"""Pixels, longest scale bar."""
LETTERS = ("x", "y", "z")


class HintsLayer(Layer):
    """The scale in millimetres at the lower right, the link's axes at the lower left."""

    name = "hints"

    def __init__(self, renderer: vtkRenderer) -> None:
        self._xy = np.zeros((12, 3), dtype=np.float32)
        points = vtkPoints()
        points.SetData(numpy_to_vtk(self._xy))
        self._data = vtkPolyData()
        self._data.SetPoints(points)
        self._data.SetLines(cells(np.arange(12).reshape(-1, 2)))
        mapper = vtkPolyDataMapper2D()
        mapper.SetInputData(self._data)
        self.lines = vtkActor2D()
        self.lines.SetMapper(mapper)
        self.lines.GetProperty().SetLineWidth(2.0)
        self.texts = [written(vtkTextActor(), letter) for letter in LETTERS]
        self.length = written(vtkTextActor())
        self._sight: Sight | None = None
        for actor in (self.lines, *self.texts, self.length):
            renderer.AddViewProp(actor)

    def set_colours(self, look: Look) -> None:
        """Take the colours of a theme."""
        self.lines.GetProperty().SetColor(*unit(look.faint))
        for text in (*self.texts, self.length):
            text.GetTextProperty().SetColor(*unit(look.faint))

    def fit_to(self, sight: Sight) -> None:
        """Draw the axes as they lie in the picture, and a bar of a round length."""
        if sight.same(self._sight):
            return
        self._sight = sight
        self._xy[:6, :2] = self._axes(sight)
        self._xy[6:, :2] = self._bar(sight)
        self._data.GetPoints().GetData().Modified()
        self._data.GetPoints().Modified()

    def _axes(self, sight: Sight) -> FloatArray:
        turned = np.stack([sight.eye.right, sight.eye.up], axis=1)
        middle = np.full(2, EDGE + ARM)
        for text, direction in zip(self.texts, turned, strict=True):
            text.SetPosition(*(middle + direction * ARM * 1.3))
        return np.stack([np.tile(middle, (3, 1)), middle + ARM * turned], axis=1).reshape(6, 2)

    def _bar(self, sight: Sight) -> FloatArray:
        length_mm = round_below(BAR / sight.scale * 1e3)
        right, low = sight.size[0] - EDGE, EDGE
        left, tick = right - length_mm * 1e-3 * sight.scale, 5
        self.length.SetInput(f"{length_mm:g} mm")
        self.length.SetPosition((left + right) / 2, low + 14)
        ends = [[(end, low - tick), (end, low + tick)] for end in (left, right)]
        return np.array([(left, low), (right, low), *ends[0], *ends[1]])


def round_below(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `value`."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-9)))
