"""Words on the turn of a taxel of three axes: directions of x, y and z, their errors, and the state."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from skincal.axes.turn_fit import IN_PLANE_KNOWN_MAX_SD
from skincal.geometry import FloatArray
from skincal.words.units import DASH, count, degrees, direction

if TYPE_CHECKING:
    from skincal.axes.push_offset import PushLean
    from skincal.axes.session_turns import ShownTurn
    from skincal.axes.taxel_frames import FrameState
    from skincal.axes.turn_differences import TurnDifferences

TURN_ROWS = ("x points to", "y points to", "z points to", "z from normal", "Turn's error", "Turn")
MIN_ANGLE_WITHOUT_DECIMAL = float(np.radians(9.95))
"""rad. Smaller predictions have a decimal."""
CERTAIN_LEAN_SDS = 4.0
NO_TURN_YET = "unknown: no poke has pressed it"
IN_PLANE_UNKNOWN = "turn in the plane is unknown: press leaning"


def turn_cells(turn: ShownTurn | FrameState | None, normal: FloatArray | None) -> tuple[str, ...]:
    """Make the cells of `TURN_ROWS`; `turn` is the state that says why readings show none, or `None` before a poke shows one.

    `normal` (3,), unit, outward, is that of the skin at the taxel.
    """
    if turn is None or isinstance(turn, Enum):
        return (*(DASH,) * (len(TURN_ROWS) - 1), NO_TURN_YET if turn is None else f"unknown: {turn.value}")
    x, y, z = turn.axes.T
    if not turn.is_in_plane_known:
        x = y = None
    lean = None if normal is None else float(np.arccos(np.clip(z @ normal, -1.0, 1.0)))
    return direction(x), direction(y), direction(z), degrees(lean, 1), turn_error_words(turn), turn_words(turn)


def turn_words(turn: ShownTurn) -> str:
    """Say whose turn it is, by how many pokes, and what is unknown."""
    whose = "its own" if turn.module is None else "that of its module"
    words = [f"{whose}, by {count(turn.turn.pokes, 'poke')}"]
    if turn.is_mirrored:
        words.append("axes are mirrored: y has the opposite sign")
    if not turn.is_in_plane_known:
        words.append(IN_PLANE_UNKNOWN)
    return "; ".join(words)


def turn_error_words(turn: ShownTurn | None) -> str:
    """Give the error of a turn in short: of z, and of the turn about it."""
    if turn is None:
        return "unknown"
    about = degrees(turn.in_plane_sd, 1) if turn.is_in_plane_known else "unknown"
    return f"z {degrees(turn.normal_sd, 1)}, in the plane {about}"


def push_lean_sentence(lean: PushLean | None) -> str:
    """State how far pushes next to the middle of a taxel lean its answer; empty unless it is certain."""
    if lean is None or abs(lean.value) < CERTAIN_LEAN_SDS * lean.sd:
        return ""
    way = "outward" if lean.value > 0 else "inward"
    return (
        f"A push 1 mm next to the middle of a taxel leans its answer {degrees(1e-3 * abs(lean.value), 1)} {way} "
        f"(sd {degrees(1e-3 * lean.sd, 1)}); the turns are corrected for it."
    )


def turn_gain_words(now: float, after: float) -> str:
    """Write the errors of a turn in the plane before and after a poke, rad, infinite while unknown; empty if it needs none."""
    if math.isnan(now):
        return ""
    if not after <= IN_PLANE_KNOWN_MAX_SD:
        return IN_PLANE_UNKNOWN
    return f"turn from {'unknown' if math.isinf(now) else _gain_degrees(now)} to {_gain_degrees(after)}"


def _gain_degrees(angle: float) -> str:
    return degrees(angle, 0 if angle >= MIN_ANGLE_WITHOUT_DECIMAL else 1)


def turn_difference_words(found: TurnDifferences, channel_name: Callable[[int], str]) -> str:
    """Make the sentence on the difference of two sets of turns; empty without a common taxel."""
    if not found.channels:
        return ""
    worst = found.channels[int(found.normals.argmax())]
    words = (
        f"z axes of {count(len(found.channels), 'taxel')} differ by {_median_and_largest(found.normals)}, {channel_name(worst)}"
    )
    known = np.flatnonzero(np.isfinite(found.in_plane))
    if known.size:
        worst = found.channels[int(known[found.in_plane[known].argmax()])]
        of = "the" if known.size == len(found.channels) else f"{known.size}"
        words += f"; {of} turns in the plane by {_median_and_largest(found.in_plane[known])}, {channel_name(worst)}"
    return f"Turns: {words}."


def _median_and_largest(angles: FloatArray) -> str:
    return f"{degrees(float(np.median(angles)), 1)} in the median, {degrees(float(angles.max()), 1)} at most"
