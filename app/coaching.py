"""What is said to the hand that presses: the one thing that matters most, and nothing while the poke counts.

Wrong is credited, nothing nags: a push that is off is coached only while the hand still moves. As soon as it holds still the
poke counts as it is, and the line says nothing else. Pure functions without Qt; what lasts is a value that goes in and out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from app.display_units import ChannelNames, degrees, millimetres, newtons
from app.guide_words import ASIDE, BETWEEN, STRAIGHT, Lean, lean_along
from app.scene3d.entry import skin_point
from app.state.view_state import ViewState
from skincal.contacts.outcome import PressPhase, Progress
from skincal.geometry.arrays import FloatArray
from skincal.guide.coaching import Coaching, Smoothed, coach, leeway, smooth
from skincal.guide.guidance import Guidance, Target
from skincal.mesh.surface import Surface

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
