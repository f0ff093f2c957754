"""Channels, modules and their flat layout: what the maker of the skin knows.

A module is a rigid or flexible carrier with taxels at known places of its own plane. The layout puts modules in one
plane, unrolled: p = c + R(theta) (mirror ? (-x, y) : (x, y)), the rule of the iCub's `skinGui` files
(`SkinMeshThreadPort.cpp`). Lengths are metres, angles radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError
from skincal.model.tables import Table, parse_toml, read_text


@dataclass(frozen=True, slots=True, eq=False)
class ModuleKind:
    """The plan of one kind of module, in its own plane."""

    name: str
    pads: FloatArray
    """(k, 2) float, metres: place of channel first_channel + i; NaN where there is no taxel (a thermal pad)."""
    outline: FloatArray
    """(v, 2) float, metres: corners, for drawing."""
    centre_pad: int
    """Local index of the taxel that represents the module (`taxel2Repr`)."""


def _mm(points: list[tuple[float, float]]) -> FloatArray:
    return np.array(points) * 1e-3


# Taxels whose neighbours are looked for at once: 17 MB of differences to 4,200 taxels.
_AT_ONCE = 256
# Coordinate of a pad that is no taxel.
_NONE = float("nan")
KINDS: dict[str, ModuleKind] = {
    # icub-main app/skinGui, Triangle.h: the paper's 12-taxel triangle, side 30 mm.
    "triangle_12": ModuleKind(
        "triangle_12",
        _mm(
            [
                (7.5, -1.443), (10, -5.774), (5, -5.774), (0, -2.887), (-5, -5.774), (-10, -5.774),
                (-7.5, -1.443), (-2.5, 1.443), (-2.5, 7.217), (0, 11.547), (2.5, 7.217), (2.5, 1.443),
            ]
        ),
        _mm([(-15, -8.66), (15, -8.66), (0, 17.32)]),
        3,
    ),
    # matejhof/icub_matej CDC_PAD_positions.xlsx: the 10-taxel triangle of the newer skin; pads 6 and 10 are thermal.
    "triangle_10pad": ModuleKind(
        "triangle_10pad",
        _mm(
            [
                (6.533, 0), (9.8, -5.66), (3.267, -5.66), (0, 0), (-3.267, -5.66), (-9.8, -5.66),
                (_NONE, _NONE), (-6.533, 0), (-3.267, 5.66), (0, 11.317), (_NONE, _NONE), (3.267, 5.66),
            ]
        ),
        _mm([(-16, -9.2376), (16, -9.2376), (0, 18.475)]),
        3,
    ),
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """Where a plane of the layout lies on the part: one point of it and two directions, link frame, metres."""

    at: FloatArray
    """(2,) float, the point in the layout's plane."""
    point: FloatArray
    """(3,) float, the same point in the link frame."""
    x: FloatArray
    """(3,) float, unit: where the layout's x axis points."""
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
    """This module's own place on the part; without it the layout's anchor holds."""

    @property
    def channels(self) -> IntArray:
        """(k,) channels that are taxels."""
        return self.first_channel + np.flatnonzero(~np.isnan(self.kind.pads[:, 0]))

    def _laid(self, points: FloatArray) -> FloatArray:
        c, s = np.cos(self.angle), np.sin(self.angle)
        # p = c + R(theta) (mirror ? (-x, y) : (x, y)), on rows.
        own = points * np.array([-1.0 if self.mirror else 1.0, 1.0])
        return self.place + own @ np.array([[c, s], [-s, c]])

    @property
    def pads(self) -> FloatArray:
        """(k, 2) float, metres: places of `channels` in the layout's plane."""
        return self._laid(self.kind.pads[~np.isnan(self.kind.pads[:, 0])])

    @property
    def outline(self) -> FloatArray:
        """(v, 2) float, metres: corners in the layout's plane."""
        return self._laid(self.kind.outline)

    @property
    def centre_channel(self) -> int:
        """Channel of the taxel that represents the module."""
        return self.first_channel + self.kind.centre_pad


class Layout:
    """The modules of a skin, at least one, and what follows from their places; a skin frame has `width` channels.

    `path` and `text` are those of the file it was read from; None and empty where it was made otherwise.
    """

    def __init__(self, modules: tuple[Module, ...], width: int, path: Path | None = None, text: str = "") -> None:
        self.modules = modules
        self.width = width
        self.path = path
        self.text = text

    @cached_property
    def channels(self) -> IntArray:
        """(n,) channels that are taxels, ascending."""
        return np.sort(np.concatenate([m.channels for m in self.modules]))

    @cached_property
    def module_of(self) -> IntArray:
        """(width,) index into `modules` for each channel, -1 where there is no taxel."""
        owner = np.full(self.width, -1, dtype=np.int64)
        for index, module in enumerate(self.modules):
            owner[module.channels] = index
        return owner

    @cached_property
    def places(self) -> FloatArray:
        """(width, 2) float, metres, the layout's plane; NaN where there is no taxel."""
        places = np.full((self.width, 2), np.nan)
        for module in self.modules:
            places[module.channels] = module.pads
        return places

    @cached_property
    def spacing(self) -> float:
        """Median distance of a taxel to its nearest neighbour in the layout, metres; infinite for a single taxel."""
        places = self.places[self.channels]
        # In blocks: the differences of 4,200 taxels at once would take 280 MB.
        nearest = np.empty(len(places))
        for start in range(0, len(places), _AT_ONCE):
            block = places[start : start + _AT_ONCE]
            distances = np.linalg.norm(block[:, None] - places[None], axis=-1)
            distances[np.arange(len(block)), start + np.arange(len(block))] = np.inf
            nearest[start : start + _AT_ONCE] = distances.min(axis=1)
        return float(np.median(nearest))


def load_layout(path: Path, width: int) -> Layout:
    """Read a `*.modules.toml` file for skin frames of `width` channels.

    It holds an array of tables `[[modules]]`: `id`, `kind`, `first_channel`, `place_mm`, `angle_deg`, `mirror`, optionally
    `anchor`; and optionally `[kinds.NAME]` with `pads_mm`, `outline_mm`, `centre_pad`.

    Raises InputError, which names the file, the module and what was expected.
    """
    return read_layout(read_text(path), path, width)


def read_layout(text: str, path: Path, width: int) -> Layout:
    """Read the text of a `*.modules.toml` file; raises what `load_layout` raises, whose sentences name `path`."""
    document = Table(parse_toml(text, path), str(path))
    kinds, own = dict(KINDS), document.table("kinds")
    for name, table in own.each_table() if own is not None else ():
        kinds[name] = _read_kind(name, table)
    tables = document.tables("modules")
    if not tables:
        raise InputError(f"{path}: no [[modules]] table was found; list at least one module.")
    document.done()
    modules = tuple(_read_module(table, kinds, width) for table in tables)
    _check_owners(modules, path)
    return Layout(modules, width, path, text)


def _check_owners(modules: tuple[Module, ...], path: Path) -> None:
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
    table.done()
    taxels = np.flatnonzero(~np.isnan(pads).any(axis=1))
    if centre not in taxels:
        raise InputError(f"{table.where}: centre_pad is {centre}; expected one of its taxels, {taxels.tolist()}.")
    # One coordinate alone is no place.
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
    table.done()
    return module


def read_anchor(table: Table) -> Anchor:
    """Read an anchor table: `at_mm` in the layout's plane, `point_mm`, `x` and `normal` in the link frame.

    Raises InputError: a key is missing, is not numbers, or `x` and `normal` are not perpendicular to within a degree.
    """
    at, point = table.lengths_mm("at_mm", (2,)), table.lengths_mm("point_mm", (3,))
    x, normal = table.direction("x"), table.direction("normal")
    table.done()
    if abs(float(x @ normal)) >= np.sin(np.radians(1.0)):
        raise InputError(f"{table.where}: x and normal must be perpendicular to within a degree.")
    return Anchor(at=at, point=point, x=x, normal=normal)
