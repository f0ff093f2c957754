"""The curves of force and moment: the last ten seconds, as the sensor says them, drawn by pyqtgraph.

The time axis ends at the newest reading, not at the clock, so a curve without new readings costs nothing. Ten thousand points
are drawn as the lowest and the highest value of each column of the picture, so that no peak is lost: measured on six curves of
10 000 points, a third of the cost of the plot's own downsampling.

Panels whose plots need pyqtgraph, which is imported beside the window once such a panel is seen; the plots come then.

Here, too, is the panel of the readings, the place of the curves of force and moment.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLabel, QVBoxLayout, QWidget

from app.panels.widgets import quiet
from app.state.policies import curve_range
from app.state.view_state import ViewState
from app.theme import GAP, LIGHT, Colours
from app.units import number
from app.workers.threads import ThreadService
from skincal.geometry import FloatArray
from skincal.model.errors import InputError

SPAN = 10.0
"""s, of the time axis: what the live view keeps."""
COLUMNS = 500
"""Columns of an envelope: about the width of the panel in pixels."""
CURVES_S = 0.09
"""s between two drawings of the curves: six of them cost as much as a picture of the 3D view, which comes thrice as often."""
NUMBERS_S = 0.2
"""s between two changes of the numbers: faster ones cannot be read."""
MEAN_READINGS = 100
"""Readings that the shown number is the mean of, a tenth of a second at 1 kHz."""


def envelope(times: FloatArray, values: FloatArray, columns: int, span: float) -> tuple[FloatArray, FloatArray]:
    """Reduce curves to at most two points a column.

    Columns are cut at multiples of `span/columns` on the time axis itself, so that a sample stays in its column while
    the curve moves on and the picture does not shimmer.

    Parameters
    ----------
    times : (n,) float, seconds, ascending
    values : (n, k) float; NaN is a gap
    columns : columns of the whole span, at least 1
    span : seconds

    Returns
    -------
    times : (m,) float, seconds, m <= 2 (columns + 1), or the input where that is not longer
    values : (m, k) float
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


def still_plot(view: pg.PlotWidget, left_px: int, bottom_px: int) -> Any:
    """Take from a plot what mouse and keys would do to it; return its item.

    Parameters
    ----------
    left_px, bottom_px : size of the axes, so that the curves stand still while the numbers beside them change
    """
    item: Any = view.getPlotItem()
    item.hideButtons()
    item.setMouseEnabled(False, False)
    item.disableAutoRange()
    item.getAxis("left").setWidth(left_px)
    item.getAxis("bottom").setHeight(bottom_px)
    view.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    return item


def colour_plot(view: pg.PlotWidget, colours: Colours) -> None:
    """Give a plot's background and axes the theme's colours."""
    view.setBackground(colours.panel)
    item: Any = view.getPlotItem()
    for name in ("left", "bottom"):
        axis = item.getAxis(name)
        axis.setPen(pg.mkPen(colours.line))
        axis.setTextPen(pg.mkPen(colours.muted))


class Curves(QWidget):
    """Three curves of one quantity under a line of numbers.

    Parameters
    ----------
    title, unit : of the quantity as shown
    factor : shown unit per SI unit
    floor : smallest half height of the axis, shown unit
    decimals : of the numbers
    """

    def __init__(self, title: str, unit: str, factor: float, floor: float, decimals: int) -> None:
        super().__init__()
        self._title, self._unit, self._factor = title, unit, factor
        self._floor, self._decimals = floor, decimals
        self._half = floor
        self._colours = LIGHT
        self.header = QLabel()
        self.header.setTextFormat(Qt.TextFormat.RichText)
        self.header.setContentsMargins(GAP, 2, GAP, 0)
        self.plot = pg.PlotWidget(enableMenu=False)
        self._item = still_plot(self.plot, 44, 18)
        self.plot.setAccessibleName(f"curves of the {title.lower()}")
        self.plot.setMinimumHeight(60)
        self._item.setXRange(-SPAN, 0.0, padding=0.0)
        self._item.setYRange(-self._half, self._half, padding=0.02)
        self.curves = [self.plot.plot() for _ in range(3)]
        for curve in self.curves:
            # No NaN reaches the curves: the readings are whole, and the check costs a pass over them.
            curve.setSkipFiniteCheck(True)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(0)
        column.addWidget(self.header)
        column.addWidget(self.plot, 1)

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self._colours = colours
        colour_plot(self.plot, colours)
        for curve, colour in zip(self.curves, colours.axes, strict=True):
            curve.setPen(pg.mkPen(colour, width=1))

    def draw(self, times: FloatArray, values: FloatArray) -> None:
        """Draw curves.

        Parameters
        ----------
        times : (m,) float, seconds before the newest reading, ascending to 0
        values : (m, 3) float, SI
        """
        shown = values * self._factor
        half = curve_range(self._half, float(np.abs(shown).max(initial=0.0)), self._floor)
        if half != self._half:
            self._half = half
            self._item.setYRange(-half, half, padding=0.02)
        for index, curve in enumerate(self.curves):
            curve.setData(times, np.ascontiguousarray(shown[:, index]))

    def show_numbers(self, newest: FloatArray) -> None:
        """Show the newest values, (3,) float, SI."""
        shown = [number(float(v) * self._factor, self._decimals) for v in newest]
        cells = "".join(
            f'<span style="color:{colour}">&nbsp;&nbsp;{axis}&nbsp;<b>{text}</b></span>'
            for axis, colour, text in zip("xyz", self._colours.axes, shown, strict=True)
        )
        self.header.setText(f'<span style="color:{self._colours.muted}">{self._title}, {self._unit}</span>{cells}')


class CurvesPanel(QWidget):
    """Force above, moment below."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.force = Curves("Force", "N", 1.0, 1.0, 2)
        self.moment = Curves("Moment", "N mm", 1e3, 50.0, 0)
        self._newest_s = -np.inf
        self._numbers_s = -np.inf
        column = QVBoxLayout(self)
        column.setContentsMargins(0, GAP // 2, 0, 0)
        column.setSpacing(0)
        column.addWidget(self.force, 1)
        column.addWidget(self.moment, 1)
        self.setWhatsThis(
            "The last ten seconds of the force/torque sensor, in its own frame and as it says them: offset and drift are "
            "not taken off here, but around each poke."
        )

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
        columns, reduced = envelope(times, wrench, COLUMNS, SPAN)
        before = columns - self._newest_s
        self.force.draw(before, reduced[:, :3])
        self.moment.draw(before, reduced[:, 3:])
        if self._newest_s - self._numbers_s >= NUMBERS_S:
            self._numbers_s = self._newest_s
            mean = wrench[-MEAN_READINGS:].mean(axis=0)
            self.force.show_numbers(mean[:3])
            self.moment.show_numbers(mean[3:])

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self.force.set_colours(colours)
        self.moment.set_colours(colours)
        self._newest_s = self._numbers_s = -np.inf
        for curves in (self.force, self.moment):
            curves.show_numbers(np.full(3, np.nan))


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
