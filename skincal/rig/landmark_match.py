"""Names of touched landmarks by the shape that the touched points have, while the pose of the part is unknown.

Touch a measured a point x_a in the base, and landmark i lies at l_i of the part. Three touches and three landmarks with the
same distances give a motion (R, t) (Kabsch 1976). Under it each touch is at the nearest landmark that its push can touch, or at
none:

    cost = sum_a min(|R x_a + t - l_i(a)|^2 / sd^2, UNMATCHED_COST).

The motion of least cost names the touches. Another naming is a rival if its cost is larger by less than
`RIVAL_MAX_CHI2_INCREASE`: equal distances, as between the corners of a square, leave the names open.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np

from skincal.geometry import BoolArray, FloatArray, IntArray, fit_rotation
from skincal.rig.part_pose import MIN_TOUCHES, MISFIT_MIN_RATIO, RIVAL_MAX_CHI2_INCREASE, RIVAL_MIN_DISTANCE_M

UNMATCHED_COST = 25.0
"""Cost of a touch at no landmark: as much as a miss of five standard deviations."""
TRIANGLE_MIN_HEIGHT_SDS = 8.0
"""A flatter triangle of landmarks does not turn the part about its long side."""
PUSH_MAX_COSINE = -0.5
"""Largest cosine between a push and the outward normal of a touched landmark, as `MAX_PUSH_COSINE` of landmark pokes."""
MATCHED_TOUCHES_MAX, MATCHED_LANDMARKS_MAX = 24, 16
"""Touches and landmarks that are compared, the first of each: of more there are too many triangles."""
CANDIDATES_MAX = 4000
"""Motions that are compared: those of the triangles that agree best."""
REFIT_STEPS = 3


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkMatch:
    """Landmarks of touches, and another naming that fits as well."""

    landmark: IntArray
    """(m,) row of the landmark of each touch; -1 at none."""
    rival: IntArray | None
    """The same of another naming; `None` if there is none."""
    miss: float
    """m, rms distance of the matched touches from their landmarks."""


class _Given(NamedTuple):
    """Parameters of `match_landmarks`, of at most `MATCHED_TOUCHES_MAX` touches and `MATCHED_LANDMARKS_MAX` landmarks."""

    points: FloatArray
    pushes: FloatArray
    places: FloatArray
    normals: FloatArray
    sd: float
    known: IntArray


def match_landmarks(
    points: FloatArray, pushes: FloatArray, places: FloatArray, normals: FloatArray, sd: float, known: IntArray
) -> LandmarkMatch | None:
    """Name touches by the shape of the touched points; `None` if fewer than three landmarks fit.

    Parameters
    ----------
    points, pushes : (m, 3) float, metres and unit, base: touched points and the directions into the part
    places, normals : (k, 3) float, metres and unit, link: landmarks, and outward there; zero if unknown
    sd : m, of a touch from its landmark, each direction
    known : (m,) row of the landmark of touches that have a name; -1 without one
    """
    points, pushes, known = points[:MATCHED_TOUCHES_MAX], pushes[:MATCHED_TOUCHES_MAX], known[:MATCHED_TOUCHES_MAX]
    places, normals = places[:MATCHED_LANDMARKS_MAX], normals[:MATCHED_LANDMARKS_MAX]
    if len(points) < MIN_TOUCHES or len(places) < MIN_TOUCHES:
        return None
    given = _Given(points, pushes, places, normals, sd, known)
    touched, marked = _equal_triangles(points, places, sd, known)
    if not len(touched):
        return None
    turns, shifts = _motions(points[touched], places[marked], np.ones(touched.shape))
    for _ in range(REFIT_STEPS):
        named, _ = _nearest(given, turns, shifts)
        goals = places[np.maximum(named, 0)]
        turns, shifts = _motions(np.broadcast_to(points, goals.shape), goals, (named >= 0).astype(np.float64))
    named, squares = _nearest(given, turns, shifts)
    costs = np.minimum(squares, UNMATCHED_COST).sum(axis=1)
    enough = np.array([len(set(row[row >= 0].tolist())) >= MIN_TOUCHES for row in named])
    enough &= (named[:, known >= 0] >= 0).all(axis=1)
    matched = (named >= 0).sum(axis=1)
    misses = np.where(named >= 0, squares, 0.0).sum(axis=1)
    enough &= misses <= MISFIT_MIN_RATIO**2 * np.maximum(3 * matched - 6, 1)
    if not enough.any():
        return None
    costs = np.where(enough, costs, np.inf)
    best = int(costs.argmin())
    # Another naming of a touch, or another place of the part in the base, and not merely a touch more or less.
    differs = ((named != named[best]) & (named >= 0) & (named[best] >= 0)).any(axis=1)
    in_base = (places - shifts[:, None]) @ turns
    differs |= np.sqrt(np.mean(np.sum((in_base - in_base[best]) ** 2, axis=2), axis=1)) > RIVAL_MIN_DISTANCE_M
    others = np.flatnonzero((costs < costs[best] + RIVAL_MAX_CHI2_INCREASE) & differs)
    rival = named[others[costs[others].argmin()]] if len(others) else None
    is_matched = named[best] >= 0
    return LandmarkMatch(named[best], rival, sd * float(np.sqrt(squares[best][is_matched].mean())))


def _equal_triangles(points: FloatArray, places: FloatArray, sd: float, known: IntArray) -> tuple[IntArray, IntArray]:
    """List triangles (c, 3) of touches and (c, 3) of landmarks with equal sides, those that agree best first."""
    touched = np.array(list(combinations(range(len(points)), 3)))
    marked = np.array(list(permutations(range(len(places)), 3)))
    marked = marked[_heights(places[marked]) > TRIANGLE_MIN_HEIGHT_SDS * sd]
    sides, goals = _sides(points[touched]), _sides(places[marked])
    found: list[tuple[FloatArray, IntArray, IntArray]] = []
    for row, side in zip(touched, sides, strict=True):
        off = np.abs(goals - side).max(axis=1)
        # A side differs by the errors of both ends.
        fits = off < np.sqrt(2.0 * UNMATCHED_COST) * sd
        fits &= ((known[row] < 0) | (known[row] == marked)).all(axis=1)
        rows = np.flatnonzero(fits)
        found.append((off[rows], np.broadcast_to(row, (len(rows), 3)), marked[rows]))
    off, touched, marked = (np.concatenate(each) for each in zip(*found, strict=True))
    order = np.argsort(off, kind="stable")[:CANDIDATES_MAX]
    return touched[order], marked[order]


def _sides(triangles: FloatArray) -> FloatArray:
    """Compute the lengths (..., 3) of the sides of triangles (..., 3, 3)."""
    return np.linalg.norm(triangles - np.roll(triangles, 1, axis=-2), axis=-1)


def _heights(triangles: FloatArray) -> FloatArray:
    """Compute the least height (...) of triangles (..., 3, 3)."""
    edges = triangles[..., 1:, :] - triangles[..., :1, :]
    area = np.linalg.norm(np.cross(edges[..., 0, :], edges[..., 1, :]), axis=-1)
    return area / np.maximum(_sides(triangles).max(axis=-1), 1e-12)


def _motions(points: FloatArray, goals: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit motions R (c, 3, 3) and t (c, 3) of points (c, n, 3) to goals (c, n, 3), with weights (c, n)."""
    share = (weights / np.maximum(weights.sum(axis=1, keepdims=True), 1.0))[..., None]
    middles, ends = np.sum(share * points, axis=1), np.sum(share * goals, axis=1)
    products = (share * (points - middles[:, None])).transpose(0, 2, 1) @ (goals - ends[:, None])
    turns = fit_rotation(products).transpose(0, 2, 1)
    return turns, ends - (turns @ middles[:, :, None])[:, :, 0]


def _nearest(given: _Given, turns: FloatArray, shifts: FloatArray) -> tuple[IntArray, FloatArray]:
    """Find (c, m) the landmark of each touch under each motion, -1 at none, and (c, m) the squared misses over `sd`."""
    points, pushes, places, normals, sd, known = given
    there = points @ turns.transpose(0, 2, 1) + shifts[:, None]
    squares = np.sum((there[:, :, None] - places) ** 2, axis=3) / sd**2
    is_behind: BoolArray = (pushes @ turns.transpose(0, 2, 1)) @ normals.T > PUSH_MAX_COSINE
    squares[is_behind & normals.any(axis=1)] = np.inf
    squares[:, (known[:, None] >= 0) & (known[:, None] != np.arange(len(places)))] = np.inf
    named = squares.argmin(axis=2)
    least = np.take_along_axis(squares, named[:, :, None], axis=2)[:, :, 0]
    return np.where(least < UNMATCHED_COST, named, -1), least
