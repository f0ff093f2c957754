"""One pose in each form: the rotation is built by hand from its three angles, and not by the library that reads it."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.model.errors import InputError
from skincal.model.pose_form import PoseForm, RotationForm, forms_of_width
from skincal.model.tool_pose import read_poses, write_poses

PLACE = np.array([0.1, -0.2, 0.3])


def about(axis: int, angle_deg: float):
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    turn = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
    return turn


TURN = about(2, 30) @ about(1, 20) @ about(0, 10)
POSE = np.eye(4)
POSE[:3, :3], POSE[:3, 3] = TURN, PLACE
# Half-angle products of the three turns, by Hamilton's rule; and the axis of (R - R')/2 times the angle.
XYZW = np.array([0.038135, 0.189308, 0.239298, 0.951549])
ANGLE = np.arccos((np.trace(TURN) - 1) / 2)
VECTOR = ANGLE / (2 * np.sin(ANGLE)) * np.array([TURN[2, 1] - TURN[1, 2], TURN[0, 2] - TURN[2, 0], TURN[1, 0] - TURN[0, 1]])
BY_FORM = {
    RotationForm.QUATERNION_XYZW: XYZW,
    RotationForm.QUATERNION_WXYZ: np.roll(XYZW, 1),
    RotationForm.ROTATION_VECTOR: VECTOR,
    RotationForm.AXIS_ANGLE: np.append(VECTOR / ANGLE, ANGLE),
    RotationForm.RPY: np.radians([10, 20, 30]),
    RotationForm.ABC: np.radians([30, 20, 10]),
    RotationForm.MOVING_XYZ: np.radians([-1.116055, 22.242181, 28.451775]),
    RotationForm.MOVING_ZYZ: np.radians([2.726830, 22.268744, 25.505550]),
    RotationForm.ROWS: TURN.ravel(),
    RotationForm.COLUMNS: TURN.T.ravel(),
}


def values_of(form):
    if form.width == 16:
        return (POSE if form is RotationForm.MATRIX else POSE.T).flatten()
    return np.concatenate([PLACE, BY_FORM[form]])


def read(values, form, unit=1.0):
    return read_poses(np.array([values]), form, unit, ["line 1"])[0]


@pytest.mark.parametrize("form", RotationForm, ids=lambda form: form.value)
def test_each_form_gives_the_same_pose(form):
    values = values_of(form)
    assert form.width == len(values)
    np.testing.assert_allclose(read(values, PoseForm(form)), POSE, atol=2e-6)
    if form.has_angles:
        values[3:] = np.degrees(values[3:])
        np.testing.assert_allclose(read(values, PoseForm(form, degrees=True)), POSE, atol=2e-6)


def test_moving_angles_are_turned_one_after_the_other():
    angles = np.degrees(BY_FORM[RotationForm.MOVING_ZYZ])
    np.testing.assert_allclose(about(2, angles[0]) @ about(1, angles[1]) @ about(2, angles[2]), TURN, atol=1e-7)
    angles = np.degrees(BY_FORM[RotationForm.MOVING_XYZ])
    np.testing.assert_allclose(about(0, angles[0]) @ about(1, angles[1]) @ about(2, angles[2]), TURN, atol=1e-7)


def test_lengths_have_a_unit():
    values = np.concatenate([PLACE * 1e3, XYZW])
    np.testing.assert_allclose(read(values, PoseForm(RotationForm.QUATERNION_XYZW), 1e-3), POSE, atol=2e-6)


@pytest.mark.parametrize(
    ("form", "change", "says"),
    [
        (RotationForm.QUATERNION_XYZW, {3: 0, 4: 0, 5: 0, 6: 0}, "not of length 1"),
        (RotationForm.QUATERNION_XYZW, {0: np.nan}, "NaN"),
        (RotationForm.QUATERNION_XYZW, {0: 100.0}, "check the unit of the lengths"),
        (RotationForm.QUATERNION_XYZW, {0: 1e-4, 1: 2e-4, 2: 3e-4}, "within 5 mm of the origin"),
        (RotationForm.ROTATION_VECTOR, {3: 28.0}, "radians or degrees"),
        (RotationForm.AXIS_ANGLE, {6: 33.1}, "radians or degrees"),
        (RotationForm.AXIS_ANGLE, {3: 0, 4: 0, 5: 0, 6: 0}, "not of length 1"),
        (RotationForm.ROWS, {3: 0.0}, "no rotation"),
        (RotationForm.MATRIX, {15: 2.0}, "0 0 0 1"),
    ],
)
def test_numbers_that_are_no_pose_are_refused(form, change, says):
    values = values_of(form)
    values[list(change)] = list(change.values())
    with pytest.raises(InputError, match=says):
        read(values, PoseForm(form))


def test_a_mirrored_matrix_is_refused_as_left_handed():
    values = np.concatenate([PLACE, (TURN @ np.diag([1, 1, -1])).ravel()])
    with pytest.raises(InputError, match="left-handed"):
        read(values, PoseForm(RotationForm.ROWS))


def test_another_number_of_values_is_refused():
    with pytest.raises(InputError, match="has 6 values; expected 7 of the form xyzw"):
        read(values_of(RotationForm.RPY), PoseForm(RotationForm.QUATERNION_XYZW))


def test_the_forms_of_a_width_are_all_that_have_it():
    assert {form.rotation for width in (6, 7, 12, 16) for form in forms_of_width(width)} == set(RotationForm)
    assert len(forms_of_width(6)) == 10
    assert forms_of_width(5) == ()


@pytest.mark.parametrize("form", [form for width in (6, 7, 12, 16) for form in forms_of_width(width)])
def test_a_written_pose_is_read_as_the_same_one(form):
    np.testing.assert_allclose(read_poses(write_poses(POSE[None], form), form, 1.0, ["line 1"])[0], POSE, atol=1e-12)
