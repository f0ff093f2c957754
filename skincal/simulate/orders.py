"""What a simulated operator is told, as lines of text: orders that are obeyed, and what a guide asks for.

`read_order` reads a line, `write_wish` writes what a guide asks; both sides of the pipe share them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError

NO_TAXEL = "-"
"""Stands for the channel of a target that is a place at which a taxel may be."""
KNOWN_POINT = "+"
"""Stands for the channel of a target that is a known point of the part: a screw head, a corner."""
FAR = 10.0
"""m. No part reaches so far from its frame's origin: coordinates beyond are a mistake."""


@dataclass(frozen=True, slots=True)
class PokeOrder:
    """Poke this taxel; what is None is as the habits have it."""

    channel: int
    tilt: float | None = None
    """rad, from the inward normal."""
    azimuth: float | None = None
    """rad, from e1 to e2 of `tangents`."""
    force: float | None = None
    """N."""


@dataclass(frozen=True, slots=True)
class PoseOrder:
    """Bring the arm to this pose."""

    name: str


@dataclass(frozen=True, slots=True, eq=False)
class TargetOrder:
    """What a guide's ring and arrow show."""

    channel: int | None
    """None where it is a place at which a taxel may be, or a known point."""
    place: FloatArray
    """(3,) float, metres, link frame: where the guide believes the taxel to be, which may be beside it; or the known point."""
    push: FloatArray
    """(3,) float, unit, link frame."""
    known: bool = False
    """The place is a known point of the part, which one sees and feels."""


class NoTarget(Enum):
    """What a guide says that names no target; the value is its line."""

    ANY = "any"
    """Nobody guides: poke what you like."""
    WAIT = "wait"
    """Nothing is to be poked."""


Wish: TypeAlias = TargetOrder | NoTarget
Order: TypeAlias = PokeOrder | PoseOrder | TargetOrder | NoTarget

ORDER_HELP = (
    "poke CHANNEL [TILT_DEG AZIMUTH_DEG FORCE_N], pose NAME, "
    "target CHANNEL|-|+ X_MM Y_MM Z_MM PUSH_X PUSH_Y PUSH_Z (- a place, + a known point), any or wait"
)


def read_order(line: str) -> Order | None:
    """Read one line; None for an empty one.

    Raises
    ------
    InputError
        The line is nothing that an operator can be told.
    """
    words = line.split()
    if not words:
        return None
    try:
        order = _READERS[words[0]](words) if words[0] in _READERS else None
    except ValueError:
        order = None
    if order is None:
        raise InputError(f"{line.strip()!r} is not an order; expected {ORDER_HELP}, with 0 <= tilt < 90 and force above 0.")
    return order


def write_wish(wish: Wish) -> str:
    """Return the line that says what a guide asks; the place to a hundredth of a millimetre."""
    if isinstance(wish, NoTarget):
        return wish.value
    place, push = (" ".join(f"{v:.{d}f}" for v in vs) for vs, d in ((wish.place * 1e3, 2), (wish.push, 4)))
    nobody = KNOWN_POINT if wish.known else NO_TAXEL
    return f"target {nobody if wish.channel is None else wish.channel} {place} {push}"


def _poke(words: list[str]) -> PokeOrder | None:
    if len(words) == 2:
        return PokeOrder(int(words[1]))
    if len(words) != 5:
        return None
    tilt, azimuth, force = (float(w) for w in words[2:])
    if not (0 <= tilt < 90 and 0 < force < 1000 and np.isfinite(azimuth)):
        return None
    return PokeOrder(int(words[1]), float(np.radians(tilt)), float(np.radians(azimuth)), force)


def _pose(words: list[str]) -> PoseOrder | None:
    return PoseOrder(words[1]) if len(words) == 2 else None


def _target(words: list[str]) -> TargetOrder | None:
    if len(words) != 8:
        return None
    numbers = np.array([float(w) for w in words[2:]])
    place, push = numbers[:3] * 1e-3, numbers[3:]
    size = float(np.linalg.norm(push))
    # NaN fails every comparison.
    if not (np.abs(place) < FAR).all() or not 0.5 < size < 2.0:
        return None
    channel = None if words[1] in (NO_TAXEL, KNOWN_POINT) else int(words[1])
    return TargetOrder(channel, place, push / size, known=words[1] == KNOWN_POINT)


def _no_target(words: list[str]) -> NoTarget | None:
    return NoTarget(words[0]) if len(words) == 1 else None


_READERS = {"poke": _poke, "pose": _pose, "target": _target, **{each.value: _no_target for each in NoTarget}}
