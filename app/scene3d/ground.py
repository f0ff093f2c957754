"""What the layers of one scene share, and what they are asked to show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from app.scene3d.looks import ColourArray, Tint, module_hues
from app.scene3d.shading import Shaded, shade
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.guide.guidance import Target
from skincal.mesh.lay import LaidSkin
from skincal.mesh.surface import Surface
from skincal.model.scene import Scene
from skincal.session.snapshot import LiveView, Snapshot
from skincal.taxels.result import Estimate, Method

DEFAULT_RADIUS = 0.06
"""m. Half the size of the view while nothing is known of the part: about a forearm's width."""

ONE_SIDED = 0.3
"""Length of the mean normal from which skin has a side to look at: evenly around a tube it is 0, around half of it 0.64."""


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """One set of places."""

    tint: Tint
    places: FloatArray
    """(n, 3) float, metres, in the order of `Ground.channels`; NaN where unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Sets of places over each other, in place of the estimates' balls."""

    clouds: tuple[Cloud, ...]
    arrows: FloatArray
    """(n, 2, 3) float, metres: from one set towards another, in the order of `Ground.channels`; NaN where there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One picture's content."""

    snapshot: Snapshot
    live: LiveView | None
    method: Method
    selected: int | None
    """Channel."""
    difference: bool = False
    """Also draw a line from each estimate to the other method's."""
    target: Target | None = None
    """The poke that is asked for."""
    leeway: float = 0.0
    """rad, how far its push may be off; 0 where that is not said."""
    comparison: Comparison | None = None
    """None while nothing is compared."""

    def estimates(self) -> tuple[Estimate, ...]:
        """Return the chosen method's estimates; empty where the scene has no such method."""
        return self.snapshot.estimates.get(self.method, ())


class Ground:
    """The part of a scene that does not change during a session.

    Parameters
    ----------
    surface, laid : None where the scene has none
    channels : taxels, in the order of the snapshot's estimates
    """

    def __init__(self, scene: Scene, surface: Surface | None, laid: LaidSkin | None, channels: Sequence[int]) -> None:
        self.scene = scene
        self.surface = surface
        self.laid = laid
        self.channels: IntArray = np.asarray(channels, dtype=np.int64)
        self.row = {int(channel): row for row, channel in enumerate(self.channels)}
        """Channel to its place in `channels`."""

    @cached_property
    def hues(self) -> ColourArray:
        """(n, 3) uint8, the module's hue for each of `channels`."""
        return module_hues(self.scene.skin.layout, self.channels)

    @cached_property
    def places(self) -> FloatArray:
        """(n, 3) float, metres: where each of `channels` lies by the layout; NaN where unknown."""
        return np.full((len(self.channels), 3), np.nan) if self.laid is None else self.laid.places[self.channels]

    @cached_property
    def normals(self) -> FloatArray:
        """(n, 3) float, unit, outward, by the layout; the link's z axis where unknown."""
        up = np.tile([0.0, 0.0, 1.0], (len(self.channels), 1))
        if self.laid is None:
            return up
        normals = self.laid.normals[self.channels]
        return np.where(np.isfinite(normals), normals, up)

    @cached_property
    def shaded(self) -> Shaded | None:
        """The surface with the normals to shade it by; None without a surface."""
        surface = self.surface
        return None if surface is None else shade(surface.vertices, surface.triangles, surface.normals)

    @cached_property
    def extent(self) -> FloatArray:
        """(n, 3) float, metres: points that the camera must show; empty where neither surface nor places are known."""
        parts = [self.places] if self.laid is None else [self.places, *self.laid.outlines]
        laid = np.concatenate(parts)
        laid = laid[np.isfinite(laid).all(axis=1)]
        return laid if self.surface is None else np.concatenate([laid, self.surface.vertices])

    @cached_property
    def facing(self) -> FloatArray | None:
        """(3,) float, unit: the side of the part that carries the skin; None where unknown or all around."""
        known = np.isfinite(self.places[:, 0])
        mean = self.normals[known].sum(axis=0) / max(1, int(known.sum()))
        length = float(np.linalg.norm(mean))
        return None if length < ONE_SIDED else mean / length
