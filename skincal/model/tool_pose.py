"""Poses of a tool as robots and trackers write them: numbers of one of several forms (`pose_form.py`)."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Any

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.tables import MAX_LENGTH_M

NORM_TOLERANCE = 0.001
"""Largest error of a quaternion's norm and of a matrix's products: six digits make it 1e-6; a lost body's zeros make it 1."""
MIN_LENGTH_M = 0.005
"""m. No base has all poses of a tool this near to its origin."""
MAX_ANGLE_RAD = 2.0 * np.pi
"""Beyond it a rotation vector or an Euler angle is in degrees."""


_EULER_AXES = {
    RotationForm.RPY: "xyz",  # lower case: fixed axes, for scipy
    RotationForm.ABC: "ZYX",
    RotationForm.MOVING_XYZ: "XYZ",
    RotationForm.MOVING_ZYZ: "ZYZ",
}


class PoseFault(Enum):
    """Reason why numbers are no pose, in the order of the checks; `read_poses` fills in `{...}`."""

    NOT_FINITE = "has NaN or an infinite number; leave lost poses out"
    WIDTH = "has {found} values; expected {expected} of the form {form}"
    LAST_ROW = "is no 4 x 4 pose of the form {form}; expected 0 0 0 1 as its last row"
    NO_ROTATION = "has a matrix that is no rotation; leave lost poses out, and check the columns"
    MIRRORED = "has a matrix that mirrors (determinant -1); its axes are left-handed: turn one around"
    NOT_UNIT = "has a quaternion that is not of length 1; leave lost poses out, and check the columns"
    NOT_UNIT_AXIS = "has an axis that is not of length 1; leave lost poses out, and check the columns"
    ANGLES = "has angles beyond one turn; check their unit: radians or degrees"
    TOO_NEAR = f"lies, as all before it, within {MIN_LENGTH_M * 1e3:g} mm of the origin; check the unit of the lengths"
    """Only of a stream: see `FrameDecoder`."""
    TOO_FAR = f"lies more than {MAX_LENGTH_M:g} m from the origin; check the unit of the lengths"


def convert_poses(values: FloatArray, form: PoseForm, metres_per_unit: float) -> tuple[FloatArray, list[PoseFault | None]]:
    """Convert poses from their numbers, and find those that are no poses.

    Parameters
    ----------
    values : (n, width) float, as written
    metres_per_unit : of the lengths

    Returns
    -------
    poses : (n, 4, 4) float, metres, rotation of determinant 1; NaN if it is no pose
    faults : of each pose; `None` for a good one
    """
    from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs] - slow to import: only who reads poses pays

    count = len(values)
    faults: list[PoseFault | None] = [None] * count

    def require(good: Any, fault: PoseFault) -> None:
        for row in np.flatnonzero(~np.asarray(good)).tolist():
            faults[row] = faults[row] or fault

    poses = np.full((count, 4, 4), np.nan)
    if values.shape[1] != form.rotation.width:
        require(np.zeros(count, np.bool), PoseFault.WIDTH)
        return poses, faults
    require(np.isfinite(values).all(axis=1), PoseFault.NOT_FINITE)
    values = np.where(np.isfinite(values), values, 0.0)
    places, numbers = values[:, :3], values[:, 3:]
    match form.rotation:
        case RotationForm.MATRIX | RotationForm.MATRIX_COLUMNS:
            whole = values.reshape(-1, 4, 4)
            whole = whole if form.rotation is RotationForm.MATRIX else whole.transpose(0, 2, 1)
            require((whole[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1), PoseFault.LAST_ROW)
            places, turns = whole[:, :3, 3], whole[:, :3, :3]
        case RotationForm.ROWS | RotationForm.COLUMNS:
            turns = numbers.reshape(-1, 3, 3)
            turns = turns if form.rotation is RotationForm.ROWS else turns.transpose(0, 2, 1)
        case RotationForm.QUATERNION_XYZW | RotationForm.QUATERNION_WXYZ:
            is_unit = np.abs(np.linalg.norm(numbers, axis=1) - 1.0) <= NORM_TOLERANCE
            require(is_unit, PoseFault.NOT_UNIT)
            first = form.rotation is RotationForm.QUATERNION_WXYZ
            whole_turn = np.array([1.0, 0.0, 0.0, 0.0] if first else [0.0, 0.0, 0.0, 1.0])
            turns = Rotation.from_quat(np.where(is_unit[:, None], numbers, whole_turn), scalar_first=first).as_matrix()
        case RotationForm.AXIS_ANGLE:
            is_unit = np.abs(np.linalg.norm(numbers[:, :3], axis=1) - 1.0) <= NORM_TOLERANCE
            require(is_unit, PoseFault.NOT_UNIT_AXIS)
            require(np.abs(numbers[:, 3]) <= MAX_ANGLE_RAD + NORM_TOLERANCE, PoseFault.ANGLES)
            turns = Rotation.from_rotvec(np.where(is_unit[:, None], numbers[:, :3] * numbers[:, 3:], 0.0)).as_matrix()
        case _:
            angles = np.radians(numbers) if form.degrees else numbers
            require((np.abs(angles) <= MAX_ANGLE_RAD + NORM_TOLERANCE).all(axis=1), PoseFault.ANGLES)
            axes = _EULER_AXES.get(form.rotation)
            turned = Rotation.from_rotvec(angles) if axes is None else Rotation.from_euler(axes, angles)
            turns = turned.as_matrix()
    off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    require(off <= NORM_TOLERANCE, PoseFault.NO_ROTATION)
    require(np.linalg.det(turns) > 0, PoseFault.MIRRORED)
    require(np.abs(places * metres_per_unit).max(axis=1, initial=0.0) <= MAX_LENGTH_M, PoseFault.TOO_FAR)
    good = np.array([fault is None for fault in faults], np.bool)
    poses[good] = np.eye(4)
    poses[good, :3, :3], poses[good, :3, 3] = turns[good], places[good] * metres_per_unit
    return poses, faults


def write_poses(poses: FloatArray, form: PoseForm) -> FloatArray:
    """Write poses (n, 4, 4) as numbers of a form, (n, width): the inverse of `convert_poses`, lengths in metres."""
    from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs] - slow to import: only who reads poses pays

    turns = poses[:, :3, :3]
    match form.rotation:
        case RotationForm.MATRIX | RotationForm.MATRIX_COLUMNS:
            whole = poses if form.rotation is RotationForm.MATRIX else poses.transpose(0, 2, 1)
            return whole.reshape(-1, form.rotation.width)
        case RotationForm.ROWS | RotationForm.COLUMNS:
            turns = turns if form.rotation is RotationForm.ROWS else turns.transpose(0, 2, 1)
            numbers = turns.reshape(-1, 9)
        case RotationForm.QUATERNION_XYZW | RotationForm.QUATERNION_WXYZ:
            first = form.rotation is RotationForm.QUATERNION_WXYZ
            numbers = Rotation.from_matrix(turns).as_quat(scalar_first=first)
        case RotationForm.AXIS_ANGLE:
            vectors = Rotation.from_matrix(turns).as_rotvec()
            angles = np.linalg.norm(vectors, axis=1, keepdims=True)
            whole = np.where(angles > 0, angles, 1.0)
            numbers = np.concatenate([np.where(angles > 0, vectors / whole, [1.0, 0.0, 0.0]), angles], axis=1)
        case _:
            turned, axes = Rotation.from_matrix(turns), _EULER_AXES.get(form.rotation)
            numbers = turned.as_rotvec() if axes is None else turned.as_euler(axes)
            numbers = np.degrees(numbers) if form.degrees else numbers
    return np.concatenate([poses[:, :3, 3], numbers], axis=1)


def read_poses(values: FloatArray, form: PoseForm, metres_per_unit: float, where: Sequence[str]) -> FloatArray:
    """Convert poses from their numbers; parameters as of `convert_poses`.

    `where` is the place of each pose, such as "line 3", for the sentence of an error.

    Returns
    -------
    poses : (n, 4, 4) float, metres, rotation of determinant 1

    Raises
    ------
    InputError
        A pose is not one: NaN, a quaternion that is not of length 1, a matrix that is no rotation, angles beyond two turns.
    """
    poses, faults = convert_poses(values, form, metres_per_unit)
    for place, fault in zip(where, faults, strict=True):
        if fault is not None:
            words = fault.value.format(found=values.shape[1], expected=form.rotation.width, form=form.rotation.value)
            raise InputError(f"{place}: {words}.")
    if len(poses) and np.abs(poses[:, :3, 3]).max() < MIN_LENGTH_M:
        raise InputError(f"{where[0]}: lies, as all poses, within {MIN_LENGTH_M * 1e3:g} mm of the origin; check the unit.")
    return poses
