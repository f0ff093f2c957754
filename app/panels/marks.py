"""How a taxel's state is drawn: hollow, quarter, half, full, a full square once done, crossed; hue names the module.

Each kind of mark is drawn once, as a stamp, and put wherever it is needed: four thousand taxels cost a dozen milliseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QBrush, QColor, QPainter, QPen, QPixmap, QPolygonF

from app.policies import Mark

SMALL = 3.5
"""Pixels. Below this radius a fill cannot be told; strength tells the state instead."""
_FILLED: dict[Mark, int] = {Mark.BLIND: 90, Mark.ROUGH: 180}
"""Degrees of the circle that are filled."""
_STRENGTH: dict[Mark, float] = {
    Mark.UNSEEN: 0.25,
    Mark.BLIND: 0.5,
    Mark.ROUGH: 0.75,
    Mark.GOOD: 1.0,
    Mark.DONE: 1.0,
    Mark.DEAD: 0.08,
}


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


def draw_dots(
    painter: QPainter, places: Sequence[Sequence[float]], radius: float, marks: Sequence[int], hues: Sequence[str]
) -> None:
    """Draw thousands of taxels too small for shapes, all of one look at once.

    Parameters
    ----------
    places : x and y in pixels, one a taxel
    radius : pixels
    marks, hues : value of `Mark` and hue, one a taxel
    """
    groups: dict[tuple[int, str], list[QPointF]] = {}
    for mark, hue, (x, y) in zip(marks, hues, places, strict=True):
        groups.setdefault((mark, hue), []).append(QPointF(x, y))
    for (mark, hue), points in groups.items():
        colour = QColor(hue)
        colour.setAlphaF(_STRENGTH[Mark(mark)])
        painter.setPen(QPen(colour, 2 * radius, Qt.PenStyle.SolidLine, Qt.PenCapStyle.SquareCap))
        painter.drawPoints(QPolygonF(points))


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
        draw_mark(painter, QPointF(self.reach, self.reach), self._radius, mark, hue, self._crossed)
        painter.end()
        return stamp
