"""The main window: on the screen within a moment, then filled with a desk when a session is there.

It imports nothing heavy. What concerns a session is the desk's; here are the menus, the messages, and coming and going.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QByteArray, QSettings, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QFileDialog, QLabel, QMainWindow, QMessageBox, QStackedWidget, QVBoxLayout, QWhatsThis, QWidget

from app.commands import Commands, key_words
from app.controller import Controller
from app.panels.message_bar import Message, MessageBar
from app.panels.texts import ElidedLabel
from app.pedal import Pedals
from app.plan import Plan, dated_folder
from app.running import Running
from app.sound import Player
from app.theme import GAP, Choice, Colours, Theme

if TYPE_CHECKING:
    from app.controller import Picture
    from app.desk import Desk
    from app.heard import Heard
    from app.opening import Part
    from skincal.files.reference import Reference
    from skincal.session.review import Review
    from skincal.session.snapshot import Snapshot

LOG = logging.getLogger(__name__)
FIRST_SIZE = QSize(1440, 860)
"""Pixels, where the screen has them."""


class Window(QMainWindow):
    """Everything the operator sees.

    Parameters
    ----------
    controller : its signals are shown, its slots get the wishes
    theme : colours
    settings : size, splitters, theme
    documents : where sessions and files go unless the operator says otherwise
    player : plays the sounds
    """

    _sound_found = Signal(bool)
    """Told by the player's thread: there is a sound device."""

    def __init__(self, controller: Controller, theme: Theme, settings: QSettings, documents: Path, player: Player) -> None:
        super().__init__()
        self.setWindowTitle("skincal")
        self.controller = controller
        self._theme = theme
        self._settings = settings
        self._documents = documents
        self._player = player
        self.desk: Desk | None = None
        self.messages = MessageBar()
        self.stack = QStackedWidget()
        self.opening = QLabel()
        self.where = ElidedLabel()
        self.commands = Commands(self.menuBar(), self._slots(), self)
        self.pedals = Pedals(self.commands.actions, self.commands.taken, settings, self)
        self._arrange()
        self._connect()
        self._set_colours(theme.colours)

    def _slots(self) -> dict[str, Callable[[], object]]:
        return {
            "new": self.ask_new,
            "open": self.ask_session,
            "keep": self.controller.keep,
            "export": self._of_desk(lambda desk: desk.ask_export(self)),
            "reference": self._of_desk(lambda desk: desk.ask_reference(self)),
            "picture": self._of_desk(lambda desk: desk.ask_picture(self)),
            "quit": self.close,
            "space": self._do_obvious,
            "pause": self.controller.toggle,
            "verdict": self._of_desk(lambda desk: desk.ask_verdict(self)),
            "another": self._of_desk(lambda desk: desk.skip_target()),
            "correct": self._of_desk(lambda desk: desk.correct()),
            "no landmarks": self._of_desk(lambda desk: desk.skip_landmarks()),
            "undo": self._of_desk(lambda desk: desk.undo()),
            "exclude": self._of_desk(lambda desk: desk.exclude_or_restore()),
            "last": self._of_desk(lambda desk: desk.select_last()),
            "dead": self._of_desk(lambda desk: desk.mark_or_revive()),
            "method": self._of_desk(lambda desk: desk.next_method()),
            "difference": self._of_desk(lambda desk: desk.show_difference()),
            "guide": self._of_desk(lambda desk: desk.show_guide()),
            "sounds": self._switch_sounds,
            "speech": self._switch_sounds,
            "turn": self._of_desk(lambda desk: desk.show_turning()),
            "camera": self._of_desk(lambda desk: desk.reset_camera()),
            "none": self._escape,
            "full": self._toggle_full,
            "what": QWhatsThis.enterWhatsThisMode,
            "keys": self._show_keys,
            "pedals": self.ask_pedals,
            "landmark": self._of_desk(lambda desk: desk.ask_landmark(self)),
        }

    def _of_desk(self, do: Callable[[Desk], Any]) -> Callable[[], None]:
        """Return what does something with the desk, if there is one."""

        def slot() -> None:
            if self.desk is not None:
                do(self.desk)

        return slot

    def _arrange(self) -> None:
        self.commands.add_themes(self._theme.choice, self._choose_theme)
        for name, wanted in (("sounds", True), ("speech", False)):
            self.commands.actions[name].setChecked(bool(self._settings.value(f"window/{name}", wanted, type=bool)))
        self.commands.follow_sound(found=True, can_speak=self._player.can_speak)
        self._switch_sounds()
        self.opening.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.opening.setProperty("quiet", True)
        self.stack.addWidget(self.opening)
        self._show_opening()
        centre = QWidget()
        column = QVBoxLayout(centre)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(0)
        column.addWidget(self.messages)
        column.addWidget(self.stack, 1)
        self.setCentralWidget(centre)
        bar = self.statusBar()
        bar.setSizeGripEnabled(False)
        bar.setContentsMargins(GAP, 0, 0, 0)
        bar.addWidget(self.where, 1)
        self.resize(FIRST_SIZE.boundedTo(self.screen().availableSize()))
        geometry = self._settings.value("window/geometry")
        if isinstance(geometry, QByteArray):
            self.restoreGeometry(geometry)

    def _connect(self) -> None:
        controller = self.controller
        controller.part_loaded.connect(self._take_part)
        controller.session_opened.connect(self._take_session)
        controller.ticked.connect(self._take_picture)
        controller.running_changed.connect(self._running_changed)
        controller.said.connect(self.tell)
        controller.truth_found.connect(self._take_truth)
        controller.reviewed.connect(self._take_review)
        controller.stored.connect(self._say_where)
        self._theme.changed.connect(self._set_colours)
        self._sound_found.connect(self._follow_sound)
        self._player.found = self._sound_found.emit

    # What the controller says

    def _take_part(self, part: Part) -> None:
        from app.desk import Desk

        self._drop_desk()
        desk = Desk(part, self.controller, self.commands, self._documents, parent=self)
        self.desk = desk
        desk.said.connect(self.tell)
        desk.heard.connect(self._play)
        desk.unsaid.connect(self.messages.withdraw)
        desk.marking.unsaid.connect(self.messages.withdraw)
        self.setWindowTitle(f"{part.scene.name} \N{EN DASH} skincal")
        # Making the panels, laying them out and showing them each take half of what a window may stand still.
        QTimer.singleShot(0, desk, lambda: self._arrange_desk(desk))

    def _arrange_desk(self, desk: Desk) -> None:
        if desk is self.desk:
            desk.workspace.arrange()
            QTimer.singleShot(0, desk, lambda: self._show_desk(desk))

    def _show_desk(self, desk: Desk) -> None:
        if desk is self.desk:
            desk.restore(self._settings)
            desk.set_colours(self._theme.colours)
            self.statusBar().addPermanentWidget(desk.chips)
            self.stack.addWidget(desk.workspace)
            self.stack.setCurrentWidget(desk.workspace)
            desk.begin()

    def _take_session(self, snapshot: Snapshot) -> None:
        if self.desk is not None:
            self.desk.session_opened(snapshot)
            self._player.get_ready()

    def _take_truth(self, truth: Reference) -> None:
        if self.desk is not None:
            self.desk.offer(truth)

    def _take_review(self, review: Review | None) -> None:
        if self.desk is not None:
            self.desk.take_review(review)

    def _take_picture(self, picture: Picture) -> None:
        if self.desk is not None:
            self.desk.take_picture(picture)

    def _running_changed(self, running: Running) -> None:
        self._show_opening()
        if self.desk is not None:
            if running is Running.OFFLINE and self.desk.frame is None:
                self.desk.workspace.wait("nothing to show", "No device could be opened; Ctrl+N names others.")
            self.desk.show_again()
            self.desk.refresh_allowed()

    def _show_opening(self) -> None:
        opening = self.controller.running is Running.OPENING
        nothing = "Nothing is open.\nCtrl+N begins a new session, Ctrl+O opens a recorded one."
        self.opening.setText("Opening \N{HORIZONTAL ELLIPSIS}" if opening else nothing)

    def _play(self, heard: Heard) -> None:
        self._player.play(heard.sound, heard.word)

    def _follow_sound(self, found: bool) -> None:
        self.commands.follow_sound(found=found, can_speak=self._player.can_speak)

    def _say_where(self, words: str) -> None:
        self.where.setText(words)
        if self.desk is not None:
            self.desk.refresh_allowed()

    def tell(self, message: Message) -> None:
        """Tell the operator something; errors are logged, too."""
        if message.error:
            LOG.warning("%s", message.text)
        self.messages.tell(message)

    def _set_colours(self, colours: Colours) -> None:
        self.messages.set_colours(colours)
        if self.desk is not None:
            self.desk.set_colours(colours)

    def _choose_theme(self, choice: Choice) -> None:
        self._settings.setValue("theme", choice.value)
        self._theme.choose(choice)

    # What the operator wants

    def _do_obvious(self) -> None:
        if self.desk is not None and self.desk.ends:
            self.desk.ask_verdict(self)
        else:
            self.controller.toggle()

    def _escape(self) -> None:
        if self.desk is not None and self.desk.marking.waiting:
            self.desk.marking.stop()
        elif self.messages.isVisible():
            self.messages.dismiss()
        elif self.desk is not None:
            self.desk.select_nothing()

    def _switch_sounds(self) -> None:
        """Play sounds, and say words, as the menu has it."""
        player, actions = self._player, self.commands.actions
        player.on, player.speaks = actions["sounds"].isChecked(), actions["speech"].isChecked()
        if self.desk is not None:
            player.get_ready()

    def _toggle_full(self) -> None:
        self.setWindowState(self.windowState() ^ Qt.WindowState.WindowFullScreen)

    def _show_keys(self) -> None:
        box = QMessageBox(QMessageBox.Icon.NoIcon, "Keys", key_words(), QMessageBox.StandardButton.Close, self)
        box.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        box.button(QMessageBox.StandardButton.Close).setFocus()
        box.open()

    def ask_new(self) -> None:
        """Ask for a new session and open it."""
        from app.dialogs.new_session import NewSessionDialog

        scene = None if self.desk is None else self.desk.workspace.part.scene.path
        folder = dated_folder(self._documents, datetime.now().astimezone())
        dialog = NewSessionDialog(scene, folder, self)
        dialog.plan_chosen.connect(self.open)
        dialog.open()

    def ask_pedals(self) -> None:
        """Learn the keys of foot pedals."""
        from app.dialogs.pedals import PedalsDialog

        PedalsDialog(self.pedals, self).open()

    def ask_session(self) -> None:
        """Ask for a recorded session and open it."""
        folder = QFileDialog.getExistingDirectory(self, "Folder of a recorded session", str(self._documents))
        if folder:
            self.open(Plan(session=Path(folder)))

    def open(self, plan: Plan) -> None:
        """Open something in place of what is open."""
        self._drop_desk()
        self.where.setText("")
        self.controller.open(plan)

    # Coming and going

    def _drop_desk(self) -> None:
        desk, self.desk = self.desk, None
        if desk is not None:
            desk.save(self._settings)
            desk.close()
            self.stack.removeWidget(desk.workspace)
            self.statusBar().removeWidget(desk.chips)
            for gone in (desk.workspace, desk.chips, desk):
                gone.deleteLater()

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask nothing: everything that was recorded is on the disk. Stop the timers, close the 3D view, then the journal."""
        self._settings.setValue("window/geometry", self.saveGeometry())
        self._settings.setValue("window/sounds", self._player.on)
        self._settings.setValue("window/speech", self._player.speaks)
        self.hide()
        self.pedals.stop()
        self.messages.stop()
        self.controller.stop()
        if self.desk is not None:
            self.desk.save(self._settings)
            self.desk.close()
        self.controller.close()
        self._player.close()
        super().closeEvent(event)
