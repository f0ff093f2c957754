"""A window that takes files which are dropped onto it."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QEvent, QObject, Signal
from PySide6.QtGui import QDragEnterEvent, QDropEvent
from PySide6.QtWidgets import QWidget

from app.session.dropping import DroppedRecording, request_of
from skincal.model.errors import InputError


class DropTarget(QObject):
    """Takes what is dropped onto a widget and what stands in it."""

    request_made = Signal(object)
    """`OpenRequest` of what was dropped."""
    recording_dropped = Signal(object)
    """Paths of a recording that is to be imported."""
    refused = Signal(str)
    """Why it cannot be opened, and what to do with it."""

    def __init__(self, over: QWidget) -> None:
        super().__init__(over)
        over.setAcceptDrops(True)
        over.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Take files, and leave anything else to whoever wants it."""
        # A drop is told by its type: both events are of one class.
        if isinstance(event, QDragEnterEvent) and event.mimeData().hasUrls():
            event.acceptProposedAction()
            return True
        if event.type() is QEvent.Type.Drop and isinstance(event, QDropEvent):
            event.acceptProposedAction()
            self._take([Path(url.toLocalFile()) for url in event.mimeData().urls() if url.isLocalFile()])
            return True
        return super().eventFilter(watched, event)

    def _take(self, paths: list[Path]) -> None:
        try:
            request = request_of(paths)
        except InputError as error:
            self.refused.emit(str(error))
            return
        if isinstance(request, DroppedRecording):
            self.recording_dropped.emit(request.paths)
        else:
            self.request_made.emit(request)
