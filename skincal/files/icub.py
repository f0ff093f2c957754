"""The iCub's taxel position files, `skinGui/positions/*.txt`, in and out.

The grammar, as its readers take it (robotology/icub-main `skinPart.cpp` and `compensator.cpp`, robotology/yarp
`Property.cpp`, robotology/icub-models-generator `generate_taxels_3d_positions.py`):

    name               r_forearm
    frame              r_forearm_dh_frame
    spatial_sampling   taxel
    taxel2Repr         (3 3 3 ... -1 ...)
    [calibration]
    x y z nx ny nz

One row a channel from 0, metres and a unit normal, spaces or tabs. `taxel2Repr` has one integer a channel: the centre
taxel of its module, -1 where there is no taxel, -2 for a thermal pad. Six zeros are "no position here" to every
reader. `frame` is the key of the CAD generator; the robot's readers pass over it.

A line that begins with `#` or `//` is a comment everywhere, also among the rows: YARP empties it and adds no row. YARP
joins lines until parentheses and quotes are balanced before it looks for comments, so a comment must not hold one
half of a pair. Ours stand after the last row: some programs skip a fixed number of lines at the top instead of looking for
`[calibration]`.

Two traps of `skinPart`: it drops the last row, and it fails where the file's name is given without a slash.

Positions and normals have `DECIMALS` decimals: a micrometre, a thousandth of the best taxel's uncertainty.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skincal.files.calibration import Calibration, placed_taxels
from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError, list_channels
from skincal.model.skin import Layout
from skincal.sentences import correction_words
from skincal.taxels.result import Estimate, Method, State

DECIMALS = 6
NO_TAXEL = -1
THERMAL_PAD = -2
UNIT_TOLERANCE = 1e-3
"""Normals of files with four decimals are unit to within it."""
ORIGIN_RADIUS = 0.5 * 10.0**-DECIMALS
"""m. A position nearer to the origin is written as zeros, which readers take as no taxel."""
SKIN_PARTS = (
    "l_hand", "l_forearm", "l_upper_arm", "r_hand", "r_forearm", "r_upper_arm", "chest",
    "l_upper_leg", "l_lower_leg", "l_foot", "r_upper_leg", "r_lower_leg", "r_foot",
)  # fmt: skip
"""Names that the robot's programs know (`SkinPart_s`, skinDynLib)."""


@dataclass(frozen=True, slots=True, eq=False)
class IcubFile:
    """What a position file says."""

    name: str
    """Skin part; empty where the file has none."""
    frame: str
    """Frame of the positions; empty where the file does not say, as most do not."""
    spatial_sampling: str
    taxel2repr: IntArray
    """(n,) as in the file; may have another length than `positions`; empty where the file has none."""
    positions: FloatArray
    """(n, 3) float, metres; zeros: no position."""
    normals: FloatArray
    """(n, 3) float, unit; zeros: not known."""
    findings: tuple[str, ...]
    """Sentences on what the file has that it should not."""


def skin_part(calibration: Calibration, part: str | None = None) -> str:
    """Return the name for a position file.

    It is `part` where given; else the skin part of the robot with which the scene's link name begins
    (`r_forearm_dh_frame` is on `r_forearm`); else the scene's name.
    """
    link = calibration.scene.link
    known = [name for name in SKIN_PARTS if link == name or link.startswith(f"{name}_")]
    chosen = part or (max(known, key=len) if known else calibration.scene.name)
    return _word(chosen)


def _word(text: str) -> str:
    """Return text as one word that YARP reads as such."""
    return re.sub(r"[\s()\[\]{}\"'#,$\\/]+", "_", text.strip()) or "unnamed"


def representatives(layout: Layout | None, width: int, placed: IntArray) -> IntArray:
    """Return `taxel2Repr`, (width,): centre taxel, `NO_TAXEL` or `THERMAL_PAD` for each channel.

    Without a layout each taxel with a position represents itself, as the robot's reader does for files without the key.
    """
    mapping = np.full(width, NO_TAXEL, dtype=np.int64)
    if layout is None:
        mapping[placed] = placed
        return mapping
    # All pads first: what is a thermal pad of one module may be a taxel's channel of another.
    for module in layout.modules:
        last = module.first_channel + len(module.kind.pads)
        mapping[module.first_channel : last] = THERMAL_PAD
    for module in layout.modules:
        mapping[module.channels] = module.centre_channel
    return mapping


def icub_text(calibration: Calibration, method: Method, part: str | None = None, frame: bool = True) -> str:
    """Return the position file of one method, a row for every channel of the skin.

    Parameters
    ----------
    part : see `skin_part`
    frame : write the `frame` key with the scene's link
    """
    width = calibration.scene.skin.channels
    estimates = calibration.of(method)
    taxels = placed_taxels(estimates)
    rows = np.zeros((width, 6))
    rows[taxels.channels] = np.hstack([taxels.positions, taxels.normals])
    mapping = representatives(calibration.scene.skin.layout, width, taxels.channels)
    lines = [f"name               {skin_part(calibration, part)}"]
    if frame:
        lines.append(f"frame              {_word(calibration.scene.link)}")
    lines += [
        "spatial_sampling   taxel",
        f"taxel2Repr         ({' '.join(map(str, mapping.tolist()))})",
        "[calibration]",
        *(_format_row(row) for row in rows.tolist()),
        *(f"# {line}" for line in _comments(calibration, method, estimates)),
    ]
    return "\n".join(lines) + "\n"


def _format_row(row: list[float]) -> str:
    # Rounded first: adding 0.0 turns the -0 that rounding may leave into 0.
    return " ".join(f"{round(value, DECIMALS) + 0.0:.{DECIMALS}f}" for value in row)


def _comments(calibration: Calibration, method: Method, estimates: tuple[Estimate, ...]) -> list[str]:
    placed = sum(estimate.position is not None for estimate in estimates)
    lines = [
        f"skincal {calibration.version}, {method.value} method, metres in {_word(calibration.scene.link)}",
        f"{placed} of {len(estimates)} taxels have a position; rows of six zeros are no positions",
        *(correction_words(used) for used in calibration.corrections),
    ]
    for state in State:
        channels = [estimate.channel for estimate in estimates if estimate.state is state and estimate.position is None]
        if channels:
            lines.append(f"{state.value}: {list_channels(channels, most=len(channels))}")
    return lines


def read_icub(path: Path) -> IcubFile:
    """Read a position file in the current grammar or the old one (bare rows of six numbers).

    Normals that are not unit are made so, and said.

    Raises
    ------
    InputError
        The file cannot be read, has no rows, or a row is not six finite numbers; names the line.
    """
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path.") from None
    return parse_icub(text, str(path))


def parse_icub(text: str, where: str) -> IcubFile:
    """Read the text of a position file; `where` names it in sentences. See `read_icub`."""
    lines = _content_lines(text)
    start = next((i for i, (_, line) in enumerate(lines) if line.startswith("[calibration]")), None)
    keys: dict[str, str] = {}
    for number, line in lines[:start] if start is not None else []:
        key, _, value = line.partition(" ")
        if key in keys:
            raise InputError(f"{where}: line {number}: {key} appears twice; expected each key once.")
        keys[key] = value.strip()
    rows = _read_rows(lines if start is None else lines[start + 1 :], where)
    findings = [] if start is not None else ["no [calibration] group: read as the old format, bare rows of six numbers."]
    mapping = _read_mapping(keys.get("taxel2Repr"), where)
    normals, sentences = _unit_normals(rows)
    findings += sentences
    if start is not None:
        findings += _mapping_findings(mapping, rows)
    findings += _duplicate_findings(rows[:, :3])
    return IcubFile(
        name=keys.get("name", ""),
        frame=keys.get("frame", ""),
        spatial_sampling=keys.get("spatial_sampling", "taxel"),
        taxel2repr=mapping,
        positions=rows[:, :3],
        normals=normals,
        findings=tuple(findings),
    )


def _content_lines(text: str) -> list[tuple[int, str]]:
    """Return (line number, text) without comments and empty lines, with single spaces, lists joined over line ends."""
    out: list[tuple[int, str]] = []
    pending = ""
    first = 0
    for number, raw in enumerate(text.splitlines(), start=1):
        line = re.sub(r"//.*|(^|\s)#.*", "", raw)
        line = " ".join(f"{pending} {line}".split())
        # A list over several lines is named by the first of them.
        first = first if pending else number
        if line.count("(") > line.count(")"):
            pending = line
            continue
        pending = ""
        if line:
            out.append((first, line))
    return [*out, (first, pending)] if pending else out


def _read_rows(lines: list[tuple[int, str]], where: str) -> FloatArray:
    rows: list[list[float]] = []
    for number, line in lines:
        if line.startswith("["):
            break
        try:
            row = [float(word) for word in line.strip("()").split()]
        except ValueError:
            row = []
        if len(row) != 6 or not np.isfinite(row).all():
            raise InputError(f"{where}: line {number} is {line[:60]!r}; expected six finite numbers, x y z nx ny nz.")
        rows.append(row)
    if not rows:
        raise InputError(f"{where}: no rows were found; expected an iCub position file with one row x y z nx ny nz a channel.")
    return np.array(rows)


def _read_mapping(text: str | None, where: str) -> IntArray:
    if text is None:
        return np.empty(0, dtype=np.int64)
    try:
        return np.array([int(word) for word in text.strip("() ").split()], dtype=np.int64)
    except ValueError:
        raise InputError(f"{where}: taxel2Repr holds something else than whole numbers; expected ( 3 3 ... -1 ).") from None


def _unit_normals(rows: FloatArray) -> tuple[FloatArray, list[str]]:
    # Published files have normals of length 0.6 to 1.
    lengths = np.linalg.norm(rows[:, 3:], axis=1)
    known = lengths > 0
    off = known & (np.abs(lengths - 1.0) > UNIT_TOLERANCE)
    findings: list[str] = []
    if off.any():
        findings.append(
            f"normals not of unit length: {off.sum()}, from {lengths[off].min():.3f} to {lengths[off].max():.3f}; made unit."
        )
    without = np.flatnonzero(~known & rows[:, :3].any(axis=1))
    if len(without):
        findings.append(f"positions without a normal: {len(without)}.")
    normals = np.zeros((len(rows), 3))
    normals[known] = rows[known, 3:] / lengths[known, None]
    return normals, findings


def _mapping_findings(mapping: IntArray, rows: FloatArray) -> list[str]:
    if not len(mapping):
        return ["taxel2Repr is missing: the robot's skinPart reader refuses such a file."]
    findings: list[str] = []
    if len(mapping) != len(rows):
        findings.append(f"taxel2Repr has {len(mapping)} entries for {len(rows)} rows; expected one a row.")
    shared = min(len(mapping), len(rows))
    placed = rows[:shared, :3].any(axis=1)
    taxel = mapping[:shared] >= 0
    if (placed & ~taxel).any():
        findings.append(
            f"a position where taxel2Repr says no taxel: channels {list_channels(np.flatnonzero(placed & ~taxel))}."
        )
    if (taxel & ~placed).any():
        findings.append(f"no position where taxel2Repr says taxel: channels {list_channels(np.flatnonzero(taxel & ~placed))}.")
    return findings


def _duplicate_findings(positions: FloatArray) -> list[str]:
    placed = positions[positions.any(axis=1)]
    distinct = len(np.unique(placed, axis=0))
    if distinct == len(placed):
        return []
    return [
        f"{len(placed)} channels share {distinct} different positions; copies of another taxel's position are no measurement."
    ]
