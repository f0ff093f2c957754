"""The tip of a robot that pokes, where the robot reports it: a ball, and a line along the tool."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyvista as pv

from app.scene3d.mesh_actors import NO_POINTS, WITHIN, Dots, Layer, Segments
from app.scene3d.scene_state import StaticScene

if TYPE_CHECKING:
    from app.state.view_state import ViewState
    from skincal.robot.target_lines import TipPose

DRAWN_ROBOT_TOOL_LENGTH_M = 0.08  # m of the tool that are drawn
BALL_PX, LINE_PX = 18.0, 5.0
TIP_BALL_SHIFT_ALONG_TOOL_M = 0.003
"""m, of the ball along the tool: otherwise the part hides half of a ball that touches it."""


class RobotTipLayer(Layer):
    """Ball and line; nothing without a robot. The part hides a tip behind it."""

    name = "robot"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self.ball, self.tool = Dots(plotter, WITHIN, BALL_PX), Segments(plotter, WITHIN, LINE_PX)
        self._tip: TipPose | None = None

    def show(self, state: ViewState) -> bool:
        # The poses of a tool show it better: `ToolLayer`.
        tip = state.tip if state.scene.tool is None else None
        if tip is self._tip:
            return False
        self._tip = tip
        self.draw()
        return True

    def draw(self) -> None:
        tip = self._tip
        ends = NO_POINTS if tip is None else np.stack([tip.place, tip.place - DRAWN_ROBOT_TOOL_LENGTH_M * tip.push])
        ball = NO_POINTS if tip is None else tip.place - TIP_BALL_SHIFT_ALONG_TOOL_M * tip.push
        self.ball.show(ball, self.colours.tints["to"])
        self.tool.show(ends, self.colours.ink)
