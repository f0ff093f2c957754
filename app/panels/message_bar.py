"""Messages over the upper edge of the 3D view: the newest is shown, and nothing below it moves.

Those about the open session or part are kept for the list.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime

from PySide6.QtCore import QEvent, QObject, QPoint, Qt, QTimer, Signal
from PySide6.QtGui import QCursor, QPalette
from PySide6.QtWidgets import QFrame, QLabel, QPushButton, QWidget

from app.panels.layouts import make_row
from app.panels.widgets import theme_colours
from app.text.message import Message, message_sign
from app.theme import WIDGET_GAP_PX

MIN_MESSAGE_SHOWN_MS = 8000  # A success or a finding disappears after this time at the earliest
READING_MS_PER_CHAR = 60  # A slow reader needs this for each letter: 200 words a minute
READER_CHECK_PERIOD_MS = 1000  # A message whose time is over waits this long until it is tried again
POINTER_ZONE_OVER_WINDOW = 1 / 3  # While the pointer is in this upper share of the window, messages stay
MAX_QUEUED_MESSAGES = 20  # Messages that wait to be read
MAX_KEPT_MESSAGES = 500  # Messages in the list; older ones are in the log
PLACING_EVENTS = (QEvent.Type.Resize, QEvent.Type.Move, QEvent.Type.Show, QEvent.Type.Hide)


class MessageBar(QFrame):
    """The newest message, over the upper edge of a widget; dismissing it shows the one before.

    `covered` returns the widget whose upper edge it may cover.
    """

    kept_changed = Signal()  # `kept` has a new message
    list_wanted = Signal()
    file_wanted = Signal(object)  # `Path` of the written file that the message names

    def __init__(self, covered: Callable[[], QWidget]) -> None:
        super().__init__()
        self._covered = covered
        self._followed: list[QWidget] = []
        self._waiting: deque[Message] = deque(maxlen=MAX_QUEUED_MESSAGES)
        self.kept: deque[tuple[datetime, Message]] = deque(maxlen=MAX_KEPT_MESSAGES)
        self.is_list_open = False
        # Messages quote files and devices: Qt would interpret HTML in them.
        self.text = QLabel(wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        self.text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.list_button, self.close_button = QPushButton("All  (F4)", flat=True), QPushButton(flat=True)
        self.open_button = QPushButton("Open", flat=True)
        self.show_key(wanted=True)
        for button in (self.open_button, self.list_button, self.close_button):
            # Tab passes by: the keys do both.
            button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.list_button.setAccessibleName("all messages")
        self._timer = QTimer(self, singleShot=True)
        margins = (2 * WIDGET_GAP_PX, WIDGET_GAP_PX // 2, WIDGET_GAP_PX, WIDGET_GAP_PX // 2)
        make_row((self.text, 1), self.open_button, self.list_button, self.close_button, within=self, margins=margins)
        self.setFrameShape(QFrame.Shape.Box)
        self.setAutoFillBackground(True)
        self.setAccessibleName("message")
        self.open_button.setAccessibleName("open the written file")
        self.open_button.clicked.connect(self._open_file)
        self.list_button.clicked.connect(self.list_wanted)
        self.close_button.clicked.connect(self.dismiss)
        self._timer.timeout.connect(self._expire)
        self.hide()

    def tell(self, message: Message) -> None:
        """Show a message; the same one twice in a row is shown once."""
        if self._waiting and self._waiting[-1] == message:
            return
        if message.work:
            # An older message on its progress is no longer true.
            older = [each for each in self._waiting if each.work != message.work]
            self._waiting = deque(older, maxlen=MAX_QUEUED_MESSAGES)
        self._waiting.append(message)
        self.kept.append((datetime.now().astimezone(), message))
        self.kept_changed.emit()
        self.show_newest()

    def show_key(self, *, wanted: bool) -> None:
        """Name the key that dismisses a message, unless it does something else now."""
        self.close_button.setText("Dismiss  (Esc)" if wanted else "Dismiss")

    def _open_file(self) -> None:
        if self._waiting and self._waiting[-1].file is not None:
            self.file_wanted.emit(self._waiting[-1].file)

    def dismiss(self) -> None:
        if self._waiting:
            self._waiting.pop()
        self.show_newest()

    def withdraw(self, message: Message) -> None:
        """Remove a message that is no longer true."""
        if message in self._waiting:
            self._waiting.remove(message)
            self.show_newest()

    def start_over(self) -> None:
        """Forget all messages: the session or the part that they are about is closed."""
        self._waiting.clear()
        self.kept.clear()
        self.kept_changed.emit()
        self.show_newest()

    def stop(self) -> None:
        self._timer.stop()
        self._watch_places([])

    def _expire(self) -> None:
        if not self._waiting or _is_permanent(self._waiting[-1]):
            return
        if self._is_being_read():
            self._timer.start(READER_CHECK_PERIOD_MS)
        else:
            self.dismiss()

    def _is_being_read(self) -> bool:
        """Return whether the pointer is on the message or on the window's upper part, text is marked, or the list is open."""
        window = self.window()
        at = window.mapFromGlobal(QCursor.pos())
        is_near = window.rect().contains(at) and at.y() < POINTER_ZONE_OVER_WINDOW * window.height()
        return is_near or self.geometry().contains(at) or self.text.hasSelectedText() or self.is_list_open

    def show_newest(self) -> None:
        """Show the newest message in the theme's colours, if there is one."""
        self._timer.stop()
        if not self._waiting:
            self.hide()
            self._watch_places([])
            return
        newest = self._waiting[-1]
        colours = theme_colours()
        palette = self.palette()
        palette.setColor(QPalette.ColorRole.Window, colours.bad if newest.error else colours.raised)
        text = colours.window if newest.error else colours.text
        for role in (QPalette.ColorRole.WindowText, QPalette.ColorRole.ButtonText):
            palette.setColor(role, text)
        for widget in (self, self.text, self.open_button, self.list_button, self.close_button):
            widget.setPalette(palette)
        self.open_button.setVisible(newest.file is not None)
        self.text.setText(f"{message_sign(newest)}  {newest.text}")
        self.place()
        self.show()
        self.raise_()
        if not _is_permanent(newest):
            self._timer.start(max(MIN_MESSAGE_SHOWN_MS, READING_MS_PER_CHAR * len(newest.text)))

    # Place

    def place(self) -> None:
        """Lie over the upper edge of the covered widget, as high as the text."""
        parent, covered = self.parentWidget(), self._covered()
        if parent is None:
            return
        self._watch_places([parent, covered])
        corner = covered.mapTo(parent, QPoint(0, 0)) if parent.isAncestorOf(covered) else QPoint(0, 0)
        left, top = corner.x() + WIDGET_GAP_PX, corner.y() + WIDGET_GAP_PX
        # A view that is narrower than a sentence needs lets the message reach over its right edge.
        width = max(covered.width() - 2 * WIDGET_GAP_PX, min(self.sizeHint().width(), parent.width() - left - WIDGET_GAP_PX))
        self.setGeometry(left, top, width, min(self.heightForWidth(width), parent.height() - top))

    def _watch_places(self, widgets: list[QWidget]) -> None:
        """Follow the size and place of these widgets, and of no others."""
        if widgets != self._followed:
            for widget in self._followed:
                # A page that was left is gone with its view.
                with suppress(RuntimeError):
                    widget.removeEventFilter(self)
            for widget in widgets:
                widget.installEventFilter(self)
            self._followed = widgets

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: ARG002
        if event.type() in PLACING_EVENTS and self.isVisible():
            self.place()
        return False


def _is_permanent(message: Message) -> bool:
    return message.error or message.asks
