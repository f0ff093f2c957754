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

Positions and normals have `POSITION_DECIMAL_PLACES` decimals: a micrometre, a thousandth of the best taxel's uncertainty.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from skincal.files.calibration import Calibration, placed_taxels
from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError
from skincal.model.given import MAX_TEXT_BYTES, read_regular
from skincal.model.scene import Scene
from skincal.model.skin import Layout
from skincal.taxels.result import Estimate, Method
from skincal.words.taxel_words import state_lines

POSITION_DECIMAL_PLACES = 6
NO_TAXEL = -1
THERMAL_PAD = -2
ORIGIN_RADIUS = 0.5 * 10.0**-POSITION_DECIMAL_PLACES
"""m. A position nearer to the origin is written as zeros, which readers take as no taxel."""
SKIN_PARTS = (
    "l_hand", "l_forearm", "l_upper_arm", "r_hand", "r_forearm", "r_upper_arm", "chest",
    "l_upper_leg", "l_lower_leg", "l_foot", "r_upper_leg", "r_lower_leg", "r_foot",
)  # fmt: skip
"""Names that the robot's programs know (`SkinPart_s`, skinDynLib)."""


def skin_part(calibration: Calibration, part: str | None = None) -> str:
    """Return the name for a position file.

    It is `part` where given; else the skin part of the robot with which the scene's link name begins
    (`r_forearm_dh_frame` is on `r_forearm`); else the scene's name.
    """
    return _word(part or robot_skin_part(calibration.scene) or calibration.scene.name)


def robot_skin_part(scene: Scene) -> str:
    """Find the skin part of the robot with which the scene's link name begins; empty for other parts."""
    known = [name for name in SKIN_PARTS if scene.link == name or scene.link.startswith(f"{name}_")]
    return max(known, key=len, default="")


def _word(text: str) -> str:
    """Return text as one word that YARP reads as such."""
    return re.sub(r"[\s\x00-\x1f\x7f-\x9f()\[\]{}\"'#,$\\/]+", "_", text.strip()) or "unnamed"


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


def icub_text(calibration: Calibration, method: Method) -> str:
    """Format the position file of one method, with a row for every channel of the skin."""
    width = calibration.scene.skin.channels
    estimates = calibration.estimates_by(method)
    taxels = placed_taxels(estimates)
    rows = np.zeros((width, 6))
    rows[taxels.channels] = np.hstack([taxels.positions, taxels.normals])
    mapping = representatives(calibration.scene.skin.layout, width, taxels.channels)
    comments = _comments(calibration, method, estimates)
    return _text(skin_part(calibration, calibration.options.part), _word(calibration.scene.link), mapping, rows, comments)


def positions_text(part: str, rows: FloatArray, comment: str) -> str:
    """Format rows (n, 6), metres and normals, as a position file that names only the part."""
    mapping = representatives(None, len(rows), np.flatnonzero(rows[:, :3].any(axis=1)))
    return _text(part, "", mapping, rows, [comment])


def _text(part: str, frame: str, mapping: IntArray, rows: FloatArray, comments: list[str]) -> str:
    lines = [
        f"name               {part}",
        *([f"frame              {frame}"] if frame else []),
        "spatial_sampling   taxel",
        f"taxel2Repr         ({' '.join(map(str, mapping.tolist()))})",
        "[calibration]",
        *(_format_row(row) for row in rows.tolist()),
        *(f"# {line}" for line in comments),
    ]
    return "\n".join(lines) + "\n"


def part_name(path: Path) -> str:
    """Return the skin part that a position file is of; empty where it names none."""
    found = re.search(r"^name\s+(\S+)", read_regular(path, MAX_TEXT_BYTES).decode("utf-8", "replace"), re.MULTILINE)
    return "" if found is None else found[1]


def has_comment(path: Path, comment: str) -> bool:
    """Return whether a position file has a comment, as `positions_text` writes it."""
    return f"# {comment}" in read_regular(path, MAX_TEXT_BYTES).decode("utf-8", "replace").splitlines()


def _format_row(row: list[float]) -> str:
    # Rounded first: adding 0.0 turns the -0 that rounding may leave into 0.
    return " ".join(f"{round(value, POSITION_DECIMAL_PLACES) + 0.0:.{POSITION_DECIMAL_PLACES}f}" for value in row)


def _comments(calibration: Calibration, method: Method, estimates: tuple[Estimate, ...]) -> list[str]:
    placed = sum(estimate.position is not None for estimate in estimates)
    lines = [
        f"skincal {calibration.version}, {method.value} method, metres in {_word(calibration.scene.link)}",
        f"{placed} of {len(estimates)} taxels have a position; rows of six zeros are no positions",
        *calibration.correction_comments(),
        *calibration.verdict_comments(method),
    ]
    return [*lines, *state_lines(estimates)]


def read_icub(path: Path) -> FloatArray:
    """Read a position file in the current grammar or the old one (bare rows); returns (n, 6) float, metres and normals.

    Raises InputError: the file cannot be read, has no rows, or a row is not six finite numbers; names the line.
    """
    return parse_icub(read_regular(path, MAX_TEXT_BYTES).decode("utf-8", "replace"), str(path))


def parse_icub(text: str, where: str) -> FloatArray:
    """Read the text of a position file; `where` names it in sentences. See `read_icub`."""
    lines = [re.sub(r"//.*|(^|\s)#.*", "", raw).strip() for raw in text.splitlines()]
    start = next((i for i, line in enumerate(lines) if line.startswith("[calibration]")), -1)
    rows: list[list[float]] = []
    for number, line in enumerate(lines[start + 1 :], start=start + 2):
        if line.startswith("["):
            break
        if not line:
            continue
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
