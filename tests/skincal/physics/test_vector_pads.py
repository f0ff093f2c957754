"""Taxels of three axes under the tip of the robot: the forces of the engine in the axes of each taxel."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from skincal.mesh.load import load_surface
from skincal.model.scene import load_scene, resource
from skincal.physics.engine import Touch
from skincal.physics.mjcf import FOAM_THICKNESS_M
from skincal.physics.rig import make_pads
from skincal.physics.skin import Pads
from skincal.physics.vector_pads import CELL_RADIUS_M, PLATE_DEPTH_M, REACH_M, VectorPadErrors, VectorPads
from tools import fingertip

SCENE = load_scene(resource("scenes/fingertip/scene.toml"))


@pytest.fixture(scope="module")
def surface():
    return load_surface(SCENE.surface)[0]


def perfect(surface, seed=1):
    return VectorPads(SCENE, surface, SCENE.skin.axes, np.random.default_rng(seed), VectorPadErrors.none())


def touch_at(pads, row, force):
    face = pads.places[row] + (FOAM_THICKNESS_M - 0.00025) * pads.normals[row]
    return Touch(face, pads.normals[row], np.asarray(force, dtype=float), 0.0005)


def test_a_push_gives_each_taxel_its_force_in_its_own_axes(surface):
    pads = perfect(surface)
    for row in (0, 14, 29):
        lean = 0.2 * pads.axes[row][:, 0] - 0.1 * pads.axes[row][:, 1]
        force = 6.0 * (lean - pads.normals[row])
        rows, readings = pads.readings(touch_at(pads, row, force), 1.0)
        own = readings[rows.tolist().index(row)]
        ratio = VectorPadErrors.none().shear_ratio
        expected = pads.axes[row].T @ force * [ratio, ratio, 1.0]
        assert own / np.linalg.norm(own) == pytest.approx(expected / np.linalg.norm(expected), abs=1e-9)
        assert np.abs(readings[:, 2]).argmax() == rows.tolist().index(row)
        # Only the same side of the dome.
        assert (np.linalg.norm(pads.places[rows] - pads.places[row], axis=1) < REACH_M).all()
        assert (pads.normals[rows] @ pads.normals[row] > 0).all()


def test_the_stress_on_a_whole_plane_carries_the_force(surface):
    """Equilibrium: a plane below the contact gets all of it, whatever its direction."""
    pads = VectorPads(SCENE, surface, SCENE.skin.axes, np.random.default_rng(1), replace(VectorPadErrors.none(), coupling=1.0))
    pads.places, pads.normals = pads.places[:1], pads.normals[:1]
    step, half = 2e-4, 0.03
    line = np.arange(-half + step / 2, half, step)
    x, y = (pads.axes[0][:, column] for column in range(2))
    grid = (line[:, None, None] * x + line[None, :, None] * y).reshape(-1, 3)
    pads._cells = (pads.places[0] + (FOAM_THICKNESS_M - PLATE_DEPTH_M) * pads.normals[0] + grid)[None]
    force = 3.0 * x - 1.0 * y - 6.0 * pads.normals[0]
    _, loads = pads.loads(touch_at(pads, 0, force), 0.0)
    whole = loads[0] * (2.0 * half) ** 2 / (np.pi * CELL_RADIUS_M**2)
    # Of the shear a plane of 60 mm misses a few percent.
    assert np.linalg.norm(whole - force) < 0.03 * np.linalg.norm(force)


def test_a_push_beside_a_taxel_points_away_from_the_tip_on_a_bonded_base(surface):
    bonded = replace(VectorPadErrors.none(), coupling=0.2)
    pads = VectorPads(SCENE, surface, SCENE.skin.axes, np.random.default_rng(1), bonded)
    x, n = pads.axes[14][:, 0], pads.normals[14]
    touch = touch_at(pads, 14, -6.0 * n)
    tilts = []
    for off in (0.0, 1e-3):
        rows, loads = pads.loads(replace(touch, point=touch.point - off * x), 1.0)
        own = loads[rows.tolist().index(14)]
        tilts.append(float(np.degrees(np.arctan2(own @ x, -(own @ n)))))
    assert abs(tilts[0]) < 0.5
    assert 1.5 < tilts[1] < 4.0


def test_frames_have_the_order_of_the_scene_and_are_still_without_a_touch(surface):
    pads, rng = perfect(surface), np.random.default_rng(2)
    assert not pads.frame(None, 1.0, rng).any()
    force = -6.0 * pads.normals[7]
    frame = pads.frame(touch_at(pads, 7, force), 1.0, rng)
    assert frame.shape == (SCENE.skin.frame_width,)
    vectors = SCENE.skin.axes.sort_values(frame)
    rows, readings = pads.readings(touch_at(pads, 7, force), 1.0)
    assert vectors[pads.channels[rows]] == pytest.approx(readings)
    # Values of z rise under a push.
    assert frame.reshape(-1, 3)[pads.channels[7], 2] > 0


def test_axes_are_right_handed_with_z_out_of_the_skin_and_the_truth_has_them(surface):
    pads = perfect(surface)
    assert np.linalg.det(pads.axes) == pytest.approx(np.ones(len(pads.axes)))
    assert np.abs(pads.axes[:, :, 2] - pads.normals).max() < 1e-9
    # A dome: the taxels have turns of their own.
    assert np.degrees(np.arccos((pads.axes[:, :, 2] @ pads.axes[:, :, 2].T).min())) > 80.0


def test_skins_of_one_axis_keep_their_pads_and_load_nothing_of_three():
    one = replace(SCENE, skin=replace(SCENE.skin, axes=None, range=(0.0, 255.0)))
    assert isinstance(make_pads(one, load_surface(SCENE.surface)[0], np.random.default_rng(1)), Pads)
    script = "import sys, skincal.physics.rig; print([m for m in sys.modules if 'vector' in m or m.startswith('skincal.axes')])"
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert json.loads(found.stdout.replace("'", '"')) == []


def test_the_scene_is_what_its_formulas_say():
    layout, middle = fingertip.layout_text()
    folder = resource("scenes/fingertip")
    assert (folder / "modules.toml").read_text() == layout
    assert (folder / "scene.toml").read_text() == fingertip.scene_text(middle)
    assert (folder / "fingertip.obj").read_text() == fingertip.mesh_text()


def test_the_flattened_layout_comes_back_to_the_points_of_the_dome(surface):
    """The layout laid on the mesh by geodesics, against the points that were flattened."""
    from skincal.physics.skin import mount_skin

    _, places, _ = mount_skin(SCENE, surface)
    off = np.linalg.norm(places * 1e3 - fingertip.make_points(), axis=1)
    assert np.median(off) < 0.6
    assert off.max() < 2.0
