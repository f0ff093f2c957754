"""Fit of a soft sheet: its pose on the surface and its deformation (`sheet_basis.py`), from the pokes on all its taxels.

The taxels lie at the ends of the geodesics that leave the pose for the deformed plane positions b + d(b). With the whitened
rows A of the pokes by all unknowns x (three of the pose, three strains, the modes), their misses r, their trust T and the prior
precisions P of the strains and modes (none of the pose), the search minimises

    r'T r / f + x'P x,   step = (A'T A / f + P)^-1 (A'T r / f - P x),

f the pokes' variance over that of the scene's noise. The covariance of x is C = (A'T A / f + P)^-1; that of a taxel is G C G'
with G its derivative by x. So it contains the pose, the stretch, and the part of each taxel that its neighbours do not explain,
and grows with the distance to the touched taxels.

**The scales** are those of the deformation, k and s, and f. Each combination of `STRETCH_SCALES`, `FIELD_SCALES` and
`NOISE_FACTORS` has the likelihood of the pokes, with all unknowns integrated out,

    2 log L = log det P - log det N + g'N^-1 g - y'T y / f - n log f,   N = A'T A / f + P,   g = A'T y / f,

y the misses of the undeformed sheet at this pose, and n twice the sum of the trust. The used k^2, s^2 and f are the means over
all combinations, weighted by likelihood and prior. A mean of variances is more than the likeliest one, so few pokes claim
little.

**Trust** is as for boards, but each poke is compared with its prediction by the others, or a poke far from all others would
draw the sheet to itself. With H = A_i C A_i' and Q = H (1 - t H)^-1 its miss from that prediction is (1 + t Q) r_i, with the
covariance 1 + Q.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from skincal.chi_square import CHI2_1DOF_MEDIAN, CHI2_2DOF_MEDIAN
from skincal.geometry import FloatArray, IntArray, dots
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import ModuleModel, ModulePoses, ModulesOnSurface, Pads
from skincal.modules.pose_fit import (
    MIN_POKES_PER_ARM_POSE,
    POSE_SEARCH_MAX_STEP_M,
    ModuleRows,
    Touches,
    fit_modules_from_pokes,
    trust_from_squares,
    whitened_rows,
)
from skincal.modules.sheet_basis import SheetBasis, make_basis
from skincal.solver.tables import (
    FULL_WEIGHT_MAX_MISS_SDS,
    MIN_POKES_FOR_TRUST,
    MIN_SUM_OF_POKE_TRUSTS,
    SMALL_SAMPLE_SPREAD_CORRECTION,
)
from skincal.taxels.contact_table import Evidence
from skincal.taxels.result import Estimate

STRETCH_SCALES = (1.0, 3.0)
STRETCH_PRIORS = (0.75, 0.25)
"""A sheet is stretched by 1 %, and in one case of four by 3 %."""
FIELD_SCALES = (1.0, 2.0, 4.0)
FIELD_PRIORS = (0.40, 0.35, 0.25)
"""No hand glues a sheet better than to 1 mm over 100 mm; a fold of 2 mm in a sheet of 60 mm looks like 2 to 4 mm. With smaller
scales, or less weight on the large ones, 83 to 88 % of the taxels of that sheet are inside after two pokes a taxel."""
NOISE_FACTORS = (0.5, 1.0, 2.0, 4.0, 8.0)
NOISE_PRIORS = (0.15, 0.60, 0.19, 0.05, 0.01)
"""The scene's noise is usually right; a rig with wrong arm poses has eight times its variance."""
FIRST_SCALES = (2.0, 2.0, 1.0)
"""k, s and f while the search begins."""
POSE_MAX_SD_M = 0.3
"""Weak prior of a step of the pose: it keeps few pokes from having no answer at all, and changes none."""
ROBUST_SHEET_SEARCH_STEPS = 3
"""Steps before trust is given: one fewer than on boards, since the rigid pose is the start."""
SHEET_SEARCH_MAX_STEPS = 12
SHEET_SEARCH_CONVERGED_STEP_M = 1e-7
"""As on boards: smaller steps go to and fro over edges of the mesh."""


@dataclass(frozen=True, slots=True, eq=False)
class SheetFit:
    """A sheet with n taxels as its m pokes place it; p unknowns."""

    module: int
    """Index in the layout."""
    touches: Touches
    """Of this sheet alone; m pokes in the order of their numbers."""
    basis: SheetBasis
    pose: ModulePoses
    """One."""
    coefficients: FloatArray
    """(p - 3,) float, metres, of `SheetBasis`."""
    pads: Pads
    """(n) positions, with gradients (n, 3, p) by all unknowns."""
    rows: ModuleRows
    """(m) in standard deviations of the found noise, with slopes (m, 2, p); without `bends`."""
    trust: FloatArray
    """(m,) float, 0 to 1."""
    information: FloatArray
    """(p, p) float, 1/m^2: of the pokes and the prior."""
    covariance: FloatArray
    """(p, p) float, m^2: its inverse."""
    scales: tuple[float, float, float]
    """k, s and f."""
    moving: float
    """metres: last step of a search that did not converge, else 0."""

    @property
    def left_out(self) -> FloatArray:
        """(n,) float, m^2: variance of each taxel, along the surface, that no poke reduces."""
        return self.scales[1] ** 2 * self.basis.left_out

    @property
    def miss(self) -> float:
        """Rms distance, metres, of the axes from the centres of the pads that answered, weighted by trust."""
        off = self._distances()
        return float(np.sqrt(self.trust @ np.sum(off * off, axis=1) / self.trust.sum()))

    def _distances(self) -> FloatArray:
        return np.asarray(np.linalg.solve(self.rows.whiten, self.rows.misses[:, :, None])[:, :, 0], dtype=np.float64)

    def without_each(self) -> tuple[FloatArray, FloatArray]:
        """Misses (m, 2) of each poke from the prediction of the others, and their covariances (m, 2, 2), in its noise's sds."""
        return _without_each(self.rows, self.trust, self.covariance)


def fit_sheets(
    evidence: Evidence,
    totals: FloatArray,
    model: ModuleModel,
    noise: NoiseSettings,
    others: Sequence[Mapping[int, Estimate]],
    doubting: bool = True,
) -> list[SheetFit]:
    """Fit all sheets that pokes touched; arguments as for `fit_modules_from_pokes`, whose rigid poses are the start."""
    start = fit_modules_from_pokes(evidence, totals, model, noise, others, doubting)
    if start is None:
        return []
    touches, fitted = start
    sheets: list[SheetFit] = []
    for index, module in enumerate(touches.modules.tolist()):
        own = _touches_of(touches, index, np.flatnonzero(fitted.of == index))
        sheets.append(_Search(own, model, module, fitted.poses.select(np.array([index])), noise).find_fit(doubting))
    return sheets


def basis_of(model: ModuleModel, module: int) -> SheetBasis:
    """Get the basis of a sheet of a model; it is made once."""
    if module not in model.bases:
        model.bases[module] = make_basis(model.pads[module])
    return model.bases[module]


def _touches_of(touches: Touches, index: int, pads: IntArray) -> Touches:
    """Select the pokes on one module, with `pads` among those of all."""
    own = np.flatnonzero(touches.of == index)
    ends = np.append(touches.starts, len(touches.answers))
    first, last = ends[own[0]], ends[own[-1] + 1]
    return Touches(
        modules=touches.modules[[index]],
        of=np.zeros(len(own), dtype=np.int64),
        rows=touches.rows[own],
        evidence=touches.evidence,
        offsets=touches.offsets[own],
        answers=touches.answers[first:last] - pads[0],
        shares=touches.shares[first:last],
        channels=touches.channels[pads],
        starts=touches.starts[own] - first,
    )


class _Search:
    """Search for one sheet."""

    def __init__(self, touches: Touches, model: ModuleModel, module: int, pose: ModulePoses, noise: NoiseSettings) -> None:
        assert isinstance(model.ground, ModulesOnSurface)
        self._ground, self._module = model.ground, module
        self._all, self._noise, self._whole = touches, noise, basis_of(model, module)
        # The search lays the touched taxels alone: on a large sheet these are few.
        touched, answers = np.unique(touches.answers, return_inverse=True)
        self._touches, self._basis = replace(touches, answers=answers), self._whole.select(touched)
        self._count = len(touches.of)
        self._poke_of_answer = np.repeat(np.arange(self._count), np.diff(np.append(touches.starts, len(touches.answers))))
        self._pose, self._coefficients = pose, np.zeros(self._basis.unknowns)
        self._scales = FIRST_SCALES
        self._lay()

    def _lay(self) -> None:
        """Lay the taxels, and linearize the pokes there."""
        self._pads = self._place(self._basis)
        rows = whitened_rows(self._touches, self._pads, self._noise)
        across = rows.whiten @ self._touches.evidence.pairs[self._touches.rows]
        answers = self._touches.answers
        # Derivative of each answer's share of the rows by the displacement of its taxel in the plane.
        moved = self._touches.shares[:, None, None] * (across[self._poke_of_answer] @ self._pads.gradients[answers][:, :, :2])
        fields = moved[:, :, None] * self._basis.modes[answers][:, None, :, None]
        each = np.concatenate([moved @ self._basis.strains[answers], fields.reshape(*moved.shape[:2], -1)], axis=2)
        slopes = np.concatenate([rows.slopes, np.add.reduceat(each, self._touches.starts)], axis=2)
        self._rows = ModuleRows(slopes, rows.misses, rows.whiten, rows.normals, rows.bends)

    def _place(self, basis: SheetBasis) -> Pads:
        flat = basis.displaced(self._coefficients)
        return self._ground.place_pads(self._pose.select(np.zeros(len(flat), dtype=np.int64)), flat)

    def find_fit(self, doubting: bool) -> SheetFit:
        weights = np.ones(self._count)
        if doubting and self._count >= MIN_POKES_FOR_TRUST:
            for _ in range(ROBUST_SHEET_SEARCH_STEPS):
                squares = self._squares(weights) + self._pitches()
                weights = FULL_WEIGHT_MAX_MISS_SDS**2 / np.maximum(squares, FULL_WEIGHT_MAX_MISS_SDS**2)
                self._take_step(weights)
            weights = self._trust(weights)
        last = np.inf
        for step in range(SHEET_SEARCH_MAX_STEPS):
            last = self._take_step(weights)
            if step == 0:
                self._scales = self._learned(weights)
            elif last <= SHEET_SEARCH_CONVERGED_STEP_M:
                break
        return self._result(weights, last if last > SHEET_SEARCH_CONVERGED_STEP_M else 0.0)

    def _precisions(self) -> FloatArray:
        of_pose = np.full(3, POSE_MAX_SD_M**-2)
        return np.concatenate([of_pose, self._basis.precisions(*self._scales[:2])])

    def _information(self, weights: FloatArray) -> FloatArray:
        """Compute (p, p) the information of the pokes, 1/m^2, by the scene's noise."""
        flat = (np.sqrt(weights)[:, None, None] * self._rows.slopes).reshape(2 * self._count, -1)
        return flat.T @ flat

    def _pull(self, weights: FloatArray, misses: FloatArray) -> FloatArray:
        return np.einsum("mrp,mr->p", self._rows.slopes, weights[:, None] * misses)

    def _take_step(self, weights: FloatArray) -> float:
        """Take one step; return its largest displacement, metres."""
        prior, factor = self._precisions(), self._scales[2]
        whole = self._information(weights) / factor + np.diag(prior)
        pull = self._pull(weights, self._rows.misses) / factor
        pull[3:] -= prior[3:] * self._coefficients
        step = np.asarray(np.linalg.solve(whole, pull), dtype=np.float64)
        largest = float(np.abs(step).max())
        step = step * min(1.0, POSE_SEARCH_MAX_STEP_M / largest if largest > 0 else 1.0)
        self._pose = self._ground.move(self._pose, step[None, :3])
        self._coefficients = self._coefficients + step[3:]
        self._lay()
        return largest

    def _learned(self, weights: FloatArray) -> tuple[float, float, float]:
        """Find the scales k, s and f by the likelihood of the pokes."""
        information, flat = self._information(weights), self._rows.misses + self._rows.slopes[:, :, 3:] @ self._coefficients
        pull, square, count = (
            self._pull(weights, flat),
            float(weights @ np.sum(flat * flat, axis=1)),
            2.0 * float(weights.sum()),
        )
        tried = np.array(list(product(STRETCH_SCALES, FIELD_SCALES, NOISE_FACTORS)))
        priors = np.array([np.prod(each) for each in product(STRETCH_PRIORS, FIELD_PRIORS, NOISE_PRIORS)])
        precisions = np.array([self._basis.precisions(k, s) for k, s in tried[:, :2]])
        factors = tried[:, 2]
        every = information / factors[:, None, None]
        at = np.arange(len(information))
        every[:, at, at] += np.concatenate([np.full((len(tried), 3), POSE_MAX_SD_M**-2), precisions], axis=1)
        roots = np.linalg.cholesky(every)
        solved = np.linalg.solve(roots, np.broadcast_to((pull / factors[:, None])[:, :, None], (len(tried), len(pull), 1)))
        twice = (
            np.sum(np.log(precisions), axis=1) - 2.0 * np.sum(np.log(np.diagonal(roots, axis1=1, axis2=2)), axis=1)
            + np.sum(solved[:, :, 0] ** 2, axis=1) - square / factors - count * np.log(factors)
        )  # fmt: skip
        odds = priors * np.exp(0.5 * (twice - twice.max()))
        odds = odds / odds.sum()
        return float(np.sqrt(odds @ tried[:, 0] ** 2)), float(np.sqrt(odds @ tried[:, 1] ** 2)), float(odds @ factors)

    def _scaled_rows(self) -> ModuleRows:
        """Rows in standard deviations of the found noise."""
        root, rows = float(np.sqrt(self._scales[2])), self._rows
        return ModuleRows(rows.slopes / root, rows.misses / root, rows.whiten / root, rows.normals, rows.bends)

    def _squares(self, weights: FloatArray) -> FloatArray:
        """Compute (m,) the squared misses from the prediction by the other pokes, in standard deviations."""
        whole = self._information(weights) / self._scales[2] + np.diag(self._precisions())
        misses, covariances = _without_each(self._scaled_rows(), weights, _inverse(whole))
        return dots(misses, np.asarray(np.linalg.solve(covariances, misses[:, :, None])[:, :, 0], dtype=np.float64))

    def _pitches(self) -> FloatArray:
        """Compute (m,) the squared pitches of the pokes, in standard deviations, over the usual one if that is larger."""
        evidence, at, noise = self._touches.evidence, self._touches.rows, self._noise
        lever = self._touches.contact_centres(self._pads)[0] - evidence.sensors[at]
        relative = noise.force / evidence.forces[at]
        swung = relative[:, None] * dots(evidence.pairs[at], lever[:, None])
        variances = (noise.moment / evidence.forces[at]) ** 2 + np.sum(swung * swung, axis=1)
        return _over_usual(evidence.columns[7, at] ** 2 / variances, CHI2_1DOF_MEDIAN)

    def _trust(self, weights: FloatArray) -> FloatArray:
        """Judge the pokes, each among those of its arm pose, or among the rest."""
        squares, poses = self._squares(weights), self._touches.evidence.poses[self._touches.rows]
        groups, of, counts = np.unique(poses, return_inverse=True, return_counts=True)
        of = np.where(counts[of] >= MIN_POKES_PER_ARM_POSE, of, len(groups))
        for group in np.unique(of).tolist():
            squares[of == group] = _over_usual(squares[of == group], CHI2_2DOF_MEDIAN)
        trust = trust_from_squares(squares + self._pitches())
        return trust if float(trust.sum()) >= MIN_SUM_OF_POKE_TRUSTS else np.ones(self._count)

    def _result(self, trust: FloatArray, moving: float) -> SheetFit:
        whole = self._information(trust) / self._scales[2] + np.diag(self._precisions())
        pads, basis = self._place(self._whole), self._whole
        plane = pads.gradients[:, :, :2]
        fields = plane[:, :, None] * basis.modes[:, None, :, None]
        gradients = np.concatenate([pads.gradients, plane @ basis.strains, fields.reshape(len(plane), 3, -1)], axis=2)
        return SheetFit(
            module=self._module,
            touches=self._all,
            basis=basis,
            pose=self._pose,
            coefficients=self._coefficients,
            pads=Pads(pads.points, gradients, pads.normals, pads.triangles),
            rows=self._scaled_rows(),
            trust=trust,
            information=whole,
            covariance=_inverse(whole),
            scales=self._scales,
            moving=moving,
        )


def _over_usual(squares: FloatArray, usual: float) -> FloatArray:
    """Divide squared misses by their median over the `usual` one, if that is above 1; raised for few misses."""
    raised = 1.0 + SMALL_SAMPLE_SPREAD_CORRECTION / max(2 * len(squares) - 3, 1)
    return squares / max(1.0, raised * float(np.median(squares)) / usual)


def _inverse(whole: FloatArray) -> FloatArray:
    """Invert a positive symmetric matrix."""
    found = np.asarray(np.linalg.inv(whole), dtype=np.float64)
    return (found + found.T) / 2.0


def _without_each(rows: ModuleRows, trust: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    seen = (rows.slopes.reshape(-1, len(covariance)) @ covariance).reshape(rows.slopes.shape)
    held, eye = seen @ rows.slopes.transpose(0, 2, 1), np.eye(2)
    weights = trust[:, None, None]
    leverage = np.asarray(np.linalg.solve(eye - weights * held, held), dtype=np.float64)
    misses = rows.misses + trust[:, None] * (leverage @ rows.misses[:, :, None])[:, :, 0]
    return misses, eye + (leverage + leverage.transpose(0, 2, 1)) / 2.0
