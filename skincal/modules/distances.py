"""Known distances between modules as priors: modules that distances join are refined together, from their own fits.

Each module's own pokes leave its d unknowns with a covariance, and errors of the rig that all pokes share move them,

    x_a = y_a + M_a s,   y_a ~ N(0, C_a) by itself,   s ~ N(0, I),

so x has the covariance P = diag(C) + M M'. A distance D between points p of two modules, known to sd, is a row with the
gradient J of |p_a - p_b|. Gauss and Newton's step for all of them is, with S = J P J' + R,

    x = P J' S^-1 (D - |p_a - p_b| + J x),   covariance P - P J' S^-1 J P,   and M - P J' S^-1 J M for M.

R is sd^2 and, along the distance, what the mesh may be wrong by (`off_surface`) or, without one, how far the skin's bend lifts
the end off its module, which is taken for flat. Pokes come in by C, M and the fit alone.
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
from skincal.model.scene import KnownDistance, NoiseSettings
from skincal.modules.estimate import FittedModule
from skincal.modules.pose import ModuleModel, ModulePoses, ModulesInSpace, join_poses
from skincal.modules.pose_fit import FULL, NO_RANK
from skincal.taxels.result import Estimate
from skincal.taxels.shared_errors import add_covariances

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
        flat = rows.slopes.reshape(len(rows.left), prior.means.size)
        of_shared = flat @ prior.moves.reshape(flat.shape[1], -1)
        seen = np.einsum("kbi,bij->kbj", rows.slopes, prior.covariances)
        seen = seen + np.einsum("kn,bdn->kbd", of_shared, prior.moves)
        covariance = seen.reshape(flat.shape) @ flat.T + np.diag(rows.variances)
        inverse = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        return cls(of_shared, seen, inverse, rows.left - flat @ prior.means.ravel())

    @property
    def steps(self) -> FloatArray:
        """(b, d) float, metres: how the rows move x."""
        return np.einsum("kbd,k->bd", self.seen, self.inverse @ self.off)


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """Modules under some of the distances."""

    kept: IntArray
    """Which distances."""
    rows: _Rows
    """Of these, near x."""
    update: _Update
    x: FloatArray
    """(b, d) float, metres."""


class _Joined:
    """Modules that distances join, as their own pokes put them."""

    def __init__(
        self, model: ModuleModel, modules: Mapping[int, FittedModule], told: Sequence[KnownDistance], radius: float
    ) -> None:
        ends = [[_end(model, distance, side) for side in (0, 1)] for distance in told]
        self.modules = sorted({module for pair in ends for module, _ in pair})
        self.fitted = [modules[module] for module in self.modules]
        self._model, self._told = model, told
        self.ends: IntArray = np.array([[self.modules.index(module) for module, _ in pair] for pair in ends])
        """(k, 2) which of the modules each distance ends at."""
        self._flat = np.array([point for pair in ends for _, point in pair])
        self._poses = join_poses([own.pose for own in self.fitted])
        self.heights: FloatArray = np.array([own.height for own in self.fitted])
        """(b,) float, m^2, of `FittedModule`."""
        self._off = self.heights[self.ends]
        """(k, 2) float, m^2: how far each end may be off along the normal there."""
        if isinstance(model.ground, ModulesInSpace):
            self._off = np.array([[_bend(model.pads[module], point, radius) for module, point in pair] for pair in ends]) ** 2
        self._factors = np.array([own.factor for own in self.fitted])
        self.prior = _Prior(
            np.zeros((len(self.fitted), model.ground.unknowns)),
            np.array([own.covariance for own in self.fitted]),
            np.array([own.moves for own in self.fitted]),
        )
        self.plain = self._rows(self.prior.means)
        """The rows of all distances where the pokes put the modules."""

    def moved(self, x: FloatArray) -> ModulePoses:
        """Return the poses (b,) of the modules at `x` (b, d), metres."""
        return self._model.ground.move(self._poses, x)

    def _rows(self, x: FloatArray) -> _Rows:
        """Return the rows of all distances near `x` (b, d), metres."""
        count = len(self.ends)
        pads = self._model.ground.place_pads(self.moved(x).take(self.ends.ravel()), self._flat)
        points, normals = pads.points.reshape(count, 2, 3), pads.normals.reshape(count, 2, 3)
        way = points[:, 0] - points[:, 1]
        length = np.linalg.norm(way, axis=1)
        along = way / length[:, None]
        gradients = np.einsum("kc,kscd->ksd", along, pads.gradients.reshape(count, 2, 3, -1))
        slopes, at = np.zeros((count, *x.shape)), np.arange(count)
        slopes[at, self.ends[:, 0]], slopes[at, self.ends[:, 1]] = gradients[:, 0], -gradients[:, 1]
        variances = np.array([told.sd**2 for told in self._told])
        variances = variances + np.sum(self._off * np.einsum("ksc,kc->ks", normals, along) ** 2, axis=1)
        left = np.array([told.length for told in self._told]) - length + np.einsum("kbd,bd->k", slopes, x)
        return _Rows(slopes, left, variances)

    def solved(self, kept: IntArray) -> _Solved:
        """Solve the modules under the distances `kept`."""
        rows = self.plain.take(kept)
        update = _Update.of(self.prior, rows)
        for _ in range(STEPS - 1):
            rows = self._rows(update.steps).take(kept)
            update = _Update.of(self.prior, rows)
        return _Solved(kept, rows, update, update.steps)

    def gains(self, rows: _Rows) -> FloatArray:
        """Return (b,) how much likelier, as a logarithm, the held-out pokes of each module are with the distances."""
        pokes = _Pokes.of_modules(self.fitted)
        left, known = pokes.left(self.prior, self._factors)
        outs = [pokes.take((pokes.folds == fold) & known[fold, pokes.of]) for fold in range(FOLDS)]
        return np.sum([self._gains_of(prior, rows, out) for prior, out in zip(left, outs, strict=True)], axis=0)

    def _gains_of(self, prior: _Prior, rows: _Rows, out: _Pokes) -> FloatArray:
        """Return `gains` by the pokes `out`, which the others of their modules, `prior`, predict."""
        update, of, slopes = _Update.of(prior, rows), out.of, out.slopes
        covariances = prior.covariances[of]
        shared = slopes @ prior.moves[of] + out.shared
        # Of the poke's two rows with each distance, before these count.
        own = prior.covariances @ rows.slopes.transpose(1, 2, 0)
        both = slopes @ own[of] + shared @ update.of_shared.T
        miss = out.misses - (slopes @ prior.means[of][:, :, None])[:, :, 0]
        spread = slopes @ covariances @ slopes.transpose(0, 2, 1) + shared @ shared.transpose(0, 2, 1)
        spread = spread + self._factors[of][:, None, None] * np.eye(2)
        # One large product: many small ones take twice as long.
        known = (both.reshape(-1, len(update.off)) @ update.inverse).reshape(both.shape)
        less, told = known @ both.transpose(0, 2, 1), known @ update.off
        likelier = _log_densities(miss - told, spread - less) - _log_densities(miss, spread)
        return np.asarray(np.bincount(of, out.trust * likelier, len(self.fitted)), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Pokes:
    """The m pokes of b modules, as `FittedModule` has them, in folds."""

    of: IntArray
    """(m,) which module."""
    folds: IntArray
    """(m,) in which fold a poke is held out."""
    slopes: FloatArray
    misses: FloatArray
    trust: FloatArray
    shared: FloatArray

    @classmethod
    def of_modules(cls, fitted: Sequence[FittedModule]) -> _Pokes:
        """Return those of modules, each module's in turn in one fold after another."""
        counts = [len(own.trust) for own in fitted]
        return cls(
            np.repeat(np.arange(len(fitted)), counts),
            np.concatenate([np.arange(count) % FOLDS for count in counts]),
            *(np.concatenate(each) for each in zip(*((m.slopes, m.misses, m.trust, m.shared) for m in fitted), strict=True)),
        )

    def take(self, rows: BoolArray) -> _Pokes:
        """Return some of them."""
        many = (each[rows] for each in (self.slopes, self.misses, self.trust, self.shared))
        return _Pokes(self.of[rows], self.folds[rows], *many)

    def left(self, prior: _Prior, factors: FloatArray) -> tuple[list[_Prior], BoolArray]:
        """Return what each fold's pokes leave of the prior when out, and (folds, b) whether the others determine a module.

        Where they do not, none of it is out.
        """
        weighted = self.trust[:, None, None] * self.slopes.transpose(0, 2, 1)
        pulls = (weighted @ self.misses[:, :, None])[:, :, 0]
        held, pulls, shared = (
            self._sums(each, len(factors)) for each in (weighted @ self.slopes, pulls, weighted @ self.shared)
        )
        others = 1.0 - np.eye(FOLDS)
        left, whole = np.tensordot(others, held, 1), held.sum(axis=0)
        values = np.linalg.eigvalsh(left)
        known = np.asarray(values[..., 0] > NO_RANK * values[..., -1])
        inverse = np.asarray(np.linalg.inv(np.where(known[..., None, None], left, whole)), dtype=np.float64)
        more = factors[:, None, None] * (inverse - np.asarray(np.linalg.inv(whole), dtype=np.float64))
        # At the minimum the pulls of all pokes cancel but for rounding.
        means = -(inverse @ np.where(known[..., None], pulls, 0.0)[..., None])[..., 0]
        moves = -inverse @ np.where(known[..., None, None], np.tensordot(others, shared, 1), shared.sum(axis=0))
        covariances = prior.covariances + more
        return [_Prior(means[fold], covariances[fold], moves[fold]) for fold in range(FOLDS)], known

    def _sums(self, values: FloatArray, count: int) -> FloatArray:
        """Return (folds, b, ...) the sums of values (m, ...) over the pokes of each fold and module."""
        sums = np.zeros((FOLDS, count, *values.shape[1:]))
        np.add.at(sums, (self.folds, self.of), values)
        return sums


def _end(model: ModuleModel, told: KnownDistance, side: int) -> tuple[int, FloatArray]:
    """Return the module at one end of a distance, and where the end is in its plane, (2,) metres."""
    end = told.ends[side]
    if told.of_taxels:
        module = int(model.layout.module_of[end])
        return module, model.pads[module][model.place_of[end]]
    return [module.id for module in model.layout.modules].index(end), np.zeros(2)


def _bend(pads: FloatArray, point: FloatArray, radius: float) -> float:
    """Return how far skin of a radius lies over the plane that is nearest to its pads (n, 2), at a point (2,); metres."""
    squares = [float(np.sum((places - pads.mean(axis=0)) ** 2)) for places in (pads, point)]
    return (squares[0] / len(pads) - squares[1]) / (2.0 * radius)


def _log_densities(misses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return (m,) the logarithms of the normal densities of misses (m, 2), but for a constant."""
    squares = np.sum(misses * np.linalg.solve(covariances, misses[:, :, None])[:, :, 0], axis=1)
    return np.asarray(-0.5 * (squares + np.log(np.linalg.det(covariances))), dtype=np.float64)


def apply_distances(
    model: ModuleModel, modules: Mapping[int, FittedModule], estimates: Mapping[int, Estimate], noise: NoiseSettings
) -> tuple[dict[int, Estimate], tuple[TriedDistance, ...]]:
    """Refine modules by the known distances of `model`.

    Parameters
    ----------
    modules : those that their own pokes place, by index
    estimates : of their taxels, by channel, from these pokes alone
    noise : of the scene

    Returns
    -------
    The estimates that distances change, by channel; and of each distance, in their order, whether it is used.
    """
    told = [distance for distance in model.distances if all(_end(model, distance, side)[0] in modules for side in (0, 1))]
    tried = {distance: TriedDistance(distance, DistanceUse.UNKNOWN) for distance in model.distances}
    if not told:
        return {}, tuple(tried.values())
    all_ = _Joined(model, modules, told, noise.radius)
    alone = _Update.of(all_.prior, all_.plain)
    uses = [DistanceUse.USED] * len(told)
    solved = _helping(all_, _agreeing(all_, uses), uses)
    sds = np.sqrt(np.einsum("kbd,kbd->k", alone.seen, all_.plain.slopes) + all_.plain.variances)
    for distance, use, off, sd in zip(told, uses, alone.off.tolist(), sds.tolist(), strict=True):
        tried[distance] = TriedDistance(distance, use, distance.length - off, sd)
    found = _moved(all_, solved, model, estimates) if len(solved.kept) else {}
    return found, tuple(tried.values())


def _agreeing(all_: _Joined, uses: list[DistanceUse]) -> _Solved:
    """Solve with the distances that agree with pokes and each other; note in `uses` which do not."""
    solved = all_.solved(np.arange(len(uses)))
    while len(solved.kept):
        update = solved.update
        pull, known = update.inverse @ update.off, np.diag(update.inverse)
        # What all others say of one: off by pull/known, with the variance 1/known.
        squares = pull**2 / known
        worst = int(squares.argmax())
        if squares[worst] <= FULL**2:
            break
        uses[int(solved.kept[worst])] = DistanceUse.OFF
        solved = all_.solved(np.delete(solved.kept, worst))
    return solved


def _helping(all_: _Joined, solved: _Solved, uses: list[DistanceUse]) -> _Solved:
    """Solve with those of the distances with which held-out pokes are likelier; note in `uses` which do not help."""
    kept = solved.kept
    if not len(kept):
        return solved
    group = np.arange(len(all_.modules))
    for one, other in all_.ends[kept].tolist():
        group[group == group[other]] = group[one]
    gains = np.bincount(group, all_.gains(solved.rows), len(group))
    helps = gains[group[all_.ends[kept, 0]]] > 0.0
    for row in kept[~helps].tolist():
        uses[row] = DistanceUse.NO_BETTER
    return solved if helps.all() else all_.solved(kept[helps])


def _moved(all_: _Joined, solved: _Solved, model: ModuleModel, estimates: Mapping[int, Estimate]) -> dict[int, Estimate]:
    """Return the estimates of the modules' taxels under distances, of which there are some."""
    prior, update = all_.prior, solved.update
    pull = np.einsum("kbd,kl->bdl", update.seen, update.inverse)
    moves = prior.moves - pull @ update.of_shared
    total = prior.covariances + prior.moves @ prior.moves.transpose(0, 2, 1) - pull @ update.seen.transpose(1, 0, 2)
    own = total - moves @ moves.transpose(0, 2, 1)
    ends: list[int] = np.unique(all_.ends[solved.kept]).tolist()
    pads = [model.pads[all_.modules[b]] for b in ends]
    of = np.repeat(ends, [len(each) for each in pads])
    channels = [int(channel) for b in ends for channel in model.layout.modules[all_.modules[b]].channels]
    laid = model.ground.place_pads(all_.moved(solved.x).take(of), np.concatenate(pads))
    outward = all_.heights[of][:, None, None] * laid.normals[:, :, None] * laid.normals[:, None]
    covariances = laid.gradients @ own[of] @ laid.gradients.transpose(0, 2, 1) + outward
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
    shared = (laid.gradients @ moves[of])[at] if moves.shape[2] else None
    return {estimate.channel: estimate for estimate in add_covariances(there, np.zeros(len(at)), covariances[at], shared)}
