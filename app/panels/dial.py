"""The tool on the skin from above: where it is asked to lean, and how it is held while it presses.

The middle is the taxel that is asked for. The outlined area is where the tool's upper end may be; the stick is the tool, thick
at the tip and with a ball at its upper end. Shape tells all of it, colour only says it again.
"""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QPainter, QPainterPath, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QWidget

from app.display_units import degrees, millimetres
from app.state.view_state import ViewState
from app.theme import LIGHT, Colours, mix
from app.top_view import AROUND, TopView, top_view
from skincal.geometry.arrays import FloatArray
from skincal.guide.coaching import leeway

DIAL_PX = 104
RIM_PX = 3.0
TAXEL_PX = 2.4
RING_PX = 6.5
"""Radius of the ring around the taxel that is asked for."""
BALL_PX = 6.0
"""Radius of the ball at the tool's upper end."""
FINEST = 0.2
"""Pixels. A smaller move is not drawn."""


class Dial(QWidget):
    """Target and tool from above."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setFixedSize(DIAL_PX, DIAL_PX)
        self._view: TopView | None = None
        self._key: tuple[object, ...] = ()
        self._colours = LIGHT
        self.setAccessibleName("tool on the skin, from above")
        self.setWhatsThis(
            "The skin around the taxel that is asked for, from above, up as in the 3D view. The outlined area is where the "
            "tool's upper end may be. The stick is the tool that presses, as the force/torque sensor feels it: a dot at its "
            "tip, a ball at its upper end; a wedge at the rim where its tip is farther away."
        )

    def show_state(self, state: ViewState) -> None:
        """Show the target of a tick and the tool that presses; nothing is drawn where both are the same."""
        guidance, target = state.guidance, state.target
        self.setVisible(target is not None)
        if guidance is None or target is None:
            return
        told = state.coaching
        view = top_view(guidance, target, told, leeway(guidance), state.eye)
        key = self._looks(view, None if told is None else told.landed)
        if key != self._key:
            self._key, self._view = key, view
            self.update()
        if told is None:
            tip = f"Tilt {degrees(target.tilt)} is asked for"
        else:
            tip = f"Aim {millimetres(told.away)}, tilt {degrees(told.tilt)} of {degrees(target.tilt)}"
        if tip != self.toolTip():
            self.setToolTip(tip)

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self._colours = colours
        self.update()

    def _looks(self, view: TopView, landed: int | None) -> tuple[object, ...]:
        """Return what decides the picture, as finely as it is seen."""
        arrays = (view.taxels, view.wanted, view.room, view.tip, view.upper)
        step = FINEST / self._scale()
        steps = (b"" if each is None else np.round(each / step).astype(np.int64).tobytes() for each in arrays)
        return (*steps, view.channels.tobytes(), view.right, landed)

    def _scale(self) -> float:
        """Pixels a metre."""
        return (DIAL_PX / 2 - RIM_PX) / AROUND

    def _at(self, point: FloatArray) -> QPointF:
        x, y = (self._scale() * point).tolist()
        return QPointF(x, -y)

    def _inside(self, point: FloatArray) -> QPointF:
        """Return where a point is drawn, at the rim where it lies beyond."""
        size, most = float(np.sqrt(point @ point)), AROUND - BALL_PX / self._scale()
        return self._at(point * min(1.0, most / size if size > 0 else 1.0))

    def paintEvent(self, _event: QPaintEvent) -> None:
        """Draw the skin, what is asked for, and the tool."""
        view = self._view
        if view is None:
            return
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.translate(DIAL_PX / 2, DIAL_PX / 2)
        radius = DIAL_PX / 2 - RIM_PX / 2
        rim = QRectF(-radius, -radius, 2 * radius, 2 * radius)
        painter.setPen(QPen(QColor(self._colours.line), RIM_PX - 1))
        painter.setBrush(QColor(self._colours.window))
        painter.drawEllipse(rim)
        inside = QPainterPath()
        inside.addEllipse(rim.adjusted(1, 1, -1, -1))
        painter.setClipPath(inside)
        self._draw_skin(painter, view)
        self._draw_wanted(painter, view)
        if view.tip is not None and view.tip @ view.tip > AROUND**2:
            self._draw_way(painter, view.tip)
        elif view.tip is not None and view.upper is not None:
            self._draw_tool(painter, self._at(view.tip), self._inside(view.upper), right=view.right)
        painter.end()

    def _draw_skin(self, painter: QPainter, view: TopView) -> None:
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(mix(self._colours.muted, self._colours.window, 0.55))
        for place in view.taxels:
            painter.drawEllipse(self._at(place), TAXEL_PX, TAXEL_PX)

    def _draw_wanted(self, painter: QPainter, view: TopView) -> None:
        text = QColor(self._colours.text)
        faint = QColor(text)
        faint.setAlphaF(0.10)
        painter.setPen(QPen(text, 1.6))
        painter.setBrush(faint)
        painter.drawPolygon(QPolygonF([self._at(corner) for corner in view.room]))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.setPen(QPen(text, 1.2, Qt.PenStyle.DashLine))
        painter.drawLine(QPointF(0, 0) if view.tip is None else self._at(view.tip), self._at(view.wanted))
        for width, colour in ((5.0, Qt.GlobalColor.black), (2.0, Qt.GlobalColor.white)):
            painter.setPen(QPen(QColor(colour), width))
            painter.drawEllipse(QPointF(0, 0), RING_PX, RING_PX)

    def _draw_tool(self, painter: QPainter, tip: QPointF, upper: QPointF, *, right: bool) -> None:
        colour = QColor(self._colours.accent if right else self._colours.bad)
        edge = QColor(self._colours.window)
        for each, more in ((edge, 2.5), (colour, 0.0)):
            painter.setPen(QPen(each, 4.0 + more, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
            painter.drawLine(tip, upper)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(each)
            painter.drawEllipse(upper, BALL_PX + more / 2, BALL_PX + more / 2)
        painter.setPen(QPen(edge, 1.0))
        painter.setBrush(QColor(self._colours.text))
        painter.drawEllipse(tip, 3.5, 3.5)

    def _draw_way(self, painter: QPainter, tip: FloatArray) -> None:
        """Draw a wedge at the rim, toward a tip that is farther away than the picture reaches."""
        x, y = (tip / np.sqrt(tip @ tip)).tolist()
        out, aside, rim = QPointF(x, -y), QPointF(y, x), DIAL_PX / 2 - RIM_PX
        painter.setPen(QPen(QColor(self._colours.window), 1.0))
        painter.setBrush(QColor(self._colours.bad))
        painter.drawPolygon(QPolygonF([out * rim, out * (rim - 12) + aside * 7, out * (rim - 12) - aside * 7]))
