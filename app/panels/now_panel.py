"""The status panel at the foot of the window: what to do now in large type, a sign, the tool from above, and the force.

It must be readable from two metres, and without colours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QPointF, QRectF, QSize, Qt
from PySide6.QtGui import QColor, QFontMetrics, QPainter, QPainterPath, QPen, QPolygonF
from PySide6.QtWidgets import QFrame, QLabel, QSizePolicy

from app.panels.layouts import make_column, make_row
from app.panels.top_view import DIAL_RADIUS_M, TopView, top_view
from app.panels.widgets import ElidedLabel, FittedLabel, Painted, digits_font, escape_tooltip, mix, set_bold
from app.state.status_line import Now, Tone
from app.theme import HEADLINE_FONT_SIZE_PT, RESULT_FONT_SIZE_PT, WIDGET_GAP_PX, Colours
from skincal.geometry import FloatArray
from skincal.words.units import degrees, millimetres, newtons

if TYPE_CHECKING:
    from app.state.view_state import ViewState

STATUS_ICON_SIZE_PX = 52
FORCE_GAUGE_WIDTH_PX = 170
TILT_DIAL_SIZE_PX = 104
TILT_DIAL_RIM_WIDTH_PX = 3.0
DIAL_TAXEL_DOT_RADIUS_PX = 2.4
RING_PX, BALL_PX = 6.5, 6.0  # Radius of the ring around the target, and of the ball at the tool's upper end
SIMULATED_LABEL_FONT_SIZE_PT = 12
MIN_REDRAWN_MOVE_PX = 0.2  # A smaller move is not drawn

_TONE_SIGNS: dict[Tone, list[list[tuple[float, float]]]] = {
    Tone.GOOD: [[(-8, 1), (-2, 7), (9, -7)]],
    Tone.BAD: [[(-7, -7), (7, 7)], [(-7, 7), (7, -7)]],
    Tone.GO: [[(0, -9), (0, 8)], [(-7, 1), (0, 8), (7, 1)]],
    Tone.HOLD: [[(0, -8), (0, 8)], [(-7, 8), (7, 8)]],
    Tone.WAIT: [[(-8, 0), (-8, 0)], [(0, 0), (0, 0)], [(8, 0), (8, 0)]],
    Tone.CALM: [[(-7, 0), (7, 0)]],
}
"""Lines of each sign, pixels from its middle, y down."""


class Dial(Painted):
    """Target and tool from above: the direction to lean to, and the tool while it presses. The middle is the target."""

    def __init__(self) -> None:
        super().__init__()
        self.setFixedSize(TILT_DIAL_SIZE_PX, TILT_DIAL_SIZE_PX)
        self._view: TopView | None = None
        self._key: tuple[object, ...] = ()
        self.setAccessibleName("tool on the skin, from above")
        self.setWhatsThis(
            "The skin around the target from above, up as in the 3D view. The tool's upper end must be in the outlined "
            "area. The stick is the tool as the force/torque sensor measures it: a dot at its tip, a ball at its upper end. A "
            "wedge at the rim points to a tip that is further away."
        )

    def show_state(self, state: ViewState) -> None:
        guidance, target = state.guidance, state.target
        self.setVisible(target is not None)
        if guidance is None or target is None:
            return
        coaching = state.coaching
        view = top_view(guidance, target, coaching, state.max_angle_error, state.eye)
        key = self._key_of(view, None if coaching is None else coaching.landed)
        if key != self._key:
            self._key, self._view = key, view
            self.update()
        if coaching is None:
            self.setToolTip(escape_tooltip(f"Target: tilt {degrees(target.tilt)}"))
        else:
            tilt = f"{degrees(coaching.tilt)} (wanted {degrees(target.tilt)})"
            self.setToolTip(escape_tooltip(f"{millimetres(coaching.away)} off target, tilt {tilt}"))

    def _key_of(self, view: TopView, landed: int | None) -> tuple[object, ...]:
        """Return a key that changes whenever the dial must be redrawn."""
        arrays = (view.taxels, view.wanted, view.room, view.tip, view.upper)
        step = MIN_REDRAWN_MOVE_PX / self._scale()
        steps = (b"" if each is None else np.round(each / step).astype(np.int64).tobytes() for each in arrays)
        return (*steps, view.channels.tobytes(), view.right, landed)

    def _scale(self) -> float:
        """Pixels a metre."""
        return (TILT_DIAL_SIZE_PX / 2 - TILT_DIAL_RIM_WIDTH_PX) / DIAL_RADIUS_M

    def _at(self, point: FloatArray) -> QPointF:
        x, y = (self._scale() * point).tolist()
        return QPointF(x, -y)

    def _inside(self, point: FloatArray) -> QPointF:
        """Return the pixel of a point; a point outside the picture is drawn at the rim."""
        size, most = float(np.sqrt(point @ point)), DIAL_RADIUS_M - BALL_PX / self._scale()
        return self._at(point * min(1.0, most / size if size > 0 else 1.0))

    def paint(self, painter: QPainter, colours: Colours) -> None:
        view = self._view
        if view is None:
            return
        painter.translate(TILT_DIAL_SIZE_PX / 2, TILT_DIAL_SIZE_PX / 2)
        radius = TILT_DIAL_SIZE_PX / 2 - TILT_DIAL_RIM_WIDTH_PX / 2
        rim = QRectF(-radius, -radius, 2 * radius, 2 * radius)
        painter.setPen(QPen(QColor(colours.line), TILT_DIAL_RIM_WIDTH_PX - 1))
        painter.setBrush(QColor(colours.window))
        painter.drawEllipse(rim)
        inside = QPainterPath()
        inside.addEllipse(rim.adjusted(1, 1, -1, -1))
        painter.setClipPath(inside)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(mix(colours.muted, colours.window, 0.55))
        for place in view.taxels:
            painter.drawEllipse(self._at(place), DIAL_TAXEL_DOT_RADIUS_PX, DIAL_TAXEL_DOT_RADIUS_PX)
        self._draw_wanted(painter, view, QColor(colours.text))
        if view.tip is not None and view.tip @ view.tip > DIAL_RADIUS_M**2:
            self._draw_wedge(painter, view.tip, colours)
        elif view.tip is not None and view.upper is not None:
            self._draw_tool(painter, self._at(view.tip), self._inside(view.upper), colours, right=view.right)

    def _draw_wanted(self, painter: QPainter, view: TopView, text: QColor) -> None:
        faint = QColor(text)
        faint.setAlphaF(0.10)
        painter.setPen(QPen(text, 1.6))
        painter.setBrush(faint)
        painter.drawPolygon(QPolygonF([self._at(corner) for corner in view.room]))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.setPen(QPen(text, 1.2, Qt.PenStyle.DashLine))
        painter.drawLine(QPointF(0, 0) if view.tip is None else self._at(view.tip), self._at(view.wanted))
        for width, colour in ((5.0, Qt.GlobalColor.black), (2.0, Qt.GlobalColor.white)):
            painter.setPen(QPen(colour, width))
            painter.drawEllipse(QPointF(0, 0), RING_PX, RING_PX)

    def _draw_tool(self, painter: QPainter, tip: QPointF, upper: QPointF, colours: Colours, *, right: bool) -> None:
        colour, edge = QColor(colours.accent if right else colours.bad), QColor(colours.window)
        for each, more in ((edge, 2.5), (colour, 0.0)):
            painter.setPen(QPen(each, 4.0 + more, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
            painter.drawLine(tip, upper)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(each)
            painter.drawEllipse(upper, BALL_PX + more / 2, BALL_PX + more / 2)
        painter.setPen(QPen(edge, 1.0))
        painter.setBrush(QColor(colours.text))
        painter.drawEllipse(tip, 3.5, 3.5)

    def _draw_wedge(self, painter: QPainter, tip: FloatArray, colours: Colours) -> None:
        """Draw a wedge at the rim toward a tip outside the picture."""
        x, y = (tip / np.sqrt(tip @ tip)).tolist()
        out, aside, rim = QPointF(x, -y), QPointF(y, x), TILT_DIAL_SIZE_PX / 2 - TILT_DIAL_RIM_WIDTH_PX
        painter.setPen(QPen(QColor(colours.window), 1.0))
        painter.setBrush(QColor(colours.bad))
        painter.drawPolygon(QPolygonF([out * rim, out * (rim - 12) + aside * 7, out * (rim - 12) - aside * 7]))


_TONE_COLOURS = {
    Tone.GO: "accent",
    Tone.GOOD: "accent",
    Tone.HOLD: "warn",
    Tone.WAIT: "muted",
    Tone.CALM: "muted",
    Tone.BAD: "bad",
}
"""Colour of the theme for each tone."""
_RESULT_MARKS = {Tone.GOOD: "\N{CHECK MARK}", Tone.BAD: "\N{BALLOT X}", Tone.CALM: "\N{BULLET}"}
"""Sign before the result of a poke or an action."""


class Sign(Painted):
    """Status icon in a ring; the ring fills while the poke is held still."""

    def __init__(self) -> None:
        super().__init__()
        self.setFixedSize(STATUS_ICON_SIZE_PX, STATUS_ICON_SIZE_PX)
        self._tone = Tone.CALM
        self._share = 0.0

    def set(self, tone: Tone, share: float) -> None:
        """Show a kind of status, and the share of the required still time that has passed, 0 to 1."""
        if (tone, round(share, 2)) != (self._tone, round(self._share, 2)):
            self._tone, self._share = tone, share
            self.update()

    def paint(self, painter: QPainter, colours: Colours) -> None:
        ring = QRectF(5, 5, STATUS_ICON_SIZE_PX - 10, STATUS_ICON_SIZE_PX - 10)
        colour = QColor(getattr(colours, _TONE_COLOURS[self._tone]))
        painter.setPen(QPen(QColor(colours.line), 5))
        painter.drawEllipse(ring)
        share = self._share if self._tone is Tone.HOLD else (1.0 if self._tone in (Tone.GOOD, Tone.BAD, Tone.GO) else 0.0)
        painter.setPen(QPen(colour, 5, Qt.PenStyle.SolidLine, Qt.PenCapStyle.FlatCap))
        # Qt counts sixteenths of a degree, anticlockwise from three o'clock.
        painter.drawArc(ring, 90 * 16, -round(share * 360 * 16))
        painter.translate(STATUS_ICON_SIZE_PX / 2, STATUS_ICON_SIZE_PX / 2)
        painter.setPen(QPen(colour, 4, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap, Qt.PenJoinStyle.RoundJoin))
        for line in _TONE_SIGNS[self._tone]:
            painter.drawPolyline(QPolygonF([QPointF(x, y) for x, y in line]))


class ForceGauge(Painted):
    """The force of the current press and its accepted range."""

    def __init__(self) -> None:
        super().__init__()
        self.setFixedWidth(FORCE_GAUGE_WIDTH_PX)
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Expanding)
        self._force = 0.0
        self._limits = (4.0, 15.0)
        self.setAccessibleName("force of the poke")

    def sizeHint(self) -> QSize:
        return QSize(FORCE_GAUGE_WIDTH_PX, STATUS_ICON_SIZE_PX)

    def set(self, force: float, low: float, high: float) -> None:
        """Show a force and its limits, N."""
        if round(force, 1) != round(self._force, 1) or (low, high) != self._limits:
            self._force, self._limits = force, (low, high)
            self.update()

    def paint(self, painter: QPainter, colours: Colours) -> None:
        low, high = self._limits
        # Room beyond the limit, so that too much force is seen to grow.
        full = high * 1.25
        metrics = QFontMetrics(painter.font())
        bar = QRectF(1, self.height() - metrics.height() - 13, self.width() - 2, 10)
        x = [bar.left() + bar.width() * min(1.0, v / full) for v in (low, high, self._force)]
        inside = low <= self._force <= high
        pressing = self._force > 0.05
        colour = QColor(colours.accent if inside else colours.bad if self._force > high else colours.warn)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor(colours.raised))
        painter.drawRoundedRect(bar, 3, 3)
        painter.setBrush(QColor(colours.line))
        painter.drawRect(QRectF(x[0], bar.top(), x[1] - x[0], bar.height()))
        if pressing:
            painter.setBrush(colour)
            painter.drawRoundedRect(QRectF(bar.left(), bar.top() + 2, x[2] - bar.left(), bar.height() - 4), 2, 2)
        painter.setPen(QColor(colours.muted))
        for place, value in zip(x[:2], (low, high), strict=True):
            text = f"{value:.0f}"
            painter.drawText(QPointF(place - metrics.horizontalAdvance(text) / 2, bar.bottom() + metrics.ascent() + 1), text)
        painter.setPen(QColor(colours.text if pressing else colours.muted))
        painter.setFont(digits_font(15))
        area = QRectF(0, 0, self.width(), bar.top() - 2)
        flags = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignBottom
        painter.drawText(area, flags, newtons(self._force) if pressing else newtons(None) + " N")


class NowPanel(QFrame):
    """What to do now, and the result of the last poke or action."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("card")
        self._now = Now(Tone.CALM, "")
        self.sign = Sign()
        self.result = FittedLabel()
        self.headline = FittedLabel()
        self.detail = ElidedLabel("muted")
        self.detail.setProperty("quiet", True)
        self.simulated = QLabel(alignment=Qt.AlignmentFlag.AlignRight)
        self.simulated.setToolTip("No robot is connected: a simulated hand presses a simulated robot. Shift+P: change its pace")
        set_bold(self.simulated, SIMULATED_LABEL_FONT_SIZE_PT)
        self.gauge = ForceGauge()
        self.dial = Dial()
        self.dial.hide()
        set_bold(self.headline, HEADLINE_FONT_SIZE_PT)
        set_bold(self.result, RESULT_FONT_SIZE_PT)
        self.headline.setAccessibleName("what to do now")
        self.result.setAccessibleName("last result")
        words = make_column(1, self.result, self.headline, self.detail, 1, gap=2)
        right = make_column(self.simulated, (self.gauge, 1, Qt.AlignmentFlag.AlignRight))
        margins = (2 * WIDGET_GAP_PX, WIDGET_GAP_PX, 2 * WIDGET_GAP_PX, WIDGET_GAP_PX)
        row = make_row(self.sign, self.dial, (words, 1), right, within=self, margins=margins, gap=2 * WIDGET_GAP_PX)
        # The same height with and without the dial, so that nothing moves when the guide is switched off.
        row.addStrut(TILT_DIAL_SIZE_PX + 2)
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Fixed)
        self.setWhatsThis(
            "What to do now: which taxel to press, how to hold the tool, and why. Above it, smaller, the result of the last "
            "poke or key. The ring fills while a poke is held still. The bar is the force; in the lighter band a poke counts."
        )

    def show_state(self, state: ViewState, now: Now) -> None:
        self.dial.show_state(state)
        self.simulated.setText(state.simulated)
        progress, limits = state.live.progress, state.scene.contacts
        # Without devices the last reading is out of date.
        force = float(np.linalg.norm(progress.force)) if state.connected else 0.0
        self.gauge.set(force, limits.force_min, limits.force_max)
        self.gauge.setVisible(state.scene.has_sensor)
        self.say(now, progress.still)

    def say(self, now: Now, share: float = 0.0) -> None:
        said = now.result
        # The sign is visible from further away than words, so it shows the result of the poke first.
        self.sign.set(now.tone if said is None or said.tone is Tone.CALM else said.tone, share)
        if now != self._now:
            self._now = now
            self.result.setText("" if said is None else f"{_RESULT_MARKS[said.tone]}  {said.words}")
            self.result.set_ink("bad" if said is not None and said.tone is Tone.BAD else "text")
            self.headline.setText(now.headline)
            self.detail.setText(now.detail)
            self.headline.set_ink("text" if now.tone in (Tone.WAIT, Tone.CALM) else _TONE_COLOURS[now.tone])
