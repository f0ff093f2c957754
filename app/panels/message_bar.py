"""The line at the top of the window for errors, results and findings; errors stay until they are dismissed."""

from __future__ import annotations

from collections import deque

from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QPalette
from PySide6.QtWidgets import QFrame, QLabel, QPushButton

from app.panels.layouts import make_row
from app.panels.widgets import theme_colours
from app.text.message import Message
from app.theme import WIDGET_GAP_PX

SUCCESS_MESSAGE_SHOWN_MS = 8000  # A success or a finding disappears after this time
MAX_QUEUED_MESSAGES = 20  # Messages that wait to be read; older ones are in the log


class MessageBar(QFrame):
    """The newest message; dismissing it shows the one before."""

    def __init__(self) -> None:
        super().__init__()
        self._waiting: deque[Message] = deque(maxlen=MAX_QUEUED_MESSAGES)
        # Messages quote files and devices: Qt would interpret HTML in them.
        self.text = QLabel(wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        self.text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.close_button = QPushButton("Dismiss  (Esc)", flat=True)
        self._timer = QTimer(self, singleShot=True)
        margins = (2 * WIDGET_GAP_PX, WIDGET_GAP_PX // 2, WIDGET_GAP_PX, WIDGET_GAP_PX // 2)
        make_row((self.text, 1), self.close_button, within=self, margins=margins)
        self.setAutoFillBackground(True)
        self.close_button.clicked.connect(self.dismiss)
        self._timer.timeout.connect(self._expire)
        self.hide()

    def tell(self, message: Message) -> None:
        """Show a message; the same one twice in a row is shown once."""
        if self._waiting and self._waiting[-1] == message:
            return
        self._waiting.append(message)
        self.show_newest()

    def dismiss(self) -> None:
        if self._waiting:
            self._waiting.pop()
        self.show_newest()

    def withdraw(self, message: Message) -> None:
        """Remove a message that is no longer true."""
        if message in self._waiting:
            self._waiting.remove(message)
            self.show_newest()

    def stop(self) -> None:
        self._timer.stop()

    def _expire(self) -> None:
        if self._waiting and not _is_permanent(self._waiting[-1]):
            self.dismiss()

    def show_newest(self) -> None:
        """Show the newest message in the theme's colours, if there is one."""
        self._timer.stop()
        self.setVisible(bool(self._waiting))
        if not self._waiting:
            return
        newest = self._waiting[-1]
        colours = theme_colours()
        palette = self.palette()
        palette.setColor(QPalette.ColorRole.Window, colours.bad if newest.error else colours.raised)
        text = colours.window if newest.error else colours.text
        for role in (QPalette.ColorRole.WindowText, QPalette.ColorRole.ButtonText):
            palette.setColor(role, text)
        for widget in (self, self.text, self.close_button):
            widget.setPalette(palette)
        self.text.setText(f"{_sign(newest)}  {newest.text}")
        if not _is_permanent(newest):
            self._timer.start(SUCCESS_MESSAGE_SHOWN_MS)


def _is_permanent(message: Message) -> bool:
    return message.error or message.asks


def _sign(message: Message) -> str:
    if message.error:
        return "\N{BALLOT X}"
    if message.found:
        return "\N{BULLET}"
    return "\N{RIGHTWARDS ARROW}" if message.asks else "\N{CHECK MARK}"
