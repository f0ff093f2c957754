"""Whether Qt draws OpenGL on a graphics card, in software, or not at all."""

from __future__ import annotations

from enum import Enum
from functools import cache

from PySide6.QtGui import QOffscreenSurface, QOpenGLContext

GL_RENDERER = 0x1F01
SOFTWARE = ("llvmpipe", "softpipe", "swrast", "swiftshader", "gdi generic", "basic render")
"""Names by which software says what it is."""


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
