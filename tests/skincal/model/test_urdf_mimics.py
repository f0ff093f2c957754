"""Mimic joints of a URDF follow their leader: equal to another library, and refused wherever an angle would be wrong."""

import numpy as np
import pytest

from skincal.model.errors import InputError
from skincal.model.urdf import read_urdf
from skincal.part.robot_shape import link_poses, middle_angles

HAND = """<robot name="finger"><link name="palm"/>
  <link name="proximal"/><link name="middle"/><link name="distal"/><link name="thumb"/>
  <joint name="mcp" type="revolute"><parent link="palm"/><child link="proximal"/><origin xyz="0 0 0.09"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="1.6" effort="1" velocity="1"/></joint>
  <joint name="pip" type="revolute"><parent link="proximal"/><child link="middle"/><origin xyz="0 0 0.04"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="1.6" effort="1" velocity="1"/>{pip}</joint>
  <joint name="dip" type="revolute"><parent link="middle"/><child link="distal"/><origin xyz="0 0 0.03"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="1.6" effort="1" velocity="1"/>{dip}</joint>
  <joint name="{thumb_name}" type="{thumb}"><parent link="palm"/><child link="thumb"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="1.6" effort="1" velocity="1"/></joint></robot>"""
PIP = '<mimic joint="mcp" multiplier="1.05" offset="0.1"/>'
DIP = '<mimic joint="pip" multiplier="-0.5" offset="0.2"/>'


def hand(tmp_path, pip=PIP, dip=DIP, thumb="revolute"):
    path = tmp_path / "hand.urdf"
    path.write_text(HAND.format(pip=pip, dip=dip, thumb=thumb, thumb_name="thumb_joint"))
    return read_urdf(path)


def planar(*turns):
    """Pose of the distal link in the palm: every joint turns about x."""
    pose = np.eye(4)
    for length, angle in zip((0.09, 0.04, 0.03), turns, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        pose = pose @ np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, length], [0, 0, 0, 1.0]])
    return pose


def distal_in_palm(made, columns, angles, **fixed):
    chain, _ = made.chain("distal", "palm", columns, {name: np.radians(angle) for name, angle in fixed.items()}, "scene")
    return np.linalg.inv(chain.link_from_sensor(np.array([angles[column] for column in chain.joints])))


@pytest.mark.parametrize("mcp", [0.0, 0.7, 1.4])
def test_a_finger_follows_its_streamed_leader(tmp_path, mcp):
    pip = 1.05 * mcp + 0.1
    found = distal_in_palm(hand(tmp_path), ["head", "mcp"], [9.0, mcp])
    assert np.abs(found - planar(mcp, pip, -0.5 * pip + 0.2)).max() < 1e-15


def test_a_finger_is_that_of_another_library(tmp_path):
    """One rule deep: yourdfpy does not follow a rule of a rule."""
    yourdfpy = pytest.importorskip("yourdfpy")
    made = hand(tmp_path, dip='<mimic joint="mcp" multiplier="-0.5" offset="0.2"/>')
    other = yourdfpy.URDF.load(str(made.path), load_meshes=False, build_scene_graph=True)
    other.update_cfg({"mcp": 0.6, "thumb_joint": 0.0})
    assert np.abs(distal_in_palm(made, ["mcp"], [0.6]) - other.get_transform("distal", "palm")).max() < 1e-15


@pytest.mark.parametrize(
    ("columns", "angles", "fixed", "turns"),
    [
        (["mcp", "pip"], [0.5, 0.9], {}, (0.5, 0.9, -0.25)),  # pip is read from its own column, and dip follows that
        (["dip", "mcp"], [0.3, 0.5], {}, (0.5, 0.625, 0.3)),
        ([], [], {"mcp": np.degrees(0.5)}, (0.5, 0.625, -0.1125)),
        ([], [], {"mcp": np.degrees(0.5), "pip": np.degrees(0.625)}, (0.5, 0.625, -0.1125)),  # they agree
    ],
)
def test_own_columns_and_fixed_leaders(tmp_path, columns, angles, fixed, turns):
    assert np.abs(distal_in_palm(hand(tmp_path), columns, angles, **fixed) - planar(*turns)).max() < 1e-14


def test_a_leader_elsewhere_in_the_robot_and_a_fixed_one(tmp_path):
    thumb = '<mimic joint="thumb_joint" multiplier="2"/>'
    made = hand(tmp_path, pip=thumb)
    assert np.abs(distal_in_palm(made, ["thumb_joint", "mcp"], [0.2, 0.5]) - planar(0.5, 0.4, 0.0)).max() < 1e-15
    assert np.abs(distal_in_palm(made, ["mcp"], [0.5], pip=np.degrees(0.4)) - planar(0.5, 0.4, 0.0)).max() < 1e-15
    made = hand(tmp_path, pip='<mimic joint="thumb_joint" offset="0.4"/>', thumb="fixed")
    assert np.abs(distal_in_palm(made, ["mcp"], [0.5]) - planar(0.5, 0.4, 0.0)).max() < 1e-15


REFUSED = [
    (PIP, DIP, "revolute", ["pips"], {}, r"joint dip follows mcp, .*--fixed mcp=DEGREES"),
    (PIP, DIP, "revolute", ["mcp"], {"pip": 30.0}, "pip follows mcp, which is streamed; leave pip out"),
    (PIP, DIP, "revolute", ["mcp"], {"dip": 30.0}, "dip follows mcp, which is streamed; leave dip out"),
    (PIP, DIP, "revolute", [], {"mcp": 20.0, "pip": 30.0}, r"so it is at 26\.73 degrees and not at 30"),
    ('<mimic joint="dip"/>', DIP, "revolute", ["mcp"], {}, "mimic one another in a circle"),
    ('<mimic joint="pip"/>', "", "revolute", ["mcp", "dip"], {}, "in a circle"),
    ('<mimic joint="mpc"/>', "", "revolute", ["mcp", "dip"], {}, "'mpc', which is not there; did you mean mcp"),
    ("<mimic/>", "", "revolute", ["mcp", "dip"], {}, "which is not there"),
    ('<mimic joint="thumb_joint"/>', "", "prismatic", ["mcp", "dip"], {}, "follows thumb_joint, which is prismatic"),
    (PIP, DIP, "revolute", ["mcp"], {"mcp": 20.0}, "leave it in one of them"),
]


@pytest.mark.parametrize(("pip", "dip", "thumb", "columns", "fixed", "words"), REFUSED)
def test_a_finger_whose_angles_are_unknown_or_contradict_is_refused(tmp_path, pip, dip, thumb, columns, fixed, words):
    with pytest.raises(InputError, match=words) as refused:
        distal_in_palm(hand(tmp_path, pip, dip, thumb), columns, [0.1] * len(columns), **fixed)
    if "mimic" not in str(refused.value):
        assert "copy of the URDF" not in str(refused.value) or "Only if it stands still" in str(refused.value)


def test_a_bad_rule_is_refused_with_a_sentence(tmp_path):
    with pytest.raises(InputError, match="joint pip: multiplier of <mimic>: is 'two'"):
        hand(tmp_path, pip='<mimic joint="mcp" multiplier="two"/>')


def test_the_advice_on_a_joint_that_slides_leads_to_the_right_pose(tmp_path):
    """It stands still at 20 mm: the fixed joint has that in its origin."""
    path = tmp_path / "slide.urdf"
    text = (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="s" type="prismatic"><parent link="a"/><child link="b"/>'
        '<origin xyz="0 0 0.1" rpy="1.5707963267948966 0 0"/><axis xyz="0 1 0"/></joint></robot>'
    )
    path.write_text(text)
    with pytest.raises(InputError, match=r"Only if it stands still .* its origin where it stands"):
        read_urdf(path).chain("b", "a", ["s"], {}, "scene")
    path.write_text(text.replace('"prismatic"', '"fixed"').replace("0 0 0.1", "0 0 0.12"))  # along y of the child: z of a
    chain, _ = read_urdf(path).chain("b", "a", [], {}, "scene")
    assert np.linalg.inv(chain.link_from_sensor(np.empty(0)))[:3, 3].tolist() == pytest.approx([0, 0, 0.12])


def test_the_drawn_robot_follows_too(tmp_path):
    made = hand(tmp_path)
    assert set(middle_angles(made)) == {"mcp", "thumb_joint"}
    poses = link_poses(made, {"mcp": 0.5}, "palm")
    assert np.abs(poses["distal"] - planar(0.5, 0.625, -0.1125)).max() < 1e-15
