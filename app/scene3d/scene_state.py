"""What all layers draw from.

`StaticScene` is the part and its layout, which a session does not change; all else comes with the `ViewState` of each tick.
`SceneColours` are the colours of a theme.

A module has a hue, light and dark follow the window. Colours are (3,) uint8, red green blue.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from app import theme
from skincal.geometry import FloatArray, IntArray
from skincal.model.skin import Layout
from skincal.part.part import Part

Colour: TypeAlias = tuple[int, int, int]
ColourArray: TypeAlias = NDArray[np.uint8]

ESTIMATE_BALL_DIAMETER_M = 3.2e-3
"""m. Diameter of a ball: neighbours of the densest skin here are 5 mm apart, so balls that touch are wrong."""
BALL_DIAMETER_OVER_SPACING = 0.64
"""Of a denser skin, such as that of a fingertip: the same share as of 5 mm."""
DEFAULT_VIEW_HALF_HEIGHT_M = 0.06
"""m. Half the height of the view while the part's size is unknown: about a forearm's width."""
ONE_SIDED_SKIN_MIN_MEAN_NORMAL = 0.3
"""Length of the mean normal from which skin has one side to look at: evenly around a tube it is 0, around half of it 0.64."""


def rgb(colour: str) -> Colour:
    """Convert a colour from `#rrggbb`."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


MODULE_RGB = np.array([rgb(hue) for hue in theme.MODULE_HUES], dtype=np.uint8)
"""(7, 3) the modules' hues, which repeat beyond seven modules."""


@dataclass(frozen=True, slots=True)
class SceneColours:
    """Colours of a theme, except the modules' hues."""

    window: theme.Colours
    """Those of the window."""
    background: Colour
    front: Colour
    """Outer side of the part."""
    back: Colour
    """Inner side of the part."""
    ink: Colour
    """Axes, rings, words."""
    faint: Colour
    """Lines to another method, and planned taxels."""
    tints: Mapping[str, Colour]
    """Colours of compared sets: `from`, `to`, `layout`, and the names of methods, which have the hue of the Errors tab."""


def _make_colours(of: theme.Colours, front: Colour, back: Colour, ink: Colour, faint: Colour, to: Colour) -> SceneColours:
    tints = {"from": ink, "to": to, "layout": ink, **{name: rgb(hue) for name, hue in of.methods.items()}}
    return SceneColours(of, rgb(of.window), front, back, ink, faint, tints)


DARK = _make_colours(
    theme.DARK, front=(176, 179, 184), back=(74, 77, 83), ink=(245, 245, 245), faint=(128, 132, 140), to=(255, 92, 170)
)
LIGHT = _make_colours(
    theme.LIGHT, front=(150, 153, 158), back=(214, 216, 220), ink=(16, 18, 22), faint=(120, 124, 130), to=(190, 0, 105)
)


def module_hues(layout: Layout | None, channels: IntArray) -> ColourArray:
    """Return the hue of the module of each of n channels, (n, 3) uint8: repeated beyond seven, the first without a layout."""
    if layout is None:
        return np.tile(MODULE_RGB[0], (len(channels), 1))
    return MODULE_RGB[layout.module_of[channels] % len(MODULE_RGB)]


class TaxelAxes(NamedTuple):
    """Axes of n taxels that measure three."""

    places: FloatArray
    """(n, 3) float, metres."""
    axes: FloatArray
    """(n, 3, 3) float, in columns; NaN where an axis is unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Sets of positions that are compared; they replace the estimates' balls.

    Arrays are in metres, in the order of `StaticScene.channels`, and NaN where a position is unknown.
    """

    sets: Mapping[str, FloatArray]
    """(n, 3) float each, by the name of their colour in `SceneColours.tints`."""
    arrows: FloatArray
    """(n, 2, 3) float: from one set to another."""
    axes: tuple[TaxelAxes, ...] = ()
    """Axes of the first set, and of the second; empty for taxels of one axis."""


class StaticScene:
    """The part of a scene that does not change during a session; `channels` are in the order of the snapshot's estimates."""

    is_draft = False
    """The part is being described, and has no session."""

    def __init__(self, part: Part) -> None:
        self.scene = part.scene
        self.layout = part.scene.skin.layout
        self.surface = part.surface
        self.laid = part.laid
        self.channels: IntArray = np.asarray(part.channels, dtype=np.int64)
        self.row = {int(channel): row for row, channel in enumerate(self.channels)}  # Row in `channels` by channel

    @cached_property
    def hues(self) -> ColourArray:
        """(n, 3) uint8, the module's hue for each of `channels`."""
        return module_hues(self.layout, self.channels)

    @cached_property
    def places(self) -> FloatArray:
        """(n, 3) float, metres: position of each of `channels` by the layout; NaN where unknown."""
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
        """(n, 3) float: as `normals`; NaN without a layout on a surface: nothing else has a far side."""
        known = self.surface is not None and self.laid is not None
        return self.normals if known else np.full((len(self.channels), 3), np.nan)

    @cached_property
    def ball_diameter(self) -> float:
        """m, of the balls of estimates: less on a dense skin."""
        spacing = np.inf if self.layout is None else self.layout.spacing
        return float(min(ESTIMATE_BALL_DIAMETER_M, BALL_DIAMETER_OVER_SPACING * spacing))

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
        return None if length < ONE_SIDED_SKIN_MIN_MEAN_NORMAL else mean / length
