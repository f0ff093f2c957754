"""One open session as the operator works on it: panels, selection, method, and the wishes that concern a session.

It is imported beside the window, after the window is on the screen: numpy and all that stands on it comes with it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QByteArray, QObject, QSettings, QTimer, Signal
from PySide6.QtGui import QAction
from PySide6.QtWidgets import QFileDialog, QSplitter, QWidget

from app.board_watch import BoardWatch
from app.commands import Commands
from app.controller import Controller, Picture
from app.dialogs.export import ExportDialog
from app.dialogs.verdict import VerdictDialog
from app.error_tracker import ErrorTracker
from app.frame import Frame, same_results
from app.guiding import Guiding
from app.heard import Ear, heard
from app.layout_saving import ask_layout
from app.marking import Marking
from app.opening import Part
from app.panels.devices import LinkChips
from app.panels.message_bar import Message
from app.policies import Allowed, allowed, link_lines
from app.rigging import Rigging
from app.scene3d.view import View3D
from app.short_way import ShortWay
from app.theme import Colours
from app.verdict_words import rig_state
from app.wishes import wish_of
from app.workspace import Workspace
from skincal.files.calibration import landmark_check
from skincal.model.errors import InputError
from skincal.sentences import correction_sentence
from skincal.session.actions import Action, AtLandmark, Exclude, MarkDead, Restore, Revive, SetPose, Uncorrect, Undo
from skincal.session.corrections import used_of
from skincal.session.review import Review
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from skincal.files.reference import Reference
    from skincal.modules.health import LayoutMend

LATE_S = 0.3
"""s. What happened longer ago is not heard any more: by now the hand does something else."""


class Desk(QObject):
    """What exists as long as a session is open.

    Parameters
    ----------
    part : what is calibrated
    controller : gets the wishes
    commands : are enabled by what may be done
    documents : where files go unless the operator says otherwise
    make_view : the 3D view
    """

    said = Signal(object)
    """`Message`."""
    unsaid = Signal(object)
    """`Message`: it holds no more."""
    heard = Signal(object)
    """`Heard`: a sound that is due."""

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
        self._picture: Picture | None = None
        self._revision = 0
        self._clock_offset = time.time() - time.monotonic()
        self._allowed: Allowed | None = None
        self._ear = Ear()
        self._rigging = Rigging()
        self.frame: Frame | None = None
        self.selected: int | None = None
        self.workspace = Workspace(part, make_view)
        self.method = self.workspace.methods[0]
        self.chips = LinkChips()
        self.tracker = ErrorTracker(part, controller.compute)
        self.guiding = Guiding(part)
        self._short_way = ShortWay(self.guiding.plan)
        self._short_said: Message | None = None
        self.marking = Marking(self.workspace.view, self._landmark_names, controller.act, part.scene.link, self)
        self.workspace.error_course.begin(self.tracker)
        self.workspace.compare.begin(BoardWatch(part, controller.compute))
        self._tab_actions: list[QAction] = commands.add_tabs(self.workspace.titles(), self.workspace.tabs.setCurrentIndex)
        self._connect()
        self.workspace.wait("opening", part.scene.name)
        self.set_addresses()

    def _connect(self) -> None:
        workspace = self.workspace
        workspace.taxel_selected.connect(self.select_taxel)
        workspace.method_chosen.connect(self.show_method)
        workspace.inspect.poke_wanted.connect(self.select_poke)
        workspace.compare.layout_wanted.connect(self.ask_layout)
        workspace.pokes.selection_changed.connect(self.refresh_allowed)
        for panel in (workspace.map, workspace.inspect):
            panel.mark_dead_requested.connect(lambda channel: self._controller.act(MarkDead(channel)))
            panel.revive_requested.connect(lambda channel: self._controller.act(Revive(channel)))
        self.marking.said.connect(self.said)
        workspace.pokes.actions_offered = [self._commands.actions[name] for name in ("exclude", "undo")]
        workspace.rig.correct_requested.connect(self._controller.act)
        workspace.rig.uncorrect_requested.connect(lambda of: self._controller.act(Uncorrect(of)))
        if workspace.rig.arm is not None:
            workspace.rig.arm.pose_requested.connect(lambda name: self._controller.act(SetPose(name)))

    def begin(self) -> None:
        """Start to build the 3D view, once the panels are on the screen."""
        QTimer.singleShot(0, self.workspace, self.workspace.begin)

    def set_addresses(self) -> None:
        """Show where the links of the session go."""
        self.workspace.devices.set_addresses({link.name: link.address for link in self._controller.links})

    def session_opened(self, snapshot: Snapshot) -> None:
        """Start with a session whose pokes are known already."""
        self.set_addresses()
        self._ear = Ear.of(snapshot)
        self.guiding.landmarks.begin(snapshot)
        self.workspace.session_opened(snapshot)

    # What is shown

    def take_picture(self, picture: Picture) -> None:
        """Show what a tick found."""
        at_landmark = self.guiding.landmarks.poked(picture.snapshot)
        if [one for one in at_landmark if self._controller.act(one)]:
            return  # that showed a newer picture already
        before = self.frame
        if before is None or not same_results(before.snapshot, picture.snapshot):
            self._revision += 1
        self._picture = picture
        # What is shown is seen now, though readings may wait.
        seen_s = picture.now_ns * 1e-9 + picture.behind_s
        guidance = self.guiding.follow(picture.snapshot, self._revision, self.method, picture.evidence, seen_s)
        self.frame = Frame(
            snapshot=picture.snapshot,
            live=picture.live,
            scene=self.workspace.part.scene,
            names=self.workspace.names,
            method=self.method,
            selected=self.selected,
            running=self._controller.running,
            now_ns=picture.now_ns,
            revision=self._revision,
            links=link_lines(picture.live.links, picture.now_ns, self._clock_offset, self._controller.running),
            guidance=guidance,
            sky=lambda channel: self.guiding.sky(channel, picture.evidence),
            coaching=self.guiding.coach(picture.live.progress),
            review=self._rigging.shown(picture.snapshot),
            offers=self._rigging.offers(picture.snapshot),
            unsolved=picture.unsolved,
            eye=self.workspace.view.eye(),
        )
        self._hear(self.frame, picture.behind_s)
        self._tell_short_way(self.frame)
        self._controller.ask(wish_of(self.frame.guidance, self.frame.running))
        self.workspace.show_frame(self.frame)
        self.chips.show_frame(self.frame)
        self.chips.show_behind(picture.behind_s)
        if before is None or _allows_other(before, self.frame):
            self.refresh_allowed()

    def take_review(self, review: Review | None) -> None:
        """Show what landmark pokes tell of the rig, and say once what could be put right; None where nobody tells any more."""
        self._rigging.review = review
        self.show_again()
        news = "" if self._picture is None else self._rigging.news(self._picture.snapshot)
        if news:
            self.said.emit(Message(news, found=True))
        self.refresh_allowed()

    def _tell_short_way(self, frame: Frame) -> None:
        """Say that the modules method needs no more, until it is shown: who pokes does not look at messages that pass."""
        news = self._short_way.news(frame)
        if news:
            self._short_said = Message(news, asks=True)
            self.said.emit(self._short_said)
        elif self._short_said is not None and frame.method is Method.MODULES:
            self.unsaid.emit(self._short_said)
            self._short_said = None

    def correct(self) -> None:
        """Use the correction that is offered."""
        if self.frame is not None and self.frame.offers:
            offer = self.frame.offers[0]
            if self._controller.act(offer.action):
                back = "Backspace takes it back until the next poke, the Rig tab at any time."
                self.said.emit(Message(f"{correction_sentence(used_of(offer.action))} {back}"))

    def _hear(self, frame: Frame, behind_s: float) -> None:
        """Ask for the sound that is due, before anything is drawn: an ear notices less delay than an eye."""
        due, self._ear = heard(self._ear, frame)
        if due is not None and behind_s <= LATE_S:
            self.heard.emit(due)

    def show_again(self) -> None:
        """Show the same moment again, after the selection, the method or the colours changed."""
        if self._picture is not None:
            self.take_picture(self._picture)

    def show_guide(self) -> None:
        """Say and show what to poke next, or do not."""
        self.guiding.wanted = self._commands.actions["guide"].isChecked()
        self.show_again()

    def show_turning(self) -> None:
        """Turn the camera to the target between pokes, or do not."""
        self.workspace.view.set_turning(self._commands.actions["turn"].isChecked())

    def skip_target(self) -> None:
        """Ask for another target."""
        self.guiding.skip()
        self.show_again()

    def skip_landmarks(self) -> None:
        """Ask for no landmarks in this arm pose."""
        self.guiding.landmarks.skip(all_of_pose=True)
        self.show_again()

    def refresh_allowed(self) -> None:
        """Enable what may be done now."""
        if self.frame is None:
            return
        frame, pokes = self.frame, self.workspace.pokes.selected()
        running = self._controller.running
        links, taxel = frame.live.links, self.selected
        self._allowed = allowed(frame.snapshot, frame.scene, links, running, pokes, taxel, frame.guidance, frame.offers)
        self._commands.follow(self._allowed, can_keep=self._controller.can_keep)

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self.chips.set_colours(colours)
        self.workspace.set_colours(colours)
        self.show_again()

    def show_method(self, method: Method) -> None:
        """Show another method's estimates."""
        self.method = method
        self.show_again()

    def next_method(self) -> None:
        """Show the next method's estimates."""
        methods = self.workspace.methods
        self.show_method(methods[(methods.index(self.method) + 1) % len(methods)])

    def show_difference(self) -> None:
        """Join the estimates of both methods by lines, or do not."""
        self.workspace.view.set_difference(self._commands.actions["difference"].isChecked())

    def select_taxel(self, channel: int | None) -> None:
        """Select a taxel in every view, or none."""
        if channel != self.selected:
            self.selected = channel
            self.show_again()
            self.refresh_allowed()

    def select_nothing(self) -> None:
        """Select no taxel."""
        self.select_taxel(None)

    def select_last(self) -> None:
        """Show the newest poke in the list."""
        if self.frame is not None and self.frame.snapshot.pokes:
            self.select_poke(self.frame.snapshot.pokes[-1].outcome.poke)

    def select_poke(self, poke: int) -> None:
        """Show a poke in the list."""
        # Opened first: a list that nobody sees does not know the newest pokes.
        self.workspace.tabs.setCurrentWidget(self.workspace.pokes)
        self.workspace.pokes.select(poke)

    def reset_camera(self) -> None:
        """Bring the whole part into the 3D view."""
        self.workspace.view.reset_camera()

    # What the operator wants

    def undo(self) -> None:
        """Take back the last poke or action."""
        self._controller.act(Undo())

    def exclude_or_restore(self) -> None:
        """Take the selected pokes out, or in again where all of them are out."""
        may = self._allowed
        if may is not None:
            out: list[Action] = [*(AtLandmark(poke, "") for poke in may.unname), *(Exclude(poke) for poke in may.exclude)]
            self._controller.act_all(out or [Restore(poke) for poke in may.restore])
            self.refresh_allowed()

    def mark_or_revive(self) -> None:
        """Leave the selected taxel out, or use it again."""
        if self.selected is not None and self._allowed is not None:
            self._controller.act(Revive(self.selected) if self._allowed.revive else MarkDead(self.selected))
            self.refresh_allowed()

    def ask_landmark(self, parent: QWidget) -> None:
        """Ask for a known point of the part and for its name."""
        if self.frame is not None:
            self.marking.ask(parent)

    def _landmark_names(self) -> set[str]:
        return set() if self.frame is None else {one.name for one in self.frame.snapshot.landmarks}

    @property
    def ends(self) -> bool:
        """Whether it is enough, so that the next thing to do is to look at the verdict."""
        return self._allowed is not None and self._allowed.ends

    def ask_verdict(self, parent: QWidget) -> None:
        """Show what the session has come to, and lead on to the file."""
        if self.frame is None or self._picture is None or self.frame.guidance is None:
            return
        verdict = self.guiding.verdict(self.frame.guidance, self.frame.snapshot, self._picture.evidence)
        can_export = self._allowed is not None and self._allowed.export
        offers, snapshot = self.frame.offers, self.frame.snapshot
        rig = rig_state(offers, snapshot.corrections.values(), self.frame.review)
        names = self.workspace.names
        dialog = VerdictDialog(verdict, names, parent, rig=rig, can_export=can_export, settled=not offers)
        dialog.taxel_wanted.connect(self.select_taxel)
        dialog.export_wanted.connect(lambda: self.ask_export(parent))
        dialog.open()

    def ask_export(self, parent: QWidget) -> None:
        """Ask what to write, write it and show what was found."""
        stem = self._documents / self.workspace.part.scene.name
        dialog = ExportDialog(self.workspace.methods, self.method, stem, parent)

        def write(format_: str, path: Path, method: Method) -> None:
            review = None if self.frame is None else self.frame.review
            check = None if review is None else landmark_check(review.rig)
            self._controller.export(format_, path, method, check, dialog.show_findings, dialog.show_failure)

        dialog.write_requested.connect(write)
        dialog.open()

    def ask_reference(self, parent: QWidget) -> None:
        """Ask for a file with known places of the taxels, and show the error against it."""
        kinds = "Known places (*.json *.txt *.ini);;All files (*)"
        # A folder that is not there yet would stand in the dialog as a file's name.
        folder = self._documents if self._documents.is_dir() else Path.home()
        path, _ = QFileDialog.getOpenFileName(parent, "Compare with known places", str(folder), kinds)
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
            lambda sentence: self.said.emit(Message(sentence, error=True)),
        )

    def ask_layout(self, mend: LayoutMend) -> None:
        """Ask for a file and save the corrected layout there."""
        ask_layout(self.workspace, self._documents, self.workspace.part.scene, mend, self._controller.compute, self.said.emit)

    def offer(self, reference: Reference) -> None:
        """Compare estimates with it, where the panel of errors is open."""
        self.tracker.offer(reference)
        self.workspace.error_course.show_sources()
        self.show_again()

    def _take_reference(self, reference: Reference) -> None:
        self.offer(reference)
        self.workspace.tabs.setCurrentWidget(self.workspace.error_course)
        self.show_again()

    def ask_picture(self, parent: QWidget) -> None:
        """Ask for a file and write the 3D view to it."""
        path, _ = QFileDialog.getSaveFileName(
            parent, "Save 3D picture", str(self._documents / "skincal.png"), "Picture (*.png)"
        )
        if not path:
            return
        try:
            self.workspace.view.screenshot(Path(path))
        except InputError as error:
            self.said.emit(Message(str(error), error=True))

    # Coming and going

    def _splitters(self) -> dict[str, QSplitter]:
        return {"window/across": self.workspace.across, "window/right": self.workspace.right}

    def restore(self, settings: QSettings) -> None:
        """Put the splitters where they were, and open the tab that was."""
        for name, splitter in self._splitters().items():
            state = settings.value(name)
            if isinstance(state, QByteArray):
                splitter.restoreState(state)
        self.guiding.wanted = bool(settings.value("window/guide", True, type=bool))
        self._commands.actions["guide"].setChecked(self.guiding.wanted)
        self._commands.actions["turn"].setChecked(bool(settings.value("window/turn", True, type=bool)))
        self.show_turning()
        self.workspace.error_course.restore(settings)
        self.workspace.show_tab(str(settings.value("window/tab", "")))

    def save(self, settings: QSettings) -> None:
        """Remember where the splitters are, and which tab is open; nothing of panels that were not laid out yet."""
        if not self.workspace.tabs.count():
            return
        for name, splitter in self._splitters().items():
            settings.setValue(name, splitter.saveState())
        self.workspace.error_course.save(settings)
        settings.setValue("window/guide", self.guiding.wanted)
        settings.setValue("window/turn", self._commands.actions["turn"].isChecked())
        settings.setValue("window/tab", self.workspace.tabs.tabText(self.workspace.tabs.currentIndex()))

    def close(self) -> None:
        """Give the 3D view's resources back, and take out of the window what belongs to this session."""
        self.marking.stop()
        for action in self._tab_actions:
            action.deleteLater()
        self._tab_actions = []
        self.workspace.close_all()


def _allows_other(before: Frame, now: Frame) -> bool:
    """Return whether other things may be done in a frame than in the one before."""
    return (
        before.revision != now.revision
        or before.guidance is not now.guidance
        or [one.text for one in before.offers] != [one.text for one in now.offers]
        or before.snapshot.can_undo != now.snapshot.can_undo
    )
