"""A part described in the window with mouse and keys, saved, and poked by the simulated operator."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import trimesh
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QWheelEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from app.builder.part_step import PartStep
from app.builder.skin_step import SkinStep
from app.dialogs.new_session import NewSessionDialog
from skincal.files.layout_sources import parse_layout
from skincal.model.scene import load_scene
from skincal.model.skin import SkinKind
from skincal.part.draft_preview import OTHER_MESH, OTHER_UNIT
from skincal.part.part_draft import open_draft
from tests.app.scene3d_support import project
from tests.app.whole_window import OPEN_MS
from tests.skincal.files.paxini_support import write_package


@pytest.fixture
def tube(tmp_path):
    """A cylinder of radius 40 mm and height 120 mm, standing on z = 0, in millimetres."""
    mesh = trimesh.creation.cylinder(40.0, 120.0, sections=96)
    mesh.apply_translation((0, 0, 60))
    mesh.export(tmp_path / "tube.stl")
    return tmp_path / "tube.stl"


class Builder:
    """The page of a window, as a person uses it."""

    def __init__(self, bench, path=None) -> None:
        self.bench, self.window = bench, bench.window
        if path is not None:
            self.window.ask_part(path)
        self.page = self.window.builder
        self.settle()

    @property
    def draft(self):
        return self.page.history.now

    def settle(self) -> None:
        """Wait until the newest draft is shown."""
        self.bench.until(lambda: self.page.is_settled and self.page.view.list_layers() != (), OPEN_MS)

    def open_step(self, name: str):
        self.page.show_step(next(step for step in self.page.steps if step.name == name))
        self.settle()
        return self.page.open_step

    def click(self, shift=(0, 0)) -> QPoint:
        """Click the picture, at pixels from its middle."""
        canvas = self.page.view._canvas
        at = QPoint(canvas.width() // 2 + shift[0], canvas.height() // 2 + shift[1])
        QTest.mouseClick(canvas, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, at)
        self.settle()
        return at

    def drag(self, start: QPoint, by: tuple[int, int]) -> QPoint:
        canvas = self.page.view._canvas
        left, plain = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
        end = start + QPoint(*by)
        QTest.mousePress(canvas, left, plain, start)
        for share in (0.3, 0.6, 1.0):
            QTest.mouseMove(canvas, start + QPoint(round(by[0] * share), round(by[1] * share)))
            QApplication.processEvents()
        QTest.mouseRelease(canvas, left, plain, end)
        self.settle()
        return end

    def ring_pixel(self, ring, angle: float) -> QPoint:
        """Pixel of the ring that turns the layout, at an angle (rad) from its knob."""
        x, normal, view = ring.anchor.x, ring.anchor.normal, self.page.view
        point = ring.anchor.point + ring.radius * (np.cos(angle) * x + np.sin(angle) * np.cross(normal, x))
        across, up, _ = project(view._renderer.renderer, point[None])[0]
        return QPoint(round(across), round(view.canvas.height() - up))

    def turn_wheel(self, at: QPoint, notches: int) -> None:
        canvas, no = self.page.view._canvas, Qt.MouseButton.NoButton
        phase = Qt.ScrollPhase.NoScrollPhase
        event = QWheelEvent(
            QPointF(at), canvas.mapToGlobal(QPointF(at)), QPoint(), QPoint(0, 120 * notches), no, Qt.KeyboardModifier(0), phase,
            False,
        )  # fmt: skip
        QApplication.sendEvent(canvas, event)
        self.settle()


def choose(box, value) -> None:
    """Choose an entry of a list by its value."""
    box.setCurrentIndex(box.findData(value))
    box.activated.emit(box.currentIndex())


def test_a_mesh_becomes_a_part_that_is_saved_and_poked(bench, tube):
    build = Builder(bench, tube)
    assert build.page.preview.size_mm == pytest.approx((80, 80, 120), rel=1e-2)
    assert "120 x 80 x 80 mm" in build.page.open_step.size_text.text()
    assert not build.page.start.isEnabled()
    sensor = build.open_step("sensor")
    sensor.bottom_gap.setValue(30.0)
    build.settle()
    sensor.turns[2].click()
    build.settle()
    assert np.array(build.draft.sensor_pose) == pytest.approx(
        np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, -0.03], [0, 0, 0, 1]]), abs=1e-6
    )
    skin = build.open_step("skin")
    choose(skin.layout_kind, "grid")
    build.settle()
    assert skin.material.currentData() == "sheet", "a grid is a sheet until it is said to be a board"
    choose(skin.material, "board")
    skin.rows.setValue(3)
    choose(skin.polarity, "down")
    build.settle()
    assert build.page.preview.layout.kind is SkinKind.BOARD, "the answer outlasts a change of the grid"
    choose(skin.layout_kind, "modules")
    build.settle()
    assert skin.material.currentData() == "board"
    choose(skin.layout_kind, "grid")
    build.settle()
    assert skin.material.currentData() == "sheet", "another layout is another skin"
    place = build.open_step("place")
    at = build.click()
    clicked = build.draft.anchor
    at = build.drag(at, (-60, -40))
    assert np.linalg.norm(np.subtract(build.draft.anchor.point_mm, clicked.point_mm)) > 5.0
    build.page.undo()
    assert build.draft.anchor == clicked, "a drag is one change"
    build.page.redo()
    build.settle()
    dragged = build.draft.anchor
    build.turn_wheel(at, 3)
    turned = build.draft.anchor
    assert turned.point_mm == dragged.point_mm
    assert np.degrees(np.arccos(np.dot(turned.x, dragged.x))) == pytest.approx(15.0, abs=0.1)
    knob, quarter = (build.ring_pixel(place.turn_handle(), angle) for angle in (0.0, np.pi / 2.0))
    build.drag(knob, (quarter - knob).toTuple())
    by_ring = build.draft.anchor
    assert by_ring.point_mm == turned.point_mm
    assert np.cross(turned.x, by_ring.x) @ turned.normal == pytest.approx(1.0, abs=0.02), "counter-clockwise, by a quarter"
    QTest.mouseClick(build.page.view.canvas, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, quarter)
    assert build.draft.anchor == by_ring, "a click on the ring places nothing"
    build.page.undo()
    build.settle()
    assert build.draft.anchor == turned, "a drag of the ring is one change"
    place.nudge(0.0, -2.0)
    build.settle()
    assert build.draft.anchor.point_mm != turned.point_mm
    check = build.open_step("check")
    build.click((0, 120))
    check.mark_name.setText("rim")
    check.mark_name.editingFinished.emit()
    build.settle()
    assert any("1 landmark" in line for line in check.summary())
    build.page.start.click()
    scene = build.draft.source
    assert load_scene(scene).landmarks[0].name == "rim"
    assert open_draft(scene).polarity == "down"
    dialog = bench.window.findChild(NewSessionDialog)
    bench.until(lambda: dialog._scene is not None, OPEN_MS)
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=OPEN_MS):
        dialog._try()
    assert bench.window.builder is None
    assert bench.window.session_view.workspace.part.scene.path == scene
    bench.until(lambda: bench.window.session_view.state is not None and len(bench.accepted()) > 0, OPEN_MS * 3)


@pytest.mark.parametrize("kind", [PartStep, SkinStep])
def test_a_file_that_cannot_be_read_is_reported_in_a_sentence(qtbot, tmp_path, kind):
    step = kind()
    qtbot.addWidget(step)
    with qtbot.waitSignal(step.failed) as failed:
        step.take_file(tmp_path / "gone.toml")
    assert "gone.toml" in failed.args[0]
    step.end()


def test_an_own_mesh_on_a_robot_has_its_unit_and_a_link_without_a_mesh_can_be_chosen(bench, tube, tmp_path):
    shapes = '<visual><geometry><cylinder radius="0.04" length="0.12"/></geometry></visual>'
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(
        f'<robot name="arm"><link name="base"/><link name="part">{shapes}</link><joint name="ft" type="fixed">'
        '<parent link="base"/><child link="part"/></joint></robot>'
    )
    build = Builder(bench, urdf)
    step = build.open_step("part")
    step.tree.topLevelItem(0).setSelected(True)
    build.settle()
    assert build.draft.link == "part"
    assert "No mesh: link part has visual cylinder" in build.page.findings.text()
    assert not step.unit.isVisible()
    step.own_mesh.setText(str(tube))
    step.own_mesh.editingFinished.emit()
    build.settle()
    assert step.size_text.text().startswith("120 x 80 x 80 mm")
    assert step.unit.isVisible()
    choose(step.unit, "cm")
    build.settle()
    assert step.size_text.text().startswith("1200 x 800 x 800 mm")
    choose(step.unit, "mm")
    build.settle()
    assert build.page.preview.problems.get("part") is None


def test_a_mesh_that_the_urdf_scales_wrongly_is_mended_in_the_fields_that_the_sentence_names(bench, tube, tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(
        f'<robot name="arm"><link name="base"/><link name="part"><visual><geometry><mesh filename="{tube.name}"/></geometry>'
        '</visual></link><joint name="ft" type="fixed"><parent link="base"/><child link="part"/></joint></robot>'
    )
    build = Builder(bench, urdf)
    step = build.open_step("part")
    step.take_link("part")
    build.settle()
    assert OTHER_MESH in build.page.findings.text()
    # "name a copy of it in the field Mesh and choose the unit in the list Unit"
    step.own_mesh.setText(str(shutil.copy(tube, tmp_path / "copy.stl")))
    step.own_mesh.editingFinished.emit()
    build.settle()
    choose(step.unit, "mm")
    build.settle()
    assert step.size_text.text().startswith("120 x 80 x 80 mm")


def test_a_wrong_unit_is_mended_in_the_list_that_the_sentence_names(bench, tmp_path):
    trimesh.creation.box((2.5, 4.6, 3.0)).export(tmp_path / "inches.stl")
    build = Builder(bench, tmp_path / "inches.stl")
    step = build.page.open_step
    assert step.unit.itemText(step.unit.findData("in")).endswith("116.8 x 76.2 x 63.5 mm"), "each unit with the size"
    assert step.size_text.text().endswith("choose another unit.")
    assert not build.page.preview.sensor_pose
    assert "The sensor's axes are drawn" not in build.open_step("sensor").hint_label.text()
    build.open_step("part")
    choose(step.unit, "in")
    build.settle()
    assert build.page.preview.size_mm == pytest.approx((63.5, 116.84, 76.2), rel=1e-4)
    assert step.size_text.text().endswith("mm"), "the unit was chosen"
    choose(step.unit, "m")
    build.settle()
    assert build.page.preview.surface is None
    said = build.page.findings.text()
    assert said.endswith(OTHER_UNIT)
    assert "--unit" not in said
    # "Choose another unit in the list Unit."
    assert step.unit.isVisible()
    assert step.form.labelForField(step.unit).text().replace("&", "") == "Unit"
    choose(step.unit, "in")
    build.settle()
    assert build.page.preview.size_mm == pytest.approx((63.5, 116.84, 76.2), rel=1e-4)


def test_paxini_modules_give_layout_axes_and_unit(qtbot, tmp_path):
    step = SkinStep()
    qtbot.addWidget(step)
    choose(step.layout_kind, "paxini")
    assert step.pages.currentWidget() is step.paxini.parentWidget()
    step.paxini.setText("FLAT-4, 25")
    step.paxini_sdk.setText(str(write_package(tmp_path)))
    with qtbot.waitSignal(step.changed) as changed:
        step.read_points.click()
    draft = changed.args[0]
    assert (draft.axes, draft.skin_unit, draft.channels) == (3, "N", None)
    assert parse_layout(draft.layout_text, tmp_path / "m.toml").width == 29
    for wrong, words in (("99", "expected a part code"), ("", "no module")):
        step.paxini.setText(wrong)
        with qtbot.waitSignal(step.failed) as failed:
            step.read_points.click()
        assert words in failed.args[0]
    step.end()
