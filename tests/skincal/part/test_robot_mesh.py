"""The mesh of a part on a robot: mirrored, of its own, for a link without one; and every advice about it, followed."""

import re
import shlex

import numpy as np
import pytest
import trimesh

from skincal.cli import main
from skincal.model.urdf import read_urdf
from skincal.part.draft_preview import PartPreviewer, completed_draft
from skincal.part.part import load_part
from skincal.part.part_changes import with_link
from skincal.part.part_draft import open_draft, save_draft

ROBOT = """<robot name="arm"><link name="base"/><link name="part">{shapes}</link>
  <joint name="ft" type="fixed"><parent link="base"/><child link="part"/></joint>
  <sensor name="arm_ft" type="force_torque"><parent joint="ft"/><force_torque>
    <measure_direction>child_to_parent</measure_direction></force_torque></sensor></robot>"""


def shape(filename, scale="1 1 1", origin="", kind="visual"):
    return f'<{kind}>{origin}<geometry><mesh filename="{filename}" scale="{scale}"/></geometry></{kind}>'


def wedge():
    """A closed part without symmetry, 60 x 40 x 100 mm, in mm."""
    corners = [[0, 0, 0], [60, 0, 0], [0, 40, 0], [0, 0, 100], [30, 40, 0], [60, 0, 50]]
    return trimesh.Trimesh(corners).convex_hull


@pytest.fixture
def robot(tmp_path):
    """A robot's package without a `package.xml`, with a mesh in mm."""
    for folder in ("arm/urdf", "arm/meshes"):
        (tmp_path / folder).mkdir(parents=True)
    wedge().export(tmp_path / "arm/meshes/part.stl")
    return tmp_path / "arm/urdf/arm.urdf"


def run(robot, shapes, *options, capsys, layout=("--channels", "4"), more=""):
    """Run `scene new`; return the exit code, the part and what was printed. What is refused leaves nothing."""
    robot.write_text(ROBOT.format(shapes=shapes).replace("</robot>", f"{more}</robot>"))
    out = robot.parents[2] / f"new/scenes/{len(list(robot.parents[2].rglob('scene.toml')))}/scene.toml"
    before = sorted(robot.parents[2].rglob("*"))
    command = ["scene", "new", "--urdf", str(robot), "--link", "part", "--sensor", "arm_ft", *layout, *options]
    code = main([*command, "--out", str(out)])
    said = capsys.readouterr()
    if code:
        assert sorted(robot.parents[2].rglob("*")) == before
        for copy in ("/robot/arm.urdf", "modules.toml", "scene.toml"):
            assert copy not in said.err, "it is no file of the user"
    return code, load_part(out) if code == 0 else None, said.out + said.err


def same_shape(part, mesh):
    """Whether a part is a mesh in metres: same box and volume, and outward."""
    made = trimesh.Trimesh(part.surface.vertices, part.surface.triangles)
    return np.allclose(made.bounds, mesh.bounds, atol=1e-6) and made.volume == pytest.approx(mesh.volume, rel=1e-4)


@pytest.mark.parametrize(
    "scale", ["0.001 -0.001 0.001", "-0.001 -0.001 0.001", "-0.001 -0.001 -0.001", "0.001 0.002 0.0005", "0.002 -0.001 0.001"]
)
def test_a_mirrored_or_stretched_mesh_is_that_of_another_library(robot, scale, capsys):
    code, part, _ = run(robot, shape("../meshes/part.stl", scale, '<origin xyz="0 0 0.05" rpy="0.3 0 0.2"/>'), capsys=capsys)
    assert code == 0
    truth = wedge().apply_scale([float(word) for word in scale.split()])
    truth.apply_transform(trimesh.transformations.euler_matrix(0.3, 0.0, 0.2, "sxyz"))
    truth.apply_translation((0, 0, 0.05))
    assert truth.volume > 0
    assert same_shape(part, truth)


@pytest.mark.parametrize(("scale", "up"), [("1 1 1", 1.0), ("1 -1 1", 1.0), ("-1 -1 1", 1.0), ("1 1 -1", -1.0)])
def test_a_mirror_turns_the_outside_of_a_flat_patch_with_it(robot, scale, up, capsys):
    """Its shape does not tell inside from outside: the winding of the file holds, mirrored."""
    flat = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], [[0, 1, 2], [0, 2, 3]])
    flat.export(robot.parents[1] / "meshes/flat.stl")
    _, part, _ = run(robot, shape("../meshes/flat.stl", scale), capsys=capsys)
    assert np.allclose(part.surface.normals, [0.0, 0.0, up])


def test_a_scale_of_zero_is_refused_and_another_mesh_helps(robot, capsys):
    code, _, said = run(robot, shape("../meshes/part.stl", "1 0 1"), capsys=capsys)
    assert code == 2
    assert "name another mesh (--mesh)" in said
    wedge().export(robot.parents[2] / "own.stl")
    code, part, _ = run(robot, shape("../meshes/part.stl", "1 0 1"), "--mesh", str(robot.parents[2] / "own.stl"), capsys=capsys)
    assert same_shape(part, wedge().apply_scale(1e-3))


@pytest.mark.parametrize(
    ("scale", "size", "options"),
    [
        ("0.001 -0.001 0.001", 1.0, []),
        ("1 1 1", 1.0, []),
        ("0.001 0.001 0.001", 0.1, ["--unit", "cm"]),
        ("1 1 1", 1.0, ["--unit", "mm"]),
        ("0.001 0.001 0.001", 1e-3, ["--unit", "m"]),
        ("0.001 0.001 0.001", 1 / 25.4, ["--unit", "in"]),
    ],
)
def test_an_own_mesh_has_its_own_unit_at_the_pose_of_the_urdfs_mesh(robot, tmp_path, scale, size, options, capsys):
    wedge().apply_scale(size).export(tmp_path / "own.stl")
    origin = '<origin xyz="0 0 0.05"/>'
    code, part, said = run(
        robot, shape("../meshes/part.stl", scale, origin), "--mesh", str(tmp_path / "own.stl"), *options, capsys=capsys
    )
    assert code == 0, said
    assert same_shape(part, wedge().apply_scale(1e-3).apply_translation((0, 0, 0.05)))
    assert (
        "own.stl lies at the pose of the mesh that it replaces: its origin is at (0, 0, 50) mm in link part, turned by 0"
        in said
    )


def test_the_advice_on_a_wrong_unit_is_an_option(robot, tmp_path, capsys):
    wedge().apply_scale(1e-3).export(tmp_path / "own.stl")
    own = ("--mesh", str(tmp_path / "own.stl"))
    code, _, said = run(robot, shape("../meshes/part.stl"), *own, capsys=capsys)
    assert code == 2
    unit = re.search(r"unit (\w+) would give 123.* mm.*--unit", said)[1]
    code, part, _ = run(robot, shape("../meshes/part.stl"), *own, "--unit", unit, capsys=capsys)
    assert same_shape(part, wedge().apply_scale(1e-3))


def test_the_advice_on_a_wrong_unit_holds_for_the_urdfs_own_mesh(robot, capsys):
    shapes = shape("../meshes/part.stl", origin='<origin xyz="0 0 0.05"/>')
    code, _, said = run(robot, shapes, capsys=capsys)
    assert code == 2
    unit = re.search(r"unit (\w+) would give 123.* mm.*Correct its unit \(--unit,", said)[1]
    code, part, _ = run(robot, shapes, "--unit", unit, capsys=capsys)
    assert same_shape(part, wedge().apply_scale(1e-3).apply_translation((0, 0, 0.05)))


def test_a_unit_without_a_mesh_is_refused(robot, capsys):
    code, _, said = run(robot, "", "--unit", "cm", capsys=capsys)
    assert code == 2
    assert (
        "The unit (--unit) is that of a mesh, and link part has no shape; leave it out, or name the part's mesh (--mesh FILE)"
        in said
    )
    code, _, said = run(robot, shape("../meshes/part.stl", "0.001 -0.001 0.001"), "--unit", "mm", capsys=capsys)
    assert code == 2
    assert "leave its unit (--unit) out" in said


UNREADABLE = ["damaged.stl", "gone.stl", "part.xyz", "package://arm/meshes/damaged.stl"]


@pytest.mark.parametrize("name", UNREADABLE)
@pytest.mark.parametrize("scale", ["1 1 1", "0.01 0.01 0.01"])
def test_a_visual_mesh_that_cannot_be_read_is_named_and_the_collision_mesh_offered(robot, name, scale, capsys):
    """Followed to the letter, the offer gives the collision mesh at its own pose and scale."""
    for file in ("damaged.stl", "part.xyz"):
        (robot.parents[1] / "meshes" / file).write_bytes(b"not a mesh" * 20)
    factor = float(scale.split()[0])
    wedge().apply_scale(1e-3 / factor).export(robot.parents[1] / "meshes/cover.stl")
    visual = shape(name if "//" in name else f"../meshes/{name}", "0.001 0.001 0.001", '<origin xyz="0.3 0 0"/>')
    collision = shape("../meshes/cover.stl", scale, '<origin xyz="0 0 0.02" rpy="0 0 1.5707963267948966"/>', "collision")
    code, _, said = run(robot, visual + collision, capsys=capsys)
    assert code == 2
    assert name.rpartition("/")[2] in said
    assert "not found" not in said or name == "gone.stl"
    offer = re.search(r"Or use the collision mesh of link part as the part's mesh: (--mesh .*)$", said.strip())[1]
    code, part, _ = run(robot, visual + collision, *shlex.split(offer), capsys=capsys)
    assert code == 0
    truth = wedge().apply_scale(1e-3)
    truth.apply_transform(trimesh.transformations.euler_matrix(0, 0, np.pi / 2, "sxyz"))
    assert same_shape(part, truth.apply_translation((0, 0, 0.02)))


@pytest.mark.parametrize("collision", ["", shape("../meshes/part.stl", "0.001 -0.001 0.001", kind="collision")])
def test_no_collision_mesh_is_offered_that_would_be_wrong(robot, collision, capsys):
    code, _, said = run(robot, shape("../meshes/gone.stl") + collision, capsys=capsys)
    assert code == 2
    assert "collision mesh of" not in said


@pytest.mark.parametrize("scale", ["0.001 -0.001 0.001", "0.0007 0.0007 0.0007"])
def test_the_advice_on_a_collision_mesh_without_a_unit_keeps_its_place(robot, scale, capsys):
    """Under another name the file would lie where the visual mesh does."""
    mesh, origin = robot.parents[1] / "meshes/part.stl", '<origin xyz="0 0 0.02" rpy="0.3 0 0.2"/>'
    collision = shape("../meshes/part.stl", scale, origin, "collision")
    visual = shape("../meshes/gone.stl", origin='<origin xyz="0.3 0 0"/>')
    code, _, said = run(robot, visual + collision, "--mesh", str(mesh), capsys=capsys)
    assert code == 2
    assert (
        "leave the mesh (--mesh) out, and put it with its <origin> in place of the link's visual shapes, in a copy of the URDF"
        in said
    )
    code, part, _ = run(robot, collision.replace("collision", "visual"), capsys=capsys)
    truth = wedge().apply_scale([float(word) for word in scale.split()])
    truth.apply_transform(trimesh.transformations.euler_matrix(0.3, 0.0, 0.2, "sxyz"))
    assert same_shape(part, truth.apply_translation((0, 0, 0.02)))


def test_a_mesh_in_place_of_a_mirrored_one_is_reported(robot, tmp_path, capsys):
    """The file may be the one that the URDF mirrors, under a name that is not found."""
    wedge().export(tmp_path / "own.stl")
    for scale, is_reported in (("0.001 -0.001 0.001", True), ("1 2 1", True), ("0.001 0.001 0.001", False)):
        shapes = shape("package://elsewhere/own.stl", scale)
        code, part, said = run(robot, shapes, "--mesh", str(tmp_path / "own.stl"), capsys=capsys)
        assert code == 0
        assert ("own.stl is used without this scale" in said) == is_reported
        preview = PartPreviewer().preview(open_draft(part.scene.path), {})
        assert ("own.stl is used without this scale" in " ".join(preview.findings["part"])) == is_reported


def test_the_urdfs_own_mesh_may_be_named_and_a_mirrored_one_not_with_a_unit(robot, capsys):
    mesh = str(robot.parents[1] / "meshes/part.stl")
    for scale, options, expected in (
        ("0.001 -0.001 0.001", [], [0.001, -0.001, 0.001]),
        ("0.001 0.001 0.001", ["--unit", "cm"], [0.01] * 3),
    ):
        _, part, _ = run(robot, shape("../meshes/part.stl", scale), "--mesh", mesh, *options, capsys=capsys)
        assert same_shape(part, wedge().apply_scale(expected))
    code, _, said = run(robot, shape("../meshes/part.stl", "1 -1 1"), "--mesh", mesh, "--unit", "mm", capsys=capsys)
    assert code == 2
    assert "leave its unit (--unit) out" in said


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        ('<visual><geometry><cylinder radius="0.03" length="0.1"/></geometry></visual>', "link part has visual cylinder"),
        (
            shape("../meshes/other.stl", "0.001 0.001 0.001", '<origin xyz="1 0 0"/>', "collision"),
            "link part has collision mesh other.stl",
        ),
        ("", "link part has no shape"),
    ],
)
def test_a_link_without_a_mesh_gets_an_own_one_in_the_links_frame(robot, tmp_path, shapes, words, capsys):
    wedge().export(robot.parents[1] / "meshes/other.stl")
    code, part, said = run(robot, shapes, capsys=capsys)
    assert (code, part.surface) == (0, None)
    assert f"no mesh: {words}" in said
    assert "Name the part's mesh by --mesh" in said
    wedge().apply_scale(0.1).export(tmp_path / "own.stl")
    code, part, said = run(
        robot, shapes, "--mesh", str(tmp_path / "own.stl"), "--unit", "cm", capsys=capsys, layout=("--grid", "3x4@8mm")
    )
    assert code == 0, said
    assert same_shape(part, wedge().apply_scale(1e-3))
    assert part.laid is not None
    draft = open_draft(part.scene.path)
    text = part.scene.path.read_text()
    assert "[surface]" in text
    assert save_draft(draft, part.scene.path).text == text, "the window saves it as it is"
    seen = PartPreviewer().preview(draft, {})
    assert seen.size_mm == pytest.approx((60, 40, 100))
    moved = with_link(draft, read_urdf(draft.urdf), "base")  # a frame of the same body, at the same place
    assert (moved.mesh, moved.mesh_pose) == (draft.mesh, draft.mesh_pose)
    assert completed_draft(seen).mesh_pose == draft.mesh_pose


@pytest.mark.parametrize(
    "name", ["../meshes/part.stl", "file://{}/meshes/part.stl", "{}/meshes/part.stl", " ../meshes/part.stl "]
)
def test_a_copy_has_the_mesh_and_no_private_file_and_can_be_moved(robot, tmp_path, name, capsys):
    (robot.parents[1] / "meshes/notes.stl").write_text("private")
    (tmp_path / "secret.stl").write_bytes((robot.parents[1] / "meshes/part.stl").read_bytes())
    (tmp_path / "arm/urdf/meshes").mkdir()
    (tmp_path / "arm/urdf/meshes/part.stl").write_bytes((robot.parents[1] / "meshes/part.stl").read_bytes() + b"")
    others = ("../meshes/notes.stl", "../../secret.stl", f"file://{tmp_path.as_posix()}/secret.stl", "meshes/part.stl")
    more = "".join(
        f'<link name="l{number}">{shape(other)}</link><joint name="j{number}" type="fixed"><parent link="base"/>'
        f'<child link="l{number}"/></joint>'
        for number, other in enumerate(others)
    )
    mesh = shape(name.format(robot.parents[1].as_posix()), "0.001 0.001 0.001")
    code, part, said = run(robot, mesh, more=more, capsys=capsys)
    assert code == 0, said
    assert "copied the robot, 3 files" in said
    moved = tmp_path / "usb-stick"
    part.scene.path.parent.rename(moved)
    robot.parents[1].rename(tmp_path / "gone")
    found = sorted(path.relative_to(moved).as_posix() for path in moved.rglob("*") if path.is_file())
    assert found == ["robot/arm.urdf", "robot/meshes/part.stl", "robot/other/meshes/part.stl", "scene.toml"]
    again = load_part(moved / "scene.toml")
    assert np.array_equal(again.surface.vertices, part.surface.vertices)
    assert same_shape(again, wedge().apply_scale(1e-3))


def test_two_meshes_of_one_name_are_both_copied(robot, tmp_path, capsys):
    """The one above the URDF's folder and the one in it would have the same name in the copy."""
    (tmp_path / "arm/urdf/meshes").mkdir()
    wedge().apply_scale(2.0).export(tmp_path / "arm/urdf/meshes/part.stl")
    more = (
        f'<link name="other">{shape("meshes/part.stl")}</link><joint name="o" type="fixed"><parent link="base"/>'
        '<child link="other"/></joint>'
    )
    _, part, _ = run(robot, shape("../meshes/part.stl", "0.001 0.001 0.001"), more=more, capsys=capsys)
    assert same_shape(part, wedge().apply_scale(1e-3))


@pytest.mark.parametrize(
    ("shapes", "options", "words"),
    [
        (shape("../meshes/gone.stl"), [], "arm/meshes/gone.stl|../meshes/gone.stl is not found"),
        (shape("package://nowhere/part.stl"), [], "--package nowhere=FOLDER"),
        (shape("../meshes/part.stl"), [], "Correct its unit"),
        (shape("../meshes/part.stl", "0.001 0.001 0.001"), ["--fixed", "nowhere=3"], "no joint 'nowhere'"),
        (
            shape("../meshes/part.stl", "0.001 0.001 0.001"),
            ["--grid", "3x4@8mm"],
            "a skin frame has 4 values; expected at least 12",
        ),
        (shape("../meshes/part.stl", "0.001 0.001 0.001"), ["--fixed", "ft=3", "--fixed", "ft=4"], "--fixed has ft twice"),
        (shape("../meshes/part.stl", "0.001 0.001 0.001"), ["--fixed", "ft=4000"], "skincal: --fixed ft has an angle of 4000"),
        (shape("../meshes/part.stl", "0.001 0.001 0.001"), ["--fixed", "ft=x"], "--fixed ft is x; expected a number."),
        (shape("../meshes/part.stl", "0.001 0.001 0.001"), ["--joints", "a,b, a"], "--joints has a twice"),
        (shape("../meshes/part.stl", "0.001 0.001 0.001"), ["--mesh", "nowhere.stl"], "nowhere.stl: there is no such mesh"),
        (shape("../meshes/part.stl", "0.001 0.001 0.001"), ["--sensor", "nowhere"], "no force/torque sensor, joint or link"),
    ],
)
def test_a_refused_scene_leaves_nothing_and_names_the_users_files(robot, shapes, options, words, capsys):
    code, _, said = run(robot, shapes, *options, capsys=capsys)
    assert code == 2
    assert any(word in said for word in words.split("|"))
