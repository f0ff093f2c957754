"""Layouts on parts of known shape: the taxels beyond a rim, an edge or a hole are counted by hand."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from mesh_support import grid as surface_over_grid

from skincal.files.layout_sources import parse_grid, parse_layout, repeated_modules
from skincal.geometry import FloatArray
from skincal.mesh.laid_check import LaidFindings, examine_layout
from skincal.mesh.lay import place_layout
from skincal.mesh.surface import Surface, make_surface
from skincal.model.skin import Anchor, Layout
from skincal.part.draft_preview import propose_anchor
from skincal.part.layout_placing import anchor_at, nudged_anchor, turned_anchor
from tests.approved import approved
from tests.skincal.sim_support import scene_and_surface

PLATE_RADIUS_MM, PLATE_LENGTH_MM = 70.0, 120.0


def grid(text: str) -> Layout:
    return parse_layout(parse_grid(text).layout_text(), Path("grid.toml"))


def surface_of(mesh: trimesh.Trimesh, scale: float = 1e-3) -> Surface:
    mesh.merge_vertices()
    return make_surface(mesh.vertices * scale, mesh.faces)


def bent_plate(thick: float = 3.0, hole: bool = False) -> Surface:
    """A plate bent to 70 mm about the y axis, 122 mm along the arc, closed; its outer face is up."""
    flat = trimesh.creation.box((122.0, PLATE_LENGTH_MM, thick))
    if hole:
        ring = trimesh.creation.annulus(8.0, 30.0, thick, sections=48)
        flat = ring
    for _ in range(5):
        flat = flat.subdivide()
    angle, radius = flat.vertices[:, 0] / PLATE_RADIUS_MM, PLATE_RADIUS_MM - thick / 2.0 + flat.vertices[:, 2]
    flat.vertices = np.column_stack([radius * np.sin(angle), flat.vertices[:, 1], radius * np.cos(angle)])
    return surface_of(flat)


def examine(
    surface: Surface, layout: Layout, point_mm: tuple[float, float, float], turn: float = 0.0, sensor: FloatArray | None = None
) -> LaidFindings:
    anchor = turned_anchor(anchor_at(surface, layout, np.array(point_mm) * 1e-3, None), turn)
    return examine_layout(layout, anchor, place_layout(layout, anchor, surface), surface, sensor)


@pytest.fixture(scope="module")
def plate() -> Surface:
    return bent_plate()


@pytest.mark.parametrize("name", ["flat-patch", "icub-forearm", "whole-body"])
def test_shipped_scenes_have_no_findings(name):
    scene, surface = scene_and_surface(name)
    layout = scene.skin.layout
    laid = place_layout(layout, scene.skin.anchor, surface)
    sensor = scene.sensor_pose[:3, 3] if scene.arm is None else None
    found = examine_layout(layout, scene.skin.anchor, laid, surface, sensor)
    assert (found.sentences, len(found.off_channels), len(found.folded_channels)) == ((), 0, 0)


@pytest.mark.parametrize(
    ("mesh", "layout", "point"),
    [
        (trimesh.creation.cylinder(40.0, 200.0, sections=12), "6x8@9mm", (40.0, 0.0, 0.0)),
        (trimesh.creation.cylinder(30.0, 200.0, sections=8), "6x8@9mm", (30.0, 0.0, 0.0)),
        (trimesh.creation.cylinder(40.0, 200.0, sections=96), "6x27@9mm", (40.0, 0.0, 0.0)),  # a sleeve of 243 of 251 mm
        (trimesh.creation.cylinder(8.0, 60.0, sections=48), "6x9@5mm", (8.0, 0.0, 0.0)),  # a finger
        (trimesh.creation.icosphere(4, 50.0), "6x6@9mm", (0.0, 0.0, 50.0)),
        (trimesh.creation.icosphere(4, 8.0), "5x5@2mm", (0.0, 0.0, 8.0)),  # a fingertip
        (trimesh.creation.box((100.0, 80.0, 40.0)), "6x6@9mm", (0.0, 0.0, 20.0)),
        (trimesh.creation.box((100.0, 80.0, 3.0)), "8x10@9.9mm", (0.0, 0.0, 1.5)),  # to 0.2 mm from the rim
    ],
    ids=["12 sides", "8 sides", "sleeve", "finger", "sphere", "fingertip", "box", "full thin plate"],
)
def test_layouts_that_fit_have_no_findings(mesh, layout, point):
    assert examine(surface_of(mesh.copy()), grid(layout), point).sentences == ()


@pytest.mark.parametrize("turn", [0.0, 30.0, 90.0])
def test_a_layout_in_the_middle_of_a_bent_plate_fits(plate, turn):
    assert examine(plate, grid("16x16@5mm"), (0.0, 0.0, 70.0), turn, np.array([0, 0, 0.02])).sentences == ()


@pytest.mark.parametrize(
    ("point", "turn", "count"),
    [
        # Rows of 16 taxels, 5 mm apart, from 37.5 mm before the anchor: the rim is 10 mm before it, and 23 mm.
        ((0.0, -50.0, 70.0), 0.0, 6 * 16),
        ((0.0, -37.0, 70.0), 0.0, 3 * 16),
        ((0.0, -22.8, 70.0), 0.0, 1 * 16),  # 0.3 mm over the edge, on the rim itself
        # Columns, by the arc from the anchor at 38 degrees: 61 - 46.4 = 14.6 mm to the rim.
        ((70.0 * np.sin(0.6632), 0.0, 70.0 * np.cos(0.6632)), 0.0, 5 * 16),
        ((70.0 * np.sin(0.6632), 0.0, 70.0 * np.cos(0.6632)), 90.0, 5 * 16),
    ],
)
def test_taxels_folded_round_the_rim_are_counted(plate, point, turn, count):
    found = examine(plate, grid("16x16@5mm"), point, turn)
    assert len(found.folded_channels) == count
    assert found.sentences == (approved("placing.folded", taxels=f"{count} taxels", modules="module 1"),)


def test_the_advice_to_slide_a_folded_layout_leaves_no_finding(plate):
    layout = grid("16x16@5mm")
    anchor = anchor_at(plate, layout, np.array([0.0, -0.05, 0.07]), None)
    slid = nudged_anchor(plate, anchor, 0.0, 0.05)
    ends = [examine_layout(layout, each, place_layout(layout, each, plate), plate).sentences for each in (anchor, slid)]
    assert [bool(each) for each in ends] == [True, False]


def l_plate() -> Surface:
    """An L of 60 x 80 mm with a notch of 30 x 40 mm, 20 mm thick; its top is at 20 mm."""
    long, short = trimesh.creation.box((30.0, 80.0, 20.0)), trimesh.creation.box((30.0, 40.0, 20.0))
    long.apply_translation((15.0, 40.0, 10.0))
    short.apply_translation((45.0, 20.0, 10.0))
    return surface_of(trimesh.boolean.union([long, short]))


@pytest.mark.parametrize("x", [30.0, 29.5, 29.0, 28.0, 27.0, 24.0])
def test_a_fold_beside_the_anchor_is_found(x):
    found = examine(l_plate(), grid("3x3@8mm"), (x, 55.0, 20.0))
    assert len(found.folded_channels) == 3
    assert "beyond a rim" in found.sentences[0]


def test_a_part_whose_middle_is_outside_it_gets_a_place_without_a_finding():
    surface, layout = l_plate(), grid("3x3@8mm")
    anchor = propose_anchor(layout, surface, None)
    found = examine_layout(layout, anchor, place_layout(layout, anchor, surface), surface, None)
    assert found.sentences == ()


@pytest.mark.parametrize("thick", [0.8, 3.0, 10.0])
def test_a_fold_is_found_at_each_thickness(thick):
    found = examine(bent_plate(thick), grid("8x8@5mm"), (0.0, -50.0, 70.0))
    # Rows at -17.5, -12.5 mm lie beyond the rim 10 mm before the anchor.
    assert found.folded_channels.tolist() == list(range(16))


def test_a_box_edge_and_a_hole_are_found_and_advice_is_right():
    box = surface_of(trimesh.creation.box((100.0, 80.0, 40.0)))
    # Columns at 45 + 4.5, 13.5, 22.5 mm: those beyond 50 mm are two of six, of six rows.
    assert len(examine(box, grid("6x6@9mm"), (45.0, 0.0, 20.0)).folded_channels) == 12
    assert examine(box, grid("6x6@9mm"), (15.0, 0.0, 20.0)).sentences == ()
    plate, hole = bent_plate(3.0), bent_plate(3.0, hole=True)
    at = (70.0 * np.sin(-0.22), 0.0, 70.0 * np.cos(-0.22))  # 15.4 mm from the middle of a hole of 8 mm radius
    layout = grid("4x6@6mm")
    assert "a hole" in " ".join(examine(hole, layout, at).sentences)
    # "use a mesh without it"
    assert examine(plate, layout, at).sentences == ()


def test_an_outline_torn_by_a_screw_hole_is_said():
    flat = trimesh.creation.annulus(1.5, 60.0, 3.0, sections=64)
    found = examine(surface_of(flat.subdivide()), grid("6x6@9mm"), (-20.0, 0.0, 1.5))
    assert found.sentences == (approved("placing.torn", modules="module 1"),)
    assert not len(found.folded_channels)


def test_a_layout_larger_than_the_part_names_both_sizes():
    found = examine(surface_of(trimesh.creation.box((4.2, 4.7, 1.1))), grid("4x4@10mm"), (0.0, 0.0, 0.55))
    assert found.sentences == (approved("placing.too_large", layout="42.4", part="6.4"),)
    # "Check the unit of the mesh": the same numbers are inches.
    inches = surface_of(trimesh.creation.box((4.2, 4.7, 1.1)), 0.0254)
    assert examine(inches, grid("4x4@10mm"), (0.0, 0.0, 0.55 * 25.4)).sentences == ()


def test_the_face_towards_the_sensor_is_said_with_the_other_face(plate):
    below, layout = np.array([0.0, 0.0, 0.02]), grid("16x16@5mm")
    inner = examine(plate, layout, (0.0, 0.0, 66.5), sensor=below)
    assert inner.sentences == (approved("placing.inner", gap="3.0"),)
    # "place the layout there"
    assert examine(plate, layout, (0.0, 0.0, 70.0), sensor=below).sentences == ()
    # A sensor in another limb lies on no side.
    assert examine(plate, layout, (0.0, 0.0, 66.5), sensor=np.array([0.0, 0.0, -0.8])).sentences == ()
    assert examine(plate, layout, (0.0, 0.0, 66.5)).sentences == ()


def test_the_upper_side_of_a_foot_below_its_ankle_may_carry_a_skin():
    """A thin convex shell with the sensor above it."""
    shell = trimesh.creation.cylinder(40.0, 200.0, sections=96)
    hollow = trimesh.creation.annulus(37.0, 40.0, 200.0, sections=96)
    for mesh in (shell, hollow):
        found = examine(surface_of(mesh), grid("6x6@9mm"), (40.0, 0.0, 0.0), sensor=np.array([0.09, 0.0, 0.0]))
        assert found.sentences == ()


def test_modules_on_both_faces_of_a_thin_plate_do_not_overlap():
    plate = surface_of(trimesh.creation.box((100.0, 80.0, 2.0)))
    layout = parse_layout(repeated_modules("triangle_12", 1, 2), Path("modules.toml"))
    faces = [Anchor(m.place, np.array([0, 0, z]), np.array([1.0, 0, 0]), np.array([0, 0, np.sign(z)]))
             for m, z in zip(layout.modules, (0.001, -0.001), strict=True)]  # fmt: skip
    both = Layout(tuple(replace(m, anchor=a) for m, a in zip(layout.modules, faces, strict=True)), layout.width)
    assert examine_layout(both, None, place_layout(both, None, plate), plate).sentences == ()
    same = Layout(tuple(replace(m, anchor=replace(faces[0], at=m.place)) for m in layout.modules), layout.width)
    assert "overlap" in examine_layout(same, None, place_layout(same, None, plate), plate).sentences[0]


def test_a_layout_wound_round_a_rod_lies_on_itself():
    rod = surface_of(trimesh.creation.cylinder(12.0, 200.0, sections=64))
    # 14 x 6 = 84 mm round a circumference of 75 mm.
    words = " ".join(examine(rod, grid("4x16@6mm"), (12.0, 0.0, 0.0)).sentences)
    assert "overlaps itself" in words
    assert examine(rod, grid("4x12@6mm"), (12.0, 0.0, 0.0)).sentences == ()


def test_a_sheet_that_would_cover_a_ball_is_said():
    """At a distance d on a sphere of radius R circles are sin(d / R) / (d / R) of those in the plane."""
    handle = trimesh.creation.box((5.0, 5.0, 5.0), trimesh.transformations.translation_matrix((0, 0, -150)))
    ball = surface_of(trimesh.util.concatenate([trimesh.creation.icosphere(5, 30.0), handle]))
    # The ends at 52.2 mm, 1.74 rad, are 2 atan(4 / 52) apart about the middle: 4.54 mm on a sphere, less on a polyhedron.
    words = " ".join(examine(ball, grid("4x14@8mm"), (0.0, 0.0, 30.0)).sentences)
    assert words.startswith("A flat layout does not fit the part here: channels ")
    found = re.search(r"are 8\.0 mm apart in the layout and (\S+) mm on the part", words)
    assert found is not None
    assert float(found[1]) == pytest.approx(4.54, abs=0.3)
    assert examine(ball, grid("6x6@9mm"), (0.0, 0.0, 30.0)).sentences == ()


def test_a_shallow_groove_does_not_count_as_an_edge():
    x, y = np.meshgrid(np.linspace(-0.05, 0.05, 401), np.linspace(-0.05, 0.05, 11), indexing="ij")
    for depth, is_found in ((0.0005, False), (0.006, True)):
        z = np.where(np.abs(x - 0.01) < 0.0012, -depth, 0.0)
        found = examine(surface_over_grid(np.stack([x, y, z], axis=-1)), grid("6x6@9mm"), (0.0, 0.0, 0.0))
        assert bool(len(found.folded_channels)) is is_found, found.sentences
