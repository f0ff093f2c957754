"""How the 3D view comes to be: what can be made beside the window's thread, and what only in it.

Importing VTK takes longer than a window may stand still, and so does the first picture, in which software OpenGL compiles
its shaders. `load` runs in a worker; with EGL or OSMesa, which know no threads of their own, it also draws that picture.
`mount` runs in the window's thread and makes the widget.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from PySide6.QtWidgets import QWidget

from app.scene3d.graphics import choose_offscreen
from app.scene3d.ground import Frame, Ground
from app.scene3d.looks import Look
from app.scene3d.probe import Canvas

if TYPE_CHECKING:
    from app.scene3d.opengl import OpenGLCanvas
    from app.scene3d.raster import RasterCanvas
    from app.scene3d.stage import Stage
    from app.scene3d.window import HiddenWindow

    AnyCanvas: TypeAlias = OpenGLCanvas | RasterCanvas

FIRST_SIZE = (640, 400)
"""Pixels of a first picture while the widget has no size yet."""


@dataclass(frozen=True, slots=True)
class Loaded:
    """What the worker made; None where that must wait for the window's thread."""

    window: HiddenWindow | None
    stage: Stage | None

    def close(self) -> None:
        """Give back what was made and never shown."""
        if self.stage is not None:
            self.stage.close()
        if self.window is not None:
            self.window.close()


def load(canvas: Canvas, ground: Ground, look: Look, size: tuple[int, int], frame: Frame | None) -> Loaded:
    """Import what the canvas needs and make what needs no widget.

    Parameters
    ----------
    size : pixels of the picture to come
    frame : what to show first, if known

    Raises
    ------
    InputError
        There is nothing to draw with here.
    """
    _ = ground.shaded
    if ground.surface is not None:
        # The ring on the skin asks for these first: worked out when they are asked for, they would hold the window.
        _ = ground.surface.centres, ground.surface.radii
    if canvas is Canvas.OPENGL:
        # pyvista imports the widgets only as it makes an interactor, in the window's thread: here they stop nothing.
        import vtkmodules.vtkInteractionWidgets  # noqa: F401

        import app.scene3d.opengl
        import app.scene3d.stage

        return Loaded(None, None)
    choose_offscreen()
    import app.scene3d.raster  # noqa: F401
    from app.scene3d.stage import Stage
    from app.scene3d.window import HiddenWindow

    if not sys.platform.startswith("linux"):
        return Loaded(None, None)
    window = HiddenWindow(size if min(size) > 1 else FIRST_SIZE)
    stage = Stage(window.renderer, ground, look)
    stage.warm(window.draw)
    if frame is not None:
        stage.show(frame)
    stage.fit()
    window.draw()
    window.release()
    return Loaded(window, stage)


def mount(canvas: Canvas, loaded: Loaded, ground: Ground, look: Look, parent: QWidget) -> tuple[AnyCanvas, Stage]:
    """Make the widget, and the stage where the worker could not."""
    from app.scene3d.stage import Stage

    if canvas is Canvas.OPENGL:
        from app.scene3d.opengl import OpenGLCanvas

        widget = OpenGLCanvas(parent)
        return widget, Stage(widget.renderer, ground, look)
    from app.scene3d.raster import RasterCanvas
    from app.scene3d.window import HiddenWindow

    window = loaded.window or HiddenWindow(FIRST_SIZE)
    return RasterCanvas(window, parent), loaded.stage or Stage(window.renderer, ground, look)
