"""The tool of a rig whose tool's poses are streamed: its tip, its shaft, and the axes of the streamed frame.

It is drawn once the part's pose in the base is known: until then the two have no place relative to each other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyvista as pv

from app.scene3d.mesh_actors import NO_POINTS, WITHIN, Dots, Layer, Segments
from app.scene3d.scene_state import ColourArray, SceneColours, StaticScene, rgb
from app.state.tool_tip import tip_in_sensor
from skincal.geometry import FloatArray, inverse_pose

if TYPE_CHECKING:
    from app.state.view_state import ViewState

TIP_BALL_PX, SHAFT_PX, TOOL_AXIS_PX = 16.0, 5.0, 2.5
TOOL_AXIS_LENGTH_M = 0.025
"""m, of the drawn axes of the streamed frame."""
MIN_DRAWN_MOTION_M = 3e-4
"""m. A tool at rest, whose poses have noise, asks for no new picture."""


class ToolLayer(Layer):
    """Ball, shaft and axes; nothing without `[tool]`. The part hides a tip behind it."""

    name = "tool"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self.tool = static.scene.tool
        self.ball, self.shaft = Dots(plotter, WITHIN, TIP_BALL_PX), Segments(plotter, WITHIN, SHAFT_PX)
        self.axes = Segments(plotter, WITHIN, TOOL_AXIS_PX)
        self.tip: FloatArray | None = None
        """(3,) float, metres, link frame: the drawn tip; `None` while the tool is not drawn or its tip is unknown."""
        self._points: FloatArray | None = None  # (5, 3) metres: tip, origin of the streamed frame, ends of its axes

    def set_colours(self, colours: SceneColours) -> None:
        self.colours = colours
        self.draw()

    def show(self, state: ViewState) -> bool:
        if self.tool is None:
            return False
        points = self._find_points(state)
        before = self._points
        if points is None or before is None:
            if points is before:
                return False
        elif np.nanmax(np.abs(points - before)) < MIN_DRAWN_MOTION_M and bool(np.isnan(points[0, 0]) == np.isnan(before[0, 0])):
            return False
        self._points = points
        self.draw()
        return True

    def _find_points(self, state: ViewState) -> FloatArray | None:
        """Compute tip, origin and ends of the axes, (5, 3) metres, link frame; `None` while the pose is unknown."""
        pose, tool = state.live.link_from_sensor, self.tool
        if tool is None or pose is None or not state.snapshot.is_placed or not np.isfinite(pose).all():
            return None
        link_from_tool = pose @ inverse_pose(tool.tool_from_sensor)
        tip = tip_in_sensor(state)
        origin = link_from_tool[:3, 3]
        place = np.full(3, np.nan) if tip is None else pose[:3] @ np.append(tip, 1.0)
        return np.stack([place, origin, *(origin + TOOL_AXIS_LENGTH_M * link_from_tool[:3, axis] for axis in range(3))])

    def draw(self) -> None:
        points = self._points
        if points is None:
            self.tip = None
            for actor in (self.ball, self.shaft, self.axes):
                actor.show(NO_POINTS, self.colours.ink)
            return
        self.tip = points[0] if np.isfinite(points[0]).all() else None
        has_tip = self.tip is not None
        self.ball.show(points[:1] if has_tip else NO_POINTS, self.colours.tints["to"])
        self.shaft.show(points[:2] if has_tip else NO_POINTS, self.colours.faint)
        ends = np.stack([np.stack([points[1], end]) for end in points[2:]])
        self.axes.show(ends, _axis_colours(self.colours))


def _axis_colours(colours: SceneColours) -> ColourArray:
    return np.array([rgb(colour) for colour in colours.window.axes], np.uint8).repeat(2, axis=0)
