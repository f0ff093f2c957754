"""Axes of taxels in the 3D view: known ones on near taxels, longer on the selected one, in one mesh."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from app.scene3d.camera import Viewpoint, pose_of
from app.scene3d.scene_renderer import SceneRenderer
from app.scene3d.scene_state import LIGHT, Comparison, StaticScene, TaxelAxes, rgb
from app.scene3d.taxel_axes import SELECTED_OVER_OTHERS
from skincal.axes.axis_checks import DeadAxis
from skincal.part.part import Part
from tests.app.scene3d_support import box, estimate, laid, snapshot, tick_of
from tests.app.three_axes_support import THREE_AXES_SCENE
from tests.app.view3d_on_screen import make_plotter
from tests.app.window_support import PLAN, SCENE
from tests.skincal.axes.turn_support import QUARTER, turn_of, turns_of

PLACES = laid(PLAN).places


@pytest.fixture(scope="module")
def plotter():
    with closing(make_plotter((200, 150))) as made:
        yield made


def renderer_of(plotter, scene):
    return SceneRenderer(plotter, StaticScene(Part(scene, box(), laid(PLAN), PLAN.channels, ())), LIGHT)


def test_axes_are_drawn_at_near_taxels_whose_turn_is_known(plotter):
    renderer = renderer_of(plotter, THREE_AXES_SCENE)
    layer = next(layer for layer in renderer.layers if layer.name == "turns")
    turns = turns_of({3: turn_of(3, QUARTER), 4: turn_of(4, QUARTER, lean_deg=0.0), 5: turn_of(5, QUARTER)})
    known = {channel: estimate(channel, PLACES[channel]) for channel in (3, 4, 5, 6)}
    state = tick_of(replace(snapshot(1, known), turns=turns))
    renderer.fit()
    for each in (renderer.estimates, layer):
        each.follow_camera(Viewpoint(pose_of(renderer.camera), (200, 150), 1.0))
    renderer.show(state)
    assert renderer.estimates.near.all()
    # Three lines at taxels 3 and 5, z alone at taxel 4, none at 6.
    ends = layer.lines.mesh.points.reshape(-1, 2, 3)
    assert len(ends) == 7
    assert ends[:3, 0] == pytest.approx(np.tile(PLACES[3], (3, 1)), abs=1e-6)
    assert (ends[:3, 1] - ends[:3, 0]).T / layer.length == pytest.approx(QUARTER, abs=0.05)
    assert (ends[3, 1] - ends[3, 0]) / layer.length == pytest.approx([0.0, 0.0, 1.0], abs=0.05)
    colours = np.array([rgb(each) for each in LIGHT.window.axes])
    assert np.array_equal(layer.lines.mesh["rgb"][::2], colours[[0, 1, 2, 2, 0, 1, 2]])
    # The selected one is larger.
    renderer.show(replace(state, selected=3))
    longer = layer.lines.mesh.points.reshape(-1, 2, 3)
    lengths = np.linalg.norm(longer[:, 1] - longer[:, 0], axis=1) / layer.length
    assert lengths == pytest.approx([SELECTED_OVER_OTHERS] * 3 + [1.0] * 4, rel=1e-4)
    # A dead axis leaves no direction.
    dead = turns_of({channel: turn_of(channel, QUARTER) for channel in (3, 5)})
    dead.__dict__["dead_axes"] = (DeadAxis(3, "x", is_stuck=False, pokes=10),)
    renderer.show(tick_of(replace(snapshot(2, known), turns=dead)))
    assert layer.lines.mesh.points.reshape(-1, 2, 3)[:, 0] == pytest.approx(np.tile(PLACES[5], (3, 1)), abs=1e-6)
    renderer.hide(frozenset({"turns"}))
    assert not layer.lines.actor.visibility
    renderer.hide(frozenset())
    assert layer.lines.actor.visibility
    # From below nothing is near; next to compared sets without axes nothing is drawn.
    renderer.estimates.near = np.zeros(4, dtype=bool)
    layer.draw()
    assert layer.lines.is_empty
    renderer.estimates.near = np.ones(4, dtype=bool)
    renderer.lay_over(Comparison({}, np.full((24, 2, 3), np.nan)), difference=False)
    layer.show(state)
    assert layer.lines.is_empty
    # Those of two compared sets: the first thin, the second broad, each at its own places.
    axes, moved = np.full((len(PLAN.channels), 3, 3), np.nan), PLACES[PLAN.channels] + 1e-3
    axes[3], axes[4, :, 2] = QUARTER, [0.0, 0.0, 1.0]
    turned = axes.copy()
    turned[3] = QUARTER @ QUARTER
    pair = TaxelAxes(PLACES[PLAN.channels], axes), TaxelAxes(moved, turned)
    renderer.lay_over(Comparison({}, np.full((24, 2, 3), np.nan), pair), difference=False)
    layer.show(state)
    for lines, (places, own) in zip((layer.lines, layer.broad), pair, strict=True):
        ends = lines.mesh.points.reshape(-1, 2, 3)
        assert len(ends) == 4
        assert ends[:3, 0] == pytest.approx(np.tile(places[3], (3, 1)), abs=1e-6)
        assert (ends[:3, 1] - ends[:3, 0]).T / layer.length == pytest.approx(own[3], abs=1e-3)
    assert layer.broad.pixels > layer.lines.pixels
    renderer.lay_over(None, difference=False)
    layer.show(state)
    assert layer.broad.is_empty
    assert not layer.lines.is_empty


def test_a_skin_of_one_axis_has_no_such_layer(plotter):
    assert "turns" not in renderer_of(plotter, SCENE).list_layers()
