"""The application around the window: settings, log, garbage collection, and uncaught exceptions."""

from __future__ import annotations

import argparse
import gc
import logging
import logging.handlers
import signal
import sys
import threading
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from types import TracebackType

from PySide6.QtCore import QMetaObject, QObject, QSettings, QStandardPaths, Qt, QTimer, Signal
from PySide6.QtWidgets import QApplication

from app.scene3d.canvas import best_canvas
from app.session.controller import Controller
from app.session.opening import (
    MESHES,
    Addresses,
    OpenRequest,
    check_addresses,
    dated_folder,
    find_scene,
    server_command,
)
from app.sound.player import Player
from app.text.message import Message
from app.theme import Choice
from app.window import Theme, Window
from skincal.model.errors import InputError

LOG = logging.getLogger("skincal")
LOG_MAX_BYTES = 1_000_000
"""Size of a log file; one older file is kept."""
GC_THRESHOLDS = (10_000, 20, 20)
"""As for `gc.set_threshold`. A full collection stops every thread for 50 ms once VTK and pyqtgraph are imported, and with the
defaults the imports cause several. These need four million new objects; a poke leaves a thousand."""
COLLECT_PERIOD_MS = 200
THREAD_SWITCH_S = 0.0005
"""With Python's default of 5 ms, background work delays pictures seven times as much (measured)."""


def documents_folder() -> Path:
    """Give the folder of the sessions."""
    place = QStandardPaths.writableLocation(QStandardPaths.StandardLocation.DocumentsLocation)
    # Qt returns an empty text if the system names no such folder.
    return Path(place or Path.home()) / "skincal"


def request_of(options: argparse.Namespace) -> OpenRequest:
    """Make the request for the options of the command line.

    Raises
    ------
    InputError
        The options contradict each other, or name no scene or session.
    """
    from skincal.journal.reader import find_segments
    from skincal.model.scene import load_scene

    addresses = Addresses(options.wrench, options.skin, options.joints)
    check_addresses(addresses)
    if options.targets:
        from skincal.robot.target_server import parse_port

        parse_port(options.targets)
        if not addresses and options.session is None:
            raise InputError("--targets needs a robot, and no device is named: add --wrench and --skin.")
    if options.session is not None:
        find_segments(options.session)
        return OpenRequest(session=options.session, addresses=addresses, targets=options.targets)
    if options.scene is not None and options.scene.suffix.lower() in MESHES:
        return _mesh_request(options)
    # The default scene is found later, in the background: that takes longer than the window itself.
    scene = None if options.scene is None else find_scene(options.scene)
    if scene is not None:
        # Refused before the window opens.
        load_scene(scene)
    folder = options.new
    if folder is None and addresses:
        folder = dated_folder(documents_folder(), datetime.now().astimezone())
    demo = scene is None and folder is None
    server = server_command(scene)
    return OpenRequest(scene=scene, addresses=addresses, server=server, folder=folder, targets=options.targets, demo=demo)


def _mesh_request(options: argparse.Namespace) -> OpenRequest:
    """Make the request for a mesh instead of a scene; `InputError` if it should be recorded already."""
    seen = [f"--{name}" for name in ("wrench", "skin", "joints", "targets", "new") if getattr(options, name)]
    if seen:
        raise InputError(
            f"{options.scene}: is a mesh, but {' and '.join(seen)} needs a scene. Open the mesh alone: the window makes "
            "a scene of it and lists what is missing."
        )
    if not options.scene.is_file():
        raise InputError(f"{options.scene}: there is no such file; check the path.")
    return OpenRequest(mesh=options.scene)


class Faults(QObject):
    """Shows uncaught exceptions of any thread to the operator; the program continues."""

    happened = Signal(str)

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def install(self) -> Callable[[], None]:
        """Replace Python's exception hooks; return a function that restores them."""
        before = sys.excepthook, threading.excepthook
        sys.excepthook = self._caught
        threading.excepthook = self._caught_in_thread

        def remove() -> None:
            sys.excepthook, threading.excepthook = before

        return remove

    def _caught(self, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if issubclass(kind, KeyboardInterrupt):
            QApplication.quit()
            return
        self.count += 1
        LOG.critical("error in the program", exc_info=(kind, error, trace))
        self.happened.emit(f"Error in the program: {kind.__name__}: {error}. The recording continues. Details are in the log.")

    def _caught_in_thread(self, args: threading.ExceptHookArgs) -> None:
        if args.exc_value is not None:
            self._caught(args.exc_type, args.exc_value, args.exc_traceback)


def start_log() -> str:
    """Log to stderr and to a file in the user's data; return a sentence if the file is not writable, else an empty text."""
    path = Path(QStandardPaths.writableLocation(QStandardPaths.StandardLocation.AppLocalDataLocation)) / "skincal.log"
    handlers: list[logging.Handler] = [logging.StreamHandler()]
    failure = ""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handlers.append(logging.handlers.RotatingFileHandler(path, maxBytes=LOG_MAX_BYTES, backupCount=1, encoding="utf-8"))
    except OSError as error:
        failure = f"{path}: the log cannot be written ({error.strerror}). Everything else works."
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s", handlers=handlers)
    return failure


def collect_in_window(application: QApplication) -> QTimer:
    """Collect cyclic garbage only in the window's thread from now on, by the returned timer.

    Python collects in any thread that makes objects: a worker would delete widgets that Qt still uses, and the program crashes.
    """
    gc.disable()
    timer = QTimer(application)
    timer.timeout.connect(_collect_what_is_due)
    timer.start(COLLECT_PERIOD_MS)
    return timer


def _collect_what_is_due() -> None:
    # Python counts objects also while its own collection is off.
    counts = gc.get_count()
    due = [generation for generation, most in enumerate(GC_THRESHOLDS) if counts[generation] > most]
    if due:
        gc.collect(due[-1])


def run_window(request: OpenRequest, player: Player | None = None) -> int:
    """Run the window and return the exit code: 1 after an uncaught exception.

    Parameters
    ----------
    player : plays the sounds; `None` for the desktop's sound device
    """
    sys.setswitchinterval(THREAD_SWITCH_S)
    application = QApplication.instance() or QApplication(sys.argv[:1])
    assert isinstance(application, QApplication)
    collect_in_window(application)
    # Part of the path of the log.
    application.setApplicationName("skincal")
    faults = Faults()
    remove = faults.install()
    settings = QSettings("skincal", "skincal")
    theme = Theme(Choice(settings.value("theme", Choice.SYSTEM.value)))
    documents = documents_folder()
    controller = Controller(documents)
    player = player or Player()
    window = Window(controller, theme, settings, documents, player)
    faults.happened.connect(lambda text: window.tell(Message(text, error=True)))
    for number in (signal.SIGINT, signal.SIGTERM):
        # The handler may interrupt a write: it only asks for the end.
        signal.signal(number, lambda *_: QMetaObject.invokeMethod(window, "leave", Qt.ConnectionType.QueuedConnection))
    window.show()
    # After the window is on the screen.
    QTimer.singleShot(0, lambda: open_first(window, request))
    try:
        application.exec()
    finally:
        remove()
        player.close()
    return 1 if faults.count else 0


def open_first(window: Window, request: OpenRequest) -> None:
    """Start the log and open the first session, whether or not the log is writable."""
    failure = start_log()
    window.open(request)
    if failure:
        window.tell(Message(failure, error=True))
    # Now, while the scene is read in the background; later it would block the window.
    best_canvas()
