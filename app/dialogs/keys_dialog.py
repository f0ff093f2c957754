"""Dialog with all keys."""

from __future__ import annotations

from PySide6.QtWidgets import QScrollArea, QWidget

from app.commands import key_words
from app.dialogs.dialog import Dialog
from app.panels.widgets import rich_label

MAX_SIZE_PX = (1240, 680)  # A screen of 1280 by 720 without the desktop's frame
SCROLL_AREA_BORDER_PX = 1  # Frame of the scrolled area, which shows the focus
COLUMN_COUNTS = (2, 1)  # One column if two do not fit: the list scrolls vertically only


class KeysDialog(Dialog):
    """List of all keys, which scrolls on a low screen."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__("Keys", parent)
        self.list = rich_label()
        self.area = QScrollArea(widgetResizable=True)
        self.area.setAccessibleName("keys")
        self.area.setFrameShape(QScrollArea.Shape.NoFrame)
        self.area.setWidget(self.list)
        column = self.fill((self.area, 1))
        edges = column.contentsMargins()
        across = edges.left() + edges.right() + 2 * SCROLL_AREA_BORDER_PX + self.area.verticalScrollBar().sizeHint().width()
        down = edges.top() + edges.bottom() + 2 * SCROLL_AREA_BORDER_PX + column.spacing() + self.buttons.sizeHint().height()
        for count in COLUMN_COUNTS:
            self.list.setText(key_words(count))
            if self.list.sizeHint().width() + across <= MAX_SIZE_PX[0]:
                break
        wanted = self.list.sizeHint()
        self.resize(min(wanted.width() + across, MAX_SIZE_PX[0]), min(wanted.height() + down, MAX_SIZE_PX[1]))
        self.button().setFocus()
