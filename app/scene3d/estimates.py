"""The taxels as estimated: balls in their module's hue, and marks for the states that have no position.

State is shape, never hue: a ball is estimated, an open circle at the planned place was touched but is not determined yet, a
cross is dead. A ring lies around what the last poke changed, two around the selected taxel.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkRenderer

from app.scene3d.camera import Sight
from app.scene3d.ground import Frame, Ground
from app.scene3d.looks import ColourArray, Look
from app.scene3d.shapes import Balls, Segments, crosses, rings
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.taxels.result import Estimate, Method, State

BALL = 3.2e-3
"""m. Diameter of a ball: neighbours of the densest skin here are 5 mm apart, so balls that touch are wrong."""
BALL_PIXELS = (5.0, 34.0)
"""Smallest and largest ball on the screen: below it a hue cannot be told, above it balls hide each other."""
RING = 2.6e-3
"""m. Radius of the ring around a ball."""
MARK = 1.3e-3
"""m. Radius of an open circle or a cross."""
FAR_SIDE = -0.25
"""Cosine. A planned taxel turned further from the camera is behind the part: its ball would show through the near wall."""
BLIND_REACH = 0.05
"""m. Half of the drawn line of a taxel that is known as a line only: about a forearm's radius."""
LIFT = 4e-4
"""m. Marks float this far above the part."""

Other = {Method.FREE: Method.SURFACE, Method.SURFACE: Method.FREE, Method.MODULES: Method.SURFACE}


class EstimatesLayer:
    """Balls, marks, and on wish a line from each estimate to the other method's."""

    name = "estimates"

    def __init__(self, renderer: vtkRenderer, ground: Ground) -> None:
        self.ground = ground
        self.balls = Balls(pixels=12.0)
        self.marks = Segments(pixels=2.0)
        self.differences = Segments(pixels=1.5) if ground.surface is not None else None
        self.alternative: Segments | None = None
        """Where else the selected taxel may lie; made when a taxel is selected that may."""
        self.shown: IntArray = np.empty(0, dtype=np.int64)
        """(k,) channels that have a ball, in the order of `places`."""
        self.places: FloatArray = np.empty((0, 3))
        self.near: NDArray[np.bool_] = np.empty(0, dtype=bool)
        """(k,) whether each is drawn: not on the far side of the part."""
        self._hues: ColourArray = np.empty((0, 3), dtype=np.uint8)
        self._normals: FloatArray = np.empty((0, 3))
        self._renderer = renderer
        self._ink: ColourArray = np.zeros(3, dtype=np.uint8)
        self._faint: ColourArray = np.zeros(3, dtype=np.uint8)
        self._key: object = None
        self._compared = False
        for shape in (self.balls, self.marks, self.differences):
            if shape is not None:
                renderer.AddActor(shape.actor)

    def dress(self, look: Look) -> None:
        """Take the colours of a theme."""
        self._ink, self._faint = np.array(look.ink, np.uint8), np.array(look.faint, np.uint8)
        self._key = None

    def follow(self, sight: Sight) -> None:
        """Keep the balls' size on the part when the camera comes nearer, and leave out those on its far side."""
        self.balls.actor.GetProperty().SetPointSize(float(np.clip(BALL * sight.scale, *BALL_PIXELS)))
        near = ~(self._normals @ sight.towards < FAR_SIDE)
        if not np.array_equal(near, self.near):
            self.near = near
            self._show_balls()

    def show(self, frame: Frame) -> bool:
        """Show a session's estimates by one method; return whether anything changed."""
        key = (frame.snapshot.generation, frame.method, frame.selected, frame.difference, frame.comparison is None)
        if key == self._key:
            return False
        self._key = key
        estimates = frame.estimates()
        rows = [row for row, e in enumerate(estimates) if e.state is State.ESTIMATED and e.position is not None]
        self.shown = self.ground.channels[rows]
        self.places = _positions([estimates[row] for row in rows])
        self._hues = self.ground.hues[rows]
        if self.ground.surface is not None and self.ground.laid is not None:
            self._normals = self.ground.normals[rows]
        else:
            self._normals = np.full((len(rows), 3), np.nan)
        self.near = np.ones(len(rows), dtype=bool)
        self._compared = frame.comparison is not None
        self._show_balls()
        self._show_marks(frame, estimates)
        if self.differences is not None:
            self._show_differences(frame, rows)
        self._show_alternative(frame, estimates)
        return True

    def _show_balls(self) -> None:
        # Balls would hide the places that are compared; a click still finds the taxels.
        drawn = np.zeros_like(self.near) if self._compared else self.near
        self.balls.set(self.places[drawn], self._hues[drawn])

    def _show_alternative(self, frame: Frame, estimates: tuple[Estimate, ...]) -> None:
        """Draw a line from the selected taxel to its rival, or along which a blind one lies."""
        row = self.ground.row.get(-1 if frame.selected is None else frame.selected, len(estimates))
        ends = _alternative(estimates[row], self.ground.places[row]) if row < len(estimates) else np.empty((0, 2, 3))
        if self.alternative is None and len(ends):
            self.alternative = Segments(pixels=1.5)
            self._renderer.AddActor(self.alternative.actor)
        if self.alternative is not None:
            self.alternative.join(ends, np.tile(self._ink, (len(ends), 1)))

    def _show_marks(self, frame: Frame, estimates: tuple[Estimate, ...]) -> None:
        row = self.ground.row
        parts = [
            self._rings(estimates, [row[int(c)] for c in frame.snapshot.touched if int(c) in row], RING),
            self._blind([r for r, e in enumerate(estimates) if e.state is State.BLIND]),
            self._dead([r for r, e in enumerate(estimates) if e.state is State.DEAD]),
        ]
        if frame.selected in row:
            parts += [self._rings(estimates, [row[frame.selected]], RING * k) for k in (1.0, 1.5)]
        self.marks.join(np.concatenate([ends for ends, _ in parts]), np.concatenate([colours for _, colours in parts]))

    def _rings(self, estimates: Sequence[Estimate], rows: list[int], radius: float) -> tuple[FloatArray, ColourArray]:
        """Rings around balls, or around the planned place of a taxel that has none."""
        centres, normals = self._planned(rows)
        for at, row in enumerate(rows):
            estimate = estimates[row] if row < len(estimates) else None
            if estimate is not None and estimate.position is not None:
                centres[at] = estimate.position
                normals[at] = normals[at] if estimate.normal is None else estimate.normal
        ends = rings(centres, normals, radius)[np.isfinite(centres[:, 0])].reshape(-1, 2, 3)
        return ends, np.tile(self._ink, (len(ends), 1))

    def _blind(self, rows: list[int]) -> tuple[FloatArray, ColourArray]:
        centres, normals = self._planned(rows)
        known = np.isfinite(centres[:, 0])
        circles = rings(centres[known], normals[known], MARK, sides=12)
        return circles.reshape(-1, 2, 3), np.repeat(self.ground.hues[rows][known], circles.shape[1], axis=0)

    def _dead(self, rows: list[int]) -> tuple[FloatArray, ColourArray]:
        centres, normals = self._planned(rows)
        known = np.isfinite(centres[:, 0])
        strokes = crosses(centres[known], normals[known], MARK).reshape(-1, 2, 3)
        return strokes, np.tile(self._ink, (len(strokes), 1))

    def _planned(self, rows: list[int]) -> tuple[FloatArray, FloatArray]:
        normals = self.ground.normals[rows]
        return self.ground.places[rows] + LIFT * normals, normals.copy()

    def _show_differences(self, frame: Frame, rows: list[int]) -> None:
        others = frame.snapshot.estimates.get(Other[frame.method], ())
        paired = [i for i, row in enumerate(rows) if row < len(others) and others[row].position is not None]
        if not frame.difference:
            paired = []
        there = _positions([others[rows[i]] for i in paired])
        ends = np.stack([self.places[paired], there], axis=1)
        if self.differences is not None:
            self.differences.join(ends, np.tile(self._faint, (len(ends), 1)))


def _alternative(estimate: Estimate, planned: FloatArray) -> FloatArray:
    """Return the segments that show where else a taxel may lie, (n, 2, 3) float, metres; none where nowhere.

    Parameters
    ----------
    planned : (3,) float, its place by the layout; NaN where unknown
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
