"""Which places on or in the part are seen from somewhere, and how those below its skin are brought before the near wall.

A free estimate lies as often inside the part as outside. Drawn where it is, the near wall would cover it; drawn before the
whole part, one of the far side would show, too. So what lies below the skin and is turned to the camera is moved along the
line of sight, which moves nothing in the picture, just so far that it clears the plane that touches the part beside it: a
convex part lies wholly behind that plane. Another limb before it still hides it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.scene3d.camera import Sight
from app.scene3d.scene_state import StaticScene
from skincal.geometry import FloatArray, IntArray
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface

TOLD = 5e-4
"""m. What lies deeper is told from what lies on the skin: less is within what a surface is known to."""
OVER_EDGE = -0.25
"""Cosine. On the skin a ball that is turned this far from the camera still stands out over the part's edge."""
GRAZING = 0.1
"""Cosine. A wall seen more slanting than this is cleared as if it were seen so, or the way would have no end."""


@dataclass(frozen=True, slots=True, eq=False)
class Wall:
    """The part's wall beside n places; all in metres, link frame, and NaN where there is no surface."""

    depths: FloatArray
    """(n,) float: below the nearest point of the surface, negative outside."""
    normals: FloatArray
    """(n, 3) float, unit, outward, at that point."""
    sides: FloatArray
    """(n, 3) float, unit: the way the taxel's skin faces, by the layout where it is laid, else as `normals`."""
    depths_of_plan: FloatArray
    """(n,) float: below the plane that touches the part at the taxel's planned place, else as `depths`."""

    @property
    def below(self) -> NDArray[np.bool_]:
        """(n,) whether a place lies so deep that it is told."""
        return self.depths > TOLD

    def seen(self, places: FloatArray, sight: Sight) -> NDArray[np.bool_]:
        """Return (n,) whether the places, (n, 3), are to be drawn: all but those of the far side."""
        # So, and not `>=`: where nothing has a far side its cosine is NaN, and all is drawn.
        return ~(facing(self.sides, places, sight) < np.where(self.below, 0.0, OVER_EDGE))

    def before(self, places: FloatArray, sight: Sight, radius: float) -> FloatArray:
        """Return the places, (n, 3), those below the skin so far towards the camera that a ball there clears the near wall."""
        at_wall, at_plan = facing(self.normals, places, sight), facing(self.sides, places, sight)
        # Deep inside the nearest wall may be another than the one that is seen.
        slant = np.where(at_wall > GRAZING, at_wall, np.maximum(at_plan, GRAZING))
        depths = np.where(at_wall > GRAZING, self.depths, self.depths_of_plan)
        by = np.where(self.below, (np.maximum(depths, 0.0) + radius) / slant, 0.0)
        return sight.lift(places, by[:, None])


def facing(normals: FloatArray, places: FloatArray, sight: Sight) -> FloatArray:
    """Return (n,) the cosine of the angle between each normal and the way to the camera, both (n, 3)."""
    ways = sight.place - places
    return np.einsum("ix,ix->i", normals, ways) / np.linalg.norm(ways, axis=1)


class Walls:
    """Finds the wall beside the taxels' places; a place that did not move is not looked for again."""

    def __init__(self, static: StaticScene) -> None:
        self._static = static
        count = len(static.channels)
        self._places, self._normals, self._sides = (np.full((count, 3), np.nan) for _ in range(3))
        self._depths, self._depths_of_plan = (np.full(count, np.nan) for _ in range(2))

    def beside(self, rows: IntArray, places: FloatArray) -> Wall:
        """Return the wall beside places, (n, 3), of the taxels in these rows, (n,), of `StaticScene.channels`."""
        moved = np.flatnonzero(np.abs(self._places[rows] - places).sum(axis=1) != 0.0)
        if self._static.surface is not None and len(moved):
            self._find(self._static.surface, rows[moved], places[moved])
        return Wall(self._depths[rows], self._normals[rows], self._sides[rows], self._depths_of_plan[rows])

    def _find(self, surface: Surface, rows: IntArray, places: FloatArray) -> None:
        feet, triangles = nearest_points(surface, places)
        normals = surface.normals[triangles]
        depths = np.einsum("ix,ix->i", feet - places, normals)
        planned, sides = self._static.places[rows], self._static.skin_normals[rows]
        laid = np.isfinite(planned[:, 0] + sides[:, 0])
        self._places[rows], self._normals[rows], self._depths[rows] = places, normals, depths
        self._sides[rows] = np.where(laid[:, None], sides, normals)
        self._depths_of_plan[rows] = np.where(laid, np.einsum("ix,ix->i", planned - places, sides), depths)
