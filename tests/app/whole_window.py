"""The whole window on a real (virtual) display, with what a test does to it."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from PySide6.QtCore import QProcess, QSettings, Qt
from PySide6.QtTest import QTest

from app.session.controller import Controller
from app.session.opening import OpenRequest, server_command
from app.session.recording import Recording
from app.sound.player import Player
from app.text.message import Message
from app.theme import Choice
from app.window import Theme, Window
from app.workers.device_process import DeviceProcess
from skincal.contacts.outcome import Contact
from skincal.model.scene import resource

HAND = ("--careful", "--errors", "none", "--pace", "4")
"""A hand without slips, on a rig without errors; quick between its pokes, since a window that waits costs time, too."""
POLL_MS = 20
POKE_MS = 60_000  # A poke takes about three seconds; a busy machine gets twenty times as long
OPEN_MS = 100_000  # A report or an import takes some seconds


class Listener(Player):
    """Writes down what is to be heard, and plays nothing."""

    def __init__(self) -> None:
        super().__init__(speech=("true",))
        self.played: list[tuple[str, str]] = []

    def get_ready(self) -> None:
        self.found(True)

    def play(self, sound, word="") -> None:
        if self.on:
            self.played.append((sound.name, word))


class Bench:
    """A window with what it needs, on the screen."""

    def __init__(self, qtbot, folder: Path, player: Player | None = None) -> None:
        self.qtbot = qtbot
        self.documents = folder / "documents"
        self.controller = Controller(self.documents)
        self.theme = Theme(Choice.DARK)
        self.messages: list[Message] = []
        self.controller.said.connect(self.messages.append)
        self.player = player or Listener()
        self.window = Window(self.controller, self.theme, QSettings("skincal", "test"), self.documents, self.player)
        self.window.resize(1280, 720)
        # Pokes in a temporary recording would else be asked about at the end of a test.
        qtbot.addWidget(self.window, before_close_func=lambda window: window.leave())
        with qtbot.waitExposed(self.window):
            self.window.show()

    def open(self, plan: OpenRequest) -> None:
        with self.qtbot.waitSignal(self.controller.session_opened, timeout=OPEN_MS):
            self.window.open(plan)
        # The panels come some moments after the session.
        self.until(lambda: self.window.session_view.workspace.current_panel() is not None, 5000)
        self.qtbot.wait(50)

    def open_served(self, name: str = "icub-forearm", **changes) -> None:
        scene = resource(f"scenes/{name}/scene.toml")
        self.open(OpenRequest(scene=scene, server=(*server_command(scene), *HAND), **changes))

    def until(self, what, timeout: int = POKE_MS) -> None:
        end = time.monotonic() + timeout / 1000.0
        while not what():
            assert time.monotonic() < end, f"it took longer than {timeout} ms"
            self.qtbot.wait(POLL_MS)

    def panel(self, kind):
        """The panel of a class."""
        return self.window.session_view.workspace.panel(kind)

    @property
    def snapshot(self):
        return self.window.session_view.state.snapshot

    @property
    def recording(self) -> Recording:
        """What is open, with the pipeline behind it; the window shows snapshots of it alone."""
        return self.controller._recording

    def device_pid(self) -> int:
        """The process that serves the simulated devices."""
        return self.controller.findChild(DeviceProcess).findChild(QProcess).processId()

    def accepted(self) -> list[Contact]:
        return [p.outcome for p in self.snapshot.pokes if isinstance(p.outcome, Contact) and not p.excluded]

    def until_all_is_there(self) -> None:
        """Wait for the 3D view and the curves, and take the messages away, so that nothing moves any more."""
        workspace = self.window.session_view.workspace
        self.until(lambda: workspace.view.list_layers() != (), OPEN_MS)
        while self.window.messages.isVisible():
            self.window.messages.dismiss()
        self.qtbot.wait(50)

    def until_all_is_taken_in(self) -> None:
        """Wait after a pause until the readers ended, and what they had read is worked on and shown."""
        recording = self.recording
        self.until(lambda: not any(thread.name.startswith("reader ") for thread in threading.enumerate()), 5000)
        self.until(lambda: not recording.has_backlog and not recording.pipeline.session.unsolved)

    def key(self, key, modifier=Qt.KeyboardModifier.NoModifier) -> None:
        self.window.activateWindow()
        self.until(self.window.isActiveWindow, 5000)
        QTest.keyClick(self.window, key, modifier)
        self.qtbot.wait(20)
