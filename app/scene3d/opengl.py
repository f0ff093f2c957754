"""A canvas for a graphics card: pyvistaqt's interactor, drawn when Qt asks for it and never by itself."""

from __future__ import annotations

from PySide6.QtGui import QImage
from PySide6.QtWidgets import QWidget
from pyvistaqt import QtInteractor

CARD_SAMPLES = 4
"""Samples a pixel on a graphics card, where they cost little."""


class OpenGLCanvas(QtInteractor):
    """An interactor whose events are all handled by `pointer.Pointer`.

    Ask for a picture by `request`, never by `render`, which draws each picture twice.
    """

    def __init__(self, parent: QWidget, samples: int = CARD_SAMPLES) -> None:
        super().__init__(parent, auto_update=False, multi_samples=samples)
        self.setAcceptDrops(False)

    def request(self) -> None:
        """Ask for one new picture; many requests before it is painted make one, and a hidden canvas makes none."""
        self.update()

    def image(self) -> QImage:
        """Return the picture as it stands, drawn now."""
        return self.grabFramebuffer()

    def release(self) -> None:
        """Close the plotter, with its timer and its context's resources."""
        self.close()
