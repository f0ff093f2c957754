"""Layouts of widgets, each made in one call. Imports no numpy."""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QBoxLayout, QFormLayout, QHBoxLayout, QLayout, QScrollArea, QVBoxLayout, QWidget

Item: TypeAlias = QWidget | QLayout | int | tuple[Any, ...]
"""A widget, a layout, the share of an empty space, or a tuple: a widget or a layout, its share, and its alignment if any."""
Margins: TypeAlias = int | tuple[int, int, int, int]
"""Pixels on all sides, or left, top, right and bottom."""
AnyBox = TypeVar("AnyBox", bound=QBoxLayout)


def make_column(
    *items: Item, within: QWidget | None = None, margins: Margins | None = None, gap: int | None = None
) -> QVBoxLayout:
    """Put items below each other, `within` a widget if one is given; `gap` is the distance between them in pixels."""
    return _fill_box(QVBoxLayout(), items, within, margins, gap)


def make_row(
    *items: Item, within: QWidget | None = None, margins: Margins | None = None, gap: int | None = None
) -> QHBoxLayout:
    """Put items side by side, as `make_column` puts them below each other."""
    return _fill_box(QHBoxLayout(), items, within, margins, gap)


def make_form(
    *rows: QWidget | QLayout | tuple[Any, Any], within: QWidget | None = None, margins: Margins | None = None
) -> QFormLayout:
    """Put rows below each other: a tuple is a label with its field; a widget or a layout is as wide as the form."""
    form = QFormLayout()
    _place_layout(form, within, margins)
    for row in rows:
        form.addRow(*row) if isinstance(row, tuple) else form.addRow(row)
    return form


def scrolled(inner: QWidget) -> QScrollArea:
    """Put a widget into an area that scrolls where the screen is too small. It follows the focus of the fields."""
    area = QScrollArea(widgetResizable=True)
    area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    area.setFrameShape(QScrollArea.Shape.NoFrame)
    area.setWidget(inner)
    return area


def _fill_box(box: AnyBox, items: tuple[Item, ...], within: QWidget | None, margins: Margins | None, gap: int | None) -> AnyBox:
    _place_layout(box, within, margins)
    if gap is not None:
        box.setSpacing(gap)
    for item in items:
        if isinstance(item, int):
            box.addStretch(item)
            continue
        what, *where = item if isinstance(item, tuple) else (item,)
        box.addLayout(what, *where) if isinstance(what, QLayout) else box.addWidget(what, *where)
    return box


def _place_layout(layout: QLayout, within: QWidget | None, margins: Margins | None) -> None:
    if within is not None:
        within.setLayout(layout)
    if margins is not None:
        layout.setContentsMargins(*((margins,) * 4 if isinstance(margins, int) else margins))
