"""yourdfpy, an independent reader of URDF in Python, reads the public iCub with taxels."""

import numpy as np
import pytest
import yourdfpy

from skincal.files.formats import ExportOptions, Inertia
from tests.consumers.robots import LINK, Skin, assert_taxels_are_right, read_kinematics


def read(path) -> yourdfpy.URDF:
    return yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)


@pytest.mark.parametrize("inertia", list(Inertia))
def test_every_taxel_of_urdf_is_on_the_icub(skin: Skin, icub, tmp_path, inertia):
    robot = read(skin.write("urdf", tmp_path / "out.urdf", ExportOptions(into=icub, inertia=inertia)))
    before, mine = read(icub), read_kinematics(icub)
    assert robot.validate()
    assert robot.actuated_joint_names == before.actuated_joint_names
    masses = [sum(link.inertial.mass for link in each.robot.links if link.inertial) for each in (robot, before)]
    added = len(skin.channels) * 1e-6 if inertia is Inertia.TINY else 0.0
    assert masses[0] - masses[1] == pytest.approx(added, abs=1e-9)
    angles = mine.random_angles(1)
    robot.update_cfg({name: angles[name] for name in robot.actuated_joint_names})
    found = {name: robot.get_transform(name, mine.base) for name in skin.names()}
    assert_taxels_are_right(found, skin, mine.pose(LINK, angles))


def test_every_taxel_of_urdf_alone_is_found(skin: Skin, tmp_path):
    robot = read(skin.write("urdf", tmp_path / "out.urdf"))
    assert_taxels_are_right({name: robot.get_transform(name, LINK) for name in skin.names()}, skin, np.eye(4))


def test_a_tactile_sensor_does_not_disturb_the_robot(skin: Skin, icub, tmp_path):
    robot = read(skin.write("tactile-urdf", tmp_path / "out.urdf", ExportOptions(into=icub)))
    assert len(robot.robot.links) == len(read(icub).robot.links)
