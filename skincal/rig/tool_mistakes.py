"""Mistakes of the poses of a tool that carries the sensor, and the pokes if each is put right.

The same numbers are read in the other forms of as many values, as inverse poses, and in a base that is turned by half a turn:
`base` and `base_link` of Universal Robots differ by that. A wrench may have the axes of the base in place of the sensor's.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from skincal.geometry import FloatArray, inverse_pose, rotations
from skincal.model.tool_pose import PoseForm, RotationForm, convert_poses, forms_of_width, write_poses
from skincal.model.tool_rig import ToolSpec
from skincal.pokes import Pokes
from skincal.rig.scene_mistakes import Mistake, MistakeKind


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
