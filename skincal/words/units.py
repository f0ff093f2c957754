"""Numbers with units, and names of channels, as operators read them. Unknown values are shown as a dash."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.skin import Layout

DASH = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"
TIMES = "\N{MULTIPLICATION SIGN}"


@dataclass(frozen=True, slots=True)
class DisplayUnit:
    """Display unit of a quantity: factor from SI, text and decimals."""

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
    """Format a number with a true minus sign and never `-0`; a dash for `None`, NaN and infinity."""
    if value is None or not math.isfinite(value):
        return DASH
    text = f"{value:.{decimals}f}"
    if float(text) == 0.0:
        text = text.lstrip("-")
    return text.replace("-", MINUS)


def quantity(value: float | None, unit: str, decimals: int | None = None) -> str:
    """Format a value with its display unit: `0.0021, "m"` gives `"2.1 mm"`.

    Parameters
    ----------
    value : in `unit`
    unit : SI unit, a key of `UNITS`; any other is shown unchanged
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
    """Format the number of `quantity` without its unit, for a column with the unit in its heading."""
    return number(None if value is None else value * UNITS[unit].factor, decimals)


def millimetres(value: float | None, decimals: int = 1) -> str:
    """Format a length in metres as millimetres."""
    return quantity(value, "m", decimals)


def newtons(value: float | None, decimals: int = 1) -> str:
    """Format a force."""
    return quantity(value, "N", decimals)


def degrees(value: float | None, decimals: int = 0) -> str:
    """Format an angle in radians as degrees."""
    return quantity(value, "rad", decimals)


def point_mm(point: FloatArray | None) -> str:
    """Format a point in metres as three numbers in millimetres, without the unit."""
    if point is None or not np.isfinite(point).all():
        return DASH
    return "  ".join(number(float(v) * 1e3, 1) for v in point)


def direction(unit_vector: FloatArray | None) -> str:
    """Format a unit vector with two decimals."""
    if unit_vector is None or not np.isfinite(unit_vector).all():
        return DASH
    return "  ".join(number(float(v), 2) for v in unit_vector)


def rate(per_second: float) -> str:
    """Format a rate, such as `"1000 Hz"`; a dash while it is unknown."""
    # Not `<= 0`: NaN is unknown, too.
    if not per_second > 0:
        return DASH
    return f"{number(per_second, 0 if per_second >= 20 else 1)} Hz"


def duration(seconds: float) -> str:
    """Format a duration: `"14 s"`, from 90 s in whole minutes."""
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{round(seconds / 60.0)} min"


def age(seconds: float) -> str:
    """Format an age: `"now"` below a quarter of a second, so that the text does not flicker."""
    if seconds < 0.25:
        return "now"
    if seconds < 60.0:
        return f"{seconds:.1f} s ago"
    return f"{int(seconds // 60)} min ago"


def count(value: int, singular: str, plural: str | None = None) -> str:
    """Format a count with its noun: `"1 poke"`, `"12 pokes"`."""
    noun = singular if value == 1 else (plural or singular + "s")
    return f"{grouped(value)} {noun}"


def grouped(value: int) -> str:
    """Format a whole number with a narrow space between thousands."""
    return f"{value:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


class ChannelNames:
    """Names of taxels: the channel's number, as in all files, commands and the report: `"taxel 40"`."""

    def __init__(self, layout: Layout | None) -> None:
        self._layout = layout

    def short(self, channel: int) -> str:
        """Give the name on labels and in lists of taxels."""
        return str(channel)

    def taxel(self, channel: int) -> str:
        """Name a taxel in a sentence: `"taxel 40"`."""
        return f"taxel {channel}"

    def long(self, channel: int) -> str:
        """Give the full name, for tooltips."""
        module = self.module_index(channel)
        if self._layout is None or module < 0:
            return f"taxel {channel}"
        owner = self._layout.modules[module]
        return f"taxel {channel}, number {channel - owner.first_channel} of module {owner.id}"

    def module_index(self, channel: int) -> int:
        """Find the index of the channel's module; -1 if it has none."""
        if self._layout is None or not 0 <= channel < self._layout.width:
            return -1
        return int(self._layout.module_of[channel])
