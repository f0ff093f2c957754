"""Pictures without a window, and a session's picture for the headless commands. Imports no Qt."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from PIL import Image
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkUnsignedCharArray

from app.scene3d.drawing_probe import choose_offscreen
from app.scene3d.mesh_actors import window_of
from app.scene3d.pyvista_import import import_plotter
from app.scene3d.scene_renderer import PLOTTER_SHAPE, SceneRenderer
from app.scene3d.scene_state import LIGHT, StaticScene
from app.state.view_state import state_at_rest
from skincal.files.atomic import write_atomically
from skincal.part.part import Part
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Method


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


def picture(part: Part, snapshot: Snapshot, method: Method, path: Path, size: tuple[int, int] = (1280, 800)) -> None:
    """Draw what the window's 3D view shows of a session on a part, as a PNG file; `size` is in pixels.

    Raises
    ------
    InputError
        There is nothing to draw with here (names the packages), or the file cannot be written.
    """
    choose_offscreen()
    channels = np.array([estimate.channel for estimate in snapshot.estimates.get(method, ())], dtype=np.int64)
    plotter = make_plotter(size)
    renderer = SceneRenderer(plotter, StaticScene(replace(part, channels=channels)), LIGHT)
    try:
        renderer.show(state_at_rest(part.scene, snapshot, method))
        renderer.fit()
        content = io.BytesIO()
        Image.fromarray(draw(plotter)[::-1, :, :3]).save(content, "png")
        write_atomically(path, content.getvalue())
    finally:
        renderer.close()
        plotter.close()
