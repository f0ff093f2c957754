"""Mistakes of a tool's poses and of its tip that touches of a part show while no pose of the part fits them.

The same numbers are read as each usual mistake would have them, and the part's pose is fitted again. A mistake is named if the
touches then miss by about the expected error, and by far less than before. A base that is turned or moved as a whole is no
mistake here: the part's pose contains it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from skincal.geometry import FloatArray, inverse_pose
from skincal.model.tool_rig import ToolSpec
from skincal.pokes import Pokes
from skincal.rig import pivot
from skincal.rig.part_pose import PartPose, PartPoseState
from skincal.rig.scene_mistakes import Mistake, MistakeKind
from skincal.rig.tool_mistakes import tool_mistakes

EXPLAINED_MAX_RATIO = 2.5
"""Misses over expected ones that a mistake may leave."""
EXPLAINED_MAX_SHARE = 0.4
"""The same as a share of those without it."""
MIN_FREEDOM = 4
"""Equations beyond the unknowns: fewer fit anything."""
FREE_TIP_SD_M = 0.3
"""m, sd of a tip that may be anywhere on a tool."""
TIP_MISTAKE_MIN_M = 0.005
"""m. A tip that is off by less is an error, and found with the part's pose."""
MIRRORS = tuple(np.diag(signs) for signs in ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0)))


def explain_misfit(
    pokes: Pokes, tool: ToolSpec, found: PartPose, fit: Callable[[Pokes, FloatArray | None], PartPose]
) -> Mistake | None:
    """Find the mistake that explains touches which no pose of the part fits; `None` if there is none.

    Parameters
    ----------
    pokes : in the base, as reported
    found : the best pose
    fit : fits the pose to other pokes, with the error of the tip (3, 3), m^2, or the scene's with `None`
    """
    best, least = None, min(EXPLAINED_MAX_RATIO, EXPLAINED_MAX_SHARE * found.ratio)
    for mistake, arrays, tip_error in _hypotheses(pokes, tool):
        other = fit(replace(pokes, **arrays), tip_error)
        if other.state in (PartPoseState.FEW_TOUCHES, PartPoseState.DISAGREES) or other.freedom < MIN_FREEDOM:
            continue
        if tip_error is not None:
            if float(np.linalg.norm(other.tip_shift)) < TIP_MISTAKE_MIN_M or other.freedom < MIN_FREEDOM + 3:
                continue
            mistake = replace(mistake, shift=other.tip_shift)
        if other.ratio < least:
            best, least = mistake, other.ratio
    return best


def _hypotheses(pokes: Pokes, tool: ToolSpec) -> Iterator[tuple[Mistake, dict[str, FloatArray], FloatArray | None]]:
    """Yield mistakes, the arrays of the pokes that change if each is put right, and the error of the tip if it is free."""
    if tool.tip is not None:
        yield Mistake(MistakeKind.TOOL_TIP), {}, FREE_TIP_SD_M**2 * np.eye(3)
    for mistake, arrays in tool_mistakes(pokes, tool):
        if mistake.kind is not MistakeKind.TOOL_BASE and (tool.has_sensor or mistake.kind is not MistakeKind.TOOL_WRENCH):
            yield mistake, arrays, None
    poses = pokes.link_from_sensor @ inverse_pose(tool.tool_from_sensor)
    for right in _other_axes(poses):
        yield Mistake(MistakeKind.TOOL_AXES), {"link_from_sensor": right @ tool.tool_from_sensor}, None


def _other_axes(poses: FloatArray) -> Iterator[FloatArray]:
    """Yield poses (n, 4, 4) with other axes: of the positions alone, and mirrored ones of positions and rotations."""
    for mistake in (pivot.Mistake.POSITION_Y_UP, pivot.Mistake.POSITION_Z_UP, pivot.Mistake.POSITION_YZ_EXCHANGED):
        yield pivot.undo_mistake(poses, mistake)
    for mirror in MIRRORS:
        right = poses.copy()
        right[:, :3, :3], right[:, :3, 3] = mirror @ poses[:, :3, :3] @ mirror, poses[:, :3, 3] @ mirror
        yield right
    mirrored = poses.copy()
    mirrored[:, :3, 3] = poses[:, :3, 3] @ MIRRORS[2]
    yield mirrored
