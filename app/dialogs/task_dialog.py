"""Base of the dialogs that run one task for one method and show its outcome."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtWidgets import QComboBox, QDialogButtonBox, QFormLayout, QListWidget, QWidget

from app.dialogs.dialog import Dialog
from app.panels.widgets import secondary_label
from skincal.taxels.result import Method

DIALOG_MIN_WIDTH_PX = 560
REMARKS_MIN_HEIGHT_PX = 80


class TaskDialog(Dialog):
    """Dialog of a task: method, start button, outcome and remarks; it stays open while the task runs."""

    def __init__(self, title: str, start: str, methods: Sequence[Method], shown: Method, parent: QWidget | None) -> None:
        super().__init__(title, parent)
        self.setMinimumWidth(DIALOG_MIN_WIDTH_PX)
        self.method = QComboBox()
        for method in methods:
            self.method.addItem(method.value, method)
        self.method.setCurrentIndex(self.method.findData(shown))
        self.form = QFormLayout()
        self.outcome = secondary_label(wrap=True)
        self.remarks = QListWidget()
        self.remarks.setWordWrap(True)
        self.start = self.buttons.addButton(start, QDialogButtonBox.ButtonRole.ActionRole)
        self.column = self.fill(self.form, self.outcome, (self.remarks, 1))
        # The list keeps its room, so that the buttons stay in their place.
        policy = self.remarks.sizePolicy()
        policy.setRetainSizeWhenHidden(True)
        self.remarks.setSizePolicy(policy)
        self.remarks.setMinimumHeight(REMARKS_MIN_HEIGHT_PX)
        self.outcome.setMinimumHeight(2 * self.outcome.fontMetrics().height())
        self.remarks.hide()

    def begin_task(self, words: str) -> None:
        """Show that the task runs; the next Space or Enter closes the dialog once it has ended."""
        # A button that is disabled while it has the focus would pass the focus to any other widget.
        self.button().setFocus()
        self.start.setEnabled(False)
        self.remarks.hide()
        self.outcome.setText(words)

    def end_task(self) -> None:
        """Allow another start of the task, and closing of the dialog."""
        self.start.setEnabled(True)

    def show_outcome(self, sentence: str, remarks: Sequence[str] = (), *, good: bool) -> None:
        """Show the outcome with a sign, and its remarks in the list."""
        self.end_task()
        sign = "\N{CHECK MARK}" if good else "\N{BALLOT X}"
        self.outcome.setText(f"{sign} {sentence}")
        self.remarks.clear()
        self.remarks.addItems(list(remarks))
        self.remarks.setVisible(bool(remarks))

    def reject(self) -> None:
        """Close the dialog, but only after the outcome of a running task was shown."""
        if self.start.isEnabled():
            super().reject()
