"""Step 2: the force/torque sensor: below the part, on the tool, or none; its pose, or the tool's settings."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import QLabel, QListWidget, QListWidgetItem, QWidget

from app.builder.fields import VectorField, button, choice, row_of, show_choice
from app.builder.rig_pictures import RigChoice
from app.builder.step import NO_POINTS, Step
from app.builder.tool_fields import ToolFields
from app.dialogs.form_widgets import number_field
from app.panels.layouts import make_form
from app.panels.widgets import compact_combo, secondary_label
from app.scene3d.draft_view import Mode
from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.part.draft_preview import PartPreview
from skincal.part.part_changes import sensors_between
from skincal.part.part_draft import IDENTITY_POSE, pose_rows
from skincal.part.sensor_placing import nearest_edge_point, pose_along, pose_on_flange, pose_under, turned_pose
from skincal.part.tool_draft import NO_ARM_WITH_TOOL, Rig

POINTS_PICKED_ON_FLANGE = 3
PICK_WORDS = (
    "Click the first of three points on the rim of the sensor's flange.",
    "Click the second point, about a third of the rim further.",
    "Click the third point.",
)
SIGN_CHOICES = {"": "as the URDF says", "1": "the force on the part", "-1": "its reaction"}
TOOL_SIGN_WORDS = {"": "the force on the tool (usual)", "1": "the force of the tool on the part", "-1": "the force on the tool"}
FEELS_THE_PART = "between part and base"
ADD_POINT = "Add the position as the next point"
SENSOR_DEPTH_MAX_MM = 1000.0
ON_TOOL_HINT = (
    "The arm holds tip and sensor, and the part stays still. The pokes show where the part is in the base of the robot: "
    "nothing is measured before."
)
NO_SENSOR_HINT = (
    "A poke is the place of the tip, when a taxel answers. The pokes show where the part is in the base of the robot or "
    "tracker."
)
NO_POSE_HINT = "Say where the sensor is. Until then only the axes of the part are drawn: x red, y green, z blue."


class SensorStep(Step):
    """The sensor's pose in the part's frame."""

    name = "sensor"
    tab = "Sensor"
    title = "Force/torque sensor"
    hint = (
        "The sensor's axes are drawn: x red, y green, z blue. A turn by 90 degrees is the usual mistake; a few pokes will "
        "show it."
    )

    def __init__(self) -> None:
        super().__init__()
        self.rig, self.tool = RigChoice(), ToolFields()
        self.rig.chosen.connect(self._choose_rig)
        self.tool.changed.connect(lambda tool, merge: self.change(replace(self.draft, tool=tool), merge))
        self.list = QListWidget()
        self.list.setAccessibleName("force/torque sensors of the URDF")
        self.list.setMaximumHeight(170)
        self.list.itemSelectionChanged.connect(self._choose_listed)
        self.other = compact_combo("joint or link at the sensor")
        self.other.activated.connect(lambda _: self._choose_sensor(self.other.currentText()))
        self.robot_form, self.free_form = QWidget(), QWidget()
        rows = ("Sensors of the URDF", self.list), ("&Other joint", self.other)
        self.robot_rows = make_form(*rows, within=self.robot_form, margins=0)
        self._make_free_form()
        self.sign = choice("meaning of the wrench", SIGN_CHOICES)
        self.sign.activated.connect(self._choose_sign)
        self.sign_row = QWidget()
        make_form(("Reports", self.sign), within=self.sign_row, margins=0)
        self.fill(self.rig, self.robot_form, self.free_form, self.tool, self.sign_row)

    def _make_free_form(self) -> None:
        """Make the fields for a part without a URDF."""
        self.under = button("The part stan&ds on the sensor", run=self._stand)
        self.bottom_gap = number_field("distance from the part's bottom to the sensor's origin", " mm", SENSOR_DEPTH_MAX_MM)
        self.bottom_gap.setToolTip("From the bottom face down to the sensor's origin; see its drawing")
        self.same = button("Same &frame as the part", run=lambda: self._set_pose(np.eye(4)))
        self.pick = button("Pic&k three points of the flange")
        self.pick.setCheckable(True)
        self.add_point = button(ADD_POINT, run=lambda: self._add_flange_point(np.array(self.origin.value()) * 1e-3))
        self.pick_note = secondary_label(wrap=True)
        self.origin, self.direction = VectorField("position of the sensor"), VectorField("direction of z", is_direction=True)
        self.turns = [
            button(f"\N{CLOCKWISE OPEN CIRCLE ARROW} 90\N{DEGREE SIGN} about {name}", run=partial(self._turn, axis))
            for axis, name in enumerate("xyz")
        ]
        for each, name in zip(self.turns, "xyz", strict=True):
            each.setAccessibleName(f"turn the sensor by 90 degrees about its {name} axis")
        below = row_of(QLabel("Origin"), self.bottom_gap, QLabel("below the part:"), self.under)
        make_form(
            below, row_of(self.same, self.pick), self.pick_note, ("Pos&ition", self.origin), ("", self.add_point),
            ("&z points to", self.direction), ("Turn", row_of(*self.turns)), within=self.free_form, margins=0,
        )  # fmt: skip
        self.bottom_gap.valueChanged.connect(self._stand)
        self.pick.toggled.connect(self._switch_picking)
        self.origin.edited.connect(self._move)
        self.direction.edited.connect(self._aim)

    def update_fields(self, preview: PartPreview) -> None:
        draft, robot = preview.draft, preview.robot
        has_robot = draft.urdf is not None or draft.has_dh_arm
        self.rig.show_rig(draft.rig, NO_ARM_WITH_TOOL if draft.has_dh_arm else "")
        self.tool.setVisible(draft.rig is not Rig.BELOW)
        self.sign_row.setVisible(draft.rig is not Rig.NONE)
        self.robot_form.setVisible(draft.urdf is not None and draft.rig is Rig.BELOW)
        self.free_form.setVisible(not has_robot and draft.rig is Rig.BELOW)
        if draft.rig is not Rig.BELOW:
            self.pick.setChecked(False)
            self.hint_label.setText(ON_TOOL_HINT if draft.rig is Rig.ON_TOOL else NO_SENSOR_HINT)
            self.tool.show_draft(draft)
            self._show_signs(preview)
            return
        if draft.has_dh_arm:
            self.hint_label.setText("The scene has an [arm] by Denavit-Hartenberg rows, which this page does not change.")
        if robot is not None:
            self._list_sensors(preview)
        pose = preview.sensor_pose
        if not draft.has_dh_arm:
            self.hint_label.setText(self.hint if pose is not None else NO_POSE_HINT)
        if draft.urdf is None and not self.pick.isChecked():
            shown = np.eye(4) if pose is None else pose
            self.origin.show_value(shown[:3, 3] * 1e3)
            self.direction.show_value(shown[:3, 2])
        for widget in self.turns:
            widget.setEnabled(pose is not None)
        for widget in (self.under, self.pick):
            widget.setEnabled(preview.surface is not None)
            widget.setToolTip("" if preview.surface is not None else "First choose the mesh of the part in step 1.")
        self._show_signs(preview)
        self._show_picking()

    def _show_signs(self, preview: PartPreview) -> None:
        is_on_tool = preview.draft.rig is Rig.ON_TOOL
        for index, words in enumerate((TOOL_SIGN_WORDS if is_on_tool else SIGN_CHOICES).values()):
            self.sign.setItemText(index, words)
        first = TOOL_SIGN_WORDS[""] if is_on_tool else "the force on the part (usual)"
        if preview.draft.urdf is not None and not is_on_tool:
            says = {1: "the force on the part", -1: "its reaction", None: "the URDF does not say; the force is assumed"}
            first = f"by the URDF: {says[preview.sign]}" if preview.sign is not None else says[None]
        self.sign.setItemText(0, first)
        show_choice(self.sign, "" if preview.draft.sign is None else str(preview.draft.sign))

    def _list_sensors(self, preview: PartPreview) -> None:
        robot = preview.robot
        assert robot is not None
        names = [sensor.name for sensor in robot.sensors]
        near = sensors_between(robot, preview.draft.link)
        with QSignalBlocker(self.list):
            self.list.clear()
            for sensor in robot.sensors:
                item = QListWidgetItem(f"{sensor.name}   {FEELS_THE_PART}" if sensor.name in near else sensor.name)
                item.setData(Qt.ItemDataRole.UserRole, sensor.name)
                self.list.addItem(item)
                item.setSelected(sensor.name == preview.draft.sensor)
        self.robot_rows.setRowVisible(self.list, bool(names))
        with QSignalBlocker(self.other):
            if self.other.count() != len(robot.joints) + 1:
                self.other.clear()
                self.other.addItem("")
                self.other.addItems(list(robot.joints))
            chosen = preview.draft.sensor
            self.other.setCurrentIndex(0 if chosen in names else max(0, self.other.findText(chosen)))

    def _choose_listed(self) -> None:
        chosen = self.list.selectedItems()
        if chosen:
            self._choose_sensor(str(chosen[0].data(Qt.ItemDataRole.UserRole)))

    def _choose_sensor(self, name: str) -> None:
        if name and name != self.draft.sensor:
            self.change(replace(self.draft, sensor=name, joints=()))

    def _choose_sign(self) -> None:
        value = str(self.sign.currentData())
        self.change(replace(self.draft, sign=int(value) if value else None))

    def _choose_rig(self, rig: Rig) -> None:
        # The signs of the two sensors are opposite by default.
        self.change(replace(self.draft, rig=rig, sign=None))

    # Without a URDF

    def _set_pose(self, pose: FloatArray, merge: str = "") -> None:
        self.change(replace(self.draft, sensor_pose=pose_rows(pose)), merge)

    def _pose(self) -> FloatArray:
        return np.array(IDENTITY_POSE if self.draft.sensor_pose is None else self.draft.sensor_pose)

    def _stand(self) -> None:
        surface = None if self.preview is None else self.preview.surface
        if surface is not None:
            self._set_pose(pose_under(surface, self.bottom_gap.value() * 1e-3), "sensor depth")

    def _move(self, millimetres: tuple[float, float, float]) -> None:
        if self.pick.isChecked():
            return  # typed for the next point
        pose = self._pose()
        pose[:3, 3] = np.array(millimetres) * 1e-3
        self._set_pose(pose, "sensor position")

    def _aim(self, direction: tuple[float, float, float]) -> None:
        with self.report_failure():
            self._set_pose(pose_along(self._pose()[:3, 3], np.array(direction)), "sensor direction")

    def _turn(self, axis: int) -> None:
        self._set_pose(turned_pose(self._pose(), axis))

    def _switch_picking(self, wanted: bool) -> None:
        self.points = NO_POINTS
        self._show_picking()
        self.mode = Mode.POINT if wanted else Mode.NONE
        self.picture_changed.emit()

    def _show_picking(self) -> None:
        is_picking = self.pick.isChecked()
        self.pick_note.setText(PICK_WORDS[len(self.points)] if is_picking else "")
        self.pick_note.setVisible(is_picking)
        self.add_point.setVisible(is_picking)

    def take_point(self, point: FloatArray) -> None:
        if self.pick.isChecked() and self.preview is not None and self.preview.surface is not None:
            self._add_flange_point(nearest_edge_point(self.preview.surface, point))

    def _add_flange_point(self, point: FloatArray) -> None:
        if self.preview is None or self.preview.surface is None:
            return
        self.points = np.concatenate([self.points, point[None]])
        if len(self.points) < POINTS_PICKED_ON_FLANGE:
            self._show_picking()
            self.picture_changed.emit()
            return
        points = self.points
        vertices = self.preview.surface.vertices
        try:
            pose = pose_on_flange(points, (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0)
        except InputError as error:
            self.failed.emit(str(error))
            self._switch_picking(wanted=True)
            return
        self.pick.setChecked(False)
        self._set_pose(pose)

    def leave(self) -> None:
        self.pick.setChecked(False)
