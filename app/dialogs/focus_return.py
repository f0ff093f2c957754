"""Keyboard focus after a dialog, on desktops without a window manager."""

from __future__ import annotations

from functools import partial

from PySide6.QtCore import QObject, Qt, QTimer, Slot
from PySide6.QtGui import QGuiApplication, QWindow
from PySide6.QtWidgets import QApplication, QWidget


class FocusReturn(QObject):
    """Gives the keyboard back to the window below a dialog that had it and is closed.

    A window manager does this itself. Without one (a bare X server, a kiosk) keys would go nowhere.
    """

    def __init__(self, window: QWidget) -> None:
        super().__init__(window)
        application = QGuiApplication.instance()
        assert isinstance(application, QGuiApplication)
        application.focusWindowChanged.connect(self._watch_dialog)

    @Slot(QWindow)
    def _watch_dialog(self, now: QWindow | None) -> None:
        if now is not None and now.type() is Qt.WindowType.Dialog:
            now.visibleChanged.connect(self._on_visible, Qt.ConnectionType.UniqueConnection)

    @Slot(bool)
    def _on_visible(self, is_visible: bool) -> None:
        # A dialog that closes while another program has the keyboard takes nothing from it.
        if is_visible or QGuiApplication.focusWindow() is not self.sender():
            return
        dialogs = (each for each in QApplication.topLevelWidgets() if each.windowHandle() is self.sender())
        below = next((each.parentWidget() for each in dialogs), None)
        if below is not None:
            below = below.window()
            # Later: a window manager, or the program itself, may give the keyboard to another window.
            QTimer.singleShot(0, below, partial(_activate_if_free, below))


def _activate_if_free(window: QWidget) -> None:
    focus = QApplication.activeWindow()
    if window.isVisible() and (focus is None or not focus.isVisible()):
        window.activateWindow()
