"""The application around the window: settings, log, and what happens to an exception that nobody caught."""

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
LOG_BYTES = 1_000_000
"""A log file grows to this size; one older is kept."""
GARBAGE = (10_000, 20, 20)
"""When cyclic garbage is looked for, as for `gc.set_threshold`. A full look stops every thread: 50 ms once VTK and pyqtgraph
are imported, and by default the imports themselves bring several about. So it takes four million new objects; what pokes leave
is a thousand."""
COLLECT_MS = 200
"""How often it is seen whether that is due."""
SWITCH_S = 0.0005
"""s. Python's thread switch: at its default of 5 ms background work delays the picture seven times as much (measured)."""


def documents_folder() -> Path:
    """Return the folder under which sessions are kept."""
    place = QStandardPaths.writableLocation(QStandardPaths.StandardLocation.DocumentsLocation)
    # Qt returns an empty text where the system names no such place.
    return Path(place or Path.home()) / "skincal"


def request_of(options: argparse.Namespace) -> OpenRequest:
    """Return what to open for the options of the command line.

    Raises
    ------
    InputError
        They contradict each other, or what they name is no scene or no session.
    """
    from skincal.journal.reader import find_segments
    from skincal.model.scene import load_scene

    addresses = Addresses(options.wrench, options.skin, options.joints)
    check_addresses(addresses)
    if options.targets:
        from skincal.robot.target_server import parse_port

        parse_port(options.targets)
        if not addresses and options.session is None:
            raise InputError("--targets asks a robot, and no device is named; expected --wrench and --skin with it.")
    if options.session is not None:
        find_segments(options.session)
        return OpenRequest(session=options.session, addresses=addresses, targets=options.targets)
    if options.scene is not None and options.scene.suffix.lower() in MESHES:
        return _mesh_request(options)
    # The usual scene is looked up later, beside the window: that takes longer than the window itself.
    scene = None if options.scene is None else find_scene(options.scene)
    if scene is not None:
        # Refused before there is a window that could show nothing.
        load_scene(scene)
    folder = options.new
    if folder is None and addresses:
        folder = dated_folder(documents_folder(), datetime.now().astimezone())
    demo = scene is None and folder is None
    server = server_command(scene)
    return OpenRequest(scene=scene, addresses=addresses, server=server, folder=folder, targets=options.targets, demo=demo)


def _mesh_request(options: argparse.Namespace) -> OpenRequest:
    """Return what to open for a mesh in place of a scene; InputError where it is to be recorded already."""
    seen = [f"--{name}" for name in ("wrench", "skin", "joints", "targets", "new") if getattr(options, name)]
    if seen:
        raise InputError(
            f"{options.scene}: is a mesh, given together with {' and '.join(seen)}; expected a scene, which says what a mesh "
            "cannot. Open the mesh alone: the window makes a scene of it and says what is missing."
        )
    if not options.scene.is_file():
        raise InputError(f"{options.scene}: there is no such file; check the path.")
    return OpenRequest(mesh=options.scene)


class Faults(QObject):
    """Brings an exception that nobody caught to the operator, from any thread; the program goes on."""

    happened = Signal(str)

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def install(self) -> Callable[[], None]:
        """Take the place of Python's hooks; return what puts them back."""
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
        LOG.critical("a fault of the program", exc_info=(kind, error, trace))
        self.happened.emit(f"A fault of the program: {kind.__name__}: {error}. The recording goes on; details are in the log.")

    def _caught_in_thread(self, args: threading.ExceptHookArgs) -> None:
        if args.exc_value is not None:
            self._caught(args.exc_type, args.exc_value, args.exc_traceback)


def start_log() -> str:
    """Log to a file in the user's data and to stderr; return why there is no file, empty where there is."""
    path = Path(QStandardPaths.writableLocation(QStandardPaths.StandardLocation.AppLocalDataLocation)) / "skincal.log"
    handlers: list[logging.Handler] = [logging.StreamHandler()]
    failure = ""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handlers.append(logging.handlers.RotatingFileHandler(path, maxBytes=LOG_BYTES, backupCount=1, encoding="utf-8"))
    except OSError as error:
        failure = f"{path}: the log cannot be written ({error.strerror}). Everything else works."
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s", handlers=handlers)
    return failure


def collect_in_window(application: QApplication) -> QTimer:
    """Look for cyclic garbage in the window's thread alone, from now on; return the timer that does.

    Python looks for it in whichever thread makes objects: a worker would end widgets that Qt still uses, and the program dies.
    """
    gc.disable()
    timer = QTimer(application)
    timer.timeout.connect(_collect_what_is_due)
    timer.start(COLLECT_MS)
    return timer


def _collect_what_is_due() -> None:
    # Python goes on counting while its own looks are off.
    counts = gc.get_count()
    due = [generation for generation, most in enumerate(GARBAGE) if counts[generation] > most]
    if due:
        # The oldest that is due: the younger ones go with it.
        gc.collect(due[-1])


def run_window(request: OpenRequest, player: Player | None = None) -> int:
    """Open the window and return the exit code once it is closed: 1 where a fault of the program happened.

    Parameters
    ----------
    player : plays the sounds; on the desktop's sound device if None
    """
    sys.setswitchinterval(SWITCH_S)
    application = QApplication.instance() or QApplication(sys.argv[:1])
    assert isinstance(application, QApplication)
    collect_in_window(application)
    # Qt names the folder of the log by it.
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
        # Python runs a handler between any two steps of the program, in the middle of a write, too: it only asks for the end.
        signal.signal(number, lambda *_: QMetaObject.invokeMethod(window, "leave", Qt.ConnectionType.QueuedConnection))
    window.show()
    # Everything else waits until the window is on the screen.
    QTimer.singleShot(0, lambda: begin(window, request))
    try:
        application.exec()
    finally:
        remove()
        player.close()
    return 1 if faults.count else 0


def begin(window: Window, request: OpenRequest) -> None:
    """Start the log and open what was asked for, once the window is on the screen; a log is no reason to open nothing."""
    failure = start_log()
    window.open(request)
    if failure:
        window.tell(Message(failure, error=True))
    # While the scene is read beside it the window has nothing else to do; later it would stand still for this.
    best_canvas()
