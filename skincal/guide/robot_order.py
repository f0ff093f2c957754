"""Order of the targets of a robot by the free method: several tilts at one place in a row, then the nearest place.

A hand aims for each poke, and goes where a poke is worth most. A robot loses time by travel. Once the sweep is over it makes
the first own pokes of a taxel in one visit. Further pokes are later visits, when the neighbours are better known. A taxel that
never answers is visited last. The other methods need no tilts, and their rounds have short ways already.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.guide.progress import GuideSettings


@dataclass(frozen=True, slots=True)
class RobotPace:
    """Travel speed of a robot that pokes, and its time for a poke."""

    speed: float
    """m/s, between two places."""
    poke_s: float
    """s, for a poke without the way to its place."""


def travel_seconds(ways: FloatArray, pace: RobotPace | None, settings: GuideSettings) -> FloatArray:
    """Compute (m,) the seconds until a hand, or a robot of that pace, has poked at places `ways` (m,) metres away."""
    if pace is None:
        return settings.poke_s + ways / settings.hand_speed
    return pace.poke_s + ways / pace.speed


def nearest_open_taxel(rows: IntArray, seconds: FloatArray, asked: IntArray, own: IntArray, in_a_row: int) -> int:
    """Choose the nearest of the taxels `rows` (m,) that have had the fewest visits.

    Parameters
    ----------
    seconds : (m,) until the robot has poked there
    asked, own : (n,) targets at each taxel, with those that failed, and own pokes
    in_a_row : own pokes of the first visit; each later one is a visit of its own
    """
    first = _fewest(_visits(asked, own, in_a_row)[rows])
    return int(rows[first[seconds[first].argmin()]])


def _visits(asked: IntArray | FloatArray, own: IntArray | FloatArray, in_a_row: int) -> IntArray:
    # A first miss is repeated at once, since the aim may have been off; each later one counts as a visit.
    return (np.maximum(own - in_a_row + 1, 0) + np.maximum(asked - own - 1, 0)).astype(np.int64)


def _fewest(visits: IntArray) -> IntArray:
    return np.flatnonzero(visits == visits.min())
