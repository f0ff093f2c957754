"""A calibration as JSON with everything that is needed to compute it again.

Numbers have every digit that a double needs, so that what is read back is bit for bit what was written; JSON has no
NaN, so a number that is not known is null. A key ends in its unit unless the number has none.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.files.calibration import Calibration, LandmarkCheck
from skincal.geometry.arrays import FloatArray
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
    "force": "N",
    "moment": "Nm",
    "contact": "m",
    "reach": "m",
    "radius": "m",
    "pose_turn": "rad",
    "pose_shift": "m",
}


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
    """Accepted contacts as the rig told them, in their order; those in `excluded` did not count."""
    excluded: tuple[int, ...]
    """Numbers of the pokes that the operator took out."""
    dead: Mapping[int, str]
    estimates: Mapping[Method, tuple[Estimate, ...]]
    corrections: tuple[UsedCorrection, ...] = ()
    """Of what the rig told, to be applied one after another."""
    landmark_pokes: tuple[LandmarkPoke, ...] = ()
    """Pokes at known points as the rig told them, in their order; those in `excluded` did not count."""
    landmark_check: LandmarkCheck | None = None

    @property
    def used_contacts(self) -> tuple[Contact, ...]:
        """Contacts from which the estimates were computed, as they were corrected."""
        used = [contact for contact in self.contacts if contact.poke not in self.excluded]
        for one in self.corrections:
            used = [one.correction.corrected(contact) for contact in used]
        return tuple(used)


def json_text(calibration: Calibration, mesh_findings: tuple[str, ...] = ()) -> str:
    """Return the JSON text of every method.

    Parameters
    ----------
    mesh_findings : sentences on the mesh, from `skincal.mesh.load.load_surface`
    """
    scene = calibration.scene
    document = {
        "format": FORMAT,
        "skincal_version": calibration.version,
        "frame": scene.link,
        "scene": {"name": scene.name, "file": scene.path.name, "text": scene.text, "modules_text": modules_text(calibration)},
        "mesh": None
        if scene.surface is None
        else {"file": scene.surface.path.name, "sha256": calibration.mesh_sha256, "findings": list(mesh_findings)},
        "contact_settings": _settings(scene.contacts, CONTACT_UNITS),
        "noise": _settings(scene.noise, NOISE_UNITS),
        "channels": [int(channel) for channel in calibration.channels],
        "dead_channels": {str(channel): reason for channel, reason in sorted(calibration.dead.items())},
        "corrections": [_correction(one) for one in calibration.corrections],
        "landmark_check": _check(calibration.landmark_check),
        "landmark_pokes": [_landmark_poke(poke) for poke in calibration.landmark_pokes],
        "excluded_pokes": [int(poke) for poke in calibration.excluded],
        "contacts": [_contact(contact) for contact in calibration.contacts],
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


def modules_text(calibration: Calibration) -> str | None:
    """Return the text of the layout that was used, as it was read; None without one."""
    layout = calibration.scene.skin.layout
    return None if layout is None else layout.text or None


def _settings(settings: ContactSettings | NoiseSettings, units: Mapping[str, str]) -> dict[str, float]:
    return {_with_unit(item.name, units): getattr(settings, item.name) for item in fields(settings)}


def _with_unit(name: str, units: Mapping[str, str]) -> str:
    return f"{name}_{units[name]}" if units[name] else name


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _array(array: FloatArray | None) -> Any:
    """Return nested lists of numbers, with None for what is not finite."""
    if array is None:
        return None
    if array.ndim > 1:
        return [_array(row) for row in array]
    return [_number(value) for value in array.tolist()]


def _contact(contact: Contact) -> dict[str, Any]:
    return {
        "poke": int(contact.poke),
        "start_s": float(contact.start_s),
        "end_s": float(contact.end_s),
        "force_sensor_N": _array(contact.force),
        "moment_sensor_Nm": _array(contact.moment),
        "channels": contact.channels.tolist(),
        "responses_raw": _array(contact.responses),
        "link_from_sensor_m": _array(contact.link_from_sensor),
        "pose": contact.pose,
        "tare_change_N": _number(contact.tare_change),
        "final": bool(contact.final),
    }


def _correction(used: UsedCorrection) -> dict[str, Any]:
    found = used.correction
    return {
        "of": used.of,
        "landmark_pokes": int(used.pokes),
        "miss_before_m": float(used.before),
        "miss_after_m": float(used.after),
        "wrench_matrix": _array(found.matrix),
        "sensor_motion_m": _array(found.everywhere),
        "pose_motions_m": {name: _array(motion) for name, motion in sorted(found.motions.items())},
    }


def _check(check: LandmarkCheck | None) -> dict[str, Any] | None:
    if check is None:
        return None
    return {
        "landmark_pokes": int(check.pokes),
        "miss_before_m": _number(check.before),
        "miss_after_m": _number(check.after),
        "worth_using": bool(check.worth_using),
    }


def _landmark_poke(poke: LandmarkPoke) -> dict[str, Any]:
    return {
        "poke": int(poke.poke),
        "landmark": poke.name,
        "landmark_place_m": _array(poke.place),
        "force_sensor_N": _array(poke.force),
        "moment_sensor_Nm": _array(poke.moment),
        "link_from_sensor_m": _array(poke.link_from_sensor),
        "pose": poke.pose,
    }


def _estimate(calibration: Calibration, estimate: Estimate) -> dict[str, Any]:
    rival = estimate.rival
    return {
        "channel": int(estimate.channel),
        "module": calibration.module_id(estimate.channel),
        "state": estimate.state.value,
        "contacts": int(estimate.contacts),
        "position_m": _array(estimate.position),
        "normal": _array(estimate.normal),
        "covariance_m2": _array(estimate.covariance),
        "weakest": _array(estimate.weakest),
        "sd_m": _number(estimate.sd),
        "rms_m": _number(estimate.rms),
        "triangle": None if estimate.triangle is None else int(estimate.triangle),
        "reason": state_sentence(estimate.reason),
        "foot_m": _array(estimate.foot),
        "rival": None if rival is None else {
            "position_m": _array(rival.position), "triangle": int(rival.triangle), "odds": float(rival.odds),
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
    newer = document["format"] == FORMAT
    return CalibrationFile(
        version=document["skincal_version"],
        frame=document["frame"],
        scene_text=document["scene"]["text"],
        modules_text=document["scene"]["modules_text"],
        mesh_sha256=mesh["sha256"],
        mesh_findings=tuple(mesh["findings"]),
        contact_settings=ContactSettings(**_plain_settings(document["contact_settings"], CONTACT_UNITS)),
        noise=NoiseSettings(**_plain_settings(document["noise"], NOISE_UNITS)),
        channels=tuple(document["channels"]),
        contacts=tuple(_read_contact(contact) for contact in document["contacts"]),
        excluded=tuple(document["excluded_pokes"]),
        dead={int(channel): reason for channel, reason in document["dead_channels"].items()},
        estimates={
            Method(name): tuple(_read_estimate(item, Method(name)) for item in items)
            for name, items in document["estimates"].items()
        },
        corrections=tuple(_read_correction(one) for one in document["corrections"]) if newer else (),
        landmark_pokes=tuple(_read_landmark_poke(one) for one in document.get("landmark_pokes", ())),
        landmark_check=_read_check(document.get("landmark_check")),
    )


def _plain_settings(values: dict[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    return {name: values[_with_unit(name, units)] for name in units}


def _read_array(values: list[Any]) -> FloatArray:
    """Return an array of floats; None in the lists becomes NaN."""
    return np.array(values, dtype=float)


def _read_optional(values: list[Any] | None) -> FloatArray | None:
    return None if values is None else _read_array(values)


def _read_contact(values: dict[str, Any]) -> Contact:
    change = values["tare_change_N"]
    return Contact(
        poke=values["poke"],
        start_s=values["start_s"],
        end_s=values["end_s"],
        force=_read_array(values["force_sensor_N"]),
        moment=_read_array(values["moment_sensor_Nm"]),
        channels=np.array(values["channels"], dtype=np.int64),
        responses=_read_array(values["responses_raw"]),
        link_from_sensor=_read_array(values["link_from_sensor_m"]),
        pose=values["pose"],
        tare_change=math.nan if change is None else change,
        final=values["final"],
    )


def _read_correction(values: dict[str, Any]) -> UsedCorrection:
    motions = {name: _read_array(motion) for name, motion in values["pose_motions_m"].items()}
    return UsedCorrection(
        of=values["of"],
        correction=Correction(_read_array(values["wrench_matrix"]), _read_array(values["sensor_motion_m"]), motions),
        before=values["miss_before_m"],
        after=values["miss_after_m"],
        pokes=values["landmark_pokes"],
    )


def _read_landmark_poke(values: dict[str, Any]) -> LandmarkPoke:
    return LandmarkPoke(
        poke=values["poke"],
        name=values["landmark"],
        place=_read_array(values["landmark_place_m"]),
        force=_read_array(values["force_sensor_N"]),
        moment=_read_array(values["moment_sensor_Nm"]),
        link_from_sensor=_read_array(values["link_from_sensor_m"]),
        pose=values["pose"],
    )


def _read_check(values: dict[str, Any] | None) -> LandmarkCheck | None:
    if values is None:
        return None
    misses = [math.nan if values[key] is None else values[key] for key in ("miss_before_m", "miss_after_m")]
    return LandmarkCheck(values["landmark_pokes"], misses[0], misses[1], values["worth_using"])


def _read_estimate(values: dict[str, Any], method: Method) -> Estimate:
    rival = values["rival"]
    return Estimate(
        channel=values["channel"],
        method=method,
        state=State(values["state"]),
        contacts=values["contacts"],
        position=_read_optional(values["position_m"]),
        normal=_read_optional(values["normal"]),
        covariance=_read_optional(values["covariance_m2"]),
        weakest=_read_optional(values["weakest"]),
        sd=values["sd_m"],
        rms=values["rms_m"],
        triangle=values["triangle"],
        reason=StateReason(Cause.GIVEN, text=values["reason"]) if values["reason"] else None,
        foot=_read_optional(values["foot_m"]),
        rival=None if rival is None else Rival(_read_array(rival["position_m"]), rival["triangle"], rival["odds"]),
        doubted={int(poke): trust for poke, trust in values["doubted"].items()},
    )
