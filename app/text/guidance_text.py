"""Sentences on the requested poke and on how to press better."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import compress
from operator import not_

import numpy as np

from app.state.press_coach import (
    OTHER_TAXEL_MIN_DISTANCE_M,
    UPRIGHT_MAX_TILT,
    CoachMemory,
    ForceLevel,
    HintKind,
    LeanDirection,
    PressHint,
    is_on_other_taxel,
    lean_of,
)
from app.state.view_state import ViewState
from skincal.guide.guidance import Guidance, GuidePhase, LandmarkTarget, Target
from skincal.guide.press_coaching import PokeError
from skincal.guide.progress import AxisDiversity, GuideSettings, Need
from skincal.rig.expected_gain import Gain
from skincal.taxels.result import Method
from skincal.taxels.shared_errors import max_known_error
from skincal.words.units import ChannelNames, cell, count, degrees, duration, millimetres, newtons
from skincal.words.verdict_words import needs_clause

MAX_NAMED_FINISHED_TAXELS = 3  # Finished taxels named after one poke
DOT_SEPARATOR = "  \N{MIDDLE DOT}  "
REDUCED_ERROR_WORDS: Mapping[Method, str] = {Method.FREE: "depth", Method.SURFACE: "position", Method.MODULES: "position"}
"""Name of the error that a poke should reduce: for the free method the depth, for the others the position along the skin."""
GUIDE_SENTENCE_OF_METHOD: Mapping[Method, str] = {
    Method.FREE: "The guide asks what the free method needs: pokes with the tool leaning to all sides.",
    Method.SURFACE: "The guide asks what the surface method needs: pokes evenly around each taxel, tool upright.",
    Method.MODULES: "The guide asks what the modules method needs: a few pokes on each module, far apart; on a sheet, many.",
}
"""Each method needs other pokes."""


def target_words(guidance: Guidance, target: Target, names: ChannelNames) -> str:
    """Ask for a poke: `"Press taxel 204, lean 28° toward 205"`."""
    if target.landmark:
        return f'Press the landmark "{target.landmark}"'
    if target.channel is None:
        return "Press inside the ring, tool upright"
    press = f"Press {names.taxel(target.channel)}"
    if target.tilt < UPRIGHT_MAX_TILT:
        return f"{press}, tool upright"
    lean = lean_of(guidance, target)
    side = "" if lean is None else f" {lean_words(lean, names)}"
    return f"{press}, lean {degrees(target.tilt)}{side}"


def landmark_words(landmark: LandmarkTarget, *, has_tool: bool = False) -> str:
    """Count the landmark pokes of this arm pose; with a tool whose poses are streamed the part has only one."""
    which = f"Landmark poke {landmark.done + 1} of {landmark.wanted}"
    return f"{which}: landmarks show where the part is in the base" if has_tool else f"{which} in this arm pose"


def gain_words(gain: Gain | None) -> str:
    """Predict the error of the rig after more landmark pokes; empty if unknown."""
    if gain is None:
        return ""
    now, after = cell(gain.now, "m"), millimetres(gain.after)
    return f"after {count(gain.pokes, 'poke')} the error of the rig should fall from {now} to {after}"


def why_words(
    guidance: Guidance, target: Target, dead: Collection[int], part_size: float = math.inf, *, has_tool: bool = False
) -> str:
    """Give the purpose of the poke, then the progress of the session. `part_size` is that of the snapshot."""
    if guidance.closing is not None:
        at = guidance.closing
        why = f"Final check {at.done + 1} of {at.places}: press an early point again to see if anything moved"
        if at.suspect_poke is not None:
            why = f"Only poke {at.suspect_poke} indicates a movement: press this point again to see if the tip slid"
        return f"{why}{DOT_SEPARATOR}Shift+N skips"
    if guidance.landmark is not None:
        return DOT_SEPARATOR.join(
            filter(None, (landmark_words(guidance.landmark, has_tool=has_tool), gain_words(guidance.gain)))
        )
    return DOT_SEPARATOR.join(
        filter(None, (_reason(guidance, target, part_size), progress_words(guidance, dead), left_words(guidance)))
    )


def _reason(guidance: Guidance, target: Target, part_size: float) -> str:
    turn = _turn_reason(target)
    words = _position_reason(guidance, target, part_size, has_turn=bool(turn))
    return ", ".join(filter(None, (words, turn)))


def _turn_reason(target: Target) -> str:
    """Predict the gain of the poke for the turn of a taxel of three axes; empty for others."""
    if math.isnan(target.turn_now):
        return ""
    from skincal.words.turn_words import turn_gain_words  # other skins do without

    return turn_gain_words(target.turn_now, target.turn_after)


def _position_reason(guidance: Guidance, target: Target, part_size: float, *, has_turn: bool) -> str:
    if target.channel is None:
        return "No layout: this shows which taxel answers here"
    row = int(np.searchsorted(guidance.channels, target.channel))
    missing = guidance.needs[row]
    if guidance.phase is GuidePhase.TEST:
        return f"Test poke, {guidance.tests_missing} left: does it agree with the estimate?"
    if has_turn and missing == (Need.TURN,):
        return "Press leaning"
    if Need.ACCURACY not in missing:
        if not missing:
            return "A check: does this poke agree with the estimate?"
        clause = needs_clause(missing[:1])
        return clause[:1].upper() + clause[1:]
    what = REDUCED_ERROR_WORDS[guidance.method]
    if not np.isfinite(guidance.rms[row]) or target.rms_now > max_known_error(part_size):
        return f"{what.capitalize()} not known yet"
    before = cell(target.rms_now, "m")
    return f"This poke should reduce the {what} error from {before} to {millimetres(target.rms_after)}"


def progress_words(guidance: Guidance, dead: Collection[int]) -> str:
    """Count the finished taxels among those in use."""
    done, total = _count_finished(guidance, dead)
    return f"{done} of {count(total, 'taxel')} finished"


def left_words(guidance: Guidance) -> str:
    """Estimate the rest: `"about 120 pokes (6 min) left"`; empty if nothing is left or it is unknown."""
    if not guidance.pokes_left or guidance.phase in (GuidePhase.COVER, GuidePhase.LANDMARKS, GuidePhase.CLOSING):
        return ""
    time = "" if guidance.seconds_left is None else f" ({duration(guidance.seconds_left)})"
    return f"about {count(round_pokes(guidance.pokes_left), 'poke')}{time} left"


def round_pokes(pokes: int) -> int:
    """Round a predicted number of pokes to its accuracy."""
    return pokes if pokes < 10 else 10 * round(pokes / 10)


def enough_words(guidance: Guidance, dead: Collection[int]) -> str:
    """Announce the end of the session: `"80 of 84 taxels are finished"`."""
    done, total = _count_finished(guidance, dead)
    if not total:
        return "All taxels are disabled"
    if not done:
        return f"Not finished: none of {count(total, 'taxel')} could be finished"
    if guidance.tests_missing:
        return f"Not finished: {count(guidance.tests_missing, 'test poke')} could not be predicted"
    return f"{done} of {count(total, 'taxel')} are finished" if done < total else f"Finished: {count(total, 'taxel')}"


NOTHING_TO_CHECK = "The final check needs two points pressed before in this arm pose: landmarks, or taxels with an estimate."


def end_words(guidance: Guidance, dead: Collection[int]) -> str:
    """Give the next step after the end, and the number of disabled taxels."""
    unused = len(guidance.channels) - _count_finished(guidance, dead)[1]
    left_out = f"{unused} disabled{DOT_SEPARATOR}" if unused else ""
    return f"{left_out}Space: show the result and write the file"


def needs_words(guidance: Guidance, channel: int) -> str:
    """List what a taxel still needs; empty if nothing."""
    row = int(np.searchsorted(guidance.channels, channel))
    missing = guidance.needs[row] if channel in guidance.channels else ()
    return needs_clause(missing)


def done_channels(guidance: Guidance | None) -> frozenset[int]:
    """Collect the channels of finished taxels."""
    if guidance is None:
        return frozenset()
    return frozenset(compress(guidance.channels.tolist(), map(not_, guidance.needs)))


def newly_done(before: Guidance | None, now: Guidance | None) -> frozenset[int]:
    """Collect the channels finished between two moments; none if the method changed."""
    if before is None or now is None or before is now or before.method is not now.method:
        return frozenset()
    return done_channels(now) - done_channels(before)


def done_words(channels: Sequence[int], names: ChannelNames) -> str:
    """Name newly finished taxels, their number first: `"2 taxels newly finished: 204, 205"`; empty if none are."""
    if not channels:
        return ""
    listed = ", ".join(names.short(channel) for channel in channels[:MAX_NAMED_FINISHED_TAXELS])
    more = ", ..." if len(channels) > MAX_NAMED_FINISHED_TAXELS else ""
    return f"{count(len(channels), 'taxel')} newly finished: {listed}{more}"


def _count_finished(guidance: Guidance, dead: Collection[int]) -> tuple[int, int]:
    """Count finished taxels and all taxels in use."""
    unused = int(np.isin(guidance.channels, list(dead)).sum()) if dead else 0
    return len(done_channels(guidance).difference(dead)), len(guidance.channels) - unused


def diversity_words(axes: AxisDiversity, method: Method) -> str:
    """Compare a taxel's pokes with what the method needs: `"directions spread 9°, needs 15°"`."""
    settings = GuideSettings()
    if not len(axes.own):
        return "no contact of its own"
    if method is Method.FREE:
        return f"poke directions spread {degrees(axes.diversity)}, {degrees(settings.diversity)} needed"
    middle = f"mean contact point {millimetres(float(np.sqrt(axes.beside @ axes.beside)))} from the taxel"
    return middle if method is Method.MODULES else f"{middle} (limit {millimetres(settings.balance)})"


def contacts_words(axes: AxisDiversity) -> str:
    """Count the pokes of a taxel: `"12 pokes, 3 strongest here"`; empty without pokes."""
    return f"{count(len(axes.own), 'poke')}, {int(axes.own.sum())} with this taxel strongest" if len(axes.own) else ""


def lean_words(lean: LeanDirection, names: ChannelNames) -> str:
    """Name the direction to lean to: `"toward 205"`."""
    return f"{'away from' if lean.away else 'toward'} {names.short(lean.channel)}"


def hint_words(hint: PressHint, target: Target, names: ChannelNames) -> str:
    """Correct the press: `"Lean 8° more toward 205"`."""
    if hint.ask is HintKind.AIM:
        where = "the ring" if target.channel is None else names.taxel(target.channel)
        return f"Move the tip {millimetres(hint.amount, 0)} toward {where}"
    if hint.ask is HintKind.LESS:
        return f"Lean {degrees(hint.amount)} less"
    side = "" if hint.toward is None else f" {lean_words(hint.toward, names)}"
    return f"Lean {degrees(hint.amount)} more{side}"


def pressing_words(coaching: PokeError | None, target: Target | None, names: ChannelNames) -> str:
    """Compare the press with the requested poke: `"1.4 mm off target · lean 26° (wanted 28°)"`; or empty."""
    if coaching is None or target is None:
        return ""
    if coaching.away > OTHER_TAXEL_MIN_DISTANCE_M:
        return "" if coaching.landed is None else _landed_words(coaching.landed, names)
    wanted = "" if target.tilt < UPRIGHT_MAX_TILT else f" (wanted {degrees(target.tilt)})"
    lean = f"lean {degrees(coaching.tilt)}{wanted}"
    if coaching.landed is not None and is_on_other_taxel(coaching, target):
        return f"{_landed_words(coaching.landed, names)}{DOT_SEPARATOR}{lean}"
    return f"{millimetres(coaching.away)} off target{DOT_SEPARATOR}{lean}"


def _landed_words(channel: int, names: ChannelNames) -> str:
    return f"You are on {names.taxel(channel)}; the poke counts for it"


def force_words(memory: CoachMemory, at: ViewState) -> tuple[str, str]:
    """Ask for more or less force (empty if it is right), and give the force with its limit."""
    if not at.scene.has_sensor:
        return "", "Pressing"
    force, limits = newtons(float(np.linalg.norm(at.live.progress.force))), at.scene.contacts
    if memory.force is ForceLevel.LOW:
        return "Press harder", f"{force}, needs {newtons(limits.force_min)}"
    if memory.force is ForceLevel.HIGH:
        return "Press softer", f"{force}, limit {newtons(limits.force_max)}"
    return "", force
