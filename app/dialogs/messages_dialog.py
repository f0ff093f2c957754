"""Dialog with all messages about the open session or part."""

from __future__ import annotations

from PySide6.QtWidgets import QPlainTextEdit, QWidget

from app.dialogs.dialog import Dialog
from app.panels.message_bar import MessageBar
from app.panels.widgets import fit_to_screen
from app.text.message import kept_messages_text

SIZE_PX = (720, 420)


class MessagesDialog(Dialog):
    """Messages with their times, newest first, in a window that stays open. While it is open the newest stays in the bar."""

    def __init__(self, bar: MessageBar, parent: QWidget | None = None) -> None:
        super().__init__("Messages", parent)
        self._bar = bar
        # Messages quote files and devices: plain text, so that no HTML in them takes effect.
        self.list = QPlainTextEdit(readOnly=True, tabChangesFocus=True)
        self.list.setAccessibleName("messages")
        self.fill((self.list, 1))
        fit_to_screen(self, SIZE_PX)
        bar.kept_changed.connect(self._show_all)
        bar.is_list_open = True
        self.finished.connect(self._end)
        self._show_all()
        self.list.setFocus()

    def _show_all(self) -> None:
        self.list.setPlainText(kept_messages_text(self._bar.kept))

    def _end(self) -> None:
        self._bar.is_list_open = False
