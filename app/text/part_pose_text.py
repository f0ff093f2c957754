"""Texts on the tip of a tool and the part's pose: the note in the 3D view, the Rig tab, and the verdict."""

from __future__ import annotations

import numpy as np

from app.state.view_state import ViewState
from skincal.geometry import FloatArray
from skincal.session.tool_sentences import session_tool_sentences
from skincal.words.units import point_mm


def unplaced_note(state: ViewState, tip: FloatArray | None) -> str:
    """Describe the missing pose of the part and the tool's present place; empty once the pose is known.

    Parameters
    ----------
    tip : (3,) float, metres, sensor frame: the tip; `None` if it is unknown
    """
    snapshot, pose = state.snapshot, state.live.link_from_sensor
    if snapshot.is_placed or snapshot.part_pose is None:
        return ""
    from skincal.words.part_words import part_pose_sentence

    note = part_pose_sentence(snapshot.part_pose, snapshot.at_landmarks.get(snapshot.part_pose.worst_landmark, ""))
    lines = [note, "The positions of the taxels are drawn on the part as soon as its pose is known."]
    if pose is not None and np.isfinite(pose).all():
        what, at = ("sensor", pose[:3, 3]) if tip is None else ("tip", pose[:3] @ np.append(tip, 1.0))
        lines.append(f"The {what} of the tool is at ({point_mm(at)}) mm in the base now.")
    return "\n".join(lines)


def tool_state(state: ViewState) -> str:
    """Describe the tip of the tool, the part's pose in the base, and the delay of the poses, a line each."""
    of_rig = session_tool_sentences(state.snapshot, state.scene)
    return "\n".join(filter(None, (*of_rig, *(link.pose_delay for link in state.live.links))))
