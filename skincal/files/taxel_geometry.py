"""Taxel geometry of a three-axis skin, the YAML file that nb-touch reads.

    name, frame: sensor, units: mm, num_taxels, taxels: [{position: [x, y, z], rotation: [[...], [...], [...]]}, ...]

Row i is taxel i of the stream. `rotation` takes the axes of a taxel to those of the sensor; its columns are x, y and z of the
taxel. All taxels have one, or none has. Forces act on the sensor, and z is outward, so a push has a negative z. The frame of
the file is the calibrated link. A taxel without a position has `.nan`, and each row has more keys, which that reader skips:
`state`, `turn` and `turn_sd_deg`.

Source: github.com/opatiny/nb-touch, `src/nb_touch/io/sensor_geometry.py` and `docs/taxel-geometry.md` (version 0.1.0).
"""

from __future__ import annotations

import json

import numpy as np

from skincal.axes.taxel_frames import FrameState, TaxelFrame
from skincal.files.calibration import Calibration
from skincal.files.frames import comment_lines, skin_name
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, list_channels
from skincal.taxels.result import Estimate, Method

NOT_A_TAXEL = "no taxel"
"""`state` of a row whose channel the layout does not have."""


def taxel_geometry_text(calibration: Calibration, method: Method) -> str:
    """Return the taxel geometry as YAML, positions in millimetres.

    Raises InputError: the skin has one axis, or its turns cannot be known while the part is not placed.
    """
    _require_axes(calibration)
    estimates = {estimate.channel: estimate for estimate in calibration.estimates_by(method)}
    has_rotations = not _without_turn(calibration, method)
    rows: list[str] = []
    for channel in range(calibration.scene.skin.channels):
        estimate, frame = estimates.get(channel), None
        if estimate is not None:
            frame = calibration.frame(channel, method)
        rows += _row(channel, estimate, frame, has_rotation=has_rotations)
    comments = [
        *comment_lines(calibration, method, "millimetres and degrees"),
        f"frame sensor is the link {calibration.scene.link}; taxel i of the stream is the i-th row",
    ]
    lines = [
        *(f"# {' '.join(line.split())}" for line in comments),
        f"name: {json.dumps(skin_name(calibration))}",
        "frame: sensor",
        "units: mm",
        f"num_taxels: {calibration.scene.skin.channels}",
        "taxels:",
        *rows,
    ]
    return "\n".join(lines) + "\n"


def geometry_findings(calibration: Calibration, method: Method) -> list[str]:
    """Name the taxels that keep the file from having rotations or positions."""
    findings: list[str] = []
    if lacking := _without_turn(calibration, method):
        findings.append(
            f"taxel-geometry: has positions alone, since a taxel geometry has a rotation for all taxels or for none; the turn "
            f"of these is unknown: channels {list_channels(lacking)}. Press them, leaning. npz and json have the others."
        )
    known = {each.channel for each in calibration.estimates_by(method) if each.position is not None}
    if absent := [channel for channel in range(calibration.scene.skin.channels) if channel not in known]:
        findings.append(f"taxel-geometry: rows without a position have .nan: channels {list_channels(absent)}.")
    return findings


def _require_axes(calibration: Calibration) -> None:
    path = calibration.scene.path
    if calibration.scene.skin.axes is None:
        raise InputError(
            f"{path}: taxel-geometry is for taxels that measure a force vector; expected axes = 3 in [skin], or another format."
        )
    if calibration.axes is None:
        raise InputError(f"{path}: the part's pose is not known yet, so no turn is; poke more, or choose another format.")


def _without_turn(calibration: Calibration, method: Method) -> list[int]:
    """List the taxels that have a position and no turn."""
    placed = [each.channel for each in calibration.estimates_by(method) if each.position is not None]
    return [channel for channel in placed if not _is_turn_known(calibration.frame(channel, method))]


def _is_turn_known(frame: TaxelFrame | None) -> bool:
    return frame is not None and frame.is_known


def _row(channel: int, estimate: Estimate | None, frame: TaxelFrame | None, *, has_rotation: bool) -> list[str]:
    place = np.full(3, np.nan) if estimate is None or estimate.position is None else estimate.position * 1e3
    state = NOT_A_TAXEL if estimate is None else estimate.state.value
    turn = FrameState.UNKNOWN if frame is None else frame.state
    lines = [f"- position: {_numbers(place, 6)}"]
    if has_rotation:
        rotation = frame.rotation if frame is not None and frame.rotation is not None else np.full((3, 3), np.nan)
        lines += ["  rotation:", *(f"  - {_numbers(row, 9)}" for row in rotation)]
    lines += [f"  channel: {channel}", f"  state: {json.dumps(state)}", f"  turn: {json.dumps(turn.value)}"]
    if frame is not None and frame.is_known:
        lines.append(f"  turn_sd_deg: {_numbers(np.degrees([frame.normal_sd, frame.in_plane_sd]), 3)}  # normal, in the plane")
    return lines


def _numbers(values: FloatArray, decimals: int) -> str:
    # Adding 0.0 turns -0 into 0.
    words = [f"{value + 0.0:.{decimals}f}" if np.isfinite(value) else ".nan" for value in values.tolist()]
    return f"[{', '.join(words)}]"
