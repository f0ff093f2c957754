"""Base of the dialogs. Imports no numpy."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtGui import QIcon, QShowEvent
from PySide6.QtWidgets import QDialog, QDialogButtonBox, QPushButton, QVBoxLayout, QWidget

from app.panels.layouts import Item, make_column
from app.panels.widgets import keep_on_screen

StandardButton = QDialogButtonBox.StandardButton


class Dialog(QDialog):
    """Dialog with a title and buttons at its foot; it is deleted when it closes, unless it `is_kept`."""

    def __init__(
        self, title: str, parent: QWidget | None, buttons: StandardButton = StandardButton.Close, *, is_kept: bool = False
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle(title)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose, not is_kept)
        self.buttons = QDialogButtonBox(buttons)
        self.buttons.rejected.connect(self.reject)

    def fill(self, *items: Item) -> QVBoxLayout:
        """Put items below each other, above the buttons."""
        for button in self.buttons.buttons():
            # The desktop's icons fit no theme of ours.
            button.setIcon(QIcon())
        return make_column(*items, self.buttons, within=self)

    def showEvent(self, event: QShowEvent) -> None:
        """Stay within the screen; a dialog with larger text would else be larger."""
        super().showEvent(event)
        keep_on_screen(self)

    def button(self, kind: StandardButton = StandardButton.Close) -> QPushButton:
        return self.buttons.button(kind)
