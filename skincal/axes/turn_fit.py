"""The fit of one turn: the rotation R from the axes of a taxel to the frame of the part.

A tip pushes with the force F (N, frame of the part, from the wrench of the poke). The taxel, with its axes in the columns of
R, reads

    r = a G R' F + noise,     G = diag(rho, rho, 1).                                                          (1)

a is the share of the force on the taxel, times its gain. It differs from poke to poke, since the tip hits the taxel here and
its neighbour there, so it is an unknown of every poke. rho is the gain along the skin over the gain across it. Silicone and
magnets have a ratio that is not 1; unmodelled it costs degrees.

**Minimum over a.** With the unit vectors f = F/|F|, u = r/|r| and with m = G R' f, the best a leaves the part of the reading
across m. Its size is the angle between u and m,

    e = (u - m (m.u)/(m.m)) / |u - m (m.u)/(m.m)| * angle(u, m),   two directions of noise, both across m.    (2)

The angle, and not its sine, so that a reading against the force is the worst one and not a perfect one.

**Variance.** The reading has the noise kappa (raw units) in each axis and the noise alpha (rad) of its direction, the force
has sigma (N). An error of f moves m by G R' df. In the mean of the two directions across m

    s^2 = (kappa/|r|)^2 + alpha^2 + (sigma/|F|)^2 (tr G^2 - m.G^2 m/(m.m)) / (2 m.m).                         (3)

s depends on rho. This is the method of effective variance: with noise on both sides it is unbiased for the slope rho, where a
slope of least squares would be too small.

**Minimum over R and rho.** C(R, rho) = sum of t |e|^2/s^2 + (ln rho - l)^2/sd_l^2. t is the trust of a poke (`trust.h`: 1 up
to 2.8 sd, 0 from 3.8 on), and l the ratio of other taxels. For a fixed rho the minimum is close to that of Wahba's problem,
sum of |f - R u'|^2/s^2 with u' along G^-1 u. Its solution is that of Procrustes: R = U diag(1, 1, det) V' from
sum f u''/s^2 = U S V' (Wahba 1965; Markley 1988). The search begins at the best of several rho. Gauss-Newton steps in
(omega, ln rho) with R exp(S(omega)) end it.

**Mirrored axes** are the same fit for readings with the opposite y: the axes are then R diag(1, -1, 1), of determinant -1.

**Covariance.** The inverse of J'J, with one subtraction. Pokes straight onto the skin say nothing about the turn in its plane,
but their measured forces lean by the noise, so J'J pretends to know it. With f = R x, an error of x adds

    2 (sigma/|F|)^2 rho^2/(m.m) x x' / s^2                                                                    (4)

to the information on omega in the mean, and as much to that on ln rho. (4) is taken away, with `SURPLUS_MARGIN_SDS` standard
deviations of its own chance. No angle is less known than a uniform one, whose variance is pi^2/3.

If the turn d about the push itself is unknown, z lies on a cone about it. With the half angle c of the cone, z is off by
sin c sin d along the cone and by sin c (1 - cos d) across it. d is normal, or uniform if nothing is known. The mean squares
E sin^2 d and E (1 - cos d)^2 are at most 1/2 and 3/2 for a uniform d, times sin^2 c (1 + exp(2 var(ln rho)))/2. The ratio is
held at its prior if pokes say less.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skincal.axes.reading_steps import common_variance
from skincal.geometry import FloatArray, IntArray, fit_rotation, rotation_by, rotations
from skincal.solver.tables import (
    FULL_TRUST_SDS,
    FULL_WEIGHT_MAX_MISS_SDS,
    MIN_POKES_FOR_TRUST,
    MIN_SUM_OF_POKE_TRUSTS,
    ZERO_TRUST_SDS,
)

LOG_RATIO_SD = 0.7
"""Standard deviation of ln rho before any poke: a factor of two either way."""
HELD_LOG_RATIO_SD = 1e-3
START_RATIOS = (0.3, 0.5, 0.75, 1.0, 1.4, 2.0, 3.3)
UNKNOWN_ANGLE_SD = float(np.pi / np.sqrt(3.0))
"""rad, standard deviation of an unknown angle."""
IN_PLANE_KNOWN_MAX_SD = float(np.radians(20.0))
"""rad. Beyond it the angle is no normal variable any more: the turn in the plane is called unknown."""
UNKNOWN_ANGLE_INFORMATION = 1.0 / UNKNOWN_ANGLE_SD**2
"""1/rad^2."""
SURPLUS_MARGIN_SDS = 3.0
"""Pokes without a lean then seem to have one in 1 of 700 fits."""
MAX_STEPS = 30
STEP_END = 1e-7
"""rad. A smaller step ends the search."""
SMALLEST_GAIN = 1e-10
"""Share of the sum of squares. A step that lowers it by less ends the search: nothing tells the points apart."""
SMALLEST_GAIN_BEFORE_TRUST = 1e-6
"""The same while the pokes are not judged yet: the search goes on after that. At 1e-4, a turn of 20 pokes with 3 wrong ones may
end at another minimum."""
MAX_DAMPED_TRIALS = 8
TRUST_ROUNDS = 3
SMALL_TURN = 1e-6
"""rad, for derivatives by differences."""
MIN_ANGULAR_NOISE = 1e-4
"""rad. No taxel repeats the direction of a force better; readings without noise need it."""
START_ANGULAR_NOISE = 0.03
"""rad. Noise of a reading's direction before its scatter is known: 2 degrees."""
MIRRORED_FACTORS = np.array([1.0, -1.0, 1.0])
"""Factors of x, y and z of a mirrored taxel."""


@dataclass(frozen=True, slots=True, eq=False)
class AxisPokes:
    """Pokes with their readings, of one taxel or of several that share their axes."""

    forces: FloatArray
    """(n, 3) float, N, force on the part, link frame."""
    readings: FloatArray
    """(n, 3) float, raw units, axes of the taxel, z out of the skin, force on the taxel."""
    pokes: IntArray
    """(n,) numbers of the pokes."""

    def __len__(self) -> int:
        return len(self.forces)

    def mirrored(self) -> AxisPokes:
        """Copy with the opposite y in each reading."""
        return AxisPokes(self.forces, self.readings * MIRRORED_FACTORS, self.pokes)


@dataclass(frozen=True, slots=True)
class AxisNoise:
    """Noise of forces and readings."""

    force: float
    """N, sd of each component of a force."""
    reading: float
    """Raw units, sd of each axis of a reading; 0 if it is counted as an angle."""
    angle: float = 0.0
    """rad, sd of a reading's direction in addition."""
    log_ratio: float = 0.0
    """ln rho that is expected."""
    log_ratio_sd: float = LOG_RATIO_SD
    step: float = 0.0
    """Raw units, of the values of a device; 0 if it does not matter."""


@dataclass(frozen=True, slots=True, eq=False)
class TurnFit:
    """The turn that fits some pokes best."""

    rotation: FloatArray
    """(3, 3) float: columns are the axes of the taxel, link frame; right-handed."""
    is_mirrored: bool
    """y of the readings has the opposite sign in these axes."""
    log_ratio: float
    """ln rho, of the gain along the skin over that across it."""
    covariance: FloatArray
    """(4, 4) float: of the turn omega in the axes of the taxel (R exp(S(omega)), rad^2), and of ln rho."""
    log_det: float
    """Logarithm of the determinant of the covariance, rad^6; of a turn about the push that is unknown without the cone of z."""
    cost: float
    """The minimum: squared misses in standard deviations, each at most `ZERO_TRUST_SDS` squared, and the prior of rho."""
    trust: FloatArray
    """(n,) float, 0 to 1."""
    misses: FloatArray
    """(n,) float, rad: angle between reading and force."""
    variances: FloatArray
    """(n,) float, rad^2, expected in each of two directions."""
    log_ratio_sd: float
    """Standard deviation of ln rho before these pokes."""
    repeats: float = 1.0
    """Readings with the same information as one with an error of its own: more than 1 if steps give all of them one error."""

    @property
    def log_evidence(self) -> float:
        """Logarithm of the probability density of the misses if any turn is as likely (Laplace).

        exp(-C/2), with the normal density 1/(2 pi s^2) of each poke's two directions, is integrated over omega, whose volume is
        8 pi^2, and over ln rho with its prior.
        """
        log_volume = self.log_det + 4.0 * np.log(2.0 * np.pi)
        prior = np.log(8.0 * np.pi**2) + 0.5 * np.log(2.0 * np.pi * self.log_ratio_sd**2)
        density = -np.log(2.0 * np.pi * self.variances).sum()
        return float(density - 0.5 * self.cost + 0.5 * log_volume - prior)

    def log_evidences(self, factors: FloatArray) -> FloatArray:
        """Compute `log_evidence` for noise that is larger by each of the factors (n,).

        The covariance of the turn grows as the variances, without a turn in the plane that is unknown.
        """
        known = 3 if self.is_in_plane_known else 2
        squares = float(np.minimum(self.misses**2 / self.variances, ZERO_TRUST_SDS**2).sum())
        spare = 2 * len(self.misses) - known
        return self.log_evidence - spare * np.log(factors) - 0.5 * squares * (1.0 / factors**2 - 1.0)

    @property
    def axes(self) -> FloatArray:
        """(3, 3) float: columns are x, y and z as the readings have them, link frame; of determinant -1 if mirrored."""
        return self.rotation * MIRRORED_FACTORS if self.is_mirrored else self.rotation

    @property
    def turn_covariance(self) -> FloatArray:
        """(3, 3) float, rad^2, of the turn in the link frame: the true rotation is exp(S(omega)) R."""
        return self.rotation @ self.covariance[:3, :3] @ self.rotation.T

    @property
    def normal_sd(self) -> float:
        """rad, standard deviation of the direction of z, in its worse direction."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))

    @property
    def in_plane_sd(self) -> float:
        """rad, standard deviation of the turn about z; at most that of an unknown angle."""
        return float(np.sqrt(self.covariance[2, 2]))

    @property
    def is_in_plane_known(self) -> bool:
        """Whether the turn about z is known."""
        return self.in_plane_sd <= IN_PLANE_KNOWN_MAX_SD


def fit_turn(pokes: AxisPokes, noise: AxisNoise, start: TurnFit | None = None) -> TurnFit:
    """Fit the turn to pokes, at least one; right-handed axes. `start` is a fit of the same pokes with nearly this noise.

    Raises ValueError: there is no poke, or a force or a reading is zero or no number.
    """
    lengths = np.linalg.norm(pokes.readings, axis=1), np.linalg.norm(pokes.forces, axis=1)
    if not len(pokes) or not all(np.isfinite(each).all() and (each > 0).all() for each in lengths):
        raise ValueError("a turn needs forces and readings that are finite and not zero")
    problem = _Problem(pokes, noise)
    if start is None:
        rotation, log_ratio = problem.start_rotation()
    else:
        rotation, log_ratio = start.rotation, start.log_ratio
    trust = np.ones(len(pokes)) if start is None else start.trust
    if start is None:
        # As in `trust.h`: far pokes pull less while the turn is sought from which they are judged.
        for weight_of_far in (0.0, 1.0, 1.0):
            squares, _ = problem.squares(rotation, log_ratio)
            far = np.minimum(1.0, FULL_WEIGHT_MAX_MISS_SDS**2 / np.maximum(squares, 1e-12)) ** weight_of_far
            rotation, log_ratio = problem.minimize(rotation, log_ratio, far, SMALLEST_GAIN_BEFORE_TRUST)
        trust = _trust_of(problem.squares(rotation, log_ratio)[0])
    for _ in range(TRUST_ROUNDS):
        rotation, log_ratio = problem.minimize(rotation, log_ratio, trust)
        squares, _ = problem.squares(rotation, log_ratio)
        now = _trust_of(squares)
        if np.abs(now - trust).max() < 1e-6:
            break
        trust = now
    repeats = problem.repeats(rotation, log_ratio, pokes.readings)
    covariance, log_det = problem.covariance(rotation, log_ratio, trust, repeats)
    if covariance[3, 3] > 0.5 * noise.log_ratio_sd**2:
        held = _Problem(pokes, replace(noise, log_ratio_sd=HELD_LOG_RATIO_SD))
        rotation, log_ratio = held.minimize(rotation, noise.log_ratio, trust)
        covariance, log_det = problem.covariance(rotation, log_ratio, trust, repeats)
    squares, variances = problem.squares(rotation, log_ratio)
    return TurnFit(
        rotation=rotation,
        is_mirrored=False,
        log_ratio=log_ratio,
        covariance=covariance,
        log_det=log_det,
        cost=float(np.minimum(squares, ZERO_TRUST_SDS**2).sum()) + problem.prior(log_ratio) ** 2,
        trust=trust,
        misses=np.sqrt(squares * variances),
        variances=variances,
        log_ratio_sd=noise.log_ratio_sd,
        repeats=repeats,
    )


def fit_both_hands(pokes: AxisPokes, noise: AxisNoise, start: tuple[TurnFit, TurnFit] | None = None) -> tuple[TurnFit, TurnFit]:
    """Fit right-handed axes, and mirrored ones; `start` as for `fit_turn`."""
    right, mirrored = start or (None, None)
    return fit_turn(pokes, noise, right), replace(fit_turn(pokes.mirrored(), noise, mirrored), is_mirrored=True)


@dataclass(frozen=True, slots=True, eq=False)
class LeanSlopes:
    """Misses of n readings at a fit, in standard deviations, with their derivatives."""

    rows: FloatArray
    """(3 n,) float, weighted by trust."""
    by_turn: FloatArray
    """(3 n, 4) float, by (omega, ln rho)."""
    by_force: FloatArray
    """(n, 3, 3) float, of the three rows of a reading, by the direction of its force in the link frame."""
    inverse: FloatArray
    """(4, 4) float, inverse of J'J with the prior of ln rho."""


def lean_slopes(pokes: AxisPokes, fit: TurnFit) -> LeanSlopes:
    """Compute the derivatives of the misses of a fit by its unknowns, and by the directions of the forces."""
    problem = _Problem(pokes.mirrored() if fit.is_mirrored else pokes, AxisNoise(0.0, 0.0))
    weights = np.sqrt(fit.trust / fit.variances)[:, None]
    rows = problem.misses(fit.rotation, fit.log_ratio) * weights
    turned = problem.misses(fit.rotation @ _SMALL_ROTATIONS, fit.log_ratio + _SMALL_STEPS[:, 3]) * weights
    by_turn = ((turned[:4] - turned[4:8]) / (2.0 * SMALL_TURN)).reshape(4, -1).T
    both_ways = SMALL_TURN * np.concatenate([np.eye(3), -np.eye(3)])
    problem.f = problem.f + both_ways[:, None]
    moved = problem.misses(fit.rotation, fit.log_ratio) * weights
    by_force = ((moved[:3] - moved[3:]) / (2.0 * SMALL_TURN)).transpose(1, 2, 0)
    information = by_turn.T @ by_turn
    information[3, 3] += 1.0 / fit.log_ratio_sd**2
    values, vectors = np.linalg.eigh(information)
    inverse = (vectors / np.maximum(values, UNKNOWN_ANGLE_INFORMATION)) @ vectors.T
    return LeanSlopes(rows.ravel(), by_turn, by_force, inverse)


def _trust_of(squares: FloatArray) -> FloatArray:
    """Compute the trust of pokes, by the squares of their misses in standard deviations; see `trust.h`."""
    if len(squares) < MIN_POKES_FOR_TRUST:
        return np.ones(len(squares))
    rest = np.clip((ZERO_TRUST_SDS - np.sqrt(squares)) / (ZERO_TRUST_SDS - FULL_TRUST_SDS), 0.0, 1.0)
    trust = rest * rest * (3.0 - 2.0 * rest)
    return trust if trust.sum() >= MIN_SUM_OF_POKE_TRUSTS else np.ones(len(squares))


_SMALL_STEPS = SMALL_TURN * np.concatenate([np.eye(4), -np.eye(4), np.zeros((1, 4))])
"""(9, 4): steps of omega and ln rho both ways, for derivatives, and none."""
_SMALL_ROTATIONS = rotations(_SMALL_STEPS[:, :3])


class _Problem:
    """The sum of squares of some pokes, as a function of the rotation and ln rho; also of b of them, (b, 3, 3) and (b,)."""

    def __init__(self, pokes: AxisPokes, noise: AxisNoise) -> None:
        size, force = np.linalg.norm(pokes.readings, axis=1), np.linalg.norm(pokes.forces, axis=1)
        self.f, self.u = pokes.forces / force[:, None], pokes.readings / size[:, None]
        self.noise = noise
        self.reading_variance = (noise.reading / size) ** 2 + noise.angle**2 + MIN_ANGULAR_NOISE**2
        self.force_variance = (noise.force / force) ** 2

    def start_rotation(self) -> tuple[FloatArray, float]:
        """Return the best of Wahba's solutions at some ratios, with its ln rho."""
        ratios = np.array(START_RATIOS)
        scaled = self.u / np.stack([ratios, ratios, np.ones(len(ratios))], axis=1)[:, None]
        scaled /= np.linalg.norm(scaled, axis=2)[..., None]
        weight = 1.0 / (self.reading_variance + self.force_variance)
        found = fit_rotation(np.einsum("n,ni,bnj->bij", weight, self.f, scaled))
        squares, _ = self.squares(found, np.log(ratios))
        cost = np.minimum(squares, ZERO_TRUST_SDS**2).sum(axis=1) + self.prior(np.log(ratios)) ** 2
        best = int(cost.argmin())
        return found[best], float(np.log(ratios[best]))

    def minimize(
        self, rotation: FloatArray, log_ratio: float, trust: FloatArray, smallest_gain: float = SMALLEST_GAIN
    ) -> tuple[FloatArray, float]:
        """Go to the minimum by damped Gauss-Newton steps, until one lowers the sum by less than a share of it."""
        damping, here = 1e-6, self._linearize(rotation, log_ratio, trust)
        for _ in range(MAX_STEPS):
            rows, slopes = here
            square, pull, value = slopes @ slopes.T, slopes @ rows, float(rows @ rows)
            scale = np.maximum(square.diagonal(), 1e-9)
            for _ in range(MAX_DAMPED_TRIALS):
                damped = square.copy()
                damped.flat[::5] += damping * scale
                step = -np.asarray(np.linalg.solve(damped, pull), dtype=np.float64)
                turned: FloatArray = rotation @ rotation_by(step[:3])
                ratio = log_ratio + min(max(float(step[3]), -1.0), 1.0)
                # With the derivatives of the next step: a trial is rarely refused.
                there = self._linearize(turned, ratio, trust)
                now = float(there[0] @ there[0])
                if now <= value:
                    break
                damping = max(damping, 1e-6) * 10.0
            else:
                return rotation, log_ratio
            rotation, log_ratio, here, damping = turned, ratio, there, damping / 10.0
            if float(np.abs(step).max()) < STEP_END or value - now < smallest_gain * value:
                break
        return rotation, log_ratio

    def prior(self, log_ratio: Any) -> Any:
        """Deviation of ln rho from the expected one, in standard deviations."""
        return (log_ratio - self.noise.log_ratio) / self.noise.log_ratio_sd

    def squares(self, rotation: FloatArray, log_ratio: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """Compute (n,) squared misses in standard deviations, and (n,) variances, rad^2: eqs. (2) and (3)."""
        misses, variances, _ = self._misses(rotation, log_ratio)
        squares: FloatArray = np.vecdot(misses, misses) / variances
        return squares, variances

    def misses(self, rotation: FloatArray, log_ratio: FloatArray | float) -> FloatArray:
        """Compute the misses (n, 3), rad: eq. (2)."""
        return self._misses(rotation, log_ratio)[0]

    def _misses(self, rotation: FloatArray, log_ratio: FloatArray | float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute misses (n, 3), rad, their variances (n,), rad^2, and m (n, 3)."""
        ratio = np.asarray(np.exp(log_ratio))[..., None]
        m = self.f @ rotation
        m[..., :2] *= ratio[..., None]
        square: FloatArray = np.vecdot(m, m)
        unit: FloatArray = m / np.sqrt(square)[..., None]
        along: FloatArray = np.vecdot(unit, self.u)
        across: FloatArray = self.u - unit * along[..., None]
        sine: FloatArray = np.sqrt(np.vecdot(across, across))
        stretch = np.where(sine > 1e-12, np.arctan2(sine, along) / np.maximum(sine, 1e-12), 1.0)
        # The trace of G P G by the projection P across the unit vector, with the gains G = diag(rho, rho, 1).
        z, squared = unit[..., 2], ratio * ratio
        moved = (squared + 1.0 + (squared - 1.0) * (z * z)) / (2.0 * square)
        return across * stretch[..., None], self.reading_variance + self.force_variance * moved, m

    def _linearize(self, rotation: FloatArray, log_ratio: float, trust: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the rows (3 n + 1,), and their derivatives (4, 3 n + 1) by (omega, ln rho), by central differences."""
        misses, variances, _ = self._misses(rotation @ _SMALL_ROTATIONS, log_ratio + _SMALL_STEPS[:, 3])
        rows = np.empty((len(_SMALL_STEPS), 3 * len(trust) + 1))
        rows[:, :-1] = (misses * np.sqrt(trust / variances)[..., None]).reshape(len(rows), -1)
        rows[:, -1] = self.prior(log_ratio + _SMALL_STEPS[:, 3])
        return rows[8], (rows[:4] - rows[4:8]) / (2.0 * SMALL_TURN)

    def repeats(self, rotation: FloatArray, log_ratio: float, readings: FloatArray) -> float:
        """Compute `TurnFit.repeats` of readings (n, 3), raw units, see `reading_steps.py`."""
        if not self.noise.step or len(readings) < 2:
            return 1.0
        _, variances = self.squares(rotation, log_ratio)
        lengths: FloatArray = np.linalg.norm(readings, axis=1)
        common = common_variance(readings, self.noise.step) * float((1.0 / lengths**2).mean())
        return 1.0 + (len(readings) - 1) * common / float(variances.mean())

    def covariance(self, rotation: FloatArray, log_ratio: float, trust: FloatArray, repeats: float) -> tuple[FloatArray, float]:
        """Compute the covariance (4, 4) of (omega, ln rho), see the module; and `TurnFit.log_det`."""
        _, slopes = self._linearize(rotation, log_ratio, trust)
        information = slopes @ slopes.T
        _, variances, m = self._misses(rotation, log_ratio)
        ratio, x = float(np.exp(log_ratio)), self.f @ rotation
        surplus = trust * 2.0 * self.force_variance * ratio**2 / np.einsum("ni,ni->n", m, m) / variances
        surplus *= 1.0 + SURPLUS_MARGIN_SDS / np.sqrt(max(float(trust.sum()), 1.0))
        known = 1.0 / self.noise.log_ratio_sd**2
        information[:3, :3] -= np.einsum("n,ni,nj->ij", surplus, x, x)
        information[3, 3] = max(information[3, 3] - known - float(surplus.sum()), 0.0)
        prior = np.diag([0.0, 0.0, 0.0, known])
        log_det = -float(np.log(np.maximum(np.linalg.eigvalsh(information + prior), UNKNOWN_ANGLE_INFORMATION)).sum())
        values, vectors = np.linalg.eigh(information / repeats + prior)
        values = np.maximum(values, UNKNOWN_ANGLE_INFORMATION)
        about = vectors[:3, 0]
        if values[0] >= 1.0 / IN_PLANE_KNOWN_MAX_SD**2 or abs(about[2]) < 0.5:
            return (vectors / values) @ vectors.T, log_det
        # Nothing tells the turns about the push apart: z is anywhere on a cone about it.
        found: FloatArray = (vectors[:, 1:] / values[1:]) @ vectors[:, 1:].T
        # Its half angle grows as 1/rho, whose mean square exceeds the square of its median by exp(2 var(ln rho)).
        cone = float(1.0 - about[2] ** 2) * 0.5 * (1.0 + float(np.exp(2.0 * min(found[3, 3], LOG_RATIO_SD**2))))
        variance = 1.0 / float(values[0]) if values[0] > UNKNOWN_ANGLE_INFORMATION else np.inf
        towards = about[:2] / max(float(np.linalg.norm(about[:2])), 1e-12)
        along, total = 0.5 - 0.5 * float(np.exp(-2.0 * variance)), 2.0 - 2.0 * float(np.exp(-0.5 * variance))
        found[:2, :2] += cone * ((total - along) * np.eye(2) + (2.0 * along - total) * np.outer(towards, towards))
        found[2, :] = found[:, 2] = 0.0
        found[2, 2] = UNKNOWN_ANGLE_SD**2
        return found, log_det
