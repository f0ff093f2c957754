"""The Readings tab: curves of force and moment over the last ten seconds.

Each column of the picture shows the lowest and the highest of its values, so that no peak is lost. For six curves of 10 000
points this costs a third of the plot's own downsampling (measured).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyqtgraph as pg
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QBoxLayout, QWidget

from app.panels.layouts import make_column
from app.panels.panel import Panel
from app.panels.plot import StillPlot
from app.panels.widgets import rich_label, secondary_label, theme_colours
from app.state.policies import curve_range
from app.state.view_state import ViewState
from app.text_size import scaled
from app.theme import WIDGET_GAP_PX
from skincal.geometry import FloatArray
from skincal.words.units import UNITS, number

if TYPE_CHECKING:
    from skincal.following.guided_session import GuidedSession

TIME_AXIS_SPAN_S = 10.0  # Length of the time axis, as the live view keeps it
TIME_TICK_PERIOD_S = 2.0  # Between the numbers of the time axis
RIGHT_MARGIN_PX = 14  # At the right of a plot at 100 %
MAX_PLOT_COLUMNS_PER_CURVE = 500  # About the width of the panel in pixels
CURVES_REDRAW_PERIOD_S = 0.09
"""Six curves cost as much as a picture of the 3D view, which is drawn three times as often."""
NUMBERS_UPDATE_PERIOD_S = 0.2  # Faster numbers cannot be read
READINGS_PER_SHOWN_MEAN = 100  # Readings in the mean that is shown: a tenth of a second at 1 kHz
NO_SENSOR = "This rig has no force/torque sensor: a poke is the place of the tip. The tab Devices shows the tool's poses."
MIN_PLOT_HEIGHT_PX = 160  # Height of a plot at 100 %; below it the two plots are side by side
PLOTTED_QUANTITIES = (("Force", "N", 1.0, 2), ("Moment", "N m", 50.0, 0))
"""Title, unit, smallest half height of the axis and decimals of each of the `Curves`."""


def min_max_decimation(times: FloatArray, values: FloatArray, columns: int, span: float) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest value of each column of the picture; a shorter input is returned unchanged.

    Columns are cut at multiples of `span/columns` on the time axis itself. So a sample stays in its column while the curve
    moves, and the picture does not shimmer.

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
    # These skip NaN: one bad reading makes no gap in its column.
    low = np.fmin.reduceat(values, starts, axis=0)
    high = np.fmax.reduceat(values, starts, axis=0)
    reduced = np.empty((2 * len(starts), values.shape[1]))
    reduced[0::2], reduced[1::2] = low, high
    edges = column[starts] * width
    return np.repeat(edges, 2) + np.tile((0.0, 0.5 * width), len(starts)), reduced


class Curves(QWidget):
    """Three curves of one quantity under a line of numbers.

    `unit` is SI; `floor` is the smallest half height of the axis in the displayed unit.
    """

    def __init__(self, title: str, unit: str, floor: float, decimals: int) -> None:
        super().__init__()
        self._title, self._unit, self._floor, self._decimals = title, UNITS[unit], floor, decimals
        self._is_broken, self._numbers, self._half = False, np.full(3, np.nan), floor
        self.header = rich_label()
        self.header.setContentsMargins(WIDGET_GAP_PX, 2, WIDGET_GAP_PX, 0)
        self.plot = StillPlot(f"curves of the {title.lower()}", 44, 18, 60)
        self.plot.item.setXRange(-TIME_AXIS_SPAN_S, 0.0, padding=0.0)
        self.plot.item.setYRange(-floor, floor, padding=0.02)
        ticks = np.arange(-TIME_AXIS_SPAN_S, TIME_TICK_PERIOD_S / 2, TIME_TICK_PERIOD_S).tolist()
        axis = self.plot.item.getAxis("bottom")
        axis.setTicks([[(at, f"{at:g}" if at else "0 s") for at in ticks]])
        # Half of the last number is beyond the end of the axis.
        axis.setStyle(hideOverlappingLabels=False)
        # Half a line above, and half a number at the right: neither the number at the upper end nor "0 s" is cut.
        self.plot.item.layout.setContentsMargins(0, 7, scaled(RIGHT_MARGIN_PX), 0)
        self.curves = [self.plot.add_curve() for _ in range(3)]
        make_column(self.header, (self.plot, 1), within=self, margins=0, gap=0)
        self.recolour()

    def recolour(self) -> None:
        self.plot.recolour()
        for curve, colour in zip(self.curves, theme_colours().axes, strict=True):
            curve.setPen(pg.mkPen(colour, width=1))
        self.show_numbers(np.full(3, np.nan))

    def break_header(self, broken: bool) -> None:
        """Put the live numbers below the title of the plot if `broken`, else next to it."""
        if broken != self._is_broken:
            self._is_broken = broken
            self.show_numbers(self._numbers)

    def draw(self, times: FloatArray, values: FloatArray) -> None:
        """Draw the curves: (m,) float, seconds before the newest reading, ascending to 0, and (m, 3) float, SI."""
        shown = values * self._unit.factor
        half = curve_range(self._half, float(np.abs(shown).max(initial=0.0)), self._floor)
        if half != self._half:
            self._half = half
            self.plot.item.setYRange(-half, half, padding=0.02)
        for index, curve in enumerate(self.curves):
            curve.setData(times, np.ascontiguousarray(shown[:, index]))

    def show_numbers(self, newest: FloatArray) -> None:
        """Show the newest values, (3,) float, SI."""
        self._numbers, colours = newest, theme_colours()
        texts = [number(value * self._unit.factor, self._decimals) for value in newest.tolist()]
        cells = "".join(
            f'<span style="color:{colour}">&nbsp;&nbsp;{axis}&nbsp;<b>{text}</b></span>'
            for axis, colour, text in zip("xyz", colours.axes, texts, strict=True)
        )
        title = f'<span style="color:{colours.muted}">{self._title}, {self._unit.text}</span>'
        self.header.setText(f"{title}{'<br>' if self._is_broken else ''}{cells}")


class ReadingsPanel(Panel):
    """Force and moment, one above the other if there is room, else side by side.

    The time axis ends at the newest reading, not at the clock, so a curve without new readings costs nothing.
    """

    title = "Readings"

    def __init__(self, _guided: GuidedSession | None = None) -> None:
        super().__init__()
        self._made: list[Curves] = []
        self._newest_s = self._numbers_s = -np.inf
        self.no_sensor = secondary_label(NO_SENSOR, wrap=True)
        self.no_sensor.hide()
        self._both = self.fill(self.no_sensor, margins=(0, WIDGET_GAP_PX // 2, 0, 0), gap=0)
        self.setWhatsThis(
            "The last ten seconds of the force/torque sensor, in its own frame and as it sends them. Offset and drift are "
            "removed around each poke, not here."
        )

    @property
    def force(self) -> Curves:
        return self.make_curves()[0]

    @property
    def moment(self) -> Curves:
        return self.make_curves()[1]

    def make_next_curves(self) -> bool:
        """Make the curves of force, or then of moment; return whether both are there.

        Not done in `__init__`: pyqtgraph takes long for a plot, and the window makes all panels in one step.
        """
        if len(self._made) < len(PLOTTED_QUANTITIES):
            self._made.append(Curves(*PLOTTED_QUANTITIES[len(self._made)]))
            self._both.addWidget(self._made[-1], 1)
        return len(self._made) == len(PLOTTED_QUANTITIES)

    def make_curves(self) -> list[Curves]:
        """Make the curves that are missing; return those of force and moment."""
        while not self.make_next_curves():
            pass
        return self._made

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Put the plots side by side if they would be too low; their numbers then get a line of their own."""
        super().resizeEvent(event)
        is_low = self.height() < 2 * (scaled(MIN_PLOT_HEIGHT_PX) + self.force.header.sizeHint().height())
        self._both.setDirection(QBoxLayout.Direction.LeftToRight if is_low else QBoxLayout.Direction.TopToBottom)
        for curves in (self.force, self.moment):
            curves.break_header(is_low)

    def depends_on(self, state: ViewState) -> tuple[object, ...]:
        return (float(state.live.wrench_s[-1]) if len(state.live.wrench_s) else 0.0,)

    def update_view(self, state: ViewState) -> None:
        """Draw the newest readings, unless the last drawing is recent."""
        if not state.scene.has_sensor:
            self.no_sensor.show()
            for curves in (self.force, self.moment):
                curves.hide()
            return
        times, wrench = state.live.wrench_s, state.live.wrench
        # A time before the last one is of another session.
        if not len(times) or 0.0 <= times[-1] - self._newest_s < CURVES_REDRAW_PERIOD_S:
            return
        self._newest_s = float(times[-1])
        good = np.isfinite(wrench).all(axis=1)
        if not good.all():
            times, wrench = times[good], wrench[good]
        if not len(times):
            return
        columns, reduced = min_max_decimation(times, wrench, MAX_PLOT_COLUMNS_PER_CURVE, TIME_AXIS_SPAN_S)
        before = columns - self._newest_s
        self.force.draw(before, reduced[:, :3])
        self.moment.draw(before, reduced[:, 3:])
        if self._newest_s - self._numbers_s >= NUMBERS_UPDATE_PERIOD_S:
            self._numbers_s = self._newest_s
            mean = wrench[-READINGS_PER_SHOWN_MEAN:].mean(axis=0)
            self.force.show_numbers(mean[:3])
            self.moment.show_numbers(mean[3:])

    def recolour(self) -> None:
        for curves in self.make_curves():
            curves.recolour()
        self._newest_s = self._numbers_s = -np.inf
        super().recolour()
