"""Layouts from other sources, as the text of a layout file: an iCub `.ini`, a table of positions, a grid, a repeated module.

Each function returns text that `skincal.model.skin.read_layout` accepts. Lengths are millimetres, angles degrees.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.skin import MODULE_KINDS, Layout, SkinKind, read_layout
from skincal.model.tables import parse_toml, read_text

CHANNELS_PER_TRIANGLE = 12
GRID_ROWS_OR_COLUMNS_MAX = 300
MAX_MODULES = 2000
MAX_TAXELS = 20_000
MAX_LAYOUT_CHANNELS = 100_000
LAYOUT_ENDINGS = ("*.toml", "*.ini", "*.csv", "*.tsv", "*.txt")
_INI_KINDS = {"triangle": "triangle_12", **{name: name for name in MODULE_KINDS}}
"""Kinds of modules in skinGui files, by their name there."""
_KIND_LINE = re.compile(r"\s*[\"']?kind[\"']?\s*=")
"""First such line of a layout: keys of the file come before its tables, which have kinds of their own."""
_FIELD_SEPARATORS = re.compile(r"[,;\t ]+")
_INI_COMMENT_RE = re.compile(r"//.*|(?<!\S)#.*")
"""Comment of a YARP file: `//` anywhere, `#` at the begin of a word."""
INI_FIELDS_MIN, INI_FIELDS = 5, 7
"""Fields of a line that are needed, and all of them; YARP takes a missing one (gain, mirror) as 0."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Taxels in rows and columns, as one module: a soft sheet, unless it is known to be a board."""

    rows: int
    columns: int
    pitch_mm: float
    kind: SkinKind = SkinKind.SHEET

    def layout_text(self) -> str:
        """Write the grid as a layout file; its origin is the middle, channels run along x."""
        x, y = ((np.arange(count) - (count - 1) / 2.0) * self.pitch_mm for count in (self.columns, self.rows))
        pads = [[float(a), float(b)] for b in y for a in x]
        half = [(count / 2.0) * self.pitch_mm for count in (self.columns, self.rows)]
        outline = [[sx * half[0], sy * half[1]] for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        middle = (self.rows // 2) * self.columns + self.columns // 2
        return (
            f"# {self.rows} x {self.columns} taxels, {self.pitch_mm:g} mm apart; channel = {self.columns} x row + column\n"
            f"{kind_line(self.kind)}"
            f"[kinds.grid]\npads_mm = {pads}\noutline_mm = {outline}\ncentre_pad = {middle}\n\n"
            '[[modules]]\nid = 1\nkind = "grid"\nfirst_channel = 0\nplace_mm = [0.0, 0.0]\n'
        )


def parse_grid(text: str) -> Grid:
    """Parse a grid such as `6x8@9mm`: rows, columns, pitch.

    Raises InputError: it is written in another way.
    """
    size, _, pitch = text.replace(" ", "").partition("@")
    try:
        rows, columns = (int(word) for word in size.split("x"))
        spacing = float(pitch.removesuffix("mm"))
    except ValueError:
        rows, columns, spacing = 0, 0, 0.0
    if not (1 <= rows <= GRID_ROWS_OR_COLUMNS_MAX and 1 <= columns <= GRID_ROWS_OR_COLUMNS_MAX and 0.1 <= spacing <= 1000.0):
        raise InputError(f"{text}: is no grid; expected ROWSxCOLUMNS@PITCHmm, such as 6x8@9mm.")
    return Grid(rows, columns, spacing)


def read_layout_file(path: Path) -> str:
    """Read a layout from a file of any supported kind, by its ending.

    Raises InputError: the file cannot be read, or is no layout.
    """
    kind = path.suffix.lower()
    if kind == ".toml":
        text = read_text(path).replace("\r\n", "\n")
    elif kind == ".ini":
        text = text_of_ini(read_text(path), path)
    elif kind in (".csv", ".tsv", ".txt"):
        text = text_of_table(read_text(path), path)
    else:
        raise InputError(f"{path}: is no layout; expected a file {', '.join(LAYOUT_ENDINGS)}.")
    parse_layout(text, path)
    return text


def parse_layout(text: str, path: Path) -> Layout:
    """Read a layout's text; its width is that of its highest channel."""
    layout = read_layout(text, path, MAX_LAYOUT_CHANNELS)
    return Layout(layout.modules, int(layout.channels.max()) + 1, path, text, layout.given_kind)


def kind_line(kind: SkinKind) -> str:
    """Write the line of a layout file that says what the skin is."""
    comments = {
        SkinKind.SHEET: 'a soft sheet, which may stretch and fold; "board": rigid boards',
        SkinKind.BOARD: 'rigid boards; "sheet": a soft sheet, which may stretch and fold',
    }
    return f'kind = "{kind.value}"  # {comments[kind]}\n'


def text_with_kind(text: str, kind: SkinKind) -> str:
    """Write another kind of skin into a layout's text; all else stays.

    Raises InputError: the text is no TOML.
    """
    before = parse_toml(text, Path("layout")).get("kind")
    if before == kind.value:
        return text
    lines = text.splitlines(keepends=True)
    if before is not None:
        at = next(number for number, line in enumerate(lines) if _KIND_LINE.match(line))
        lines[at] = kind_line(kind)
    else:
        # Above the first table, and below the comment at the top.
        at = next((number for number, line in enumerate(lines) if not line.startswith("#")), len(lines))
        lines.insert(at, kind_line(kind))
    return "".join(lines)


def text_of_ini(text: str, path: Path) -> str:
    """Convert a layout of iCub's skinGui (`icub-main/app/skinGui/conf/skinGui/*.ini`).

    A line is: kind, number, x, y, orientation, gain, mirror. A missing gain or mirror is 0. The channels of module k begin
    at 12 k.

    Raises InputError: it has no modules, a line is not readable, or a kind is unknown.
    """
    modules: list[str] = []
    seen: set[int] = set()
    for number, line in enumerate(text.splitlines(), start=1):
        words = _INI_COMMENT_RE.sub("", line).split()
        if not words or words[0].startswith("[") or words[0] not in _INI_KINDS:
            if len(words) > INI_FIELDS_MIN and _are_numbers(words[1 : INI_FIELDS_MIN + 1]):
                raise InputError(f"{path}: line {number} has a module {words[0]!r}; expected {', '.join(_INI_KINDS)}.")
            continue
        fields = [*words[1:INI_FIELDS], *["0"] * (INI_FIELDS - len(words))]
        if len(words) < INI_FIELDS_MIN or not _are_numbers(fields):
            raise InputError(
                f"{path}: line {number} is {line.strip()!r}; expected kind, number, x, y, angle, gain, mirror "
                "(the last two may be missing)."
            )
        module, x, y, angle, _, mirror = map(float, fields)
        if int(module) in seen:
            raise InputError(f"{path}: line {number} repeats module {int(module)}; each module has one place: correct it.")
        seen.add(int(module))
        modules.append(_module(int(module), _INI_KINDS[words[0]], (x, y), angle, mirror=bool(mirror)))
    if not modules:
        raise InputError(f"{path}: lists no module; expected lines such as `triangle_10pad 3 192.38 -20.00 -150.00 5 1`.")
    title = f"# From {path.name}, a layout of skinGui; the channels of module k begin at {CHANNELS_PER_TRIANGLE} k.\n"
    return title + kind_line(SkinKind.BOARD) + "".join(modules)


def text_of_table(text: str, path: Path) -> str:
    """Convert a table of positions: rows `channel, x, y` or `x, y`, millimetres, or metres if the heading says `x_m`.

    Raises InputError: a row is not readable, or a channel is there twice.
    """
    rows: list[list[float]] = []
    scale = 1.0
    for number, line in enumerate(text.splitlines(), start=1):
        words = [word for word in _FIELD_SEPARATORS.split(line.strip()) if word]
        if not words or words[0].startswith("#"):
            continue
        if not _are_numbers(words):
            if rows:
                raise InputError(f"{path}: line {number} is {line.strip()!r}; expected numbers: channel, x, y or x, y.")
            scale = 1e3 if {"x_m", "x[m]"} & {word.lower() for word in words} else 1.0
            continue
        if len(words) not in (2, 3) or (rows and len(words) != len(rows[0])):
            raise InputError(f"{path}: line {number} has {len(words)} numbers; expected channel, x, y or x, y in each row.")
        rows.append([float(word) for word in words])
    if not 1 <= len(rows) <= MAX_TAXELS:
        raise InputError(f"{path}: has {len(rows)} positions; expected 1 to {MAX_TAXELS} rows: channel, x, y in mm.")
    table: FloatArray = np.array(rows)
    channels: FloatArray = np.arange(float(len(rows))) if table.shape[1] == 2 else table[:, 0]
    _require_channels(channels, path)
    pads = np.full((int(channels.max()) + 1, 2), np.nan)
    pads[channels.astype(int)] = table[:, -2:] * scale
    title = f"# From {path.name}: {len(rows)} positions as one module.\n"
    return title + kind_line(SkinKind.SHEET) + one_module(pads, _box(pads), int(channels[0]))


def _require_channels(channels: FloatArray, path: Path) -> None:
    if (channels < 0).any() or (channels >= MAX_LAYOUT_CHANNELS).any() or (channels != np.rint(channels)).any():
        raise InputError(f"{path}: a channel is no whole number from 0 to {MAX_LAYOUT_CHANNELS - 1}; correct the first column.")
    if len(np.unique(channels)) < len(channels):
        raise InputError(f"{path}: a channel is there twice; expected one row for each channel.")


def one_module(pads_mm: FloatArray, outline_mm: FloatArray, centre: int, name: str = "patch") -> str:
    """Write a layout of one module of its own kind; pad i is channel i, (k, 2) mm, NaN without a taxel."""
    rows = ", ".join("[nan, nan]" if np.isnan(x) else f"[{x:.6g}, {y:.6g}]" for x, y in pads_mm.tolist())
    outline = ", ".join(f"[{x:.6g}, {y:.6g}]" for x, y in outline_mm.tolist())
    return (
        f"[kinds.{name}]\npads_mm = [{rows}]\noutline_mm = [{outline}]\ncentre_pad = {centre}\n"
        f'\n[[modules]]\nid = 1\nkind = "{name}"\nfirst_channel = 0\nplace_mm = [0, 0]\n'
    )


def _box(pads_mm: FloatArray) -> FloatArray:
    """Make the corners of a rectangle around positions, (4, 2) mm, half a spacing outside."""
    known = pads_mm[~np.isnan(pads_mm[:, 0])]
    low, high = known.min(axis=0), known.max(axis=0)
    margin = max(1.0, float(np.sqrt(float((high - low).prod()) / len(known))) / 2.0)
    (x0, y0), (x1, y1) = low - margin, high + margin
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def repeated_modules(kind: str, rows: int, columns: int) -> str:
    """Write a layout of one kind of module, edge to edge; modules and channels count along the rows.

    Raises InputError: there are no modules or too many, or the kind is unknown.
    """
    if kind not in MODULE_KINDS:
        raise InputError(f"a module {kind!r} does not ship; expected one of {', '.join(MODULE_KINDS)}.")
    if not (rows >= 1 and columns >= 1 and rows * columns <= MAX_MODULES):
        raise InputError(f"{rows} x {columns} modules: expected 1 to {MAX_MODULES} in all.")
    outline = MODULE_KINDS[kind].outline * 1e3
    side = float(np.linalg.norm(outline[1] - outline[0]))
    height = side * math.sqrt(3.0) / 2.0
    modules: list[str] = []
    for row in range(rows):
        for column in range(columns):
            # In a strip of triangles each second one stands on its head.
            is_up = (row + column) % 2 == 0
            x, y = column * side / 2.0, row * height + (height / 3.0 if is_up else 2.0 * height / 3.0)
            modules.append(_module(len(modules), kind, (round(x, 3), round(y, 3)), 0.0 if is_up else 180.0))
    return f"# {rows} x {columns} modules {kind}, edge to edge.\n{kind_line(SkinKind.BOARD)}" + "".join(modules)


def _module(number: int, kind: str, place: Sequence[float], angle: float, *, mirror: bool = False) -> str:
    first = number * CHANNELS_PER_TRIANGLE
    lines = [f'\n[[modules]]\nid = {number}\nkind = "{kind}"\nfirst_channel = {first}\n']
    lines.append(f"place_mm = [{place[0]:g}, {place[1]:g}]\nangle_deg = {angle:g}\nmirror = {str(mirror).lower()}\n")
    return "".join(lines)


def _are_numbers(words: Iterable[str]) -> bool:
    try:
        return all(math.isfinite(float(word)) for word in words)
    except ValueError:
        return False
