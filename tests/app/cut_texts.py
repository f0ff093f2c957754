"""Texts that do not fit, measured: each widget's text against its room, and each widget against its window and screen."""

from __future__ import annotations

import re
from collections.abc import Iterator

from PySide6.QtCore import QPoint, QRect, Qt
from PySide6.QtGui import QFontMetrics
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QCheckBox,
    QHeaderView,
    QLabel,
    QMenuBar,
    QRadioButton,
    QScrollArea,
    QTabBar,
    QTreeWidget,
    QWidget,
)

from app.panels.widgets import ElidedLabel

SLACK_PX = 1
CELL_MARGINS_PX = 4
MIN_TABLE_ROWS = 3
"""Rows of a table that are seen at once, of those that it has."""


def plain(text: str) -> str:
    return re.sub(r"&(.)", r"\1", text)


def cut_texts(window: QWidget) -> list[str]:
    """List what is cut in a window: words that are wider or higher than their room, and tables of one line."""
    found: list[str] = []
    for each in window.findChildren(QWidget):
        if each.isVisible() and each.window() is window:
            found += _cuts_of(each)
    return found


def outside(window: QWidget) -> list[str]:
    """List widgets that take input or show words, and that no scrolling brings into the window."""
    found = []
    for each in window.findChildren(QWidget):
        if not each.isVisible() or each.window() is not window or not _matters(each):
            continue
        place = QRect(each.mapTo(window, QPoint(0, 0)), each.size())
        if _is_beside(each, window):
            found.append(f"{_name(each)} reaches over the side of its area")
        elif not _scrolls(each, window) and not window.rect().adjusted(-SLACK_PX, -SLACK_PX, SLACK_PX, SLACK_PX).contains(
            place
        ):
            found.append(f"{_name(each)} at {place.getRect()} of {window.size().toTuple()}")
    return found


def _matters(widget: QWidget) -> bool:
    return (
        isinstance(widget, QLabel | QAbstractButton | QAbstractItemView | QTabBar)
        or widget.focusPolicy() != Qt.FocusPolicy.NoFocus
    )


def _scrolls(widget: QWidget, window: QWidget) -> bool:
    """Whether a scroll area below the window shows the widget on demand."""
    area = widget.parentWidget()
    while area is not None and area is not window:
        if isinstance(area, QScrollArea | QAbstractItemView):
            return True
        area = area.parentWidget()
    return False


def _is_beside(widget: QWidget, window: QWidget) -> bool:
    """Whether the widget reaches over the side of an area that scrolls up and down only."""
    area = widget.parentWidget()
    while area is not None and area is not window:
        if isinstance(area, QScrollArea) and area.horizontalScrollBarPolicy() == Qt.ScrollBarPolicy.ScrollBarAlwaysOff:
            left, room = widget.mapTo(area.viewport(), QPoint(0, 0)).x(), area.viewport().width()
            if left < -SLACK_PX or left + widget.width() > room + SLACK_PX:
                return True
        area = area.parentWidget()
    return False


def _name(widget: QWidget) -> str:
    return f"{type(widget).__name__} {widget.accessibleName() or widget.objectName() or getattr(widget, 'text', str)()!r}"


def _cuts_of(widget: QWidget) -> Iterator[str]:
    if isinstance(widget, QLabel):
        yield from _label(widget)
    elif isinstance(widget, ElidedLabel):
        if widget.text() and widget.height() < widget.fontMetrics().height():
            yield f"{_name(widget)}: height {widget.height()}"
    elif isinstance(widget, QAbstractButton):
        if widget.text() and widget.width() + SLACK_PX < _button_width(widget):
            yield f"{_name(widget)}: {plain(widget.text())!r} has {widget.width()} of {_button_width(widget)}"
    elif isinstance(widget, QHeaderView):
        yield from _header(widget)
    elif isinstance(widget, QTabBar):
        yield from _tabs(widget)
    elif isinstance(widget, QMenuBar):
        last = widget.actionGeometry(widget.actions()[-1])
        if last.isEmpty() or last.right() > widget.width():
            yield f"menu bar: {widget.actions()[-1].text()!r} at {last.getRect()}"
    elif isinstance(widget, QTreeWidget):
        yield from _table(widget)


def _label(label: QLabel) -> Iterator[str]:
    if not label.text() or label.pixmap().width():
        return
    room = label.contentsRect()
    if label.wordWrap():
        need = label.heightForWidth(label.width())
        if need > label.height() + SLACK_PX:
            yield f"{_name(label)}: needs height {need}, has {label.height()}"
        # The longest word decides whether it wraps at all.
        words = re.split(r"[\s/_-]+", re.sub(r"<[^>]*>", " ", label.text()))
        widest = max((label.fontMetrics().horizontalAdvance(word) for word in words), default=0)
        if widest > room.width() + SLACK_PX:
            yield f"{_name(label)}: a word of {widest} in {room.width()}"
    elif label.sizeHint().width() > label.width() + SLACK_PX or label.sizeHint().height() > label.height() + SLACK_PX:
        yield f"{_name(label)}: {plain(label.text())!r} has {label.size().toTuple()} of {label.sizeHint().toTuple()}"


def _button_width(button: QAbstractButton) -> int:
    if isinstance(button, QCheckBox | QRadioButton):
        return button.sizeHint().width()
    return max(QFontMetrics(button.font()).horizontalAdvance(line) for line in plain(button.text()).splitlines()) + 4


def _header(header: QHeaderView) -> Iterator[str]:
    model = header.model()
    if model is None or header.isHidden():
        return
    for column in range(header.count()):
        text = str(model.headerData(column, header.orientation()) or "")
        widest = header.sectionSizeHint(column)
        if not header.isSectionHidden(column) and widest > header.sectionSize(column) + SLACK_PX:
            yield f"header {text!r} of {_name(header.parentWidget())}: {header.sectionSize(column)} of {widest}"


def _tabs(bar: QTabBar) -> Iterator[str]:
    for index in range(bar.count()):
        rect = bar.tabRect(index)
        if rect.right() > bar.width() + SLACK_PX:
            yield f"tab {bar.tabText(index)!r} ends at {rect.right()} of {bar.width()}"
        if rect.width() < bar.fontMetrics().horizontalAdvance(bar.tabText(index)):
            yield f"tab {bar.tabText(index)!r} has {rect.width()}"


def _table(table: QTreeWidget) -> Iterator[str]:
    items = [item for at in range(table.topLevelItemCount()) if (item := table.topLevelItem(at)) is not None]
    if not items:
        return
    height, room = table.visualItemRect(items[0]).height(), table.viewport().height()
    if height and room < min(len(items), MIN_TABLE_ROWS) * height:
        yield f"table {table.accessibleName()}: {room} px for {len(items)} rows of {height}"
    for item in items:
        if table.visualItemRect(item).bottom() < room:
            for column in range(table.columnCount()):
                need = table.fontMetrics().horizontalAdvance(item.text(column)) + CELL_MARGINS_PX
                if need > table.columnWidth(column):
                    yield f"cell {item.text(column)!r} of {table.accessibleName()}: {table.columnWidth(column)} of {need}"
