"""Pose of a part in the base of a tool's poses, from the points of the part that the tool touched.

Touch k measures a point x_k in the base with the precision W_k (3 x 3): of rank 3 for the tip of a tool, of rank 2 for a force
axis, which measures nothing along its push. Unknown is the pose (R, t) that carries the base into the part's link:

    p_k = R x_k + t.

Three kinds of equations give it, in one weighted least squares.

* **Landmark** l_k: p_k = l_k, noise W_k^-1 + s_l^2 I.
* **Layout**: p_k = q_k + b + b_m, with q_k the planned place of the taxel that answers most. The hand aims beside it by the
  scene's `contact`. The whole skin is laid b off its plan and its module m by b_m more: unknowns with a prior.
* **Mesh**: n.(p_k - y_k) = h, with y_k the nearest point of the triangles that face the push, n its normal. The foam's height h
  over the mesh is one unknown for all touches, with the scene's `skin` as its sd. A poke of a taxel then uses the layout only
  across n.

An error d of the tip moves all touched points by T_k d, with the tool's rotation T_k: three more unknowns with a prior. Touches
from all sides show it.

A small motion of the part turns by w about the centre c of the touched points and shifts by s: p' = p + w x (p - c) + s. With
W = B'B the equation of a point that should lie at y is B (x + R'(t - y)) = 0, and its derivative B R' [-S(y - c), I]: exact for
a force axis, too, whose point x may be far from y. Gauss-Newton steps from many starts (`part_pose_starts`) with Huber's
weights give the pose. Its covariance is the inverse of the normal equations, without the rows of b, b_m and h. It grows by
chi-square over its degrees of freedom where that is above 1. A scale of the drawing that the touches leave open adds to the
error (`part_scale`).

Directions with a large error are named (`open_motions`), as the shift along the axis of a cylinder whose mesh alone is known.
Poses that differ and fit as well are rivals: a box fits turned by half a turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from skincal.geometry import FloatArray, IntArray, inverse_pose
from skincal.rig.part_pose_starts import DROPPED_ABOVE_COST_FACTOR, DROPPED_ABOVE_COST_INCREASE, start_poses
from skincal.rig.part_scale import NO_SCALES, PartScales, WrongScale, find_landmarks_off_mesh, find_scales, scale_rows
from skincal.rig.part_touches import (
    HUBER_THRESHOLD_SDS,
    LANDMARK_SD_M,
    MODULE_SHIFT_SD_M,
    PLAN_SHIFT_SD_M,
    POINT_MIN_PRECISION,
    SHIFT_PRIOR_SD_M,
    TURN_PRIOR_SD_RAD,
    OpenMotion,
    PartShape,
    PartTouches,
    PoseRows,
    find_open_motions,
    motion_rows,
    moved_pose,
    pose_rows,
    roots_of,
    trust_of,
)

PART_POSE_MAX_SD_M = 0.015
"""m. A pose is used if no point of the part has a larger sd in any direction: half of `POSITION_MAX_SD_M` of a taxel."""
MIN_TOUCHES = 3
DISAGREES_ABOVE_SDS = 5.0
"""Misses over expected ones. Above this the part, a landmark or the tip is another one."""
MISFIT_MIN_RATIO = 2.5
"""Misses over expected ones from which the touches contradict each other: usual mistakes are then looked for."""
RIVAL_MIN_DISTANCE_M, RIVAL_MAX_CHI2_INCREASE = 0.010, 16.0
"""m, rms over the part, between two poses that are rivals; a rival fits no worse than by 4 standard deviations."""
FIRST_FIT_STEPS, FIT_STEPS = 5, 30
TIP_MIN_SD_M = 1e-6
"""m, added to the error of a tip, so that an exact one has an inverse."""
STALLED_STEPS, MIN_COST_DECREASE = 3, 0.01
"""Steps without a decrease of the cost by as much end a fit, too: 0.01 is a tenth of a standard deviation of one unknown."""
CONVERGED_STEP_SDS = 1e-4
"""Steps smaller than this share of the standard deviations end a fit."""


class PartPoseState(Enum):
    """How far the touches give the pose."""

    FEW_TOUCHES = "few touches"
    OPEN = "open"
    """A motion of the part hardly changes the fit."""
    AMBIGUOUS = "ambiguous"
    """Another pose fits as well."""
    DISAGREES = "disagrees"
    """No pose fits."""
    KNOWN = "known"


@dataclass(frozen=True, slots=True, eq=False)
class PartPose:
    """Pose of the part in the base, with its error."""

    state: PartPoseState
    link_from_base: FloatArray
    """(4, 4) float, metres; the identity with few touches."""
    centre: FloatArray
    """(3,) float, metres, link frame: c."""
    with_tip: FloatArray
    """(9, 9) float: covariance of the turn w (rad) about the centre, of the shift s (m), link frame, and of `tip_shift`, for a
    drawing of the right scale."""
    landmarks: int
    """Touches at landmarks that it was fitted to..."""
    taxels: int
    """...touches at taxels with a planned place..."""
    points: int
    """...and touches on the mesh."""
    tip_shift: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,) float, metres: error of the tip that the touches show, in the frame of `PartShape.tip_covariance`."""
    tip_shift_chi2: float = 0.0
    """Chi-square of `tip_shift` under `PartShape.tip_covariance`, three degrees of freedom."""
    height: float = 0.0
    """m, h: height of the touched face of the skin over the mesh; 0 without touches on it."""
    height_sd: float = np.inf
    """m; infinite without touches on the mesh."""
    ratio: float = 1.0
    """Misses over the expected ones: the root of chi-square over its degrees of freedom."""
    freedom: int = 0
    """Equations beyond the six unknowns."""
    held_out_ratio: float = np.nan
    """The same of landmarks, each predicted without its own touches; NaN without a landmark."""
    landmark_places: int = 0
    """Number of different landmarks."""
    worst_landmark: int = 0
    """Number of the landmark touch that misses most; 0 without landmarks."""
    worst_miss: float = 0.0
    """m, its miss."""
    sd: float = np.inf
    """m, largest sd of a point of the part in any direction."""
    open_motions: tuple[OpenMotion, ...] = ()
    """The largest first."""
    rival: FloatArray | None = None
    """(4, 4) float, metres: link_from_base of another pose that fits as well; `None` without one."""
    scales: PartScales = NO_SCALES
    """Scale of landmarks and mesh, as the touches show it."""

    @property
    def base_from_link(self) -> FloatArray:
        """(4, 4) float, metres: the pose as a scene writes it."""
        return inverse_pose(self.link_from_base)

    def motion_to(self, link_from_base: FloatArray) -> FloatArray:
        """Compute the motion (6,) from this pose to another, (4, 4) float: a turn (rad) about `centre` and a shift (m)."""
        from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs] - slow to import

        between = link_from_base @ self.base_from_link
        turn: FloatArray = Rotation.from_matrix(between[:3, :3]).as_rotvec()
        return np.concatenate([turn, between[:3] @ np.append(self.centre, 1.0) - self.centre])

    @property
    def is_known(self) -> bool:
        """Whether it may carry estimates into the part's frame."""
        return self.state is PartPoseState.KNOWN

    @property
    def wrong_scale(self) -> WrongScale | None:
        """Scale of the drawing that the touches contradict; `None` if they agree with it."""
        return self.scales.wrong

    @property
    def covariance(self) -> FloatArray:
        """(6, 6) float: of the turn w (rad) about the centre, and of the shift s (m), link frame."""
        return self.with_tip[:6, :6]

    def error_shifts(self, points: FloatArray, tool_turns: FloatArray, normals: FloatArray) -> FloatArray:
        """Compute the shifts (..., 3, 14), metres, of points (..., 3) of the link by independent errors of unit variance.

        Parameters
        ----------
        tool_turns : (..., 3, 3) float: mean rotation of the tip's frame into the link, at the pokes that measured each point
        normals : (..., 3) float, unit: of the mesh at points bound to it, else zero
        """
        values, axes = np.linalg.eigh(self.scales.moment)
        off_mesh = np.concatenate([np.zeros_like(points[..., :1]), -normals * points], axis=-1)
        by_scales = normals[..., :, None] * off_mesh[..., None, :]
        rows = np.concatenate([motion_rows(points - self.centre), tool_turns, by_scales], axis=-1)
        by_mesh = self.scales.landmarks_off_mesh * normals[..., :, None]
        return np.concatenate([rows @ (axes * np.sqrt(np.maximum(values, 0.0))), by_mesh], axis=-1)


NO_PART_POSE = PartPose(PartPoseState.FEW_TOUCHES, np.eye(4), np.zeros(3), np.eye(9), 0, 0, 0)


def _huber_cost(sizes: FloatArray) -> FloatArray:
    return np.where(sizes < HUBER_THRESHOLD_SDS, sizes**2, HUBER_THRESHOLD_SDS * (2.0 * sizes - HUBER_THRESHOLD_SDS))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A pose with its normal equations."""

    turn: FloatArray
    shift: FloatArray
    centre: FloatArray
    covariance: FloatArray
    """(9, 9) float, not yet enlarged: with the tip."""
    tip_shift: FloatArray
    """(3,) float, metres: error of the tip."""
    height: tuple[float, float]
    """m: h, and its sd, not yet enlarged."""
    step: FloatArray
    """(6,) float: the Gauss-Newton step."""
    cost: float
    """Huber's cost, with the priors of the plan's shift and the height."""
    chi2: float
    """Sum of the trusted squares."""
    rows: PoseRows
    """Equations without the shifts of the plan, the tip and the height..."""
    slopes: FloatArray
    """(e, u) float: ...all derivatives, of three rows for each target, then of one for each point on the mesh..."""
    misses: FloatArray
    """(e,) float: ...misses with these shifts, in standard deviations..."""
    trust: FloatArray
    """(e,) float: ...Huber's weights..."""
    normal: FloatArray
    """(u, u) float: ...and normal equations with priors."""

    @classmethod
    def at(cls, touches: PartTouches, shape: PartShape, turn: FloatArray, shift: FloatArray) -> _Fit:
        rows = pose_rows(touches, shape, turn[None], shift[None], is_start=False)
        modules, module = np.unique(touches.module[touches.on_plan], return_inverse=True)
        landmarks, targets, points = len(touches.at_landmark), rows.of_targets.shape[1], rows.of_mesh.shape[1]
        # Columns: turn and shift; then the tip, the height, the plan's shift, the shift of each module.
        own = np.zeros((targets, 3, 7 + 3 * len(modules)))
        own[:, :, :3], own[:, :, 4:7] = rows.tip_slopes[0], rows.plan_slopes[0]
        for row, index in enumerate(module.tolist(), start=landmarks):
            own[row, :, 7 + 3 * index : 10 + 3 * index] = rows.plan_slopes[0, row]
        of_mesh = np.zeros((points, own.shape[2]))
        of_mesh[:, :3], of_mesh[:, 3] = rows.mesh_tip_slopes[0], rows.height_slopes[0]
        slopes = np.concatenate(
            [
                np.concatenate([rows.target_slopes[0], own], axis=2).reshape(-1, 6 + own.shape[2]),
                np.concatenate([rows.mesh_slopes[0], of_mesh], axis=1),
            ]
        )
        misses = np.concatenate([rows.of_targets[0].ravel(), rows.of_mesh[0]])
        height = max(shape.noise.skin, 1e-5)
        sds = np.concatenate([[height], np.repeat([PLAN_SHIFT_SD_M, MODULE_SHIFT_SD_M], [3, 3 * len(modules)])])
        prior = np.diag(np.concatenate([np.repeat([TURN_PRIOR_SD_RAD, SHIFT_PRIOR_SD_M, TIP_MIN_SD_M], 3), sds]) ** -2.0)
        prior[6:9, 6:9] = np.linalg.inv(shape.tip_covariance + TIP_MIN_SD_M**2 * np.eye(3))
        trust, left, rest = np.ones(len(misses)), misses, np.zeros(own.shape[2])
        for _ in range(3):  # the shifts and the height are found at each pose, with the weights
            weighted = slopes * trust[:, None]
            normal = weighted.T @ slopes
            rest = np.asarray(np.linalg.solve(normal[6:, 6:] + prior[6:, 6:], -(weighted.T @ misses)[6:]), np.float64)
            left = misses + slopes[:, 6:] @ rest
            trust = trust_of(_sizes(left, targets))
        weighted = slopes * trust[:, None]
        normal = weighted.T @ slopes + prior
        inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
        gradient = weighted.T @ left
        gradient[6:] += prior[6:, 6:] @ rest
        step = -(inverse @ gradient)[:6]
        sizes = _size_of_each(left, targets)
        of_prior = float(rest @ prior[6:, 6:] @ rest)
        cost = float(np.sum(_huber_cost(sizes))) + of_prior
        chi2 = float(np.sum(trust * left**2)) + of_prior
        skin = float(rest[3]), float(np.sqrt(inverse[9, 9]))
        of_tip, equations = (inverse[:9, :9], rest[:3]), (rows, slopes, left, trust, normal)
        return cls(turn, shift, rows.centres[0], *of_tip, skin, step, cost, chi2, *equations)

    def next(self, touches: PartTouches, shape: PartShape) -> _Fit:
        turn, shift = moved_pose(self.turn[None], self.shift[None], self.centre[None], self.step[None])
        return _Fit.at(touches, shape, turn[0], shift[0])

    @property
    def is_converged(self) -> bool:
        return float(self.step @ np.linalg.solve(self.covariance[:6, :6], self.step)) < CONVERGED_STEP_SDS**2

    @property
    def link_from_base(self) -> FloatArray:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.turn, self.shift
        return pose


def _size_of_each(misses: FloatArray, targets: int) -> FloatArray:
    """Compute the size (k + m,) of each miss: of three rows for each target, then of one row for each point."""
    of_targets = np.linalg.norm(misses[: 3 * targets].reshape(-1, 3), axis=1)
    return np.concatenate([of_targets, np.abs(misses[3 * targets :])])


def _sizes(misses: FloatArray, targets: int) -> FloatArray:
    """Compute the size of the miss of each row."""
    sizes = _size_of_each(misses, targets)
    return np.concatenate([np.repeat(sizes[:targets], 3), sizes[targets:]])


def start_at(link_from_base: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Make the starts of a fit from one pose, (4, 4) float, metres."""
    return link_from_base[None, :3, :3], link_from_base[None, :3, 3]


def fit_part_pose(touches: PartTouches, shape: PartShape, starts: tuple[FloatArray, FloatArray] | None = None) -> PartPose:
    """Fit the pose of a part to touches of it. The same touches give the same pose to the last bit.

    Parameters
    ----------
    starts : rotations (S, 3, 3) and shifts (S, 3), metres; `None` to search for them
    """
    counts = len(touches.at_landmark), len(touches.on_plan), len(touches.on_mesh) if shape.surface is not None else 0
    used = sum(counts[:2]) + counts[2]
    if max(counts) < MIN_TOUCHES and used < 2 * MIN_TOUCHES:
        return replace(NO_PART_POSE, landmarks=counts[0], taxels=counts[1], points=counts[2])
    turns, shifts = start_poses(touches, shape) if starts is None else starts
    fits = [_Fit.at(touches, shape, turn, shift) for turn, shift in zip(turns, shifts, strict=True)]
    fits = [_advanced(fit, touches, shape, FIRST_FIT_STEPS) for fit in fits]
    least = min(fit.cost for fit in fits)
    hopeful = [fit for fit in fits if fit.cost <= DROPPED_ABOVE_COST_FACTOR * least + DROPPED_ABOVE_COST_INCREASE]
    fits = [_advanced(fit, touches, shape, FIT_STEPS) for fit in hopeful]
    best = min(fits, key=lambda fit: fit.cost)
    return _judge(best, fits, touches, shape, counts)


def _advanced(fit: _Fit, touches: PartTouches, shape: PartShape, steps: int) -> _Fit:
    """Make up to `steps` Gauss-Newton steps, and give the best pose on the way.

    At the edges of triangles the nearest points change, and the steps go round between some poses that fit about as well.
    """
    best, stalled = fit, 0
    for _ in range(steps):
        if fit.is_converged or stalled == STALLED_STEPS:
            break
        fit = fit.next(touches, shape)
        stalled = 0 if fit.cost < best.cost - MIN_COST_DECREASE else stalled + 1
        best = min(best, fit, key=lambda each: each.cost)
    return best


def _judge(best: _Fit, fits: Sequence[_Fit], touches: PartTouches, shape: PartShape, counts: tuple[int, int, int]) -> PartPose:
    ranks = np.linalg.matrix_rank(touches.precision, hermitian=True, tol=POINT_MIN_PRECISION)
    equations = int(ranks[touches.at_landmark].sum() + ranks[touches.on_plan].sum()) + counts[2]
    if shape.surface is not None:
        equations -= int(np.isin(touches.on_plan, touches.on_mesh).sum())
    ratio = float(np.sqrt(best.chi2 / max(equations - 6, 1)))
    covariance = best.covariance * max(1.0, ratio) ** 2
    scales = _scales_of(best, touches, shape, equations - 6)
    open_motions, sd = find_open_motions(scales.moment[:6, :6], best.centre, shape.corners)
    rival = _find_rival(best, fits, shape.corners, max(1.0, ratio) ** 2)
    worst_landmark, worst_miss = _worst_landmark(best, touches)
    state = PartPoseState.KNOWN
    if sd > PART_POSE_MAX_SD_M:
        state = PartPoseState.OPEN
    elif rival is not None:
        state = PartPoseState.AMBIGUOUS
    if equations > 6 and ratio > DISAGREES_ABOVE_SDS:
        state = PartPoseState.DISAGREES
    return PartPose(
        state=state,
        link_from_base=best.link_from_base,
        centre=best.centre,
        with_tip=covariance,
        scales=scales,
        landmarks=counts[0],
        taxels=counts[1],
        points=counts[2],
        tip_shift=best.tip_shift,
        tip_shift_chi2=_tip_shift_chi2(best.tip_shift, shape),
        height=best.height[0] if counts[2] else 0.0,
        height_sd=best.height[1] * max(1.0, ratio) if counts[2] else np.inf,
        ratio=ratio,
        freedom=equations - 6,
        held_out_ratio=_held_out_ratio(best, touches.landmark[touches.at_landmark], ranks[touches.at_landmark]),
        landmark_places=len(np.unique(touches.landmark[touches.at_landmark], axis=0)),
        worst_landmark=worst_landmark,
        worst_miss=worst_miss,
        sd=sd,
        open_motions=open_motions,
        rival=rival,
    )


def _tip_shift_chi2(tip_shift: FloatArray, shape: PartShape) -> float:
    covariance = shape.tip_covariance + TIP_MIN_SD_M**2 * np.eye(3)
    return float(tip_shift @ np.linalg.solve(covariance, tip_shift))


def _scales_of(best: _Fit, touches: PartTouches, shape: PartShape, freedom: int) -> PartScales:
    """Find the scale of the drawing at the best pose, whose chi-square has `freedom` degrees of freedom."""
    own = scale_rows(touches, shape, best.turn, best.shift, best.rows)
    slopes = np.concatenate([own.of_targets.reshape(-1, own.of_mesh.shape[1]), own.of_mesh])
    weighted = slopes * best.trust[:, None]
    across, count = best.slopes.T @ weighted, len(best.normal)
    normal = np.block([[best.normal, across], [across.T, slopes.T @ weighted]])
    landmarks = np.unique(touches.landmark[touches.at_landmark], axis=0)
    pull = np.concatenate([np.zeros(count), weighted.T @ best.misses])
    found = find_scales(normal, pull, (best.chi2, freedom), (len(landmarks), len(own.of_mesh)))
    off_mesh = 0.0 if shape.surface is None else find_landmarks_off_mesh(landmarks, shape.surface)
    return replace(found, landmarks_off_mesh=off_mesh)


def _held_out_ratio(best: _Fit, places: FloatArray, ranks: IntArray) -> float:
    """Compute the rms ratio of the misses of landmarks to those predicted from all other touches; NaN without a landmark.

    Without the rows J of a landmark, of trust w and with the misses r, the unknowns are N_0^-1 J'w r away, with
    N_0 = N - J'w J. Then r becomes e = r + J N_0^-1 J'w r, of covariance I + J N_0^-1 J'.

    Parameters
    ----------
    places : (k, 3) float, metres: landmark of each touch
    ranks : (k,) directions that each touch measures
    """
    normal, count = best.normal, len(places)
    slopes, misses = best.slopes[: 3 * count].reshape(count, 3, len(normal)), best.misses[: 3 * count].reshape(count, 3)
    trust, squares, equations = best.trust[: 3 * count : 3], 0.0, 0
    for place in np.unique(places, axis=0):
        own = np.flatnonzero((places == place).all(axis=1))
        rows, off = slopes[own].reshape(-1, normal.shape[0]), misses[own].ravel()
        trusted = rows * np.repeat(trust[own], 3)[:, None]
        without = normal - trusted.T @ rows
        predicted = off + rows @ np.linalg.solve(without, trusted.T @ off)
        covariance = np.eye(len(off)) + rows @ np.linalg.solve(without, rows.T)
        squares += float(predicted @ np.linalg.solve(covariance, predicted))
        equations += int(ranks[own].sum())
    return float(np.sqrt(squares / equations)) if equations else np.nan


def _worst_landmark(best: _Fit, touches: PartTouches) -> tuple[int, float]:
    rows = touches.at_landmark
    if not len(rows):
        return 0, 0.0
    off = touches.place[rows] @ best.turn.T + best.shift - touches.landmark[rows]
    # Along a direction that a touch does not measure it misses nothing.
    measured = roots_of(best.turn @ touches.precision[rows] @ best.turn.T, LANDMARK_SD_M**2)
    sizes = np.linalg.norm((measured @ off[:, :, None])[:, :, 0], axis=1)
    row = int(np.argmax(sizes))
    values = np.linalg.norm(measured[row], ord=2)
    return int(touches.number[rows[row]]), float(sizes[row] / values)


def _find_rival(best: _Fit, fits: Sequence[_Fit], corners: FloatArray, variance: float) -> FloatArray | None:
    """Find another pose that fits about as well and puts the part elsewhere."""
    base = (corners - best.shift) @ best.turn
    others = [fit for fit in fits if (fit.cost - best.cost) / variance < RIVAL_MAX_CHI2_INCREASE]
    for fit in sorted(others, key=lambda fit: fit.cost):
        off = base @ fit.turn.T + fit.shift - corners
        if float(np.linalg.norm(off)) / len(off) ** 0.5 > RIVAL_MIN_DISTANCE_M:
            return fit.link_from_base
    return None
