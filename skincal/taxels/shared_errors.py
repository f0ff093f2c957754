"""Covariance of estimates by errors that many pokes share: the sensor's matrix, the arm's poses, drift, the mesh, thick skin.

A poke's two rows E (p - a) change by B x with errors x of independent unit variance that all pokes share. The estimate is the
minimum of sum k |E (p - a)|^2 with the weights k of `contact_table`, so the errors move it by

    dp = M x,   M = -H^-1 sum k E'B,   H = sum k E'E,

on a surface in the plane of its triangle alone. The covariance of all estimates is that of the pokes' own noise plus M M'. The
part of M that is the same for all taxels shifts the whole skin; the rest moves taxels against each other.

**Errors in variables.** The noise of a force turns its axis about the sensor's origin o. It stands on both sides of the free
method's equations and pulls the point towards the sensor. With sigma_f the noise of each component this is to first order
H^-1 sum 2 k sigma_f^2/|f|^2 u u'(p - o), the part along the push u. It is counted as a standard deviation and not corrected:
the size of the noise comes from the scene and not from the pokes, and the point stays the paper's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import NoiseSettings
from skincal.solver.machine import Value, fill_in
from skincal.solver.machine import shared as machine
from skincal.taxels.contact_table import ContactTable, Evidence
from skincal.taxels.noise import noise_in_solver
from skincal.taxels.result import POSITION_MAX_SD_M, Cause, Estimate, Method, State, StateReason

SharedRows: TypeAlias = Callable[[IntArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Maps pokes by number (m,), the positions (m, 3), metres, that they touch, and the directions E (m, 2, 3) across their pushes
to B (m, 2, n), metres, for n errors that all pokes share, in their standard deviations, and (m, 2, k) for k errors that the
pokes in one arm pose share, independent between poses."""
POKES_PER_DRIFT_BLOCK = 60
"""Pokes that share slow changes, about two minutes of work: drift of the sensor, an arm that creeps."""
MAX_DRIFT_PAIR_GAP = POKES_PER_DRIFT_BLOCK // 4
"""The drift is measured from pairs of pokes with numbers at most this far apart."""
DRIFT_VARIANCE_FACTOR_IF_CORRECTED = 2.0
"""True drift variance over that of the residuals under a correction. It absorbs the mean drift of each arm pose, which over the
60 to 80 pokes of a pose has about half of the variance."""
MAX_KNOWN_ERROR_SHARE_OF_PART = 0.1
"""Largest predicted error that is shown, as a share of the part's longest side: 12 mm on the forearm with its spacing of 5 mm.
The paper's rig without a correction has 7 to 8 mm. The 95 % region of a larger error is longer than half the part."""
MIN_OF_MAX_KNOWN_ERROR_M = 0.010
"""m: an error up to this is known on a part of any size that is not smaller itself."""
UNRANKED_SHIFT_PER_DISTANCE = 0.7
"""How far pokes that press one of several taxels at the end of the range shift one of these, over the rms distance of the
pokes. Over a disc it is 0, over half a disc, as at a straight rim, 0.60, over a quarter, as at a corner, 0.85."""
RANK_MIN_INFORMATION_RATIO = 1e-9
"""Share of the largest information of a group below which there is none in a direction."""


def variance_factors(squares: FloatArray, trust: FloatArray, starts: IntArray, unknowns: float) -> FloatArray:
    """Compute (g,) the ratio of the variance of g groups of pokes to that by the scene's noise, at least 1.

    It is the mean square of a group's misses, in standard deviations, less its standard error: few pokes show little. The ratio
    is uncertain itself, so the variance is that of Student's t, n/(n - 2) times as large.

    Parameters
    ----------
    squares : (m,) float: squared misses of pokes, two numbers each, in standard deviations
    trust : (m,) float, 0 to 1, of the pokes
    starts : (g,) where each group begins
    unknowns : of each group; with a prior the number that the pokes determine
    """
    found, count = np.add.reduceat(trust * squares, starts), 2.0 * np.add.reduceat(trust, starts)
    free = np.maximum(count - unknowns, 1.0)
    seen = found / free - np.sqrt(2.0 / free)
    return np.where(seen > 1.0, seen * free / np.maximum(free - 2.0, 1.0), 1.0)


@lru_cache(maxsize=16)
def spread_rules(noise: NoiseSettings) -> NDArray[Any]:
    """Fill in `SpreadRules` of `skincal/solver/tables.py`."""
    rules = {
        "pokes_per_drift_block": POKES_PER_DRIFT_BLOCK,
        "max_drift_pair_gap": MAX_DRIFT_PAIR_GAP,
        "drift_factor_if_corrected": DRIFT_VARIANCE_FACTOR_IF_CORRECTED,
        "unranked_shift": UNRANKED_SHIFT_PER_DISTANCE,
        "min_information_ratio": RANK_MIN_INFORMATION_RATIO,
        "skin": noise.skin,
    }
    return fill_in("SpreadRules", rules)


def nothing_shared(pokes: int) -> tuple[FloatArray, FloatArray]:
    """Make the result of `SharedRows` without a correction of the rig."""
    return np.empty((pokes, 2, 0)), np.empty((pokes, 2, 0))


def shared_rows_in_solver(errors: tuple[FloatArray, FloatArray], *, is_corrected: bool) -> dict[str, Value]:
    """Describe the result of `SharedRows` for some pokes as `skincal/solver/tables.py` does."""
    alike, of_pose = errors
    return {
        "corrected": is_corrected,
        "errors": alike.shape[2],
        "pose_errors": of_pose.shape[2],
        "alike": alike,
        "of_pose": of_pose,
    }


def add_shared_errors(
    table: ContactTable | Evidence, estimates: Sequence[Estimate], noise: NoiseSettings, shared: SharedRows | None
) -> list[Estimate]:
    """Add the covariance of shared errors to the estimates of one method of `PER_TAXEL`, of different channels.

    Parameters
    ----------
    table : that they were solved from, or its evidence of their channels
    shared : errors of the rig, if it is corrected
    """
    known = sorted((estimate for estimate in estimates if estimate.position is not None), key=lambda estimate: estimate.channel)
    if not known:
        return list(estimates)
    evidence, count = table.evidence([estimate.channel for estimate in known]), len(known)
    positions = np.array([estimate.position for estimate in known])
    normals = np.array([(0.0, 0.0, 0.0) if estimate.normal is None else estimate.normal for estimate in known])
    rows = nothing_shared(len(evidence.pokes)) if shared is None else _shared_rows(shared, evidence, positions)
    found = machine().run(
        "spread_taxels",
        taxels=count,
        answers=len(evidence.pokes),
        starts=evidence.starts,
        columns=evidence.columns,
        weights=evidence.weights,
        poses=evidence.poses,
        pokes=evidence.pokes,
        unranked=evidence.unranked,
        trust=_trust_of_answers(evidence, known),
        noise=noise_in_solver(noise),
        rules=spread_rules(noise),
        on_surface=known[0].method is Method.SURFACE,
        positions=positions,
        normals=normals,
        covariances=np.array([estimate.covariance for estimate in known]),
        worst=(count, 3),
        sds=(count,),
        rms=(count,),
        moved=(count, 3, rows[0].shape[2]),
        **shared_rows_in_solver(rows, is_corrected=shared is not None),
    )
    moved = None if shared is None else found["moved"]
    spread = _with_covariances(known, found["covariances"], found["worst"], found["sds"], found["rms"], moved)
    by_channel = {estimate.channel: estimate for estimate in spread}
    return [by_channel.get(estimate.channel, estimate) for estimate in estimates]


def _shared_rows(shared: SharedRows, evidence: Evidence, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ask for the errors that the answers share, by taxel and then by poke, each at the position of its taxel."""
    order = np.lexsort((evidence.pokes, evidence.taxels))
    return shared(evidence.pokes[order], positions[evidence.taxels], evidence.pairs[order])


def _trust_of_answers(evidence: Evidence, estimates: Sequence[Estimate]) -> FloatArray:
    """List (n,) the trust of each answer, 0 to 1, by the estimates."""
    trust = np.ones(len(evidence.pokes))
    for row, estimate in enumerate(estimates):
        if estimate.doubted:
            own = slice(*evidence.starts[row : row + 2].tolist())
            trust[own] = [estimate.doubted.get(poke, 1.0) for poke in evidence.pokes[own].tolist()]
    return trust


def add_covariances(
    estimates: Sequence[Estimate], factors: FloatArray, added: FloatArray, moves: FloatArray | None
) -> list[Estimate]:
    """Enlarge the covariances of n estimates that have a position; under a correction blind beyond `POSITION_MAX_SD_M`.

    Without a correction the points stay the paper's, up to misses of `FORCE_AXIS_MAX_MISS_M`.

    Parameters
    ----------
    factors : (n,) of their own variances
    added : (n, 3, 3) float, m^2
    moves : (n, 3, k) float, metres: shifts by errors that all taxels share; None without any
    """
    covariances = np.array([estimate.covariance for estimate in estimates]).reshape(-1, 3, 3)
    covariances = factors[:, None, None] * covariances + added
    if moves is not None:
        covariances = covariances + moves @ moves.transpose(0, 2, 1)
    values, axes = np.linalg.eigh(covariances)
    worst = axes[:, :, -1]
    largest = np.take_along_axis(worst, np.abs(worst).argmax(axis=1)[:, None], axis=1)
    weakest = worst * np.copysign(1.0, largest)
    rms = np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    return _with_covariances(estimates, covariances, weakest, np.sqrt(values[:, -1]), rms, moves)


def _with_covariances(
    estimates: Sequence[Estimate],
    covariances: FloatArray,
    weakest: FloatArray,
    sds: FloatArray,
    rms: FloatArray,
    moves: FloatArray | None,
) -> list[Estimate]:
    """Give estimates other covariances (n, 3, 3), with their worst directions, sds and predicted errors, and shifts."""
    found: list[Estimate] = []
    for row, (estimate, sd, error) in enumerate(zip(estimates, sds.tolist(), rms.tolist(), strict=True)):
        if moves is None or sd <= POSITION_MAX_SD_M:
            moved = None if moves is None else moves[row]
            found.append(estimate.with_covariance(covariances[row], weakest[row], sd, error, moved))
        else:
            reason = StateReason(Cause.SHARED_ERRORS, size=sd)
            blind = Estimate(
                estimate.channel, estimate.method, State.BLIND, estimate.contacts, normal=estimate.normal,
                worst_direction=weakest[row], sd=sd, reason=reason, doubted=estimate.doubted,
            )  # fmt: skip
            found.append(blind)
    return found


@dataclass(frozen=True, slots=True)
class PredictedError:
    """Predicted error of a skin, metres; that of a taxel is the root of its covariance's trace."""

    mean: float
    """Of the taxels."""
    worst: float
    whole: float
    """rms shift of the whole skin."""
    among: float
    """rms of the rest: taxels against each other. The squares of both add up to that of the rms error."""
    unknown: int = 0
    """Estimated taxels whose error is not known yet (`known_error`), left out of the other numbers; NaN if these are all."""


def max_known_error(part_size: float) -> float:
    """Return the largest predicted error that says where a taxel is, metres: a share of the part of `part_size`, metres."""
    return min(max(MAX_KNOWN_ERROR_SHARE_OF_PART * part_size, MIN_OF_MAX_KNOWN_ERROR_M), part_size)


def known_error(estimate: Estimate, part_size: float) -> float | None:
    """Return the predicted error of a taxel, metres; `None` without an estimate, or while it is above `max_known_error`.

    A larger one is no size of an error: the position is not known yet.
    """
    return None if estimate.rms is None or estimate.rms > max_known_error(part_size) else estimate.rms


def predicted_error(estimates: Sequence[Estimate], part_size: float) -> PredictedError | None:
    """Summarise the predicted error of the estimated taxels; `None` without any. `part_size` is that of `known_error`."""
    estimated = [estimate for estimate in estimates if estimate.rms is not None]
    known = [estimate for estimate in estimated if known_error(estimate, part_size) is not None]
    if not estimated:
        return None
    if not known:
        return PredictedError(*(np.nan,) * 4, unknown=len(estimated))
    errors = np.array([estimate.rms for estimate in known], dtype=np.float64)
    moves = [estimate.moved for estimate in known if estimate.moved is not None]
    whole = 0.0
    if moves:
        whole = float(np.sum((np.sum(moves, axis=0) / len(known)) ** 2))
    among = max(float(np.mean(errors**2)) - whole, 0.0)
    return PredictedError(
        float(np.mean(errors)), float(np.max(errors)), float(np.sqrt(whole)), float(np.sqrt(among)), len(estimated) - len(known)
    )
