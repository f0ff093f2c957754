"""Dialog that sends positions to a running robot: the verdict, the address, then the robot's answers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QLineEdit, QWidget

from app.dialogs.task_dialog import TaskDialog
from app.panels.widgets import secondary_label
from skincal.taxels.result import Method

DEFAULT_PORT = "yarp:/skinManager/rpc"
SERVER_PREFIX = "yarp://"


def offered_port(links: Iterable[str]) -> str:
    """Propose skinManager's port, on the YARP name server of the session's device addresses if they name one."""
    servers = [link.removeprefix(SERVER_PREFIX).partition("/")[0] for link in links if link.startswith(SERVER_PREFIX)]
    return f"{SERVER_PREFIX}{servers[0]}/{DEFAULT_PORT.partition('/')[2]}" if servers else DEFAULT_PORT


class ApplyDialog(TaskDialog):
    """Dialog that asks before positions are sent to a robot; `verdict_of` makes the session's verdict by a method."""

    apply_requested = Signal(str, object)  # Address, method

    def __init__(
        self,
        methods: Sequence[Method],
        shown: Method,
        verdict_of: Callable[[Method], str],
        address: str,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__("Apply to the robot", "Send positions", methods, shown, parent)
        self._verdict_of = verdict_of
        self.address = QLineEdit(address)
        self.verdict = secondary_label(wrap=True)
        self.remarks.setAccessibleName("questions and answers")
        self.form.addRow("&Method", self.method)
        self.form.addRow("", self.verdict)
        self.form.addRow("&RPC port of skinManager", self.address)
        restore = "The robot's present positions are first saved in a file, so that you can restore them."
        self.form.addRow("", secondary_label(restore, wrap=True))
        # A robot is changed on purpose: Space and Enter close.
        self.button().setDefault(True)
        self.button().setFocus()
        self.method.currentIndexChanged.connect(self._show_verdict)
        self.start.clicked.connect(self._apply)
        self._show_verdict()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Move with Enter from the address to the button that sends; another key presses that."""
        if self.address.hasFocus() and event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self.start.setFocus()
            event.accept()
            return
        super().keyPressEvent(event)

    def show_end(self, sentence: str, lines: Sequence[str], *, good: bool) -> None:
        """Show the outcome, with every question and its answer."""
        self.show_outcome(sentence, lines, good=good)
        self.remarks.scrollToBottom()

    def _show_verdict(self) -> None:
        self.verdict.setText(self._verdict_of(self.method.currentData()))

    def _apply(self) -> None:
        self.begin_task("Sending \N{HORIZONTAL ELLIPSIS}")
        self.apply_requested.emit(self.address.text().strip(), self.method.currentData())
