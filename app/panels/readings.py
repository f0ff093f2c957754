"""The place of the curves: pyqtgraph is imported beside the window, and the curves come when it is there."""

from __future__ import annotations

import importlib
import threading
from typing import TYPE_CHECKING

from PySide6.QtCore import QTimer
from PySide6.QtGui import QHideEvent
from PySide6.QtWidgets import QVBoxLayout, QWidget

from app.frame import Frame
from app.panels.texts import quiet
from app.theme import LIGHT, Colours

if TYPE_CHECKING:
    from app.panels.curves import CurvesPanel

POLL_MS = 30
"""How often it is asked whether the import is done."""


class ReadingsPanel(QWidget):
    """Curves of force and moment, once they can be drawn."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.curves: CurvesPanel | None = None
        self._colours: Colours = LIGHT
        self._frame: Frame | None = None
        self._importer: threading.Thread | None = None
        self._failure = ""
        self._poll = QTimer(self)
        self._poll.setInterval(POLL_MS)
        self._label = quiet("The curves are loading \N{HORIZONTAL ELLIPSIS}")
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(0, 0, 0, 0)
        self._column.addWidget(self._label)
        self._poll.timeout.connect(self._take)

    def hideEvent(self, event: QHideEvent) -> None:
        """Ask no more while nobody sees it."""
        self._poll.stop()
        super().hideEvent(event)

    def show_frame(self, frame: Frame) -> None:
        """Show a frame; before there is anything to show nothing is loaded, so that the 3D view comes first."""
        self._frame = frame
        if self.curves is not None:
            self.curves.show_frame(frame)
        elif not self._poll.isActive() and self.isVisible() and not self._failure:
            self._load()

    def _load(self) -> None:
        if self._importer is None:
            # A daemon: importing has nothing to lose, and must not keep a closed program alive.
            self._importer = threading.Thread(target=self._import, name="curves import", daemon=True)
            self._importer.start()
        self._poll.start()

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self._colours = colours
        if self.curves is not None:
            self.curves.set_colours(colours)

    def _import(self) -> None:
        try:
            importlib.import_module("pyqtgraph")
        except ImportError as error:
            self._failure = f"There are no curves: {error}"

    def _take(self) -> None:
        if self._importer is None or self._importer.is_alive():
            return
        self._poll.stop()
        if self._failure:
            self._label.setText(self._failure)
            return
        from app.panels.curves import CurvesPanel

        self.curves = CurvesPanel()
        self.curves.set_colours(self._colours)
        self._label.hide()
        self._column.addWidget(self.curves)
        if self._frame is not None:
            self.curves.show_frame(self._frame)
