"""Rows of a table as text for a spreadsheet or a mail."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtGui import QGuiApplication, QKeySequence, QShortcut
from PySide6.QtWidgets import QAbstractItemView

from skincal.model.errors import plain_text


def make_copyable(view: QAbstractItemView) -> None:
    """Have Ctrl+C in a table copy whole rows, as `positions_text` gives them."""
    shortcut = QShortcut(QKeySequence(QKeySequence.StandardKey.Copy), view)
    shortcut.setContext(Qt.ShortcutContext.WidgetShortcut)
    shortcut.activated.connect(lambda: QGuiApplication.clipboard().setText(rows_text(view)))


def rows_text(view: QAbstractItemView) -> str:
    """Return the rows that are selected, or all where none is: a line each, cells parted by tabs, below their headings."""
    model = view.model()
    columns = range(model.columnCount())
    chosen = sorted(index.row() for index in view.selectionModel().selectedRows())
    # A narrow column has its unit in a second line.
    heads = [str(model.headerData(column, Qt.Orientation.Horizontal)).replace("\n", ", ") for column in columns]
    rows = [[str(model.index(row, column).data() or "") for column in columns] for row in chosen or range(model.rowCount())]
    # A name with a tab would be two cells.
    return "".join("\t".join(plain_text(cell) for cell in row) + "\n" for row in (heads, *rows))
