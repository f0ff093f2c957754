"""Mistakes of a tool's rig made on purpose, in sessions of the independent simulator: what the program says within 20 pokes."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.model.pose_form import PoseForm, RotationForm
from skincal.rig.scene_mistakes import MistakeKind
from skincal.rig.touch_mistakes import TouchedPlaces, find_touch_mistake
from tests.skincal.rig.tool_mistake_bench import MADE, SKIN_POKES, poked, said

SAYS = {
    "tool centre point of another tool": ("mm from tip_mm, in the tool's frame", "correct tip_mm of [tool]"),
    "pose of the tip read as that of the flange": ("are those of its tip, not of the flange", "send the pose of the flange"),
    "inverse poses": ("the poses of the tool are inverse", "send the poses of the tool in the base"),
    "quaternion scalar first": ("is a quaternion w x y z", "correct rotation of [tool]"),
    "rotation vector read as angles": ("is a rotation vector in radians", "correct rotation of [tool]"),
    "left-handed tracker": ("y and z of the tool's poses are exchanged", "turn the axes"),
    "sensor turned on the flange": ("the sensor is turned by 90 degrees about", "turn flange by that"),
    "sign of the force": ("the pokes show the reaction force", "invert that sign"),
    "part moved in the middle": ("moved by about", "press the landmarks again"),
}


@pytest.mark.parametrize("name", SAYS)
def test_a_mistake_made_on_purpose_is_named_with_its_remedy(name):
    form = PoseForm(RotationForm.RPY) if "vector" in name else None
    first = said(MADE[name](poked()), form=form)[0]
    assert first.startswith("The scene does not fit the pokes: ")
    assert all(words in first for words in SAYS[name])


def test_a_pose_of_the_tip_is_named_if_the_scene_gives_the_parts_pose():
    first = said(MADE["pose of the tip read as that of the flange"](poked()), is_given=True)[0]
    assert "are those of its tip, not of the flange" in first


def test_the_poke_before_which_the_part_moved_is_named():
    first = said(MADE["part moved in the middle"](poked(3)))[0]
    assert "before poke 14." in first
    assert any(f"moved by about {by} mm" in first for by in range(19, 30))


@pytest.mark.parametrize("seed", range(1, 6))
def test_a_right_rig_is_not_blamed(seed):
    assert not any("does not fit" in each or "no known mistake" in each for each in said(poked(seed)))


def test_a_turned_sensor_is_not_seen_where_a_controller_takes_out_the_weight():
    made = MADE["sensor turned on the flange"](poked())
    rest = np.random.default_rng(1).normal(0.0, 0.05, made.rest_wrench.shape)
    assert not any("does not fit" in each for each in said(replace(made, rest_wrench=rest)))


def touched(poses, places, tip, marks=6):
    count = len(poses)
    sds = np.where(np.arange(count) < marks, 0.002, 0.005)
    return TouchedPlaces(np.arange(1, count + 1), poses, places, sds, tip, PoseForm(RotationForm.QUATERNION_XYZW))


def random_touches(seed=1, count=20):
    rng = np.random.default_rng(seed)
    tip, poses = np.array([0.002, -0.001, 0.12]), np.tile(np.eye(4), (count, 1, 1))
    turns, _ = np.linalg.qr(rng.standard_normal((count, 3, 3)))
    poses[:, :3, :3] = turns * np.sign(np.linalg.det(turns))[:, None, None]
    places = rng.uniform(-0.05, 0.05, (count, 3))
    part, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    part *= np.sign(np.linalg.det(part))
    poses[:, :3, 3] = places @ part.T + [0.4, 0.1, 0.2] - poses[:, :3, :3] @ tip
    return poses, places, tip


def test_touches_that_fit_show_no_mistake_and_few_touches_are_not_judged():
    poses, places, tip = random_touches()
    assert find_touch_mistake(touched(poses, places, tip)) is None
    wrong = np.linalg.inv(poses)
    assert find_touch_mistake(touched(wrong, places, tip)).mistake.kind is MistakeKind.TOOL_INVERSE
    assert find_touch_mistake(touched(wrong[:7], places[:7], tip)) is None


def test_another_tip_is_measured():
    poses, places, tip = random_touches(2)
    found = find_touch_mistake(touched(poses, places, tip + np.array([0.01, 0.0, -0.03])))
    assert found.mistake.kind is MistakeKind.TOOL_OTHER_TIP
    assert found.mistake.names == ("-10", "0", "30")
    assert found.mistake.miss < 1e-4 < found.miss


def test_a_skin_that_lies_off_its_plan_is_no_part_that_moved():
    poses, places, tip = random_touches(3)
    off = places + np.where(np.arange(20) < 6, 0.0, 0.015)[:, None] * [1.0, 0.0, 0.0]
    found = find_touch_mistake(touched(poses, off, tip))
    assert found is None or found.mistake.kind is not MistakeKind.TOOL_PART_MOVED


def test_scattered_touches_have_no_named_mistake():
    poses, places, tip = random_touches(4)
    shaken = replace(touched(poses, places, tip), place=np.random.default_rng(5).uniform(-0.1, 0.1, places.shape))
    assert find_touch_mistake(shaken) is None


def test_a_session_of_the_bench_has_twenty_pokes():
    assert len(poked().wrench) <= 6 + SKIN_POKES
