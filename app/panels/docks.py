"""The movable arrangement of the view of a session: the 3D view in the middle, and panels around it that can be dragged.

The map and the tabs are docks: their titles are dragged to another edge or out of the window, the gaps between them are dragged
to resize. A double click on a tab makes it a window of its own; closing that puts it back.
"""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import QByteArray, QSettings, Qt, Signal
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QDockWidget, QMainWindow, QTabWidget, QWidget

from app.panels.widgets import keep_on_screen
from app.text_size import scaled

DOCKS_SETTING, DETACHED_SETTING = "window/docks", "window/detached"
ARRANGEMENT_VERSION = 1  # Of the saved arrangement; another one is not restored
DETACHED_SIZE_PX = (560, 420)  # Of a tab's own window at 100 %
ENLARGED_SHARE = 0.62  # Width of the enlarged panels over that of the session's view
HEIGHT_SHARES = (42, 58)
"""Of the map and the tabs: a plot needs the height more than the map, whose marks stay visible."""
_FIXED_FEATURES = QDockWidget.DockWidgetFeature.DockWidgetMovable | QDockWidget.DockWidgetFeature.DockWidgetFloatable


class PanelDock(QDockWidget):
    """Dock with a title that is also its name in the saved arrangement."""

    closed = Signal(str)

    def __init__(self, title: str, inner: QWidget, parent: QWidget, *, can_close: bool = False) -> None:
        super().__init__(title, parent)
        self.setObjectName(title)
        self.setAccessibleName(f"{title}, movable")
        closable = QDockWidget.DockWidgetFeature.DockWidgetClosable
        self.setFeatures(_FIXED_FEATURES | closable if can_close else _FIXED_FEATURES)
        self.setWidget(inner)

    def closeEvent(self, event: QCloseEvent) -> None:
        super().closeEvent(event)
        self.closed.emit(self.objectName())


class Docks(QMainWindow):
    """A middle, a map and tabs."""

    detached_changed = Signal()

    def __init__(self, parent: QWidget, middle: QWidget, map_card: QWidget, tabs_card: QWidget, tabs: QTabWidget) -> None:
        super().__init__(parent)
        # A main window within another one is a plain widget with docks.
        self.setWindowFlags(Qt.WindowType.Widget)
        self.setDockNestingEnabled(True)
        self.setCentralWidget(middle)
        self.map, self.panels = PanelDock("Map", map_card, self), PanelDock("Panels", tabs_card, self)
        self.detached: dict[str, PanelDock] = {}
        self._tabs, self._titles, self._right_px = tabs, tuple[str, ...](), 0
        self._before_enlarging: QByteArray | None = None
        tabs.tabBarDoubleClicked.connect(lambda index: self.detach(tabs.tabText(index)))

    def arrange(self, right_px: int) -> None:
        """Put the docks at their first places; the right column is `right_px` wide at 100 %."""
        self._right_px = right_px
        self.restore_first()

    def name_tabs(self, titles: Sequence[str]) -> None:
        """Take the titles of all tabs, in order."""
        self._titles = tuple(titles)

    def restore_first(self) -> None:
        """Restore the first arrangement: map above tabs at the right, all tabs in their places."""
        self._before_enlarging = None
        for title in tuple(self.detached):
            self.attach(title)
        for dock in (self.map, self.panels):
            dock.setFloating(False)
            self.removeDockWidget(dock)
            self.addDockWidget(Qt.DockWidgetArea.RightDockWidgetArea, dock)
            dock.show()
        self.resizeDocks([self.map, self.panels], [scaled(self._right_px)] * 2, Qt.Orientation.Horizontal)
        # Shares of more pixels than there are.
        self.resizeDocks([self.map, self.panels], [500 * share for share in HEIGHT_SHARES], Qt.Orientation.Vertical)

    def enlarge(self) -> None:
        """Give the tabs most of the room, or restore the arrangement before that."""
        if self._before_enlarging is not None:
            before, self._before_enlarging = self._before_enlarging, None
            self.restoreState(before, ARRANGEMENT_VERSION)
            return
        self._before_enlarging = self.saveState(ARRANGEMENT_VERSION)
        self.map.hide()
        self.resizeDocks([self.panels], [round(ENLARGED_SHARE * self.width())], Qt.Orientation.Horizontal)

    def detach(self, title: str) -> None:
        """Make a tab a window of its own; the last tab stays."""
        index = next((at for at in range(self._tabs.count()) if self._tabs.tabText(at) == title), -1)
        if index < 0 or self._tabs.count() < 2:
            return
        panel = self._tabs.widget(index)
        assert panel is not None
        corner = self._tabs.mapToGlobal(self._tabs.rect().topLeft())
        self._tabs.removeTab(index)
        self.detached[title] = dock = PanelDock(title, panel, self, can_close=True)
        dock.closed.connect(self.attach)
        self.addDockWidget(Qt.DockWidgetArea.LeftDockWidgetArea, dock)
        dock.setFloating(True)
        dock.resize(*map(scaled, DETACHED_SIZE_PX))
        dock.move(corner.x() - scaled(DETACHED_SIZE_PX[0]) // 2, corner.y())
        keep_on_screen(dock)
        panel.show()
        dock.show()
        self.detached_changed.emit()

    def attach(self, title: str) -> None:
        """Put a detached tab back to its place."""
        dock = self.detached.pop(title, None)
        panel = None if dock is None else dock.widget()
        if dock is None or panel is None:
            return
        before = [self._tabs.tabText(at) for at in range(self._tabs.count())]
        place = sum(self._titles.index(other) < self._titles.index(title) for other in before)
        self._tabs.insertTab(place, panel, title)
        self.removeDockWidget(dock)
        dock.deleteLater()
        self.detached_changed.emit()

    def save(self, settings: QSettings) -> None:
        state = self._before_enlarging or self.saveState(ARRANGEMENT_VERSION)
        settings.setValue(DOCKS_SETTING, state)
        settings.setValue(DETACHED_SETTING, list(self.detached))

    def restore(self, settings: QSettings) -> None:
        """Restore the arrangement of the last session, if it is of this version."""
        state = settings.value(DOCKS_SETTING)
        if isinstance(state, QByteArray) and not self.restoreState(state, ARRANGEMENT_VERSION):
            self.restore_first()

    def restore_detached(self, settings: QSettings) -> None:
        """Detach the tabs that had windows of their own in the last session, each at its former place."""
        kept = settings.value(DETACHED_SETTING, [])
        for title in [kept] if isinstance(kept, str) else kept if isinstance(kept, list) else []:
            self.detach(str(title))
        if self.detached:
            self.restore(settings)
