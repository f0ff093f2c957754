"""Fit of a rig's correction to landmark pokes and skin pokes together, tested on held-out landmark pokes.

The rows are those of `skincal.rig.correction`. **Rigid groups** move with the taxels while a rig is fitted: modules with a
layout, else each taxel alone. The rows of a group contain no other group's unknowns, so each group's unknowns are eliminated
first (QR of its rows with the group's columns in front), and the rest is solved for the rig by QR again. Each Gauss-Newton
step is one such solve.

A landmark poke that is far from the prediction of all others, in standard deviations of it (its miss divided by the root of one
minus its leverage), counts less, as a taxel's poke does (`trust.h`). One landmark in four is held out with all its pokes, each
quarter in turn: a correction is worth using only if it predicts the held-out pokes better than the rig as reported. Without
landmarks nothing is corrected: no skin poke tells whether the rig is wrong or the skin lies elsewhere.

The answer follows from a frozen request alone, so any thread or process may compute it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.methods import estimate_from
from skincal.model.scene import NoiseSettings, Scene
from skincal.model.skin import SkinKind
from skincal.modules.pose import ModuleModel, ModulePoses
from skincal.modules.pose_fit import Touches, fit_modules_from_pokes, trust_from_squares
from skincal.pokes import LandmarkPokes, Pokes
from skincal.rig.correction import (
    MAX_ARM_POSES_WITH_UNCERTAINTY,
    Correction,
    RigPrior,
    RigRows,
    RigState,
    UsedCorrection,
    rig_rows,
    rigid_motion,
)
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Estimate, Method

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

GAUSS_NEWTON_STEPS = 4
"""The rows are nearly linear in the unknowns: the fourth step moves no taxel by a micrometre."""
TRUST_UPDATES_PER_FIT_STEP = 4
"""Updates of the landmark pokes' trust within a step."""
SKIN_POKE_WEIGHT_IN_RIG_FIT = 0.1
"""Weight of a skin poke for the rig: pokes near one place share their error, so ten of them are not ten times the evidence. On
the paper's rig with 1,200 skin pokes and 21 at landmarks the modules' error is 2.1 mm with 1, 1.0 with 0.3, 0.65 with 0.1 and
0.65 with 0.03."""
LANDMARK_HELD_OUT_FOLDS = 4
"""One landmark in this many is held out, with all its pokes: a wrong place of a landmark would predict its own miss."""
MIN_LANDMARKS = 4
"""With fewer landmarks nothing is corrected: the rest would tell too little while one is held out. With three that are 4 mm
off, holding out pokes instead of landmarks made a good rig five times worse."""
MAX_HELD_OUT_ERROR_RATIO_TO_CORRECT = 0.5
"""A correction must lower the held-out mean square to below this share. With six pokes at six landmarks in one pose, good rigs
with landmarks 4 to 6 mm off had 0.53 or more by chance, rigs like the paper's 0.01 to 0.43 in 19 of 20."""
LANDMARKS_AGREE_MAX_MISS_RATIO = 1.5
"""Landmarks agree up to this ratio of misses to their prediction. On rigs with modelled errors 21 pokes at six landmarks have
0.7 to 1.1."""
WARN_FROM_LANDMARK_NOISE_FACTOR = 2.0
"""From this factor on the scene's noise, agreeing landmarks say little and the operator reads that: their prediction was
widened by their own misses."""
REPORT_LANDMARK_POKES_WITH_TRUST_BELOW = 0.9
"""A landmark poke with less trust is named to the operator."""
LANDMARK_OFFSETS_M = (0.0, 0.0005, 0.001, 0.002, 0.004)
"""m: candidate sds of a landmark's place in each direction, shared by all its pokes. The likeliest gives the correction, all
of them its covariance."""
NOISE_FACTORS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6)
"""Candidate factors on the scene's noise for landmark pokes: an arm that wanders, a sensor that drifts."""
MIN_LIKELIHOOD_RATIO_OF_LANDMARK_ERRORS = 1e-4
"""Errors of landmarks less likely than this, over the likeliest, are left out: they have less than 0.0001 of its weight in the
covariance."""
NONLINEAR_SENSOR_QUADRATIC_SHARE = 0.03
"""`RigPrior.quadratic` of the nonlinear sensor that is fitted as an alternative."""
NONLINEAR_FIT_STEPS = 2
"""Steps of the nonlinear fit, which starts from the linear one's end."""
SENSOR_MODEL_MIN_LOG_LIKELIHOOD_RATIO = 5.0
"""From this log likelihood ratio on (150 times) the likelier sensor model, linear or not, is used alone. The other would add
less than a tenth of the predicted error."""
LINEAR_SENSOR_MATRIX_COLUMNS = 6
"""Columns of C for a linear sensor."""
MIN_MEAN_LANDMARK_POKE_TRUST = 0.5
"""If the mean trust of landmark pokes falls below this, all count fully: if most are in doubt, the right ones are unknown."""
MIN_LANDMARK_POKES = 6
"""With fewer landmark pokes nothing is corrected: none would be left to test a correction on."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPokes:
    """Places of m skin pokes by the current groups."""

    places: FloatArray
    """(m, 3) float, metres, link frame."""
    gradients: FloatArray
    """(m, 3, d) float: derivative of a place by its group's unknowns."""
    spread: FloatArray
    """(m, 3, 3) float, m^2: covariance of the contact about its place."""


@dataclass(frozen=True, slots=True, eq=False)
class _Groups:
    pokes: IntArray
    """(m,) numbers of the pokes."""
    of: IntArray
    """(m,) group of each poke, 0 to `count` - 1."""
    count: int
    trust: FloatArray
    """(m,) of each poke, from the fit of the taxels or modules alone."""


@dataclass(frozen=True, slots=True, eq=False)
class ModuleGroups(_Groups):
    """The poked modules; each moves as a rigid body in the fit."""

    model: ModuleModel
    touches: Touches
    poses: ModulePoses

    def placed(self) -> PlacedPokes:
        modules: list[int] = self.touches.modules.tolist()
        own = [self.model.pads[module] for module in modules]
        of = np.repeat(np.arange(len(own)), [len(pads) for pads in own])
        pads = self.model.ground.place_pads(self.poses.select(of), np.concatenate(own))
        places, gradients, normals = self.touches.contact_centres(pads)
        across = np.eye(3) - normals[:, :, None] * normals[:, None]
        return PlacedPokes(places, gradients, self.touches.offsets[:, None, None] * across)

    def move_by(self, moves: FloatArray) -> ModuleGroups:
        return replace(self, poses=self.model.ground.move(self.poses, moves))


@dataclass(frozen=True, slots=True, eq=False)
class TaxelGroups(_Groups):
    """The poked taxels; each moves on its own in the fit."""

    points: FloatArray
    """(count, 3) float, metres."""
    offsets: FloatArray
    """(m,) float, m^2: variance of the contact about its taxel, each direction."""

    def placed(self) -> PlacedPokes:
        eye = np.tile(np.eye(3), (len(self.of), 1, 1))
        return PlacedPokes(self.points[self.of], eye, self.offsets[:, None, None] * eye)

    def move_by(self, moves: FloatArray) -> TaxelGroups:
        return replace(self, points=self.points + moves)


RigidGroups: TypeAlias = ModuleGroups | TaxelGroups


def module_groups(
    table: ContactTable, model: ModuleModel, estimates: Mapping[int, Estimate], noise: NoiseSettings, channels: list[int]
) -> ModuleGroups | None:
    """Fit the modules that were poked with the rig as reported; `None` without any.

    Parameters
    ----------
    estimates : of taxels, from which the search for a module starts
    channels : those in use
    """
    evidence = table.evidence(channels)
    fit = fit_modules_from_pokes(evidence, table.totals(evidence.pokes), model, noise, [estimates])
    if fit is None:
        return None
    touches, fitted = fit
    pokes = evidence.pokes[touches.rows]
    return ModuleGroups(pokes, touches.of, len(touches.modules), fitted.trust, model, touches, fitted.poses)


def taxel_groups(
    table: ContactTable, estimates: Mapping[int, Estimate], noise: NoiseSettings, channels: list[int]
) -> TaxelGroups | None:
    """Collect the taxels that have an estimate and were poked; `None` without any."""
    placed = {channel: estimates[channel] for channel in channels if channel in estimates}
    known = {channel: estimate.position for channel, estimate in placed.items() if estimate.position is not None}
    evidence = table.evidence(known)
    if not len(evidence.channels):
        return None
    answered: list[int] = evidence.channels.tolist()
    doubted = [placed[channel].doubted for channel in answered]
    taxels: list[int] = evidence.taxels.tolist()
    pairs = zip(taxels, evidence.pokes.tolist(), strict=True)
    return TaxelGroups(
        pokes=evidence.pokes,
        of=evidence.taxels,
        count=len(evidence.channels),
        points=np.array([known[channel] for channel in answered]),
        offsets=noise.contact**2 - noise.reach**2 * np.log(evidence.weights),
        trust=np.array([doubted[taxel].get(poke, 1.0) for taxel, poke in pairs]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class RigRequest:
    """Input of a rig's correction."""

    scene: Scene
    surface: Surface | None
    contacts: Sequence[Contact]
    """Skin pokes that count."""
    landmarks: LandmarkPokes
    dead: Mapping[int, str] = field(default_factory=dict[int, str])
    prior: RigPrior = field(default_factory=RigPrior)


@dataclass(frozen=True, slots=True, eq=False)
class RigAnswer:
    """Result of the fit of a rig's correction."""

    correction: Correction | None
    """`None` with too few landmark pokes."""
    used: bool
    """The correction predicts held-out landmark pokes better than the rig as reported, and is worth using."""
    before: float
    """m: distance of the axes from the landmarks as reported, rms weighted by trust; NaN without pokes."""
    after: float
    """m: the same of held-out pokes with a correction made without them; NaN without one."""
    points: int
    """Number of different landmarks poked."""
    trust: Mapping[int, float]
    """Of each landmark poke, 0 to 1."""
    distances: Mapping[int, float]
    """m: of each landmark poke the distance of its axis from the landmark with the correction."""
    unknowns: FloatArray
    """(n,) float: the correction in standard deviations of the prior; n as in `RigPrior.scales`."""
    known: FloatArray
    """(n,) float: sd of each unknown over its prior's, 0 to 1; 1 is undetermined."""
    ratio: float = float("nan")
    """Rms of held-out misses over their predicted sd; NaN without any. Above 1 the correction does not explain everything, and
    its uncertainty is multiplied by it."""
    plain_ratio: float = float("nan")
    """The same of all pokes without a correction, over the sd that noise and hand cause on an exact rig."""
    noisier: float = 1.0
    """Factor on the scene's noise that the landmark pokes' own misses suggest, one of `NOISE_FACTORS`. It widens the
    prediction of held-out pokes, so `ratio` tells little if it is large."""

    @property
    def usable(self) -> Correction | None:
        """The correction if it is worth using."""
        return self.correction if self.used else None


@dataclass(frozen=True, slots=True)
class LandmarkAgreement:
    """Agreement of the landmark pokes with their prediction."""

    pokes: int
    ratio: float
    """Rms of their misses, each over its predicted standard deviation."""
    corrected: bool
    """Judged with the rig's correction in use, of pokes that were held out of it; else the rig as reported."""
    noisier: float = 1.0
    """Factor on the scene's noise in the prediction (`RigAnswer.noisier`); 1 without a correction."""
    by_part: bool = False
    """Each landmark was predicted from all other touches of a tool, without the sensor (`part_agreement`)."""
    driven: int = 0
    """Pokes to whose landmark a robot drove by a pose of the part: then agreement confirms nothing."""

    @property
    def agrees(self) -> bool:
        """Whether the landmark pokes miss by as much as predicted."""
        return self.ratio <= LANDMARKS_AGREE_MAX_MISS_RATIO

    @property
    def by_noise(self) -> bool:
        """Whether the predicted misses are so large that agreement says little."""
        return self.noisier >= WARN_FROM_LANDMARK_NOISE_FACTOR


def landmark_agreement(rig: RigAnswer | None, used: UsedCorrection | None) -> LandmarkAgreement | None:
    """Compare landmark pokes with their prediction; `None` with too few.

    Parameters
    ----------
    rig : fit to the landmark pokes; `None` if there was none
    used : the rig's correction in use
    """
    if rig is not None and rig.correction is not None:
        if used is None:
            return LandmarkAgreement(len(rig.trust), rig.plain_ratio, False)
        return LandmarkAgreement(len(rig.trust), rig.ratio, True, rig.noisier)
    return None if used is None or np.isnan(used.ratio) else LandmarkAgreement(used.pokes, used.ratio, True, used.noisier)


def _nothing() -> None:
    pass


def correct_rig(request: RigRequest, between: Callable[[], None] = _nothing) -> RigAnswer:
    """Fit the correction of a rig to its landmark pokes.

    Parameters
    ----------
    between : called between the steps, some 50 ms apart; may raise to give up
    """
    names = sorted({contact.pose for contact in request.contacts} | set(request.landmarks.pose.tolist()))
    scales, points = request.prior.scales(len(names)), len(np.unique(request.landmarks.name))
    if len(request.landmarks) < MIN_LANDMARK_POKES or points < MIN_LANDMARKS:
        trust, nothing = dict.fromkeys(request.landmarks.number.tolist(), 1.0), np.zeros(len(scales))
        return RigAnswer(None, False, float("nan"), float("nan"), points, trust, {}, nothing, nothing + 1.0)
    fit = _Fit(request, names, request.prior)
    for _ in range(GAUSS_NEWTON_STEPS):
        between()
        fit.do_step()
    other = _Fit(request, names, replace(request.prior, quadratic=NONLINEAR_SENSOR_QUADRATIC_SHARE), fit)
    for _ in range(NONLINEAR_FIT_STEPS):
        between()
        other.do_step()
    between()
    return _weighed(fit, other, names)


def _weighed(linear: _Fit, bent: _Fit, names: list[str]) -> RigAnswer:
    """Combine the linear and the nonlinear fit by their likelihoods; use only one if it is nearly certain.

    Both have the same prior probability. Between them the unknowns are the mean, x = w x_1 + (1 - w) x_2, with the
    covariance w C_1 + (1 - w) C_2 + w (1 - w) (x_1 - x_2)(x_1 - x_2)'. The likelier one was tested on held-out pokes.
    """
    # A fit that doubts a poke does not explain it: likelihoods are compared over the pokes that both trust.
    counts = np.minimum(linear.trust, bent.trust)
    gap = bent.likelihood(counts) - linear.likelihood(counts)
    answer = (bent if gap > 0.0 else linear).answer(names)
    if abs(gap) > SENSOR_MODEL_MIN_LOG_LIKELIHOOD_RATIO:
        return answer
    chance = 1.0 / (1.0 + float(np.exp(-gap)))
    (one, root), (two, other) = linear.posterior(bent.columns), bent.posterior(bent.columns)
    mean, off = (1.0 - chance) * one + chance * two, np.sqrt(chance * (1.0 - chance)) * (one - two)
    every = np.column_stack([np.sqrt(1.0 - chance) * root, np.sqrt(chance) * other, off])
    return replace(
        answer,
        correction=bent.correction(mean, max(1.0, answer.ratio) * every, names),
        distances=dict(zip(answer.distances, bent.passed(mean).tolist(), strict=True)),
        unknowns=mean / bent.scales,
        known=bent.share_of_prior(every),
    )


class _Fit:
    """Gauss-Newton fit of the rig and the rigid groups."""

    def __init__(self, request: RigRequest, names: list[str], prior: RigPrior, begin: _Fit | None = None) -> None:
        self.noise, self.scales = request.scene.noise, prior.scales(len(names))
        self.columns = (len(self.scales) - 6 * len(names)) // 6
        self.groups: RigidGroups | None = _rigid_groups(request) if begin is None else begin.groups
        self.landmarks = request.landmarks[request.landmarks.number.argsort(kind="stable")]
        self._aim = np.tile(request.prior.landmark**2 * np.eye(3), (len(self.landmarks), 1, 1))
        by_number = {contact.poke: contact for contact in request.contacts}
        pokes: list[int] = [] if self.groups is None else self.groups.pokes.tolist()
        self._skin = Pokes.collect([by_number[poke] for poke in pokes]) if pokes else None
        self.state = RigState.at_prior(names, self.columns)
        self.trust = np.ones(len(self.landmarks))
        if begin is not None:
            added = np.zeros((LINEAR_SENSOR_MATRIX_COLUMNS, self.columns - begin.columns))
            self.state = replace(begin.state, matrix=np.concatenate([begin.state.matrix, added], axis=1))
            self.trust = begin.trust
        self._at_landmark = (self.landmarks.name[:, None] == np.unique(self.landmarks.name)).astype(np.float64)
        self._shared, self._noisier = np.zeros((2 * len(self.landmarks),) * 2), 1.0
        self._last: tuple[RigRows, FloatArray] | None = None

    def do_step(self) -> None:
        """Do one Gauss-Newton step of the rig and the groups."""
        base, tops = self._without_groups(self.state.unknowns(self.scales))
        rows = self._landmark_rows(self.state)
        for _ in range(TRUST_UPDATES_PER_FIT_STEP):
            self.trust = _trusted(rows, self._shared, *_solve_rows(base, rows, self._shared, self.trust), self.trust)
        self._shared, self._noisier, _ = self._likeliest(base, rows, self.trust)
        step, _ = _solve_rows(base, rows, self._shared, self.trust)
        self._last = (rows, base)
        self.state = self.state.add_step(step, self.scales)
        if self.groups is not None:
            self.groups = self.groups.move_by(np.stack([_group_move(top, step) for top in tops]))

    def likelihood(self, trust: FloatArray) -> float:
        """Log likelihood of landmark pokes with the trust (m,), up to a constant that all fits share."""
        assert self._last is not None
        rows, base = self._last
        return self._likeliest(base, rows, trust)[2]

    def _likeliest(self, base: FloatArray, rows: RigRows, trust: FloatArray) -> tuple[FloatArray, float, float]:
        """Choose the likeliest of `LANDMARK_OFFSETS_M` and `NOISE_FACTORS`.

        Returns
        -------
        What they add to the covariance of landmark pokes, (2 m, 2 m), the noise factor, and the log likelihood but a constant.
        """
        every, likelihoods = self._errors_of_landmarks(base, rows, trust)
        best = int(np.argmax(likelihoods))
        return every[best], NOISE_FACTORS[best // len(LANDMARK_OFFSETS_M)], float(likelihoods[best])

    def _errors_of_landmarks(self, base: FloatArray, rows: RigRows, trust: FloatArray) -> tuple[list[FloatArray], FloatArray]:
        """List what `NOISE_FACTORS` with each of `LANDMARK_OFFSETS_M` adds, and the log likelihoods: see `_likeliest`."""
        of_place = (rows.of_place[:, :, None] * self._at_landmark[:, None, :, None]).reshape(2 * len(self.landmarks), -1)
        alike = of_place @ of_place.T
        own, marginal = np.eye(len(alike)), _Marginal(base, rows, trust)
        every = [off**2 * alike + (noisier**2 - 1.0) * own for noisier in NOISE_FACTORS for off in LANDMARK_OFFSETS_M]
        return every, np.array([marginal.log_likelihood(added) for added in every])

    def _landmark_rows(self, state: RigState) -> RigRows:
        return rig_rows(self.landmarks, state, self.landmarks.place, self._aim, self.noise, self.scales)

    def _without_groups(self, here: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Factorize all rows but the landmarks': (n + 1, n + 1), and each group's own rows on top of its factor."""
        kept, tops = [np.column_stack([np.eye(len(here)), here])], list[FloatArray]()
        if self.groups is not None and self._skin is not None:
            placed = self.groups.placed()
            rows = rig_rows(self._skin, self.state, placed.places, placed.spread, self.noise, self.scales)
            root = np.sqrt(SKIN_POKE_WEIGHT_IN_RIG_FIT * self.groups.trust)[:, None, None]
            own = rows.of_place @ placed.gradients
            every = root * np.concatenate([own, rows.of_rig, rows.misses[:, :, None]], axis=2)
            for group in range(self.groups.count):
                factor = qr_factor(every[self.groups.of == group].reshape(-1, every.shape[2]))
                tops.append(factor[: own.shape[2]])
                kept.append(factor[own.shape[2] :, own.shape[2] :])
        return qr_factor(np.concatenate(kept)), tops

    def answer(self, names: list[str]) -> RigAnswer:
        """Make the answer, tested on held-out pokes at the last linearization."""
        assert self._last is not None
        rows, base = self._last
        reported = self._landmark_rows(RigState.at_prior(names, self.columns))
        held, predicted = self._held_out(rows, base)
        before, after = (np.average(np.sum(own**2, axis=1), weights=self.trust) for own in (reported.misses, held))
        # Squared misses in predicted standard deviations: two numbers a poke.
        ratio = float(np.sqrt(np.average(_squares(held, predicted), weights=self.trust) / 2.0))
        # Misses are in standard deviations; this converts them to metres on average.
        metre = np.sqrt(np.sum(reported.distances**2) / np.sum(reported.misses**2))
        unknowns, spread = self.posterior(self.columns)
        pokes: list[int] = self.landmarks.number.tolist()
        return RigAnswer(
            correction=self.correction(unknowns, max(1.0, ratio) * spread, names),
            used=bool(after < MAX_HELD_OUT_ERROR_RATIO_TO_CORRECT * before),
            before=float(metre * np.sqrt(before)),
            after=float(metre * np.sqrt(after)),
            ratio=ratio,
            plain_ratio=float(np.sqrt(before / 2.0)),
            noisier=self._noisier,
            points=self._at_landmark.shape[1],
            trust=dict(zip(pokes, self.trust.tolist(), strict=True)),
            distances=dict(zip(pokes, self.passed(unknowns).tolist(), strict=True)),
            unknowns=unknowns / self.scales,
            known=self.share_of_prior(spread),
        )

    def posterior(self, columns: int) -> tuple[FloatArray, FloatArray]:
        """Compute the unknowns (n,), SI, and a root (n, k) of their covariance. Columns of C that the fit lacks are 0."""
        of_fit = self._spread()
        own, size = len(self.scales), 6 * columns
        at = np.concatenate(
            [
                np.arange(size).reshape(6, columns)[:, : self.columns].ravel(),
                np.arange(size, size + own - 6 * self.columns),
            ]
        )
        unknowns, spread = np.zeros(at[-1] + 1), np.zeros((at[-1] + 1, own))
        unknowns[at] = self.state.unknowns(self.scales) * self.scales
        spread[at] = self.scales[:, None] * of_fit
        return unknowns, spread

    def _spread(self) -> FloatArray:
        """Compute a root (n, n), upper triangular, of the covariance of the unknowns, in standard deviations of the prior.

        The errors of landmarks and of their pokes are not known, and the likeliest are often too small: the fit bends to few
        landmarks. All candidates have the same prior probability. With their probabilities w by the misses, solutions x and
        covariances C, the second moment about the solution x_0 in use is sum w (C + (x - x_0)(x - x_0)').
        """
        assert self._last is not None
        rows, base = self._last
        every, likelihoods = self._errors_of_landmarks(base, rows, self.trust)
        kept = np.flatnonzero(likelihoods > likelihoods.max() + np.log(MIN_LIKELIHOOD_RATIO_OF_LANDMARK_ERRORS))
        weights = np.exp(likelihoods[kept] - likelihoods.max())
        weights = weights / weights.sum()
        used, roots = _solve_rows(base, rows, self._shared, self.trust)[0], list[FloatArray]()
        pairs: list[tuple[int, float]] = list(zip(kept.tolist(), weights.tolist(), strict=True))
        for index, weight in pairs:
            step, root = _solve_rows(base, rows, every[index], self.trust)
            roots.append(np.sqrt(weight) * np.column_stack([np.linalg.inv(root), step - used]))
        return _first_rows(np.concatenate(roots, axis=1), len(used))

    def share_of_prior(self, spread: FloatArray) -> FloatArray:
        """Compute the sd (n,) of the unknowns, by a root (n, k) of their covariance, over the prior's, at most 1."""
        return np.minimum(np.linalg.norm(spread, axis=1) / self.scales, 1.0)

    def passed(self, unknowns: FloatArray) -> FloatArray:
        """Distances (m,), metres, of the axes from their landmarks with the unknowns (n,), SI."""
        at_prior = RigState.at_prior(self.state.names.tolist(), self.columns)
        return self._landmark_rows(at_prior.add_step(unknowns / self.scales, self.scales)).distances

    def correction(self, unknowns: FloatArray, spread: FloatArray, names: list[str]) -> Correction:
        """Make the correction from unknowns (n,), SI, whose covariance has the root `spread` (n, m)."""
        of_matrix = 6 * self.columns
        matrix, poses = unknowns[:of_matrix].reshape(6, -1), unknowns[of_matrix:].reshape(-1, 2, 3)
        kept = len(unknowns) if len(names) <= MAX_ARM_POSES_WITH_UNCERTAINTY else of_matrix
        return Correction(
            np.eye(6) + matrix[:, :LINEAR_SENSOR_MATRIX_COLUMNS],
            motions={name: rigid_motion(*pose) for name, pose in zip(names, poses, strict=True)},
            quadratic=matrix[:, LINEAR_SENSOR_MATRIX_COLUMNS:],
            root=spread if spread.shape == (kept, kept) else _first_rows(spread, kept),
        )

    def _held_out(self, rows: RigRows, base: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Misses (m, 2) of landmark pokes, each with a correction made without its quarter, and their covariances (m, 2, 2)."""
        held, predicted = np.empty_like(rows.misses), np.empty((len(rows.misses), 2, 2))
        quarter = self._at_landmark.argmax(axis=1) % LANDMARK_HELD_OUT_FOLDS
        for out in range(LANDMARK_HELD_OUT_FOLDS):
            own = quarter == out
            step, root = _solve_rows(base, rows, self._shared, np.where(own, 0.0, self.trust))
            held[own] = rows.misses[own] + rows.of_rig[own] @ step
            predicted[own] = _own_blocks(self._shared)[own] + _leverage(rows.of_rig[own], root)
        return held, predicted


def _rigid_groups(request: RigRequest) -> RigidGroups | None:
    """Collect the groups that the skin pokes move with, placed by the rig as reported."""
    scene, surface = request.scene, request.surface
    table = ContactTable(request.contacts)
    layout = scene.skin.layout
    answered = sorted({channel for contact in request.contacts for channel in contact.channels.tolist()} - request.dead.keys())
    channels = answered if layout is None else [channel for channel in answered if layout.module_of[channel] >= 0]
    method = Method.FREE if surface is None else Method.SURFACE
    estimates = estimate_from(table, channels, [method], scene.noise, surface)[method]
    if layout is None or layout.kind is SkinKind.SHEET:
        return taxel_groups(table, estimates, scene.noise, channels)
    return module_groups(table, ModuleModel(layout, scene.skin.anchor, surface), estimates, scene.noise, channels)


def qr_factor(rows: FloatArray) -> FloatArray:
    """Compute R of the QR of rows, square or with fewer rows than columns."""
    factor: Any = np.linalg.qr(rows, mode="r")
    return np.asarray(factor, dtype=np.float64)


def _first_rows(root: FloatArray, count: int) -> FloatArray:
    """Upper triangular U (count, count): U U' is the covariance of the first unknowns, root root' that of all."""
    return np.ascontiguousarray(qr_factor(root[count - 1 :: -1].T).T[::-1, ::-1])


def _solve_rows(base: FloatArray, rows: RigRows, shared: FloatArray, trust: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve all rows, those of landmarks weighted by their trust.

    Parameters
    ----------
    shared : (2 m, 2 m) covariance of errors that pokes share, in addition to the rows' own unit covariance

    Returns
    -------
    (n,) the step from the prior's zero, and (n, n) upper triangular the root of the information, root' root.
    """
    own, whiten = _counting(rows, shared, trust)
    factor = qr_factor(np.concatenate([base, whiten @ own]))
    root = factor[:-1, :-1]
    return -np.asarray(np.linalg.solve(root, factor[:-1, -1]), dtype=np.float64), root


def _counting(rows: RigRows, shared: FloatArray, trust: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the rows (k, n + 1) of trusted pokes with their misses, and their whitening (k, k)."""
    counts = np.repeat(trust > 0.0, 2)
    own = np.concatenate([rows.of_rig, rows.misses[:, :, None]], axis=2).reshape(len(counts), -1)[counts]
    covariance = shared[np.ix_(counts, counts)] + np.diag(np.repeat(1.0 / trust[trust > 0.0], 2))
    return own, np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)


class _Marginal:
    """Marginal likelihood of the landmarks' misses under the prior and the skin pokes, for an added covariance."""

    def __init__(self, base: FloatArray, rows: RigRows, trust: FloatArray) -> None:
        self._counts = np.repeat(trust > 0.0, 2)
        own = rows.of_rig.reshape(len(self._counts), -1)[self._counts]
        root, right = base[: own.shape[1], :-1], base[: own.shape[1], -1]
        self._misses = rows.misses.ravel()[self._counts] - own @ np.linalg.solve(root, right)
        spread = np.linalg.solve(root.T, own.T)
        self._known = spread.T @ spread + np.diag(np.repeat(1.0 / trust[trust > 0.0], 2))

    def log_likelihood(self, added: FloatArray) -> float:
        factor = np.linalg.cholesky(self._known + added[np.ix_(self._counts, self._counts)])
        return -float(np.sum(np.linalg.solve(factor, self._misses) ** 2) / 2.0 + np.sum(np.log(np.diag(factor))))


def _own_blocks(shared: FloatArray) -> FloatArray:
    """Compute the covariance (m, 2, 2) of each poke's own rows."""
    count = len(shared) // 2
    at = np.arange(count)
    return np.eye(2) + shared.reshape(count, 2, count, 2)[at, :, at]


def _trusted(rows: RigRows, shared: FloatArray, step: FloatArray, root: FloatArray, trust: FloatArray) -> FloatArray:
    """Compute the trust of each landmark poke from its distance to what all other pokes predict.

    With H = A (root' root)^-1 A' for a poke of weight k, its miss r in the fit has the covariance 1/k - H under noise alone. So
    r' (I - k H)^-1 r is chi-square for a poke of full weight; (I + H) is used for one in doubt. Shared errors are added to I.
    """
    leverage = _leverage(rows.of_rig, root)
    counts = (trust > 0.5)[:, None, None]
    total = _own_blocks(shared) + np.where(counts, -trust[:, None, None] * leverage, leverage)
    # Rounding may leave a square below zero.
    found = trust_from_squares(np.maximum(_squares(rows.misses + rows.of_rig @ step, total), 0.0))
    return found if found.sum() >= MIN_MEAN_LANDMARK_POKE_TRUST * len(found) else np.ones(len(found))


def _leverage(of_rig: FloatArray, root: FloatArray) -> FloatArray:
    """Compute A (root' root)^-1 A', (m, 2, 2), for the rows A (m, 2, n) of each poke."""
    spread = np.asarray(np.linalg.solve(root.T, of_rig.reshape(-1, of_rig.shape[2]).T), dtype=np.float64)
    spread = spread.T.reshape(*of_rig.shape[:2], -1)
    return spread @ spread.transpose(0, 2, 1)


def _squares(misses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Squares (m,) of misses (m, 2) whitened by their covariances (m, 2, 2)."""
    return np.sum(misses * np.asarray(np.linalg.solve(covariances, misses[:, :, None])[:, :, 0]), axis=1)


def _group_move(top: FloatArray, step: FloatArray) -> FloatArray:
    """Move (d,) of a group for a step of the rig; of the smallest norm if its pokes do not determine it."""
    unknowns = top.shape[1] - 1 - len(step)
    right = -(top[:, -1] + top[:, unknowns:-1] @ step)
    return np.asarray(np.linalg.lstsq(top[:, :unknowns], right, rcond=1e-9)[0], dtype=np.float64)
