"""What the guide wants, and what the hand that presses should do better, put into words: pure functions, without Qt."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from app.state.press_coach import ELSEWHERE, STRAIGHT, Ask, CoachMemory, Force, Hint, Lean, beside, lean_of
from app.state.view_state import ViewState
from app.text.outcomes import METHOD_NAMES
from skincal.contacts.outcome import Contact
from skincal.guide.guidance import Coaching, Guidance, GuidePhase, LandmarkTarget, Target
from skincal.guide.progress import AxisDiversity, GuideSettings, Need
from skincal.rig.expected_gain import Gain
from skincal.taxels.result import Method
from skincal.words.units import ChannelNames, count, degrees, in_millimetres, millimetres, minutes, newtons, number

DONE_NAMED = 3
"""So many taxels that became done with one poke are named."""
BETWEEN = "  \N{MIDDLE DOT}  "
WHAT: Mapping[Method, str] = {Method.FREE: "depth", Method.SURFACE: "place", Method.MODULES: "place"}
"""What a poke is to show: nearly all of the free method's error is depth; the surface method's lies along the skin."""
FOLLOWS: Mapping[Method, str] = {
    Method.FREE: "The guide follows the free method: it needs tilt, from all sides.",
    Method.SURFACE: "The guide follows the surface method: it needs evenness, all around each taxel, and no tilt.",
    Method.MODULES: "The guide follows the modules method: it needs a few pokes on each module, apart from each other.",
}
"""What to poke for depends on the method: what serves one does not serve the others."""


def target_words(guidance: Guidance, target: Target, names: ChannelNames) -> str:
    """Return what to do, verb first: `"poke 17-04, tilt 28° toward 17-05"`."""
    if target.landmark:
        return f"poke the landmark {target.landmark}"
    if target.channel is None:
        return "poke at the ring, straight"
    poke = f"poke {names.short(target.channel)}"
    if target.tilt < STRAIGHT:
        return f"{poke} straight"
    lean = lean_of(guidance, target)
    side = "" if lean is None else f" {lean_words(lean, names)}"
    return f"{poke}, tilt {degrees(target.tilt)}{side}"


def landmark_words(landmark: LandmarkTarget) -> str:
    """Return which of how many landmark pokes it is."""
    return f"landmark {landmark.done + 1} of {landmark.wanted} in this arm pose"


def gain_words(gain: Gain | None) -> str:
    """Return what landmark pokes are worth: `"expected error of the rig 7.1 -> 2.5 mm after 6 pokes"`; empty where unknown."""
    if gain is None:
        return ""
    now, after = number(in_millimetres(gain.now), 1), millimetres(gain.after)
    return f"expected error of the rig {now} \N{RIGHTWARDS ARROW} {after} after {count(gain.pokes, 'poke')}"


def why_words(guidance: Guidance, target: Target, dead: Collection[int]) -> str:
    """Return by which method the guide asks, what the poke is for, and how far the session is."""
    if guidance.closing is not None:
        at = guidance.closing
        why = f"closing check {at.done + 1} of {at.places}: shows whether anything moved since the start"
        if at.lone is not None:
            why = f"poke {at.lone} alone says that something moved: this place once more shows whether it slipped"
        return f"{why}{BETWEEN}Shift+N ends it"
    if guidance.landmark is not None:
        return BETWEEN.join(filter(None, (landmark_words(guidance.landmark), gain_words(guidance.gain))))
    reason = f"{METHOD_NAMES[guidance.method]} method: {_reason(guidance, target)}"
    return BETWEEN.join(filter(None, (reason, progress_words(guidance, dead), left_words(guidance))))


def _reason(guidance: Guidance, target: Target) -> str:
    if target.channel is None:
        return "looks for taxels"
    row = int(np.searchsorted(guidance.channels, target.channel))
    missing = guidance.needs[row]
    if Need.ACCURACY not in missing:
        return f"needs {missing[0].value}" if missing else "checks what is known"
    what = WHAT[guidance.method]
    if not np.isfinite(guidance.rms[row]):
        return f"{what} not known yet"
    return f"{what} {number(in_millimetres(target.before), 1)} \N{RIGHTWARDS ARROW} {millimetres(target.after)}"


def asked_words(contact: Contact, meant: int, names: ChannelNames) -> str:
    """Return which taxel was asked for where a poke counts for another."""
    return f"{names.short(meant)} was asked for{BETWEEN}{count(len(contact.channels), 'taxel')} answered"


def progress_words(guidance: Guidance, dead: Collection[int]) -> str:
    """Return how many taxels are done, of those that are used."""
    done, total = _done(guidance, dead)
    return f"{done} of {total} done"


def left_words(guidance: Guidance) -> str:
    """Return how much is left: `"about 120 pokes, 6 min left"`; empty where nothing is, or where nobody knows."""
    if not guidance.pokes_left or guidance.phase in (GuidePhase.COVER, GuidePhase.LANDMARKS, GuidePhase.CLOSING):
        return ""
    time = "" if guidance.seconds_left is None else f", {minutes(guidance.seconds_left)}"
    return f"about {count(round_pokes(guidance.pokes_left), 'poke')}{time} left"


def round_pokes(pokes: int) -> int:
    """Return a predicted number of pokes with as many digits as it is true to."""
    return pokes if pokes < 10 else 10 * round(pokes / 10)


def enough_words(guidance: Guidance, dead: Collection[int]) -> str:
    """Return that nothing more is asked for: `"enough: 84 of 84 taxels are done"`, `"enough: 80 of 84 done, 4 given up"`."""
    done, total = _done(guidance, dead)
    if not total:
        return "no taxel is used"
    return (
        f"enough: {done} of {total} done, {total - done} given up"
        if done < total
        else f"enough: {done} of {count(total, 'taxel')} are done"
    )


NOTHING_TO_CHECK = (
    "The closing check needs two places that were poked in this arm pose before; expected landmarks or known taxels."
)


def end_words(guidance: Guidance, dead: Collection[int]) -> str:
    """Return what comes after enough, and what was left out."""
    unused = len(guidance.channels) - _done(guidance, dead)[1]
    left_out = f"{unused} not used{BETWEEN}" if unused else ""
    return f"{left_out}The space bar shows the verdict, then writes the calibration."


def needs_words(guidance: Guidance, channel: int) -> str:
    """Return what a taxel still needs: `"needs pokes of its own, pokes from other sides"`; empty where nothing."""
    row = int(np.searchsorted(guidance.channels, channel))
    missing = guidance.needs[row] if channel in guidance.channels else ()
    return f"needs {', '.join(need.value for need in missing)}" if missing else ""


def done_channels(guidance: Guidance | None) -> frozenset[int]:
    """Return the channels of which the guide needs nothing more."""
    if guidance is None:
        return frozenset()
    return frozenset(c for c, missing in zip(guidance.channels.tolist(), guidance.needs, strict=True) if not missing)


def newly_done(before: Guidance | None, now: Guidance | None) -> frozenset[int]:
    """Return the channels that became done between two moments; none where they follow different methods."""
    if before is None or now is None or before is now or before.method is not now.method:
        return frozenset()
    return done_channels(now) - done_channels(before)


def done_words(channels: Sequence[int], names: ChannelNames) -> str:
    """Return which taxels became done: `"17-04, 17-05 done"`; empty where none did."""
    if not channels:
        return ""
    named = ", ".join(names.short(channel) for channel in channels[:DONE_NAMED])
    more = len(channels) - DONE_NAMED
    return f"{named} and {more} more done" if more > 0 else f"{named} done"


def _done(guidance: Guidance, dead: Collection[int]) -> tuple[int, int]:
    """Return how many taxels are done, and how many there are; none that is not used."""
    used = set(guidance.channels.tolist()).difference(dead)
    return len(used & done_channels(guidance)), len(used)


def diversity_words(axes: AxisDiversity, method: Method) -> str:
    """Return what a taxel's contacts are like beside what the method needs: `"axes spread 9° of 15°"`."""
    settings = GuideSettings()
    if not len(axes.own):
        return "not poked yet"
    if method is Method.FREE:
        return f"axes spread {degrees(axes.diversity)}, wanted {degrees(settings.diversity)}"
    middle = f"their middle lies {millimetres(float(np.sqrt(axes.beside @ axes.beside)))} beside it"
    return middle if method is Method.MODULES else f"{middle}, wanted {millimetres(settings.balance)} or less"


def contacts_words(axes: AxisDiversity) -> str:
    """Return how many contacts there are: `"12 pokes, 3 its own"`; empty where there is none."""
    return f"{count(len(axes.own), 'poke')}, {int(axes.own.sum())} its own" if len(axes.own) else ""


def lean_words(lean: Lean, names: ChannelNames) -> str:
    """Return `"toward 17-05"`."""
    return f"{'away from' if lean.away else 'toward'} {names.short(lean.channel)}"


def hint_words(hint: Hint, target: Target, names: ChannelNames) -> str:
    """Return what to do, verb first: `"tilt 8° more toward 17-05"`."""
    if hint.ask is Ask.AIM:
        where = "the ring" if target.channel is None else names.short(target.channel)
        return f"aim {millimetres(hint.amount, 0)} toward {where}"
    if hint.ask is Ask.LESS:
        return f"tilt {degrees(hint.amount)} less"
    side = "" if hint.toward is None else f" {lean_words(hint.toward, names)}"
    return f"tilt {degrees(hint.amount)} more{side}"


def pressing_words(coaching: Coaching | None, target: Target | None, names: ChannelNames) -> str:
    """Return how a poke goes beside the poke that is asked for: `"aim 1.4 mm · tilt 26° of 28°"`; or empty."""
    if coaching is None or target is None:
        return ""
    if coaching.away > ELSEWHERE:
        return "" if coaching.landed is None else f"on {names.short(coaching.landed)}, it counts there"
    asked = "" if target.tilt < STRAIGHT else f" of {degrees(target.tilt)}"
    tilt = f"tilt {degrees(coaching.tilt)}{asked}"
    if coaching.landed is not None and beside(coaching, target):
        return f"on {names.short(coaching.landed)}, it counts there{BETWEEN}{tilt}"
    return f"aim {millimetres(coaching.away)}{BETWEEN}{tilt}"


def force_words(memory: CoachMemory, at: ViewState) -> tuple[str, str]:
    """Return what to do about the force and its number beside the limit; empty where the force is right."""
    force, limits = newtons(float(np.linalg.norm(at.live.progress.force))), at.scene.contacts
    if memory.force is Force.LOW:
        return "press harder", f"{force} of at least {newtons(limits.force_min)}"
    if memory.force is Force.HIGH:
        return "press less", f"{force} of at most {newtons(limits.force_max)}"
    return "", force
