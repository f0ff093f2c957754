"""Text size of the whole window. Widgets with their own font size are rescaled too.

Sizes in the program are points at 100 %; `text_scale` converts them.
"""

from __future__ import annotations

from PySide6.QtCore import QObject, QSettings, Signal
from PySide6.QtGui import QFont, QFontDatabase
from PySide6.QtWidgets import QApplication, QWidget

TEXT_SIZES_PERCENT = (75, 100, 125, 150, 200)  # Per cent of the desktop's own size
DEFAULT_TEXT_SIZE_PERCENT = 100
TEXT_SETTING = "window/text"
_POINTS_PROPERTY = "points"  # Of a widget with its own font size, which the application's font does not change


def text_scale() -> float:
    """Return the text size over that of the desktop."""
    return QApplication.font().pointSizeF() / _desktop_points()


def scaled(size: float) -> int:
    """Scale a size in pixels at 100 % with the text."""
    return round(size * text_scale())


def set_font(widget: QWidget, font: QFont, points: float) -> None:
    """Give a widget its own font, of a size in points at 100 %; it follows the text size."""
    widget.setProperty(_POINTS_PROPERTY, points)
    font.setPointSizeF(points * text_scale())
    widget.setFont(font)


def _desktop_points() -> float:
    return QFontDatabase.systemFont(QFontDatabase.SystemFont.GeneralFont).pointSizeF()


class TextSize(QObject):
    """One of `TEXT_SIZES_PERCENT` for the whole application, kept in the settings."""

    changed = Signal()  # Every widget has its font

    def __init__(self, settings: QSettings, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._settings = settings
        kept = str(settings.value(TEXT_SETTING, DEFAULT_TEXT_SIZE_PERCENT))
        self.percent = DEFAULT_TEXT_SIZE_PERCENT
        self.choose(int(kept) if kept.isdecimal() and int(kept) in TEXT_SIZES_PERCENT else DEFAULT_TEXT_SIZE_PERCENT)

    def larger(self) -> None:
        self.choose(min((step for step in TEXT_SIZES_PERCENT if step > self.percent), default=TEXT_SIZES_PERCENT[-1]))

    def smaller(self) -> None:
        self.choose(max((step for step in TEXT_SIZES_PERCENT if step < self.percent), default=TEXT_SIZES_PERCENT[0]))

    def choose(self, percent: int = DEFAULT_TEXT_SIZE_PERCENT) -> None:
        self.percent = percent
        self._settings.setValue(TEXT_SETTING, percent)
        font = QApplication.font()
        points = _desktop_points() * percent / 100
        if font.pointSizeF() != points:
            font.setPointSizeF(points)
            _resize_all(font)
        self.changed.emit()


def _resize_all(font: QFont) -> None:
    QApplication.setFont(font)
    app = QApplication.instance()
    if isinstance(app, QApplication):
        # Otherwise widgets with a rule in the sheet keep their font.
        app.setStyleSheet(app.styleSheet())
    for widget in QApplication.allWidgets():
        points = widget.property(_POINTS_PROPERTY)
        if points is not None:
            set_font(widget, widget.font(), points)
