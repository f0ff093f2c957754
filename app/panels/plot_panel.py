"""A panel whose plots need pyqtgraph: it is imported beside the window once the panel is seen, and the plots come then."""

from __future__ import annotations

import importlib
import threading

from PySide6.QtCore import QTimer
from PySide6.QtGui import QHideEvent
from PySide6.QtWidgets import QVBoxLayout, QWidget

from app.panels.texts import quiet
from app.state.view_state import ViewState
from app.theme import GAP

POLL_MS = 30
"""How often it is asked whether the import is done."""


class PlotPanel(QWidget):
    """The place of plots; subclasses say which, and draw them.

    A panel that was never on the screen imports nothing, and one that is not on the screen asks nothing.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.ready = False
        """Whether the plots are there."""
        self._state: ViewState | None = None
        self._importer: threading.Thread | None = None
        self._failure = ""
        self._poll = QTimer(self)
        self._poll.setInterval(POLL_MS)
        self._label = quiet("The curves are loading \N{HORIZONTAL ELLIPSIS}")
        self._label.setContentsMargins(GAP, GAP, GAP, GAP)
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(0, 0, 0, 0)
        self._column.setSpacing(0)
        self._column.addWidget(self._label)
        self._poll.timeout.connect(self._take)

    def make(self) -> QWidget:
        """Make the plots, with the colours that hold; pyqtgraph is imported."""
        raise NotImplementedError

    def draw_state(self, state: ViewState) -> None:
        """Show a tick on the plots."""
        raise NotImplementedError

    def hideEvent(self, event: QHideEvent) -> None:
        """Ask no more while nobody sees it."""
        self._poll.stop()
        super().hideEvent(event)

    def show_state(self, state: ViewState) -> None:
        """Show a tick; before there is anything to show nothing is loaded, so that the 3D view comes first."""
        self._state = state
        if self.ready:
            self.draw_state(state)
        elif not self._poll.isActive() and self.isVisible() and not self._failure:
            self._load()

    def _load(self) -> None:
        if self._importer is None:
            # A daemon: importing has nothing to lose, and must not keep a closed program alive.
            self._importer = threading.Thread(target=self._import, name="curves import", daemon=True)
            self._importer.start()
        self._poll.start()

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
        plots = self.make()
        self.ready = True
        self._label.hide()
        self._column.addWidget(plots, 1)
        if self._state is not None:
            self.draw_state(self._state)
