"""Mistakes of a tool's poses that touches of known places show, also while the part's pose in the base is unknown.

Touch k of the tip t lies at x_k = T_k t in the base, with the pose T_k of the tool. It should lie at a known place l_k of the
part: a landmark, or the plan of the taxel that answers most. Under the right reading of the poses one motion (R, s) carries all
touches there (Kabsch 1976), with

    chi2 = sum |R x_k + s - l_k|^2 / sd_k^2,   3 n - 6 degrees of freedom.

The same numbers are read in the other forms, as inverse poses, as poses of the tip, and with mirrored axes; with another tip;
and as those of a part that moved once. A reading is named if it fits as touches do, and the scene's reading does not by far.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from skincal.geometry import FloatArray, IntArray, fit_rotation, inverse_pose
from skincal.model.pose_form import PoseForm, RotationForm, forms_of_width
from skincal.model.tool_pose import convert_poses, write_poses
from skincal.rig.scene_mistakes import Mistake, MistakeKind

LANDMARK_TOUCH_SD_M, PLANNED_TOUCH_SD_M = 0.002, 0.005
"""m, each direction: of a tip at a landmark with its ball and the errors of a robot; at a taxel beside its plan."""
MIN_TOUCHES, MIN_TOUCHES_OF_PART = 8, 5
"""In all, and on each side of a motion of the part."""
RIGHT_MAX_RATIO = 1.25
"""Root of chi-square over its degrees of freedom of touches that fit, at most."""
WRONG_MIN_GAIN = 2.0
"""Ratio of the scene's reading over that of the named one, at least."""
MOVED_MIN_GAIN = 2.0
"""The same for a part that moved once, by touches of one kind."""
TIP_FIT_STEPS, CHOICE_STEPS = 20, 8
EULER_FORMS = (RotationForm.RPY, RotationForm.ABC, RotationForm.MOVING_XYZ, RotationForm.MOVING_ZYZ)
OTHER_TIP_MIN_M = 0.006
"""m from the scene's tip to one that is named."""
AXIS_PAIRS = {"y and z": (0, 2, 1), "x and y": (1, 0, 2), "x and z": (2, 1, 0)}


@dataclass(frozen=True, slots=True, eq=False)
class TouchedPlaces:
    """n touches of known places, in the order of their numbers."""

    number: IntArray
    """(n,) numbers of the pokes."""
    base_from_tool: FloatArray
    """(n, 4, 4) float, metres, as the scene reads the poses."""
    place: FloatArray
    """(n, 3) float, metres, link frame: landmark or planned taxel."""
    sd: FloatArray
    """(n,) float, m, each direction."""
    tip: FloatArray
    """(3,) float, metres, tool frame."""
    form: PoseForm
    """Form of the numbers of the poses."""


class TouchFinding(NamedTuple):
    """A mistake that touches show."""

    mistake: Mistake
    """With `miss` of the touches if it is put right."""
    miss: float
    """m, median distance of the touches from their places as the scene reads them."""


class _Fit(NamedTuple):
    ratio: float
    misses: FloatArray
    turn: FloatArray
    shift: FloatArray


def find_touch_mistake(touched: TouchedPlaces) -> TouchFinding | None:
    """Find the mistake that touches show; `None` if they fit, are too few, or no known mistake explains them."""
    if len(touched.number) < MIN_TOUCHES:
        return None
    described = _fit(touched, _tips(touched.base_from_tool, touched.tip))
    if described.ratio <= RIGHT_MAX_RATIO:
        return None
    found = [
        (fit.ratio, mistake, fit) for mistake, fit in _readings(touched)
        if fit.ratio <= min(RIGHT_MAX_RATIO, described.ratio / WRONG_MIN_GAIN)
    ]  # fmt: skip
    if not found:
        return _moved_in_one_kind(touched)
    _, mistake, fit = min(found, key=lambda each: each[0])
    return TouchFinding(replace(mistake, miss=float(np.median(fit.misses))), float(np.median(described.misses)))


def _moved_in_one_kind(touched: TouchedPlaces) -> TouchFinding | None:
    """Find a part that moved by touches of landmarks alone, or of taxels: a skin beside its plan is no part that moved."""
    for is_kind in (touched.sd == PLANNED_TOUCH_SD_M, touched.sd == LANDMARK_TOUCH_SD_M):
        own = _select(touched, np.flatnonzero(is_kind))
        if len(own.number) < 2 * MIN_TOUCHES_OF_PART:
            continue
        described, (mistake, fit) = _fit(own, _tips(own.base_from_tool, own.tip)), _moved_part(own)
        if described.ratio > RIGHT_MAX_RATIO and fit.ratio <= min(RIGHT_MAX_RATIO, described.ratio / MOVED_MIN_GAIN):
            return TouchFinding(replace(mistake, miss=float(np.median(fit.misses))), float(np.median(described.misses)))
    return None


def _tips(poses: FloatArray, tip: FloatArray) -> FloatArray:
    return poses[:, :3, :3] @ tip + poses[:, :3, 3]


def _fit(touched: TouchedPlaces, points: FloatArray, unknowns: int = 6) -> _Fit:
    """Fit the motion that carries points (n, 3) to their places."""
    weights = 1.0 / touched.sd**2
    share = weights / weights.sum()
    centre, goal = share @ points, share @ touched.place
    turn = fit_rotation((points - centre).T @ (share[:, None] * (touched.place - goal))).T
    shift = goal - turn @ centre
    off = np.linalg.norm(points @ turn.T + shift - touched.place, axis=1)
    freedom = max(3 * len(points) - unknowns, 1)
    return _Fit(float(np.sqrt(np.sum((off / touched.sd) ** 2) / freedom)), off, turn, shift)


def _readings(touched: TouchedPlaces) -> Iterator[tuple[Mistake, _Fit]]:
    """Yield each other reading of the poses with its fit."""
    poses, tip = touched.base_from_tool, touched.tip

    def fit(read: FloatArray, at: FloatArray = tip) -> _Fit:
        return _fit(touched, _tips(read, at))

    yield Mistake(MistakeKind.TOOL_INVERSE), fit(np.array([inverse_pose(each) for each in poses]))
    yield Mistake(MistakeKind.TOOL_POSE_OF_TIP), fit(poses, np.zeros(3))
    numbers = write_poses(poses, touched.form)
    for other in forms_of_width(touched.form.rotation.width):
        if other != touched.form and (read := _read_again(touched, numbers, other)) is not None:
            yield Mistake(MistakeKind.TOOL_FORM, form=other), fit(read)
    for (names, order), of_turn in product(AXIS_PAIRS.items(), (False, True)):
        mirror = np.eye(3)[list(order)]
        read = poses.copy()
        read[:, :3, 3] = poses[:, :3, 3] @ mirror.T
        if of_turn:
            read[:, :3, :3] = mirror @ poses[:, :3, :3] @ mirror
        yield Mistake(MistakeKind.TOOL_MIRRORED, names=(names,)), fit(read)
    other = _other_tip(touched)
    if float(np.linalg.norm(other - tip)) >= OTHER_TIP_MIN_M:
        shift = tuple(str(round(1e3 * value)) for value in (other - tip).tolist())
        yield Mistake(MistakeKind.TOOL_OTHER_TIP, names=shift), _fit(touched, _tips(poses, other), 9)


def _read_again(touched: TouchedPlaces, numbers: FloatArray, form: PoseForm) -> FloatArray | None:
    """Read the numbers of poses (n, 3 + k) in another form; `None` if one is no pose then.

    Numbers that were sent as another form may be angles beyond a quarter turn, which have a second triple for the same
    rotation: (a + pi, pi - b, c + pi). Of both the one that fits better is taken.
    """
    read, faults = convert_poses(numbers, form, 1.0)
    if any(faults) or not form.rotation.has_angles or touched.form.rotation not in EULER_FORMS:
        return None if any(faults) else read
    half = 180.0 if touched.form.degrees else np.pi
    other = numbers.copy()
    other[:, 3:] = np.array([1.0, 0.0 if touched.form.rotation is RotationForm.MOVING_ZYZ else 1.0, 1.0]) * half
    other[:, 3:] += numbers[:, 3:] * [1.0, -1.0, 1.0]
    other[:, 3:] -= 2.0 * half * np.round(other[:, 3:] / (2.0 * half))
    second, faults = convert_poses(other, form, 1.0)
    if any(faults):
        return read
    first = read
    for _ in range(CHOICE_STEPS):
        fit = _fit(touched, _tips(read, touched.tip))
        misses = [
            np.linalg.norm(_tips(each, touched.tip) @ fit.turn.T + fit.shift - touched.place, axis=1)
            for each in (first, second)
        ]
        read = np.where((misses[0] <= misses[1])[:, None, None], first, second)
    return read


def _other_tip(touched: TouchedPlaces) -> FloatArray:
    """Fit tip and motion in turns: for a motion (R, s), R (R_k t + p_k) + s = l_k is linear in the tip t."""
    tip, weights = touched.tip, 1.0 / touched.sd[:, None]
    turns, places = touched.base_from_tool[:, :3, :3], touched.base_from_tool[:, :3, 3]
    for _ in range(TIP_FIT_STEPS):
        fit = _fit(touched, _tips(touched.base_from_tool, tip))
        rows = (weights[:, :, None] * (fit.turn @ turns)).reshape(-1, 3)
        wanted = (weights * (touched.place - fit.shift - places @ fit.turn.T)).ravel()
        tip = np.asarray(np.linalg.lstsq(rows, wanted, rcond=1e-9)[0], dtype=np.float64)
    return tip


def _moved_part(touched: TouchedPlaces) -> tuple[Mistake, _Fit]:
    """Fit a part that moved once between two of 2 x `MIN_TOUCHES_OF_PART` or more touches."""
    points, count = _tips(touched.base_from_tool, touched.tip), len(touched.number)
    splits: list[tuple[float, Mistake, _Fit]] = []
    for first in range(MIN_TOUCHES_OF_PART, count - MIN_TOUCHES_OF_PART + 1):
        rows = np.arange(count)
        parts = [_fit(_select(touched, each), points[each]) for each in (rows[:first], rows[first:])]
        misses = np.concatenate([each.misses for each in parts])
        # Six unknowns each, and the place of the motion.
        ratio = float(np.sqrt(np.sum((misses / touched.sd) ** 2) / (3 * count - 13)))
        middle = points.mean(axis=0)
        by = 1e3 * np.linalg.norm((parts[1].turn - parts[0].turn) @ middle + parts[1].shift - parts[0].shift)
        number = int(touched.number[first])
        mistake = Mistake(MistakeKind.TOOL_PART_MOVED, names=(str(number), f"{by:.0f}", str(number - 1)))
        splits.append((ratio, mistake, _Fit(ratio, misses, parts[0].turn, parts[0].shift)))
    return min(splits, key=lambda each: each[0])[1:]


def _select(touched: TouchedPlaces, rows: IntArray) -> TouchedPlaces:
    return replace(
        touched, number=touched.number[rows], base_from_tool=touched.base_from_tool[rows], place=touched.place[rows],
        sd=touched.sd[rows],
    )  # fmt: skip
