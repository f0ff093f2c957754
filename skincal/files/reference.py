"""How far estimates lie from places that are known otherwise: a truth, a CAD model, an earlier calibration."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skincal.errors import InputError
from skincal.estimate.result import Estimate
from skincal.readings import FloatArray


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
    """Read known taxel places from a `truth.json` or an iCub position file.

    Returns
    -------
    Channel to (3,) float, metres, link frame of the file.

    Raises
    ------
    InputError
        The file is missing or is neither of the two.
    """
    if path.suffix.lower() != ".json":
        from skincal.files.icub import read_icub

        return {channel: place for channel, place in enumerate(read_icub(path).positions) if np.any(place != 0.0)}
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        return {int(taxel["channel"]): _place(taxel["position_m"]) for taxel in document["taxels"]}
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
