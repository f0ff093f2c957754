"""Section of a report on taxels of three axes: which turns are known and how well, modules or taxels, and mistakes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from skincal.axes.turn_differences import compare_turns
from skincal.words.axis_words import FRAME_STATE_WORDS, odds_words, reading_words, shared_sentence, turn_summary
from skincal.words.turn_words import push_lean_sentence, turn_difference_words
from skincal.words.units import DASH, degrees

if TYPE_CHECKING:
    from skincal.axes.axis_results import AxisResults
    from skincal.axes.module_axes import ModuleTurn
    from skincal.axes.taxel_frames import TaxelFrame
    from skincal.model.skin_axes import SkinAxes
    from skincal.reporting.session_facts import SessionFacts

TURN_HEADINGS = ("Taxel", "Module", "Turn", "Pokes", "x", "y", "z", "Error of z", "in the plane")
MODULE_TURN_HEADINGS = ("Module", "Taxels", "Turn of its taxels", "Odds", "z scatters by", "Error of z", "in the plane")


def turn_words_of(facts: SessionFacts, found: AxisResults, axes: SkinAxes) -> tuple[str, ...]:
    """Make the sentences of the section."""
    findings, frames = found.findings(facts.method), found.frames(facts.method)
    summary = turn_summary([*frames.values()])
    sentences = [
        f"{summary[:1].upper()}{summary[1:]}.",
        f"A reading is the force on the taxel, z out of the skin: {reading_words(axes)}.",
        shared_sentence(findings),
        push_lean_sentence(found.turns.lean),
    ]
    if facts.truth is not None and facts.truth.axes:
        known = {channel: frame.rotation for channel, frame in frames.items() if frame.rotation is not None}
        sentences.append(turn_difference_words(compare_turns(known, facts.truth.axes), "taxel {}".format))
        if known:
            sentences[-1] = f"Against the truth: {sentences[-1]}"
    # Mistakes are under the evidence.
    return tuple(sentence for sentence in sentences if sentence)


def module_turn_rows(found: AxisResults) -> Iterator[tuple[str, ...]]:
    """Make a row of each module with pokes."""
    for module in found.turns.modules.values():
        fit = module.turn.fit
        about = degrees(fit.in_plane_sd, 1) if fit.is_in_plane_known else DASH
        odds = odds_words(module.log_odds_shared).removeprefix("odds ") if module.taxels > 1 else DASH
        scatter = degrees(module.spread, 1)
        yield str(module.id), str(module.taxels), _share_words(module), odds, scatter, degrees(fit.normal_sd, 1), about


def _share_words(module: ModuleTurn) -> str:
    if module.is_shared:
        return "shared"
    return "each its own" if module.is_separate else "open"


def turn_rows(facts: SessionFacts, found: AxisResults) -> Iterator[tuple[str, ...]]:
    """Make a row of each taxel: directions of its axes in the link, and their errors."""
    for channel, frame in found.frames(facts.method).items():
        module = found.turns.module_of.get(channel)
        name = DASH if module is None else str(module)
        axes = (DASH,) * 3 if frame.rotation is None else tuple(_direction(axis) for axis in frame.rotation.T)
        yield str(channel), name, _state_words(frame), str(frame.pokes), *axes, *_errors(frame)


def _direction(axis: np.ndarray) -> str:
    return ", ".join(f"{number + 0.0:.3f}" for number in axis.tolist())


def _state_words(frame: TaxelFrame) -> str:
    return frame.state.value if frame.is_known else f"{frame.state.value}: {FRAME_STATE_WORDS[frame.state]}"


def _errors(frame: TaxelFrame) -> tuple[str, str]:
    return degrees(frame.normal_sd, 1), degrees(frame.in_plane_sd, 1)
