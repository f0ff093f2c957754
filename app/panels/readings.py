"""The place of the curves of force and moment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PySide6.QtWidgets import QWidget

from app.panels.plot_panel import PlotPanel
from app.state.view_state import ViewState
from app.theme import LIGHT, Colours

if TYPE_CHECKING:
    from app.panels.curves import CurvesPanel


class ReadingsPanel(PlotPanel):
    """Curves of force and moment, once they can be drawn."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.curves: CurvesPanel | None = None
        self._colours: Colours = LIGHT

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
