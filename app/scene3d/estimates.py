"""The estimated taxels, their uncertainty, and sets of positions that are compared.

Shape tells the state, hue the module. A ball is estimated. An open circle at the planned position was touched but is not
determined yet, a cross is dead. One ring surrounds each taxel that the last poke changed, two the selected taxel.

All of it is drawn before the part, so that an estimate inside the part is seen. Taxels on the far side are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress, count, repeat
from operator import attrgetter, is_, is_not
from typing import TYPE_CHECKING, cast

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkPointPicker, vtkRenderer

from app.scene3d.camera import facing
from app.scene3d.lines import crosses, rings
from app.scene3d.mesh_actors import FRONT, NO_POINTS, WITHIN, Dots, Layer, MeshActor, Segments
from app.scene3d.scene_state import ColourArray, Comparison, SceneColours, StaticScene
from skincal.geometry import FloatArray, IntArray
from skincal.taxels.result import Estimate, Method, State

if TYPE_CHECKING:
    from app.state.view_state import ViewState

_POSITION_OF, _STATE_OF, _COVARIANCE_OF = attrgetter("position"), attrgetter("state"), attrgetter("covariance")
BALL_PX = (5.0, 34.0)  # Smallest and largest ball: below it a hue cannot be made out, above it balls hide each other
MAX_CLICK_DISTANCE_PX = 14.0  # A click this near to a ball means it: half a finger's width on a common screen
RING_RADIUS_M = 2.6e-3  # m
OPEN_MARK_RADIUS_M = 1.3e-3  # m, of an open circle or a cross
MARK_HEIGHT_ABOVE_PART_M = 4e-4  # m. Marks float this far above the part.
UNKNOWN_DEPTH_HALF_LENGTH_M = 0.05
"""m. Half of the drawn line of a taxel that is known as a line only: about a forearm's radius."""
CHI_3DOF_95 = 2.7955  # Square root of the 95 % quantile of chi-square with 3 degrees of freedom
CHI_2DOF_95 = 2.4477  # The same with 2 degrees of freedom
MAX_ELLIPSOID_HALF_AXIS_M = 0.15  # m. Half axes are cut here: beyond it an ellipsoid is a line across the view anyhow.
OTHER_METHODS = (Method.SURFACE, Method.FREE, Method.MODULES)
"""Lines lead to the first of these that exists and is not the shown method."""


class EstimatesLayer(Layer):
    """Balls, marks, and lines from each estimate to another method's."""

    name = "estimates"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self.balls = Dots(plotter, FRONT, 12.0)
        self.marks = Segments(plotter, FRONT, 2.0)
        self.differences = Segments(plotter, WITHIN, 1.5)
        self.alternative = Segments(plotter, WITHIN, 1.5)  # Other possible positions of the selected taxel
        self.shown: IntArray = np.empty(0, dtype=np.int64)  # (k,) channels that have a ball, in the order of `places`
        self.places = NO_POINTS
        self.near: NDArray[np.bool_] = np.empty(0, dtype=bool)
        """(k,) whether each is drawn: not on the far side of the part."""
        self._hues: ColourArray = np.empty((0, 3), dtype=np.uint8)
        self._sides = NO_POINTS
        self._marks: tuple[FloatArray, ColourArray, FloatArray] = (np.empty((0, 2, 3)), self._hues, NO_POINTS)
        """(n, 2, 3) segments, (n, 3) colours, (n, 3) outward normals of the skin below them."""
        self._key: object = None
        self._is_compared = False

    def set_colours(self, colours: SceneColours) -> None:
        self.colours, self._key = colours, None

    def draw(self) -> None:
        """Keep the balls' size on the part when the camera moves, and leave out the far side."""
        if self.viewpoint is None:
            return
        position = self.viewpoint.pose.position
        self.balls.pixels = float(np.clip(self.static.ball_diameter / self.viewpoint.pixel, *BALL_PX))
        self.balls.set_pixel_ratio(self.viewpoint.ratio)
        # Negated, since a cosine is NaN where nothing has a far side.
        self.near = ~(facing(self._sides, self.places, position) < 0.0)
        # Balls would hide the positions that are compared.
        drawn = self.near & (not self._is_compared)
        self.balls.show(self.places[drawn], self._hues[drawn])
        ends, colours, sides = self._marks
        near = ~(facing(sides, ends[:, 0], position) < 0.0)
        self.marks.show(ends[near], np.repeat(colours[near], 2, axis=0))

    def show(self, state: ViewState) -> bool:
        key = (state.snapshot.generation, state.method, state.selected, self.difference, self.comparison is None)
        if key == self._key:
            return False
        self._key = key
        estimates = state.estimates
        rows = list(compress(count(), map(is_not, map(_POSITION_OF, estimates), repeat(None))))
        self.shown, self._hues = self.static.channels[rows], self.static.hues[rows]
        self.places = _positions([estimates[row] for row in rows])
        self._sides = self._outward(rows, estimates)
        self._is_compared = self.comparison is not None
        self._marks = self._marks_of(state, estimates)
        self._show_differences(state, rows)
        self._show_alternative(state, estimates)
        self.draw()
        return True

    def obstacles(self) -> FloatArray:
        return self.places[self.near]

    def pick(self, x: float, y: float, renderer: vtkRenderer) -> int | None:
        """Return the channel of the foremost ball at a pixel, else of one within `MAX_CLICK_DISTANCE_PX`."""
        if self.viewpoint is None or self.balls.hidden or not self.near.any():
            return None
        self.balls.show(self.places[self.near], self._hues[self.near])
        picker = vtkPointPicker()
        picker.PickFromListOn()
        picker.AddPickList(self.balls.actor)
        found = -1
        for reach in (self.balls.pixels / 2.0, MAX_CLICK_DISTANCE_PX):
            picker.SetTolerance(reach * self.viewpoint.ratio / float(np.hypot(*self.viewpoint.size)))
            if found < 0 and picker.Pick(x, y, 0.0, renderer):
                found = picker.GetPointId()
        self.draw()
        return None if found < 0 else int(self.shown[self.near][found])

    def _outward(self, rows: list[int], estimates: Sequence[Estimate]) -> FloatArray:
        """Return the skin's outward normal at each taxel, (n, 3): by the layout, else of its estimate; NaN without a part."""
        normals = self.static.skin_normals[rows]
        if self.static.surface is not None and self.static.laid is None:
            own = [estimates[row].normal for row in rows]
            return np.array([np.full(3, np.nan) if normal is None else normal for normal in own]).reshape(-1, 3)
        return normals

    def _show_alternative(self, state: ViewState, estimates: Sequence[Estimate]) -> None:
        """Draw a line from the selected taxel to its second possible position, or along its unknown direction."""
        row = self.static.row.get(-1 if state.selected is None else state.selected, len(estimates))
        ends = _alternative(estimates[row], self.static.places[row]) if row < len(estimates) else NO_POINTS
        self.alternative.show(ends, self.colours.ink)

    def _marks_of(self, state: ViewState, estimates: Sequence[Estimate]) -> tuple[FloatArray, ColourArray, FloatArray]:
        row, hues, ink = self.static.row, self.static.hues, np.array(self.colours.ink, np.uint8)
        touched = [row[channel] for channel in state.snapshot.touched.tolist() if channel in row]
        selected = [row[state.selected]] if state.selected in row else []
        states = list(map(_STATE_OF, estimates))
        blind, dead = (list(compress(count(), map(is_, states, repeat(kind)))) for kind in (State.BLIND, State.DEAD))
        drawn = [
            (blind, rings(*self._places_of(blind), OPEN_MARK_RADIUS_M, sides=12), hues[blind][:, None]),
            (dead, crosses(*self._places_of(dead), OPEN_MARK_RADIUS_M), ink),
            *(
                (rows, rings(*self._places_of(rows, estimates), radius), ink)
                for rows, radius in ((touched, RING_RADIUS_M), (selected, RING_RADIUS_M), (selected, 1.5 * RING_RADIUS_M))
                if rows
            ),
        ]
        ends = np.concatenate([lines.reshape(-1, 2, 3) for _, lines, _ in drawn])
        colours = [np.broadcast_to(colour, (*lines.shape[:2], 3)).reshape(-1, 3) for _, lines, colour in drawn]
        sides = [np.repeat(self._outward(rows, estimates), lines.shape[1], axis=0) for rows, lines, _ in drawn]
        known = np.isfinite(ends[:, 0, 0])
        return ends[known], np.concatenate(colours)[known], np.concatenate(sides)[known]

    def _places_of(self, rows: list[int], estimates: Sequence[Estimate] = ()) -> tuple[FloatArray, FloatArray]:
        """Return positions, metres, NaN where unknown, and normals of taxels: by `estimates`, else as planned."""
        normals = self.static.normals[rows]
        centres = self.static.places[rows] + MARK_HEIGHT_ABOVE_PART_M * normals
        for at, row in enumerate(rows):
            estimate = estimates[row] if row < len(estimates) else None
            if estimate is not None and estimate.position is not None:
                centres[at] = estimate.position
                normals[at] = normals[at] if estimate.normal is None else estimate.normal
        return centres, normals

    def _show_differences(self, state: ViewState, rows: list[int]) -> None:
        found = state.snapshot.estimates
        other = next((method for method in OTHER_METHODS if method is not state.method and method in found), None)
        others = found[other] if other is not None and self.difference else ()
        paired = [i for i, row in enumerate(rows) if row < len(others) and others[row].position is not None]
        there = _positions([others[rows[i]] for i in paired])
        self.differences.show(np.stack([self.places[paired], there], axis=1), self.colours.faint)


def _alternative(estimate: Estimate, planned: FloatArray) -> FloatArray:
    """Return segments to other possible positions of a taxel, (n, 2, 3) float, metres; n = 0 if there are none.

    `planned` is its position by the layout, (3,) float, NaN where unknown.
    """
    if estimate.rival is not None and estimate.position is not None:
        there = estimate.rival.position[None]
        up = np.array([[0.0, 0.0, 1.0] if estimate.normal is None else estimate.normal])
        line = np.stack([estimate.position[None], there], axis=1)
        return np.concatenate([line, rings(there, up, RING_RADIUS_M).reshape(-1, 2, 3)])
    if estimate.line_point is not None and estimate.worst_direction is not None:
        along = (planned - estimate.line_point) @ estimate.worst_direction if np.isfinite(planned).all() else 0.0
        middle = estimate.line_point + along * estimate.worst_direction
        half = UNKNOWN_DEPTH_HALF_LENGTH_M * estimate.worst_direction
        return np.stack([middle - half, middle + half])[None]
    return NO_POINTS


def _positions(estimates: list[Estimate]) -> FloatArray:
    return np.array([e.position for e in estimates], dtype=float).reshape(-1, 3)


UNIT_CIRCLES = rings(np.zeros((3, 3)), np.eye(3), 1.0, sides=48)
"""(3, 48, 2, 3) float: unit circles across the three axes, as segments."""


class UncertaintyLayer(Layer):
    """The 95 % regions of the worst estimate and of the selected one: three circles an ellipsoid, one a disc on a surface.

    A region is {p + L u : |u| <= s} with L L' the covariance; s = 2.80 = sqrt(chi2(3, 0.95)) in space and
    2.45 = sqrt(chi2(2, 0.95)) on a surface, where the covariance has no part along the normal. The region covers sensor noise
    only; see `Estimate` for the errors that it does not cover.
    """

    name = "uncertainty"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self.lines = Segments(plotter, FRONT, 1.5)
        self._key: object = None

    def show(self, state: ViewState) -> bool:
        key = (state.snapshot.generation, state.method, state.selected, self.comparison is None)
        if key == self._key:
            return False
        self._key = key
        rows, estimates = self.rows(state), state.estimates
        parts = [NO_POINTS, *(region(estimates[row], state.snapshot.part_size).reshape(-1, 3) for row in rows)]
        self.lines.show(np.concatenate(parts), np.repeat(self.static.hues[rows], [len(part) for part in parts[1:]], axis=0))
        return True

    def rows(self, state: ViewState) -> list[int]:
        """Return the rows of taxels whose uncertainty regions are drawn: not all, since many would hide the taxels."""
        if self.comparison is not None:
            return []
        from skincal.taxels.shared_errors import known_error  # the first picture has no estimate

        estimated = map(is_not, map(_COVARIANCE_OF, state.estimates), repeat(None))
        errors = ((row, known_error(e, state.snapshot.part_size)) for row, e in compress(enumerate(state.estimates), estimated))
        known = {row: error for row, error in errors if error is not None}
        worst = sorted(known, key=lambda row: (-known[row], row))[:1]
        selected = self.static.row.get(-1 if state.selected is None else state.selected)
        return worst if selected is None or selected not in known or selected in worst else [*worst, selected]


def region(estimate: Estimate, part_size: float) -> FloatArray:
    """Return the outline of an estimate's 95 % region as segments, (circles, sides, 2, 3) float, metres, link frame.

    It is cut to be no longer than the part, `part_size` of the snapshot.
    """
    if estimate.position is None or estimate.covariance is None:
        return np.empty((0, 1, 2, 3))
    variances, axes = np.linalg.eigh(estimate.covariance)
    is_flat = estimate.method is Method.SURFACE or estimate.triangle is not None
    half = (CHI_2DOF_95 if is_flat else CHI_3DOF_95) * np.sqrt(np.maximum(variances, 0.0))
    half = np.minimum(half, min(part_size / 2.0, MAX_ELLIPSOID_HALF_AXIS_M))
    # eigh sorts upwards: on a surface the first axis is the normal, and the disc is the circle across it.
    return estimate.position + (UNIT_CIRCLES[: 1 if is_flat else 3] * half) @ axes.T


COMPARED_DOT_DIAMETER_M = 1.5e-3
"""m: half of an estimate's ball, so that the dots of several sets are seen next to each other."""
DOT_PX = (4.0, 9.0)  # Smallest and largest dot
MAX_ARROWHEAD_LENGTH_M = 2.4e-3  # m. Length of an arrow's head at most.
MAX_ARROWHEAD_SHARE_OF_ARROW = 0.4  # Of an arrow's length in its head at most, so that a short arrow is not all head


class Heads(MeshActor):
    """Heads of arrows, flat coloured; each three points in turn are the tail, the tip and the head's back."""

    def __init__(self, plotter: pv.BasePlotter, renderer: int) -> None:
        super().__init__(plotter, renderer, 1.0, lighting=False)

    def connect(self, points: FloatArray) -> pv.PolyData:
        return pv.PolyData(points.copy())

    def show_heads(self, shafts: FloatArray, colour: ColourArray) -> None:
        """Show a cone at the tip of each shaft, (n, 2, 3) float, metres."""
        ways = shafts[:, 1] - shafts[:, 0]
        lengths = np.linalg.norm(ways, axis=1)
        shafts, ways, lengths = shafts[lengths > 0.0], ways[lengths > 0.0], lengths[lengths > 0.0]
        self.is_empty = len(shafts) == 0
        if not self.is_empty:
            size = np.minimum(MAX_ARROWHEAD_LENGTH_M, MAX_ARROWHEAD_SHARE_OF_ARROW * lengths)
            tips = pv.PolyData(shafts[:, 1] - (size / lengths / 2)[:, None] * ways)
            tips["way"], tips["size"] = ways, size
            cone = pv.Cone(height=1.0, radius=0.45, resolution=8)
            cones = cast("pv.PolyData", tips.glyph(orient="way", scale="size", geom=cone))
            cones.clear_data()
            cones["rgb"] = np.tile(colour, (cones.n_points, 1))
            self.mesh.shallow_copy(cones)
            self._keep_arrays()
        self.update_visibility()


class CompareLayer(Layer):
    """Dots and arrows between two compared sets; empty while nothing is compared."""

    name = "compare"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self.shafts, self.heads = Segments(plotter, FRONT, 2.0), Heads(plotter, FRONT)
        self.dots = Dots(plotter, FRONT, DOT_PX[1], is_lit=False)
        self._shown: Comparison | None = None

    def show(self, state: ViewState) -> bool:  # noqa: ARG002
        if self.comparison is self._shown:
            return False
        self._shown = self.comparison
        self.draw()
        return True

    def draw(self) -> None:
        """Keep the dots' size on the part, and leave out the far side."""
        if self._shown is None or self.viewpoint is None:
            for actor in (self.shafts, self.heads, self.dots):
                actor.show(NO_POINTS, self.colours.ink)
            return
        self.dots.pixels = float(np.clip(COMPARED_DOT_DIAMETER_M / self.viewpoint.pixel, *DOT_PX))
        self.dots.set_pixel_ratio(self.viewpoint.ratio)
        near = ~(facing(self.static.skin_normals, self.static.places, self.viewpoint.pose.position) < 0.0)
        dots = {name: _select_known(places, near) for name, places in self._shown.sets.items()}
        colours = [np.tile(self.colours.tints[name], (len(places), 1)) for name, places in dots.items()]
        self.dots.show(np.concatenate([*dots.values()]), np.concatenate(colours).astype(np.uint8))
        shafts = _select_known(self._shown.arrows.reshape(-1, 6), near).reshape(-1, 2, 3)
        self.shafts.show(shafts, self.colours.tints["to"])
        self.heads.show_heads(shafts, np.array(self.colours.tints["to"], np.uint8))


def _select_known(rows: FloatArray, near: NDArray[np.bool_]) -> FloatArray:
    return rows[near & np.isfinite(rows).all(axis=1)]
