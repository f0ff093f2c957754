"""Reads a calibration's JSON back: what any program can do with the file alone, to compute it again."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.files.export import (
    CONTACT_KEYS,
    CONTACT_UNITS,
    ESTIMATE_KEYS,
    JSON_FORMAT,
    LANDMARK_KEYS,
    NOISE_UNITS,
)
from skincal.model.scene import ContactSettings, NoiseSettings
from skincal.pokes import LandmarkPokes
from skincal.rig.correction import Correction, UsedCorrection
from skincal.taxels.result import Cause, Estimate, Method, Rival, State, StateReason

UNKNOWN = ("tare_change", "before", "after")
"""Fields in which null stands for NaN; elsewhere it stands for nothing."""


@dataclass(frozen=True)
class CalibrationFile:
    """What a calibration's JSON says."""

    frame: str
    scene_text: str
    modules_text: str | None
    mesh_sha256: str | None
    mesh_findings: tuple[str, ...]
    contact_settings: ContactSettings
    noise: NoiseSettings
    channels: tuple[int, ...]
    contacts: tuple[Contact, ...]
    excluded: tuple[int, ...]
    dead: Mapping[int, str]
    estimates: Mapping[Method, tuple[Estimate, ...]]
    corrections: tuple[UsedCorrection, ...]
    landmark_pokes: LandmarkPokes
    landmark_check: Mapping[str, Any] | None

    @property
    def used_contacts(self) -> tuple[Contact, ...]:
        """Contacts from which the estimates were computed, as they were corrected."""
        used = [contact for contact in self.contacts if contact.poke not in self.excluded]
        for step in self.corrections:
            used = [step.correction.corrected(contact) for contact in used]
        return tuple(used)


def read_json(path: Path) -> CalibrationFile:
    """Read a calibration's JSON back, bit for bit."""
    document = json.loads(path.read_text(encoding="utf-8"))
    assert document["format"] == JSON_FORMAT
    mesh = document["mesh"] or {"sha256": None, "findings": []}
    return CalibrationFile(
        frame=document["frame"],
        scene_text=document["scene"]["text"],
        modules_text=document["scene"]["modules_text"],
        mesh_sha256=mesh["sha256"],
        mesh_findings=tuple(mesh["findings"]),
        contact_settings=ContactSettings(**_settings(document["contact_settings"], CONTACT_UNITS)),
        noise=NoiseSettings(**_settings(document["noise"], NOISE_UNITS)),
        channels=tuple(document["channels"]),
        contacts=tuple(Contact(**_fields(values, CONTACT_KEYS)) for values in document["contacts"]),
        excluded=tuple(document["excluded_pokes"]),
        dead={int(channel): reason for channel, reason in document["dead_channels"].items()},
        estimates={
            Method(name): tuple(_estimate(values, Method(name)) for values in items)
            for name, items in document["estimates"].items()
        },
        corrections=tuple(_correction(values) for values in document["corrections"]),
        landmark_pokes=LandmarkPokes(
            **{name: np.array([values[key] for values in document["landmark_pokes"]]) for name, key in LANDMARK_KEYS.items()}
        ),
        landmark_check=document["landmark_check"],
    )


def _settings(values: dict[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    return {name: values[f"{name}_{unit}" if unit else name] for name, unit in units.items()}


def _fields(values: dict[str, Any], keys: Mapping[str, str]) -> dict[str, Any]:
    return {name: _field(name, values[key]) for name, key in keys.items()}


def _field(name: str, value: Any) -> Any:
    if name == "state":
        return State(value)
    if name == "channels":
        return np.array(value, dtype=np.int64)
    if isinstance(value, list):
        return np.array(value, dtype=float)
    return math.nan if value is None and name in UNKNOWN else value


def _correction(values: dict[str, Any]) -> UsedCorrection:
    motions = {name: np.array(motion, dtype=float) for name, motion in values["pose_motions_m"].items()}
    matrix, everywhere = (np.array(values[key], dtype=float) for key in ("wrench_matrix", "sensor_motion_m"))
    root, quadratic = (np.array(values[key], dtype=float) for key in ("uncertainty_root", "wrench_quadratic"))
    correction = Correction(matrix, everywhere, motions, root, quadratic.reshape(6, -1))
    return UsedCorrection(
        values["of"],
        correction,
        values["miss_before_m"],
        values["miss_after_m"],
        pokes=values["landmark_pokes"],
        ratio=values["miss_over_predicted"] or math.nan,
        noisier=values["noise_over_scene"],
    )


def _estimate(values: dict[str, Any], method: Method) -> Estimate:
    rival, reason = values["rival"], values["reason"]
    return Estimate(
        channel=values["channel"],
        method=method,
        **_fields(values, ESTIMATE_KEYS),
        reason=StateReason(Cause.EXTERNAL_TEXT, text=reason) if reason else None,
        line_point=None if values["foot_m"] is None else np.array(values["foot_m"], dtype=float),
        rival=None if rival is None else Rival(np.array(rival["position_m"], dtype=float), rival["triangle"], rival["odds"]),
        doubted={int(poke): trust for poke, trust in values["doubted"].items()},
    )
