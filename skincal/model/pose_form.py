"""Forms of the numbers of a pose, without the arrays: the options of the commands name them.

A pose has three properties that a reader must be told: the form of its rotation, the unit of its angles, and the unit of its
lengths. Each wrong one makes a plausible pose. `docs/tool.md` lists the forms of known robots, with the sources.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

MATRIX_WIDTH = 16
"""Numbers of a 4 x 4 matrix."""


class RotationForm(Enum):
    """Form of the numbers of a pose; x y z come first, but in a 4 x 4 matrix."""

    QUATERNION_XYZW = "xyzw"
    QUATERNION_WXYZ = "wxyz"
    ROTATION_VECTOR = "vector"
    RPY = "rpy"
    """Roll, pitch and yaw about fixed axes: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    ABC = "abc"
    """The same angles in the other order: R = Rz(A) Ry(B) Rx(C)."""
    MOVING_XYZ = "xyz"
    """About moving axes: R = Rx Ry Rz."""
    MOVING_ZYZ = "zyz"
    ROWS = "rows"
    """3 x 3, row by row."""
    COLUMNS = "columns"
    AXIS_ANGLE = "axis-angle"
    """A unit axis and the angle about it, rad."""
    MATRIX = "4x4"
    """4 x 4, row by row; the last row is 0 0 0 1."""
    MATRIX_COLUMNS = "4x4-columns"

    @property
    def width(self) -> int:
        """Number of values of a pose."""
        return _WIDTH_OF_FORM[self]

    @property
    def has_angles(self) -> bool:
        """Whether its numbers are angles, in radians or degrees."""
        return self.width == 6


_WIDTH_OF_FORM = {
    **dict.fromkeys((RotationForm.QUATERNION_XYZW, RotationForm.QUATERNION_WXYZ, RotationForm.AXIS_ANGLE), 7),
    **dict.fromkeys((RotationForm.ROWS, RotationForm.COLUMNS), 12),
    **dict.fromkeys((RotationForm.MATRIX, RotationForm.MATRIX_COLUMNS), MATRIX_WIDTH),
    **dict.fromkeys(
        (RotationForm.ROTATION_VECTOR, RotationForm.RPY, RotationForm.ABC, RotationForm.MOVING_XYZ, RotationForm.MOVING_ZYZ), 6
    ),
}

POSE_WIDTHS = frozenset(_WIDTH_OF_FORM.values())
"""Numbers of values that a pose may have."""

QUATERNION_FORMS = (RotationForm.QUATERNION_XYZW, RotationForm.QUATERNION_WXYZ)


@dataclass(frozen=True, slots=True)
class PoseForm:
    """Form of a pose as its reader must know it."""

    rotation: RotationForm
    degrees: bool = False
    """Whether angles are in degrees; only where the form has angles."""


@dataclass(frozen=True, slots=True)
class SentPose:
    """A pose as a device sent it."""

    numbers: tuple[float, ...]
    form: PoseForm
    """Reading of the numbers."""
    metres_per_unit: float
    """Of the lengths."""

    @property
    def position(self) -> tuple[float, float, float]:
        """Position, metres: a 4 x 4 matrix has it in its last column, or in its last row."""
        x, y, z = self.numbers[:3]
        if len(self.numbers) == MATRIX_WIDTH:
            last_row, last_column = self.numbers[12:15], self.numbers[3:12:4]
            x, y, z = last_row if any(last_row) else last_column
        return x * self.metres_per_unit, y * self.metres_per_unit, z * self.metres_per_unit


def forms_of_width(width: int) -> tuple[PoseForm, ...]:
    """List the forms of a pose with `width` values; empty if no form has as many."""
    found = [form for form in RotationForm if form.width == width]
    return tuple(PoseForm(form, degrees) for form in found for degrees in ((False, True) if form.has_angles else (False,)))
