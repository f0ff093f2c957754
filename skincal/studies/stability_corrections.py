"""Stability cases of a rig's correction, and the same in 80 digits.

Choices are made in double precision by the program's rule, here too: trust of pokes, the likeliest noise of landmark pokes.
Everything else is computed in another way. The program solves for n unknowns x by QR of the prior's rows and the pokes',
whitened. Here, with J the slopes of a step's rows, r their misses, R their covariance and P that of the prior,

    x = P J' S^-1 (J x0 - r),   S = J P J' + R,   covariance P - P J' S^-1 J P,

as many equations as rows. P is diagonal, and for the matrix C it is U x V over its rows and columns, so J P J' is a product of
small matrices. Slopes with the arm's poses are differences in 80 digits. The uncertainty of a correction is compared by its
effect on a poke on the skin, metres.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.geometry import orthonormal_pair as pairs_across
from skincal.model.scene import NoiseSettings, load_scene, resource
from skincal.modules.pose_fit import trust_from_squares
from skincal.pokes import LandmarkPokes
from skincal.rig.correction import TYPICAL_PRESS_FORCE_N, CorrectionErrors, RigPrior, products
from skincal.rig.correction_fit import (
    GAUSS_NEWTON_STEPS,
    LANDMARK_HELD_OUT_FOLDS,
    LANDMARK_OFFSETS_M,
    MIN_LIKELIHOOD_RATIO_OF_LANDMARK_ERRORS,
    MIN_MEAN_LANDMARK_POKE_TRUST,
    NOISE_FACTORS,
    NONLINEAR_FIT_STEPS,
    NONLINEAR_SENSOR_QUADRATIC_SHARE,
    SENSOR_MODEL_MIN_LOG_LIKELIHOOD_RATIO,
    TRUST_UPDATES_PER_FIT_STEP,
    RigAnswer,
    RigRequest,
    correct_rig,
)
from skincal.studies.reference_80_digits import (
    DIFFERENCE_STEP,
    MP,
    Exact,
    cross,
    dot,
    rotate,
    solve_positive,
    to_float,
    to_mp,
    two_across,
)
from skincal.studies.reference_80_digits import unit as unit_of
from skincal.studies.stability_cases import (
    AddedCase,
    CaseSizes,
    Outputs,
    arm_poses,
    cone,
    unit,
)

LINEAR_COLUMNS, ALL_COLUMNS = 6, 27
"""Columns of the matrix C: of a wrench's components, and with their products."""


@dataclass(frozen=True, slots=True, eq=False)
class CorrectionInputs:
    """Pokes at landmarks, and one on the skin in each arm pose."""

    wrenches: FloatArray
    """(m, 6) float, N and N m, sensor frame; those on the skin last."""
    places: FloatArray
    """(l, 3) float, metres, link frame: landmarks, then the points on the skin."""
    at: IntArray
    """(m,) index into `places`."""
    poses: FloatArray
    """(g, 4, 4) float: link_from_sensor as reported."""
    pose_of: IntArray
    """(m,) index into `poses`."""
    noise: NoiseSettings
    prior: RigPrior

    @property
    def landmark_count(self) -> int:
        """Number of pokes at landmarks."""
        return len(self.at) - len(self.poses)


class _Equations(NamedTuple):
    """Equations of a step, in exact numbers or in floats, and for rows of m pokes.

    `prior` (2m, 2m) is J P J', `wanted` (2m,) is J x0 - r, `noise` (m, 2, 2) is D, `alike` (2m, 2m) the part of R by a metre of
    landmark error.
    """

    prior: Exact
    wanted: Exact
    noise: Exact
    alike: Exact

    def covariance(self, trust: FloatArray, choice: tuple[float, float]) -> Exact:
        """Return R (2m, 2m) for the pokes' trust, and for a choice of noise factor and landmark error (m)."""
        at, (noisier, off) = np.arange(len(trust)), choice
        every = self.alike * off**2
        own = every.reshape(len(at), 2, len(at), 2)
        own[at, :, at] = own[at, :, at] + self.noise * (noisier**2 - 1.0 + 1.0 / np.where(trust > 0, trust, 1.0))[:, None, None]
        return every

    def solve(self, trust: FloatArray, choice: tuple[float, float]) -> _Posterior:
        counts = np.flatnonzero(np.repeat(trust > 0, 2))
        total = (self.prior + self.covariance(trust, choice))[np.ix_(counts, counts)]
        pulls, log = solve_positive(total, self.wanted[counts])
        return _Posterior(counts, total, pulls, -(dot(self.wanted[counts], pulls) + log) / 2)

    def predict_misses(self, found: _Posterior) -> tuple[Exact, Exact]:
        """Return the misses (m, 2) after a step, and J C J' (m, 2, 2) of each poke."""
        seen, count = self.prior[:, found.counts], len(self.noise)
        known = self.prior - seen @ solve_positive(found.covariance, seen.T)[0]
        return (seen @ found.pulls - self.wanted).reshape(count, 2), _blocks(known)

    def own(self, choice: tuple[float, float]) -> Exact:
        return _blocks(self.covariance(np.ones(len(self.noise)), choice))

    def rounded(self) -> _Equations:
        return _Equations(*map(to_float, self))


class _Posterior(NamedTuple):
    """Result of a step: x = P J' pulls, the rows `counts` it used, their covariance S, and log density but for a constant."""

    counts: IntArray
    covariance: Exact
    pulls: Exact
    log: Any


def _blocks(covariance: Exact) -> Exact:
    at = np.arange(len(covariance) // 2)
    return covariance.reshape(len(at), 2, len(at), 2)[at, :, at]


class _Fit:
    """The program's steps from landmark pokes in 80 digits, from the fit `begin` or from zero."""

    def __init__(self, pokes: CorrectionInputs, quadratic: float, begin: _Fit | None, steps: int) -> None:
        units, prior = TYPICAL_PRESS_FORCE_N * np.repeat([1.0, pokes.prior.arm], 3), pokes.prior
        columns = [to_mp(prior.matrix) / to_mp(units)]
        if quadratic:
            columns.append(to_mp(quadratic) / to_mp(products(units[None])[0]))
        self.pokes, self._own = pokes, np.arange(pokes.landmark_count)
        self._units, self.columns = to_mp(units) ** 2, np.concatenate(columns) ** 2
        self._turns = to_mp(np.repeat([prior.pose_turn, prior.pose_shift], 3)) ** 2
        wrenches = to_mp(pokes.wrenches)
        first, second = np.triu_indices(6)
        every = np.concatenate([wrenches, wrenches[:, first] * wrenches[:, second]], axis=1)
        self._features = every[:, : len(self.columns)]
        self.trust, self._chosen = np.ones(pokes.landmark_count), (1.0, 0.0)
        self.matrix, self.poses = to_mp(np.zeros((6, len(self.columns)))), to_mp(np.zeros((len(pokes.poses), 6)))
        if begin is not None:
            self.trust, self.poses = begin.trust, begin.poses
            self.matrix[:, : len(begin.columns)] = begin.matrix
        for _ in range(steps):
            self._iterate()

    def _rows(self) -> list[Exact]:
        """Compute rows r = E (m' - c x f')/|f| of the landmark pokes, E any two directions across the measured push.

        Returns
        -------
        r (m, 2), its change with the added wrench (m, 2, 6), with turn and shift of the pose (m, 2, 6) and with the place
        (m, 2, 3), and the noise D (m, 2, 2)
        """
        pokes = self.pokes
        wrenches, poses = to_mp(pokes.wrenches), to_mp(pokes.poses)[pokes.pose_of]
        size = np.sqrt(dot(wrenches[:, :3], wrenches[:, :3]))[:, None, None]
        pairs = two_across(unit_of(wrenches[:, :3])) / size
        corrected = wrenches + self._features @ self.matrix.T
        reached = to_mp(pokes.places)[pokes.at] - poses[:, :3, 3]
        there = (reached[:, None] @ poses[:, :3, :3])[:, 0]
        force, moment = corrected[:, None, :3], corrected[:, None, 3:]

        def lever(change: Exact) -> Exact:
            own = self.poses[pokes.pose_of] + change
            return rotate(there - own[:, 3:], -own[:, :3])[:, None]

        def missed(change: Exact) -> Exact:
            return dot(pairs, moment - cross(lever(change), force))

        here, still = lever(self._turns * 0), missed(self._turns * 0)
        slopes = [(missed(one * DIFFERENCE_STEP) - still) / DIFFERENCE_STEP for one in to_mp(np.eye(6))]
        # e.(f x dc) = (e x f).dc, and e.(df x c) = (c x e).df.
        of_lever, of_force = cross(pairs, force), cross(here, pairs)
        noise = pokes.noise
        variances = to_mp([noise.moment, noise.force, pokes.prior.landmark]) ** 2
        terms = zip(variances, (pairs, of_force, of_lever), strict=True)
        added: Exact = sum(variance * (each @ each.swapaxes(1, 2)) for variance, each in terms)
        turn = rotate(to_mp(np.eye(3))[None], -self.poses[pokes.pose_of][:, None, :3])
        of_place = of_lever @ turn.swapaxes(1, 2) @ poses[:, :3, :3].swapaxes(1, 2)
        every = still, np.concatenate([of_force, pairs], axis=2), np.stack(slopes, axis=2), of_place, added
        return [each[self._own] for each in every]

    def _together(self, one: tuple[Exact, Exact, IntArray], other: tuple[Exact, Exact, IntArray]) -> Exact:
        """Return J P J' of rows with rows: of the wrench (m, r, 6) and of the pose (m, r, 6), and whose pokes they are."""
        (wrench, pose, of), (others, poses, at) = one, other
        features = (self._features[of] * self.columns) @ self._features[at].T
        both = (wrench * self._units).reshape(-1, 6) @ others.reshape(-1, 6).T
        turns = (pose * self._turns).reshape(-1, 6) @ poses.reshape(-1, 6).T
        same = (self.pokes.pose_of[of][:, None] == self.pokes.pose_of[at]).astype(int)

        def spread(of_pokes: Exact) -> Exact:
            return of_pokes.repeat(wrench.shape[1], axis=0).repeat(others.shape[1], axis=1)

        return both * spread(features) + turns * spread(same)

    def _iterate(self) -> None:
        misses, of_wrench, of_pose, of_place, noise = self._rows()
        self._parts = of_wrench, of_pose, self._own
        wanted = (self.shifts(*self._parts) - misses).ravel()
        places, of = of_place.reshape(-1, 3), self.pokes.at[self._own].repeat(2)
        alike = places @ places.T * (of[:, None] == of).astype(int)
        self._last = _Equations(self._together(self._parts, self._parts), wanted, noise, alike)
        rounded = self._last.rounded()
        for _ in range(TRUST_UPDATES_PER_FIT_STEP):
            self.trust = self._trusted(rounded)
        self._chosen = self._likeliest(rounded, self.trust)
        # P J' S^-1 (J x0 - r).
        found = self._last.solve(self.trust, self._chosen)
        wrench, pose = (part.reshape(-1, 6)[found.counts] * found.pulls[:, None] for part in self._parts[:2])
        of = np.repeat(self._own, 2)[found.counts]
        self.matrix = self._units[:, None] * (wrench.T @ self._features[of]) * self.columns
        pose_of = self.pokes.pose_of[of]
        self.poses = np.array([self._turns * pose[pose_of == g].sum(axis=0) for g in range(len(self.pokes.poses))])

    def shifts(self, of_wrench: Exact, of_pose: Exact, of: IntArray) -> Exact:
        """Return J x of rows of the pokes `of`, such as the shifts of their axes."""
        wrench = (self._features[of] @ self.matrix.T)[:, None]
        return dot(of_wrench, wrench) + dot(of_pose, self.poses[self.pokes.pose_of[of], None])

    def _likeliest(self, rounded: _Equations, trust: FloatArray) -> tuple[float, float]:
        """Choose noise factor and landmark error (m) by likelihood."""
        choices = [(noisier, off) for noisier in NOISE_FACTORS for off in LANDMARK_OFFSETS_M]
        return max(choices, key=lambda choice: rounded.solve(trust, choice).log)

    def _trusted(self, rounded: _Equations) -> FloatArray:
        left, leverage = rounded.predict_misses(rounded.solve(self.trust, self._chosen))
        counts = np.where(self.trust > 0.5, -self.trust, 1.0)[:, None, None]
        found = trust_from_squares(np.maximum(_squares(left, rounded.own(self._chosen) + counts * leverage), 0.0))
        return found if found.sum() >= MIN_MEAN_LANDMARK_POKE_TRUST * len(found) else np.ones(len(found))

    def log_likelihood(self, trust: FloatArray) -> Any:
        """Return the log density of the whitened rows, but for a constant; it leaves out their noise."""
        noise = self._last.noise[trust > 0]
        within = sum(MP.log(each[0, 0] * each[1, 1] - each[0, 1] * each[1, 0]) for each in noise)
        return self._last.solve(trust, self._likeliest(self._last.rounded(), trust)).log + within / 2

    def ratio(self) -> Any:
        """Return the ratio of measured to predicted misses of held-out landmark pokes."""
        named = [str(at) for at in self.pokes.at[self._own].tolist()]
        names, total = sorted(set(named)), MP.zero
        quarter = np.array([names.index(name) % LANDMARK_HELD_OUT_FOLDS for name in named])
        for out in range(LANDMARK_HELD_OUT_FOLDS):
            own = quarter == out
            left, known = self._last.predict_misses(self._last.solve(np.where(own, 0.0, self.trust), self._chosen))
            total = total + dot(_squares(left[own], (self._last.own(self._chosen) + known)[own]), self.trust[own])
        return MP.sqrt(total / self.trust.sum() / 2)

    def unknowns(self) -> Exact:
        """Return the unknowns in standard deviations of their prior, first those of C, row by row."""
        roots = np.sqrt(self._units), np.sqrt(self.columns)
        matrix = self.matrix / roots[0][:, None] / roots[1]
        return np.concatenate([matrix.ravel(), (self.poses / np.sqrt(self._turns)).ravel()])

    def on_skin(self) -> tuple[Exact, Exact, Exact]:
        """Return the shifts (m) of the axes of pokes on the skin by wrench and pose errors, and the indices of these pokes."""
        pokes = self.pokes
        of = np.arange(pokes.landmark_count, len(pokes.at))
        wrenches, poses = to_mp(pokes.wrenches)[of], to_mp(pokes.poses)[pokes.pose_of[of]]
        return (*axes_off(wrenches, poses, to_mp(pokes.places)[pokes.at[of]]), of)

    def spread(self, skin: tuple[Exact, Exact, IntArray]) -> Exact:
        """Return (k, 3, 3) the covariance of the axes of k pokes on the skin, over the errors that landmarks may have."""
        rounded, choices = self._last.rounded(), [(noisier, off) for noisier in NOISE_FACTORS for off in LANDMARK_OFFSETS_M]
        logs = np.array([float(rounded.solve(self.trust, choice).log) for choice in choices])
        kept = np.flatnonzero(logs > logs.max() + np.log(MIN_LIKELIHOOD_RATIO_OF_LANDMARK_ERRORS)).tolist()
        count, at = len(skin[2]), np.arange(len(skin[2]))
        every = self._together(skin, skin).reshape(count, 3, count, 3)[at, :, at]
        across, here = self._together(skin, self._parts), self.shifts(*skin)
        total, moments = MP.zero, to_mp(np.zeros((count, 3, 3)))
        for found in (self._last.solve(self.trust, choices[index]) for index in kept):
            seen, weight = across[:, found.counts], MP.exp(found.log - logs.max())
            solved = solve_positive(found.covariance, seen.T)[0].T.reshape(count, 3, -1)
            known = every - seen.reshape(count, 3, -1) @ solved.swapaxes(1, 2)
            moved = (seen @ found.pulls).reshape(count, 3) - here
            total, moments = total + weight, moments + weight * (known + moved[:, :, None] * moved[:, None])
        return moments / total


def axes_off(wrenches: Exact, poses: Exact, places: Exact) -> tuple[Exact, Exact]:
    """Return the shifts (m, 3, 6) of axes across their pushes at `places` (m, 3), by wrench errors and by pose errors."""
    force = wrenches[:, None, :3]
    size = np.sqrt(dot(force, force))[:, :, None]
    here = (places - poses[:, :3, 3])[:, None] @ poses[:, :3, :3]
    eye = to_mp(np.eye(3))[None]
    # By each component of a force -c x df, of a moment dm, of a turn f x (c x w), of a shift -f x t.
    moments = [-cross(here, eye), eye + 0 * here, cross(force, cross(here, eye)), -cross(force, eye + 0 * here)]
    across = [cross(force / size, each / size) for each in moments]
    off = [(each @ poses[:, :3, :3].swapaxes(1, 2)).swapaxes(1, 2) for each in across]
    return np.concatenate(off[:2], axis=2), np.concatenate(off[2:], axis=2)


def _squares(misses: Exact, covariances: Exact) -> Exact:
    """Return the squared Mahalanobis lengths (m,) of misses (m, 2)."""
    (xx, xy), (_, yy) = covariances.transpose(1, 2, 0)
    x, y = misses.T
    return (yy * x * x - 2 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)


def exact_correction(pokes: CorrectionInputs) -> Outputs:
    """Compute the unknowns of a rig's correction, and the covariance that it leaves to the axes of the pokes on the skin."""
    linear = _Fit(pokes, pokes.prior.quadratic, None, GAUSS_NEWTON_STEPS)
    bent = _Fit(pokes, NONLINEAR_SENSOR_QUADRATIC_SHARE, linear, NONLINEAR_FIT_STEPS)
    counts = np.minimum(linear.trust, bent.trust)
    gap = bent.log_likelihood(counts) - linear.log_likelihood(counts)
    likelier = bent if gap > 0 else linear
    more, skin = max(MP.one, likelier.ratio()) ** 2, likelier.on_skin()
    if abs(gap) > SENSOR_MODEL_MIN_LOG_LIKELIHOOD_RATIO:
        return {"unknowns": likelier.unknowns(), "uncertainty": more * likelier.spread(skin)}
    chance = 1 / (1 + MP.exp(-gap))
    off = linear.shifts(*skin) - bent.shifts(*skin)
    both = (1 - chance) * linear.spread(skin) + chance * bent.spread(skin)
    both = both + chance * (1 - chance) * off[:, :, None] * off[:, None]
    one, other = linear.unknowns(), bent.unknowns()
    wide = other * 0
    of_matrix = 6 * len(bent.columns)
    wide[:of_matrix].reshape(6, -1)[:, :LINEAR_COLUMNS] = one[: 6 * LINEAR_COLUMNS].reshape(6, -1)
    wide[of_matrix:] = one[6 * LINEAR_COLUMNS :]
    return {"unknowns": (1 - chance) * wide + chance * other, "uncertainty": more * both}


def shipped_correction(pokes: CorrectionInputs) -> Outputs:
    """Compute the same by the program."""
    answer = correct_by_landmarks(pokes)
    if answer.correction is None or min(answer.trust.values()) < 1.0:
        raise ValueError("a case whose landmark pokes do not all count")
    of = np.arange(pokes.landmark_count, len(pokes.at))
    contacts = {
        at: Contact(at, 0.0, 1.0, pokes.wrenches[at, :3], pokes.wrenches[at, 3:], np.array([0]), np.ones(1),
                    pokes.poses[pokes.pose_of[at]], f"{pokes.pose_of[at]}", 0.0, True)
        for at in of.tolist()
    }  # fmt: skip
    pushes = (pokes.poses[pokes.pose_of[of], :3, :3] @ pokes.wrenches[of, :3, None])[:, :, 0]
    pairs = pairs_across(unit(pushes))
    alike, _ = CorrectionErrors(answer.correction, contacts.__getitem__)(of, pokes.places[pokes.at[of]], pairs)
    off = pairs.transpose(0, 2, 1) @ alike
    return {"unknowns": answer.unknowns, "uncertainty": off @ off.transpose(0, 2, 1)}


def correct_by_landmarks(pokes: CorrectionInputs) -> RigAnswer:
    """Correct a rig by the program."""
    scene = replace(load_scene(resource("scenes/icub-forearm/scene.toml")), noise=pokes.noise)
    of = np.arange(pokes.landmark_count)
    forces, moments = pokes.wrenches[of, :3], pokes.wrenches[of, 3:]
    known = LandmarkPokes(
        of, forces, moments, pokes.poses[pokes.pose_of[of]], pokes.pose_of[of].astype(np.str_), pokes.at[of].astype(np.str_),
        pokes.places[pokes.at[of]],
    )  # fmt: skip
    return correct_rig(RigRequest(scene, None, [], known, prior=pokes.prior))


# ---- cases ----


@dataclass(frozen=True, slots=True)
class LandmarkSession:
    """A wrong rig that is poked at landmarks, each of them in each pose."""

    landmarks: int = 6
    poses: int = 2
    line: float = 1.0
    """Factor on the landmarks' distances from a line."""
    tilt: float = 0.7
    """rad, within which the pushes lie about one direction."""
    wrong: float = 0.02
    """sd of each entry of the sensor's matrix."""
    bent: float = 0.0
    """The same for products of a wrench's components."""
    places_off: float = 0.0
    """m, error of the landmarks."""
    noise: NoiseSettings = field(default_factory=NoiseSettings)

    def simulate(self, rng: np.random.Generator) -> CorrectionInputs:
        """Simulate the pokes."""
        noise, prior, landmarks, poses = self.noise, RigPrior(), self.landmarks, self.poses
        reported = arm_poses(rng, poses, 0.3)
        count = landmarks * poses
        along, known = unit(rng.normal(size=3)), 0.08 * rng.normal(size=(landmarks, 3))
        across_line = known - (known @ along)[:, None] * along
        known = 0.1 * unit(rng.normal(size=3)) + known - (1.0 - self.line) * across_line
        at = np.concatenate([np.arange(count) % landmarks, landmarks + np.arange(poses)])
        pose_of = np.concatenate([np.arange(count) // landmarks % poses, np.arange(poses)])
        places = np.concatenate([known, 0.1 * rng.normal(size=(poses, 3))])
        true = places + self.places_off * rng.normal(size=places.shape)
        pushes = np.concatenate([cone(rng, count, self.tilt, unit(rng.normal(size=3))), unit(rng.normal(size=(poses, 3)))])
        turns, shifts = reported[pose_of, :3, :3], reported[pose_of, :3, 3]
        touched = true[at] + 0.0007 * rng.normal(size=(len(at), 3)) + 0.001 * rng.normal(size=(poses, 3))[pose_of]
        force = (pushes[:, None] @ turns)[:, 0] * rng.uniform(6.0, 12.0, (len(at), 1))
        moment = np.cross(((touched - shifts)[:, None] @ turns)[:, 0], force)
        wrenches = np.concatenate([force, moment], axis=1)
        units = TYPICAL_PRESS_FORCE_N * np.repeat([1.0, prior.arm], 3)
        own = wrenches / units
        off = own @ (self.wrong * rng.normal(size=(6, 6))) + products(own) @ (self.bent * rng.normal(size=(21, 6)))
        spread = np.repeat([noise.force, noise.moment], 3) * rng.normal(size=wrenches.shape)
        return CorrectionInputs(wrenches + off * units + spread, places, at, reported, pose_of, noise, prior)


CORRECTION_CASES = {
    "rig as modelled": LandmarkSession(),
    "four landmarks, two pokes each": LandmarkSession(landmarks=4),
    "landmarks within 0.1 mm of a line": LandmarkSession(line=1e-3),
    "pushes within 1e-3 rad": LandmarkSession(tilt=1e-3),
    "noise of 1e-4 of what is usual": LandmarkSession(noise=NoiseSettings(force=1e-5, moment=1e-6)),
    "noise of 30 times what is usual": LandmarkSession(noise=NoiseSettings(force=3.0, moment=0.3), wrong=0.002),
    "sensor not linear": LandmarkSession(bent=0.05),
    "landmarks 4 mm off": LandmarkSession(places_off=0.004),
}


def correction_cases(rng: np.random.Generator, sizes: CaseSizes) -> Iterator[AddedCase]:
    """Yield a correction for each session of `CORRECTION_CASES`."""
    del sizes
    for name, session in CORRECTION_CASES.items():
        pokes = session.simulate(rng)
        yield AddedCase(f"correction, {name}", pokes, shipped_correction, exact_correction, pokes.landmark_count)
