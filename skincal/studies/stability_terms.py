"""What the program adds to the methods, beside the same in 80 digits: a rig's correction, covariances, heights, distances.

The bar is that of `stability`. What a formula is conditional on, it is here too: the trust of pokes and the likeliest noise of
landmark pokes are choices, made in double precision by their rule. What follows from the inputs is worked out another way.

**A rig's correction.** The program solves for n unknowns x by QR of the prior's rows and the pokes', whitened. Here, with J the
slopes of a step's rows, r their misses, R their covariance and P that of the prior,

    x = P J' S^-1 (J x0 - r),   S = J P J' + R,   covariance P - P J' S^-1 J P,

as many equations as rows. P is diagonal, and of the matrix C it is U x V over its rows and columns, so J P J' is a product of
small ones: neither the 162 columns of a sensor that is not linear nor any factor of them is formed. Slopes with the arm's poses
are differences in 80 digits. How a correction is uncertain is compared by what it does to a poke on the skin, metres.

**Covariances.** A poke whose wrench and pose are off by x shifts its axis across the push by u x (dm - c x df)/|f|, and a
module by N^-1 sum A'D^-1 times that. **A height** z is one more unknown beside the module's, with n for its slope. **Known
distances** are rows beside the inverse of P.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.geometry import orthonormal_pair as pairs_across
from skincal.mesh.surface import make_surface
from skincal.model.scene import KnownDistance, NoiseSettings, load_scene, resource
from skincal.modules.distances import GAUSS_NEWTON_STEPS as DISTANCE_STEPS
from skincal.modules.distances import apply_distances
from skincal.modules.estimate import FittedModule, estimate_modules
from skincal.modules.off_surface import MAX_HEIGHT_SD_M, MAX_THICKNESS_SDS, MIN_HEIGHT_SDS
from skincal.modules.pose import LEVER_M, ModulePoses, ModulesOnSurface
from skincal.modules.pose_fit import trust_from_squares
from skincal.rig.correction import HAND_LOAD_N, Correction, CorrectionErrors, RigPrior, products
from skincal.rig.correction_fit import (
    GAUSS_NEWTON_STEPS,
    HELD_OUT_PARTS,
    LANDMARK_OFFSETS_M,
    MIN_TRUSTED_SHARE,
    MODEL_LOG_ODDS,
    NOISE_FACTORS,
    NONLINEAR_STEPS,
    QUADRATIC_SHARE,
    TRUST_ROUNDS,
    LandmarkPoke,
    RigAnswer,
    RigRequest,
    correct_rig,
)
from skincal.studies.exact import (
    MP,
    Exact,
    ExactPads,
    ExactPokes,
    ExactPose,
    InPlane,
    begin_of,
    cross,
    dot,
    exactly,
    find,
    floats,
    pokes_of,
    two_across,
    weighed,
)
from skincal.studies.exact import unit as unit_of
from skincal.studies.stability_cases import (
    PADS,
    CaseSizes,
    ModuleCase,
    arm_poses,
    cone,
    contacts_of,
    in_space,
    model_of,
    moved,
    on_sheet,
    placed,
    unit,
)
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Estimate, Method, State

Said: TypeAlias = dict[str, Any]
"""Numbers by what they are: arrays of floats from the program, of exact ones from here."""
_np: Any = np
_STEP = MP.mpf("1e-30")
_LINEAR = 6
_SEED = 20261123


def _sinc(angle: Any) -> Any:
    return MP.sin(angle) / angle if angle else MP.one


_sincs: Any = _np.frompyfunc(_sinc, 1, 1)


def turned(v: Exact, by: Exact) -> Exact:
    """Return `v` (..., 3) turned about `by` (..., 3) by its length, rad: v + sinc b x v + (1 - cos)/b^2 b x (b x v)."""
    angle = np.sqrt((by * by).sum(axis=-1, keepdims=True))
    once = cross(by, v)
    return v + _sincs(angle) * once + _sincs(angle / 2) ** 2 / 2 * cross(by, once)


def eliminated(matrix: Exact, right: Exact) -> tuple[Exact, Any]:
    """Return the solution of equations whose matrix (n, n) is symmetric and positive, and the logarithm of its determinant."""
    if matrix.dtype == float:
        return _np.linalg.solve(matrix, right), _np.linalg.slogdet(matrix)[1]
    count, log = len(matrix), MP.zero
    rows = _np.column_stack([matrix, right])
    for k in range(count):
        log += MP.log(rows[k, k])
        rows[k] = rows[k] / rows[k, k]
        rows[k + 1 :] = rows[k + 1 :] - rows[k + 1 :, k][:, None] * rows[k]
    for k in range(count - 1, 0, -1):
        rows[:k] = rows[:k] - rows[:k, k][:, None] * rows[k]
    return rows[:, count:].reshape(np.shape(right)), log


def inverted(matrix: Exact) -> Exact:
    """Return the inverse of a symmetric positive matrix."""
    return eliminated(matrix, exactly(np.eye(len(matrix))))[0]


# ---- a rig's correction ----


@dataclass(frozen=True, slots=True, eq=False)
class Landmarked:
    """Pokes at landmarks, and one on the skin in each arm pose: every number is an input."""

    wrenches: FloatArray
    """(m, 6) float, N and N m, sensor frame; the last of them are those on the skin."""
    places: FloatArray
    """(l, 3) float, metres, link frame: landmarks, then the places on the skin."""
    at: IntArray
    """(m,) which of the places a poke is at."""
    poses: FloatArray
    """(g, 4, 4) float: link_from_sensor as reported."""
    pose_of: IntArray
    """(m,)"""
    noise: NoiseSettings
    prior: RigPrior

    def moved(self, rng: np.random.Generator) -> Landmarked:
        """Return it with every number moved by one unit in its last place."""
        poses = self.poses.copy()
        poses[:, :3] = moved(poses[:, :3], rng)
        return replace(self, wrenches=moved(self.wrenches, rng), places=moved(self.places, rng), poses=poses)

    @property
    def known(self) -> int:
        """How many of the pokes are at landmarks."""
        return len(self.at) - len(self.poses)


class _Rows(NamedTuple):
    """m rows r = E (m' - c x f')/|f| near a state; E any two directions across the measured push."""

    misses: Exact
    """(m, 2) r."""
    of_wrench: Exact
    """(m, 2, 6): change with the wrench that is added."""
    of_pose: Exact
    """(m, 2, 6): with turn and shift of the arm pose."""
    of_place: Exact
    """(m, 2, 3)."""
    noise: Exact
    """(m, 2, 2) D."""


class _State(NamedTuple):
    matrix: Exact
    """(6, columns)."""
    poses: Exact
    """(g, 6) turns and shifts."""


class _Equations(NamedTuple):
    """What a step solves, in exact numbers or in floats."""

    prior: Exact
    """(2 m, 2 m) J P J'."""
    wanted: Exact
    """(2 m,) J x0 - r."""
    noise: Exact
    """(m, 2, 2) D."""
    alike: Exact
    """(2 m, 2 m) what a metre by which landmarks are off adds to R."""

    def added(self, trust: FloatArray, choice: tuple[float, float]) -> Exact:
        """Return R: the pokes' own noise, by their trust, so many times larger, and landmarks that are off."""
        at, (noisier, off) = np.arange(len(trust)), choice
        every = self.alike * off**2
        own = every.reshape(len(at), 2, len(at), 2)
        own[at, :, at] = own[at, :, at] + self.noise * (noisier**2 - 1.0 + 1.0 / np.where(trust > 0, trust, 1.0))[:, None, None]
        return every

    def solved(self, trust: FloatArray, choice: tuple[float, float]) -> _Posterior:
        """Solve with the pokes that count."""
        counts = np.flatnonzero(np.repeat(trust > 0, 2))
        total = (self.prior + self.added(trust, choice))[np.ix_(counts, counts)]
        pulls, log = eliminated(total, self.wanted[counts])
        return _Posterior(counts, total, pulls, -(dot(self.wanted[counts], pulls) + log) / 2)

    def left(self, found: _Posterior) -> tuple[Exact, Exact]:
        """Return (m, 2) the misses that a step leaves, and (m, 2, 2) J C J' of each poke."""
        seen, count = self.prior[:, found.counts], len(self.noise)
        known = self.prior - seen @ eliminated(found.covariance, seen.T)[0]
        return (seen @ found.pulls - self.wanted).reshape(count, 2), _blocks(known)

    def own(self, choice: tuple[float, float]) -> Exact:
        """Return (m, 2, 2) the covariance of each poke's rows by themselves."""
        return _blocks(self.added(np.ones(len(self.noise)), choice))

    def rounded(self) -> _Equations:
        """Return them in floats."""
        return _Equations(*map(floats, self))


class _Posterior(NamedTuple):
    """What a step found: x = P J' pulls, and S for the covariance."""

    counts: IntArray
    """Which of the 2 m rows."""
    covariance: Exact
    pulls: Exact
    log: Any
    """The logarithm of the rows' density, but for a constant."""


def _blocks(covariance: Exact) -> Exact:
    """Return (m, 2, 2) those of each poke by itself."""
    at = np.arange(len(covariance) // 2)
    return covariance.reshape(len(at), 2, len(at), 2)[at, :, at]


class _Fit:
    """The program's steps from landmark pokes alone, in 80 digits; without `begin` from the prior's zero."""

    def __init__(self, pokes: Landmarked, quadratic: float, begin: _Fit | None, steps: int) -> None:
        units, prior = HAND_LOAD_N * np.repeat([1.0, pokes.prior.arm], 3), pokes.prior
        columns = [exactly(prior.matrix) / exactly(units)]
        if quadratic:
            columns.append(exactly(quadratic) / exactly(products(units[None])[0]))
        self.pokes, self._own = pokes, np.arange(pokes.known)
        self._units, self.columns = exactly(units) ** 2, np.concatenate(columns) ** 2
        self._turns = exactly(np.repeat([prior.pose_turn, prior.pose_shift], 3)) ** 2
        wrenches = exactly(pokes.wrenches)
        first, second = np.triu_indices(6)
        every = np.concatenate([wrenches, wrenches[:, first] * wrenches[:, second]], axis=1)
        self._features = every[:, : len(self.columns)]
        self.trust, self._chosen = np.ones(pokes.known), (1.0, 0.0)
        self.state = _State(exactly(np.zeros((6, len(self.columns)))), exactly(np.zeros((len(pokes.poses), 6))))
        if begin is not None:
            self.trust, matrix = begin.trust, self.state.matrix.copy()
            matrix[:, : len(begin.columns)] = begin.state.matrix
            self.state = _State(matrix, begin.state.poses)
        for _ in range(steps):
            self._step()

    def _rows(self) -> _Rows:
        """Return the rows of all pokes where the state is."""
        pokes, state = self.pokes, self.state
        wrenches, poses = exactly(pokes.wrenches), exactly(pokes.poses)[pokes.pose_of]
        size = np.sqrt(dot(wrenches[:, :3], wrenches[:, :3]))[:, None, None]
        pairs = two_across(unit_of(wrenches[:, :3])) / size
        corrected = wrenches + self._features @ state.matrix.T
        reached = exactly(pokes.places)[pokes.at] - poses[:, :3, 3]
        there = (reached[:, None] @ poses[:, :3, :3])[:, 0]
        force, moment = corrected[:, None, :3], corrected[:, None, 3:]

        def lever(change: Exact) -> Exact:
            own = state.poses[pokes.pose_of] + change
            return turned(there - own[:, 3:], -own[:, :3])[:, None]

        def missed(change: Exact) -> Exact:
            return dot(pairs, moment - cross(lever(change), force))

        here, still = lever(self._turns * 0), missed(self._turns * 0)
        slopes = [(missed(one * _STEP) - still) / _STEP for one in exactly(np.eye(6))]
        # e.(f x dc) = (e x f).dc, and e.(df x c) = (c x e).df.
        of_lever, of_force = cross(pairs, force), cross(here, pairs)
        noise = pokes.noise
        variances = exactly([noise.moment, noise.force, pokes.prior.landmark]) ** 2
        terms = zip(variances, (pairs, of_force, of_lever), strict=True)
        added = sum(variance * (each @ each.swapaxes(1, 2)) for variance, each in terms)
        turn = turned(exactly(np.eye(3))[None], -state.poses[pokes.pose_of][:, None, :3])
        of_place = of_lever @ turn.swapaxes(1, 2) @ poses[:, :3, :3].swapaxes(1, 2)
        return _Rows(still, np.concatenate([of_force, pairs], axis=2), np.stack(slopes, axis=2), of_place, added)

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

    def _step(self) -> None:
        rows = _Rows(*(each[self._own] for each in self._rows()))
        self._parts = rows.of_wrench, rows.of_pose, self._own
        shift = dot(rows.of_pose, self.state.poses[self.pokes.pose_of[self._own], None])
        wrench = (self._features[self._own] @ self.state.matrix.T)[:, None]
        wanted = (dot(rows.of_wrench, wrench) + shift - rows.misses).ravel()
        places, of = rows.of_place.reshape(-1, 3), self.pokes.at[self._own].repeat(2)
        alike = places @ places.T * (of[:, None] == of).astype(int)
        self._last = _Equations(self._together(self._parts, self._parts), wanted, rows.noise, alike)
        rounded = self._last.rounded()
        for _ in range(TRUST_ROUNDS):
            self.trust = self._trusted(rounded)
        self._chosen = self._likeliest(rounded, self.trust)
        self.state = self._moved(self._last.solved(self.trust, self._chosen))

    def _likeliest(self, rounded: _Equations, trust: FloatArray) -> tuple[float, float]:
        """Return how much noisier landmark pokes are and how far landmarks are off, as is likeliest."""
        choices = [(noisier, off) for noisier in NOISE_FACTORS for off in LANDMARK_OFFSETS_M]
        return max(choices, key=lambda choice: rounded.solved(trust, choice).log)

    def _trusted(self, rounded: _Equations) -> FloatArray:
        left, leverage = rounded.left(rounded.solved(self.trust, self._chosen))
        counts = np.where(self.trust > 0.5, -self.trust, 1.0)[:, None, None]
        found = trust_from_squares(np.maximum(_squares(left, rounded.own(self._chosen) + counts * leverage), 0.0))
        return found if found.sum() >= MIN_TRUSTED_SHARE * len(found) else np.ones(len(found))

    def _moved(self, found: _Posterior) -> _State:
        """Return P J' S^-1 (J x0 - r)."""
        wrench, pose = (part.reshape(-1, 6)[found.counts] * found.pulls[:, None] for part in self._parts[:2])
        of = np.repeat(self._own, 2)[found.counts]
        matrix = self._units[:, None] * (wrench.T @ self._features[of]) * self.columns
        pose_of = self.pokes.pose_of[of]
        shifts = [self._turns * pose[pose_of == number].sum(axis=0) for number in range(len(self.pokes.poses))]
        return _State(matrix, np.array(shifts))

    # ---- what is said of it ----

    def log_likelihood(self, trust: FloatArray) -> Any:
        """Return the logarithm of the density of whitened rows, but for a constant: their noise is not in it."""
        noise = self._last.noise[trust > 0]
        within = sum(MP.log(each[0, 0] * each[1, 1] - each[0, 1] * each[1, 0]) for each in noise)
        return self._last.solved(trust, self._likeliest(self._last.rounded(), trust)).log + within / 2

    def ratio(self) -> Any:
        """Return misses of held-out landmark pokes over what is predicted for them."""
        named = [str(at) for at in self.pokes.at[self._own].tolist()]
        names, total = sorted(set(named)), MP.zero
        quarter = np.array([names.index(name) % HELD_OUT_PARTS for name in named])
        for out in range(HELD_OUT_PARTS):
            own = quarter == out
            left, known = self._last.left(self._last.solved(np.where(own, 0.0, self.trust), self._chosen))
            total = total + dot(_squares(left[own], (self._last.own(self._chosen) + known)[own]), self.trust[own])
        return MP.sqrt(total / self.trust.sum() / 2)

    def unknowns(self) -> Exact:
        """Return the unknowns in standard deviations of their prior, those of C as (6, columns)."""
        roots = np.sqrt(self._units), np.sqrt(self.columns)
        matrix = self.state.matrix / roots[0][:, None] / roots[1]
        return np.concatenate([matrix.ravel(), (self.state.poses / np.sqrt(self._turns)).ravel()])

    def on_skin(self) -> tuple[Exact, Exact, Exact]:
        """Return what a wrench and a pose that are off do to the axes of pokes on the skin, as these report: m."""
        pokes = self.pokes
        of = np.arange(pokes.known, len(pokes.at))
        wrenches, poses = exactly(pokes.wrenches)[of], exactly(pokes.poses)[pokes.pose_of[of]]
        return (*axes_off(wrenches, poses, exactly(pokes.places)[pokes.at[of]]), of)

    def spread(self, skin: tuple[Exact, Exact, IntArray]) -> Exact:
        """Return (k, 3, 3) the covariance of the axes of k pokes on the skin."""
        found = self._last.solved(self.trust, self._chosen)
        count, at = len(skin[2]), np.arange(len(skin[2]))
        seen = self._together(skin, self._parts)[:, found.counts]
        every = self._together(skin, skin) - seen @ eliminated(found.covariance, seen.T)[0]
        return every.reshape(count, 3, count, 3)[at, :, at]

    def axes(self, skin: tuple[Exact, Exact, IntArray]) -> Exact:
        """Return (k, 3) how far the unknowns move the axes of k pokes on the skin."""
        wrench, pose, of = skin
        of_pose = self.state.poses[self.pokes.pose_of[of], None]
        return dot(wrench, (self._features[of] @ self.state.matrix.T)[:, None]) + dot(pose, of_pose)


def axes_off(wrenches: Exact, poses: Exact, places: Exact) -> tuple[Exact, Exact]:
    """Return how axes are shifted across their pushes at `places` (m, 3), m: (m, 3, 6) by wrenches and by poses (m, 4, 4)."""
    force = wrenches[:, None, :3]
    size = np.sqrt(dot(force, force))[:, :, None]
    here = (places - poses[:, :3, 3])[:, None] @ poses[:, :3, :3]
    eye = exactly(np.eye(3))[None]
    # By each component of a force -c x df, of a moment dm, of a turn f x (c x w), of a shift -f x t.
    moments = [-cross(here, eye), eye + 0 * here, cross(force, cross(here, eye)), -cross(force, eye + 0 * here)]
    across = [cross(force / size, each / size) for each in moments]
    off = [(each @ poses[:, :3, :3].swapaxes(1, 2)).swapaxes(1, 2) for each in across]
    return np.concatenate(off[:2], axis=2), np.concatenate(off[2:], axis=2)


def _squares(misses: Exact, covariances: Exact) -> Exact:
    """Return (m,) the squares of misses (m, 2) in standard deviations of their covariances (m, 2, 2)."""
    (xx, xy), (_, yy) = covariances.transpose(1, 2, 0)
    x, y = misses.T
    return (yy * x * x - 2 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)


def exact_rig(pokes: Landmarked) -> Said:
    """Return the unknowns of a rig's correction, and how uncertain it leaves the axes of the pokes on the skin."""
    linear = _Fit(pokes, pokes.prior.quadratic, None, GAUSS_NEWTON_STEPS)
    bent = _Fit(pokes, QUADRATIC_SHARE, linear, NONLINEAR_STEPS)
    counts = np.minimum(linear.trust, bent.trust)
    gap = bent.log_likelihood(counts) - linear.log_likelihood(counts)
    likelier = bent if gap > 0 else linear
    more, skin = max(MP.one, likelier.ratio()) ** 2, likelier.on_skin()
    if abs(gap) > MODEL_LOG_ODDS:
        return {"unknowns": likelier.unknowns(), "uncertainty": more * likelier.spread(skin)}
    chance = 1 / (1 + MP.exp(-gap))
    off = linear.axes(skin) - bent.axes(skin)
    both = (1 - chance) * linear.spread(skin) + chance * bent.spread(skin)
    both = both + chance * (1 - chance) * off[:, :, None] * off[:, None]
    one, other = linear.unknowns(), bent.unknowns()
    wide = other * 0
    of_matrix = 6 * len(bent.columns)
    wide[:of_matrix].reshape(6, -1)[:, :_LINEAR] = one[: 6 * _LINEAR].reshape(6, -1)
    wide[of_matrix:] = one[6 * _LINEAR :]
    return {"unknowns": (1 - chance) * wide + chance * other, "uncertainty": more * both}


def shipped_rig(pokes: Landmarked) -> Said:
    """Return the same by the program."""
    answer = corrected(pokes)
    if answer.correction is None or min(answer.trust.values()) < 1.0:
        raise ValueError("a case whose landmark pokes do not all count")
    of = np.arange(pokes.known, len(pokes.at))
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


def corrected(pokes: Landmarked) -> RigAnswer:
    """Return what the program makes of landmark pokes."""
    scene = replace(load_scene(resource("scenes/icub-forearm/scene.toml")), noise=pokes.noise)
    known = [
        LandmarkPoke(at, f"{pokes.at[at]}", pokes.places[pokes.at[at]], pokes.wrenches[at, :3], pokes.wrenches[at, 3:],
                     pokes.poses[pokes.pose_of[at]], f"{pokes.pose_of[at]}")
        for at in range(pokes.known)
    ]  # fmt: skip
    return correct_rig(RigRequest(scene, None, [], known, prior=pokes.prior))


# ---- covariances, heights and distances of modules ----

_SPARSE = 100
"""Between the numbers of two pokes: what changes slowly is not shared."""


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """A module's pokes, and a root of what a correction of the rig does not know: every number is an input."""

    case: ModuleCase
    root: FloatArray
    """(n, n) float, as in `Correction`."""
    quadratic: bool
    """Whether it knows the products of a wrench's components."""
    known: int
    """How many of the arm poses it knows; the others are as wrong as the prior says."""

    def moved(self, rng: np.random.Generator) -> Shared:
        """Return it with every number moved by one unit in its last place."""
        return replace(self, case=replace(self.case, readings=self.case.readings.moved(rng)), root=moved(self.root, rng))

    @property
    def columns(self) -> int:
        """Of the matrix C."""
        return 27 if self.quadratic else _LINEAR


def shared_errors(shared: Shared, contacts: Sequence[Contact]) -> CorrectionErrors:
    """Return what the program makes of the root."""
    quadratic = np.zeros((6, shared.columns - _LINEAR))
    motions = {f"pose {pose}": np.eye(4) for pose in range(shared.known)}
    correction = Correction(np.eye(6), motions=motions, root=shared.root, quadratic=quadratic)
    return CorrectionErrors(correction, {contact.poke: contact for contact in contacts}.__getitem__)


def apart(contacts: Sequence[Contact]) -> list[Contact]:
    """Return contacts whose numbers are so far from each other that they share nothing that changes slowly."""
    return [replace(contact, poke=1 + _SPARSE * at) for at, contact in enumerate(contacts)]


def exact_module(shared: Shared, begin: ExactPose | None = None) -> Said:
    """Return of a module's pads the covariances, what all pokes share of them, and the variance of its height.

    Parameters
    ----------
    begin : a pose near the answer
    """
    case = shared.case
    pokes = pokes_of(case.readings, case.noise)
    pose, _ = find(pokes, begin or begin_of(case))
    pads = pose.pads()
    misses, slopes, inverse = weighed(pokes, pads)
    unknowns = slopes.shape[2]
    places, _, normals = pokes.contact_centres(pads)
    weights = slopes.swapaxes(1, 2) @ inverse
    back = inverted((weights @ slopes).sum(axis=0))
    alike, of_pose = _axes_of(shared, pokes, places)
    moves = back @ (weights @ alike).sum(axis=0)
    own = [(weights @ each).sum(axis=0) for each in of_pose]
    squares, free = dot(misses, (inverse @ misses[:, :, None])[:, :, 0]).sum(), 2 * len(misses) - unknowns
    factor = _factor(squares, free)
    skin, out = exactly(case.noise.skin), dot(pokes.pairs, normals[:, None])
    along = back @ (weights @ out[:, :, None]).sum(axis=0)
    total = factor * back + skin**2 * along @ along.T + sum(back @ each @ each.T @ back for each in own)
    height = MP.zero
    if unknowns == ModulesOnSurface.unknowns:
        # One unknown more: the misses' slope with the height, less what the module's own unknowns make of it.
        alone = ((out - (slopes @ along)[:, :, 0])[:, None] @ inverse)[:, 0]
        told = dot(alone, out).sum()
        z = dot(alone, misses).sum() / told
        z = min(z, max(z - MAX_THICKNESS_SDS * skin, MP.zero))
        variance = factor / told + sum(dot(each, each) for each in _lifts(alone, told, alike, of_pose))
        height = z**2 - variance if factor / told < MAX_HEIGHT_SD_M**2 and z**2 > MIN_HEIGHT_SDS**2 * variance else MP.zero
    changes = pads.changes
    outward = height * pads.normals[:, :, None] * pads.normals[:, None]
    by_shared = changes @ (moves @ moves.T) @ changes.swapaxes(1, 2)
    covariances = changes @ total @ changes.swapaxes(1, 2) + by_shared + outward
    return _with_height({"covariances": covariances, "shared": by_shared}, np.array([height]))


def _lifts(alone: Exact, told: Any, alike: Exact, of_pose: Sequence[Exact]) -> Iterator[Exact]:
    for each in (alike, *of_pose):
        yield (alone[:, None] @ each).sum(axis=0)[0] / told


def _factor(squares: Any, free: int) -> Any:
    """Return by how much misses show the variances to be larger than the scene's noise, as `variance_factors` says."""
    seen = squares / free - MP.sqrt(MP.mpf(2) / free)
    return seen * free / max(free - 2, 1) if seen > 1 else MP.one


def _axes_of(shared: Shared, pokes: ExactPokes, places: Exact) -> tuple[Exact, list[Exact]]:
    """Return how errors shift the axes, E da: (m, 2, n) by those that all pokes share, (m, 2, 6) by each pose's own."""
    readings = shared.case.readings
    wrenches = exactly(np.concatenate([readings.forces, readings.moments], axis=1))
    first, second = np.triu_indices(6)
    features = np.concatenate([wrenches, wrenches[:, first] * wrenches[:, second]], axis=1)[:, : shared.columns]
    of_wrench, of_pose = axes_off(wrenches, exactly(readings.poses)[readings.pose_of], places)
    rows = (pokes.pairs @ of_wrench)[:, :, :, None] * features[:, None, None]
    size, root = 6 * shared.columns, exactly(shared.root)
    alike, own = rows.reshape(len(rows), 2, size) @ root[:size], pokes.pairs @ of_pose
    prior = RigPrior()
    scales, others = exactly(np.repeat([prior.pose_turn, prior.pose_shift], 3)), list[Exact]()
    for pose in range(len(readings.poses)):
        here = (readings.pose_of == pose).astype(int)[:, None, None]
        if pose < shared.known:
            alike = alike + here * (own @ root[size + 6 * pose : size + 6 * pose + 6])
        else:
            others.append(here * own * scales)
    return alike, others


def shipped_module(shared: Shared) -> Said:
    """Return the same by the program, its search begun where it ends: else its last step, up to 1e-7 m, is in the slopes."""
    case = shared.case
    surface = None if case.mesh is None else make_surface(case.mesh.vertices, case.mesh.triangles)
    contacts = apart(contacts_of(case, np.arange(len(case.readings.forces))))
    table, errors = ContactTable(contacts), shared_errors(shared, contacts)

    def placed_from(start: ModulePoses) -> tuple[list[Estimate], FittedModule]:
        kept, model = dict[int, FittedModule](), model_of([replace(case, start=start)], surface)
        found = estimate_modules(table, model, [0], case.noise, [], {}, False, errors, kept)
        return [found[channel] for channel in range(PADS)], kept[0]

    pads, module = placed_from(placed_from(case.start)[1].pose)
    moves = np.array([pad.moved for pad in pads])
    covariances = np.array([pad.covariance for pad in pads])
    by_shared = moves @ moves.transpose(0, 2, 1)
    return _with_height({"covariances": covariances, "shared": by_shared}, np.array([module.height]))


def _with_height(said: Said, height: Any) -> Said:
    """Return it with the variance of a height where there is one: zero would have no bar."""
    return {**said, "height": height} if height[0] else said


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """Modules as their own pokes put them, without a surface, and distances between them: every number is an input."""

    cases: tuple[ModuleCase, ...]
    fitted: tuple[FittedModule, ...]
    told: tuple[KnownDistance, ...]
    noise: NoiseSettings

    def moved(self, rng: np.random.Generator) -> Joined:
        """Return it with every number moved by one unit in its last place; covariances stay symmetric."""
        fitted = tuple(replace(own, pose=_pose_moved(own.pose, rng), covariance=_evenly_moved(own.covariance, rng),
                               moves=moved(own.moves, rng)) for own in self.fitted)  # fmt: skip
        lengths = moved(np.array([own.length for own in self.told]), rng).tolist()
        told = (replace(own, length=length) for own, length in zip(self.told, lengths, strict=True))
        return replace(self, fitted=fitted, told=tuple(told))


def _pose_moved(pose: ModulePoses, rng: np.random.Generator) -> ModulePoses:
    return ModulePoses(moved(pose.points, rng), moved(pose.x, rng), moved(pose.normals, rng), pose.triangles)


def _evenly_moved(covariance: FloatArray, rng: np.random.Generator) -> FloatArray:
    every = np.tril(moved(covariance, rng))
    return every + np.tril(every, -1).T


def joined_by(cases: Sequence[ModuleCase], told: Sequence[KnownDistance], root: FloatArray) -> Joined:
    """Return the modules of cases as the program fits them, all with the errors that a root of 6 x 6 numbers makes."""
    contacts = [
        replace(contact, channels=contact.channels + number * PADS, pose=f"pose {number}")
        for number, case in enumerate(cases)
        for contact in contacts_of(case, np.arange(len(case.readings.forces)))
    ]
    contacts, kept, noise = apart(contacts), dict[int, FittedModule](), cases[0].noise
    errors = CorrectionErrors(Correction(np.eye(6), root=root), {contact.poke: contact for contact in contacts}.__getitem__)
    modules = range(len(cases))
    estimate_modules(ContactTable(contacts), model_of(cases, None), modules, noise, [], {}, False, errors, kept)
    return Joined(tuple(cases), tuple(kept[module] for module in modules), tuple(told), noise)


def shipped_joined(joined: Joined) -> Said:
    """Return the pads' places and covariances by the program."""
    model = model_of(joined.cases, None, joined.told)
    before = {
        channel: Estimate(channel, Method.MODULES, State.ESTIMATED, 1, position=np.zeros(3), covariance=np.eye(3))
        for channel in range(len(joined.cases) * PADS)
    }
    found, tried = apply_distances(model, dict(enumerate(joined.fitted)), before, joined.noise)
    if not all(each.used for each in tried):
        raise ValueError("a case whose distances do not all count")
    every = [found[channel] for channel in before]
    places, covariances = ([getattr(each, name) for each in every] for name in ("position", "covariance"))
    return {"places": np.array(places), "covariances": np.array(covariances)}


def exact_joined(joined: Joined) -> Said:
    """Return the same: Gauss and Newton's steps by the inverse of P and the distances' rows beside it."""
    count, own = len(joined.fitted), joined.fitted
    size = 6 * count
    prior = _np.full((size, size), MP.zero)
    for at, module in enumerate(own):
        prior[6 * at : 6 * at + 6, 6 * at : 6 * at + 6] = exactly(module.covariance)
    moves = exactly(np.concatenate([module.moves for module in own]))
    held = inverted(prior + moves @ moves.T)
    ends = [[_end_of(joined, told, side) for side in (0, 1)] for told in joined.told]
    x, covariance = exactly(np.zeros(size)), held
    for _ in range(DISTANCE_STEPS):
        rows, left, weights = zip(*(_distance(joined, x, *each) for each in zip(joined.told, ends, strict=True)), strict=True)
        slopes, weighing = np.array(rows), np.array(weights)[:, None]
        covariance = inverted(held + slopes.T @ (weighing * slopes))
        x = covariance @ (slopes.T @ (weighing[:, 0] * np.array(left)))
    laid = [_laid(joined, at, x, joined.cases[at].module.flat) for at in range(count)]
    covariances = [
        each.changes @ covariance[6 * at : 6 * at + 6, 6 * at : 6 * at + 6] @ each.changes.swapaxes(1, 2)
        for at, each in enumerate(laid)
    ]
    return {"places": np.concatenate([each.points for each in laid]), "covariances": np.concatenate(covariances)}


def _end_of(joined: Joined, told: KnownDistance, side: int) -> tuple[int, FloatArray]:
    """Return the module at one end of a distance, and the end in its plane."""
    end = told.ends[side]
    return (end // PADS, joined.cases[end // PADS].module.flat[end % PADS]) if told.of_taxels else (end, np.zeros(2))


def _laid(joined: Joined, at: int, x: Exact, flat: FloatArray) -> ExactPads:
    """Return points in a module's plane where x moves it, turns counted as ways at `LEVER_M`."""
    pose, step = joined.fitted[at].pose, x[6 * at : 6 * at + 6]
    by = step[3:] / exactly(LEVER_M)
    place = exactly(pose.points[0]) + step[:3]
    pads = InPlane(place, turned(exactly(pose.x[0]), by), turned(exactly(pose.normals[0]), by), exactly(flat)).pads()
    turns = pads.changes[:, :, 3:] / exactly(LEVER_M)
    return pads._replace(changes=np.concatenate([pads.changes[:, :, :3], turns], axis=2))


def _distance(joined: Joined, x: Exact, told: KnownDistance, ends: Sequence[tuple[int, FloatArray]]) -> tuple[Exact, Any, Any]:
    """Return a distance's row J, what J x is to be, and 1/R."""
    one, other = (_laid(joined, at, x, flat[None]) for at, flat in ends)
    way = (one.points - other.points)[0]
    length = MP.sqrt(dot(way, way))
    variance, row = exactly(told.sd) ** 2, exactly(np.zeros(len(x)))
    for sign, pads, (at, flat) in ((1, one, ends[0]), (-1, other, ends[1])):
        row[6 * at : 6 * at + 6] = sign * (way / length) @ pads.changes[0]
        every, here = exactly(joined.cases[at].module.flat), exactly(flat)
        middle = every.sum(axis=0) / len(every)
        square = dot(every - middle, every - middle).sum() / len(every) - dot(here - middle, here - middle)
        lean = dot(pads.normals[0], way / length)
        variance = variance + (square / (2 * exactly(joined.noise.radius)) * lean) ** 2
    return row, exactly(told.length) - length + dot(row, x), 1 / variance


# ---- cases ----


def landmarked(
    rng: np.random.Generator,
    *,
    landmarks: int = 6,
    poses: int = 2,
    rounds: int = 1,
    line: float = 1.0,
    tilt: float = 0.7,
    wrong: float = 0.02,
    bent: float = 0.0,
    places_off: float = 0.0,
    noise: NoiseSettings | None = None,
    scatter: float = 0.0007,
) -> Landmarked:
    """Return landmark pokes of a rig that is wrong, each landmark poked in each pose.

    Parameters
    ----------
    rounds : how often
    line : how far landmarks lie beside a line, as a share of its length
    tilt : rad, within which pushes lie about one direction in each pose
    wrong : of the sensor's matrix, the sd of each entry
    bent : the same of products of a wrench's components
    places_off : m, of the landmarks
    scatter : m, of contacts
    """
    noise, prior = noise or NoiseSettings(), RigPrior()
    reported = arm_poses(rng, poses, 0.3)
    count = landmarks * poses * rounds
    along, known = unit(rng.normal(size=3)), 0.08 * rng.normal(size=(landmarks, 3))
    beside_line = known - (known @ along)[:, None] * along
    known = 0.1 * unit(rng.normal(size=3)) + known - (1.0 - line) * beside_line
    at = np.concatenate([np.arange(count) % landmarks, landmarks + np.arange(poses)])
    pose_of = np.concatenate([np.arange(count) // landmarks % poses, np.arange(poses)])
    places = np.concatenate([known, 0.1 * rng.normal(size=(poses, 3))])
    true = places + places_off * rng.normal(size=places.shape)
    pushes = np.concatenate([cone(rng, count, tilt, unit(rng.normal(size=3))), unit(rng.normal(size=(poses, 3)))])
    turns, shifts = reported[pose_of, :3, :3], reported[pose_of, :3, 3]
    touched = true[at] + scatter * rng.normal(size=(len(at), 3)) + 0.001 * rng.normal(size=(poses, 3))[pose_of]
    force = (pushes[:, None] @ turns)[:, 0] * rng.uniform(6.0, 12.0, (len(at), 1))
    moment = np.cross(((touched - shifts)[:, None] @ turns)[:, 0], force)
    wrenches = np.concatenate([force, moment], axis=1)
    units = HAND_LOAD_N * np.repeat([1.0, prior.arm], 3)
    own = wrenches / units
    off = own @ (wrong * rng.normal(size=(6, 6))) + products(own) @ (bent * rng.normal(size=(21, 6)))
    spread = np.repeat([noise.force, noise.moment], 3) * rng.normal(size=wrenches.shape)
    return Landmarked(wrenches + off * units + spread, places, at, reported, pose_of, noise, prior)


def _root(rng: np.random.Generator, columns: int, poses: int, share: float = 0.2) -> FloatArray:
    """Return a root as a correction leaves it: a share of the prior's scales, and all of it correlated."""
    quadratic = QUADRATIC_SHARE if columns > _LINEAR else 0.0
    scales = replace(RigPrior(), quadratic=quadratic).scales(poses)
    return np.triu(scales[:, None] * share * (np.eye(len(scales)) + 0.1 * rng.normal(size=(len(scales),) * 2)))


@dataclass(frozen=True, slots=True, eq=False)
class TermCase:
    """Inputs, and the two ways to work out what follows from them."""

    name: str
    inputs: Landmarked | Shared | Joined

    @property
    def pokes(self) -> int:
        """How many there are."""
        if isinstance(self.inputs, Landmarked):
            return self.inputs.known
        cases = (self.inputs.case,) if isinstance(self.inputs, Shared) else self.inputs.cases
        return sum(len(case.readings.forces) for case in cases)

    def said(self) -> Said:
        """Return what the program says."""
        if isinstance(self.inputs, Landmarked):
            return shipped_rig(self.inputs)
        return shipped_module(self.inputs) if isinstance(self.inputs, Shared) else shipped_joined(self.inputs)

    def exactly_said(self, rng: np.random.Generator | None = None) -> Said:
        """Return the same in 80 digits; with `rng` of inputs moved by their last digit."""
        inputs = self.inputs if rng is None else self.inputs.moved(rng)
        if isinstance(inputs, Landmarked):
            return exact_rig(inputs)
        return exact_module(inputs) if isinstance(inputs, Shared) else exact_joined(inputs)


def term_cases(sizes: CaseSizes) -> Iterator[TermCase]:
    """Yield every case of what the program adds to the paper's methods."""
    for number, family in enumerate((_corrections, _carried, _distances)):
        yield from family(np.random.default_rng([_SEED, number]), sizes)


def _corrections(rng: np.random.Generator, sizes: CaseSizes) -> Iterator[TermCase]:
    del sizes
    ways: dict[str, dict[str, Any]] = {
        "rig as modelled": {},
        "four landmarks, two pokes each": {"landmarks": 4},
        "landmarks within 0.1 mm of a line": {"line": 1e-3},
        "pushes within 1e-3 rad": {"tilt": 1e-3},
        "noise of 1e-4 of what is usual": {"noise": NoiseSettings(force=1e-5, moment=1e-6)},
        "noise of 30 times what is usual": {"noise": NoiseSettings(force=3.0, moment=0.3), "wrong": 0.002},
        "sensor not linear": {"bent": 0.05},
        "landmarks 4 mm off": {"places_off": 0.004},
    }
    for name, how in ways.items():
        yield TermCase(f"correction, {name}", landmarked(rng, **how))


def _carried(rng: np.random.Generator, sizes: CaseSizes) -> Iterator[TermCase]:
    n, poses = max(sizes.contacts, 10), arm_poses(rng, 2, 0.3)
    grounds = {"module": in_space(rng), "module on a sheet": on_sheet(rng, sizes, 8.0)}

    def case(name: str, module: ModuleCase, share: float = 0.2, *, quadratic: bool = False, known: int = 2) -> TermCase:
        return TermCase(name, Shared(module, _root(rng, 27 if quadratic else _LINEAR, known, share), quadratic, known))

    for (name, ground), tilt in zip(grounds.items(), (0.2, 0.001), strict=True):
        how: dict[str, Any] = {"rng": rng, "module": ground, "count": n, "poses": poses}
        yield case(f"{name}, shared errors", placed(name, **how))
        yield case(f"{name}, shared errors of products too", placed(name, **how), quadratic=True)
        yield case(f"{name}, arm poses that are not known", placed(name, **how), known=0)
        yield case(f"{name}, shared errors, pushes within {tilt} rad", placed(name, tilt=tilt, **how))
        loud = NoiseSettings(force=0.2, moment=0.02)
        yield case(f"{name}, shared errors, twice the noise", placed(name, noise=loud, **how))
        yield case(f"{name}, shared errors, misses of 6 mm", placed(name, scatter=0.006, **how))
    flat = grounds["module on a sheet"]
    for far in (0.004, -0.003):
        usual = placed("", rng, flat, 2 * n, NoiseSettings(contact=0.0005, skin=0.0005), poses=poses, tilt=0.8, scatter=1e-4)
        assert flat.mesh is not None
        mesh = replace(flat.mesh, vertices=flat.mesh.vertices - far * flat.at.normals[0])
        lowered = replace(flat, mesh=mesh, at=replace(flat.at, points=flat.at.points - far * flat.at.normals[0]))
        start = replace(usual.start, points=usual.start.points - far * flat.at.normals[0])
        yield case(f"module {1e3 * far:g} mm over its sheet", replace(usual, mesh=mesh, module=lowered, start=start), 0.02)


def _distances(rng: np.random.Generator, sizes: CaseSizes) -> Iterator[TermCase]:
    n, root = max(sizes.contacts, 10), _root(rng, _LINEAR, 0)
    for name, sd, tilt in (("", 0.0005, 0.5), (" told to 1e-6 m", 1e-6, 0.5), (", pushes within 0.02 rad", 0.0005, 0.02)):
        cases: list[ModuleCase] = []
        for number in range(3):
            module = in_space(rng, at=unit(rng.normal(size=3)) * 0.05 + np.array([0.05 * number, 0.0, 0.1]))
            cases.append(placed("", rng, module, n, tilt=tilt))
        pads = [laid(case) for case in cases]
        ends_of = (((0, 1), False), ((1, 2), False), ((3, PADS + 7), True), ((PADS + 2, 2 * PADS + 9), True))
        told: list[KnownDistance] = []
        for ends, taxels in ends_of:
            one, other = (_where(cases, pads, end, taxels) for end in ends)
            told.append(KnownDistance(ends, taxels, float(np.linalg.norm(one - other)), sd))
        yield TermCase(f"distances between three modules{name}", joined_by(cases, told, root))


def laid(case: ModuleCase) -> FloatArray:
    """Return (k, 3) where a module's pads lie."""
    module = case.module
    return module.ground.place_pads(module.at.select(np.zeros(PADS, dtype=np.int64)), module.flat).points


def _where(cases: Sequence[ModuleCase], pads: Sequence[FloatArray], end: int, of_taxels: bool) -> FloatArray:
    return pads[end // PADS][end % PADS] if of_taxels else cases[end].module.at.points[0]
