"""A layout of PaXini modules from the points in the user's own package paxini-sdk.

The package (0.1.0, MIT) has the folder `paxini_sdk/data`: `registry.json` lists the modules with their part code, model, number
of points and file, and each file has the points in millimetres in the frame of the module, in the order of the stream: y from
the connector to the tip, z outward. skincal has none of these numbers. They are read from the installed package, its unpacked
folder, or its wheel.

A fingertip is a dome, and a layout is flat. So they are flattened: the distances of neighbours are kept,
those of others are ways over the neighbours (stress majorization: de Leeuw 1977; weights D^-4). The result is oriented as the
points are, seen from outside, with x and y of the module. It is the plan of a soft sheet, which may stretch: a dome does not
unroll. Distances of neighbours then change by 10 to 20 % on the fingertips, and by 5 % on the pads.
"""

from __future__ import annotations

import importlib.util
import json
import re
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from skincal.files.layout_sources import kind_line
from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.given import MAX_JSON_BYTES, read_regular
from skincal.model.skin import SkinKind

PACKAGE_NAME = "paxini_sdk"
REGISTRY_FILE = "registry.json"
PART_CODE_RE = re.compile(r"[\w-]+")
POINTS_MAX = 1000
"""Of a module; the largest of GEN3 has 239."""
POINT_MAX_M, POINT_DECIMALS = 0.2, 5
"""m: a module is smaller. Points that agree to this decimal of a metre are one."""
NEIGHBOUR_MAX_SPACINGS = 2.2
"""Distances up to this many spacings are kept."""
NEIGHBOURS_OF_WAY = 8
DISTANCE_WEIGHT_POWER = -4.0
FLATTENING_STEPS = 150
MARGIN_MM = 1.5
"""mm, of the outline around the points."""
MODULE_GAP_MM = 5.0
"""mm, between the modules of one layout."""
HOW_TO_GET = "install it (pip install paxini-sdk), or name its unpacked folder or its wheel (--paxini-sdk)"


@dataclass(frozen=True, slots=True, eq=False)
class PaxiniModule:
    """A module with its points."""

    code: str
    """Part code of the maker."""
    model: str
    points: FloatArray
    """(n, 3) float, metres, frame of the module; row i is taxel i of its stream."""


def read_modules(names: Sequence[str], package: Path | None = None) -> list[PaxiniModule]:
    """Read modules by part code, model, or number of points.

    Parameters
    ----------
    package : folder or wheel of the package; `None` for the installed one

    Raises
    ------
    InputError
        The package is not there or has another form, or it does not know a module.
    """
    read, where = _reader(package)
    registry = _parse(read, REGISTRY_FILE, where)
    try:
        known = [
            (str(each["vendor_part_code"]), str(each["sensor_model"]), int(each["n_points"]), str(each["json_file"]))
            for each in registry["sensors"]
        ]
        # It names files and objects.
        if not all(PART_CODE_RE.fullmatch(code) for code, *_ in known):
            raise ValueError
    except (KeyError, TypeError, ValueError):
        raise InputError(
            f"{where}: {REGISTRY_FILE} has another form than that of paxini-sdk 0.1.0; expected its data."
        ) from None
    return [_read_module(name, known, read, where) for name in names]


def _read_module(
    name: str, known: Sequence[tuple[str, str, int, str]], read: Callable[[str], bytes], where: str
) -> PaxiniModule:
    wanted = name.strip().upper()
    found = [each for each in known if wanted in (each[0].upper(), each[1].upper(), str(each[2]))]
    if len(found) != 1:
        every = ", ".join(f"{code} ({count} taxels)" for code, _, count, _ in known)
        which = "no module" if not found else f"{len(found)} modules"
        raise InputError(f"{where}: {which} {name!r}; expected a part code, a model or a number of taxels of: {every}.")
    ((code, model, count, file),) = found
    rows = _parse(read, file, where)
    try:
        points = np.array([[row["x_mm"], row["y_mm"], row["z_mm"]] for row in rows["points"]], dtype=float) * 1e-3
        numbers = [int(row["index"]) for row in rows["points"]]
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{where}: {file} has another form than that of paxini-sdk 0.1.0; expected points in mm.") from None
    is_ordered = numbers == list(range(numbers[0], numbers[0] + len(numbers))) if numbers else False
    if points.shape != (count, 3) or not is_ordered or count > POINTS_MAX:
        raise InputError(
            f"{where}: {file} has {len(points)} points; expected {count}, numbered in a row, as {REGISTRY_FILE} says."
        )
    if not (np.abs(points) < POINT_MAX_M).all() or len(np.unique(points.round(POINT_DECIMALS), axis=0)) < count:
        raise InputError(
            f"{where}: {file} has points that are equal, no number, or over {POINT_MAX_M * 1e3:g} mm away; expected those of a "
            "module, in mm."
        )
    return PaxiniModule(code, model, points)


def _reader(package: Path | None) -> tuple[Callable[[str], bytes], str]:
    """Find the data of the package; give a function that reads one of its files, and its name for the operator."""
    if package is None:
        spec = importlib.util.find_spec(PACKAGE_NAME)
        if spec is None or spec.origin is None:
            raise InputError(f"the package paxini-sdk, which has the points of the modules, is not installed; {HOW_TO_GET}.")
        return _folder_reader(Path(spec.origin).parent / "data"), str(Path(spec.origin).parent)
    if package.is_file():
        return _wheel_reader(package), str(package)
    for folder in (package, package / "data", package / PACKAGE_NAME / "data", package / "src" / PACKAGE_NAME / "data"):
        if (folder / REGISTRY_FILE).is_file():
            return _folder_reader(folder), str(package)
    raise InputError(f"{package}: has no {PACKAGE_NAME}/data/{REGISTRY_FILE}; expected the package paxini-sdk; {HOW_TO_GET}.")


def _folder_reader(folder: Path) -> Callable[[str], bytes]:
    def read(name: str) -> bytes:
        return read_regular(folder / Path(name).name, MAX_JSON_BYTES)

    return read


def _wheel_reader(wheel: Path) -> Callable[[str], bytes]:
    def read(name: str) -> bytes:
        inside = f"{PACKAGE_NAME}/data/{Path(name).name}"
        try:
            with zipfile.ZipFile(wheel) as archive:
                if archive.getinfo(inside).file_size > MAX_JSON_BYTES:
                    raise InputError(f"{wheel}: {inside} is too large; expected the package paxini-sdk.")
                return archive.read(inside)
        except (zipfile.BadZipFile, zlib.error, KeyError, OSError, RuntimeError):  # encrypted or of another method
            raise InputError(f"{wheel}: has no {inside}; expected the wheel of paxini-sdk.") from None

    return read


def _parse(read: Callable[[str], bytes], name: str, where: str) -> Any:
    try:
        found: Any = json.loads(read(name))
    except ValueError:
        raise InputError(f"{where}: {name} is no JSON; expected the data of paxini-sdk.") from None
    if not isinstance(found, dict):
        raise InputError(f"{where}: {name} has another form than that of paxini-sdk 0.1.0.")
    return cast("Any", found)


def flatten_points(points: FloatArray) -> FloatArray:
    """Lay points on a dome (n, 3), metres, into a plane: (n, 2), metres, as seen from outside (+z), with the middle at 0."""
    count = len(points)
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    if count < 3 or np.ptp(points[:, 2]) < 1e-6:
        return flat
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    order = np.sort(apart, axis=1)
    spacing = float(np.median(order[:, 1]))
    ways = _ways(apart, order[:, min(NEIGHBOURS_OF_WAY, count - 1)])
    wanted = np.where(apart < NEIGHBOUR_MAX_SPACINGS * spacing, apart, ways)
    np.fill_diagonal(wanted, 1.0)
    weights = (wanted / spacing) ** DISTANCE_WEIGHT_POWER
    np.fill_diagonal(weights, 0.0)
    inverse = np.linalg.pinv(np.diag(weights.sum(axis=1)) - weights)
    placed = _classical_scaling(ways)
    for _ in range(FLATTENING_STEPS):
        now = np.linalg.norm(placed[:, None] - placed, axis=2)
        now[now == 0.0] = np.inf
        pull = -weights * wanted / now
        np.fill_diagonal(pull, 0.0)
        np.fill_diagonal(pull, -pull.sum(axis=1))
        placed = inverse @ (pull @ placed)
    placed = placed - placed.mean(axis=0)
    u, _, v = np.linalg.svd(placed.T @ flat)
    return np.asarray(placed @ (u @ v), dtype=np.float64)


def _ways(apart: FloatArray, reach: FloatArray) -> FloatArray:
    """Find the shortest ways (n, n) over neighbours within `reach` (n,) of a point (Floyd and Warshall)."""
    is_near = (apart <= reach[:, None]) | (apart <= reach)
    ways = np.where(is_near, apart, np.inf)
    for middle in range(len(apart)):
        ways = np.minimum(ways, ways[:, middle, None] + ways[middle])
    # Between islands there is no way.
    return np.where(np.isfinite(ways), ways, apart)


def _classical_scaling(ways: FloatArray) -> FloatArray:
    """Place points (n, 2) by their distances (n, n) (Torgerson 1952)."""
    centred = np.eye(len(ways)) - 1.0 / len(ways)
    values, vectors = np.linalg.eigh(-0.5 * centred @ (ways**2) @ centred)
    return np.asarray(vectors[:, -2:] * np.sqrt(np.maximum(values[-2:], 0.0)), dtype=np.float64)


def layout_text(modules: Sequence[PaxiniModule]) -> str:
    """Write a layout of the modules, next to each other; their channels follow in the order of the stream."""
    lines = [
        f"# Flattened points of the maker's modules, in the order of the stream: {', '.join(each.code for each in modules)}.\n"
    ]
    lines.append(kind_line(SkinKind.SHEET))
    kinds, places = list[str](), list[str]()
    first, x = 0, 0.0
    for number, module in enumerate(modules, start=1):
        pads = flatten_points(module.points) * 1e3
        low, high = pads.min(axis=0) - MARGIN_MM, pads.max(axis=0) + MARGIN_MM
        corners = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
        name = f"{module.code.lower().replace('-', '_')}_{number}"
        outline = ", ".join(f"[{a:.3f}, {b:.3f}]" for a, b in corners)
        rows = ", ".join(f"[{a:.3f}, {b:.3f}]" for a, b in pads.tolist())
        centre = int((pads**2).sum(axis=1).argmin())
        kinds.append(
            f"\n[kinds.{name}]  # {module.model}\npads_mm = [{rows}]\noutline_mm = [{outline}]\ncentre_pad = {centre}\n"
        )
        shift = x - float(low[0])
        places.append(
            f'\n[[modules]]\nid = {number}\nkind = "{name}"\nfirst_channel = {first}\nplace_mm = [{shift:.3f}, 0.0]\n'
        )
        first, x = first + len(pads), shift + float(high[0]) + MODULE_GAP_MM
    return "".join([*lines, *kinds, *places])


def positions_as_json(modules: Sequence[PaxiniModule]) -> str:
    """Write the points of one module for `skincal compare`: its frame has no link, since its mounting is unknown."""
    points = np.concatenate([module.points for module in modules])
    taxels = [{"channel": channel, "position_m": place} for channel, place in enumerate(np.round(points, 9).tolist())]
    return json.dumps({"taxels": taxels}, indent=1) + "\n"
