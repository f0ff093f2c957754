"""The Errors tab: mean, 95th percentile and maximum error of each method, over pokes, time or modules."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QSettings, Qt
from PySide6.QtWidgets import QButtonGroup, QComboBox, QSizePolicy, QToolButton

from app.panels.layouts import make_column, make_row
from app.panels.panel import Panel
from app.panels.plot import StillPlot
from app.panels.widgets import compact_combo, escape_tooltip, rich_label, secondary_label, theme_colours
from app.state.view_state import ViewState
from app.text.errors_text import (
    LEGEND_OF_STATISTIC,
    SYMBOL_OF_METHOD,
    Axis,
    axis_words,
    newest_words,
    quantity_words,
    source_words,
)
from app.theme import WIDGET_GAP_PX
from skincal.following.error_history import MAX, MEAN, P95, ErrorSeries
from skincal.geometry import FloatArray, IntArray
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from skincal.files.reference import TaxelPositions
    from skincal.following.guided_session import GuidedSession

PLOT_REDRAW_PERIOD_S = 0.2  # Between two drawings while earlier points are being computed
LINE_STYLES = {MEAN: Qt.PenStyle.SolidLine, P95: Qt.PenStyle.DashLine, MAX: Qt.PenStyle.DotLine}
PLOT_SYMBOLS = {Method.FREE: "o", Method.SURFACE: "d", Method.MODULES: "t1"}
MAX_MARKERS_PER_CURVE = 12  # Symbols along a line
METHOD_OFFSETS = {Method.FREE: -0.22, Method.SURFACE: 0.0, Method.MODULES: 0.22}
"""Methods are side by side at a module; 1 is the distance between modules."""
PERCENTILE_TICK_HALF_WIDTH = 0.1  # Of the mark of the 95th percentile at a module
MAX_MODULE_LABELS_ON_AXIS = 12  # Module numbers that fit under the plot
AXIS_SETTING = "window/errors_against"


def round_range(low: float, high: float) -> tuple[float, float]:
    """Return the next steps of 1, 2, 5 x 10^n at or below `low` and at or above `high`, both positive, any unit."""
    below, above = 10.0 ** math.floor(math.log10(low)), 10.0 ** math.floor(math.log10(high))
    # The slack takes a step with a rounding error for that step.
    bottom = max(step * below for step in (1.0, 2.0, 5.0) if step * below <= low * (1 + 1e-9))
    top = min(step * above for step in (1.0, 2.0, 5.0, 10.0) if step * above >= high * (1 - 1e-9))
    return (bottom, top) if top > bottom else (bottom, 2.0 * bottom)


def log_ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Return the marks of a logarithmic axis: log10 of the value, and its text."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    values = [step * 10.0**decade for decade in decades for step in (1.0, 2.0, 5.0)]
    return [(math.log10(v), f"{v:g}") for v in values if low * (1 - 1e-9) <= v <= high * (1 + 1e-9)]


class ErrorPlot(StillPlot):
    """Curves of the errors: for each method a solid line for the mean, dashed for p95, dotted for the maximum.

    The vertical axis is logarithmic, since the first pokes leave ten times the error of the last. A method has its own symbol
    as well as its hue.
    """

    def __init__(self, methods: Sequence[Method], modules: Sequence[str]) -> None:
        super().__init__("course of the errors", 46, 34, 90)
        self._modules = modules
        self.item.setLogMode(x=False, y=True)
        # Half a line, so that the number at the upper end is not cut.
        self.item.layout.setContentsMargins(0, 7, 0, 0)
        self.curves: dict[tuple[Method, int], Any] = {(m, at): self.add_curve() for m in methods for at in LEGEND_OF_STATISTIC}
        self.symbols = {m: self.add_curve(pen=None, symbol=PLOT_SYMBOLS[m], symbolSize=8) for m in methods}
        self.recolour()

    def recolour(self) -> None:
        super().recolour()
        colours = theme_colours()
        for (method, statistic), curve in self.curves.items():
            curve.setPen(pg.mkPen(colours.methods[method.value], width=1, style=LINE_STYLES[statistic]))
        for method, symbols in self.symbols.items():
            symbols.setSymbolPen(pg.mkPen(colours.panel))
            symbols.setSymbolBrush(pg.mkBrush(colours.methods[method.value]))

    def draw(self, series: ErrorSeries, axis: Axis, row: int, quantity: str) -> None:
        """Draw the errors.

        Parameters
        ----------
        row : 0 for all taxels, else 1 + index of the module; not used if the modules are the axis
        quantity : title of the vertical axis
        """
        drawn: list[FloatArray] = []
        # 1 if a point is joined to the next, 0 if points between them are still missing.
        joined = (np.diff(series.counts, append=0) <= series.stride).astype(np.int64)
        for method in self.symbols:
            course = series.spreads.get(method)
            values = np.empty((0, 1 + len(self._modules), 4)) if course is None else 1e3 * course
            if axis is Axis.MODULES:
                drawn.append(self._draw_modules(method, values))
            else:
                at = series.counts.astype(float) if axis is Axis.POKES else series.times / 60.0
                drawn.append(self._draw_course(method, at, values[:, row], joined))
        self._fit(series, axis, drawn)
        self._set_label("left", quantity)
        self._set_label("bottom", axis_words(series, axis))

    def _set_label(self, side: str, words: str) -> None:
        axis = self.item.getAxis(side)
        if axis.labelText != words:
            axis.setLabel(words)
            axis.resizeEvent()  # centres the words again

    def _draw_course(self, method: Method, at: FloatArray, values: FloatArray, joined: IntArray) -> FloatArray:
        known = np.isfinite(values[:, MEAN]) & (values[:, MEAN] > 0.0)
        at, values, joined = at[known], values[known], joined[known]
        for statistic in LEGEND_OF_STATISTIC:
            self.curves[method, statistic].setData(at, values[:, statistic], connect=joined)
        some = np.unique(np.linspace(0, len(at) - 1, min(len(at), MAX_MARKERS_PER_CURVE)).astype(np.int64))
        self.symbols[method].setData(at[some], values[some, MEAN])
        return values[:, MEAN:]

    def _draw_modules(self, method: Method, values: FloatArray) -> FloatArray:
        newest = values[-1, 1:] if len(values) else np.empty((0, 4))
        known = np.isfinite(newest[:, MEAN]) & (newest[:, MEAN] > 0.0)
        at, newest = np.flatnonzero(known) + METHOD_OFFSETS[method], newest[known]
        # At each module a line from the mean to the maximum, and a mark across it at p95.
        self.curves[method, MAX].setData(np.repeat(at, 2), newest[:, [MEAN, MAX]].ravel(), connect="pairs")
        ends = (at[:, None] + [-PERCENTILE_TICK_HALF_WIDTH, PERCENTILE_TICK_HALF_WIDTH]).ravel()
        self.curves[method, P95].setData(ends, np.repeat(newest[:, P95], 2), connect="pairs")
        self.curves[method, MEAN].setData([], [])
        self.symbols[method].setData(at, newest[:, MEAN])
        return newest[:, MEAN:]

    def _fit(self, series: ErrorSeries, axis: Axis, drawn: Sequence[FloatArray]) -> None:
        known = [values[np.isfinite(values) & (values > 0.0)] for values in drawn]
        every = np.concatenate([*known, [5.0, 10.0]])
        low, high = round_range(float(every.min()), float(every.max()))
        self.item.setYRange(math.log10(low), math.log10(high), padding=0.02)
        self.item.getAxis("left").setTicks([log_ticks(low, high)])
        if axis is Axis.MODULES:
            step = math.ceil(len(self._modules) / MAX_MODULE_LABELS_ON_AXIS)
            self.item.getAxis("bottom").setTicks([[(at, name) for at, name in enumerate(self._modules) if at % step == 0]])
            self.item.setXRange(-0.6, max(1, len(self._modules)) - 0.4, padding=0.0)
        else:
            # `None` restores the axis' own ticks.
            self.item.getAxis("bottom").setTicks(None)
            along, least = (series.counts, 10.0) if axis is Axis.POKES else (series.times / 60.0, 1.0)
            longest = max(float(along[-1]) if len(along) else 0.0, least)
            self.item.setXRange(-0.01 * longest, 1.01 * longest, padding=0.0)


class ErrorsPanel(Panel):
    """Choice of reference and axis, the newest figures, and the plot."""

    title = "Errors"

    def __init__(self, guided: GuidedSession) -> None:
        super().__init__()
        layout = guided.part.scene.skin.layout
        self._methods = [method for method in Method if method in guided.methods]
        self._modules = [] if layout is None else [str(module.id) for module in layout.modules]
        self.course = guided.errors
        self._drawn_s = -PLOT_REDRAW_PERIOD_S
        self.source_box, self.module_box = compact_combo("compared with"), QComboBox()
        self.axis_buttons = {axis: QToolButton() for axis in Axis}
        self.lines = {method: rich_label(wrap=True) for method in self._methods}
        self._group = QButtonGroup(self)
        for axis, button in self.axis_buttons.items():
            button.setText(axis.value)
            button.setCheckable(True)
            button.setProperty("choice", True)
            button.setToolTip(escape_tooltip(f"Draw the error over {axis.value}"))
            self._group.addButton(button)
        self.axis_buttons[Axis.POKES].setChecked(True)
        self.axis_buttons[Axis.MODULES].setVisible(bool(self._modules))
        self.module_box.addItems(["all taxels", *(f"module {name}" for name in self._modules)])
        self.module_box.setVisible(bool(self._modules))
        self.module_box.setAccessibleName("taxels")
        self.source_box.setToolTip("Reference of the errors; Ctrl+R reads a file")
        self.source_box.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setWhatsThis(
            "Distance of the estimates from the known positions of the taxels, after each poke. Without known positions, the "
            "expected error of the estimates. Excluded pokes are left out of the whole course."
        )
        choices = make_row(secondary_label("over"), *self.axis_buttons.values(), 1, self.module_box)
        for label in self.lines.values():
            # A narrow panel cuts the end off and does not grow wider.
            label.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        figures, half_gap = make_column(*self.lines.values(), gap=0), WIDGET_GAP_PX // 2
        margins = (WIDGET_GAP_PX, half_gap, WIDGET_GAP_PX, 0)
        self._column = self.fill(make_column(self.source_box, choices, figures, margins=margins, gap=half_gap), gap=0)
        self._list_sources()
        self.source_box.activated.connect(self._choose_source)
        self.module_box.activated.connect(self.show_again)
        self._group.buttonClicked.connect(self._choose_axis)

    @cached_property
    def plot(self) -> ErrorPlot:
        """Plot of the error curves, made when the tab is first shown: a third of the time of all panels."""
        plot = ErrorPlot(self._methods, self._modules)
        self._column.addWidget(plot, 1)
        return plot

    def _list_sources(self) -> None:
        self.source_box.clear()
        self.source_box.addItems([source_words(source) for source in self.course.sources])
        self.source_box.setCurrentIndex(self.course.sources.index(self.course.source))

    @property
    def axis(self) -> Axis:
        return next(axis for axis, button in self.axis_buttons.items() if button.isChecked())

    def add_reference(self, reference: TaxelPositions) -> None:
        self.course.offer(reference)
        self._list_sources()

    def show_state(self, state: ViewState) -> None:
        """Draw new errors; while earlier points are being computed, not at each tick."""
        self._state = state
        is_recent = 0.0 <= state.now_s - self._drawn_s < PLOT_REDRAW_PERIOD_S
        if self.isVisible() and not (self._shown and is_recent and self.course.series().missing):
            super().show_state(state)

    def depends_on(self, state: ViewState) -> tuple[object, ...]:  # noqa: ARG002
        return self.course.version, self.axis, self.module_box.currentIndex()

    def update_view(self, state: ViewState) -> None:
        self._drawn_s, row, series = state.now_s, self.module_box.currentIndex(), self.course.series()
        for method, label in self.lines.items():
            mark = f'<span style="color:{theme_colours().methods[method.value]}">{SYMBOL_OF_METHOD[method]}</span>'
            # A narrow panel breaks the line between two figures, not between a name and its number.
            figures = escape(newest_words(series, method, row)).split("   ")
            words = "&nbsp;&nbsp; ".join(figure.replace(" ", "&nbsp;") for figure in figures)
            label.setText(f"{mark} <b>{method.value}</b>&nbsp;&nbsp;{words}")
        self.plot.draw(series, self.axis, row, quantity_words(self.course.source))

    def recolour(self) -> None:
        if self._shown:
            self.plot.recolour()
        super().recolour()

    def restore(self, settings: QSettings) -> None:
        kept = settings.value(AXIS_SETTING, "")
        axis = next((axis for axis in Axis if axis.value == kept), Axis.POKES)
        if axis is not Axis.MODULES or self._modules:
            self.axis_buttons[axis].setChecked(True)
            self._choose_axis()

    def save(self, settings: QSettings) -> None:
        settings.setValue(AXIS_SETTING, self.axis.value)

    def _choose_axis(self) -> None:
        self.module_box.setEnabled(self.axis is not Axis.MODULES)
        self.show_again()

    def _choose_source(self, index: int) -> None:
        self.course.choose(index)
        self.follow_wanted.emit()
        self.show_again()
