"""The fixed-point test: the tip of a tool, from its poses while it touches one point from several sides.

Pose k has rotation R_k and position p_k in the fixed frame. Unknown are the tip t in the tool's frame and the point c in the
fixed frame:

    R_k t - c = -p_k + noise,   noise of sigma^2 I.

This is linear in (t, c): least squares, with sigma estimated from the residuals. A wrong form of the rotation, or other axes of
the position, break the equations: then no tip fits. So the readings of the same numbers that are common mistakes are fitted as
well, and compared (`find_readings`).

The inverse poses fit as well, with t and c exchanged: R_k' c - t = R_k' p_k. A wrong unit of length stretches both. A mirrored
frame of all poses mirrors both. A known tip, or its size, shows these mistakes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.pose_form import PoseForm, forms_of_width
from skincal.model.tool_pose import read_poses

MIN_TOUCHES = 4
"""Two directions of turn, and as many equations left to judge the fit."""
TOUCH_SD_MIN_M = 0.0001
"""m. No hand and no robot touches a point better."""
TOUCH_SD_MAX_M = 0.001
"""m. Above it the touches do not agree on a point: a robot and a steady hand reach a third of it."""
TIP_SD_MAX_M = 0.001
"""m. Above it the tip's position is open in a direction."""
OTHER_READING_MAX_P = 1e-4
"""Significance level of the F test of two sums of squares: a low one, since there are up to 50 readings."""

KNOWN_TIP_SD_M = 0.001
"""m. Error of a tip that was measured or taken from a drawing, each direction."""
TIP_MAX_CHI2 = 16.27
"""99.9 % point of chi-square with 3 degrees of freedom."""


class Mistake(Enum):
    """Common mistake of a reader of poses, beside the form of the rotation."""

    NONE = "none"
    ROTATION_INVERSE = "inverse rotation"
    POSITION_Y_UP = "position with y up"
    POSITION_Z_UP = "position with z up"
    POSITION_YZ_EXCHANGED = "position with y and z exchanged"


_POSITION_TURNS = {
    Mistake.POSITION_Y_UP: ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    Mistake.POSITION_Z_UP: ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    Mistake.POSITION_YZ_EXCHANGED: ((1, 0, 0), (0, 0, 1), (0, 1, 0)),
}
"""What takes a position as written to the axes of the rotation."""


def undo_mistake(poses: FloatArray, mistake: Mistake) -> FloatArray:
    """Undo a mistake of poses (n, 4, 4), metres."""
    corrected = poses.copy()
    if mistake is Mistake.ROTATION_INVERSE:
        corrected[:, :3, :3] = poses[:, :3, :3].transpose(0, 2, 1)
    if mistake in _POSITION_TURNS:
        corrected[:, :3, 3] = poses[:, :3, 3] @ np.array(_POSITION_TURNS[mistake], dtype=np.float64).T
    return corrected


@dataclass(frozen=True, slots=True, eq=False)
class PivotFit:
    """Tip and touched point that fit the poses best."""

    tip: FloatArray
    """(3,) float, metres, tool frame: t."""
    point: FloatArray
    """(3,) float, metres, fixed frame: c."""
    covariance: FloatArray
    """(3, 3) float, m^2, tool frame: of the tip."""
    misses: FloatArray
    """(n,) float, metres: distance of the tip from the point at each touch."""
    touch_sd: float
    """m, of one touch, each direction: sigma, at least `TOUCH_SD_MIN_M`."""

    @property
    def open_direction(self) -> FloatArray:
        """(3,) float, unit, tool frame: direction of the tip's largest error."""
        return np.linalg.eigh(self.covariance)[1][:, 2]

    @property
    def tip_sd(self) -> float:
        """m, of the tip along `open_direction`."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[2]))

    @property
    def agrees(self) -> bool:
        """Whether the touches agree on one point."""
        return self.touch_sd <= TOUCH_SD_MAX_M


def fit_pivot(poses: FloatArray) -> PivotFit:
    """Fit tip and point to poses (n, 4, 4), metres, of `MIN_TOUCHES` or more touches of one point."""
    count = len(poses)
    rows = np.concatenate([poses[:, :3, :3], np.broadcast_to(-np.eye(3), (count, 3, 3))], axis=2).reshape(-1, 6)
    # About their mean: a point far from the fixed frame's origin costs no digits.
    centre = poses[:, :3, 3].mean(axis=0)
    wanted = -(poses[:, :3, 3] - centre).ravel()
    # An open direction, such as of touches without turns, takes the smallest tip; its covariance says so.
    left, sizes, right = np.linalg.svd(rows, full_matrices=False)
    sizes = np.maximum(sizes, 1e-6)
    found = right.T @ ((left.T @ wanted) / sizes)
    misses = (rows @ found - wanted).reshape(-1, 3)
    touch_sd = max(float(np.sqrt(np.sum(misses**2) / (3 * count - 6))), TOUCH_SD_MIN_M)
    covariance = touch_sd**2 * (right.T / sizes**2) @ right
    return PivotFit(found[:3], found[3:] + centre, covariance[:3, :3], np.linalg.norm(misses, axis=1), touch_sd)


@dataclass(frozen=True, slots=True, eq=False)
class PoseReading:
    """One reading of the numbers of poses, with its fit."""

    form: PoseForm
    mistake: Mistake
    fit: PivotFit


def find_readings(values: FloatArray, metres_per_unit: float, where: Sequence[str]) -> list[PoseReading]:
    """Fit each reading of the numbers of touches of one point; the best first. Readings of the same poses are kept once.

    Parameters
    ----------
    values : (n, width) float, as written; n is `MIN_TOUCHES` or more
    metres_per_unit : of the lengths
    where : place of each pose, for the sentence of an error

    Raises
    ------
    InputError
        No reading makes poses of the numbers.
    """
    found: list[tuple[PoseReading, FloatArray]] = []
    refused: InputError | None = None
    for mistake in Mistake:
        for form in forms_of_width(values.shape[1]):
            try:
                poses = undo_mistake(read_poses(values, form, metres_per_unit, where), mistake)
            except InputError as error:
                refused = refused or error
                continue
            if not any(np.allclose(poses, other, rtol=0.0, atol=1e-9) for _, other in found):
                found.append((PoseReading(form, mistake, fit_pivot(poses)), poses))
    if not found:
        raise refused or InputError(f"{where[0]}: {values.shape[1]} values are no pose; expected 6, 7, 12 or 16.")
    return sorted((reading for reading, _ in found), key=lambda reading: reading.fit.touch_sd)


class PivotState(Enum):
    """What touches of one point say of the reading of their poses."""

    AGREES = "agrees"
    OTHER_READING = "another reading"
    """Another reading of the same numbers fits, and this one does not."""
    UNDECIDED = "undecided"
    """No form was given, and several readings fit."""
    SCATTERED = "scattered"
    """No reading fits: the point, the tool or the stream moved."""
    OPEN = "open"
    """The tool turned too little to determine the tip."""


@dataclass(frozen=True, slots=True, eq=False)
class PivotResult:
    """Result of the fixed-point test."""

    state: PivotState
    reading: PoseReading
    """As given; without that the best."""
    others: tuple[PoseReading, ...]
    """Other readings, the best first."""

    @property
    def similar_readings(self) -> tuple[PoseReading, ...]:
        """Other readings that fit about as well as the best."""
        best = min((self.reading, *self.others[:1]), key=lambda each: each.fit.touch_sd)
        return tuple(each for each in self.others if each.fit.agrees and not fits_better(best.fit, each.fit))


def judge_touches(values: FloatArray, metres_per_unit: float, where: Sequence[str], given: PoseForm | None) -> PivotResult:
    """Judge touches of one point by a tool; arguments and errors as for `find_readings`, `given` is the form if it is known."""
    readings = find_readings(values, metres_per_unit, where)
    if given is None:
        mine, others = readings[0], tuple(readings[1:])
    else:
        poses = read_poses(values, given, metres_per_unit, where)
        mine = PoseReading(given, Mistake.NONE, fit_pivot(poses))
        others = tuple(each for each in readings if not np.isclose(each.fit.touch_sd, mine.fit.touch_sd, rtol=1e-9, atol=0.0))
    result = PivotResult(PivotState.AGREES, mine, others)
    if given is not None and others and not mine.fit.agrees and others[0].fit.agrees and fits_better(others[0].fit, mine.fit):
        return replace(result, state=PivotState.OTHER_READING)
    if not mine.fit.agrees:
        return replace(result, state=PivotState.SCATTERED)
    if mine.fit.tip_sd > TIP_SD_MAX_M:
        return replace(result, state=PivotState.OPEN)
    return replace(result, state=PivotState.UNDECIDED) if given is None and result.similar_readings else result


class TipMismatch(Enum):
    """Likely reason why a known tip differs from the fitted one."""

    INVERSE = "inverse poses"
    UNIT = "unit"
    POSE_OF_TIP = "poses of the tip"
    POSE_OF_FLANGE = "poses of the flange"
    OTHER_TOOL = "another tool"


def compare_tip(fit: PivotFit, known: FloatArray) -> TipMismatch | None:
    """Compare the fitted tip with a `known` one, (3,) float, metres, tool frame; `None` if they agree within their errors."""

    def agree(one: FloatArray, other: FloatArray) -> bool:
        away = one - other
        error = fit.covariance + KNOWN_TIP_SD_M**2 * np.eye(3)
        return float(away @ np.linalg.solve(error, away)) < TIP_MAX_CHI2

    size, known_size = float(np.linalg.norm(fit.tip)), float(np.linalg.norm(known))
    if agree(fit.tip, known):
        return None
    if agree(fit.point, known):
        return TipMismatch.INVERSE
    if agree(fit.tip, np.zeros(3)):
        return TipMismatch.POSE_OF_TIP
    if any(agree(fit.tip, known * factor) for factor in (1e-3, 1e-2, 10.0, 1e3)):
        return TipMismatch.UNIT
    return TipMismatch.POSE_OF_FLANGE if known_size < KNOWN_TIP_SD_M < size else TipMismatch.OTHER_TOOL


def fits_better(one: PivotFit, other: PivotFit) -> bool:
    """Whether `one` fits the same touches better than `other` by more than chance."""
    from scipy.special import fdtrc  # pyright: ignore[reportMissingTypeStubs]

    freedom, ratio = 3 * len(one.misses) - 6, other.touch_sd / one.touch_sd
    return float(fdtrc(freedom, freedom, ratio * ratio)) < OTHER_READING_MAX_P
