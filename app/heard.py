"""Which sound is due, as a pure function of what was heard before and the frame; nothing here plays.

Whatever is heard is said on the screen in the same frame, so one who hears nothing misses nothing:

- contact: the line says what to do with the force; held: "enough, release" - the verdict comes only with the release, and
  it is now that the hand wants to know;
- accepted and rejected: the verdict; taxel done: the verdict names it, and its mark on the map becomes a square;
- enough: the line says so; device lost: it says which, and as it says nothing else meanwhile, nothing else is heard.

One sound a frame, the one that matters most: a taxel that is done tells that the poke was accepted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from app.earcons import Sound
from app.guide_words import newly_done
from app.state.policies import is_news, newest_outcome
from app.state.running import Running
from app.state.view_state import LinkLook, ViewState
from skincal.contacts.outcome import Outcome, PressPhase, Rejection
from skincal.guide.coaching import PRESSING
from skincal.guide.guidance import Guidance, GuidePhase
from skincal.session.snapshot import Snapshot

ALARM_S = 3.0
"""s. As long as a device is lost, that is said again so often."""


@dataclass(frozen=True, slots=True)
class Heard:
    """A sound that is due."""

    sound: Sound
    word: str = ""
    """What may be said after it: why a poke was rejected."""


@dataclass(frozen=True, slots=True)
class Ear:
    """What is remembered between two frames."""

    outcome: Outcome | None = None
    """The newest poke that was seen."""
    phase: PressPhase = PressPhase.NO_DATA
    at_landmark: bool = False
    """That poke was at a landmark, where no taxel need answer."""
    held: bool = False
    """The press in progress was said to be enough."""
    guidance: Guidance | None = None
    lost: frozenset[str] = frozenset()
    """Links that are lost."""
    alarm_s: float = -math.inf

    @staticmethod
    def of(snapshot: Snapshot) -> Ear:
        """Return an ear to which the pokes that are there already are no news."""
        return Ear(outcome=newest_outcome(snapshot))


def heard(ear: Ear, at: ViewState) -> tuple[Heard | None, Ear]:
    """Return the sound that is due now, None where none is, and what has to be remembered."""
    phase = at.live.progress.phase
    lost = frozenset(link.link for link in at.live.links if at.look(link) is LinkLook.LOST)
    newest = newest_outcome(at.snapshot) or ear.outcome
    following = Ear(
        outcome=newest,
        at_landmark=newest is not None and newest.poke in at.snapshot.at_landmarks,
        phase=phase,
        held=phase is PressPhase.HELD or (ear.held and phase in PRESSING),
        guidance=at.guidance,
        lost=lost,
        alarm_s=ear.alarm_s,
    )
    if at.running is not Running.STREAMING:
        return None, following
    if not lost:
        return _of_poking(ear, following), following
    if lost <= ear.lost and at.now_s - ear.alarm_s < ALARM_S:
        return None, following
    return Heard(Sound.LOST), replace(following, alarm_s=at.now_s)


def _of_poking(before: Ear, now: Ear) -> Heard | None:
    """Return what is due of pokes and taxels, the most important of it."""
    if _became_enough(before.guidance, now.guidance):
        return Heard(Sound.ENOUGH)
    verdict = now.outcome if now.outcome is not None and is_news(before.outcome, now.outcome) else None
    if isinstance(verdict, Rejection) and not now.at_landmark:
        return Heard(Sound.REJECTED, verdict.reason.value)
    if _came(before.outcome, now.outcome) and newly_done(before.guidance, now.guidance):
        return Heard(Sound.DONE)
    if verdict is not None:
        return Heard(Sound.ACCEPTED)
    if now.held and not before.held:
        return Heard(Sound.HELD)
    return Heard(Sound.CONTACT) if now.phase in PRESSING and before.phase not in PRESSING else None


def _came(before: Outcome | None, now: Outcome | None) -> bool:
    """Return whether a poke came, or came again with the tare after it; not where one was taken back or let in again."""
    return now is not None and now is not before and (before is None or now.poke >= before.poke)


def _became_enough(before: Guidance | None, now: Guidance | None) -> bool:
    if before is None or now is None or before.method is not now.method:
        return False
    return now.phase is GuidePhase.ENOUGH and before.phase is not GuidePhase.ENOUGH
