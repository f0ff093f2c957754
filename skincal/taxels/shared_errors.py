"""How errors that many pokes share move estimates: the sensor's matrix and the arm's poses, which no number of pokes averages.

A poke's two rows E (p - a) change by B x with errors x of independent unit variance that all pokes share. The estimate is the
minimum of sum k |E (p - a)|^2 with the weights k of `contact_table`, so the errors move it by

    dp = M x,   M = -H^-1 sum k E'B,   H = sum k E'E,

on a surface in the plane of its triangle alone. The covariance of all estimates together is that of the pokes' own noise and
M M'. What is the same in the M of all taxels shifts the whole skin; the rest moves taxels against each other.

**Errors in variables.** The noise of a force turns its axis about the sensor's origin o, so it stands on both sides of the
free method's equations and pulls the point towards the sensor: with sigma_f the noise of each component, to first order by
H^-1 sum 2 k sigma_f^2/|f|^2 u u'(p - o): of the lever the part along the push u, since each row is divided by its own noisy
|f|. It is taken as a standard deviation and not put back: how large the noise is, the scene says and not the pokes, and the
point stays the paper's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray, crossed, dots
from skincal.model.scene import NoiseSettings
from skincal.taxels.contact_table import ContactTable, Evidence, orthonormal_pair
from skincal.taxels.noise import offset_square, row_precision
from skincal.taxels.result import SD_MAX, Cause, Estimate, Method, State, StateReason

SharedRows: TypeAlias = Callable[[IntArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Of pokes by number (m,), with the places (m, 3), metres, that they are said to touch and the directions E (m, 2, 3) across
their pushes, link frame: B (m, 2, n), metres for each of n errors in its standard deviations that all pokes share, and
(m, 2, k) for each of k that the pokes in one arm pose share, those of each pose independent of the others'."""


SLOW = 60
"""Pokes that share what changes slowly, about two minutes of work: drift of the sensor, an arm that creeps."""
NEAR = SLOW // 4
"""Pokes at most this far from each other say how much of that there is."""
TAKEN_UP = 2.0
"""Variance of slow errors over what misses show of it once a correction has moved each arm pose: it takes up the mean over a
pose. Of what is forgotten over `SLOW`/2 pokes that mean has half the variance, over a pose of 60 to 80 pokes."""

UNTOLD = 1e-9
"""Share of the largest information of a group below which there is none in a direction."""


def variance_factors(squares: FloatArray, trust: FloatArray, starts: IntArray, unknowns: int) -> FloatArray:
    """Return (g,) how many times larger the variances of g groups of pokes are than the scene's noise has them, at least 1.

    The mean square of a group's misses, in standard deviations, less its standard error by the scene's noise: where few pokes
    tell, little is seen. What is seen is uncertain, and makes the variance that of Student's t, n/(n - 2) times as large.

    Parameters
    ----------
    squares : (m,) float: squared misses of pokes, two numbers each, in standard deviations
    trust : (m,) float, 0 to 1, of the pokes
    starts : (g,) where each group begins
    unknowns : of each group
    """
    found, count = np.add.reduceat(trust * squares, starts), 2.0 * np.add.reduceat(trust, starts)
    free = np.maximum(count - unknowns, 1.0)
    seen = found / free - np.sqrt(2.0 / free)
    return np.where(seen > 1.0, seen * free / np.maximum(free - 2.0, 1.0), 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """How m pokes hold g groups, taxels or modules, with d unknowns each; ordered by group, then by poke."""

    starts: IntArray
    """(g,) where each group begins."""
    pokes: IntArray
    """(m,)"""
    poses: IntArray
    """(m,) equal where the arm's pose is."""
    pairs: FloatArray
    """(m, 2, 3) float, unit, E: across the push."""
    misses: FloatArray
    """(m, 2) float, metres: how far the axis passes the place that it touches, times the poke's trust."""
    pulls: FloatArray
    """(m, d, 2) float: how the two rows pull at the group's unknowns; `held` (g, d, d) over pulls is the way that these go."""
    held: FloatArray
    normals: FloatArray
    """(m, 3) float, unit, outward: of the skin there; zeros where unknown."""
    corrected: bool
    """Whether a correction of the rig has moved the arm poses."""

    def covariances(self, skin: float) -> FloatArray:
        """Return (g, d, d) what slow errors and the skin's thickness, sd `skin`, m, add to the covariances of the unknowns."""
        of, moved = self._of(), self.pulls @ self.pairs
        # Counted from the first poke of each group: where the numbers begin says nothing.
        block = (self.pokes - self.pokes[self.starts][of]) // SLOW
        new = np.ones(len(of), dtype=bool)
        new[1:] = (of[1:] != of[:-1]) | (self.poses[1:] != self.poses[:-1]) | (block[1:] != block[:-1])
        first = np.flatnonzero(new)
        together = np.add.reduceat(moved, first)
        slow = np.add.reduceat(together @ together.transpose(0, 2, 1), np.searchsorted(first, self.starts))
        along = np.add.reduceat((moved @ self.normals[:, :, None])[:, :, 0], self.starts)
        added = self._slow_variances(of)[:, None, None] * slow + skin**2 * along[:, :, None] * along[:, None]
        inverse = self.inverse()
        return inverse @ added @ inverse

    def moves(self, alike: FloatArray, of_pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (g, d, n) how errors that all pokes share move the unknowns, and (g, d, d) the covariance by those of poses.

        `alike` (m, 2, n) and `of_pose` (m, 2, k) are what `SharedRows` gives of the pokes.
        """
        of, inverse = self._of(), self.inverse()
        _, first, pose = np.unique(of * (self.poses.max() + 1) + self.poses, return_index=True, return_inverse=True)
        # By group, then by the first poke in the pose: the poses' numbers are those of a table that knows more of them.
        ordered = np.argsort(first[pose], kind="stable")
        begins = np.sort(first)
        runs = np.searchsorted(first[pose][ordered], begins)
        together = np.add.reduceat((self.pulls @ of_pose)[ordered], runs)
        own = np.add.reduceat(together @ together.transpose(0, 2, 1), np.searchsorted(begins, self.starts))
        return -inverse @ np.add.reduceat(self.pulls @ alike, self.starts), inverse @ own @ inverse

    def inverse(self) -> FloatArray:
        """Return (g, d, d) the inverse of `held`; what the pokes do not determine has no estimate, and is not moved."""
        values, axes = np.linalg.eigh(self.held)
        told = values > UNTOLD * np.abs(values).max(axis=1, keepdims=True)
        # As numpy's pinv, which takes twice as long for the few taxels of a poke.
        return (axes * (told / np.where(told, values, 1.0))[:, None]) @ axes.transpose(0, 2, 1)

    def _of(self) -> IntArray:
        """Return (m,) the group of each poke."""
        return np.repeat(np.arange(len(self.starts)), np.diff(np.append(self.starts, len(self.pokes))))

    def _slow_variances(self, of: IntArray) -> FloatArray:
        """Return (g,) the variance of what pokes near each other share, each direction, m^2.

        It is the mean product of the misses of neighbours, (E'r)_i . (E'r)_j over trace P_i P_j with P = E'E, less its standard
        error: where few pokes tell, none is seen. What a correction has taken up is not in the misses, but in the estimates:
        landmarks were poked at another time.
        """
        first, second = self.pairs[:, 0], self.pairs[:, 1]
        way, push = first * self.misses[:, :1] + second * self.misses[:, 1:], crossed(first, second)
        sums = np.zeros((3, len(self.starts)))
        for step in (1, 2):
            near = (of[step:] == of[:-step]) & (self.poses[step:] == self.poses[:-step])
            near &= self.pokes[step:] - self.pokes[:-step] <= NEAR
            i, j = np.flatnonzero(near), np.flatnonzero(near) + step
            product = dots(way[i], way[j])
            # trace P_i P_j, with P = E'E = 1 - u u'.
            shared = 1.0 + dots(push[i], push[j]) ** 2
            for row, values in enumerate((product, product**2, shared)):
                sums[row] += np.bincount(of[i], values, minlength=len(self.starts))
        product, squares, shared = sums
        seen = np.maximum(product - np.sqrt(squares), 0.0) / np.where(shared > 0, shared, np.inf)
        return TAKEN_UP * seen if self.corrected else seen


def add_shared_errors(
    table: ContactTable | Evidence, estimates: Sequence[Estimate], noise: NoiseSettings, shared: SharedRows | None
) -> list[Estimate]:
    """Return the estimates of one method of `PER_TAXEL`, of different channels, with what shared errors add to them.

    Parameters
    ----------
    table : that they were solved from, or its evidence of their channels, which need not be gathered twice
    shared : errors of the rig, if it is corrected
    """
    known = sorted((estimate for estimate in estimates if estimate.position is not None), key=lambda estimate: estimate.channel)
    if not known:
        return list(estimates)
    evidence = table.evidence([estimate.channel for estimate in known])
    trust = _trust(evidence, known)
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
    if known[0].method is Method.FREE:
        bends = np.sqrt(factors * (factors - 1.0))[:, None] * _bends(evidence, trust, normals, held, noise)
        for off in (bends, _force_biases(evidence, trust, places, held, noise)):
            inside = inside + off[:, :, None] * off[:, None]
    moves: FloatArray | None = None
    if shared is not None:
        alike, of_poses = ordered.moves(*shared(ordered.pokes, places, ordered.pairs))
        moves, inside = outward @ alike, inside + of_poses
    found = {estimate.channel: estimate for estimate in add_covariances(known, factors, outward @ inside @ free, moves)}
    return [found.get(estimate.channel, estimate) for estimate in estimates]


def _factors(evidence: Evidence, trust: FloatArray, places: FloatArray, noise: NoiseSettings, unknowns: int) -> FloatArray:
    """Return (t,) the `variance_factors` of taxels whose answers' are at `places` (n, 3), metres."""
    pairs, lever, offsets = evidence.pairs, places - evidence.sensors, offset_square(evidence.weights, noise)
    precision = row_precision(pairs, lever, evidence.forces, offsets, noise)
    off = dots(pairs, (evidence.nearest - places)[:, None])
    squares = dots(off, dots(precision, off[:, None]))
    return variance_factors(squares, trust, evidence.starts[:-1], unknowns)


def _force_biases(
    evidence: Evidence, trust: FloatArray, places: FloatArray, held: FloatArray, noise: NoiseSettings
) -> FloatArray:
    """Return (t, 3) how far the noise of forces pulls taxels, metres, whose answers' are at `places` (n, 3); as `_bends`."""
    pushes = evidence.directions
    levers = pushes * dots(pushes, places - evidence.sensors)[:, None]
    share = 2.0 * noise.force**2 * trust * evidence.weights**2 / evidence.forces**2
    pulled = np.add.reduceat(share[:, None] * levers, evidence.starts[:-1])
    return np.asarray(np.linalg.solve(held, pulled[:, :, None])[:, :, 0], dtype=np.float64)


def _bends(evidence: Evidence, trust: FloatArray, normals: FloatArray, held: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Return (t, 3) beta of `uncertainty.h`, metres: what the skin's bend makes of offsets as the scene has them.

    It grows as the square of the offsets, their variance: where this is larger by a factor, beta is, and beta beta' by its
    square.

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


def _trust(evidence: Evidence, estimates: Sequence[Estimate]) -> FloatArray:
    """Return (n,) how far each answer counts, 0 to 1, for the estimates of the taxels that answered."""
    trust = np.ones(len(evidence.pokes))
    for row, estimate in enumerate(estimates):
        if estimate.doubted:
            own = slice(*evidence.starts[row : row + 2].tolist())
            trust[own] = [estimate.doubted.get(poke, 1.0) for poke in evidence.pokes[own].tolist()]
    return trust


def add_covariances(
    estimates: Sequence[Estimate], factors: FloatArray, added: FloatArray, moves: FloatArray | None
) -> list[Estimate]:
    """Return n estimates that have a position with more covariance; under a correction blind where it is beyond `SD_MAX`.

    Without one the points stay the paper's, however far their axes miss them up to `MISS_MAX`.

    Parameters
    ----------
    factors : (n,) by how much their own variances are larger
    added : (n, 3, 3) float, m^2
    moves : (n, 3, k) float, metres: how errors that all taxels share move them; None without any
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
        if moves is None or sds[row] <= SD_MAX
        else Estimate(
            estimate.channel, estimate.method, State.BLIND, estimate.contacts, normal=estimate.normal,
            worst_direction=weakest[row], sd=sds[row], reason=StateReason(Cause.SHARED_ERRORS, size=sds[row]),
            doubted=estimate.doubted,
        )
        for row, estimate in enumerate(estimates)
    ]  # fmt: skip


@dataclass(frozen=True, slots=True)
class PredictedError:
    """The predicted error of a skin, metres; that of a taxel is the root of its covariance's trace."""

    mean: float
    """Over the taxels."""
    worst: float
    """The largest of them."""
    whole: float
    """By how much the skin may be shifted as a whole."""
    among: float
    """By how much taxels may lie wrong among each other: with `whole` their root mean square, in squares."""


def predicted_error(estimates: Sequence[Estimate]) -> PredictedError | None:
    """Return the predicted error of the taxels that are estimated; None where none is."""
    known = [estimate for estimate in estimates if estimate.rms is not None]
    if not known:
        return None
    errors = np.array([estimate.rms for estimate in known], dtype=np.float64)
    moves = [estimate.moved for estimate in known if estimate.moved is not None]
    whole = 0.0
    if moves:
        whole = float(np.sum((np.sum(moves, axis=0) / len(known)) ** 2))
    among = max(float(np.mean(errors**2)) - whole, 0.0)
    return PredictedError(float(np.mean(errors)), float(np.max(errors)), float(np.sqrt(whole)), float(np.sqrt(among)))
