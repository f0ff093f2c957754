"""Taxels that measure three axes: the order of their values in a frame, their signs, and the response used for thresholds.

The frame of a taxel has z out of the skin, and its readings are the force **on** the taxel: a push has a negative z. A device
may send the values of z as pressure, which rises under a push. `polarity` of the scene says so, and then z changes its sign. So
x, y and z of a reading make a right-handed frame if x and y are the force on the taxel, too. A device may send another
order or other signs of the three: `values` names them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.skin import RESPONSE_MIN_OF_UNIT
from skincal.model.tables import Table

AXES_PER_TAXEL = 3
AXIS_NAMES = ("x", "y", "z")
RAW_RESPONSE_MIN = 10.0
"""Raw units. As for skins of one axis."""


class ValueOrder(Enum):
    """Order of the values in a skin frame; the value is its word in scenes."""

    BY_TAXEL = "xyzxyz"
    """The three values of each taxel are together."""
    BY_AXIS = "xxyyzz"
    """The first values of all taxels come first, then the second, then the third."""

    @property
    def is_by_taxel(self) -> bool:
        """Whether the three values of a taxel are together."""
        return self is ValueOrder.BY_TAXEL

    @property
    def other(self) -> ValueOrder:
        """The other order."""
        return ValueOrder.BY_AXIS if self.is_by_taxel else ValueOrder.BY_TAXEL


class ResponseRule(Enum):
    """The one number of a taxel for thresholds and weights; the value is its word in scenes."""

    PUSH = "push"
    """The component into the skin."""
    LENGTH = "length"
    """The length of the vector: for magnetic skins, where z changes its sign next to the contact."""


@dataclass(frozen=True, slots=True)
class SkinAxes:
    """The three values of each taxel in a frame."""

    order: ValueOrder
    signs: tuple[int, int, int]
    """1 or -1 for x, y, z: factor of the value that measures it, to the force on the taxel with z out of the skin."""
    places: tuple[int, int, int]
    """Place of x, y and z among the three values of a taxel, from 0."""
    rule: ResponseRule
    unit: str
    """Unit of the values, `"N"` or `"raw"`."""

    @property
    def response_min(self) -> float:
        """Default of the threshold of a taxel, in `unit`."""
        return RESPONSE_MIN_OF_UNIT.get(self.unit, RAW_RESPONSE_MIN)

    def sort_values(self, frames: FloatArray) -> FloatArray:
        """Bring frames (..., 3 n), raw, in the device's order, to the axes of each taxel, (..., n, 3), with their signs."""
        return self.by_taxel(frames)[..., list(self.places)] * np.array(self.signs, dtype=np.float64)

    def by_taxel(self, frames: FloatArray) -> FloatArray:
        """Group frames (..., 3 n), raw, by taxel: (..., n, 3), each in the device's order of values."""
        count = frames.shape[-1] // AXES_PER_TAXEL
        if self.order is ValueOrder.BY_TAXEL:
            return frames.reshape(*frames.shape[:-1], count, AXES_PER_TAXEL)
        return np.moveaxis(frames.reshape(*frames.shape[:-1], AXES_PER_TAXEL, count), -2, -1)

    def as_frames(self, vectors: FloatArray) -> FloatArray:
        """Put values (..., n, 3) of x, y and z into frames (..., 3 n) in the device's order: the inverse of `sort_values`."""
        count = vectors.shape[-2]
        by_taxel = np.empty(vectors.shape)
        by_taxel[..., list(self.places)] = vectors * np.array(self.signs, dtype=np.float64)
        if self.order is ValueOrder.BY_AXIS:
            by_taxel = np.moveaxis(by_taxel, -1, -2)
        return by_taxel.reshape(*vectors.shape[:-2], AXES_PER_TAXEL * count)


def read_axes(table: Table, polarity: int) -> SkinAxes | None:
    """Read the keys `axes`, `order`, `values`, `response` and `unit` of a scene's [skin]; `None` for one axis.

    The values of z rise under a push if `polarity` is 1, and fall if it is -1.
    """
    axes = table.take("axes", int, 1)
    if axes not in (1, AXES_PER_TAXEL):
        raise InputError(f"{table.where}: axes is {axes}; expected 1, or 3 for taxels that measure a force vector.")
    if axes == 1:
        given = [key for key in ("order", "values", "response", "unit") if key in table.keys]
        if given:
            raise InputError(f"{table.where}: {given[0]} is for taxels of three axes; add axes = 3, or remove {given[0]}.")
        return None
    order = table.choice("order", {each.value: each for each in ValueOrder}, ValueOrder.BY_TAXEL)
    rule = table.choice("response", {each.value: each for each in ResponseRule}, ResponseRule.PUSH)
    unit = table.choice("unit", {"raw": "raw", "N": "N"}, "raw")
    (sign_x, sign_y), places = _read_values(table)
    return SkinAxes(order, (sign_x, sign_y, -polarity), places, rule, unit)


def _read_values(table: Table) -> tuple[tuple[int, int], tuple[int, int, int]]:
    """Read the names of a taxel's values; return the signs of x and y, and the places of x, y and z."""
    names = table.words("values", list(AXIS_NAMES))
    found = {name.lstrip("-"): (-1 if name.startswith("-") else 1, place) for place, name in enumerate(names)}
    if len(names) != AXES_PER_TAXEL or sorted(found) != list(AXIS_NAMES) or any(name.count("-") > 1 for name in names):
        raise InputError(
            f'{table.where}: values is {names}; expected x, y and z in the order of the device, such as ["x", "y", "z"], x and '
            "y with a minus sign where the value has the opposite sign."
        )
    if "-z" in names:
        raise InputError(f'{table.where}: values names "-z"; write "z", and polarity = "down" if its values fall under a push.')
    (sign_x, place_x), (sign_y, place_y), (_, place_z) = (found[axis] for axis in AXIS_NAMES)
    return (sign_x, sign_y), (place_x, place_y, place_z)
