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
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray, crossed, dots, orthonormal_pair
from skincal.model.scene import NoiseSettings
from skincal.taxels.contact_table import ContactTable, Evidence
from skincal.taxels.noise import offset_square, row_precision
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


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of g groups (taxels or modules) with d unknowns each, from m pokes; ordered by group, then by poke."""

    starts: IntArray
    """(g,) begin of each group."""
    pokes: IntArray
    """(m,)"""
    poses: IntArray
    """(m,) equal for the same arm pose."""
    pairs: FloatArray
    """(m, 2, 3) float, unit, E: across the push."""
    misses: FloatArray
    """(m, 2) float, metres: distance of the axis from the touched position, times the poke's trust."""
    row_weights: FloatArray
    """(m, d, 2) float: weights of the two rows in the equations of the unknowns."""
    information: FloatArray
    """(g, d, d) float: matrix of the equations."""
    normals: FloatArray
    """(m, 3) float, unit, outward, of the skin there; zeros if unknown."""
    corrected: bool
    """Whether a correction of the rig has moved the arm poses."""

    def covariances(self, skin: float) -> FloatArray:
        """Compute (g, d, d) the covariances that slow errors and the skin's thickness, sd `skin`, m, add to the unknowns."""
        of, moved = self.group_of_poke, self.row_weights @ self.pairs
        block = (self.pokes - self.pokes[self.starts][of]) // POKES_PER_DRIFT_BLOCK
        new = np.ones(len(of), dtype=bool)
        new[1:] = (of[1:] != of[:-1]) | (self.poses[1:] != self.poses[:-1]) | (block[1:] != block[:-1])
        first = np.flatnonzero(new)
        together = np.add.reduceat(moved, first)
        slow = np.add.reduceat(together @ together.transpose(0, 2, 1), np.searchsorted(first, self.starts))
        along = np.add.reduceat((moved @ self.normals[:, :, None])[:, :, 0], self.starts)
        added = self.slow_variances[:, None, None] * slow + skin**2 * along[:, :, None] * along[:, None]
        return self.inverse @ added @ self.inverse

    def shift_by_errors(self, alike: FloatArray, of_pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute (g, d, n) shifts of the unknowns by errors that all pokes share, and (g, d, d) covariances by those of poses.

        `alike` (m, 2, n) and `of_pose` (m, 2, k) are the result of `SharedRows`.
        """
        of, inverse = self.group_of_poke, self.inverse
        _, first, pose = np.unique(of * (self.poses.max() + 1) + self.poses, return_index=True, return_inverse=True)
        # By group, then by the first poke in the pose: the numbers of poses depend on other pokes in the table.
        ordered = np.argsort(first[pose], kind="stable")
        begins = np.sort(first)
        runs = np.searchsorted(first[pose][ordered], begins)
        together = np.add.reduceat((self.row_weights @ of_pose)[ordered], runs)
        own = np.add.reduceat(together @ together.transpose(0, 2, 1), np.searchsorted(begins, self.starts))
        return -inverse @ np.add.reduceat(self.row_weights @ alike, self.starts), inverse @ own @ inverse

    def of_other_unknowns(self, row_weights: FloatArray, information: FloatArray) -> NormalEquations:
        """Give the equations of the same pokes for other unknowns."""
        others = replace(self, row_weights=row_weights, information=information)
        vars(others).update(group_of_poke=self.group_of_poke, slow_variances=self.slow_variances)
        return others

    @cached_property
    def inverse(self) -> FloatArray:
        """Inverse of the information, (g, d, d); zero along directions that the pokes do not determine."""
        values, axes = np.linalg.eigh(self.information)
        told = values > RANK_MIN_INFORMATION_RATIO * np.abs(values).max(axis=1, keepdims=True)
        # As numpy's pinv, which takes twice as long for the few taxels of a poke.
        return (axes * (told / np.where(told, values, 1.0))[:, None]) @ axes.transpose(0, 2, 1)

    @cached_property
    def group_of_poke(self) -> IntArray:
        """Index (m,) of each poke's group of shared noise."""
        begins = np.zeros(len(self.pokes), dtype=np.int64)
        begins[self.starts[1:]] = 1
        return begins.cumsum()

    @cached_property
    def slow_variances(self) -> FloatArray:
        """Variance (g,) of slow errors, each direction, m^2.

        It is the mean product of the misses of successive pokes, (E'r)_i . (E'r)_j over trace P_i P_j with P = E'E, less its
        standard error. The part that a correction absorbs is not in the misses, but in the estimates: landmarks were poked at
        another time.
        """
        of, first, second = self.group_of_poke, self.pairs[:, 0], self.pairs[:, 1]
        way, push = first * self.misses[:, :1] + second * self.misses[:, 1:], crossed(first, second)
        sums = np.zeros((3, len(self.starts)))
        for step in (1, 2):
            near = (of[step:] == of[:-step]) & (self.poses[step:] == self.poses[:-step])
            near &= self.pokes[step:] - self.pokes[:-step] <= MAX_DRIFT_PAIR_GAP
            i, j = np.flatnonzero(near), np.flatnonzero(near) + step
            product = dots(way[i], way[j])
            # trace P_i P_j, with P = E'E = 1 - u u'.
            shared = 1.0 + dots(push[i], push[j]) ** 2
            for row, values in enumerate((product, product**2, shared)):
                sums[row] += np.bincount(of[i], values, minlength=len(self.starts))
        product, squares, shared = sums
        seen = np.maximum(product - np.sqrt(squares), 0.0) / np.where(shared > 0, shared, np.inf)
        return DRIFT_VARIANCE_FACTOR_IF_CORRECTED * seen if self.corrected else seen


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
    evidence = table.evidence([estimate.channel for estimate in known])
    trust = _trust_of_answers(evidence, known)
    # One key, by taxel and then by poke, is quicker than two.
    order = (evidence.taxels * (evidence.pokes.max() + 1) + evidence.pokes).argsort(kind="stable")
    of, starts, pairs = evidence.taxels, evidence.starts[:-1], evidence.pairs[order]
    places = np.array([estimate.position for estimate in known])[of]
    normals = np.array([np.zeros(3) if estimate.normal is None else estimate.normal for estimate in known])
    # The directions in which a taxel is free: all, or those of its triangle's plane.
    free = orthonormal_pair(normals) if known[0].method is Method.SURFACE else np.tile(np.eye(3), (len(known), 1, 1))
    pulls = (trust * evidence.weights**2)[order][:, None, None] * (free[of] @ pairs.transpose(0, 2, 1))
    held = np.add.reduceat(pulls @ pairs, starts) @ free.transpose(0, 2, 1)
    misses = trust[order, None] * dots(pairs, (evidence.nearest[order] - places)[:, None])
    ordered = NormalEquations(
        starts, evidence.pokes[order], evidence.poses[order], pairs, misses, pulls, held, normals[of], shared is not None
    )
    outward = free.transpose(0, 2, 1)
    inside = ordered.covariances(noise.skin)
    factors = _factors(evidence, trust, places, noise, free.shape[1])
    inside = inside + free @ _unranked_covariances(evidence, trust, places, noise) @ outward
    if known[0].method is Method.FREE:
        bends = np.sqrt(factors * (factors - 1.0))[:, None] * _curvature_biases(evidence, trust, normals, held, noise)
        for off in (bends, _force_biases(evidence, trust, places, held, noise)):
            inside = inside + off[:, :, None] * off[:, None]
    moves: FloatArray | None = None
    if shared is not None:
        alike, of_poses = ordered.shift_by_errors(*shared(ordered.pokes, places, ordered.pairs))
        moves, inside = outward @ alike, inside + of_poses
    found = {estimate.channel: estimate for estimate in add_covariances(known, factors, outward @ inside @ free, moves)}
    return [found.get(estimate.channel, estimate) for estimate in estimates]


def _factors(evidence: Evidence, trust: FloatArray, places: FloatArray, noise: NoiseSettings, unknowns: int) -> FloatArray:
    """Compute (t,) the `variance_factors` of taxels; `places` (n, 3), metres, is the position of each answer's taxel."""
    pairs, lever, offsets = evidence.pairs, places - evidence.sensors, offset_square(evidence.weights, noise)
    precision = row_precision(pairs, lever, evidence.forces, offsets, noise)
    off = dots(pairs, (evidence.nearest - places)[:, None])
    squares = dots(off, dots(precision, off[:, None]))
    return variance_factors(squares, trust, evidence.starts[:-1], unknowns)


def _unranked_covariances(evidence: Evidence, trust: FloatArray, places: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Compute (t, 3, 3) the covariances of taxels by answers that are unranked, m^2; arguments as for `_factors`.

    The pressed taxel is any of those at the end of the range. At a rim these lie to one side, so more pokes do not
    move the estimate nearer to its taxel: a share of the mean square distance of the pokes' axes stays.
    """
    if not evidence.unranked.any():
        return np.zeros((len(evidence.channels), 3, 3))
    starts, pairs, weights = evidence.starts[:-1], evidence.pairs, trust * evidence.weights**2
    own = np.where(evidence.unranked, weights, 0.0)[:, None, None]
    away = dots(pairs, (evidence.nearest - places)[:, None])[:, None] @ pairs
    shift = UNRANKED_SHIFT_PER_DISTANCE**2 * np.add.reduceat(own * away.transpose(0, 2, 1) @ away, starts)
    # One poke has no distance from itself: its answer has the height that the scene's reach lets expect.
    count = np.maximum(np.add.reduceat(evidence.unranked.astype(np.int64), starts), 1)
    single = noise.reach**2 * np.add.reduceat(own * pairs.transpose(0, 2, 1) @ pairs, starts) / count[:, None, None]
    return (shift + single) / np.add.reduceat(weights, starts)[:, None, None]


def _force_biases(
    evidence: Evidence, trust: FloatArray, places: FloatArray, held: FloatArray, noise: NoiseSettings
) -> FloatArray:
    """Compute (t, 3) the pull of force noise on taxels, metres; arguments as for `_factors` and `_curvature_biases`."""
    pushes = evidence.directions
    levers = pushes * dots(pushes, places - evidence.sensors)[:, None]
    share = 2.0 * noise.force**2 * trust * evidence.weights**2 / evidence.forces**2
    pulled = np.add.reduceat(share[:, None] * levers, evidence.starts[:-1])
    return np.asarray(np.linalg.solve(held, pulled[:, :, None])[:, :, 0], dtype=np.float64)


def _curvature_biases(
    evidence: Evidence, trust: FloatArray, normals: FloatArray, held: FloatArray, noise: NoiseSettings
) -> FloatArray:
    """Compute (t, 3) beta of `uncertainty.h`, metres: the bias by the skin's curvature for offsets of the scene's noise.

    It is proportional to the variance of the offsets, so beta beta' grows with the square of the variance factor.

    Parameters
    ----------
    normals : (t, 3) float, unit, of the taxels
    held : (t, 3, 3) float: sum of the pokes' rows
    """
    of, starts, shares = evidence.taxels, evidence.starts[:-1], trust * evidence.weights**2
    out = dots(evidence.pairs, normals[of][:, None])
    steep = dots(out, out) / 2.0 + (noise.force / evidence.forces) ** 2
    lean, whole = np.add.reduceat(shares * steep, starts), np.add.reduceat(shares, starts)
    far = shares * offset_square(evidence.weights, noise) * dots(evidence.directions, normals[of])
    pulled = np.add.reduceat((far[:, None, None] * evidence.pairs * out[:, :, None]).sum(axis=1), starts)
    size = whole / np.where(lean > 0, lean, np.inf) / (2.0 * noise.radius)
    return size[:, None] * np.linalg.solve(held, pulled[:, :, None])[:, :, 0]


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
    sds, rms = np.sqrt(values[:, -1]).tolist(), np.sqrt(np.trace(covariances, axis1=1, axis2=2)).tolist()
    return [
        replace(
            estimate,
            covariance=covariances[row],
            worst_direction=weakest[row],
            sd=sds[row],
            rms=rms[row],
            moved=None if moves is None else moves[row],
        )
        if moves is None or sds[row] <= POSITION_MAX_SD_M
        else Estimate(
            estimate.channel, estimate.method, State.BLIND, estimate.contacts, normal=estimate.normal,
            worst_direction=weakest[row], sd=sds[row], reason=StateReason(Cause.SHARED_ERRORS, size=sds[row]),
            doubted=estimate.doubted,
        )
        for row, estimate in enumerate(estimates)
    ]  # fmt: skip


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
