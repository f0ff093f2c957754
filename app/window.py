"""The main window in its theme: on the screen within a moment, then filled with a session view when a session is there.

It imports nothing heavy. Here are the menus, the messages, and opening and closing; what concerns a session is in the session
view.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Concatenate, ParamSpec

from PySide6.QtCore import QByteArray, QObject, QSettings, QSize, Qt, QTimer, Signal, Slot, qVersion
from PySide6.QtGui import QCloseEvent, QColor, QPalette
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QFileDialog,
    QLabel,
    QMainWindow,
    QMessageBox,
    QStackedWidget,
    QVBoxLayout,
    QWhatsThis,
    QWidget,
)

from app.commands import LAYERS, Commands
from app.dialogs.pedals import Pedals
from app.panels.documents_menu import DocumentsMenu
from app.panels.drop_target import DropTarget
from app.panels.first_minute import FirstMinute
from app.panels.message_bar import MessageBar
from app.panels.recent_menu import RecentMenu, kept_texts
from app.panels.widgets import ElidedLabel, mix
from app.session.controller import PACES, Controller
from app.session.opening import OpenRequest, dated_folder, find_scene
from app.sound.player import Player
from app.state.running import Running
from app.text.demo_text import pace_words
from app.text.help_text import about_words
from app.text.message import NO_ADDRESSES, Message, connect_words, keep_question, look_words
from app.text_size import STEPS, TextSize
from app.theme import DARK, GAP, LIGHT, Choice, Colours

if TYPE_CHECKING:
    from app.dialogs.import_dialog import ImportDialog
    from app.session.opening import Addresses
    from app.session_view import SessionView
    from skincal.session.importing import Imported
    from skincal.session.part import Part
    from skincal.session.snapshot import Snapshot

LOG = logging.getLogger(__name__)
Said = ParamSpec("Said")
ADDRESSES_KEPT = 50
"""Addresses that the operator named or agreed to: more than one has devices."""
IMPORTED_ON = "import/scene"
"""Setting: the scene of the last import."""
FIELDS = ("QLineEdit", "QComboBox", "QAbstractSpinBox")
"""Classes of what is typed into or chosen from."""
FUSION_DARKER = 140
"""Percent: by so much Fusion makes a border darker than the window, which is seen on a light one alone."""
FIRST_SIZE = QSize(1440, 860)
"""Pixels, where the screen has them."""


def qpalette(colours: Colours) -> QPalette:
    """Return the Qt palette of a theme; the desktop's own is never used, so the window looks alike everywhere."""
    role = QPalette.ColorRole
    palette = QPalette()
    for names, value in (
        ((role.Window, role.AlternateBase, role.ToolTipBase), colours.window),
        ((role.Base,), colours.panel),
        ((role.Button, role.Light, role.Midlight), colours.raised),
        ((role.Mid, role.Dark, role.Shadow), colours.line),
        ((role.WindowText, role.Text, role.ButtonText, role.ToolTipText, role.BrightText), colours.text),
        ((role.PlaceholderText,), colours.muted),
        ((role.Highlight, role.Link, role.LinkVisited, role.Accent), colours.accent),
        ((role.HighlightedText,), colours.on_accent),
    ):
        for name in names:
            palette.setColor(name, QColor(value))
    # After the others, which Qt sets for every group alike.
    for name in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(QPalette.ColorGroup.Disabled, name, mix(colours.muted, colours.window, 0.45))
    return palette


def field_palette(colours: Colours) -> QPalette:
    """Return the palette of fields: that of the window, but for the colour of which Fusion makes borders."""
    palette = qpalette(colours)
    palette.setColor(QPalette.ColorRole.Window, QColor(colours.edge).lighter(FUSION_DARKER))
    return palette


def style_sheet(colours: Colours) -> str:
    """Return the few rules that a palette cannot say: flat tabs, quiet headers, thin splitters."""
    return f"""
    QToolTip {{ color: {colours.text}; background: {colours.raised}; border: 1px solid {colours.line}; padding: 4px; }}
    QMenuBar {{ background: {colours.window}; border-bottom: 1px solid {colours.line}; }}
    QMenuBar::item {{ padding: 5px 10px; background: transparent; }}
    QMenuBar::item:selected {{ background: {colours.raised}; }}
    QStatusBar {{ border-top: 1px solid {colours.line}; }}
    QStatusBar::item {{ border: none; }}
    QSplitter::handle {{ background: {colours.window}; }}
    QTabWidget::pane {{ border: none; border-top: 1px solid {colours.line}; background: {colours.panel}; }}
    QTabBar::tab {{ padding: 6px 10px; border: none; color: {colours.muted}; background: transparent; }}
    QTabBar::tab:selected {{ color: {colours.text}; border-bottom: 2px solid {colours.accent}; }}
    QTabBar::tab:hover {{ color: {colours.text}; }}
    QTabBar::tab:selected:focus {{ border: 1px solid {colours.accent}; border-bottom-width: 2px; padding: 5px 9px 6px 9px; }}
    QTabBar {{ outline: none; }}
    QScrollArea {{ border: 1px solid {colours.panel}; }}
    QScrollArea:focus {{ border: 1px solid {colours.accent}; }}
    QHeaderView::section {{ color: {colours.muted}; background: {colours.panel}; border: none; padding: 4px 6px;
        border-bottom: 1px solid {colours.line}; }}
    QTableView {{ border: none; background: {colours.panel}; gridline-color: {colours.raised};
        selection-background-color: {colours.accent}; selection-color: {colours.on_accent}; }}
    QToolButton[choice="true"] {{ padding: 2px 8px; border: 1px solid {colours.line}; border-radius: 3px; }}
    QToolButton[choice="true"]:checked {{ color: {colours.on_accent}; background: {colours.accent}; }}
    QFrame#card {{ background: {colours.panel}; border: 1px solid {colours.line}; border-radius: 6px; }}
    QLabel[quiet="true"] {{ color: {colours.muted}; }}
    /* Labels quote files and devices, and Qt would open what a text that looks like HTML names. */
    QLabel {{ qproperty-textFormat: PlainText; }}
    QLabel[rich="true"] {{ qproperty-textFormat: RichText; }}
    """


class Theme(QObject):
    """Which colours hold now: the operator's choice, or the desktop's where the choice is left to it.

    The application's palette keeps them; see `theme_colours`.
    """

    changed = Signal()
    """After they were applied to the application."""

    def __init__(self, choice: Choice = Choice.SYSTEM, parent: QObject | None = None) -> None:
        super().__init__(parent)
        QApplication.styleHints().colorSchemeChanged.connect(self._system_changed)
        self.choose(choice)

    def choose(self, choice: Choice) -> None:
        """Take the operator's choice, and give the whole application the colours that hold; light where nobody says which."""
        self.choice = choice
        is_dark = choice is Choice.DARK
        if choice is Choice.SYSTEM:
            is_dark = QApplication.styleHints().colorScheme() is Qt.ColorScheme.Dark
        colours = DARK if is_dark else LIGHT
        # The style that follows a palette on every system; the desktops' own keep their colours.
        QApplication.setStyle("Fusion")
        QApplication.setPalette(qpalette(colours))
        for kind in FIELDS:
            # PySide6 takes a str, where its types say bytes.
            QApplication.setPalette(field_palette(colours), kind)  # pyright: ignore[reportArgumentType]
        app = QApplication.instance()
        if isinstance(app, QApplication):
            app.setStyleSheet(style_sheet(colours))
        self.changed.emit()

    def _system_changed(self) -> None:
        if self.choice is Choice.SYSTEM:
            self.choose(self.choice)


class Window(QMainWindow):
    """Everything the operator sees."""

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
        self.text_size = TextSize(settings, self)
        self.session_view: SessionView | None = None
        self._told: FirstMinute | None = None
        self._question: QMessageBox | None = None
        """Whether to keep a session that would be deleted, while it is open."""
        self._targets = ""
        """Address that asks a robot for pokes, in every session with devices; empty before it was given."""
        self._leaves = False
        self._import: ImportDialog | None = None
        self.messages = MessageBar()
        self.stack = QStackedWidget()
        self.opening = QLabel()
        self.where = ElidedLabel()
        self.commands = Commands(self.menuBar(), self._slots(), self)
        self.recent = RecentMenu(settings, self)
        self.documents = DocumentsMenu(self)
        self.pedals = Pedals(self.commands.actions, self.commands.taken, settings, self)
        self._arrange()
        self._connect()

    def _slots(self) -> dict[str, Callable[[], object]]:
        return {
            "new": self.ask_new,
            "open": self.ask_session,
            "import": self.ask_import,
            "addresses": self.ask_addresses,
            "keep": self.controller.keep,
            "export": self._of_session(lambda view: view.ask_export(self)),
            "apply": self._of_session(lambda view: view.ask_apply(self, self._settings)),
            "report": self._of_session(lambda view: view.ask_report(self)),
            "reference": self._of_session(lambda view: view.ask_reference(self)),
            "picture": self._of_session(lambda view: view.ask_picture(self)),
            "pace": self._change_pace,
            "quit": self.close,
            "space": self._do_obvious,
            "pause": self.controller.toggle,
            "verdict": self._of_session(lambda view: view.ask_verdict(self)),
            "another": self._of_session(lambda view: view.skip_target()),
            "closing": self._of_session(lambda view: view.check_again()),
            "correct": self._of_session(lambda view: view.correct()),
            "no landmarks": self._of_session(lambda view: view.skip_landmarks()),
            "undo": self._of_session(lambda view: view.undo()),
            "redo": self._of_session(lambda view: view.redo()),
            "history": self._of_session(lambda view: view.show_history(self)),
            "thresholds": self._of_session(lambda view: view.show_thresholds(self)),
            "exclude": self._of_session(lambda view: view.exclude_or_restore()),
            "last": self._of_session(lambda view: view.select_last()),
            "dead": self._of_session(lambda view: view.mark_or_revive()),
            "method": self._of_session(lambda view: view.next_method()),
            "difference": self._of_session(lambda view: view.show_difference()),
            "guide": self._of_session(lambda view: view.show_guide()),
            "sounds": self._switch_sounds,
            "speech": self._switch_sounds,
            "turn": self._of_session(lambda view: view.show_turning()),
            **dict.fromkeys(LAYERS, self._of_session(lambda view: view.show_layers())),
            "camera": self._of_session(lambda view: view.workspace.view.reset_camera()),
            "larger": self.text_size.larger,
            "smaller": self.text_size.smaller,
            "usual": self.text_size.choose,
            "none": self._escape,
            "full": self._toggle_full,
            "what": QWhatsThis.enterWhatsThisMode,
            "keys": self._show_keys,
            "about": self._show_about,
            "pedals": self.ask_pedals,
            "landmark": self._of_session(lambda view: view.ask_landmark(self)),
        }

    def _of_session(self, do: Callable[Concatenate[SessionView, Said], object]) -> Callable[Said, None]:
        """Return what does something with the session view, if there is one, and with what a signal says."""

        def slot(*said: Said.args, **named: Said.kwargs) -> None:
            if self.session_view is not None:
                do(self.session_view, *said, **named)

        return slot

    def _arrange(self) -> None:
        self.commands.add_themes(self._theme.choice, self._choose_theme)
        self.commands.menus["Session"].insertMenu(self.commands.actions["import"], self.recent)
        self.commands.menus["Help"].addMenu(self.documents)
        for name, wanted in (("sounds", True), ("speech", False)):
            self.commands.actions[name].setChecked(bool(self._settings.value(f"window/{name}", wanted, type=bool)))
        # Until the player has looked, beside the window.
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
        if self.size() != FIRST_SIZE:
            # The desktop's frame around it would push its lower rim off the screen.
            self.setWindowState(Qt.WindowState.WindowMaximized)
        geometry = self._settings.value("window/geometry")
        if isinstance(geometry, QByteArray):
            self.restoreGeometry(geometry)

    def _connect(self) -> None:
        controller = self.controller
        controller.prepare = _prepare
        controller.confirmation_due.connect(self._ask_first)
        controller.recorded_elsewhere.connect(self._offer_to_look)
        controller.part_loaded.connect(self._take_part)
        controller.session_opened.connect(self._take_session)
        controller.ticked.connect(self._of_session(lambda view, tick: view.take_tick(tick)))
        controller.running_changed.connect(self._running_changed)
        controller.said.connect(self.tell)
        controller.truth_found.connect(self._of_session(lambda view, truth: view.offer(truth)))
        controller.reviewed.connect(self._of_session(lambda view, review: view.take_review(review)))
        controller.stored.connect(self._say_where)
        self._theme.changed.connect(self._recolour)
        self.text_size.changed.connect(self._follow_text)
        self._follow_text()
        dropped = DropTarget(self)
        dropped.request_made.connect(self.open)
        dropped.recording_dropped.connect(self.ask_import)
        for failed in (dropped.refused, self.documents.failed):
            failed.connect(lambda sentence: self.tell(Message(sentence, error=True)))
        self.recent.chosen.connect(lambda folder: self.open(OpenRequest(session=folder)))
        self._sound_found.connect(self._follow_sound)
        self._player.found = self._sound_found.emit

    # What the controller says

    def _take_part(self, part: Part) -> None:
        from app.session_view import SessionView

        self._drop_session()
        session_view = SessionView(part, self.controller, self.commands, self._documents, parent=self)
        self.session_view = session_view
        session_view.said.connect(self.tell)
        session_view.sound_due.connect(lambda due: self._player.play(due.sound, due.word))
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
            session_view.recolour()
            self.statusBar().addPermanentWidget(session_view.chips)
            self.stack.addWidget(session_view.workspace)
            self.stack.setCurrentWidget(session_view.workspace)
            session_view.begin()
            if self.controller.demo and not self._settings.value("window/told", False, type=bool):
                self._told = FirstMinute(session_view.workspace.view, session_view.workspace.view.cover)
                # At once: a window that is closed within the minute has shown it, too.
                self._settings.setValue("window/told", True)

    def _take_session(self, snapshot: Snapshot) -> None:
        if self.session_view is not None:
            self.session_view.session_opened(snapshot)
            self._player.get_ready()

    def _running_changed(self, running: Running) -> None:
        self._show_opening()
        self.commands.follow_pace(pace_words(self.controller.pace), served=self.controller.has_simulator)
        if self.session_view is not None:
            if running is Running.OFFLINE and self.session_view.state is None:
                self.session_view.workspace.wait("nothing to show", "No device is read; Ctrl+N names devices.")
            self.session_view.follow_again()

    def _show_opening(self) -> None:
        # The session's panels come some moments after its part.
        opening = self.controller.running is Running.OPENING or self.session_view is not None
        nothing = "Nothing is open.\nCtrl+N begins a new session, Ctrl+O opens a recorded one."
        self.opening.setText("Opening \N{HORIZONTAL ELLIPSIS}" if opening else nothing)

    def _follow_sound(self, found: bool) -> None:
        self.commands.follow_sound(found=found, can_speak=self._player.can_speak)

    def _say_where(self, words: str) -> None:
        self.where.setText(words)
        if self.controller.folder is not None:
            self.recent.remember(self.controller.folder)
        if self.session_view is not None:
            self.session_view.refresh_allowed()

    def tell(self, message: Message) -> None:
        """Tell the operator something; errors are logged, too."""
        if message.error:
            LOG.warning("%s", message.text)
        self.messages.tell(message)

    def _recolour(self) -> None:
        self.messages.show_newest()
        if self.session_view is not None:
            self.session_view.recolour()

    def _follow_text(self) -> None:
        self.commands.follow_text(self.text_size.percent, STEPS)

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
        elif self._told is not None and self._told.isVisible():
            self._told.leave()
        elif self.messages.isVisible():
            self.messages.dismiss()
        elif self.session_view is not None:
            self.session_view.select_taxel(None)

    def _change_pace(self) -> None:
        """Have the simulated operator be quicker, and after the quickest as slow as at first."""
        paces = PACES
        self.controller.set_pace(paces[(paces.index(self.controller.pace) + 1) % len(paces)])

    def _switch_sounds(self) -> None:
        """Play sounds, and say words, as the menu has it."""
        player, actions = self._player, self.commands.actions
        player.on, player.speaks = actions["sounds"].isChecked(), actions["speech"].isChecked()
        if self.session_view is not None:
            player.get_ready()

    def _toggle_full(self) -> None:
        # That bit alone: a window that was as large as the screen is so again afterwards.
        self.setWindowState(self.windowState() ^ Qt.WindowState.WindowFullScreen)

    def _show_keys(self) -> None:
        from app.dialogs.keys_dialog import KeysDialog

        KeysDialog(self).open()

    def _show_about(self) -> None:
        self._offer("About skincal", about_words(qVersion()))

    def ask_new(self) -> None:
        """Ask for a new session and open it."""
        from app.dialogs.new_session import NewSessionDialog

        scene = None if self.session_view is None else self.session_view.workspace.part.scene.path
        folder = dated_folder(self._documents, datetime.now().astimezone())
        paused = self._lend_devices()
        dialog = NewSessionDialog(scene, folder, self, self._known_addresses(), paused=paused)
        dialog.request_chosen.connect(self.open)
        self._open_page(dialog, paused=paused)

    def ask_addresses(self) -> None:
        """Ask where the devices of this session are now."""
        from app.dialogs.new_session import NewSessionDialog
        from app.session.opening import addresses_of

        view = self.session_view
        if view is None or self.controller.has_simulator or not self.controller.links:
            self.tell(Message(NO_ADDRESSES, found=True))
            return
        present = addresses_of(self.controller.links), view.workspace.part.scene
        paused = self._lend_devices()
        dialog = NewSessionDialog(None, Path(), self, self._known_addresses(), present)
        dialog.addresses_chosen.connect(self._use_addresses)
        self._open_page(dialog, paused=paused)

    def _use_addresses(self, addresses: Addresses, agreed: Iterable[str]) -> None:
        """Read the devices there; of what the session's file names and nobody has agreed to is asked first, as ever."""
        self._remember(agreed)
        named = tuple(filter(None, (addresses.wrench, addresses.skin, addresses.joints)))
        self._once_agreed(named, lambda: self.controller.change_addresses(addresses))

    def _lend_devices(self) -> bool:
        """Let go of devices that a page will look at, since a port has one reader; return whether they were read."""
        if self.controller.running is not Running.STREAMING or self.controller.has_simulator:
            return False
        self.controller.pause()
        return True

    def _open_page(self, dialog: QDialog, *, paused: bool) -> None:
        """Open a page that looks at devices; where it is left they are read again."""
        if paused:
            dialog.rejected.connect(self.controller.resume)
        dialog.open()

    def ask_import(self, paths: Sequence[Path] = ()) -> None:
        """Ask for a recording of another program, make a session of it and open that."""
        from app.dialogs.import_dialog import ImportDialog

        if self._import is not None:
            return
        scene = None if self.session_view is None else self.session_view.workspace.part.scene.path
        kept = Path(str(self._settings.value(IMPORTED_ON, "")))
        folder = dated_folder(self._documents, datetime.now().astimezone())
        self._import = dialog = ImportDialog(paths, scene or find_scene(kept if kept.is_file() else None), folder, self)
        dialog.imported.connect(self._open_imported)
        dialog.finished.connect(self._import_over)
        dialog.open()

    def _import_over(self) -> None:
        self._import = None

    def _open_imported(self, imported: Imported, scene: str) -> None:
        from app.text.import_text import imported_words

        self._settings.setValue(IMPORTED_ON, scene)
        self.open(OpenRequest(session=imported.folder))
        self.tell(Message(imported_words(imported)))

    def ask_pedals(self) -> None:
        """Learn the keys of foot pedals."""
        from app.dialogs.pedals import PedalsDialog

        PedalsDialog(self.pedals, self).open()

    def ask_session(self) -> None:
        """Ask for a recorded session and open it."""
        folder = QFileDialog.getExistingDirectory(self, "Folder of a recorded session", str(self._documents))
        if folder:
            self.open(OpenRequest(session=Path(folder)))

    def _ask_first(self, addresses: tuple[str, ...]) -> None:
        """Ask before devices are connected that a recorded session names: it may be a stranger's."""
        self._once_agreed(addresses, lambda: self.controller.resume(confirmed=True))

    def _once_agreed(self, addresses: Iterable[str], connect: Callable[[], object]) -> None:
        """Ask before devices are connected; what the operator named or agreed to before is not asked about again."""
        known = self._known_addresses()
        new = [address for address in addresses if address not in known]

        def agree() -> None:
            self._remember(new)
            connect()

        if new:
            self._offer("Connect to these devices?", connect_words(new), "Connect", agree)
        else:
            connect()

    def _offer(self, title: str, text: str, yes: str = "", do: Callable[[], object] = lambda: None) -> None:
        """Ask, beside everything else, and do something where the answer is yes; without a `yes` only say it."""
        no = QMessageBox.StandardButton.Cancel if yes else QMessageBox.StandardButton.Close
        box = QMessageBox(QMessageBox.Icon.NoIcon, title, "", no, self)
        # Before the text, which would be laid out, and what it names opened, at once.
        box.setTextFormat(Qt.TextFormat.PlainText)
        box.setText(text)
        box.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        if yes:
            box.addButton(yes, QMessageBox.ButtonRole.AcceptRole).clicked.connect(do)
        # The space bar and the pedal bring a question about, and may be pressed once more before it is read.
        box.setDefaultButton(QMessageBox.StandardButton.Cancel)
        box.open()

    def _known_addresses(self) -> list[str]:
        return kept_texts(self._settings, "addresses")

    def _remember(self, addresses: Iterable[str]) -> None:
        newest = sorted(set(addresses))
        older = [address for address in self._known_addresses() if address not in newest]
        # The oldest are dropped: what is not known is asked about again.
        self._settings.setValue("addresses", [*older, *newest][-ADDRESSES_KEPT:])

    def _offer_to_look(self, folder: Path, sentence: str) -> None:
        """Another process records the session: offer to see it as far as it is written."""
        request = OpenRequest(session=folder, read_only=True)
        self._offer("Being recorded", look_words(sentence), "View", lambda: self.open(request))

    def open(self, request: OpenRequest) -> None:
        """Open something in place of what is open, once it is settled what becomes of that."""
        self._before_losing(lambda: self._open(request))

    def _open(self, request: OpenRequest) -> None:
        given = request.addresses
        self._targets = request.targets or self._targets
        if given:
            self._remember({given.wrench, given.skin, given.joints} - {""})
            request = replace(request, targets=self._targets)
        self._drop_session()
        self.where.setText("")
        self.controller.open(request)

    def _before_losing(self, then: Callable[[], object]) -> None:
        """Ask whether to keep a provisional session that has pokes, then call `then`."""
        pokes = self.controller.unsaved_pokes
        if not pokes:
            then()
            return
        if self._question is not None:
            return
        question, more = keep_question(pokes)
        self._question = box = QMessageBox(QMessageBox.Icon.Question, "Keep this session", question, parent=self)
        box.setInformativeText(more)
        keep = box.addButton("Keep", QMessageBox.ButtonRole.AcceptRole)
        drop = box.addButton("Do not keep", QMessageBox.ButtonRole.DestructiveRole)
        box.addButton(QMessageBox.StandardButton.Cancel)
        box.setDefaultButton(keep)

        def answered() -> None:
            chosen, self._question = box.clickedButton(), None
            box.deleteLater()
            if chosen is keep:
                self.controller.keep()
            elif chosen is drop:
                self.controller.discard()
            if chosen in (keep, drop):
                then()

        box.finished.connect(answered)
        box.open()
        keep.setFocus()

    # Coming and going

    @Slot()
    def leave(self) -> None:
        """Close without a question: it is answered, or nobody can be asked."""
        self._leaves = True
        self.close()

    def _drop_session(self) -> None:
        session_view, self.session_view = self.session_view, None
        # It goes with the view that it stands over.
        self._told = None
        if session_view is not None:
            session_view.save(self._settings)
            session_view.close()
            self.stack.removeWidget(session_view.workspace)
            self.statusBar().removeWidget(session_view.chips)
            for gone in (session_view.workspace, session_view.chips, session_view):
                gone.deleteLater()

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask whether to keep a provisional session; then stop the timers, close the 3D view, then the journal."""
        if not self._leaves and self.controller.unsaved_pokes:
            self._before_losing(self.leave)
            event.ignore()
            return
        self._settings.setValue("window/geometry", self.saveGeometry())
        self._settings.setValue("window/sounds", self._player.on)
        self._settings.setValue("window/speech", self._player.speaks)
        # Hidden first: closing may take as long as a read, and a window that stands still looks broken.
        self.hide()
        self.pedals.stop()
        if self._import is not None:
            self._import.end()
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
