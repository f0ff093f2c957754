"""How a taxel's state is drawn: hollow, quarter, half, full, a full square once done, crossed; hue names the module.

Each kind of mark is drawn once, as a stamp, and put wherever it is needed: four thousand taxels cost a dozen milliseconds.
"""

from __future__ import annotations

import math

from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QBrush, QColor, QPainter, QPen, QPixmap, QPolygonF

from app.state.policies import Mark

SMALL = 3.0
"""Pixels. Below this radius a quarter cannot be told from a half; strength tells the state, beside the shape."""
_FILLED: dict[Mark, int] = {Mark.BLIND: 90, Mark.ROUGH: 180}
"""Degrees of the circle that are filled."""
_STRENGTH: dict[Mark, float] = {Mark.UNSEEN: 0.35, Mark.BLIND: 0.55, Mark.ROUGH: 0.75, Mark.GOOD: 1.0}
"""Of a small mark: where even a ring has no room all four are dots, and still differ."""
_HOLLOW = (Mark.UNSEEN, Mark.BLIND)
"""Small marks of taxels that have no estimate."""


def draw_mark(painter: QPainter, centre: QPointF, radius: float, mark: Mark, hue: QColor, crossed: QColor) -> None:
    """Draw one taxel.

    Parameters
    ----------
    painter : with antialiasing
    radius : pixels
    hue : of the module
    crossed : colour of the cross of a taxel that is not used
    """
    circle = QRectF(centre.x() - radius, centre.y() - radius, 2 * radius, 2 * radius)
    if mark is Mark.DEAD:
        _draw_cross(painter, centre, 0.8 * radius, crossed)
        return
    if mark is Mark.DONE:
        painter.fillRect(circle, hue)
        return
    painter.setPen(QPen(hue, max(1.0, 0.26 * radius)))
    painter.setBrush(QBrush(hue) if mark is Mark.GOOD else Qt.BrushStyle.NoBrush)
    painter.drawEllipse(circle)
    if mark in _FILLED:
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QBrush(hue))
        painter.drawPie(circle, 90 * 16, -_FILLED[mark] * 16)


def _draw_cross(painter: QPainter, centre: QPointF, reach: float, colour: QColor) -> None:
    painter.setPen(QPen(colour, max(1.0, 0.3 * reach)))
    for sign in (-1, 1):
        start = QPointF(centre.x() - reach, centre.y() - sign * reach)
        painter.drawLine(start, QPointF(centre.x() + reach, centre.y() + sign * reach))


def draw_wedge(painter: QPainter, centre: QPointF, reach: float, colour: QColor, around: QColor) -> None:
    """Draw the small triangle that says that a taxel may lie elsewhere.

    Parameters
    ----------
    reach : pixels from the middle to a corner
    around : colour of its rim, which sets it off from the mark below
    """
    corners = [(0.0, -1.0), (0.87, 0.5), (-0.87, 0.5)]
    painter.setPen(QPen(around, 1.2))
    painter.setBrush(QBrush(colour))
    painter.drawPolygon(QPolygonF([QPointF(centre.x() + reach * x, centre.y() + reach * y) for x, y in corners]))


def draw_small(painter: QPainter, centre: QPointF, radius: float, mark: Mark, hue: QColor, crossed: QColor) -> None:
    """Draw one taxel too small for quarters and halves: a ring, a dot, a square once done, a cross; parameters as above."""
    # On whole pixels, or the square's corners are as soft as a dot's.
    reach = float(max(1, round(radius)))
    circle = QRectF(centre.x() - reach, centre.y() - reach, 2 * reach, 2 * reach)
    if mark is Mark.DEAD:
        _draw_cross(painter, centre, 0.8 * reach, crossed)
        return
    if mark is Mark.DONE:
        painter.fillRect(circle, hue)
        return
    colour = QColor(hue)
    colour.setAlphaF(_STRENGTH[mark])
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(QBrush(colour))
    painter.drawEllipse(circle)
    if mark in _HOLLOW:
        painter.setCompositionMode(QPainter.CompositionMode.CompositionMode_Clear)
        painter.drawEllipse(circle.adjusted(1.0, 1.0, -1.0, -1.0))
        painter.setCompositionMode(QPainter.CompositionMode.CompositionMode_SourceOver)


class Stamps:
    """Marks of one size, drawn once each.

    Parameters
    ----------
    radius : pixels
    ratio : device pixels a pixel
    """

    def __init__(self, radius: float, ratio: float, crossed: QColor) -> None:
        self._radius = radius
        self._ratio = ratio
        self._crossed = crossed
        self._made: dict[tuple[int, str], QPixmap] = {}
        self.reach = math.ceil(1.2 * radius) + 1.0
        """Pixels from a stamp's corner to its centre."""

    def get(self, mark: int, hue: str) -> QPixmap:
        """Return the stamp of a mark's value in a hue."""
        key = (mark, hue)
        if key not in self._made:
            self._made[key] = self._make(Mark(mark), QColor(hue))
        return self._made[key]

    def _make(self, mark: Mark, hue: QColor) -> QPixmap:
        side = math.ceil(2 * self.reach * self._ratio)
        stamp = QPixmap(side, side)
        stamp.setDevicePixelRatio(self._ratio)
        stamp.fill(Qt.GlobalColor.transparent)
        painter = QPainter(stamp)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        draw = draw_small if self._radius < SMALL else draw_mark
        draw(painter, QPointF(self.reach, self.reach), self._radius, mark, hue, self._crossed)
        painter.end()
        return stamp
