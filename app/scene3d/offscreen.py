"""Pictures without a window. Imports no Qt."""

from __future__ import annotations

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkUnsignedCharArray

from app.scene3d.mesh_actors import window_of
from app.scene3d.pyvista_import import import_plotter
from app.scene3d.scene_renderer import PLOTTER_SHAPE


def make_plotter(size: tuple[int, int]) -> pv.Plotter:
    """Make a plotter that is never on a screen, for a `SceneRenderer`; `size` is in pixels."""
    import_plotter()
    plotter = pv.Plotter(off_screen=True, shape=PLOTTER_SHAPE, border=False, lighting="none", window_size=list(size))
    # Software OpenGL pays for every sample of every pixel: four of them make a picture take 2.5 times as long.
    window_of(plotter).SetMultiSamples(0)
    return plotter


def draw(plotter: pv.BasePlotter) -> NDArray[np.uint8]:
    """Return a new picture, (height, width, 4) uint8, first row lowest; valid until the next call.

    The context belongs to the thread that drew last. VTK's `Render` leaves Python's other threads alone.
    """
    window, pixels = window_of(plotter), vtkUnsignedCharArray()
    window.Render()
    width, height = window.GetSize()
    window.GetRGBACharPixelData(0, 0, width - 1, height - 1, 0, pixels)  # pyright: ignore[reportArgumentType]
    return vtk_to_numpy(pixels).reshape(height, width, 4)
