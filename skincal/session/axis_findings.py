"""Sentences on the axes of a session's taxels: mistakes of the scene, and what the readings say of taxels, pokes and mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skincal.axes.axis_checks import find_mesh_lean, find_shear_misses, find_unit_excess
from skincal.axes.taxel_frames import FrameState
from skincal.methods import leading_method
from skincal.model.skin_axes import ResponseRule
from skincal.words.axis_words import (
    axis_mistake_sentences,
    dead_axis_sentence,
    mesh_lean_sentence,
    shear_miss_sentence,
    unit_excess_sentence,
)

if TYPE_CHECKING:
    from skincal.model.scene import Scene
    from skincal.session.snapshot import Snapshot


def session_axis_sentences(snapshot: Snapshot, scene: Scene) -> tuple[str, ...]:
    """Name faults of the axes that a session shows; empty without one."""
    axes, results = scene.skin.axes, snapshot.axis_results(scene.skin.layout)
    if axes is None or results is None:
        return ()
    turns = results.turns.skin
    method = leading_method(snapshot.estimates) or next(iter(snapshot.estimates))
    findings = results.findings(method)
    sentences = [*axis_mistake_sentences(axes, findings)]
    if findings.is_value_order_wrong:
        # Its readings are those of other taxels.
        return tuple(sentences)
    if axes.unit == "N" and axes.rule is ResponseRule.PUSH and scene.has_sensor:
        sentences.append(unit_excess_sentence(find_unit_excess(snapshot.contacts)))
    sentences.append(dead_axis_sentence([*results.turns.dead_axes, *results.dead_z(method)]))
    sentences.append(shear_miss_sentence(find_shear_misses(turns)))
    shared = [channel for channel, frame in results.frames(method).items() if frame.state is FrameState.BY_MODULE]
    on_mesh = {
        each.channel: each.normal
        for each in snapshot.estimates[method]
        if each.normal is not None and each.triangle is not None
    }
    # A mistake of the axes turns z, too.
    if not findings.mistakes:
        sentences.append(mesh_lean_sentence(find_mesh_lean(turns, on_mesh, shared)))
    return tuple(sentence for sentence in sentences if sentence)
