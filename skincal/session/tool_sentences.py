"""Sentences on the tip of a tool and the part's pose in a session: commands, report and files say the same."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skincal.contacts.pose_delays import PoseDelays
    from skincal.model.scene import Scene
    from skincal.session.snapshot import Snapshot


def session_tool_sentences(snapshot: Snapshot, scene: Scene, delays: PoseDelays | None = None) -> tuple[str, ...]:
    """Describe the tip of a tool, the part's pose in the base of its poses, and the `delays` of these; empty for other rigs."""
    if scene.tool is None:
        return ()
    from skincal.words.part_words import ADD_LANDMARK, driven_pose_sentence, tip_shift_sentence, tool_rig_sentences
    from skincal.words.tool_words import pose_delay_sentence

    of_rig = tool_rig_sentences(
        snapshot.tip_frame,
        snapshot.part_pose,
        snapshot.typed_pose_error,
        snapshot.at_landmarks,
        snapshot.off_mesh,
        snapshot.wrong_scale,
    )
    part = snapshot.part_pose
    if part is not None and part.open_motions and not snapshot.decisions.landmarks:
        of_rig = (*of_rig, ADD_LANDMARK)
    if snapshot.driven_to_landmarks:
        of_rig = (*of_rig, driven_pose_sentence(snapshot.driven_to_landmarks))
    of_tip = "" if part is None else tip_shift_sentence(part, scene.tool)
    of_rig = (*of_rig, of_tip) if of_tip else of_rig
    of_delay = pose_delay_sentence(delays)
    return (*of_rig, of_delay) if of_delay else of_rig
