"""A part described by hand: what is opened and saved stays as it is, what is changed reads back, and nothing else moves."""

import shutil
from dataclasses import replace
from difflib import unified_diff

import numpy as np
import pytest
import trimesh

from skincal.files.layout_sources import parse_grid, parse_layout, read_layout_file, repeated_modules
from skincal.model.errors import InputError
from skincal.model.scene import resource
from skincal.model.skin import Anchor
from skincal.part.draft_preview import PartPreviewer, completed_draft
from skincal.part.draft_summary import State, can_start, summarize, why_not_simulated
from skincal.part.layout_placing import (
    anchor_at,
    anchor_of_module,
    nudged_anchor,
    turn_of,
    turned_anchor,
    with_module_anchor,
)
from skincal.part.mesh_units import guess_unit
from skincal.part.part import load_part
from skincal.part.part_changes import with_link, with_part_file, with_unit
from skincal.part.part_draft import (
    IDENTITY_POSE,
    AnchorDraft,
    DraftHistory,
    LandmarkDraft,
    PartDraft,
    open_draft,
    pose_rows,
    save_draft,
    scene_text,
)
from skincal.part.sensor_placing import nearest_edge_point, pose_along, pose_on_flange, pose_under, turned_pose
from skincal.part.touch_watch import FRAMES_AT_REST_FIRST, TouchWatch
from tests.approved import approved

SHIPPED = [path.parent.name for path in sorted(resource("scenes").glob("*/scene.toml"))]


@pytest.fixture
def cylinder(tmp_path):
    """A cylinder of radius 40 mm and height 120 mm, standing on z = 0, in millimetres."""
    mesh = trimesh.creation.cylinder(40.0, 120.0, sections=128)
    mesh.apply_translation((0, 0, 60))
    mesh.export(tmp_path / "tube.stl")
    return tmp_path / "tube.stl"


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_scene_that_is_opened_and_saved_is_the_same_to_the_byte(tmp_path, name):
    folder = shutil.copytree(resource("scenes"), tmp_path / "scenes") / name  # a scene may share the mesh of another
    before = {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}
    draft = open_draft(folder / "scene.toml")
    assert save_draft(draft, folder / "scene.toml") == draft
    assert {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()} == before
    with pytest.raises(InputError, match="is part of skincal"):
        save_draft(draft, resource(f"scenes/{name}/scene.toml"))


@pytest.mark.parametrize(
    ("change", "lines"),
    [
        (lambda d: replace(d, polarity="up"), 1),
        (lambda d: replace(d, anchor=replace(d.anchor, point_mm=(1.0, 39.5, 29.25))), 1),
        (lambda d: replace(d, landmarks=(*d.landmarks, LandmarkDraft("new", (0.01, 0.02, 0.03)))), 0),
        (lambda d: replace(d, landmarks=d.landmarks[1:]), 5),
        (lambda d: replace(d, landmarks=(replace(d.landmarks[0], name="x"), *d.landmarks[1:])), 2),
        (lambda d: replace(d, sign=-1), 0),
        (lambda d: replace(d, anchor=None), 6),
    ],
)
def test_a_change_takes_away_the_lines_it_is_about_and_no_others(change, lines):
    draft = open_draft(resource("scenes/icub-forearm/scene.toml"))
    changed = change(draft)
    text = scene_text(changed, draft.source.parent)
    gone = [line for line in unified_diff(draft.text.splitlines(), text.splitlines(), n=0) if line[:1] == "-" != line[1:2]]
    assert len(gone) <= lines, gone
    assert scene_text(replace(changed, text=text), draft.source.parent) == text


def described(cylinder) -> PartDraft:
    draft = PartDraft(mesh=cylinder, name="tube", sensor_pose=IDENTITY_POSE, polarity="down")
    return replace(draft, layout_text=repeated_modules("triangle_12", 1, 4))


def test_a_part_that_is_described_is_saved_with_its_mesh_and_loads(tmp_path, cylinder):
    previewer = PartPreviewer()
    seen = previewer.preview(described(cylinder), {})
    assert seen.size_mm == pytest.approx((80.0, 80.0, 120.0), rel=1e-3)
    anchor = anchor_at(seen.surface, seen.layout, np.array([0.05, 0.0, 0.06]), None)
    draft = replace(seen.draft, anchor=AnchorDraft.from_anchor(anchor), landmarks=(LandmarkDraft("rim", (0.04, 0.0, 0.12)),))
    seen = previewer.preview(draft, {})
    assert can_start(seen)
    assert {line.state for line in summarize(seen)} == {State.COMPLETE, State.OPTIONAL}
    saved = save_draft(completed_draft(seen), tmp_path / "scenes/tube/scene.toml")
    part = load_part(saved.source)
    assert np.array_equal(part.laid.places, seen.laid.places, equal_nan=True)
    assert part.scene.skin.channels == 48
    assert part.scene.skin.polarity == -1
    assert part.scene.landmarks[0].name == "rim"
    history = DraftHistory().changed(draft).changed(seen.draft).changed(replace(seen.draft, sign=-1)).saved_as(saved)
    again = save_draft(completed_draft(previewer.preview(history.undone().now, {})), saved.source)
    assert again == saved, "what was undone after saving is saved to the same file"
    cylinder.unlink()
    assert save_draft(replace(saved, polarity="up"), saved.source).polarity == "up"
    assert "up" in saved.source.read_text()


def test_a_scene_that_cannot_be_loaded_is_not_left_behind(tmp_path, cylinder):
    with pytest.raises(InputError):
        save_draft(replace(described(cylinder), channels=7), tmp_path / "scenes/tube/scene.toml")
    assert not list((tmp_path / "scenes").rglob("*.*"))


def test_one_module_moves_alone_and_only_its_lines_change(cylinder):
    previewer = PartPreviewer()
    seen = previewer.preview(described(cylinder), {})
    anchor = anchor_at(seen.surface, seen.layout, np.array([0.05, 0.0, 0.06]), None)
    seen = previewer.preview(replace(seen.draft, anchor=AnchorDraft.from_anchor(anchor)), {})
    here = anchor_of_module(seen.surface, seen.layout.modules[2], anchor)
    for shift, expected in ((0.0, 0.0), (0.003, 0.003)):
        own = AnchorDraft.from_anchor(nudged_anchor(seen.surface, here, shift, 0.0))
        text = with_module_anchor(seen.draft.layout_text, 2, own)
        moved = previewer.preview(replace(seen.draft, layout_text=text), {}).laid.places - seen.laid.places
        distances = np.linalg.norm(moved, axis=1)
        assert distances[24:36] == pytest.approx(expected, abs=2e-6 + 0.05 * expected)
        assert distances[np.r_[0:24, 36:48]].max() == 0.0
    assert with_module_anchor(text, 2, None) == seen.draft.layout_text


def test_an_anchor_slides_round_a_cylinder_and_turns(cylinder):
    surface = PartPreviewer().preview(PartDraft(mesh=cylinder), {}).surface
    layout = parse_layout(repeated_modules("triangle_12", 1, 1), cylinder)
    start = anchor_at(surface, layout, np.array([0.05, 0.0, 0.06]), None)
    assert start.normal == pytest.approx([1, 0, 0], abs=0.03)
    quarter = nudged_anchor(surface, start, 0.0, 0.02 * np.pi) if abs(start.x[2]) > 0.9 else None
    quarter = quarter or nudged_anchor(surface, start, 0.02 * np.pi, 0.0)
    assert abs(quarter.normal[1]) > 0.999
    turned = turned_anchor(start, 90.0)
    assert turned.x @ start.x == pytest.approx(0.0, abs=1e-12)
    assert np.cross(start.x, turned.x) == pytest.approx(start.normal)


def test_sensor_poses(cylinder):
    surface = PartPreviewer().preview(PartDraft(mesh=cylinder), {}).surface
    under = pose_under(surface, 0.03)
    assert under[:3, 3] == pytest.approx([0, 0, -0.03], abs=1e-6)
    rim = np.array([[0.04 * np.cos(a), 0.04 * np.sin(a), 0.0] for a in (0.2, 1.9, 4.0)])
    flange = pose_on_flange(rim, np.array([0, 0, 0.06]))
    assert flange[:3, 3] == pytest.approx([0, 0, 0], abs=1e-9)
    assert flange[:3, 2] == pytest.approx([0, 0, 1])
    assert flange[:3, 0] == pytest.approx(rim[0] / 0.04)
    clicked = np.array([nearest_edge_point(surface, point) for point in rim + np.array([0.0, 0.0, 0.003])])
    assert pose_on_flange(clicked, np.array([0, 0, 0.06]))[:3, 2:] == pytest.approx(flange[:3, 2:], abs=1e-6)
    tilted = flange @ pose_along(np.zeros(3), np.array([0.0, np.sin(0.2), np.cos(0.2)]))
    for pose, count in ((flange, 0), (tilted, 1)):
        seen = PartPreviewer().preview(PartDraft(mesh=cylinder, sensor_pose=pose_rows(pose)), {})
        assert sum("degrees off the nearest axis" in each for each in seen.findings.get("sensor", ())) == count
    middle = np.array([0.04, 0.0, 0.06])
    assert nearest_edge_point(surface, middle) == pytest.approx(middle), "no edge is near"
    with pytest.raises(InputError, match="of a line"):
        pose_on_flange(np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0.0005, 0]]), np.zeros(3))
    with pytest.raises(InputError, match="0 0 0"):
        pose_along(np.zeros(3), np.zeros(3))
    for axis in range(3):
        turned = turned_pose(flange, axis)
        angle = np.arccos((np.trace(flange[:3, :3].T @ turned[:3, :3]) - 1) / 2)
        assert angle == pytest.approx(np.pi / 2)
        assert turned[:3, axis] == pytest.approx(flange[:3, axis])
        assert turned_pose(turned, axis, 3) == pytest.approx(flange)
        assert np.linalg.det(turned[:3, :3]) == pytest.approx(1.0)
    assert np.array(pose_rows(flange)) == pytest.approx(flange, abs=1e-6)


@pytest.mark.parametrize(
    ("sides", "unit"),
    [((240, 90, 88), "mm"), ((0.24, 0.09, 0.088), "m"), ((24, 9, 8.8), "cm"), ((1.7, 0.5, 0.3), "m"), ((9e5, 1, 1), "mm")],
)
def test_the_unit_of_a_mesh_is_guessed_from_its_size(sides, unit):
    assert guess_unit(np.array(sides, dtype=float)) == unit


def test_the_summary_has_no_tick_for_a_guessed_unit_until_it_is_chosen(cylinder):
    draft = with_part_file(PartDraft(), cylinder)
    for each, state in ((draft, State.OPTIONAL), (with_unit(draft, draft.unit), State.COMPLETE)):
        line = summarize(PartPreviewer().preview(each, {}))[0]
        assert (line.step, line.state) == ("part", state)
        assert ("guessed" in line.text) is (state is State.OPTIONAL)


def test_a_sheet_is_not_counted_as_a_module():
    sheet = PartDraft(layout_text=parse_grid("4x4@10mm").layout_text(), channels=16, sensor_pose=IDENTITY_POSE)
    texts = [line.text for line in summarize(PartPreviewer().preview(sheet, {}))]
    assert any("1 sheet with 16 taxels" in text for text in texts), texts


def test_changes_are_undone_and_the_steps_of_a_drag_at_once():
    first, second, third = (PartDraft(name=name) for name in "abc")
    history = DraftHistory(now=first).changed(second, "drag").changed(third, "drag")
    assert history.changed(third) is history
    assert history.undone().now == first
    assert history.undone().redone().now == third
    assert history.undone().changed(second).redone().now == second
    assert DraftHistory().undone() == DraftHistory()


INI = "[SENSORS]\n# k n x y a g m\ntriangle_10pad 0 100.00 -20.00 30.00 5 1\ntriangle_10pad 12 127.71 -4 -90 5 0\n"


def test_an_ini_of_skingui_is_read(tmp_path):
    path = tmp_path / "arm.ini"
    path.write_text("cardid 8 9\nwidth 500\n" + INI)
    layout = parse_layout(read_layout_file(path), path)
    assert [(m.id, m.first_channel, m.mirror) for m in layout.modules] == [(0, 0, True), (12, 144, False)]
    assert layout.modules[0].place == pytest.approx([0.1, -0.02])
    assert np.degrees(layout.modules[1].angle) == pytest.approx(-90)
    assert len(layout.channels) == 20


@pytest.mark.parametrize("end", ["5 0", "5", "", "5 0 // second board", "5// no mirror", "5 0 # kept"])
def test_missing_fields_of_an_ini_are_zero_and_yarp_comments_are_left_out(tmp_path, end):
    """YARP reads a missing gain or mirror as 0; `//` begins a comment anywhere, `#` before a word."""
    path = tmp_path / "arm.ini"
    path.write_text(f"// triangle_10pad 3 1 2 3\n{INI}//triangle_10pad 13 0 0 0 5 1\ntriangle_10pad 14 52 -4.57 60 {end}\n")
    layout = parse_layout(read_layout_file(path), path)
    assert [(m.id, m.mirror) for m in layout.modules] == [(0, True), (12, False), (14, False)]
    assert layout.modules[2].place == pytest.approx([0.052, -0.00457])
    assert np.degrees(layout.modules[2].angle) == pytest.approx(60)


@pytest.mark.parametrize(
    "text", ["channel,x,y\n0,0,0\n2,5,0\n1,0,5\n", "0 0 0\n2 5 0\n1 0 5", "x_m;y_m\n0;0\n0;0.005\n0.005;0"]
)
def test_a_table_of_positions_is_read(tmp_path, text):
    path = tmp_path / "pads.csv"
    path.write_text(text)
    places = parse_layout(read_layout_file(path), path).places
    assert places == pytest.approx(np.array([[0, 0], [0, 5], [5, 0]]) * 1e-3)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.ini", "[SENSORS]\n", "lists no module"),
        ("a.ini", "hexagon 1 2 3 4 5 6\n", "module 'hexagon'"),
        ("a.ini", "triangle_10pad 1 2 3\n", "line 1"),
        ("a.ini", INI + "triangle_10pad 12 1 1 1 1 1", "repeats module 12"),
        ("a.csv", "0,1\n0,1,2\n", "line 2"),
        ("a.csv", "0,1,2\n0,1,2\n", "twice"),
        ("a.csv", "-1,1,2\n", "whole number"),
        ("a.csv", "0,1,2\nx,y,z\n", "line 2"),
        ("a.csv", "", "0 positions"),
        ("a.step", "", "is no layout"),
    ],
)
def test_what_is_no_layout_is_refused(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        read_layout_file(tmp_path / name)


def test_repeated_triangles_share_their_edges():
    layout = parse_layout(repeated_modules("triangle_12", 2, 5), resource("scenes"))
    assert layout.spacing == pytest.approx(0.005, abs=1e-5)
    corners = np.round(np.concatenate([module.outline for module in layout.modules]) * 1e3, 1)
    assert len(np.unique(corners, axis=0)) == 11  # of 30: each inner corner is one of several modules
    with pytest.raises(InputError, match="does not ship"):
        repeated_modules("hexagon", 1, 1)


@pytest.mark.parametrize(("falls", "noise"), [(True, 0.5), (False, 0.0), (False, 2.0)])
def test_channels_that_answer_a_touch_are_found_and_which_way_they_went(falls, noise):
    rng = np.random.default_rng(3)
    watch = TouchWatch(48)
    rest = rng.uniform(50, 200, 48)
    press = np.zeros(48)
    press[12:24] = rng.uniform(30, 60, 12)
    press[30] = 4.0
    for frame in range(200):
        share = max(0.0, np.sin(frame / 20.0)) if frame >= FRAMES_AT_REST_FIRST else 0.0
        watch.feed(rest + (-1 if falls else 1) * share * press + noise * rng.standard_normal(48))
    touch = watch.touch()
    assert touch.channels.tolist() == list(range(12, 24))
    assert touch.falls == falls
    assert "12-23" in touch.sentence()
    assert "one block" in touch.sentence()


def test_a_skin_at_rest_answers_nothing():
    rng = np.random.default_rng(4)
    watch = TouchWatch(20)
    for _ in range(300):
        watch.feed(100.0 + rng.standard_normal(20))
    watch.feed(np.zeros(3))  # of another device
    assert not len(watch.touch().channels)
    assert "Press the skin" in watch.touch().sentence()


ROBOT = """<robot name="r"><link name="base"/><link name="tool"/><link name="part"><visual><geometry>
<mesh filename="tube.stl" scale="0.001 0.001 0.001"/></geometry></visual></link><link name="frame"/><link name="cap"/>
<joint name="ft" type="fixed"><parent link="base"/><child link="tool"/><origin xyz="0 0 0.1"/></joint>
<joint name="wrist" type="revolute"><parent link="tool"/><child link="part"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1"/></joint><joint name="f" type="fixed"><parent link="part"/><child link="frame"/>
<origin xyz="0.1 0 0" rpy="0 1.5707963267948966 0"/></joint><joint name="c" type="revolute"><parent link="part"/>
<child link="cap"/><axis xyz="1 0 0"/><limit lower="-1" upper="1"/></joint>
<sensor name="s" type="force_torque"><parent joint="ft"/></sensor></robot>"""


def test_points_follow_a_change_of_frame_and_are_dropped_with_the_part(cylinder):
    urdf = cylinder.with_name("r.urdf")
    urdf.write_text(ROBOT)
    previewer = PartPreviewer()
    start = with_part_file(PartDraft(), urdf)
    assert start.link == "part", "the only link with a mesh"
    assert start.sensor == "s", "the only one between part and base"
    start = replace(start, layout_text=repeated_modules("triangle_12", 1, 3))
    seen = previewer.preview(start, {})
    anchor = anchor_at(seen.surface, seen.layout, np.array([0.05, 0.01, 0.06]), None)
    own = AnchorDraft.from_anchor(anchor_of_module(seen.surface, seen.layout.modules[1], anchor))
    start = replace(
        start, anchor=AnchorDraft.from_anchor(anchor), layout_text=with_module_anchor(start.layout_text, 1, own),
        landmarks=(LandmarkDraft("rim", (0.04, 0.0, 0.12), (1.0, 0.0, 0.0)),),
    )  # fmt: skip
    seen, moved = previewer.preview(start, {}), previewer.preview(with_link(start, seen.robot, "frame"), {})
    pose = seen.link_poses["frame"]
    again = moved.laid.places @ pose[:3, :3].T + pose[:3, 3]
    assert np.allclose(again, seen.laid.places, atol=3e-6, equal_nan=True)
    assert pose[:3, :3] @ moved.draft.landmarks[0].place + pose[:3, 3] == pytest.approx([0.04, 0.0, 0.12], abs=1e-6)
    assert moved.sensor_pose == pytest.approx(np.linalg.inv(pose) @ seen.sensor_pose, abs=1e-9)
    assert previewer.preview(start, {"wrist": 0.5}).sensor_pose != pytest.approx(seen.sensor_pose, abs=1e-3)
    for other in (with_link(start, seen.robot, "cap"), with_unit(start, "cm"), with_part_file(start, cylinder)):
        assert (other.anchor, other.landmarks) == (None, ())
        assert "anchor" not in other.layout_text
    of_mesh = replace(with_part_file(PartDraft(), cylinder), sensor_pose=((1.0, 0.0, 0.0, 0.0),))
    assert with_unit(of_mesh, "cm").sensor_pose is None, "it was placed on the mesh of another size"
    assert with_unit(replace(start, sensor_pose=((1.0, 0.0, 0.0, 0.0),)), "cm").sensor_pose is not None
    fixed = previewer.preview(replace(start, fixed=(("wrist", 20.0),)), {})
    assert fixed.joints == ()
    assert fixed.sensor_pose == pytest.approx(previewer.preview(start, {"wrist": np.radians(20.0)}).sensor_pose)
    lost = previewer.preview(replace(start, joints=("elbow",)), {})
    assert "no column of the joint stream has its name" in lost.problems["joints"]
    assert not can_start(lost)
    beside = previewer.preview(replace(start, sensor="c"), {})
    assert any("may not feel the pokes" in line.text for line in summarize(beside))
    assert not any("may not feel" in line.text for line in summarize(seen))


def test_what_is_wrong_with_the_place_of_a_layout_is_said(tmp_path):
    tube = trimesh.creation.cylinder(40.0, 60.0, sections=96)
    shell = trimesh.Trimesh(tube.vertices, tube.faces[np.abs(tube.face_normals[:, 2]) < 0.5])
    shell.slice_plane((0, 0, 0), (1, 0, 0)).export(tmp_path / "shell.stl")
    previewer = PartPreviewer()
    draft = replace(
        PartDraft(mesh=tmp_path / "shell.stl", sensor_pose=IDENTITY_POSE), layout_text=repeated_modules("triangle_12", 2, 3)
    )
    seen = previewer.preview(draft, {})
    assert "not placed yet" in seen.problems["place"]
    assert seen.laid is not None, "it is shown all the same"
    for point, words in (((0.05, 0, 0.025), "off the mesh"), ((0.05, 0, 0), "")):
        anchor = anchor_at(seen.surface, seen.layout, np.array(point), None)
        found = previewer.preview(replace(draft, anchor=AnchorDraft.from_anchor(anchor)), {})
        assert [words in sentence for sentence in found.findings["place"]] == ([True] if words else [])
    assert "place" not in found.problems
    own = anchor_of_module(seen.surface, seen.layout.modules[0], anchor)
    text = with_module_anchor(draft.layout_text, 0, AnchorDraft.from_anchor(nudged_anchor(seen.surface, own, 0.03, 0.0)))
    crossed = previewer.preview(replace(found.draft, layout_text=text), {})
    assert any("overlap" in sentence for sentence in crossed.findings["place"])


def test_a_package_that_is_not_found_is_named_and_its_folder_helps(tmp_path, cylinder):
    urdf = tmp_path / "robots/r.urdf"
    urdf.parent.mkdir()
    urdf.write_text(ROBOT.replace("tube.stl", "package://arm_description/meshes/tube.stl"))
    folder = tmp_path / "elsewhere/meshes"
    folder.mkdir(parents=True)
    cylinder.rename(folder / "tube.stl")
    previewer, draft = PartPreviewer(), with_part_file(PartDraft(), urdf)
    seen = previewer.preview(draft, {})
    assert seen.missing_packages == ("arm_description",)
    assert "arm_description" in seen.problems["part"]
    assert "cannot be drawn" in seen.findings["part"][0]
    draft = replace(draft, packages=(("arm_description", folder.parent),), channels=4, name="arm")
    seen = previewer.preview(draft, {})
    assert (seen.missing_packages, len(seen.shape.links)) == ((), 1)
    saved = save_draft(completed_draft(seen), tmp_path / "scenes/arm/scene.toml")
    assert (saved.packages, load_part(saved.source).scene.surface.path.parts[-3:]) == (
        (), ("arm_description", "meshes", "tube.stl")
    )  # fmt: skip
    assert load_part(saved.source).surface is not None


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
@pytest.mark.parametrize(
    "text",
    [
        'mesh = "./tube.stl"\nunit = "mm"\n\n[wrench]\nsign = 1\n',
        'mesh = "meshes/../meshes/tube.stl"\nunit = "mm"\npose = [[1,0,0,0],[0,1,0,0],[0,0,1,0.5],[0,0,0,1]]\n',
        'mesh = "meshes/tube.stl" # here\nunit = "mm"\n[[landmarks]]\nname="a"\nplace=[0,0.0,1e-3]\n[contacts]\nforce_min=3\n',
        "robot",
    ],
)
def test_a_scene_that_was_written_by_hand_is_not_rewritten(tmp_path, cylinder, text, line_end):
    (tmp_path / "meshes").mkdir()
    shutil.copy(cylinder, tmp_path / "meshes/tube.stl")
    if text == "robot":
        (tmp_path / "r.urdf").write_text(ROBOT)
        body = 'name="x"\nlink="frame" # f\n[robot]\nurdf = "./r.urdf"\nsensor="s"\njoints=[]\nfixed = { wrist = 20 }\n[skin]\n'
    else:
        body = f'name = "x"\nlink = "part"\n[surface]\n{text}\n[skin]\n'
    body += "channels = 12\nanchor = { at_mm = [0, 0], point_mm = [40, 0, 60], x = [0, 3, 0], normal = [1, 0, 0] }\n"
    scene = tmp_path / "scene.toml"
    scene.write_bytes(body.replace("\n", line_end).encode())
    draft = open_draft(scene)
    assert save_draft(completed_draft(PartPreviewer().preview(draft, {})), scene) == draft
    assert scene.read_bytes() == body.replace("\n", line_end).encode()
    assert sorted(path.name for path in tmp_path.glob("*.*")) == sorted(
        {"scene.toml", "tube.stl", *(["r.urdf"] * (text == "robot"))}
    )
    changed = save_draft(replace(draft, polarity="down"), scene)
    assert scene.read_bytes().count(line_end.encode()) == scene.read_bytes().count(b"\n")
    assert replace(changed, text=draft.text, polarity="up") == draft


def test_a_layout_that_is_not_placed_lies_in_the_middle_of_the_free_face(tmp_path):
    """Of a plate the larger face, away from a sensor below it; of a column the side that is seen first."""
    for name, mesh in (
        ("plate", trimesh.creation.box((107.0, 120.0, 20.0))),
        ("column", trimesh.creation.cylinder(40.0, 300.0)),
    ):
        mesh.export(tmp_path / f"{name}.stl")
    previewer, text = PartPreviewer(), repeated_modules("triangle_12", 1, 2)
    pose = np.eye(4)
    for name, z_mm, middle in (("plate", -60.0, (0, 0, 10)), ("plate", 60.0, (0, 0, -10)), ("column", -200.0, (40, 0, 0))):
        pose[2, 3] = z_mm * 1e-3
        draft = PartDraft(mesh=tmp_path / f"{name}.stl", sensor_pose=pose_rows(pose), layout_text=text)
        seen = previewer.preview(draft, {})
        assert seen.proposed_anchor.point * 1e3 == pytest.approx(middle, abs=0.2)


def test_the_summary_has_no_tick_for_a_layout_that_does_not_fit(tmp_path):
    """The same sentence is under step 5, and in the summary."""
    trimesh.creation.box((100.0, 80.0, 3.0)).export(tmp_path / "plate.stl")
    previewer = PartPreviewer()
    draft = PartDraft(mesh=tmp_path / "plate.stl", sensor_pose=IDENTITY_POSE, layout_text=parse_grid("6x6@9mm").layout_text())
    seen = previewer.preview(draft, {})
    for point, is_fine in (((0.0, 0.0, 0.0015), True), ((0.04, 0.0, 0.0015), False)):
        anchor = anchor_at(seen.surface, seen.layout, np.array(point), None)
        placed = previewer.preview(replace(draft, anchor=AnchorDraft.from_anchor(anchor)), {})
        line = next(line for line in summarize(placed) if line.step == "place")
        assert (line.state is State.COMPLETE) is is_fine
        assert (line.text == "every taxel is on the part") is is_fine
        assert is_fine or line.text == placed.findings["place"][0]


def test_a_landmark_off_the_mesh_is_reported_with_the_nearest_point(cylinder):
    marks = tuple(LandmarkDraft(name, (x, 0.0, 0.06)) for name, x in (("on", 0.04), ("head", 0.0415), ("far", 0.058)))
    seen = PartPreviewer().preview(PartDraft(mesh=cylinder, sensor_pose=IDENTITY_POSE, channels=4, landmarks=marks), {})
    said = approved("placing.off_mesh", what="Landmark far", distance="18.0", point="40.0, 0.0, 60.0")
    assert seen.findings["check"] == (said,)
    assert any(line.text == said and line.state is State.OPTIONAL for line in summarize(seen))


def test_a_part_without_a_placed_layout_cannot_be_tried(cylinder):
    draft = PartDraft(mesh=cylinder, channels=9)
    previewer = PartPreviewer()
    assert "force/torque sensor" in why_not_simulated(previewer.preview(draft, {}))
    draft = replace(draft, sensor_pose=IDENTITY_POSE)
    assert "layout" in why_not_simulated(previewer.preview(draft, {}))
    draft = replace(draft, layout_text=parse_grid("3x3@8mm").layout_text())
    seen = previewer.preview(draft, {})
    assert "place" in why_not_simulated(seen)
    anchor = anchor_at(seen.surface, seen.layout, np.array([0.04, 0.0, 0.06]), None)
    assert not why_not_simulated(previewer.preview(replace(draft, anchor=AnchorDraft.from_anchor(anchor)), {}))


def test_the_turn_of_a_layout_is_counted_from_upright():
    """At (40, 0, z) of a column the level axis is +y."""
    x = np.array([0.0, np.cos(0.4), np.sin(0.4)])
    anchor = Anchor(np.zeros(2), np.array([0.04, 0.0, 0.0]), x, np.array([1.0, 0.0, 0.0]))
    assert turn_of(anchor) == pytest.approx(np.degrees(0.4))
    assert turn_of(turned_anchor(anchor, -turn_of(anchor))) == pytest.approx(0.0, abs=1e-9)
