"""The card for newcomers next to the 3D view of the first session; a click, Esc or a minute closes it."""

from __future__ import annotations

from PySide6.QtCore import QTimer, Signal
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QFrame, QLabel

from app.panels.layouts import make_column
from app.panels.widgets import secondary_label, set_bold
from app.text.demo_text import FIRST_MINUTE, FIRST_MINUTE_COBOT, FIRST_MINUTE_END, FIRST_MINUTE_ROBOT
from app.text_size import scaled
from app.theme import WIDGET_GAP_PX

HELP_CARD_WIDTH_PX = 280
HELP_CARD_SHOWN_MS = 60_000
TITLE_FONT_SIZE_PT = 10.5


class FirstMinute(QFrame):
    """Explains the demonstration in a few points."""

    closed = Signal()

    def __init__(self, *, robot: bool = False, has_tool: bool = False) -> None:
        super().__init__()
        self.setObjectName("card")
        self.setAccessibleName("first minute")
        self.setFixedWidth(scaled(HELP_CARD_WIDTH_PX))
        column = make_column(within=self, margins=2 * WIDGET_GAP_PX, gap=WIDGET_GAP_PX // 2)
        of_robot = FIRST_MINUTE_COBOT if has_tool else FIRST_MINUTE_ROBOT
        for number, (title, more) in enumerate(of_robot if robot else FIRST_MINUTE, 1):
            head = QLabel(f"{number}  {title}", wordWrap=True)
            set_bold(head, TITLE_FONT_SIZE_PT)
            column.addWidget(head)
            column.addWidget(QLabel(more, wordWrap=True))
            column.addSpacing(WIDGET_GAP_PX)
        column.addWidget(secondary_label(FIRST_MINUTE_END, wrap=True))
        column.addStretch(1)
        self._timer = QTimer(self, singleShot=True)
        self._timer.timeout.connect(self.leave)
        self._timer.start(HELP_CARD_SHOWN_MS)

    def leave(self) -> None:
        self._timer.stop()
        self.hide()
        self.closed.emit()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        event.accept()
        self.leave()
