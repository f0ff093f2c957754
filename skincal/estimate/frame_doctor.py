"""Whether the sensor's frame is the one that the scene says, from a few pokes at landmarks.

Each mistake that is made with such frames is a hypothesis: an order of the axes with signs (48, among them the right one and
the reaction in place of the action), moments in another unit than newton metres beside the forces', and a sensor that sits
elsewhere on the arm than told. Under each the pokes' axes pass their landmarks at some distance across: by hand and landmark
in both directions with the standard deviation `TOLERANCE`, each poke by itself; and by what is ordinarily wrong with a rig
(`RigPrior`: its matrix for all pokes, the pose of each arm pose for those in it), all pokes together. In units of `TOLERANCE`
the misses r have the covariance V = I + J S J', with J of `rig.py` and S the prior, and a hypothesis costs

    r' V^-1 r + log det V,

so that one under which an ordinary rig may do anything explains nothing. A push that comes from inside the part costs as much
as three standard deviations. A sensor that sits elsewhere by a turn w and a shift t, of which only the sizes are known (`TURN`,
`SHIFT`), is weighed by the same likelihood averaged over all w and t: V + M M', with M the change of r with them.

What it says is an offer. Nothing is changed by it. It does not tell a small error of the mounting from one of the F/T matrix:
that is what the correction of the rig is for (`rig_fit.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import permutations, product

import numpy as np

from skincal.estimate.boards import rotations
from skincal.estimate.rig import Readings, RigPrior, RigState, rig_rows
from skincal.estimate.rig_fit import LandmarkPoke
from skincal.readings import FloatArray
from skincal.scene import NoiseSettings

TOLERANCE = 0.003
"""m, sd of an axis from its landmark, each direction, on a right rig: hand, sensor noise, a landmark off by 4 mm in space."""
TURN, SHIFT = float(np.radians(15.0)), 0.030
"""rad and m, sd of a wrong mounting, each axis: a bracket that was turned, a wrong length."""
INSIDE = 9.0
"""What a push from inside the part costs, as a sum of squares: three standard deviations."""
RIGHT = 2.0
"""By how much less likely any mistake is than none, as a difference of twice the logarithm: one session in four.
From three pokes on rigs with the paper's errors 99 of 100 right frames lie below 1, and 96 of 100 mountings that are off by
25 degrees and 40 mm above 2."""
SURE = 6.0
"""Twice the logarithm of how much likelier the best hypothesis must be than the next: 20 times."""
STEPS = 3
"""Of Gauss and Newton, until a wrong mounting is found."""
FEWEST = 3
"""Pokes below which nothing is said."""
MOST = 12
"""Pokes that are looked at: more take longer and tell little more of a mistake that is the same in all."""
EXACT = NoiseSettings(force=0.0, moment=0.0)
"""What a sensor's noise adds is in `TOLERANCE`."""
FORCE_SIZE = (3.0, 25.0)
"""N: pokes of a hand lie between."""
GRAVITY = 9.80665
MOMENT_UNITS = {
    1.0: "",
    1e-3: "the moments are newton millimetres, not newton metres",
    1e-2: "the moments are newton centimetres, not newton metres",
    GRAVITY: "the moments are kilogram-force metres beside newtons",
    1.0 / GRAVITY: "the forces are kilogram-force beside newton metres",
}
"""What the moments are multiplied by, in words."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameCorrection:
    """What makes a told wrench and pose the right ones."""

    axes: FloatArray = field(default_factory=lambda: np.eye(3))
    """(3, 3) float, of noughts and one of 1 or -1 a row: the right axes are this times the told ones, of force and moment."""
    force_scale: float = 1.0
    moment_scale: float = 1.0
    motion: FloatArray = field(default_factory=lambda: np.eye(4))
    """(4, 4) float, metres: link_from_sensor is the one told times this."""

    def corrected(self, poke: LandmarkPoke) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return force (3,), N, moment (3,), N m, and link_from_sensor (4, 4) as they are under the correction."""
        force, moment = self.force_scale * self.axes @ poke.force, self.moment_scale * self.axes @ poke.moment
        return force, moment, poke.link_from_sensor @ self.motion


@dataclass(frozen=True, slots=True, eq=False)
class FrameDiagnosis:
    """What the pokes say of the frame."""

    words: str
    """A sentence for the operator, with the miss as told and as corrected."""
    right: bool
    """The frame is the one that the scene says."""
    sure: bool
    """No other hypothesis is nearly as likely."""
    miss: float
    """m: at what distance the axes pass the landmarks as told, root mean square."""
    corrected_miss: float
    """m: the same under the correction."""
    correction: FrameCorrection
    """Offered; nothing is changed by it."""


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    words: str
    correction: FrameCorrection
    cost: float
    """Minus twice the logarithm of the likelihood, but for what all have in common."""
    miss: float


def diagnose(
    pokes: Sequence[LandmarkPoke], normals: Sequence[FloatArray | None], prior: RigPrior | None = None
) -> FrameDiagnosis | None:
    """Tell a wrong sensor frame from a right one; None from fewer than `FEWEST` pokes.

    Parameters
    ----------
    pokes : at landmarks that do not all lie on one line; of any arm poses. Of more than `MOST`, so many of them, evenly
    normals : (3,) float, outward, at each of them; None where it is not known, and then no side is wrong
    prior : how wrong a rig is whose frame is right; that of `RigPrior` for None
    """
    if len(pokes) < FEWEST:
        return None
    count = min(len(pokes), MOST)
    some = [len(pokes) * i // count for i in range(count)]
    asked = _Asked.of([pokes[i] for i in some], [normals[i] for i in some], prior or RigPrior())
    named = _named()
    found = sorted([*_discrete(asked, named), _elsewhere(asked)], key=lambda one: one.cost)
    told = next(one for one in found if not one.words)
    others = [one for one in found if one.words]
    best = told if told.cost - RIGHT <= others[0].cost else others[0]
    first, second = sorted([told.cost - RIGHT, *(one.cost for one in others)])[:2]
    return FrameDiagnosis(
        words=_sentence(best, told),
        right=best is told,
        sure=second - first >= SURE,
        miss=told.miss,
        corrected_miss=best.miss,
        correction=best.correction,
    )


def _sentence(best: _Hypothesis, told: _Hypothesis) -> str:
    if best is told:
        return f"The sensor's frame is right: pokes pass their landmarks at {told.miss * 1e3:.0f} mm."
    return (
        f"The sensor's frame looks wrong: {best.words}. As told, pokes pass their landmarks at {told.miss * 1e3:.0f} mm; "
        f"so corrected, at {best.miss * 1e3:.0f} mm."
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Named:
    """The h mistakes of axes and units, the one that is none among them."""

    words: tuple[str, ...]
    corrections: tuple[FrameCorrection, ...]
    axes: FloatArray
    """(h, 3, 3) float."""
    scales: FloatArray
    """(2, h) float: of force and moment."""


@lru_cache(maxsize=1)
def _named() -> _Named:
    """Return every order of the axes with signs, in every unit."""
    words: list[str] = []
    corrections: list[FrameCorrection] = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        axes = np.array(signs)[:, None] * np.eye(3)[list(order)]
        for factor, unit in MOMENT_UNITS.items():
            words.append("; ".join(part for part in (_axes_words(order, signs), unit) if part))
            corrections.append(FrameCorrection(axes, *((GRAVITY, 1.0) if factor == 1.0 / GRAVITY else (1.0, factor))))
    return _Named(
        tuple(words),
        tuple(corrections),
        np.array([one.axes for one in corrections]),
        np.array([[one.force_scale, one.moment_scale] for one in corrections]).T,
    )


def _axes_words(order: tuple[int, ...], signs: tuple[float, ...]) -> str:
    """Return what an order of the axes is, in words; empty for the one told."""
    if order == (0, 1, 2) and min(signs) > 0:
        return ""
    if order == (0, 1, 2) and max(signs) < 0:
        return "it reports the reaction: all signs are turned"
    named = [f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True)]
    if order == (0, 1, 2):
        turned = ", ".join("xyz"[axis] for axis, sign in enumerate(signs) if sign < 0)
        return f"the sign of {turned} is turned"
    return f"its axes are told in another order: x, y, z are {', '.join(named)}"


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """The n pokes that are looked at."""

    force: FloatArray
    """(n, 3) float, N, sensor frame."""
    moment: FloatArray
    """(n, 3) float, N m."""
    told: FloatArray
    """(n, 4, 4) float: link_from_sensor."""
    places: FloatArray
    """(n, 3) float, metres: the landmarks."""
    normals: FloatArray
    """(n, 3) float, outward; nought where it is not known."""
    together: FloatArray
    """(2 n, 2 n) float: 1 where two rows are of pokes in one arm pose, else 0."""
    prior: RigPrior

    @classmethod
    def of(cls, pokes: Sequence[LandmarkPoke], normals: Sequence[FloatArray | None], prior: RigPrior) -> _Asked:
        """Return what is looked at."""
        poses = np.repeat([one.pose for one in pokes], 2)
        return cls(
            force=np.array([one.force for one in pokes]),
            moment=np.array([one.moment for one in pokes]),
            told=np.array([one.link_from_sensor for one in pokes]),
            places=np.array([one.place for one in pokes]),
            normals=np.array([np.zeros(3) if normal is None else normal for normal in normals]),
            together=(poses[:, None] == poses).astype(np.float64),
            prior=prior,
        )

    def rows(self, force: FloatArray, moment: FloatArray, state: RigState) -> _Rows:
        """Return the rows of these pokes under each of h hypotheses.

        Parameters
        ----------
        force, moment : (h, n, 3) float, as they are under each
        state : of one arm pose, in which all pokes are moved alike
        """
        many, count = len(force), len(self.places)
        wrenches = np.concatenate([force, moment], axis=2).reshape(-1, 6)
        readings = Readings(wrenches, np.zeros(len(wrenches), dtype=np.int64), np.tile(self.told, (many, 1, 1)))
        spread = np.broadcast_to(TOLERANCE**2 * np.eye(3), (len(wrenches), 3, 3))
        rows = rig_rows(readings, state, np.tile(self.places, (many, 1)), spread, EXACT, np.ones(42))
        slopes, scales = rows.of_rig.reshape(many, 2 * count, -1), self.prior.scales(1)
        matrix, motion = slopes[:, :, :36] * scales[:36], slopes[:, :, 36:] * scales[36:]
        covariances = matrix @ matrix.transpose(0, 2, 1) + self.together * (motion @ motion.transpose(0, 2, 1))
        distances = np.sqrt(np.mean(rows.distances.reshape(many, count) ** 2, axis=1))
        return _Rows(rows.misses.reshape(many, -1), np.eye(2 * count) + covariances, slopes[:, :, 36:], distances)

    def cost_of_force(self, force: FloatArray, turns: FloatArray) -> FloatArray:
        """Return (h,) what pushes from inside the part and of a size that no hand makes cost.

        Parameters
        ----------
        force : (h, n, 3) float, N, sensor frame
        turns : (n, 3, 3) float: from the sensor's axes to the link's
        """
        out = np.sum((turns.transpose(0, 2, 1) @ self.normals[:, :, None])[:, :, 0] * force, axis=2) > 0
        sizes = np.sqrt(np.sum(force * force, axis=2))
        return INSIDE * np.sum(out, axis=1) + INSIDE * np.sum((sizes < FORCE_SIZE[0]) | (sizes > FORCE_SIZE[1]), axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """How far the axes of n pokes pass their landmarks under each of h hypotheses."""

    misses: FloatArray
    """(h, 2 n) float, across the push, in units of `TOLERANCE`."""
    covariances: FloatArray
    """(h, 2 n, 2 n) float: of these, by hand, landmark and what is ordinarily wrong with a rig."""
    slopes: FloatArray
    """(h, 2 n, 6) float: their change with a turn of the sensor, rad, and a shift, m."""
    distances: FloatArray
    """(h,) float, metres: root mean square."""


def _discrete(asked: _Asked, named: _Named) -> list[_Hypothesis]:
    """Weigh every order of the axes with signs, and every unit."""
    turned = named.axes.transpose(0, 2, 1)
    force = named.scales[0][:, None, None] * (asked.force @ turned)
    moment = named.scales[1][:, None, None] * (asked.moment @ turned)
    rows = asked.rows(force, moment, RigState.at_prior(1))
    costs = _costs(rows.misses, rows.covariances) + asked.cost_of_force(force, asked.told[:, :3, :3])
    pairs = zip(named.words, named.corrections, costs.tolist(), rows.distances.tolist(), strict=True)
    return [_Hypothesis(*one) for one in pairs]


def _costs(misses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return (h,) minus twice the logarithm of the likelihood of misses (h, k), but for what all have in common."""
    roots = np.linalg.cholesky(covariances)
    whitened = np.linalg.solve(roots, misses[:, :, None])[:, :, 0]
    diagonals = np.diagonal(roots, axis1=1, axis2=2)
    return np.asarray(np.sum(whitened * whitened, axis=1) + 2.0 * np.sum(np.log(diagonals), axis=1), dtype=np.float64)


def _elsewhere(asked: _Asked) -> _Hypothesis:
    """Weigh a sensor that sits elsewhere on the arm than told."""
    scales, cost = np.repeat([TURN, SHIFT], 3), 0.0
    step: FloatArray = np.zeros(6)
    for _ in range(STEPS):
        rows = asked.rows(asked.force[None], asked.moment[None], _moved(scales * step))
        slopes = rows.slopes[0] * scales
        # From nought of the prior: the rows as they are here, seen from there.
        sides = rows.misses[0] - slopes @ step
        total = rows.covariances[0] + slopes @ slopes.T
        cost = float(_costs(sides[None], total[None])[0])
        step = -slopes.T @ np.asarray(np.linalg.solve(total, sides), dtype=np.float64)
    move = scales * step
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotations(move[None, :3])[0], move[3:]
    angle, shift = np.degrees(np.linalg.norm(move[:3])), 1e3 * float(np.linalg.norm(move[3:]))
    words = (
        f"the sensor sits elsewhere on the arm than told, by about {angle:.0f} degrees and {shift:.0f} mm, or its matrix is "
        "far off"
    )
    cost += float(asked.cost_of_force(asked.force[None], (asked.told @ motion)[:, :3, :3])[0])
    distance = float(asked.rows(asked.force[None], asked.moment[None], _moved(move)).distances[0])
    return _Hypothesis(words, FrameCorrection(motion=motion), cost, distance)


def _moved(move: FloatArray) -> RigState:
    """Return a rig whose sensor is turned by `move[:3]`, rad, and shifted by `move[3:]`, m."""
    return RigState(np.zeros((6, 6)), move[None, :3], move[None, 3:])
