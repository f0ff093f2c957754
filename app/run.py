"""The application around the window: settings, log, uncaught exceptions."""

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
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType

from PySide6.QtCore import QMetaObject, QObject, QSettings, QStandardPaths, Qt, QTimer, Signal
from PySide6.QtGui import QFont, QFontDatabase
from PySide6.QtWidgets import QApplication

from app.qt_types import skip_feature_search
from app.scene3d import canvas
from app.session.controller import Controller
from app.session.opening import (
    DEMO_SCENES,
    PART_FILES,
    Addresses,
    OpenRequest,
    check_addresses,
    check_streams,
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
MAX_LOG_FILE_BYTES = 1_000_000  # Size of the log file; one older file is kept
GC_THRESHOLDS = (10_000, 20, 20)
"""As for `gc.set_threshold`. A full collection stops every thread for 50 ms once VTK and pyqtgraph are imported, and with the
default values the imports alone cause several. With these it needs four million new objects; a poke leaves a thousand."""
GARBAGE_COLLECTION_PERIOD_MS = 200
FIRST_COLLECTION_MS = 3000  # Until then nearly all new objects are of imports and of the opening: none of them is garbage
FALLBACK_FONTS = "mpl-data/fonts/ttf/DejaVuSans*.ttf"
"""Fonts of the package matplotlib, for a system without any: a server, a container."""
FALLBACK_FAMILIES = {"Sans Serif": "DejaVu Sans", "Serif": "DejaVu Sans", "Monospace": "DejaVu Sans Mono"}
"""By the names that Qt lists even on a system without fonts."""
PYTHON_THREAD_SWITCH_INTERVAL_S = 0.0005
"""With Python's default of 5 ms, background work delays the picture seven times as much (measured)."""


def documents_folder() -> Path:
    """Return the folder for sessions."""
    place = QStandardPaths.writableLocation(QStandardPaths.StandardLocation.DocumentsLocation)
    # Qt returns an empty text if the system has no such folder.
    return Path(place or Path.home()) / "skincal"


def request_of(options: argparse.Namespace) -> OpenRequest:
    """Make the request for the options of the command line.

    Raises
    ------
    InputError
        They contradict each other, or name something that is no scene or no session.
    """
    from skincal.journal.reader import find_segments
    from skincal.model.scene import load_scene

    addresses = Addresses(options.wrench, options.skin, options.joints, options.tip, options.tool)
    check_addresses(addresses)
    if options.targets:
        from skincal.robot.targets import check_targets

        check_targets(options.targets)
        if not addresses and options.session is None:
            raise InputError("--targets asks a robot, and no device is named; expected --wrench and --skin with it.")
    if options.session is not None:
        find_segments(options.session)
        return OpenRequest(session=options.session, addresses=addresses, targets=options.targets)
    if options.scene is not None and options.scene.suffix.lower() in PART_FILES:
        return _part_request(options)
    # The default scene is found later, in the background: that takes longer than the window itself.
    scene = None if options.scene is None else find_scene(options.scene)
    if scene is not None:
        # Refused before a window opens.
        loaded = load_scene(scene)
        if addresses:
            check_streams(addresses, loaded)
    folder = options.new
    if folder is None and addresses:
        folder = dated_folder(documents_folder(), datetime.now().astimezone())
    demo = scene is None and not addresses
    server = server_command(scene)
    return OpenRequest(scene=scene, addresses=addresses, server=server, folder=folder, targets=options.targets, demo=demo)


def _part_request(options: argparse.Namespace) -> OpenRequest:
    """Make the request for a mesh or a URDF in place of a scene; `InputError` if devices or a folder are named with it."""
    seen = [f"--{name}" for name in ("wrench", "skin", "joints", "tip", "tool", "targets", "new") if getattr(options, name)]
    if seen:
        raise InputError(
            f"{options.scene}: is a mesh or a URDF, given together with {' and '.join(seen)}; expected a scene. Open the file "
            "alone: the window makes a scene of it."
        )
    if not options.scene.is_file():
        raise InputError(f"{options.scene}: there is no such file; check the path.")
    return OpenRequest(part=options.scene)


def robot_demo(sensor: str = "below") -> OpenRequest:
    """Make the request for the demonstration with a robot; `sensor` is one of `DEMO_SCENES`.

    Raises InputError: the physics engine is missing.
    """
    from skincal.physics.engine import load_mujoco

    load_mujoco()
    name = DEMO_SCENES[sensor]
    scene = find_scene(Path(name)) if name else None
    return OpenRequest(scene=scene, server=server_command(scene, robot=True), demo=True, robot=True)


class Faults(QObject):
    """Shows uncaught exceptions of any thread to the operator; the program continues."""

    happened = Signal(str)

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def install(self) -> Callable[[], None]:
        """Install the handlers of unexpected errors; return a function that restores Python's own."""
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
    """Log to a file in the user's data and to stderr; return why there is no file, or an empty text."""
    path = Path(QStandardPaths.writableLocation(QStandardPaths.StandardLocation.AppLocalDataLocation)) / "skincal.log"
    handlers: list[logging.Handler] = [logging.StreamHandler()]
    failure = ""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handlers.append(
            logging.handlers.RotatingFileHandler(path, maxBytes=MAX_LOG_FILE_BYTES, backupCount=1, encoding="utf-8")
        )
    except OSError as error:
        failure = f"{path}: the log cannot be written ({error.strerror}). Everything else works."
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s", handlers=handlers)
    return failure


def collect_in_window(application: QApplication) -> QTimer:
    """Collect cyclic garbage in the window's thread only, from now on; return its timer.

    Python collects in any thread that makes objects: a worker would delete widgets that Qt still uses, which ends the program.
    """
    gc.disable()
    timer = QTimer(application)
    timer.timeout.connect(_collect_garbage)
    timer.setInterval(GARBAGE_COLLECTION_PERIOD_MS)
    QTimer.singleShot(FIRST_COLLECTION_MS, timer, timer.start)
    return timer


def _collect_garbage() -> None:
    # Python counts objects while its own collection is off.
    counts = gc.get_count()
    due = [generation for generation, most in enumerate(GC_THRESHOLDS) if counts[generation] > most]
    if due:
        # The younger generations are collected with the oldest.
        gc.collect(due[-1])


def skip_open_session(controller: Controller, window: Window) -> None:
    """Leave the objects that opening a session makes out of collections, until the session closes.

    They are hundreds of thousands for a whole body and live as long as the session. A look at them takes a tenth of a second.
    """
    # `freeze` looks at no object.
    for made in (controller.part_loaded, controller.session_opened):
        made.connect(lambda _: gc.freeze())
    window.view_ready.connect(gc.freeze)
    controller.released.connect(gc.unfreeze)


def add_fallback_fonts() -> None:
    """Use the fonts of matplotlib if the system has none, since Qt would draw squares."""
    package = find_spec("matplotlib")
    if package is None or package.origin is None or not set(QFontDatabase.families()) <= FALLBACK_FAMILIES.keys():
        return
    for font in Path(package.origin).parent.glob(FALLBACK_FONTS):
        QFontDatabase.addApplicationFont(str(font))
    for alias, family in FALLBACK_FAMILIES.items():
        QFont.insertSubstitution(alias, family)
    QApplication.setFont(QFont(FALLBACK_FAMILIES["Sans Serif"]))


def run_window(request: OpenRequest, player: Player | None = None) -> int:
    """Open the window; return the exit code when it is closed: 1 after an uncaught exception.

    Parameters
    ----------
    player : plays the sounds; default: the desktop's sound device
    """
    sys.setswitchinterval(PYTHON_THREAD_SWITCH_INTERVAL_S)
    skip_feature_search()
    # A process of its own tries to draw while the window is made.
    canvas.early_egl_probe()
    application = QApplication.instance() or QApplication(sys.argv[:1])
    assert isinstance(application, QApplication)
    collect_in_window(application)
    add_fallback_fonts()
    # The folder of the log has this name.
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
        # Python runs a handler at any moment, also in the middle of a write: it only requests the end.
        signal.signal(number, lambda *_: QMetaObject.invokeMethod(window, "leave", Qt.ConnectionType.QueuedConnection))
    skip_open_session(controller, window)
    window.show()
    QTimer.singleShot(0, lambda: start_log_and_open(window, request))
    try:
        application.exec()
    finally:
        remove()
        player.close()
    return 1 if faults.count else 0


def start_log_and_open(window: Window, request: OpenRequest) -> None:
    """Start the log and open the request, after the window is on the screen. A failing log does not prevent it."""
    failure = start_log()
    window.open(request)
    if failure:
        window.tell(Message(failure, error=True))
    # Now the window is idle, since the scene is loading; later this would block it.
    canvas.get_ready(window)
