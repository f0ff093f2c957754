"""Starts of the fit of a part's pose (`part_pose`): poses from which Gauss-Newton steps reach the best one.

Landmarks and planned taxels say which point was touched. Touches that are points then give a pose directly (Kabsch 1976, Horn
1987). Force axes and single landmarks do not, so 24 rotations are tried as well, each with its best shift. Without enough of
these the mesh must give the pose: the touch nearest to the middle of all is put on places all over the mesh, against its
normal and turned about it. All starts go through the same steps together, with an error that shrinks from centimetres to
nothing; the best different ones remain.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry import FloatArray, IntArray, cube_rotations, fit_rotation, orthonormal_pair, rotations
from skincal.mesh.surface import Surface
from skincal.rig.part_touches import (
    HUBER_THRESHOLD_SDS,
    SHIFT_PRIOR_SD_M,
    TURN_PRIOR_SD_RAD,
    PartShape,
    PartTouches,
    find_open_motions,
    moved_pose,
    pose_rows,
    roots_of,
    trust_of,
)

ADDED_SDS_M = (0.05, 0.03, 0.02, 0.012, 0.008, 0.005, 0.003, 0.002, 0.001, 0.0005)
"""m, sd added to every miss in successive steps."""
TARGETS_SUFFICE_BELOW_SD_M = 0.03
"""m. If landmarks and planned taxels give the pose to this, the mesh needs no starts of its own."""
MESH_SEEDS, SEED_SPINS = 20, 12
"""Places on the mesh, and turns about the normal at each."""
MESH_POINTS, PLASTIC_NUMBER = 500, 1.2207440846057596
"""Points among which the places are chosen; 1 / x, 1 / x^2, 1 / x^3 with x^4 = x + 1 make the sequence in three dimensions."""
START_TOUCHES_MAX = 24
"""Touches that the starts use, spread evenly over their numbers; landmarks first."""
STARTS_KEPT = 8
CLOSED_START_MIN_TOUCHES = 4
LANDMARK_MIN_SPREAD_M = 0.015
"""m, rms distance of landmarks from a line: with errors of 1 mm none of their touches fits turned about it."""
DROPPED_ABOVE_COST_FACTOR, DROPPED_ABOVE_COST_INCREASE = 3.0, 16.0
"""After the first steps a start with a cost above this multiple of the least, and this much more, goes no further."""
DIFFERENT_ABOVE_M = 0.003
"""m, rms over the part, between two starts that are kept."""
SURVIVORS_AFTER_STEPS, SURVIVORS = 4, 48
"""After the first steps only the best starts go on."""


def start_poses(touches: PartTouches, shape: PartShape) -> tuple[FloatArray, FloatArray]:
    """Find up to `STARTS_KEPT` different poses: rotations (S, 3, 3) and shifts (S, 3), metres, the best first."""
    if _landmarks_suffice(touches):
        return start_from_landmarks(touches)
    some = _spread_touches(touches)
    starts = [_from_targets(some)] if len(some.at_landmark) + len(some.on_plan) else []
    if shape.surface is not None and len(some.on_mesh) and not _targets_suffice(some, shape, starts):
        starts.append(_from_mesh(some, shape.surface))
    turns, shifts = (np.concatenate(each) for each in zip(*starts, strict=True))
    costs = np.zeros(len(turns))
    for step, added_sd in enumerate(ADDED_SDS_M):
        turns, shifts, costs = _move_starts(some, shape, turns, shifts, added_sd)
        if step == SURVIVORS_AFTER_STEPS:
            best = np.sort(np.argsort(costs, kind="stable")[:SURVIVORS])
            turns, shifts = turns[best], shifts[best]
    kept: list[int] = []
    hopeful = costs <= DROPPED_ABOVE_COST_FACTOR * costs.min() + DROPPED_ABOVE_COST_INCREASE
    for row in np.argsort(costs, kind="stable")[: int(hopeful.sum())].tolist():
        base = (shape.corners - shifts[row]) @ turns[row]
        off = [base @ turns[other].T + shifts[other] - shape.corners for other in kept]
        if all(float(np.linalg.norm(each)) / len(each) ** 0.5 > DIFFERENT_ABOVE_M for each in off):
            kept.append(row)
        if len(kept) == STARTS_KEPT:
            break
    return turns[kept], shifts[kept]


def _landmarks_suffice(touches: PartTouches) -> bool:
    """Whether points at landmarks alone give the pose, so that no other one fits."""
    places = touches.landmark[touches.at_landmark]
    if len(places) < CLOSED_START_MIN_TOUCHES or not touches.is_point[touches.at_landmark].all():
        return False
    # The second singular value is the spread across the line that fits them best.
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False) / len(places) ** 0.5
    return float(spread[1]) > LANDMARK_MIN_SPREAD_M


def start_from_landmarks(touches: PartTouches) -> tuple[FloatArray, FloatArray]:
    """Find the pose that carries the points at landmarks to these: rotation (1, 3, 3) and shift (1, 3), metres."""
    turns, shifts = _from_targets(touches.rows(touches.at_landmark))
    return turns[:1], shifts[:1]


def closed_start(touches: PartTouches) -> tuple[FloatArray, FloatArray] | None:
    """Find the best pose of the points at landmarks and planned taxels; `None` with fewer than `CLOSED_START_MIN_TOUCHES`."""
    if len(touches.at_landmark) + len(touches.on_plan) < CLOSED_START_MIN_TOUCHES:
        return None
    turns, shifts = _from_targets(touches)
    return turns[:1], shifts[:1]


def _spread_touches(touches: PartTouches) -> PartTouches:
    """Select up to `START_TOUCHES_MAX` touches; landmarks all."""
    landmarks = touches.at_landmark
    others = np.setdiff1d(np.arange(len(touches)), landmarks)
    room = max(START_TOUCHES_MAX - len(landmarks), START_TOUCHES_MAX // 2)
    if len(others) > room:
        others = others[np.linspace(0, len(others) - 1, room).round().astype(np.int64)]
    return touches.rows(np.sort(np.concatenate([landmarks, others])))


def _move_starts(
    touches: PartTouches, shape: PartShape, turns: FloatArray, shifts: FloatArray, added_sd: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move all starts by one step; also gives their costs (S,) before it."""
    rows = pose_rows(touches, shape, turns, shifts, added_sd, is_start=True)
    sizes = np.linalg.norm(rows.of_targets, axis=2), np.abs(rows.of_mesh)
    weights = [trust_of(each) for each in sizes]
    normal = np.einsum("sk,skij,skil->sjl", weights[0], rows.target_slopes, rows.target_slopes)
    normal += np.einsum("sm,smj,sml->sjl", weights[1], rows.mesh_slopes, rows.mesh_slopes)
    gradient = np.einsum("sk,skij,ski->sj", weights[0], rows.target_slopes, rows.of_targets)
    gradient += np.einsum("sm,smj,sm->sj", weights[1], rows.mesh_slopes, rows.of_mesh)
    prior = np.repeat([TURN_PRIOR_SD_RAD, SHIFT_PRIOR_SD_M], 3) ** -2.0
    motion = -np.asarray(np.linalg.solve(normal + np.diag(prior), gradient[:, :, None])[:, :, 0], dtype=np.float64)
    size = np.linalg.norm(motion[:, :3], axis=1, keepdims=True)
    motion[:, :3] *= np.minimum(1.0, 0.7 / np.maximum(size, 1e-12))  # a linear step holds for less than this, rad
    costs = sum(np.sum(np.minimum(each**2, HUBER_THRESHOLD_SDS * 2.0 * each), axis=1) for each in sizes)
    return *moved_pose(turns, shifts, rows.centres, motion), np.asarray(costs)


def _from_targets(touches: PartTouches) -> tuple[FloatArray, FloatArray]:
    """Make 25 starts: the best fit of the points, and 24 rotations with their best shifts."""
    rows = np.concatenate([touches.at_landmark, touches.on_plan])
    goals = np.concatenate([touches.landmark[touches.at_landmark], touches.planned[touches.on_plan]])
    points, precision = touches.place[rows], touches.precision[rows]
    off = points - points.mean(axis=0)
    # R x = y as rows: x R' = y.
    kabsch = fit_rotation(off.T @ (goals - goals.mean(axis=0))).T
    turns = np.array([kabsch, *cube_rotations()])
    roots = roots_of(precision, 0.01**2)
    shifts = np.empty((len(turns), 3))
    for row, turn in enumerate(turns):
        # Least squares of B (x + R'(t - y)) for t.
        by_link = (roots @ turn.T).reshape(-1, 3)
        wanted = (by_link.reshape(-1, 3, 3) @ goals[:, :, None]).ravel() - (roots @ points[:, :, None]).ravel()
        shifts[row] = np.linalg.lstsq(by_link, wanted, rcond=1e-9)[0]
    return turns, shifts


def _targets_suffice(touches: PartTouches, shape: PartShape, starts: list[tuple[FloatArray, FloatArray]]) -> bool:
    """Whether landmarks and planned taxels alone give the pose about."""
    if not starts:
        return False
    (turns, shifts), costs = starts[0], np.zeros(0)
    without_mesh = PartShape(None, shape.corners, shape.noise)
    for added_sd in ADDED_SDS_M[:5]:
        turns, shifts, costs = _move_starts(touches, without_mesh, turns, shifts, added_sd)
    best = int(np.argmin(costs))
    rows = pose_rows(touches, without_mesh, turns[best : best + 1], shifts[best : best + 1], is_start=True)
    slopes = rows.target_slopes[0].reshape(-1, 6)
    prior = np.repeat([TURN_PRIOR_SD_RAD, SHIFT_PRIOR_SD_M], 3) ** -2.0
    covariance = np.asarray(np.linalg.inv(slopes.T @ slopes + np.diag(prior)), dtype=np.float64)
    return find_open_motions(covariance, rows.centres[0], shape.corners)[1] < TARGETS_SUFFICE_BELOW_SD_M


def _from_mesh(touches: PartTouches, surface: Surface) -> tuple[FloatArray, FloatArray]:
    """Make starts that lay the middle touch on places all over the mesh, against the normal, in all turns about it."""
    rows = touches.on_mesh
    places, pushes = touches.place[rows], touches.push[rows]
    middle = int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))
    spins = np.linspace(0.0, 2.0 * np.pi, SEED_SPINS, endpoint=False, dtype=np.float64)
    push = pushes[middle]
    first = np.concatenate([orthonormal_pair(push[None])[0], push[None]])  # rows: two across, then the push
    turns: list[FloatArray] = []
    shifts: list[FloatArray] = []
    for place, normal in zip(*_seeds(surface), strict=True):
        second = np.concatenate([orthonormal_pair(-normal[None])[0], -normal[None]])
        for spin in rotations(np.stack([np.zeros_like(spins), np.zeros_like(spins), spins], axis=1)):
            turn = second.T @ spin @ first
            turns.append(turn)
            shifts.append(place - turn @ places[middle])
    return np.array(turns), np.array(shifts)


def _seeds(surface: Surface) -> tuple[FloatArray, FloatArray]:
    """Choose `MESH_SEEDS` places far apart on a mesh, each the farthest from those before; their places and normals, (k, 3)."""
    corners = surface.corners
    sides = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    # A sequence of low discrepancy (Roberts 2018) over the area and in each triangle.
    at = np.modf(0.5 + np.arange(1, MESH_POINTS + 1)[:, None] * PLASTIC_NUMBER ** -np.arange(1.0, 4.0))[0]
    below: FloatArray = np.cumsum(areas, dtype=np.float64)
    rows: IntArray = np.asarray(below[:-1].searchsorted(at[:, 0] * below[-1]), dtype=np.int64)
    root = np.sqrt(at[:, 1:2])
    places = corners[rows, 0] + root * (sides[rows, 0] + at[:, 2:] * (sides[rows, 1] - sides[rows, 0]))
    chosen = [int(np.argmax(np.linalg.norm(places - places.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < MESH_SEEDS:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return places[chosen], surface.normals[rows[chosen]]
