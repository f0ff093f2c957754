"""Step 3: the joints between sensor and part: columns of their stream, live values or sliders, fixed angles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import QCheckBox, QGridLayout, QLabel, QLineEdit, QSlider, QWidget

from app.builder.fields import set_silently
from app.builder.live_row import LiveRow
from app.builder.step import Step
from app.dialogs.form_widgets import number_field
from app.panels.widgets import escape_tooltip, secondary_label
from skincal.model.readings import Stream
from skincal.part.draft_preview import JointState, PartPreview
from skincal.streams.expected_readings import ExpectedReadings

SLIDER_RANGE_WITHOUT_LIMITS_DEG = 180.0
SLIDER_STEPS_PER_DEGREE = 10


class JointRow:
    """One joint: its name, a slider with its limits, its angle, and whether it is fixed there."""

    def __init__(self, grid: QGridLayout, name: str, limits: tuple[float, float] | None, *, can_fix: bool) -> None:
        self.name = name
        at = grid.rowCount()
        free = (-SLIDER_RANGE_WITHOUT_LIMITS_DEG, SLIDER_RANGE_WITHOUT_LIMITS_DEG)
        low, high = free if limits is None else np.degrees(limits).tolist()
        self.label = QLabel(name, textInteractionFlags=Qt.TextInteractionFlag.TextSelectableByMouse)
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setAccessibleName(f"angle of {name}")
        self.slider.setRange(round(low * SLIDER_STEPS_PER_DEGREE), round(high * SLIDER_STEPS_PER_DEGREE))
        self.slider.setSingleStep(SLIDER_STEPS_PER_DEGREE)
        self.limits = f"{low:.0f} to {high:.0f}\N{DEGREE SIGN}" if limits is not None else ""
        self.slider.setToolTip(escape_tooltip(self.limits or "This joint has no limits in the URDF."))
        self.slider.setPageStep(10 * SLIDER_STEPS_PER_DEGREE)
        self.angle = number_field(f"angle of {name} in degrees", "\N{DEGREE SIGN}", 360.0)
        self.fixed = QCheckBox("fixed, not in the stream")
        self.fixed.setAccessibleName(f"{name} is fixed at this angle, not in the stream")
        self.fixed.setVisible(can_fix)
        grid.addWidget(self.label, at, 0, 1, 3)
        grid.addWidget(self.slider, at + 1, 0)
        grid.addWidget(self.angle, at + 1, 1)
        grid.addWidget(self.fixed, at + 1, 2)

    def show_angle(self, radians: float, words: str, *, is_fixed: bool) -> None:
        degrees = float(np.degrees(radians))
        self.label.setText("   ".join(filter(None, (self.name, words, self.limits))))
        with QSignalBlocker(self.slider), QSignalBlocker(self.fixed):
            self.slider.setValue(round(degrees * SLIDER_STEPS_PER_DEGREE))
            self.fixed.setChecked(is_fixed)
        set_silently(self.angle, degrees)

    def widgets(self) -> tuple[QWidget, ...]:
        return self.label, self.slider, self.angle, self.fixed


class JointsStep(Step):
    """Joints of the chain."""

    name = "joints"
    tab = "Joints"
    title = "Joints"
    absent = "No joint moves between sensor and part: there is nothing to set."
    hint = "These joints lie between sensor and part. Move them here, or connect their stream: the robot in the view follows."

    def __init__(self) -> None:
        super().__init__()
        self.columns = QLineEdit()
        self.columns.setAccessibleName("columns of the joint stream")
        self.columns.editingFinished.connect(self._name_columns)
        self.columns_label = QLabel("Col&umns of the joint stream, by joint name, separated by commas", wordWrap=True)
        self.columns_label.setBuddy(self.columns)
        self.rows: dict[str, JointRow] = {}
        holder = QWidget()
        self._grid = QGridLayout(holder)
        self._grid.setContentsMargins(0, 0, 0, 0)
        self._grid.setColumnStretch(0, 1)
        self.live = LiveRow(Stream.JOINTS)
        self.live.read.connect(self._take_frames)
        about = secondary_label("Optional: read the joints now, to see whether order and unit are right.", wrap=True)
        self.warning = secondary_label(wrap=True)
        self.fill(self.columns_label, self.columns, holder, about, self.live, self.warning)

    def applies(self, preview: PartPreview) -> bool:
        return bool(preview.joints or preview.draft.fixed)

    def update_fields(self, preview: PartPreview) -> None:
        draft = preview.draft
        joints = {joint.name: joint for joint in preview.joints}
        fixed = {name: float(np.radians(angle)) for name, angle in draft.fixed}
        for name, angle in fixed.items():
            limits = None if preview.robot is None or name not in preview.robot.joints else preview.robot.joints[name].limits
            joints.setdefault(name, JointState(name, -1, angle, limits))
        if list(joints) != list(self.rows):
            self._make_rows(list(joints.values()), can_fix=draft.urdf is not None)
        for name, joint in joints.items():
            is_fixed = name in fixed
            words = "fixed" if is_fixed else f"column {joint.column}" if joint.column >= 0 else "no column has its name"
            self.rows[name].show_angle(joint.angle, words if not draft.has_dh_arm else "", is_fixed=is_fixed)
        is_editable = draft.urdf is not None
        self.columns.setVisible(is_editable)
        self.columns_label.setVisible(is_editable)
        if not self.columns.hasFocus():
            self.columns.setText(", ".join(draft.joints or [joint.name for joint in preview.joints]))
        count = 1 + max((joint.column for joint in preview.joints), default=0)
        self.live.expect(ExpectedReadings(max(1, draft.channels or 1), count, draft.joints or tuple(self._streamed())))

    def _make_rows(self, joints: list[JointState], *, can_fix: bool) -> None:
        for row in self.rows.values():
            for widget in row.widgets():
                self._grid.removeWidget(widget)
                widget.deleteLater()
        self.rows = {}
        for joint in joints:
            row = JointRow(self._grid, joint.name, joint.limits, can_fix=can_fix)
            row.slider.valueChanged.connect(
                lambda value, name=joint.name: self._turn(name, np.radians(value / SLIDER_STEPS_PER_DEGREE))
            )
            row.angle.valueChanged.connect(lambda value, name=joint.name: self._turn(name, np.radians(value)))
            row.fixed.toggled.connect(lambda on, name=joint.name: self._fix(name, on))
            self.rows[joint.name] = row

    def _turn(self, name: str, radians: float) -> None:
        fixed = dict(self.draft.fixed)
        if name in fixed:
            fixed[name] = round(float(np.degrees(radians)), 2)
            self.change(replace(self.draft, fixed=tuple(fixed.items())), f"fixed {name}")
        else:
            self.angles_changed.emit({name: float(radians)})

    def _fix(self, name: str, on: bool) -> None:
        fixed = dict(self.draft.fixed)
        columns = [each for each in (self.draft.joints or self._streamed()) if each != name]
        if on:
            fixed[name] = round(self.rows[name].angle.value(), 2)
        else:
            fixed.pop(name, None)
            columns.append(name)
        self.change(replace(self.draft, fixed=tuple(fixed.items()), joints=tuple(columns)))

    def _streamed(self) -> list[str]:
        return [] if self.preview is None else [joint.name for joint in self.preview.joints]

    def _name_columns(self) -> None:
        names = tuple(dict.fromkeys(word for word in self.columns.text().replace(",", " ").split() if word))
        if names != (self.draft.joints or tuple(self._streamed())):
            self.change(replace(self.draft, joints=names))

    def _take_frames(self, frames: list[np.ndarray]) -> None:
        """Follow the stream: the newest angles move the arm."""
        preview = self.preview
        if preview is None or not frames:
            return
        newest = frames[-1]
        angles = {joint.name: float(newest[joint.column]) for joint in preview.joints if 0 <= joint.column < len(newest)}
        self.angles_changed.emit(angles)
        outside = [
            joint.name
            for joint in preview.joints
            if joint.limits is not None
            and joint.name in angles
            and not joint.limits[0] <= angles[joint.name] <= joint.limits[1]
        ]
        verb = "is" if len(outside) == 1 else "are"
        words = f"{', '.join(outside)} {verb} outside the joint limits: check the order and the unit of the columns."
        self.warning.setText(words if outside else "")
