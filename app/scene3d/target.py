"""The poke that the guide asks for: a ring on the skin, an arrow from where the tool comes, a cone of accepted directions.

Ring and arrow are white with a black outline, so that they stand out on any hue in both themes. The taxel's name stands next to
the ring.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyvista as pv

from app.scene3d.lines import DRAWN_TOOL_LENGTH_M, closed, cone_rim, tangents
from app.scene3d.mesh_actors import FRONT, NO_POINTS, Label, Layer, MeshActor, Segments, Solid
from app.scene3d.scene_state import StaticScene
from skincal.geometry import FloatArray
from skincal.mesh.surface import point_on_skin
from skincal.words.units import ChannelNames

if TYPE_CHECKING:
    from app.state.view_state import ViewState
    from skincal.guide.guidance import Target

TARGET_RING_RADIUS_M = 4.6e-3  # m: around the rings of a selected taxel, and below the distance to the next one
CORE_RADIUS, OUTLINE_RADIUS = 0.36e-3, 0.75e-3
"""m, of the ring's tube and the arrow's shaft: white, and black around it."""
HEAD_LENGTH, HEAD_RADIUS = 8e-3, 2.2e-3  # m
MIN_TARGET_RING_RADIUS_PX = 13.0  # Radius of the ring at least, so that it is found on a whole body
TARGET_CONE_LINE_COUNT = 4  # Lines of the cone, from the tip to its rim
TARGET_RING_TO_NAME_GAP_PX = 9.0  # Between ring and name
LABEL_FREE_SHARES = np.linspace(0.2, 1.0, 6)  # Shares of the arrow's length, at which labels keep clear of it
BLACK, WHITE = (0, 0, 0), (255, 255, 255)


class TargetLayer(Layer):
    """Ring, arrow, cone and name of the target; nothing without a target."""

    name = "target"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self._names = ChannelNames(static.scene.skin.layout)
        self.ring_outline = Solid(plotter, _ring(OUTLINE_RADIUS), is_outline=True)
        self.arrow_outline = Solid(plotter, _arrow(OUTLINE_RADIUS - CORE_RADIUS), is_outline=True)
        self.ring, self.arrow = Solid(plotter, _ring(CORE_RADIUS)), Solid(plotter, _arrow(0.0))
        self.cone = Segments(plotter, FRONT, 1.5)
        self.at: FloatArray = np.zeros(3)  # (3,) float, metres: where the target's line meets the skin
        self._length = DRAWN_TOOL_LENGTH_M
        self._key: tuple[object, ...] = ()
        self._leeway = 0.0  # rad, half angle of the cone
        self._target: Target | None = None

    def parts(self) -> Mapping[str, Sequence[MeshActor]]:
        return {self.name: (self.ring_outline, self.arrow_outline, self.ring, self.arrow), "cone": (self.cone,)}

    def show(self, state: ViewState) -> bool:
        target = state.target
        max_angle_error = 0.0 if target is None else state.max_angle_error
        key: tuple[object, ...] = ()
        if target is not None:
            key = target.channel, target.landmark, *(way.tobytes() for way in (target.place, target.normal, target.push))
        if (key, max_angle_error) == (self._key, self._leeway):
            return False
        self._key, self._target, self._leeway = key, target, max_angle_error
        if target is not None:
            # An estimate lies above or below the skin, the ring must lie on it. A landmark has an exact position.
            self.at = point_on_skin(None if target.landmark else self.static.surface, target.place, target.normal)
        self.draw()
        return True

    def draw(self) -> None:
        """Keep the ring large enough to be found when the camera moves away."""
        target, scale = self._target, 1.0
        if self.viewpoint is not None:
            scale = max(1.0, MIN_TARGET_RING_RADIUS_PX * self.viewpoint.pixel / TARGET_RING_RADIUS_M)
        self.labels, self._length = (), scale * DRAWN_TOOL_LENGTH_M
        if target is None:
            for actor in (*self.parts()[self.name], self.cone):
                actor.show(NO_POINTS, BLACK)
            return
        across, along = _frame(target.normal), np.roll(_frame(target.push), 1, axis=0)
        for actor, colour, axes in (
            (self.ring_outline, BLACK, across), (self.ring, WHITE, across),
            (self.arrow_outline, BLACK, along), (self.arrow, WHITE, along),
        ):  # fmt: skip
            actor.show(self.at + scale * actor.template.points @ axes, colour)
        lines = _cone(target.push, self._leeway) if self._leeway else NO_POINTS
        self.cone.show(self.at + scale * lines, ((np.array(self.colours.ink, float) + self.colours.faint) / 2).astype(np.uint8))
        if self.viewpoint is not None and target.channel is not None and not target.landmark:
            gap = scale * TARGET_RING_RADIUS_M / self.viewpoint.pixel + TARGET_RING_TO_NAME_GAP_PX
            if target.normal @ (self.viewpoint.pose.position - self.at) > 0.0:
                self.labels = (Label(self._names.short(target.channel), self.at, gap, 2.0),)

    def obstacles(self) -> FloatArray:
        if self._target is None:
            return NO_POINTS
        return np.concatenate(
            [self.ring.mesh.points[::20], self.at - LABEL_FREE_SHARES[:, None] * self._length * self._target.push]
        )


def _frame(third: FloatArray) -> FloatArray:
    """Return (3, 3) float: the axes of a right-handed frame as rows, `third` last."""
    first, second = tangents(third[None])
    return np.stack([first[0], second[0], third])


def _ring(tube_radius: float) -> pv.PolyData:
    """Make a ring about the z axis."""
    return pv.ParametricTorus(
        ringradius=TARGET_RING_RADIUS_M, crosssectionradius=tube_radius, u_res=48, v_res=10, w_res=2
    )  # fmt: skip


def _arrow(margin: float) -> pv.PolyData:
    """Make an arrow along x whose tip is at the origin, larger by a margin on every side, in metres."""
    length = DRAWN_TOOL_LENGTH_M + 3.0 * margin
    return pv.Arrow(
        start=(-DRAWN_TOOL_LENGTH_M - margin, 0.0, 0.0), scale=length, shaft_radius=(1.5 * CORE_RADIUS + margin) / length,
        tip_radius=(HEAD_RADIUS + 1.5 * margin) / length, tip_length=(HEAD_LENGTH + 3.0 * margin) / length,
        shaft_resolution=12, tip_resolution=16,
    )  # fmt: skip


def _cone(push: FloatArray, angle: float) -> FloatArray:
    """Return rim and spokes of a cone as segments, (36 + TARGET_CONE_LINE_COUNT, 2, 3) float, metres.

    It opens from the origin against `push`, (3,) float, unit; `angle`, rad, lies between its axis and its side.
    """
    corners = -DRAWN_TOOL_LENGTH_M * cone_rim(push, angle)
    ends = corners[:: len(corners) // TARGET_CONE_LINE_COUNT]
    return np.concatenate([closed(corners), np.stack([np.zeros_like(ends), ends], axis=1)])
