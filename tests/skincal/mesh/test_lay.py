from dataclasses import replace

import numpy as np
import pytest
from mesh_support import grid

from skincal.mesh.lay import anchor_remarks, place_layout, subdivide_outline
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface, make_surface
from skincal.model.errors import InputError
from skincal.model.skin import MODULE_KINDS, Anchor, Layout, Module, ModuleKind
from tests.approved import approved, approved_pattern
from tests.skincal.sim_support import scene_and_surface


def grid_surface(shape, u, v) -> Surface:
    """A surface over a grid of parameters, wound so that u cross v is outward."""
    return grid(np.stack(shape(*np.meshgrid(u, v, indexing="ij")), axis=-1))


RADIUS = 0.04


def cylinder(around=181, along=61) -> Surface:
    return grid_surface(
        lambda a, z: (RADIUS * np.cos(a), RADIUS * np.sin(a), z), np.linspace(-2.5, 2.5, around), np.linspace(-0.1, 0.1, along)
    )


def anchor_at(angle=0.3, height=0.01, turn=0.0, at=(0.0, 0.0)) -> Anchor:
    normal = np.array([np.cos(angle), np.sin(angle), 0.0])
    side, up = np.array([-np.sin(angle), np.cos(angle), 0.0]), np.array([0.0, 0.0, 1.0])
    x = np.cos(turn) * side + np.sin(turn) * up
    return Anchor(np.array(at), RADIUS * normal + np.array([0, 0, height]), x, normal)


def spread_layout(count=40, reach=0.05, seed=0) -> Layout:
    rng = np.random.default_rng(seed)
    pads = rng.uniform(-reach, reach, size=(count, 2))
    outline = np.array([[-reach, -reach], [reach, -reach], [reach, reach], [-reach, reach]])
    module = Module(1, ModuleKind("board", pads, outline, 0), 5, np.zeros(2), 0.0, False)
    return Layout((module,), count + 8)


@pytest.mark.parametrize("turn", [0.0, 0.7, -2.0])
def test_on_a_cylinder_a_board_rolls_up(turn):
    """A cylinder unrolls without stretch: distance along it, angle times radius and height are the board's own."""
    layout, anchor = spread_layout(), anchor_at(turn=turn, at=(0.004, -0.003))
    laid = place_layout(layout, anchor, cylinder())
    flat = layout.places[layout.channels] - anchor.at
    side = np.cos(turn) * flat[:, 0] - np.sin(turn) * flat[:, 1]
    up = np.sin(turn) * flat[:, 0] + np.cos(turn) * flat[:, 1]
    angle = 0.3 + side / RADIUS
    expected = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), 0.01 + up], axis=1)
    # The polygon of 181 sides is up to 4 um inside the circle and 0.003 % shorter.
    np.testing.assert_allclose(laid.places[layout.channels], expected, atol=2e-5)
    radial = expected * [1, 1, 0] / RADIUS
    assert (np.einsum("ij,ij->i", laid.normals[layout.channels], radial) > np.cos(0.02)).all()
    assert np.isnan(laid.places[:5]).all()
    assert np.isnan(laid.places[-3:]).all()


def test_a_geodesic_over_one_fold_is_straight_when_unfolded():
    """Two planes meeting at 60 degrees: unfolded by hand."""
    bend = np.radians(60)
    vertices = np.array(
        [[-0.1, -0.1, 0], [0, -0.1, 0], [0, 0.1, 0], [-0.1, 0.1, 0], [0.1 * np.cos(bend), 0.1, -0.1 * np.sin(bend)],
         [0.1 * np.cos(bend), -0.1, -0.1 * np.sin(bend)]]
    )  # fmt: skip
    surface = make_surface(vertices, np.array([[0, 1, 2], [0, 2, 3], [1, 5, 4], [1, 4, 2]]))
    anchor = Anchor(np.zeros(2), np.array([-0.02, 0.0, 0.0]), np.array([1.0, 0, 0]), np.array([0.0, 0, 1]))
    layout = spread_layout(reach=0.06)
    laid = place_layout(layout, anchor, surface)
    x, y = (layout.places[layout.channels] + [-0.02, 0.0]).T
    folded = np.where((x > 0)[:, None], np.stack([x * np.cos(bend), y, -x * np.sin(bend)], 1), np.stack([x, y, 0 * x], 1))
    np.testing.assert_allclose(laid.places[layout.channels], folded, atol=1e-9)
    np.testing.assert_allclose(
        laid.normals[layout.channels][x > 0], [[np.sin(bend), 0, np.cos(bend)]] * (x > 0).sum(), atol=1e-12
    )


def test_on_a_sphere_walks_are_great_circles():
    radius = 0.06
    ball = grid_surface(
        lambda lon, lat: (radius * np.cos(lat) * np.cos(lon), radius * np.cos(lat) * np.sin(lon), radius * np.sin(lat)),
        np.linspace(-2, 2, 161), np.linspace(-1.2, 1.2, 97),
    )  # fmt: skip
    anchor = Anchor(np.zeros(2), np.array([radius, 0, 0]), np.array([0.0, 1, 0]), np.array([1.0, 0, 0]))
    layout = spread_layout(reach=0.04)
    laid = place_layout(layout, anchor, ball)
    flat = layout.places[layout.channels]
    away = np.linalg.norm(flat, axis=1)
    ahead = np.stack([0 * away, flat[:, 0] / away, flat[:, 1] / away], axis=1)
    expected = radius * (np.cos(away / radius)[:, None] * np.array([1.0, 0, 0]) + np.sin(away / radius)[:, None] * ahead)
    np.testing.assert_allclose(laid.places[layout.channels], expected, atol=2e-4)


def test_without_a_surface_the_layout_stays_flat():
    layout, anchor = spread_layout(), anchor_at(turn=0.4, at=(0.01, 0.02))
    laid = place_layout(layout, anchor, None)
    flat = layout.places[layout.channels] - anchor.at
    y = np.cross(anchor.normal, anchor.x)
    np.testing.assert_allclose(
        laid.places[layout.channels], anchor.point + flat[:, :1] * anchor.x + flat[:, 1:] * y, atol=1e-15
    )
    np.testing.assert_allclose(laid.normals[layout.channels], np.tile(anchor.normal, (40, 1)))


def test_a_modules_own_anchor_beats_the_layouts():
    kind = MODULE_KINDS["triangle_12"]
    own = anchor_at(angle=-0.5, height=-0.03)
    modules = (
        Module(7, kind, 0, np.zeros(2), 0.2, False),
        Module(8, kind, 12, np.array([0.03, 0.0]), 0.0, True, Anchor(np.array([0.03, 0.0]), own.point, own.x, own.normal)),
    )
    surface = cylinder()
    laid = place_layout(Layout(modules, 24), anchor_at(), surface)
    centre = laid.places[12 + kind.centre_pad]
    assert np.linalg.norm(centre - own.point) == pytest.approx(0.002887, abs=2e-5)
    alone = place_layout(Layout(modules, 24), None, surface)
    assert np.isnan(alone.places[:12]).all()
    np.testing.assert_array_equal(alone.places[12:], laid.places[12:])
    assert alone.outlines[0].shape == (0, 3)
    assert place_layout(Layout(modules[:1], 24), None, surface) is None


def test_outlines_bend_with_the_surface():
    layout = Layout((Module(1, MODULE_KINDS["triangle_12"], 0, np.zeros(2), 0.0, False),), 12)
    laid = place_layout(layout, anchor_at(), cylinder())
    outline = laid.outlines[0]
    # A chord of one long straight side would lie 2.8 mm inside the surface.
    assert np.abs(np.linalg.norm(outline[:, :2], axis=1) - RADIUS).max() < 1e-4
    closed = np.concatenate([outline, outline[:1]])
    assert np.linalg.norm(np.diff(closed, axis=0), axis=1).max() <= 0.002 + 1e-9
    corners = MODULE_KINDS["triangle_12"].outline
    assert all(np.isclose(subdivide_outline(corners), corner).all(axis=1).any() for corner in corners)


def test_past_the_rim_the_board_goes_on_straight_and_is_named():
    surface, layout = cylinder(), spread_layout()
    laid = place_layout(layout, anchor_at(height=0.08), surface)
    past = layout.places[layout.channels][:, 1] > 0.0201
    places = laid.places[layout.channels]
    np.testing.assert_array_equal(np.linalg.norm(nearest_points(surface, places)[0] - places, axis=1) > 1e-6, past)
    np.testing.assert_allclose(places[:, 2], 0.08 + layout.places[layout.channels][:, 1], atol=1e-9)


def test_walks_through_vertices_and_along_edges_end():
    """Anchored at a vertex of a regular grid, with pads along its edges: each step meets a vertex."""
    flat = grid_surface(lambda x, y: (x, y, 0 * x), np.linspace(-0.05, 0.05, 21), np.linspace(-0.05, 0.05, 21))
    pads = np.array([[0.03, 0], [-0.03, 0], [0, 0.03], [0.03, 0.03], [0.03, -0.03], [0, 0], [0.02, 0.01]])
    module = Module(1, ModuleKind("cross", pads, pads[:3], 0), 0, np.zeros(2), 0.0, False)
    anchor = Anchor(np.zeros(2), np.zeros(3), np.array([1.0, 0, 0]), np.array([0.0, 0, 1]))
    laid = place_layout(Layout((module,), 7), anchor, flat)
    np.testing.assert_allclose(laid.places[:, :2], pads, atol=1e-9)
    np.testing.assert_allclose(laid.places[:, 2], 0, atol=1e-12)


def test_turns_with_a_rigid_motion_of_everything():
    rng = np.random.default_rng(3)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    shift = np.array([0.2, -0.1, 0.5])
    surface, anchor, layout = cylinder(), anchor_at(turn=0.3), spread_layout()
    moved = make_surface(surface.vertices @ rotation.T + shift, surface.triangles)
    turned = Anchor(anchor.at, rotation @ anchor.point + shift, rotation @ anchor.x, rotation @ anchor.normal)
    one, two = place_layout(layout, anchor, surface), place_layout(layout, turned, moved)
    np.testing.assert_allclose(one.places[layout.channels] @ rotation.T + shift, two.places[layout.channels], atol=1e-8)


def plate(thick=0.003) -> Surface:
    """Two walls of a plate, its rim left out: the upper at z = 0, the lower below it."""
    top = grid_surface(lambda x, y: (x, y, 0 * x), *[np.linspace(-0.1, 0.1, 5)] * 2)
    below = top.vertices - [0, 0, thick]
    return make_surface(
        np.concatenate([top.vertices, below]), np.concatenate([top.triangles, top.triangles[:, ::-1] + len(below)])
    )


def test_an_anchor_whose_normal_points_into_the_part_is_remarked_on():
    layout = spread_layout()
    into, out = (Anchor(np.zeros(2), np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, side])) for side in (-1.0, 1.0))
    said = approved("mesh.anchor_into", modules="module 1", gap="3.0")
    assert anchor_remarks(layout, into, plate()) == (said,)
    assert anchor_remarks(layout, out, plate()) == ()
    # On the inner wall of a cover, and beside the rim of it, a layout may well lie.
    inner = replace(into, point=np.array([0.0, 0, -0.003]))
    assert anchor_remarks(layout, inner, plate()) == ()
    assert anchor_remarks(layout, anchor_at(), cylinder()) == ()
    assert anchor_remarks(layout, into, None) == anchor_remarks(layout, None, plate()) == ()
    modules = tuple(replace(layout.modules[0], id=k) for k in range(1, 7))
    many = Layout(modules, layout.width)
    assert anchor_remarks(many, into, plate()) == (approved("mesh.anchor_into", modules="modules 1, 2, 3, ...", gap="3.0"),)


@pytest.mark.parametrize("name", ["flat-patch", "icub-forearm", "whole-body"])
def test_anchors_of_the_scenes_that_ship_point_out(name):
    scene, surface = scene_and_surface(name)
    assert scene.skin.layout is not None
    assert anchor_remarks(scene.skin.layout, scene.skin.anchor, surface) == ()


def test_anchors_of_another_frame_are_refused():
    anchor = anchor_at()
    far = Anchor(anchor.at, anchor.point * 1000, anchor.x, anchor.normal)
    with pytest.raises(InputError, match=approved_pattern("mesh.anchor_off")):
        place_layout(spread_layout(), far, cylinder())
    flat = make_surface(np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match=approved_pattern("mesh.none_faces")):
        place_layout(spread_layout(), Anchor(anchor.at, np.zeros(3), np.array([1.0, 0, 0]), np.array([0.0, 0, -1])), flat)
