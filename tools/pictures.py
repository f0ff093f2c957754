"""Make the pictures of the window in `docs/pictures` anew: `python -m tools.pictures`, about ten minutes.

Opens the window on seeded simulated sessions, on no display, and grabs it where there is what a picture is to show. Those of
a session in progress differ a little from run to run, since the devices send in real time: look at each.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QSettings
from PySide6.QtWidgets import QApplication

from app.session.controller import Controller
from app.session.opening import OpenRequest, find_scene, server_command
from app.sound.player import Player
from app.theme import Choice
from app.window import Theme, Window
from skincal.taxels.result import Method

PICTURES = Path(__file__).resolve().parent.parent / "docs" / "pictures"
SMALL, LARGE = (1280, 800), (1440, 860)
DRAWN_S, SOON_S = 0.5, 0.06
"""s. By then all is drawn; by then the next tick is, and the hand has not gone on."""
WAIT_S = 600.0


class Photographed:
    """The window on one session, while its pictures are made."""

    def __init__(self, request: OpenRequest, choice: Choice, size: tuple[int, int]) -> None:
        settings = QSettings(str(Path("settings.ini").absolute()), QSettings.Format.IniFormat)
        settings.setValue("window/sounds", False)
        settings.setValue("window/turn", False)
        self.theme = Theme(choice)
        self.window = Window(Controller(Path("documents")), self.theme, settings, Path("documents"), Player())
        self.window.resize(*size)
        self.window.show()
        self.window.controller.open(request)
        self.until(lambda: self.window.session_view is not None and self.window.session_view.state is not None)
        assert self.window.session_view is not None
        self.view = self.window.session_view
        self.until(lambda: self.view.workspace.view.list_layers() != () and self.view.workspace.readings.curves is not None)

    def until(self, there: Callable[[], bool]) -> None:
        """Let the window work until something is there."""
        end = time.monotonic() + WAIT_S
        while not there():
            if time.monotonic() > end:
                sys.exit("pictures: what a picture is to show did not come; try another seed.")
            QApplication.processEvents()
            time.sleep(0.001)

    def until_said(self, headline: str, detail: str = "", after: int = 0) -> None:
        """Wait until the line below says something, as it begins and what its second line holds, `after` so many pokes."""
        now = self.view.workspace.now

        def said() -> bool:
            known = len(self.view.state.snapshot.pokes) if self.view.state else 0
            return known >= after and now.headline.text().startswith(headline) and detail in now.detail.text()

        self.until(said)

    def grab(self, name: str, seconds: float = DRAWN_S) -> None:
        """Write the picture of the window, with the dialog in front of it."""
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end)
        picture = self.window.grab()
        dialog = QApplication.activeModalWidget()
        if dialog is not None:
            dialog.render(picture, (self.window.rect().center() - dialog.rect().center()))
        picture.save(str(PICTURES / f"{name}.png"))
        print(name, flush=True)


def guided(seed: int, errors: str) -> OpenRequest:
    """Return a simulated forearm with an operator that is quick to do what the window asks for."""
    command = server_command(None)
    return OpenRequest(server=(*command, "--seed", str(seed), "--errors", errors, "--pace", "2"))


def take_good_rig() -> None:
    """A press, a rejection, and the window as `start.py` opens it."""
    taken = Photographed(guided(7, "noise"), Choice.LIGHT, LARGE)
    taken.view.workspace.show_tab("Taxel")
    taken.until_said("hold still", "aim", 25)
    taken.grab("guide-contact", SOON_S)
    taken.until_said("rejected", after=25)
    taken.grab("guide-rejected", SOON_S)
    taken.window.resize(*SMALL)
    taken.view.workspace.show_tab("Readings")
    taken.until_said("counted", "Next", 60)
    taken.grab("window", SOON_S)
    taken.window.close()


def take_paper_rig() -> None:
    """What landmarks say of a wrong rig, and a verdict that is not to be believed."""
    taken = Photographed(guided(3, "paper"), Choice.LIGHT, SMALL)
    taken.view.workspace.show_tab("Rig")
    taken.until(lambda: bool(taken.view.state and taken.view.state.offers))
    taken.grab("rig", SOON_S)
    taken.theme.choose(Choice.DARK)
    taken.window.resize(*LARGE)
    taken.view.show_method(Method.MODULES)
    taken.until(lambda: taken.view.ends)
    taken.view.ask_verdict(taken.window)
    taken.grab("guide-verdict")
    taken.window.close()


def take_errors() -> None:
    """The course of the errors of a recorded session."""
    from skincal.mesh.load import load_surface
    from skincal.model.scene import load_scene
    from skincal.simulate.faults import RigErrors
    from skincal.simulate.virtual_session import simulate_session

    scene = load_scene(find_scene(None))
    assert scene.surface is not None
    simulate_session(scene, load_surface(scene.surface)[0], Path("trial"), 252, 1, RigErrors.noise())
    taken = Photographed(OpenRequest(session=Path("trial")), Choice.DARK, SMALL)
    taken.view.workspace.show_tab("Errors")
    taken.grab("errors", 10.0)
    taken.window.close()


if __name__ == "__main__":
    os.environ["QT_QPA_PLATFORM"] = "offscreen"
    application = QApplication(sys.argv[:1])
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for take in (take_errors, take_good_rig, take_paper_rig):
            if len(sys.argv) < 2 or take.__name__.removeprefix("take_") in sys.argv[1:]:
                take()
