"""The verdict on a session: one sentence, the figures behind it, what is not done and why, and the way to the file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from PySide6.QtCore import QAbstractTableModel, QModelIndex, QPersistentModelIndex, Qt, Signal
from PySide6.QtGui import QKeyEvent, QShowEvent
from PySide6.QtWidgets import QDialog, QDialogButtonBox, QFormLayout, QHeaderView, QLabel, QTableView, QVBoxLayout, QWidget

from app.panels.widgets import plain_buttons, quiet
from app.text.verdict_text import figures, left_words, sentence
from app.theme import GAP, HEADLINE_PT
from app.units import ChannelNames, count
from skincal.guide.verdict import Left, Verdict

_Index = QModelIndex | QPersistentModelIndex
HEADINGS = ("Taxel", "Why it is not done")


class LeftTable(QAbstractTableModel):
    """A row for each taxel that is not done."""

    def __init__(self, left: Sequence[Left], names: ChannelNames) -> None:
        super().__init__()
        self.left, self._names = left, names

    def rowCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008
        """Return the number of taxels."""
        return 0 if parent.isValid() else len(self.left)

    def columnCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008
        """Return the number of columns."""
        return 0 if parent.isValid() else len(HEADINGS)

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Return the heading of a column."""
        if role == Qt.ItemDataRole.DisplayRole and orientation is Qt.Orientation.Horizontal:
            return HEADINGS[section]
        return None

    def data(self, index: _Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Return a taxel's name, or why it is not done."""
        if role not in (Qt.ItemDataRole.DisplayRole, Qt.ItemDataRole.ToolTipRole):
            return None
        left = self.left[index.row()]
        return self._names.short(left.channel) if index.column() == 0 else left_words(left)


class LeftView(QTableView):
    """The table; Enter or a double click asks for the taxel of its row."""

    taxel_wanted = Signal(int)

    def __init__(self, left: Sequence[Left], names: ChannelNames, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._left = left
        self.setModel(LeftTable(left, names))
        self.setAccessibleName("what is not done")
        self.setSelectionBehavior(QTableView.SelectionBehavior.SelectRows)
        self.setSelectionMode(QTableView.SelectionMode.SingleSelection)
        # Tab goes on to the buttons.
        self.setTabKeyNavigation(False)
        self.verticalHeader().hide()
        self.horizontalHeader().setSectionResizeMode(0, QHeaderView.ResizeMode.ResizeToContents)
        self.horizontalHeader().setStretchLastSection(True)
        self.horizontalHeader().setHighlightSections(False)
        self.horizontalHeader().setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        self.setShowGrid(False)
        self.doubleClicked.connect(self._ask)

    def _ask(self, index: QModelIndex) -> None:
        if index.isValid():
            self.taxel_wanted.emit(self._left[index.row()].channel)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Keep Enter from the dialog's default button."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self._ask(self.currentIndex())
            event.accept()
            return
        super().keyPressEvent(event)


class VerdictDialog(QDialog):
    """Says how it ends; the space bar goes on: to the file if it is enough and nothing speaks against it, else to the session.

    Parameters
    ----------
    rig : what is known of the rig's own errors; empty for nothing
    settled : whether nothing is offered that would change the estimates
    """

    export_wanted = Signal()
    taxel_wanted = Signal(int)

    def __init__(
        self,
        verdict: Verdict,
        names: ChannelNames,
        parent: QWidget | None = None,
        *,
        rig: str = "",
        can_export: bool = True,
        settled: bool = True,
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle("Verdict")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.sentence = QLabel(sentence(verdict))
        shown = (*figures(verdict), *((("Rig", rig),) if rig else ()))
        self.figures = [(name, QLabel(value)) for name, value in shown]
        self.heading = quiet(f"{count(len(verdict.left), 'taxel')} not done; Enter selects one in the views.")
        self.left = LeftView(verdict.left, names)
        self.buttons = QDialogButtonBox()
        self.go_on = self.buttons.addButton("Go on", QDialogButtonBox.ButtonRole.RejectRole)
        self.export = self.buttons.addButton("Export\N{HORIZONTAL ELLIPSIS}", QDialogButtonBox.ButtonRole.AcceptRole)
        self.export.setEnabled(can_export)
        self._arrange()
        first = self.export if verdict.enough and not verdict.doubted and settled and can_export else self.go_on
        first.setDefault(True)
        first.setFocus()
        self.buttons.accepted.connect(self._export)
        self.buttons.rejected.connect(self.reject)
        self.left.taxel_wanted.connect(self.taxel_wanted)

    def _arrange(self) -> None:
        font = self.sentence.font()
        font.setPointSizeF(HEADLINE_PT)
        font.setBold(True)
        self.sentence.setFont(font)
        self.sentence.setAccessibleName("verdict")
        form = QFormLayout()
        for name, value in self.figures:
            value.setWordWrap(True)
            form.addRow(quiet(name), value)
        column = QVBoxLayout(self)
        column.setSpacing(2 * GAP)
        column.addWidget(self.sentence)
        column.addLayout(form)
        column.addWidget(self.heading)
        column.addWidget(self.left, 1)
        column.addWidget(self.buttons)
        for widget in (self.heading, self.left):
            widget.setVisible(self.left.model().rowCount() > 0)
        self.sentence.setWordWrap(True)
        plain_buttons(self.buttons)
        self.setMinimumWidth(680)

    def showEvent(self, event: QShowEvent) -> None:
        """Take the height that the wrapped words need in this width, now that their fonts are known."""
        super().showEvent(event)
        layout = self.layout()
        if layout is not None:
            self.resize(self.width(), max(self.height(), layout.totalHeightForWidth(self.width())))

    def _export(self) -> None:
        self.accept()
        self.export_wanted.emit()
