"""A canvas for software OpenGL: VTK draws into memory, Qt paints the picture like any other.

There it takes two thirds of the time of a `QOpenGLWidget`, leaves the rest of the window out of OpenGL, and works
where Qt has no OpenGL at all.
"""

from __future__ import annotations

from PySide6.QtGui import QImage, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QWidget

from app.scene3d.window import HiddenWindow


class RasterCanvas(QWidget):
    """Shows the picture of a `HiddenWindow`, drawn again when asked and when its size changes."""

    def __init__(self, window: HiddenWindow, parent: QWidget) -> None:
        super().__init__(parent)
        self._window: HiddenWindow | None = window
        self._image = QImage()
        self._stale = True
        self._size = (0, 0)
        self.setMouseTracking(False)

    def request(self) -> None:
        """Ask for one new picture; many requests before it is painted make one, and a hidden canvas makes none."""
        self._stale = True
        self.update()

    def image(self) -> QImage:
        """Return the picture as it stands, drawn now if it is stale."""
        self._refresh()
        return self._image

    def release(self) -> None:
        """Close the window behind; the last picture stays."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: ARG002
        """Paint the picture; only a stale one is drawn by VTK."""
        self._refresh()
        painter = QPainter(self)
        painter.drawImage(0, 0, self._image)
        painter.end()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Have the next picture drawn in the new size."""
        self._stale = True
        super().resizeEvent(event)

    def _refresh(self) -> None:
        density = self.devicePixelRatioF()
        size = max(1, round(self.width() * density)), max(1, round(self.height() * density))
        if self._window is None or not (self._stale or size != self._size):
            return
        if size != self._size:
            self._window.resize(size, density)
            self._size = size
        self._stale = False
        pixels = self._window.draw()
        # VTK's first row is the lowest; the flipped copy is the image's own, so the next picture cannot tear it.
        image = QImage(pixels[::-1].tobytes(), size[0], size[1], QImage.Format.Format_RGBX8888)
        self._image = image.convertToFormat(QImage.Format.Format_RGB32)
        self._image.setDevicePixelRatio(density)
