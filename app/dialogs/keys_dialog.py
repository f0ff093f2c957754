"""Dialog with all keys."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDialog, QDialogButtonBox, QLabel, QScrollArea, QVBoxLayout, QWidget

from app.commands import key_words
from app.panels.widgets import plain_buttons

MAX_SIZE_PX = (1240, 680)  # A screen of 1280 by 720 without the desktop's frame
SCROLL_AREA_BORDER_PX = 1  # Frame of the scrolled area, which shows the focus
COLUMN_COUNTS = (2, 1)  # One column if two do not fit: the list scrolls vertically only


class KeysDialog(QDialog):
    """List of all keys, which scrolls on a low screen."""

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
        across = edges.left() + edges.right() + 2 * SCROLL_AREA_BORDER_PX + self.area.verticalScrollBar().sizeHint().width()
        down = edges.top() + edges.bottom() + 2 * SCROLL_AREA_BORDER_PX + column.spacing() + self.buttons.sizeHint().height()
        for count in COLUMN_COUNTS:
            self.list.setText(key_words(count))
            if self.list.sizeHint().width() + across <= MAX_SIZE_PX[0]:
                break
        wanted = self.list.sizeHint()
        self.resize(min(wanted.width() + across, MAX_SIZE_PX[0]), min(wanted.height() + down, MAX_SIZE_PX[1]))
        self.buttons.button(QDialogButtonBox.StandardButton.Close).setFocus()
