"""Known distances between modules as priors: modules that distances join are refined together, from their own fits.

Each module's own pokes leave its d unknowns with a covariance, and errors of the rig that all pokes share move them,

    x_a = y_a + M_a s,   y_a ~ N(0, C_a) by itself,   s ~ N(0, I),

so x has the covariance P = diag(C) + M M'. A distance D between points p of two modules, known to sd, is a row with the
gradient J of |p_a - p_b|. Gauss and Newton's step for all of them is, with S = J P J' + R,

    x = P J' S^-1 (D - |p_a - p_b| + J x),   covariance P - P J' S^-1 J P,   and M - P J' S^-1 J M for M.

R is sd^2 and what the mesh may be wrong by along the distance (`off_surface`). Pokes come in by C, M and the fit alone.
This is least squares over all pokes and distances, exact but for the curvature of the pokes' rows over the step.

**Which count.** A distance that lies far off what pokes and the other distances predict is left out. The rest is tried on
held-out pokes: each sixth of every module's pokes is taken out of its information N in turn, N_F = N - sum t A'A, and
predicted by the others, with and without distances, as in `skincal.modules.estimate`; errors that pokes share are common to
both. Distances that join the same modules count where these pokes are likelier with them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import KnownDistance
from skincal.modules.estimate import FittedModule
from skincal.modules.pose import ModuleModel, joined
from skincal.modules.pose_fit import FULL, NO_RANK
from skincal.taxels.result import Estimate
from skincal.taxels.shared_errors import with_shared

BoolArray: TypeAlias = NDArray[np.bool_]
STEPS = 3
"""Of Gauss and Newton: a module moves by a millimetre, over which a distance is all but straight."""
FOLDS = 6
"""One poke in so many is held out at a time, as for the verdict."""


class DistanceUse(Enum):
    """Whether a known distance counts, or why not."""

    USED = "used"
    UNKNOWN = "a module of it is not known"
    OFF = "pokes and other distances lie too far off it"
    NO_BETTER = "held-out pokes are predicted no better with it"


@dataclass(frozen=True, slots=True)
class TriedDistance:
    """A known distance, and what the pokes alone say of it."""

    told: KnownDistance
    use: DistanceUse
    found: float | None = None
    """m, by the pokes; None where a module is not known."""
    sd: float | None = None
    """m, predicted of the difference between told and found."""

    @property
    def used(self) -> bool:
        """Whether it counts."""
        return self.use is DistanceUse.USED


@dataclass(frozen=True, slots=True, eq=False)
class _Prior:
    """What pokes leave of b modules: x = mean + y + M s."""

    means: FloatArray
    """(b, d) float, metres."""
    covariances: FloatArray
    """(b, d, d) float, m^2, of y."""
    moves: FloatArray
    """(b, d, n) float, metres, M."""


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """k distances near some x."""

    slopes: FloatArray
    """(k, b, d) float, J."""
    left: FloatArray
    """(k,) float, metres: D - |p_a - p_b| + J x, what J x is to be."""
    variances: FloatArray
    """(k,) float, m^2, R."""

    def take(self, rows: IntArray) -> _Rows:
        """Return some of them."""
        return _Rows(self.slopes[rows], self.left[rows], self.variances[rows])


@dataclass(frozen=True, slots=True, eq=False)
class _Update:
    """How rows move a prior."""

    of_shared: FloatArray
    """(k, n) float, metres, J M."""
    seen: FloatArray
    """(k, b, d) float, m^2, J P."""
    inverse: FloatArray
    """(k, k) float, 1/m^2, S^-1."""
    off: FloatArray
    """(k,) float, metres: the rows' misses before they count."""

    @classmethod
    def of(cls, prior: _Prior, rows: _Rows) -> _Update:
        """Return it for rows that may be none."""
        count, flat = len(rows.left), rows.slopes.reshape(len(rows.left), -1)
        of_shared = flat @ prior.moves.reshape(flat.shape[1], -1)
        seen = np.einsum("kbi,bij->kbj", rows.slopes, prior.covariances)
        seen = seen + np.einsum("kn,bdn->kbd", of_shared, prior.moves)
        covariance = seen.reshape(count, -1) @ flat.T + np.diag(rows.variances)
        inverse = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        return cls(of_shared, seen, inverse, rows.left - flat @ prior.means.ravel())

    @property
    def steps(self) -> FloatArray:
        """(b, d) float, metres: how the rows move x."""
        return np.einsum("kbd,k->bd", self.seen, self.inverse @ self.off)


class _Joined:
    """Modules that distances join, as their own pokes put them."""

    def __init__(self, model: ModuleModel, modules: Mapping[int, FittedModule], told: Sequence[KnownDistance]) -> None:
        ends = [[_end(model, distance, side) for side in (0, 1)] for distance in told]
        self.modules = sorted({module for pair in ends for module, _ in pair})
        self.fitted = [modules[module] for module in self.modules]
        self._model, self._told = model, told
        self.ends: IntArray = np.array([[self.modules.index(module) for module, _ in pair] for pair in ends])
        """(k, 2) which of the modules each distance ends at."""
        self._flat = np.array([point for pair in ends for _, point in pair])
        self._poses = joined([own.pose for own in self.fitted])
        self.prior = _Prior(
            np.zeros((len(self.fitted), model.ground.unknowns)),
            np.array([own.covariance for own in self.fitted]),
            np.array([own.moves for own in self.fitted]),
        )

    def rows(self, x: FloatArray) -> _Rows:
        """Return the rows of all distances near `x` (b, d), metres."""
        ground, count = self._model.ground, len(self.ends)
        pads = ground.laid(ground.moved(self._poses, x).take(self.ends.ravel()), self._flat)
        points, normals = pads.points.reshape(count, 2, 3), pads.normals.reshape(count, 2, 3)
        way = points[:, 0] - points[:, 1]
        length = np.linalg.norm(way, axis=1)
        along = way / length[:, None]
        gradients = np.einsum("kc,kscd->ksd", along, pads.gradients.reshape(count, 2, 3, -1))
        slopes, at = np.zeros((count, *x.shape)), np.arange(count)
        slopes[at, self.ends[:, 0]], slopes[at, self.ends[:, 1]] = gradients[:, 0], -gradients[:, 1]
        heights = np.array([own.height for own in self.fitted])[self.ends]
        variances = np.array([told.sd**2 for told in self._told])
        variances = variances + np.sum(heights * np.einsum("ksc,kc->ks", normals, along) ** 2, axis=1)
        left = np.array([told.length for told in self._told]) - length + np.einsum("kbd,bd->k", slopes, x)
        return _Rows(slopes, left, variances)

    def solved(self, kept: IntArray) -> tuple[FloatArray, _Rows, _Update]:
        """Return x (b, d), metres, under the distances `kept`, with their rows near it and what these do."""
        rows = self.rows(self.prior.means).take(kept)
        update = _Update.of(self.prior, rows)
        for _ in range(STEPS - 1):
            rows = self.rows(update.steps).take(kept)
            update = _Update.of(self.prior, rows)
        return update.steps, rows, update

    def gains(self, rows: _Rows) -> FloatArray:
        """Return (b,) how much likelier, as a logarithm, the held-out pokes of each module are with the distances."""
        return np.sum([self._gains_of(fold, rows) for fold in range(FOLDS)], axis=0)

    def _gains_of(self, fold: int, rows: _Rows) -> FloatArray:
        parts = [_without(own, np.arange(len(own.trust)) % FOLDS == fold) for own in self.fitted]
        means, covariances, moves, outs = zip(*parts, strict=True)
        prior = _Prior(np.array(means), np.array(covariances), np.array(moves))
        update, gains = _Update.of(prior, rows), np.zeros(len(parts))
        for b, (own, out) in enumerate(zip(self.fitted, outs, strict=True)):
            slopes, count = own.slopes[out], int(out.sum())
            shared = slopes @ prior.moves[b] + own.shared[out]
            # Of the poke's two rows with each distance, before these count.
            both = slopes @ (prior.covariances[b] @ rows.slopes[:, b].T) + shared @ update.of_shared.T
            miss = own.misses[out] - slopes @ prior.means[b]
            spread = slopes @ prior.covariances[b] @ slopes.transpose(0, 2, 1) + shared @ shared.transpose(0, 2, 1)
            spread = spread + own.factor * np.eye(2)
            less, told = both @ update.inverse @ both.transpose(0, 2, 1), both @ (update.inverse @ update.off)
            likelier = _log_densities(miss - told, spread - less) - _log_densities(miss, spread)
            gains[b] = own.trust[out] @ likelier if count else 0.0
        return gains


def _end(model: ModuleModel, told: KnownDistance, side: int) -> tuple[int, FloatArray]:
    """Return the module at one end of a distance, and where the end is in its plane, (2,) metres."""
    end = told.ends[side]
    if told.of_taxels:
        module = int(model.layout.module_of[end])
        return module, model.pads[module][model.place_of[end]]
    return [module.id for module in model.layout.modules].index(end), np.zeros(2)


def _without(own: FittedModule, out: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return a module's mean (d,), covariance (d, d) and M (d, n) without the pokes `out` (m,), and which these are.

    None of them where the others do not determine it.
    """
    weighted = own.trust[:, None, None] * own.slopes.transpose(0, 2, 1)
    each, pulls = weighted @ own.slopes, (weighted @ own.misses[:, :, None])[:, :, 0]
    values = np.linalg.eigvalsh(each[~out].sum(axis=0))
    if not values[0] > NO_RANK * values[-1]:
        out = np.zeros_like(out)
    inverse, whole = (np.asarray(np.linalg.inv(some.sum(axis=0)), dtype=np.float64) for some in (each[~out], each))
    more = own.factor * (inverse - whole)
    # At the minimum the pulls of all pokes cancel but for rounding.
    return -inverse @ pulls[out].sum(axis=0), own.covariance + more, -inverse @ (weighted @ own.shared)[~out].sum(axis=0), out


def _log_densities(misses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return (m,) the logarithms of the normal densities of misses (m, 2), but for a constant."""
    squares = np.sum(misses * np.linalg.solve(covariances, misses[:, :, None])[:, :, 0], axis=1)
    return np.asarray(-0.5 * (squares + np.log(np.linalg.det(covariances))), dtype=np.float64)


def refined(
    model: ModuleModel, modules: Mapping[int, FittedModule], estimates: Mapping[int, Estimate]
) -> tuple[dict[int, Estimate], tuple[TriedDistance, ...]]:
    """Refine modules by the known distances of `model`.

    Parameters
    ----------
    modules : those that their own pokes place, by index
    estimates : of their taxels, by channel, from these pokes alone

    Returns
    -------
    The estimates that distances change, by channel; and of each distance, in their order, whether it is used.
    """
    told = [distance for distance in model.distances if all(_end(model, distance, side)[0] in modules for side in (0, 1))]
    tried = {distance: TriedDistance(distance, DistanceUse.UNKNOWN) for distance in model.distances}
    if not told:
        return {}, tuple(tried.values())
    all_ = _Joined(model, modules, told)
    plain = all_.rows(all_.prior.means)
    alone = _Update.of(all_.prior, plain)
    uses = [DistanceUse.USED] * len(told)
    kept = _agreeing(all_, uses)
    kept = _helping(all_, kept, uses)
    sds = np.sqrt(np.einsum("kbd,kbd->k", alone.seen, plain.slopes) + plain.variances)
    for distance, use, off, sd in zip(told, uses, alone.off.tolist(), sds.tolist(), strict=True):
        tried[distance] = TriedDistance(distance, use, distance.length - off, sd)
    found = _moved(all_, kept, model, estimates) if len(kept) else {}
    return found, tuple(tried.values())


def _agreeing(all_: _Joined, uses: list[DistanceUse]) -> IntArray:
    """Return the distances that agree with pokes and each other; note in `uses` which do not."""
    kept = np.arange(len(uses))
    while len(kept):
        update = all_.solved(kept)[2]
        pull, known = update.inverse @ update.off, np.diag(update.inverse)
        # What all others say of one: off by pull/known, with the variance 1/known.
        squares = pull**2 / known
        worst = int(squares.argmax())
        if squares[worst] <= FULL**2:
            break
        uses[int(kept[worst])] = DistanceUse.OFF
        kept = np.delete(kept, worst)
    return kept


def _helping(all_: _Joined, kept: IntArray, uses: list[DistanceUse]) -> IntArray:
    """Return those of the distances `kept` with which held-out pokes are likelier; note in `uses` which do not help."""
    if not len(kept):
        return kept
    group = np.arange(len(all_.modules))
    for one, other in all_.ends[kept].tolist():
        group[group == group[other]] = group[one]
    gains = np.bincount(group, all_.gains(all_.solved(kept)[1]), len(group))
    helps = gains[group[all_.ends[kept, 0]]] > 0.0
    for row in kept[~helps].tolist():
        uses[row] = DistanceUse.NO_BETTER
    return kept[helps]


def _moved(all_: _Joined, kept: IntArray, model: ModuleModel, estimates: Mapping[int, Estimate]) -> dict[int, Estimate]:
    """Return the estimates of the modules' taxels under the distances `kept`."""
    x, _, update = all_.solved(kept)
    found: dict[int, Estimate] = {}
    ends: list[int] = np.unique(all_.ends[kept]).tolist()
    for b in ends:
        own, module = all_.fitted[b], all_.modules[b]
        pull = update.seen[:, b].T @ update.inverse
        moves = own.moves - pull @ update.of_shared
        total = own.covariance + own.moves @ own.moves.T - pull @ update.seen[:, b]
        pads = model.pads[module]
        pose = model.ground.moved(own.pose, x[b : b + 1]).take(np.zeros(len(pads), dtype=np.int64))
        laid = model.ground.laid(pose, pads)
        outward = own.height * laid.normals[:, :, None] * laid.normals[:, None]
        covariances = laid.gradients @ (total - moves @ moves.T) @ laid.gradients.transpose(0, 2, 1) + outward
        channels: list[int] = model.layout.modules[module].channels.tolist()
        at = [pad for pad, channel in enumerate(channels) if estimates[channel].position is not None]
        there = [
            replace(
                estimates[channels[pad]],
                position=laid.points[pad],
                normal=laid.normals[pad],
                triangle=int(laid.triangles[pad]) if laid.triangles[pad] >= 0 else None,
            )
            for pad in at
        ]
        shared = laid.gradients @ moves if moves.shape[1] else None
        moved = with_shared(there, np.zeros(len(at)), covariances[at], None if shared is None else shared[at])
        found.update((estimate.channel, estimate) for estimate in moved)
    return found
