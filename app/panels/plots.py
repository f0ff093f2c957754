"""The plots, drawn by pyqtgraph: the curves of force and moment, and the course of errors.

Ten thousand points are drawn as the lowest and the highest value of each column of the picture, so that no peak is lost:
measured on six curves of 10 000 points, a third of the cost of the plot's own downsampling.

It is imported once a panel with a plot is seen: pyqtgraph takes a quarter of a second, and the 3D view comes first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QBoxLayout, QLabel, QVBoxLayout, QWidget

from app.panels.widgets import theme_colours
from app.state.policies import curve_range
from app.state.view_state import ViewState
from app.text.errors_text import PAPER, STATISTICS, Axis, axis_words, log_ticks, paper_words, shown_range
from app.text_size import scaled
from app.theme import GAP, method_hue
from skincal.geometry import FloatArray, IntArray
from skincal.session.error_history import MAX, MEAN, P95, ErrorSeries
from skincal.taxels.result import Method
from skincal.words.units import UNITS, in_millimetres, in_minutes, number

SPAN = 10.0
"""s, of the time axis: what the live view keeps."""
COLUMNS = 500
"""Columns of the curves: about the width of the panel in pixels."""
CURVES_S = 0.09
"""s between two drawings of the curves: six of them cost as much as a picture of the 3D view, which comes thrice as often."""
NUMBERS_S = 0.2
"""s between two changes of the numbers: faster ones cannot be read."""
MEAN_READINGS = 100
"""Readings that the shown number is the mean of, a tenth of a second at 1 kHz."""

PLOT_PX = 160
"""Height of a plot at 100 %, down to which the two stand one above the other."""

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


def min_max_decimation(times: FloatArray, values: FloatArray, columns: int, span: float) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest value of each column of the picture, or the input where that is not longer.

    Columns are cut at multiples of `span/columns` on the time axis itself, so that a sample stays in its column while
    the curve moves on and the picture does not shimmer.

    Parameters
    ----------
    times : (n,) float, seconds, ascending
    values : (n, k) float; NaN is a gap
    columns : of the whole span, in seconds
    """
    if len(times) <= 2 * columns:
        return times, values
    width = span / columns
    column = np.floor(times / width)
    starts = np.flatnonzero(np.diff(column, prepend=column[0] - 1.0))
    # These pass over NaN: one bad reading makes no gap in its column.
    low = np.fmin.reduceat(values, starts, axis=0)
    high = np.fmax.reduceat(values, starts, axis=0)
    reduced = np.empty((2 * len(starts), values.shape[1]))
    reduced[0::2], reduced[1::2] = low, high
    edges = column[starts] * width
    return np.repeat(edges, 2) + np.tile((0.0, 0.5 * width), len(starts)), reduced


class StillPlot(pg.PlotWidget):
    """A plot in the theme's colours to which mouse and keys do nothing.

    Its axes keep their sizes in pixels, so that the curves stand still while the numbers beside them change.
    """

    def __init__(self, name: str, left_px: int, bottom_px: int, least_px: int) -> None:
        super().__init__(enableMenu=False)
        self.item: Any = self.getPlotItem()
        self.item.hideButtons()
        self.item.setMouseEnabled(False, False)
        self.item.disableAutoRange()
        self._axes_px = left_px, bottom_px
        self._fit_axes()
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setAccessibleName(name)
        self.setMinimumHeight(least_px)

    def _fit_axes(self) -> None:
        left_px, bottom_px = self._axes_px
        self.item.getAxis("left").setWidth(scaled(left_px))
        self.item.getAxis("bottom").setHeight(scaled(bottom_px))

    def changeEvent(self, event: QEvent) -> None:
        """Leave room for numbers of another size."""
        super().changeEvent(event)
        if event.type() is QEvent.Type.FontChange:
            self._fit_axes()

    def curve(self) -> Any:
        """Add a curve; no NaN may reach it, since looking for one costs a pass over its points."""
        made: Any = self.item.plot()
        made.setSkipFiniteCheck(True)
        return made

    def recolour(self) -> None:
        """Follow the theme."""
        colours = theme_colours()
        self.setBackground(colours.panel)
        for name in ("left", "bottom"):
            self.item.getAxis(name).setPen(pg.mkPen(colours.line))
            self.item.getAxis(name).setTextPen(pg.mkPen(colours.muted))


class Curves(QWidget):
    """Three curves of one quantity under a line of numbers.

    The unit is SI; `floor` is the smallest half height of the axis in the shown unit.
    """

    def __init__(self, title: str, unit: str, floor: float, decimals: int) -> None:
        super().__init__()
        self._title, self._unit = title, UNITS[unit]
        self._floor, self._decimals = floor, decimals
        self._broken, self._shown = False, np.full(3, np.nan)
        self._half = floor
        self.header = QLabel()
        self.header.setTextFormat(Qt.TextFormat.RichText)
        self.header.setProperty("rich", True)
        self.header.setContentsMargins(GAP, 2, GAP, 0)
        self.plot = StillPlot(f"curves of the {title.lower()}", 44, 18, 60)
        self.plot.item.setXRange(-SPAN, 0.0, padding=0.0)
        self.plot.item.setYRange(-floor, floor, padding=0.02)
        # Half a line, so that a number at the upper end is whole.
        self.plot.item.layout.setContentsMargins(0, 7, 0, 0)
        self.curves = [self.plot.curve() for _ in range(3)]
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(0)
        column.addWidget(self.header)
        column.addWidget(self.plot, 1)
        self.recolour()

    def recolour(self) -> None:
        """Follow the theme."""
        self.plot.recolour()
        for curve, colour in zip(self.curves, theme_colours().axes, strict=True):
            curve.setPen(pg.mkPen(colour, width=1))
        self.show_numbers(np.full(3, np.nan))

    def break_header(self, broken: bool) -> None:
        """Have the numbers in a line of their own, below the title, or beside it."""
        if broken != self._broken:
            self._broken = broken
            self.show_numbers(self._shown)

    def draw(self, times: FloatArray, values: FloatArray) -> None:
        """Draw curves.

        Parameters
        ----------
        times : (m,) float, seconds before the newest reading, ascending to 0
        values : (m, 3) float, SI
        """
        shown = values * self._unit.factor
        half = curve_range(self._half, float(np.abs(shown).max(initial=0.0)), self._floor)
        if half != self._half:
            self._half = half
            self.plot.item.setYRange(-half, half, padding=0.02)
        for index, curve in enumerate(self.curves):
            curve.setData(times, np.ascontiguousarray(shown[:, index]))

    def show_numbers(self, newest: FloatArray) -> None:
        """Show the newest values, (3,) float, SI."""
        self._shown = newest
        shown = [number(float(v) * self._unit.factor, self._decimals) for v in newest]
        colours = theme_colours()
        cells = "".join(
            f'<span style="color:{colour}">&nbsp;&nbsp;{axis}&nbsp;<b>{text}</b></span>'
            for axis, colour, text in zip("xyz", colours.axes, shown, strict=True)
        )
        title = f'<span style="color:{colours.muted}">{self._title}, {self._unit.text}</span>'
        self.header.setText(f"{title}{'<br>' if self._broken else ''}{cells}")


class CurvesPanel(QWidget):
    """Force and moment, one above the other where both are high enough, else side by side: the last ten seconds.

    The time axis ends at the newest reading, not at the clock, so a curve without new readings costs nothing.
    """

    def __init__(self) -> None:
        super().__init__()
        self.force = Curves("Force", "N", 1.0, 2)
        self.moment = Curves("Moment", "N m", 50.0, 0)
        self._newest_s = -np.inf
        self._numbers_s = -np.inf
        self._both = QBoxLayout(QBoxLayout.Direction.TopToBottom, self)
        self._both.setContentsMargins(0, GAP // 2, 0, 0)
        self._both.setSpacing(0)
        self._both.addWidget(self.force, 1)
        self._both.addWidget(self.moment, 1)
        self.setWhatsThis(
            "The last ten seconds of the force/torque sensor, in its own frame and as it says them: offset and drift are "
            "not taken off here, but around each poke."
        )

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Give each plot `PLOT_PX` of height: on a small screen side by side, where its numbers take a line of their own."""
        super().resizeEvent(event)
        beside = self.height() < 2 * (scaled(PLOT_PX) + self.force.header.sizeHint().height())
        self._both.setDirection(QBoxLayout.Direction.LeftToRight if beside else QBoxLayout.Direction.TopToBottom)
        for curves in (self.force, self.moment):
            curves.break_header(beside)

    def show_state(self, state: ViewState) -> None:
        """Draw the newest readings; nothing where there are no newer ones."""
        times, wrench = state.live.wrench_s, state.live.wrench
        # Time that went back is another session's, and is drawn at once.
        if not len(times) or 0.0 <= times[-1] - self._newest_s < CURVES_S:
            return
        self._newest_s = float(times[-1])
        good = np.isfinite(wrench).all(axis=1)
        if not good.all():
            times, wrench = times[good], wrench[good]
        if not len(times):
            return
        columns, reduced = min_max_decimation(times, wrench, COLUMNS, SPAN)
        before = columns - self._newest_s
        self.force.draw(before, reduced[:, :3])
        self.moment.draw(before, reduced[:, 3:])
        if self._newest_s - self._numbers_s >= NUMBERS_S:
            self._numbers_s = self._newest_s
            mean = wrench[-MEAN_READINGS:].mean(axis=0)
            self.force.show_numbers(mean[:3])
            self.moment.show_numbers(mean[3:])

    def recolour(self) -> None:
        """Follow the theme."""
        self.force.recolour()
        self.moment.recolour()
        self._newest_s = self._numbers_s = -np.inf


class ErrorPlot(StillPlot):
    """The course of errors: for each method a solid line for the mean, a dashed one for p95 and a dotted one for the maximum.

    The vertical axis is logarithmic, since the first pokes leave ten times the error of the last. A method has a symbol of its
    own as well as a hue. The plot keeps nothing but what it draws.
    """

    def __init__(self, methods: Sequence[Method], modules: Sequence[str]) -> None:
        super().__init__("course of the errors", 46, 34, 90)
        self._modules = modules
        self._across = (0.0, 1.0)
        """What is drawn reaches from here to there."""
        self.curves: dict[tuple[Method, int], Any] = {(m, at): self.curve() for m in methods for at in STATISTICS}
        self.symbols = {method: pg.ScatterPlotItem(symbol=PLOT_SYMBOLS[method], size=8) for method in methods}
        self.papers = {method: self._paper(method) for method in methods if method in PAPER}
        for item in (*self.symbols.values(), *self.papers.values()):
            self.item.addItem(item)
        self.item.getViewBox().sigResized.connect(self._keep_rim)
        self.recolour()

    def _paper(self, method: Method) -> pg.InfiniteLine:
        # The two lie close together: one has its label above, the other below. Both touch their line, which goes on
        # to the right rim, where no curve is.
        anchor = (1.0, 1.0 - TEXT_MARGIN if method is Method.FREE else TEXT_MARGIN)
        options = {"position": 1.0, "anchors": [anchor, anchor], "movable": False}
        place = math.log10(in_millimetres(PAPER[method]))
        return pg.InfiniteLine(place, angle=0, label=paper_words(method), labelOpts=options)

    def recolour(self) -> None:
        """Follow the theme."""
        super().recolour()
        colours = theme_colours()
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
        axis = self.item.getAxis(side)
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
        self.item.setYRange(math.log10(low), math.log10(high), padding=0.02)
        self.item.getAxis("left").setTicks([log_ticks(low, high)])
        for line in self.papers.values():
            line.setVisible(paper)
        if axis is Axis.MODULES:
            step = math.ceil(len(self._modules) / NUMBERS_SHOWN)
            self.item.getAxis("bottom").setTicks([[(at, name) for at, name in enumerate(self._modules) if at % step == 0]])
            self._across = (-0.6, max(1, len(self._modules)) - 0.4)
        else:
            # None gives the axis its own ticks back, after those of the modules.
            self.item.getAxis("bottom").setTicks(None)
            along, least = (series.counts, 10.0) if axis is Axis.POKES else (in_minutes(series.times), 1.0)
            longest = max(float(along[-1]) if len(along) else 0.0, least)
            self._across = (-0.01 * longest, 1.01 * longest)
        self._keep_rim()

    def _keep_rim(self) -> None:
        """Show what is drawn, and keep room for the labels at the right of it."""
        low, high = self._across
        labels = [line.label.textItem.boundingRect().width() for line in self.papers.values() if line.isVisible()]
        share = min(RIM_MOST, max(labels, default=0.0) / max(1.0, self.item.getViewBox().width()))
        self.item.setXRange(low, low + (high - low) / (1.0 - share), padding=0.0)


def _joined(series: ErrorSeries) -> IntArray:
    """Return 1 where a point is joined to the next, 0 where something between them is still worked out, (n,) int."""
    return (np.diff(series.counts, append=0) <= series.stride).astype(np.int64)
