"""Lines of text between skincal and a robot that pokes (`docs/wire.md`): targets and verdicts out, answers in.

Lengths are metres, forces newtons, times seconds; place and push are in the frame that the line names. No port and no clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import accumulate, takewhile
from typing import TypeAlias
from urllib.parse import quote

import numpy as np

from skincal.geometry import FloatArray, quaternion_of_rotation
from skincal.guide.robot_order import RobotPace
from skincal.model.errors import InputError, plain_text, shortened

GREETING = "skincal targets 3"
"""First line of every connection: protocol and version."""
LINE_MAX_BYTES = 512
"""A target has about 150; the rest is for long names and reasons."""
NAME_MAX_BYTES = 160
"""Two names in a target, with the numbers, stay below `LINE_MAX_BYTES`."""
REASON_MAX_CHARS, REASON_MAX_BYTES = 200, 400
"""A letter may have four bytes."""
NO_TAXEL = "-"
"""In place of the channel: a place at which a taxel may be. In place of a name: there is none."""
KNOWN_POINT = "+"
"""In place of the channel: a known point of the part, such as a screw head or a corner."""
BY_HAND = "hand"
"""First word of a robot's line: a person guides the tip to a known point."""


@dataclass(frozen=True, slots=True, eq=False)
class PokeTarget:
    """A requested poke."""

    number: int
    """From 1; every request has a new number."""
    channel: int | None
    """`None` for a place at which a taxel may be, and for a known point."""
    place: FloatArray
    """(3,) float, metres: the estimated position of the taxel, or the known point."""
    push: FloatArray
    """(3,) float, unit: direction in which the tool pushes."""
    known: bool = False
    """Whether the place is a known point of the part, which one sees and feels."""
    frame: str = ""
    """Frame of place and push: the link that is calibrated."""
    pose: str = ""
    """Name of the requested arm pose; empty without an arm, or if it is unknown."""
    force: float = 9.5
    """N, desired."""
    hold: float = 0.6
    """s, time to hold that force without moving."""


class NoTarget(Enum):
    """Lines without a target."""

    ANY = "any"
    """The guide is off: any poke is welcome."""
    WAIT = "wait"
    """No poke is wanted now; the target before is withdrawn."""
    ENOUGH = "enough"
    """No more pokes are needed."""
    STOP = "stop"
    """The operator pressed the stop key: stop moving at once, let go of the part, and stay until the next target."""


@dataclass(frozen=True, slots=True)
class Judged:
    """The verdict on the poke that was requested by a number."""

    number: int
    reason: str = ""
    """Why it does not count; empty if it counts."""


@dataclass(frozen=True, slots=True)
class Held:
    """The poke that was requested by a number is held long enough: let go."""

    number: int


@dataclass(frozen=True, slots=True)
class Refused:
    """The reason for which a robot is disconnected."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class PartPlace:
    """Pose of the part in the base of the tool's poses, as the pokes show it: the robot need not measure it."""

    frame: str
    """Frame of the targets: the link that is calibrated."""
    base_from_link: FloatArray
    """(4, 4) float, metres."""


AskedLine: TypeAlias = PokeTarget | NoTarget | Judged | Held | Refused | PartPlace


class AnswerKind(Enum):
    """Words of a robot on a target."""

    REACHED = "reached"
    """It pressed there as requested, and released."""
    SKIP = "skip"
    """It cannot or will not; another target is wanted. With a text it never can, and the text says why."""
    FAULT = "fault"
    """It has stopped."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A robot's line."""

    kind: AnswerKind
    number: int
    text: str = ""
    """What happened, for a fault; why it is impossible, for a skip."""


@dataclass(frozen=True, slots=True, eq=False)
class TipPose:
    """Pose of the robot's tip as the robot knows it, in the frame of the targets."""

    place: FloatArray
    """(3,) float, metres: the end of the tip."""
    push: FloatArray
    """(3,) float, unit: from the tool to the tip."""


@dataclass(frozen=True, slots=True)
class GuidedByHand:
    """A person guides the tip to the known point of a request: the robot drives to it by no pose of the part."""

    number: int


RobotLine: TypeAlias = Answer | RobotPace | TipPose | GuidedByHand

ANSWER_HELP = "reached N, skip N [REASON], fault N TEXT, hand N, robot SPEED SECONDS or tip X Y Z PX PY PZ"
COORDINATE_MAX_M = 10.0
"""m. No part reaches so far from its frame's origin."""
ROBOT_SPEED_AND_POKE_TIME_MAX = 1000.0
"""m/s and s. Largest speed and time of a robot."""


def write_line(line: AskedLine) -> str:
    """Write a line, without its end: the place to a micrometre, force and hold to six digits."""
    match line:
        case NoTarget():
            return line.value
        case Refused():
            return f"refused {_words(line.reason)}"
        case Held():
            return f"held {line.number}"
        case Judged():
            return f"rejected {line.number} {_words(line.reason)}" if line.reason else f"accepted {line.number}"
        case PartPlace():
            pose = line.base_from_link
            w, *xyz = quaternion_of_rotation(pose[:3, :3]).tolist()
            numbers = [*(f"{value:.6f}" for value in pose[:3, 3]), *(f"{value:.7f}" for value in (*xyz, w))]
            return " ".join(["part", _name(line.frame), *numbers])
        case PokeTarget():
            what = (KNOWN_POINT if line.known else NO_TAXEL) if line.channel is None else line.channel
            names = " ".join(_name(name) for name in (line.frame, line.pose))
            place, push = (" ".join(f"{v:.{d}f}" for v in vs) for vs, d in ((line.place, 6), (line.push, 5)))
            return f"target {line.number} {what} {names} {place} {push} {line.force:.6g} {line.hold:.6g}"


def _name(name: str) -> str:
    """Write a name as one word of at most `NAME_MAX_BYTES`; a longer one loses whole letters at its end."""
    fitting = accumulate((quote(letter, safe="", errors="replace") for letter in name), initial="")
    return max(takewhile(lambda word: len(word) <= NAME_MAX_BYTES, fitting), key=len) or NO_TAXEL


def write_answer(answer: RobotLine) -> str:
    """Write a robot's line, without its end."""
    match answer:
        case RobotPace():
            return f"robot {answer.speed:.6g} {answer.poke_s:.6g}"
        case TipPose():
            return " ".join(["tip", *(f"{value:.6f}" for value in (*answer.place, *answer.push))])
        case Answer():
            return f"{answer.kind.value} {answer.number} {_words(answer.text)}".rstrip()
        case GuidedByHand():
            return f"{BY_HAND} {answer.number}"


def read_answer_line(line: str) -> RobotLine | None:
    """Read a robot's line; `None` for an empty one. Raises InputError: it is no line of a robot."""
    words = line.split()
    if not words:
        return None
    try:
        if words[0] == "robot":
            return _pace_of(*words[1:])
        if words[0] == BY_HAND:
            return _hand_of(*words[1:])
        if words[0] == "tip":
            return _tip_of(words[1:])
        kind, number = AnswerKind(words[0]), read_number(words[1])
        if len(words) > 2 and kind is AnswerKind.REACHED:
            raise ValueError(line)
    except (ValueError, IndexError, TypeError):
        raise InputError(f"it says {shortened(line.strip(), 80)!r}; expected {ANSWER_HELP}.") from None
    return Answer(kind, number, _words(" ".join(words[2:])))


def _hand_of(number: str) -> GuidedByHand:
    return GuidedByHand(read_number(number))


def _pace_of(speed: str, poke_s: str) -> RobotPace:
    pace = RobotPace(float(speed), float(poke_s))
    # NaN fails every comparison.
    if not (0.0 < pace.speed <= ROBOT_SPEED_AND_POKE_TIME_MAX and 0.0 < pace.poke_s <= ROBOT_SPEED_AND_POKE_TIME_MAX):
        raise ValueError(speed)
    return pace


def _tip_of(words: list[str]) -> TipPose:
    values = np.array([float(word) for word in words])
    size = float(np.linalg.norm(values[3:]))
    if not (len(values) == 6 and (np.abs(values[:3]) < COORDINATE_MAX_M).all() and 0.5 < size < 2.0):
        raise ValueError(words)
    return TipPose(values[:3], values[3:] / size)


def read_number(word: str) -> int:
    """Read a number of at most nine digits. Raises ValueError."""
    if not (word.isascii() and word.isdigit() and len(word) < 10):
        raise ValueError(word)
    return int(word)


def _words(text: str) -> str:
    words = shortened(plain_text(" ".join(text.split())), REASON_MAX_CHARS)
    return words.encode("utf-8", "replace")[:REASON_MAX_BYTES].decode("utf-8", "ignore")


class LineCutter:
    """Cuts bytes into lines. A line longer than `LINE_MAX_BYTES`, ended or not, raises InputError."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Return the completed lines."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if max(map(len, (*lines, self._rest))) > LINE_MAX_BYTES:
            raise InputError(f"it sends a line of more than {LINE_MAX_BYTES} bytes; expected {ANSWER_HELP}.")
        return [line.decode("utf-8", "replace") for line in lines]
