"""Channels, modules and their flat layout: what the maker of the skin knows.

A module is a rigid or flexible board with taxels at known places of its own plane. The layout puts modules in one
plane, unrolled: p = c + R(theta) (mirror ? (-x, y) : (x, y)), the rule of the iCub's `skinGui` files
(`SkinMeshThreadPort.cpp`). Lengths are metres, angles radians.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from skincal.errors import InputError
from skincal.readings import FloatArray, IntArray


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
    """One board of the skin, in the layout's plane."""

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
    """The modules of a skin and what follows from their places.

    Parameters
    ----------
    modules : at least one
    width : channels of a skin frame
    """

    def __init__(self, modules: tuple[Module, ...], width: int) -> None:
        self.modules = modules
        self.width = width

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
        """Median distance of a taxel to its nearest neighbour in the layout, metres."""
        places = self.places[self.modules[0].channels]
        distances = np.linalg.norm(places[:, None] - places[None], axis=-1)
        np.fill_diagonal(distances, np.inf)
        return float(np.median(distances.min(axis=1)))


def load_layout(path: Path, width: int) -> Layout:
    """Read a `*.modules.toml` file.

    Parameters
    ----------
    path : file with an array of tables `[[modules]]`: `id`, `kind`, `first_channel`, `place_mm`, `angle_deg`, `mirror`,
        optionally `anchor`; and optionally `[kinds.NAME]` with `pads_mm`, `outline_mm`, `centre_pad`
    width : channels of a skin frame

    Raises
    ------
    InputError
        Names the file, the module and what was expected.
    """
    document = read_toml(path)
    kinds = dict(KINDS)
    for name, table in document.get("kinds", {}).items():
        kinds[name] = _read_kind(name, table, path)
    tables = document.get("modules", [])
    if not tables:
        raise InputError(f"{path}: no [[modules]] table was found; list at least one module.")
    modules = tuple(_read_module(table, kinds, width, path) for table in tables)
    taken: dict[int, int] = {}
    for module in modules:
        for channel in module.channels:
            if int(channel) in taken:
                raise InputError(
                    f"{path}: channel {channel} belongs to modules {taken[int(channel)]} and {module.id}; "
                    "each channel has one place: correct first_channel."
                )
            taken[int(channel)] = module.id
    return Layout(modules, width)


def read_toml(path: Path) -> dict[str, Any]:
    """Return a TOML file's content; `InputError` says what is wrong with it and where."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; check the path.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a TOML file ({error}); correct that line.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path and its rights.") from None


def _numbers(value: object, shape: tuple[int, ...] | None, what: str) -> FloatArray:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what} is {value!r}; numbers were expected.") from None
    if shape is not None and array.shape != shape:
        raise InputError(f"{what} has shape {array.shape}; {shape} was expected.")
    return array


def _read_kind(name: str, table: dict[str, Any], path: Path) -> ModuleKind:
    where = f"{path}: [kinds.{name}]"
    for key in ("pads_mm", "outline_mm", "centre_pad"):
        if key not in table:
            raise InputError(f"{where} has no {key}; expected pads_mm, outline_mm and centre_pad.")
    pads = _numbers(table["pads_mm"], None, f"{where} pads_mm")
    outline = _numbers(table["outline_mm"], None, f"{where} outline_mm")
    if pads.ndim != 2 or pads.shape[1] != 2 or outline.ndim != 2 or outline.shape[1] != 2:
        raise InputError(f"{where}: pads_mm and outline_mm are lists of [x, y] in millimetres.")
    return ModuleKind(name, pads * 1e-3, outline * 1e-3, int(table["centre_pad"]))


_MODULE_KEYS = {"id", "kind", "first_channel", "place_mm", "angle_deg", "mirror", "anchor"}


def _read_module(table: dict[str, Any], kinds: dict[str, ModuleKind], width: int, path: Path) -> Module:
    where = f"{path}: module {table.get('id', '?')}"
    unknown = set(table) - _MODULE_KEYS
    if unknown:
        raise InputError(f"{where} has an unknown name {sorted(unknown)[0]!r}; known are {sorted(_MODULE_KEYS)}.")
    for key in ("id", "kind", "first_channel"):
        if key not in table:
            raise InputError(f"{where} has no {key}.")
    if table["kind"] not in kinds:
        raise InputError(f"{where} has kind {table['kind']!r}; known are {sorted(kinds)}, or describe it in [kinds].")
    kind = kinds[table["kind"]]
    first = int(table["first_channel"])
    if first < 0 or first + len(kind.pads) > width:
        raise InputError(f"{where} takes channels {first} to {first + len(kind.pads) - 1}; a skin frame has {width}.")
    return Module(
        id=int(table["id"]),
        kind=kind,
        first_channel=first,
        place=_numbers(table.get("place_mm", [0, 0]), (2,), f"{where} place_mm") * 1e-3,
        angle=float(np.radians(float(table.get("angle_deg", 0.0)))),
        mirror=bool(table.get("mirror", False)),
        anchor=read_anchor(table["anchor"], where) if "anchor" in table else None,
    )


def read_anchor(table: dict[str, Any], where: str) -> Anchor:
    """Read an anchor table: `at_mm` in the layout's plane, `point_mm`, `x` and `normal` in the link frame.

    Raises
    ------
    InputError
        A key is missing, is not numbers, or `x` and `normal` are not perpendicular to within a degree.
    """
    for key in ("at_mm", "point_mm", "x", "normal"):
        if key not in table:
            raise InputError(f"{where}: the anchor has no {key}; expected at_mm, point_mm, x and normal.")
    x = _numbers(table["x"], (3,), f"{where} anchor x")
    normal = _numbers(table["normal"], (3,), f"{where} anchor normal")
    x, normal = x / np.linalg.norm(x), normal / np.linalg.norm(normal)
    if not abs(float(x @ normal)) < np.sin(np.radians(1.0)):
        raise InputError(f"{where}: the anchor's x and normal must be perpendicular.")
    return Anchor(
        at=_numbers(table["at_mm"], (2,), f"{where} anchor at_mm") * 1e-3,
        point=_numbers(table["point_mm"], (3,), f"{where} anchor point_mm") * 1e-3,
        x=x,
        normal=normal,
    )
