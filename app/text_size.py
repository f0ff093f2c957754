"""How large the text of the window is: the application's font keeps it, and every size that is set apart follows.

Sizes in the program are points at 100 %; `text_scale` brings them to what the operator wants.
"""

from __future__ import annotations

from PySide6.QtCore import QObject, QSettings, Signal
from PySide6.QtGui import QFont, QFontDatabase
from PySide6.QtWidgets import QApplication, QWidget

STEPS = (75, 100, 125, 150, 200)
"""Per cent of the desktop's own size."""
USUAL = 100
SETTING = "window/text"
_POINTS = "points"
"""Property of a widget whose font has a size of its own, which the application's does not reach."""


def text_scale() -> float:
    """Return how many times as large as the desktop's the text is now."""
    return QApplication.font().pointSizeF() / _usual_points()


def scaled(size: float) -> int:
    """Return pixels that text needs, `size` at 100 %, now."""
    return round(size * text_scale())


def set_font(widget: QWidget, font: QFont, points: float) -> None:
    """Give a widget a font of its own, so many points large at 100 %; it follows the text size from then on."""
    widget.setProperty(_POINTS, points)
    font.setPointSizeF(points * text_scale())
    widget.setFont(font)


def _usual_points() -> float:
    """Points of the desktop's own font, which stays while the application's changes."""
    return QFontDatabase.systemFont(QFontDatabase.SystemFont.GeneralFont).pointSizeF()


class TextSize(QObject):
    """One of `STEPS`, the whole application's at once, remembered in the settings."""

    changed = Signal()
    """After every widget has its font."""

    def __init__(self, settings: QSettings, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._settings = settings
        kept = str(settings.value(SETTING, USUAL))
        self.percent = USUAL
        self.choose(int(kept) if kept.isdecimal() and int(kept) in STEPS else USUAL)

    def larger(self) -> None:
        """Take the next step up, if there is one."""
        self.choose(min((step for step in STEPS if step > self.percent), default=STEPS[-1]))

    def smaller(self) -> None:
        """Take the next step down, if there is one."""
        self.choose(max((step for step in STEPS if step < self.percent), default=STEPS[0]))

    def choose(self, percent: int = USUAL) -> None:
        """Give all text of the application this size."""
        self.percent = percent
        self._settings.setValue(SETTING, percent)
        font = QApplication.font()
        points = _usual_points() * percent / 100
        if font.pointSizeF() != points:
            font.setPointSizeF(points)
            _resize_all(font)
        self.changed.emit()


def _resize_all(font: QFont) -> None:
    QApplication.setFont(font)
    app = QApplication.instance()
    if isinstance(app, QApplication):
        # Or what a rule of the sheet is about keeps its font.
        app.setStyleSheet(app.styleSheet())
    for widget in QApplication.allWidgets():
        points = widget.property(_POINTS)
        if points is not None:
            set_font(widget, widget.font(), points)
