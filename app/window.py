"""The main window: on the screen within a moment, then filled with a session view when a session is there.

It imports nothing heavy. Here are the menus, the messages, and opening and closing; what concerns a session is in the session
view.
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
from app.dialogs.pedals import Pedals
from app.panels.message_bar import MessageBar
from app.panels.widgets import ElidedLabel
from app.session.controller import Controller
from app.session.opening import OpenRequest, dated_folder
from app.sound.player import Player
from app.state.running import Running
from app.text.message import Message
from app.theme import GAP, Choice, Colours, Theme

if TYPE_CHECKING:
    from app.session.controller import Tick
    from app.session_view import SessionView
    from app.sound.cues import DueCue
    from skincal.files.reference import Reference
    from skincal.session.part import Part
    from skincal.session.review import Review
    from skincal.session.snapshot import Snapshot

LOG = logging.getLogger(__name__)
FIRST_SIZE = QSize(1440, 860)
"""Pixels, where the screen has them."""


class Window(QMainWindow):
    """Everything the operator sees.

    Parameters
    ----------
    controller : its signals are shown, its slots do what the operator wants
    theme : colours
    settings : size, splitters, theme
    documents : where sessions and files go unless the operator says otherwise
    player : plays the sounds
    """

    _sound_found = Signal(bool)
    """From the player's thread: whether there is a sound device."""

    def __init__(self, controller: Controller, theme: Theme, settings: QSettings, documents: Path, player: Player) -> None:
        super().__init__()
        self.setWindowTitle("skincal")
        self.controller = controller
        self._theme = theme
        self._settings = settings
        self._documents = documents
        self._player = player
        self.session_view: SessionView | None = None
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
            "export": self._of_session(lambda view: view.ask_export(self)),
            "reference": self._of_session(lambda view: view.ask_reference(self)),
            "picture": self._of_session(lambda view: view.ask_picture(self)),
            "quit": self.close,
            "space": self._do_obvious,
            "pause": self.controller.toggle,
            "verdict": self._of_session(lambda view: view.ask_verdict(self)),
            "another": self._of_session(lambda view: view.skip_target()),
            "correct": self._of_session(lambda view: view.correct()),
            "no landmarks": self._of_session(lambda view: view.skip_landmarks()),
            "undo": self._of_session(lambda view: view.undo()),
            "exclude": self._of_session(lambda view: view.exclude_or_restore()),
            "last": self._of_session(lambda view: view.select_last()),
            "dead": self._of_session(lambda view: view.mark_or_revive()),
            "method": self._of_session(lambda view: view.next_method()),
            "difference": self._of_session(lambda view: view.show_difference()),
            "guide": self._of_session(lambda view: view.show_guide()),
            "sounds": self._switch_sounds,
            "speech": self._switch_sounds,
            "turn": self._of_session(lambda view: view.show_turning()),
            "camera": self._of_session(lambda view: view.workspace.view.reset_camera()),
            "none": self._escape,
            "full": self._toggle_full,
            "what": QWhatsThis.enterWhatsThisMode,
            "keys": self._show_keys,
            "pedals": self.ask_pedals,
            "landmark": self._of_session(lambda view: view.ask_landmark(self)),
        }

    def _of_session(self, do: Callable[[SessionView], Any]) -> Callable[[], None]:
        """Return what does something with the session view, if there is one."""

        def slot() -> None:
            if self.session_view is not None:
                do(self.session_view)

        return slot

    def _arrange(self) -> None:
        self.commands.add_themes(self._theme.choice, self._choose_theme)
        for name, wanted in (("sounds", True), ("speech", False)):
            self.commands.actions[name].setChecked(bool(self._settings.value(f"window/{name}", wanted, type=bool)))
        self._follow_sound(True)
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
        controller.prepare = _prepare
        controller.part_loaded.connect(self._take_part)
        controller.session_opened.connect(self._take_session)
        controller.ticked.connect(self._take_tick)
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
        from app.session_view import SessionView

        self._drop_session()
        session_view = SessionView(part, self.controller, self.commands, self._documents, parent=self)
        self.session_view = session_view
        session_view.said.connect(self.tell)
        session_view.heard.connect(self._play)
        session_view.unsaid.connect(self.messages.withdraw)
        session_view.picking.unsaid.connect(self.messages.withdraw)
        self.setWindowTitle(f"{part.scene.name} \N{EN DASH} skincal")
        # Making the panels, laying them out and showing them each take half of what a window may stand still.
        QTimer.singleShot(0, session_view, lambda: self._arrange_session(session_view))

    def _arrange_session(self, session_view: SessionView) -> None:
        if session_view is self.session_view:
            session_view.workspace.arrange()
            QTimer.singleShot(0, session_view, lambda: self._show_session(session_view))

    def _show_session(self, session_view: SessionView) -> None:
        if session_view is self.session_view:
            session_view.restore(self._settings)
            session_view.set_colours(self._theme.colours)
            self.statusBar().addPermanentWidget(session_view.chips)
            self.stack.addWidget(session_view.workspace)
            self.stack.setCurrentWidget(session_view.workspace)
            session_view.begin()

    def _take_session(self, snapshot: Snapshot) -> None:
        if self.session_view is not None:
            self.session_view.session_opened(snapshot)
            self._player.get_ready()

    def _take_truth(self, truth: Reference) -> None:
        if self.session_view is not None:
            self.session_view.offer(truth)

    def _take_review(self, review: Review | None) -> None:
        if self.session_view is not None:
            self.session_view.take_review(review)

    def _take_tick(self, tick: Tick) -> None:
        if self.session_view is not None:
            self.session_view.take_tick(tick)

    def _running_changed(self, running: Running) -> None:
        self._show_opening()
        if self.session_view is not None:
            if running is Running.OFFLINE and self.session_view.state is None:
                self.session_view.workspace.wait("nothing to show", "No device could be opened; Ctrl+N names others.")
            self.session_view.follow_again()

    def _show_opening(self) -> None:
        opening = self.controller.running is Running.OPENING
        nothing = "Nothing is open.\nCtrl+N begins a new session, Ctrl+O opens a recorded one."
        self.opening.setText("Opening \N{HORIZONTAL ELLIPSIS}" if opening else nothing)

    def _play(self, heard: DueCue) -> None:
        self._player.play(heard.sound, heard.word)

    def _follow_sound(self, found: bool) -> None:
        self.commands.follow_sound(found=found, can_speak=self._player.can_speak)

    def _say_where(self, words: str) -> None:
        self.where.setText(words)
        if self.session_view is not None:
            self.session_view.refresh_allowed()

    def tell(self, message: Message) -> None:
        """Tell the operator something; errors are logged, too."""
        if message.error:
            LOG.warning("%s", message.text)
        self.messages.tell(message)

    def _set_colours(self, colours: Colours) -> None:
        self.messages.set_colours(colours)
        if self.session_view is not None:
            self.session_view.set_colours(colours)

    def _choose_theme(self, choice: Choice) -> None:
        self._settings.setValue("theme", choice.value)
        self._theme.choose(choice)

    # What the operator wants

    def _do_obvious(self) -> None:
        if self.session_view is not None and self.session_view.ends:
            self.session_view.ask_verdict(self)
        else:
            self.controller.toggle()

    def _escape(self) -> None:
        if self.session_view is not None and self.session_view.picking.waiting:
            self.session_view.picking.stop()
        elif self.messages.isVisible():
            self.messages.dismiss()
        elif self.session_view is not None:
            self.session_view.select_taxel(None)

    def _switch_sounds(self) -> None:
        """Play sounds, and say words, as the menu has it."""
        player, actions = self._player, self.commands.actions
        player.on, player.speaks = actions["sounds"].isChecked(), actions["speech"].isChecked()
        if self.session_view is not None:
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

        scene = None if self.session_view is None else self.session_view.workspace.part.scene.path
        folder = dated_folder(self._documents, datetime.now().astimezone())
        dialog = NewSessionDialog(scene, folder, self)
        dialog.request_chosen.connect(self.open)
        dialog.open()

    def ask_pedals(self) -> None:
        """Learn the keys of foot pedals."""
        from app.dialogs.pedals import PedalsDialog

        PedalsDialog(self.pedals, self).open()

    def ask_session(self) -> None:
        """Ask for a recorded session and open it."""
        folder = QFileDialog.getExistingDirectory(self, "Folder of a recorded session", str(self._documents))
        if folder:
            self.open(OpenRequest(session=Path(folder)))

    def open(self, request: OpenRequest) -> None:
        """Open something in place of what is open."""
        self._drop_session()
        self.where.setText("")
        self.controller.open(request)

    # Coming and going

    def _drop_session(self) -> None:
        session_view, self.session_view = self.session_view, None
        if session_view is not None:
            session_view.save(self._settings)
            session_view.close()
            self.stack.removeWidget(session_view.workspace)
            self.statusBar().removeWidget(session_view.chips)
            for gone in (session_view.workspace, session_view.chips, session_view):
                gone.deleteLater()

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask nothing: everything that was recorded is on the disk. Stop the timers, close the 3D view, then the journal."""
        self._settings.setValue("window/geometry", self.saveGeometry())
        self._settings.setValue("window/sounds", self._player.on)
        self._settings.setValue("window/speech", self._player.speaks)
        # Hidden first: closing may take as long as a read, and a window that stands still looks broken.
        self.hide()
        self.pedals.stop()
        self.messages.stop()
        self.controller.stop()
        if self.session_view is not None:
            self.session_view.save(self._settings)
            self.session_view.close()
        self.controller.close()
        self._player.close()
        super().closeEvent(event)


def _prepare() -> None:
    """Import what shows a session: numpy and all that stands on it comes with it."""
    import app.session_view  # noqa: F401
