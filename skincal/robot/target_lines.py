"""What a robot that pokes is asked, and what it answers, as lines of text; see `docs/wire.md`.

Bytes in, values out, and values in, lines out: no port and no clock. Lengths are metres, forces newtons, times seconds; place
and push are in the frame that the line names.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import accumulate, takewhile
from typing import TypeAlias
from urllib.parse import quote, unquote

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plain_text, shortened
from skincal.model.scene import SECONDS_MOST, SETTING_MOST

GREETING = "skincal targets 1"
"""The first line on every connection: what speaks, and the version of the lines."""
LINE_MAX = 512
"""Bytes of a line, either way: a target has about 150, the rest is for long names and for words."""
NAME_MAX = 160
"""Bytes of a name in a target: two of them, with the numbers, stay below `LINE_MAX`."""
WORDS_MAX = 200
"""Characters of a reason or a fault."""
WORDS_BYTES = 400
"""Bytes of the same: a letter may have four."""
NO_TAXEL = "-"
"""Stands for the channel of a target that is a place at which a taxel may be, and for a name that there is not."""
KNOWN_POINT = "+"
"""Stands for the channel of a target that is a known point of the part: a screw head, a corner."""
FAR = 10.0
"""m. No part reaches so far from its frame's origin: coordinates beyond are a mistake."""

FORCE_MAX = SETTING_MOST
"""N. What thresholds of a scene allow; a robot has limits of its own."""
HOLD_MAX_S = 2.0 * SECONDS_MOST
"""s. Twice the longest still window."""


@dataclass(frozen=True, slots=True, eq=False)
class PokeTarget:
    """One poke that is asked for."""

    number: int
    """From 1; every time that something is asked for it has another one."""
    channel: int | None
    """None where it is a place at which a taxel may be, or a known point."""
    place: FloatArray
    """(3,) float, metres: where the guide believes the taxel to be, which may be beside it; or the known point."""
    push: FloatArray
    """(3,) float, unit: which way the tool pushes."""
    known: bool = False
    """The place is a known point of the part, which one sees and feels."""
    frame: str = ""
    """Of place and push: the link that is calibrated."""
    pose: str = ""
    """Name of the arm pose that is asked for it; empty without an arm, or where it is unknown."""
    force: float = 9.5
    """N, wished."""
    hold: float = 0.6
    """s, at that force without moving."""


class NoTarget(Enum):
    """What is said where no target is named; the value is its line."""

    ANY = "any"
    """Nobody guides: poke what you like, or wait."""
    WAIT = "wait"
    """Nothing is to be poked; what was asked for before is withdrawn."""
    ENOUGH = "enough"
    """Nothing is to be poked any more."""


@dataclass(frozen=True, slots=True)
class Judged:
    """What became of the poke that was asked for by a number."""

    number: int
    reason: str = ""
    """Why it does not count; empty where it does."""


@dataclass(frozen=True, slots=True)
class Refused:
    """Why a robot is hung up on."""

    reason: str


AskedLine: TypeAlias = PokeTarget | NoTarget | Judged | Refused


class AnswerKind(Enum):
    """What a robot says of a target; the value is its word."""

    REACHED = "reached"
    """It pressed there as asked, and let go."""
    SKIP = "skip"
    """It cannot or will not; another is to be asked for."""
    FAULT = "fault"
    """It has stopped."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A robot's line."""

    kind: AnswerKind
    number: int
    text: str = ""
    """Of a fault: what happened."""


ANSWER_HELP = "reached N, skip N or fault N TEXT"


def write_line(line: AskedLine) -> str:
    """Return the line, without its end: the place to a micrometre, force and hold to six digits, however small."""
    match line:
        case NoTarget():
            return line.value
        case Refused():
            return f"refused {_words(line.reason)}"
        case Judged():
            return f"rejected {line.number} {_words(line.reason)}" if line.reason else f"accepted {line.number}"
        case PokeTarget():
            what = (KNOWN_POINT if line.known else NO_TAXEL) if line.channel is None else line.channel
            names = " ".join(_name(name) for name in (line.frame, line.pose))
            place, push = (" ".join(f"{v:.{d}f}" for v in vs) for vs, d in ((line.place, 6), (line.push, 5)))
            return f"target {line.number} {what} {names} {place} {push} {line.force:.6g} {line.hold:.6g}"


def _name(name: str) -> str:
    """Return a name as one word of at most `NAME_MAX` bytes; a longer one loses its end, by whole letters."""
    fitting = accumulate((quote(letter, safe="", errors="replace") for letter in name), initial="")
    return max(takewhile(lambda word: len(word) <= NAME_MAX, fitting), key=len) or NO_TAXEL


def read_line(line: str) -> AskedLine | None:
    """Read a line of skincal's; None for an empty one, the greeting, and words that later versions may add.

    Raises
    ------
    InputError
        It begins as one, and goes on otherwise.
    """
    word, _, rest = line.strip().partition(" ")
    try:
        match word:
            case "target":
                return _target_of(rest.split())
            case "accepted" | "rejected":
                number, _, reason = rest.partition(" ")
                return Judged(_number(number), (reason or word) if word == "rejected" else "")
            case "refused":
                return Refused(rest)
            case _:
                return NoTarget(line.strip()) if line.strip() in {each.value for each in NoTarget} else None
    except ValueError:
        raise InputError(f"{shortened(line.strip(), WORDS_MAX)!r} is no target; docs/wire.md describes these lines.") from None


def _target_of(words: list[str]) -> PokeTarget:
    if len(words) != 12:
        raise ValueError(words)
    number, what, frame, pose, *rest = words
    values = np.array([float(value) for value in rest])
    place, push, force, hold = values[:3], values[3:6], float(values[6]), float(values[7])
    size = float(np.linalg.norm(push))
    # NaN fails every comparison.
    if not ((np.abs(place) < FAR).all() and 0.5 < size < 2.0 and 0 < force <= FORCE_MAX and 0 <= hold <= HOLD_MAX_S):
        raise ValueError(words)
    channel = None if what in (NO_TAXEL, KNOWN_POINT) else _number(what)
    frame, pose = ("" if name == NO_TAXEL else unquote(name) for name in (frame, pose))
    return PokeTarget(_number(number), channel, place, push / size, what == KNOWN_POINT, frame, pose, force, hold)


def write_answer(answer: Answer) -> str:
    """Return a robot's line, without its end."""
    return f"{answer.kind.value} {answer.number} {_words(answer.text)}".rstrip()


def read_answer_line(line: str) -> Answer | None:
    """Read a robot's line; None for an empty one.

    Raises
    ------
    InputError
        The line is no answer.
    """
    words = line.split(maxsplit=2)
    if not words:
        return None
    try:
        kind, number = AnswerKind(words[0]), _number(words[1])
        if len(words) > 2 and kind is not AnswerKind.FAULT:
            raise ValueError(line)
    except (ValueError, IndexError):
        raise InputError(f"it says {shortened(line.strip(), 80)!r}; expected {ANSWER_HELP}.") from None
    return Answer(kind, number, _words(words[2]) if len(words) > 2 else "")


def _number(word: str) -> int:
    # Without this 100,000 digits would be read, and others than ours.
    if not (word.isascii() and word.isdigit() and len(word) < 10):
        raise ValueError(word)
    return int(word)


def _words(text: str) -> str:
    words = shortened(plain_text(" ".join(text.split())), WORDS_MAX)
    return words.encode("utf-8", "replace")[:WORDS_BYTES].decode("utf-8", "ignore")


class LineCutter:
    """Cuts bytes into lines; InputError where one is longer than `LINE_MAX`, whether or not it ends."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Return the lines that ended."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if max(map(len, (*lines, self._rest))) > LINE_MAX:
            raise InputError(f"it sends a line of more than {LINE_MAX} bytes; expected {ANSWER_HELP}.")
        return [line.decode("utf-8", "replace") for line in lines]
