"""Base of the plots, drawn by pyqtgraph."""

from __future__ import annotations

from typing import Any

import pyqtgraph as pg
from PySide6.QtCore import QEvent, Qt

from app.panels.widgets import theme_colours
from app.text_size import scaled


class StillPlot(pg.PlotWidget):
    """A plot in the theme's colours that ignores mouse and keys.

    Its axes have fixed sizes in pixels, so that curves stay in place while the numbers next to them change.
    """

    def __init__(self, name: str, left_px: int, bottom_px: int, min_height_px: int) -> None:
        super().__init__(enableMenu=False)
        self.item: Any = self.getPlotItem()
        self.item.hideButtons()
        self.item.setMouseEnabled(False, False)
        self.item.disableAutoRange()
        self._axes_px = left_px, bottom_px
        self._fit_axes()
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setAccessibleName(name)
        self.setMinimumHeight(min_height_px)

    def _fit_axes(self) -> None:
        left_px, bottom_px = self._axes_px
        self.item.getAxis("left").setWidth(scaled(left_px))
        self.item.getAxis("bottom").setHeight(scaled(bottom_px))

    def changeEvent(self, event: QEvent) -> None:
        super().changeEvent(event)
        if event.type() is QEvent.Type.FontChange:
            self._fit_axes()

    def add_curve(self, **options: Any) -> Any:
        """Add a curve. It must not contain NaN, since a check would cost a pass over its points.

        It is antialiased: otherwise Qt leaves out segments shorter than a pixel, and a calm curve gets holes. It costs no time
        (measured).
        """
        made: Any = self.item.plot(antialias=True, **options)
        made.setSkipFiniteCheck(True)
        return made

    def recolour(self) -> None:
        colours = theme_colours()
        self.setBackground(colours.panel)
        for name in ("left", "bottom"):
            self.item.getAxis(name).setPen(pg.mkPen(colours.line))
            self.item.getAxis(name).setTextPen(pg.mkPen(colours.muted))
