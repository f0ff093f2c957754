"""Fields of a part whose sensor is on the tool, or that has none: form of the poses, tip, place of the sensor."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from PySide6.QtCore import Signal
from PySide6.QtWidgets import QFormLayout, QWidget

from app.builder.fields import VectorField, button, choice, row_of, set_silently, show_choice
from app.dialogs.form_widgets import number_field
from app.panels.layouts import make_form
from app.panels.widgets import secondary_label
from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.pose_form import RotationForm
from skincal.model.tool_rig import TIP_RADIUS_MAX_MM, TIP_SD_DEFAULT_MM, TIP_SD_RANGE_MM
from skincal.part.part_draft import IDENTITY_POSE, MM_DIGITS, PartDraft, pose_rows, rounded
from skincal.part.sensor_placing import turned_pose
from skincal.part.tool_draft import Rig, ToolDraft
from skincal.words.tool_words import FORM_WORDS

FORM_CHOICES = {"": "as the stream defines them (ROS, RTDE)", **{form.value: FORM_WORDS[form] for form in RotationForm}}
UNIT_CHOICES = {"": "choose", **{unit: unit for unit in METRES_PER_UNIT}}
ANGLE_CHOICES = {"": "choose", "radians": "radians", "degrees": "degrees"}
TIP_CHOICES = {"": "the pokes show it", "given": "known"}
TIP_UNKNOWN = {Rig.ON_TOOL: "the pokes show it", Rig.NONE: "not known yet"}
POSE_CHOICES = {"": "the pokes show it", "given": "as in the scene file"}
FORM_HELP = "Choose what your robot or tracker sends, if its lines are numbers alone. The manual lists the makers: docs/tool.md"
FLANGE_HELP = "Position of the sensor's origin in the frame whose pose is streamed; 0 0 0 if that is the sensor's own frame"
TIP_HELP = "Centre of the tip's ball, or the end of a pointed tip, in the frame whose pose is streamed"
TEST_HELP = "Touch one point from four sides: shows the tip, and whether the poses are read rightly"
SD_HELP = "Error of one place of the tip: 0.5 mm for a cobot, 0.3 mm for a good tracker"


class ToolFields(QWidget):
    """Fields of `[tool]`; each change is another `ToolDraft`."""

    changed = Signal(object, str)
    """`ToolDraft`, and the kind of the change, as in `Step.changed`."""

    def __init__(self) -> None:
        super().__init__()
        self._tool = ToolDraft()
        self.form = choice("form of the tool's poses", FORM_CHOICES)
        self.form.setToolTip(FORM_HELP)
        self.unit, self.angles = choice("unit of the lengths", UNIT_CHOICES), choice("unit of the angles", ANGLE_CHOICES)
        self.how = choice("how the tip is known", TIP_CHOICES)
        self.tip = VectorField("position of the tip")
        self.tip.setToolTip(TIP_HELP)
        self.test = button("Fixed-point test\N{HORIZONTAL ELLIPSIS}", run=self._open_test)
        self.test.setToolTip(TEST_HELP)
        self.address = ""
        """Address of the tool's stream, once the test named it."""
        self.radius = number_field("radius of the tip", " mm", TIP_RADIUS_MAX_MM)
        self.radius.setMinimum(0.0)
        self.error = number_field("error of one place of the tip", " mm", TIP_SD_RANGE_MM[1])
        self.error.setMinimum(TIP_SD_RANGE_MM[0])
        self.error.setToolTip(SD_HELP)
        self.flange = VectorField("position of the sensor in the frame of the poses")
        self.flange.setToolTip(FLANGE_HELP)
        self.turns = [
            button(f"\N{CLOCKWISE OPEN CIRCLE ARROW} 90\N{DEGREE SIGN} about {name}", run=partial(self._turn, axis))
            for axis, name in enumerate("xyz")
        ]
        for each, name in zip(self.turns, "xyz", strict=True):
            each.setAccessibleName(f"turn the sensor by 90 degrees about its {name} axis, in the frame of the poses")
        self.turn_row = QWidget()
        make_form(row_of(*self.turns), within=self.turn_row, margins=0)
        self.axes_note = secondary_label(wrap=True)
        self.pose = choice("the part's pose in the base", POSE_CHOICES)
        self.rows: QFormLayout = make_form(
            ("Pos&es", self.form), ("&Unit", self.unit), ("An&gles", self.angles), ("Tip", self.how), ("Tip at", self.tip),
            ("", row_of(self.test)), ("Radius", self.radius), ("Error", self.error), ("Sensor at", self.flange),
            ("Turn", self.turn_row), self.axes_note, ("Part", self.pose), within=self, margins=0,
        )  # fmt: skip
        self._connect()

    def _connect(self) -> None:
        self.form.activated.connect(lambda _: self._set(rotation=str(self.form.currentData())))
        self.unit.activated.connect(lambda _: self._set(unit=str(self.unit.currentData())))
        self.angles.activated.connect(lambda _: self._choose_angles())
        self.how.activated.connect(lambda _: self._choose_tip())
        self.tip.edited.connect(lambda point: self._set("tip", tip_mm=rounded(np.array(point), MM_DIGITS)))
        self.radius.valueChanged.connect(lambda value: self._set("radius", tip_radius_mm=round(value, 2) or None))
        self.error.valueChanged.connect(lambda value: self._set("error", tip_sd_mm=round(value, 2)))
        self.flange.edited.connect(self._move_sensor)
        self.pose.activated.connect(lambda _: self._set(base_from_link=None))

    def show_draft(self, draft: PartDraft) -> None:
        """Show the tool of a draft."""
        tool, rig = draft.tool, draft.rig
        self._tool = tool
        show_choice(self.form, tool.rotation)
        show_choice(self.unit, tool.unit)
        show_choice(self.angles, "" if tool.degrees is None else "degrees" if tool.degrees else "radians")
        has_sensor, has_tip = rig is Rig.ON_TOOL, tool.tip_mm is not None
        self.how.setItemText(0, TIP_UNKNOWN.get(rig, ""))
        show_choice(self.how, "given" if has_tip else "")
        self.tip.show_value(tool.tip_mm or (0.0, 0.0, 0.0))
        set_silently(self.radius, tool.tip_radius_mm or 0.0)
        set_silently(self.error, tool.tip_sd_mm or TIP_SD_DEFAULT_MM)
        pose = np.array(tool.flange or IDENTITY_POSE)
        self.flange.show_value(pose[:3, 3] * 1e3)
        self.axes_note.setText(_axes_words(pose))
        shown = {
            self.unit: tool.form is not None,
            self.angles: tool.form is not None and tool.form.has_angles,
            self.tip: has_tip or not has_sensor,
            self.radius: has_tip or not has_sensor,
            self.error: has_tip or not has_sensor,
            self.flange: has_sensor,
            self.turn_row: has_sensor,
            self.axes_note: has_sensor,
            self.pose: tool.base_from_link is not None,
        }
        for field, is_shown in shown.items():
            self.rows.setRowVisible(field, is_shown)
        show_choice(self.pose, "given" if tool.base_from_link is not None else "")

    def _set(self, merge: str = "", **values: Any) -> None:
        self._tool = replace(self._tool, **values)
        self.changed.emit(self._tool, f"tool {merge}" if merge else "")

    def _open_test(self) -> None:
        from app.builder.fixed_point_dialog import FixedPointDialog  # rarely needed

        dialog = FixedPointDialog(self._tool, self.address, self.window())
        dialog.found.connect(lambda tool: self.changed.emit(tool, ""))
        dialog.finished.connect(lambda _: self._keep_address(dialog.live.row.named))
        dialog.open()

    def _keep_address(self, address: str) -> None:
        self.address = address or self.address

    def _choose_angles(self) -> None:
        chosen = str(self.angles.currentData())
        self._set(degrees=None if not chosen else chosen == "degrees")

    def _choose_tip(self) -> None:
        self._set(tip_mm=(0.0, 0.0, 0.0) if self.how.currentData() else None)

    def _move_sensor(self, millimetres: tuple[float, float, float]) -> None:
        pose = np.array(self._tool.flange or IDENTITY_POSE)
        pose[:3, 3] = np.array(millimetres) * 1e-3
        self._set_flange(pose, "flange")

    def _turn(self, axis: int) -> None:
        self._set_flange(turned_pose(np.array(self._tool.flange or IDENTITY_POSE), axis), "")

    def _set_flange(self, pose: np.ndarray, merge: str) -> None:
        rows = pose_rows(pose)
        self._set(merge, flange=None if rows == IDENTITY_POSE else rows)


def _axes_words(pose: np.ndarray) -> str:
    """Describe the directions of a sensor's axes in the frame of the poses."""
    names = list[str]()
    for column, axis in enumerate("xyz"):
        direction = pose[:3, column]
        along = int(np.argmax(np.abs(direction)))
        is_parallel = abs(direction[along]) > 0.999
        sign = "-" if direction[along] < 0 else "+"
        numbers = " ".join(f"{value:.2f}" for value in direction.tolist())
        names.append(f"{axis} along {sign}{'xyz'[along]}" if is_parallel else f"{axis} along ({numbers})")
    return f"The sensor's axes in that frame: {', '.join(names)}."
