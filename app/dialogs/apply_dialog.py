"""The dialog that brings positions to a running robot: what the session has come to, where to send them, what was answered."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QComboBox, QDialog, QDialogButtonBox, QFormLayout, QLineEdit, QListWidget, QVBoxLayout, QWidget

from app.panels.widgets import plain_buttons, quiet
from app.text.outcomes import METHOD_NAMES
from skincal.taxels.result import Method

USUAL = "yarp:/skinManager/rpc"
SERVER = "yarp://"


def offered_port(links: Iterable[str]) -> str:
    """Return the usual address of skinManager's port, by the name server that the addresses of a session name, if any do."""
    servers = [link.removeprefix(SERVER).partition("/")[0] for link in links if link.startswith(SERVER)]
    return f"{SERVER}{servers[0]}/{USUAL.partition('/')[2]}" if servers else USUAL


class ApplyDialog(QDialog):
    """Asks before anything is sent; `verdict_of` says of one of the `methods` what the session has come to."""

    apply_requested = Signal(str, object)
    """Address, method."""

    def __init__(
        self,
        methods: Sequence[Method],
        shown: Method,
        verdict_of: Callable[[Method], str],
        address: str,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle("Apply to the robot")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._verdict_of = verdict_of
        self.address = QLineEdit(address)
        self.method = QComboBox()
        for method in methods:
            self.method.addItem(METHOD_NAMES[method], method)
        self.method.setCurrentIndex(self.method.findData(shown))
        self.verdict, self.outcome = quiet(wrap=True), quiet(wrap=True)
        self.answers = QListWidget()
        self.answers.setAccessibleName("what was asked and answered")
        self.buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Close)
        self.apply = self.buttons.addButton("Send positions", QDialogButtonBox.ButtonRole.ActionRole)
        self._arrange()
        self.method.currentIndexChanged.connect(self._show_verdict)
        self.apply.clicked.connect(self._apply)
        self.buttons.rejected.connect(self.reject)
        self._show_verdict()

    def _arrange(self) -> None:
        form = QFormLayout()
        form.addRow("&Method", self.method)
        form.addRow("", self.verdict)
        form.addRow("&RPC port of skinManager", self.address)
        form.addRow("", quiet("The robot's own positions are read first, and kept in a file to go back.", wrap=True))
        column = QVBoxLayout(self)
        column.addLayout(form)
        column.addWidget(self.outcome)
        column.addWidget(self.answers, 1)
        column.addWidget(self.buttons)
        self.answers.hide()
        plain_buttons(self.buttons)
        self.setMinimumWidth(560)
        # A robot is changed on purpose: Space and Enter close.
        close = self.buttons.button(QDialogButtonBox.StandardButton.Close)
        close.setDefault(True)
        close.setFocus()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Go on with Enter from the address to the button that sends, which another key presses."""
        if self.address.hasFocus() and event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self.apply.setFocus()
            event.accept()
            return
        super().keyPressEvent(event)

    def show_end(self, sentence: str, lines: Sequence[str], *, good: bool) -> None:
        """Say what became of it, with every question and its answer."""
        self.apply.setEnabled(True)
        self.outcome.setText(("\N{CHECK MARK} " if good else "\N{BALLOT X} ") + sentence)
        self.answers.clear()
        self.answers.addItems(list(lines))
        self.answers.setVisible(bool(lines))
        self.answers.scrollToBottom()

    def reject(self) -> None:
        """Close, but not before it is said what became of the robot."""
        if self.apply.isEnabled():
            super().reject()

    def _show_verdict(self) -> None:
        self.verdict.setText(self._verdict_of(self.method.currentData()))

    def _apply(self) -> None:
        self.buttons.button(QDialogButtonBox.StandardButton.Close).setFocus()
        self.apply.setEnabled(False)
        self.answers.hide()
        self.outcome.setText("Sending \N{HORIZONTAL ELLIPSIS}")
        self.apply_requested.emit(self.address.text().strip(), self.method.currentData())
