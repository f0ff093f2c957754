"""Sentences on the skin of a session, without the pokes at landmarks, which no taxel answers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skincal.contacts.outcome import Contact
from skincal.words.skin_words import skin_sentences

if TYPE_CHECKING:
    from skincal.contacts.pose_delays import PoseDelays
    from skincal.contacts.skin_condition import SkinCondition
    from skincal.model.scene import Scene
    from skincal.session.snapshot import Snapshot


def session_skin_sentences(
    snapshot: Snapshot, condition: SkinCondition, scene: Scene, delays: PoseDelays | None = None
) -> tuple[str, ...]:
    """Name the faults of the skin that a session shows, and of the poses of a tool; empty without one.

    Parameters
    ----------
    delays : of the tool's poses; `None` without a tool
    """
    at_landmarks = snapshot.at_landmarks
    outcomes = [each.outcome for each in snapshot.pokes if not each.excluded and each.outcome.poke not in at_landmarks]
    of_skin = tuple(skin_sentences(condition, outcomes, scene, snapshot.decisions.thresholds))
    if scene.skin.axes is not None:
        from skincal.session.axis_findings import session_axis_sentences

        of_skin += session_axis_sentences(snapshot, scene)
    if scene.tool is None:
        return of_skin
    from skincal.words.tool_words import pose_stream_faults, repeated_pose_sentence

    repeated = repeated_pose_sentence([each for each in outcomes if isinstance(each, Contact)])
    return (*of_skin, *((repeated,) if repeated else ()), *pose_stream_faults(delays))
