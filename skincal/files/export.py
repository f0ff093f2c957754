"""Write a calibration in one of the formats of `formats.py`, and say what is wrong with it and what it leaves out.

JSON holds everything that is needed to compute the calibration again. CSV has a row for each channel and method, PLY is a point
cloud for MeshLab, CloudCompare and ParaView; `icub.py` makes the robot's position file, `frames.py` those of simulators.

Each check (`lint`) exists because a published position file had that fault; a fault is reported and does not stop the writing.
Sources: the history of icub-main `app/skinGui/conf/positions` (a typo of 10 cm in the torso 29cc1b07e, a mirrored
patch c89409d3a, swapped patches 60dcc37a5, a wrong column ab19cf6a9), and the statistics of the files themselves:
copies of a neighbour's position, normals of length 0.6 to 1, taxels missing in a module.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

import numpy as np

from skincal.files.atomic import write_atomically
from skincal.files.calibration import Calibration, PlacedTaxels, placed_taxels
from skincal.files.formats import NO_OPTIONS, ExportFormat, ExportOptions
from skincal.files.frames import mjcf_text, named_poses, npz_bytes, sdf_text, skin_name, urdf_text
from skincal.files.icub import ORIGIN_RADIUS, SKIN_PARTS, icub_text, robot_skin_part, skin_part
from skincal.files.robot_file import check_robot, mesh_sentences, require_other_file
from skincal.files.tactile_urdf import tactile_urdf_text
from skincal.geometry import FloatArray, IntArray, quaternion_of_rotation
from skincal.mesh.findings import MeshFinding
from skincal.mesh.lay import PlacedLayout, place_layout
from skincal.mesh.search import nearest_points, nearest_pushed_points
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError, list_channels, plural
from skincal.model.scene import ContactSettings, NoiseSettings, Scene, SurfaceSpec
from skincal.model.skin import Layout, Module
from skincal.modules.health import fits_better_mirrored, neighbours_of
from skincal.rig.closing import Closing
from skincal.rig.correction import UsedCorrection
from skincal.rig.correction_fit import RigAnswer
from skincal.taxels.gains import TaxelGain
from skincal.taxels.result import Estimate, Method, State
from skincal.words.taxel_words import STATE_WORDS, state_count_words, state_lines, state_sentence
from skincal.words.units import millimetres

if TYPE_CHECKING:
    from skincal.axes.taxel_frames import TaxelFrame
    from skincal.rig.part_pose import PartPose

PART_BOX_MARGIN_M = 0.020
"""m. Taxels are on the part: the paper's largest error is 19.4 mm, a typo is 100 mm."""
DUPLICATE_POSITION_MAX_DISTANCE_M = 1e-6
"""m. Positions nearer than the file's last digit are one position."""
UNIT_NORMAL_LENGTH_TOLERANCE = 1e-6
"""A unit vector of doubles is unit to 1e-15; more than this was never normalised."""
MIRROR_CHECK_MIN_TAXELS_PER_MODULE = 6
"""Least taxels of a module whose handedness is judged: three more than a plane fit uses up."""
SAME_DEPTH_MAX_SDS = 2.0
"""Walls whose distances from a taxel differ by less, in standard deviations of its position, may both be the poked one."""
SPACING_RATIOS = (0.7, 1.4)
"""Median distance of neighbours over that of the layout: 4 to 6 mm for 5 mm, and room for scatter, which widens it."""


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedSurface:
    """Skin position known from the mesh or the planned layout."""

    points: FloatArray
    """(n, 3) float, metres: the surface's vertices, or the places as planned."""
    normals: FloatArray | None
    """(taxels, 3) float, unit, outward: for each placed taxel that of the nearest place; None where unknown."""
    what: str
    """Such as `"the surface"`."""


def lint(calibration: Calibration, method: Method, reference: ExpectedSurface | None = None) -> tuple[str, ...]:
    """Check one method's positions; one sentence for each fault."""
    taxels = placed_taxels(calibration.estimates_by(method))
    name = method.value
    if not len(taxels.channels):
        return (f"{name}: no taxel has a position; poke some more before you load such a file.",)
    finite = np.asarray(np.isfinite(np.hstack([taxels.positions, taxels.normals])).all(axis=1))
    states = tuple(compress(taxels.states, finite.tolist()))
    good = PlacedTaxels(taxels.channels[finite], taxels.positions[finite], taxels.normals[finite], taxels.sd[finite], states)
    faults = [(taxels.channels[~finite], "NaN or infinite position or normal: channels {}."), *_own_faults(good)]
    if reference is not None:
        outward = None if reference.normals is None else reference.normals[finite]
        faults += _faults_against(good, reference, outward)
    layout = calibration.scene.skin.layout
    if layout is not None:
        faults += _layout_faults(good, layout)
        if calibration.scene.tool is None or robot_skin_part(calibration.scene):
            faults += _modules_without_centre(good, layout)
    return tuple(f"{name}: {words.format(list_channels(where))}" for where, words in faults if len(where))


Fault: TypeAlias = tuple[IntArray | list[int], str]
"""The channels or modules that have a fault, and the sentence on it with a gap for their numbers."""


def _own_faults(taxels: PlacedTaxels) -> Iterator[Fault]:
    at_origin = np.abs(taxels.positions).max(axis=1, initial=0.0) <= ORIGIN_RADIUS
    yield taxels.channels[at_origin], "at 0 0 0, which readers take as no taxel: channels {}."
    # Neighbouring cells are not compared: copies agree in every digit.
    cells = np.round(taxels.positions / DUPLICATE_POSITION_MAX_DISTANCE_M).astype(np.int64)
    _, group, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    shared = taxels.channels[count[group.ravel()] > 1]
    yield shared, "the same position for several taxels, so at most one is right: channels {}."
    lengths = np.linalg.norm(taxels.normals, axis=1)
    off = taxels.channels[(lengths > 0) & (np.abs(lengths - 1.0) > UNIT_NORMAL_LENGTH_TOLERANCE)]
    yield off, "a normal that is not unit: channels {}."
    yield taxels.channels[lengths == 0], "no normal, written as 0 0 0: channels {}."


def _faults_against(taxels: PlacedTaxels, reference: ExpectedSurface, outward: FloatArray | None) -> Iterator[Fault]:
    low, high = reference.points.min(axis=0) - PART_BOX_MARGIN_M, reference.points.max(axis=0) + PART_BOX_MARGIN_M
    beyond = np.maximum(low - taxels.positions, taxels.positions - high).max(axis=1)
    yield (
        taxels.channels[beyond > 0],
        f"more than {millimetres(PART_BOX_MARGIN_M, 0)} outside the box of {reference.what}, by up to "
        f"{millimetres(beyond.max(initial=0.0), 0)} more: channels {{}}; check units, frame, and the poses of arm or tool.",
    )
    if outward is not None:
        inward = taxels.channels[np.sum(taxels.normals * outward, axis=1) < 0]
        words = f"a normal that points into the part, against {reference.what}: channels {{}}; check the wrench's sign."
        yield inward, words


def _layout_faults(taxels: PlacedTaxels, layout: Layout) -> Iterator[Fault]:
    wrong = np.setdiff1d(taxels.channels, layout.channels)
    yield wrong, "a position where the layout has no taxel: channels {}."
    mirrored = [module.id for module in layout.modules if _is_mirrored(module, taxels)]
    yield mirrored, "mirrored against the layout, seen from outside: modules {}; check mirror and channel order."
    known = np.isin(taxels.channels, layout.channels)
    ratios = neighbours_of(layout).pair_ratios(taxels.channels[known], taxels.positions[known])
    ratio = float(np.median(ratios)) if len(ratios) else 1.0
    if not SPACING_RATIOS[0] <= ratio <= SPACING_RATIOS[1]:
        yield (
            taxels.channels,
            f"neighbours lie {ratio:.2f} times as far apart as in the layout (median of {plural(len(ratios), 'pair')}); "
            f"expected {SPACING_RATIOS[0]} to {SPACING_RATIOS[1]}: poke more from other sides, or check the layout's unit.",
        )


def _modules_without_centre(taxels: PlacedTaxels, layout: Layout) -> Iterator[Fault]:
    """Name the modules that an iCub's program does not find; a part that a cobot pokes is of another robot."""
    placed = set(taxels.channels.tolist())
    lacking = [m.id for m in layout.modules if m.centre_channel not in placed and not placed.isdisjoint(m.channels.tolist())]
    yield lacking, "no position for the centre taxel, which stands for the module in taxel2Repr: modules {}."


def _is_mirrored(module: Module, taxels: PlacedTaxels) -> bool:
    """Whether the mirrored plan of a module fits its taxels clearly better, seen from outside."""
    _, own, placed = np.intersect1d(module.channels, taxels.channels, return_indices=True)
    normal = taxels.normals[placed].sum(axis=0)
    length = np.linalg.norm(normal)
    if len(own) < MIRROR_CHECK_MIN_TAXELS_PER_MODULE or length == 0:
        return False
    return fits_better_mirrored(module.pads[own], taxels.positions[placed], normal / length)


class _CsvRow(NamedTuple):
    """A taxel by one method, with the values of its row; NaN and `None` are empty fields."""

    method: Method
    estimate: Estimate
    module: int | None
    gain: TaxelGain
    frame: TaxelFrame | None

    def place(self, axis: int) -> float:
        """Coordinate of the position, metres, link frame."""
        return np.nan if self.estimate.position is None else float(self.estimate.position[axis])

    def normal(self, axis: int) -> float:
        """Coordinate of the normal, of a taxel with a position."""
        normal = None if self.estimate.position is None else self.estimate.normal
        return np.nan if normal is None else float(normal[axis])

    def quaternion(self, part: int) -> float:
        """Part of the unit quaternion w x y z from the axes of the readings to the link."""
        rotation = None if self.frame is None else self.frame.rotation
        return np.nan if rotation is None else float(quaternion_of_rotation(rotation)[part])

    @property
    def sd_mm(self) -> float:
        """Predicted sd along the weakest direction, mm, of a taxel with a position."""
        sd = None if self.estimate.position is None else self.estimate.sd
        return np.nan if sd is None else float(sd) * 1e3


CSV_COLUMNS: Mapping[str, Callable[[_CsvRow], str | float | None]] = {
    "channel": lambda row: row.estimate.channel,
    "module": lambda row: row.module,
    "method": lambda row: row.method.value,
    "state": lambda row: row.estimate.state.value,
    "contacts": lambda row: row.estimate.contacts,
    **{f"{name}_m": partial(_CsvRow.place, axis=axis) for axis, name in enumerate("xyz")},
    **{f"n{name}": partial(_CsvRow.normal, axis=axis) for axis, name in enumerate("xyz")},
    "sd_mm": lambda row: row.sd_mm,
    "gain_raw_per_N": lambda row: row.gain.mean,
    "gain_sd_raw_per_N": lambda row: row.gain.spread,
    "gain_pokes": lambda row: row.gain.pokes,
    "normal_sd_deg": lambda row: None if row.estimate.normal_sd is None else math.degrees(row.estimate.normal_sd),
}
"""Columns of the CSV, with the value of each."""
TURN_COLUMNS: Mapping[str, Callable[[_CsvRow], str | float | None]] = {
    "turn_state": lambda row: None if row.frame is None else row.frame.state.value,
    **{f"turn_q{name}": partial(_CsvRow.quaternion, part=part) for part, name in enumerate("wxyz")},
    "turn_normal_sd_deg": lambda row: None if row.frame is None else math.degrees(row.frame.normal_sd),
    "turn_in_plane_sd_deg": lambda row: None if row.frame is None else math.degrees(row.frame.in_plane_sd),
}
"""More columns of taxels of three axes: state of the turn, the turn, and the standard deviations of its z axis and about it."""


def csv_columns(calibration: Calibration) -> Mapping[str, Callable[[_CsvRow], str | float | None]]:
    """Choose the columns of a calibration; gains have the unit of the skin."""
    axes = calibration.scene.skin.axes
    if axes is None:
        return CSV_COLUMNS
    in_unit = {name.replace("raw_per_N", f"{axes.unit}_per_N"): value for name, value in CSV_COLUMNS.items()}
    return in_unit if calibration.axes is None else {**in_unit, **TURN_COLUMNS}


def csv_text(calibration: Calibration, _method: Method | None = None) -> str:
    """Return the CSV text of every method; what is not known is left empty.

    Positions are metres in the link frame, `sd_mm` is the predicted sd along the weakest direction, millimetres; gains are as
    for `taxel_gains`; `normal_sd_deg` is the predicted sd of the normal's angle, degrees. Numbers have every digit that a
    double needs. Taxels of three axes have `TURN_COLUMNS`, too.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    columns = csv_columns(calibration)
    writer.writerow(columns)
    for method, estimates in calibration.estimates.items():
        for estimate, gain in zip(estimates, calibration.gains(method), strict=True):
            channel = estimate.channel
            row = _CsvRow(method, estimate, calibration.module_id(channel), gain, calibration.frame(channel, method))
            writer.writerow([_csv_field(value(row)) for value in columns.values()])
    return out.getvalue()


def _csv_field(value: str | float | None) -> str | float | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value


METHOD_CODE = {Method.FREE: 0, Method.SURFACE: 1, Method.MODULES: 2}
"""Of the property `method`: PLY has no text properties."""


def ply_text(calibration: Calibration, method: Method) -> str:
    """Return ASCII PLY: one vertex a taxel with a position, metres, link frame.

    Properties: `x y z`, unit normal `nx ny nz` (0 0 0 where unknown), `channel`, `method` (0 free, 1 surface, 2 modules),
    `sd_mm` (-1 where it is not determined), `quality`, the same number under the only name that MeshLab keeps, and `inferred`
    (1 without a contact of its own, else 0).
    """
    taxels, frame = placed_taxels(calibration.estimates_by(method)), " ".join(calibration.scene.link.split())
    header = [
        "ply",
        "format ascii 1.0",
        f"comment skincal {calibration.version}, {method.value} method, metres, frame {frame}",
        "comment method 0 is free, 1 is surface, 2 is modules; sd_mm, quality -1 is not determined; normal 0 0 0 is not known",
        f"comment inferred 0 is touched ({STATE_WORDS[State.TOUCHED]}), 1 is inferred ({STATE_WORDS[State.INFERRED]})",
        *(f"comment {words}" for words in state_lines(calibration.estimates_by(method))),
        *(f"comment {words}" for words in calibration.correction_comments()),
        *(f"comment {words}" for words in calibration.verdict_comments(method)),
        f"element vertex {len(taxels.channels)}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
        "property int channel",
        "property uchar method",
        "property float sd_mm",
        "property float quality",
        "property uchar inferred",
        "end_header",
    ]
    rows = [
        # Nine digits give every 32-bit float back as it was.
        f"{' '.join(f'{length:.9g}' for length in place)} {channel} {METHOD_CODE[method]} {_ply_sd(sd)} {_ply_sd(sd)} "
        f"{int(state is State.INFERRED)}"
        for place, channel, sd, state in zip(
            np.hstack([taxels.positions, taxels.normals]).tolist(),
            taxels.channels.tolist(),
            taxels.sd.tolist(),
            taxels.states,
            strict=True,
        )
    ]
    return "\n".join([*header, *rows]) + "\n"


def _ply_sd(sd: float) -> str:
    """Format an sd (m) in millimetres."""
    return f"{sd * 1e3 if math.isfinite(sd) else -1.0:.6g}"


JSON_FORMAT = "skincal-calibration/3"
CONTACT_UNITS = {
    "force_min": "N", "force_max": "N", "touch_force": "N", "release_force": "N", "still_s": "", "still_change": "",
    "slide_max": "m", "pitch_max": "m", "taxels_max": "", "response_min": "raw", "response_noises": "", "response_share": "",
    "quiet_s": "", "tare_change_max": "N", "gap_factor": "",
}  # fmt: skip
"""Unit after the name of each setting; empty for a plain number or where the name has it."""
NOISE_UNITS = {
    "force": "N", "moment": "Nm", "contact": "m", "reach": "m", "radius": "m", "skin": "m",
    "pose_turn": "rad", "pose_shift": "m",
}  # fmt: skip


CONTACT_KEYS = {
    "poke": "poke", "start_s": "start_s", "end_s": "end_s", "force": "force_sensor_N", "moment": "moment_sensor_Nm",
    "channels": "channels", "responses": "responses_raw", "link_from_sensor": "link_from_sensor_m", "pose": "pose",
    "tare_change": "tare_change_N", "final": "final",
}  # fmt: skip
"""Key in the file by field name, for fields that are written unchanged."""
LANDMARK_KEYS = {
    "number": "poke", "name": "landmark", "place": "landmark_place_m", "force": "force_sensor_N", "moment": "moment_sensor_Nm",
    "link_from_sensor": "link_from_sensor_m", "pose": "pose",
}  # fmt: skip
ERROR_KEYS = {
    "mean": "mean_m", "worst": "worst_m", "whole": "whole_skin_m", "among": "among_taxels_m", "unknown": "taxels_not_known_yet",
}  # fmt: skip
CLOSING_KEYS = {
    "after": "after_poke", "names": "places", "shift": "shift_m", "limit": "limit_m", "chance": "chance", "has_moved": "moved",
    "observable_directions": "directions_seen", "chance_without_worst": "chance_without_poke",
    "poke": "poke_left_out", "place": "place_left_out",
}  # fmt: skip
ESTIMATE_KEYS = {
    "state": "state", "contacts": "contacts", "position": "position_m", "normal": "normal", "normal_sd": "normal_sd_rad",
    "covariance": "covariance_m2",
    "worst_direction": "weakest", "sd": "sd_m", "rms": "rms_m", "triangle": "triangle",
}  # fmt: skip


def _gain_keys(scene: Scene) -> dict[str, str]:
    """Name the fields of a taxel's gain, with the unit of the skin."""
    unit = "raw" if scene.skin.axes is None else scene.skin.axes.unit
    return {"pokes": "pokes", "mean": f"{unit}_per_N", "spread": f"sd_{unit}_per_N"}


def json_text(calibration: Calibration, _method: Method | None = None) -> str:
    """Format every method as JSON."""
    scene = calibration.scene
    layout = scene.skin.layout
    closings = [_closing(closing) for closing in calibration.closings]
    keys, contact_units = CONTACT_KEYS, CONTACT_UNITS
    if scene.skin.axes is not None:
        unit = scene.skin.axes.unit
        keys = CONTACT_KEYS | {"responses": f"responses_{unit}", "vectors": f"readings_{unit}"}
        contact_units = CONTACT_UNITS | {"response_min": unit}
    document = {
        "format": JSON_FORMAT,
        "skincal_version": calibration.version,
        "frame": scene.link,
        "scene": {
            "name": scene.name,
            "file": scene.path.name,
            "text": scene.text,
            "modules_text": None if layout is None else layout.text or None,
        },
        "mesh": None
        if scene.surface is None
        else {"file": scene.surface.path.name, "sha256": calibration.mesh_sha256, "findings": list(calibration.mesh_findings)},
        "contact_settings": _settings(scene.contacts, contact_units),
        "noise": _settings(scene.noise, NOISE_UNITS),
        "channels": [int(channel) for channel in calibration.channels],
        "dead_channels": {str(channel): reason for channel, reason in sorted(calibration.dead.items())},
        "corrections": [_correction(used) for used in calibration.corrections],
        **_part_pose(calibration.part_pose),
        **({"tool": calibration.tool} if calibration.tool else {}),
        "verdicts": {method.value: words for method, words in calibration.verdicts.items()},
        "predicted_errors": {method.value: _error(calibration, method) for method in calibration.verdicts},
        "landmark_check": _landmark_check(calibration.rig),
        "closing_check": closings[-1] if closings else None,
        "closing_checks_before": closings[:-1],
        "landmark_pokes": [_written(poke, LANDMARK_KEYS) for poke in calibration.landmark_pokes],
        "excluded_pokes": [int(poke) for poke in calibration.excluded],
        "contacts": [_written(contact, keys) for contact in calibration.contacts],
        **_axes(calibration),
        "estimates": {
            method.value: [
                _estimate(calibration, method, estimate, gain)
                for estimate, gain in zip(estimates, calibration.gains(method), strict=True)
            ]
            for method, estimates in calibration.estimates.items()
        },
    }
    return _dump(document)


def _error(calibration: Calibration, method: Method) -> dict[str, float | None] | None:
    found = calibration.predicted_error(method)
    unmodelled = calibration.unmodelled_rig_error_m.get(method)
    return None if found is None else {**_written(found, ERROR_KEYS), "unchecked_rig_m": unmodelled}


def _part_pose(pose: PartPose | None) -> dict[str, Any]:
    """Write the part's pose in the base of a tool's poses, if it was found from the pokes."""
    if pose is None:
        return {}
    values = {
        "state": pose.state.value,
        "base_from_link": pose.base_from_link,
        "centre": pose.centre,
        "covariance": pose.covariance,
    }
    return {"part_pose": {key: _plain(value) for key, value in values.items()}}


def _landmark_check(rig: RigAnswer | None) -> dict[str, Any] | None:
    if rig is None or rig.correction is None:
        return None
    values = {"landmark_pokes": len(rig.trust), "miss_before_m": rig.before, "miss_after_m": rig.after, "worth_using": rig.used}
    return {key: _plain(value) for key, value in values.items()}


def _closing(closing: Closing) -> dict[str, Any]:
    return {"at": closing.at.value, **_written(closing, CLOSING_KEYS)}


def _dump(document: dict[str, Any]) -> str:
    """Format JSON with a line for each key, contact and estimate: readable, and a third of the length of `indent=1`."""

    def compact(value: object) -> str:
        return json.dumps(value, allow_nan=False, ensure_ascii=False)

    def lines(items: list[Any]) -> str:
        return "[" + ",".join(f"\n   {compact(item)}" for item in items) + "]"

    methods = ",\n".join(f"  {compact(name)}: {lines(items)}" for name, items in document["estimates"].items())
    values = {key: compact(value) for key, value in document.items() if key not in ("contacts", "estimates")}
    values |= {"contacts": lines(document["contacts"]), "estimates": f"{{\n{methods}\n }}"}
    return "{\n" + ",\n".join(f" {compact(key)}: {value}" for key, value in values.items()) + "\n}\n"


def _settings(settings: ContactSettings | NoiseSettings, units: Mapping[str, str]) -> dict[str, float]:
    return {f"{name}_{unit}".rstrip("_"): getattr(settings, name) for name, unit in units.items()}


def _written(value: object, keys: Mapping[str, str]) -> dict[str, Any]:
    return {key: _plain(getattr(value, name)) for name, key in keys.items()}


def _plain(value: object) -> Any:
    """Return a field as JSON has it: arrays as nested lists, with null for a number that is not finite."""
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list):
        return [_plain(item) for item in cast("list[object]", value)]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.generic):
        return cast("np.generic[Any]", value).item()
    return value.value if isinstance(value, State) else value


def _correction(used: UsedCorrection) -> dict[str, Any]:
    found = used.correction
    return {
        "of": used.of,
        "landmark_pokes": int(used.pokes),
        "miss_before_m": float(used.before),
        "miss_after_m": float(used.after),
        "miss_over_predicted": _plain(used.ratio),
        "noise_over_scene": _plain(used.noisier),
        "wrench_matrix": _plain(found.matrix),
        "sensor_motion_m": _plain(found.everywhere),
        "pose_motions_m": {name: _plain(motion) for name, motion in sorted(found.motions.items())},
        "wrench_quadratic": _plain(found.quadratic),
        "uncertainty_root": _plain(found.root),
    }


def _axes(calibration: Calibration) -> dict[str, Any]:
    """Write what the pokes say of the axes of the taxels, by method; empty for a skin of one axis."""
    axes, found = calibration.scene.skin.axes, calibration.axes
    if axes is None or found is None:
        return {}
    from skincal.words.axis_words import axis_sentences, reading_words

    noise, lean = found.turns.skin.noise, found.turns.lean
    return {
        "axes": {
            "reading": f"force on the taxel, z out of the skin: {reading_words(axes)}",
            "quaternion_order": "wxyz",
            "unit": axes.unit,
            "shear_over_normal_gain": math.exp(noise.log_ratio),
            "push_lean_rad_per_m": None if lean is None else {"value": lean.value, "sd": lean.sd},
            "findings": {method.value: list(axis_sentences(axes, found.findings(method))) for method in calibration.estimates},
            "modules": [
                {"module": module.id, "taxels": module.taxels, "log_odds_shared": float(module.log_odds_shared)}
                for module in found.turns.modules.values()
            ],
        }
    }


def _turn(frame: TaxelFrame | None) -> dict[str, Any]:
    """Write the turn of a taxel; empty for a skin of one axis."""
    if frame is None:
        return {}
    rotation = frame.rotation
    values = {
        "state": frame.state.value,
        "pokes": frame.pokes,
        "quaternion_wxyz": None if rotation is None else quaternion_of_rotation(rotation),
        "covariance_rad2": frame.covariance,
        "normal_sd_rad": frame.normal_sd,
        "in_plane_sd_rad": frame.in_plane_sd,
    }
    return {"turn": {key: _plain(value) for key, value in values.items()}}


def _estimate(calibration: Calibration, method: Method, estimate: Estimate, gain: TaxelGain) -> dict[str, Any]:
    rival, gain_keys = estimate.rival, _gain_keys(calibration.scene)
    return {
        "channel": int(estimate.channel),
        "module": calibration.module_id(estimate.channel),
        **_written(estimate, ESTIMATE_KEYS),
        "reason": state_sentence(estimate.reason),
        "foot_m": _plain(estimate.line_point),
        "rival": None if rival is None else {
            "position_m": _plain(rival.position), "triangle": int(rival.triangle), "odds": float(rival.odds),
        },
        "doubted": {str(poke): trust for poke, trust in sorted(estimate.doubted.items())},
        "gain": _written(gain, gain_keys),
        **_turn(calibration.frame(estimate.channel, method)),
    }  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """Shape of the part, as the scene describes it."""

    surface: Surface | None = None
    planned: PlacedLayout | None = None
    """Without a surface alone."""
    mesh_findings: tuple[str, ...] = ()
    troubles: tuple[str, ...] = ()
    """Why the positions were not compared with it, or the comparison says little."""


def write_calibration(
    calibration: Calibration,
    format_: ExportFormat | str,
    path: Path,
    method: Method,
    options: ExportOptions = NO_OPTIONS,
) -> tuple[str, ...]:
    """Write a calibration file; an older one is kept as `.bak`, see `write_atomically`.

    Parameters
    ----------
    method : whose estimates a file of one method holds

    Returns
    -------
    Sentences that do not stop the writing: faults, omitted data, the suffix of another format, and the older file's name.

    Raises InputError: the session has no such estimates, the options do not fit, or the file cannot be written.
    """
    wanted = ExportFormat(format_)
    if options.into is not None:
        require_other_file(path, options.into)
    content, sentences = calibration_file(calibration, wanted, method, options)
    kept = write_atomically(path, content)
    if options.into is not None:
        if path.read_bytes() != content:
            raise InputError(f"{path}: does not have the content that was written; check the disk, and write it again.")
        sentences += tuple(mesh_sentences(path, options.into))
    sentences += tuple(
        f"{path.name} ends in {path.suffix} and holds the format {wanted.value}; expected the ending {wanted.suffix}: rename "
        f"the file, or choose the format {other.value}."
        for other in ExportFormat
        if other.suffix == path.suffix.lower() and not wanted.suffix.endswith(other.suffix)
    )
    return sentences if kept is None else (*sentences, f"The older {path.name} is kept as {kept.name}.")


def _taxel_geometry_text(calibration: Calibration, method: Method) -> str:
    from skincal.files.taxel_geometry import taxel_geometry_text  # for skins of three axes alone

    return taxel_geometry_text(calibration, method)


WRITER_OF_FORMAT: dict[ExportFormat, Callable[[Calibration, Method], str | bytes]] = {
    ExportFormat.ICUB: icub_text,
    ExportFormat.JSON: json_text,
    ExportFormat.CSV: csv_text,
    ExportFormat.PLY: ply_text,
    ExportFormat.URDF: urdf_text,
    ExportFormat.TACTILE_URDF: tactile_urdf_text,
    ExportFormat.SDF: sdf_text,
    ExportFormat.MJCF: mjcf_text,
    ExportFormat.NPZ: npz_bytes,
    ExportFormat.TAXEL_GEOMETRY: _taxel_geometry_text,
}
"""The function that makes the content of a file of each format."""


def calibration_file(
    calibration: Calibration, format_: ExportFormat, method: Method, options: ExportOptions = NO_OPTIONS
) -> tuple[bytes, tuple[str, ...]]:
    """Make a calibration file's bytes and its findings, as `write_calibration`, without writing."""
    options.require_use(format_)
    # Refuses a method without estimates before the mesh is loaded.
    calibration.estimates_by(method)
    shape = _shape_of(calibration)
    written = WRITER_OF_FORMAT[format_](replace(calibration, options=options, mesh_findings=shape.mesh_findings), method)
    methods = tuple(calibration.estimates) if format_.holds_all_methods else (method,)
    sentences = [*(f"{words}." for words in calibration.correction_comments()), *shape.troubles]
    for each in methods:
        sentences += lint(calibration, each, _expected_surface(calibration, each, shape))
        sentences += _left_out(calibration.estimates_by(each), each)
    if format_ is ExportFormat.ICUB and (options.is_asked or options.part or robot_skin_part(calibration.scene)):
        sentences += _icub_traps(calibration, method, options.part)
    if format_ is ExportFormat.TAXEL_GEOMETRY:
        from skincal.files.taxel_geometry import geometry_findings

        sentences += geometry_findings(calibration, method)
    content = written.encode() if isinstance(written, str) else written
    if options.into is not None:
        names, what = _names_of_taxels(replace(calibration, options=options), format_, method)
        sentences.append(check_robot(options.into, content, names, what))
    return content, tuple(sentences)


def _names_of_taxels(calibration: Calibration, format_: ExportFormat, method: Method) -> tuple[list[str], str]:
    """List the names that an export adds to a robot, and say what is added."""
    taxels = placed_taxels(calibration.estimates_by(method))
    if format_ is ExportFormat.TACTILE_URDF:
        return [skin_name(calibration)], f"a tactile sensor of {plural(len(taxels.channels), 'taxel')} is"
    names = [name for name, _, _ in named_poses(calibration, taxels, method)]
    return names, "1 taxel is" if len(names) == 1 else f"{len(names)} taxels are"


def _shape_of(calibration: Calibration) -> _Shape:
    """Load the part's shape; a missing mesh must not keep a calibration from being written."""
    scene = calibration.scene
    try:
        if scene.surface is None:
            return _Shape(None, None if scene.skin.layout is None else place_layout(scene.skin.layout, scene.skin.anchor, None))
        path = scene.surface.path
        # A file that is missing has no time; `load_surface` says so.
        surface, findings = _load(scene.surface, path.stat().st_mtime_ns if path.exists() else 0)
    except InputError as error:
        return _Shape(troubles=(f"the positions were not compared with the part's shape: {error}",))
    changed = f"{scene.surface.path}: the mesh changed since the estimates were computed; solve again."
    troubles = () if surface.sha256 == calibration.mesh_sha256 else (changed,)
    return _Shape(surface, None, tuple(finding.sentence for finding in findings), troubles)


@lru_cache(maxsize=1)
def _load(spec: SurfaceSpec, _version: int) -> tuple[Surface, tuple[MeshFinding, ...]]:
    """Load a mesh once for the files of one calibration, which are written one after another."""
    from skincal.mesh.load import load_surface  # a part without a mesh needs no reader

    return load_surface(spec)


def _expected_surface(calibration: Calibration, method: Method, shape: _Shape) -> ExpectedSurface | None:
    """Choose the expected surface: the mesh, or else the planned layout; none while positions are in another frame."""
    if calibration.part_pose is not None and not calibration.part_pose.is_known:
        return None
    taxels = placed_taxels(calibration.estimates_by(method))
    finite = np.isfinite(taxels.positions).all(axis=1)
    if shape.surface is not None:
        normals = np.zeros((len(taxels.channels), 3))
        if finite.any():
            places = taxels.positions[finite]
            near, triangles = nearest_points(shape.surface, places)
            if method is Method.FREE:
                # It knows the depth badly: on a thin part a taxel may lie nearer to the inner face.
                facing, others = nearest_pushed_points(shape.surface, places, -taxels.normals[finite])
                farther = np.linalg.norm(facing - places, axis=1) - np.linalg.norm(near - places, axis=1)
                triangles = np.where(farther <= SAME_DEPTH_MAX_SDS * taxels.sd[finite], others, triangles)
            normals[finite] = shape.surface.normals[triangles]
        return ExpectedSurface(shape.surface.vertices, normals, "the surface")
    known = None if shape.planned is None else np.isfinite(shape.planned.places).all(axis=1)
    if shape.planned is None or known is None or not known.any():
        return None
    normals = np.nan_to_num(shape.planned.normals[taxels.channels])
    return ExpectedSurface(shape.planned.places[known], normals, "the layout as planned")


def _left_out(estimates: tuple[Estimate, ...], method: Method) -> list[str]:
    without = [estimate for estimate in estimates if estimate.position is None]
    # The same for every format, so that who writes several of them reads it once.
    left_out = f"{method.value}: {len(without)} of {len(estimates)} taxels have no position ({state_count_words(without)})."
    inferred = [estimate.channel for estimate in estimates if estimate.state is State.INFERRED]
    untouched = (
        f"{method.value}: {plural(len(inferred), 'taxel')} of {len(estimates)} {'is' if len(inferred) == 1 else 'are'} "
        f"inferred ({STATE_WORDS[State.INFERRED]}): channels {list_channels(inferred)}."
    )
    return [*([left_out] if without else []), *([untouched] if inferred else [])]


def usual_format(scene: Scene) -> ExportFormat:
    """Choose the format to propose: the position file for skin parts of the iCub, URDF for parts of other robots, else CSV."""
    if robot_skin_part(scene):
        return ExportFormat.ICUB
    return ExportFormat.URDF if scene.robot is not None else ExportFormat.CSV


def _icub_traps(calibration: Calibration, method: Method, part: str | None) -> list[str]:
    """Warn of content that the robot's own readers misread; see `skincal.files.icub`."""
    sentences: list[str] = []
    last = calibration.scene.skin.channels - 1
    if any(estimate.channel == last and estimate.position is not None for estimate in calibration.estimates_by(method)):
        sentences.append(
            f"channel {last} is the last row and has a position: the skinPart reader of icub-main drops the last row; "
            "skinManager reads it."
        )
    name = skin_part(calibration, part)
    if name not in SKIN_PARTS:
        sentences.append(
            f"the part is named {name!r}, which no program of the robot knows; expected one of {', '.join(SKIN_PARTS)}: "
            "begin the scene's link name with it."
        )
    return sentences
