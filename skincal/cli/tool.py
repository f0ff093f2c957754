"""`tool`: where the tip of a tool is, and whether its poses are read rightly, from touches of one point."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.solve import Json
from skincal.model.errors import InputError, shortened
from skincal.model.given import MAX_TEXT_BYTES, read_regular
from skincal.model.length_units import METRES_PER_UNIT, LengthUnit
from skincal.model.pose_form import PoseForm, RotationForm

if TYPE_CHECKING:
    from skincal.geometry import FloatArray
    from skincal.rig.pivot import PivotResult, PoseReading

SPACES_FOR_SEPARATORS = str.maketrans(",;\t[]()", " " * 7)


def add_to(app: typer.Typer) -> None:
    """Add the command of this module."""
    example = "Example: skincal tool touches.csv --unit m --rotation vector"
    app.command(epilog=example)(tool)


def tool(
    touches: Annotated[
        Path,
        typer.Argument(help="File with a line for each touch: x y z and the rotation, or 16 values.", show_default=False),
    ],
    unit: Annotated[LengthUnit, typer.Option(help="Unit of the lengths.", show_default=False)],
    rotation: Annotated[
        RotationForm | None,
        typer.Option(help="Form of the rotation (docs/tool.md). Default: each is tried.", show_default=False),
    ] = None,
    degrees: Annotated[bool, typer.Option("--degrees", help="Angles are in degrees.")] = False,
    tip: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="Tip to compare with: X Y Z, mm, in the tool's frame.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> int:
    """Find the tip of a tool from touches of one point, from four or more sides (fixed-point test).

    A wrong form of the poses cannot fit, so it is named. Exit code 2 if the touches do not determine the tip.
    """
    import numpy as np

    from skincal.cli import output
    from skincal.rig.pivot import PivotState, judge_touches
    from skincal.words.tool_words import pivot_sentences

    if degrees and not (rotation is not None and rotation.has_angles):
        raise InputError("--degrees needs a --rotation with angles: vector, rpy, abc, xyz or zyz.")
    values, where, names = _read_touches(touches)
    given = None if rotation is None else PoseForm(rotation, degrees)
    _check_names(touches, names, given, unit)
    result = judge_touches(values, METRES_PER_UNIT[unit], where, given)
    lines = pivot_sentences(result, None if tip is None else np.array(tip) * 1e-3)
    output.print_result({"touches": touches, **_json(result), "said": lines}, lines, as_json)
    return 0 if result.state is PivotState.AGREES else 2


def _read_touches(path: Path) -> tuple[FloatArray, list[str], list[str]]:
    """Read the numbers of each touch, (n, width), the place of each in the file, and the names of a first line."""
    import numpy as np

    from skincal.rig.pivot import MIN_TOUCHES

    try:
        text = read_regular(path, MAX_TEXT_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is no text; expected a line of numbers for each touch.") from None
    rows = list[list[float]]()
    where, names = list[str](), list[str]()
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line.lstrip()[0] != "#"]
    for index, (number, line) in enumerate(lines):
        try:
            row = [float(word) for word in line.translate(SPACES_FOR_SEPARATORS).split()]
        except ValueError:
            if index == 0:
                mark = next((each for each in ";\t," if each in line), None)
                names = [name.strip() for name in line.lower().split(mark)]
                continue
            raise InputError(f"{path}, line {number}: is {shortened(line, 60)!r}; expected numbers alone.") from None
        if rows and len(row) != len(rows[0]):
            raise InputError(f"{path}, line {number}: has {len(row)} values; expected {len(rows[0])}, as in {where[0]}.")
        rows.append(row)
        where.append(f"line {number}")
    if len(rows) < MIN_TOUCHES:
        raise InputError(
            f"{path}: has {len(rows)} touches; expected {MIN_TOUCHES} or more, with the tool leaning in other ways."
        )
    if len(rows[0]) not in {form.width for form in RotationForm}:
        raise InputError(f"{path}: its lines have {len(rows[0])} values; expected 6, 7, 12 or 16: x y z and a rotation.")
    return np.array(rows), [f"{path}, {each}" for each in where], names


def _check_names(touches: Path, names: list[str], given: PoseForm | None, unit: LengthUnit) -> None:
    """Compare the names of the columns with the options. Raises InputError: they differ, or are no pose."""
    from skincal.devices.pose_names import PoseNames

    found = PoseNames.read(names)
    if found.mistake is not None:
        raise InputError(f"{touches}: its columns are {', '.join(names)}, {found.mistake.finding}; {found.mistake.advice}.")
    clash = found.clash(given, METRES_PER_UNIT[unit])
    if clash is not None:
        seen, key, value = clash
        said = f"--{key} is {value}" if key != "degrees" else f"--degrees is {'' if value == 'true' else 'not '}given"
        raise InputError(f"{touches}: its columns name {seen}, and {said}; correct the one that is wrong.")


def _json(result: PivotResult) -> dict[str, Any]:
    fit = result.reading.fit
    return {
        "state": result.state.value,
        "reading": _reading_json(result.reading),
        "tip_mm": (fit.tip * 1e3).tolist(),
        "tip_sd_mm": fit.tip_sd * 1e3,
        "point_mm": (fit.point * 1e3).tolist(),
        "miss_mm": (fit.misses * 1e3).tolist(),
        "others": [_reading_json(each) for each in result.others],
    }


def _reading_json(reading: PoseReading) -> dict[str, Any]:
    return {
        "rotation": reading.form.rotation.value,
        "degrees": reading.form.degrees,
        "mistake": reading.mistake.value,
        "touch_sd_mm": reading.fit.touch_sd * 1e3,
    }
