"""The page of an open session: the 3D view in the middle, docks around it, the status line below.

It is on the screen with the picture of the part before the panels are imported: until `arrange` their cards are empty.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

from PySide6.QtCore import QEvent, QTimer, Signal
from PySide6.QtWidgets import QFrame, QTabWidget, QWidget

from app.commands import LAYER_NAMES
from app.panels.docks import Docks
from app.panels.layouts import make_column, make_row
from app.panels.now_panel import NowPanel
from app.panels.widgets import theme_colours
from app.scene3d.scene_state import StaticScene
from app.scene3d.view import View3D
from app.state.status_line import Now, Tone
from app.text_size import scaled
from app.theme import WIDGET_GAP_PX
from skincal.part.part import Part

if TYPE_CHECKING:
    from app.panels.panel import Panel
    from app.panels.taxel_map import MapCard, TaxelMap
    from app.state.view_state import ViewState
    from skincal.following.guided_session import GuidedSession
    from skincal.taxels.result import Method
    from skincal.words.units import ChannelNames

RIGHT_PX, MIN_RIGHT_PX = 430, 400
"""Width of the right column at 1280 pixels, and the least that the titles of all tabs need at 100 %."""
MIN_VIEW_WIDTH_PX = 420
AnyPanel = TypeVar("AnyPanel", bound="Panel")


class Workspace(QWidget):
    """3D view on the left, map and tabs on the right, the status line below. Only visible parts are drawn."""

    taxel_selected = Signal(int)
    method_chosen = Signal(object)
    names: ChannelNames  # These four since `add_panels`
    methods: tuple[Method, ...]
    card: MapCard
    map: TaxelMap

    def __init__(self, part: Part) -> None:
        super().__init__()
        self.part, self._static = part, StaticScene(part)
        self.view, self.now = View3D(), NowPanel()
        self.panels: dict[str, Panel] = {}  # By title; empty before `add_panels`
        self._state: ViewState | None = None
        # All widgets have their parents from the start: Qt applies the style sheet again to all in a widget that moves.
        left = QWidget(self)
        self._left_row = make_row((self.view, 1), within=left, margins=0, gap=WIDGET_GAP_PX)
        self._map_card, self._tabs_card = QFrame(self), QFrame(self)
        for card in (self._map_card, self._tabs_card):
            card.setObjectName("card")
        self.tabs = QTabWidget(self._tabs_card, documentMode=True)
        make_column(self.tabs, within=self._tabs_card, margins=1)
        self.docks = Docks(self, left, self._map_card, self._tabs_card, self.tabs)
        self._view_timer = QTimer(self, singleShot=True, interval=0)
        """Updates the 3D view in an event of its own: together with a tick it would block the window twice as long."""
        self._view_timer.timeout.connect(self._show_in_view)
        self.view.taxel_picked.connect(self.taxel_selected)
        self.view.setMinimumWidth(MIN_VIEW_WIDTH_PX)
        self._fit_right()
        self.docks.arrange(RIGHT_PX)
        make_column((self.docks, 1), self.now, within=self, margins=WIDGET_GAP_PX, gap=WIDGET_GAP_PX)
        self.wait("Opening", part.scene.name)

    def add_panels(self, guided: GuidedSession, panels: Sequence[Panel]) -> None:
        """Take the panels of the session, and make the map; `arrange` shows them."""
        from app.panels.taxel_map import MapCard, TaxelMap, quarter_turns

        self.names, self.methods = guided.names, guided.methods
        self.panels = {panel.title: panel for panel in panels}
        self.map = TaxelMap(self.part.scene, self.part.channels, guided.names, quarter_turns(self._static))
        self.card = MapCard(self.docks.map, self.map, self.methods)
        self.map.taxel_clicked.connect(self.taxel_selected)
        for panel in panels:
            panel.taxel_wanted.connect(self.taxel_selected)
            panel.comparison_changed.connect(self.view.set_comparison)
        choice = self.card.methods
        choice.activated.connect(lambda index: self.method_chosen.emit(choice.itemData(index)))

    def panel(self, kind: type[AnyPanel]) -> AnyPanel:
        return next(panel for panel in self.panels.values() if isinstance(panel, kind))

    def arrange(self) -> None:
        """Put map and panels into their cards, once. Not done in `add_panels`, to keep the window responsive."""
        self.docks.map.setWidget(self.card)
        self._map_card.deleteLater()
        self._map_card = self.card
        self._fit_right()
        for title, panel in self.panels.items():
            self.tabs.addTab(panel, title)
        self.tabs.setAccessibleName("tabs")
        self.tabs.tabBar().setExpanding(True)
        self.tabs.tabBar().setDrawBase(False)
        self.docks.name_tabs(tuple(self.panels))
        self.tabs.currentChanged.connect(self._show_tab)

    def show_card(self, card: QWidget) -> None:
        self._left_row.insertWidget(0, card)

    def _fit_right(self) -> None:
        for card in (self._map_card, self._tabs_card):
            card.setMinimumWidth(scaled(MIN_RIGHT_PX))

    def changeEvent(self, event: QEvent) -> None:
        super().changeEvent(event)
        if event.type() is QEvent.Type.FontChange:
            self._fit_right()

    def build_3d_view(self) -> None:
        """Start to build the 3D view; call once the window is on the screen."""
        self.view.build_scene(self._static)

    def wait(self, headline: str, detail: str) -> None:
        """Show a line in the status panel while there is no session yet."""
        self.now.say(Now(Tone.WAIT, headline, detail))

    def show_state(self, state: ViewState, now: Now, note: str) -> None:
        """Show a tick in all visible parts, `now` in the status line, and `note` over the 3D view."""
        before, self._state = self._state, state
        self.now.show_state(state, now)
        is_changed = before is None or (before.revision, before.method) != (state.revision, state.method)
        self.card.show_state(state, is_changed=is_changed)
        # Started again, it would stay behind the ticks of a busy machine.
        if not self._view_timer.isActive():
            self._view_timer.start()
        self.view.set_note(note)
        self._show_tab()

    def _show_in_view(self) -> None:
        if self._state is not None:
            self.view.show_state(self._state)

    def current_panel(self) -> Panel | None:
        """Return the panel of the open tab; `None` before `arrange`."""
        return next((panel for panel in self.panels.values() if panel is self.tabs.currentWidget()), None)

    def _show_tab(self, _index: int = -1) -> None:
        if self._state is not None:
            for panel in self.seen_panels():
                panel.show_state(self._state)

    def seen_panels(self) -> list[Panel]:
        """Return the panel of the open tab, and those in windows of their own."""
        current, detached = self.current_panel(), [self.panels[title] for title in self.docks.detached]
        return [*([] if current is None else [current]), *detached]

    def show_tab(self, title: str) -> None:
        """Open the tab with this title, if there is one, or raise its window."""
        if title in self.docks.detached:
            self.docks.detached[title].raise_()
            self.docks.detached[title].activateWindow()
        elif title in self.panels:
            self.tabs.setCurrentWidget(self.panels[title])

    def show_numbered_tab(self, index: int) -> None:
        self.show_tab(tuple(self.panels)[index])

    def detach_current(self) -> None:
        """Make the open tab a window of its own."""
        panel = self.current_panel()
        if panel is not None:
            self.docks.detach(panel.title)

    def follow_switches(self, is_on: Callable[[str], bool]) -> None:
        """Apply the switches of the View and Layers menus to the 3D view."""
        self.view.set_turning(is_on("turn"))
        self.view.set_difference(is_on("difference"))
        self.view.hide_layers(frozenset(name for name in LAYER_NAMES if not is_on(name)))

    def recolour(self) -> None:
        """Recolour what Qt's palette does not change."""
        for panel in self.panels.values():
            panel.recolour()
        self.view.set_dark(theme_colours().dark)
