"""Sentences on the skin of a session, without the pokes at landmarks, which no taxel answers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skincal.words.skin_words import skin_sentences

if TYPE_CHECKING:
    from skincal.contacts.skin_condition import SkinCondition
    from skincal.model.scene import Scene
    from skincal.session.snapshot import Snapshot


def session_skin_sentences(snapshot: Snapshot, condition: SkinCondition, scene: Scene) -> tuple[str, ...]:
    """Name the faults of the skin that a session shows; empty without one."""
    at_landmarks = snapshot.at_landmarks
    outcomes = [each.outcome for each in snapshot.pokes if not each.excluded and each.outcome.poke not in at_landmarks]
    return tuple(skin_sentences(condition, outcomes, scene, snapshot.decisions.thresholds))
