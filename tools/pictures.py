"""Make the pictures of README and `docs/` again: `python -m tools.pictures`; words after it choose some (`window part`).

- `window`, `errors`, `rig`, `robot`, `cobot`, `fingertip`: the window on seeded simulated sessions, without a display, in about
  fifteen minutes. Devices send in real time, so that pictures differ slightly from run to run: check each.
- `part`: the steps of the tutorial `docs/first-part.md`; needs the package icub-models.
- `headless`: the 3D picture without a display.
- `studies`: the figures of `NAME.json` in the folder `--measured`. A missing study is run, which takes up to half an hour.

The sentences that a window shows are stored in `docs/pictures/sentences.json`, and a test finds those that become old.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from PIL import Image
from PySide6.QtCore import QSettings, Qt
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractScrollArea,
    QApplication,
    QComboBox,
    QGroupBox,
    QHeaderView,
    QLabel,
    QLineEdit,
    QListWidget,
    QMenuBar,
    QPlainTextEdit,
    QTabBar,
    QTextEdit,
    QWidget,
)

from app.headless import SIMULATED_POKE_COUNT, SIMULATED_RIG_RANDOM_SEED
from app.panels.message_bar import MAX_QUEUED_MESSAGES
from app.panels.widgets import ElidedLabel
from app.run import robot_demo
from app.scene3d.session_picture import picture
from app.session.controller import Controller
from app.session.opening import OpenRequest, find_scene, server_command
from app.sound.player import Player
from app.theme import Choice
from app.window import Theme, Window
from skincal.cli.simulated_robot import record_robot
from skincal.interface.scene import Scene
from skincal.interface.session import simulate
from skincal.model.scene import load_scene, resource
from skincal.part.part import load_scene_surface
from skincal.part.tool_draft import Rig
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.virtual_session import simulate_session
from skincal.studies import load_study
from skincal.taxels.result import Method
from tools.picture_sentences import PICTURES_FOLDER, STUDY_PICTURES, choose_texts, program_texts, store_sentences

PART_PICTURE_COLOURS = 200
FINGERTIP_SEED, FINGERTIP_POKES, FINGERTIP_TAXEL = 1, 181, 12
SHOWN_SENTENCES: dict[str, list[str]] = {}
"""By picture of a window made here, the texts that it shows."""


def list_texts(window: QWidget) -> Iterator[str]:
    """List the texts that a window shows, from its widgets; the 3D view's own labels are left out."""
    for widget in window.findChildren(QWidget):
        # The viewport of a list or a heading covers it.
        seen = widget.viewport() if isinstance(widget, QAbstractScrollArea) else widget
        if not widget.isVisible() or seen.visibleRegion().isEmpty() or widget.window() is not window:
            continue
        match widget:
            case QLabel() | ElidedLabel() | QAbstractButton():
                yield widget.text()
            case QGroupBox():
                yield widget.title()
            case QComboBox():
                yield widget.currentText()
            case QLineEdit() if not widget.text():
                yield widget.placeholderText()
            case QTabBar():
                yield from (widget.tabText(index) for index in range(widget.count()))
            case QMenuBar():
                yield from (action.text() for action in widget.actions() if action.isVisible())
            case QHeaderView() if (model := widget.model()) is not None:
                count = model.columnCount() if widget.orientation() == Qt.Orientation.Horizontal else 0
                yield from (str(model.headerData(column, widget.orientation())) for column in range(count))
            case QTextEdit() | QPlainTextEdit():
                yield widget.toPlainText()
            case QListWidget():
                yield from (widget.item(row).text() for row in range(widget.count()))
            case _:
                pass


class WindowPhotographer:
    """A window without a screen, and its pictures."""

    def __init__(self, name: str, choice: Choice, size: tuple[int, int]) -> None:
        settings, documents = QSettings(f"{name}.ini", QSettings.Format.IniFormat), Path("documents").absolute()
        settings.setValue("window/sounds", False)
        self.theme = Theme(choice)
        self.window = Window(Controller(documents), self.theme, settings, documents, Player())
        # There is no screen to maximize on.
        self.window.setWindowState(Qt.WindowState.WindowNoState)
        self.window.resize(*size)
        self.window.show()

    def until(self, there: Callable[[], bool]) -> None:
        """Let the window work until a condition is true."""
        end = time.monotonic() + 900.0
        while not there():
            if time.monotonic() > end:
                sys.exit("pictures: what a picture is to show did not come; try another seed.")
            QApplication.processEvents()
            time.sleep(0.001)

    def grab(self, name: str, seconds: float = 0.06) -> Path:
        """Write a picture of the window and its open dialog after `seconds`; return its path."""
        self.window.show()
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end)
        # The folder of this run says nothing to a reader.
        self.window.where.setText(self.window.where.text().replace(str(Path.cwd()), str(Path("~", "skincal"))))
        picture, dialog = self.window.grab(), QApplication.activeModalWidget()
        if dialog is not None:
            dialog.render(picture, self.window.rect().center() - dialog.rect().center())
        shown = [*list_texts(self.window), *([] if dialog is None else list_texts(dialog))]
        SHOWN_SENTENCES[name] = choose_texts(shown, program_texts())
        path = PICTURES_FOLDER / f"{name}.png"
        picture.save(str(path))
        return path


class SessionPhotographer(WindowPhotographer):
    """A window on one session, and its pictures."""

    def __init__(self, request: OpenRequest, choice: Choice, tab: str, size: tuple[int, int] = (1280, 800)) -> None:
        super().__init__(tab, choice, size)
        self.window.controller.open(request)
        self.until(lambda: self.window.session_view is not None and self.window.session_view.state is not None)
        assert self.window.session_view is not None
        self.view = self.window.session_view
        self.until(lambda: self.view.workspace.view.list_layers() != ())
        self.view.workspace.show_tab(tab)

    def dismiss_messages(self) -> None:
        """Remove all messages, which would cover the part."""
        for _ in range(MAX_QUEUED_MESSAGES):
            self.window.messages.dismiss()

    def until_text(self, words: str, detail: str, pokes: int) -> None:
        """Wait until the line below the views has `words`, the one below it `detail`, and the session `pokes`."""
        now = self.view.workspace.now

        def has_text() -> bool:
            state = self.view.state
            shown = state is not None and len(state.snapshot.pokes) >= pokes and state.behind_s < 0.2
            return shown and words in f"{now.result.text()} {now.headline.text()}" and detail in now.detail.text()

        self.until(has_text)


def draw_errors() -> None:
    """Write the picture of a session's errors."""
    forearm = load_scene(find_scene(None))
    simulate_session(forearm, load_scene_surface(forearm)[0], Path("trial"), 252, 1, RigErrors.noise())
    course = SessionPhotographer(OpenRequest(session=Path("trial")), Choice.DARK, "Errors", (1280, 1100))
    course.grab("errors", 10.0)
    course.window.leave()


def draw_window() -> None:
    """Write the pictures of a session on a good rig."""
    good = SessionPhotographer(OpenRequest(server=(*server_command(None), "--pace", "2")), Choice.LIGHT, "Taxel", (1440, 860))
    # The modules method would end before the last pictures.
    good.view.show_method(Method.SURFACE)
    good.until_text("Hold still", "off target", 25)
    good.dismiss_messages()
    good.grab("guide-contact")
    good.view.workspace.view.set_turning(False)
    good.view.workspace.view.reset_camera()
    good.until_text("rejected", "", 30)
    good.dismiss_messages()
    good.grab("guide-rejected")
    good.view.workspace.show_tab("Readings")
    good.window.resize(1280, 800)
    good.until_text("accepted", "", 60)
    good.dismiss_messages()
    good.grab("window")
    good.window.leave()


def draw_rig() -> None:
    """Write the pictures of a rig with the paper's errors."""
    wrong = SessionPhotographer(OpenRequest(server=(*server_command(None), "--errors", "paper")), Choice.LIGHT, "Rig")
    # Hidden, it does not fall behind the operator on a busy machine.
    wrong.window.hide()
    wrong.until(lambda: any(offer.frame is None for offer in (wrong.view.state.offers if wrong.view.state else ())))
    wrong.grab("rig", 1.0)
    wrong.window.hide()
    wrong.theme.choose(Choice.DARK)
    wrong.view.show_method(Method.MODULES)
    wrong.until(lambda: wrong.view.state is not None and wrong.view.state.may.ends)
    wrong.view.ask_verdict()
    wrong.grab("guide-verdict", 1.0)
    wrong.window.leave()


def draw_robot() -> None:
    """Write the picture of the window while a simulated robot pokes."""
    robot = SessionPhotographer(OpenRequest(server=server_command(None, robot=True), robot=True), Choice.LIGHT, "Readings")
    robot.until(lambda: robot.view.state is not None and len(robot.view.state.snapshot.contacts) >= 14)
    robot.until_text("Hold still", "", 0)
    robot.dismiss_messages()
    robot.grab("robot")
    robot.window.leave()


def draw_cobot() -> None:
    """Write the picture of the three rigs to choose from, and that of the window while a simulated cobot pokes."""
    page = WindowPhotographer("cobot part", Choice.LIGHT, (1280, 800))
    page.window.ask_part(resource("scenes/icub-forearm/forearm.obj"))
    builder = page.window.builder
    assert builder is not None
    page.until(lambda: builder.is_settled and builder.view.list_layers() != ())
    builder.show_step(builder.sensor)
    builder.sensor.rig.buttons[Rig.ON_TOOL].click()
    page.until(lambda: builder.is_settled)
    page.grab("rigs", 0.5)
    page.window.leave()
    cobot = SessionPhotographer(robot_demo("tool"), Choice.DARK, "Readings")
    cobot.until(lambda: cobot.view.state is not None and len(cobot.view.state.snapshot.contacts) >= 14)
    cobot.until_text("Hold still", "", 0)
    cobot.dismiss_messages()
    cobot.grab("cobot")
    cobot.window.leave()


def draw_fingertip() -> None:
    """Write the picture of a fingertip of three axes that a simulated robot calibrated."""
    scene = load_scene(find_scene(Path("fingertip")))
    record_robot(scene, Path("fingertip"), FINGERTIP_POKES, FINGERTIP_SEED, threading.Event(), "all")
    tip = SessionPhotographer(OpenRequest(session=Path("fingertip")), Choice.LIGHT, "Taxel", (1280, 1100))
    tip.view.select_taxel(FINGERTIP_TAXEL)
    # The force axes of 30 pokes would cover the axes of the taxels.
    tip.view.workspace.view.hide_layers(frozenset({"axes"}))
    tip.dismiss_messages()
    tip.grab("fingertip", 2.0)
    tip.window.leave()


def draw_part() -> None:
    """Write the pictures of the tutorial on a part of one's own."""
    from tools.first_part import find_icub, walk_tutorial

    part = WindowPhotographer("part", Choice.LIGHT, (1280, 720))
    # The page shows the robot's path, and not that of an environment.
    robot = find_icub()
    Path("iCub").symlink_to(robot.parents[2])
    urdf = Path("iCub", *robot.parts[-3:]).absolute()
    for name in walk_tutorial(part.window, urdf, part.until, Path("documents/forearm.json").absolute()):
        path = part.grab(f"part-{name}", 0.3)
        # A quarter of the size, and no eye sees the difference.
        Image.open(path).convert("RGB").quantize(PART_PICTURE_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    part.window.leave()


def draw_headless() -> None:
    """Write the picture of a session without a display."""
    session = simulate(Scene.load(find_scene(None)), SIMULATED_POKE_COUNT, SIMULATED_RIG_RANDOM_SEED)
    # Otherwise the old picture would be kept as a backup.
    (PICTURES_FOLDER / "headless.png").unlink(missing_ok=True)
    picture(session.scene.part, session.results.snapshot, Method(session.method), PICTURES_FOLDER / "headless.png")


def draw_studies(measured: Path) -> None:
    """Write the figures of the studies that the docs show."""
    measured.mkdir(parents=True, exist_ok=True)
    for name in STUDY_PICTURES:
        study, path = load_study(name), measured / f"{name}.json"
        if not path.is_file():
            path.write_text(json.dumps(study.run(False, print), indent=1, allow_nan=False), encoding="utf-8")
        result = json.loads(path.read_text(encoding="utf-8"))
        (picture,) = study.pictures(result, ("png",))
        (PICTURES_FOLDER / f"{name}.png").write_bytes(picture)


def main() -> None:
    """Write the chosen pictures."""
    parser = argparse.ArgumentParser(description="Make the pictures of README and docs again.")
    parser.add_argument(
        "which", nargs="*", help="window, errors, rig, robot, cobot, fingertip, part, headless, studies; without any: all"
    )
    parser.add_argument("--measured", type=Path, default=Path("studies"), help="folder of the studies' numbers")
    options = parser.parse_args()
    os.environ["QT_QPA_PLATFORM"] = "offscreen"
    measured = options.measured.absolute()
    makers = {
        "window": draw_window,
        "errors": draw_errors,
        "rig": draw_rig,
        "robot": draw_robot,
        "cobot": draw_cobot,
        "fingertip": draw_fingertip,
        "part": draw_part,
        "headless": draw_headless,
        "studies": lambda: draw_studies(measured),
    }
    wanted = options.which or list(makers)
    if unknown := sorted(set(wanted) - set(makers)):
        parser.error(f"there is no {unknown[0]}; choose of {', '.join(makers)}")
    application = QApplication(sys.argv[:1])
    with tempfile.TemporaryDirectory(prefix="skincal-") as folder:
        os.chdir(folder)
        for name in wanted:
            makers[name]()
        os.chdir(PICTURES_FOLDER)
    store_sentences(SHOWN_SENTENCES)
    for name, texts in SHOWN_SENTENCES.items():
        for text in texts:
            if not program_texts().has(text):
                print(f"{name}: shows a sentence that is not found in the program's source: {text}")
    application.quit()


# The studies' processes import this file.
if __name__ == "__main__":
    main()
