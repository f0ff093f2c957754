"""Pinocchio reads the public iCub with taxels."""

import numpy as np
import pytest

from skincal.files.formats import ExportOptions, Inertia
from tests.consumers.robots import LINK, Skin, assert_taxels_are_right, read_kinematics

pin = pytest.importorskip("pinocchio", reason="pin has no wheel for this system")


def frame_poses(model, names, angles) -> dict[str, np.ndarray]:
    """Poses of frames in the world, the root's frame, by name."""
    configuration = pin.neutral(model)
    for joint, angle in angles.items():
        configuration[model.joints[model.getJointId(joint)].idx_q] = angle
    data = model.createData()
    pin.framesForwardKinematics(model, data, configuration)
    return {name: data.oMf[model.getFrameId(name)].homogeneous for name in names if model.existFrame(name)}


@pytest.mark.parametrize("inertia", list(Inertia))
def test_every_taxel_of_urdf_is_on_the_icub(skin: Skin, icub, tmp_path, inertia):
    options = ExportOptions(into=icub, inertia=inertia)
    robot, before = skin.write("urdf", tmp_path / "out.urdf", options), pin.buildModelFromUrdf(str(icub))
    model, mine = pin.buildModelFromUrdf(str(robot)), read_kinematics(icub)
    assert (model.nq, list(model.names)) == (before.nq, list(before.names))
    added = len(skin.channels) * 1e-6 if inertia is Inertia.TINY else 0.0
    # Without a free flyer pinocchio leaves out the mass that is fixed to the world, in both.
    assert pin.computeTotalMass(model) == pytest.approx(pin.computeTotalMass(before) + added, abs=1e-9)
    if inertia is Inertia.NONE:
        assert all(one == other for one, other in zip(model.inertias, before.inertias, strict=True))
    for seed in range(4):
        angles = mine.random_angles(seed)
        found = frame_poses(model, skin.names(), angles)
        assert_taxels_are_right(found, skin, mine.pose(LINK, angles))


def test_every_taxel_of_urdf_alone_is_found(skin: Skin, tmp_path):
    model = pin.buildModelFromUrdf(str(skin.write("urdf", tmp_path / "out.urdf")))
    assert_taxels_are_right(frame_poses(model, skin.names(), {}), skin, np.eye(4))
    assert pin.computeTotalMass(model) == 0.0


def test_two_skins_of_one_robot_are_read(skin: Skin, icub, tmp_path):
    one = skin.write("urdf", tmp_path / "one.urdf", ExportOptions(into=icub))
    two = skin.write("urdf", tmp_path / "two.urdf", ExportOptions(into=one, prefix="second_"))
    model, angles = pin.buildModelFromUrdf(str(two)), read_kinematics(icub).random_angles(1)
    pose = read_kinematics(icub).pose(LINK, angles)
    for prefix in (f"{LINK}_", "second_"):
        assert_taxels_are_right(frame_poses(model, skin.names(prefix), angles), skin, pose, prefix)
