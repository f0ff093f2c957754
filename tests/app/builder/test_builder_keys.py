"""The page with the keyboard alone, with names for a screen reader, and with devices that are connected meanwhile."""

from __future__ import annotations

import shutil
import threading
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QLineEdit,
    QListWidget,
    QMessageBox,
    QSlider,
)

from app.dialogs.new_session import NewSessionDialog
from app.scene3d.draft_view import CLICKED_BESIDE, RING_CLICKED
from app.text.message import PART_NOT_SAVED
from app.window import OWN_SCENE_SETTING
from skincal.files.layout_sources import parse_grid
from skincal.model.scene import resource
from skincal.part.part_draft import IDENTITY_POSE, open_draft
from skincal.simulation.outlets import TcpOutlet
from tests.app.builder.test_builder_window import Builder, choose, tube  # noqa: F401
from tests.app.scene3d_support import project
from tests.app.whole_window import OPEN_MS
from tests.approved import approved

FIELDS = (QLineEdit, QComboBox, QAbstractSpinBox, QSlider, QListWidget, QAbstractButton)
MAX_TABS = 80


class Keys(Builder):
    """The page, by keys."""

    def activate(self) -> None:
        self.window.activateWindow()
        self.bench.until(self.window.isActiveWindow, OPEN_MS)

    def press(self, key, modifier=Qt.KeyboardModifier.NoModifier) -> None:
        QTest.keyClick(QApplication.focusWidget() or self.window, key, modifier)
        QApplication.processEvents()

    def tab_to(self, widget) -> None:
        """Press Tab until a field, or its editor, has the focus."""
        for _ in range(MAX_TABS):
            focus = QApplication.focusWidget()
            if focus is widget or (focus is not None and widget.isAncestorOf(focus)):
                return
            self.press(Qt.Key.Key_Tab)
        raise AssertionError(f"Tab does not reach {widget.accessibleName() or widget}")

    def type_into(self, widget, text) -> None:
        self.tab_to(widget)
        self.press(Qt.Key.Key_A, Qt.KeyboardModifier.ControlModifier)
        QTest.keyClicks(QApplication.focusWidget(), text)
        self.press(Qt.Key.Key_Return)
        self.settle()

    def push(self, button) -> None:
        self.tab_to(button)
        self.press(Qt.Key.Key_Space)
        self.settle()


def test_a_part_is_described_with_the_keyboard_alone(bench, tube):  # noqa: F811
    bench.key(Qt.Key.Key_N, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier)
    build = Keys(bench)
    part, sensor, _, skin, place, check = build.page.steps
    build.type_into(part.file, str(tube))
    assert build.page.preview.size_mm == pytest.approx((80, 80, 120), rel=1e-2)
    build.push(build.page.next)
    # Three points of the flange, typed.
    build.push(sensor.pick)
    for angle in (0.3, 2.4, 4.4):
        for box, value in zip(sensor.origin.boxes, (40 * np.cos(angle), 40 * np.sin(angle), 0.0), strict=True):
            build.type_into(box, f"{value:.2f}")
        build.push(sensor.add_point)
    assert np.array(build.draft.sensor_pose)[:3, 3] == pytest.approx(np.zeros(3), abs=1e-4)
    assert np.array(build.draft.sensor_pose)[:3, 2] == pytest.approx([0, 0, 1], abs=1e-4)
    build.press(Qt.Key.Key_4, Qt.KeyboardModifier.AltModifier)
    assert build.page.open_step is skin
    build.type_into(skin.channels, "24")
    build.tab_to(skin.layout_kind)
    for _ in range(3):
        build.press(Qt.Key.Key_Down)
    build.settle()
    assert build.page.preview.layout is not None
    build.type_into(skin.in_strip, "2")
    build.push(build.page.next)
    assert build.page.open_step is place
    for box, value in zip(place.point.boxes, ("0", "-40", "60"), strict=True):
        build.type_into(box, value)
    build.push(place.turns[3])
    build.push(place.arrows[0])
    assert build.draft.anchor.point_mm[1] < -38.0
    build.push(build.page.next)
    build.type_into(check.place.boxes[2], "120")
    build.push(check.add)
    assert len(build.draft.landmarks) == 1
    build.tab_to(build.page.back)
    build.press(Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    build.settle()
    assert build.draft.landmarks == ()
    build.push(build.page.start)
    assert open_draft(build.draft.source).channels == 24
    assert bench.window.findChild(NewSessionDialog).isVisible()


def test_every_field_has_a_name_and_every_step_fits_the_small_window(bench, tube):  # noqa: F811
    build = Builder(bench, tube)
    skin = build.open_step("skin")
    choose(skin.layout_kind, "modules")
    build.settle()
    for step in build.page.steps:
        build.page.show_step(step)
        build.settle()
        assert step.minimumSizeHint().width() <= step.width() + 1, step.name
        for field in step.findChildren(QComboBox) + [f for kind in FIELDS for f in step.findChildren(kind)]:
            if field.isVisible() and not isinstance(field.parent(), QComboBox | QAbstractSpinBox):
                text = field.text() if isinstance(field, QAbstractButton) else ""
                assert field.accessibleName() or text, f"{step.name}: {field}"
    tabs = build.page.tabs.buttons()
    assert all(tab.sizeHint().width() <= tab.width() for tab in tabs if tab.isVisible())


class Lines:
    """A device that sends one line of numbers a hundred times a second."""

    def __init__(self, values) -> None:
        self.outlet, self.values, self._done = TcpOutlet(), values, threading.Event()
        self.address = self.outlet.address
        self._thread = threading.Thread(target=self._send)
        self._thread.start()

    def _send(self) -> None:
        while not self._done.wait(0.01):
            self.outlet.poll()
            self.outlet.write(",".join(f"{value:.3f}" for value in self.values).encode() + b"\n")

    def close(self) -> None:
        self._done.set()
        self._thread.join(5.0)
        self.outlet.close()


def test_a_touch_marks_the_channels_that_answer_and_tells_the_polarity(bench, tube):  # noqa: F811
    build = Builder(bench, tube)
    skin = build.open_step("skin")
    choose(skin.layout_kind, "modules")
    build.settle()
    rest = np.full(48, 200.0)
    with closing(Lines(rest)) as device:
        skin.live.row.set_address(device.address, agreed=True)
        skin.live.row.agreed.emit()
        bench.until(lambda: "No channel" in skin.touched.text(), OPEN_MS)
        pressed = rest.copy()
        pressed[24:36] -= 40.0
        device.values = pressed
        bench.until(lambda: "24-35" in skin.touched.text(), OPEN_MS)
        assert skin.answered.tolist() == list(range(24, 36))
        bench.until(skin.use_polarity.isVisible, OPEN_MS)
        skin.use_polarity.click()
        assert build.draft.polarity == "down"
        build.open_step("part")
        assert skin.answered is None


def test_a_first_touch_of_a_skin_with_small_values_proposes_a_threshold_for_the_scene(bench, tube):  # noqa: F811
    build = Builder(bench, tube)
    skin = build.open_step("skin")
    choose(skin.layout_kind, "modules")
    build.settle()
    rest = np.full(48, 0.5)
    with closing(Lines(rest)) as device:
        skin.live.row.set_address(device.address, agreed=True)
        skin.live.row.agreed.emit()
        bench.until(lambda: "No channel" in skin.touched.text(), OPEN_MS)
        pressed = rest.copy()
        pressed[24:26] += 8.0
        device.values = pressed
        bench.until(skin.use_threshold.isVisible, OPEN_MS)
        assert "no taxel would answer" in skin.threshold.text()
        skin.use_threshold.click()
        assert build.draft.response_min == 0.8  # a tenth of the touch: this device has no noise and no step
        bench.until(lambda: not skin.use_threshold.isVisible(), OPEN_MS)
        assert "the threshold of 0.8 raw units fits" in skin.threshold.text()


def test_the_arm_follows_the_joint_stream_and_wrong_columns_are_reported(bench):
    pytest.importorskip("icub_models")
    from tools.first_part import FRAME, SENSOR, find_icub

    build = Builder(bench, find_icub())
    renderer, preview = build.page.view._renderer, build.page.preview
    head = next(link for link in preview.shape.links if link.link == "head")
    pose = preview.link_poses["head"]
    at = project(renderer.renderer, (head.vertices.mean(axis=0) @ pose[:3, :3].T + pose[:3, 3])[None])[0]
    canvas = build.page.view.canvas
    build.click((round(at[0]) - canvas.width() // 2, canvas.height() - round(at[1]) - canvas.height() // 2))
    assert (build.draft.link, build.page.preview.mesh_link) == ("head", "head")
    build.page.change(replace(build.draft, link=FRAME, sensor=SENSOR))
    joints = build.open_step("joints")
    with closing(Lines([80.0, 10.0])) as device:
        joints.live.row.set_address(device.address, agreed=True)
        joints.live.row.agreed.emit()
        bench.until(lambda: build.page.angles.get("l_elbow", 0.0) == pytest.approx(np.radians(80.0)), OPEN_MS)
        assert joints.warning.text() == ""
        device.values = [10.0, 80.0]
        bench.until(lambda: "l_wrist_prosup" in joints.warning.text(), OPEN_MS)


def test_of_many_changes_the_newest_is_shown_and_few_others_are_worked_on(bench):
    bench.window.change_part(resource("scenes/whole-body/scene.toml"))
    build = Builder(bench)
    place = build.open_step("place")
    previewer, asked = build.page._previewer, []
    preview = previewer.preview
    previewer.preview = lambda draft, angles: asked.append(draft) or preview(draft, angles)
    before = build.page.preview.layout.modules[0].anchor
    for _ in range(30):
        place.nudge(0.5, 0.0)
    build.settle()
    after = build.page.preview.layout.modules[0].anchor
    assert np.linalg.norm(after.point - before.point) == pytest.approx(0.015, rel=0.05), "each of the thirty steps counts"
    assert len(asked) <= 3
    assert asked[-1] == build.draft == build.page.preview.draft
    build.page.undo()
    assert not build.page.is_changed, "what one key does again and again is undone at once"


def test_a_shipped_scene_is_opened_changed_and_saved_elsewhere(bench, tmp_path):
    scene = shutil.copytree(resource("scenes/icub-forearm"), tmp_path / "own") / "scene.toml"
    before = scene.read_bytes()
    bench.window.change_part(scene)
    build = Builder(bench)
    assert [step.name for step in build.page.steps if step.applies(build.page.preview)] == [
        "part", "sensor", "joints", "skin", "place", "check"
    ]  # fmt: skip
    assert build.page.save() == scene
    assert scene.read_bytes() == before
    for name in ("sensor", "joints", "skin", "place", "check"):
        build.open_step(name)
    build.page.steps[0].part_name.setText("other")
    build.page.steps[0].part_name.editingFinished.emit()
    build.settle()
    assert build.page.is_changed
    assert build.page.save() == scene
    assert scene.read_text().splitlines()[1].startswith('name = "other"')
    assert not build.page.is_changed


def test_the_start_page_offers_a_new_part_first_until_a_scene_of_ones_own_was_opened(bench):
    page, settings = bench.window.opening, bench.window._settings
    bench.controller.leave()
    for own, first in ((False, "part"), (True, "new")):
        settings.setValue(OWN_SCENE_SETTING, own)
        bench.window._show_opening()
        bench.qtbot.wait(20)
        order = sorted(page.buttons, key=lambda name: page.buttons[name].y())
        assert order[0] == first
    with bench.qtbot.waitSignal(page.command_wanted):
        page.buttons["part"].click()
    assert bench.window.builder is not None
    bench.window.builder.leave_button.click()
    assert bench.window.builder is None
    assert bench.window.stack.currentWidget() is page
    assert page.buttons["new"].isVisible()


def test_a_part_that_is_not_saved_is_asked_about(bench, tube):  # noqa: F811
    build = Builder(bench, tube)
    assert build.page.is_changed
    for wanted in (False, True):
        build.page.leave_button.click()
        box = bench.window.findChildren(QMessageBox)[-1]
        assert box.text() == PART_NOT_SAVED
        next(button for button in box.buttons() if (button.text() == "Do not save") == wanted).click()
        bench.qtbot.wait(20)
        assert (bench.window.builder is None) == wanted


def test_a_part_is_saved_when_its_page_is_left(bench, tube):  # noqa: F811
    """Save writes the newest change, which may not be previewed yet; what cannot be saved stays open."""
    build = Builder(bench, tube)
    for is_complete in (False, True):
        if is_complete:
            build.page.change(replace(build.draft, channels=16, sensor_pose=IDENTITY_POSE))
            build.page.change(replace(build.draft, polarity="down"))
        build.page.leave_button.click()
        box = bench.window.findChildren(QMessageBox)[-1]
        assert {button.text() for button in box.buttons()} == {"Save", "Do not save", "Cancel"}
        next(button for button in box.buttons() if button.text() == "Save").click()
        bench.until(lambda is_complete=is_complete: (bench.window.builder is None) == is_complete, OPEN_MS)
        bench.qtbot.wait(20)
        assert (bench.window.builder is None) == is_complete
    scene = next((bench.documents / "scenes").glob("*/scene.toml"))
    assert (open_draft(scene).polarity, open_draft(scene).channels) == ("down", 16)


def test_a_typed_position_is_taken_whole_and_names_its_distance_to_the_mesh(bench, tube):  # noqa: F811
    build = Keys(bench, tube)
    build.page.change(replace(build.draft, layout_text=parse_grid("3x3@8mm").layout_text(), sensor_pose=IDENTITY_POSE))
    build.settle()
    place = build.open_step("place")
    build.settle()
    start = build.draft.anchor
    build.activate()
    place.point.boxes[0].setFocus()
    for box, text in zip(place.point.boxes, ("0", "-45", "70"), strict=True):
        QTest.keyClick(box, Qt.Key.Key_A, Qt.KeyboardModifier.ControlModifier)
        QTest.keyClicks(box, text)
        assert build.draft.anchor is start, "nothing moves before the third number"
        QTest.keyClick(box, Qt.Key.Key_Tab)
    build.settle()
    # The mesh has a radius of 40 mm.
    assert build.draft.anchor.point_mm == pytest.approx((0, -40, 70), abs=0.05)
    assert place.note.text() == approved("placing.typed", distance="5.0", point="0.0, -40.0, 70.0")
    assert place.point.value() == (0.0, -45.0, 70.0), "what was typed stays"
    # One by one with Enter: the numbers in between do not turn or flip the layout.
    for box, text in zip(place.point.boxes, ("40", "0", "60"), strict=True):
        build.type_into(box, text)
    assert build.draft.anchor.point_mm == pytest.approx((40, 0, 60), abs=0.05)
    assert place.angle.value() == pytest.approx(0.0, abs=0.05)
    build.type_into(place.angle, "30")
    level = np.array([0.0, 1.0, 0.0])
    x = np.array(build.draft.anchor.x)
    assert np.degrees(np.arccos(x @ level)) == pytest.approx(30.0, abs=0.1)
    assert x[2] > 0.0, "counter-clockwise seen from outside"
    place.turns[3].click()
    build.settle()
    assert place.angle.value() == pytest.approx(45.0, abs=0.05)


def test_clicks_that_place_nothing_say_why(bench, tube):  # noqa: F811
    build = Keys(bench, tube)
    build.page.change(replace(build.draft, layout_text=parse_grid("3x3@8mm").layout_text(), sensor_pose=IDENTITY_POSE))
    place = build.open_step("place")
    build.click()
    before = build.draft.anchor
    ring = build.ring_pixel(place.turn_handle(), 2.0)
    QTest.mouseClick(build.page.view.canvas, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, ring)
    assert place.note.text() == RING_CLICKED
    canvas = build.page.view.canvas
    build.click((5 - canvas.width() // 2, 5 - canvas.height() // 2))
    assert place.note.text() == CLICKED_BESIDE
    assert build.draft.anchor == before


def test_landmarks_keep_their_typed_names_and_say_how_far_from_the_mesh_they_are(bench, tube):  # noqa: F811
    build = Keys(bench, tube)
    build.activate()
    check = build.open_step("check")
    # A name before the point.
    build.type_into(check.mark_name, "screw")
    for box, text in zip(check.place.boxes, ("58", "0", "60"), strict=True):
        build.type_into(box, text)
    assert check.distance.text() == approved("placing.off_mesh", what="This point", distance="18.0", point="40.0, 0.0, 60.0")
    build.push(check.nearest)
    build.push(check.add)
    assert [(mark.name, mark.place) for mark in build.draft.landmarks] == [
        ("screw", pytest.approx((0.04, 0.0, 0.06), abs=1e-5))
    ]
    # A second one does not move the first.
    build.push(check.add_other)
    build.type_into(check.mark_name, "far")
    for box, text in zip(check.place.boxes, ("0", "58", "60"), strict=True):
        build.type_into(box, text)
    build.push(check.add)
    assert [mark.name for mark in build.draft.landmarks] == ["screw", "far"]
    assert build.draft.landmarks[0].place == pytest.approx((0.04, 0.0, 0.06), abs=1e-5)
    line = approved("placing.off_mesh", what="Landmark far", distance="18.0", point="0.0, 40.0, 60.0")
    assert any(line in text for text in check.summary())


def test_a_simulated_hand_pokes_a_new_part_at_one_click(bench, tube):  # noqa: F811
    build = Keys(bench, tube)
    build.page.change(replace(build.draft, sensor_pose=IDENTITY_POSE, channels=9))
    check = build.open_step("check")
    assert not check.attempt.isEnabled()
    assert "layout" in check.attempt_note.text()
    build.page.change(replace(build.draft, layout_text=parse_grid("3x3@8mm").layout_text()))
    build.settle()
    assert not check.attempt.isEnabled()
    assert "place of the layout" in check.attempt_note.text()
    build.open_step("place").take_point(np.array([0.04, 0.0, 0.06]))
    build.open_step("check")
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=OPEN_MS):
        check.attempt.click()
    assert bench.window.builder is None
    assert bench.controller.has_simulator
    bench.until(lambda: bench.window.session_view.state is not None and len(bench.accepted()) > 1, OPEN_MS * 3)


def test_the_new_session_dialog_has_the_simulated_hand_too(bench):
    bench.controller.leave()
    bench.window._ask_devices(resource("scenes/flat-patch/scene.toml"))
    dialog = bench.window.findChild(NewSessionDialog)
    dialog.fields["skin"].setText("socket://127.0.0.1:1")
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=OPEN_MS):
        dialog.attempt.click()
    assert bench.controller.has_simulator
    assert bench.controller.can_keep, "its folder is asked about"


def test_the_numbers_of_the_steps_stay_and_an_empty_step_says_what_is_missing(bench, tube):  # noqa: F811
    bench.window.ask_part()
    build = Keys(bench)
    build.activate()
    tabs = build.page.tabs.buttons()
    assert [tab.text().split()[:2] for tab in tabs] == [
        ["1", "Part"], ["2", "Sensor"], ["3", "Joints"], ["4", "Skin"], ["5", "Place"], ["6", "Check"]
    ]  # fmt: skip
    assert [tab.isEnabled() for tab in tabs] == [True, True, False, True, False, True]
    build.press(Qt.Key.Key_3, Qt.KeyboardModifier.AltModifier)
    assert "No joint moves" in build.page.findings.text()
    assert build.page.open_step is build.page.steps[0]
    build.page.next.click()
    assert "Choose the mesh of the part" in build.page.findings.text()
    assert build.page.open_step is build.page.steps[0]
    build.page.take_part(tube)
    build.settle()
    build.page.next.click()
    assert build.page.open_step is build.page.steps[1]
    for step in (1, 3):
        build.page.next.click()
        assert build.page.open_step is build.page.steps[step]


def test_a_typed_number_is_taken_before_a_key_with_alt_acts(bench, tube):  # noqa: F811
    build = Keys(bench, tube)
    build.activate()
    alt = Qt.KeyboardModifier.AltModifier
    build.press(Qt.Key.Key_2, alt)
    step = build.page.open_step
    build.tab_to(step.bottom_gap)
    build.press(Qt.Key.Key_A, Qt.KeyboardModifier.ControlModifier)
    QTest.keyClicks(QApplication.focusWidget(), "30")
    build.press(Qt.Key.Key_D, alt)
    bench.until(lambda: not step.under.isDown())  # Qt clicks at the release, 0.1 s after the key
    build.settle()
    assert build.draft.sensor_pose[2][3] == pytest.approx(-0.03), "30 mm below a part that stands on z = 0"
    build.press(Qt.Key.Key_I, alt)
    assert step.origin.boxes[0].hasFocus()
    build.tab_to(step.origin.boxes[1])
    build.press(Qt.Key.Key_A, Qt.KeyboardModifier.ControlModifier)
    QTest.keyClicks(QApplication.focusWidget(), "17")
    build.press(Qt.Key.Key_4, alt)
    build.settle()
    assert build.page.open_step.name == "skin"
    assert build.draft.sensor_pose[1][3] == pytest.approx(0.017)


@pytest.mark.parametrize("name", ["sensor", "place", "check"])
def test_alt_i_leads_to_the_position(bench, tube, name):  # noqa: F811
    build = Keys(bench, tube)
    build.activate()
    choose(build.open_step("skin").layout_kind, "grid")
    step = build.open_step(name)
    build.press(Qt.Key.Key_I, Qt.KeyboardModifier.AltModifier)
    field = {"sensor": "origin", "place": "point", "check": "place"}[name]
    assert getattr(step, field).boxes[0].hasFocus()
