"""The plot of errors: for each method a solid line for the mean, a dashed one for p95 and a dotted one for the maximum.

The vertical axis is logarithmic, since the first pokes leave ten times the error of the last. A method has a
symbol of its own as well as a hue.

The panel of errors: of each method, against pokes, time or modules; worked out and drawn only while it is on the screen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QSettings, Qt, Signal
from PySide6.QtWidgets import QButtonGroup, QComboBox, QHBoxLayout, QLabel, QSizePolicy, QToolButton, QVBoxLayout, QWidget

from app.panels.plot_panel import PlotPanel, colour_plot, still_plot
from app.panels.widgets import put, quiet
from app.state.view_state import ViewState
from app.text.errors_text import (
    PAPER,
    STATISTICS,
    SYMBOLS,
    Axis,
    axis_words,
    log_ticks,
    newest_words,
    paper_words,
    quantity_words,
    shown_range,
    source_words,
)
from app.text.outcomes import METHOD_NAMES
from app.theme import GAP, LIGHT, Colours, method_hue
from app.units import in_millimetres, in_minutes
from skincal.geometry import FloatArray, IntArray
from skincal.model.skin import Layout
from skincal.session.error_history import MAX, MEAN, P95, ErrorFollower, ErrorSeries
from skincal.taxels.result import Method

STYLES = {MEAN: Qt.PenStyle.SolidLine, P95: Qt.PenStyle.DashLine, MAX: Qt.PenStyle.DotLine}
PLOT_SYMBOLS = {Method.FREE: "o", Method.SURFACE: "d", Method.MODULES: "t1"}
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
        self.symbols = {method: pg.ScatterPlotItem(symbol=PLOT_SYMBOLS[method], size=8) for method in methods}
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


DRAW_S = 0.2
"""s between two drawings while the past is being worked out."""


class ErrorsPanel(PlotPanel):
    """Mean, 95th percentile and maximum of each method, against what is known of the taxels' places.

    Parameters
    ----------
    methods : that the scene has
    layout : names the modules; None where there are none
    """

    source_chosen = Signal()
    """Estimates are to be compared with something else from now on."""

    def __init__(self, methods: tuple[Method, ...], layout: Layout | None, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._methods = [method for method in Method if method in methods]
        self._modules = [] if layout is None else [str(module.id) for module in layout.modules]
        self._course: ErrorFollower | None = None
        self._drawn: object = None
        self._drawn_s = -DRAW_S
        self.plot: ErrorPlot | None = None
        self.source_box = QComboBox()
        self.axis_buttons = {axis: QToolButton() for axis in Axis}
        self.module_box = QComboBox()
        self.lines = {method: QLabel() for method in self._methods}
        self._fill()
        self._column.insertLayout(0, self._head())
        self._column.setAlignment(self._label, Qt.AlignmentFlag.AlignTop)
        self.source_box.activated.connect(self._source_chosen)
        self.module_box.activated.connect(self._show_again)
        self._group.buttonClicked.connect(self._axis_chosen)
        self.setWhatsThis(
            "How far the estimates lie from where the taxels are known to be, for the pokes up to each one; or, where "
            "nothing else is known, how far off they say they are. A poke that was taken out leaves no trace in the course."
        )

    def _fill(self) -> None:
        self._group = QButtonGroup(self)
        for axis, button in self.axis_buttons.items():
            button.setText(axis.value)
            button.setCheckable(True)
            button.setProperty("choice", True)
            button.setToolTip(f"Draw the error against {axis.value}")
            self._group.addButton(button)
        self.axis_buttons[Axis.POKES].setChecked(True)
        self.axis_buttons[Axis.MODULES].setVisible(bool(self._modules))
        self.module_box.addItems(["all taxels", *(f"module {name}" for name in self._modules)])
        self.module_box.setVisible(bool(self._modules))
        self.module_box.setAccessibleName("taxels")
        self.source_box.setAccessibleName("compared with")
        self.source_box.setToolTip("What the estimates are compared with; Ctrl+R takes a file")
        self.source_box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.source_box.setMinimumContentsLength(12)
        self.source_box.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)

    def _head(self) -> QVBoxLayout:
        choices = QHBoxLayout()
        choices.addWidget(quiet("against"))
        for button in self.axis_buttons.values():
            choices.addWidget(button)
        choices.addStretch(1)
        choices.addWidget(self.module_box)
        figures = QVBoxLayout()
        figures.setSpacing(0)
        for label in self.lines.values():
            label.setTextFormat(Qt.TextFormat.RichText)
            # A narrow panel cuts the end off, rather than growing wider.
            label.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
            figures.addWidget(label)
        head = QVBoxLayout()
        head.setContentsMargins(GAP, GAP // 2, GAP, 0)
        head.setSpacing(GAP // 2)
        head.addWidget(self.source_box)
        head.addLayout(choices)
        head.addLayout(figures)
        return head

    def begin(self, course: ErrorFollower) -> None:
        """Take what follows the course of errors; it is followed while the panel is open."""
        self._course = course
        self.show_sources()

    def show_sources(self) -> None:
        """List what estimates can be compared with."""
        if self._course is not None:
            self.source_box.clear()
            self.source_box.addItems([source_words(source) for source in self._course.sources])
            self.source_box.setCurrentIndex(self._course.sources.index(self._course.source))

    def make(self) -> QWidget:
        """Make the plot."""
        self.plot = ErrorPlot(self._methods, self._modules)
        self.plot.set_colours(self._colours)
        return self.plot

    @property
    def axis(self) -> Axis:
        """What errors are drawn against."""
        return next(axis for axis, button in self.axis_buttons.items() if button.isChecked())

    def draw_state(self, state: ViewState) -> None:
        """Draw what is new; nothing happens where nothing is, or where nobody sees it."""
        course = self._course
        if course is None or not self.isVisible():
            return
        wanted = (course.version, self.axis, self.module_box.currentIndex())
        series = None if wanted == self._drawn else course.series()
        if series is None or (series.missing and 0.0 <= state.now_s - self._drawn_s < DRAW_S):
            return
        self._drawn, self._drawn_s = wanted, state.now_s
        row = self.module_box.currentIndex()
        for method, label in self.lines.items():
            mark = f'<span style="color:{method_hue(self._colours, method)}">{SYMBOLS[method]}</span>'
            words = newest_words(series, method, row).replace(" ", "&nbsp;")
            put(label, f"{mark} <b>{METHOD_NAMES[method]}</b>&nbsp;&nbsp;{words}")
        if self.plot is not None:
            self.plot.draw(series, self.axis, row, quantity_words(course.source), paper=course.source is not None)

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self._colours = colours
        self._drawn = None
        if self.plot is not None:
            self.plot.set_colours(colours)

    def restore(self, settings: QSettings) -> None:
        """Draw against what was drawn against."""
        kept = settings.value("window/errors_against", "")
        axis = next((axis for axis in Axis if axis.value == kept), Axis.POKES)
        if axis is not Axis.MODULES or self._modules:
            self.axis_buttons[axis].setChecked(True)
            self._axis_chosen()

    def save(self, settings: QSettings) -> None:
        """Remember what is drawn against."""
        settings.setValue("window/errors_against", self.axis.value)

    def _axis_chosen(self) -> None:
        self.module_box.setEnabled(self.axis is not Axis.MODULES)
        self._show_again()

    def _source_chosen(self, index: int) -> None:
        if self._course is not None:
            self._course.choose(index)
        self.source_chosen.emit()
        self._show_again()

    def _show_again(self) -> None:
        if self._state is not None and self.ready:
            self.draw_state(self._state)
