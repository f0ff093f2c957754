"""Labels, lists and pictures that several panels and dialogs use. They redraw only what has changed."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from PySide6.QtCore import QEvent, QRect, QSize, Qt, Signal
from PySide6.QtGui import (
    QColor,
    QFont,
    QFontDatabase,
    QFontMetrics,
    QGuiApplication,
    QKeySequence,
    QPainter,
    QPaintEvent,
    QPalette,
    QResizeEvent,
    QShortcut,
)
from PySide6.QtWidgets import (
    QAbstractItemView,
    QApplication,
    QComboBox,
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

from app.text_size import scaled, set_font, text_scale
from app.theme import DARK, LIGHT, Colours
from skincal.model.errors import plain_text

MAX_TABLE_ROWS_WITHOUT_SCROLLING = 12  # Rows of a table that is as high as its rows
MIN_FITTED_FONT_SCALE = 0.75  # Large type below this share of its size cannot be read from two metres
POSITION_FILES = "Known positions (*.json *.csv *.urdf *.txt *.ini);;All files (*)"


def theme_colours() -> Colours:
    """Return the colours in use; the application's palette keeps the theme."""
    return DARK if QApplication.palette().window().color().lightness() < 128 else LIGHT


def mix(first: str, second: str, share: float) -> QColor:
    """Return the colour at a share of the way from `first` to `second`."""
    a, b = QColor(first), QColor(second)
    ends = ((a.redF(), b.redF()), (a.greenF(), b.greenF()), (a.blueF(), b.blueF()))
    return QColor.fromRgbF(*(low + (high - low) * share for low, high in ends))


def digits_font(points: float) -> QFont:
    """Return a bold font with digits of equal width, so that live numbers stay in place; size in points at 100 %."""
    font = QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont)
    font.setPointSizeF(points * text_scale())
    font.setBold(True)
    return font


def escape_tooltip(text: str) -> str:
    """Return a tooltip that shows any text literally: Qt would open images that a text in HTML names."""
    return f'<p style="white-space: pre-wrap">{escape(text)}</p>' if "<" in text else text


class ElidedLabel(QWidget):
    """One line in a colour of the theme, with an ellipsis if it does not fit; the tooltip has all of it."""

    def __init__(self, ink: str = "text") -> None:
        super().__init__()
        self._text, self._ink = "", ink
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)

    def text(self) -> str:
        return self._text

    def setText(self, text: str) -> None:  # noqa: N802
        if text != self._text:
            self._text = text
            self.setToolTip(escape_tooltip(text))
            self.setAccessibleDescription(text)
            self.update()

    def set_ink(self, ink: str) -> None:
        """Draw in another colour of the theme."""
        if ink != self._ink:
            self._ink = ink
            self.update()

    def sizeHint(self) -> QSize:
        return QSize(40, self.fontMetrics().height() + 2)

    minimumSizeHint = sizeHint

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setPen(QColor(getattr(theme_colours(), self._ink)))
        painter.setFont(self.fitted())
        text = painter.fontMetrics().elidedText(self._text, Qt.TextElideMode.ElideRight, self.width())
        painter.drawText(self.rect(), Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft, text)
        painter.end()

    def fitted(self) -> QFont:
        return self.font()


class FittedLabel(ElidedLabel):
    """One line of large type; it is drawn smaller if it does not fit, and only then with an ellipsis."""

    def fitted(self) -> QFont:
        """Find the largest font that lets the text fit: the label's own, or down to `MIN_FITTED_FONT_SCALE` of it.

        With a larger text size, large type may shrink to the same absolute size, but not below the text around it.
        """
        font, step = QFont(self.font()), 0.5
        least = MIN_FITTED_FONT_SCALE * font.pointSizeF()
        least = min(least, max(least / text_scale(), QApplication.font().pointSizeF()))
        while QFontMetrics(font).horizontalAdvance(self.text()) > self.width() and font.pointSizeF() - step >= least:
            font.setPointSizeF(font.pointSizeF() - step)
        return font


def secondary_label(text: str = "", *, wrap: bool = False) -> QLabel:
    """Make a label of secondary text."""
    label = QLabel(text)
    label.setProperty("quiet", True)
    label.setWordWrap(wrap)
    return label


def rich_label(*, wrap: bool = False) -> QLabel:
    """Make an empty label that shows HTML."""
    label = QLabel(wordWrap=wrap, textFormat=Qt.TextFormat.RichText)
    # The style sheet makes the text of all other labels plain.
    label.setProperty("rich", True)
    return label


def set_bold(label: QWidget, points: float = 0.0) -> None:
    """Make a label's type bold, and of this size in points at 100 % unless it is 0."""
    font = QFont()
    font.setBold(True)
    if points:
        set_font(label, font, points)
    else:
        label.setFont(font)


class Painted(QWidget):
    """A picture in the theme's colours; Qt repaints it when the palette changes."""

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        self.paint(painter, theme_colours())
        painter.end()

    def paint(self, painter: QPainter, colours: Colours) -> None:
        raise NotImplementedError


def make_copyable(view: QAbstractItemView) -> None:
    """Let Ctrl+C in a table copy rows; see `rows_text`."""
    shortcut = QShortcut(QKeySequence(QKeySequence.StandardKey.Copy), view)
    shortcut.setContext(Qt.ShortcutContext.WidgetShortcut)
    shortcut.activated.connect(lambda: QGuiApplication.clipboard().setText(rows_text(view)))


def rows_text(view: QAbstractItemView) -> str:
    """Return the selected rows, or all without a selection, below their headings; cells are separated by tabs."""
    model = view.model()
    columns = range(model.columnCount())
    chosen = sorted(index.row() for index in view.selectionModel().selectedRows())
    # A narrow column has its unit in a second line.
    heads = [str(model.headerData(column, Qt.Orientation.Horizontal)).replace("\n", ", ") for column in columns]
    rows = [[str(model.index(row, column).data() or "") for column in columns] for row in chosen or range(model.rowCount())]
    # A name with a tab would become two cells.
    return "".join("\t".join(plain_text(cell) for cell in row) + "\n" for row in (heads, *rows))


class FairHeader(QHeaderView):
    """Header that gives each column the room of its heading and cells, and shares the rest in proportion.

    If they need more than there is, the table scrolls if it may, else the widest column is cut.
    """

    def __init__(self, tree: QTreeWidget) -> None:
        super().__init__(Qt.Orientation.Horizontal, tree)
        self._tree = tree
        self.setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        self.setStretchLastSection(False)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.share_room()

    def changeEvent(self, event: QEvent) -> None:
        super().changeEvent(event)
        if event.type() in (QEvent.Type.FontChange, QEvent.Type.StyleChange):
            self.share_room()

    def share_room(self) -> None:
        """Resize the columns; called when the table has other cells."""
        columns = range(self.count())
        widths = [max(self.sectionSizeHint(at), self._tree.sizeHintForColumn(at)) for at in columns]
        room, need = self._tree.viewport().width(), sum(widths)
        can_scroll = self._tree.horizontalScrollBarPolicy() != Qt.ScrollBarPolicy.ScrollBarAlwaysOff
        if not widths or room <= 0:
            return
        if need > room and not can_scroll:
            widest = widths.index(max(widths))
            widths[widest] = max(self.sectionSizeHint(widest), widths[widest] - (need - room))
        elif need < room:
            widths = [width * room // need for width in widths]
            widths[-1] += room - sum(widths)
        for at, width in zip(columns, widths, strict=True):
            if self.sectionSize(at) != width:
                self.resizeSection(at, width)


def table(name: str, headings: Sequence[str], hints: Sequence[str] = ()) -> QTreeWidget:
    """Make an empty table whose rows can be copied; `hints` explain the headings."""
    tree = QTreeWidget()
    tree.setAccessibleName(name)
    tree.setHeader(FairHeader(tree))
    tree.setHeaderLabels(list(headings))
    tree.setRootIsDecorated(False)
    # Qt then measures one row only.
    tree.setUniformRowHeights(True)
    tree.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    for column, hint in enumerate(hints):
        tree.headerItem().setToolTip(column, escape_tooltip(hint))
    make_copyable(tree)
    return tree


def put_rows(tree: QTreeWidget, rows: Sequence[Sequence[str]]) -> None:
    """Show these rows in a table; unchanged cells are not redrawn."""
    while tree.topLevelItemCount() > len(rows):
        tree.takeTopLevelItem(tree.topLevelItemCount() - 1)
    for at, cells in enumerate(rows):
        item = tree.topLevelItem(at) or QTreeWidgetItem(tree)
        for column, text in enumerate(cells):
            item.setText(column, text)
    fit_columns(tree)


def fit_columns(tree: QTreeWidget) -> None:
    """Give the columns of a `table` the room of their cells."""
    header = tree.header()
    if isinstance(header, FairHeader):
        header.share_room()


def fit_rows(tree: QTreeWidget, most: int = MAX_TABLE_ROWS_WITHOUT_SCROLLING) -> None:
    """Make a table as high as its rows, up to `most`; beyond that it scrolls."""
    row = tree.sizeHintForRow(0) if tree.topLevelItemCount() else 0
    height = tree.header().sizeHint().height() + row * min(tree.topLevelItemCount(), most) + 2 * tree.frameWidth() + 2
    if tree.height() != height:
        tree.setFixedHeight(height)


class TaxelList(QListWidget):
    """A list of taxels with a few words on each; an item's user data is its channel."""

    taxel_wanted = Signal(int)

    def __init__(self, name: str) -> None:
        super().__init__()
        self.setAccessibleName(name)
        self.setMinimumHeight(110)
        for chosen in (self.itemActivated, self.itemClicked):
            chosen.connect(lambda item: self.taxel_wanted.emit(item.data(Qt.ItemDataRole.UserRole)))

    def show_taxels(self, entries: Sequence[tuple[int, str]]) -> None:
        """Show channels with their words."""
        while self.count() > len(entries):
            self.takeItem(self.count() - 1)
        for row, (channel, text) in enumerate(entries):
            item = self.item(row) or QListWidgetItem(self)
            item.setData(Qt.ItemDataRole.UserRole, channel)
            item.setText(text)


def panel_scroll_area(area: QScrollArea) -> QWidget:
    """Give a scroll area an inner widget in the panels' colour, and return it."""
    area.setWidgetResizable(True)
    area.setBackgroundRole(QPalette.ColorRole.Base)
    inner = QWidget()
    inner.setBackgroundRole(QPalette.ColorRole.Base)
    inner.setAutoFillBackground(True)
    area.setWidget(inner)
    return inner


def compact_combo(name: str) -> QComboBox:
    """Make an empty combo box that is as wide as its place, not as its longest entry."""
    box = QComboBox()
    box.setAccessibleName(name)
    box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
    box.setMinimumContentsLength(12)
    return box


def room_of(window: QWidget) -> QRect:
    """Return the part of the screen that windows may cover."""
    return window.screen().availableGeometry()


def fit_to_screen(window: QWidget, size: tuple[int, int]) -> None:
    """Resize a window, its width in pixels at 100 %, within the space of the screen, and move it into the screen."""
    window.resize(scaled(size[0]), size[1])
    keep_on_screen(window)


def keep_on_screen(window: QWidget) -> None:
    """Make a window no larger than the screen, and move it into the screen."""
    room = room_of(window)
    if window.width() > room.width() or window.height() > room.height():
        window.resize(window.size().boundedTo(room.size()))
    frame = window.frameGeometry()
    frame.moveRight(min(frame.right(), room.right()))
    frame.moveBottom(min(frame.bottom(), room.bottom()))
    window.move(max(frame.left(), room.left()), max(frame.top(), room.top()))


def with_ending(chosen: str, ending: str) -> Path:
    """Return a path; a name that was typed without an ending gets this one."""
    path = Path(chosen)
    return path if path.suffix else path.with_name(path.name + ending)


def choose_session_folder(field: QLineEdit, parent: QWidget) -> None:
    """Ask for the folder of a new session, and put it into a field unless the dialog is cancelled."""
    path = QFileDialog.getExistingDirectory(parent, "Folder of the new session", str(Path(field.text()).parent))
    if path:
        field.setText(path)
