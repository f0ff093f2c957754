"""URDF files: chains equal to another library's, force/torque sensors, meshes, and a sentence for every bad file."""

from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.model.errors import InputError
from skincal.model.mesh_lookup import find_mesh
from skincal.model.urdf import read_urdf

TREE = """<robot name="two arms">
  <link name="trunk"/><link name="left_upper"/><link name="left_hand"/><link name="right_upper"/><link name="right_hand"/>
  <link name="cover"><visual><origin xyz="0 0 0.01" rpy="0 0 1.5"/><geometry><mesh filename="{mesh}" scale="0.001 0.001 0.001"/>
  </geometry></visual></link>
  <joint name="l1" type="revolute"><parent link="trunk"/><child link="left_upper"/><origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/>
    <axis xyz="0 2 0"/><limit lower="-1.5" upper="1.0"/></joint>
  <joint name="l2" type="continuous"><parent link="left_upper"/><child link="left_hand"/><origin xyz="0 0 0.2" rpy="0 1 0"/>
    <axis xyz="1 1 0"/></joint>
  <joint name="r1" type="revolute"><parent link="trunk"/><child link="right_upper"/><origin xyz="-0.1 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-0.2" upper="0.2"/></joint>
  <joint name="r2" type="{kind}"><parent link="right_upper"/><child link="right_hand"/><origin xyz="0 0.3 0" rpy="0 0 0.5"/>
    <axis xyz="0 0 1"/>{extra}</joint>
  <joint name="glue" type="fixed"><parent link="left_hand"/><child link="cover"/><origin xyz="0 0 0.05" rpy="0.4 0 0"/></joint>
  {sensor}
</robot>"""
SENSOR = """<sensor name="ft" type="force_torque"><parent joint="l2"/><origin xyz="0 0 0.01" rpy="0.3 0.2 0.1"/>
  <force_torque><frame>{frame}</frame><measure_direction>{direction}</measure_direction></force_torque></sensor>"""


def robot(tmp_path, mesh="cover.stl", kind="fixed", extra="", sensor=""):
    path = tmp_path / "robot.urdf"
    path.write_text(TREE.format(mesh=mesh, kind=kind, extra=extra, sensor=sensor))
    return read_urdf(path)


def pose(xyz, rpy):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    matrix[:3, 3] = xyz
    return matrix


def turned(axis, angle):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    return matrix


def at(chain, columns):
    """The chain's pose with an angle for each column."""
    return chain.link_from_sensor(np.array([columns[column] for column in chain.joints]))


def test_sensor_and_part_may_lie_on_different_branches(tmp_path):
    chain, sign = robot(tmp_path).chain("cover", "right_hand", ["l2", "head", "l1", "r1"], {}, "scene")
    assert chain.joints == (0, 2, 3)
    l2, l1, r1 = 0.7, -0.4, 0.1
    trunk_from_cover = (
        pose([0.1, 0.2, 0.3], [0.1, 0.2, 0.3]) @ turned([0, 1, 0], l1) @ pose([0, 0, 0.2], [0, 1, 0]) @ turned([1, 1, 0], l2)
        @ pose([0, 0, 0.05], [0.4, 0, 0])
    )  # fmt: skip
    trunk_from_sensor = pose([-0.1, 0, 0], [0, 0, 0]) @ turned([0, 0, 1], r1) @ pose([0, 0.3, 0], [0, 0, 0.5])
    expected = np.linalg.inv(trunk_from_cover) @ trunk_from_sensor
    assert np.abs(chain.link_from_sensor(np.array([l2, l1, r1])) - expected).max() < 1e-14
    assert sign is None


def test_a_joint_that_is_not_streamed_has_a_given_angle(tmp_path):
    made = robot(tmp_path)
    streamed, _ = made.chain("cover", "trunk", ["l1", "l2"], {}, "scene")
    fixed, _ = made.chain("cover", "trunk", ["l2"], {"l1": 0.3}, "scene")
    assert fixed.joints == (0,)
    assert fixed.link_from_sensor(np.array([0.2])).tolist() == streamed.link_from_sensor(np.array([0.3, 0.2])).tolist()


@pytest.mark.parametrize(
    ("frame", "direction", "link", "sign"),
    [
        ("child", "child_to_parent", "cover", 1),
        ("parent", "parent_to_child", "cover", -1),
        ("sensor", "child_to_parent", "right_hand", -1),
    ],
)
def test_frame_and_sign_come_from_the_file(tmp_path, frame, direction, link, sign):
    made = robot(tmp_path, sensor=SENSOR.format(frame=frame, direction=direction))
    chain, found = made.chain(link, "ft", ["l1", "l2", "r1"], {}, "scene")
    assert found == sign
    at_child, _ = made.chain(link, "left_hand", ["l1", "l2", "r1"], {}, "scene")
    columns = {column: 0.1 * (column + 1) for column in range(3)}
    own = np.linalg.inv(at(at_child, columns)) @ at(chain, columns)
    expected = {
        "child": np.eye(4),
        "parent": np.linalg.inv(pose([0, 0, 0.2], [0, 1, 0]) @ turned([1, 1, 0], columns[1])),
        "sensor": pose([0, 0, 0.01], [0.3, 0.2, 0.1]),
    }[frame]
    assert np.abs(own - expected).max() < 1e-14


@pytest.mark.parametrize(("frame", "expected"), [
    ("parent", np.linalg.inv(turned([1, 1, 0], 0.2)) @ pose([0, 0, 0], [0, 1, 0]).T),
    ("sensor", pose([0, 0, 0], [0, 0, 1.5])),
])  # fmt: skip
def test_gazebos_sensor_turns_about_the_joints_origin(tmp_path, frame, expected):
    details = f"<force_torque><frame>{frame}</frame></force_torque><pose>0 0 0.1 0 0 1.5</pose>"
    made = robot(tmp_path, sensor=f'<gazebo reference="l2"><sensor name="ft" type="force_torque">{details}</sensor></gazebo>')
    columns = {0: 0.1, 1: 0.2}
    chains = [made.chain("cover", name, ["l1", "l2"], {}, "scene")[0] for name in ("left_hand", "ft")]
    own = np.linalg.inv(at(chains[0], columns)) @ at(chains[1], columns)
    assert np.abs(own - expected).max() < 1e-14


def test_gazebos_form_of_a_sensor_is_completed_by_the_other(tmp_path):
    gazebo = """<gazebo reference="l2"><sensor name="ft" type="force_torque"><force_torque><frame>child</frame>
      <measure_direction>parent_to_child</measure_direction></force_torque></sensor></gazebo>"""
    (sensor,) = robot(tmp_path, sensor=gazebo + '<sensor name="ft" type="force_torque"><parent joint="l2"/></sensor>').sensors
    assert (sensor.joint, sensor.frame, sensor.direction) == ("l2", "child", "parent_to_child")


def test_a_frame_without_a_mesh_has_that_of_a_link_fixed_to_it(tmp_path):
    made = robot(tmp_path)
    mesh, at = made.mesh_for("left_hand")
    assert (mesh.link, mesh.scale_and_pose(at, "x")[0]) == ("cover", 0.001)
    assert np.abs(at - pose([0, 0, 0.05], [0.4, 0, 0]) @ pose([0, 0, 0.01], [0, 0, 1.5])).max() < 1e-14
    assert made.mesh_for("trunk") is None
    assert made.mesh_for("left_hand", "glue") is None, "the joint of the sensor is not crossed"
    assert set(made.fixed_frames("cover")) == {"cover", "left_hand"}


@pytest.mark.parametrize(("degrees", "words"), [([5.0, 50.0], None), ([80.0, 5.0], "r1"), ([50.0, 5.0], "are exchanged")])
def test_angles_outside_the_limits_are_named(tmp_path, degrees, words):
    chain, _ = robot(tmp_path).chain("left_upper", "right_upper", ["r1", "l1"], {}, "scene")
    warning = chain.limit_warning(np.radians(degrees))
    assert (warning is None) if words is None else (words in warning)


def test_radians_taken_for_degrees_are_named(tmp_path):
    made = robot(tmp_path)
    joint = made.joints["l1"]
    assert joint.limits == (-1.5, 1.0)
    path = tmp_path / "bent.urdf"
    path.write_text((tmp_path / "robot.urdf").read_text().replace('lower="-1.5" upper="1.0"', 'lower="0.5" upper="1.5"'))
    chain, _ = read_urdf(path).chain("left_upper", "trunk", ["l1"], {}, "scene")
    assert "radians" in chain.limit_warning(np.radians(np.array([1.0])))


def test_a_mesh_of_a_package_is_found(tmp_path, monkeypatch):
    for at in ("robots/one", "meshes", "elsewhere/pack"):
        (tmp_path / "pack" / at).mkdir(parents=True)
    (tmp_path / "pack/meshes/cover.stl").write_text("solid")
    path = tmp_path / "pack/robots/one/robot.urdf"
    path.write_text(TREE.format(mesh="package://pack/meshes/cover.stl", kind="fixed", extra="", sensor=""))
    made = read_urdf(path)
    found = tmp_path / "pack/meshes/cover.stl"
    assert find_mesh(made, made.meshes["cover"], {}) == found
    alone = robot(tmp_path / "pack/elsewhere", mesh="package://pack/meshes/cover.stl")
    moved = tmp_path / "moved"
    (tmp_path / "pack").rename(moved)
    alone = robot(moved / "robots", mesh="package://pack/meshes/cover.stl")
    with pytest.raises(InputError, match=r"robot\.packages"):
        find_mesh(alone, alone.meshes["cover"], {})
    assert find_mesh(alone, alone.meshes["cover"], {"pack": moved}) == moved / "meshes/cover.stl"
    (tmp_path / "prefix/share").mkdir(parents=True)
    moved.rename(tmp_path / "prefix/share/pack")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    assert find_mesh(alone, alone.meshes["cover"], {}) == tmp_path / "prefix/share/pack/meshes/cover.stl"


@pytest.mark.parametrize(
    "mesh", ["../../etc/passwd", "/etc/passwd", "package://../x.stl", "http://host/x.stl", "file:///etc/x"]
)
def test_a_mesh_outside_the_folder_is_refused(tmp_path, mesh):
    made = robot(tmp_path, mesh=mesh)
    with pytest.raises(InputError, match="mesh of link cover"):
        find_mesh(made, made.meshes["cover"], {})


def joint(name="j", parent="a", child="b", kind="fixed", inside=""):
    ends = (f'<parent link="{parent}"/>' if parent else "") + f'<child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


def of(*parts, links="ab"):
    return "<robot>" + "".join(f'<link name="{name}"/>' for name in links) + "".join(parts) + "</robot>"


LONG = range(300)
MESH = '<link name="a"><visual><geometry><mesh filename="a" scale="1 1 0"/></geometry></visual></link>'
BAD_FILES = [
    ("", "not an XML file"),
    ("<robot", "not an XML file"),
    ("<sdf/>", "begins with <sdf>"),
    ('<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><robot>&b;</robot>', "document type"),
    ('<robot xmlns:xacro="x"><xacro:macro name="m"/></robot>', "xacro"),
    (of(joint("j"), joint("k")), "two parents"),
    (of(links="aab"), "two links are named 'a'"),
    (of(joint("j"), joint("j", "b", "c"), links="abc"), "two joints are named 'j'"),
    (of(joint(), links="a"), "'b', which is not there"),
    (of(joint("j"), joint("k", "b", "a")), "circle"),
    (of(joint(kind="screw")), "type is 'screw'"),
    (of(joint(parent="")), "no parent"),
    (of(joint(inside='<origin xyz="nan 0 0"/>')), "finite numbers"),
    (of(joint(inside='<origin xyz="0 0"/>')), "3 finite numbers"),
    (of(joint(inside='<origin xyz="0 0 1e9"/>')), "expected metres"),
    (of(joint(kind="revolute", inside='<axis xyz="0 0 0"/>')), "not zero"),
    (of(links="ab"), "no joint connects a and b"),
    ('<?xml version="1.0" encoding="foo"?><robot/>', "not an XML file"),
    (of(*(joint(f"j{i}", "l0", f"l{i}") for i in range(1, 5001)), links=[f"l{i}" for i in range(5001)]), "at most 5000"),
    (of(*(joint(f"j{i}", f"l{i}", f"l{i + 1}") for i in LONG[:-1]), links=[f"l{i}" for i in LONG]), "in depth"),
]


@pytest.mark.parametrize(("text", "words"), BAD_FILES, ids=[words for _, words in BAD_FILES])
def test_a_bad_file_is_refused_with_a_sentence(tmp_path, text, words):
    path = tmp_path / "bad.urdf"
    path.write_text(text)
    with pytest.raises(InputError, match=r"bad\.urdf") as refused:
        read_urdf(path)
    assert words in str(refused.value)


def test_prefixes_that_no_one_declares_and_a_namespace_are_read(tmp_path):
    path = tmp_path / "drake.urdf"
    path.write_text(
        of("<drake:joint_filter/>").replace("<robot>", '<robot xmlns="http://www.ros.org">').replace('<link name="b"/>', "")
    )
    assert read_urdf(path).links == ("a",)


def test_utf_16_is_refused(tmp_path):
    path = tmp_path / "wide.urdf"
    path.write_text('<!DOCTYPE r [<!ENTITY a "aaaa">]><robot>&a;</robot>', encoding="utf-16")
    with pytest.raises(InputError, match="UTF-8"):
        read_urdf(path)


def test_what_is_wrong_elsewhere_in_the_robot_is_no_fault_of_the_chain(tmp_path):
    path = tmp_path / "other.urdf"
    path.write_text(of(joint(), MESH.replace('"a"', '"c"'), joint("k", "b", "c"), SENSOR.format(frame="up", direction="x")))
    made = read_urdf(path)
    made.chain("b", "a", [], {}, "scene")
    with pytest.raises(InputError, match=r"scaled by .* not 0"):
        made.meshes["c"].scale_and_pose(np.eye(4), "scene")
    with pytest.raises(InputError, match="is at joint 'l2'"):
        made.chain("b", "ft", [], {}, "scene")


def test_a_huge_file_is_not_read(tmp_path):
    path = tmp_path / "huge.urdf"
    with path.open("wb") as file:
        file.truncate(100 << 20)
    with pytest.raises(InputError, match="at most"):
        read_urdf(path)


@pytest.mark.parametrize(
    ("link", "sensor", "columns", "fixed", "kind", "extra", "words"),
    [
        ("covr", "trunk", ["l1", "l2"], {}, "fixed", "", "did you mean cover"),
        ("cover", "ft", ["l1", "l2"], {}, "fixed", "", "no force/torque sensor, joint or link 'ft'"),
        ("cover", "trunk", ["l1"], {}, "fixed", "", "joint l2 moves"),
        ("cover", "trunk", ["l1", "l2"], {"l1": 0.1}, "fixed", "", "leave it in one of them"),
        ("right_hand", "trunk", ["r1", "r2"], {}, "prismatic", "", "is prismatic"),
        ("right_hand", "trunk", ["r1"], {"r2": 0.1}, "prismatic", "", "is prismatic"),
        ("right_hand", "trunk", ["r1"], {}, "continuous", '<mimic joint="l1"/>', "follows l1, .*--fixed l1=DEGREES"),
    ],
)
def test_a_chain_that_cannot_be_followed_is_refused(tmp_path, link, sensor, columns, fixed, kind, extra, words):
    with pytest.raises(InputError, match=words):
        robot(tmp_path, kind=kind, extra=extra).chain(link, sensor, columns, fixed, "scene")


def public_urdf(package, ending):
    """A file of an installed package; the robots have three makers."""
    try:
        files = metadata.files(package)
    except metadata.PackageNotFoundError:
        pytest.skip(f"{package} is not installed here")
    return Path(next(file for file in files if str(file).endswith(ending)).locate())


@pytest.mark.parametrize(
    ("package", "ending", "pairs"),
    [
        ("icub-models", "iCubGenova03/model.urdf", 3540),
        ("jvrc-description", "jvrc1.urdf", 3540),  # with fingers that mimic others
        ("airo-models", "ur5e.urdf", 110),
    ],
)
def test_poses_of_every_pair_of_links_are_those_of_another_library(package, ending, pairs):
    yourdfpy = pytest.importorskip("yourdfpy")
    made = read_urdf(public_urdf(package, ending))
    other = yourdfpy.URDF.load(str(made.path), load_meshes=False, build_scene_graph=True)
    moving = [name for name in other.actuated_joint_names if made.joints[name].kind in ("revolute", "continuous")]
    angles = dict(zip(moving, np.random.default_rng(3).uniform(-1.5, 1.5, len(moving)).tolist(), strict=True))
    other.update_cfg({name: angles[name] for name in other.actuated_joint_names})
    places = {link: other.get_transform(link) for link in made.links}
    compared = 0
    for link in made.links:
        for sensor in made.links:
            chain, _ = made.chain(link, sensor, moving, {}, "test")
            found = chain.link_from_sensor(np.array([angles[moving[k]] for k in chain.joints]))
            assert np.abs(found - np.linalg.inv(places[link]) @ places[sensor]).max() < 1e-12
            compared += link != sensor
    assert compared == pairs


def test_the_public_icub_has_all_that_a_calibration_needs():
    made = read_urdf(public_urdf("icub-models", "iCubGenova02/model.urdf"))
    chain, sign = made.chain("l_forearm_dh_frame", "l_arm_ft", ["l_elbow", "l_wrist_prosup"], {}, "test")
    assert (chain.joints, sign) == ((0, 1), 1)
    assert chain.limit_warning(np.radians([94.0, 0.0])) is None
    assert "radians" in chain.limit_warning(np.radians(np.radians([94.0, 0.0])))
    assert "are exchanged" in chain.limit_warning(np.radians([0.0, 50.0]))
    mesh, _ = made.mesh_for("l_forearm_dh_frame")
    assert find_mesh(made, mesh, {}).name == "sim_sea_2-5_l_forearm_prt-binary.stl"
    frames = [name for name in made.fixed_frames("l_forearm_dh_frame") if name.startswith("l_forearm_skin_")]
    assert len(frames) == 24
