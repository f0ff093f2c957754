"""Sensor-frame check: whether the sensor's frame is the one that the scene says, from a few landmark pokes.

Each common mistake is a hypothesis: an order of the axes with signs (48, with the right one and the reaction in place of the
action), moments or forces in another unit, and a sensor that sits elsewhere on the arm than reported. Under each hypothesis
the pokes' axes pass their landmarks at some distance. Hand and landmark contribute `POKE_TO_LANDMARK_SD_M` in each direction
and poke. The usual errors of a rig (`RigPrior`: its matrix for all pokes, the arm pose for those in it) contribute to all pokes
together. In units of `POKE_TO_LANDMARK_SD_M` the misses r have the covariance V = I + J S J', with J of
`skincal.rig.correction` and S the prior, and a hypothesis costs

    r' V^-1 r + log det V.

The log-determinant penalizes hypotheses that fit anything. A push from inside the part costs as much as three standard
deviations. A sensor that sits elsewhere by a rotation w and a shift t, with known sizes only (`MOUNT_TURN_SD`,
`MOUNT_SHIFT_SD_M`), has the same likelihood averaged over all w and t: V + M M', with M the change of r with them.

One poke may have been at another point than its landmark. So each hypothesis is also tried with each poke k at another point:
V + s^2 E E', with E the two rows of k and s `WRONG_POINT_POKED_SD_M`, at the cost `WRONG_POINT_COST` and without a cost for the
side of k. By Woodbury's identity that takes the two by two blocks of V^-1 alone.

The result is an offer; nothing is changed. A small error of the mounting looks like one of the F/T matrix: the rig's correction
is for both (`skincal.rig.correction_fit`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray
from skincal.pokes import LandmarkPokes, Pokes
from skincal.rig.correction import NO_NOISE, RigPrior, RigState, rig_rows, rigid_motion
from skincal.rig.scene_mistakes import Mistake, MistakeKind, sensor_mistakes

POKE_TO_LANDMARK_SD_M = 0.003
"""m, sd of an axis from its landmark, each direction, on a right rig: hand, sensor noise, a landmark off by 4 mm in space."""
MOUNT_TURN_SD, MOUNT_SHIFT_SD_M = float(np.radians(15.0)), 0.030
"""rad and m, sd of a wrong mounting, each axis: a turned bracket, a wrong length."""
PUSH_FROM_INSIDE_CHI2 = 9.0
"""Cost of a push from inside the part, as a sum of squares: three standard deviations."""
RIGHT_FRAME_COST_BONUS = 2.0
"""Prior of a right frame against any mistake, as a difference of twice the log likelihood: one session in four has a mistake.
From three pokes on rigs with the paper's errors 99 of 100 right frames lie below 1, and 96 of 100 mountings that are off by
25 degrees and 40 mm above 2."""
MIN_COST_GAP_TO_BE_SURE = 6.0
"""The best hypothesis must be 20 times likelier than the next: twice the logarithm of that."""
WRONG_POINT_POKED_SD_M = 0.050
"""m, sd of a wrong point in each direction across the push: the spacing of landmarks on a forearm."""
WRONG_POINT_COST = 2.0 * math.log(20.0)
"""Prior cost of a poke at another point: a hand at half a dozen landmarks, or a list of pokes, errs about once in twenty."""
EXPLAINED_POKES_MAX_RMS_MISS_M = 0.017
"""m. A hypothesis explains the pokes if their rms miss under it is below this, or below half of the reported miss. In the right
frame, on rigs with the paper's errors, it is 11 mm in the median, and below this in 19 of 20."""
GAUSS_NEWTON_STEPS = 3
"""Steps until a wrong mounting is found."""
FRAME_CHECK_MIN_POKES = 3
FRAME_CHECK_MAX_POKES = 12
"""Pokes of a check: more take longer and add little about a mistake that is the same in all."""
HAND_FORCE_RANGE_N = (3.0, 25.0)
"""N: range of a hand's pokes."""


@dataclass(frozen=True, slots=True)
class PokeAtOtherPoint:
    """A poke that was likely at another point than its landmark."""

    poke: int
    name: str
    """Landmark that it is listed under."""
    miss: float
    """m: distance of its axis from that landmark, under the most likely hypothesis."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameDiagnosis:
    """Result of the sensor-frame check, under the most likely hypothesis."""

    right: bool
    """The scene's frame is right."""
    sure: bool
    """No other hypothesis is nearly as likely, and at least three pokes support it."""
    explained: bool
    """The hypothesis fits the pokes. Else there is nothing to offer."""
    miss: float
    """m: rms distance of the axes from the landmarks as reported."""
    corrected_miss: float
    """m: the same with the correction, without a poke that was at another point."""
    mistake: Mistake
    """Of kind `NONE`, `AXES`, `UNITS` or `MOUNT`."""
    other_point: PokeAtOtherPoint | None = None
    """The poke that was at another point; `None` without one."""
    wrench_frame: str = ""
    """Frame of the wrench's messages that may explain a wrong frame, and is to be settled first; empty for none."""


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    mistake: Mistake
    cost: float
    """Minus twice the log likelihood, up to a constant."""
    distances: FloatArray
    """(n,) float, metres: distances of the axes from their landmarks."""
    beside: int | None
    """Index of the poke that was at another point; `None` without one."""

    @property
    def miss(self) -> float:
        """Rms distance, m, of the pokes from their landmarks, without the poke that was at another point."""
        return _miss(self.distances, self.beside)


def _miss(distances: FloatArray, beside: int | None) -> float:
    left = distances if beside is None else np.delete(distances, beside)
    return float(np.sqrt(np.mean(left * left)))


def check_frame(
    pokes: LandmarkPokes, normals: Sequence[FloatArray | None], prior: RigPrior | None = None
) -> FrameDiagnosis | None:
    """Tell a wrong sensor frame from a right one; `None` with fewer than `FRAME_CHECK_MIN_POKES` pokes.

    Parameters
    ----------
    pokes : at landmarks that are not all on one line; of any arm poses. Of more than `FRAME_CHECK_MAX_POKES` an even choice is
        used
    normals : (3,) float, outward, at each of them; `None` if unknown, and then no side is wrong
    prior : usual errors of a rig; `RigPrior()` for `None`
    """
    if len(pokes) < FRAME_CHECK_MIN_POKES:
        return None
    count = min(len(pokes), FRAME_CHECK_MAX_POKES)
    some = [len(pokes) * i // count for i in range(count)]
    used = pokes[some]
    evidence = _LandmarkEvidence(used, [normals[i] for i in some], prior or RigPrior())
    reported, *wrong = _discrete(evidence)
    wrong = sorted([*wrong, _elsewhere(evidence)], key=lambda hypothesis: hypothesis.cost)
    best = reported if reported.cost - RIGHT_FRAME_COST_BONUS <= wrong[0].cost else wrong[0]
    first, second = sorted([reported.cost - RIGHT_FRAME_COST_BONUS, *(hypothesis.cost for hypothesis in wrong)])[:2]
    # Both of the same pokes, else leaving out one poke would look like an explanation.
    explained = best is reported or best.miss <= max(
        EXPLAINED_POKES_MAX_RMS_MISS_M, 0.5 * _miss(reported.distances, best.beside)
    )
    other_point = None
    if best.beside is not None:
        at = best.beside
        other_point = PokeAtOtherPoint(int(used.number[at]), str(used.name[at]), float(best.distances[at]))
    return FrameDiagnosis(
        right=best is reported,
        sure=second - first >= MIN_COST_GAP_TO_BE_SURE and (best.beside is None or count > FRAME_CHECK_MIN_POKES),
        explained=explained,
        miss=_miss(reported.distances, None),
        corrected_miss=best.miss,
        mistake=best.mistake,
        other_point=other_point,
    )


class _LandmarkEvidence:
    """Misses of n landmark pokes under hypotheses.

    Parameters
    ----------
    normals : (3,) float, outward, at each of them; `None` if unknown
    """

    def __init__(self, pokes: LandmarkPokes, normals: Sequence[FloatArray | None], prior: RigPrior) -> None:
        self.pokes, self._prior = pokes, prior
        self._normals = np.array([np.zeros(3) if normal is None else normal for normal in normals])
        poses = np.repeat(pokes.pose, 2)
        # 1 for two rows of one arm pose, else 0.
        self._together = (poses[:, None] == poses).astype(np.float64)

    def rows(self, force: FloatArray, moment: FloatArray, state: RigState) -> _Rows:
        """Compute the rows of these pokes under each of h hypotheses.

        Parameters
        ----------
        force, moment : (h, n, 3) float, corrected by each
        state : of one arm pose that moves all pokes equally
        """
        many, count = len(force), len(self.pokes)
        spread = np.broadcast_to(POKE_TO_LANDMARK_SD_M**2 * np.eye(3), (many * count, 3, 3))
        tried = Pokes(
            np.tile(self.pokes.number, many),
            force.reshape(-1, 3),
            moment.reshape(-1, 3),
            np.tile(self.pokes.link_from_sensor, (many, 1, 1)),
            np.full(many * count, ""),
        )
        rows = rig_rows(tried, state, np.tile(self.pokes.place, (many, 1)), spread, NO_NOISE, np.ones(42))
        slopes, scales = rows.of_rig.reshape(many, 2 * count, -1), self._prior.scales(1)
        matrix, motion = slopes[:, :, :36] * scales[:36], slopes[:, :, 36:] * scales[36:]
        covariances = matrix @ matrix.transpose(0, 2, 1) + self._together * (motion @ motion.transpose(0, 2, 1))
        distances = rows.distances.reshape(many, count)
        return _Rows(rows.misses.reshape(many, -1), np.eye(2 * count) + covariances, slopes[:, :, 36:], distances)

    def cost_of_sides(self, force: FloatArray, turns: FloatArray) -> FloatArray:
        """Cost (h, n) of pushes from inside the part, by force (h, n, 3), N, and link_from_sensor's rotations (n, 3, 3)."""
        out = np.sum((turns.transpose(0, 2, 1) @ self._normals[:, :, None])[:, :, 0] * force, axis=2) > 0
        return PUSH_FROM_INSIDE_CHI2 * out


def _cost_of_size(force: FloatArray) -> FloatArray:
    """Cost (h,) of forces (h, n, 3), N, that no hand makes."""
    sizes = np.sqrt(np.sum(force * force, axis=2))
    return np.asarray(
        PUSH_FROM_INSIDE_CHI2 * np.sum((sizes < HAND_FORCE_RANGE_N[0]) | (sizes > HAND_FORCE_RANGE_N[1]), axis=1),
        dtype=np.float64,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Distances of n pokes from their landmarks (residuals) under each of h hypotheses on the sensor frame."""

    misses: FloatArray
    """(h, 2 n) float, across the push, in units of `POKE_TO_LANDMARK_SD_M`."""
    covariances: FloatArray
    """(h, 2 n, 2 n) float: of these, by hand, landmark and the usual errors of a rig."""
    slopes: FloatArray
    """(h, 2 n, 6) float: their change with a rotation of the sensor, rad, and a shift, m."""
    distances: FloatArray
    """(h, n) float, metres."""


def _discrete(evidence: _LandmarkEvidence) -> list[_Hypothesis]:
    """Compute the cost of every order of the axes with signs, and every unit, in the order of `sensor_mistakes`."""
    tried = sensor_mistakes()
    turned = np.array([mistake.axes for mistake in tried]).transpose(0, 2, 1)
    force_scales, moment_scales = np.array([[mistake.force_scale, mistake.moment_scale] for mistake in tried]).T
    force = force_scales[:, None, None] * (evidence.pokes.force @ turned)
    moment = moment_scales[:, None, None] * (evidence.pokes.moment @ turned)
    rows = evidence.rows(force, moment, RigState.at_prior([""]))
    sides = evidence.cost_of_sides(force, evidence.pokes.link_from_sensor[:, :3, :3])
    costs, besides = _least(_costs(rows.misses, rows.covariances), sides)
    costs += _cost_of_size(force)
    return [_Hypothesis(*row) for row in zip(tried, costs.tolist(), rows.distances, besides, strict=True)]


def _costs(misses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Costs (h, 1 + n) of misses (h, 2 n): with all pokes at their landmarks, then with each at another point."""
    roots = np.linalg.cholesky(covariances)
    whitening = np.linalg.inv(roots)
    whitened = whitening @ misses[:, :, None]
    many, size = misses.shape
    plain = np.sum(whitened[:, :, 0] ** 2, axis=1) + 2.0 * np.sum(np.log(np.diagonal(roots, axis1=1, axis2=2)), axis=1)
    # For each poke its two columns: V^-1 r, and its block of V^-1 plus 1 / s^2.
    columns = whitening.reshape(many, size, -1, 2)
    pulls = np.sum(columns * whitened[:, :, :, None], axis=1)
    a, d = np.moveaxis(np.sum(columns * columns, axis=1) + (POKE_TO_LANDMARK_SD_M / WRONG_POINT_POKED_SD_M) ** 2, 2, 0)
    b = np.sum(columns[..., 0] * columns[..., 1], axis=1)
    size_of, (x, y) = a * d - b * b, np.moveaxis(pulls, 2, 0)
    freed = (
        np.log(size_of)
        + 4.0 * math.log(WRONG_POINT_POKED_SD_M / POKE_TO_LANDMARK_SD_M)
        - (d * x * x - 2.0 * b * x * y + a * y * y) / size_of
    )
    return np.asarray(plain[:, None] + np.column_stack([np.zeros(many), WRONG_POINT_COST + freed]), dtype=np.float64)


def _least(costs: FloatArray, sides: FloatArray) -> tuple[FloatArray, list[int | None]]:
    """Minimum (h,) of costs (h, 1 + n) plus sides (h, n), and the index of the poke at another point in it."""
    pushes = np.sum(sides, axis=1)[:, None] - np.column_stack([np.zeros(len(sides)), sides])
    total = costs + pushes
    least = np.argmin(total, axis=1)
    return np.min(total, axis=1), [column - 1 if column else None for column in least.tolist()]


def _elsewhere(evidence: _LandmarkEvidence, beside: int | None = None) -> _Hypothesis:
    """Compute the cost of a sensor that sits elsewhere than reported, with poke `beside`, or a likely one, at another point."""
    scales, cost = np.repeat([MOUNT_TURN_SD, MOUNT_SHIFT_SD_M], 3), np.zeros((1, 1))
    step: FloatArray = np.zeros(6)
    elsewhere = np.zeros(len(evidence.pokes))
    force, moment = evidence.pokes.force[None], evidence.pokes.moment[None]
    if beside is not None:
        elsewhere[beside] = 1.0
    for _ in range(GAUSS_NEWTON_STEPS):
        rows = evidence.rows(force, moment, _mounted(scales * step))
        slopes = rows.slopes[0] * scales
        # Linearized here, with the prior's zero as the origin.
        misses = rows.misses[0] - slopes @ step
        total = (
            rows.covariances[0]
            + slopes @ slopes.T
            + np.diag(np.repeat(elsewhere, 2) * (WRONG_POINT_POKED_SD_M / POKE_TO_LANDMARK_SD_M) ** 2)
        )
        cost = _costs(misses[None], total[None])
        step = -slopes.T @ np.asarray(np.linalg.solve(total, misses), dtype=np.float64)
    move = scales * step
    motion = rigid_motion(move[:3], move[3:])
    sides = evidence.cost_of_sides(force, (evidence.pokes.link_from_sensor @ motion)[:, :3, :3])
    if beside is None and (likely := _least(cost, sides)[1][0]) is not None:
        # Repeated without the influence of that poke.
        return _elsewhere(evidence, likely)
    whole = float(cost[0, 0] + sides[0] @ (1.0 - elsewhere) + WRONG_POINT_COST * np.sum(elsewhere) + _cost_of_size(force)[0])
    distances = evidence.rows(force, moment, _mounted(move)).distances[0]
    return _Hypothesis(Mistake(MistakeKind.MOUNT, motion=motion), whole, distances, beside)


def _mounted(move: FloatArray) -> RigState:
    """Make a rig whose sensor is rotated by `move[:3]`, rad, and shifted by `move[3:]`, m."""
    return RigState(np.array([""]), np.zeros((6, 6)), move[None, :3], move[None, 3:])
