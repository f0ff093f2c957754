"""Dialog with the history of a session, newest first; it undoes or redoes several steps at once."""

from __future__ import annotations

import time

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeyEvent, QShowEvent
from PySide6.QtWidgets import QTreeWidgetItem, QWidget

from app.dialogs.dialog import Dialog
from app.panels.widgets import put_rows, secondary_label, table
from app.state.view_state import ViewState
from app.text.history_text import HistoryLine, history_lines

HEADINGS = ("When", "What")
SIZE_PX = (420, 480)


class HistoryDialog(Dialog):
    """List of past actions in a window that stays open; Enter or a double click undoes or redoes up to a line."""

    undo_wanted = Signal(int)  # Number of undo steps
    redo_wanted = Signal(int)  # Number of redo steps

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__("History", parent, is_kept=True)
        self.list = table("history", HEADINGS)
        about = "Enter undoes the line and all lines above it, or redoes an undone line."
        self.fill((self.list, 1), secondary_label(about, wrap=True))
        self.resize(*SIZE_PX)
        self._state: ViewState | None = None
        self._shown: tuple[object, ...] = ()
        self._lines: list[HistoryLine] = []
        self.list.itemActivated.connect(self._activated)

    def show_state(self, state: ViewState) -> None:
        """Show the history, if it changed and the dialog is visible."""
        self._state, snapshot = state, state.snapshot
        shown = snapshot.history.entries, snapshot.history.undone, snapshot.pokes
        if not self.isVisible() or shown == self._shown:
            return
        self._shown, self._lines = shown, history_lines(snapshot, time.time())
        put_rows(self.list, [(line.when, line.what) for line in self._lines])

    def showEvent(self, event: QShowEvent) -> None:
        """Show the newest state and select the newest line."""
        super().showEvent(event)
        if self._state is not None:
            self.show_state(self._state)
        self.list.setFocus()
        first = self.list.topLevelItem(0)
        if first is not None:
            self.list.setCurrentItem(first)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Handle Enter in the list, so that it does not press the dialog's default button."""
        if not (self.list.hasFocus() and event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter)):
            super().keyPressEvent(event)

    def _activated(self, item: QTreeWidgetItem) -> None:
        line = self._lines[self.list.indexOfTopLevelItem(item)]
        if line.again:
            self.redo_wanted.emit(line.again)
        else:
            self.undo_wanted.emit(line.back)
