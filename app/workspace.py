"""The panels of one open session in their places, as long as it is open.

Only what is on the screen is drawn; a tab that comes up gets the newest state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QComboBox, QFrame, QGridLayout, QSplitter, QTabWidget, QVBoxLayout, QWidget

from app.panels.compare_panel import ComparePanel
from app.panels.devices import DevicesPanel
from app.panels.errors_panel import ErrorsPanel
from app.panels.inspect_panel import InspectPanel
from app.panels.now_panel import NowPanel
from app.panels.plot_panel import ReadingsPanel
from app.panels.pokes_panel import PokesPanel
from app.panels.rig_panel import RigPanel
from app.panels.taxel_map import TaxelMap
from app.panels.widgets import FittedLabel
from app.scene3d.view import View3D
from app.state.view_state import ViewState
from app.text.now_text import Now, Tone
from app.text.outcomes import METHOD_NAMES, error_words, pokes_words, summary_words
from app.theme import GAP, Colours
from app.units import ChannelNames
from skincal.guide.guidance import leeway
from skincal.session.part import Part
from skincal.session.solving import methods_of
from skincal.taxels.result import Method

SHOWN = (Method.SURFACE, Method.FREE, Method.MODULES)
"""Methods in the order in which they are offered; the first that there is is shown first."""
RIGHT_PX = 430
"""Width of the right column at 1280 pixels; the 3D view gets the rest, two thirds."""


TabPanel: TypeAlias = ReadingsPanel | PokesPanel | InspectPanel | ComparePanel | DevicesPanel | ErrorsPanel | RigPanel


class Workspace(QWidget):
    """3D view on the left, map and tabs on the right, and below all of it the line that says what happens."""

    taxel_selected = Signal(int)
    method_chosen = Signal(object)

    def __init__(self, part: Part, make_view: Callable[[], View3D], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        scene, names = part.scene, ChannelNames(part.scene.skin.layout)
        self.part = part
        self.names = names
        there = methods_of(scene, part.surface)
        self.methods = tuple(method for method in SHOWN if method in there)
        self.view = make_view()
        self.now = NowPanel()
        self.progress = FittedLabel()
        self.errors = FittedLabel()
        self.method_box = QComboBox()
        self.map = TaxelMap(scene, part.channels, names)
        self.readings = ReadingsPanel()
        self.pokes = PokesPanel(names)
        self.inspect = InspectPanel(self.methods, names)
        self.compare = ComparePanel(part, self.methods, names)
        self.devices = DevicesPanel()
        self.error_course = ErrorsPanel(self.methods, scene.skin.layout)
        self.rig = RigPanel(scene.arm)
        self._panels: dict[str, TabPanel] = {
            "Readings": self.readings,
            "Pokes": self.pokes,
            "Taxel": self.inspect,
            "Compare": self.compare,
            "Devices": self.devices,
            "Errors": self.error_course,
            "Rig": self.rig,
        }
        """Of each tab, by its title."""
        # Splitters, cards and tabs in what they stand in, from the first: Qt applies the style sheet anew to all that a moved
        # widget holds.
        self.across = QSplitter(Qt.Orientation.Horizontal, self)
        self.across.addWidget(self.view)
        self.right = QSplitter(Qt.Orientation.Vertical, self.across)
        self._fill_map_card(_card(self.right))
        column = _card(self.right)
        self.tabs = QTabWidget(column.parentWidget())
        column.addWidget(self.tabs)
        self._state: ViewState | None = None
        self._connect()

    def arrange(self) -> None:
        """Lay the panels out, once; apart from making them, since each takes half of what a window may stand still."""
        for title, panel in self._panels.items():
            self.tabs.addTab(panel, title)
        self.tabs.setDocumentMode(True)
        self.tabs.setUsesScrollButtons(False)
        self.tabs.tabBar().setExpanding(True)
        self.tabs.tabBar().setDrawBase(False)
        self.view.setMinimumWidth(420)
        self.right.setStretchFactor(0, 1)
        self.right.setStretchFactor(1, 1)
        self.right.setMinimumWidth(360)
        self.across.setStretchFactor(0, 1)
        self.across.setSizes([10_000, RIGHT_PX])
        for splitter in (self.right, self.across):
            splitter.setHandleWidth(GAP)
            splitter.setChildrenCollapsible(False)
        column = QVBoxLayout(self)
        column.setContentsMargins(GAP, GAP, GAP, GAP)
        column.setSpacing(GAP)
        column.addWidget(self.across, 1)
        column.addWidget(self.now)
        self.tabs.currentChanged.connect(self._show_tab)

    def _fill_map_card(self, column: QVBoxLayout) -> None:
        for method in self.methods:
            self.method_box.addItem(METHOD_NAMES[method].capitalize() + " method", method)
        self.method_box.setVisible(len(self.methods) > 1)
        self.method_box.setToolTip("Whose estimates are shown, and whose needs the guide follows (V)")
        self.method_box.setAccessibleName("method")
        self.method_box.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        head = QGridLayout()
        head.setContentsMargins(GAP + 4, GAP // 2, GAP // 2, 0)
        head.setVerticalSpacing(0)
        head.setColumnStretch(0, 1)
        head.addWidget(self.progress, 0, 0, 1, 2)
        head.addWidget(self.errors, 1, 0)
        head.addWidget(self.method_box, 1, 1)
        column.setSpacing(0)
        column.addLayout(head)
        column.addWidget(self.map, 1)

    def _connect(self) -> None:
        self.view.taxel_picked.connect(self.taxel_selected)
        self.map.taxel_clicked.connect(self.taxel_selected)
        self.pokes.taxel_wanted.connect(self.taxel_selected)
        self.inspect.taxel_wanted.connect(self.taxel_selected)
        self.compare.taxel_wanted.connect(self.taxel_selected)
        self.compare.comparison_changed.connect(self.view.set_comparison)
        self.method_box.activated.connect(lambda index: self.method_chosen.emit(self.method_box.itemData(index)))

    def begin(self) -> None:
        """Start to build the 3D view; call once the window is on the screen."""
        part = self.part
        self.view.begin(part.scene, part.surface, part.laid, [int(channel) for channel in part.channels])

    def wait(self, headline: str, detail: str) -> None:
        """Say what is waited for while there is no session yet."""
        self.now.say(Now(Tone.WAIT, headline, detail))

    def show_state(self, state: ViewState) -> None:
        """Show a tick on everything that is on the screen."""
        before, self._state = self._state, state
        self.now.show_state(state)
        self.map.show_state(state)
        if before is None or (before.revision, before.method) != (state.revision, state.method):
            self.progress.setText(f"{summary_words(state.estimates)}, {pokes_words(state.snapshot)}")
            self.errors.setText(error_words(state.estimates))
            self.method_box.setCurrentIndex(self.method_box.findData(state.method))
        room = 0.0 if state.guidance is None else leeway(state.guidance)
        self.view.show_moment(state.snapshot, state.live, state.method, state.selected, state.target, room)
        self._show_tab()

    def _show_tab(self, _index: int = -1) -> None:
        if self._state is not None and self.tabs.count():
            self._panels[self.tabs.tabText(self.tabs.currentIndex())].show_state(self._state)

    def show_tab(self, title: str) -> None:
        """Open the tab of that title, if there is one."""
        if title in self._panels:
            self.tabs.setCurrentWidget(self._panels[title])

    def titles(self) -> list[str]:
        """Return the titles of the tabs."""
        return list(self._panels)

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        for panel in (self.now, self.map, *self._panels.values()):
            # The rig's panel has the palette's colours alone.
            if not isinstance(panel, RigPanel):
                panel.set_colours(colours)
        self.errors.set_colour(QColor(colours.muted))
        self.view.set_dark(colours.dark)


def _card(splitter: QSplitter) -> QVBoxLayout:
    """Add a card to a splitter, and return its column."""
    card = QFrame(splitter)
    card.setObjectName("card")
    column = QVBoxLayout(card)
    column.setContentsMargins(1, 1, 1, 1)
    return column
