"""What the hand that presses should do better: the push beside the one that is asked for, and which hint holds now.

A poke that is off is coached only while the hand still moves: as soon as it holds still the poke counts as it is, and nothing
is asked of it. What lasts between two ticks is a `CoachMemory`, which goes in and comes out. Numbers only:
`app.text.guidance_text` puts them into words.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from app.state.view_state import ViewState
from skincal.contacts.outcome import PressPhase
from skincal.geometry import FloatArray
from skincal.guide.guidance import Guidance, PokeError, Target, max_angle_error

STRAIGHT = float(np.radians(5.0))
"""rad. A hand does not hold a smaller tilt: it is asked to push straight."""
ASIDE = float(np.cos(np.radians(35.0)))
"""Cosine. A neighbour lies where the tool leans if it is off by less: the six around a taxel are 60 degrees apart."""
FARTHEST = 0.020
"""m. A neighbour farther away shows no direction to somebody who looks at the taxel."""
COACH_S = 0.25
"""s. A hint is said once it held for so long: a hand that holds still before needs none, one that searches does."""
FORCE_BACK = 0.3
"""N. "Press harder" and "press less" stay until the force is inside by so much: three times a good sensor's noise."""
AIM_FAR = 0.004
"""m. A tip this far off, on another taxel, is said: nine in ten pokes of a hand with 2 mm sd are nearer."""
AIM_BACK = 0.003
"""m. It is said until it is this near."""
TILT_BACK = float(np.radians(2.0))
"""rad. A tilt is asked for until it is inside what is asked for by so much."""
ELSEWHERE = 0.015
"""m. A tip this far off, three taxels, is on another taxel on purpose: it counts there, and there is nothing to say."""
SAME_TILT, SAME_AIM = float(np.radians(3.0)), 0.0015
"""rad and m. A number that changes by less is not said anew."""


@dataclass(frozen=True, slots=True)
class Lean:
    """Where the tool's upper end leans, shown by a neighbour of the target."""

    channel: int
    away: bool
    """It leans away from that neighbour: there is none on the other side."""


def lean_of(guidance: Guidance, target: Target) -> Lean | None:
    """Return where the tool leans; None where it stands straight, or where no neighbour lies that way."""
    if target.tilt < STRAIGHT:
        return None
    up = -target.push
    along = up - (up @ target.normal) * target.normal
    return lean_along(guidance, target, along / np.linalg.norm(along))


def lean_along(guidance: Guidance, target: Target, along: FloatArray) -> Lean | None:
    """Return which neighbour shows a direction `along` the skin, (3,) float, unit; None where none does."""
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
    """Where the tool's upper end has to go; None where no neighbour lies that way."""


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


def follow_press(memory: CoachMemory, at: ViewState) -> CoachMemory:
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
    coaching, target, guidance = at.coaching, at.target, at.guidance
    if coaching is None or target is None or guidance is None or coaching.away > ELSEWHERE:
        return None
    aimed = said is not None and said.ask is Ask.AIM
    if beside(coaching, target) and coaching.away > (AIM_BACK if aimed else AIM_FAR):
        return Hint(Ask.AIM, coaching.away)
    tilted = said is not None and not aimed
    if coaching.error > max_angle_error(guidance) - (TILT_BACK if tilted else 0.0):
        return tilt_hint(guidance, target, coaching)
    return None


def tilt_hint(guidance: Guidance, target: Target, coaching: PokeError) -> Hint:
    """Return how the tool has to turn: less, where it leans that way already, else more toward a neighbour."""
    upper = (coaching.push @ target.normal) * target.normal - coaching.push
    leans = math.sin(coaching.tilt)
    if coaching.tilt >= STRAIGHT and float(upper @ coaching.lean) < -ASIDE * leans:
        return Hint(Ask.LESS, coaching.error)
    return Hint(Ask.MORE, coaching.error, lean_along(guidance, target, coaching.lean) if coaching.lean.any() else None)


def beside(coaching: PokeError, target: Target) -> bool:
    """Return whether another taxel answers most than the taxel that is asked for."""
    return target.channel is not None and coaching.landed not in (None, target.channel)


def _alike(first: Hint | None, second: Hint | None) -> bool:
    if first is None or second is None:
        return first is second
    near = SAME_AIM if first.ask is Ask.AIM else SAME_TILT
    return (first.ask, first.toward) == (second.ask, second.toward) and abs(first.amount - second.amount) < near
