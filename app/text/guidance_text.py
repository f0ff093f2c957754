"""What the guide wants, put into words; pure functions of its guidance, without Qt.

What is said to the hand that presses: the one thing that matters most, and nothing while the poke counts.

Wrong is credited, nothing nags: a push that is off is coached only while the hand still moves. As soon as it holds still the
poke counts as it is, and the line says nothing else. Pure functions without Qt; what lasts is a value that goes in and out.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from app.scene3d.entry import skin_point
from app.state.view_state import ViewState
from app.text.outcomes import METHOD_NAMES
from app.units import ChannelNames, count, degrees, in_millimetres, millimetres, minutes, newtons, number
from skincal.contacts.outcome import Contact, PressPhase, Progress
from skincal.geometry.arrays import FloatArray
from skincal.guide.coaching import Coaching, Smoothed, coach, leeway, smooth
from skincal.guide.guidance import Guidance, GuidePhase, Target
from skincal.guide.landmark_targets import LandmarkTarget
from skincal.guide.progress import AxisDiversity, GuideSettings, Need
from skincal.mesh.surface import Surface
from skincal.rig.expected_gain import Gain
from skincal.taxels.result import Method

STRAIGHT = float(np.radians(5.0))
"""rad. A hand does not hold a smaller tilt: it is asked to push straight."""
ASIDE = float(np.cos(np.radians(35.0)))
"""Cosine. A neighbour lies where the tool leans if it is off by less: the six around a taxel are 60 degrees apart."""
FARTHEST = 0.020
"""m. A neighbour farther away tells no direction to somebody who looks at the taxel."""
DONE_NAMED = 3
"""So many taxels that became done with one poke are named."""
BETWEEN = "  \N{MIDDLE DOT}  "
WHAT: Mapping[Method, str] = {Method.FREE: "depth", Method.SURFACE: "place", Method.MODULES: "place"}
"""What a poke is to tell: nearly all of the free method's error is depth; the surface method's lies along the skin."""


@dataclass(frozen=True, slots=True)
class Lean:
    """Where the tool's upper end leans, told by a neighbour of the target."""

    channel: int
    away: bool
    """It leans away from that neighbour: there is none on the other side."""

    def words(self, names: ChannelNames) -> str:
        """Return `"toward 17-05"`."""
        return f"{'away from' if self.away else 'toward'} {names.short(self.channel)}"


def lean_of(guidance: Guidance, target: Target) -> Lean | None:
    """Return where the tool leans; None where it stands straight, or where no neighbour tells."""
    if target.tilt < STRAIGHT:
        return None
    up = -target.push
    along = up - (up @ target.normal) * target.normal
    return lean_along(guidance, target, along / np.linalg.norm(along))


def lean_along(guidance: Guidance, target: Target, along: FloatArray) -> Lean | None:
    """Return which neighbour tells a direction `along` the skin, (3,) float, unit; None where none does."""
    for away in (False, True):
        channel = _neighbour(guidance, target, -along if away else along)
        if channel is not None:
            return Lean(channel, away)
    return None


def _neighbour(guidance: Guidance, target: Target, along: FloatArray) -> int | None:
    """Return the nearest taxel of those that lie `along` the skin, (3,) float, unit, from the target."""
    apart = guidance.places - target.place
    apart -= (apart @ target.normal)[:, None] * target.normal
    distance = np.sqrt(np.sum(apart * apart, axis=1))
    found = (apart @ along > ASIDE * distance) & (distance <= FARTHEST) & (guidance.channels != target.channel)
    return int(guidance.channels[np.where(found, distance, np.inf).argmin()]) if found.any() else None


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
    side = "" if lean is None else f" {lean.words(names)}"
    return f"{poke}, tilt {degrees(target.tilt)}{side}"


def landmark_poked_words(poke: int, name: str) -> str:
    """Return that a poke was at a landmark."""
    return f"poke {poke} at the landmark {name}"


def landmark_words(wish: LandmarkTarget) -> str:
    """Return which of how many landmark pokes it is."""
    return f"landmark {wish.done + 1} of {wish.wanted} in this arm pose"


def gain_words(gain: Gain | None) -> str:
    """Return what landmark pokes are worth: `"expected error of the rig 7.1 -> 2.5 mm after 6 pokes"`; empty where unknown."""
    if gain is None:
        return ""
    now, after = number(in_millimetres(gain.now), 1), millimetres(gain.after)
    return f"expected error of the rig {now} \N{RIGHTWARDS ARROW} {after} after {count(gain.pokes, 'poke')}"


def why_words(guidance: Guidance, target: Target, dead: Collection[int]) -> str:
    """Return by which method the guide asks, what the poke is for, and how far the session is."""
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
    if not np.isfinite(guidance.rms[row]):
        return f"{WHAT[guidance.method]} not known yet"
    return (
        f"{WHAT[guidance.method]} {number(in_millimetres(target.before), 1)} \N{RIGHTWARDS ARROW} {millimetres(target.after)}"
    )


def asked_words(contact: Contact, meant: int, names: ChannelNames) -> str:
    """Return which taxel was asked for where a poke counts for another."""
    return f"{names.short(meant)} was asked for{BETWEEN}{count(len(contact.channels), 'taxel')} answered"


def progress_words(guidance: Guidance, dead: Collection[int]) -> str:
    """Return how many taxels are done, of those that are used."""
    done, total = _done(guidance, dead)
    return f"{done} of {total} done"


def left_words(guidance: Guidance) -> str:
    """Return how much is left: `"about 120 pokes, 6 min left"`; empty where nothing is, or where nobody knows."""
    if not guidance.pokes_left or guidance.phase in (GuidePhase.COVER, GuidePhase.LANDMARKS):
        return ""
    # More digits than it is good to would be a lie.
    pokes = guidance.pokes_left if guidance.pokes_left < 10 else 10 * round(guidance.pokes_left / 10)
    time = "" if guidance.seconds_left is None else f", {minutes(guidance.seconds_left)}"
    return f"about {count(pokes, 'poke')}{time} left"


def enough_words(guidance: Guidance, wanted: float, dead: Collection[int]) -> str:
    """Return that it is enough: `"enough: 84 of 84 taxels meet 3 mm"`.

    Parameters
    ----------
    wanted : m, the predicted error that was asked for
    """
    done, total = _done(guidance, dead)
    if not total:
        return "no taxel is used"
    return f"enough: {done} of {count(total, 'taxel')} meet {millimetres(wanted, 0)}"


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
    used = [
        not missing for channel, missing in zip(guidance.channels.tolist(), guidance.needs, strict=True) if channel not in dead
    ]
    return sum(used), len(used)


FOLLOWS: Mapping[Method, str] = {
    Method.FREE: "The guide follows the free method: it needs tilt, from all sides.",
    Method.SURFACE: "The guide follows the surface method: it needs evenness, all around each taxel, and no tilt.",
    Method.MODULES: "The guide follows the modules method: it needs a few pokes on each module, apart from each other.",
}
"""The guide of one method is wrong for the other."""


def sky_words(sky: AxisDiversity, method: Method) -> str:
    """Return what a taxel's contacts are like beside what the method needs: `"axes spread 9° of 15°"`."""
    settings = GuideSettings()
    if not len(sky.own):
        return "not poked yet"
    if method is Method.FREE:
        return f"axes spread {degrees(sky.diversity)}, wanted {degrees(settings.diversity)}"
    beside = float(np.sqrt(sky.beside @ sky.beside))
    if method is Method.MODULES:
        return f"their middle lies {millimetres(beside)} beside it"
    return f"their middle lies {millimetres(beside)} beside it, wanted {millimetres(settings.balance)} or less"


def contacts_words(sky: AxisDiversity) -> str:
    """Return how many contacts there are: `"12 pokes, 3 its own"`; empty where there is none."""
    return f"{count(len(sky.own), 'poke')}, {int(sky.own.sum())} its own" if len(sky.own) else ""


COACH_S = 0.25
"""s. A hint is said once it held for so long: a hand that holds still before needs none, one that searches does."""
FORCE_BACK = 0.3
"""N. "Press harder" and "press less" stay until the force is inside by so much: three times a good sensor's noise."""
AIM_FAR = 0.004
"""m. A tip this far off, on another taxel, is told: nine in ten pokes of a hand with 2 mm sd are nearer."""
AIM_BACK = 0.003
"""m. It is told until it is this near."""
TILT_BACK = float(np.radians(2.0))
"""rad. A tilt is told until it is inside what is asked for by so much."""
ELSEWHERE = 0.015
"""m. A tip this far off, three taxels, is on another one on purpose: it counts there, and there is nothing to say."""
SAME_TILT, SAME_AIM = float(np.radians(3.0)), 0.0015
"""rad and m. A number that changes by less is not said anew."""


class PressCoach:
    """Follows a poke in progress beside the one that is asked for.

    Parameters
    ----------
    surface : of the part; None where the scene has none
    """

    def __init__(self, surface: Surface | None) -> None:
        self._surface = surface
        self._smoothed: Smoothed | None = None
        self._skin: tuple[Target, FloatArray] | None = None
        """The target and its place on the skin, (3,) float, metres."""
        self.coaching: Coaching | None = None
        """None while nothing presses, or nobody guides."""

    def follow(self, progress: Progress, target: Target | None) -> None:
        """Take the newest reading; `target` is None where nobody guides."""
        self._smoothed = smooth(self._smoothed, progress)
        # What a rig's errors make of a tip on a landmark is what is to be found: nobody is told to aim by it.
        if target is None or target.landmark or self._smoothed is None:
            self.coaching = None
            return
        if self._skin is None or self._skin[0] is not target:
            self._skin = target, skin_point(self._surface, target.place, target.normal)
        self.coaching = coach(self._smoothed, progress, target, self._skin[1])


class Force(Enum):
    """Where the force lies."""

    LOW = "low"
    RIGHT = "right"
    HIGH = "high"


class Ask(Enum):
    """What a hand can do better."""

    AIM = "aim"
    MORE = "tilt more"
    LESS = "tilt less"


@dataclass(frozen=True, slots=True)
class Hint:
    """One thing to do better."""

    ask: Ask
    amount: float
    """m or rad."""
    toward: Lean | None = None
    """Where the tool's upper end has to go; None where no neighbour tells."""


@dataclass(frozen=True, slots=True)
class CoachMemory:
    """What the coach remembers between two ticks."""

    force: Force = Force.LOW
    hint: Hint | None = None
    """What is said."""
    coming: Hint | None = None
    coming_since_s: float = -math.inf


SILENT = CoachMemory()
"""Nothing was said yet."""


def follow(memory: CoachMemory, at: ViewState) -> CoachMemory:
    """Return what is to be said now: the force at once, a hint once it held, none while the poke counts."""
    memory = replace(memory, force=_force(memory.force, at))
    if at.live.progress.phase is not PressPhase.PRESSING:
        return CoachMemory(memory.force)
    wanted = _hint(memory.hint, at)
    if _alike(wanted, memory.hint):
        return replace(memory, coming=memory.hint)
    if not _alike(wanted, memory.coming):
        return replace(memory, coming=wanted, coming_since_s=at.now_s)
    if at.now_s - memory.coming_since_s >= COACH_S:
        return replace(memory, hint=wanted, coming=wanted)
    return memory


def _force(said: Force, at: ViewState) -> Force:
    progress, limits = at.live.progress, at.scene.contacts
    size = float(np.linalg.norm(progress.force))
    # What is held still is hard enough: it counts.
    if progress.phase is PressPhase.PRESSING and size < limits.force_min + (FORCE_BACK if said is Force.LOW else 0.0):
        return Force.LOW
    return Force.HIGH if size > limits.force_max - (FORCE_BACK if said is Force.HIGH else 0.0) else Force.RIGHT


def _hint(said: Hint | None, at: ViewState) -> Hint | None:
    """Return what this moment alone asks for; what is said already is let go a little later than it began."""
    told, target, guidance = at.coaching, at.target, at.guidance
    if told is None or target is None or guidance is None or told.away > ELSEWHERE:
        return None
    aimed = said is not None and said.ask is Ask.AIM
    if _beside(told, target) and told.away > (AIM_BACK if aimed else AIM_FAR):
        return Hint(Ask.AIM, told.away)
    tilted = said is not None and not aimed
    if told.error > leeway(guidance) - (TILT_BACK if tilted else 0.0):
        return tilt_hint(guidance, target, told)
    return None


def tilt_hint(guidance: Guidance, target: Target, told: Coaching) -> Hint:
    """Return how the tool has to turn: less, where it leans that way already, else more toward a neighbour."""
    upper = (told.push @ target.normal) * target.normal - told.push
    leans = math.sin(told.tilt)
    if told.tilt >= STRAIGHT and float(upper @ told.lean) < -ASIDE * leans:
        return Hint(Ask.LESS, told.error)
    return Hint(Ask.MORE, told.error, lean_along(guidance, target, told.lean) if told.lean.any() else None)


def _beside(told: Coaching, target: Target) -> bool:
    """Return whether another taxel answers most than the one that is asked for."""
    return target.channel is not None and told.landed not in (None, target.channel)


def _alike(one: Hint | None, other: Hint | None) -> bool:
    if one is None or other is None:
        return one is other
    near = SAME_AIM if one.ask is Ask.AIM else SAME_TILT
    return (one.ask, one.toward) == (other.ask, other.toward) and abs(one.amount - other.amount) < near


def hint_words(hint: Hint, target: Target, names: ChannelNames) -> str:
    """Return what to do, verb first: `"tilt 8° more toward 17-05"`."""
    if hint.ask is Ask.AIM:
        where = "the ring" if target.channel is None else names.short(target.channel)
        return f"aim {millimetres(hint.amount, 0)} toward {where}"
    if hint.ask is Ask.LESS:
        return f"tilt {degrees(hint.amount)} less"
    side = "" if hint.toward is None else f" {hint.toward.words(names)}"
    return f"tilt {degrees(hint.amount)} more{side}"


def pressing_words(told: Coaching | None, target: Target | None, names: ChannelNames) -> str:
    """Return how a poke goes beside the one that is asked for: `"aim 1.4 mm · tilt 26° of 28°"`; empty where nothing tells."""
    if told is None or target is None:
        return ""
    if told.away > ELSEWHERE:
        return "" if told.landed is None else f"on {names.short(told.landed)}, it counts there"
    asked = "" if target.tilt < STRAIGHT else f" of {degrees(target.tilt)}"
    tilt = f"tilt {degrees(told.tilt)}{asked}"
    if told.landed is not None and _beside(told, target):
        return f"on {names.short(told.landed)}, it counts there{BETWEEN}{tilt}"
    return f"aim {millimetres(told.away)}{BETWEEN}{tilt}"


def force_words(memory: CoachMemory, at: ViewState) -> tuple[str, str]:
    """Return what to do about the force and its number beside the limit; empty where the force is right."""
    force, limits = newtons(float(np.linalg.norm(at.live.progress.force))), at.scene.contacts
    if memory.force is Force.LOW:
        return "press harder", f"{force} of at least {newtons(limits.force_min)}"
    if memory.force is Force.HIGH:
        return "press less", f"{force} of at most {newtons(limits.force_max)}"
    return "", force
