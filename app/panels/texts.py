"""Labels that redraw only when their text changes, and that never push a panel wider than its place."""

from __future__ import annotations

from PySide6.QtCore import QSize, Qt
from PySide6.QtGui import QColor, QFont, QFontMetrics, QIcon, QPainter, QPaintEvent, QPalette
from PySide6.QtWidgets import QDialogButtonBox, QLabel, QScrollArea, QSizePolicy, QTreeWidget, QWidget

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


def put(label: QLabel, text: str) -> None:
    """Set a label's text where it differs, so that an unchanged label costs no redraw."""
    if label.text() != text:
        label.setText(text)


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


def fit_rows(tree: QTreeWidget) -> None:
    """Make a list as high as its rows, which are all alike, up to `MOST_ROWS`: it scrolls beyond, and its panel need not."""
    row = tree.sizeHintForRow(0) if tree.topLevelItemCount() else 0
    height = tree.header().sizeHint().height() + row * min(tree.topLevelItemCount(), MOST_ROWS) + 2 * tree.frameWidth() + 2
    if tree.height() != height:
        tree.setFixedHeight(height)
