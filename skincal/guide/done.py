"""When a taxel is done, and when it is given up. Never by residuals: those of near-parallel axes agree and are wrong."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from skincal.estimate.result import Estimate, Method, State
from skincal.guide.settings import GuideSettings


class Need(Enum):
    """What a taxel still needs; the value says it in a few words."""

    POKES = "pokes of its own"
    ACCURACY = "a smaller predicted error"
    SIDES = "pokes from other sides"
    BALANCE = "pokes on its other half"
    SETTLED = "one more poke, since the last one moved it"
    DECISION = "a poke that tells two places apart"


class Why(Enum):
    """Why a taxel is not done; the value says it in a few words."""

    DEAD = "not used"
    NEVER_FIRED = "never answered where it is expected"
    OUT_OF_REACH = "out of reach: every side of it was skipped"
    TILT = "the tilt that the hand manages does not spread its axes enough"
    AMBIGUOUS = "two places fit its pokes"
    STUBBORN = "many pokes were not enough"
    EARLY = "not poked enough yet"


@dataclass(frozen=True, slots=True)
class Facts:
    """What is known of one taxel beside its estimate; SI units."""

    own: int
    """Pokes of its own; by the modules method, of its module."""
    diversity: float
    beside: float
    moved: float


@dataclass(frozen=True, slots=True)
class Tried:
    """What was tried at one taxel, and what can be."""

    own: int
    contacts: int
    """Pokes in which it answered."""
    unanswered: int
    """Pokes at it, while it was asked for, in which it did not answer."""
    shut: bool
    """Every side of it was skipped."""
    tilt: float
    """rad, the most that a push may lean now."""


def needs(estimate: Estimate, facts: Facts, method: Method, settings: GuideSettings) -> tuple[Need, ...]:
    """Return what a taxel still needs by one method; nothing for one that is done or dead."""
    if estimate.state is State.DEAD:
        return ()
    if method is Method.MODULES:
        few, wide = facts.own < settings.module_pokes, estimate.rms is None or estimate.rms > settings.wanted
        return tuple(need for need, is_missing in ((Need.POKES, few), (Need.ACCURACY, wide)) if is_missing)
    missing = {
        Need.POKES: facts.own < settings.own_pokes,
        Need.ACCURACY: estimate.rms is None or estimate.rms > settings.wanted,
        Need.SIDES: method is Method.FREE and facts.diversity < settings.diversity,
        Need.BALANCE: facts.beside > settings.balance,
        Need.SETTLED: facts.own >= settings.own_pokes and not facts.moved <= settings.settled,
        Need.DECISION: estimate.rival is not None,
    }
    return tuple(need for need, is_missing in missing.items() if is_missing)


def given_up(missing: tuple[Need, ...], tried: Tried, settings: GuideSettings) -> Why | None:
    """Return why a taxel that still needs something is asked for no more; None where it is."""
    if not missing:
        return None
    if tried.shut:
        return Why.OUT_OF_REACH
    if tried.contacts == 0:
        return Why.NEVER_FIRED if tried.unanswered >= settings.unanswered else None
    if tried.own >= settings.patience:
        return Why.AMBIGUOUS if Need.DECISION in missing else Why.STUBBORN
    # Axes that all lean by one angle, evenly to all sides, have just that diversity; none has more.
    if Need.SIDES in missing and tried.own >= settings.own_pokes and tried.tilt < settings.diversity:
        return Why.TILT
    return None
