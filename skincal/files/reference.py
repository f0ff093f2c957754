"""How far estimates lie from places that are known otherwise: a truth, a CAD model, an earlier calibration."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.taxels.result import Estimate

TRUTH_NAME = "truth.json"
RIG_KEY = "rig"
"""In a truth: `seed` and `errors` of the simulated rig, by which `simulate` makes the same one again."""
"""A simulated session has one beside its segments."""


class Origin(Enum):
    """Where places come from that estimates are compared with."""

    TRUTH = "truth"
    """A simulated rig's: where its taxels are."""
    FILE = "file"
    """A file that the operator chose: as true as it was made."""
    PLAN = "plan"
    """The scene's layout laid on the part: modules stretch and are glued askew, so it may lie a few millimetres off."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Places of taxels that are known otherwise."""

    origin: Origin
    name: str
    """Of the file, or of the scene."""
    places: Mapping[int, FloatArray]
    """Channel to (3,) float, metres, link frame."""


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Distance of estimates to their reference over the taxels that have both, metres."""

    taxels: int
    mean: float
    sd: float
    p95: float
    max: float
    worst_channel: int


def read_reference(path: Path) -> dict[int, FloatArray]:
    """Read known taxel places, (3,) float in metres by channel, from a `truth.json` or an iCub position file.

    Raises InputError: the file is missing or is neither of the two.
    """
    return _read(path)[1]


def load_reference(path: Path, link: str, channels: Collection[int], origin: Origin = Origin.FILE) -> Reference:
    """Read known taxel places and check that they are of the scene's `link` and `channels`.

    Raises InputError: as for `read_reference`; also if the file is of another link or knows none of the channels.
    """
    named, places = _read(path)
    # An iCub file names no link; the operator answers for it.
    if named and named != link:
        raise InputError(f"{path}: its places are in the frame of {named!r}; the scene calibrates {link!r}.")
    if not places.keys() & set(channels):
        raise InputError(f"{path}: it knows none of this skin's {len(channels)} taxels; choose the file of this part.")
    return Reference(origin, path.name, places)


def find_truth(folder: Path, link: str, channels: Collection[int]) -> Reference | None:
    """Return the truth that lies in a session's folder; None where there is none.

    Raises InputError: as for `load_reference`.
    """
    path = folder / TRUTH_NAME
    return load_reference(path, link, channels, Origin.TRUTH) if path.is_file() else None


def plan_reference(name: str, places: FloatArray) -> Reference | None:
    """Return a scene's laid layout as a reference; None where it places no taxel.

    `places` are (width, 3) float, metres, link frame; NaN where a channel is no taxel or has no place.
    """
    known = {int(channel): places[channel] for channel in np.flatnonzero(np.isfinite(places).all(axis=1))}
    return Reference(Origin.PLAN, name, known) if known else None


def _read(path: Path) -> tuple[str, dict[int, FloatArray]]:
    """Return the link that the file names, empty where it names none, and the places by channel."""
    if path.suffix.lower() != ".json":
        from skincal.files.icub import read_icub

        # Zeros stand for no position in such a file.
        return "", {channel: place for channel, place in enumerate(read_icub(path)[:, :3]) if np.any(place != 0.0)}
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
        places = {int(taxel["channel"]): _place(taxel["position_m"]) for taxel in document["taxels"]}
        return str(document.get("link", "")), places
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path.") from None
    except (ValueError, KeyError, TypeError):
        raise InputError(f'{path}: not a reference; expected JSON with "taxels": [{{"channel", "position_m"}}].') from None


def _place(numbers: object) -> FloatArray:
    place = np.array(numbers, dtype=float)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ValueError
    return place


def error_summary(estimates: Iterable[Estimate], reference: Mapping[int, FloatArray]) -> ErrorSummary | None:
    """Summarise the distance of estimated taxels to their reference; None where they share no taxel.

    The sd is that of the distances, as in the paper's figures 4 and 5.
    """
    pairs = [
        (estimate.channel, float(np.linalg.norm(estimate.position - reference[estimate.channel])))
        for estimate in estimates
        if estimate.position is not None and estimate.channel in reference
    ]
    if not pairs:
        return None
    distance = np.array([value for _, value in pairs])
    return ErrorSummary(
        taxels=len(pairs),
        mean=float(distance.mean()),
        sd=float(distance.std()),
        p95=float(np.percentile(distance, 95)),
        max=float(distance.max()),
        worst_channel=pairs[int(distance.argmax())][0],
    )
