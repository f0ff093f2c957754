"""The widget that shows the picture, drawn by a graphics card or by software.

Importing pyvista would block the window too long, and so would the first picture, for which software OpenGL compiles shaders.
`load` runs in a thread; with EGL or OSMesa, which are not bound to a thread, it also draws that picture. `mount` runs in the
window's thread and makes the widget.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias

from PySide6.QtCore import QObject
from PySide6.QtGui import QImage, QOffscreenSurface, QOpenGLContext, QPainter, QPaintEvent
from PySide6.QtWidgets import QWidget

from app.qt_types import name_types
from app.scene3d.drawing_probe import DrawingProbe, choose_offscreen, start_egl_probe
from app.scene3d.pyvista_import import import_plotter
from app.text_size import text_scale
from skincal.model.errors import InputError

if TYPE_CHECKING:
    import pyvista as pv
    from pyvistaqt import QtInteractor

    from app.scene3d.scene_renderer import SceneRenderer
    from app.scene3d.scene_state import SceneColours, StaticScene
    from app.state.view_state import ViewState

    AnyCanvas: TypeAlias = "QtInteractor | RasterCanvas"

GL_RENDERER = 0x1F01
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "swiftshader", "gdi generic", "basic render")
GPU_SAMPLES_PER_PIXEL = 4  # Samples a pixel on a graphics card, where they cost little
DEFAULT_SIZE = (640, 400)  # Pixels of a first picture while the widget has no size yet


class Canvas(Enum):
    """Method of drawing the 3D view's picture."""

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
    return Canvas.RASTER if any(word in name for word in SOFTWARE_RENDERERS) else Canvas.OPENGL


@cache
def early_egl_probe() -> DrawingProbe | None:
    """Return the trial of EGL of this program, which the first call starts; `None` if there is nothing to try."""
    return start_egl_probe()


def get_ready(window: QObject) -> None:
    """Choose the canvas, and start to import what it draws with; takes as long as `best_canvas`."""
    # Not a daemon: a program that ends while VTK is loaded crashes.
    thread = threading.Thread(target=_import_early, args=(best_canvas(),), name="skincal-libraries")
    prepare_import(best_canvas(), window, thread.start)


def prepare_import(canvas: Canvas, owner: QObject, then: Callable[[], object]) -> None:
    """Call `then` to import a canvas's libraries in a thread, once that is safe; not after the end of `owner`."""
    if canvas is Canvas.OPENGL:
        # pyvistaqt names all of Qt's types at its import.
        name_types(owner, then)
    else:
        then()


def _import_early(canvas: Canvas) -> None:
    # The view of the part imports them again, and says what is missing.
    with suppress(Exception):
        import_libraries(canvas)


def import_libraries(canvas: Canvas) -> None:
    """Import what draws a picture of a session; takes long the first time."""
    import_plotter()
    if canvas is Canvas.OPENGL:
        # pyvista imports the widgets only as it makes an interactor, in the window's thread: here they block nothing.
        import pyvistaqt  # noqa: F401
        import vtkmodules.vtkInteractionWidgets  # noqa: F401
    import app.scene3d.offscreen
    import app.scene3d.scene_renderer  # noqa: F401


class RasterCanvas(QWidget):
    """Shows the picture of an off-screen plotter, drawn again on request and when the size changes.

    On software OpenGL a picture takes two thirds of the time of a `QOpenGLWidget`, the rest of the window stays out of
    OpenGL, and it works where Qt has none.
    """

    def __init__(self, plotter: pv.BasePlotter, parent: QWidget) -> None:
        super().__init__(parent)
        self._plotter: pv.BasePlotter | None = plotter
        self._image = QImage()
        self._is_stale = True
        self._drawn_as: tuple[float, ...] = ()  # Size in pixels, pixel ratio and text scale of the picture

    def update(self, *part: Any) -> None:
        """Ask for one new picture; many requests before it is painted make one, and a hidden canvas makes none."""
        self._is_stale = True
        super().update(*part)

    def grabFramebuffer(self) -> QImage:  # noqa: N802 - as of a QOpenGLWidget
        """Return the picture, drawn now if it is stale."""
        self._refresh()
        return self._image

    def close(self) -> bool:
        """Close the plotter; the last picture stays."""
        if self._plotter is not None:
            self._plotter.close()
            self._plotter = None
        return super().close()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: ARG002
        self._refresh()
        painter = QPainter(self)
        painter.drawImage(0, 0, self._image)
        painter.end()

    def _refresh(self) -> None:
        from app.scene3d.offscreen import draw

        ratio = self.devicePixelRatioF()
        size = max(1, round(self.width() * ratio)), max(1, round(self.height() * ratio))
        draw_as = (*size, ratio, text_scale())
        if self._plotter is None or not (self._is_stale or draw_as != self._drawn_as):
            return
        self._is_stale, self._drawn_as = False, draw_as
        self._plotter.window_size = list(size)
        pixels = draw(self._plotter)
        # VTK's first row is the lowest; the flipped copy is the image's own, so the next picture cannot tear it.
        image = QImage(pixels[::-1].tobytes(), size[0], size[1], QImage.Format.Format_RGBX8888)
        self._image = image.convertToFormat(QImage.Format.Format_RGB32)
        self._image.setDevicePixelRatio(ratio)


def release(renderer: SceneRenderer | None) -> None:
    """Release a loaded renderer that was never shown."""
    if renderer is not None:
        renderer.close()
        renderer.plotter.close()


def load(
    canvas: Canvas, static: StaticScene, colours: SceneColours, size: tuple[int, int], state: ViewState | None
) -> SceneRenderer | None:
    """Import the libraries and make the renderer; `None` if only the window's thread can make it.

    `size` is that of the first picture in pixels.

    Raises
    ------
    InputError
        There is nothing to draw with here.
    """
    egl_probe = early_egl_probe() if canvas is Canvas.RASTER else None
    # Meanwhile the child tries to draw.
    import_libraries(canvas)
    if canvas is Canvas.OPENGL:
        _renderer_class(static)
        return None
    from app.scene3d.mesh_actors import window_of
    from app.scene3d.offscreen import make_plotter

    try:
        choose_offscreen(egl_probe)
    except InputError:
        # The next scene tries again: the operator may install what is missing.
        early_egl_probe.cache_clear()
        raise
    # Only EGL and OSMesa are not bound to a thread: elsewhere the window's thread draws the first picture.
    if not sys.platform.startswith("linux"):
        return None
    plotter = make_plotter(size if min(size) > 1 else DEFAULT_SIZE)
    renderer = _renderer_class(static)(plotter, static, colours)
    renderer.compile_shaders()
    if state is not None:
        renderer.show(state)
    renderer.fit()
    window_of(plotter).Render()
    # A context belongs to the thread that drew last: let the window's thread draw.
    window_of(plotter).ReleaseCurrent()
    return renderer


def _renderer_class(static: StaticScene) -> type[SceneRenderer]:
    # The modules of a draft take as long to import as the layers take to be built: a session goes without them.
    if static.is_draft:
        from app.scene3d.draft_renderer import DraftRenderer

        return DraftRenderer
    from app.scene3d.scene_renderer import SceneRenderer

    return SceneRenderer


def mount(
    canvas: Canvas, loaded: SceneRenderer | None, static: StaticScene, colours: SceneColours, parent: QWidget
) -> tuple[AnyCanvas, SceneRenderer]:
    """Make the widget, and the renderer where `load` could not."""
    from app.scene3d.scene_renderer import PLOTTER_SHAPE

    make = _renderer_class(static)
    if canvas is Canvas.OPENGL:
        from pyvistaqt import QtInteractor

        # Drawn only when Qt asks for it; its `render` would draw each picture twice.
        widget = QtInteractor(
            parent, auto_update=False, multi_samples=GPU_SAMPLES_PER_PIXEL, shape=PLOTTER_SHAPE, border=False, lighting="none"
        )  # fmt: skip
        # pyvistaqt would load a mesh that is dropped on it.
        widget.setAcceptDrops(False)
        renderer = make(widget, static, colours)
    else:
        from app.scene3d.offscreen import make_plotter

        renderer = loaded or make(make_plotter(DEFAULT_SIZE), static, colours)
        widget = RasterCanvas(renderer.plotter, parent)
    renderer.scales = lambda: (widget.devicePixelRatioF(), text_scale())
    return widget, renderer
