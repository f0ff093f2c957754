"""The fit of a rig's correction from landmark pokes and skin pokes together, tried on landmark pokes that were held out.

The rows are those of `skincal.rig.correction`. What moves with the taxels while a rig is fitted are **rigid groups**: modules
where there is a layout, else each taxel alone. The rows of a group know no other group, so each group's own unknowns are
eliminated from its rows first (QR of its rows, the group's columns in front), and what is left of all of them is solved for
the rig, by QR again. Each step costs one such solve.

A landmark poke that is far off what all others predict for it, in standard deviations of that (its miss divided by the root
of one less its leverage), counts less, as a taxel's poke does (`trust.h`); the answer says which. One landmark in four is held
out with all its pokes, each quarter in turn: the correction is used only where it predicts the held-out pokes better than the
rig as it reports itself. Without landmarks nothing of the rig is touched: no poke on the skin tells whether the rig is wrong
or the skin lies elsewhere.

What is asked is frozen, and the answer follows from it alone: it may be worked out in any thread or process, at any time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray, axis_point, move_wrench
from skincal.methods import estimate_from
from skincal.model.scene import NoiseSettings, Scene
from skincal.modules.pose import ModuleModel, ModulePoses
from skincal.modules.pose_fit import Touches, fit_modules_from_pokes, trust_from_squares
from skincal.rig.correction import (
    POSES_KEPT,
    Correction,
    RigPrior,
    RigReadings,
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

STEPS = 4
"""Of Gauss and Newton: the rows are nearly linear in the unknowns, and the fourth step moves no taxel by a micrometre."""
ROUNDS = 4
"""How often the trust of landmark pokes is found anew within a step."""
SKIN = 0.1
"""What a poke on the skin counts for the rig: pokes near one place are off by the same, so ten of them do not say ten times as
much. On the paper's rig with 1,200 skin pokes and 21 at landmarks the modules' error is 2.1 mm with 1, 1.0 with 0.3, 0.65 with
0.1 and 0.65 with 0.03."""
HELD_OUT = 4
"""One landmark in this many is held out, with all its pokes: a landmark whose place is wrong predicts its own miss."""
FEWEST_POINTS = 4
"""Different landmarks below which nothing is corrected: fewer would be held out one by one, and the rest would say too little.
With three that are 4 mm off, pokes held out instead of landmarks made a good rig five times worse."""
BETTER = 0.5
"""The held-out pokes must be predicted better by this share, in the mean square, for a correction to be used. Six pokes at six
landmarks in one pose, ten rigs each: on good ones whose landmarks are 4 to 6 mm off it comes to 0.53 and more by chance, on
the paper's to 0.01 to 0.43 in 19 of 20, with landmarks that are right or 4 mm off."""
AS_PREDICTED = 1.5
"""Misses of landmarks over what is predicted for them that are still as predicted: of 21 pokes at six landmarks the ratio is
0.7 to 1.1 on rigs that are wrong as modelled."""
TOO_NOISY = 2.0
"""Times the scene's noise from which landmarks that agree do not speak for a prediction, and so much is said: what is predicted
for them is then twice as wide by their own misses, and hardly any misses would disagree."""
DOUBTED = 0.9
"""A landmark poke that counts less than this is named to the operator."""
PLACES_OFF = (0.0, 0.0005, 0.001, 0.002, 0.004)
"""m: how far the places of landmarks may be off, sd in each direction, alike for all pokes at one; the likeliest is taken."""
NOISIER = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6)
"""How many times larger than the scene says the noise of landmark pokes may be: an arm that wanders, a sensor that drifts."""
QUADRATIC = 0.03
"""Share of its load by which a sensor may be off that is not linear (`RigPrior.quadratic`), where pokes speak for one."""
STEPS_ON = 2
"""Of the fit with such a sensor, from where that with a linear one ended."""
SURE = 5.0
"""Logarithm of how many times likelier landmark pokes are by a sensor that is linear, or by one that is not, for it to be taken
alone: 150 times. What the other would add is then below a tenth of the predicted error."""
LINEAR = 6
"""Columns of the matrix C of a sensor that is linear."""
LEFT = 0.5
"""Share of the landmark pokes that must count, or all of them do: where most are doubted, nobody can say which are right."""
FEWEST = 6
"""Landmark pokes below which nothing is corrected: from fewer, nothing is left to try a correction on."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPokes:
    """Where the m pokes on the skin are, as their groups lie."""

    places: FloatArray
    """(m, 3) float, metres, link frame."""
    gradients: FloatArray
    """(m, 3, d) float: change of a place with its group's unknowns."""
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
    """The modules that were poked, each rigid."""

    model: ModuleModel
    touches: Touches
    poses: ModulePoses

    def placed(self) -> PlacedPokes:
        """Return where the pokes are."""
        modules: list[int] = self.touches.modules.tolist()
        own = [self.model.pads[module] for module in modules]
        of = np.repeat(np.arange(len(own)), [len(pads) for pads in own])
        pads = self.model.ground.place_pads(self.poses.take(of), np.concatenate(own))
        places, gradients, normals = self.touches.contact_centres(pads)
        across = np.eye(3) - normals[:, :, None] * normals[:, None]
        return PlacedPokes(places, gradients, self.touches.offsets[:, None, None] * across)

    def moved(self, moves: FloatArray) -> ModuleGroups:
        """Return them moved by `moves` (count, d)."""
        return replace(self, poses=self.model.ground.move(self.poses, moves))


@dataclass(frozen=True, slots=True, eq=False)
class TaxelGroups(_Groups):
    """The taxels that were poked, each by itself."""

    points: FloatArray
    """(count, 3) float, metres."""
    offsets: FloatArray
    """(m,) float, m^2: variance of the contact beside its taxel, each direction."""

    def placed(self) -> PlacedPokes:
        """Return where the pokes are: at their taxels."""
        eye = np.tile(np.eye(3), (len(self.of), 1, 1))
        return PlacedPokes(self.points[self.of], eye, self.offsets[:, None, None] * eye)

    def moved(self, moves: FloatArray) -> TaxelGroups:
        """Return them moved by `moves` (count, 3)."""
        return replace(self, points=self.points + moves)


RigidGroups: TypeAlias = ModuleGroups | TaxelGroups


def module_groups(
    table: ContactTable, model: ModuleModel, estimates: Mapping[int, Estimate], noise: NoiseSettings, channels: list[int]
) -> ModuleGroups | None:
    """Return the modules that were poked, where the rig as it reports itself puts them; None where none was.

    Parameters
    ----------
    estimates : of taxels, where the search for a module begins
    channels : those that are used
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
    """Return the taxels that have an estimate and were poked; None where none was."""
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
class LandmarkPoke:
    """A poke at a known point of the part; no taxel needs to answer."""

    poke: int
    """Number of the poke."""
    name: str
    """Of the landmark."""
    place: FloatArray
    """(3,) float, metres, link frame: of the landmark."""
    force: FloatArray
    """(3,) float, N, tared, sensor frame, force on the part."""
    moment: FloatArray
    """(3,) float, N m, about the sensor's origin."""
    link_from_sensor: FloatArray
    """(4, 4) float, metres: pose of the arm as reported."""
    pose: str
    """Name of the arm pose."""

    @property
    def miss(self) -> float:
        """How far its axis passes the landmark, metres."""
        force, moment = move_wrench(self.link_from_sensor, self.force, self.moment)
        return float(np.linalg.norm(np.cross(self.place - axis_point(force, moment), force / np.linalg.norm(force))))


@dataclass(frozen=True, slots=True, eq=False)
class RigRequest:
    """What a correction is worked out from."""

    scene: Scene
    surface: Surface | None
    contacts: Sequence[Contact]
    """Those on the skin that count."""
    landmarks: Sequence[LandmarkPoke]
    dead: Mapping[int, str] = field(default_factory=dict[int, str])
    prior: RigPrior = field(default_factory=RigPrior)


@dataclass(frozen=True, slots=True, eq=False)
class RigAnswer:
    """What came out."""

    correction: Correction | None
    """None where there is nothing to correct with."""
    used: bool
    """Whether the correction predicts held-out landmark pokes better than the rig as it reports itself."""
    before: float
    """m: at what distance the axes pass the landmarks as reported, root mean square by trust; NaN without pokes."""
    after: float
    """m: the same for held-out pokes under a correction made without them; NaN where there is none."""
    points: int
    """How many different landmarks were poked."""
    trust: Mapping[int, float]
    """Of each landmark poke, 0 to 1."""
    distances: Mapping[int, float]
    """m: of each landmark poke, how far its axis passes the landmark under the correction."""
    unknowns: FloatArray
    """(n,) float: the correction in standard deviations of the prior; n as in `RigPrior.scales`."""
    known: FloatArray
    """(n,) float: sd of each unknown over that of its prior, 0 to 1; 1 is not determined."""
    ratio: float = float("nan")
    """Misses of held-out pokes over what was predicted for them, root mean square; NaN where there is none. Above 1 something
    is wrong that the correction does not know of, and its uncertainty is as many times larger."""
    plain_ratio: float = float("nan")
    """The same of all pokes without a correction, over what the scene's noise and the hand make of a right rig."""
    noisier: float = 1.0
    """How many times the scene's noise that of landmark pokes is taken for, by their own misses, one of `NOISIER`: what is
    predicted for held-out pokes is as much wider, so that `ratio` tells little where this is large."""


@dataclass(frozen=True, slots=True)
class LandmarkAgreement:
    """How landmarks are passed, over what is predicted."""

    pokes: int
    ratio: float
    """Root mean square of their misses, each over its predicted standard deviation."""
    corrected: bool
    """A correction of the rig is in use, made without the pokes that are judged; else the rig is judged as it reports."""
    noisier: float = 1.0
    """How many times the scene's noise is predicted for them (`RigAnswer.noisier`); 1 without a correction."""

    @property
    def agrees(self) -> bool:
        """Whether they are passed as predicted."""
        return self.ratio <= AS_PREDICTED

    @property
    def by_noise(self) -> bool:
        """Whether what is predicted is so much wider than by the scene's noise that to agree says little."""
        return self.noisier >= TOO_NOISY


def landmark_agreement(rig: RigAnswer | None, used: UsedCorrection | None) -> LandmarkAgreement | None:
    """Return how landmarks are passed; None where too few were poked to say.

    Parameters
    ----------
    rig : what landmark pokes say; None where nobody has looked
    used : the correction of the rig that is in use
    """
    if rig is not None and rig.correction is not None:
        if used is None:
            return LandmarkAgreement(len(rig.trust), rig.plain_ratio, False)
        return LandmarkAgreement(len(rig.trust), rig.ratio, True, rig.noisier)
    return None if used is None or np.isnan(used.ratio) else LandmarkAgreement(used.pokes, used.ratio, True, used.noisier)


def _nothing() -> None:
    pass


def correct_rig(request: RigRequest, between: Callable[[], None] = _nothing) -> RigAnswer:
    """Find what is wrong with a rig, as far as landmark pokes show it.

    Parameters
    ----------
    between : called between the steps, some 50 ms apart; may raise to give up
    """
    names = sorted({poke.pose for poke in (*request.contacts, *request.landmarks)})
    scales, points = request.prior.scales(len(names)), len({poke.name for poke in request.landmarks})
    if len(request.landmarks) < FEWEST or points < FEWEST_POINTS:
        trust, nothing = {poke.poke: 1.0 for poke in request.landmarks}, np.zeros(len(scales))
        return RigAnswer(None, False, float("nan"), float("nan"), points, trust, {}, nothing, nothing + 1.0)
    fit = _Fit(request, names, request.prior)
    for _ in range(STEPS):
        between()
        fit.step()
    other = _Fit(request, names, replace(request.prior, quadratic=QUADRATIC), fit)
    for _ in range(STEPS_ON):
        between()
        other.step()
    between()
    return _weighed(fit, other, names)


def _weighed(linear: _Fit, bent: _Fit, names: list[str]) -> RigAnswer:
    """Return the answer of both fits, each as likely as landmark pokes make it; of one alone where it is all but sure.

    Before landmarks speak, either is as likely. Between them the unknowns are the mean, x = w x_1 + (1 - w) x_2, with the
    covariance w C_1 + (1 - w) C_2 + w (1 - w) (x_1 - x_2)(x_1 - x_2)'. What was tried on held-out pokes is the likelier one.
    """
    # A fit that doubts a poke does not explain it: likelihoods are compared over the pokes that count by both.
    counts = np.minimum(linear.trust, bent.trust)
    gap = bent.likelihood(counts) - linear.likelihood(counts)
    answer = (bent if gap > 0.0 else linear).answer(names)
    if abs(gap) > SURE:
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
    """Steps of Gauss and Newton over the rig and the rigid groups."""

    def __init__(self, request: RigRequest, names: list[str], prior: RigPrior, begin: _Fit | None = None) -> None:
        self.noise, self.scales = request.scene.noise, prior.scales(len(names))
        self.columns = (len(self.scales) - 6 * len(names)) // 6
        self.groups: RigidGroups | None = _rigid_groups(request) if begin is None else begin.groups
        self.landmarks = sorted(request.landmarks, key=lambda poke: poke.poke)
        order = {name: index for index, name in enumerate(names)}
        self._known = readings_of(self.landmarks, order)
        self._places = np.array([poke.place for poke in self.landmarks])
        self._aim = np.tile(request.prior.landmark**2 * np.eye(3), (len(self.landmarks), 1, 1))
        by_number = {contact.poke: contact for contact in request.contacts}
        pokes: list[int] = [] if self.groups is None else self.groups.pokes.tolist()
        self._skin = readings_of([by_number[poke] for poke in pokes], order) if pokes else None
        self.state = RigState.at_prior(len(names), self.columns)
        self.trust = np.ones(len(self.landmarks))
        if begin is not None:
            added = np.zeros((LINEAR, self.columns - begin.columns))
            self.state = replace(begin.state, matrix=np.concatenate([begin.state.matrix, added], axis=1))
            self.trust = begin.trust
        points = sorted({poke.name for poke in self.landmarks})
        self._at_landmark = np.array([[poke.name == name for name in points] for poke in self.landmarks], dtype=float)
        self._shared, self._noisier = np.zeros((2 * len(self.landmarks),) * 2), 1.0
        self._last: tuple[RigRows, FloatArray] | None = None

    def step(self) -> None:
        """Move the rig and the groups to the minimum of the rows as they are here."""
        base, tops = self._without_groups(self.state.unknowns(self.scales))
        rows = self._landmark_rows(self.state)
        for _ in range(ROUNDS):
            self.trust = _trusted(rows, self._shared, *_solved(base, rows, self._shared, self.trust), self.trust)
        self._shared, self._noisier, _ = self._likeliest(base, rows, self.trust)
        step, _ = _solved(base, rows, self._shared, self.trust)
        self._last = (rows, base)
        self.state = self.state.moved(step, self.scales)
        if self.groups is not None:
            self.groups = self.groups.moved(np.stack([_group_move(top, step) for top in tops]))

    def likelihood(self, trust: FloatArray) -> float:
        """Return the logarithm of how likely landmark pokes are, (m,) by how far each counts, but for what all fits share."""
        assert self._last is not None
        rows, base = self._last
        return self._likeliest(base, rows, trust)[2]

    def _likeliest(self, base: FloatArray, rows: RigRows, trust: FloatArray) -> tuple[FloatArray, float, float]:
        """Return what is added to the covariance of landmark pokes, the likeliest of `PLACES_OFF` and `NOISIER`.

        Returns
        -------
        (2 m, 2 m), which of `NOISIER` is in it, and the logarithm of how likely the pokes are with it, but for a constant.
        """
        of_place = (rows.of_place[:, :, None] * self._at_landmark[:, None, :, None]).reshape(2 * len(self.landmarks), -1)
        alike = of_place @ of_place.T
        own, marginal = np.eye(len(alike)), _Marginal(base, rows, trust)
        every = [off**2 * alike + (noisier**2 - 1.0) * own for noisier in NOISIER for off in PLACES_OFF]
        likelihoods = [marginal.log_likelihood(added) for added in every]
        best = int(np.argmax(likelihoods))
        return every[best], NOISIER[best // len(PLACES_OFF)], likelihoods[best]

    def _landmark_rows(self, state: RigState) -> RigRows:
        return rig_rows(self._known, state, self._places, self._aim, self.noise, self.scales)

    def _without_groups(self, here: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Return the factor (n + 1, n + 1) of all rows but the landmarks', and each group's own rows on top of its factor."""
        kept, tops = [np.column_stack([np.eye(len(here)), here])], list[FloatArray]()
        if self.groups is not None and self._skin is not None:
            placed = self.groups.placed()
            rows = rig_rows(self._skin, self.state, placed.places, placed.spread, self.noise, self.scales)
            root = np.sqrt(SKIN * self.groups.trust)[:, None, None]
            own = rows.of_place @ placed.gradients
            every = root * np.concatenate([own, rows.of_rig, rows.misses[:, :, None]], axis=2)
            for group in range(self.groups.count):
                factor = qr_factor(every[self.groups.of == group].reshape(-1, every.shape[2]))
                tops.append(factor[: own.shape[2]])
                kept.append(factor[own.shape[2] :, own.shape[2] :])
        return qr_factor(np.concatenate(kept)), tops

    def answer(self, names: list[str]) -> RigAnswer:
        """Return what came out, tried on held-out pokes where the rows stood last."""
        assert self._last is not None
        rows, base = self._last
        reported = self._landmark_rows(RigState.at_prior(len(names), self.columns))
        held, predicted = self._held_out(rows, base)
        before, after = (np.average(np.sum(own**2, axis=1), weights=self.trust) for own in (reported.misses, held))
        # Squared misses in their predicted standard deviations: two numbers a poke.
        ratio = float(np.sqrt(np.average(_squares(held, predicted), weights=self.trust) / 2.0))
        # Misses are in standard deviations; this is how many metres one of them is on average.
        metre = np.sqrt(np.sum(reported.distances**2) / np.sum(reported.misses**2))
        unknowns, spread = self.posterior(self.columns)
        pokes = [poke.poke for poke in self.landmarks]
        return RigAnswer(
            correction=self.correction(unknowns, max(1.0, ratio) * spread, names),
            used=bool(after < BETTER * before),
            before=float(metre * np.sqrt(before)),
            after=float(metre * np.sqrt(after)),
            ratio=ratio,
            plain_ratio=float(np.sqrt(before / 2.0)),
            noisier=self._noisier,
            points=len({poke.name for poke in self.landmarks}),
            trust=dict(zip(pokes, self.trust.tolist(), strict=True)),
            distances=dict(zip(pokes, self.passed(unknowns).tolist(), strict=True)),
            unknowns=unknowns / self.scales,
            known=self.share_of_prior(spread),
        )

    def posterior(self, columns: int) -> tuple[FloatArray, FloatArray]:
        """Return (n,) the unknowns, SI, and (n, k) a root of their covariance.

        `columns` are those of C, at least its own; what a sensor of more has besides is zero.
        """
        assert self._last is not None
        rows, base = self._last
        root = _solved(base, rows, self._shared, self.trust)[1]
        own, size = len(self.scales), 6 * columns
        at = np.concatenate(
            [
                np.arange(size).reshape(6, columns)[:, : self.columns].ravel(),
                np.arange(size, size + own - 6 * self.columns),
            ]
        )
        unknowns, spread = np.zeros(at[-1] + 1), np.zeros((at[-1] + 1, own))
        unknowns[at] = self.state.unknowns(self.scales) * self.scales
        spread[at] = self.scales[:, None] * np.asarray(np.linalg.inv(root), dtype=np.float64)
        return unknowns, spread

    def share_of_prior(self, spread: FloatArray) -> FloatArray:
        """Return (n,) the sd of each unknown, by a root (n, k) of their covariance, over that of its prior, at most 1."""
        return np.minimum(np.linalg.norm(spread, axis=1) / self.scales, 1.0)

    def passed(self, unknowns: FloatArray) -> FloatArray:
        """Return (m,) metres, how far each landmark is passed under (n,) unknowns, SI."""
        at_prior = RigState.at_prior(len(self.state.turns), self.columns)
        return self._landmark_rows(at_prior.moved(unknowns / self.scales, self.scales)).distances

    def correction(self, unknowns: FloatArray, spread: FloatArray, names: list[str]) -> Correction:
        """Return the correction by (n,) unknowns, SI, whose covariance has the root `spread` (n, m)."""
        of_matrix = 6 * self.columns
        matrix, poses = unknowns[:of_matrix].reshape(6, -1), unknowns[of_matrix:].reshape(-1, 2, 3)
        kept = len(unknowns) if len(names) <= POSES_KEPT else of_matrix
        return Correction(
            np.eye(6) + matrix[:, :LINEAR],
            motions={name: rigid_motion(*pose) for name, pose in zip(names, poses, strict=True)},
            quadratic=matrix[:, LINEAR:],
            root=spread if spread.shape == (kept, kept) else _first_rows(spread, kept),
        )

    def _held_out(self, rows: RigRows, base: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how landmark pokes are missed, each under the correction made without its quarter of the landmarks.

        Returns
        -------
        (m, 2) the misses, and (m, 2, 2) the covariance that is predicted for each.
        """
        held, predicted = np.empty_like(rows.misses), np.empty((len(rows.misses), 2, 2))
        names = sorted({poke.name for poke in self.landmarks})
        quarter = np.array([names.index(poke.name) % HELD_OUT for poke in self.landmarks])
        for out in range(HELD_OUT):
            own = quarter == out
            step, root = _solved(base, rows, self._shared, np.where(own, 0.0, self.trust))
            held[own] = rows.misses[own] + rows.of_rig[own] @ step
            predicted[own] = _own_blocks(self._shared)[own] + _leverage(rows.of_rig[own], root)
        return held, predicted


def _rigid_groups(request: RigRequest) -> RigidGroups | None:
    """Return what moves with the skin pokes, from where the rig as it reports itself puts it."""
    scene, surface = request.scene, request.surface
    table = ContactTable(request.contacts)
    layout = scene.skin.layout
    answered = sorted({channel for contact in request.contacts for channel in contact.channels.tolist()} - request.dead.keys())
    channels = answered if layout is None else [channel for channel in answered if layout.module_of[channel] >= 0]
    method = Method.FREE if surface is None else Method.SURFACE
    estimates = estimate_from(table, channels, [method], scene.noise, surface)[method]
    if layout is None:
        return taxel_groups(table, estimates, scene.noise, channels)
    return module_groups(table, ModuleModel(layout, scene.skin.anchor, surface), estimates, scene.noise, channels)


def readings_of(pokes: Sequence[Contact | LandmarkPoke], order: Mapping[str, int]) -> RigReadings:
    """Return the readings of at least one poke; `order` is the index of each arm pose by its name."""
    return RigReadings(
        np.array([np.concatenate([poke.force, poke.moment]) for poke in pokes]),
        np.array([order[poke.pose] for poke in pokes]),
        np.array([poke.link_from_sensor for poke in pokes]),
    )


def qr_factor(rows: FloatArray) -> FloatArray:
    """Return R of the QR of rows, square or with fewer rows than columns."""
    factor: Any = np.linalg.qr(rows, mode="r")
    return np.asarray(factor, dtype=np.float64)


def _first_rows(root: FloatArray, count: int) -> FloatArray:
    """Return (count, count) upper triangular U, U U' the covariance of the first unknowns under that of all, root root'."""
    return np.ascontiguousarray(qr_factor(root[count - 1 :: -1].T).T[::-1, ::-1])


def _solved(base: FloatArray, rows: RigRows, shared: FloatArray, trust: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the minimum of all rows, those of landmarks by their trust.

    Parameters
    ----------
    shared : (2 m, 2 m) what errors that pokes share add to the covariance of the rows, of which each has one by itself

    Returns
    -------
    (n,) the step from the prior's zero, and (n, n) upper triangular the root of the information, root' root.
    """
    own, whiten = _counting(rows, shared, trust)
    factor = qr_factor(np.concatenate([base, whiten @ own]))
    root = factor[:-1, :-1]
    return -np.asarray(np.linalg.solve(root, factor[:-1, -1]), dtype=np.float64), root


def _counting(rows: RigRows, shared: FloatArray, trust: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (k, n + 1) the rows of pokes that count with their misses, and (k, k) what makes them independent."""
    counts = np.repeat(trust > 0.0, 2)
    own = np.concatenate([rows.of_rig, rows.misses[:, :, None]], axis=2).reshape(len(counts), -1)[counts]
    covariance = shared[np.ix_(counts, counts)] + np.diag(np.repeat(1.0 / trust[trust > 0.0], 2))
    return own, np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)


class _Marginal:
    """How likely the landmarks' misses are under the prior and the skin pokes, for what may be added to their covariance."""

    def __init__(self, base: FloatArray, rows: RigRows, trust: FloatArray) -> None:
        self._counts = np.repeat(trust > 0.0, 2)
        own = rows.of_rig.reshape(len(self._counts), -1)[self._counts]
        root, right = base[: own.shape[1], :-1], base[: own.shape[1], -1]
        self._misses = rows.misses.ravel()[self._counts] - own @ np.linalg.solve(root, right)
        spread = np.linalg.solve(root.T, own.T)
        self._known = spread.T @ spread + np.diag(np.repeat(1.0 / trust[trust > 0.0], 2))

    def log_likelihood(self, added: FloatArray) -> float:
        """Return the logarithm of the density, but for a constant."""
        factor = np.linalg.cholesky(self._known + added[np.ix_(self._counts, self._counts)])
        return -float(np.sum(np.linalg.solve(factor, self._misses) ** 2) / 2.0 + np.sum(np.log(np.diag(factor))))


def _own_blocks(shared: FloatArray) -> FloatArray:
    """Return (m, 2, 2) the covariance of each poke's rows by themselves."""
    count = len(shared) // 2
    at = np.arange(count)
    return np.eye(2) + shared.reshape(count, 2, count, 2)[at, :, at]


def _trusted(rows: RigRows, shared: FloatArray, step: FloatArray, root: FloatArray, trust: FloatArray) -> FloatArray:
    """Return the trust of landmark pokes by what all others predict for each.

    With H = A (root' root)^-1 A' of a poke that counts k, its miss r under the fit has the covariance 1/k - H where all is
    noise: so r' (I - k H)^-1 r is chi-square for a poke that counts fully, and (I + H) takes the place for one that does not.
    What pokes share stands beside the I.
    """
    leverage = _leverage(rows.of_rig, root)
    counts = (trust > 0.5)[:, None, None]
    total = _own_blocks(shared) + np.where(counts, -trust[:, None, None] * leverage, leverage)
    # Rounding may leave a square below zero.
    found = trust_from_squares(np.maximum(_squares(rows.misses + rows.of_rig @ step, total), 0.0))
    return found if found.sum() >= LEFT * len(found) else np.ones(len(found))


def _leverage(of_rig: FloatArray, root: FloatArray) -> FloatArray:
    """Return (m, 2, 2) A (root' root)^-1 A' of the rows A (m, 2, n) of each poke."""
    spread = np.asarray(np.linalg.solve(root.T, of_rig.reshape(-1, of_rig.shape[2]).T), dtype=np.float64)
    spread = spread.T.reshape(*of_rig.shape[:2], -1)
    return spread @ spread.transpose(0, 2, 1)


def _squares(misses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return (m,) the squares of misses (m, 2) in standard deviations of their covariances (m, 2, 2)."""
    return np.sum(misses * np.asarray(np.linalg.solve(covariances, misses[:, :, None])[:, :, 0]), axis=1)


def _group_move(top: FloatArray, step: FloatArray) -> FloatArray:
    """Return (d,) how a group moves where the rig takes a step; of the smallest norm where its pokes do not say."""
    unknowns = top.shape[1] - 1 - len(step)
    right = -(top[:, -1] + top[:, unknowns:-1] @ step)
    return np.asarray(np.linalg.lstsq(top[:, :unknowns], right, rcond=1e-9)[0], dtype=np.float64)
