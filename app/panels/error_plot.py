"""The plot of errors: for each method a solid line for the mean, a dashed one for p95 and a dotted one for the maximum.

The vertical axis is logarithmic, since the first pokes leave ten times the error of the last. A method has a
symbol of its own as well as a hue.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QVBoxLayout, QWidget

from app.panels.curves import colour_plot, still_plot
from app.text.errors_text import PAPER, STATISTICS, Axis, axis_words, log_ticks, paper_words, shown_range
from app.theme import LIGHT, Colours, method_hue
from app.units import in_millimetres, in_minutes
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.session.error_history import MAX, MEAN, P95, ErrorSeries
from skincal.taxels.result import Method

STYLES = {MEAN: Qt.PenStyle.SolidLine, P95: Qt.PenStyle.DashLine, MAX: Qt.PenStyle.DotLine}
SYMBOLS = {Method.FREE: "o", Method.SURFACE: "d", Method.MODULES: "t1"}
SYMBOLS_SHOWN = 12
"""Symbols along a line: enough to know it by, few enough to see it."""
SHIFT = {Method.FREE: -0.22, Method.SURFACE: 0.0, Method.MODULES: 0.22}
"""Methods stand side by side at a module; 1 is from module to module."""
TICK = 0.1
"""Half the width of the mark of p95 at a module."""
TEXT_MARGIN = 0.12
"""Height of the empty margin above and below a label's letters, in heights of the label."""
RIM_MOST = 0.4
"""Share of the plot's width that is kept free for labels at most."""
NUMBERS_SHOWN = 12
"""Modules whose numbers fit under the plot."""


class ErrorPlot(QWidget):
    """Curves and labelled lines; it keeps nothing but what it draws."""

    def __init__(self, methods: Sequence[Method], modules: Sequence[str], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._modules = modules
        self.view = pg.PlotWidget(enableMenu=False)
        self._item = still_plot(self.view, 46, 34)
        self._across = (0.0, 1.0)
        """What is drawn reaches from here to there."""
        self.curves: dict[tuple[Method, int], Any] = {(m, at): self.view.plot() for m in methods for at in STATISTICS}
        self.symbols = {method: pg.ScatterPlotItem(symbol=SYMBOLS[method], size=8) for method in methods}
        self.papers = {method: self._paper(method) for method in methods if method in PAPER}
        for item in (*self.symbols.values(), *self.papers.values()):
            self._item.addItem(item)
        self._item.getViewBox().sigResized.connect(self._keep_rim)
        self.view.setMinimumHeight(90)
        self.view.setAccessibleName("course of the errors")
        for curve in self.curves.values():
            curve.setSkipFiniteCheck(True)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self.view)
        self.set_colours(LIGHT)

    def _paper(self, method: Method) -> pg.InfiniteLine:
        # The two lie close together: one has its label above, the other below. Both touch their line, which goes on
        # to the right rim, where no curve is.
        anchor = (1.0, 1.0 - TEXT_MARGIN if method is Method.FREE else TEXT_MARGIN)
        options = {"position": 1.0, "anchors": [anchor, anchor], "movable": False}
        place = math.log10(in_millimetres(PAPER[method]))
        return pg.InfiniteLine(place, angle=0, label=paper_words(method), labelOpts=options)

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        colour_plot(self.view, colours)
        for (method, statistic), curve in self.curves.items():
            curve.setPen(pg.mkPen(method_hue(colours, method), width=1, style=STYLES[statistic]))
        for method, line in self.papers.items():
            line.setPen(pg.mkPen(method_hue(colours, method), width=1, style=Qt.PenStyle.DashDotLine))
            line.label.setColor(colours.text)
        for method, symbols in self.symbols.items():
            symbols.setPen(pg.mkPen(colours.panel))
            symbols.setBrush(pg.mkBrush(method_hue(colours, method)))

    def draw(self, series: ErrorSeries, axis: Axis, row: int, quantity: str, *, paper: bool) -> None:
        """Draw a course.

        Parameters
        ----------
        row : 0 for all taxels, else 1 + index of the module; not used where the modules are the axis
        quantity : title of the vertical axis
        paper : the paper's figures are of the same kind
        """
        drawn: list[FloatArray] = []
        for method in self.symbols:
            course = series.spreads.get(method)
            values = np.empty((0, 1 + len(self._modules), 4)) if course is None else in_millimetres(course)
            if axis is Axis.MODULES:
                drawn.append(self._draw_modules(method, values))
            else:
                at = series.counts.astype(float) if axis is Axis.POKES else in_minutes(series.times)
                drawn.append(self._draw_course(method, at, values[:, row], _joined(series)))
        self._fit(series, axis, drawn, paper=paper)
        self._name("left", quantity)
        self._name("bottom", axis_words(series, axis))

    def _name(self, side: str, words: str) -> None:
        axis = self._item.getAxis(side)
        if axis.labelText != words:
            axis.setLabel(words)
            axis.resizeEvent()  # puts the words in the middle again

    def _draw_course(self, method: Method, at: FloatArray, values: FloatArray, joined: IntArray) -> FloatArray:
        known = np.isfinite(values[:, MEAN]) & (values[:, MEAN] > 0.0)
        at, values, joined = at[known], values[known], joined[known]
        for statistic in STATISTICS:
            self.curves[method, statistic].setData(at, np.log10(values[:, statistic]), connect=joined)
        some = np.unique(np.linspace(0, len(at) - 1, min(len(at), SYMBOLS_SHOWN)).astype(np.int64))
        self.symbols[method].setData(at[some], np.log10(values[some, MEAN]))
        return values[:, MEAN:]

    def _draw_modules(self, method: Method, values: FloatArray) -> FloatArray:
        newest = values[-1, 1:] if len(values) else np.empty((0, 4))
        known = np.isfinite(newest[:, MEAN]) & (newest[:, MEAN] > 0.0)
        at, newest = np.flatnonzero(known) + SHIFT[method], newest[known]
        marks = np.log10(newest)
        # At each module a line from the mean up to the maximum, and a mark across it at p95.
        self.curves[method, MAX].setData(np.repeat(at, 2), marks[:, [MEAN, MAX]].ravel(), connect="pairs")
        ends = (at[:, None] + [-TICK, TICK]).ravel()
        self.curves[method, P95].setData(ends, np.repeat(marks[:, P95], 2), connect="pairs")
        self.curves[method, MEAN].setData([], [])
        self.symbols[method].setData(at, marks[:, MEAN])
        return newest[:, MEAN:]

    def _fit(self, series: ErrorSeries, axis: Axis, drawn: Sequence[FloatArray], *, paper: bool) -> None:
        figures = [in_millimetres(PAPER[method]) for method in self.papers] if paper else []
        low, high = shown_range(drawn, min([5.0, *figures]), max([10.0, *figures]))
        self._item.setYRange(math.log10(low), math.log10(high), padding=0.02)
        self._item.getAxis("left").setTicks([log_ticks(low, high)])
        for line in self.papers.values():
            line.setVisible(paper)
        bottom = self._item.getAxis("bottom")
        if axis is Axis.MODULES:
            step = math.ceil(len(self._modules) / NUMBERS_SHOWN)
            bottom.setTicks([[(at, name) for at, name in enumerate(self._modules) if at % step == 0]])
            self._across = (-0.6, max(1, len(self._modules)) - 0.4)
            self._keep_rim()
            return
        bottom.setTicks(None)
        last = float(series.counts[-1] if axis is Axis.POKES else in_minutes(series.times)[-1]) if len(series.counts) else 0.0
        longest = max(last, 10.0 if axis is Axis.POKES else 1.0)
        self._across = (-0.01 * longest, 1.01 * longest)
        self._keep_rim()

    def _keep_rim(self) -> None:
        """Show what is drawn, and keep room for the labels at the right of it."""
        low, high = self._across
        labels = [line.label.textItem.boundingRect().width() for line in self.papers.values() if line.isVisible()]
        share = min(RIM_MOST, max(labels, default=0.0) / max(1.0, self._item.getViewBox().width()))
        self._item.setXRange(low, low + (high - low) / (1.0 - share), padding=0.0)


def _joined(series: ErrorSeries) -> IntArray:
    """Return 1 where a point is joined to the next, 0 where something between them is still worked out, (n,) int."""
    return (np.diff(series.counts, append=0) <= series.stride).astype(np.int64)
