"""Files that are dropped onto the window."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QEvent, QObject, Signal
from PySide6.QtGui import QDragEnterEvent, QDropEvent
from PySide6.QtWidgets import QWidget

from app.session.dropping import request_of
from skincal.model.errors import InputError


class DropTarget(QObject):
    """Accepts files that are dropped onto a widget or its children."""

    request_made = Signal(object)  # `OpenRequest`
    recording_dropped = Signal(object)  # Paths of a recording to import
    refused = Signal(str)  # Why the files cannot be opened, and what to do

    def __init__(self, over: QWidget) -> None:
        super().__init__(over)
        over.setAcceptDrops(True)
        over.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        # Both events are of one class.
        if isinstance(event, QDragEnterEvent) and event.mimeData().hasUrls():
            event.acceptProposedAction()
            return True
        if event.type() is QEvent.Type.Drop and isinstance(event, QDropEvent):
            event.acceptProposedAction()
            self._open_dropped([Path(url.toLocalFile()) for url in event.mimeData().urls() if url.isLocalFile()])
            return True
        return super().eventFilter(watched, event)

    def _open_dropped(self, paths: list[Path]) -> None:
        try:
            request = request_of(paths)
        except InputError as error:
            self.refused.emit(str(error))
            return
        if isinstance(request, tuple):
            self.recording_dropped.emit(request)
        else:
            self.request_made.emit(request)
