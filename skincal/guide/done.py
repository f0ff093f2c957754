"""When a taxel is done. Never by residuals: those of near-parallel axes agree beautifully and are wrong."""

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


@dataclass(frozen=True, slots=True)
class Facts:
    """What is known of one taxel beside its estimate; SI units."""

    own: int
    diversity: float
    beside: float
    moved: float


def needs(estimate: Estimate, facts: Facts, method: Method, settings: GuideSettings) -> tuple[Need, ...]:
    """Return what a taxel still needs by one method; nothing for one that is done or dead."""
    if estimate.state is State.DEAD:
        return ()
    missing = {
        Need.POKES: facts.own < settings.own_pokes,
        Need.ACCURACY: estimate.rms is None or estimate.rms > settings.wanted,
        Need.SIDES: method is Method.FREE and facts.diversity < settings.diversity,
        Need.BALANCE: facts.beside > settings.balance,
        Need.SETTLED: facts.own >= settings.own_pokes and not facts.moved <= settings.settled,
        Need.DECISION: estimate.rival is not None,
    }
    return tuple(need for need, is_missing in missing.items() if is_missing)
