"""Channels, modules and their flat layout, from the maker of the skin.

A module is a carrier with taxels at known positions in its own plane: a rigid board, or a soft sheet that may stretch, shear
and fold (`SkinKind`). The layout puts the modules in one unrolled plane: p = c + R(theta) (mirror ? (-x, y) : (x, y)), the rule
of the iCub's `skinGui` files (`SkinMeshThreadPort.cpp`). Lengths are metres, angles radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError
from skincal.model.tables import Table, parse_toml, read_text


class SkinKind(Enum):
    """Material of the modules; the value is its name in files."""

    BOARD = "board"
    """Rigid boards: circuit boards, triangles. They bend with the part, and do not stretch."""
    SHEET = "sheet"
    """Soft sheets: foam, fabric, rubber. They may also stretch, shear and fold when they are glued to the part."""


SKIN_KINDS = {kind.value: kind for kind in SkinKind}
RESPONSE_MIN_OF_UNIT: Mapping[str, float] = MappingProxyType({"N": 0.15, "mN": 150.0})
"""Default of `response_min` for a skin whose device names this unit: 7 times the noise of a good skin (0.02 N), and between one
and two steps of a skin that sends tenths of a newton. A press of 4 N on six taxels gives each more."""


@dataclass(frozen=True, slots=True, eq=False)
class ModuleKind:
    """The plan of one kind of module, in its own plane."""

    name: str
    pads: FloatArray
    """(k, 2) float, metres: position of channel first_channel + i; NaN without a taxel (a thermal pad)."""
    outline: FloatArray
    """(v, 2) float, metres: corners, for drawing."""
    centre_pad: int
    """Local index of the taxel that represents the module (`taxel2Repr`)."""


TAXELS_PER_NEIGHBOUR_SEARCH = 256
"""Taxels whose neighbours are searched at once: 17 MB of differences to 4,200 taxels."""
_OUTLINES_AND_PADS_MM = (
    # icub-main app/skinGui, Triangle.h: the paper's 12-taxel triangle, side 30 mm.
    ("triangle_12", [(-15, -8.66), (15, -8.66), (0, 17.32)], [
        (7.5, -1.443), (10, -5.774), (5, -5.774), (0, -2.887), (-5, -5.774), (-10, -5.774),
        (-7.5, -1.443), (-2.5, 1.443), (-2.5, 7.217), (0, 11.547), (2.5, 7.217), (2.5, 1.443),
    ]),
    # matejhof/icub_matej CDC_PAD_positions.xlsx: the 10-taxel triangle of the newer skin; pads 6 and 10 are thermal.
    ("triangle_10pad", [(-16, -9.2376), (16, -9.2376), (0, 18.475)], [
        (6.533, 0), (9.8, -5.66), (3.267, -5.66), (0, 0), (-3.267, -5.66), (-9.8, -5.66),
        (np.nan, np.nan), (-6.533, 0), (-3.267, 5.66), (0, 11.317), (np.nan, np.nan), (3.267, 5.66),
    ]),
)  # fmt: skip
MODULE_KINDS = {
    name: ModuleKind(name, np.array(pads) * 1e-3, np.array(outline) * 1e-3, 3) for name, outline, pads in _OUTLINES_AND_PADS_MM
}
"""Shipped kinds of modules, by their name in layout files."""


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """Position of a plane of the layout on the part: one point and two directions, link frame, metres."""

    at: FloatArray
    """(2,) float, the point in the layout's plane."""
    point: FloatArray
    """(3,) float, the same point in the link frame."""
    x: FloatArray
    """(3,) float, unit: direction of the layout's x axis."""
    normal: FloatArray
    """(3,) float, unit, outward."""


@dataclass(frozen=True, slots=True, eq=False)
class Module:
    """A carrier of several taxels, in the layout's plane."""

    id: int
    kind: ModuleKind
    first_channel: int
    place: FloatArray
    """(2,) float, metres."""
    angle: float
    mirror: bool
    anchor: Anchor | None = None
    """This module's own anchor; `None` for the layout's."""

    @property
    def channels(self) -> IntArray:
        """(k,) channels that are taxels."""
        return self.first_channel + np.flatnonzero(~np.isnan(self.kind.pads[:, 0]))

    def _in_layout(self, points: FloatArray) -> FloatArray:
        c, s = np.cos(self.angle), np.sin(self.angle)
        own = points * np.array([-1.0 if self.mirror else 1.0, 1.0])
        return self.place + own @ np.array([[c, s], [-s, c]])

    @property
    def pads(self) -> FloatArray:
        """(k, 2) float, metres: positions of `channels` in the layout's plane."""
        return self._in_layout(self.kind.pads[~np.isnan(self.kind.pads[:, 0])])

    @property
    def outline(self) -> FloatArray:
        """(v, 2) float, metres: corners in the layout's plane."""
        return self._in_layout(self.kind.outline)

    @property
    def centre_channel(self) -> int:
        """Channel of the taxel that represents the module."""
        return self.first_channel + self.kind.centre_pad


class Layout:
    """The modules of a skin, at least one, with their positions; a skin frame has `width` channels.

    `path` and `text` are those of its file; `None` and empty without one. `given_kind` is the one that the file names.
    """

    def __init__(
        self,
        modules: tuple[Module, ...],
        width: int,
        path: Path | None = None,
        text: str = "",
        given_kind: SkinKind | None = None,
    ) -> None:
        self.modules, self.width, self.path, self.text, self.given_kind = modules, width, path, text, given_kind

    def __reduce__(self) -> tuple[type[Layout], tuple[object, ...]]:
        """Pickle what was given: the bytes of a layout do not depend on the properties that were read."""
        return Layout, (self.modules, self.width, self.path, self.text, self.given_kind)

    def with_modules(self, modules: tuple[Module, ...]) -> Layout:
        """Copy with other modules."""
        return Layout(modules, self.width, self.path, self.text, self.given_kind)

    @property
    def kind(self) -> SkinKind:
        """Kind of all modules. Files written before kinds existed name none: their modules are boards, as they were then."""
        return self.given_kind or SkinKind.BOARD

    @cached_property
    def channels(self) -> IntArray:
        """(n,) channels that are taxels, ascending."""
        return np.sort(np.concatenate([m.channels for m in self.modules]))

    @cached_property
    def module_of(self) -> IntArray:
        """(width,) index into `modules` for each channel, -1 without a taxel."""
        owner = np.full(self.width, -1, dtype=np.int64)
        for index, module in enumerate(self.modules):
            owner[module.channels] = index
        return owner

    @cached_property
    def places(self) -> FloatArray:
        """(width, 2) float, metres, the layout's plane; NaN without a taxel."""
        places = np.full((self.width, 2), np.nan)
        for module in self.modules:
            places[module.channels] = module.pads
        return places

    @cached_property
    def size(self) -> float:
        """Longest side of the box around the taxels in the layout's plane, metres."""
        return float(np.ptp(self.places[self.channels], axis=0).max())

    @cached_property
    def spacing(self) -> float:
        """Median distance of a taxel to its nearest neighbour in the layout, metres; infinite for a single taxel."""
        x, y = self.places[self.channels].T
        order = np.argsort(x)
        x, y = x[order], y[order]
        # A taxel at hand is no nearer than the nearest: beyond its distance along x, no other one can be. In blocks: the
        # differences of 4,200 taxels at once would take 280 MB.
        bounds, nearest = _distances_at_hand(self.places[self.channels])[order], np.empty(len(x))
        for start in range(0, len(x), TAXELS_PER_NEIGHBOUR_SEARCH):
            rows = np.arange(start, min(start + TAXELS_PER_NEIGHBOUR_SEARCH, len(x)))
            reach = (1.0 + 1e-9) * bounds[rows].max()  # Beyond the rounding of the sums below
            first, last = (int(end) for end in np.searchsorted(x, [x[rows[0]] - reach, x[rows[-1]] + reach]))
            squares = (x[rows, None] - x[first:last]) ** 2 + (y[rows, None] - y[first:last]) ** 2
            squares[np.arange(len(rows)), rows - first] = np.inf
            nearest[rows] = np.sqrt(squares.min(axis=1))
        # `np.median` imports numpy's masked arrays: 10 ms before the window's first picture.
        ordered = np.sort(nearest)
        return float((ordered[(len(x) - 1) // 2] + ordered[len(x) // 2]) / 2.0)


def _distances_at_hand(places: FloatArray) -> FloatArray:
    """Return the distance of each of n places, (n, 2) float, to the one before or after it; infinite for an only one."""
    steps = np.concatenate([[np.inf], np.linalg.norm(np.diff(places, axis=0), axis=1), [np.inf]])
    return np.minimum(steps[:-1], steps[1:])


def load_layout(path: Path, width: int) -> Layout:
    """Read a `*.modules.toml` file for skin frames of `width` channels.

    It holds `kind` ("board" or "sheet"; default: board), and an array of tables `[[modules]]`: `id`, `kind`, `first_channel`,
    `place_mm`, `angle_deg`, `mirror`, optionally `anchor`; and optionally `[kinds.NAME]` with `pads_mm`, `outline_mm`,
    `centre_pad`.
    """
    return read_layout(read_text(path), path, width)


def read_layout(text: str, path: Path, width: int) -> Layout:
    """Read the text of a `*.modules.toml` file; sentences name `path`."""
    document = Table(parse_toml(text, path), str(path))
    given_kind = document.choice("kind", SKIN_KINDS, None)
    kinds, own = dict(MODULE_KINDS), document.table("kinds")
    for name, table in own.subtables() if own is not None else ():
        kinds[name] = _read_kind(name, table)
    tables = document.tables("modules")
    if not tables:
        raise InputError(f"{path}: no [[modules]] table was found; list at least one module.")
    document.refuse_unknown_keys()
    modules = tuple(_read_module(table, kinds, width) for table in tables)
    _check_channels_once(modules, path)
    return Layout(modules, width, path, text, given_kind)


def _check_channels_once(modules: tuple[Module, ...], path: Path) -> None:
    owner: dict[int, int] = {}
    ids: set[int] = set()
    for module in modules:
        if module.id in ids:
            raise InputError(f"{path}: two modules have the id {module.id}; each module has its own: correct one.")
        ids.add(module.id)
        for channel in module.channels:
            if int(channel) in owner:
                raise InputError(
                    f"{path}: channel {channel} belongs to modules {owner[int(channel)]} and {module.id}; "
                    "each channel has one place: correct first_channel."
                )
            owner[int(channel)] = module.id


def _read_kind(name: str, table: Table) -> ModuleKind:
    pads = table.lengths_mm("pads_mm", (None, 2), gaps=True)
    outline = table.lengths_mm("outline_mm", (None, 2))
    centre = table.take("centre_pad", int)
    table.refuse_unknown_keys()
    taxels = np.flatnonzero(~np.isnan(pads).any(axis=1))
    if centre not in taxels:
        raise InputError(f"{table.where}: centre_pad is {centre}; expected one of its taxels, {taxels.tolist()}.")
    # One coordinate alone is no position.
    pads[np.isnan(pads).any(axis=1)] = np.nan
    return ModuleKind(name, pads, outline, centre)


def _read_module(table: Table, kinds: dict[str, ModuleKind], width: int) -> Module:
    number = table.take("id", int)
    table.where += f" (id {number})"
    kind = table.choice("kind", kinds)
    first = table.take("first_channel", int)
    if first < 0 or first + len(kind.pads) > width:
        raise InputError(f"{table.where} takes channels {first} to {first + len(kind.pads) - 1}; a skin frame has {width}.")
    anchor = table.table("anchor")
    module = Module(
        id=number,
        kind=kind,
        first_channel=first,
        place=table.lengths_mm("place_mm", (2,), np.zeros(2)),
        angle=float(np.radians(table.take("angle_deg", float, 0.0))),
        mirror=table.take("mirror", bool, False),
        anchor=None if anchor is None else read_anchor(anchor),
    )
    table.refuse_unknown_keys()
    return module


def read_anchor(table: Table) -> Anchor:
    """Read an anchor table: `at_mm` in the layout's plane, `point_mm`, `x` and `normal` in the link frame.

    `x` and `normal` must be perpendicular to within a degree.
    """
    at, point = table.lengths_mm("at_mm", (2,)), table.lengths_mm("point_mm", (3,))
    x, normal = table.direction("x"), table.direction("normal")
    table.refuse_unknown_keys()
    if abs(float(x @ normal)) >= np.sin(np.radians(1.0)):
        raise InputError(f"{table.where}: x and normal must be perpendicular to within a degree.")
    return Anchor(at=at, point=point, x=x, normal=normal)
