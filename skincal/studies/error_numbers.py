"""Estimates compared with the truth: errors, the share inside the 95 % regions, and their means over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skincal.geometry import FloatArray
from skincal.taxels.result import Estimate

ZERO_VARIANCE_MAX_RATIO = 1e-6
"""Variances below this share of the largest are taken for zero: the estimate lies on a surface."""
CHI2_95 = {1: 3.841, 2: 5.991, 3: 7.815}
"""95 % quantile of chi-square by degrees of freedom."""
ROOT_MEAN_SQUARES = ("predicted", "true_rms", "true_along", "ratio", "predicted_mm", "true_rms_mm")
"""Numbers that are averaged as root mean squares."""


def in_known_directions(off: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Project an error (3,) onto the directions with nonzero variance. Return the components and their variances, (d,)."""
    values, axes = np.linalg.eigh(covariance)
    known = values > ZERO_VARIANCE_MAX_RATIO * max(values[-1], 0.0)
    return axes[:, known].T @ off, values[known]


def inside_95_ellipsoid(off: FloatArray, covariance: FloatArray) -> bool:
    """Whether an error (3,) lies inside the 95 % ellipsoid of a covariance (3, 3), or its ellipse on a surface.

    A covariance of zero claims an exact position: only a zero error lies inside.
    """
    parts, variances = in_known_directions(off, covariance)
    if not len(parts):
        return not off.any()
    return float(np.sum(parts**2 / variances)) < CHI2_95[len(parts)]


def error_numbers(estimates: Sequence[Estimate], places: FloatArray) -> dict[str, Any]:
    """Compare estimates with the true positions (n, 3), metres.

    Returns
    -------
    JSON: `mean`, `predicted` and `true_rms`, mm; `true_along`, the rms part of the error in the directions of the covariance,
    mm; `inside`, the share of the taxels in their 95 % ellipsoids; `missing` have no estimate
    """
    both: list[tuple[FloatArray, FloatArray]] = [
        (estimate.position - place, estimate.covariance)
        for estimate, place in zip(estimates, places, strict=True)
        if estimate.position is not None and estimate.covariance is not None
    ]
    if not both:
        return {**dict.fromkeys(("mean", "inside", "predicted", "true_rms", "true_along"), np.nan), "missing": len(estimates)}
    off: FloatArray = np.linalg.norm([error for error, _ in both], axis=1)
    along = [np.sum(in_known_directions(error, covariance)[0] ** 2) for error, covariance in both]
    return {
        "mean": 1e3 * float(off.mean()),
        "inside": float(np.mean([inside_95_ellipsoid(error, covariance) for error, covariance in both])),
        "predicted": 1e3 * float(np.sqrt(np.mean([float(covariance.trace()) for _, covariance in both]))),
        "true_rms": 1e3 * float(np.sqrt(np.mean(off**2))),
        "true_along": 1e3 * float(np.sqrt(np.mean(along))),
        "missing": len(estimates) - len(both),
    }


def mean_over_seeds(found: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """Average over seeds: predicted and true errors and ratios as root mean squares, the others as means."""
    means: dict[str, float | None] = {}
    for name in found[0]:
        own = np.array([session[name] for session in found], dtype=float)
        # A session without any estimate has no errors (NaN); it counts under `missing`.
        own = own[np.isfinite(own)]
        means[name] = None if not len(own) else float(np.sqrt(np.mean(own**2)) if name in ROOT_MEAN_SQUARES else own.mean())
    return means
