"""What all layers draw from.

`StaticScene` is the part and its layout, which a session does not change; `View3DState` is what one picture shows of a moment;
`Look` is the colours of a theme.

Hue names the module, light and dark follow the window. Colours are (3,) uint8, red green blue.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from app import theme
from skincal.geometry import FloatArray, IntArray
from skincal.guide.guidance import Target
from skincal.mesh.lay import LaidSkin
from skincal.mesh.surface import Surface
from skincal.model.scene import Scene
from skincal.model.skin import Layout
from skincal.session.snapshot import LiveView, Snapshot
from skincal.taxels.result import Estimate, Method

Colour: TypeAlias = tuple[int, int, int]
ColourArray: TypeAlias = NDArray[np.uint8]

HUES = np.array([list(bytes.fromhex(hue[1:])) for hue in theme.HUES], dtype=np.uint8)
"""(7, 3) the modules' hues: seven that colour-blind people tell apart."""
CREASE = float(np.cos(np.radians(40.0)))
"""Cosine. A triangle more than 40 degrees off the mean of a vertex is beyond an edge; below it the part is smooth."""
BALL = 3.2e-3
"""m. Diameter of a ball: neighbours of the densest skin here are 5 mm apart, so balls that touch are wrong."""
DEFAULT_RADIUS = 0.06
"""m. Half the size of the view while nothing is known of the part: about a forearm's width."""
ONE_SIDED = 0.3
"""Length of the mean normal from which skin has a side to look at: evenly around a tube it is 0, around half of it 0.64."""


class Tint(Enum):
    """Whose places are drawn, where several sets lie over each other."""

    FROM = "from"
    TO = "to"
    LAYOUT = "layout"
    FREE = "free"
    SURFACE = "surface"
    MODULES = "modules"


@dataclass(frozen=True, slots=True)
class Look:
    """What is not a module's hue."""

    background: Colour
    front: Colour
    """Outer side of the part."""
    back: Colour
    """Inner side of the part: what is seen through it or through its opening."""
    ink: Colour
    """Axes, rings, numbers: what must be read."""
    faint: Colour
    """Axes of the past and the laid taxels: what must not be in the way."""
    tints: Mapping[Tint, Colour]
    """Sets of places over each other; the methods as in the course of errors."""


def _rgb(colour: str) -> Colour:
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def _look(of: theme.Colours, front: Colour, back: Colour, ink: Colour, faint: Colour, to: Colour) -> Look:
    """Return the look of a theme: its own window and methods, and what only the 3D view has."""
    tints = {Tint.FROM: ink, Tint.TO: to, Tint.LAYOUT: ink}
    tints |= zip((Tint.FREE, Tint.SURFACE, Tint.MODULES), map(_rgb, of.methods), strict=True)
    return Look(_rgb(of.window), front, back, ink, faint, tints)


DARK = _look(
    theme.DARK, front=(176, 179, 184), back=(74, 77, 83), ink=(245, 245, 245), faint=(128, 132, 140), to=(255, 92, 170)
)
LIGHT = _look(
    theme.LIGHT, front=(150, 153, 158), back=(214, 216, 220), ink=(16, 18, 22), faint=(120, 124, 130), to=(190, 0, 105)
)


def module_hues(layout: Layout | None, channels: IntArray) -> ColourArray:
    """Return the hue of the module of each of n channels, (n, 3) uint8: repeated beyond seven, one where none is known."""
    if layout is None:
        return np.tile(HUES[0], (len(channels), 1))
    return HUES[layout.module_of[channels] % len(HUES)]


def unit(colour: Colour | ColourArray) -> tuple[float, float, float]:
    """Return a colour as VTK takes it, 0 to 1."""
    return float(colour[0]) / 255, float(colour[1]) / 255, float(colour[2]) / 255


class Shaded(NamedTuple):
    """A mesh with one normal a point."""

    points: FloatArray
    """(k, 3) float, metres; the mesh's vertices come first."""
    normals: FloatArray
    """(k, 3) float, unit."""
    triangles: IntArray
    """(nt, 3) int."""


def shade(vertices: FloatArray, triangles: IntArray, normals: FloatArray) -> Shaded:
    """Give every corner the normal to shade it with: smooth, but sharp along edges.

    A corner takes the mean normal of its vertex, weighted by area. Where that is more than `CREASE` off one of the
    vertex's triangles, every corner there gets a point of its own with its triangle's normal. `normals` are (nt, 3), unit.
    """
    corners = vertices[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weighted = np.repeat(normals * areas[:, None], 3, axis=0)
    owner = triangles.ravel()
    mean = np.stack([np.bincount(owner, weighted[:, axis], len(vertices)) for axis in range(3)], axis=1)
    # A vertex of no triangle has no mean, and stays 0.
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), np.finfo(float).tiny)
    own = np.repeat(normals, 3, axis=0)
    on_edge = np.zeros(len(vertices), dtype=bool)
    on_edge[owner[np.einsum("ix,ix->i", mean[owner], own) < CREASE]] = True
    sharp = np.flatnonzero(on_edge[owner])
    split = owner.copy()
    split[sharp] = len(vertices) + np.arange(len(sharp))
    points = np.concatenate([vertices, vertices[owner[sharp]]])
    return Shaded(points, np.concatenate([mean, own[sharp]]), split.reshape(-1, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """One set of places."""

    tint: Tint
    places: FloatArray
    """(n, 3) float, metres, in the order of `StaticScene.channels`; NaN where unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Sets of places over each other, in place of the estimates' balls."""

    clouds: tuple[Cloud, ...]
    arrows: FloatArray
    """(n, 2, 3) float, metres: from one set to another, in the order of `StaticScene.channels`; NaN where there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class View3DState:
    """One picture's content."""

    snapshot: Snapshot
    live: LiveView | None
    method: Method
    selected: int | None
    """Channel."""
    difference: bool = False
    """Also draw a line from each estimate to another method's."""
    target: Target | None = None
    """The poke that is asked for."""
    leeway: float = 0.0
    """rad, how far its push may be off; 0 where that is not said."""
    comparison: Comparison | None = None
    """None while nothing is compared."""

    def estimates(self) -> tuple[Estimate, ...]:
        """Return the chosen method's estimates; empty where the scene has no such method."""
        return self.snapshot.estimates.get(self.method, ())


class StaticScene:
    """The part of a scene that does not change during a session; `channels` are in the order of the snapshot's estimates."""

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
    def skin_normals(self) -> FloatArray:
        """(n, 3) float: as `normals`; NaN where no skin is laid on a surface, and so nothing has a far side."""
        known = self.surface is not None and self.laid is not None
        return self.normals if known else np.full((len(self.channels), 3), np.nan)

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
