"""The taxels as estimated: balls in their module's hue, marks for the states that have no position, and how uncertain they are.

State is shape, never hue: a ball is estimated, and has a hole where it lies below the skin; an open circle at the planned place
was touched but is not determined yet, a cross is dead. A ring lies around what the last poke changed, two around the selected
taxel.

Sets of places over each other: a dot for each taxel and set, and arrows from one set to another.

What lies below the skin is drawn before the near wall, and the sets of places before the whole part: a difference that goes
into the part must be seen along its whole length. What lies on the part's far side is left out instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.scene3d.camera import Sight
from app.scene3d.scene_state import BALL, ColourArray, Comparison, Look, StaticScene, Tint, View3DState
from app.scene3d.shapes import Balls, Dots, Layer, Segments, crosses, heads, rings
from app.scene3d.wall import Walls, facing
from skincal.geometry import FloatArray, IntArray
from skincal.taxels.result import Estimate, Method, State

BALL_PIXELS = (5.0, 34.0)
"""Smallest and largest ball on the screen: below it a hue cannot be made out, above it balls hide each other."""
RING = 2.6e-3
"""m. Radius of the ring around a ball."""
MARK = 1.3e-3
"""m. Radius of an open circle or a cross."""
HOLE = 0.5
"""Width of the hole of a ball below the skin, in widths of the ball."""
HOLE_LIFT = 1.1
"""How far before its ball's middle the hole lies, in radii of the ball: just before where that bulges most."""
BLIND_REACH = 0.05
"""m. Half of the drawn line of a taxel that is known as a line only: about a forearm's radius."""
LIFT = 4e-4
"""m. Marks float this far above the part."""
SPACE_95 = 2.7955
"""sqrt of the 95 % quantile of chi-square with 3 degrees of freedom."""
SURFACE_95 = 2.4477
"""sqrt of the 95 % quantile of chi-square with 2 degrees of freedom."""
LARGEST = 0.15
"""m. Half axes are cut here in the picture: beyond it an ellipsoid is a line across the view anyhow."""
DISC_LIFT = 6e-4
"""m. Discs float this far above the part."""

BESIDE = (Method.SURFACE, Method.FREE, Method.MODULES)
"""Lines lead to the first of these that there is beside the method that is shown; without a mesh there is no surface method."""


@dataclass(frozen=True, slots=True, eq=False)
class Strokes:
    """Line segments of marks, and which way the skin faces that they lie on."""

    ends: FloatArray
    """(n, 2, 3) float, metres."""
    colours: ColourArray
    """(n, 3) uint8."""
    sides: FloatArray
    """(n, 3) float, unit, outward; NaN where the skin has no far side."""

    @classmethod
    def none(cls) -> Strokes:
        """Return no strokes."""
        return cls(np.empty((0, 2, 3)), np.empty((0, 3), np.uint8), np.empty((0, 3)))

    def seen(self, sight: Sight) -> Strokes:
        """Return those that are turned to the camera."""
        near = ~(facing(self.sides, self.ends[:, 0], sight) < 0.0)
        return Strokes(self.ends[near], self.colours[near], self.sides[near])


class EstimatesLayer(Layer):
    """Balls, marks, and where wanted a line from each estimate to another method's."""

    name = "estimates"

    def __init__(self, static: StaticScene) -> None:
        super().__init__()
        self.static = static
        self.balls = Balls(pixels=12.0)
        self.holes = Dots(pixels=6.0, render_points_as_spheres=True)
        self.marks = Segments(pixels=2.0)
        self.differences = Segments(pixels=1.5)
        self.alternative = Segments(pixels=1.5)
        """Where else the selected taxel may lie."""
        self.shown: IntArray = np.empty(0, dtype=np.int64)
        """(k,) channels that have a ball, in the order of `places`."""
        self.places: FloatArray = np.empty((0, 3))
        self.near: NDArray[np.bool_] = np.empty(0, dtype=bool)
        """(k,) whether each is drawn: not on the far side of the part."""
        self._hues: ColourArray = np.empty((0, 3), dtype=np.uint8)
        self._walls = Walls(static)
        self._wall = self._walls.beside(self.shown, self.places)
        self._strokes = Strokes.none()
        """The marks where they are."""
        self._key: object = None
        self._compared = False

    def set_colours(self, look: Look) -> None:
        """Take the colours of a theme."""
        self.look = look
        self._key = None

    def draw(self) -> None:
        """Keep the balls' size on the part when the camera comes nearer, and see to what lies below the skin or behind it."""
        sight = self.sight
        if sight is None:
            return
        pixels = float(np.clip(BALL * sight.scale, *BALL_PIXELS))
        radius = pixels / 2.0 / sight.scale
        self.balls.actor.GetProperty().SetPointSize(pixels)
        self.holes.actor.GetProperty().SetPointSize(HOLE * pixels)
        self.near = self._wall.seen(self.places, sight)
        # Balls would hide the places that are compared; a click still finds the taxels.
        drawn = np.zeros_like(self.near) if self._compared else self.near
        before, hollow = self._wall.before(self.places, sight, radius), drawn & self._wall.below
        self.balls.set(before[drawn], self._hues[drawn])
        # A hole lies where its ball bulges most.
        self.holes.set(sight.lift(before[hollow], HOLE_LIFT * radius), np.array(self.look.background, np.uint8))
        marks = self._strokes.seen(sight)
        self.marks.join(sight.bring_before(marks.ends, self.static.extent), marks.colours)

    def show(self, state: View3DState) -> bool:
        """Show a session's estimates by one method; return whether anything changed."""
        key = (state.snapshot.generation, state.method, state.selected, state.difference, state.comparison is None)
        if key == self._key:
            return False
        self._key = key
        estimates = state.estimates()
        rows = [row for row, e in enumerate(estimates) if e.state is State.ESTIMATED and e.position is not None]
        self.shown = self.static.channels[rows]
        self.places = _positions([estimates[row] for row in rows])
        self._wall = self._walls.beside(np.array(rows, dtype=np.int64), self.places)
        self._hues = self.static.hues[rows]
        self.near = np.ones(len(rows), dtype=bool)
        self._compared = state.comparison is not None
        self._strokes = self._marks_of(state, estimates)
        self._show_differences(state, rows)
        self._show_alternative(state, estimates)
        self.draw()
        return True

    def _show_alternative(self, state: View3DState, estimates: tuple[Estimate, ...]) -> None:
        """Draw a line from the selected taxel to its rival, or along which a blind one lies."""
        row = self.static.row.get(-1 if state.selected is None else state.selected, len(estimates))
        ends = _alternative(estimates[row], self.static.places[row]) if row < len(estimates) else np.empty((0, 2, 3))
        self.alternative.join(ends, np.array(self.look.ink, np.uint8))

    def _marks_of(self, state: View3DState, estimates: tuple[Estimate, ...]) -> Strokes:
        row, hues, ink = self.static.row, self.static.hues, np.array(self.look.ink, np.uint8)
        touched = [row[channel] for channel in state.snapshot.touched.tolist() if channel in row]
        selected = [row[state.selected]] if state.selected in row else []
        blind, dead = ([at for at, e in enumerate(estimates) if e.state is kind] for kind in (State.BLIND, State.DEAD))
        around = [(touched, RING), (selected, RING), (selected, 1.5 * RING)]
        drawn = [(rows, rings(*self._places(rows, estimates), radius), ink) for rows, radius in around]
        drawn.insert(1, (blind, rings(*self._places(blind), MARK, sides=12), hues[blind][:, None]))
        drawn.insert(2, (dead, crosses(*self._places(dead), MARK), ink))
        ends = np.concatenate([lines.reshape(-1, 2, 3) for _, lines, _ in drawn])
        colours = [np.broadcast_to(colour, (*lines.shape[:2], 3)).reshape(-1, 3) for _, lines, colour in drawn]
        sides = [np.repeat(self.static.skin_normals[rows], lines.shape[1], axis=0) for rows, lines, _ in drawn]
        known = np.isfinite(ends[:, 0, 0])
        return Strokes(ends[known], np.concatenate(colours)[known], np.concatenate(sides)[known])

    def _places(self, rows: list[int], estimates: Sequence[Estimate] = ()) -> tuple[FloatArray, FloatArray]:
        """Return the places of taxels, metres, NaN where unknown, and their normals: by `estimates`, else as planned."""
        normals = self.static.normals[rows]
        centres = self.static.places[rows] + LIFT * normals
        for at, row in enumerate(rows):
            estimate = estimates[row] if row < len(estimates) else None
            if estimate is not None and estimate.position is not None:
                centres[at] = estimate.position
                normals[at] = normals[at] if estimate.normal is None else estimate.normal
        return centres, normals

    def _show_differences(self, state: View3DState, rows: list[int]) -> None:
        found = state.snapshot.estimates
        beside = next((method for method in BESIDE if method is not state.method and method in found), None)
        others = found[beside] if beside is not None and state.difference else ()
        paired = [i for i, row in enumerate(rows) if row < len(others) and others[row].position is not None]
        there = _positions([others[rows[i]] for i in paired])
        self.differences.join(np.stack([self.places[paired], there], axis=1), np.array(self.look.faint, np.uint8))


def _alternative(estimate: Estimate, planned: FloatArray) -> FloatArray:
    """Return the segments that show where else a taxel may lie, (n, 2, 3) float, metres; none where nowhere.

    `planned` is its place by the layout, (3,) float, NaN where unknown.
    """
    if estimate.rival is not None and estimate.position is not None:
        there = estimate.rival.position[None]
        up = np.array([[0.0, 0.0, 1.0] if estimate.normal is None else estimate.normal])
        return np.concatenate([np.stack([estimate.position[None], there], axis=1), rings(there, up, RING).reshape(-1, 2, 3)])
    if estimate.foot is not None and estimate.weakest is not None:
        along = (planned - estimate.foot) @ estimate.weakest if np.isfinite(planned).all() else 0.0
        middle, half = estimate.foot + along * estimate.weakest, BLIND_REACH * estimate.weakest
        return np.stack([middle - half, middle + half])[None]
    return np.empty((0, 2, 3))


def _positions(estimates: list[Estimate]) -> FloatArray:
    return np.array([e.position for e in estimates], dtype=float).reshape(-1, 3)


CIRCLES = rings(np.zeros((3, 3)), np.eye(3), 1.0, sides=48)
"""(3, 48, 2, 3) float: unit circles across the three axes, as segments."""


class UncertaintyLayer(Layer):
    """The 95 % regions of the worst estimate and of the selected one: three circles an ellipsoid, one a disc on a surface.

    A region is {p + L u : |u| <= s} with L L' the covariance; s = 2.80 = sqrt(chi2(3, 0.95)) in space and
    2.45 = sqrt(chi2(2, 0.95)) on a surface, where the covariance has no part along the normal. It leaves out what
    `Estimate` leaves out.
    """

    name = "uncertainty"

    def __init__(self, static: StaticScene) -> None:
        super().__init__()
        self.static = static
        self.lines = Segments(pixels=1.5)
        self._key: object = None

    def show(self, state: View3DState) -> bool:
        """Show the regions of a moment; return whether anything changed."""
        key = (state.snapshot.generation, state.method, state.selected)
        if key == self._key:
            return False
        self._key = key
        rows, estimates = self.rows(state), state.estimates()
        # The empty head keeps the shape where no region is drawn.
        parts = [np.empty((0, 2, 3)), *(region(estimates[row]).reshape(-1, 2, 3) for row in rows)]
        self.lines.join(np.concatenate(parts), np.repeat(self.static.hues[rows], [len(part) for part in parts[1:]], axis=0))
        return True

    def rows(self, state: View3DState) -> list[int]:
        """Return whose regions are drawn: more would hide the taxels that they are about."""
        known = {row: e.rms for row, e in enumerate(state.estimates()) if e.covariance is not None and e.rms is not None}
        worst = sorted(known, key=lambda row: (-known[row], row))[:1]
        selected = self.static.row.get(-1 if state.selected is None else state.selected)
        return worst if selected is None or selected not in known or selected in worst else [*worst, selected]


def region(estimate: Estimate) -> FloatArray:
    """Return the outline of an estimate's 95 % region as segments, (circles, sides, 2, 3) float, metres, link frame."""
    if estimate.position is None or estimate.covariance is None:
        return np.empty((0, 1, 2, 3))
    variances, axes = np.linalg.eigh(estimate.covariance)
    flat = estimate.method is Method.SURFACE or estimate.triangle is not None
    half = np.minimum((SURFACE_95 if flat else SPACE_95) * np.sqrt(np.maximum(variances, 0.0)), LARGEST)
    if not flat:
        return estimate.position + (CIRCLES * half) @ axes.T
    # eigh sorts upwards: the first axis is the normal, and the disc is the circle across it.
    disc = estimate.position + (CIRCLES[:1] * half) @ axes.T
    return disc if estimate.normal is None else disc + DISC_LIFT * estimate.normal


DOT = 1.5e-3
"""m. Diameter of a dot: half of an estimate's ball, so that dots of several sets are seen beside each other."""
DOT_PIXELS = (4.0, 9.0)
"""Smallest and largest dot on the screen."""
HEAD = 2.4e-3
"""m. Length of each of the two strokes of an arrow's head at most."""


class CompareLayer(Layer):
    """The dots and the arrows of a comparison; nothing while nothing is compared."""

    name = "compare"

    def __init__(self, static: StaticScene) -> None:
        super().__init__()
        self.arrows = Segments(pixels=2.0)
        self.dots = Dots(pixels=DOT_PIXELS[1], render_points_as_spheres=True)
        self._shown: Comparison | None = None
        self._part = static.extent
        self._planned, self._normals = static.places, static.skin_normals

    def show(self, state: View3DState) -> bool:
        """Show what is compared in a moment; return whether anything changed."""
        if state.comparison is self._shown:
            return False
        self._shown = state.comparison
        if self._shown is None:
            self.dots.clear()
            self.arrows.clear()
        self.draw()
        return True

    def draw(self) -> None:
        """Keep the dots' size on the part, all before it, and the arrows' heads flat to the camera; leave out the far side."""
        shown, sight = self._shown, self.sight
        if shown is None or sight is None:
            return
        self.dots.actor.GetProperty().SetPointSize(float(np.clip(DOT * sight.scale, *DOT_PIXELS)))
        near = ~(facing(self._normals, self._planned, sight) < 0.0)
        dots = [_known(cloud.places, near) for cloud in shown.clouds]
        tints = [np.tile(self._colour(cloud.tint), (len(places), 1)) for cloud, places in zip(shown.clouds, dots, strict=True)]
        self.dots.set(sight.bring_before(np.concatenate(dots), self._part), np.concatenate(tints))
        shafts = _known(shown.arrows.reshape(-1, 6), near).reshape(-1, 2, 3)
        strokes = np.concatenate([shafts, heads(shafts, sight.towards, HEAD)])
        self.arrows.join(sight.bring_before(strokes, self._part), self._colour(Tint.TO))

    def _colour(self, tint: Tint) -> ColourArray:
        return np.array(self.look.tints[tint], np.uint8)


def _known(rows: FloatArray, near: NDArray[np.bool_]) -> FloatArray:
    return rows[near & np.isfinite(rows).all(axis=1)]
