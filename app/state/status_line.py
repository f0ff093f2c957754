"""What the status line shows: its kind, and its words. Imports no numpy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Tone(Enum):
    """Kind of status; each has a colour and a sign."""

    CALM = "calm"
    WAIT = "wait"
    GO = "go"
    HOLD = "hold"
    GOOD = "good"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Said:
    """Result of the last poke or action, shown in smaller type."""

    tone: Tone
    words: str


@dataclass(frozen=True, slots=True)
class Now:
    """What to do now in large type, one line of detail, and the result of the last poke or action."""

    tone: Tone
    headline: str
    detail: str = ""
    result: Said | None = None
