"""A calibration as JSON with everything that is needed to compute it again.

Numbers have every digit that a double needs, so that what is read back is bit for bit what was written; JSON has no
NaN, so a number that is not known is null. A key ends in its unit unless the number has none.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.files.calibration import Calibration, LandmarkCheck
from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError
from skincal.model.scene import ContactSettings, NoiseSettings
from skincal.rig.correction import Correction, UsedCorrection
from skincal.rig.correction_fit import LandmarkPoke
from skincal.sentences import state_sentence
from skincal.taxels.result import Cause, Estimate, Method, Rival, State, StateReason

FORMAT = "skincal-calibration/3"
OLDER = "skincal-calibration/2"
"""Knows no landmark pokes and no corrections of the rig."""
CONTACT_UNITS = {
    "force_min": "N", "force_max": "N", "touch_force": "N", "release_force": "N", "still_s": "", "still_change": "",
    "slide_max": "m", "pitch_max": "m", "taxels_max": "", "response_min": "raw", "response_noises": "", "quiet_s": "",
    "tare_change_max": "N", "gap_factor": "",
}  # fmt: skip
"""Unit after the name of each setting; empty for a plain number or where the name has it."""
NOISE_UNITS = {
    "force": "N", "moment": "Nm", "contact": "m", "reach": "m", "radius": "m", "skin": "m", "pose_turn": "rad", "pose_shift": "m",
}  # fmt: skip


def _as_is(value: Any) -> Any:
    return value


def _known(value: float | None) -> float:
    """Return a number, NaN for null."""
    return math.nan if value is None else value


def _floats(values: list[Any] | None) -> FloatArray | None:
    """Return an array, with NaN for each null within; None for null."""
    return None if values is None else np.array(values, dtype=float)


def _integers(values: list[int]) -> IntArray:
    return np.array(values, dtype=np.int64)


Keys: TypeAlias = tuple[tuple[str, str, Callable[[Any], Any]], ...]
"""Of a value's fields that are written alike: key in the file, name of the field, and how the field is read back."""
CONTACT_KEYS: Keys = (
    ("poke", "poke", _as_is),
    ("start_s", "start_s", _as_is),
    ("end_s", "end_s", _as_is),
    ("force_sensor_N", "force", _floats),
    ("moment_sensor_Nm", "moment", _floats),
    ("channels", "channels", _integers),
    ("responses_raw", "responses", _floats),
    ("link_from_sensor_m", "link_from_sensor", _floats),
    ("pose", "pose", _as_is),
    ("tare_change_N", "tare_change", _known),
    ("final", "final", _as_is),
)
LANDMARK_KEYS: Keys = (
    ("poke", "poke", _as_is),
    ("landmark", "name", _as_is),
    ("landmark_place_m", "place", _floats),
    ("force_sensor_N", "force", _floats),
    ("moment_sensor_Nm", "moment", _floats),
    ("link_from_sensor_m", "link_from_sensor", _floats),
    ("pose", "pose", _as_is),
)
CHECK_KEYS: Keys = (
    ("landmark_pokes", "pokes", _as_is),
    ("miss_before_m", "before", _known),
    ("miss_after_m", "after", _known),
    ("worth_using", "worth_using", _as_is),
)


def _given_reason(text: str) -> StateReason | None:
    return StateReason(Cause.GIVEN, text=text) if text else None


ESTIMATE_KEYS: Keys = (
    ("state", "state", State),
    ("contacts", "contacts", _as_is),
    ("position_m", "position", _floats),
    ("normal", "normal", _floats),
    ("covariance_m2", "covariance", _floats),
    ("weakest", "weakest", _floats),
    ("sd_m", "sd", _as_is),
    ("rms_m", "rms", _as_is),
    ("triangle", "triangle", _as_is),
    ("reason", "reason", _given_reason),
    ("foot_m", "foot", _floats),
)


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationFile:
    """What a calibration's JSON says: enough to solve again with `skincal.methods`."""

    version: str
    """Of the skincal that wrote it."""
    frame: str
    scene_text: str
    modules_text: str | None
    """Text of the layout's file; None without a layout."""
    mesh_sha256: str | None
    mesh_findings: tuple[str, ...]
    contact_settings: ContactSettings
    noise: NoiseSettings
    channels: tuple[int, ...]
    contacts: tuple[Contact, ...]
    """Accepted contacts as the rig reported them, in their order; those in `excluded` did not count."""
    excluded: tuple[int, ...]
    """Numbers of the pokes that the operator took out."""
    dead: Mapping[int, str]
    estimates: Mapping[Method, tuple[Estimate, ...]]
    corrections: tuple[UsedCorrection, ...] = ()
    """Of what the rig reported, to be applied one after another."""
    landmark_pokes: tuple[LandmarkPoke, ...] = ()
    """Pokes at known points as the rig reported them, in their order; those in `excluded` did not count."""
    landmark_check: LandmarkCheck | None = None

    @property
    def used_contacts(self) -> tuple[Contact, ...]:
        """Contacts from which the estimates were computed, as they were corrected."""
        used = [contact for contact in self.contacts if contact.poke not in self.excluded]
        for step in self.corrections:
            used = [step.correction.corrected(contact) for contact in used]
        return tuple(used)


def json_text(calibration: Calibration, mesh_findings: tuple[str, ...] = ()) -> str:
    """Return the JSON text of every method.

    Parameters
    ----------
    mesh_findings : sentences on the mesh, from `skincal.mesh.load.load_surface`
    """
    scene = calibration.scene
    layout = scene.skin.layout
    check = calibration.landmark_check
    document = {
        "format": FORMAT,
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
        else {"file": scene.surface.path.name, "sha256": calibration.mesh_sha256, "findings": list(mesh_findings)},
        "contact_settings": _settings(scene.contacts, CONTACT_UNITS),
        "noise": _settings(scene.noise, NOISE_UNITS),
        "channels": [int(channel) for channel in calibration.channels],
        "dead_channels": {str(channel): reason for channel, reason in sorted(calibration.dead.items())},
        "corrections": [_correction(used) for used in calibration.corrections],
        "landmark_check": None if check is None else _written(check, CHECK_KEYS),
        "landmark_pokes": [_written(poke, LANDMARK_KEYS) for poke in calibration.landmark_pokes],
        "excluded_pokes": [int(poke) for poke in calibration.excluded],
        "contacts": [_written(contact, CONTACT_KEYS) for contact in calibration.contacts],
        "estimates": {
            method.value: [_estimate(calibration, estimate) for estimate in estimates]
            for method, estimates in calibration.estimates.items()
        },
    }
    return _dump(document)


def _dump(document: dict[str, Any]) -> str:
    """Return JSON with one line a contact and an estimate: readable, and a third of the length of `indent=1`."""
    contacts: list[Any] = document["contacts"]
    groups: dict[str, list[Any]] = document["estimates"]
    plain = {key: value for key, value in document.items() if key not in ("contacts", "estimates")}
    estimates = ",\n".join(f"  {_compact(name)}: {_lines(items)}" for name, items in groups.items())
    entries = [f" {_compact(key)}: {_compact(value)}" for key, value in plain.items()]
    entries += [f' "contacts": {_lines(contacts)}', f' "estimates": {{\n{estimates}\n }}']
    return "{\n" + ",\n".join(entries) + "\n}\n"


def _lines(items: list[Any]) -> str:
    return "[" + ",".join(f"\n   {_compact(item)}" for item in items) + "]"


def _compact(value: object) -> str:
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


def _settings(settings: ContactSettings | NoiseSettings, units: Mapping[str, str]) -> dict[str, float]:
    return {_with_unit(item.name, units): getattr(settings, item.name) for item in fields(settings)}


def _with_unit(name: str, units: Mapping[str, str]) -> str:
    return f"{name}_{units[name]}" if units[name] else name


def _written(value: object, keys: Keys) -> dict[str, Any]:
    return {key: _plain(getattr(value, name)) for key, name, _ in keys}


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
        "wrench_matrix": _plain(found.matrix),
        "sensor_motion_m": _plain(found.everywhere),
        "pose_motions_m": {name: _plain(motion) for name, motion in sorted(found.motions.items())},
        "uncertainty_root": _plain(found.root),
    }


def _estimate(calibration: Calibration, estimate: Estimate) -> dict[str, Any]:
    rival = estimate.rival
    return {
        "channel": int(estimate.channel),
        "module": calibration.module_id(estimate.channel),
        **_written(estimate, ESTIMATE_KEYS),
        "reason": state_sentence(estimate.reason),
        "rival": None if rival is None else {
            "position_m": _plain(rival.position), "triangle": int(rival.triangle), "odds": float(rival.odds),
        },
        "doubted": {str(poke): trust for poke, trust in sorted(estimate.doubted.items())},
    }  # fmt: skip


def read_json(path: Path) -> CalibrationFile:
    """Read a calibration's JSON back, bit for bit.

    Raises
    ------
    InputError
        The file cannot be read, is no JSON, is of another format, or lacks a key.
    """
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path.") from None
    except ValueError as error:
        raise InputError(f"{path}: not JSON ({error}); expected a calibration that skincal wrote.") from None
    try:
        found: Any = document["format"]
    except (TypeError, KeyError, IndexError):
        found = None
    if found not in (FORMAT, OLDER):
        raise InputError(f"{path}: its format is {found!r}; expected {FORMAT!r}.")
    try:
        return _calibration_file(document)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: damaged near {error}; expected a calibration that skincal wrote, unchanged.") from None


def _calibration_file(document: dict[str, Any]) -> CalibrationFile:
    mesh: dict[str, Any] = document["mesh"] or {"sha256": None, "findings": []}
    newer, check = document["format"] == FORMAT, document.get("landmark_check")
    return CalibrationFile(
        version=document["skincal_version"],
        frame=document["frame"],
        scene_text=document["scene"]["text"],
        modules_text=document["scene"]["modules_text"],
        mesh_sha256=mesh["sha256"],
        mesh_findings=tuple(mesh["findings"]),
        contact_settings=ContactSettings(**_read_settings(document["contact_settings"], CONTACT_UNITS)),
        noise=NoiseSettings(**_read_settings(document["noise"], NOISE_UNITS)),
        channels=tuple(document["channels"]),
        contacts=tuple(Contact(**_read(values, CONTACT_KEYS)) for values in document["contacts"]),
        excluded=tuple(document["excluded_pokes"]),
        dead={int(channel): reason for channel, reason in document["dead_channels"].items()},
        estimates={
            Method(name): tuple(_read_estimate(values, Method(name)) for values in items)
            for name, items in document["estimates"].items()
        },
        corrections=tuple(_read_correction(values) for values in document["corrections"]) if newer else (),
        landmark_pokes=tuple(LandmarkPoke(**_read(values, LANDMARK_KEYS)) for values in document.get("landmark_pokes", ())),
        landmark_check=None if check is None else LandmarkCheck(**_read(check, CHECK_KEYS)),
    )


def _read_settings(values: dict[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    # What was added since has a default: files of old lack it.
    return {name: values[key] for name in units if (key := _with_unit(name, units)) in values}


def _read(values: dict[str, Any], keys: Keys) -> dict[str, Any]:
    return {name: read(values[key]) for key, name, read in keys}


def _read_correction(values: dict[str, Any]) -> UsedCorrection:
    motions = {name: np.array(motion, dtype=float) for name, motion in values["pose_motions_m"].items()}
    matrix, everywhere = (np.array(values[key], dtype=float) for key in ("wrench_matrix", "sensor_motion_m"))
    return UsedCorrection(
        of=values["of"],
        correction=Correction(matrix, everywhere, motions, np.array(values.get("uncertainty_root", []), dtype=float)),
        before=values["miss_before_m"],
        after=values["miss_after_m"],
        pokes=values["landmark_pokes"],
        ratio=_known(values.get("miss_over_predicted")),
    )


def _read_estimate(values: dict[str, Any], method: Method) -> Estimate:
    rival = values["rival"]
    return Estimate(
        channel=values["channel"],
        method=method,
        **_read(values, ESTIMATE_KEYS),
        rival=None if rival is None else Rival(np.array(rival["position_m"], dtype=float), rival["triangle"], rival["odds"]),
        doubted={int(poke): trust for poke, trust in values["doubted"].items()},
    )
