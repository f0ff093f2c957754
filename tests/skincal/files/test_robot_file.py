"""Whole robots with taxels: everything else stays as it is, and wrong robots are refused with a sentence."""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import yourdfpy

from skincal.files.export import write_calibration
from skincal.files.formats import ExportOptions, Inertia
from skincal.files.reference import read_place_sets
from skincal.files.robot_file import check_robot
from skincal.model.errors import InputError
from skincal.taxels.result import Method
from tests.skincal.files.files_support import make_calibration

LINK = "r_forearm_dh_frame"
URDF = """<?xml version="1.0" encoding="{encoding}"?>
<!-- caf\u00e9: </robot> is no end here -->
<robot name="arm" xmlns:xi="http://www.w3.org/2001/XInclude">
  <link name="base"><inertial><mass value="2.5"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="upper"><inertial><mass value='0.75'/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <visual><geometry><mesh filename="{mesh}"/></geometry></visual></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <link name="r_forearm_dh_frame"/>
  <joint name="to_skin" type="fixed"><parent link="upper"/><child link="r_forearm_dh_frame"/>
    <origin xyz="0.1 0 0" rpy="0 1.5707963267948966 0"/></joint>
  <gazebo reference="upper"><sensor name="camera" type="camera"/></gazebo>
</robot>
<!-- after the end -->
"""
SDF = """<sdf version="1.9"><world name="w">
  <model name="other"><link name="elsewhere"/><frame name="r_forearm_dh_frame_taxel_0"/></model>
  <model name="arm">
    <link name="base"><inertial><mass>2.5</mass></inertial></link>
    <link name="r_forearm_dh_frame"><inertial><mass>0.5</mass></inertial></link>
    <joint name="turn" type="revolute"><parent>base</parent><child>r_forearm_dh_frame</child>
      <axis><xyz>0 1 0</xyz></axis></joint>
    <model name="gripper"><link name="finger"/></model>
  </model>
</world></sdf>"""


@pytest.fixture(scope="module")
def calibration(part):
    return make_calibration(part, unseen=(5,))


def write_robot(path: Path, text: str = URDF, encoding: str = "utf-8", mesh: str = "package://arm/a.stl") -> Path:
    path.write_bytes(text.replace("{encoding}", encoding).replace("{mesh}", mesh).encode(encoding))
    return path


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "iso-8859-1"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("ending", ["\n</robot>", "</robot>", "   </robot  >"])
def test_the_robot_stays_as_it_is_to_the_last_byte(calibration, tmp_path, encoding, newline, ending):
    text = URDF.replace("\n</robot>", ending).replace("\n", newline).replace("-sig", "")
    robot = write_robot(tmp_path / "robot.urdf", text, encoding)
    robot.write_bytes(robot.read_bytes().replace(b"utf-8-sig", b"utf-8"))
    for format_ in ("urdf", "tactile-urdf"):
        out = tmp_path / f"{format_}.urdf"
        write_calibration(calibration, format_, out, Method.FREE, ExportOptions(into=robot))
        before, after = robot.read_bytes(), out.read_bytes()
        end = before.index(b"</robot", before.index(b"gazebo>"))
        rest = len(before) - end
        kept = before[:end].rstrip(b" ")
        assert after.startswith(kept)
        assert after[-rest:] == before[end:]
        added = after[len(kept) : -rest]
        assert added.count(b"\r\n") == (added.count(b"\n") if newline == "\r\n" else 0)
        ET.fromstring(after)


def test_every_taxel_is_found_on_the_robot_at_its_place(part, calibration, tmp_path):
    robot, out = write_robot(tmp_path / "robot.urdf"), tmp_path / "out.urdf"
    said = write_calibration(calibration, "urdf", out, Method.FREE, ExportOptions(into=robot))
    assert (
        "33 taxels are added to robot.urdf: the mass of 3.25 kg and 1 moving joint are unchanged, every name is found." in said
    )
    found = yourdfpy.URDF.load(str(out), load_meshes=False, build_scene_graph=True)
    assert found.actuated_joint_names == ["turn"]
    found.update_cfg([0.4])
    # By hand: 1 m up, turned by 0.4 rad about y, then 0.1 m along x and a quarter turn about y.
    turn = np.array([[np.cos(0.4), 0, np.sin(0.4)], [0, 1, 0], [-np.sin(0.4), 0, np.cos(0.4)]])
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    for channel in np.setdiff1d(calibration.channels, [5]).tolist():
        expected = [0, 0, 1] + turn @ (np.array([0.1, 0, 0]) + quarter @ part.places[channel])
        pose = found.get_transform(f"{LINK}_taxel_{channel}", "base")
        np.testing.assert_allclose(pose[:3, 3], expected, atol=1e-8)
        np.testing.assert_allclose(pose[:3, 2], turn @ quarter @ part.normals[channel], atol=1e-7)


def test_the_mass_of_taxels_that_have_one_is_said(calibration, tmp_path):
    robot, out = write_robot(tmp_path / "robot.urdf"), tmp_path / "out.urdf"
    said = write_calibration(calibration, "urdf", out, Method.FREE, ExportOptions(into=robot, inertia=Inertia.TINY))
    assert any("the mass of 3.25 kg and 1 moving joint are unchanged (the taxels have 33 mg)" in each for each in said)
    masses = [float(each.get("value")) for each in ET.parse(out).iter("mass")]
    assert sum(masses) == pytest.approx(3.25 + 33e-6, abs=1e-12)


def test_a_second_skin_goes_into_the_robot_with_the_first(calibration, tmp_path):
    robot, one, two = write_robot(tmp_path / "robot.urdf"), tmp_path / "one.urdf", tmp_path / "two.urdf"
    write_calibration(calibration, "urdf", one, Method.FREE, ExportOptions(into=robot))
    with pytest.raises(InputError, match=rf"has {LINK}_taxel_0 and 65 more of the names of the taxels already\. .*--prefix"):
        write_calibration(calibration, "urdf", two, Method.FREE, ExportOptions(into=one))
    # The sentence's advice, followed.
    write_calibration(calibration, "urdf", two, Method.FREE, ExportOptions(into=one, prefix="second_"))
    links = [each.get("name") for each in ET.parse(two).getroot().findall("link")]
    assert len(links) == len(set(links)) == 3 + 2 * 33
    with pytest.raises(InputError, match=r"has .* of the taxels already"):
        write_calibration(calibration, "urdf", two, Method.FREE, ExportOptions(into=one, prefix=f"{LINK}_"))


def test_a_tactile_sensor_in_the_robot_is_read_as_known_positions(part, calibration, tmp_path):
    robot, out = write_robot(tmp_path / "robot.urdf"), tmp_path / "out.urdf"
    said = write_calibration(calibration, "tactile-urdf", out, Method.FREE, ExportOptions(into=robot))
    assert any(each.startswith("a tactile sensor of 33 taxels is added to robot.urdf") for each in said)
    (found,) = read_place_sets(out)
    assert found.link == LINK
    assert all(np.allclose(found.places[channel], part.places[channel], atol=1e-9) for channel in found.places)
    assert len(found.places) == 33


def test_frames_go_into_the_model_that_has_the_link(calibration, tmp_path):
    robot, out = write_robot(tmp_path / "world.sdf", SDF), tmp_path / "out.sdf"
    said = write_calibration(calibration, "sdf", out, Method.FREE, ExportOptions(into=robot))
    mass = "the mass of 3 kg of 2 of its 4 links"
    assert f"33 taxels are added to world.sdf: {mass} and 1 moving joint are unchanged, every name is found." in said
    arm = ET.parse(out).find("world/model[@name='arm']")
    frames = arm.findall("frame")
    assert len(frames) == 33
    assert {frame.get("attached_to") for frame in frames} == {LINK}
    assert [each.get("name") for each in arm.findall("link")] == ["base", LINK], "no link is added"
    assert out.read_text().startswith(SDF[: SDF.index("  </model>\n</world>")])


@pytest.mark.parametrize(
    ("format_", "text", "words"),
    [
        ("urdf", URDF.replace(f'link name="{LINK}"', 'link name="r_forearm"'), f"has no link '{LINK}'.*nearest are r_forearm"),
        ("urdf", URDF.replace("</robot>", f'<link name="{LINK}"/></robot>'), "has the link .* 2 times.*leave out the others"),
        ("sdf", SDF.replace(f'<link name="{LINK}', f'<link name="{LINK}"/><link name="{LINK}', 1), "has the link .* 2 times"),
        ("urdf", "<robot name='x'/>", "has no link .*it has none at all"),
        ("urdf", SDF, "begins with <sdf>; expected <robot>.*choose the format sdf"),
        ("sdf", URDF, "begins with <robot>; expected <sdf>.*choose the format urdf or tactile-urdf"),
        ("urdf", "<mujoco/>", "begins with <mujoco>; expected <robot>, a robot's URDF"),
        ("urdf", "<robot", "not an XML file"),
        ("urdf", '<!DOCTYPE a [<!ENTITY b "c">]><robot/>', "document type"),
        ("urdf", '<robot><xacro:property name="a"/></robot>', "is a xacro file.*xacro robot > robot.urdf"),
        ("sdf", SDF.replace('"1.9"', '"1.6"'), "is SDF 1.6; frames on links need 1.7 or newer"),
        ("sdf", SDF.replace(' version="1.9"', ""), "is SDF without a version"),
        ("sdf", SDF.replace("elsewhere", LINK), "2 models have a link .*expected one"),
    ],
)
def test_a_robot_that_cannot_have_the_taxels_is_refused(calibration, tmp_path, format_, text, words):
    robot, out = write_robot(tmp_path / "robot", text, "utf-8"), tmp_path / "out.xml"
    with pytest.raises(InputError, match=words):
        write_calibration(calibration, format_, out, Method.FREE, ExportOptions(into=robot))
    assert not out.exists()


def test_the_robots_own_file_is_never_replaced(calibration, tmp_path):
    robot = write_robot(tmp_path / "robot.urdf")
    (tmp_path / "folder").mkdir()
    for out in (robot, tmp_path / "folder" / ".." / "robot.urdf"):
        with pytest.raises(InputError, match="is the robot's own file"):
            write_calibration(calibration, "urdf", out, Method.FREE, ExportOptions(into=robot))
    with pytest.raises(InputError, match="name the robot's URDF file"):
        write_calibration(calibration, "urdf", robot, Method.FREE, ExportOptions(into=tmp_path / "none.urdf"))
    assert [each.name for each in tmp_path.iterdir() if each.is_file()] == ["robot.urdf"]


def test_meshes_that_are_not_found_from_another_folder_are_said(calibration, tmp_path):
    robot = write_robot(tmp_path / "robot.urdf", mesh="../meshes/a.stl")
    (tmp_path / "results").mkdir()
    said = write_calibration(calibration, "urdf", tmp_path / "results" / "out.urdf", Method.FREE, ExportOptions(into=robot))
    assert any(
        "names 1 file of meshes from its own folder: programs find them only if out.urdf is there" in each for each in said
    )
    # The sentence's advice, followed.
    said = write_calibration(calibration, "urdf", tmp_path / "out.urdf", Method.FREE, ExportOptions(into=robot))
    assert not any("meshes" in each for each in said)


def test_the_check_finds_every_kind_of_damage(calibration, tmp_path):
    robot = write_robot(tmp_path / "robot.urdf")
    write_calibration(calibration, "urdf", tmp_path / "out.urdf", Method.FREE, ExportOptions(into=robot))
    good = (tmp_path / "out.urdf").read_bytes()
    names = [f"{LINK}_taxel_{channel}" for channel in calibration.channels.tolist() if channel != 5]
    assert "33" in check_robot(robot, good, names, "33 taxels are")
    for old, new in (
        (b'value="2.5"', b'value="3.5"'),
        (b"<mass value='0.75'/>", b""),
        (b'name="turn" type="revolute"', b'name="turn" type="fixed"'),
        (b'name="turn"', b'name="turned"'),
        (b'name="base"', b'name="root"'),
        (f'link name="{LINK}_taxel_0"'.encode(), b'link name="taxel_0"'),
        (f'link name="{LINK}_taxel_1"'.encode(), f'link name="{LINK}_taxel_0"'.encode()),
    ):
        assert old in good
        with pytest.raises(RuntimeError, match="differs from the robot"):
            check_robot(robot, good.replace(old, new), names, "33 taxels are")


def test_a_name_of_strangers_goes_into_the_robot_as_it_is(calibration, tmp_path):
    hostile = 'a"b<c>&-- d\u00e9'
    scene = replace(calibration.scene, link=hostile, name=hostile)
    text = URDF.replace(f'"{LINK}"', '"a&quot;b&lt;c&gt;&amp;-- d\u00e9"')
    robot, out = write_robot(tmp_path / "robot.urdf", text, "iso-8859-1"), tmp_path / "out.urdf"
    write_calibration(replace(calibration, scene=scene), "urdf", out, Method.FREE, ExportOptions(into=robot))
    parents = [each.get("link") for each in ET.parse(out).iter("parent")]
    assert parents.count(hostile) == 33


def test_lines_of_taxels_are_short(calibration, tmp_path):
    """PyBullet cuts lines after 8191 characters."""
    write_calibration(calibration, "urdf", tmp_path / "out.urdf", Method.FREE, ExportOptions(inertia=Inertia.TINY))
    assert max(len(line) for line in (tmp_path / "out.urdf").read_text().splitlines()) < 200


@pytest.mark.parametrize(
    ("head", "link", "left"),
    [
        ("", '<link name="${prefix}base"/>', r"\$\{prefix\}base"),
        ("", '<link name="$(arg side)_base"/>', r"\$\(arg side\)_base"),
        (' xmlns:x="http://www.ros.org/wiki/xacro"', '<x:include filename="a.xacro"/>', "<x:include>"),
    ],
)
def test_leftovers_of_xacro_are_refused_by_name(calibration, tmp_path, head, link, left):
    text = URDF.replace('name="arm"', f'name="arm"{head}').replace(
        '<link name="r_forearm_dh_frame"/>', f'{link}<link name="{LINK}"/>'
    )
    into = write_robot(tmp_path / "robot.urdf", text)
    with pytest.raises(InputError, match=rf"is a xacro file \(it has {left}\); make a URDF of it first: xacro"):
        write_calibration(calibration, "urdf", tmp_path / "out.urdf", Method.FREE, ExportOptions(into=into))


def said(robot):
    return check_robot(robot, robot.read_bytes(), [], "None is")


def test_masses_that_sdf_does_not_state_and_merged_models_are_named(tmp_path):
    robot = write_robot(tmp_path / "robot.sdf", SDF.replace("<mass>2.5</mass>", "").replace("<mass>0.5</mass>", ""))
    assert "its links, which state no mass, and 1 moving joint are unchanged" in check_robot(
        robot, robot.read_bytes(), [], "None is"
    )
    robot = write_robot(tmp_path / "robot.sdf", SDF.replace("<mass>2.5</mass>", ""))
    assert "the mass of 0.5 kg of 1 of its 4 links and" in said(robot)
    merged = SDF.replace('<model name="arm">', '<model name="arm"><include merge="true"><uri>model://hand</uri></include>')
    robot = write_robot(tmp_path / "robot.sdf", merged)
    assert 'that it includes with merge="true" are in other files' in said(robot)
