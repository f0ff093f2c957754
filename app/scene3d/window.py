"""A VTK window that is never on a screen: draws one renderer into an array."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkUnsignedCharArray
from vtkmodules.vtkIOImage import vtkPNGWriter
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter

NO_SAMPLES = 0
"""Software OpenGL pays for every sample of every pixel: four of them make a frame 2.5 times as long."""


class HiddenWindow:
    """One renderer of `size` pixels.

    Its context belongs to the thread that drew last; `release` lets another thread draw. VTK's `Render` leaves Python's other
    threads alone.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.renderer = vtkRenderer()
        self._window = vtkRenderWindow()
        self._window.SetMultiSamples(NO_SAMPLES)
        self._window.SetShowWindow(False)
        self._window.SetOffScreenRendering(True)
        self._window.SetSize(*size)
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
        grabber = vtkWindowToImageFilter()
        grabber.SetInput(self._window)
        grabber.ShouldRerenderOff()
        grabber.ReadFrontBufferOff()
        writer = vtkPNGWriter()
        writer.SetInputConnection(grabber.GetOutputPort())
        writer.WriteToMemoryOn()
        writer.Write()
        return vtk_to_numpy(writer.GetResult()).tobytes()

    def release(self) -> None:
        """Give the context up, so that another thread can draw."""
        self._window.ReleaseCurrent()

    def close(self) -> None:
        """Give everything back; the window cannot be used again."""
        self._window.RemoveRenderer(self.renderer)
        self._window.Finalize()
