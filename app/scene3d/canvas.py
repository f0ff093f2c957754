"""The widget that shows the picture, drawn by a graphics card or by software, and what can be made beside the window's thread.

Importing VTK takes longer than a window may stand still, and so does the first picture, in which software OpenGL compiles
its shaders. `load` runs beside the window; with EGL or OSMesa, which know no threads of their own, it also draws that picture.
`mount` runs in the window's thread and makes the widget.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias

from PySide6.QtGui import QImage, QOffscreenSurface, QOpenGLContext, QPainter, QPaintEvent
from PySide6.QtWidgets import QWidget

from app.scene3d.drawing_probe import start_egl_probe
from app.text_size import text_scale

if TYPE_CHECKING:
    from pyvistaqt import QtInteractor

    from app.scene3d.offscreen import HiddenWindow
    from app.scene3d.scene_state import Look, StaticScene, View3DState
    from app.scene3d.stage import Stage

    AnyCanvas: TypeAlias = "QtInteractor | RasterCanvas"


GL_RENDERER = 0x1F01
SOFTWARE = ("llvmpipe", "softpipe", "swrast", "swiftshader", "gdi generic", "basic render")
"""Names by which software says what it is."""
CARD_SAMPLES = 4
"""Samples a pixel on a graphics card, where they cost little."""
FIRST_SIZE = (640, 400)
"""Pixels of a first picture while the widget has no size yet."""


class Canvas(Enum):
    """How the 3D view gets its picture."""

    OPENGL = "opengl"
    RASTER = "raster"


@cache
def best_canvas() -> Canvas:
    """Return the canvas for this machine; takes about 40 ms the first time, on the thread of the window."""
    context, surface = QOpenGLContext(), QOffscreenSurface()
    surface.create()
    if not context.create() or not surface.isValid() or not context.makeCurrent(surface):
        return Canvas.RASTER
    name = str(context.functions().glGetString(GL_RENDERER)).lower()
    context.doneCurrent()
    surface.destroy()
    return Canvas.RASTER if any(word in name for word in SOFTWARE) else Canvas.OPENGL


class RasterCanvas(QWidget):
    """Shows the picture of a `HiddenWindow`, drawn again when asked and when its size changes; used as a `QtInteractor` is.

    On software OpenGL a picture takes two thirds of the time of a `QOpenGLWidget`, the rest of the window stays out of
    OpenGL, and it works where Qt has none.
    """

    def __init__(self, window: HiddenWindow, parent: QWidget) -> None:
        super().__init__(parent)
        self._window: HiddenWindow | None = window
        self._image = QImage()
        self._stale = True
        self._looks = (0, 0, 0.0)
        """Its size in pixels, and that of its letters."""
        self.setMouseTracking(False)

    def update(self, *part: Any) -> None:
        """Ask for one new picture; many requests before it is painted make one, and a hidden canvas makes none."""
        self._stale = True
        super().update(*part)

    def grabFramebuffer(self) -> QImage:  # noqa: N802 - as of a QOpenGLWidget
        """Return the picture as it stands, drawn now if it is stale."""
        self._refresh()
        return self._image

    def close(self) -> bool:
        """Close the window behind; the last picture stays."""
        if self._window is not None:
            self._window.close()
            self._window = None
        return super().close()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: ARG002
        """Paint the picture; only a stale one is drawn by VTK."""
        self._refresh()
        painter = QPainter(self)
        painter.drawImage(0, 0, self._image)
        painter.end()

    def _refresh(self) -> None:
        density = self.devicePixelRatioF()
        size = max(1, round(self.width() * density)), max(1, round(self.height() * density))
        looks = *size, density * text_scale()
        if self._window is None or not (self._stale or looks != self._looks):
            return
        if looks != self._looks:
            self._window.resize(size, density * text_scale())
            self._looks = looks
        self._stale = False
        pixels = self._window.draw()
        # VTK's first row is the lowest; the flipped copy is the image's own, so the next picture cannot tear it.
        image = QImage(pixels[::-1].tobytes(), size[0], size[1], QImage.Format.Format_RGBX8888)
        self._image = image.convertToFormat(QImage.Format.Format_RGB32)
        self._image.setDevicePixelRatio(density)


@dataclass(frozen=True, slots=True)
class Loaded:
    """What was made beside the window; None where that must wait for the window's thread."""

    window: HiddenWindow | None
    stage: Stage | None

    def close(self) -> None:
        """Give back what was made and never shown."""
        if self.stage is not None:
            self.stage.close()
        if self.window is not None:
            self.window.close()


def load(canvas: Canvas, static: StaticScene, look: Look, size: tuple[int, int], state: View3DState | None) -> Loaded:
    """Import what the canvas needs and make what needs no widget, for a first picture of so many pixels.

    Raises
    ------
    InputError
        There is nothing to draw with here.
    """
    _ = static.shaded
    if static.surface is not None:
        # The ring on the skin asks for these first: worked out when they are asked for, they would hold the window.
        _ = static.surface.centres, static.surface.radii
    if canvas is Canvas.OPENGL:
        # pyvista imports the widgets only as it makes an interactor, in the window's thread: here they stop nothing.
        import pyvistaqt  # noqa: F401
        import vtkmodules.vtkInteractionWidgets  # noqa: F401

        import app.scene3d.stage  # noqa: F401

        return Loaded(None, None)
    egl_probe = start_egl_probe()
    from app.scene3d.offscreen import HiddenWindow, choose_offscreen
    from app.scene3d.stage import Stage

    choose_offscreen(egl_probe)
    # EGL and OSMesa alone know no threads of their own: elsewhere the window's thread draws the first picture.
    if not sys.platform.startswith("linux"):
        return Loaded(None, None)
    window = HiddenWindow(size if min(size) > 1 else FIRST_SIZE)
    stage = Stage(window.renderer, static, look)
    stage.warm(window.draw)
    if state is not None:
        stage.show(state)
    stage.fit()
    window.draw()
    # Or the window's thread could not draw: a context belongs to the thread that drew last.
    window.release()
    return Loaded(window, stage)


def mount(canvas: Canvas, loaded: Loaded, static: StaticScene, look: Look, parent: QWidget) -> tuple[AnyCanvas, Stage]:
    """Make the widget, and the stage where `load` could not."""
    from app.scene3d.stage import Stage

    if canvas is Canvas.OPENGL:
        from pyvistaqt import QtInteractor

        # Drawn when Qt asks for it and never by itself; its `render` would draw each picture twice.
        interactor = QtInteractor(parent, auto_update=False, multi_samples=CARD_SAMPLES)
        # pyvistaqt would load a mesh that is dropped on it.
        interactor.setAcceptDrops(False)
        return interactor, Stage(interactor.renderer, static, look)
    from app.scene3d.offscreen import HiddenWindow

    window = loaded.window or HiddenWindow(FIRST_SIZE)
    return RasterCanvas(window, parent), loaded.stage or Stage(window.renderer, static, look)
