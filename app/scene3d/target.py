"""The poke that the guide asks for: a ring on the skin, and an arrow from where the tool comes to where it pushes.

Everything is drawn twice, broad in black and narrow in white upon it, so that it stands out on any hue, in both themes.
"""

from __future__ import annotations

import numpy as np
from vtkmodules.vtkRenderingCore import vtkRenderer

from app.scene3d.entry import contact_point
from app.scene3d.ground import Frame, Ground
from app.scene3d.looks import Look
from app.scene3d.shapes import Segments, rings, tangents
from skincal.guide.guide import Target
from skincal.readings import FloatArray

RING = 4.6e-3
"""m. Radius of the ring: around the rings of a selected taxel, and below the distance to the next one."""
TOOL = 0.035
"""m. Length of the arrow, a tool's tip: as long as a drawn force axis outside the part."""
HEAD = 7e-3
"""m. Length of each stroke of the arrow's head."""
SPREAD = float(np.radians(28.0))
"""rad. Angle of these strokes with the arrow."""
NEARER = {"rim": -600.0, "core": -1000.0}
"""How far towards the camera each is drawn, in VTK's units of depth, a few millimetres here: the part's curve must not cut
the ring, nor the black the white."""
BLACK, WHITE = np.zeros(3, np.uint8), np.full(3, 255, np.uint8)


class TargetLayer:
    """The ring and the arrow of the target; nothing where nobody guides."""

    name = "target"

    def __init__(self, renderer: vtkRenderer, ground: Ground) -> None:
        self.ground = ground
        self.rim = Segments(pixels=7.0)
        self.core = Segments(pixels=2.5)
        self._key = b""
        for shape, nearer in ((self.rim, NEARER["rim"]), (self.core, NEARER["core"])):
            mapper = shape.actor.GetMapper()
            mapper.SetResolveCoincidentTopologyToPolygonOffset()
            mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0.0, nearer)
            renderer.AddActor(shape.actor)

    def dress(self, look: Look) -> None:
        """Keep the colours: black and white are seen in every theme."""

    def show(self, frame: Frame) -> bool:
        """Show the target of a moment; return whether anything changed."""
        target = frame.target
        key = b"" if target is None else b"".join(each.tobytes() for each in (target.place, target.normal, target.push))
        if key == self._key:
            return False
        self._key = key
        ends = np.empty((0, 2, 3)) if target is None else self._strokes(target)
        for shape, colour in ((self.rim, BLACK), (self.core, WHITE)):
            shape.join(ends, np.tile(colour, (len(ends), 1)))
        return True

    def _strokes(self, target: Target) -> FloatArray:
        """Return the sides of the ring and the strokes of the arrow, (n, 2, 3) float, metres, on the skin."""
        # A believed place lies above or below the skin; seen from outside, the ring must not.
        at = contact_point(self.ground.surface, target.place, -target.normal, target.place)
        ring = rings(at[None], target.normal[None], RING, sides=36).reshape(-1, 2, 3)
        return np.concatenate([ring, arrow(at, target.push)])


def arrow(tip: FloatArray, push: FloatArray) -> FloatArray:
    """Return the strokes of an arrow that ends at `tip`, (3,) float, metres, and points along `push`, (3,) float, unit.

    Returns
    -------
    (5, 2, 3) float, metres: the shaft, then four strokes of the head, so that two of them are seen from any side
    """
    one, two = (across[0] for across in tangents(push[None]))
    sides = np.array([one, -one, two, -two])
    back = HEAD * (np.sin(SPREAD) * sides - np.cos(SPREAD) * push)
    tails = np.concatenate([(tip - TOOL * push)[None], tip + back])
    return np.stack([tails, np.tile(tip, (5, 1))], axis=1)
