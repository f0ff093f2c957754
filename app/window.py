"""The main window: menus, messages, opening and closing. A session view fills it when a session is open.

It is on the screen before anything heavy is imported, so it imports neither numpy nor what needs it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QByteArray, QObject, QSettings, QSize, Qt, QTimer, QUrl, Signal, Slot, qVersion
from PySide6.QtGui import QCloseEvent, QColor, QDesktopServices, QPalette
from PySide6.QtWidgets import QApplication, QDialog, QFileDialog, QMainWindow, QMessageBox, QStackedWidget, QWidget

from app.commands import Commands
from app.dialogs.focus_return import FocusReturn
from app.dialogs.pedals import Pedals
from app.panels.drop_target import DropTarget
from app.panels.first_minute import FirstMinute
from app.panels.layouts import make_column, scrolled
from app.panels.message_bar import MessageBar
from app.panels.recent_menu import RecentMenu, kept_texts
from app.panels.start_page import StartPage
from app.panels.widgets import ElidedLabel, mix
from app.qt_types import name_types
from app.session.controller import OPERATOR_PACES, Controller
from app.session.opening import Addresses, OpenRequest, dated_folder, find_scene, is_shipped, server_command
from app.sound.player import Player
from app.state.running import Running
from app.text.demo_text import GO_ON_SIMULATED
from app.text.help_text import NO_DOCUMENTS, about_words, unopened_words
from app.text.message import (
    NO_ADDRESSES,
    PART_NOT_SAVED,
    Message,
    closed_words,
    connect_words,
    keep_question,
    look_words,
    tip_words,
    tip_written_words,
)
from app.text_size import TextSize, scaled
from app.theme import DARK, LIGHT, WIDGET_GAP_PX, Choice, Colours
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from app.builder.page import BuilderPage
    from app.dialogs.import_dialog import ImportDialog
    from app.dialogs.messages_dialog import MessagesDialog
    from app.session_view import SessionView
    from app.state.policies import Allowed
    from app.workspace import Workspace
    from skincal.part.part import Part
    from skincal.part.tool_draft import ToolDraft
    from skincal.session.importing import Imported

LOG = logging.getLogger(__name__)
MAX_REMEMBERED_ADDRESSES = 50  # Addresses that the operator named or agreed to; no laboratory has more devices
DOCUMENTS_FOLDER = Path(__file__).resolve().parents[1] / "docs"
"""Next to the program in a checkout; a package comes without."""
PARTS_FOLDER = "scenes"  # Of the documents: the parts that the operator described
OWN_SCENE_SETTING = "window/own_scene"  # A scene of the operator's own was opened
KEEP_COUNT_PERIOD_MS = 250  # The question whether to keep a session counts its pokes again
IMPORT_SCENE_SETTING = "import/scene"  # Scene of the last import
FIELD_CLASSES = ("QLineEdit", "QComboBox", "QAbstractSpinBox", "QCheckBox", "QRadioButton")
FUSION_BORDER_DARKNESS_PERCENT = 130
"""Fusion makes a border this much darker than the window, or a little more, which is visible on a light one only."""
STATUS_BAR_HEIGHT_PX = 26  # At 100 %, with the signs of links
FIRST_SIZE = QSize(1440, 860)  # Pixels, if the screen has them


def qpalette(colours: Colours) -> QPalette:
    """Return the Qt palette of a theme. The desktop's own is never used, so the window looks the same everywhere."""
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
    # Last, since the others are set for every group.
    for name in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(QPalette.ColorGroup.Disabled, name, mix(colours.muted, colours.window, 0.45))
    return palette


def field_palette(colours: Colours) -> QPalette:
    """Return the palette of fields: as the window's, except the colour from which Fusion makes borders."""
    palette = qpalette(colours)
    palette.setColor(QPalette.ColorRole.Window, QColor(colours.edge).lighter(FUSION_BORDER_DARKNESS_PERCENT))
    return palette


def style_sheet(colours: Colours) -> str:
    """Return the rules that a palette cannot express: flat tabs, muted headers, thin splitters."""
    return f"""
    QToolTip {{ color: {colours.text}; background: {colours.raised}; border: 1px solid {colours.line}; padding: 4px; }}
    QMenuBar {{ background: {colours.window}; border-bottom: 1px solid {colours.line}; }}
    QMenuBar::item {{ padding: 5px 10px; background: transparent; }}
    QMenuBar::item:selected {{ background: {colours.raised}; }}
    QStatusBar {{ border-top: 1px solid {colours.line}; }}
    QStatusBar::item {{ border: none; }}
    QMainWindow::separator {{ width: {WIDGET_GAP_PX}px; height: {WIDGET_GAP_PX}px; background: {colours.window}; }}
    QDockWidget {{ color: {colours.muted}; }}
    QDockWidget::title {{ background: {colours.window}; padding: 1px 4px; text-align: left; }}
    QSplitter::handle {{ background: {colours.window}; }}
    QTabWidget::pane {{ border: none; border-top: 1px solid {colours.line}; background: {colours.panel}; }}
    QTabBar::tab {{ padding: 6px 10px; border: none; color: {colours.muted}; background: transparent; }}
    QTabBar::tab:selected {{ color: {colours.text}; border-bottom: 2px solid {colours.accent}; }}
    QTabBar::tab:hover {{ color: {colours.text}; }}
    QTabBar::tab:selected:focus {{ border: 1px solid {colours.accent}; border-bottom-width: 2px; padding: 5px 9px 6px 9px; }}
    QTabBar {{ outline: none; }}
    QScrollArea {{ border: 1px solid {colours.panel}; }}
    QScrollArea#pages, QScrollArea[frameless="true"] {{ border: none; }}
    QScrollArea:focus {{ border: 1px solid {colours.accent}; }}
    QHeaderView::section {{ color: {colours.muted}; background: {colours.panel}; border: none; padding: 4px 4px;
        border-bottom: 1px solid {colours.line}; }}
    QTableView {{ border: none; background: {colours.panel}; gridline-color: {colours.raised};
        selection-background-color: {colours.accent}; selection-color: {colours.on_accent}; }}
    QToolButton[choice="true"] {{ padding: 2px 8px; border: 1px solid {colours.line}; border-radius: 3px; }}
    QToolButton[choice="true"]:checked {{ color: {colours.on_accent}; background: {colours.accent}; }}
    QFrame#card {{ background: {colours.panel}; border: 1px solid {colours.line}; border-radius: 6px; }}
    QLabel[quiet="true"] {{ color: {colours.muted}; }}
    /* Labels quote files and devices: Qt would open an image that a text in HTML names. */
    QLabel {{ qproperty-textFormat: PlainText; }}
    QLabel[rich="true"] {{ qproperty-textFormat: RichText; }}
    """


class Theme(QObject):
    """The colours of the application, kept in its palette: the operator's choice, or the desktop's."""

    changed = Signal()

    def __init__(self, choice: Choice = Choice.SYSTEM, parent: QObject | None = None) -> None:
        super().__init__(parent)
        QApplication.styleHints().colorSchemeChanged.connect(self._follow_desktop)
        self.choose(choice)

    def choose(self, choice: Choice) -> None:
        """Give the whole application these colours; light if the desktop has no preference."""
        self.choice = choice
        is_dark = choice is Choice.DARK
        if choice is Choice.SYSTEM:
            is_dark = QApplication.styleHints().colorScheme() is Qt.ColorScheme.Dark
        colours = DARK if is_dark else LIGHT
        # The only style that follows a palette on every system.
        QApplication.setStyle("Fusion")
        QApplication.setPalette(qpalette(colours))
        for kind in FIELD_CLASSES:
            # PySide6 takes a str, where its types say bytes.
            QApplication.setPalette(field_palette(colours), kind)  # pyright: ignore[reportArgumentType]
        app = QApplication.instance()
        if isinstance(app, QApplication):
            app.setStyleSheet(style_sheet(colours))
        self.changed.emit()

    def _follow_desktop(self) -> None:
        if self.choice is Choice.SYSTEM:
            self.choose(self.choice)


class Window(QMainWindow):
    """Everything the operator sees."""

    view_ready = Signal()  # The 3D view of the session has its picture
    _sound_found = Signal(bool)  # From the player's thread: whether there is a sound device

    def __init__(self, controller: Controller, theme: Theme, settings: QSettings, documents: Path, player: Player) -> None:
        super().__init__()
        self.setWindowTitle("skincal")
        self.controller, self.player = controller, player
        self._theme, self._settings, self._documents = theme, settings, documents
        self.text_size = TextSize(settings, self)
        self.workspace: Workspace | None = None  # Page of the open session, from the loaded part on
        self.session_view: SessionView | None = None  # From `guided_made` on
        self.builder: BuilderPage | None = None
        self.has_sound = True  # There is a sound device; true until the player has looked
        self._first_minute: FirstMinute | None = None
        self._question: QMessageBox | None = None  # The open question whether to keep a session
        self._targets = ""  # Address that asks a robot for pokes, in every session with devices; empty by default
        self._leaves = False
        self._farewell: Message | None = None  # Where the session or the part that is being closed is saved
        self._import: ImportDialog | None = None
        self._messages_dialog: MessagesDialog | None = None
        self.stack, self.opening, self.where = QStackedWidget(), StartPage(), ElidedLabel()
        self.messages = MessageBar(self._message_place)
        self.commands = Commands(self)
        self.recent = RecentMenu(settings, self)
        self._focus_return = FocusReturn(self)
        self.pedals = Pedals(self.commands.actions, self.commands.meaning_of_keys, settings, self)
        self._arrange()
        self._connect()

    def _arrange(self) -> None:
        self.commands.menus["Session"].insertMenu(self.commands.actions["import"], self.recent)
        self.commands.restore(self._settings)
        self._check_theme()
        self.switch_sounds()
        self.stack.addWidget(self.opening)
        self._show_opening()
        centre = QWidget()
        # Pages larger than the screen scroll: Wayland compositors end a program whose maximized window is larger.
        pages = scrolled(self.stack)
        pages.setObjectName("pages")
        make_column((pages, 1), within=centre, margins=0, gap=0)
        self.setCentralWidget(centre)
        self.messages.setParent(centre)
        bar = self.statusBar()
        bar.setSizeGripEnabled(False)
        bar.setContentsMargins(WIDGET_GAP_PX, 0, 0, 0)
        bar.addWidget(self.where, 1)
        self._fit_status_bar()
        self.resize(FIRST_SIZE.boundedTo(self.screen().availableSize()))
        if self.size() != FIRST_SIZE:
            # The desktop's frame would push the lower edge off the screen.
            self.setWindowState(Qt.WindowState.WindowMaximized)
        geometry = self._settings.value("window/geometry")
        if isinstance(geometry, QByteArray):
            self.restoreGeometry(geometry)

    def _fit_status_bar(self) -> None:
        """Leave the signs of the links their room before there is a link, so that they move nothing when they come."""
        self.statusBar().setMinimumHeight(scaled(STATUS_BAR_HEIGHT_PX))

    def _connect(self) -> None:
        controller = self.controller
        controller.prepare = _import_session_view
        controller.confirmation_due.connect(
            lambda addresses: self._confirm_addresses(addresses, lambda: controller.resume(confirmed=True))
        )
        controller.simulation_due.connect(
            lambda: self._offer("Go on with the simulated hand?", GO_ON_SIMULATED, "Go on", controller.simulate_again)
        )
        controller.recorded_elsewhere.connect(self._offer_to_look)
        controller.part_loaded.connect(self._show_part)
        controller.guided_made.connect(lambda _: self._make_session_view())
        controller.session_opened.connect(lambda _: self.player.get_ready())
        controller.running_changed.connect(self._follow_running)
        self.messages.list_wanted.connect(self.show_messages)
        self.messages.file_wanted.connect(self.open_file)
        self.stack.currentChanged.connect(lambda _: self.messages.show_newest())
        controller.said.connect(self.tell)
        controller.unsaid.connect(self.messages.withdraw)
        controller.stored.connect(self._show_storage)
        self._theme.changed.connect(self._recolour)
        self.text_size.changed.connect(self.commands.update_actions)
        self.text_size.changed.connect(self._fit_status_bar)
        self.opening.command_wanted.connect(lambda name: self.commands.actions[name].trigger())
        dropped = DropTarget(self)
        dropped.request_made.connect(self.open)
        dropped.recording_dropped.connect(self.ask_import)
        dropped.refused.connect(self.tell_failure)
        self.recent.chosen.connect(lambda folder: self.open(OpenRequest(session=folder)))
        self._sound_found.connect(self._follow_sound)
        self.player.found = self._sound_found.emit
        self.commands.update_actions()

    @property
    def may(self) -> Allowed | None:
        """What the operator may do with the session; `None` before its first picture."""
        state = None if self.session_view is None else self.session_view.state
        return None if state is None else state.may

    # Signals of the controller

    def _show_part(self, part: Part) -> None:
        """Show the part of the session that is being opened. All else waits for its picture."""
        from app.workspace import Workspace

        self._drop_session()
        self.workspace = workspace = Workspace(part)
        self.setWindowTitle(f"{part.scene.name} \N{EN DASH} skincal")
        if not self._settings.value(OWN_SCENE_SETTING, False, type=bool):
            self._settings.setValue(OWN_SCENE_SETTING, not is_shipped(part.scene.path))
        workspace.view.ready.connect(self.view_ready)
        workspace.view.settled.connect(lambda: name_types(workspace, self.controller.guide_part))
        workspace.docks.restore(self._settings)
        workspace.follow_switches(self.commands.is_on)
        workspace.recolour()
        self._show_first_minute(workspace)
        self.stack.addWidget(workspace)
        self.stack.setCurrentWidget(workspace)
        # With the workspace as its context Qt calls nothing once that is gone.
        QTimer.singleShot(0, workspace, workspace.build_3d_view)

    def _show_first_minute(self, workspace: Workspace) -> None:
        """Show newcomers what the demonstration is."""
        if not self.controller.demo or self._settings.value("window/told", False, type=bool):
            return
        self._first_minute = FirstMinute(robot=not self.controller.pace, has_tool=self.has_tool)
        workspace.show_card(self._first_minute)
        # Esc closes the card first: one thing at a time says so.
        self.messages.show_key(wanted=False)
        self._first_minute.closed.connect(lambda: self.messages.show_key(wanted=True))
        # Now: a window that is closed within the minute has shown it, too.
        self._settings.setValue("window/told", True)

    def _make_session_view(self) -> None:
        from app.session_view import SessionView

        if self.workspace is None:
            return
        self.session_view = view = SessionView(
            self.workspace, self.controller, self.commands, self._documents, self._settings, self
        )
        view.said.connect(self.tell)
        view.sound_due.connect(lambda due: self.player.play(due.sound, due.word))
        view.unsaid.connect(self.messages.withdraw)
        view.picking.unsaid.connect(self.messages.withdraw)
        # Making the panels, their plots, laying them out and showing them would together block the window too long.
        QTimer.singleShot(0, view, lambda: self._make_plots(view))

    def _make_plots(self, view: SessionView) -> None:
        if view is self.session_view:
            next_step = self._arrange_session if view.make_next_plot() else self._make_plots
            QTimer.singleShot(0, view, lambda: next_step(view))

    def _arrange_session(self, view: SessionView) -> None:
        if view is self.session_view:
            view.workspace.arrange()
            view.restore()
            QTimer.singleShot(0, view, lambda: self._show_session(view))

    def _show_session(self, view: SessionView) -> None:
        if view is self.session_view:
            view.recolour()
            self.statusBar().addPermanentWidget(view.chips)

    def _follow_running(self, running: Running) -> None:
        self._show_opening()
        has_picture = self.session_view is not None and self.session_view.state is not None
        # A device may fail before the panels are there.
        if self.workspace is not None and running is Running.OFFLINE and not has_picture:
            self.workspace.wait("Nothing to show", "No device is connected. Ctrl+N: name devices.")
        if self.session_view is not None:
            self.session_view.follow_again()
        self.commands.update_actions()

    def _show_opening(self) -> None:
        # The panels of a session come some moments after its part.
        is_opening = self.controller.running is Running.OPENING or self.workspace is not None
        is_new_here = not self._settings.value(OWN_SCENE_SETTING, False, type=bool)
        words = "Opening …" if is_opening else "No session is open."
        self.opening.show_words(words, offers=not is_opening, part_first=is_new_here)

    def _follow_sound(self, found: bool) -> None:
        self.has_sound = found
        self.commands.update_actions()

    def _show_storage(self, words: str) -> None:
        self.where.setText(words)
        if self.controller.folder is not None:
            part = "" if self.workspace is None else self.workspace.part.scene.name
            self.recent.remember(self.controller.folder, part)
        self.commands.update_actions()

    def _message_place(self) -> QWidget:
        """Return the widget whose upper edge messages may cover: the 3D view, since no field or button is there."""
        page = self.stack.currentWidget()
        if self.workspace is not None and page is self.workspace:
            return self.workspace.view
        return self.builder.view if self.builder is not None and page is self.builder else self.stack

    def tell(self, message: Message) -> None:
        """Show a message to the operator; log errors, too."""
        if message.error:
            LOG.warning("%s", message.text)
        self.messages.tell(message)

    def tell_failure(self, sentence: str) -> None:
        self.tell(Message(sentence, error=True))

    def _recolour(self) -> None:
        self.messages.show_newest()
        if self.session_view is not None:
            self.session_view.recolour()
        elif self.workspace is not None:
            self.workspace.recolour()
        if self.builder is not None:
            self.builder.recolour()

    # Commands

    def choose_theme(self, choice: Choice) -> None:
        self._settings.setValue("theme", choice.value)
        self._theme.choose(choice)
        self._check_theme()

    def _check_theme(self) -> None:
        for choice in Choice:
            self.commands.actions[choice.value].setChecked(choice is self._theme.choice)

    def pause_or_show_verdict(self) -> None:
        if self.session_view is not None and self.may is not None and self.may.ends:
            self.session_view.ask_verdict()
        else:
            self.controller.toggle()

    def escape(self) -> None:
        """Close or cancel the item that was opened last."""
        if self.session_view is not None and self.session_view.picking.waiting:
            self.session_view.picking.stop()
        elif self._first_minute is not None and self._first_minute.isVisible():
            self._first_minute.leave()
        elif self.messages.isVisible():
            self.messages.dismiss()
        elif self.session_view is not None:
            self.session_view.select_taxel(None)

    def change_pace(self) -> None:
        """Make the simulated operator faster, and after the fastest pace slow again."""
        self.controller.set_pace(OPERATOR_PACES[(OPERATOR_PACES.index(self.controller.pace) + 1) % len(OPERATOR_PACES)])

    def switch_sounds(self) -> None:
        """Apply the menu's choices of sounds and speech."""
        self.player.on, self.player.speaks = self.commands.is_on("sounds"), self.commands.is_on("speech")
        if self.session_view is not None:
            self.player.get_ready()

    def toggle_full_screen(self) -> None:
        # This bit alone: a maximized window is maximized again afterwards.
        self.setWindowState(self.windowState() ^ Qt.WindowState.WindowFullScreen)

    def show_keys(self) -> None:
        from app.dialogs.keys_dialog import KeysDialog

        KeysDialog(self).open()

    def show_messages(self) -> None:
        """Show all messages in a window that stays open."""
        from app.dialogs.messages_dialog import MessagesDialog

        if self._messages_dialog is None:
            self._messages_dialog = dialog = MessagesDialog(self.messages, self)
            dialog.finished.connect(self._forget_messages)
        self._messages_dialog.show()
        self._messages_dialog.activateWindow()

    def _forget_messages(self) -> None:
        self._messages_dialog = None

    def show_about(self) -> None:
        self._offer("About skincal", about_words(qVersion()))

    def open_file(self, path: Path) -> None:
        """Open a written file in the program that the desktop has for it."""
        if not QDesktopServices.openUrl(QUrl.fromLocalFile(str(path))):
            self.tell_failure(f"No program was found that opens {path}. Open it in a browser.")

    def open_documents(self) -> None:
        """Open the documents folder in the desktop's file manager."""
        if not DOCUMENTS_FOLDER.is_dir():
            self.tell_failure(NO_DOCUMENTS)
        elif not QDesktopServices.openUrl(QUrl.fromLocalFile(str(DOCUMENTS_FOLDER))):
            self.tell_failure(unopened_words(DOCUMENTS_FOLDER))

    def ask_new(self) -> None:
        self._ask_devices(self._scene_path(), paused=self._lend_devices())

    def _scene_path(self) -> Path | None:
        return None if self.workspace is None else self.workspace.part.scene.path

    def _new_folder(self) -> Path:
        return dated_folder(self._documents, datetime.now().astimezone())

    def ask_addresses(self) -> None:
        from app.dialogs.new_session import NewSessionDialog
        from app.session.opening import addresses_of

        view = self.session_view
        if view is None or self.controller.has_simulator or not self.controller.links:
            self.tell(Message(NO_ADDRESSES, found=True))
            return
        present = addresses_of(self.controller.links), view.workspace.part.scene
        paused = self._lend_devices()
        dialog = NewSessionDialog(OpenRequest(), self, self._known_addresses(), present)
        dialog.addresses_chosen.connect(self._use_addresses)
        self._open_page(dialog, paused=paused)

    def _use_addresses(self, addresses: Addresses, agreed: Iterable[str]) -> None:
        """Read the devices at these addresses; those of the session's file need the operator's agreement as always."""
        self._remember(agreed)
        self._confirm_addresses(addresses.named, lambda: self.controller.change_addresses(addresses))

    def _lend_devices(self) -> bool:
        """Release devices that a page will read, since a port has one reader; return whether they were in use."""
        if self.controller.running is not Running.STREAMING or self.controller.has_simulator:
            return False
        self.controller.pause()
        return True

    def _open_page(self, dialog: QDialog, *, paused: bool) -> None:
        """Open a dialog that reads the devices itself; the session reads them again if the dialog is cancelled."""
        if paused:
            dialog.rejected.connect(self.controller.resume)
        dialog.open()

    @property
    def has_tool(self) -> bool:
        """Whether the open session is about a part that a tool pokes, whose poses are streamed."""
        return self.workspace is not None and self.workspace.part.scene.tool is not None

    def ask_fixed_point(self) -> None:
        """Find the tip of the tool by touches of one point; the devices of the session are released meanwhile."""
        from skincal.model.readings import Stream

        address = next((link.address for link in self.controller.links if Stream.TOOL in link.carries), "")
        self._confirm_addresses([address] if address else [], lambda: self._open_fixed_point(address))

    def _open_fixed_point(self, address: str) -> None:
        from app.builder.fixed_point_dialog import FixedPointDialog
        from skincal.part.part_draft import open_draft
        from skincal.part.tool_draft import changes_by_test

        try:
            files = self._scene_files()
            tool = open_draft(files[0]).tool
        except InputError as error:
            self.tell_failure(str(error))
            return
        paused = self._lend_devices()
        resume = self.controller.resume if paused else lambda: None
        dialog = FixedPointDialog(tool, address, self)

        def ask(found: ToolDraft) -> None:
            changed = changes_by_test(tool, found)
            words = tip_words(changed, files)
            self._offer("Write this tip?", words, "Write", lambda: self._use_tip(changed, files, paused=paused), resume)

        dialog.found.connect(ask)
        self._open_page(dialog, paused=paused)

    def _scene_files(self) -> list[Path]:
        """List the scene files of the open session: its own copy, then the part's file if that is another one.

        Raises InputError: there is none that may be changed.
        """
        part = self._scene_path()
        found = dict.fromkeys(path for path in (self.controller.scene_copy, part) if path is not None)
        files = [path for path in found if path.is_file() and not is_shipped(path)]
        if not files:
            raise InputError(
                f"{part}: is part of skincal and is not changed; start a session first, or describe your own part."
            )
        return files

    def _use_tip(self, changed: Mapping[str, Any], files: Sequence[Path], *, paused: bool) -> None:
        """Write a tip that was found into scene files, and open the session again: its pokes are found again from the bytes."""
        from app.session.opening import addresses_of
        from skincal.part.part_draft import save_tool

        self.controller.keep()
        folder = self.controller.folder
        # A simulated device ends with its session.
        read = paused and not self.controller.simulated
        given = addresses_of(self.controller.links) if read else Addresses()
        written, failure = list[Path](), ""
        try:
            for path in files:
                save_tool(path, changed)
                written.append(path)
        except InputError as error:
            failure = f"{error} "
        if folder is not None and written:
            self._open(OpenRequest(session=folder, addresses=given))
        elif paused and failure:
            self.controller.resume()
        words = tip_written_words(written, is_session=folder is not None) if written else ""
        if failure:
            self.tell_failure(f"{failure}{words}".strip())
        else:
            self.tell(Message(words))

    def ask_import(self, paths: Sequence[Path] = ()) -> None:
        """Ask for a recording of another program, make a session of it and open that."""
        from app.dialogs.import_dialog import ImportDialog

        if self._import is not None:
            return
        kept = Path(str(self._settings.value(IMPORT_SCENE_SETTING, "")))
        scene = self._scene_path() or find_scene(kept if kept.is_file() else None)
        self._import = dialog = ImportDialog(paths, scene, self._new_folder(), self, self._documents / PARTS_FOLDER)
        dialog.imported.connect(self._open_imported)
        dialog.finished.connect(self._forget_import)
        dialog.open()

    def _forget_import(self) -> None:
        self._import = None

    def _open_imported(self, imported: Imported, scene: str) -> None:
        from app.text.import_text import imported_words

        self._settings.setValue(IMPORT_SCENE_SETTING, scene)

        def start() -> None:
            self._open(OpenRequest(session=imported.folder))
            self.tell(Message(imported_words(imported)))

        self._confirm_unsaved(start)

    def ask_part(self, path: Path | None = None) -> None:
        """Describe a new part, from a mesh or a URDF if one is given; the open session is closed."""
        self._confirm_unsaved(lambda: self._open_builder(lambda page: None if path is None else page.take_part(path)))

    def _take_part_file(self, path: Path) -> None:
        """Describe a part with this mesh or URDF, on the page if it is open."""
        if self.builder is None:
            self.ask_part(path)
            return
        try:
            self.builder.take_part(path)
        except InputError as error:
            self.tell_failure(str(error))

    def ask_scene(self) -> None:
        """Ask for a scene file, and change it on the page for parts."""
        path, _ = QFileDialog.getOpenFileName(self, "Change a part", str(self._documents / PARTS_FOLDER), "Scene (*.toml)")
        if path:
            self.change_part(Path(path))

    def change_part(self, path: Path) -> None:
        """Open a scene file in the builder; the open session is closed."""
        self._confirm_unsaved(lambda: self._open_builder(lambda page: page.open_scene(path)))

    def _open_builder(self, start: Callable[[BuilderPage], object]) -> None:
        from app.builder.page import BuilderPage

        page = BuilderPage(self._documents / PARTS_FOLDER, self)
        try:
            start(page)
        except InputError as error:
            page.close_page()
            page.deleteLater()
            self.tell_failure(str(error))
            return
        self._drop_session()
        self.controller.leave()
        self.where.setText("")
        self.builder = page
        page.failed.connect(self.tell_failure)
        page.left.connect(lambda: self._confirm_unsaved(self._leave_builder))
        page.start_wanted.connect(self._ask_devices)
        page.try_wanted.connect(self.try_scene)
        self.setWindowTitle("New part \N{EN DASH} skincal")
        self.stack.addWidget(page)
        self.stack.setCurrentWidget(page)
        QTimer.singleShot(0, page, page.build_view)

    def _leave_builder(self) -> None:
        self._drop_builder()
        self._show_opening()

    def _drop_builder(self) -> None:
        page, self.builder = self.builder, None
        if page is not None:
            self._drop_messages()
            page.close_page()
            self.stack.removeWidget(page)
            page.deleteLater()
            self.setWindowTitle("skincal")

    def try_scene(self, scene: Path) -> None:
        """Start a session of a scene with a simulated hand."""
        self.open(OpenRequest(scene=scene, server=server_command(scene)))

    def _ask_devices(self, scene: Path | None, addresses: Addresses | None = None, *, paused: bool = False) -> None:
        """Ask for scene and devices, and start; `paused` if devices are lent to the dialog."""
        from app.dialogs.new_session import NewSessionDialog

        proposed = OpenRequest(scene=scene, folder=self._new_folder(), addresses=addresses or Addresses())
        parts = self._documents / PARTS_FOLDER
        dialog = NewSessionDialog(proposed, self, self._known_addresses(), paused=paused, parts=parts)
        dialog.request_chosen.connect(self.open)
        self._open_page(dialog, paused=paused)

    def reset_camera(self) -> None:
        if self.builder is not None:
            self.builder.view.reset_camera()
        elif self.workspace is not None:
            self.workspace.view.reset_camera()

    def ask_pedals(self) -> None:
        from app.dialogs.pedals import PedalsDialog

        PedalsDialog(self.pedals, self).open()

    def ask_session(self) -> None:
        folder = QFileDialog.getExistingDirectory(self, "Folder of a recorded session", str(self._documents))
        if folder:
            self.open(OpenRequest(session=Path(folder)))

    def _confirm_addresses(self, addresses: Iterable[str], connect: Callable[[], object]) -> None:
        """Connect devices; ask first about addresses that the operator neither named nor agreed to before."""
        known = self._known_addresses()
        new = [address for address in addresses if address not in known]

        def agree() -> None:
            self._remember(new)
            connect()

        if new:
            self._offer("Connect to these devices?", connect_words(new), "Connect", agree)
        else:
            connect()

    def _offer(
        self,
        title: str,
        text: str,
        yes: str = "",
        accepted: Callable[[], object] = lambda: None,
        refused: Callable[[], object] = lambda: None,
    ) -> None:
        """Show a text; with a button `yes`, call `accepted` if it is pressed, else `refused`."""
        no = QMessageBox.StandardButton.Cancel if yes else QMessageBox.StandardButton.Close
        box = QMessageBox(QMessageBox.Icon.NoIcon, title, "", no, self)
        # Before the text: HTML in it would take effect at once.
        box.setTextFormat(Qt.TextFormat.PlainText)
        box.setText(text)
        box.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        if yes:
            box.addButton(yes, QMessageBox.ButtonRole.AcceptRole).clicked.connect(accepted)
            box.rejected.connect(refused)
        # The space bar or a pedal may be pressed a second time before the question is read.
        box.setDefaultButton(QMessageBox.StandardButton.Cancel)
        box.open()

    def _known_addresses(self) -> list[str]:
        return kept_texts(self._settings, "addresses")

    def _remember(self, addresses: Iterable[str]) -> None:
        newest = sorted(set(addresses))
        older = [address for address in self._known_addresses() if address not in newest]
        self._settings.setValue("addresses", [*older, *newest][-MAX_REMEMBERED_ADDRESSES:])

    def _offer_to_look(self, folder: Path, sentence: str) -> None:
        """Another process records the session: offer to show what is recorded so far."""
        request = OpenRequest(session=folder, read_only=True)
        self._offer("Being recorded", look_words(sentence), "View", lambda: self.open(request))

    def _ask_part(self, page: BuilderPage, then: Callable[[], object]) -> None:
        """Ask whether to save a part; call `then` after the answer, unless it is Cancel or the part cannot be saved."""
        box = QMessageBox(QMessageBox.Icon.Question, "Part not saved", PART_NOT_SAVED, parent=self)
        box.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        save = box.addButton("Save", QMessageBox.ButtonRole.AcceptRole)
        drop = box.addButton("Do not save", QMessageBox.ButtonRole.DestructiveRole)
        box.addButton(QMessageBox.StandardButton.Cancel)
        box.setDefaultButton(QMessageBox.StandardButton.Cancel)
        save.clicked.connect(lambda: page.save_then(lambda path: self._leave_saved(path, then)))
        drop.clicked.connect(lambda: then())
        box.open()

    def _leave_saved(self, path: Path, then: Callable[[], object]) -> None:
        self._leave_with(Message(f"The part is saved in {path.parent}."), then)

    def _leave_with(self, farewell: Message, then: Callable[[], object]) -> None:
        """Tell the place of a saved session or part, and call `then`, which may close it with its messages."""
        self.tell(farewell)
        self._farewell = farewell
        then()
        self._farewell = None

    def _drop_messages(self) -> None:
        """Forget the messages of a closed session or part, except the one on its place."""
        self.messages.start_over()
        if self._farewell is not None:
            self.tell(self._farewell)

    # Opening and closing

    def open(self, request: OpenRequest) -> None:
        """Open something in place of the open session, after the operator decided whether to keep that."""
        if request.part is not None:
            self._take_part_file(request.part)
            return
        self._confirm_unsaved(lambda: self._open(request))

    def _open(self, request: OpenRequest) -> None:
        given = request.addresses
        self._targets = request.targets or self._targets
        if given:
            self._remember({*given.named})
            request = replace(request, targets=self._targets)
        self._drop_session()
        self.where.setText("")
        self.controller.open(request)

    def _confirm_unsaved(self, then: Callable[[], object]) -> None:
        """Ask whether to keep an unsaved session or part; call `then` after the answer, unless it is Cancel."""
        if self.builder is not None and self.builder.is_changed:
            self._ask_part(self.builder, then)
            return
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

        def count_again() -> None:
            # The devices go on while it is asked.
            box.setText(keep_question(self.controller.unsaved_pokes or pokes)[0])

        counting = QTimer(box, interval=KEEP_COUNT_PERIOD_MS)
        counting.timeout.connect(count_again)
        counting.start()

        def answered() -> None:
            counting.stop()
            chosen, self._question = box.clickedButton(), None
            box.deleteLater()
            if chosen is keep:
                self.controller.keep()
                folder = self.controller.folder
                self._leave_with(Message(closed_words(folder)), then) if folder is not None else then()
            elif chosen is drop:
                self.controller.discard()
                then()

        box.finished.connect(answered)
        box.open()
        keep.setFocus()

    @Slot()
    def leave(self) -> None:
        """Close the window without asking, for example after the question was answered."""
        self._leaves = True
        self.close()

    def _drop_session(self) -> None:
        self._drop_builder()
        view, self.session_view = self.session_view, None
        workspace, self.workspace = self.workspace, None
        self._first_minute = None
        self.messages.show_key(wanted=True)
        if view is not None:
            view.save()
            view.close()
            self.statusBar().removeWidget(view.chips)
            for gone in (view.chips, view):
                gone.deleteLater()
        if workspace is not None:
            self._drop_messages()
            workspace.view.close_view()
            self.stack.removeWidget(workspace)
            workspace.deleteLater()
            self.commands.update_actions()

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask whether to keep an unsaved session; then stop the timers, close the 3D view, then the journal."""
        is_unsaved = self.controller.unsaved_pokes or (self.builder is not None and self.builder.is_changed)
        if not self._leaves and is_unsaved:
            self._confirm_unsaved(self.leave)
            event.ignore()
            return
        self._settings.setValue("window/geometry", self.saveGeometry())
        self.commands.save(self._settings)
        # Hidden first: closing may take as long as a read, and a window that does not answer looks broken.
        self.hide()
        self.pedals.stop()
        if self._import is not None:
            self._import.end()
        self.messages.stop()
        self.controller.stop()
        if self.session_view is not None:
            self.session_view.save()
            self.session_view.close()
        if self.workspace is not None:
            self.workspace.view.close_view()
        if self.builder is not None:
            self.builder.close_page()
        self.controller.close()
        self.player.close()
        super().closeEvent(event)


def _import_session_view() -> None:
    import app.session_view  # noqa: F401
