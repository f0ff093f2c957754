"""A scene made of a URDF or a mesh: what is written reads as what was said, is copied whole, and can be poked."""

import json

import numpy as np
import pytest
import trimesh

from skincal.cli import main
from skincal.cli.scene import robot_findings
from skincal.files.layout_sources import parse_grid, read_layout_file
from skincal.journal.writer import copy_scene, scene_digest
from skincal.model.errors import InputError
from skincal.model.scene import load_scene
from skincal.part.draft_preview import PartPreviewer
from skincal.part.part import load_part
from skincal.part.part_draft import PartDraft, open_draft, save_draft
from skincal.part.robot_places import robot_places
from skincal.part.scene_draft import write_scene
from skincal.session.arm_poses import ArmPoses

ROBOT = """<robot name="arm">
  <link name="base"/><link name="mount"/><link name="upper"/>
  <link name="part"><visual><origin xyz="0 0 0.05"/><geometry><mesh filename="package://arm/meshes/part.stl"
    scale="0.001 0.001 0.001"/></geometry></visual></link>
  <joint name="ft" type="fixed"><parent link="base"/><child link="mount"/><origin xyz="0 0 0.1"/></joint>
  <joint name="elbow" type="revolute"><parent link="mount"/><child link="upper"/><origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>
    <limit lower="0.2" upper="1.8"/></joint>
  <joint name="wrist" type="revolute"><parent link="upper"/><child link="part"/><origin xyz="0 0 0.1"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1"/></joint>
  <sensor name="wrist_ft" type="force_torque"><parent joint="ft"/><force_torque><frame>child</frame>
    {direction}</force_torque></sensor>
</robot>"""
DIRECTION = "<measure_direction>child_to_parent</measure_direction>"


@pytest.fixture
def urdf(tmp_path):
    for folder in ("arm/meshes", "arm/robots"):
        (tmp_path / folder).mkdir(parents=True)
    trimesh.creation.box((60.0, 40.0, 100.0)).export(tmp_path / "arm/meshes/part.stl")
    path = tmp_path / "arm/robots/arm.urdf"
    path.write_text(ROBOT.format(direction=DIRECTION))
    return path


def write(tmp_path, urdf, **values):
    grid = parse_grid("3x4@8mm").layout_text()
    given = {"urdf": urdf, "link": "part", "sensor": "wrist_ft", "unit": "", "layout_text": grid, **values}
    return write_scene(PartDraft(**given), tmp_path / "scenes/new/scene.toml")


def test_a_robots_scene_has_its_chain_sign_mesh_and_grid(tmp_path, urdf):
    scene = write(tmp_path, urdf)
    assert scene.arm.arm.joints == (0, 1)
    assert scene.arm.poses == {}, "an arm pose is streamed or chosen, never assumed"
    assert scene.robot.columns == ("elbow", "wrist")
    assert scene.wrench_sign == 1
    assert scene.skin.channels == 12
    assert scene.skin.layout.spacing == pytest.approx(0.008)
    part = load_part(scene.path)
    assert part.surface.vertices[:, 2].max() == pytest.approx(0.1)  # 50 mm of the box above 50 mm of its origin
    assert part.laid.places.shape == (12, 3)
    # The middle of the larger faces, 60 x 100 mm; of the two equal ones that along y.
    assert np.allclose(part.laid.places[:, 1], 0.02)
    assert np.allclose(part.laid.places.mean(axis=0), [0.0, 0.02, 0.05])
    straight = scene.arm.arm.link_from_sensor(np.zeros(2))
    assert straight[:3, 3].tolist() == pytest.approx([0.0, 0.0, -0.3])


def test_a_scene_says_what_the_urdf_does_not_know(tmp_path, urdf):
    urdf.write_text(ROBOT.format(direction=""))
    scene = write(tmp_path, urdf)
    assert scene.robot.sign is None
    assert "the URDF does not say" in scene.path.read_text()


def test_a_copy_holds_urdf_and_mesh_and_its_digest_covers_them(tmp_path, urdf):
    scene = write(tmp_path, urdf)
    copied = load_scene(copy_scene(scene, tmp_path / "session/scene"))
    (tmp_path / "arm").rename(tmp_path / "gone")
    again = load_part(copied.path)
    assert again.surface is not None
    angles = np.array([0.7, -0.3])
    assert copied.arm.arm.link_from_sensor(angles).tolist() == scene.arm.arm.link_from_sensor(angles).tolist()
    before = scene_digest(copied.path.parent)
    file = copied.path.parent / "arm.urdf"
    file.write_text(file.read_text().replace('xyz="0 0 0.2"', 'xyz="0 0 0.25"'))
    assert scene_digest(copied.path.parent) != before


def test_a_new_scene_holds_the_robot_and_can_be_moved_to_another_computer(tmp_path, urdf, capsys):
    secret = tmp_path / "arm/meshes/key.stl"
    secret.write_text("a private key")
    names = ("key.stl", "../../secret.stl", "gone.stl")
    others = "".join(
        f'<link name="l{number}"><visual><geometry><mesh filename="package://arm/meshes/{name}"/></geometry></visual></link>'
        f'<joint name="j{number}" type="fixed"><parent link="base"/><child link="l{number}"/></joint>'
        for number, name in enumerate(names)
    )
    urdf.write_text(urdf.read_text().replace("</robot>", f"{others}</robot>"))
    (tmp_path / "secret.stl").write_bytes((tmp_path / "arm/meshes/part.stl").read_bytes())
    out = tmp_path / "scenes/new/scene.toml"
    command = ["scene", "new", "--urdf", str(urdf), "--link", "part", "--sensor", "wrist_ft", "--grid", "3x4@8mm", "--out"]
    assert main([*command, str(out)]) == 0
    assert "copied the robot, 2 files" in capsys.readouterr().out
    before = load_part(out)
    moved = tmp_path / "usb-stick/part"
    moved.parent.mkdir()
    out.parent.rename(moved)
    (tmp_path / "arm").rename(tmp_path / "gone")
    found = sorted(path.relative_to(moved).as_posix() for path in moved.rglob("*") if path.is_file())
    assert found == ["modules.toml", "robot/arm.urdf", "robot/arm/meshes/part.stl", "scene.toml"]
    after = load_part(moved / "scene.toml")
    assert np.array_equal(after.laid.places, before.laid.places)
    assert str(tmp_path) not in (moved / "scene.toml").read_text()
    (tmp_path / "gone").rename(tmp_path / "arm")
    referring = tmp_path / "referring/scene.toml"
    assert main([*command, str(referring), "--reference"]) == 0
    inside = tmp_path / "arm/robots/scenes/scene.toml"
    assert main([*command, str(inside)]) == 0
    assert "copied" not in capsys.readouterr().out
    for path in (referring, inside):
        assert load_scene(path).robot.urdf.path.resolve() == urdf


def test_a_robot_too_large_for_a_copy_is_refused(tmp_path, urdf, monkeypatch):
    monkeypatch.setattr("skincal.part.robot_copy.MAX_ROBOT_BYTES", 1000)
    with pytest.raises(InputError, match="save without it"):
        write(tmp_path, urdf)
    assert write(tmp_path, urdf, copies_robot=False).robot.urdf.path.is_file()


def test_a_streamed_angle_outside_its_limits_is_named(tmp_path, urdf):
    poses = ArmPoses(write(tmp_path, urdf))
    for degrees, words in (
        ([60, 10], ""),
        ([150, 10], "joint elbow"),
        ([5, 70], "are exchanged"),
        ([1.0, 0.1], "radians"),
        ([3000, 400], "in degrees"),
    ):
        poses.at("", np.radians(np.array(degrees, dtype=float)))
        assert (poses.limit_warning == "") if not words else (words in poses.limit_warning)


@pytest.mark.parametrize("first", [(60, 10), (5, 70)])
def test_a_stream_with_more_columns_than_the_scene_names_is_doubted(tmp_path, urdf, first):
    """A state port of a whole arm begins with the shoulder: its angles may lie inside the limits, or fit if exchanged."""
    poses = ArmPoses(write(tmp_path, urdf))
    poses.at("", np.radians([*first, 30.0, 0.0, 0.0]))
    assert "the stream has 5 values, and the scene names the first 2: elbow, " in poses.limit_warning
    assert "exchanged" not in poses.limit_warning


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        ([(10, 40), (80, -50)], None),
        ([np.degrees((0.2, 0.7)), np.degrees((1.4, -0.9))], None),
        ([(0.3, 0.7), (1.5, -0.9)], "in radians"),
        ([(0.3, 0.7), (1.2, 0.1)], None),  # moved by less than a radian
        ([(0.3, 0.7), (4.0, -0.9)], None),
        ([(30, 4000)], "they fit as degrees"),
    ],
)
def test_radians_inside_wide_limits_are_noticed(tmp_path, urdf, poses, words):
    """Joints as wide as a UR's; the last case turns without end."""
    wide = ROBOT.format(direction=DIRECTION).replace('lower="0.2" upper="1.8"', 'lower="-6.3" upper="6.3"')
    urdf.write_text(wide.replace('type="revolute"><parent link="upper"', 'type="continuous"><parent link="upper"'))
    stream = ArmPoses(write(tmp_path, urdf))
    for pose in poses:
        stream.at("", np.radians(np.array(pose, dtype=float)))
    assert (stream.limit_warning == "") if words is None else (words in stream.limit_warning)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"link": "prt"}, "did you mean part"),
        ({"sensor": ""}, "it has wrist_ft"),
        ({"joints": ("elbow",)}, "joint wrist moves"),
        ({"layout_text": ""}, "--channels"),
        ({"urdf": None}, "--sensor is of a robot's URDF; name it by --urdf, or leave --sensor out"),
        ({"urdf": None, "sensor": "", "joints": ("elbow",)}, "--joints is of a robot's URDF"),
    ],
)
def test_what_cannot_be_a_scene_is_refused_and_leaves_nothing(tmp_path, urdf, values, words):
    with pytest.raises(InputError) as refused:
        write(tmp_path, **{"urdf": urdf, **values})
    assert words in str(refused.value)
    assert not list(tmp_path.rglob("*.toml"))


def test_a_skin_without_mesh_and_urdf_has_a_scene(tmp_path, capsys):
    """No CAD model: the frame of the positions is that of the sensor."""
    out = tmp_path / "pad/scene.toml"
    assert main(["scene", "new", "--channels", "16", "--polarity", "down", "--out", str(out)]) == 0
    assert "the sensor is taken at the origin of the link" in capsys.readouterr().out
    scene = load_scene(out)
    assert (scene.skin.channels, scene.skin.polarity, scene.surface, scene.robot) == (16, -1, None, None)
    np.testing.assert_array_equal(scene.sensor_pose, np.eye(4))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--unit", "mm"], "--unit is of a mesh"),
        (["--sensor", "tool"], "name its mesh (--mesh) or the place of the layout (--anchor-mm)"),
        (["--sensor", "none", "--tip", "0,0,100"], "write --link base"),
        (["--sensor", "arm_ft"], "name it by --urdf"),
        (["--joints", "elbow"], "name it by --urdf"),
    ],
)
def test_options_that_need_a_file_without_one_are_refused_by_their_names(tmp_path, capsys, options, words):
    out = tmp_path / "pad/scene.toml"
    assert main(["scene", "new", "--grid", "4x4@8mm", *options, "--out", str(out)]) == 2
    assert words in capsys.readouterr().err
    assert not out.parent.exists()


@pytest.mark.parametrize("text", ["6x8", "6x8@", "0x8@9mm", "6x8@9000mm", "axb@9mm", "6x8x2@9mm", ""])
def test_a_grid_is_refused(text):
    with pytest.raises(InputError, match="such as 6x8@9mm"):
        parse_grid(text)


def test_a_mesh_in_place_of_that_of_the_urdf_and_a_sign_are_options(tmp_path, urdf):
    trimesh.creation.box((60.0, 40.0, 80.0)).export(tmp_path / "own.stl")
    urdf.write_text(ROBOT.format(direction=DIRECTION).replace("package://arm/meshes/part.stl", "../meshes/part.dae"))
    scene = write(tmp_path, urdf, mesh=tmp_path / "own.stl", sign=-1)
    assert scene.surface.path.name == "own.stl"
    assert scene.wrench_sign == -1
    sign, place = robot_findings(scene.robot, scene.link, scene.wrench_sign)
    assert sign == "[wrench] sign is -1, and the URDF says +1: check one of them"
    assert "own.stl lies at the pose of the mesh that it replaces" in place


def test_a_joint_that_is_not_streamed_is_fixed_by_the_command(tmp_path, urdf, capsys):
    out = tmp_path / "scene.toml"
    words = [
        "scene",
        "new",
        "--urdf",
        str(urdf),
        "--link",
        "part",
        "--sensor",
        "wrist_ft",
        "--channels",
        "4",
        "--out",
        str(out),
    ]
    assert main([*words, "--fixed", "elbow=ninety"]) == 2
    assert main([*words, "--fixed", "elbow"]) == 2
    assert "expected NAME=DEGREES" in capsys.readouterr().err
    assert main([*words, "--fixed", "elbow=94"]) == 0
    scene = load_scene(out)
    assert scene.robot.columns == ("wrist",)
    both = write(tmp_path, urdf).arm.arm.link_from_sensor(np.radians([94.0, 20.0]))
    assert np.allclose(scene.arm.arm.link_from_sensor(np.radians([20.0])), both, atol=1e-15)


def test_visual_shapes_that_are_not_used_are_a_finding(tmp_path, urdf):
    more = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
    urdf.write_text(ROBOT.format(direction=DIRECTION).replace('<link name="part">', f'<link name="part">{more}'))
    scene = write(tmp_path, urdf)
    assert load_part(scene.path).surface is not None
    (finding,) = robot_findings(scene.robot, "part", 1)
    assert "1 further visual shape without use" in finding


def skin_frames(names):
    places = enumerate(names)
    return "".join(
        f'<link name="{name}"/><joint name="to_{name}" type="fixed"><parent link="part"/><child link="{name}"/>'
        f'<origin xyz="0 0.01 {0.1 * (number + 1)}"/></joint>'
        for number, name in places
    )


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["part_skin_5", "part_skin_2", "part_skin_99", "screw_2"], {20: 0.1, 8: 0.2}),
        (["taxel_7", "taxel_0", "taxel_3", "part_skin_5", "part_skin_2"], {7: 0.1, 0: 0.2, 3: 0.3}),
        (["part_skin_5"], None),
    ],
)
def test_skin_frames_of_the_urdf_are_known_places(tmp_path, urdf, names, expected):
    urdf.write_text(ROBOT.format(direction=DIRECTION).replace("</robot>", skin_frames(names) + "</robot>"))
    layout = tmp_path / "two.toml"
    kind = "[kinds.k]\npads_mm = [[0, 0], [4, 0], [0, 4], [4, 4]]\noutline_mm = [[-2, -2], [6, -2], [6, 6]]\ncentre_pad = 0\n"
    module = '[[modules]]\nid = {}\nkind = "k"\nfirst_channel = {}\nplace_mm = [{}, 0]\n'
    layout.write_text(
        kind + module.format(5, 20, 0) + module.format(2, 8, 20) + module.format(1, 0, 40) + module.format(3, 4, 60)
    )
    found = robot_places(write(tmp_path, urdf, layout_text=read_layout_file(layout)))
    if expected is None:
        assert found is None
        return
    assert {channel: place[2] for channel, place in found.places.items()} == pytest.approx(expected)
    assert found.link == "part"


def test_a_sensor_of_another_arm_is_a_finding(tmp_path, urdf):
    arm = (
        '<link name="other"/><joint name="o" type="fixed"><parent link="base"/><child link="other"/></joint>'
        '<link name="hand"/><joint name="h" type="continuous"><parent link="other"/><child link="hand"/></joint>'
    )
    urdf.write_text(ROBOT.format(direction=DIRECTION).replace("</robot>", f"{arm}</robot>"))
    scene = write(tmp_path, urdf, sensor="o")
    (finding,) = [words for words in robot_findings(scene.robot, "part", 1) if "not between" in words]
    assert "wrist_ft is" in finding


def test_a_mesh_alone_becomes_a_scene_by_the_command_and_is_shown(tmp_path, capsys):
    trimesh.creation.cylinder(30.0, 80.0).export(tmp_path / "can.stl")
    out = tmp_path / "can/scene.toml"
    words = [
        "scene",
        "new",
        "--mesh",
        str(tmp_path / "can.stl"),
        "--grid",
        "4x4@8mm",
        "--anchor-mm",
        "30,0,10",
        "--out",
        str(out),
    ]
    assert main(words) == 0
    scene = load_scene(out)
    assert scene.skin.anchor.normal.tolist() == pytest.approx([1.0, 0.0, 0.0], abs=0.2)
    assert main([*words[:-1], str(out)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main(["scene", "show", str(out), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["link_from_sensor"] == np.eye(4).tolist()
    assert shown["taxels"] == 16
    assert any("the sensor is taken at the origin of the link" in finding for finding in shown["findings"])
    out.write_text(out.read_text() + "\n[sensor]\npose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -0.05], [0, 0, 0, 1]]\n")
    assert main(["scene", "show", str(out)]) == 0
    assert "the sensor is taken" not in capsys.readouterr().out


def test_a_robot_is_shown_at_the_given_joints(tmp_path, urdf, capsys):
    scene = write(tmp_path, urdf)
    assert main(["scene", "show", str(scene.path), "--joints", "90,0", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    expected = scene.arm.arm.link_from_sensor(np.radians([90.0, 0.0]))
    assert np.allclose(shown["link_from_sensor"], expected)
    assert [joint["joint"] for joint in shown["chain"]] == ["elbow", "wrist"]
    assert main(["scene", "show", str(scene.path), "--joints", "90"]) == 2
    assert main(["scene", "show", str(scene.path), "--joints", "200,0"]) == 0
    assert "limits are 11 to 103" in capsys.readouterr().out


def test_a_simulated_session_of_a_robot_is_calibrated(tmp_path, urdf, capsys):
    scene = write(tmp_path, urdf, layout_text=parse_grid("4x4@8mm").layout_text())
    assert (
        main(["simulate", "--scene", str(scene.path), "--pokes", "12", "--careful", "--out", str(tmp_path / "s"), "--json"])
        == 0
    )
    capsys.readouterr()
    assert main(["solve", str(tmp_path / "s"), "--replay", "--reference", str(tmp_path / "s/truth.json"), "--json"]) == 0
    modules = json.loads(capsys.readouterr().out)["methods"]["modules"]
    assert modules["states"]["touched"] + modules["states"]["inferred"] == 16
    assert modules["predicted_error_mm"]["mean"] < 3.0


def test_what_is_wrong_with_the_place_of_a_layout_is_said_by_both_commands(tmp_path, capsys):
    """A layout folded round the rim, one larger than the part, and one that fits; the window shows the same sentences."""
    trimesh.creation.box((100.0, 80.0, 3.0)).export(tmp_path / "plate.stl")
    mesh = ["--mesh", str(tmp_path / "plate.stl"), "--unit"]
    for name, options, words in (
        ("folded", ["mm", "--grid", "6x6@9mm", "--anchor-mm", "40,0,1.5"], "12 taxels of module 1 lie beyond a rim"),
        ("large", ["mm", "--grid", "16x16@9mm"], "The layout is larger than the part: 191 mm from corner to corner"),
        ("fits", ["mm", "--grid", "6x6@9mm"], ""),
    ):
        scene = tmp_path / name / "scene.toml"
        for command in (["new", *mesh, *options, "--out", str(scene)], ["show", str(scene)]):
            assert main(["scene", *command]) == 0
            said = capsys.readouterr().out
            assert words in said
            assert words or not any(word in said for word in ("taxels of module", "The layout"))
        seen = PartPreviewer().preview(open_draft(scene), {})
        assert "".join(seen.findings["place"]) in said
        assert bool(seen.findings["place"]) is bool(words)


TOOL = ["--tip", "1,-2,130.5", "--tip-radius", "2", "--poses", "vector:mm:degrees"]


@pytest.mark.parametrize("rig", ["tool", "none"])
def test_a_part_of_a_urdf_is_poked_by_a_tool(tmp_path, urdf, capsys, rig):
    """The URDF gives link and mesh; the sensor is on the tool, or there is none, so no joint is streamed."""
    out = tmp_path / "scenes/new/scene.toml"
    command = ["scene", "new", "--urdf", str(urdf), "--link", "part", "--grid", "3x4@8mm", "--out", str(out)]
    assert main([*command, "--sensor", rig, *TOOL, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["sensor"], said["chain"], said["link_from_sensor"]) == (None, [], None)
    assert said["tool"]["sensor"] == {"tool": "on the tool", "none": "none"}[rig]
    assert not any("URDF says" in each or "does not say" in each for each in said["findings"])
    scene = load_scene(out)
    assert scene.tool.has_sensor is (rig == "tool")
    assert (scene.tool.tip.tolist(), scene.tool.tip_radius) == ([0.001, -0.002, 0.1305], 0.002)
    assert (scene.tool.form.rotation.value, scene.tool.form.degrees, scene.tool.metres_per_unit) == ("vector", True, 1e-3)
    assert (scene.arm, scene.robot.sensor, scene.finds_part_pose) == (None, "", True)
    below = write(tmp_path / "below", urdf)
    np.testing.assert_array_equal(scene.surface.link_from_mesh, below.surface.link_from_mesh)
    np.testing.assert_allclose(load_part(out).surface.vertices, load_part(below.path).surface.vertices)
    copied = load_scene(copy_scene(scene, tmp_path / "session/scene"))
    assert copied.tool.tip.tolist() == scene.tool.tip.tolist()
    assert robot_places(scene) is None
    assert main(["scene", "show", str(out)]) == 0
    draft = open_draft(out)
    assert (draft.rig.value, draft.urdf is not None, draft.sensor) == (rig, True, "")
    preview = PartPreviewer().preview(draft, {})
    assert not {"sensor", "joints", "part"} & preview.problems.keys()
    assert save_draft(draft, out).text == draft.text


def test_a_sensor_below_a_part_that_a_tool_pokes_is_refused(tmp_path, urdf, capsys):
    command = ["scene", "new", "--urdf", str(urdf), "--link", "part", "--grid", "3x4@8mm", "--out", str(tmp_path / "s.toml")]

    def refused(*words):
        assert main([*command, *words]) == 2
        assert not (tmp_path / "s.toml").exists()
        return capsys.readouterr().err

    assert "--sensor tool" in refused()
    assert "--sensor none has no --tip, which alone says where a poke is" in refused("--sensor", "none")
    assert "--joints is of joints between" in refused("--sensor", "tool", "--joints", "elbow")
    assert "--tip is of a tool" in refused("--sensor", "wrist_ft", "--tip", "0,0,1")
    assert "expected FORM:UNIT" in refused("--sensor", "tool", "--poses", "vector")
    assert "expected FORM:UNIT" in refused("--sensor", "tool", "--poses", "xyzw:m:degrees")
    urdf.write_text(urdf.read_text().replace('"mount"', '"tool"'))
    assert "means a rig" in refused("--sensor", "tool")
    assert main([*command, "--sensor", "tool", "--tip", "0,0,1"]) == 0
    text = (tmp_path / "s.toml").read_text()
    (tmp_path / "s.toml").write_text(text.replace("[robot]\n", '[robot]\nsensor = "ft"\n'))
    with pytest.raises(InputError, match="sensor is of a sensor below the part"):
        load_scene(tmp_path / "s.toml")
