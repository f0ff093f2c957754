"""Sensor-frame check: whether the sensor's frame is the one that the scene says, from a few pokes at landmarks.

Each mistake that is made with such frames is a hypothesis: an order of the axes with signs (48, among them the right one and
the reaction in place of the action), moments in another unit than newton metres beside the forces', and a sensor that sits
elsewhere on the arm than reported. Under each the pokes' axes pass their landmarks at some distance across: by hand and
landmark in both directions with the standard deviation `TOLERANCE`, each poke by itself; and by what is ordinarily wrong with
a rig (`RigPrior`: its matrix for all pokes, the pose of each arm pose for those in it), all pokes together. In units of
`TOLERANCE` the misses r have the covariance V = I + J S J', with J of `skincal.rig.correction` and S the prior, and a
hypothesis costs

    r' V^-1 r + log det V,

so that a hypothesis under which an ordinary rig may do anything explains nothing. A push that comes from inside the part costs
as much as three standard deviations. A sensor that sits elsewhere by a turn w and a shift t, of which only the sizes are known
(`TURN`, `SHIFT`), is weighed by the same likelihood averaged over all w and t: V + M M', with M the change of r with them.

One poke may have been at another point than the landmark it is listed under. So each hypothesis is also weighed with each
poke k at another point: V + s^2 E E', with E the two rows of k and s `BESIDE`, at the cost `SLIP`, and the side from which k
pushes says nothing. By Woodbury's identity that takes the two by two blocks of V^-1 alone.

What it finds is an offer; nothing is changed by it. It does not distinguish a small error of the mounting from one of the F/T
matrix: that is what the correction of the rig is for (`skincal.rig.correction_fit`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import permutations, product

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.scene import NoiseSettings
from skincal.rig.correction import Correction, RigPrior, RigReadings, RigState, rig_rows, rigid_motion
from skincal.rig.correction_fit import LandmarkPoke

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
BESIDE = 0.050
"""m, sd of a point that was poked in place of the landmark, each direction across: landmarks of a forearm lie so far apart."""
SLIP = 2.0 * math.log(20.0)
"""What a poke at another point costs before its row is weighed: a hand that goes round half a dozen landmarks, or a list that
names the pokes, errs about once in twenty."""
UNEXPLAINED = 0.017
"""m: where pokes still pass their landmarks farther off than this under a wrong frame, and at more than half of what they do
as reported, that frame does not explain them. Under the right one, on rigs with the paper's errors, they pass at 11 mm in the
median and 19 times of 20 within this; a mistake of the frame makes it several times as much."""
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
"""m/s^2: newtons in a kilogram-force."""
UNITS = ((1.0, 1.0), (1.0, 1e-3), (1.0, 1e-2), (1.0, GRAVITY), (GRAVITY, 1.0))
"""Factors of force and moment: right, moments in N mm, in N cm and in kgf m, forces in kgf."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameCorrection:
    """What makes a reported wrench and pose the right ones; it shows the mistake, too."""

    axes: FloatArray = field(default_factory=lambda: np.eye(3))
    """(3, 3) float, one entry of 1 or -1 in each row: the right axes are this times the reported ones, of force and moment."""
    force_scale: float = 1.0
    moment_scale: float = 1.0
    motion: FloatArray = field(default_factory=lambda: np.eye(4))
    """(4, 4) float, metres: link_from_sensor is the reported one times this."""


@dataclass(frozen=True, slots=True)
class Slip:
    """A poke that was likely at another point than its landmark."""

    poke: int
    name: str
    """Of the landmark it is listed under."""
    miss: float
    """m: how far its axis passes that landmark, under the most likely hypothesis."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameDiagnosis:
    """What the pokes say of the frame, under the most likely hypothesis."""

    right: bool
    """The frame is the one that the scene says."""
    sure: bool
    """No other hypothesis of the frame is nearly as likely, and three pokes at least speak for it."""
    explained: bool
    """A wrong frame explains the pokes, or none is needed. Else there is nothing to offer."""
    miss: float
    """m: at what distance the axes pass the landmarks as reported, root mean square."""
    corrected_miss: float
    """m: the same under the correction, without a poke that was at another point."""
    correction: FrameCorrection
    """Offered; nothing is changed by it."""
    slip: Slip | None = None
    """The poke that was at another point; None where none was."""


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    correction: FrameCorrection
    cost: float
    """Minus twice the logarithm of the likelihood, but for what all have in common."""
    distances: FloatArray
    """(n,) float, metres: at which the axes pass their landmarks."""
    beside: int | None
    """Which of the pokes was at another point; None where none was."""

    @property
    def miss(self) -> float:
        """Root mean square of the distances, m, without the poke that was at another point."""
        return _miss(self.distances, self.beside)


def _miss(distances: FloatArray, beside: int | None) -> float:
    left = distances if beside is None else np.delete(distances, beside)
    return float(np.sqrt(np.mean(left * left)))


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
    used = [pokes[i] for i in some]
    asked = _Asked.of(used, [normals[i] for i in some], prior or RigPrior())
    reported, *wrong = _discrete(asked)
    wrong = sorted([*wrong, _elsewhere(asked)], key=lambda hypothesis: hypothesis.cost)
    best = reported if reported.cost - RIGHT <= wrong[0].cost else wrong[0]
    first, second = sorted([reported.cost - RIGHT, *(hypothesis.cost for hypothesis in wrong)])[:2]
    # Of the same pokes, or a correction would seem to explain what one poke at another point does.
    explained = best is reported or best.miss <= max(UNEXPLAINED, 0.5 * _miss(reported.distances, best.beside))
    slip = None
    if best.beside is not None:
        poke = used[best.beside]
        slip = Slip(poke.poke, poke.name, float(best.distances[best.beside]))
    return FrameDiagnosis(
        right=best is reported,
        sure=second - first >= SURE and (best.beside is None or count > FEWEST),
        explained=explained,
        miss=_miss(reported.distances, None),
        corrected_miss=best.miss,
        correction=best.correction,
        slip=slip,
    )


@lru_cache(maxsize=1)
def _named() -> tuple[FrameCorrection, ...]:
    """Return every order of the axes with signs, in every unit; the first is no mistake."""
    return tuple(
        FrameCorrection(np.array(signs)[:, None] * np.eye(3)[list(order)], *units)
        for order, signs, units in product(permutations(range(3)), product((1.0, -1.0), repeat=3), UNITS)
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """The n pokes that are looked at."""

    force: FloatArray
    """(n, 3) float, N, sensor frame."""
    moment: FloatArray
    """(n, 3) float, N m."""
    reported: FloatArray
    """(n, 4, 4) float: link_from_sensor."""
    places: FloatArray
    """(n, 3) float, metres: the landmarks."""
    normals: FloatArray
    """(n, 3) float, outward; zero where it is not known."""
    together: FloatArray
    """(2 n, 2 n) float: 1 where two rows are of pokes in one arm pose, else 0."""
    prior: RigPrior

    @classmethod
    def of(cls, pokes: Sequence[LandmarkPoke], normals: Sequence[FloatArray | None], prior: RigPrior) -> _Asked:
        """Return what is looked at."""
        poses = np.repeat([poke.pose for poke in pokes], 2)
        return cls(
            force=np.array([poke.force for poke in pokes]),
            moment=np.array([poke.moment for poke in pokes]),
            reported=np.array([poke.link_from_sensor for poke in pokes]),
            places=np.array([poke.place for poke in pokes]),
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
        readings = RigReadings(wrenches, np.zeros(len(wrenches), dtype=np.int64), np.tile(self.reported, (many, 1, 1)))
        spread = np.broadcast_to(TOLERANCE**2 * np.eye(3), (len(wrenches), 3, 3))
        rows = rig_rows(readings, state, np.tile(self.places, (many, 1)), spread, EXACT, np.ones(42))
        slopes, scales = rows.of_rig.reshape(many, 2 * count, -1), self.prior.scales(1)
        matrix, motion = slopes[:, :, :36] * scales[:36], slopes[:, :, 36:] * scales[36:]
        covariances = matrix @ matrix.transpose(0, 2, 1) + self.together * (motion @ motion.transpose(0, 2, 1))
        distances = rows.distances.reshape(many, count)
        return _Rows(rows.misses.reshape(many, -1), np.eye(2 * count) + covariances, slopes[:, :, 36:], distances)

    def cost_of_sides(self, force: FloatArray, turns: FloatArray) -> FloatArray:
        """Return (h, n) what pushes from inside the part cost.

        Parameters
        ----------
        force : (h, n, 3) float, N, sensor frame
        turns : (n, 3, 3) float: from the sensor's axes to the link's
        """
        out = np.sum((turns.transpose(0, 2, 1) @ self.normals[:, :, None])[:, :, 0] * force, axis=2) > 0
        return INSIDE * out


def _cost_of_size(force: FloatArray) -> FloatArray:
    """Return (h,) what pushes (h, n, 3), N, of a size that no hand makes cost."""
    sizes = np.sqrt(np.sum(force * force, axis=2))
    return np.asarray(INSIDE * np.sum((sizes < FORCE_SIZE[0]) | (sizes > FORCE_SIZE[1]), axis=1), dtype=np.float64)


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
    """(h, n) float, metres."""


def _discrete(asked: _Asked) -> list[_Hypothesis]:
    """Weigh every order of the axes with signs, and every unit, in the order of `_named`."""
    turned = np.array([mistake.axes for mistake in _named()]).transpose(0, 2, 1)
    force_scales, moment_scales = np.array([[mistake.force_scale, mistake.moment_scale] for mistake in _named()]).T
    force = force_scales[:, None, None] * (asked.force @ turned)
    moment = moment_scales[:, None, None] * (asked.moment @ turned)
    rows = asked.rows(force, moment, RigState.at_prior(1))
    sides = asked.cost_of_sides(force, asked.reported[:, :3, :3])
    costs, besides = _least(_costs(rows.misses, rows.covariances), sides)
    costs += _cost_of_size(force)
    return [_Hypothesis(*row) for row in zip(_named(), costs.tolist(), rows.distances, besides, strict=True)]


def _costs(misses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return (h, 1 + n) costs of misses (h, 2 n): with all pokes at their landmarks, then with each at another point."""
    roots = np.linalg.cholesky(covariances)
    whitening = np.linalg.inv(roots)
    whitened = whitening @ misses[:, :, None]
    many, size = misses.shape
    plain = np.sum(whitened[:, :, 0] ** 2, axis=1) + 2.0 * np.sum(np.log(np.diagonal(roots, axis1=1, axis2=2)), axis=1)
    # Of each poke the two columns: V^-1 r, and its block of V^-1, to which 1 / s^2 is added.
    columns = whitening.reshape(many, size, -1, 2)
    pulls = np.sum(columns * whitened[:, :, :, None], axis=1)
    a, d = np.moveaxis(np.sum(columns * columns, axis=1) + (TOLERANCE / BESIDE) ** 2, 2, 0)
    b = np.sum(columns[..., 0] * columns[..., 1], axis=1)
    size_of, (x, y) = a * d - b * b, np.moveaxis(pulls, 2, 0)
    freed = np.log(size_of) + 4.0 * math.log(BESIDE / TOLERANCE) - (d * x * x - 2.0 * b * x * y + a * y * y) / size_of
    return np.asarray(plain[:, None] + np.column_stack([np.zeros(many), SLIP + freed]), dtype=np.float64)


def _least(costs: FloatArray, sides: FloatArray) -> tuple[FloatArray, list[int | None]]:
    """Return (h,) the least of costs (h, 1 + n) with those of sides (h, n), and which poke was at another point in it."""
    pushes = np.sum(sides, axis=1)[:, None] - np.column_stack([np.zeros(len(sides)), sides])
    total = costs + pushes
    least = np.argmin(total, axis=1)
    return np.min(total, axis=1), [column - 1 if column else None for column in least.tolist()]


def _elsewhere(asked: _Asked, beside: int | None = None) -> _Hypothesis:
    """Weigh a sensor that sits elsewhere than reported, with poke `beside` at another point, or any that likely was."""
    scales, cost = np.repeat([TURN, SHIFT], 3), np.zeros((1, 1))
    step: FloatArray = np.zeros(6)
    slipped = np.zeros(len(asked.places))
    if beside is not None:
        slipped[beside] = 1.0
    for _ in range(STEPS):
        rows = asked.rows(asked.force[None], asked.moment[None], _moved(scales * step))
        slopes = rows.slopes[0] * scales
        # From the zero of the prior: the rows as they are here, seen from there.
        misses = rows.misses[0] - slopes @ step
        total = rows.covariances[0] + slopes @ slopes.T + np.diag(np.repeat(slipped, 2) * (BESIDE / TOLERANCE) ** 2)
        cost = _costs(misses[None], total[None])
        step = -slopes.T @ np.asarray(np.linalg.solve(total, misses), dtype=np.float64)
    move = scales * step
    motion = rigid_motion(move[:3], move[3:])
    sides = asked.cost_of_sides(asked.force[None], (asked.reported @ motion)[:, :3, :3])
    if beside is None and (likely := _least(cost, sides)[1][0]) is not None:
        # Found anew, so that the poke at another point does not bend it.
        return _elsewhere(asked, likely)
    whole = float(cost[0, 0] + sides[0] @ (1.0 - slipped) + SLIP * np.sum(slipped) + _cost_of_size(asked.force[None])[0])
    distances = asked.rows(asked.force[None], asked.moment[None], _moved(move)).distances[0]
    return _Hypothesis(FrameCorrection(motion=motion), whole, distances, beside)


def _moved(move: FloatArray) -> RigState:
    """Return a rig whose sensor is turned by `move[:3]`, rad, and shifted by `move[3:]`, m."""
    return RigState(np.zeros((6, 6)), move[None, :3], move[None, 3:])


def frame_correction(found: FrameCorrection) -> Correction:
    """Return what the sensor-frame check offers as a correction of every poke."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3], matrix[3:, 3:] = found.force_scale * found.axes, found.moment_scale * found.axes
    return Correction(matrix, found.motion)
