"""Force/torque sensors of a URDF: poses relative to other links, sensors without a type, and sensors that feel the part."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.model.errors import InputError
from skincal.model.urdf import read_urdf
from skincal.words.robot_words import sensor_findings

ARM = """<robot name="arm"><link name="base"/><link name="upper"/><link name="ft_link"/><link name="forearm"/>
  <joint name="elbow" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3" rpy="0.2 0 0"/>
    <axis xyz="0 1 0"/></joint>
  <joint name="ft_joint" type="fixed"><parent link="upper"/><child link="ft_link"/>
    <origin xyz="0.02 0 0.1" rpy="0 0 0.5"/></joint>
  <joint name="rest" type="fixed"><parent link="ft_link"/><child link="forearm"/><origin xyz="0 0 0.05"/></joint>
  {sensor}</robot>"""


def arm(tmp_path, sensor):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM.format(sensor=sensor))
    return read_urdf(path)


def of_gazebo(pose, frame="sensor"):
    details = f"<force_torque><frame>{frame}</frame><measure_direction>child_to_parent</measure_direction></force_torque>"
    return f'<gazebo reference="ft_joint"><sensor name="ft" type="force_torque">{details}{pose}</sensor></gazebo>'


def of_idyntree(place):
    details = "<force_torque><frame>sensor</frame></force_torque>"
    return f'<sensor name="ft" type="force_torque"><parent joint="ft_joint"/>{details}{place}</sensor>'


def matrix(xyz, rotation):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), xyz
    return pose


def rpy(*angles):
    return Rotation.from_euler("xyz", angles)


ELBOW, FT = matrix([0, 0, 0.3], rpy(0.2, 0, 0)), matrix([0.02, 0, 0.1], rpy(0, 0, 0.5))
GIVEN = matrix([0.01, 0.02, 0.03], rpy(0.1, 0.2, 0.3))
POSE = "0.01 0.02 0.03 0.1 0.2 0.3"
QUATERNION = " ".join(map(str, rpy(0.1, 0.2, 0.3).as_quat()))
IN_DEGREES = "0.01 0.02 0.03 " + " ".join(map(str, np.degrees([0.1, 0.2, 0.3])))
PLACES = [
    (f"<pose>{POSE}</pose>", GIVEN),
    (f'<pose relative_to="">{POSE}</pose>', GIVEN),
    (f'<pose degrees="true">{IN_DEGREES}</pose>', GIVEN),
    (f'<pose degrees="0">{POSE}</pose>', GIVEN),
    (f'<pose rotation_format="quat_xyzw">0.01 0.02 0.03 {QUATERNION}</pose>', GIVEN),
    (f'<pose relative_to="ft_link">{POSE}</pose>', GIVEN),
    (f'<pose relative_to="ft_joint">{POSE}</pose>', GIVEN),
    (f'<pose relative_to="upper">{POSE}</pose>', np.linalg.inv(FT) @ GIVEN),
    (f'<pose frame="upper" degrees="true">{IN_DEGREES}</pose>', np.linalg.inv(FT) @ GIVEN),
    (f'<pose relative_to="base">{POSE}</pose>', np.linalg.inv(ELBOW @ FT) @ GIVEN),  # SDFormat: the elbow at 0
    (f'<pose relative_to="forearm">{POSE}</pose>', matrix([0, 0, 0.05], rpy(0, 0, 0)) @ GIVEN),
    (f'<origin xyz="0.01 0.02 0.03" quat_xyzw="{QUATERNION}"/>', GIVEN),
    ("<pose/>", np.eye(4)),
]


@pytest.mark.parametrize(("place", "expected"), PLACES)
def test_the_pose_of_a_sensor_is_resolved(tmp_path, place, expected):
    chain, _ = arm(tmp_path, of_idyntree(place)).chain("ft_link", "ft", ["elbow"], {}, "scene")
    assert np.abs(chain.link_from_sensor(np.empty(0)) - expected).max() < 1e-12
    if "origin" not in place:
        chain, _ = arm(tmp_path, of_gazebo(place)).chain("ft_link", "ft", ["elbow"], {}, "scene")
        turned = expected.copy()
        turned[:3, 3] = 0.0  # Gazebo's moment is about the joint's origin
        assert np.abs(chain.link_from_sensor(np.empty(0)) - turned).max() < 1e-12


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (
            f'<pose relative_to="uper">{POSE}</pose>',
            "no link or joint of the robot; write the pose relative to the link ft_link",
        ),
        (f'<pose relative_to="__model__">{POSE}</pose>', "no link or joint"),
        (f'<pose relative_to="upper" frame="base">{POSE}</pose>', "leave one of them"),
        (f'<pose expressed_in="upper">{POSE}</pose>', "attribute expressed_in='upper', which is not understood"),
        (f'<pose degrees="yes">{POSE}</pose>', "expected true or false"),
        (f'<pose rotation_format="matrix">{POSE}</pose>', "euler_rpy or quat_xyzw"),
        ('<pose rotation_format="quat_xyzw">0 0 0 0 0 0 2</pose>', "has the length 2"),
        ("<pose>0 0 0 0 0 0 1</pose>", "expected 6 finite numbers"),
        ('<origin xyz="0 0 0" rpy_deg="0 0 90"/>', "attribute rpy_deg='0 0 90'"),
        ('<origin rpy="0 0 1" quat_xyzw="0 0 0 1"/>', "has rpy and quat_xyzw"),
    ],
)
def test_a_pose_that_is_not_understood_is_never_read(tmp_path, place, words):
    made = arm(tmp_path, of_idyntree(place))
    with pytest.raises(InputError) as refused:
        made.chain("forearm", "ft", ["elbow"], {}, "scene")
    assert words in str(refused.value)
    made.chain("forearm", "ft_link", ["elbow"], {}, "scene")
    if "origin" not in place:  # the pose does not matter to the frame of the child
        arm(tmp_path, of_gazebo(place, "child")).chain("forearm", "ft", ["elbow"], {}, "scene")


def test_the_advice_on_a_pose_leads_to_the_right_sensor(tmp_path):
    """The pose relative to `upper` is rewritten relative to the link that the sentence names."""
    own = np.linalg.inv(FT) @ GIVEN
    text = " ".join(map(repr, [*own[:3, 3].tolist(), *Rotation.from_matrix(own[:3, :3]).as_euler("xyz").tolist()]))
    chains = [
        arm(tmp_path, of_idyntree(place)).chain("forearm", "ft", ["elbow"], {}, "scene")[0]
        for place in (f'<pose relative_to="upper">{POSE}</pose>', f"<pose>{text}</pose>")
    ]
    poses = [chain.link_from_sensor(np.empty(0)) for chain in chains]
    assert np.abs(poses[0] - poses[1]).max() < 1e-12


def test_an_origin_of_a_joint_that_is_not_understood_is_refused(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM.format(sensor="").replace('rpy="0 0 0.5"', 'rot="0 0 0.5"'))
    with pytest.raises(InputError, match=r"joint ft_joint: origin: has the attribute rot='0 0 0.5'"):
        read_urdf(path)


@pytest.mark.parametrize(
    ("kind", "count", "words"), [("", 1, ["has no type"]), ('type="force_torque"', 1, []), ('type="imu"', 0, None)]
)
def test_a_sensor_without_a_type_is_read_and_reported(tmp_path, kind, count, words):
    made = arm(
        tmp_path,
        f'<sensor name="ft" {kind}><parent joint="ft_joint"/><force_torque><frame>child</frame></force_torque></sensor>'
        '<sensor name="camera"><parent link="base"/></sensor>',
    )
    assert len(made.sensors) == count
    if words is not None:
        assert made.sensor_named("ft", "scene").joint == "ft_joint"
        found = sensor_findings(made, "ft", "forearm")
        assert len(found) == len(words)
        assert all(word in each for word, each in zip(words, found, strict=True))


LEAVES = """<robot name="ur"><link name="base"/><link name="upper"/>
  <link name="wrist"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
  <link name="ft_frame"/><link name="ft_optical"/><link name="tool"/><link name="finger"/><link name="other"/>
  <link name="gripper"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/></joint>
  <joint name="bend" type="revolute"><parent link="upper"/><child link="wrist"/></joint>
  <joint name="to_ft" type="fixed"><parent link="wrist"/><child link="ft_frame"/></joint>
  <joint name="to_optical" type="fixed"><parent link="ft_frame"/><child link="ft_optical"/></joint>
  <joint name="to_tool" type="fixed"><parent link="wrist"/><child link="tool"/></joint>
  <joint name="to_gripper" type="fixed"><parent link="tool"/><child link="gripper"/></joint>
  <joint name="knuckle" type="revolute"><parent link="tool"/><child link="finger"/></joint>
  <joint name="to_other" type="revolute"><parent link="base"/><child link="other"/></joint></robot>"""


@pytest.mark.parametrize(
    ("sensor", "felt", "not_felt"),
    [
        ("ft_frame", ["wrist", "tool", "gripper", "finger"], ["upper", "other", "base"]),
        ("ft_optical", ["wrist", "finger"], ["upper"]),
        ("to_ft", ["wrist", "tool", "finger"], ["upper"]),
        ("base", ["base", "upper", "finger", "other"], []),
        ("bend", ["wrist", "finger"], ["upper", "other"]),
        ("to_gripper", ["gripper"], ["wrist", "finger"]),  # a joint with a body behind it: that body alone is felt
        ("other", ["other"], ["finger", "upper"]),
    ],
)
def test_a_leaf_feels_as_its_body_and_the_root_feels_everything(tmp_path, sensor, felt, not_felt):
    path = tmp_path / "ur.urdf"
    path.write_text(LEAVES)
    made = read_urdf(path)
    assert [link for link in felt if sensor_findings(made, sensor, link)] == []
    assert all("not between the part and the robot's base" in sensor_findings(made, sensor, link)[0] for link in not_felt)
