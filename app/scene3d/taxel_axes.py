"""The axes of taxels that measure a force vector: x red, y green, z blue.

An axis is drawn once it is known: without a poke that leans, z alone. Taxels on the far side are left out, as their balls are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyvista as pv

from app.scene3d.camera import facing
from app.scene3d.estimates import EstimatesLayer
from app.scene3d.mesh_actors import FRONT, NO_POINTS, Layer, Segments
from app.scene3d.scene_state import ColourArray, SceneColours, StaticScene, TaxelAxes, rgb
from skincal.axes.session_turns import ShownTurn
from skincal.geometry import BoolArray, FloatArray

if TYPE_CHECKING:
    from app.state.view_state import ViewState

AXIS_LENGTH_OVER_SPACING = 0.6
MAX_AXIS_LENGTH_M = 4e-3
SELECTED_OVER_OTHERS = 2.5
"""Length of the selected taxel's axes over that of others."""
BROAD_LINE_PX, BROAD_LINE_OPACITY = 6.0, 0.4
"""Of the second of two compared sets: the lines of the first are seen on those of the second."""


class TaxelAxesLayer(Layer):
    """Three lines at each ball of `estimates` whose turn is known, in one mesh."""

    name = "turns"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene, estimates: EstimatesLayer) -> None:
        super().__init__(plotter, static)
        self.lines = Segments(plotter, FRONT, 2.0)
        self.broad = Segments(plotter, FRONT, BROAD_LINE_PX, opacity=BROAD_LINE_OPACITY)
        self._estimates = estimates
        spacing = np.inf if static.layout is None else static.layout.spacing
        self.length = min(AXIS_LENGTH_OVER_SPACING * spacing, MAX_AXIS_LENGTH_M)
        """m, of an axis."""
        self._ends = np.empty((0, 3, 2, 3))
        self._known = np.empty((0, 3), dtype=bool)
        self._key: object = None

    def set_colours(self, colours: SceneColours) -> None:
        self.colours, self._key = colours, None

    def show(self, state: ViewState) -> bool:
        key = (state.snapshot.generation, state.method, state.selected, self.comparison)
        if key == self._key:
            return False
        self._key = key
        layer = self._estimates
        every = [state.snapshot.shown_turn(channel) for channel in layer.shown.tolist()]
        known = [turn if isinstance(turn, ShownTurn) else None for turn in every]
        lengths = np.where(layer.shown == (-1 if state.selected is None else state.selected), SELECTED_OVER_OTHERS, 1.0)
        axes = np.array([np.eye(3) if turn is None else turn.axes for turn in known]).reshape(-1, 3, 3)
        ways = self.length * lengths[:, None, None] * axes.transpose(0, 2, 1)
        starts = np.broadcast_to(layer.places[:, None], ways.shape)
        self._ends = np.stack([starts, starts + ways], axis=2)
        self._known = np.array([_known_axes(turn) for turn in known], dtype=bool).reshape(-1, 3)
        self.draw()
        return True

    def draw(self) -> None:
        """Leave out the far side. While sets are compared, draw the axes of both in place of the session's."""
        if self.viewpoint is None:
            return
        if self.comparison is None:
            self._show_lines(self.lines, self._ends, self._known & self._estimates.near[:, None])
            self.broad.show(NO_POINTS, self.colours.ink)
            return
        near = ~(facing(self.static.skin_normals, self.static.places, self.viewpoint.pose.position) < 0.0)
        nothing = TaxelAxes(np.empty((0, 3)), np.empty((0, 3, 3)))
        for lines, found in zip((self.lines, self.broad), (*self.comparison.axes, nothing, nothing), strict=False):
            ways = self.length * found.axes.transpose(0, 2, 1)
            starts = np.broadcast_to(found.places[:, None], ways.shape)
            ends = np.stack([starts, starts + ways], axis=2)
            self._show_lines(lines, ends, np.isfinite(ends).all(axis=(2, 3)) & near[: len(ends), None])

    def _show_lines(self, lines: Segments, ends: FloatArray, drawn: BoolArray) -> None:
        """Draw those axes of n taxels, `ends` (n, 3, 2, 3), that are `drawn` (n, 3)."""
        colours: ColourArray = np.array([rgb(axis) for axis in self.colours.window.axes], dtype=np.uint8)
        shown: FloatArray = ends[drawn] if drawn.any() else NO_POINTS
        lines.show(shown, np.repeat(colours[np.nonzero(drawn)[1]], 2, axis=0))


def _known_axes(turn: ShownTurn | None) -> tuple[bool, bool, bool]:
    """List for x, y and z of a taxel whether it is known."""
    if turn is None:
        return False, False, False
    return turn.is_in_plane_known, turn.is_in_plane_known, True
