"""The poke that the guide asks for: a ring on the skin, an arrow from where the tool comes, and a cone of pushes as good.

The taxel's name stands beside the ring.

Ring and arrow are drawn twice, broad in black and narrow in white upon it, so that they stand out on any hue, in both themes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from vtkmodules.vtkRenderingCore import vtkProp, vtkRenderer

from app.scene3d.camera import Sight, project
from app.scene3d.estimates import EstimatesLayer
from app.scene3d.names import boxes_around, make_readable, name_actor, put
from app.scene3d.scene_state import StaticScene, View3DState
from app.scene3d.shapes import Layer, Segments, heads, rings, tangents
from skincal.geometry import FloatArray
from skincal.guide.guidance import Target
from skincal.mesh.surface import skin_point
from skincal.words.units import ChannelNames

RING = 4.6e-3
"""m. Radius of the ring: around the rings of a selected taxel, and below the distance to the next one."""
TOOL = 0.035
"""m. Length of the arrow, a tool's tip: as long as a drawn force axis outside the part."""
HEAD = 7e-3
"""m. Length of each of the two strokes of the arrow's head."""
SPOKES = 4
"""Lines of the cone, from the tip to its rim."""
LEAST_PIXELS = 13.0
"""Radius of the ring at least, on the screen: on a whole body a ring of its own size would not be found."""
RIM_LIFT, CORE_LIFT = 3e-3, 5e-3
"""m. How far towards the camera black and white are drawn: the part's curve must not cut the ring, nor the black the white."""
LETTERS, GAP = 15, 8.0
"""Points, size of the name; pixels between it and the ring."""
ALONG = np.linspace(0.2, 1.0, 6)
"""Where along the arrow it is looked whether words would cover it."""
NOTHING: FloatArray = np.empty((0, 4))
BLACK, WHITE = np.zeros(3, np.uint8), np.full(3, 255, np.uint8)


class TargetLayer(Layer):
    """The ring and the arrow of the target; nothing where nobody guides."""

    name = "target"

    def __init__(self, renderer: vtkRenderer, static: StaticScene, estimates: EstimatesLayer) -> None:
        super().__init__()
        self.static = static
        self.label = name_actor(LETTERS, bold=True)
        self.boxes: FloatArray = NOTHING
        """(n, 4) float: what ring, arrow and name cover of the picture; see `names`."""
        self._renderer, self._estimates = renderer, estimates
        self._names = ChannelNames(static.scene.skin.layout)
        self.rim = Segments(pixels=7.0)
        self.core = Segments(pixels=2.5)
        self.cone = Segments(pixels=1.5)
        self._key: tuple[object, ...] = ()
        self._leeway = 0.0
        """rad, half angle of the cone."""
        self._target: Target | None = None
        self._at: FloatArray = np.zeros(3)
        """(3,) float, metres: where the target's line meets the skin."""

    def parts(self) -> Mapping[str, Sequence[vtkProp]]:
        """Return ring and arrow, which are always seen, and the cone."""
        return {self.name: (self.rim.actor, self.core.actor, self.label), "cone": (self.cone.actor,)}

    def show(self, state: View3DState) -> bool:
        """Show the target of a moment; return whether anything changed."""
        target = state.target
        width = 0.0 if target is None else state.leeway
        key: tuple[object, ...] = ()
        if target is not None:
            ways = (target.place, target.normal, target.push)
            key = target.channel, target.landmark, *(way.tobytes() for way in ways)
        if (key, width) == (self._key, self._leeway):
            return False
        self._key, self._target, self._leeway = key, target, width
        if target is not None:
            # A believed place lies above or below the skin; seen from outside, the ring must not. A landmark is where it is.
            surface = None if target.landmark else self.static.surface
            self._at = skin_point(surface, target.place, target.normal)
            # A landmark's name stands beside it already.
            self.label.SetInput("" if target.channel is None or target.landmark else self._names.short(target.channel))
        self.draw()
        return True

    def draw(self) -> None:
        """Keep the ring large enough to be found when the camera goes away, and the arrow's head flat to the camera."""
        target, sight = self._target, self.sight
        # How many times larger than its own size it is drawn.
        scale = 1.0 if sight is None else max(1.0, LEAST_PIXELS / (RING * sight.scale))
        ends = soft = np.empty((0, 2, 3))
        if target is not None:
            ring = rings(np.zeros((1, 3)), target.normal[None], RING, sides=36).reshape(-1, 2, 3)
            towards = np.zeros(3) if sight is None else sight.towards
            ends = self._at + scale * np.concatenate([ring, arrow(target.push, towards)])
            if self._leeway:
                soft = self._at + scale * cone(target.push, self._leeway)
        for shape, colour, by in ((self.rim, BLACK, RIM_LIFT), (self.core, WHITE, CORE_LIFT)):
            shape.join(ends if sight is None else sight.lift(ends, by * scale), colour)
        # Between ink and what is not to be in the way; black and white are seen in every theme.
        self.cone.join(soft, ((np.array(self.look.ink, float) + self.look.faint) / 2.0).astype(np.uint8))
        self.label.SetVisibility(False)
        self.boxes = NOTHING if target is None or sight is None else self._place_name(target, sight, scale)

    def _place_name(self, target: Target, sight: Sight, scale: float) -> FloatArray:
        """Put the name beside the ring, where the arrow is not; return what all of it covers."""
        way = ALONG[:, None] * (-scale * TOOL * target.push)
        middle, *shaft = project(self._renderer, np.concatenate([self._at[None], self._at + way]))
        if not (abs(middle[2]) <= 1.0 and float(target.normal @ (sight.place - self._at)) > 0.0):
            return NOTHING
        radius = scale * RING * sight.scale
        ring, along = boxes_around(middle[None, :2], radius + GAP / 2.0), boxes_around(np.array(shaft)[:, :2], GAP)
        covered = np.concatenate([ring, along[np.isfinite(along[:, 0])]])
        if self.label.GetInput():
            self.label.SetVisibility(True)
            make_readable(self.label, self.look, self.look.ink)
            taken = np.concatenate([covered, self._estimates.boxes(self._renderer)])
            covered = np.concatenate([covered, put(self.label, self._renderer, middle[:2], radius + GAP, taken)[None]])
        return covered


def arrow(push: FloatArray, towards: FloatArray) -> FloatArray:
    """Return the shaft and the head's two strokes of an arrow that ends at the origin, (3, 2, 3) float, metres.

    It points along `push`, (3,) float, unit; the camera, `towards` which (3,) leads, sees both strokes.
    """
    shaft = np.array([[-TOOL * push, np.zeros(3)]])
    strokes = heads(shaft, towards, HEAD)
    # A camera that looks along the arrow sees a dot: either side of it will do.
    return np.concatenate([shaft, strokes if len(strokes) else heads(shaft, -tangents(push[None])[1][0], HEAD)])


def cone(push: FloatArray, angle: float) -> FloatArray:
    """Return the rim and the lines of a cone, (36 + 4, 2, 3) float, metres.

    It opens from the origin against `push`, (3,) float, unit; `angle`, rad, lies between its axis and its side.
    """
    rim = rings((-TOOL * np.cos(angle) * push)[None], push[None], TOOL * float(np.sin(angle)), sides=36).reshape(-1, 2, 3)
    tops = rim[:: len(rim) // SPOKES, 0]
    return np.concatenate([rim, np.stack([np.zeros_like(tops), tops], axis=1)])
