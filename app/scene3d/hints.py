"""The scale in millimetres at the lower right of the picture, and the axes of a named frame at the lower left."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from app.scene3d.labels import LETTER_PX
from app.scene3d.mesh_actors import FRONT, NO_POINTS, Label, Layer, Segments
from app.scene3d.scene_state import StaticScene
from skincal.geometry import FloatArray

HINT_EDGE_MARGIN_PX = 26.0  # Between the hints and the edge of the picture
AXIS_PX, MAX_BAR_PX, TICK_PX = 30.0, 120.0, 5.0
LINE_PX, RIM_PX = 2.0, 5.0  # Lines, and the background's colour around them
FRAME_NAME_EDGE_PX = 2.0  # Between the frame's name and the edge of the picture
OBSTACLES_A_LINE = 9  # Points that keep labels off a line
RIM_SETBACK_OVER_HINT_DISTANCE = 2e-3  # Of the distance to the hints: the rim is behind the lines


class HintsLayer(Layer):
    """Lines and words in the plane that the camera looks at."""

    name = "hints"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self.frame = ""  # Name of the frame whose axes are drawn
        self._obstacles = NO_POINTS
        self.rim, self.lines = Segments(plotter, FRONT, RIM_PX), Segments(plotter, FRONT, LINE_PX)

    def draw(self) -> None:
        if self.viewpoint is None:
            return
        pose, pixel = self.viewpoint.pose, self.viewpoint.pixel
        width, height = np.array(self.viewpoint.size) / self.viewpoint.ratio
        length_mm = round_below(MAX_BAR_PX * pixel * 1e3)
        bar = length_mm * 1e-3 / pixel
        middle = np.full(2, HINT_EDGE_MARGIN_PX + AXIS_PX)
        if self.frame:
            middle[1] += LETTER_PX[1]
        axes = pose.axes[:2].T * AXIS_PX
        right, low = width - HINT_EDGE_MARGIN_PX, HINT_EDGE_MARGIN_PX
        left, tick = right - bar, np.array([0.0, TICK_PX])
        bar_ends = np.array([(left, low), (right, low)])
        lines = np.stack([
            *(np.stack([middle, middle + axis]) for axis in axes),
            bar_ends, *(np.stack([end - tick, end + tick]) for end in bar_ends),
        ])  # fmt: skip
        from_middle = (lines.reshape(-1, 2) - (width / 2, height / 2)) * pixel
        points = pose.focus + from_middle @ pose.axes[:2]
        self.lines.show(points, self.colours.ink)
        self.rim.show(points + RIM_SETBACK_OVER_HINT_DISTANCE * (points - pose.position), self.colours.background)
        ends = points.reshape(-1, 2, 3)
        letters = [Label(letter, end[0] + 1.35 * (end[1] - end[0]), 0.0, 3.0) for letter, end in zip("xyz", ends, strict=False)]
        above_bar = ends[3].mean(axis=0) + (TICK_PX + 11.0) * pixel * pose.up
        self.labels = [*letters, Label(f"{length_mm:g} mm", above_bar, 0.0, 3.0)]
        if self.frame:
            half = LETTER_PX[0] * len(self.frame) / 2.0
            below = np.array([max(middle[0], half + FRAME_NAME_EDGE_PX), FRAME_NAME_EDGE_PX + LETTER_PX[1] / 2.0])
            at = pose.focus + (below - (width / 2, height / 2)) * pixel @ pose.axes[:2]
            self.labels.append(Label(self.frame, at, 0.0, 3.0))
        along = np.linspace(0.0, 1.0, OBSTACLES_A_LINE)[:, None, None]
        self._obstacles = (ends[:4, 0] + along * (ends[:4, 1] - ends[:4, 0])).reshape(-1, 3)

    def obstacles(self) -> FloatArray:
        return self._obstacles


def round_below(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `value`."""
    power = 10.0 ** np.floor(np.log10(value))
    # The slack keeps a round length that a rounding made a little too long.
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-9)))
