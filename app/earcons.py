"""The sounds of the window, made when they are first wanted: short, and told apart by their rhythm even by who hears no pitch.

Nothing here knows when a sound is due (`app.heard`) or how it is played (`app.sound`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from skincal.geometry.arrays import FloatArray

RATE = 48_000
"""Samples a second: what most sound devices run at, so that nobody has to convert."""
LONGEST_S = 0.120
"""s. No sound is longer: the next may be due right after."""
LEVEL = 0.35
"""Largest sample, as a share of what the device can take: heard beside a fan, and nobody jumps."""
EDGE_S = 0.003
"""s. A note comes and goes in this time; a harder edge clicks."""


class Sound(Enum):
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

_NOTES: Mapping[Sound, tuple[Note, ...]] = {
    Sound.CONTACT: (Note(0.0, 0.012, (1200.0,)),),
    Sound.HELD: (Note(0.0, 0.012, (1600.0,)), Note(0.040, 0.012, (1600.0,))),
    Sound.ACCEPTED: (Note(0.0, 0.030, (660.0,)), Note(0.045, 0.075, (990.0,))),
    Sound.REJECTED: (Note(0.0, 0.045, _LOW), Note(0.075, 0.045, _LOW)),
    Sound.DONE: (Note(0.0, 0.120, (1320.0, 2640.0), 0.045),),
    Sound.ENOUGH: (
        Note(0.0, 0.020, (523.25,)),
        Note(0.030, 0.020, (659.25,)),
        Note(0.060, 0.060, (523.25, 659.25, 783.99)),
    ),
    Sound.LOST: tuple(Note(0.032 * k, 0.022, (740.0 - 70.0 * k,)) for k in range(4)),
}


def samples_of(sound: Sound) -> bytes:
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
