"""Sentences on taxels of three axes: their turns, modules or taxels, and mistakes of the scene's axes with their remedies."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from skincal.axes.module_axes import AXIS_NAMES, AxisFindings, AxisMistake, AxisMistakeKind
from skincal.axes.skin_turns import CERTAIN_LOG_ODDS
from skincal.axes.taxel_frames import FrameState, TaxelFrame
from skincal.model.errors import list_channels
from skincal.words.units import count, degrees

if TYPE_CHECKING:
    from skincal.axes.axis_checks import DeadAxis, MeshLean, ShearMiss
    from skincal.model.skin_axes import SkinAxes

LARGEST_ODDS = 1e6
"""Larger odds are given as more than this."""
FRAME_STATE_WORDS: Mapping[FrameState, str] = {
    FrameState.KNOWN: "turn by its own pokes",
    FrameState.BY_MODULE: "turn that the taxels of its module share",
    FrameState.IN_PLANE_UNKNOWN: "no poke leaned enough: press leaning",
    FrameState.MIRRORED: "no rotation: x, y and z of the readings are mirrored axes",
    FrameState.WRONG_ORDER: "no rotation: the values of a frame have another order than the scene",
    FrameState.DEAD_AXIS: "no rotation: an axis of the taxel does not answer",
    FrameState.UNKNOWN: "turn unknown: no poke has a reading of it",
}


def odds_words(log_odds: float) -> str:
    """Format odds from their natural logarithm: `"odds 120 to 1"`."""
    odds = math.exp(min(abs(log_odds), 50.0))
    return "odds more than a million to 1" if odds > LARGEST_ODDS else f"odds {odds:.0f} to 1"


def frame_state_lines(frames: Iterable[TaxelFrame]) -> list[str]:
    """List the channels of each state, for a file's comments."""
    channels: dict[FrameState, list[int]] = {state: [] for state in FrameState}
    for frame in frames:
        channels[frame.state].append(frame.channel)
    return [
        f"turn {state.value.removeprefix('turn ')} ({FRAME_STATE_WORDS[state]}): channels "
        f"{list_channels(some, max_ranges=len(some))}"
        for state, some in channels.items()
        if some
    ]


def reading_words(axes: SkinAxes) -> str:
    """Describe how the three values of a taxel become a reading: x, y and z of the force on it, z out of the skin."""
    parts = [
        f"{name} = {'-' if sign < 0 else ''}value {place + 1}"
        for name, sign, place in zip(AXIS_NAMES, axes.signs, axes.places, strict=True)
    ]
    order = "together" if axes.order.is_by_taxel else "apart: first those of all taxels, then the second ones, then the third"
    return f"{', '.join(parts)} of the three values of a taxel, which are {order} in a frame"


def axes_lines(axes: SkinAxes, findings: AxisFindings, frames: Iterable[TaxelFrame]) -> list[str]:
    """List the facts on the axes for a file's comments, without full stops."""
    return [
        "axes of a taxel: those of its readings if the turn is known; otherwise z is its normal, and x and y have no meaning",
        f"a reading is the force on the taxel, z out of the skin, so a push has a negative z: {reading_words(axes)}",
        *(sentence.rstrip(".") for sentence in axis_sentences(axes, findings)),
        *frame_state_lines(frames),
    ]


def turn_summary(frames: Sequence[TaxelFrame]) -> str:
    """Summarize the turns: `"turns: 20 of 36 taxels known, expected error 0.6 deg of the normal, ..."`."""
    known = [frame for frame in frames if frame.is_known]
    words = f"turns: {len(known)} of {count(len(frames), 'taxel')} known"
    if known:
        normal, plane = (float(np.median([getattr(frame, name) for frame in known])) for name in ("normal_sd", "in_plane_sd"))
        words += f", expected error {degrees(normal, 1)} of the normal and {degrees(plane, 1)} in the plane (median sd)"
    rest = {state: sum(frame.state is state for frame in frames) for state in FrameState}
    open_ = [
        f"{rest[state]} {words_of}"
        for state, words_of in (
            (FrameState.IN_PLANE_UNKNOWN, "without a turn in the plane: press leaning"),
            (FrameState.MIRRORED, "with mirrored axes"),
            (FrameState.WRONG_ORDER, "with values in another order"),
            (FrameState.DEAD_AXIS, "with an axis that does not answer"),
            (FrameState.UNKNOWN, "without a reading"),
        )
        if rest[state]
    ]
    return "; ".join([words, *open_])


def shared_sentence(findings: AxisFindings) -> str:
    """Say whether taxels report in the axes of their module; empty if no module has two taxels with pokes."""
    judged = [module for module in findings.modules if module.taxels > 1]
    if not judged:
        return ""
    odds = odds_words(findings.log_odds_shared)
    shared = [module.id for module in judged if module.is_shared]
    separate = [module.id for module in judged if module.is_separate]
    if shared and separate:
        return (
            f"Taxels of modules {list_channels(shared)} report in the axes of their module, those of modules "
            f"{list_channels(separate)} each in its own."
        )
    if findings.log_odds_shared > CERTAIN_LOG_ODDS:
        return f"All taxels of a module report in the module's axes ({odds} against one turn for each taxel)."
    if findings.log_odds_shared < -CERTAIN_LOG_ODDS:
        return f"Each taxel reports in axes of its own ({odds} against one turn for each module)."
    return "It is open whether taxels report in the axes of their module or each in its own: press more, leaning."


def axis_sentences(axes: SkinAxes, findings: AxisFindings) -> tuple[str, ...]:
    """Name mistakes of the axes with their remedies, then say whether taxels share the axes of their module."""
    mistakes = axis_mistake_sentences(axes, findings)
    if findings.is_value_order_wrong:
        return mistakes
    shared = shared_sentence(findings)
    return (*mistakes, shared) if shared else mistakes


def axis_mistake_sentences(axes: SkinAxes, findings: AxisFindings) -> tuple[str, ...]:
    """Name mistakes of the axes with their remedies; empty without one."""
    return tuple(_mistake_sentence(axes, mistake) for mistake in findings.mistakes)


def _mistake_sentence(axes: SkinAxes, mistake: AxisMistake) -> str:
    odds = odds_words(mistake.log_odds)
    if mistake.kind is AxisMistakeKind.ORDER:
        other = axes.order.other.value
        return (
            f"The strongest value of a poke is no z: the values of a frame have the order {other}, not {axes.order.value} "
            f'({odds}). Write order = "{other}" in [skin] of the scene, and read the recording again.'
        )
    where = "" if mistake.module is None else f" of module {mistake.module}"
    what = _what_is_wrong(mistake)
    remedy = _remedy(axes, mistake)
    return f"The axes of the readings{where} do not fit the pokes: {what} ({odds}). {remedy}"


def _what_is_wrong(mistake: AxisMistake) -> str:
    match mistake.kind:
        case AxisMistakeKind.OPPOSITE:
            return f"{mistake.axes[0]} has the opposite sign"
        case AxisMistakeKind.EXCHANGED:
            return f"{mistake.axes[0]} and {mistake.axes[1]} are exchanged"
        case AxisMistakeKind.TURNED:
            return f"they are turned by {mistake.turn_deg:.0f} degrees about z, seen from outside counter-clockwise"
        case _:
            return f"x, y and z point along {', '.join(mistake.directions)} of the module"


def _remedy(axes: SkinAxes, mistake: AxisMistake) -> str:
    if mistake.module is not None and mistake.kind is AxisMistakeKind.TURNED:
        return (
            f"If module {mistake.module} is mounted so, add {mistake.turn_deg:.0f} to its angle_deg in the layout. Files have "
            "the turn as the readings show it."
        )
    if mistake.module is not None:
        return f"The other modules do not have it: look whether module {mistake.module} is of another kind, or exchanged."
    polarity, values = corrected_values(axes, mistake.directions)
    written = ", ".join(f'"{name}"' for name in values)
    advice = f'Write values = [{written}] and polarity = "{polarity}" in [skin] of the scene'
    if mistake.kind is AxisMistakeKind.TURNED:
        return f"{advice}, or change angle_deg of the modules in the layout if they are mounted so."
    return f"{advice}."


def corrected_values(axes: SkinAxes, directions: Sequence[str]) -> tuple[str, list[str]]:
    """Compute `polarity` and `values` of a scene whose x, y and z point along `directions` of the module now."""
    names = [""] * len(AXIS_NAMES)
    polarity = "up"
    for axis, direction in enumerate(directions):
        name, sign = direction.lstrip("-"), axes.signs[axis] * (-1 if direction.startswith("-") else 1)
        if name == "z":
            # Values of z that rise under a push are the opposite of the force.
            polarity = "up" if sign < 0 else "down"
        names[axes.places[axis]] = f"-{name}" if sign < 0 and name != "z" else name
    return polarity, names


MAX_LISTED_SHEAR_MISSES = 5


def dead_axis_sentence(found: Sequence[DeadAxis]) -> str:
    """Name axes of taxels that do not answer; empty without one."""
    if not found:
        return ""
    shear = [each for each in found if each.axis != "z"]
    stuck, weak = ([f"{each.axis} of taxel {each.channel}" for each in shear if each.is_stuck is way] for way in (True, False))
    parts = [
        f"z of taxel {each.channel} answers none of {each.pokes} pokes that its x and y answer"
        for each in found
        if each.axis == "z"
    ]
    if stuck:
        parts.append(f"{', '.join(stuck)} {'keeps' if len(stuck) == 1 else 'keep'} one value through all pokes")
    if weak:
        parts.append(f"{', '.join(weak)} {'answers' if len(weak) == 1 else 'answer'} much less than their pokes lean")
    return f"{' and '.join(parts)}: dead or stuck. Check the taxel and its wiring; it has no turn until then."


def shear_miss_sentence(found: Sequence[ShearMiss]) -> str:
    """Name pokes whose shear on the skin is not that of the wrench; empty without one."""
    if not found:
        return ""
    listed = ", ".join(f"{each.poke} ({degrees(each.angle)})" for each in found[:MAX_LISTED_SHEAR_MISSES])
    more = f" and {len(found) - MAX_LISTED_SHEAR_MISSES} more" if len(found) > MAX_LISTED_SHEAR_MISSES else ""
    word = "poke" if len(found) == 1 else "pokes"
    return (
        f"The skin feels another direction of the force than the force/torque sensor in {word} {listed}{more}: the tip "
        "slipped, something else was touched, or the tare is wrong. These pokes do not count for turns; exclude them if their "
        "positions are off, too."
    )


def unit_excess_sentence(excess: float) -> str:
    """Name readings that are no newtons; empty if `excess`, their sum over the force, is 0."""
    if not excess:
        return ""
    return (
        f"The taxels of a poke push together {excess:.3g} times its force (median), so their values are no newtons. Write "
        'unit = "raw" in [skin] of the scene, or check the scale that the device is set to. Positions and turns do not need it.'
    )


def mesh_lean_sentence(found: MeshLean | None) -> str:
    """Name taxels whose z is not along the normal of the mesh; empty without one."""
    if found is None:
        return ""
    return (
        f"z of {len(found.channels)} of {count(found.judged, 'taxel')} leans {degrees(found.angle)} (median) from the normal "
        f"of the mesh: channels {list_channels(found.channels)}. They report in other axes than across the skin, or mesh or "
        "position is wrong there."
    )


def axes_doubt_words(findings: AxisFindings) -> str:
    """Name mistakes of the axes in a clause for the verdict; empty without one."""
    if not findings.mistakes:
        return ""
    if findings.is_value_order_wrong:
        return "the values of a frame have another order than the scene"
    return "the axes of the readings do not fit the scene"
