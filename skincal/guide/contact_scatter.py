"""Scatter of the contact points, learned from how far a session's own pokes miss their predictions.

The scene's noise says how far a press acts from where the taxels answer. Skins and hands differ: a wide skin, an uneven tip or
a careless aim scatter more. The extra variance is the same in each direction across the push. Most pokes of a session share one
number. Where a press reaches many taxels, pokes that few taxels answer lie beyond the skin's edge: they have a larger one.

Errors of the rig must not pass for scatter. They are shared by pokes that follow each other in one arm pose, so the misses are
compared within windows of such pokes. In each window the rigid motion (six numbers) that explains most is taken out first.
Wrong poses, drift and a creeping arm therefore stay in the check. The median of the rest is robust against single bad pokes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.chi_square import CHI2_2DOF_MEDIAN
from skincal.geometry import FloatArray, IntArray, select_rows

POKES_PER_WINDOW = 12
"""Pokes of one window, half a minute of work: 24 numbers, six for a rigid motion."""
MIN_POKE_WINDOWS_TO_LEARN_NOISE = 8
"""Windows below which the scene's noise is kept: of fewer misses the median is too uncertain (8 % in standard deviations)."""
MAX_LEARNED_OVER_SCENE_NOISE = 1.5
"""Largest learned noise of a poke over the scene's (standard deviations). Sessions whose regions are right need at most 1.44
(skin that spreads a press over six taxels). Larger misses come from an error of the rig or the mesh, so the scene's noise
judges them."""
SENSOR_TO_SKIN_LEVER_M = 0.2
"""Typical distance from the sensor to the skin: a turn counts as the way at this distance."""
MOTION_PRIOR_INFORMATION_PER_M2 = 1.0
"""1/m^2, added to the information of each motion (a prior of 1 m): one that a window does not determine is no division by 0."""
BISECTION_STEPS = 16
EDGE_POKE_MAX_ANSWERS_OVER_MEDIAN = 0.6
"""Pokes with at most this share of the session's median number of answers are taken for pokes at the skin's edge."""
MIN_EDGE_POKES_FOR_SCATTER = 24
"""Edge pokes below which their scatter is that of the others."""
MAX_EDGE_OVER_SCENE_NOISE = 3.0
"""`MAX_LEARNED_OVER_SCENE_NOISE` of edge pokes: the middle of the taxels that answer may lie a whole pitch beside the press."""


@dataclass(frozen=True, slots=True, eq=False)
class PokeMisses:
    """Distances of the force axes of n pokes from the positions that all other pokes predict."""

    pokes: IntArray
    """(n,) numbers of the pokes."""
    poses: IntArray
    """(n,) equal where the arm's pose has the same name."""
    answers: IntArray
    """(n,) number of taxels that answered."""
    pairs: FloatArray
    """(n, 2, 3) float: two unit directions across each push."""
    levers: FloatArray
    """(n, 3) float, metres, from the sensor's origin to the predicted position."""
    misses: FloatArray
    """(n, 2) float, metres, along `pairs`."""
    covariances: FloatArray
    """(n, 2, 2) float, m^2, predicted of `misses`, by the scene's noise."""
    variances: FloatArray
    """(n,) float, m^2: the part of the poke's own noise, the mean of both directions."""

    def select(self, rows: IntArray) -> PokeMisses:
        """Keep the pokes in the given rows."""
        return select_rows(self, rows)

    def squares(self, scatter: Scatter) -> FloatArray:
        """Compute (n,) squared misses in standard deviations, with the scatter added to each direction."""
        total = self.covariances + scatter.variances(self.answers)[:, None, None] * np.eye(2)
        return np.sum(self.misses * np.linalg.solve(total, self.misses[:, :, None])[:, :, 0], axis=1)


@dataclass(frozen=True, slots=True)
class Scatter:
    """Variances of the contact points beyond the scene's noise, m^2."""

    common: float = 0.0
    edge: float = 0.0
    """Of pokes at the skin's edge."""
    edge_answers: int = 0
    """Largest number of answers of an edge poke."""

    def variances(self, answers: IntArray) -> FloatArray:
        """Look up (n,) variances, m^2, of pokes by their (n,) numbers of answers."""
        return np.where(answers <= self.edge_answers, self.edge, self.common)


def learn_scatter(misses: PokeMisses) -> Scatter:
    """Learn the variances that contact points have beyond the scene's noise.

    0 if the scene's noise is enough. 0 as well if more than `MAX_LEARNED_OVER_SCENE_NOISE` is needed: an error and not scatter.
    """
    windows = _windows(misses)
    if len(windows) < MIN_POKE_WINDOWS_TO_LEARN_NOISE:
        return Scatter()
    own = misses.select(windows.ravel())
    edge_answers = int(EDGE_POKE_MAX_ANSWERS_OVER_MEDIAN * np.median(own.answers))
    at_edge = own.answers <= edge_answers
    if np.count_nonzero(at_edge) < MIN_EDGE_POKES_FOR_SCATTER:
        at_edge, edge_answers = np.zeros_like(at_edge), 0
    common = _bisect(lambda scatter: _median(own, windows.shape, Scatter(scatter), ~at_edge), own, MAX_LEARNED_OVER_SCENE_NOISE)
    if not edge_answers:
        return Scatter(common)
    edge = _bisect(
        lambda scatter: _median(own, windows.shape, Scatter(common, scatter, edge_answers), at_edge),
        own,
        MAX_EDGE_OVER_SCENE_NOISE,
    )
    return Scatter(common, max(common, edge), edge_answers)


def _bisect(median: Callable[[float], float], misses: PokeMisses, max_factor: float) -> float:
    """Find the scatter at which the median of the squared misses is that of two degrees of freedom; 0 if there is none."""
    low, high = 0.0, (max_factor**2 - 1.0) * float(np.median(misses.variances))
    if median(low) <= CHI2_2DOF_MEDIAN or median(high) > CHI2_2DOF_MEDIAN:
        return 0.0
    for _ in range(BISECTION_STEPS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if median(middle) > CHI2_2DOF_MEDIAN else (low, middle)
    return high


def _median(misses: PokeMisses, shape: tuple[int, ...], scatter: Scatter, counted: NDArray[np.bool_]) -> float:
    """Compute the median of the squared misses that no rigid motion of a window explains, of the pokes that are counted."""
    motions = np.concatenate([misses.pairs, np.cross(misses.levers[:, None], misses.pairs) / SENSOR_TO_SKIN_LEVER_M], axis=2)
    total = misses.covariances + scatter.variances(misses.answers)[:, None, None] * np.eye(2)
    whiten = np.linalg.inv(np.linalg.cholesky(total))
    slopes = (whiten @ motions).reshape(shape[0], -1, 6)
    sides = (whiten @ misses.misses[:, :, None]).reshape(shape[0], -1, 1)
    held = slopes.transpose(0, 2, 1) @ slopes
    taken = slopes @ np.linalg.solve(held + MOTION_PRIOR_INFORMATION_PER_M2 * np.eye(6), slopes.transpose(0, 2, 1))
    # Of each miss the motion takes its leverage.
    left = 1.0 - np.diagonal(taken, axis1=1, axis2=2)
    rest = (sides - taken @ sides)[:, :, 0] / np.sqrt(np.maximum(left, 0.05))
    return float(np.median(np.sum(rest.reshape(-1, 2) ** 2, axis=1)[counted]))


def _windows(misses: PokeMisses) -> IntArray:
    """Find (w, POKES_PER_WINDOW) rows of pokes that follow each other in one arm pose; the rest of a pose is dropped."""
    order = misses.pokes.argsort(kind="stable")
    found = [np.empty((0, POKES_PER_WINDOW), dtype=np.int64)]
    for pose in np.unique(misses.poses):
        rows = order[misses.poses[order] == pose]
        found.append(rows[: len(rows) // POKES_PER_WINDOW * POKES_PER_WINDOW].reshape(-1, POKES_PER_WINDOW))
    return np.concatenate(found)
