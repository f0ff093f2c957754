"""Names of streamed arm poses: one for poses that are nearly the same, whatever the arm passed through before."""

import dataclasses

import numpy as np
import pytest

from skincal.geometry import Arm, DhLink
from skincal.model.scene import ArmSpec
from skincal.session.arm_poses import ArmPoses
from tests.skincal.poke_script import small_scene


@pytest.fixture
def poses() -> ArmPoses:
    arm = Arm((0, 1), (DhLink(0.1, 0.0, 0.0, 0.0), DhLink(0.05, 0.0, 0.5, 0.0)), np.eye(4))
    scene = small_scene(arm=ArmSpec(arm, {"up": np.radians([80.0, 80.0])}))
    return ArmPoses(dataclasses.replace(scene))


def poke(poses: ArmPoses, *degrees: float) -> str:
    """Stream angles and poke there; return the pose's name."""
    name, sensor = poses.at("", np.radians(degrees))
    poses.add_used(name, sensor)
    return name


def test_angles_on_both_sides_of_a_rounding_are_one_pose(poses):
    assert poke(poses, 12.49, 20.0) == poke(poses, 12.51, 20.0) == poke(poses, 13.6, 20.3) == "12 deg, 20 deg"
    assert poke(poses, 25.0, 20.0) == "25 deg, 20 deg"
    assert poke(poses, 12.6, 20.0) == "12 deg, 20 deg"
    assert poke(poses, 80.2, 80.0) == "up"


def test_poses_that_the_arm_passes_through_are_not_kept_and_change_no_name(poses):
    for degrees in np.linspace(0.0, 60.0, 500):
        poses.at("", np.radians([degrees, 20.0]))
    assert not poses._used
    assert poke(poses, 12.51, 20.0) == "13 deg, 20 deg", "as if the arm had come straight here"
    assert poke(poses, 12.49, 20.0) == "13 deg, 20 deg"


def test_a_trembling_joint_does_not_rename_a_pose_before_its_first_poke(poses):
    names = {poses.at("", np.radians([degrees, 20.0]))[0] for degrees in (12.49, 12.51, 12.48, 12.6)}
    assert names == {"12 deg, 20 deg"}


def test_sessions_of_old_formats_keep_a_name_for_each_rounded_angle(poses):
    poses.are_grouped = False
    assert (poke(poses, 12.49, 20.0), poke(poses, 12.51, 20.0)) == ("12 deg, 20 deg", "13 deg, 20 deg")
