"""The verdict on a session: one sentence, the figures behind it, what is not done and why, and the way to the file."""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeyEvent, QShowEvent
from PySide6.QtWidgets import (
    QDialog,
    QDialogButtonBox,
    QFormLayout,
    QHeaderView,
    QLabel,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from app.panels.copying import make_copyable
from app.panels.widgets import embolden, plain_buttons, quiet
from app.theme import GAP, HEADLINE_PT
from app.units import ChannelNames, count
from skincal.guide.verdict import Verdict
from skincal.guide.verdict_words import figures, left_words, verdict_sentence

HEADINGS = ("Taxel", "Why it is not done")


class VerdictDialog(QDialog):
    """Says how it ends; the space bar goes on: to the file if it is enough and nothing speaks against it, else to the session.

    `rig` says what is known of the rig's own errors; it is settled where nothing is offered that would change the estimates.
    """

    export_wanted = Signal()
    report_wanted = Signal()
    """What the dialog says is to be written down; it stays open."""
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
        self.sentence = QLabel(verdict_sentence(verdict))
        shown = (*figures(verdict), *((("Rig", rig),) if rig else ()))
        self.figures = [(name, QLabel(value)) for name, value in shown]
        self.heading = quiet(f"{count(len(verdict.left), 'taxel')} not done; Enter selects one in the views.")
        self.left = QTableWidget(len(verdict.left), len(HEADINGS))
        self._channels = [left.channel for left in verdict.left]
        for row, left in enumerate(verdict.left):
            for column, text in enumerate((names.short(left.channel), left_words(left))):
                self.left.setItem(row, column, QTableWidgetItem(text))
        self.buttons = QDialogButtonBox()
        self.go_on = self.buttons.addButton("Go on", QDialogButtonBox.ButtonRole.RejectRole)
        self.report = self.buttons.addButton("Report\N{HORIZONTAL ELLIPSIS}", QDialogButtonBox.ButtonRole.ActionRole)
        self.export = self.buttons.addButton("Export\N{HORIZONTAL ELLIPSIS}", QDialogButtonBox.ButtonRole.AcceptRole)
        self.export.setEnabled(can_export)
        make_copyable(self.left)
        self._arrange()
        first = self.export if verdict.enough and not verdict.doubted and settled and can_export else self.go_on
        first.setDefault(True)
        first.setFocus()
        self.buttons.accepted.connect(self._export)
        self.buttons.rejected.connect(self.reject)
        self.report.clicked.connect(self.report_wanted)
        self.left.itemActivated.connect(lambda item: self.taxel_wanted.emit(self._channels[item.row()]))

    def _arrange(self) -> None:
        table = self.left
        table.setAccessibleName("what is not done")
        table.setHorizontalHeaderLabels(HEADINGS)
        table.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        table.setSelectionBehavior(QTableWidget.SelectionBehavior.SelectRows)
        table.setSelectionMode(QTableWidget.SelectionMode.SingleSelection)
        # Tab goes on to the buttons.
        table.setTabKeyNavigation(False)
        table.setShowGrid(False)
        table.verticalHeader().hide()
        header = table.horizontalHeader()
        header.setSectionResizeMode(0, QHeaderView.ResizeMode.ResizeToContents)
        header.setStretchLastSection(True)
        header.setHighlightSections(False)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        embolden(self.sentence, HEADLINE_PT)
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
            widget.setVisible(bool(self._channels))
        self.sentence.setWordWrap(True)
        plain_buttons(self.buttons)
        self.setMinimumWidth(680)

    def showEvent(self, event: QShowEvent) -> None:
        """Take the height that the wrapped words need in this width, now that their fonts are known."""
        super().showEvent(event)
        layout = self.layout()
        if layout is not None:
            self.resize(self.width(), max(self.height(), layout.totalHeightForWidth(self.width())))

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Keep Enter in the list from the default button: it asks for the taxel of its row."""
        if not (self.left.hasFocus() and event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter)):
            super().keyPressEvent(event)

    def _export(self) -> None:
        self.accept()
        self.export_wanted.emit()
