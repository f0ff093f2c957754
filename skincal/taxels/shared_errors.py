"""How errors that many pokes share move estimates: the sensor's matrix and the arm's poses, which no number of pokes averages.

A poke's two rows E (p - a) change by B x with errors x of independent unit variance that all pokes share. The estimate is the
minimum of sum k |E (p - a)|^2 with the weights k of `contact_table`, so the errors move it by

    dp = M x,   M = -H^-1 sum k E'B,   H = sum k E'E,

on a surface in the plane of its triangle alone. The covariance of all estimates together is that of the pokes' own noise and
M M'. What is the same in the M of all taxels shifts the whole skin; the rest moves taxels against each other.

**Errors in variables.** The noise of a force turns its axis about the sensor's origin o, so it stands on both sides of the
free method's equations and pulls the point towards the sensor: with sigma_f the noise of each component, to first order by
H^-1 sum 2 k sigma_f^2/|f|^2 (p - o). It is taken as a standard deviation and not put back: how large the noise is, the
scene says and not the pokes, and the point stays the paper's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import NoiseSettings
from skincal.taxels.contact_table import ContactTable, Evidence, across
from skincal.taxels.result import Estimate, Method

SharedRows: TypeAlias = Callable[[IntArray, FloatArray, FloatArray], FloatArray]
"""Of pokes by number (m,), with the places (m, 3), metres, that they are said to touch and the directions E (m, 2, 3) across
their pushes, link frame: B (m, 2, n), metres for each of n shared errors in its standard deviations."""


SLOW = 30
"""Pokes that share what changes slowly, about a minute of work: drift of the sensor, an arm that creeps."""
NEAR = SLOW // 2
"""Pokes at most this far from each other say how much of that there is."""


@dataclass(frozen=True, slots=True, eq=False)
class Pulls:
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
    """(m, 2) float, metres: how far the axis passes the place that it touches."""
    pulls: FloatArray
    """(m, d, 2) float: how the two rows pull at the group's unknowns; `held` (g, d, d) over pulls is the way that these go."""
    held: FloatArray
    normals: FloatArray
    """(m, 3) float, unit, outward: of the skin there; zeros where unknown."""

    def covariances(self, skin: float) -> FloatArray:
        """Return (g, d, d) what slow errors and the skin's thickness, sd `skin`, m, add to the covariances of the unknowns."""
        of = np.repeat(np.arange(len(self.starts)), np.diff(np.append(self.starts, len(self.pokes))))
        moved = self.pulls @ self.pairs
        block = self.pokes // SLOW
        new = np.ones(len(of), dtype=bool)
        new[1:] = (of[1:] != of[:-1]) | (self.poses[1:] != self.poses[:-1]) | (block[1:] != block[:-1])
        first = np.flatnonzero(new)
        together = np.add.reduceat(moved, first)
        slow = np.add.reduceat(together @ together.transpose(0, 2, 1), np.searchsorted(first, self.starts))
        along = np.add.reduceat((moved @ self.normals[:, :, None])[:, :, 0], self.starts)
        added = self._slow_variances(of)[:, None, None] * slow + skin**2 * along[:, :, None] * along[:, None]
        inverse = np.linalg.pinv(self.held, rcond=1e-9, hermitian=True)
        return inverse @ added @ inverse

    def _slow_variances(self, of: IntArray) -> FloatArray:
        """Return (g,) the variance of what pokes near each other share, each direction, m^2.

        It is the mean product of the misses of neighbours, (E'r)_i . (E'r)_j over trace P_i P_j with P = E'E, less its standard
        error: where few pokes tell, none is seen.
        """
        way = np.sum(self.pairs * self.misses[:, :, None], axis=1)
        sums = np.zeros((3, len(self.starts)))
        for step in (1, 2):
            near = (of[step:] == of[:-step]) & (self.poses[step:] == self.poses[:-step])
            near &= self.pokes[step:] - self.pokes[:-step] <= NEAR
            i, j = np.flatnonzero(near), np.flatnonzero(near) + step
            product = np.sum(way[i] * way[j], axis=1)
            shared = np.sum((self.pairs[i] @ self.pairs[j].transpose(0, 2, 1)) ** 2, axis=(1, 2))
            for row, values in enumerate((product, product**2, shared)):
                sums[row] += np.bincount(of[i], values, minlength=len(self.starts))
        product, squares, shared = sums
        return np.maximum(product - np.sqrt(squares), 0.0) / np.where(shared > 0, shared, np.inf)


def carried(
    table: ContactTable, estimates: Sequence[Estimate], noise: NoiseSettings, shared: SharedRows | None
) -> list[Estimate]:
    """Return the estimates of one method of `PER_TAXEL`, of different channels, with what shared errors add to them.

    Parameters
    ----------
    table : that they were solved from
    shared : errors of the rig, if it is corrected
    """
    known = sorted((estimate for estimate in estimates if estimate.position is not None), key=lambda estimate: estimate.channel)
    if not known:
        return list(estimates)
    evidence = table.evidence([estimate.channel for estimate in known])
    order = np.lexsort((evidence.pokes, evidence.taxels))
    of, pairs = evidence.taxels, evidence.pairs[order]
    places = np.array([estimate.position for estimate in known])[of]
    normals = np.array([np.zeros(3) if estimate.normal is None else estimate.normal for estimate in known])
    # Outward from the unknowns to space: on a surface they lie in the triangle's plane.
    plane = known[0].method is Method.SURFACE
    outward = across(normals).transpose(0, 2, 1) if plane else np.tile(np.eye(3), (len(known), 1, 1))
    inward = outward.transpose(0, 2, 1)
    weights = (_trust_of(known, evidence) * evidence.weights**2)[order]
    pulls = weights[:, None, None] * (inward[of] @ pairs.transpose(0, 2, 1))
    starts = evidence.starts[:-1]
    held = np.add.reduceat(pulls @ pairs, starts) @ outward
    misses = np.sum(pairs * (evidence.nearest[order] - places)[:, None], axis=2)
    ordered = Pulls(starts, evidence.pokes[order], evidence.poses[order], pairs, misses, pulls, held, normals[of])
    added = outward @ ordered.covariances(noise.skin) @ inward
    if known[0].method is Method.FREE:
        share = 2.0 * noise.force**2 * weights / evidence.forces[order] ** 2
        pulled = np.add.reduceat(share[:, None] * (places - evidence.sensors[order]), starts)
        biases = np.linalg.solve(held, pulled[:, :, None])
        added = added + biases @ biases.transpose(0, 2, 1)
    moves: Sequence[FloatArray | None] = [None] * len(known)
    if shared is not None:
        pulled = np.add.reduceat(pulls @ shared(ordered.pokes, places, pairs), starts)
        moves = list(-outward @ np.linalg.solve(held, pulled))
    rows = zip(known, added, moves, strict=True)
    found = {estimate.channel: with_shared(estimate, more, move) for estimate, more, move in rows}
    return [found.get(estimate.channel, estimate) for estimate in estimates]


def _trust_of(known: Sequence[Estimate], evidence: Evidence) -> FloatArray:
    """Return (n,) the trust that the solver found for each answer of the taxels of `known`."""
    trust = np.ones(len(evidence.pokes))
    for row, estimate in enumerate(known):
        if estimate.doubted:
            own = slice(*evidence.starts[row : row + 2].tolist())
            trust[own] = [estimate.doubted.get(poke, 1.0) for poke in evidence.pokes[own].tolist()]
    return trust


def with_shared(estimate: Estimate, added: FloatArray, moved: FloatArray | None) -> Estimate:
    """Return an estimate with more covariance: `added` (3, 3), m^2, and of shared errors `moved` (3, n), metres."""
    if estimate.covariance is None:
        return estimate
    covariance = estimate.covariance + added
    if moved is not None:
        covariance = covariance + moved @ moved.T
    values, axes = np.linalg.eigh(covariance)
    worst = axes[:, -1]
    return replace(
        estimate,
        covariance=covariance,
        weakest=worst * np.copysign(1.0, worst[np.abs(worst).argmax()]),
        sd=float(np.sqrt(values[-1])),
        rms=float(np.sqrt(np.trace(covariance))),
        moved=moved,
    )


@dataclass(frozen=True, slots=True)
class PredictedError:
    """The predicted error of a skin, told apart; root mean squares over its taxels, metres."""

    whole: float
    """By how much the skin may be shifted as a whole."""
    among: float
    """By how much taxels may lie wrong among each other."""
    every: float
    """Both together."""


def predicted_error(estimates: Sequence[Estimate]) -> PredictedError | None:
    """Return the predicted error of the taxels that are estimated, told apart; None where none is."""
    known = [estimate for estimate in estimates if estimate.rms is not None]
    if not known:
        return None
    every = float(np.mean([(estimate.rms or 0.0) ** 2 for estimate in known]))
    moves = [estimate.moved for estimate in known if estimate.moved is not None]
    whole = 0.0
    if moves:
        width = max(move.shape[1] for move in moves)
        mean = np.sum([np.pad(move, ((0, 0), (0, width - move.shape[1]))) for move in moves], axis=0) / len(known)
        whole = float(np.sum(mean**2))
    return PredictedError(float(np.sqrt(whole)), float(np.sqrt(max(every - whole, 0.0))), float(np.sqrt(every)))
