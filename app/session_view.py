"""The view of one open session: its panels, the selection, the method, and the operator's actions on the session.

At each tick one frozen `ViewState` is made of the session and what follows it (`GuidedSession`), and handed to the views, which
change nothing. The module is imported after the window is on the screen, since numpy comes with it.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, QSettings, QTimer, Signal
from PySide6.QtGui import QAction
from PySide6.QtWidgets import QApplication, QFileDialog

from app.commands import Commands
from app.dialogs.apply_dialog import ApplyDialog, offered_port
from app.dialogs.export_dialog import ExportDialog
from app.dialogs.history_dialog import HistoryDialog
from app.dialogs.landmark_dialog import LandmarkPicking
from app.dialogs.thresholds_dialog import ThresholdsDialog
from app.dialogs.verdict_dialog import VerdictDialog
from app.panels.compare_panel import ComparePanel
from app.panels.devices import DevicesPanel, LinkChips
from app.panels.errors_panel import ErrorsPanel
from app.panels.inspect_panel import InspectPanel
from app.panels.panel import Panel
from app.panels.pokes_panel import PokesPanel
from app.panels.readings_panel import ReadingsPanel
from app.panels.rig_panel import RigPanel
from app.panels.widgets import POSITION_FILES, with_ending
from app.session.controller import Controller
from app.sound.cues import CueMemory, due_cue
from app.state.memo import Memo
from app.state.policies import Allowed, RigReview, allowed
from app.state.tool_tip import tip_in_sensor
from app.state.view_state import ViewState, focused_channel
from app.text.guidance_text import NOTHING_TO_CHECK
from app.text.message import REPORT_IN_PROGRESS, REPORT_WORK, Message, report_words
from app.text.now_text import NowMemory, modules_enough_words, now_line
from app.text.part_pose_text import tool_state, unplaced_note
from app.text.rig_text import corrected_words, named_landmarks_words, offer_news, rig_state
from skincal.files.formats import ExportOptions
from skincal.following.review import Review
from skincal.following.session_guide import ModulesEnough
from skincal.guide.progress import AxisDiversity
from skincal.model.actions import Action, Redo, Undo
from skincal.model.errors import InputError
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Method
from skincal.words.compare_words import saved_words
from skincal.words.verdict_words import verdict_sentence

if TYPE_CHECKING:
    from app.workspace import Workspace
    from skincal.files.reference import TaxelPositions
    from skincal.guide.verdict import Verdict

DIALOG_CHECK_PERIOD_MS = 300  # Time between tries to open the verdict while a dialog is open
DEMO_VERDICT_DELAY_MS = 3000  # The demonstration shows that it is finished for this long before the verdict opens
MAX_EVENT_AGE_FOR_SOUND_S = 0.3  # Older events make no sound: the hand does something else by now
PANEL_TYPES: tuple[type[Panel], ...] = (
    ReadingsPanel, PokesPanel, InspectPanel, ComparePanel, DevicesPanel, ErrorsPanel, RigPanel,
)  # fmt: skip
"""The tabs; the number of a tab is its key."""


class SessionView(QObject):
    """Everything of the window that exists while a session is open, except its page, the workspace."""

    said = Signal(object)  # `Message`
    unsaid = Signal(object)  # `Message` that is no longer true
    sound_due = Signal(object)  # `DueCue`

    def __init__(
        self,
        workspace: Workspace,
        controller: Controller,
        commands: Commands,
        documents: Path,
        settings: QSettings,
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._controller, self._commands, self._documents, self._settings = controller, commands, documents, settings
        self._moment: ViewState | None = None  # Of the newest tick, without the selection and what follows from it
        self._clock_offset_s = time.time() - time.monotonic()
        self._cues, self._now = CueMemory(), NowMemory()
        self._rig = RigReview(has_arm=workspace.part.scene.arm is not None)
        self._may, self._diversity = Memo[Allowed](), Memo[AxisDiversity | None]()
        self._has_ended = False  # The demonstration has ended
        self._is_verdict_due = False  # It opens without a key
        self._history: HistoryDialog | None = None
        self._thresholds: ThresholdsDialog | None = None
        self.state: ViewState | None = None  # What is shown; `None` before the first tick
        self.selected: int | None = None
        assert controller.guided is not None
        self.guided = guided = controller.guided
        self.workspace = workspace
        workspace.add_panels(guided, [kind(guided) for kind in PANEL_TYPES])
        self.chips = LinkChips()
        self._modules_enough = ModulesEnough(guided.guide.plan, guided.part.scene.noise.skin, guided.guide.surroundings)
        self._enough_message: Message | None = None
        self.picking = LandmarkPicking(self.workspace.view, self._landmark_names, controller.act, guided.part.scene.link, self)
        self._tab_actions: list[QAction] = commands.add_tabs(self.workspace.panels, self.workspace.show_numbered_tab)
        self._pokes = self.workspace.panel(PokesPanel)
        self._followed = (
            (controller.session_opened, self._begin_session), (controller.ticked, self._take_tick),
            (controller.reviewed, self._take_review), (controller.truth_found, self.offer),
        )  # fmt: skip
        """Signals of the controller, followed until `close`."""
        self._connect()

    def _connect(self) -> None:
        workspace = self.workspace
        for signal, slot in self._followed:
            signal.connect(slot)
        workspace.taxel_selected.connect(self.select_taxel)
        workspace.method_chosen.connect(self.show_method)
        for panel in workspace.panels.values():
            panel.poke_wanted.connect(self.select_poke)
            panel.action_wanted.connect(self._controller.act)
            panel.command_wanted.connect(lambda name: self._commands.actions[name].trigger())
            panel.follow_wanted.connect(self.follow_again)
            panel.message_ready.connect(lambda sentence: self.said.emit(Message(sentence)))
        compare = workspace.panel(ComparePanel)
        compare.seen.connect(self.guided.show_modules)
        compare.file_wanted.connect(self._ask_compared_file)
        compare.session_wanted.connect(self._ask_compared_session)
        compare.layout_wanted.connect(self._ask_corrected_layout)
        workspace.panel(ErrorsPanel).seen.connect(self.guided.show_errors)
        # A panel follows the session only while it is visible: at once, not from the next tick on.
        workspace.tabs.currentChanged.connect(lambda _: self.follow_again())
        workspace.docks.detached_changed.connect(self.follow_again)
        self._pokes.selection_changed.connect(self.refresh_allowed)
        self.picking.said.connect(self.said)

    def make_next_plot(self) -> bool:
        """Make a plot of the readings; return whether all are there, as `Workspace.arrange` needs.

        Not done in `__init__`, to keep the window responsive.
        """
        return self.workspace.panel(ReadingsPanel).make_next_curves()

    def _begin_session(self, snapshot: Snapshot) -> None:
        """Show a newly opened session, which may already have pokes."""
        self._cues = CueMemory.from_snapshot(snapshot)
        self._now = NowMemory.from_snapshot(snapshot)

    # What is shown

    @property
    def has_turns(self) -> bool:
        """Whether the taxels measure three axes, so that each has a turn."""
        return self.guided.part.scene.skin.axes is not None

    @property
    def method(self) -> Method:
        """The method that is shown and that the guide serves."""
        return self.guided.method

    def _take_tick(self, moment: ViewState) -> None:
        self._moment = moment
        self.show()

    def follow_again(self) -> None:
        """Follow and show the session again, for example after the method changed."""
        self._controller.publish_again()

    def show(self) -> None:
        """Show the newest tick with the present selection."""
        moment, before = self._moment, self.state
        if moment is None:
            return
        self.state = state = self._completed(moment)
        self._play_cue(state)
        self._announce_modules(state)
        if state.may.ends and self._controller.demo and not self._has_ended:
            # A spectator would not know that the demonstration is over.
            self._has_ended = self._is_verdict_due = True
            QTimer.singleShot(DEMO_VERDICT_DELAY_MS, self.workspace, self._show_due_verdict)
        now, self._now = now_line(self._now, state)
        note = "" if state.snapshot.is_placed else unplaced_note(state, tip_in_sensor(state))
        self.workspace.show_state(state, now, note)
        self.chips.show_state(state)
        for dialog in (self._history, self._thresholds):
            if dialog is not None:
                dialog.show_state(state)
        if before is None or state.may is not before.may:
            self._commands.update_actions()

    def refresh_allowed(self) -> None:
        """Enable the commands for another selection."""
        if self.state is not None:
            self.state = replace(self.state, may=self._allowed(self.state))
            self._commands.update_actions()

    def _allowed(self, moment: ViewState) -> Allowed:
        snapshot, offers = moment.snapshot, self._rig.offers(moment.snapshot)
        chosen = moment.running, self._pokes.selected(), self.selected, moment.guidance, offers
        return self._may.get((snapshot.generation, *chosen), lambda: allowed(snapshot, *chosen))

    def _completed(self, moment: ViewState) -> ViewState:
        """Add the selection and what follows from it to the state of a tick."""
        snapshot, channel = moment.snapshot, focused_channel(self.selected, moment.guidance)
        return replace(
            moment,
            clock_offset=self._clock_offset_s,
            selected=self.selected,
            diversity=self._diversity.get(
                (snapshot.generation, moment.method, channel, moment.guidance),
                lambda: None if channel is None else self.guided.guide.axis_diversity(channel),
            ),
            review=self._rig.in_use(snapshot),
            offers=self._rig.offers(snapshot),
            eye=self.workspace.view.eye(),
            may=self._allowed(moment),
        )

    def _take_review(self, review: Review | None) -> None:
        """Show the results of landmark pokes; announce an available correction once."""
        self._rig.review = review
        self.show()
        news = None if self._moment is None else self._rig.news(self._moment.snapshot)
        if news is not None:
            self.said.emit(Message(offer_news(news), found=True))

    def _announce_modules(self, state: ViewState) -> None:
        """Announce that the modules method needs no more pokes; the message stays until that method is shown."""
        if self._modules_enough.is_news(state.snapshot, state.guidance, state.method, streaming=state.connected):
            self._enough_message = Message(modules_enough_words(), asks=True)
            self.said.emit(self._enough_message)
        elif self._enough_message is not None and state.method is Method.MODULES:
            self.unsaid.emit(self._enough_message)
            self._enough_message = None

    def _play_cue(self, state: ViewState) -> None:
        """Play a sound before anything is drawn: an ear notices a shorter delay than an eye."""
        due, self._cues = due_cue(self._cues, state)
        if due is not None and state.behind_s <= MAX_EVENT_AGE_FOR_SOUND_S:
            self.sound_due.emit(due)

    def recolour(self) -> None:
        self.workspace.recolour()
        self.show()

    # Commands

    def follow_switches(self) -> None:
        """Apply the switches of the View and Layers menus."""
        is_on = self._commands.is_on
        self.workspace.follow_switches(is_on)
        if self.guided.guide.wanted != is_on("guide"):
            self.guided.guide.wanted = is_on("guide")
            self.follow_again()

    def correct(self) -> None:
        if self.state is not None and self.state.offers:
            offer = self.state.offers[0]
            if self._controller.act(offer.action):
                self.said.emit(Message(corrected_words(offer)))

    def skip_target(self) -> None:
        self._act_and_follow(self.guided.guide.skip())

    def skip_landmarks(self) -> None:
        """Skip the remaining landmarks of this arm pose, or the final check if it is running."""
        self._act_and_follow(self.guided.guide.skip_landmarks())

    def check_again(self) -> None:
        moment = self._moment
        again = None if moment is None else self.guided.guide.check_again(moment.snapshot, moment.live.pose)
        if again is None:
            self.said.emit(Message(NOTHING_TO_CHECK))
        else:
            self._act_and_follow(again)

    def _act_and_follow(self, action: Action | None) -> None:
        if action is not None:
            self._controller.act(action)
        self.follow_again()

    def show_method(self, method: Method) -> None:
        self.guided.method = method
        self.follow_again()

    def next_method(self) -> None:
        methods = self.workspace.methods
        self.show_method(methods[(methods.index(self.method) + 1) % len(methods)])

    def select_taxel(self, channel: int | None) -> None:
        """Select a taxel in every view, or none."""
        if channel != self.selected:
            self.selected = channel
            self.show()

    def select_last(self) -> None:
        if self.state is not None and self.state.snapshot.pokes:
            self.select_poke(self.state.snapshot.pokes[-1].outcome.poke)

    def select_poke(self, poke: int) -> None:
        # Opened first: a hidden list does not have the newest pokes.
        self.workspace.show_tab(PokesPanel.title)
        self._pokes.select(poke)

    def undo(self) -> None:
        self._controller.act(Undo())

    def redo(self) -> None:
        self._controller.act(Redo())

    def show_history(self) -> None:
        if self._history is None:
            self._history = HistoryDialog(self.workspace.window())
            self._history.undo_wanted.connect(lambda count: self._controller.act_all([Undo()] * count))
            self._history.redo_wanted.connect(lambda count: self._controller.act_all([Redo()] * count))
        self._show_dialog(self._history)

    def show_thresholds(self) -> None:
        if self._thresholds is None:
            scene = self.workspace.part.scene
            self._thresholds = ThresholdsDialog(scene.contacts, self.workspace.window(), has_sensor=scene.has_sensor)
            self._thresholds.thresholds_wanted.connect(self._controller.act)
        self._show_dialog(self._thresholds)

    def _show_dialog(self, dialog: HistoryDialog | ThresholdsDialog) -> None:
        if self.state is not None:
            dialog.show_state(self.state)
        dialog.show()
        dialog.activateWindow()

    def exclude_or_restore(self) -> None:
        """Exclude the selected pokes; restore them if all are excluded."""
        if self.state is not None:
            self._controller.act_all(self.state.may.exclude)
            self.refresh_allowed()

    def mark_or_revive(self) -> None:
        """Mark the selected taxel as dead, or use it again."""
        if self.state is not None and self.state.may.taxel is not None:
            self._controller.act(self.state.may.taxel)
            self.refresh_allowed()

    def name_landmarks(self) -> None:
        """Name the landmarks of recorded pokes, the sure ones alone; each can be undone."""
        self.said.emit(Message(named_landmarks_words(self._controller.name_landmarks()), found=True))

    def ask_landmark(self) -> None:
        if self.state is not None:
            self.picking.ask(self.workspace.window())

    def _landmark_names(self) -> set[str]:
        return set() if self.state is None else {landmark.name for landmark in self.state.snapshot.decisions.landmarks}

    def _show_due_verdict(self) -> None:
        """Show the verdict unless it was shown meanwhile; an open question or dialog is answered first."""
        if not self._is_verdict_due:
            return
        if QApplication.activeModalWidget() is not None:
            QTimer.singleShot(DIALOG_CHECK_PERIOD_MS, self.workspace, self._show_due_verdict)
            return
        self.ask_verdict()

    def ask_verdict(self) -> None:
        """Show the verdict; it leads on to the file."""
        state, parent = self.state, self.workspace.window()
        if state is None or state.guidance is None:
            return
        self._is_verdict_due = False
        found = None if state.review is None else state.review.rig
        verdict = self.guided.guide.verdict(state.snapshot, state.method, found)
        used = state.snapshot.decisions.corrections.values()
        has_tool = state.scene.tool is not None
        is_corrected = bool(state.offers) or bool(used)
        rig = rig_state(state.offers, used, state.review, has_arm=verdict.has_arm) if is_corrected or not has_tool else ""
        rig = "\n".join(filter(None, (rig, tool_state(state)))) if has_tool else rig
        can_export, settled = state.may.export, not state.offers
        dialog = VerdictDialog(verdict, self.workspace.names, parent, rig=rig, can_export=can_export, settled=settled)
        dialog.taxel_wanted.connect(self.select_taxel)
        dialog.export_wanted.connect(self.ask_export)
        dialog.report_wanted.connect(self.ask_report)
        dialog.open()

    def ask_export(self) -> None:
        """Ask for format, method and file, write it and show the remarks on it."""
        stem = self._folder() / self.workspace.part.scene.name
        from skincal.files.export import usual_format

        usual = usual_format(self.workspace.part.scene)
        dialog = ExportDialog(self.workspace.methods, self.method, stem, self.workspace.window(), usual)

        def write(format_: str, path: Path, method: Method, options: ExportOptions) -> None:
            rig = None if self.state is None or self.state.review is None else self.state.review.rig

            def show_result(found: tuple[Verdict, tuple[str, ...]]) -> None:
                verdict, sentences = found
                early = () if verdict.is_finished and not verdict.frame_in_doubt else (verdict_sentence(verdict),)
                dialog.show_written((*early, *sentences))

            try:
                work = self._controller.export_work(format_, path, method, rig, options)
            except InputError as error:
                dialog.show_failure(str(error))
                return
            self._controller.compute(work, show_result, dialog.show_failure, ended=dialog.end_task)

        dialog.write_requested.connect(write)
        dialog.open()

    def ask_apply(self) -> None:
        """Ask for a robot's address, send the positions and show the robot's answers."""
        state, settings = self.state, self._settings
        if state is None:
            return
        rig = None if state.review is None else state.review.rig

        def verdict_of(method: Method) -> str:
            # Pokes may come while the dialog is open; the positions of the newest are sent.
            assert self._moment is not None
            return verdict_sentence(self.guided.guide.verdict(self._moment.snapshot, method, rig))

        address = str(settings.value("apply/address", "")) or offered_port(link.address for link in self._controller.links)
        dialog = ApplyDialog(self.workspace.methods, self.method, verdict_of, address, self.workspace.window())
        dialog.address.textEdited.connect(lambda typed: settings.setValue("apply/address", typed.strip()))

        def send(address: str, method: Method) -> None:
            settings.setValue("apply/address", address)
            self._controller.apply(address, method, dialog.show_end, dialog.end_task)

        dialog.apply_requested.connect(send)
        dialog.open()

    def ask_report(self) -> None:
        """Ask for a file and write the session's report to it."""
        path = self._ask_file("Write the report", f"{self.workspace.part.scene.name}-report.html", "Report (*.html)")
        if path is not None:
            self.said.emit(Message(REPORT_IN_PROGRESS, found=True, work=REPORT_WORK))

            def tell_written(verdict: str) -> None:
                self.said.emit(Message(report_words(path, verdict), file=path, work=REPORT_WORK))

            def tell_failed(sentence: str) -> None:
                self.said.emit(Message(sentence, error=True, work=REPORT_WORK))

            self._controller.report(path, self.method, tell_written, tell_failed)

    def ask_picture(self) -> None:
        path = self._ask_file("Save 3D picture", "skincal.png", "Picture (*.png)")
        if path is not None:
            try:
                self.workspace.view.screenshot(path)
            except InputError as error:
                self._tell_failure(str(error))

    def _ask_file(self, title: str, name: str, kinds: str) -> Path | None:
        """Ask for a file to write; a typed name gets the ending of the proposed one."""
        path, _ = QFileDialog.getSaveFileName(self.workspace, title, str(self._folder() / name), kinds)
        return with_ending(path, Path(name).suffix) if path else None

    def _ask_compared_file(self) -> None:
        self._compare(
            QFileDialog.getOpenFileName(self.workspace, "Compare with a file", str(self._folder()), POSITION_FILES)[0]
        )

    def _ask_compared_session(self) -> None:
        self._compare(QFileDialog.getExistingDirectory(self.workspace, "Compare with a session", str(self._folder())))

    def _compare(self, path: str) -> None:
        """Compare with the positions in a file or another session; an empty path names none."""
        if path:
            show = partial(self.workspace.panel(ComparePanel).add_sets, Path(path))
            self._controller.read_positions(Path(path), show)

    def _ask_corrected_layout(self) -> None:
        """Ask for a file, and write the corrected layout to it."""
        scene, found = self.workspace.part.scene, self.guided.modules.found
        layout = scene.skin.layout
        path = self._ask_file("Save the corrected layout", f"{scene.name}-corrected.modules.toml", "Layout (*.toml)")
        if layout is None or found is None or path is None:
            return

        def write() -> None:
            from skincal.files.layout_file import write_layout

            write_layout(layout, found.mend, path)

        self._controller.compute(write, lambda _: self.said.emit(Message(saved_words(path, found.mend))))

    def ask_reference(self) -> None:
        """Ask for a file with known positions of the taxels, and show the error against it."""
        path, _ = QFileDialog.getOpenFileName(
            self.workspace, "Compare with known positions", str(self._folder()), POSITION_FILES
        )
        if path:
            self.compare_with(Path(path))

    def compare_with(self, path: Path) -> None:
        """Show the error against the positions in a file."""
        from skincal.files.reference import load_reference

        part = self.workspace.part
        channels = part.channels.tolist()

        def show(reference: TaxelPositions) -> None:
            self.offer(reference)
            self.workspace.show_tab(ErrorsPanel.title)

        self._controller.compute(lambda: load_reference(path, part.scene.link, channels), show)

    def offer(self, reference: TaxelPositions) -> None:
        """Let panels compare the estimates with known positions."""
        for panel in self.workspace.panels.values():
            panel.add_reference(reference)
        self.follow_again()

    def _folder(self) -> Path:
        """Return the session's folder, which files are proposed for; while it is not saved, that of the documents."""
        # A dialog would take a missing folder for the name of a file.
        folders = (self._controller.folder, self._documents)
        return next((folder for folder in folders if folder is not None and folder.is_dir()), Path.home())

    def _tell_failure(self, sentence: str) -> None:
        self.said.emit(Message(sentence, error=True))

    # Opening and closing

    def restore(self) -> None:
        """Restore the detached tabs, the open tab and the choices of panels."""
        self.workspace.docks.restore_detached(self._settings)
        for panel in self.workspace.panels.values():
            panel.restore(self._settings)
        self.workspace.show_tab(str(self._settings.value("window/tab", "")))
        self.follow_switches()

    def save(self) -> None:
        """Save the arrangement, the open tab and the choices of panels; nothing before the panels were laid out."""
        current = self.workspace.current_panel()
        if current is None:
            return
        self.workspace.docks.save(self._settings)
        for panel in self.workspace.panels.values():
            panel.save(self._settings)
        self._settings.setValue("window/tab", current.title)

    def close(self) -> None:
        """Follow the session no longer, and remove its dialogs and menu entries."""
        for signal, slot in self._followed:
            signal.disconnect(slot)
        self._followed = ()
        self.picking.stop()
        for dialog in (self._history, self._thresholds):
            if dialog is not None:
                dialog.deleteLater()
        self._history = self._thresholds = None
        for action in self._tab_actions:
            action.deleteLater()
        self._tab_actions = []
