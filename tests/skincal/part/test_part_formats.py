"""Parts from COLLADA and GLB files: by the command, by a URDF and in a draft."""

import numpy as np
import pytest
import trimesh

from skincal.cli import main
from skincal.mesh.load import load_surface
from skincal.model.errors import InputError
from skincal.model.scene import load_scene
from skincal.part.draft_preview import PartPreviewer
from skincal.part.part_changes import with_part_file
from skincal.part.part_draft import PartDraft
from skincal.part.robot_shape import load_robot_shape
from tests.approved import approved

SIDES_M = np.array([0.06, 0.04, 0.08])
ROBOT = """<robot name="r"><link name="base"/><link name="part"><visual><origin xyz="0 0 0.1" rpy="{rpy}"/><geometry>
<mesh filename="{mesh}" scale="1 1 1"/></geometry></visual></link>
<joint name="wrist_ft" type="fixed"><parent link="base"/><child link="part"/></joint></robot>"""


def dae_box(unit, up="Z_UP"):
    box = trimesh.creation.box(SIDES_M / unit)
    numbers = " ".join(map(repr, box.vertices.ravel().tolist()))
    corners = " ".join(map(str, box.faces.ravel().tolist()))
    return f"""<COLLADA version="1.4.1"><asset><unit meter="{unit}"/><up_axis>{up}</up_axis></asset><library_geometries>
<geometry id="g"><mesh><source id="s"><float_array id="a" count="24">{numbers}</float_array><technique_common>
<accessor source="#a" count="8" stride="3"><param name="X"/><param name="Y"/><param name="Z"/></accessor></technique_common>
</source><vertices id="v"><input semantic="POSITION" source="#s"/></vertices><triangles count="12">
<input semantic="VERTEX" source="#v" offset="0"/><p>{corners}</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>""".encode()


def glb_box(sides):
    return trimesh.creation.box(sides).export(file_type="glb")


def new_scene(folder, *options):
    out = folder / "part" / "scene.toml"
    return main(["scene", "new", *map(str, options), "--channels", "4", "--out", str(out)]), out


def sides_of(scene):
    surface, _ = load_surface(load_scene(scene).surface)
    return np.ptp(surface.vertices, axis=0)


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.001, 0.0254])
def test_the_command_takes_the_unit_of_a_collada_file(tmp_path, unit):
    (tmp_path / "part.dae").write_bytes(dae_box(unit))
    code, scene = new_scene(tmp_path, "--mesh", tmp_path / "part.dae")
    assert code == 0
    np.testing.assert_allclose(sides_of(scene), SIDES_M, rtol=1e-9)


def test_the_command_takes_metres_of_a_glb_and_a_typed_unit_of_its_numbers(tmp_path, capsys):
    (tmp_path / "m.glb").write_bytes(glb_box(SIDES_M))
    (tmp_path / "mm.glb").write_bytes(glb_box(SIDES_M * 1e3))
    code, scene = new_scene(tmp_path, "--mesh", tmp_path / "m.glb")
    np.testing.assert_allclose(sides_of(scene), SIDES_M, rtol=1e-6)
    assert approved("mesh.gltf_axes") in " ".join(capsys.readouterr().out.split("\n- "))
    other = tmp_path / "other"
    other.mkdir()
    code, scene = new_scene(other, "--mesh", tmp_path / "mm.glb", "--unit", "mm")
    assert code == 0
    np.testing.assert_allclose(sides_of(scene), SIDES_M, rtol=1e-6)


def test_a_file_in_a_unit_without_a_name_is_refused_with_what_to_do(tmp_path, capsys):
    (tmp_path / "part.dae").write_bytes(dae_box(0.3048))
    code, _ = new_scene(tmp_path, "--mesh", tmp_path / "part.dae")
    assert code == 2
    assert "its unit is 0.3048 m; expected m, cm, mm or in" in capsys.readouterr().err
    # The advice: the same numbers in a unit that has a name.
    (tmp_path / "part.dae").write_bytes(dae_box(0.01))
    _, scene = new_scene(tmp_path, "--mesh", tmp_path / "part.dae")
    np.testing.assert_allclose(sides_of(scene), SIDES_M, rtol=1e-9)


@pytest.mark.parametrize("reference", [(), ("--reference",)])
@pytest.mark.parametrize("name", ["part.dae", "part.glb"])
def test_a_urdf_with_collada_or_glb_needs_nothing_more(tmp_path, name, reference):
    (tmp_path / name).write_bytes(dae_box(0.01) if name.endswith("dae") else glb_box(SIDES_M))
    (tmp_path / "robot.urdf").write_text(ROBOT.format(mesh=name, rpy="0 0 0"))
    code, scene = new_scene(
        tmp_path, "--urdf", tmp_path / "robot.urdf", "--link", "part", "--sensor", "wrist_ft", *reference
    )  # fmt: skip
    assert code == 0
    surface, _ = load_surface(load_scene(scene).surface)
    np.testing.assert_allclose(np.ptp(surface.vertices, axis=0), SIDES_M, rtol=1e-6)
    np.testing.assert_allclose(surface.vertices.mean(axis=0), [0, 0, 0.1], atol=1e-9)
    robot = load_scene(scene).robot.urdf
    (shape,) = load_robot_shape(robot, {}).links
    np.testing.assert_allclose(np.ptp(shape.vertices, axis=0), SIDES_M, rtol=1e-6)


def test_a_part_on_its_side_is_turned_as_the_finding_says(tmp_path):
    """A file with y up: (x, y, z) of it is (x, -z, y) of the part."""
    (tmp_path / "part.glb").write_bytes(glb_box(SIDES_M[[0, 2, 1]]))
    (tmp_path / "robot.urdf").write_text(ROBOT.format(mesh="part.glb", rpy=f"{np.pi / 2} 0 0"))
    _, scene = new_scene(tmp_path, "--urdf", tmp_path / "robot.urdf", "--link", "part", "--sensor", "wrist_ft")
    np.testing.assert_allclose(sides_of(scene), SIDES_M, rtol=1e-6)
    other = tmp_path / "other"
    other.mkdir()
    _, scene = new_scene(other, "--mesh", tmp_path / "part.glb")
    pose = 'unit = "m"\npose = [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]'
    text = scene.read_text()
    line = next(line for line in text.splitlines() if line.startswith("unit"))
    scene.write_text(text.replace(line, pose))
    np.testing.assert_allclose(sides_of(scene), SIDES_M, rtol=1e-6)


@pytest.mark.parametrize(("unit", "name"), [(1.0, "m"), (0.01, "cm"), (0.001, "mm"), (0.0254, "in")])
def test_a_new_part_begins_with_the_unit_of_the_file(tmp_path, unit, name):
    (tmp_path / "part.dae").write_bytes(dae_box(unit))
    draft = with_part_file(PartDraft(), tmp_path / "part.dae")
    assert draft.unit == name
    preview = PartPreviewer().preview(draft, {})
    np.testing.assert_allclose(preview.size_mm, SIDES_M * 1e3, rtol=1e-9)


def test_a_new_part_from_a_file_without_triangles_is_refused(tmp_path):
    (tmp_path / "part.dae").write_bytes(b'<COLLADA version="1.4.1"/>')
    with pytest.raises(InputError, match="empty or not finite"):
        with_part_file(PartDraft(), tmp_path / "part.dae")
