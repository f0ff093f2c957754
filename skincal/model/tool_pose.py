"""Poses of a tool as robots and trackers write them: numbers of one of several forms, which nothing in the numbers names.

A pose has three properties that a reader must be told: the form of its rotation, the unit of its angles, and the unit of its
lengths. Each wrong one makes a plausible pose. `docs/tool.md` lists the forms of known robots, with the sources.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.tables import MAX_LENGTH_M

NORM_TOLERANCE = 0.001
"""Largest error of a quaternion's norm and of a matrix's products: six digits make it 1e-6; a lost body's zeros make it 1."""
MIN_LENGTH_M = 0.005
"""m. No base has all poses of a tool this near to its origin."""
MAX_ANGLE_RAD = 2.0 * np.pi
"""Beyond it a rotation vector or an Euler angle is in degrees."""


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
    MATRIX = "4x4"
    """4 x 4, row by row; the last row is 0 0 0 1."""
    MATRIX_COLUMNS = "4x4-columns"

    @property
    def width(self) -> int:
        """Number of values of a pose."""
        return _WIDTH[self]

    @property
    def has_angles(self) -> bool:
        """Whether its numbers are angles, in radians or degrees."""
        return self.width == 6


_WIDTH = {
    **dict.fromkeys((RotationForm.QUATERNION_XYZW, RotationForm.QUATERNION_WXYZ), 7),
    **dict.fromkeys((RotationForm.ROWS, RotationForm.COLUMNS), 12),
    **dict.fromkeys((RotationForm.MATRIX, RotationForm.MATRIX_COLUMNS), 16),
    **dict.fromkeys(
        (RotationForm.ROTATION_VECTOR, RotationForm.RPY, RotationForm.ABC, RotationForm.MOVING_XYZ, RotationForm.MOVING_ZYZ), 6
    ),
}
_EULER_AXES = {
    RotationForm.RPY: "xyz",  # lower case: fixed axes, for scipy
    RotationForm.ABC: "ZYX",
    RotationForm.MOVING_XYZ: "XYZ",
    RotationForm.MOVING_ZYZ: "ZYZ",
}


@dataclass(frozen=True, slots=True)
class PoseForm:
    """What a reader of poses must be told."""

    rotation: RotationForm
    degrees: bool = False
    """Whether angles are in degrees; only where the form has angles."""


def forms_of_width(width: int) -> tuple[PoseForm, ...]:
    """List the forms of a pose with `width` values; empty if no form has as many."""
    found = [form for form in RotationForm if form.width == width]
    return tuple(PoseForm(form, degrees) for form in found for degrees in ((False, True) if form.has_angles else (False,)))


def read_poses(values: FloatArray, form: PoseForm, metres_per_unit: float, where: Sequence[str]) -> FloatArray:
    """Convert poses from their numbers.

    Parameters
    ----------
    values : (n, width) float, as written
    metres_per_unit : of the lengths
    where : place of each pose, such as "line 3", for the sentence of an error

    Returns
    -------
    poses : (n, 4, 4) float, metres, rotation of determinant 1

    Raises
    ------
    InputError
        A pose is not one: NaN, a quaternion that is not of length 1, a matrix that is no rotation, angles beyond two turns.
    """
    from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs] - slow to import: only who reads poses pays

    _require(np.isfinite(values).all(axis=1), where, "has NaN or an infinite number; leave lost poses out")
    form_words = f"{values.shape[1]} values; expected {form.rotation.width} of the form {form.rotation.value}"
    _require(np.full(len(values), values.shape[1] == form.rotation.width), where, f"has {form_words}")
    match form.rotation:
        case RotationForm.MATRIX | RotationForm.MATRIX_COLUMNS:
            whole = values.reshape(-1, 4, 4)
            whole = whole if form.rotation is RotationForm.MATRIX else whole.transpose(0, 2, 1)
            is_pose = (whole[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
            _require(is_pose, where, f"is no 4 x 4 pose of the form {form.rotation.value}; expected 0 0 0 1 as its last row")
            places, turns = whole[:, :3, 3], _checked_matrices(whole[:, :3, :3], where)
        case RotationForm.ROWS | RotationForm.COLUMNS:
            matrices = values[:, 3:].reshape(-1, 3, 3)
            matrices = matrices if form.rotation is RotationForm.ROWS else matrices.transpose(0, 2, 1)
            places, turns = values[:, :3], _checked_matrices(matrices, where)
        case RotationForm.QUATERNION_XYZW | RotationForm.QUATERNION_WXYZ:
            is_unit = np.abs(np.linalg.norm(values[:, 3:], axis=1) - 1.0) <= NORM_TOLERANCE
            _require(is_unit, where, "has a quaternion that is not of length 1; leave lost poses out, and check the columns")
            first = form.rotation is RotationForm.QUATERNION_WXYZ
            places, turns = values[:, :3], Rotation.from_quat(values[:, 3:], scalar_first=first).as_matrix()
        case _:
            angles = np.radians(values[:, 3:]) if form.degrees else values[:, 3:]
            is_turn = (np.abs(angles) <= MAX_ANGLE_RAD + NORM_TOLERANCE).all(axis=1)
            _require(is_turn, where, "has angles beyond one turn; check their unit: radians or degrees")
            axes = _EULER_AXES.get(form.rotation)
            turned = Rotation.from_rotvec(angles) if axes is None else Rotation.from_euler(axes, angles)
            places, turns = values[:, :3], turned.as_matrix()
    _check_lengths(places * metres_per_unit, where)
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turns, places * metres_per_unit
    return poses


def _check_lengths(places: FloatArray, where: Sequence[str]) -> None:
    """Refuse places (n, 3), metres, whose unit cannot be right."""
    near = np.abs(places).max(axis=1) <= MAX_LENGTH_M
    _require(near, where, f"lies more than {MAX_LENGTH_M:g} m from the origin; check the unit of the lengths")
    if len(places) and np.abs(places).max() < MIN_LENGTH_M:
        raise InputError(f"{where[0]}: lies, as all poses, within {MIN_LENGTH_M * 1e3:g} mm of the origin; check the unit.")


def _checked_matrices(matrices: FloatArray, where: Sequence[str]) -> FloatArray:
    off = np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    _require(off <= NORM_TOLERANCE, where, "has a matrix that is no rotation; leave lost poses out, and check the columns")
    is_right = np.linalg.det(matrices) > 0
    _require(is_right, where, "has a matrix that mirrors (determinant -1); its axes are left-handed: turn one around")
    return matrices


def _require(good: NDArray[Any] | np.bool, where: Sequence[str], what: str) -> None:
    if not good.all():
        raise InputError(f"{where[int(np.argmin(good))]}: {what}.")
