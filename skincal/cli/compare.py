"""`compare`: how far two sets of places of the same taxels lie apart."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.solve import Json

if TYPE_CHECKING:
    from skincal.files.reference import Comparison
    from skincal.interface.taxels import Taxels

Places = typer.Argument(
    help="Folder of a session, or a file: a calibration's JSON or CSV, an iCub position file, a URDF with a tactile sensor, a "
    "truth.json. After a colon one of free, surface, modules; of a session also plan, truth, or robot (skin frames of its "
    "URDF). Default: the method with the smallest predicted error.",
    show_default=False,
)


def add_to(app: typer.Typer) -> None:
    """Add the command of this module."""
    example = "Examples: skincal compare monday tuesday; skincal compare trial:modules trial:truth --json"
    app.command(epilog=example)(compare)


def compare(first: Annotated[str, Places], second: Annotated[str, Places], as_json: Json = False) -> None:
    """Compare two sets of positions of the same taxels: mean and worst, common rigid motion, module by module."""
    from skincal.cli import output
    from skincal.interface.taxels import Taxels

    here, there = Taxels.load(first), Taxels.load(second)
    result, lines = comparison_result(here.compare(there)), list[str]()
    if here.axes is not None and there.axes is not None:
        result["turns"], lines = _turns(here, there)
    output.print_result(result, [*_lines(result), *lines], as_json)


def _turns(here: Taxels, there: Taxels) -> tuple[dict[str, Any], list[str]]:
    """Compare the turns of taxels of three axes: as JSON in degrees, and in a line if both know one."""
    from skincal.axes.turn_differences import compare_turns
    from skincal.words.turn_words import turn_difference_words
    from skincal.words.units import ChannelNames

    found = compare_turns(here.places().axes, there.places().axes)
    words = turn_difference_words(found, ChannelNames(None).taxel)
    known = {
        str(channel): {"z_deg": math.degrees(z), "in_plane_deg": math.degrees(about) if math.isfinite(about) else None}
        for channel, z, about in zip(found.channels, found.normals.tolist(), found.in_plane.tolist(), strict=True)
    }
    return {"taxels": len(known), "apart": known}, [words] if words else ["Turns: no taxel has one in both."]


def comparison_result(found: Comparison) -> dict[str, Any]:
    """Convert a comparison to JSON, in millimetres and degrees."""
    import numpy as np

    motion, count = found.motion, len(found.channel)
    return {
        "first": found.first,
        "second": found.second,
        "taxels": count,
        "error_mm": None if not count else {
            "mean": found.mean * 1e3, "rms": found.rms * 1e3, "worst": found.worst * 1e3, "worst_channel": found.worst_channel,
        },
        "common_motion": None if motion is None else {
            "turn_deg": float(np.degrees(motion.turn)), "shift_mm": motion.shift * 1e3,
            "left_mean_mm": motion.mean * 1e3, "left_worst_mm": motion.largest * 1e3,
        },
        "modules": [
            {
                "module": module, "taxels": each.known, "mean_mm": each.mean * 1e3,
                "shift_mm": each.shift * 1e3, "shape_mm": None if each.shape is None else each.shape * 1e3,
            }
            for module, each in found.modules.items()
        ],
        "apart_mm": {
            str(channel): length * 1e3
            for channel, length in zip(found.channel.tolist(), found.distance.tolist(), strict=True)
        },
    }  # fmt: skip


def _lines(result: dict[str, Any]) -> list[str]:
    """Return the text of `comparison_result`."""
    error, motion = result["error_mm"], result["common_motion"]
    lines = [f"from {result['first']} to {result['second']}"]
    if error is None:
        return [*lines, "no taxel is known in both"]
    lines.append(
        f"{result['taxels']} taxels known in both: apart {error['mean']:.2f} mm mean, {error['rms']:.2f} rms, "
        f"{error['worst']:.2f} at most (channel {error['worst_channel']})"
    )
    if motion is not None:
        lines.append(
            f"all together moved by {motion['shift_mm']:.2f} mm and turned by {motion['turn_deg']:.2f} degrees; without that "
            f"apart {motion['left_mean_mm']:.2f} mm mean, {motion['left_worst_mm']:.2f} at most"
        )
    for each in result["modules"]:
        shape = "" if each["shape_mm"] is None else f", shape {each['shape_mm']:.2f}"
        moved = f"mean {each['mean_mm']:.2f} mm, shift {each['shift_mm']:.2f}{shape}"
        lines.append(f"module {each['module']:3d}: {each['taxels']} taxels, {moved}")
    return lines
