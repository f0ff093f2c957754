"""SI values to the words and units that an operator reads; the only place where units are converted for display.

Nothing here keeps state or knows Qt. A value that is not known is shown as a dash, never as NaN or zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.skin import Layout

DASH = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"
TIMES = "\N{MULTIPLICATION SIGN}"


Lengths = TypeVar("Lengths", float, FloatArray)


@dataclass(frozen=True, slots=True)
class DisplayUnit:
    """How a quantity in an SI unit is shown."""

    factor: float
    text: str
    decimals: int


UNITS = {
    "m": DisplayUnit(1e3, "mm", 1),
    "N": DisplayUnit(1.0, "N", 1),
    "N m": DisplayUnit(1e3, "N mm", 0),
    "rad": DisplayUnit(180.0 / math.pi, "\N{DEGREE SIGN}", 0),
    "s": DisplayUnit(1.0, "s", 2),
    "1": DisplayUnit(100.0, "%", 1),
    "": DisplayUnit(1.0, "", 0),
}


def number(value: float | None, decimals: int) -> str:
    """Return a number with a true minus sign and never `-0`; a dash where it is None, NaN or infinite."""
    if value is None or not math.isfinite(value):
        return DASH
    text = f"{value:.{decimals}f}"
    if float(text) == 0.0:
        text = text.lstrip("-")
    return text.replace("-", MINUS)


def quantity(value: float | None, unit: str, decimals: int | None = None) -> str:
    """Return a value with its display unit, such as `0.0021, "m"` to `"2.1 mm"`.

    Parameters
    ----------
    value : in `unit`; None or not finite gives a dash
    unit : SI unit, a key of `UNITS`; any other is shown as it is
    decimals : overrides the unit's own
    """
    shown = UNITS.get(unit, DisplayUnit(1.0, unit, 2))
    if value is None or not math.isfinite(value):
        return DASH
    text = number(value * shown.factor, shown.decimals if decimals is None else decimals)
    if not shown.text:
        return text
    return text + shown.text if unit == "rad" else f"{text} {shown.text}"


def cell(value: float | None, unit: str, decimals: int = 1) -> str:
    """Return the number of `quantity` alone, for a column whose heading has the unit."""
    return number(None if value is None else value * UNITS[unit].factor, decimals)


def millimetres(value: float | None, decimals: int = 1) -> str:
    """Return a length in metres as millimetres with the unit."""
    return quantity(value, "m", decimals)


def in_millimetres(value: Lengths) -> Lengths:
    """Return lengths in metres as numbers of millimetres."""
    return value * 1e3


def in_metres(value: Lengths) -> Lengths:
    """Return numbers of millimetres as lengths in metres."""
    return value * 1e-3


def in_minutes(times: FloatArray) -> FloatArray:
    """Return times in seconds as numbers of minutes."""
    return times / 60.0


def newtons(value: float | None, decimals: int = 1) -> str:
    """Return a force with its unit."""
    return quantity(value, "N", decimals)


def degrees(value: float | None, decimals: int = 0) -> str:
    """Return an angle in radians as degrees with the sign."""
    return quantity(value, "rad", decimals)


def point_mm(point: FloatArray | None) -> str:
    """Return a point in metres as three numbers in millimetres, without the unit."""
    if point is None or not np.isfinite(point).all():
        return DASH
    return "  ".join(number(float(v) * 1e3, 1) for v in point)


def direction(unit_vector: FloatArray | None) -> str:
    """Return a unit vector as three numbers with two decimals."""
    if unit_vector is None or not np.isfinite(unit_vector).all():
        return DASH
    return "  ".join(number(float(v), 2) for v in unit_vector)


def rate(per_second: float) -> str:
    """Return a rate, such as `"1000 Hz"`, or a dash while it is unknown."""
    # So, and not `<= 0`: NaN is no rate either.
    if not per_second > 0:
        return DASH
    return f"{number(per_second, 0 if per_second >= 20 else 1)} Hz"


def minutes(seconds: float) -> str:
    """Return a length of time for somebody who plans a break: `"12 min"`, and `"1 min"` for anything less."""
    return f"{max(1, round(seconds / 60.0))} min"


def age(seconds: float) -> str:
    """Return how long ago something was, in words that do not flicker: `"now"` below a quarter of a second."""
    if seconds < 0.25:
        return "now"
    if seconds < 60.0:
        return f"{seconds:.1f} s ago"
    return f"{int(seconds // 60)} min ago"


def count(value: int, singular: str, plural: str | None = None) -> str:
    """Return a count with its noun, thousands set apart: `"1 poke"`, `"12 pokes"`."""
    noun = singular if value == 1 else (plural or singular + "s")
    return f"{grouped(value)} {noun}"


def grouped(value: int) -> str:
    """Return a whole number with its thousands set apart."""
    return f"{value:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


class ChannelNames:
    """What a channel is called: `17-05` is taxel 5 of module 17, as in the maker's files; `ch 12` without a layout."""

    def __init__(self, layout: Layout | None) -> None:
        self._layout = layout

    def short(self, channel: int) -> str:
        """Return the name on labels."""
        module = self.module_index(channel)
        if self._layout is None or module < 0:
            return f"ch {channel}"
        owner = self._layout.modules[module]
        return f"{owner.id}-{channel - owner.first_channel:02d}"

    def long(self, channel: int) -> str:
        """Return the name in full, for tooltips."""
        module = self.module_index(channel)
        if self._layout is None or module < 0:
            return f"channel {channel}"
        owner = self._layout.modules[module]
        return f"taxel {channel - owner.first_channel} of module {owner.id}, channel {channel}"

    def module_index(self, channel: int) -> int:
        """Return the index of the channel's module, -1 where there is none."""
        if self._layout is None or not 0 <= channel < self._layout.width:
            return -1
        return int(self._layout.module_of[channel])
