"""How a press deviates from the target, and which hint to show.

Hints are shown only while the hand still moves; a poke that is held still counts. `CoachMemory` lasts between two ticks.
`app.text.guidance_text` makes the words.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from app.state.view_state import ViewState
from skincal.contacts.outcome import PressPhase
from skincal.geometry import FloatArray
from skincal.guide.guidance import Guidance, Target
from skincal.guide.press_coaching import PokeError, max_angle_error

UPRIGHT_MAX_TILT = float(np.radians(5.0))
"""rad. A smaller tilt cannot be held by hand: the tool is asked to be upright."""
NEIGHBOUR_MIN_COS = float(np.cos(np.radians(35.0)))
"""A neighbour shows a direction that is off by less; the six neighbours of a taxel are 60 degrees apart."""
NEIGHBOUR_MAX_DISTANCE_M = 0.020  # m. A neighbour further away shows no direction to somebody who looks at the taxel.
HINT_DEBOUNCE_S = 0.25  # A hint must hold this long before it is shown: a hand that is just arriving needs none
FORCE_HINT_HYSTERESIS_N = 0.3
"""N. "Press harder" and "press softer" stay until the force is inside by this much: three times a good sensor's noise."""
AIM_SHOWN, AIM_HIDDEN = 0.004, 0.003
"""m. The aim hint is shown above the one distance and hidden below the other: nine in ten pokes of a hand with 2 mm sd
are nearer."""
TILT_HYSTERESIS = float(np.radians(2.0))  # rad. A tilt hint stays until the tilt is inside the limit by this much.
OTHER_TAXEL_MIN_DISTANCE_M = 0.015
"""m. A tip this far off, three taxels, is on another taxel on purpose: there is nothing to correct."""
SAME_TILT, SAME_AIM = float(np.radians(3.0)), 0.0015
"""rad and m. A hint stays unchanged while its number changes by less."""


@dataclass(frozen=True, slots=True)
class LeanDirection:
    """Direction of the tool's upper end, shown by a neighbour of the target."""

    channel: int
    away: bool
    """It leans away from that neighbour: there is none on the other side."""


def lean_of(guidance: Guidance, target: Target) -> LeanDirection | None:
    """Return the lean direction of a target; `None` if the tool is upright or no neighbour shows the direction."""
    if target.tilt < UPRIGHT_MAX_TILT:
        return None
    up = -target.push
    along = up - (up @ target.normal) * target.normal
    return lean_along(guidance, target, along / np.linalg.norm(along))


def lean_along(guidance: Guidance, target: Target, along: FloatArray) -> LeanDirection | None:
    """Return the neighbour that shows a direction `along` the skin, (3,) float, unit; `None` if there is none."""
    for away in (False, True):
        channel = _neighbour(guidance, target, -along if away else along)
        if channel is not None:
            return LeanDirection(channel, away)
    return None


def _neighbour(guidance: Guidance, target: Target, along: FloatArray) -> int | None:
    """Return the nearest taxel in a direction `along` the skin, (3,) float, unit, from the target."""
    offset = guidance.places - target.place
    offset -= (offset @ target.normal)[:, None] * target.normal
    distance = np.sqrt(np.sum(offset * offset, axis=1))
    found = (offset @ along > NEIGHBOUR_MIN_COS * distance) & (distance <= NEIGHBOUR_MAX_DISTANCE_M)
    found &= guidance.channels != target.channel
    return int(guidance.channels[np.where(found, distance, np.inf).argmin()]) if found.any() else None


class ForceLevel(Enum):
    """Force compared with its limits."""

    LOW = "low"
    RIGHT = "right"
    HIGH = "high"


class HintKind(Enum):
    """Quantity that the operator should correct during a press: force, tilt or place."""

    AIM = "aim"
    MORE = "tilt more"
    LESS = "tilt less"


@dataclass(frozen=True, slots=True)
class PressHint:
    """One correction that the coach proposes during a press."""

    ask: HintKind
    amount: float
    """m or rad."""
    toward: LeanDirection | None = None
    """Where the tool's upper end should go; `None` if no neighbour shows it."""


@dataclass(frozen=True, slots=True)
class CoachMemory:
    """State of the coach between two ticks."""

    force: ForceLevel = ForceLevel.LOW
    hint: PressHint | None = None
    """The hint that is shown."""
    coming: PressHint | None = None
    """The hint that will be shown if it holds for `HINT_DEBOUNCE_S`."""
    coming_since_s: float = -math.inf


NO_HINT = CoachMemory()


def follow_press(memory: CoachMemory, at: ViewState) -> CoachMemory:
    """Update the memory: the force level at once, a hint once it held, none while the poke counts."""
    memory = replace(memory, force=_force_level(memory.force, at))
    if at.live.progress.phase is not PressPhase.PRESSING:
        return CoachMemory(memory.force)
    wanted = _hint(memory.hint, at)
    if _is_alike(wanted, memory.hint):
        return replace(memory, coming=memory.hint)
    if not _is_alike(wanted, memory.coming):
        return replace(memory, coming=wanted, coming_since_s=at.now_s)
    if at.now_s - memory.coming_since_s >= HINT_DEBOUNCE_S:
        return replace(memory, hint=wanted, coming=wanted)
    return memory


def _force_level(before: ForceLevel, at: ViewState) -> ForceLevel:
    progress, limits = at.live.progress, at.scene.contacts
    if not at.scene.has_sensor:
        return ForceLevel.RIGHT
    size = float(np.linalg.norm(progress.force))
    low = limits.force_min + (FORCE_HINT_HYSTERESIS_N if before is ForceLevel.LOW else 0.0)
    # A poke that is held still counts, so its force is high enough.
    if progress.phase is PressPhase.PRESSING and size < low:
        return ForceLevel.LOW
    high = limits.force_max - (FORCE_HINT_HYSTERESIS_N if before is ForceLevel.HIGH else 0.0)
    return ForceLevel.HIGH if size > high else ForceLevel.RIGHT


def _hint(shown: PressHint | None, at: ViewState) -> PressHint | None:
    """Choose the hint for this moment; a hint that is shown ends a little later than it began (hysteresis)."""
    coaching, target, guidance = at.coaching, at.target, at.guidance
    if coaching is None or target is None or guidance is None or coaching.away > OTHER_TAXEL_MIN_DISTANCE_M:
        return None
    is_aim = shown is not None and shown.ask is HintKind.AIM
    if is_on_other_taxel(coaching, target) and coaching.away > (AIM_HIDDEN if is_aim else AIM_SHOWN):
        return PressHint(HintKind.AIM, coaching.away)
    is_tilt = shown is not None and not is_aim
    if coaching.error > max_angle_error(guidance) - (TILT_HYSTERESIS if is_tilt else 0.0):
        return tilt_hint(guidance, target, coaching)
    return None


def tilt_hint(guidance: Guidance, target: Target, coaching: PokeError) -> PressHint:
    """Make the hint on the tilt: less if it leans the right way already, else more toward a neighbour."""
    upper = (coaching.push @ target.normal) * target.normal - coaching.push
    leans = math.sin(coaching.tilt)
    if coaching.tilt >= UPRIGHT_MAX_TILT and float(upper @ coaching.lean) < -NEIGHBOUR_MIN_COS * leans:
        return PressHint(HintKind.LESS, coaching.error)
    toward = lean_along(guidance, target, coaching.lean) if coaching.lean.any() else None
    return PressHint(HintKind.MORE, coaching.error, toward)


def is_on_other_taxel(coaching: PokeError, target: Target) -> bool:
    """Return whether another taxel than the target answers most."""
    return target.channel is not None and coaching.landed not in (None, target.channel)


def _is_alike(first: PressHint | None, second: PressHint | None) -> bool:
    if first is None or second is None:
        return first is second
    near = SAME_AIM if first.ask is HintKind.AIM else SAME_TILT
    return (first.ask, first.toward) == (second.ask, second.toward) and abs(first.amount - second.amount) < near
