"""Sound cues of the window: how each sounds, and which is due. `app.sound.player` plays them.

Each cue has its own rhythm, for operators who do not hear pitch. Each event is also shown on the screen in the same frame.
At most one cue per frame, the most important: a finished taxel implies an accepted poke.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache

import numpy as np

from app.state.policies import is_news, newest_outcome
from app.state.running import Running
from app.state.view_state import LINK_FAULTS, ViewState
from app.text.guidance_text import newly_done
from skincal.contacts.outcome import PRESSING_PHASES, Outcome, PressPhase, Rejection
from skincal.geometry import FloatArray
from skincal.guide.guidance import Guidance, GuidePhase
from skincal.session.snapshot import Snapshot
from skincal.words.poke_words import reason_words

SAMPLE_RATE_HZ = 48_000  # Hz, the usual rate of sound devices
MAX_CUE_LENGTH_S = 0.120  # No sound is longer: the next may follow at once
CUE_PEAK_OVER_FULL_SCALE = 0.35  # Largest sample as a share of full scale: audible next to a fan, and not startling
NOTE_FADE_TIME_S = 0.003  # Time in which a note fades in and out; a shorter one clicks
DEVICE_LOST_ALARM_PERIOD_S = 3.0  # The alarm for a lost device is repeated this often


class Cue(Enum):
    """Event with a sound; the value describes the sound."""

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
    """Time constant of the decay, s."""


_LOW_PITCHES = (196.0, 588.0, 980.0)
"""Hz, with odd overtones: it sounds low even if a small loudspeaker omits the lowest."""

_NOTES_OF_CUE: Mapping[Cue, tuple[Note, ...]] = {
    Cue.CONTACT: (Note(0.0, 0.012, (1200.0,)),),
    Cue.HELD: (Note(0.0, 0.012, (1600.0,)), Note(0.040, 0.012, (1600.0,))),
    Cue.ACCEPTED: (Note(0.0, 0.030, (660.0,)), Note(0.045, 0.075, (990.0,))),
    Cue.REJECTED: (Note(0.0, 0.045, _LOW_PITCHES), Note(0.075, 0.045, _LOW_PITCHES)),
    Cue.DONE: (Note(0.0, 0.120, (1320.0, 2640.0), 0.045),),
    Cue.ENOUGH: (Note(0.0, 0.02, (523.25,)), Note(0.03, 0.02, (659.25,)), Note(0.06, 0.06, (523.25, 659.25, 783.99))),
    Cue.LOST: tuple(Note(0.032 * k, 0.022, (740.0 - 70.0 * k,)) for k in range(4)),
}


@cache
def samples_of(sound: Cue) -> bytes:
    """Synthesise a sound: mono, signed 16 bits in the machine's byte order, at `SAMPLE_RATE_HZ`."""
    wave = np.zeros(round(MAX_CUE_LENGTH_S * SAMPLE_RATE_HZ))
    for note in _NOTES_OF_CUE[sound]:
        begin = round(note.start_s * SAMPLE_RATE_HZ)
        heard = _wave(note)
        wave[begin : begin + len(heard)] += heard
    end = int(np.flatnonzero(wave)[-1]) + 1
    scale = CUE_PEAK_OVER_FULL_SCALE / np.abs(wave).max() * np.iinfo(np.int16).max
    return np.round(wave[:end] * scale).astype(np.int16).tobytes()


def _wave(note: Note) -> FloatArray:
    """Synthesise a note, (n,) float, faded at both ends."""
    time = np.arange(round(note.length_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    tone = sum((np.sin(2.0 * np.pi * pitch * time) / rank for rank, pitch in enumerate(note.pitches, 1)), np.zeros(len(time)))
    edges = np.clip(np.minimum(time, note.length_s - time) / NOTE_FADE_TIME_S, 0.0, 1.0)
    return tone * np.sin(0.5 * np.pi * edges) ** 2 * np.exp(-time / note.fading_s)


@dataclass(frozen=True, slots=True)
class DueCue:
    """A sound that is due."""

    sound: Cue
    word: str = ""
    """Spoken after it: the reason of a rejection."""


@dataclass(frozen=True, slots=True)
class CueMemory:
    """Memory between two frames."""

    outcome: Outcome | None = None
    """Newest poke."""
    phase: PressPhase = PressPhase.NO_DATA
    at_landmark: bool = False
    """The newest poke was at a landmark, where no taxel needs to answer."""
    held: bool = False
    """The press in progress was held long enough."""
    guidance: Guidance | None = None
    lost: frozenset[str] = frozenset()
    """Names of the lost or frozen links."""
    alarm_s: float = -math.inf

    @staticmethod
    def from_snapshot(snapshot: Snapshot) -> CueMemory:
        """Make a memory for which all past pokes are already announced."""
        return CueMemory(outcome=newest_outcome(snapshot))


def due_cue(memory: CueMemory, at: ViewState) -> tuple[DueCue | None, CueMemory]:
    """Choose the sound that is due, or `None`, and make the memory for the next frame."""
    phase = at.live.progress.phase
    lost = frozenset(link.link for link in at.live.links if at.status_of(link) in LINK_FAULTS)
    newest = newest_outcome(at.snapshot) or memory.outcome
    following = CueMemory(
        outcome=newest,
        at_landmark=newest is not None and newest.poke in at.snapshot.at_landmarks,
        phase=phase,
        held=phase is PressPhase.HELD or (memory.held and phase in PRESSING_PHASES),
        guidance=at.guidance,
        lost=lost,
        alarm_s=memory.alarm_s,
    )
    if at.running is not Running.STREAMING:
        return None, following
    if not lost:
        return _poking_cue(memory, following), following
    if lost <= memory.lost and at.now_s - memory.alarm_s < DEVICE_LOST_ALARM_PERIOD_S:
        return None, following
    return DueCue(Cue.LOST), replace(following, alarm_s=at.now_s)


def _poking_cue(before: CueMemory, now: CueMemory) -> DueCue | None:
    """Choose the most important cue of pokes and taxels."""
    if _became_enough(before.guidance, now.guidance):
        return DueCue(Cue.ENOUGH)
    verdict = now.outcome if now.outcome is not None and is_news(before.outcome, now.outcome) else None
    if isinstance(verdict, Rejection) and not now.at_landmark:
        return DueCue(Cue.REJECTED, reason_words(verdict))
    if _is_new_poke(before.outcome, now.outcome) and newly_done(before.guidance, now.guidance):
        return DueCue(Cue.DONE)
    if verdict is not None:
        return DueCue(Cue.ACCEPTED)
    if now.held and not before.held:
        return DueCue(Cue.HELD)
    return DueCue(Cue.CONTACT) if now.phase in PRESSING_PHASES and before.phase not in PRESSING_PHASES else None


def _is_new_poke(before: Outcome | None, now: Outcome | None) -> bool:
    """Whether the newest poke is new, or has its final tare now; undo and redo do not count."""
    return now is not None and now is not before and (before is None or now.poke >= before.poke)


def _became_enough(before: Guidance | None, now: Guidance | None) -> bool:
    if before is None or now is None or before.method is not now.method:
        return False
    return now.phase is GuidePhase.ENOUGH and before.phase is not GuidePhase.ENOUGH
