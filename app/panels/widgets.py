"""What several panels are made of: labels, lists and pictures that redraw only what changed and keep to their place."""

from __future__ import annotations

import inspect
from abc import ABCMeta, abstractmethod
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TypeVar

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QColor, QFont, QFontDatabase, QFontMetrics, QIcon, QPainter, QPaintEvent, QPalette
from PySide6.QtWidgets import (
    QApplication,
    QComboBox,
    QDialogButtonBox,
    QFileDialog,
    QHeaderView,
    QLabel,
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QScrollArea,
    QSizePolicy,
    QTreeWidget,
    QTreeWidgetItem,
    QWidget,
)

from app.panels.copying import make_copyable
from app.text_size import scaled, set_font, text_scale
from app.theme import DARK, LIGHT, Colours

Made = TypeVar("Made")
MOST_ROWS = 12
"""Rows of a list that is as high as its rows."""
LEAST_SHARE = 0.75
"""Share of a large type's size below which it is not read from two metres."""


def theme_colours() -> Colours:
    """Return the colours that hold: the application's palette is what keeps the theme."""
    return DARK if QApplication.palette().window().color().lightness() < 128 else LIGHT


def mix(first: str, second: str, share: float) -> QColor:
    """Return the colour that lies `share` of the way from `first` to `second`."""
    a, b = QColor(first), QColor(second)
    ends = ((a.redF(), b.redF()), (a.greenF(), b.greenF()), (a.blueF(), b.blueF()))
    return QColor.fromRgbF(*(low + (high - low) * share for low, high in ends))


def digits_font(points: float) -> QFont:
    """Return a bold font whose digits have one width, so that live numbers do not jump, of so many points at 100 %."""
    font = QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont)
    font.setPointSizeF(points * text_scale())
    font.setBold(True)
    return font


def plain_tip(text: str) -> str:
    """Return a tooltip that shows any text as it is: Qt would open what a text that looks like HTML names."""
    return f'<p style="white-space: pre-wrap">{escape(text)}</p>' if "<" in text else text


class ElidedLabel(QWidget):
    """One line in one of the theme's colours, with an ellipsis where it does not fit; the whole of it is the tooltip."""

    def __init__(self, ink: str = "text") -> None:
        super().__init__()
        self._text = ""
        self._ink = ink
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)

    def text(self) -> str:
        """Return the whole text."""
        return self._text

    def setText(self, text: str) -> None:  # noqa: N802
        """Show another text."""
        if text != self._text:
            self._text = text
            self.setToolTip(plain_tip(text))
            self.setAccessibleDescription(text)
            self.update()

    def set_ink(self, ink: str) -> None:
        """Draw in another of the theme's colours."""
        if ink != self._ink:
            self._ink = ink
            self.update()

    def sizeHint(self) -> QSize:
        """Return the height of one line; the width is whatever there is."""
        return QSize(40, self.fontMetrics().height() + 2)

    minimumSizeHint = sizeHint

    def paintEvent(self, _event: QPaintEvent) -> None:
        """Draw what fits."""
        painter = QPainter(self)
        painter.setPen(QColor(getattr(theme_colours(), self._ink)))
        self.draw(painter)
        painter.end()

    def draw(self, painter: QPainter) -> None:
        """Draw what fits, in the painter's font."""
        text = painter.fontMetrics().elidedText(self._text, Qt.TextElideMode.ElideRight, self.width())
        painter.drawText(self.rect(), Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft, text)


class FittedLabel(ElidedLabel):
    """One line of large type that is drawn smaller where it does not fit, and only then ends in an ellipsis."""

    def fitted(self) -> QFont:
        """Return the font in which the text is drawn: its own, or down to `LEAST_SHARE` of it.

        Where all text is larger, large type gives way down to the same size as else, before it is cut off, but not below the
        size of the text around.
        """
        font, step = QFont(self.font()), 0.5
        least = LEAST_SHARE * font.pointSizeF()
        least = min(least, max(least / text_scale(), QApplication.font().pointSizeF()))
        while QFontMetrics(font).horizontalAdvance(self.text()) > self.width() and font.pointSizeF() - step >= least:
            font.setPointSizeF(font.pointSizeF() - step)
        return font

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


def embolden(label: QWidget, points: float = 0.0) -> None:
    """Make a label's type bold, and so many points large at 100 % where that is said."""
    font = QFont()
    font.setBold(True)
    if points:
        set_font(label, font, points)
    else:
        label.setFont(font)


class AbstractWidget(ABCMeta, type(QWidget)):
    """The type of widgets that only a subclass makes whole; Qt's own type leaves out Python's look at that."""

    def __call__(cls: type[Made], *given: object, **named: object) -> Made:
        """Make a widget of a class that lacks nothing."""
        if inspect.isabstract(cls):
            raise TypeError(f"{cls.__name__} is made by its subclasses")
        return type.__call__(cls, *given, **named)


class Painted(QWidget, metaclass=AbstractWidget):
    """A widget that is one picture, painted in the theme's colours; Qt has it painted anew when its palette changes."""

    def paintEvent(self, _event: QPaintEvent) -> None:
        """Paint the picture, with soft edges."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        self.paint(painter, theme_colours())
        painter.end()

    @abstractmethod
    def paint(self, painter: QPainter, colours: Colours) -> None:
        """Paint the picture."""


def table(name: str, headings: Sequence[str], hints: Sequence[str] = ()) -> QTreeWidget:
    """Return an empty list with columns, whose rows are copied by Ctrl+C; `hints` explain their headings."""
    tree = QTreeWidget()
    tree.setAccessibleName(name)
    tree.setHeaderLabels(list(headings))
    tree.setRootIsDecorated(False)
    # Qt then measures one row for all of them.
    tree.setUniformRowHeights(True)
    tree.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    tree.header().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
    for column, hint in enumerate(hints):
        tree.headerItem().setToolTip(column, plain_tip(hint))
    make_copyable(tree)
    return tree


def put_rows(tree: QTreeWidget, rows: Sequence[Sequence[str]]) -> None:
    """Have a table show these rows; rows keep their place, and Qt leaves cells alone that are the same."""
    while tree.topLevelItemCount() > len(rows):
        tree.takeTopLevelItem(tree.topLevelItemCount() - 1)
    for at, cells in enumerate(rows):
        item = tree.topLevelItem(at) or QTreeWidgetItem(tree)
        for column, text in enumerate(cells):
            item.setText(column, text)


class TaxelList(QListWidget):
    """A list of taxels with a word on each; an item's user data is its channel."""

    taxel_wanted = Signal(int)

    def __init__(self, name: str) -> None:
        super().__init__()
        self.setAccessibleName(name)
        self.setMinimumHeight(110)
        for chosen in (self.itemActivated, self.itemClicked):
            chosen.connect(lambda item: self.taxel_wanted.emit(item.data(Qt.ItemDataRole.UserRole)))

    def show_taxels(self, entries: Sequence[tuple[int, str]]) -> None:
        """Show channels with their words; rows keep their place."""
        while self.count() > len(entries):
            self.takeItem(self.count() - 1)
        for row, (channel, text) in enumerate(entries):
            item = self.item(row) or QListWidgetItem(self)
            item.setData(Qt.ItemDataRole.UserRole, channel)
            item.setText(text)


def on_panel(area: QScrollArea) -> QWidget:
    """Return the inside of a scroll area that has the colour of the panels; its frame is seen while it has the focus."""
    area.setWidgetResizable(True)
    area.setBackgroundRole(QPalette.ColorRole.Base)
    inner = QWidget()
    inner.setBackgroundRole(QPalette.ColorRole.Base)
    inner.setAutoFillBackground(True)
    return inner


def short_box(name: str) -> QComboBox:
    """Return an empty box of choices that is as wide as its place, not as its longest words."""
    box = QComboBox()
    box.setAccessibleName(name)
    box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
    box.setMinimumContentsLength(12)
    return box


def fit_to_screen(window: QWidget, size: tuple[int, int]) -> None:
    """Give a window a size, pixels at 100 % for its width, as far as the screen has room, and bring all of it there."""
    room = window.screen().availableGeometry()
    window.resize(QSize(scaled(size[0]), size[1]).boundedTo(room.size()))
    frame = window.frameGeometry()
    frame.moveRight(min(frame.right(), room.right()))
    frame.moveBottom(min(frame.bottom(), room.bottom()))
    window.move(max(frame.left(), room.left()), max(frame.top(), room.top()))


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


def choose_scene(box: QComboBox, parent: QWidget) -> None:
    """Ask for the file of a scene, and put it into an editable box; nothing changes where none is chosen."""
    path, _ = QFileDialog.getOpenFileName(parent, "Scene", box.currentText(), "Scene (*.toml)")
    if path:
        box.setEditText(path)


def choose_session_folder(field: QLineEdit, parent: QWidget) -> None:
    """Ask where a new session is to lie, and put it into a field; nothing changes where nothing is chosen."""
    path = QFileDialog.getExistingDirectory(parent, "Folder of the new session", str(Path(field.text()).parent))
    if path:
        field.setText(path)
