"""The view of one open session: its panels in their places, selection, method, and what the operator wants of the session.

Each tick makes one frozen value of what the session and its followers say and hands it to the views, which change nothing.

It is imported beside the window, after the window is on the screen: numpy and all that stands on it comes with it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from PySide6.QtCore import QByteArray, QEvent, QObject, QSettings, Qt, QTimer, Signal
from PySide6.QtGui import QAction
from PySide6.QtWidgets import QFileDialog, QFrame, QSplitter, QTabWidget, QVBoxLayout, QWidget

from app.commands import LAYERS, Commands
from app.dialogs.apply_dialog import ApplyDialog, offered_port
from app.dialogs.export_dialog import ExportDialog
from app.dialogs.history_dialog import HistoryDialog
from app.dialogs.landmark_dialog import LandmarkPicking
from app.dialogs.thresholds_dialog import ThresholdsDialog
from app.dialogs.verdict_dialog import VerdictDialog
from app.panels.compare_panel import ComparePanel
from app.panels.devices import DevicesPanel, LinkChips
from app.panels.inspect_panel import InspectPanel
from app.panels.now_panel import NowPanel
from app.panels.plot_panels import ErrorsPanel, ReadingsPanel
from app.panels.pokes_panel import PokesPanel
from app.panels.rig_panel import RigPanel
from app.panels.widgets import theme_colours
from app.scene3d.scene_state import StaticScene
from app.scene3d.view import View3D
from app.session.controller import Controller, Tick
from app.sound.cues import CueMemory, due_cue
from app.state.place_sets import PlaceOrigin, Source, other_source
from app.state.policies import Allowed, RigReview, allowed
from app.state.view_state import ViewState, looked_at
from app.text.compare_text import saved_words
from app.text.demo_text import simulated_words
from app.text.guidance_text import NOTHING_TO_CHECK
from app.text.message import REPORTING, Message, report_words
from app.text.now_text import Now, Tone, modules_enough_words
from app.text.rig_text import corrected_words, offer_news, offer_text, rig_state
from app.text_size import scaled
from app.theme import GAP
from skincal.files.reference import Origin
from skincal.guide.guidance import max_angle_error
from skincal.guide.progress import AxisDiversity
from skincal.model.actions import (
    Action,
    AtLandmark,
    Exclude,
    MarkDead,
    Redo,
    Restore,
    Revive,
    SetPose,
    Uncorrect,
    Undo,
)
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.session.guided_session import GuidedSession
from skincal.session.guiding import ModulesEnough
from skincal.session.part import Part
from skincal.session.review import Review
from skincal.session.snapshot import Snapshot
from skincal.session.solving import methods_of
from skincal.taxels.result import Method
from skincal.words.units import ChannelNames
from skincal.words.verdict_words import verdict_sentence

if TYPE_CHECKING:
    from skincal.files.reference import Reference, TaxelPositions
    from skincal.guide.verdict import Verdict
    from skincal.modules.health import LayoutRepair

KINDS_OF_PLACES = "Known places (*.json *.csv *.txt *.ini);;All files (*)"
VERDICT_MS = 3000
"""The demo's line says *enough* for so long before the verdict comes by itself."""
LATE_S = 0.3
"""s. What happened longer ago makes no sound any more: by now the hand does something else."""
SHOWN = (Method.SURFACE, Method.FREE, Method.MODULES)
"""Methods in the order in which they are offered; `first_method` says which is shown first."""
RIGHT_PX = 430
"""Width of the right column at 1280 pixels; the 3D view gets the rest, two thirds."""
RIGHT_LEAST_PX = 400
"""About what the titles of all tabs need at 100 %; with less they scroll."""

TabPanel: TypeAlias = ReadingsPanel | PokesPanel | InspectPanel | ComparePanel | DevicesPanel | ErrorsPanel | RigPanel


class Workspace(QWidget):
    """3D view on the left, map and tabs on the right, and below all of it the line that says what happens.

    Only what is on the screen is drawn; a tab that comes up gets the newest state.
    """

    taxel_selected = Signal(int)
    method_chosen = Signal(object)

    def __init__(self, part: Part, make_view: Callable[[], View3D]) -> None:
        super().__init__()
        scene, names = part.scene, ChannelNames(part.scene.skin.layout)
        self.part = part
        self.names = names
        there = methods_of(scene, part.surface)
        self.methods = tuple(method for method in SHOWN if method in there)
        self.view = make_view()
        self.now = NowPanel()
        # Imported in the window's thread: pyqtgraph names all types of Qt, which must not happen in two threads at once.
        from app.panels.taxel_map import MapCard, TaxelMap, quarter_turns

        static = StaticScene(scene, part.surface, part.laid, part.channels)
        self.map = TaxelMap(scene, part.channels, names, quarter_turns(static))
        self.readings = ReadingsPanel()
        self.pokes = PokesPanel(names)
        self.inspect = InspectPanel(self.methods, names)
        self.compare = ComparePanel(part, self.methods, names)
        self.devices = DevicesPanel()
        self.error_course = ErrorsPanel(self.methods, scene.skin.layout)
        self.rig = RigPanel(scene.arm)
        self.panels: dict[str, TabPanel] = {
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
        self.card = MapCard(self.right, self.map, self.methods)
        below = QFrame(self.right)
        below.setObjectName("card")
        column = QVBoxLayout(below)
        column.setContentsMargins(1, 1, 1, 1)
        self.tabs = QTabWidget(below)
        column.addWidget(self.tabs)
        self._state: ViewState | None = None
        self._connect()

    def _connect(self) -> None:
        self.view.taxel_picked.connect(self.taxel_selected)
        self.map.taxel_clicked.connect(self.taxel_selected)
        for panel in (self.pokes, self.inspect, self.compare):
            panel.taxel_wanted.connect(self.taxel_selected)
        self.compare.comparison_changed.connect(self.view.set_comparison)
        chosen = self.card.methods
        chosen.activated.connect(lambda index: self.method_chosen.emit(chosen.itemData(index)))

    def arrange(self) -> None:
        """Lay the panels out, once; apart from making them, since each takes half of what a window may stand still."""
        for title, panel in self.panels.items():
            self.tabs.addTab(panel, title)
            # A panel that scrolls takes the focus.
            panel.setAccessibleName(title)
        self.tabs.setAccessibleName("tabs")
        self.tabs.setDocumentMode(True)
        self.tabs.tabBar().setExpanding(True)
        self.tabs.tabBar().setDrawBase(False)
        self.view.setMinimumWidth(420)
        # A plot needs the height more than the map, whose marks are seen whole down to this at 720 pixels.
        self.right.setSizes([21_000, 29_000])
        self._fit_right()
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

    def _fit_right(self) -> None:
        self.right.setMinimumWidth(scaled(RIGHT_LEAST_PX))

    def changeEvent(self, event: QEvent) -> None:
        """Leave room beside the 3D view for letters of another size."""
        super().changeEvent(event)
        if event.type() is QEvent.Type.FontChange:
            self._fit_right()

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
        anew = before is None or (before.revision, before.method) != (state.revision, state.method)
        self.card.show_state(state, anew=anew)
        room = 0.0 if state.guidance is None else max_angle_error(state.guidance)
        self.view.show_moment(state.snapshot, state.live, state.method, state.selected, state.target, room)
        self._show_tab()

    def _show_tab(self, _index: int = -1) -> None:
        # By its place: a style may add an ampersand to the text of a tab.
        if self._state is not None and self.tabs.count():
            list(self.panels.values())[self.tabs.currentIndex()].show_state(self._state)

    def show_tab(self, title: str) -> None:
        """Open the tab of that title, if there is one."""
        if title in self.panels:
            self.tabs.setCurrentWidget(self.panels[title])

    def recolour(self) -> None:
        """Follow the theme, where Qt's palette alone does not reach."""
        self.readings.recolour()
        self.error_course.recolour()
        self.compare.show_again()
        self.view.set_dark(theme_colours().dark)


class SessionView(QObject):
    """What exists as long as a session is open."""

    said = Signal(object)
    """`Message`."""
    unsaid = Signal(object)
    """`Message`: it holds no more."""
    sound_due = Signal(object)
    """`DueCue`: a sound that is due."""

    _ended = False
    """The verdict of the demo came by itself."""
    _history: HistoryDialog | None = None
    """Made when it is first asked for."""
    _thresholds: ThresholdsDialog | None = None
    """Likewise."""
    _scene: Scene | None = None
    """With the thresholds that hold; None before the first tick."""

    def __init__(
        self,
        part: Part,
        controller: Controller,
        commands: Commands,
        documents: Path,
        make_view: Callable[[], View3D] = View3D,
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self._controller = controller
        self._commands = commands
        self._documents = documents
        self._tick: Tick | None = None
        self._opened_s, self._opened_unix_s = time.monotonic(), time.time()
        self._cues = CueMemory()
        self._rig = RigReview()
        self._may: tuple[tuple[object, ...], Allowed] | None = None
        """What the newest answer of `_allowed` was made of, and that."""
        self._diversity: tuple[tuple[object, ...], AxisDiversity | None] = ((), None)
        """What the newest answer of `_diversity_of` was made of, and that."""
        self.state: ViewState | None = None
        """What is shown; None before the first tick."""
        self.selected: int | None = None
        self.workspace = Workspace(part, make_view)
        assert controller.guided is not None
        self.guided: GuidedSession = controller.guided
        self.guided.shows_modules = self.workspace.compare.isVisible
        self.guided.shows_errors = self.workspace.error_course.isVisible
        self.chips = LinkChips()
        self._modules_enough = ModulesEnough(self.guided.guide.plan, part.scene.noise.skin)
        self._enough_said: Message | None = None
        self.picking = LandmarkPicking(self.workspace.view, self._landmark_names, controller.act, part.scene.link, self)
        self._tab_actions: list[QAction] = commands.add_tabs(self.workspace.panels, self.workspace.tabs.setCurrentIndex)
        self._connect()

    def _connect(self) -> None:
        workspace = self.workspace
        workspace.wait("opening", workspace.part.scene.name)
        workspace.error_course.begin(self.guided.errors)
        workspace.taxel_selected.connect(self.select_taxel)
        workspace.method_chosen.connect(self.show_method)
        workspace.inspect.poke_wanted.connect(self.select_poke)
        workspace.compare.layout_wanted.connect(self.ask_layout)
        workspace.compare.file_wanted.connect(self.ask_places)
        workspace.compare.session_wanted.connect(self.ask_session_places)
        workspace.devices.change_wanted.connect(self._commands.actions["addresses"].trigger)
        workspace.tabs.currentChanged.connect(self._tab_opened)
        workspace.error_course.source_chosen.connect(self.follow_again)
        workspace.pokes.selection_changed.connect(self.refresh_allowed)
        workspace.inspect.mark_dead_requested.connect(lambda channel: self._controller.act(MarkDead(channel)))
        workspace.inspect.revive_requested.connect(lambda channel: self._controller.act(Revive(channel)))
        self.picking.said.connect(self.said)
        workspace.rig.correct_requested.connect(self._controller.act)
        workspace.rig.uncorrect_requested.connect(lambda of: self._controller.act(Uncorrect(of)))
        if workspace.rig.arm is not None:
            workspace.rig.arm.pose_requested.connect(lambda name: self._controller.act(SetPose(name)))

    def begin(self) -> None:
        """Start to build the 3D view, once the panels are on the screen."""
        # With the workspace as its context Qt calls nothing once that is gone.
        QTimer.singleShot(0, self.workspace, self.workspace.begin)

    @property
    def method(self) -> Method:
        """Method whose estimates are shown."""
        return self.guided.method

    def session_opened(self, snapshot: Snapshot) -> None:
        """Start with a session whose pokes are known already."""
        self._cues = CueMemory.of(snapshot)
        self.workspace.now.begin(snapshot)

    # What is shown

    def take_tick(self, tick: Tick) -> None:
        """Show a tick."""
        self._tick = tick
        self.show()

    def _tab_opened(self, _index: int) -> None:
        # What these show is worked out only while they are seen, and not only from the next tick on.
        if self.workspace.tabs.currentWidget() in (self.workspace.compare, self.workspace.error_course):
            self.follow_again()

    def show(self) -> None:
        """Show the newest tick with what is selected now; nothing of the session changes."""
        tick, before = self._tick, self.state
        if tick is None:
            return
        self.state = state = self.view_state(tick)
        self._cue(state)
        self._announce_modules(state)
        if self.ends and self._controller.demo and not self._ended:
            # Nobody's hands are busy, and somebody who only looks on would not know that this is the end.
            self._ended = True
            QTimer.singleShot(VERDICT_MS, self.workspace, lambda: self.ask_verdict(self.workspace.window()))
        self.workspace.show_state(state)
        self.chips.show_state(state)
        for dialog in (self._history, self._thresholds):
            if dialog is not None:
                dialog.show_state(state)
        if before is None or state.may is not before.may:
            self._enable(state.may)

    def refresh_allowed(self) -> None:
        """Enable what may be done now."""
        if self._tick is not None and self.state is not None:
            self.state = replace(self.state, may=self._allowed(self._tick))
            self._enable(self.state.may)

    def _enable(self, may: Allowed) -> None:
        correct = "" if may.correct is None else offer_text(may.correct)
        self._commands.follow(may, correct, can_keep=self._controller.can_keep)

    def _allowed(self, tick: Tick) -> Allowed:
        """Return what may be done now; the same object until something that it follows from changes."""
        snapshot, live, running, offers = tick.snapshot, tick.live, self._controller.running, self._rig.offers(tick.snapshot)
        pokes, taxel, guidance = self.workspace.pokes.selected(), self.selected, self.guided.guidance
        carried = tuple(link.carries for link in live.links)
        made_of = (snapshot.generation, running, pokes, taxel, carried, guidance, offers)
        if self._may is None or made_of != self._may[0]:
            scene = self.workspace.part.scene
            self._may = made_of, allowed(snapshot, scene, live.links, running, pokes, taxel, guidance, offers)
        return self._may[1]

    def view_state(self, tick: Tick) -> ViewState:
        """Return what all views are a function of; making it changes nothing."""
        snapshot = tick.snapshot
        return ViewState(
            snapshot=snapshot,
            live=tick.live,
            scene=self._scene_now(snapshot),
            names=self.workspace.names,
            method=self.method,
            selected=self.selected,
            running=self._controller.running,
            now_ns=tick.now_ns,
            behind_s=tick.behind_s,
            clock_offset=self._opened_unix_s - self._opened_s,
            guidance=self.guided.guidance,
            diversity=self._diversity_of(tick),
            coaching=self.guided.coach.coaching,
            review=self._rig.shown(snapshot),
            offers=self._rig.offers(snapshot),
            modules=self.guided.modules.found,
            unsolved=tick.unsolved,
            simulated=simulated_words(self._controller.pace, self._controller.running) if self._controller.simulated else "",
            costs=self.guided.guide.costs,
            eye=self.workspace.view.eye(),
            may=self._allowed(tick),
        )

    def _scene_now(self, snapshot: Snapshot) -> Scene:
        """Return the scene with the thresholds that hold; the same object until they change."""
        if self._scene is None or self._scene.contacts != snapshot.decisions.thresholds:
            self._scene = replace(self.workspace.part.scene, contacts=snapshot.decisions.thresholds)
        return self._scene

    def _diversity_of(self, tick: Tick) -> AxisDiversity | None:
        """Return what the contacts of the taxel that is looked at are like; the same object until something changes it."""
        channel = looked_at(self.selected, self.guided.guidance)
        made_of = tick.snapshot.generation, self.method, channel, self.guided.guidance
        if made_of != self._diversity[0]:
            self._diversity = made_of, None if channel is None else self.guided.guide.axis_diversity(channel, tick.evidence)
        return self._diversity[1]

    def take_review(self, review: Review | None) -> None:
        """Show what landmark pokes say of the rig, and say once what could be put right; None where there is none."""
        self._rig.review = review
        self.show()
        news = None if self._tick is None else self._rig.news(self._tick.snapshot)
        if news is not None:
            self.said.emit(Message(offer_news(news), found=True))

    def _announce_modules(self, state: ViewState) -> None:
        """Say that the modules method needs no more, until it is shown: an operator who pokes misses a message that passes."""
        is_news = self._modules_enough.is_news
        if is_news(state.snapshot, state.guidance, state.method, streaming=state.connected):
            self._enough_said = Message(modules_enough_words(), asks=True)
            self.said.emit(self._enough_said)
        elif self._enough_said is not None and state.method is Method.MODULES:
            self.unsaid.emit(self._enough_said)
            self._enough_said = None

    def correct(self) -> None:
        """Use the correction that is offered."""
        if self.state is not None and self.state.offers:
            action = self.state.offers[0].action
            if self._controller.act(action):
                self.said.emit(Message(corrected_words(action)))

    def _cue(self, state: ViewState) -> None:
        """Ask for the sound that is due, before anything is drawn: an ear notices a shorter delay than an eye."""
        due, self._cues = due_cue(self._cues, state)
        if due is not None and state.behind_s <= LATE_S:
            self.sound_due.emit(due)

    def follow_again(self) -> None:
        """Follow and show the session again, after the method or what is wanted of the guide changed."""
        self._controller.publish_again()

    def show_guide(self) -> None:
        """Say and show what to poke next, or do not."""
        self.guided.guide.wanted = self._commands.actions["guide"].isChecked()
        self.follow_again()

    def show_turning(self) -> None:
        """Turn the camera to the target between pokes, or do not."""
        self.workspace.view.set_turning(self._commands.actions["turn"].isChecked())

    def show_layers(self) -> None:
        """Show the layers of the 3D view that are wanted."""
        hidden = (name for name in LAYERS if not self._commands.actions[name].isChecked())
        self.workspace.view.hide_layers(frozenset(hidden))

    def skip_target(self) -> None:
        """Ask for another target."""
        self._act_and_follow(self.guided.guide.skip())

    def skip_landmarks(self) -> None:
        """Ask for no landmarks in this arm pose, or end the closing check."""
        self._act_and_follow(self.guided.guide.skip_landmarks())

    def check_again(self) -> None:
        """Make the closing check once more."""
        again = None if self._tick is None else self.guided.guide.check_again(self._tick.snapshot, self._tick.live.pose)
        if again is None:
            self.said.emit(Message(NOTHING_TO_CHECK))
        else:
            self._act_and_follow(again)

    def _act_and_follow(self, action: Action | None) -> None:
        if action is not None:
            self._controller.act(action)
        self.follow_again()

    def recolour(self) -> None:
        """Follow the theme."""
        self.workspace.recolour()
        self.show()

    def show_method(self, method: Method) -> None:
        """Show another method's estimates."""
        self.guided.method = method
        self.follow_again()

    def next_method(self) -> None:
        """Show the next method's estimates."""
        methods = self.workspace.methods
        self.show_method(methods[(methods.index(self.method) + 1) % len(methods)])

    def show_difference(self) -> None:
        """Join each estimate to another method's by a line, or do not."""
        self.workspace.view.set_difference(self._commands.actions["difference"].isChecked())

    def select_taxel(self, channel: int | None) -> None:
        """Select a taxel in every view, or none."""
        if channel != self.selected:
            self.selected = channel
            self.show()

    def select_last(self) -> None:
        """Show the newest poke in the list."""
        if self.state is not None and self.state.snapshot.pokes:
            self.select_poke(self.state.snapshot.pokes[-1].outcome.poke)

    def select_poke(self, poke: int) -> None:
        """Show a poke in the list."""
        # Opened first: a list that nobody sees does not know the newest pokes.
        self.workspace.tabs.setCurrentWidget(self.workspace.pokes)
        self.workspace.pokes.select(poke)

    # What the operator wants

    def undo(self) -> None:
        """Take back the last poke or action."""
        self._controller.act(Undo())

    def redo(self) -> None:
        """Bring again what was taken back last."""
        self._controller.act(Redo())

    def show_history(self, parent: QWidget) -> None:
        """Show what was done and when, beside the window."""
        if self._history is None:
            self._history = HistoryDialog(parent)
            self._history.undo_wanted.connect(lambda count: self._controller.act_all([Undo()] * count))
            self._history.redo_wanted.connect(lambda count: self._controller.act_all([Redo()] * count))
        if self.state is not None:
            self._history.show_state(self.state)
        self._history.show()
        self._history.activateWindow()

    def show_thresholds(self, parent: QWidget) -> None:
        """Show what a poke must pass to count, beside the window, and let it be changed."""
        if self._thresholds is None:
            self._thresholds = ThresholdsDialog(self.workspace.part.scene.contacts, parent)
            self._thresholds.thresholds_wanted.connect(self._controller.act)
        if self.state is not None:
            self._thresholds.show_state(self.state)
        self._thresholds.show()
        self._thresholds.activateWindow()

    def exclude_or_restore(self) -> None:
        """Take the selected pokes out, or in again where all of them are out."""
        if self.state is not None:
            may = self.state.may
            out: list[Action] = [*(AtLandmark(poke, "") for poke in may.unname), *(Exclude(poke) for poke in may.exclude)]
            self._controller.act_all(out or [Restore(poke) for poke in may.restore])
            self.refresh_allowed()

    def mark_or_revive(self) -> None:
        """Leave the selected taxel out, or use it again."""
        if self.selected is not None and self.state is not None:
            may = self.state.may
            self._controller.act(Revive(self.selected) if may.revive else MarkDead(self.selected))
            self.refresh_allowed()

    def ask_landmark(self, parent: QWidget) -> None:
        """Ask for a known point of the part and for its name."""
        if self.state is not None:
            self.picking.ask(parent)

    def _landmark_names(self) -> set[str]:
        return set() if self.state is None else {landmark.name for landmark in self.state.snapshot.decisions.landmarks}

    @property
    def ends(self) -> bool:
        """Whether it is enough, so that the next thing to do is to look at the verdict."""
        return self.state is not None and self.state.may.ends

    def ask_verdict(self, parent: QWidget) -> None:
        """Show what the session has come to, and lead on to the file."""
        state = self.state
        if state is None or self._tick is None or state.guidance is None:
            return
        found = None if state.review is None else state.review.rig
        verdict = self.guided.guide.verdict(state.snapshot, state.method, self._tick.evidence, found)
        rig = rig_state(state.offers, state.snapshot.decisions.corrections.values(), state.review)
        may, names, settled = state.may, self.workspace.names, not state.offers
        dialog = VerdictDialog(verdict, names, parent, rig=rig, can_export=may.export, settled=settled)
        dialog.taxel_wanted.connect(self.select_taxel)
        dialog.export_wanted.connect(lambda: self.ask_export(parent))
        dialog.report_wanted.connect(lambda: self.ask_report(parent))
        dialog.open()

    def ask_export(self, parent: QWidget) -> None:
        """Ask what to write, write it and show what was found."""
        stem = self._documents / self.workspace.part.scene.name
        dialog = ExportDialog(self.workspace.methods, self.method, stem, parent)

        def write(format_: str, path: Path, method: Method) -> None:
            rig = None if self.state is None or self.state.review is None else self.state.review.rig

            def done(found: tuple[Verdict, tuple[str, ...]]) -> None:
                verdict, sentences = found
                early = () if verdict.enough else (verdict_sentence(verdict),)
                dialog.show_written((*early, *sentences))

            self._controller.export(format_, path, method, rig, done, dialog.show_failure, dialog.end_task)

        dialog.write_requested.connect(write)
        dialog.open()

    def ask_apply(self, parent: QWidget, settings: QSettings) -> None:
        """Ask where positions are to be sent, send them and show what the robot answered."""
        state = self.state
        if state is None or self._tick is None:
            return
        rig = None if state.review is None else state.review.rig
        evidence, snapshot = self._tick.evidence, state.snapshot

        def verdict_of(method: Method) -> str:
            return verdict_sentence(self.guided.guide.verdict(snapshot, method, evidence, rig))

        address = str(settings.value("apply/address", "")) or offered_port(link.address for link in self._controller.links)
        dialog = ApplyDialog(self.workspace.methods, self.method, verdict_of, address, parent)
        dialog.address.textEdited.connect(lambda typed: settings.setValue("apply/address", typed.strip()))

        def send(address: str, method: Method) -> None:
            settings.setValue("apply/address", address)
            self._controller.apply(address, method, dialog.show_end, dialog.end_task)

        dialog.apply_requested.connect(send)
        dialog.open()

    def ask_report(self, parent: QWidget) -> None:
        """Ask for a file, write the session's report there, and say where it is or why it is not."""
        name = str(self._folder() / f"{self.workspace.part.scene.name}-report.html")
        chosen, _ = QFileDialog.getSaveFileName(parent, "Write the report", name, "Report (*.html)")
        if chosen:
            path = _with_ending(chosen, ".html")
            self.said.emit(Message(REPORTING, found=True))

            def say_where(verdict: str) -> None:
                self.said.emit(Message(report_words(path, verdict)))

            self._controller.report(path, self.method, say_where, self._say_failure)

    def ask_places(self) -> None:
        """Ask for a file of places, and compare with it."""
        path, _ = QFileDialog.getOpenFileName(self.workspace, "Compare with a file", str(self._folder()), KINDS_OF_PLACES)
        if path:
            self._controller.read_positions(Path(path), partial(self._take_places, Path(path)))

    def ask_session_places(self) -> None:
        """Ask for the folder of another session, and compare with it."""
        path = QFileDialog.getExistingDirectory(self.workspace, "Compare with a session", str(self._folder()))
        if path:
            self._controller.read_positions(Path(path), partial(self._take_places, Path(path)))

    def _take_places(self, path: Path, sets: tuple[TaxelPositions, ...]) -> None:
        """Offer sets of places in the panel that compares; the first is chosen."""
        for found in sets:
            source = other_source(found.name, path, self.workspace.compare.others)
            self.workspace.compare.offer(source, found.places, choose=found is sets[0])

    def ask_reference(self, parent: QWidget) -> None:
        """Ask for a file with known places of the taxels, and show the error against it."""
        path, _ = QFileDialog.getOpenFileName(parent, "Compare with known places", str(self._folder()), KINDS_OF_PLACES)
        if path:
            self.compare_with(Path(path))

    def compare_with(self, path: Path) -> None:
        """Show the error against the places in a file."""
        from skincal.files.reference import load_reference

        part = self.workspace.part
        channels = part.channels.tolist()
        self._controller.compute(
            lambda: load_reference(path, part.scene.link, channels),
            self._take_reference,
            self._say_failure,
        )

    def ask_layout(self, mend: LayoutRepair) -> None:
        """Ask for a file, write the corrected layout there, and say where it is or why it is not."""
        scene = self.workspace.part.scene
        given, name = scene.skin.layout, str(self._folder() / f"{scene.name}-corrected.modules.toml")
        chosen, _ = QFileDialog.getSaveFileName(self.workspace, "Save the corrected layout", name, "Layout (*.toml)")
        if given is None or not chosen:
            return
        path = _with_ending(chosen, ".toml")

        def write() -> None:
            from skincal.files.layout_file import write_layout

            write_layout(given, mend, path)

        self._controller.compute(write, lambda _: self.said.emit(Message(saved_words(path, mend))), self._say_failure)

    def _folder(self) -> Path:
        # A folder that is not there yet would stand in a dialog as a file's name.
        return self._documents if self._documents.is_dir() else Path.home()

    def _say_failure(self, sentence: str) -> None:
        self.said.emit(Message(sentence, error=True))

    def offer(self, reference: Reference) -> None:
        """Compare estimates with it, where the panel of errors is open."""
        self.guided.errors.offer(reference)
        source = (
            Source(PlaceOrigin.TRUTH) if reference.origin is Origin.TRUTH else Source(PlaceOrigin.OTHER, name=reference.name)
        )
        self.workspace.compare.offer(source, reference.places)
        self.workspace.error_course.show_sources()
        self.follow_again()

    def _take_reference(self, reference: Reference) -> None:
        self.offer(reference)
        self.workspace.tabs.setCurrentWidget(self.workspace.error_course)

    def ask_picture(self, parent: QWidget) -> None:
        """Ask for a file and write the 3D view to it."""
        path, _ = QFileDialog.getSaveFileName(parent, "Save 3D picture", str(self._folder() / "skincal.png"), "Picture (*.png)")
        if not path:
            return
        try:
            self.workspace.view.screenshot(_with_ending(path, ".png"))
        except InputError as error:
            self._say_failure(str(error))

    # Coming and going

    def _splitters(self) -> dict[str, QSplitter]:
        return {"window/across": self.workspace.across, "window/right": self.workspace.right}

    def restore(self, settings: QSettings) -> None:
        """Put the splitters where they were, and open the tab that was."""
        for name, splitter in self._splitters().items():
            state = settings.value(name)
            if isinstance(state, QByteArray):
                splitter.restoreState(state)
        # A settings file holds words, and "false" would be true without its type.
        self.guided.guide.wanted = bool(settings.value("window/guide", True, type=bool))
        self._commands.actions["guide"].setChecked(self.guided.guide.wanted)
        self._commands.actions["turn"].setChecked(bool(settings.value("window/turn", True, type=bool)))
        self.show_turning()
        for name in LAYERS:
            self._commands.actions[name].setChecked(bool(settings.value(f"layers/{name}", True, type=bool)))
        self.show_layers()
        self.show_difference()
        self.workspace.error_course.restore(settings)
        self.workspace.show_tab(str(settings.value("window/tab", "")))
        self.follow_again()

    def save(self, settings: QSettings) -> None:
        """Remember where the splitters are, and which tab is open; nothing of panels that were not laid out yet."""
        if not self.workspace.tabs.count():
            return
        for name, splitter in self._splitters().items():
            settings.setValue(name, splitter.saveState())
        self.workspace.error_course.save(settings)
        settings.setValue("window/guide", self.guided.guide.wanted)
        settings.setValue("window/turn", self._commands.actions["turn"].isChecked())
        for name in LAYERS:
            settings.setValue(f"layers/{name}", self._commands.actions[name].isChecked())
        settings.setValue("window/tab", list(self.workspace.panels)[self.workspace.tabs.currentIndex()])

    def close(self) -> None:
        """Give the 3D view's resources back, and take out of the window what belongs to this session."""
        self.picking.stop()
        for dialog in (self._history, self._thresholds):
            if dialog is not None:
                dialog.deleteLater()
        self._history = self._thresholds = None
        for action in self._tab_actions:
            action.deleteLater()
        self._tab_actions = []
        self.workspace.view.close_view()


def _with_ending(chosen: str, ending: str) -> Path:
    """Add the file ending to a typed name that has none."""
    path = Path(chosen)
    return path if path.suffix else path.with_name(path.name + ending)
