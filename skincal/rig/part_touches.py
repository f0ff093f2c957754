"""Touches of a part by a tool, and their equations for the part's pose in the base.

The derivation: `part_pose`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray, cross_matrix, mean_rows, rotations, select_rows
from skincal.model.scene import NoiseSettings

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

LANDMARK_SD_M = 0.0007
"""m, sd of a touch from its landmark, each direction: `RigPrior.landmark`."""
PLAN_SHIFT_SD_M, MODULE_SHIFT_SD_M = 0.008, 0.004
"""m, sd of the shift of a skin from its plan, as `SENSOR_MOUNT_SHIFT_SD_M` of the setup check, and of a module in it."""
MESH_SD_M = 0.0005
"""m, sd of a single touch from a mesh, in addition to the height h of all touches: a printed part."""
OPEN_MOTION_MIN_SD_M = 0.002
"""m, rms over the part, of a motion that is named."""
HUBER_THRESHOLD_SDS = 2.5
TURN_PRIOR_SD_RAD, SHIFT_PRIOR_SD_M = 1.0, 0.5
"""rad and m, of each step: directions without any equation keep their value."""
POINT_MIN_PRECISION = 1.0 / 0.05**2
"""1/m^2. A touch with less along a direction is no point for the mesh."""


@dataclass(frozen=True, eq=False)
class PartTouches:
    """n points of the part that the tool touched."""

    number: IntArray
    """(n,) numbers of the pokes."""
    place: FloatArray
    """(n, 3) float, metres, base: the touched point, or a point of the force axis."""
    precision: FloatArray
    """(n, 3, 3) float, 1/m^2, base: W."""
    push: FloatArray
    """(n, 3) float, unit, base: into the part."""
    tool_turn: FloatArray
    """(n, 3, 3) float: rotation that carries an error of the tip, in the frame of `PartShape.tip_covariance`, into the base."""
    landmark: FloatArray
    """(n, 3) float, metres, link: NaN without a landmark."""
    planned: FloatArray
    """(n, 3) float, metres, link: planned place of the taxel that answers most; NaN without one, and at landmarks."""
    normal: FloatArray
    """(n, 3) float, unit, link: outward there; NaN as `planned`."""
    module: IntArray
    """(n,) index of that taxel's module; -1 without one."""

    def __len__(self) -> int:
        return len(self.number)

    def rows(self, rows: IntArray | slice) -> PartTouches:
        """Select touches."""
        return select_rows(self, rows)

    @cached_property
    def at_landmark(self) -> IntArray:
        """Rows of touches at landmarks."""
        return np.flatnonzero(np.isfinite(self.landmark[:, 0]))

    @cached_property
    def on_plan(self) -> IntArray:
        """Rows of touches at a planned taxel."""
        return np.flatnonzero(np.isfinite(self.planned[:, 0]))

    @cached_property
    def is_point(self) -> NDArray[np.bool_]:
        """(n,) bool: measured in all directions."""
        return np.linalg.eigvalsh(self.precision)[:, 0] > POINT_MIN_PRECISION

    @cached_property
    def on_mesh(self) -> IntArray:
        """Rows of touches that are points, and at no landmark."""
        return np.flatnonzero(self.is_point & ~np.isfinite(self.landmark[:, 0]))

    @cached_property
    def points(self) -> PartTouches:
        """The touches of `on_mesh`."""
        return self.rows(self.on_mesh)

    @cached_property
    def covariance(self) -> FloatArray:
        """(n, 3, 3) float, m^2, base: of touches that are all points."""
        return np.asarray(np.linalg.inv(self.precision), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class PartShape:
    """Mesh and size of the part, and the noise of the scene."""

    surface: Surface | None
    corners: FloatArray
    """(m, 3) float, metres, link: points all over the part, at which an error of its pose is measured; one or more."""
    noise: NoiseSettings
    """Of the scene: `contact` and `skin` are used."""
    tip_covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    """(3, 3) float, m^2: error of the tip that all touches share, in the tool's or the sensor's frame; zero for force axes."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenMotion:
    """A motion of the part that the touches hardly determine, of one standard deviation."""

    turn: FloatArray
    """(3,) float, rad, link frame, about the part's middle."""
    shift: FloatArray
    """(3,) float, metres, link frame, of the part's middle."""
    sd: float
    """m, rms over the part."""

    @property
    def is_shift(self) -> bool:
        """Whether it moves the part's middle by more than it turns the part about it."""
        return bool(np.linalg.norm(self.shift) ** 2 >= 0.5 * self.sd**2)


def motion_rows(levers: FloatArray) -> FloatArray:
    """Make (..., 3, 6): the shift of points at levers (..., 3) from the centre by a turn and a shift."""
    return np.concatenate([-cross_matrix(levers), np.broadcast_to(np.eye(3), (*levers.shape[:-1], 3, 3))], axis=-1)


def roots_of(precision: FloatArray, variance: FloatArray | float) -> FloatArray:
    """Compute B (n, 3, 3) with B'B = (W^-1 + variance I)^-1 for precisions W (n, 3, 3) of any rank; `variance` is (n,), m^2."""
    values, axes = np.linalg.eigh(precision)
    values = np.maximum(values, 0.0)
    left = values / (1.0 + values * np.asarray(variance)[..., None])
    return np.sqrt(left)[:, :, None] * axes.transpose(0, 2, 1)


@dataclass(frozen=True, slots=True, eq=False)
class PoseRows:
    """Whitened equations of S poses at once, with k targets (landmarks and planned taxels) and m points on the mesh."""

    of_targets: FloatArray
    """(S, k, 3) float: misses in standard deviations."""
    target_slopes: FloatArray
    """(S, k, 3, 6) float: derivatives by turn (rad) and shift (m)."""
    plan_slopes: FloatArray
    """(S, k, 3, 3) float, 1/m: derivatives by the shift of the planned place, link frame; zero for landmarks."""
    tip_slopes: FloatArray
    """(S, k, 3, 3) float, 1/m: derivatives by an error of the tip."""
    of_mesh: FloatArray
    """(S, m) float: misses in standard deviations."""
    mesh_slopes: FloatArray
    """(S, m, 6) float."""
    height_slopes: FloatArray
    """(S, m) float, 1/m: derivatives by the height h."""
    mesh_tip_slopes: FloatArray
    """(S, m, 3) float, 1/m: derivatives by an error of the tip."""
    centres: FloatArray
    """(S, 3) float, metres, link: c."""


def pose_rows(
    touches: PartTouches, shape: PartShape, turns: FloatArray, shifts: FloatArray, added_sd: float = 0.0, *, is_start: bool
) -> PoseRows:
    """Make the equations at S poses.

    Parameters
    ----------
    turns, shifts : (S, 3, 3) and (S, 3), metres: R and t
    added_sd : m, sd that is added to every miss, each direction: large at first, so that far starts converge
    is_start : the shifts of the plan and the height over the mesh are noise, not unknowns
    """
    noise, landmarks, planned = shape.noise, touches.at_landmark, touches.on_plan
    on_mesh = touches.on_mesh if shape.surface is not None else np.empty(0, np.int64)
    centres = touches.place.mean(axis=0) @ turns.transpose(0, 2, 1) + shifts
    rows = np.concatenate([landmarks, planned])
    goals = np.concatenate([touches.landmark[landmarks], touches.planned[planned]])
    plan_sd = np.hypot(noise.contact, np.hypot(PLAN_SHIFT_SD_M, MODULE_SHIFT_SD_M)) if is_start else noise.contact
    own = np.repeat([LANDMARK_SD_M, plan_sd], [len(landmarks), len(planned)])
    roots = roots_of(touches.precision[rows], own**2 + added_sd**2)
    by_link = roots @ turns.transpose(0, 2, 1)[:, None]
    # The mesh measures along the normal, so the layout measures across it.
    across = np.concatenate([np.zeros(len(landmarks), np.bool), np.isin(planned, on_mesh)])
    normals = np.concatenate([np.zeros((len(landmarks), 3)), touches.normal[planned]])
    along = (by_link @ normals[:, :, None])[..., 0]
    size = np.sum(along * along, axis=-1, keepdims=True)
    unit = np.where(across[:, None] & (size > 0.0), along / np.sqrt(np.where(size > 0.0, size, 1.0)), 0.0)
    keep = np.eye(3) - unit[..., :, None] * unit[..., None, :]
    by_link = keep @ by_link
    roots = keep @ roots
    misses = (roots @ touches.place[rows][:, :, None])[..., 0] + (by_link @ (shifts[:, None] - goals)[..., None])[..., 0]
    slopes = by_link @ motion_rows(goals - centres[:, None])
    is_planned = np.repeat([0.0, 1.0], [len(landmarks), len(planned)])
    mesh = _mesh_rows(touches.points, shape, (turns, shifts, centres), added_sd, is_start=is_start)
    of_plan = -by_link * is_planned[:, None, None]
    return PoseRows(misses, slopes, of_plan, roots @ touches.tool_turn[rows], *mesh, centres)


def _mesh_rows(
    touches: PartTouches,
    shape: PartShape,
    poses: tuple[FloatArray, FloatArray, FloatArray],
    added_sd: float,
    *,
    is_start: bool,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    (turns, shifts, centres), count = poses, len(touches)
    if shape.surface is None or not count:
        none = np.empty((len(turns), 0))
        return none, np.empty((len(turns), 0, 6)), none, np.empty((len(turns), 0, 3))
    from skincal.mesh.search import nearest_pushed_points  # a part without a mesh does without

    there = touches.place @ turns.transpose(0, 2, 1) + shifts[:, None]
    pushes = touches.push @ turns.transpose(0, 2, 1)
    near, triangles = nearest_pushed_points(shape.surface, there.reshape(-1, 3), pushes.reshape(-1, 3))
    near, normals = near.reshape(there.shape), shape.surface.normals[triangles].reshape(there.shape)
    in_base = (normals[:, :, None] @ turns[:, None])[:, :, 0]
    variance = np.vecdot((in_base[:, :, None] @ touches.covariance)[:, :, 0], in_base) + MESH_SD_M**2 + added_sd**2
    if is_start:
        variance = variance + shape.noise.skin**2
    weights = 1.0 / np.sqrt(variance)
    misses = np.sum(normals * (there - near), axis=2) * weights
    slopes = (normals[:, :, None] @ motion_rows(there - centres[:, None]))[:, :, 0] * weights[:, :, None]
    of_tip = (in_base[:, :, None] @ touches.tool_turn)[:, :, 0] * weights[:, :, None]
    return misses, slopes, -weights, of_tip


def trust_of(sizes: FloatArray) -> FloatArray:
    """Compute Huber's weights of misses in standard deviations."""
    return np.minimum(1.0, HUBER_THRESHOLD_SDS / np.maximum(sizes, 1e-12))


def moved_pose(turn: FloatArray, shift: FloatArray, centre: FloatArray, motion: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn S poses (S, 3, 3) and (S, 3) by motion[:, :3], rad, about centres (S, 3), then shift them by motion[:, 3:]."""
    by = rotations(motion[:, :3])
    return by @ turn, (by @ (shift - centre)[:, :, None])[:, :, 0] + centre + motion[:, 3:]


def find_open_motions(covariance: FloatArray, centre: FloatArray, corners: FloatArray) -> tuple[tuple[OpenMotion, ...], float]:
    """Find the motions with a large error, the largest first, and the largest sd of a corner in any direction, metres.

    Parameters
    ----------
    covariance : (6, 6) float: of a turn about `centre` and a shift
    corners : (m, 3) float, metres: points all over the part
    """
    rows = motion_rows(corners - centre)
    sds = np.sqrt(np.linalg.eigvalsh(rows @ covariance @ rows.transpose(0, 2, 1))[:, -1])
    # Motions v with independent errors that move the part by sizes v' M v: eigenvectors of M^1/2 P M^1/2.
    size = np.mean(rows.transpose(0, 2, 1) @ rows, axis=0) + 1e-12 * np.eye(6)
    values, axes = np.linalg.eigh(size)
    root, inverse = (axes * values**power @ axes.T for power in (0.5, -0.5))
    squares, motions = np.linalg.eigh(root @ covariance @ root)
    middle = mean_rows(corners)
    found: list[OpenMotion] = []
    for square, motion in zip(squares[::-1].tolist(), motions.T[::-1], strict=True):
        sd = float(np.sqrt(max(square, 0.0)))
        if sd < OPEN_MOTION_MIN_SD_M:
            break
        change = inverse @ motion * sd
        change = change * np.copysign(1.0, change[np.abs(change).argmax()])
        found.append(OpenMotion(change[:3], change[3:] + np.cross(change[:3], middle - centre), sd))
    return tuple(found), float(sds.max())
