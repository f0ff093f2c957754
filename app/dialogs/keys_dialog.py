"""Every key in one list: on a low screen at once as far as it fits, then scrolled."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDialog, QDialogButtonBox, QLabel, QScrollArea, QVBoxLayout, QWidget

from app.commands import key_words
from app.panels.widgets import plain_buttons

MOST_PX = (1240, 680)
"""Of a screen of 1280 by 720, with a desktop's frame around."""
BORDER_PX = 1
"""Around what is scrolled, where the window's style shows the focus."""
COLUMNS = (2, 1)
"""Beside each other while they fit: a list is scrolled in one direction only."""


class KeysDialog(QDialog):
    """Closed by every key that presses its only button."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Keys")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.list = QLabel()
        self.list.setProperty("rich", True)
        self.area = QScrollArea()
        self.area.setAccessibleName("keys")
        self.area.setFrameShape(QScrollArea.Shape.NoFrame)
        self.area.setWidgetResizable(True)
        self.area.setWidget(self.list)
        self.buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Close)
        plain_buttons(self.buttons)
        column = QVBoxLayout(self)
        column.addWidget(self.area, 1)
        column.addWidget(self.buttons)
        self.buttons.rejected.connect(self.reject)
        edges = column.contentsMargins()
        across = edges.left() + edges.right() + 2 * BORDER_PX + self.area.verticalScrollBar().sizeHint().width()
        down = edges.top() + edges.bottom() + 2 * BORDER_PX + column.spacing() + self.buttons.sizeHint().height()
        for count in COLUMNS:
            self.list.setText(key_words(count))
            if self.list.sizeHint().width() + across <= MOST_PX[0]:
                break
        wanted = self.list.sizeHint()
        self.resize(min(wanted.width() + across, MOST_PX[0]), min(wanted.height() + down, MOST_PX[1]))
        self.buttons.button(QDialogButtonBox.StandardButton.Close).setFocus()
