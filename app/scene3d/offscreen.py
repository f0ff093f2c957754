"""Pictures without a window, and a session's picture for the headless commands. Imports no Qt."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkUnsignedCharArray
from vtkmodules.vtkIOImage import vtkPNGWriter
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter

from app.scene3d.drawing_probe import choose_offscreen
from app.scene3d.scene_state import LIGHT, StaticScene, View3DState
from app.scene3d.stage import Stage
from skincal.files.atomic import write_atomically
from skincal.mesh.lay import LaidSkin
from skincal.mesh.surface import Surface
from skincal.model.scene import Scene
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Method

NO_SAMPLES = 0
"""Software OpenGL pays for every sample of every pixel: four of them make a picture take 2.5 times as long."""


class HiddenWindow:
    """A VTK window that is never on a screen: draws one renderer of `size` pixels into an array.

    Its context belongs to the thread that drew last; `release` lets another thread draw. VTK's `Render` leaves Python's other
    threads alone.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.renderer = vtkRenderer()
        self._window = vtkRenderWindow(multi_samples=NO_SAMPLES, show_window=False, off_screen_rendering=True, size=size)
        self._window.AddRenderer(self.renderer)
        self._pixels = vtkUnsignedCharArray()

    def resize(self, size: tuple[int, int], density: float) -> None:
        """Take another size in pixels; `density` is the screen's pixels per unit of text size."""
        self._window.SetSize(*size)
        self._window.SetDPI(round(72 * density))

    def draw(self) -> NDArray[np.uint8]:
        """Return a new picture, (height, width, 4) uint8, first row lowest; valid until the next call."""
        self._window.Render()
        width, height = self._window.GetSize()
        self._window.GetRGBACharPixelData(0, 0, width - 1, height - 1, 0, self._pixels)  # pyright: ignore[reportArgumentType]
        return vtk_to_numpy(self._pixels).reshape(height, width, 4)

    def png(self) -> bytes:
        """Return a new picture as the content of a PNG file."""
        self._window.Render()
        # By default it would draw the picture a second time, and read a front buffer that a hidden window lacks.
        grabber = vtkWindowToImageFilter(input=self._window, should_rerender=False, read_front_buffer=False)
        writer = vtkPNGWriter(input_connection=grabber.GetOutputPort(), write_to_memory=True)
        writer.Write()
        return vtk_to_numpy(writer.GetResult()).tobytes()

    def release(self) -> None:
        """Give the context up, so that another thread can draw."""
        self._window.ReleaseCurrent()

    def close(self) -> None:
        """Give everything back; the window cannot be used again."""
        self._window.RemoveRenderer(self.renderer)
        self._window.Finalize()


def picture(
    scene: Scene,
    surface: Surface | None,
    laid: LaidSkin | None,
    snapshot: Snapshot,
    method: Method,
    path: Path,
    size: tuple[int, int] = (1280, 800),
) -> None:
    """Draw what the window's 3D view shows of a session, as a PNG file of so many pixels.

    Raises
    ------
    InputError
        There is nothing to draw with here (names the packages), or the file cannot be written.
    """
    choose_offscreen()
    channels = [estimate.channel for estimate in snapshot.estimates.get(method, ())]
    window = HiddenWindow(size)
    stage = Stage(window.renderer, StaticScene(scene, surface, laid, channels), LIGHT)
    try:
        stage.show(View3DState(snapshot, None, method, None))
        stage.fit()
        write_atomically(path, window.png())
    finally:
        stage.close()
        window.close()
