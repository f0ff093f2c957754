"""Known distances between modules as priors: modules that distances join are refined together, from their own fits.

Each module's own pokes leave its d unknowns with a covariance, and errors of the rig that all pokes share move them,

    x_a = y_a + M_a s,   y_a ~ N(0, C_a) independent,   s ~ N(0, I),

so x has the covariance P = diag(C) + M M'. A distance D between points p of two modules, known to sd, is a row with the
gradient J of |p_a - p_b|. The Gauss-Newton step for all of them is, with S = J P J' + R and the gain K = P J' S^-1,

    x = K (D - |p_a - p_b| + J x),   (I - K J) M for M,   (I - K J) C (I - K J)' + K R K' for C.

**Rounding.** The usual P - K S K' cancels: pokes in nearly one direction leave a P a thousand times as large as the result.
The form above (Joseph's) is a sum of squares, and an error of K changes the total covariance by its square. The gain comes from
QR, with P = A A' and A = [roots of C, M], since forming S squares its condition:

    [J A, sqrt R]' = Q U,   S = U'U,   K = A Q_A U'^-1,   Q_A the rows of Q that belong to A.

R is sd^2 plus, along the distance, the variance of the mesh's error (`off_surface`) or, without a mesh, of the height of the
bent skin over its module, which is modelled flat. This is least squares over all pokes and distances, exact up to the curvature
of the pokes' rows over the step.

**Which distances are used.** One that contradicts pokes and the other distances is left out. The others are tried on held-out
pokes: each sixth of every module's pokes is taken out of its information N in turn, N_F = N - sum t A'A, and predicted by the
others, with and without distances, as in `skincal.modules.estimate`; errors that pokes share are common to both. Distances that
join the same modules are used if these pokes are likelier with them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray, select_rows
from skincal.model.scene import KnownDistance, NoiseSettings
from skincal.modules.estimate import FittedModule
from skincal.modules.pose import ModuleModel, ModulePoses, ModulesInSpace, join_poses
from skincal.modules.pose_fit import MIN_SINGULAR_VALUE_RATIO
from skincal.solver.tables import FULL_TRUST_SDS
from skincal.taxels.result import Estimate
from skincal.taxels.shared_errors import add_covariances

GAUSS_NEWTON_STEPS = 3
"""A module moves by a millimetre, over which a distance is nearly linear."""
HELD_OUT_FOLDS = 6
"""One poke in this many is held out at a time, as for the verdict."""


class DistanceUse(Enum):
    """Use of a known distance, or the reason why it is not used."""

    USED = "used"
    UNKNOWN = "a module of it is not known"
    OFF = "pokes and other distances lie too far off it"
    NO_BETTER = "held-out pokes are predicted no better with it"


@dataclass(frozen=True, slots=True)
class TriedDistance:
    """A known distance, and its estimate by the pokes alone."""

    distance: KnownDistance
    use: DistanceUse
    found: float | None = None
    """m, by the pokes; `None` if a module has no pose."""
    sd: float | None = None
    """m, predicted, of the difference between `found` and the known length."""

    @property
    def used(self) -> bool:
        """Whether the distance correction is used."""
        return self.use is DistanceUse.USED


@dataclass(frozen=True, slots=True, eq=False)
class _Prior:
    """Distribution of the unknowns of b modules by their pokes: x = mean + y + M s."""

    means: FloatArray
    """(b, d) float, metres."""
    covariances: FloatArray
    """(b, d, d) float, m^2, of y."""
    moves: FloatArray
    """(b, d, n) float, metres, M."""


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """k known distances, linearized at the unknowns x."""

    slopes: FloatArray
    """(k, b, d) float, J."""
    left: FloatArray
    """(k,) float, metres: D - |p_a - p_b| + J x, the wanted value of J x."""
    variances: FloatArray
    """(k,) float, m^2, R."""

    def select(self, rows: IntArray) -> _Rows:
        return _Rows(self.slopes[rows], self.left[rows], self.variances[rows])


class _Update:
    """Kalman update of a prior by zero or more rows, in square roots."""

    def __init__(self, prior: _Prior, rows: _Rows) -> None:
        flat = rows.slopes.reshape(len(rows.left), prior.means.size)
        self._prior, self._roots, self._sds = prior, _roots(prior.covariances), np.sqrt(rows.variances)
        self._of_own: FloatArray = (rows.slopes.transpose(1, 0, 2) @ self._roots).transpose(1, 0, 2).reshape(flat.shape)
        self.of_shared: FloatArray = flat @ prior.moves.reshape(flat.shape[1], -1)
        """(k, n) float, metres, J M."""
        by_root, root = np.linalg.qr(np.concatenate([self._of_own, self.of_shared, np.diag(self._sds)], axis=1).T)
        self.whiten: FloatArray = np.asarray(np.linalg.inv(root), dtype=np.float64)
        """(k, k) float, 1/m, U^-1: S^-1 = U^-1 U'^-1."""
        self.variances: FloatArray = np.sum(root * root, axis=0)
        """(k,) float, m^2, diagonal of S: of each row's miss before the rows count."""
        self.off: FloatArray = rows.left - flat @ prior.means.ravel()
        """(k,) float, metres: misses of the rows before they count."""
        self.whitened: FloatArray = self.whiten.T @ self.off
        """(k,) float, in standard deviations: the misses as independent ones, U'^-1 off."""
        own, shared = np.split(by_root[: len(by_root) - len(flat)], [flat.shape[1]])
        self._whitened_gains: FloatArray = self._roots @ own.reshape(*prior.means.shape, -1) + prior.moves @ shared
        """(b, d, k) float, metres, A Q_A = K U'."""

    @property
    def steps(self) -> FloatArray:
        """(b, d) float, metres: change of the unknowns of each module by the distances."""
        return self._whitened_gains @ self.whitened

    @property
    def shared_shifts(self) -> FloatArray:
        """(b, d, n) float, metres: M under the distances."""
        return self._prior.moves - self._whitened_gains @ (self.whiten.T @ self.of_shared)

    @property
    def covariances(self) -> FloatArray:
        """(b, d, d) float, m^2: C of each module under the distances."""
        count, unknowns = self._prior.means.shape
        gains = self._whitened_gains @ self.whiten.T
        kept: FloatArray = -(gains @ self._of_own).reshape(count, unknowns, count, unknowns)
        at = np.arange(len(kept))
        kept[at, :, at] += self._roots
        roots = np.concatenate([kept.reshape(count, unknowns, -1), gains * self._sds], axis=2)
        return roots @ roots.transpose(0, 2, 1)


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """Modules under some of the distances: their indices, rows near the solution, and the update."""

    used: IntArray
    rows: _Rows
    update: _Update


class LinkedModules:
    """Modules that distances join, as their own pokes place them."""

    def __init__(
        self, model: ModuleModel, modules: Mapping[int, FittedModule], distances: Sequence[KnownDistance], radius: float
    ) -> None:
        ends = [[_end(model, distance, side) for side in (0, 1)] for distance in distances]
        self.modules = sorted({module for pair in ends for module, _ in pair})
        self.fitted = [modules[module] for module in self.modules]
        self._model, self._distances = model, distances
        self.ends: IntArray = np.array([[self.modules.index(module) for module, _ in pair] for pair in ends])
        """(k, 2) index of the module at each end of each distance."""
        self._flat = np.array([point for pair in ends for _, point in pair])
        self._poses = join_poses([own.pose for own in self.fitted])
        self.heights: FloatArray = np.array([own.height for own in self.fitted])
        """(b,) float, m^2, of `FittedModule`."""
        # (k, 2) m^2: variance of each end along the normal there.
        self._off = self.heights[self.ends]
        if isinstance(model.ground, ModulesInSpace):
            self._off = np.array([[_bend(model.pads[module], point, radius) for module, point in pair] for pair in ends]) ** 2
        self._factors = np.array([own.factor for own in self.fitted])
        self.prior = _Prior(
            np.zeros((len(self.fitted), model.ground.unknowns)),
            np.array([own.covariance for own in self.fitted]),
            np.array([own.moves for own in self.fitted]),
        )
        self.plain = self._rows(self.prior.means)
        """All distances at the poses by the pokes."""

    def move_modules(self, x: FloatArray) -> ModulePoses:
        """Poses (b,) of the modules at `x` (b, d), metres."""
        return self._model.ground.move(self._poses, x)

    def _rows(self, x: FloatArray) -> _Rows:
        """Linearize all distances at `x` (b, d), metres."""
        count = len(self.ends)
        pads = self._model.ground.place_pads(self.move_modules(x).select(self.ends.ravel()), self._flat)
        points, normals = pads.points.reshape(count, 2, 3), pads.normals.reshape(count, 2, 3)
        way = points[:, 0] - points[:, 1]
        length = np.linalg.norm(way, axis=1)
        along = way / length[:, None]
        gradients = np.einsum("kc,kscd->ksd", along, pads.gradients.reshape(count, 2, 3, -1))
        slopes, at = np.zeros((count, *x.shape)), np.arange(count)
        slopes[at, self.ends[:, 0]], slopes[at, self.ends[:, 1]] = gradients[:, 0], -gradients[:, 1]
        variances = np.array([distance.sd**2 for distance in self._distances])
        variances = variances + np.sum(self._off * np.einsum("ksc,kc->ks", normals, along) ** 2, axis=1)
        left = np.array([distance.length for distance in self._distances]) - length + np.einsum("kbd,bd->k", slopes, x)
        return _Rows(slopes, left, variances)

    def solve(self, used: IntArray) -> _Solved:
        """Solve the modules under the distances `used`."""
        rows = self.plain.select(used)
        update = _Update(self.prior, rows)
        for _ in range(GAUSS_NEWTON_STEPS - 1):
            rows = self._rows(update.steps).select(used)
            update = _Update(self.prior, rows)
        return _Solved(used, rows, update)

    def gains(self, rows: _Rows) -> FloatArray:
        """Compute (b,) the gain in log likelihood of the held-out pokes of each module by the distances."""
        pokes = _HeldOutPokes.of_modules(self.fitted)
        left, known = pokes.priors_without_folds(self.prior, self._factors)
        outs = [pokes.select((pokes.folds == fold) & known[fold, pokes.of]) for fold in range(HELD_OUT_FOLDS)]
        return np.sum([self._gains_of(prior, rows, out) for prior, out in zip(left, outs, strict=True)], axis=0)

    def _gains_of(self, prior: _Prior, rows: _Rows, out: _HeldOutPokes) -> FloatArray:
        """Compute `gains` by the pokes `out`, predicted from `prior`, the other pokes of their modules."""
        update, of, slopes = _Update(prior, rows), out.of, out.slopes
        covariances = prior.covariances[of]
        shared = slopes @ prior.moves[of] + out.shared
        # Covariance of the poke's two rows with each distance.
        own = prior.covariances @ rows.slopes.transpose(1, 2, 0)
        both = slopes @ own[of] + shared @ update.of_shared.T
        miss = out.misses - (slopes @ prior.means[of][:, :, None])[:, :, 0]
        spread = slopes @ covariances @ slopes.transpose(0, 2, 1) + shared @ shared.transpose(0, 2, 1)
        spread = spread + self._factors[of][:, None, None] * np.eye(2)
        # One large product: many small ones take twice as long.
        known = (both.reshape(-1, len(update.off)) @ update.whiten).reshape(both.shape)
        less, explained = known @ known.transpose(0, 2, 1), known @ update.whitened
        likelier = _log_densities(miss - explained, spread - less) - _log_densities(miss, spread)
        return np.asarray(np.bincount(of, out.trust * likelier, len(self.fitted)), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _HeldOutPokes:
    """m pokes of b modules, as `FittedModule` has them, in folds."""

    of: IntArray
    """(m,) module."""
    folds: IntArray
    """(m,) fold that holds a poke out."""
    slopes: FloatArray
    misses: FloatArray
    trust: FloatArray
    shared: FloatArray

    @classmethod
    def of_modules(cls, fitted: Sequence[FittedModule]) -> _HeldOutPokes:
        counts = [len(own.trust) for own in fitted]
        return cls(
            np.repeat(np.arange(len(fitted)), counts),
            np.concatenate([np.arange(count) % HELD_OUT_FOLDS for count in counts]),
            *(np.concatenate(each) for each in zip(*((m.slopes, m.misses, m.trust, m.shared) for m in fitted), strict=True)),
        )

    def select(self, rows: NDArray[np.bool_]) -> _HeldOutPokes:
        return select_rows(self, rows)

    def priors_without_folds(self, prior: _Prior, factors: FloatArray) -> tuple[list[_Prior], NDArray[np.bool_]]:
        """Compute the prior without each fold's pokes, and (folds, b) whether the others determine a module.

        If they do not, its prior stays whole.
        """
        weighted = self.trust[:, None, None] * self.slopes.transpose(0, 2, 1)
        pulls = (weighted @ self.misses[:, :, None])[:, :, 0]
        information, pulls, shared = (
            self._sums(each, len(factors)) for each in (weighted @ self.slopes, pulls, weighted @ self.shared)
        )
        others = 1.0 - np.eye(HELD_OUT_FOLDS)
        left, whole = np.tensordot(others, information, 1), information.sum(axis=0)
        values = np.linalg.eigvalsh(left)
        known = np.asarray(values[..., 0] > MIN_SINGULAR_VALUE_RATIO * values[..., -1])
        inverse = np.asarray(np.linalg.inv(np.where(known[..., None, None], left, whole)), dtype=np.float64)
        more = factors[:, None, None] * (inverse - np.asarray(np.linalg.inv(whole), dtype=np.float64))
        # At the minimum the pulls of all pokes cancel but for rounding.
        means = -(inverse @ np.where(known[..., None], pulls, 0.0)[..., None])[..., 0]
        moves = -inverse @ np.where(known[..., None, None], np.tensordot(others, shared, 1), shared.sum(axis=0))
        covariances = prior.covariances + more
        return [_Prior(means[fold], covariances[fold], moves[fold]) for fold in range(HELD_OUT_FOLDS)], known

    def _sums(self, values: FloatArray, count: int) -> FloatArray:
        """Sum values (m, ...) over the pokes of each fold and module: (folds, b, ...)."""
        sums = np.zeros((HELD_OUT_FOLDS, count, *values.shape[1:]))
        np.add.at(sums, (self.folds, self.of), values)
        return sums


def _end(model: ModuleModel, distance: KnownDistance, side: int) -> tuple[int, FloatArray]:
    """Find the module at one end of a distance, and the end in its plane, (2,) metres."""
    end = distance.ends[side]
    if distance.of_taxels:
        module = int(model.layout.module_of[end])
        return module, model.pads[module][model.place_of[end]]
    return [module.id for module in model.layout.modules].index(end), np.zeros(2)


def _bend(pads: FloatArray, point: FloatArray, radius: float) -> float:
    """Compute the height of skin of a radius over the best plane of its pads (n, 2), at a point (2,); metres."""
    squares = [float(np.sum((places - pads.mean(axis=0)) ** 2)) for places in (pads, point)]
    return (squares[0] / len(pads) - squares[1]) / (2.0 * radius)


def _roots(covariances: FloatArray) -> FloatArray:
    """Compute roots (b, d, d), root root' = covariance, of covariances that rounding may have made indefinite.

    Each unknown is scaled to a variance of 1. So the errors are those of Cholesky's roots, relative to each variance.
    """
    scales = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))[:, :, None]
    values, axes = np.linalg.eigh(covariances / (scales * scales.transpose(0, 2, 1)))
    return np.asarray(scales * axes * np.sqrt(np.maximum(values, 0.0))[:, None], dtype=np.float64)


def _log_densities(misses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Compute (m,) the log normal densities of misses (m, 2), up to a constant."""
    squares = np.sum(misses * np.linalg.solve(covariances, misses[:, :, None])[:, :, 0], axis=1)
    return np.asarray(-0.5 * (squares + np.log(np.linalg.det(covariances))), dtype=np.float64)


def apply_distances(
    model: ModuleModel, modules: Mapping[int, FittedModule], estimates: Mapping[int, Estimate], noise: NoiseSettings
) -> tuple[dict[int, Estimate], tuple[TriedDistance, ...]]:
    """Refine modules by the known distances of `model`.

    Parameters
    ----------
    modules : with a pose by their own pokes, by index
    estimates : of their taxels, by channel, from these pokes alone
    noise : of the scene

    Returns
    -------
    The estimates that distances change, by channel; and the use of each distance, in their order.
    """
    tried = {distance: TriedDistance(distance, DistanceUse.UNKNOWN) for distance in model.distances}
    known = [distance for distance in tried if all(_end(model, distance, side)[0] in modules for side in (0, 1))]
    if not known:
        return {}, tuple(tried.values())
    linked = LinkedModules(model, modules, known, noise.radius)
    alone = _Update(linked.prior, linked.plain)
    uses = [DistanceUse.USED] * len(known)
    solved = _drop_useless(linked, _drop_contradicting(linked, uses), uses)
    for distance, use, off, sd in zip(known, uses, alone.off.tolist(), np.sqrt(alone.variances).tolist(), strict=True):
        tried[distance] = TriedDistance(distance, use, distance.length - off, sd)
    found = _refine_estimates(linked, solved, model, estimates) if len(solved.used) else {}
    return found, tuple(tried.values())


def _drop_contradicting(linked: LinkedModules, uses: list[DistanceUse]) -> _Solved:
    """Solve with the distances that agree with pokes and each other; note the others in `uses`."""
    solved = linked.solve(np.arange(len(uses)))
    while len(solved.used):
        update = solved.update
        pull, known = update.whiten @ update.whitened, np.sum(update.whiten**2, axis=1)
        # Each one differs from the prediction of all others by pull/known, with the variance 1/known.
        squares = pull**2 / known
        worst = int(squares.argmax())
        if squares[worst] <= FULL_TRUST_SDS**2:
            break
        uses[int(solved.used[worst])] = DistanceUse.OFF
        solved = linked.solve(np.delete(solved.used, worst))
    return solved


def _drop_useless(linked: LinkedModules, solved: _Solved, uses: list[DistanceUse]) -> _Solved:
    """Solve with the distances that make held-out pokes likelier; note the others in `uses`."""
    used = solved.used
    if not len(used):
        return solved
    group = np.arange(len(linked.modules))
    for one, other in linked.ends[used].tolist():
        group[group == group[other]] = group[one]
    gains = np.bincount(group, linked.gains(solved.rows), len(group))
    helps = gains[group[linked.ends[used, 0]]] > 0.0
    for row in used[~helps].tolist():
        uses[row] = DistanceUse.NO_BETTER
    return solved if helps.all() else linked.solve(used[helps])


def _refine_estimates(
    linked: LinkedModules, solved: _Solved, model: ModuleModel, estimates: Mapping[int, Estimate]
) -> dict[int, Estimate]:
    """Make the estimates of the modules' taxels under some distances."""
    update = solved.update
    own, moves = update.covariances, update.shared_shifts
    ends: list[int] = np.unique(linked.ends[solved.used]).tolist()
    pads = [model.pads[linked.modules[b]] for b in ends]
    of = np.repeat(ends, [len(each) for each in pads])
    channels = [int(channel) for b in ends for channel in model.layout.modules[linked.modules[b]].channels]
    laid = model.ground.place_pads(linked.move_modules(update.steps).select(of), np.concatenate(pads))
    outward = linked.heights[of][:, None, None] * laid.normals[:, :, None] * laid.normals[:, None]
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
