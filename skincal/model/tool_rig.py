"""A rig with the force/torque sensor on the poking tool, or without one: `[tool]` of a scene, and the sensor's poses.

The part does not move, and the tool's pose is streamed in a frame that does not move either, such as a robot's base. So the
sensor's pose in the part's link is

    link_from_sensor = link_from_base base_from_tool tool_from_sensor,

another one at each poke. Without the part's pose in the base the link is the base itself. Without a sensor its frame has the
axes of the tool and the origin at the tip: a poke is then written as a unit force through it (docs/decisions/pose-rows.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from skincal.geometry import FloatArray, inverse_pose
from skincal.model.errors import InputError
from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.tables import Table

BASE_LINK = "base"
"""Name of the frame of all positions while the part's pose in it is not known."""
TOOL_ARM_POSE = "tool"
"""Name of the arm pose of all pokes: the tool has another pose at each, and no two share an error of their own."""
TIP_ARM_POSE = "tip"
"""The same with a tool that carries no sensor."""
DEFAULT_TOOL_TURN_MAX_DEG = 1.0
"""Degrees. Largest turn of the tool between its tare and the poke: a tool of 0.5 kg then changes the force by 0.09 N."""
POINT_FORCE_N = 1.0
"""N, force of a poke without a sensor: through the tip, along the push."""
PUSH_TURN_SD_RAD = 0.15
"""rad, sd of the direction of this push: it is the way of the tip, and not the normal of the skin."""
TIP_SD_DEFAULT_MM = 0.5
"""mm, sd of one place of the tip, each direction: a cobot's smooth position error over its workspace (issue 41)."""
TIP_SD_RANGE_MM = (0.01, 10.0)
TIP_RADIUS_MAX_MM = 50.0
PART_POSE_SD_DEFAULT_MM, PART_POSE_SD_MAX_MM = 2.0, 50.0
"""mm, sd of a typed pose of the part, each direction: that of an arm's pose in `skincal.rig.usual_errors`."""
_FORMS_WITH_ANGLES = ", ".join(form.value for form in RotationForm if form.has_angles)


@dataclass(frozen=True, slots=True, eq=False)
class ToolSpec:
    """The tool of a scene, and how its poses are written."""

    has_sensor: bool
    """Whether the tool carries a force/torque sensor; without one the rig has none."""
    form: PoseForm | None
    """Form of the numbers; `None` if the stream must define it."""
    metres_per_unit: float | None
    """Of the lengths; `None` as `form`."""
    tool_from_sensor: FloatArray
    """(4, 4) float, metres: pose of the sensor in the frame whose pose is streamed."""
    link_from_base: FloatArray
    """(4, 4) float, metres; the identity while the link is the base."""
    has_part_pose: bool
    """Whether the scene gives the part's pose in the base."""
    part_pose_sd: float
    """m, sd of a given pose at the middle of the part, each direction."""
    tip: FloatArray | None
    """(3,) float, metres, tool frame: centre of the tip's ball, or its end with a radius of 0; `None` if not given."""
    tip_radius: float
    """m, of the ball."""
    tip_sd: float
    """m, sd of one place of the tip by the tool's poses, each direction."""
    turn_max: float
    """rad, largest turn of the tool between its tare and the end of the poke."""

    @property
    def streamed_form(self) -> tuple[PoseForm, float] | None:
        """Form of the numbers of a pose, and metres per unit of its lengths; `None` if the stream must define them."""
        return None if self.form is None or self.metres_per_unit is None else (self.form, self.metres_per_unit)

    @property
    def arm_pose(self) -> str:
        """Name of the arm pose of all pokes."""
        return TOOL_ARM_POSE if self.has_sensor else TIP_ARM_POSE

    @property
    def tip_in_sensor(self) -> FloatArray | None:
        """(3,) float, metres, sensor frame: `tip`; `None` if the scene has none."""
        return None if self.tip is None else inverse_pose(self.tool_from_sensor)[:3] @ np.append(self.tip, 1.0)

    def link_from_sensor(self, base_from_tool: FloatArray) -> FloatArray:
        """Compute the sensor's pose (4, 4) in the link at a pose of the tool, metres."""
        return self.link_from_base @ base_from_tool @ self.tool_from_sensor

    def tip_in_link(self, base_from_tool: FloatArray) -> FloatArray | None:
        """Compute the position (3,) of the end of the tip in the link, metres; `None` if the scene has none."""
        return None if self.tip is None else (self.link_from_base @ base_from_tool)[:3] @ np.append(self.tip, 1.0)


def read_tool(table: Table) -> ToolSpec:
    """Read `[tool]`. Raises InputError with the key, the value found and what was expected."""
    has_sensor = table.choice("sensor", {"tool": True, "none": False})
    form, unit = _read_form(table)
    has_part_pose = "base_from_link" in table.keys
    base_from_link = table.pose("base_from_link", np.eye(4))
    tip = table.lengths_mm("tip_mm", (3,)) if "tip_mm" in table.keys else None
    if not has_sensor:
        _refuse_keys_of_a_sensor(table, tip)
    tool_from_sensor = table.pose("flange", np.eye(4)) if has_sensor else _shift(tip)
    tolerance = table.take("tolerance_deg", float, DEFAULT_TOOL_TURN_MAX_DEG)
    if not 0 < tolerance <= 90:
        raise InputError(f"{table.where}: tolerance_deg is {tolerance:g}; expected a number above 0, up to 90.")
    if "base_from_link_sd_mm" in table.keys and not has_part_pose:
        raise InputError(
            f"{table.where}: base_from_link_sd_mm is the error of base_from_link, and that is not given; give both, or neither."
        )
    part_pose_sd = _read_length(table, "base_from_link_sd_mm", PART_POSE_SD_DEFAULT_MM, (0.0, PART_POSE_SD_MAX_MM))
    radius = _read_length(table, "tip_radius_mm", 0.0, (0.0, TIP_RADIUS_MAX_MM))
    tip_sd = _read_length(table, "tip_sd_mm", TIP_SD_DEFAULT_MM, TIP_SD_RANGE_MM)
    table.refuse_unknown_keys()
    return ToolSpec(
        has_sensor=has_sensor,
        form=form,
        metres_per_unit=unit,
        tool_from_sensor=tool_from_sensor,
        link_from_base=inverse_pose(base_from_link) if has_part_pose else np.eye(4),
        has_part_pose=has_part_pose,
        part_pose_sd=part_pose_sd,
        tip=tip,
        tip_radius=radius,
        tip_sd=tip_sd,
        turn_max=float(np.radians(tolerance)),
    )


def _refuse_keys_of_a_sensor(table: Table, tip: FloatArray | None) -> None:
    named = [key for key in ("flange", "tolerance_deg") if key in table.keys]
    if named:
        raise InputError(f'{table.where}: {named[0]} is of a sensor on the tool, and sensor is "none"; leave {named[0]} out.')
    if tip is None:
        raise InputError(
            f"{table.where}: tip_mm is missing; without a sensor the tip alone says where a poke is: "
            "find it by skincal tool (docs/tool.md)."
        )


def _read_length(table: Table, key: str, default: float, limits: tuple[float, float]) -> float:
    """Read a length in millimetres within limits, as metres."""
    length = table.take(key, float, default)
    if not limits[0] <= length <= limits[1]:
        raise InputError(f"{table.where}: {key} is {length:g}; expected {limits[0]:g} to {limits[1]:g}.")
    return length * 1e-3


def _shift(tip: FloatArray | None) -> FloatArray:
    pose = np.eye(4)
    pose[:3, 3] = 0.0 if tip is None else tip
    return pose


def _refuse_incomplete_form(
    table: Table, rotation: RotationForm | None, unit: float | None, *, needs_degrees: bool
) -> NoReturn:
    """Name all keys at once that the form of the poses lacks, with their values."""
    form = f"a form with angles ({_FORMS_WITH_ANGLES})" if rotation is None else f"the form {rotation.value}"
    lacks: list[str] = []
    if rotation is None:
        lacks.append(f"rotation is missing; expected one of {', '.join(each.value for each in RotationForm)}")
    if unit is None:
        lacks.append(f"unit is missing; expected one of {', '.join(METRES_PER_UNIT)}")
    if needs_degrees:
        lacks.append(f"degrees is missing; expected true or false for {form}")
    raise InputError(f"{table.where}: {'; '.join(lacks)}.")


def _read_form(table: Table) -> tuple[PoseForm | None, float | None]:
    given = {key for key in ("rotation", "unit", "degrees") if key in table.keys}
    if not given:
        return None, None
    rotation = table.choice("rotation", {form.value: form for form in RotationForm}) if "rotation" in given else None
    unit = table.choice("unit", METRES_PER_UNIT) if "unit" in given else None
    degrees = table.take("degrees", bool, None)
    needs_degrees = degrees is None and (rotation is None or rotation.has_angles)
    if rotation is None or unit is None or needs_degrees:
        _refuse_incomplete_form(table, rotation, unit, needs_degrees=needs_degrees)
    if degrees and not rotation.has_angles:
        raise InputError(f"{table.where}: degrees is true, and the form {rotation.value} has no angles; leave degrees out.")
    return PoseForm(rotation, bool(degrees)), unit
