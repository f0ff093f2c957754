"""How a session ends: what is known well enough, whether its errors may be believed, what is not done and why."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.estimate.boards import Boards
from skincal.estimate.evidence import Evidence
from skincal.estimate.result import Estimate, Method, State
from skincal.guide.check import Check, check
from skincal.guide.done import Need, Why
from skincal.guide.guidance import Guidance, Phase
from skincal.guide.left import worked
from skincal.guide.settings import GuideSettings
from skincal.scene import NoiseSettings

if TYPE_CHECKING:
    from skincal.surface.mesh import Surface


@dataclass(frozen=True, slots=True)
class Left:
    """A taxel that is not done."""

    channel: int
    why: Why
    needs: tuple[Need, ...]
    """What it still needs; none for one that is not used."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """What a session has come to by one method."""

    method: Method
    enough: bool
    """Whether nothing is asked for any more, of anything that there is."""
    wanted: float
    """m, the predicted error that was asked for."""
    done: int
    used: int
    """Taxels, without those that are not used."""
    left: tuple[Left, ...]
    """Those that are not done, used or not, by channel."""
    check: Check
    pokes: int
    """Accepted, and not taken out."""
    seconds: float
    """s, from the first of these pokes to the end of the last, without pauses."""


def verdict_of(
    guidance: Guidance,
    estimates: Sequence[Estimate],
    contacts: Mapping[int, Contact],
    evidence: Callable[[Collection[int]], Evidence],
    noise: NoiseSettings,
    surface: Surface | None,
    settings: GuideSettings,
    boards: Boards | None = None,
) -> Verdict:
    """Return what a session has come to.

    Parameters
    ----------
    guidance : of this moment
    estimates : of its method
    contacts : those that count, by the number of their poke
    evidence : gives what the contacts say of some channels
    surface : needed by the surface method
    boards : needed by the modules method, whose errors are not checked without
    """
    state = {one.channel: one.state for one in estimates}
    used = [channel for channel in guidance.channels.tolist() if state.get(channel) is not State.DEAD]
    left = tuple(_left(guidance, state))
    ordered = [contacts[poke] for poke in sorted(contacts)]
    return Verdict(
        method=guidance.method,
        enough=guidance.phase is Phase.ENOUGH and bool(used),
        wanted=settings.wanted,
        done=len(used) - sum(one.why is not Why.DEAD for one in left),
        used=len(used),
        left=left,
        check=check(ordered, used, evidence, guidance.method, noise, surface, boards, estimates),
        pokes=len(contacts),
        seconds=worked(*(np.array([getattr(one, name) for one in ordered]) for name in ("start_s", "end_s"))),
    )


def _left(guidance: Guidance, state: Mapping[int, State]) -> Iterator[Left]:
    """Give the taxels that are not done, by channel."""
    for channel, needs in zip(guidance.channels.tolist(), guidance.needs, strict=True):
        if state.get(channel) is State.DEAD:
            yield Left(channel, Why.DEAD, ())
        elif needs:
            yield Left(channel, guidance.given_up.get(channel, Why.EARLY), needs)
