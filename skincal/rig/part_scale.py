"""Scale of a part's drawing: whether landmarks or mesh are larger or smaller than the part that the tool touched.

A drawing of another scale moves all taxels alike: 3 % at 60 mm from the link's origin are 1.8 mm. The touches show it where
their misses grow with the distance from the middle. Four relative errors e of the drawn lengths are unknowns in addition to
those of the pose (`part_pose`): of the landmarks, and of the mesh along each axis of the link. With e the true place of a
drawn point y is y - e y, so a touch at a landmark l misses by B R' e l more, and one on the mesh by n.(e y) more. The scale of
the layout is eliminated with the unknowns of the pose: without a mesh it is laid flat, so touches do not measure it.

With the unknowns of the pose eliminated, the equations of the four are S e = g, with the trust of the pose's fit. Some
hypotheses h, each with one number e, are compared with a drawing of the right scale: e = h'g / h'S h, of variance 1 / h'S h.
A hypothesis has a small prior probability, and then e the sd `WRONG_SCALE_SD`. Its Bayes factor is
sqrt(v / (v + t^2)) exp(z^2/2 t^2/(v + t^2)), with v the variance of e, z^2 = e^2/v and t the prior's sd.

A mesh that is too large to all sides looks like one under thinner foam, so touches do not show it. Landmarks on
the mesh do: their rms distance from it beyond the usual one is an error of the height of all taxels that are bound to it.

The pose stays that of a right drawing. The second moment of its error is the mean over the hypotheses, so predicted errors
contain a scale that the touches leave open, and one that is likely but not named.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from skincal.geometry import FloatArray
from skincal.rig.part_touches import PartShape, PartTouches, PoseRows

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

WRONG_LANDMARKS_PROBABILITY, WRONG_MESH_PROBABILITY = 0.03, 0.01
"""Of a hypothesis with typed landmarks, and of one with the mesh alone, before the touches: a file is seldom wrong."""
WRONG_SCALE_SD = 0.03
"""sd of the relative error of a wrong scale: pages fitted to the paper (3 to 6 %), shrinkage, inches of 25 mm (1.6 %)."""
NAMED_MIN_PROBABILITY = 0.5
"""Of all hypotheses together, after the touches: then the likeliest is named."""
NAMED_MAX_RATIO = 2.5
"""Misses over expected ones that the scale may leave: beyond, another mistake explains them."""
NAMED_MIN_EXCESS = 0.008
"""A smaller relative error is not named: printed parts shrink by as much, and a robot's lengths err by 0.2 %."""
EQUAL_MAX_CHI2 = 4.0
"""Hypotheses that fit worse than the best by less are named with it."""
LANDMARK_OFF_MESH_SD_M = 0.0004
"""m, usual rms distance of landmarks from the mesh: a drawing's landmarks and a printed part err by 0.2 to 0.3 mm each."""
LANDMARK_ON_MESH_MAX_M = 0.003
"""m. Landmarks that are farther from the mesh are not on it: a screw in a hole."""
LANDMARKS_OFF_MESH_MIN_COUNT = 3
LAYOUT_SCALE_SD = 0.05
"""sd of the relative error of a layout's lengths, flat on a bent part included."""
UNKNOWNS_OF_POSE = 9
"""Turn, shift and tip."""
SCALE_COUNT = 4
"""Of landmarks, and of the mesh along x, y and z."""


class DrawnThing(Enum):
    """Part of a scene that may have another scale; its value has the entries of e that are equal, the others being zero."""

    LANDMARKS = (1.0, 0.0, 0.0, 0.0)
    DRAWING = (1.0, 1.0, 1.0, 1.0)
    """Landmarks and mesh together."""
    MESH = (0.0, 1.0, 1.0, 1.0)
    MESH_X = (0.0, 1.0, 0.0, 0.0)
    MESH_Y = (0.0, 0.0, 1.0, 0.0)
    MESH_Z = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class WrongScale:
    """A drawing that is larger or smaller than the touched part."""

    thing: DrawnThing
    excess: float
    """Relative error of the drawn lengths: 0.03 if they are 3 % too large."""
    sd: float
    landmarks: int
    """Number of touched landmarks..."""
    points: int
    """...and of touches on the mesh."""
    others: tuple[tuple[DrawnThing, float], ...] = ()
    """Other things that explain the touches as well, each with its excess."""


@dataclass(frozen=True, slots=True, eq=False)
class PartScales:
    """Relative errors of a drawing's lengths, as the touches show them."""

    moment: FloatArray
    """(13, 13) float: second moment of the errors of turn (rad), shift and tip (m), and of the four relative errors e."""
    wrong: WrongScale | None
    """`None` if the drawing may have the right scale."""
    landmarks_off_mesh: float = 0.0
    """m, rms distance of the touched landmarks from the mesh beyond the usual one; negative if most are inside it."""


NO_SCALES = PartScales(np.eye(UNKNOWNS_OF_POSE + SCALE_COUNT), None)


@dataclass(frozen=True, slots=True, eq=False)
class ScaleRows:
    """Whitened derivatives of the equations of a pose by the relative errors of the layout, then by the four."""

    of_targets: FloatArray
    """(k, 3, 5) float: the first is by the error of the layout."""
    of_mesh: FloatArray
    """(m, 5) float."""


def scale_rows(touches: PartTouches, shape: PartShape, turn: FloatArray, shift: FloatArray, rows: PoseRows) -> ScaleRows:
    """Compute the derivatives at a pose (3, 3) and (3,), metres, whose equations are `rows`."""
    landmarks, planned = touches.landmark[touches.at_landmark], touches.planned[touches.on_plan]
    of_targets = np.zeros((rows.of_targets.shape[1], 3, 1 + SCALE_COUNT))
    # The derivative by the shift is that by the target's place, but for its sign.
    by_place = rows.target_slopes[0, :, :, 3:]
    of_targets[: len(landmarks), :, 1] = (by_place[: len(landmarks)] @ landmarks[:, :, None])[:, :, 0]
    of_targets[len(landmarks) :, :, 0] = (by_place[len(landmarks) :] @ planned[:, :, None])[:, :, 0]
    of_mesh = np.zeros((rows.of_mesh.shape[1], 1 + SCALE_COUNT))
    if shape.surface is not None and len(of_mesh):
        from skincal.mesh.search import nearest_pushed_points  # a part without a mesh does without

        points = touches.points
        near, triangles = nearest_pushed_points(shape.surface, points.place @ turn.T + shift, points.push @ turn.T)
        of_mesh[:, 2:] = -rows.height_slopes[0][:, None] * shape.surface.normals[triangles] * near
    return ScaleRows(of_targets, of_mesh)


def find_landmarks_off_mesh(landmarks: FloatArray, surface: Surface) -> float:
    """Measure the rms distance of landmarks (n, 3) from a mesh beyond the usual one, metres; negative if most are inside."""
    from skincal.mesh.search import nearest_points  # a part without a mesh does without

    near, triangles = nearest_points(surface, landmarks)
    every = np.sum(surface.normals[triangles] * (landmarks - near), axis=1)
    heights: FloatArray = every[np.abs(every) < LANDMARK_ON_MESH_MAX_M]
    if len(heights) < LANDMARKS_OFF_MESH_MIN_COUNT:
        return 0.0
    square = float(np.mean(heights**2)) - LANDMARK_OFF_MESH_SD_M**2
    return math.copysign(math.sqrt(max(square, 0.0)), float(heights.sum()))


def find_scales(normal: FloatArray, gradient: FloatArray, misfit: tuple[float, int], counts: tuple[int, int]) -> PartScales:
    """Find the relative errors of the drawn lengths at the best pose.

    Parameters
    ----------
    normal : (u + 5, u + 5) float: normal equations: turn, shift, tip and other unknowns with priors, then the errors of the
        lengths of layout, landmarks and mesh
    gradient : (u + 5,) float: zero but for the last five entries at the best pose
    misfit : chi-square of the pose's fit, and its degrees of freedom; beyond 1 their ratio enlarges variances
    counts : touched landmarks, and touches on the mesh
    """
    count = len(normal) - SCALE_COUNT
    normal = normal.copy()
    normal[count - 1, count - 1] += LAYOUT_SCALE_SD**-2.0
    inverse = np.asarray(np.linalg.inv(normal[:count, :count]), dtype=np.float64)
    across = normal[:count, count:]
    pulled = inverse @ across
    information = normal[count:, count:] - across.T @ pulled
    pull = gradient[count:] - pulled.T @ gradient[:count]
    total, freedom = misfit
    alone = np.zeros((UNKNOWNS_OF_POSE + SCALE_COUNT, UNKNOWNS_OF_POSE + SCALE_COUNT))
    alone[:UNKNOWNS_OF_POSE, :UNKNOWNS_OF_POSE] = inverse[:UNKNOWNS_OF_POSE, :UNKNOWNS_OF_POSE] * max(
        1.0, total / max(freedom, 1)
    )
    found: list[tuple[float, DrawnThing, float, float, float]] = []
    moment, odds = alone.copy(), 1.0
    for thing in DrawnThing:
        entries: FloatArray = np.array(thing.value)
        if (entries[0] and not counts[0]) or (entries[1:].any() and not counts[1]):
            continue
        size = max(float(entries @ information @ entries), 1.0)
        excess = -float(entries @ pull) / size
        noise = max(1.0, (total - size * excess**2) / max(freedom, 1))
        variance = noise / size
        share = WRONG_SCALE_SD**2 / (variance + WRONG_SCALE_SD**2)
        chi2 = excess**2 / variance
        prior = WRONG_LANDMARKS_PROBABILITY if entries[0] else WRONG_MESH_PROBABILITY
        own_odds = prior * float(np.sqrt(1.0 - share) * np.exp(min(0.5 * chi2 * share, 300.0)))
        # The error of all unknowns by one of the scale.
        way = np.concatenate([-pulled[:UNKNOWNS_OF_POSE] @ entries, entries])
        square = variance * share + (excess * share) ** 2
        moment += own_odds * (alone + square * way[:, None] * way)
        odds += own_odds
        if variance < WRONG_SCALE_SD**2:  # otherwise the touches say less than the prior
            found.append((chi2, thing, excess, float(np.sqrt(variance)), noise))
    moment /= odds
    if not found or 1.0 - 1.0 / odds < NAMED_MIN_PROBABILITY:
        return PartScales(moment, None)
    best, thing, excess, sd, noise = max(found, key=lambda each: each[0])
    if abs(excess) < NAMED_MIN_EXCESS or noise > NAMED_MAX_RATIO**2:
        return PartScales(moment, None)
    others = tuple((other, own) for chi2, other, own, _, _ in found if other is not thing and best - chi2 < EQUAL_MAX_CHI2)
    return PartScales(moment, WrongScale(thing, excess, sd, *counts, others))
