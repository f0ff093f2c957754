"""The verdict on a session: one sentence, the figures behind it, what is not done and why, and the way to the file."""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeyEvent, QShowEvent
from PySide6.QtWidgets import (
    QDialog,
    QDialogButtonBox,
    QFormLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QScrollArea,
    QSizePolicy,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from app.panels.widgets import fit_to_screen, make_copyable, plain_buttons, secondary_label, set_bold
from app.text_size import scaled
from app.theme import GAP, HEADLINE_PT
from skincal.guide.verdict import Verdict
from skincal.words.units import ChannelNames, count
from skincal.words.verdict_words import figures, left_words, verdict_sentence

HEADINGS = ("Taxel", "Why it is not done")
WIDTH_PX = 840
LIST_PX = 100
"""Of the list at least; both at 100 %."""
MOST_PX = 660
"""What is higher scrolls: a screen of 720 pixels shows all of it."""


class VerdictDialog(QDialog):
    """Says how it ends; the space bar goes on: to the file or to the session.

    It is the file if it is enough, not every taxel was given up, and nothing speaks against it.
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
        self.heading = secondary_label(f"{count(len(verdict.left), 'taxel')} not done; Enter selects one in the views.")
        self.area, self.words = QScrollArea(), QWidget()
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
        good = verdict.enough and verdict.done > 0 and not verdict.doubted and settled
        first = self.export if good and can_export else self.go_on
        first.setDefault(True)
        first.setFocus()
        self.buttons.accepted.connect(self._export)
        self.buttons.rejected.connect(self.reject)
        self.report.clicked.connect(self.report_wanted)
        self.left.itemActivated.connect(lambda item: self.taxel_wanted.emit(self._channels[item.row()]))

    def _arrange(self) -> None:
        self._arrange_list()
        set_bold(self.sentence, HEADLINE_PT)
        self.sentence.setAccessibleName("verdict")
        form = QFormLayout()
        for name, value in self.figures:
            value.setWordWrap(True)
            form.addRow(secondary_label(name), value)
        words = QVBoxLayout(self.words)
        words.setSpacing(2 * GAP)
        words.addWidget(self.sentence)
        words.addLayout(form)
        words.addWidget(self.heading)
        row = QHBoxLayout()
        row.addWidget(self.left)
        row.addStrut(scaled(LIST_PX) if self._channels else 0)
        words.addLayout(row, 1)
        for widget in (self.heading, self.left):
            widget.setVisible(bool(self._channels))
        self.sentence.setWordWrap(True)
        self.area.setAccessibleName("verdict and figures")
        self.area.setFrameShape(QScrollArea.Shape.NoFrame)
        self.area.setWidgetResizable(True)
        self.area.setWidget(self.words)
        plain_buttons(self.buttons)
        column = QVBoxLayout(self)
        column.addWidget(self.area, 1)
        column.addWidget(self.buttons)
        self.setMinimumWidth(680)

    def _arrange_list(self) -> None:
        table = self.left
        table.setAccessibleName("what is not done")
        table.setHorizontalHeaderLabels(HEADINGS)
        table.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        table.setSelectionBehavior(QTableWidget.SelectionBehavior.SelectRows)
        table.setSelectionMode(QTableWidget.SelectionMode.SingleSelection)
        # Tab goes on to the buttons.
        table.setTabKeyNavigation(False)
        table.setShowGrid(False)
        # It gets what height is left, and scrolls by itself before all of the words do.
        table.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
        table.verticalHeader().hide()
        header = table.horizontalHeader()
        header.setSectionResizeMode(0, QHeaderView.ResizeMode.ResizeToContents)
        header.setStretchLastSection(True)
        header.setHighlightSections(False)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)

    def showEvent(self, event: QShowEvent) -> None:
        """Take the size that the wrapped words need, now that their fonts are known, as far as a low screen has it."""
        super().showEvent(event)
        fit_to_screen(self, (WIDTH_PX, MOST_PX))
        words = self.words.heightForWidth(self.width() - 4 * GAP)
        height = words + self.buttons.sizeHint().height() + 4 * GAP
        fit_to_screen(self, (WIDTH_PX, MOST_PX if self._channels else min(height, MOST_PX)))

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Keep Enter in the list from the default button: it asks for the taxel of its row."""
        if not (self.left.hasFocus() and event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter)):
            super().keyPressEvent(event)

    def _export(self) -> None:
        self.accept()
        self.export_wanted.emit()
