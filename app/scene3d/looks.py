"""Colours of the 3D view: hue names the module, light and dark follow the window.

Colours are (3,) uint8, red green blue.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.geometry.arrays import IntArray
from skincal.model.skin import Layout

Colour: TypeAlias = tuple[int, int, int]
ColourArray: TypeAlias = NDArray[np.uint8]

HUES = np.array(
    [(230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178), (213, 94, 0), (204, 121, 167)], dtype=np.uint8
)
"""(7, 3) Okabe and Ito's palette without its black: seven hues that colour-blind people tell apart."""


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


_DARK_TINTS = {
    Tint.FROM: (245, 245, 245), Tint.TO: (255, 92, 170), Tint.LAYOUT: (245, 245, 245),
    Tint.FREE: (86, 180, 233), Tint.SURFACE: (230, 159, 0), Tint.MODULES: (53, 197, 150),
}  # fmt: skip
_LIGHT_TINTS = {
    Tint.FROM: (16, 18, 22), Tint.TO: (190, 0, 105), Tint.LAYOUT: (16, 18, 22),
    Tint.FREE: (0, 114, 178), Tint.SURFACE: (213, 94, 0), Tint.MODULES: (0, 121, 90),
}  # fmt: skip
DARK = Look(
    background=(20, 23, 28),
    front=(176, 179, 184),
    back=(74, 77, 83),
    ink=(245, 245, 245),
    faint=(128, 132, 140),
    tints=_DARK_TINTS,
)
LIGHT = Look(
    background=(238, 240, 243),
    front=(150, 153, 158),
    back=(214, 216, 220),
    ink=(16, 18, 22),
    faint=(120, 124, 130),
    tints=_LIGHT_TINTS,
)


def module_hues(layout: Layout | None, channels: IntArray) -> ColourArray:
    """Return the hue of each channel's module, repeated beyond seven modules.

    Parameters
    ----------
    layout : None where the modules are not known; then one hue serves all
    channels : (n,) int

    Returns
    -------
    (n, 3) uint8
    """
    if layout is None:
        return np.tile(HUES[0], (len(channels), 1))
    return HUES[layout.module_of[channels] % len(HUES)]


def unit(colour: Colour) -> tuple[float, float, float]:
    """Return a colour as VTK takes it, 0 to 1."""
    return colour[0] / 255, colour[1] / 255, colour[2] / 255
