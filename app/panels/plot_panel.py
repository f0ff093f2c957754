"""Panels whose plots need pyqtgraph, which is imported beside the window once such a panel is seen; the plots come then.

Here, too, is the panel of the readings, the place of the curves of force and moment.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from PySide6.QtWidgets import QVBoxLayout, QWidget

from app.panels.texts import quiet
from app.state.view_state import ViewState
from app.theme import GAP, LIGHT, Colours
from app.workers.threads import ThreadService
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from app.panels.curves import CurvesPanel


class PlotPanel(QWidget):
    """The place of plots; subclasses say which, and draw them.

    A panel that was never on the screen imports nothing.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.ready = False
        """Whether the plots are there."""
        self._state: ViewState | None = None
        self._threads: ThreadService | None = None
        """Imports, once it was asked to."""
        self._imported = False
        self._label = quiet("The curves are loading \N{HORIZONTAL ELLIPSIS}")
        self._label.setContentsMargins(GAP, GAP, GAP, GAP)
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(0, 0, 0, 0)
        self._column.setSpacing(0)
        self._column.addWidget(self._label)
        self._colours: Colours = LIGHT

    def make(self) -> QWidget:
        """Make the plots, with the colours that hold; pyqtgraph is imported."""
        raise NotImplementedError

    def draw_state(self, state: ViewState) -> None:
        """Show a tick on the plots."""
        raise NotImplementedError

    def show_state(self, state: ViewState) -> None:
        """Show a tick; before there is anything to show nothing is loaded, so that the 3D view comes first."""
        self._state = state
        if self.ready:
            self.draw_state(state)
        # It was imported while the panel was hidden.
        elif self.isVisible() and self._imported:
            self._make()
        elif self.isVisible() and self._threads is None:
            self._threads = ThreadService("curves", self)
            self._threads.submit(_import_pyqtgraph, self._take_imported, self._label.setText)

    def _take_imported(self, _nothing: None) -> None:
        self._imported = True
        if self.isVisible():
            self._make()

    def _make(self) -> None:
        plots = self.make()
        self.ready = True
        self._label.hide()
        self._column.addWidget(plots, 1)
        if self._state is not None:
            self.draw_state(self._state)


def _import_pyqtgraph() -> None:
    try:
        importlib.import_module("pyqtgraph")
    except ImportError as error:
        raise InputError(f"There are no curves: {error}") from error


class ReadingsPanel(PlotPanel):
    """Curves of force and moment, once they can be drawn."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.curves: CurvesPanel | None = None

    def make(self) -> QWidget:
        """Make the curves."""
        from app.panels.curves import CurvesPanel

        self.curves = CurvesPanel()
        self.curves.set_colours(self._colours)
        return self.curves

    def draw_state(self, state: ViewState) -> None:
        """Draw the newest readings."""
        if self.curves is not None:
            self.curves.show_state(state)

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self._colours = colours
        if self.curves is not None:
            self.curves.set_colours(colours)
