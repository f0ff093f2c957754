"""The steps of `docs/first-part.md` in a window, with mouse and fields: for the tutorial's pictures and its test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QComboBox, QDialog, QDialogButtonBox

from app.builder.check_step import CheckStep
from app.builder.joints_step import JointsStep
from app.builder.page import BuilderPage
from app.builder.part_step import PartStep
from app.builder.sensor_step import SensorStep
from app.builder.skin_step import SkinStep
from app.builder.step import Step
from app.dialogs.export_dialog import ExportDialog
from app.dialogs.new_session import NewSessionDialog
from app.window import Window
from skincal.files.formats import ExportFormat

LINK, FRAME, SENSOR, ELBOW = "l_forearm", "l_forearm_dh_frame", "l_arm_ft", "l_elbow"
ELBOW_ANGLE_DEG = 70.0
LAYOUT_AT = (-60, -30)  # Pixels from the middle of the picture, right and down
LANDMARK_CLICKS = {"elbow side": (-280, -20), "wrist": (200, 80), "below": (-60, 190), "above": (-120, -195)}
POKE_COUNT = 24
Until = Callable[[Callable[[], bool]], None]
AnyStep = TypeVar("AnyStep", bound=Step)
AnyDialog = TypeVar("AnyDialog", bound=QDialog)


def find_icub() -> Path:
    """Find the URDF of the public iCub; `ImportError` without the package icub-models."""
    import icub_models

    return Path(icub_models.get_models_path()) / "iCubGenova02" / "model.urdf"


def walk_tutorial(window: Window, urdf: Path, until: Until, calibration: Path, pokes: int = POKE_COUNT) -> Iterator[str]:
    """Do the steps; yield the name of each when the window shows its result.

    Parameters
    ----------
    until : lets the window work until a condition is true
    calibration : file to write at the end
    """
    yield from _describe_part(window, urdf, until)
    yield from _calibrate(window, until, calibration, pokes)


def _describe_part(window: Window, urdf: Path, until: Until) -> Iterator[str]:
    window.ask_part(urdf)
    page = window.builder
    assert page is not None
    _settle(page, until)
    yield "robot"
    part = _open(page, PartStep, until)
    item = part.tree.findItems(LINK, Qt.MatchFlag.MatchExactly | Qt.MatchFlag.MatchRecursive)[0]
    part.tree.setCurrentItem(item)
    _settle(page, until)
    _choose(part.frame, FRAME)
    _settle(page, until)
    yield "part"
    sensor = _open(page, SensorStep, until)
    row = next(row for row in range(sensor.list.count()) if sensor.list.item(row).data(Qt.ItemDataRole.UserRole) == SENSOR)
    sensor.list.setCurrentRow(row)
    _settle(page, until)
    yield "sensor"
    joints = _open(page, JointsStep, until)
    joints.rows[ELBOW].angle.setValue(ELBOW_ANGLE_DEG)
    _settle(page, until)
    yield "joints"
    skin = _open(page, SkinStep, until)
    skin.layout_kind.setCurrentIndex(skin.layout_kind.findData("modules"))
    skin.layout_kind.activated.emit(skin.layout_kind.currentIndex())
    skin.strips.setValue(2)
    _settle(page, until)
    yield "skin"
    page.next.click()
    _settle(page, until)
    _click(page, LAYOUT_AT)
    _settle(page, until)
    yield "place"
    check = _open(page, CheckStep, until)
    for name, at in LANDMARK_CLICKS.items():
        _click(page, at)
        _settle(page, until)
        QTest.keyClicks(check.mark_name, name)
        QTest.keyClick(check.mark_name, Qt.Key.Key_Return)
        _settle(page, until)
    yield "check"
    page.start.click()


def _calibrate(window: Window, until: Until, calibration: Path, pokes: int) -> Iterator[str]:
    dialog = _dialog(window, NewSessionDialog)
    until(lambda: dialog.has_scene)
    yield "devices"
    dialog.buttons.button(QDialogButtonBox.StandardButton.Ok).click()
    until(lambda: window.session_view is not None and window.session_view.state is not None)
    while window.controller.pace < 4:
        window.change_pace()
    view = window.session_view
    assert view is not None
    until(lambda: view.state is not None and len(view.state.snapshot.pokes) >= pokes)
    yield "poke"
    window.commands.actions["export"].trigger()
    export = _dialog(window, ExportDialog)
    export.format.setCurrentIndex(export.format.findData(ExportFormat.JSON))
    export.path.setText(str(calibration))
    export.start.click()
    until(calibration.exists)
    yield "export"


def _settle(page: BuilderPage, until: Until) -> None:
    until(lambda: page.is_settled and page.view.list_layers() != ())


def _open(page: BuilderPage, kind: type[AnyStep], until: Until) -> AnyStep:
    step = next(step for step in page.steps if isinstance(step, kind))
    page.show_step(step)
    _settle(page, until)
    return step


def _choose(box: QComboBox, text: str) -> None:
    box.setCurrentText(text)
    box.activated.emit(box.currentIndex())


def _click(page: BuilderPage, at: tuple[int, int]) -> None:
    """Click the picture at pixels from its middle, right and down."""
    canvas = page.view.canvas
    assert canvas is not None
    point = QPoint(canvas.width() // 2 + at[0], canvas.height() // 2 + at[1])
    QTest.mouseClick(canvas, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, point)


def _dialog(window: Window, kind: type[AnyDialog]) -> AnyDialog:
    found = window.findChild(kind)
    assert found is not None
    return found
