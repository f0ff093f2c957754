"""The tool in the 3D view: it is where its pose in the part's frame says, and appears once the part's pose is known."""

from dataclasses import replace

import numpy as np
import pytest
import pyvista as pv

from app.scene3d.estimates import EstimatesLayer
from app.scene3d.mesh_actors import FRONT
from app.scene3d.scene_state import StaticScene
from app.scene3d.tool import MIN_DRAWN_MOTION_M, ToolLayer
from app.state.tool_tip import tip_in_sensor
from app.text.part_pose_text import unplaced_note
from skincal.geometry import rotation_by
from skincal.model.tables import Table
from skincal.model.tool_rig import read_tool
from skincal.part.part import Part
from skincal.rig.part_pose import NO_PART_POSE
from tests.app.scene3d_support import box, estimate, laid, layout, live, scene, snapshot, tick_of

TIP = np.array([0.001, -0.002, 0.130])
FLANGE = [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0.02], [0, 0, 0, 1]]


def pose_of(vector, place) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_by(np.array(vector)), place
    return pose


@pytest.fixture
def plotter():
    made = pv.Plotter(shape=(1, FRONT + 1), off_screen=True)
    yield made
    made.close()


def part(**tool) -> Part:
    plan = layout()
    spec = read_tool(Table({"sensor": "tool", **tool}, "scene"))
    return Part(replace(scene(plan), tool=spec), box(), laid(plan), plan.channels, ())


def state(of: Part, pose, at=None):
    """A tick with the tool at a pose of its sensor in the link."""
    made = tick_of(snapshot(1, {3: estimate(3, (0.0, 0.0, 0.0))}) if at is None else at, live())
    return replace(made, scene=of.scene, live=replace(made.live, link_from_sensor=pose))


def test_tip_shaft_and_axes_are_drawn_where_the_pose_of_the_tool_says(plotter):
    arm = part(tip_mm=(TIP * 1e3).tolist(), flange=FLANGE)
    layer = ToolLayer(plotter, StaticScene(arm))
    link_from_tool = pose_of((0.3, -0.2, 0.5), (0.01, 0.02, 0.15))
    now = state(arm, link_from_tool @ np.array(FLANGE, float))
    assert layer.show(now)
    expected = link_from_tool[:3, :3] @ TIP + link_from_tool[:3, 3]
    assert layer.tip == pytest.approx(expected)
    assert np.array(layer.shaft.mesh.points) == pytest.approx(np.stack([expected, link_from_tool[:3, 3]]), abs=1e-6)
    assert layer.axes.mesh.n_points == 6
    assert not layer.show(now), "a tool at rest asks for no picture"
    near = pose_of((0, 0, 0), (0.5 * MIN_DRAWN_MOTION_M, 0, 0)) @ now.live.link_from_sensor
    assert not layer.show(state(arm, near))
    assert layer.show(state(arm, pose_of((0, 0, 0), (0.001, 0, 0)) @ now.live.link_from_sensor))


def test_without_a_known_tip_only_the_frame_is_drawn_and_without_a_pose_nothing(plotter):
    arm = part()
    layer = ToolLayer(plotter, StaticScene(arm))
    assert layer.show(state(arm, np.eye(4)))
    assert (layer.tip, layer.ball.is_empty, layer.axes.is_empty) == (None, True, False)
    assert layer.show(state(arm, None))
    assert layer.axes.is_empty
    assert not ToolLayer(plotter, StaticScene(Part(scene(layout()), box(), None, arm.channels, ()))).show(state(arm, np.eye(4)))


def test_before_the_parts_pose_is_known_neither_tool_nor_estimates_are_on_the_part(plotter):
    arm = part(tip_mm=(TIP * 1e3).tolist())
    unknown = replace(snapshot(1, {3: estimate(3, (0.4, 0.1, 0.2))}), part_pose=NO_PART_POSE)
    now = state(arm, pose_of((0, 0, 0), (0.4, 0.1, 0.3)), unknown)
    tool, balls = ToolLayer(plotter, StaticScene(arm)), EstimatesLayer(plotter, StaticScene(arm))
    assert not tool.show(now)
    balls.show(now.on_part)
    assert len(balls.places) == 0, "the estimate is in the base"
    note = unplaced_note(now, tip_in_sensor(now))
    assert "not known yet" in note
    assert "tip of the tool is at (401.0  98.0  430.0) mm in the base" in note
    placed = replace(now, snapshot=replace(unknown, part_pose=None))
    assert placed.on_part is placed
    assert unplaced_note(placed, None) == ""
