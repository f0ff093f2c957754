"""Sentences on the tip of a tool and the part's pose in a session: commands, report and files say the same."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skincal.model.scene import Scene
    from skincal.session.snapshot import Snapshot


def session_tool_sentences(snapshot: Snapshot, scene: Scene) -> tuple[str, ...]:
    """Describe the tip of a tool and the part's pose in the base of its poses; empty for other rigs."""
    if scene.tool is None:
        return ()
    from skincal.words.part_words import tool_rig_sentences

    return tool_rig_sentences(
        snapshot.tip_frame,
        snapshot.part_pose,
        snapshot.typed_pose_error,
        snapshot.at_landmarks,
        snapshot.off_mesh,
    )
