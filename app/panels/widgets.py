"""What several panels are made of: labels, lists and pictures that redraw only what changed and keep to their place."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import QSize, Qt
from PySide6.QtGui import QColor, QFont, QFontMetrics, QIcon, QPainter, QPaintEvent, QPalette
from PySide6.QtWidgets import (
    QAbstractButton,
    QDialogButtonBox,
    QHeaderView,
    QLabel,
    QListWidget,
    QListWidgetItem,
    QScrollArea,
    QSizePolicy,
    QTreeWidget,
    QTreeWidgetItem,
    QWidget,
)

from app.theme import LIGHT, Colours

MOST_ROWS = 12
"""Rows of a list that is as high as its rows."""
LEAST_SHARE = 0.75
"""Share of a large type's size below which it is not read from two metres."""


class ElidedLabel(QWidget):
    """One line of text that ends in an ellipsis where it does not fit; the whole of it is the tooltip."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._text = ""
        self._colour: QColor | None = None
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)

    def text(self) -> str:
        """Return the whole text."""
        return self._text

    def setText(self, text: str) -> None:  # noqa: N802
        """Show another text."""
        if text != self._text:
            self._text = text
            self.setToolTip(text)
            self.setAccessibleDescription(text)
            self.update()

    def set_colour(self, colour: QColor) -> None:
        """Draw in another colour than the palette's."""
        if colour != self._colour:
            self._colour = colour
            self.update()

    def sizeHint(self) -> QSize:
        """Return the height of one line; the width is whatever there is."""
        return QSize(40, self.fontMetrics().height() + 2)

    minimumSizeHint = sizeHint

    def paintEvent(self, _event: QPaintEvent) -> None:
        """Draw what fits."""
        painter = QPainter(self)
        painter.setPen(self._colour or self.palette().windowText().color())
        self.draw(painter)
        painter.end()

    def draw(self, painter: QPainter) -> None:
        """Draw what fits, in the painter's font."""
        text = painter.fontMetrics().elidedText(self._text, Qt.TextElideMode.ElideRight, self.width())
        painter.drawText(self.rect(), Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft, text)


class FittedLabel(ElidedLabel):
    """One line of large type that is drawn smaller where it does not fit, and only then ends in an ellipsis."""

    def fitted(self) -> QFont:
        """Return the font in which the text is drawn: its own, or down to `LEAST_SHARE` of it."""
        font = QFont(self.font())
        least, step = LEAST_SHARE * font.pointSizeF(), 0.5
        while QFontMetrics(font).horizontalAdvance(self.text()) > self.width() and font.pointSizeF() - step >= least:
            font.setPointSizeF(font.pointSizeF() - step)
        return font

    def is_elided(self) -> bool:
        """Return whether the text does not fit even so."""
        return QFontMetrics(self.fitted()).horizontalAdvance(self.text()) > self.width()

    def draw(self, painter: QPainter) -> None:
        """Draw what fits."""
        painter.setFont(self.fitted())
        super().draw(painter)


def quiet(text: str = "", *, wrap: bool = False) -> QLabel:
    """Return a label of secondary text."""
    label = QLabel(text)
    label.setProperty("quiet", True)
    label.setWordWrap(wrap)
    return label


def put(label: QLabel | QAbstractButton, text: str) -> None:
    """Set the text of a label or a button where it differs, so that an unchanged one costs no redraw."""
    if label.text() != text:
        label.setText(text)


def embolden(label: QWidget, points: float = 0.0) -> None:
    """Make a label's type bold, and so many points larger."""
    font = label.font()
    font.setBold(True)
    if points:
        font.setPointSizeF(font.pointSizeF() + points)
    label.setFont(font)


class Painted(QWidget):
    """A widget that is one picture, painted in the theme's colours."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._colours = LIGHT

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self._colours = colours
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        """Paint the picture, with soft edges."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        self.paint(painter)
        painter.end()

    def paint(self, painter: QPainter) -> None:
        """Paint the picture."""
        raise NotImplementedError


def table(name: str, headings: Sequence[str], hints: Sequence[str] = ()) -> QTreeWidget:
    """Return an empty list with columns; `hints` explain their headings."""
    tree = QTreeWidget()
    tree.setAccessibleName(name)
    tree.setHeaderLabels(list(headings))
    tree.setRootIsDecorated(False)
    tree.setUniformRowHeights(True)
    tree.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    tree.header().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
    for column, hint in enumerate(hints):
        tree.headerItem().setToolTip(column, hint)
    return tree


def put_rows(tree: QTreeWidget, rows: Sequence[Sequence[str]]) -> None:
    """Have a table show these rows; cells that are the same are left alone, and rows keep their place."""
    while tree.topLevelItemCount() > len(rows):
        tree.takeTopLevelItem(tree.topLevelItemCount() - 1)
    for at, cells in enumerate(rows):
        item = tree.topLevelItem(at) or QTreeWidgetItem(tree)
        for column, text in enumerate(cells):
            put_cell(item, column, text)


def put_cell(row: QTreeWidgetItem, column: int, text: str) -> None:
    """Set a cell's text where it differs."""
    if row.text(column) != text:
        row.setText(column, text)


def put_taxels(listed: QListWidget, entries: Sequence[tuple[int, str]]) -> None:
    """Have a list show channels with their words; an item's user data is its channel."""
    while listed.count() > len(entries):
        listed.takeItem(listed.count() - 1)
    while listed.count() < len(entries):
        listed.addItem(QListWidgetItem())
    for row, (channel, text) in enumerate(entries):
        item = listed.item(row)
        item.setData(Qt.ItemDataRole.UserRole, channel)
        if item.text() != text:
            item.setText(text)


def on_panel(area: QScrollArea) -> QWidget:
    """Return the inside of a scroll area that has the colour of the panels, without a frame."""
    area.setWidgetResizable(True)
    area.setFrameShape(QScrollArea.Shape.NoFrame)
    area.setBackgroundRole(QPalette.ColorRole.Base)
    inner = QWidget()
    inner.setBackgroundRole(QPalette.ColorRole.Base)
    inner.setAutoFillBackground(True)
    return inner


def plain_buttons(box: QDialogButtonBox) -> None:
    """Take the icons off a dialog's buttons: they come from the desktop and belong to no theme of ours."""
    for button in box.buttons():
        button.setIcon(QIcon())


def fit_rows(tree: QTreeWidget, most: int = MOST_ROWS) -> None:
    """Make a table as high as its rows, which are all alike, up to `most`: it scrolls beyond, and its panel need not."""
    row = tree.sizeHintForRow(0) if tree.topLevelItemCount() else 0
    height = tree.header().sizeHint().height() + row * min(tree.topLevelItemCount(), most) + 2 * tree.frameWidth() + 2
    if tree.height() != height:
        tree.setFixedHeight(height)
