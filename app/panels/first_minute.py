"""What a newcomer must know, over the 3D view of the first session; it goes by a click, by Esc, or by itself."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QEvent, QObject, QTimer, Signal
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QFrame, QLabel, QVBoxLayout, QWidget

from app.panels.widgets import embolden, quiet
from app.text.demo_text import FIRST_MINUTE, FIRST_MINUTE_END
from app.text_size import scaled
from app.theme import GAP

WIDTH_PX = 340
STAYS_MS = 60_000
TITLE_PT = 10.5


class FirstMinute(QFrame):
    """A card in the left upper corner of another widget.

    Parameters
    ----------
    covers : is told how many pixels of that widget it covers, from its left edge
    """

    gone = Signal()

    def __init__(self, over: QWidget, covers: Callable[[int], object]) -> None:
        super().__init__(over)
        self._over, self._covers = over, covers
        self.setObjectName("card")
        self.setAccessibleName("first minute")
        self.setAutoFillBackground(True)
        column = QVBoxLayout(self)
        column.setContentsMargins(2 * GAP, 2 * GAP, 2 * GAP, 2 * GAP)
        column.setSpacing(GAP // 2)
        for number, (title, more) in enumerate(FIRST_MINUTE, 1):
            head = QLabel(f"{number}  {title}")
            head.setWordWrap(True)
            embolden(head, TITLE_PT)
            column.addWidget(head)
            column.addWidget(QLabel(more, wordWrap=True))
            column.addSpacing(GAP)
        column.addWidget(quiet(FIRST_MINUTE_END, wrap=True))
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.timeout.connect(self.leave)
        self._timer.start(STAYS_MS)
        over.installEventFilter(self)
        self.show()
        self._place()

    def leave(self) -> None:
        """Go away."""
        self._timer.stop()
        self.hide()
        self._covers(0)
        self.gone.emit()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Go away."""
        event.accept()
        self.leave()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Keep the corner while the widget below is resized, and stay above what it mounts."""
        if event.type() in (QEvent.Type.Resize, QEvent.Type.ChildAdded, QEvent.Type.LayoutRequest):
            self._place()
        return super().eventFilter(watched, event)

    def _place(self) -> None:
        width = min(scaled(WIDTH_PX), self._over.width() - 2 * GAP)
        self.setGeometry(GAP, GAP, width, self.heightForWidth(width))
        self.raise_()
        if not self.isHidden():
            self._covers(GAP + width)
