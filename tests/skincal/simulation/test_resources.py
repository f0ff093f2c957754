"""The scenes and meshes that ship: made by the benches, and as the scenes say."""

import numpy as np
import pytest
import trimesh

from skincal.mesh.lay import place_layout
from skincal.mesh.search import nearest_points
from skincal.simulation.example_parts import SHAPE_OF_PART
from tests.skincal.sim_support import scene_and_surface


@pytest.mark.parametrize("name", SHAPE_OF_PART)
def test_the_mesh_that_ships_is_that_of_the_shape(name):
    scene, surface = scene_and_surface(name)
    made, shipped = SHAPE_OF_PART[name].mesh(len(surface.triangles)), trimesh.load(scene.surface.path, process=False)
    # To the micrometre to which the files have them.
    np.testing.assert_allclose(made.vertices * 1e3, shipped.vertices, atol=0.002)
    np.testing.assert_array_equal(made.triangles, shipped.faces)


def test_the_forearm_is_the_papers():
    scene, surface = scene_and_surface("icub-forearm")
    layout = scene.skin.layout
    assert [m.id for m in layout.modules] == [17, 28, 29, 24, 25, 26, 21]
    assert [m.first_channel for m in layout.modules] == [12 * m.id for m in layout.modules]
    assert len(layout.channels) == 84
    assert scene.skin.channels == 384
    assert 8000 <= len(surface.triangles) <= 10000
    low, high = surface.vertices.min(axis=0) * 1e3, surface.vertices.max(axis=0) * 1e3
    np.testing.assert_allclose(low, [-32, -2, -43], atol=2)
    np.testing.assert_allclose(high, [31, 115, 32], atol=2)
    wanted = {"1": (94, 0), "2": (15, -90), "3": (35, -40), "4": (94, 0), "5": (94, 0), "6": (45, 0), "7": (94, -90)}
    assert set(scene.arm.poses) == set(wanted)
    for pose, degrees in wanted.items():
        np.testing.assert_allclose(np.degrees(scene.arm.poses[pose]), degrees, atol=1e-9)


def test_the_v1_chain_puts_the_wrist_where_it_is_known_to_be():
    # Wrist origin in the sensor frame, mm: published figures of this chain.
    scene, _ = scene_and_surface("icub-forearm")
    for pose, wrist in {"1": (138.0, 0, 89.7), "2": (21.0, 0, 220.8), "3": (66.5, 0, 205.4), "6": (86.5, 0, 192.0)}.items():
        sensor_from_link = np.linalg.inv(scene.arm.arm.link_from_sensor(scene.arm.poses[pose]))
        np.testing.assert_allclose(np.abs(sensor_from_link[:3, 3]) * 1e3, wrist, atol=0.06)


@pytest.mark.parametrize("name", ["icub-forearm", "whole-body"])
def test_surfaces_are_consistent_outward_and_open(name):
    scene, surface = scene_and_surface(name)
    axis = 1 if name == "icub-forearm" else 2
    others = [i for i in range(3) if i != axis]
    centres = surface.vertices[surface.triangles].mean(axis=1)
    middle = centres[:, others] - surface.vertices[:, others].mean(axis=0)
    assert (np.sum(middle * surface.normals[:, others], axis=1) > 0).all()
    sides = np.concatenate([surface.triangles[:, [0, 1]], surface.triangles[:, [1, 2]], surface.triangles[:, [2, 0]]])
    directed, counts = np.unique(sides, axis=0, return_counts=True)
    assert counts.max() == 1  # each side at most once in each direction
    one_way = {tuple(side) for side in directed.tolist()}
    rim = [side for side in one_way if side[::-1] not in one_way]
    assert rim
    assert scene.surface.path.stat().st_size < 6_000_000


@pytest.mark.parametrize("name", ["icub-forearm", "whole-body", "flat-patch"])
def test_every_taxel_lies_on_the_part_and_none_on_another(name):
    scene, surface = scene_and_surface(name)
    laid = place_layout(scene.skin.layout, scene.skin.anchor, surface)
    places = laid.places[scene.skin.layout.channels]
    assert np.isfinite(places).all()
    if surface is not None:
        np.testing.assert_allclose(nearest_points(surface, places)[0], places, atol=1e-9)
    nearest = np.full(len(places), np.inf)
    for start in range(0, len(places), 500):
        gaps = np.linalg.norm(places[start : start + 500, None] - places[None], axis=-1)
        gaps[gaps == 0] = np.inf
        nearest[start : start + 500] = gaps.min(axis=1)
    assert nearest.min() > 0.0035
    assert nearest.max() < 0.0065


def test_whole_body_size():
    scene, surface = scene_and_surface("whole-body")
    assert len(scene.skin.layout.channels) == 4200
    assert len(surface.triangles) == 100_000


def test_the_forearms_patch_lies_on_its_upper_side():
    scene, surface = scene_and_surface("icub-forearm")
    laid = place_layout(scene.skin.layout, scene.skin.anchor, surface)
    places = laid.places[scene.skin.layout.channels] * 1e3
    assert places[:, 2].min() > -5
    assert places[:, 1].min() > 11
    assert places[:, 1].max() < 75
    # The published places of the middles of modules 17 and 21: on the thumb's side and on the other.
    middles = {m.id: laid.places[m.channels].mean(axis=0) * 1e3 for m in scene.skin.layout.modules}
    np.testing.assert_allclose(middles[17], [-25, 56, 19], atol=8)
    np.testing.assert_allclose(middles[21], [29, 60, 15], atol=8)
