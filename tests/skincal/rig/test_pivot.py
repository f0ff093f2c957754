"""The fixed-point test on touches made by hand: the tip within its error, and each wrong reading named."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.tool_pose import read_poses
from skincal.rig.pivot import Mistake, PivotState, TipMismatch, compare_tip, find_readings, fit_pivot, judge_touches
from skincal.words.tool_words import pivot_sentences
from tests.approved import approved

TIP, POINT, TOUCH_SD = np.array([0.01, -0.005, 0.12]), np.array([0.4, -0.2, 0.1]), 0.0003
VECTOR = PoseForm(RotationForm.ROTATION_VECTOR)


def touch(rng, count=6, lean_deg=25.0, sd=TOUCH_SD):
    """Rotations and positions of a tool that looks down, leans to all sides and turns about itself."""
    around = np.arange(count) * 2.0 * np.pi / count
    leans = np.radians(lean_deg) * np.stack([np.cos(around), np.sin(around), 0.0 * around], axis=1)
    spins = np.stack([0.0 * around, 0.0 * around, rng.uniform(-1.0, 1.0, count)], axis=1)
    turns = Rotation.from_rotvec(leans) * Rotation.from_euler("xyz", [3.0, 0.1, 0.4]) * Rotation.from_rotvec(spins)
    return turns, POINT - turns.apply(TIP) + rng.normal(0.0, sd, (count, 3))


def values(turns, places):
    return np.hstack([places, turns.as_rotvec()])


def where(count):
    return [f"line {k + 1}" for k in range(count)]


def judge(numbers, given=None):
    return judge_touches(numbers, 1.0, where(len(numbers)), given)


def fit(turns, places):
    return fit_pivot(read_poses(values(turns, places), VECTOR, 1.0, where(len(places))))


def test_the_tip_is_found_and_its_error_is_true():
    misses = []
    for seed in range(200):
        found = fit(*touch(np.random.default_rng(seed)))
        away = found.tip - TIP
        misses.append(away @ np.linalg.solve(found.covariance, away))
    # Hotelling: t^2 of 3 numbers with 12 degrees of freedom is below 3 * 12 / 10 * F(0.95; 3, 10) = 13.35 in 95 %.
    assert 0.90 <= np.mean(np.array(misses) < 13.35) <= 0.99
    assert np.linalg.norm(found.point - POINT) < 0.002


def test_the_fit_equals_a_general_least_squares_to_the_last_digits():
    turns, places = touch(np.random.default_rng(3))
    rows = np.hstack([turns.as_matrix().reshape(-1, 3), np.tile(-np.eye(3), (len(places), 1))])
    expected = np.linalg.lstsq(rows, -places.ravel())[0]
    found = fit(turns, places)
    np.testing.assert_allclose(np.r_[found.tip, found.point], expected, atol=1e-12)


WRITTEN = {
    "vector": (RotationForm.ROTATION_VECTOR, False, lambda r: r.as_rotvec()),
    "vector in degrees": (RotationForm.ROTATION_VECTOR, True, lambda r: r.as_rotvec(degrees=True)),
    "rpy in degrees": (RotationForm.RPY, True, lambda r: r.as_euler("xyz", degrees=True)),
    "zyz": (RotationForm.MOVING_ZYZ, False, lambda r: r.as_euler("ZYZ")),
    "xyzw": (RotationForm.QUATERNION_XYZW, False, lambda r: r.as_quat()),
    "wxyz": (RotationForm.QUATERNION_WXYZ, False, lambda r: r.as_quat(scalar_first=True)),
    "columns": (RotationForm.COLUMNS, False, lambda r: r.as_matrix().transpose(0, 2, 1).reshape(-1, 9)),
}


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize("seed", range(5))
def test_the_form_of_the_rotation_is_found_from_the_numbers_alone(name, seed):
    form, degrees, write = WRITTEN[name]
    turns, places = touch(np.random.default_rng(seed))
    result = judge(np.hstack([places, write(turns)]))
    assert result.state is PivotState.AGREES
    assert (result.reading.form, result.reading.mistake) == (PoseForm(form, degrees), Mistake.NONE)


MISREAD = {
    "vector as rpy": (lambda r, p: np.hstack([p, r.as_rotvec()]), PoseForm(RotationForm.RPY), Mistake.NONE),
    "xyzw as wxyz": (lambda r, p: np.hstack([p, r.as_quat()]), PoseForm(RotationForm.QUATERNION_WXYZ), Mistake.NONE),
    "inverse rotation": (lambda r, p: np.hstack([p, r.inv().as_rotvec()]), VECTOR, Mistake.ROTATION_INVERSE),
    "y up": (lambda r, p: np.hstack([p[:, [0, 2, 1]] * (1, 1, -1), r.as_rotvec()]), VECTOR, Mistake.POSITION_Y_UP),
    "z up": (lambda r, p: np.hstack([p[:, [0, 2, 1]] * (1, -1, 1), r.as_rotvec()]), VECTOR, Mistake.POSITION_Z_UP),
    "exchanged": (lambda r, p: np.hstack([p[:, [0, 2, 1]], r.as_rotvec()]), VECTOR, Mistake.POSITION_YZ_EXCHANGED),
}


@pytest.mark.parametrize("name", MISREAD)
@pytest.mark.parametrize("seed", range(5))
def test_a_wrong_reading_is_named_with_the_right_one(name, seed):
    write, given, mistake = MISREAD[name]
    result = judge(write(*touch(np.random.default_rng(seed))), given)
    assert result.state is PivotState.OTHER_READING
    assert result.others[0].mistake is mistake
    np.testing.assert_allclose(result.others[0].fit.tip, TIP, atol=0.002)


def test_a_point_that_moved_fits_no_reading():
    turns, places = touch(np.random.default_rng(1))
    places[3] += (0.02, 0.0, 0.01)
    result = judge(values(turns, places), VECTOR)
    assert result.state is PivotState.SCATTERED
    assert int(np.argmax(result.reading.fit.misses)) == 3


def test_touches_that_lean_one_way_leave_the_tip_open():
    rng = np.random.default_rng(2)
    turns = Rotation.from_rotvec(np.outer(np.linspace(0.1, 0.6, 6), (1.0, 0.0, 0.0)))
    places = POINT - turns.apply(TIP) + rng.normal(0.0, TOUCH_SD, (6, 3))
    result = judge(values(turns, places), VECTOR)
    assert result.state is PivotState.OPEN
    assert abs(result.reading.fit.open_direction[0]) > 0.99


@pytest.mark.parametrize("lean_deg", [0.0, 1.0])
def test_touches_that_hardly_lean_never_give_a_sure_tip(lean_deg):
    turns, places = touch(np.random.default_rng(2), lean_deg=lean_deg)
    assert judge(values(turns, places)).state in (PivotState.OPEN, PivotState.UNDECIDED)
    assert judge(values(turns, places), VECTOR).state is PivotState.OPEN


def test_a_turn_of_the_base_turns_the_point_and_leaves_the_tip():
    turns, places = touch(np.random.default_rng(4))
    base = Rotation.from_euler("xyz", [0.3, -0.7, 1.1])
    one, other = fit(turns, places), fit(base * turns, base.apply(places) + 0.5)
    np.testing.assert_allclose(other.tip, one.tip, atol=1e-12)
    np.testing.assert_allclose(other.point, base.apply(one.point) + 0.5, atol=1e-12)


def test_a_known_tip_names_what_the_touches_alone_cannot_show():
    turns, places = touch(np.random.default_rng(5))
    found = fit(turns, places)
    inverse = fit(turns.inv(), -turns.inv().apply(places))
    of_tip = fit(turns, places + turns.apply(TIP))
    assert compare_tip(found, TIP) is None
    assert compare_tip(inverse, TIP) is TipMismatch.INVERSE
    assert compare_tip(found, TIP * 1e3) is TipMismatch.UNIT
    assert compare_tip(of_tip, TIP) is TipMismatch.POSE_OF_TIP
    assert compare_tip(found, np.zeros(3)) is TipMismatch.POSE_OF_FLANGE
    assert compare_tip(found, TIP + np.array([0.0, 0.03, 0.0])) is TipMismatch.OTHER_TOOL


def test_sentences_say_what_was_seen_and_what_to_do():
    turns, places = touch(np.random.default_rng(6))
    numbers = values(turns, places)
    assert pivot_sentences(judge(numbers, PoseForm(RotationForm.RPY)), None) == [approved("tool.other_reading")]
    assert pivot_sentences(judge(numbers, VECTOR), TIP) == [
        approved("tool.agrees"),
        approved("tool.tip"),
        approved("tool.known_agrees"),
    ]
    assert pivot_sentences(judge(numbers, VECTOR), np.zeros(3))[-1] == approved("tool.flange")
    places[3] += (0.02, 0.0, 0.01)
    assert pivot_sentences(judge(values(turns, places), VECTOR), None) == [approved("tool.scattered")]


def test_readings_of_equal_poses_are_kept_once():
    turns, places = touch(np.random.default_rng(7))
    numbers = np.hstack([places, turns.as_matrix().reshape(-1, 9)])
    found = find_readings(numbers, 1.0, where(len(numbers)))
    # By columns is the inverse rotation of by rows: 2 rotations, and 3 other axes of the position with each form.
    assert len(found) == 8
    assert found[0].form.rotation is RotationForm.ROWS
