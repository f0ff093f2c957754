"""The window's sound cues: what each sounds like, and which is due now. `app.sound.player` plays them.

They are made when they are first wanted, short, and known by their rhythm even to an operator who hears no pitch. Which is due
is a pure function of what was heard before and of the frame. Whatever is heard is also said on the screen in the same frame, so
an operator who hears nothing misses nothing:

- contact: the line says what to do with the force; held: "held: release" - the verdict comes only with the release, and
  it is now that the hand wants to know;
- accepted and rejected: the verdict; taxel done: the verdict names it, and its mark on the map becomes a square;
- enough: the line says so; device lost: it says which, and as it says nothing else meanwhile, nothing else is heard.

One sound a frame, the one that matters most: a taxel that is done implies that the poke was accepted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from app.state.policies import is_news, newest_outcome
from app.state.running import Running
from app.state.view_state import LINK_FAULTS, ViewState
from app.text.guidance_text import newly_done
from skincal.contacts.outcome import Outcome, PressPhase, Rejection
from skincal.geometry import FloatArray
from skincal.guide.guidance import Guidance, GuidePhase
from skincal.guide.press_coaching import PRESSING
from skincal.session.snapshot import Snapshot
from skincal.words.poke_words import REASON_WORDS

RATE = 48_000
"""Samples a second: what most sound devices run at, so that nobody has to convert."""
LONGEST_S = 0.120
"""s. No sound is longer: the next may be due right after."""
LEVEL = 0.35
"""Largest sample, as a share of what the device can take: heard beside a fan, and nobody jumps."""
EDGE_S = 0.003
"""s. A note comes and goes in this time; a harder edge clicks."""
ALARM_S = 3.0
"""s. As long as a device is lost, that is said again so often."""


class Cue(Enum):
    """What is heard; the value says how it sounds."""

    CONTACT = "one tick"
    HELD = "two quick ticks"
    ACCEPTED = "short low, long high"
    REJECTED = "two long low ones"
    DONE = "one that rings"
    ENOUGH = "two short, then a chord"
    LOST = "four in a row"


@dataclass(frozen=True, slots=True)
class Note:
    """One note of a sound."""

    start_s: float
    length_s: float
    pitches: tuple[float, ...]
    """Hz, sounding together."""
    fading_s: float = float("inf")
    """s, in which the note fades to a third; as it begins where infinite."""


_LOW = (196.0, 588.0, 980.0)
"""Hz. Odd overtones: a small loudspeaker leaves the lowest out, and it still sounds low."""

_NOTES: Mapping[Cue, tuple[Note, ...]] = {
    Cue.CONTACT: (Note(0.0, 0.012, (1200.0,)),),
    Cue.HELD: (Note(0.0, 0.012, (1600.0,)), Note(0.040, 0.012, (1600.0,))),
    Cue.ACCEPTED: (Note(0.0, 0.030, (660.0,)), Note(0.045, 0.075, (990.0,))),
    Cue.REJECTED: (Note(0.0, 0.045, _LOW), Note(0.075, 0.045, _LOW)),
    Cue.DONE: (Note(0.0, 0.120, (1320.0, 2640.0), 0.045),),
    Cue.ENOUGH: (Note(0.0, 0.02, (523.25,)), Note(0.03, 0.02, (659.25,)), Note(0.06, 0.06, (523.25, 659.25, 783.99))),
    Cue.LOST: tuple(Note(0.032 * k, 0.022, (740.0 - 70.0 * k,)) for k in range(4)),
}


def samples_of(sound: Cue) -> bytes:
    """Return a sound, one channel, 16 bits a sample in the machine's byte order, `RATE` samples a second."""
    wave = np.zeros(round(LONGEST_S * RATE))
    for note in _NOTES[sound]:
        begin = round(note.start_s * RATE)
        heard = _wave(note)
        wave[begin : begin + len(heard)] += heard
    end = int(np.flatnonzero(wave)[-1]) + 1
    return np.round(wave[:end] * (LEVEL / np.abs(wave).max()) * np.iinfo(np.int16).max).astype(np.int16).tobytes()


def _wave(note: Note) -> FloatArray:
    """Return a note, (n,) float, without a jump at its ends."""
    time = np.arange(round(note.length_s * RATE)) / RATE
    tone = sum((np.sin(2.0 * np.pi * pitch * time) / rank for rank, pitch in enumerate(note.pitches, 1)), np.zeros(len(time)))
    edges = np.clip(np.minimum(time, note.length_s - time) / EDGE_S, 0.0, 1.0)
    return tone * np.sin(0.5 * np.pi * edges) ** 2 * np.exp(-time / note.fading_s)


@dataclass(frozen=True, slots=True)
class DueCue:
    """A sound that is due."""

    sound: Cue
    word: str = ""
    """What may be said after it: why a poke was rejected."""


@dataclass(frozen=True, slots=True)
class CueMemory:
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
    """Links that are lost or frozen."""
    alarm_s: float = -math.inf

    @staticmethod
    def of(snapshot: Snapshot) -> CueMemory:
        """Return a memory to which the pokes that are there already are no news."""
        return CueMemory(outcome=newest_outcome(snapshot))


def due_cue(memory: CueMemory, at: ViewState) -> tuple[DueCue | None, CueMemory]:
    """Return the sound that is due now, None where none is, and what has to be remembered."""
    phase = at.live.progress.phase
    lost = frozenset(link.link for link in at.live.links if at.look(link) in LINK_FAULTS)
    newest = newest_outcome(at.snapshot) or memory.outcome
    following = CueMemory(
        outcome=newest,
        at_landmark=newest is not None and newest.poke in at.snapshot.at_landmarks,
        phase=phase,
        held=phase is PressPhase.HELD or (memory.held and phase in PRESSING),
        guidance=at.guidance,
        lost=lost,
        alarm_s=memory.alarm_s,
    )
    if at.running is not Running.STREAMING:
        return None, following
    if not lost:
        return _of_poking(memory, following), following
    if lost <= memory.lost and at.now_s - memory.alarm_s < ALARM_S:
        return None, following
    return DueCue(Cue.LOST), replace(following, alarm_s=at.now_s)


def _of_poking(before: CueMemory, now: CueMemory) -> DueCue | None:
    """Return what is due of pokes and taxels, the most important of it."""
    if _became_enough(before.guidance, now.guidance):
        return DueCue(Cue.ENOUGH)
    verdict = now.outcome if now.outcome is not None and is_news(before.outcome, now.outcome) else None
    if isinstance(verdict, Rejection) and not now.at_landmark:
        return DueCue(Cue.REJECTED, REASON_WORDS[verdict.reason])
    if _came(before.outcome, now.outcome) and newly_done(before.guidance, now.guidance):
        return DueCue(Cue.DONE)
    if verdict is not None:
        return DueCue(Cue.ACCEPTED)
    if now.held and not before.held:
        return DueCue(Cue.HELD)
    return DueCue(Cue.CONTACT) if now.phase in PRESSING and before.phase not in PRESSING else None


def _came(before: Outcome | None, now: Outcome | None) -> bool:
    """Return whether a poke came, or came again with the tare after it; not where one was taken back or let in again."""
    return now is not None and now is not before and (before is None or now.poke >= before.poke)


def _became_enough(before: Guidance | None, now: Guidance | None) -> bool:
    if before is None or now is None or before.method is not now.method:
        return False
    return now.phase is GuidePhase.ENOUGH and before.phase is not GuidePhase.ENOUGH
