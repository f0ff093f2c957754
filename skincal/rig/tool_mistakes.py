"""Mistakes of a rig whose tool carries the sensor, and the pokes if each is put right.

The same numbers are read in the other forms of as many values, as inverse poses, and in a base that is turned by half a turn:
`base` and `base_link` of Universal Robots differ by that. A wrench may have the axes of the base in place of the sensor's.

A wrong pose of the part moves every force axis by one motion in the link. A correction of the sensor moves it in the sensor's
frame, and would take that error for one of the sensor if the tool hardly turns (`find_part_motion`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from skincal.geometry import FloatArray, cross_matrix, inverse_pose, rotations
from skincal.model.pose_form import PoseForm, RotationForm, forms_of_width
from skincal.model.tool_pose import convert_poses, write_poses
from skincal.model.tool_rig import ToolSpec
from skincal.pokes import LandmarkPokes, Pokes
from skincal.rig.correction import rigid_motion
from skincal.rig.scene_mistakes import Mistake, MistakeKind

PART_MOTION_MIN_POKES = 5
"""Landmark pokes: six unknowns, and two equations of each."""
PART_MOTION_MAX_P = 1e-4
"""Significance level of the F test of the sums of squares with and without the motion."""
PART_MOTION_MIN_GAIN_M = 0.001
"""m. The motion must lower the rms miss by as much."""
PART_TURN_SD, PART_SHIFT_SD_M = 0.5, 0.5
"""rad and m, each axis: weak priors, so that landmarks on a line leave a turn at zero."""
PUSH_SD_M = 0.003
"""m. Weight of a poke against the priors."""
GAUSS_NEWTON_STEPS = 8


class PartMotion(NamedTuple):
    """Motion of the part that brings landmark pokes to their landmarks."""

    motion: FloatArray
    """(4, 4) float, metres, link frame: to where the part is in truth."""
    miss: float
    """m, rms of the misses that it leaves, as six unknowns fewer would leave them."""


def find_part_motion(pokes: LandmarkPokes) -> PartMotion | None:
    """Find the error of the part's pose that landmark pokes show; `None` if they show none.

    A small motion of the force axes, x' = x + w x x + t, is fitted to the misses across each push, in steps.
    """
    from scipy.special import fdtrc  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType] - slow to import

    left = 2 * len(pokes) - 6
    if len(pokes) < PART_MOTION_MIN_POKES:
        return None
    motion, prior = np.eye(4), PUSH_SD_M / np.repeat([PART_TURN_SD, PART_SHIFT_SD_M], 3)
    points, pushes = pokes.axis_point, pokes.direction

    def misses() -> tuple[FloatArray, FloatArray]:
        push = pushes @ motion[:3, :3].T
        across = np.eye(3) - push[:, :, None] * push[:, None, :]
        off = points @ motion[:3, :3].T + motion[:3, 3] - pokes.place
        return across, (across @ off[:, :, None])[:, :, 0]

    before = float(np.sum(misses()[1] ** 2))
    for _ in range(GAUSS_NEWTON_STEPS):
        across, off = misses()
        # The miss changes as that of a line through the landmark: by t + w x place across the push.
        rows = np.concatenate([across @ -cross_matrix(pokes.place), across], axis=2).reshape(-1, 6)
        wanted = -rows.T @ off.ravel()
        step = np.asarray(np.linalg.solve(rows.T @ rows + np.diag(prior**2), wanted), dtype=np.float64)
        motion = rigid_motion(step[:3], step[3:]) @ motion
    after = float(np.sum(misses()[1] ** 2))
    count = len(pokes)
    miss = float(np.sqrt(2.0 * after / left))
    if np.sqrt(before / count) - miss < PART_MOTION_MIN_GAIN_M:
        return None
    ratio = (before - after) / 6.0 / max(after / left, 1e-12)
    return PartMotion(inverse_pose(motion), miss) if float(fdtrc(6, left, ratio)) < PART_MOTION_MAX_P else None


def tool_mistakes(pokes: Pokes, tool: ToolSpec) -> Iterator[tuple[Mistake, dict[str, FloatArray]]]:
    """Yield each mistake of the tool's poses, and the arrays of n pokes that change if it is put right."""
    into_base, into_tool = inverse_pose(tool.link_from_base), inverse_pose(tool.tool_from_sensor)
    poses = np.array([into_base @ each @ into_tool for each in pokes.link_from_sensor])

    def placed(right: FloatArray) -> dict[str, FloatArray]:
        return {"link_from_sensor": tool.link_from_base @ right @ tool.tool_from_sensor}

    yield Mistake(MistakeKind.TOOL_INVERSE), placed(np.array([inverse_pose(each) for each in poses]))
    half_turn = np.eye(4)
    half_turn[:3, :3] = rotations(np.array([[0.0, 0.0, np.pi]]))[0]
    yield Mistake(MistakeKind.TOOL_BASE), placed(half_turn @ poses)
    back = (poses[:, :3, :3] @ tool.tool_from_sensor[:3, :3]).transpose(0, 2, 1)
    of_base = {
        name: (back @ wrench[:, :, None])[:, :, 0] for name, wrench in (("force", pokes.force), ("moment", pokes.moment))
    }
    yield Mistake(MistakeKind.TOOL_WRENCH), of_base
    form = tool.form or PoseForm(RotationForm.QUATERNION_XYZW)
    numbers = write_poses(poses, form)
    for other in forms_of_width(form.rotation.width):
        if other != form:
            right, faults = convert_poses(numbers, other, 1.0)
            if not any(faults):
                yield Mistake(MistakeKind.TOOL_FORM, form=other), placed(right)
