"""The step for the sensor: three pictures, and for a tool the fields of its poses, its tip and its sensor."""

from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from app.builder.sensor_step import SensorStep
from skincal.part.draft_preview import PartPreview
from skincal.part.part_draft import PartDraft
from skincal.part.tool_draft import NO_ARM_WITH_TOOL, Rig, tool_problem


@pytest.fixture
def step(qtbot):
    """The step alone; a change is shown at once, as by the page."""
    made = SensorStep()
    qtbot.addWidget(made)

    def show(draft, _merge=""):
        made.draft = draft
        made.show_preview(PartPreview(draft))

    made.changed.connect(show)
    show(PartDraft())
    made.show()
    return made


def shown(step) -> set[str]:
    """Names of the fields that a person sees."""
    tool = step.tool
    named = {
        "under": step.under, "form": tool.form, "unit": tool.unit, "angles": tool.angles, "how": tool.how, "tip": tool.tip,
        "radius": tool.radius, "flange": tool.flange, "sign": step.sign,
    }  # fmt: skip
    return {name for name, widget in named.items() if widget.isVisibleTo(step)}


def choose(box, value) -> None:
    box.setCurrentIndex(box.findData(value))
    box.activated.emit(box.currentIndex())


def test_a_picture_chooses_the_rig_and_shows_only_its_fields(step):
    assert shown(step) == {"under", "sign"}
    step.rig.buttons[Rig.ON_TOOL].click()
    assert step.draft.rig is Rig.ON_TOOL
    assert shown(step) == {"form", "how", "flange", "sign"}
    choose(step.tool.how, "given")
    assert {"tip", "radius"} < shown(step)
    step.rig.buttons[Rig.NONE].click()
    assert shown(step) == {"form", "how", "tip", "radius"}, "no force, so no sign and no place of a sensor"
    assert step.draft.tool.tip_mm == (0.0, 0.0, 0.0), "what was typed stays"


def test_the_arrow_keys_go_from_picture_to_picture(step, qtbot):
    first = step.rig.buttons[Rig.BELOW]
    step.activateWindow()
    first.setFocus()
    qtbot.waitUntil(first.hasFocus)
    QTest.keyClick(first, Qt.Key.Key_Right)
    assert step.draft.rig is Rig.ON_TOOL
    QTest.keyClick(step.rig.buttons[Rig.ON_TOOL], Qt.Key.Key_Right)
    assert step.draft.rig is Rig.NONE
    assert all(button.accessibleName() for button in step.rig.buttons.values())


def test_the_form_of_the_poses_is_asked_until_it_is_complete(step):
    step.rig.buttons[Rig.ON_TOOL].click()
    choose(step.tool.form, "vector")
    assert {"unit", "angles"} < shown(step)
    assert "unit of the lengths" in tool_problem(step.draft.rig, step.draft.tool, has_arm=False)
    choose(step.tool.unit, "m")
    assert "radians or degrees" in tool_problem(step.draft.rig, step.draft.tool, has_arm=False)
    choose(step.tool.angles, "radians")
    assert tool_problem(step.draft.rig, step.draft.tool, has_arm=False) == ""
    choose(step.tool.form, "xyzw")
    assert "angles" not in shown(step)


def test_the_sensor_on_the_tool_is_placed_and_turned(step):
    step.rig.buttons[Rig.ON_TOOL].click()
    step.tool.flange.boxes[2].setValue(20.0)
    step.tool.turns[2].click()
    assert np.array(step.draft.tool.flange) == pytest.approx(
        np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0.02], [0, 0, 0, 1]]), abs=1e-9
    )
    assert "x along +y, y along -x, z along +z" in step.tool.axes_note.text()
    step.tool.flange.boxes[2].setValue(0.0)
    for _ in range(3):
        step.tool.turns[2].click()
    assert step.draft.tool.flange is None, "the identity is not written"


def test_a_part_with_a_denavit_hartenberg_arm_has_its_sensor_below_and_says_why(step):
    step.changed.emit(PartDraft(has_dh_arm=True), "")
    assert not step.rig.buttons[Rig.ON_TOOL].isEnabled()
    assert step.rig.buttons[Rig.NONE].toolTip() == NO_ARM_WITH_TOOL


def test_a_part_of_a_urdf_may_be_poked_by_a_tool_and_asks_for_no_sensor_of_the_urdf(step):
    step.changed.emit(PartDraft(urdf=Path("robot.urdf")), "")
    assert step.robot_form.isVisibleTo(step)
    step.rig.buttons[Rig.NONE].click()
    assert step.draft.rig is Rig.NONE
    assert not step.robot_form.isVisibleTo(step)
    assert {"form", "tip"} < shown(step)
    step.rig.buttons[Rig.BELOW].click()
    assert step.robot_form.isVisibleTo(step)


def test_the_pictures_differ_and_are_drawn_in_the_colours_of_the_theme(step):
    step.resize(500, 700)
    pictures = [step.rig.buttons[rig].grab().toImage() for rig in Rig]
    assert len({bytes(picture.constBits()) for picture in pictures}) == 3
