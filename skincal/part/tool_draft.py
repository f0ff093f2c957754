"""Where the force/torque sensor of a part draft sits, and the tool that pokes if it is not below the part: `[tool]`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeAlias

from skincal.model.pose_form import RotationForm

Vector: TypeAlias = tuple[float, ...]
Pose: TypeAlias = tuple[Vector, ...]
"""Four rows of four numbers, metres."""
FORM_OF_NAME = {form.value: form for form in RotationForm}
NO_ARM_WITH_TOOL = (
    "With an [arm] the sensor is below the part. For a sensor on the tool, or none, begin with the mesh or the URDF of the "
    "part: step 1, Part."
)
UNIT_MISSING = "Choose the unit of the lengths in the poses."
ANGLES_MISSING = "Choose whether the angles of the poses are radians or degrees."
TIP_MISSING = "Without a force sensor the tip alone says where a poke is: find it by the fixed-point test, or type it."


class Rig(Enum):
    """Place of the force/torque sensor."""

    BELOW = "below"
    """Below the part: it feels every poke on it."""
    ON_TOOL = "tool"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class ToolDraft:
    """The tool of a part draft, as its entries in `[tool]`; `None` or empty for a value that is not given."""

    rotation: str = ""
    """Form of the poses, a value of `RotationForm`; empty if the stream defines it."""
    unit: str = ""
    """Of the lengths; only with `rotation`."""
    degrees: bool | None = None
    """Whether the angles are in degrees; only with a form that has angles."""
    tip_mm: Vector | None = None
    """(3,) in the tool's frame."""
    tip_radius_mm: float | None = None
    tip_sd_mm: float | None = None
    flange: Pose | None = None
    """Of the sensor in the frame whose pose is streamed; `None` for the identity."""
    tolerance_deg: float | None = None
    base_from_link: Pose | None = None
    """Of the part in the base of the poses; `None` if the pokes show it."""
    kept: tuple[tuple[str, Any], ...] = ()
    """Entries that the page does not change, by name."""

    @property
    def form(self) -> RotationForm | None:
        """Form of the poses; `None` if the stream defines it."""
        return FORM_OF_NAME.get(self.rotation)


NO_TOOL = ToolDraft()
_OF_SENSOR = ("flange", "tolerance_deg")
_KEYS = (
    "rotation", "unit", "degrees", "tip_mm", "tip_radius_mm", "tip_sd_mm", *_OF_SENSOR, "base_from_link",
)  # fmt: skip
"""Entries in the order of a new file."""


def tool_entries(rig: Rig, tool: ToolDraft) -> dict[tuple[str, ...], Any]:
    """List the entries of `[tool]`, by their path; empty for a sensor below the part."""
    if rig is Rig.BELOW:
        return {}
    left_out = {"degrees"} if tool.form is None or not tool.form.has_angles else set[str]()
    left_out |= {"unit"} if tool.form is None else set()
    left_out |= set(_OF_SENSOR) if rig is Rig.NONE else set()
    left_out |= {"base_from_link_sd_mm"} if tool.base_from_link is None else set()
    entries: dict[tuple[str, ...], Any] = {("tool", "sensor"): rig.value}
    entries |= {("tool", key): getattr(tool, key) for key in _KEYS if key not in left_out}
    entries |= {("tool", key): value for key, value in tool.kept if key not in left_out}
    return {key: value for key, value in entries.items() if value not in (None, "")}


def read_tool_draft(table: Mapping[str, Any] | None) -> tuple[Rig, ToolDraft]:
    """Read `[tool]` of a scene that loads, with tuples in place of lists; `None` for a scene without one."""
    if table is None:
        return Rig.BELOW, NO_TOOL
    known: dict[str, Any] = {key: table[key] for key in _KEYS if key in table}
    kept = tuple((key, value) for key, value in table.items() if key != "sensor" and key not in _KEYS)
    return Rig(table["sensor"]), ToolDraft(**known, kept=kept)


def changes_by_test(before: ToolDraft, found: ToolDraft) -> dict[str, Any]:
    """List what a fixed-point test changed of a tool: its tip, and the form of its poses if that was another one."""
    after = {key: getattr(found, key) for key in ("tip_mm", "rotation", "degrees")}
    return {key: value for key, value in after.items() if key == "tip_mm" or value != getattr(before, key)}


def tool_problem(rig: Rig, tool: ToolDraft, *, has_arm: bool) -> str:
    """Name the first missing thing of a rig; empty if it is complete.

    Parameters
    ----------
    has_arm : the scene has an `[arm]`, at whose end the sensor is
    """
    if rig is Rig.BELOW:
        return ""
    if has_arm:
        return NO_ARM_WITH_TOOL
    if tool.form is not None and not tool.unit:
        return UNIT_MISSING
    if tool.form is not None and tool.form.has_angles and tool.degrees is None:
        return ANGLES_MISSING
    return TIP_MISSING if rig is Rig.NONE and tool.tip_mm is None else ""


def tool_costs(rig: Rig, tool: ToolDraft) -> tuple[str, ...]:
    """List the optional things that a rig with a tool lacks, with their cost."""
    found = list[str]()
    if tool.form is None:
        found.append("form of the poses: the stream must define it, as ROS, RTDE and `P` records do")
    if rig is Rig.ON_TOOL and tool.tip_mm is None:
        found.append("the tip is not given: force axes show it from twelve pokes on, if they lean against the tool")
    return tuple(found)
