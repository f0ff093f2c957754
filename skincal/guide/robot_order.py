"""Order of the targets of a robot: by travel, and all pokes of a place in a row.

A hand visits all taxels in turn. A robot makes the first pokes of a taxel or a module in one visit, each with another
tilt where tilt helps. Then it goes to the nearest one that is open. Further pokes are later visits, when the neighbours are
better known. A taxel that never answers is visited last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.guide.progress import GuideSettings


@dataclass(frozen=True, slots=True)
class RobotPace:
    """Speed of a robot that pokes."""

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


def nearest_open_module(
    rows: IntArray,
    seconds: FloatArray,
    asked: IntArray,
    own: IntArray,
    in_a_row: int,
    modules: IntArray,
    places: FloatArray,
) -> int:
    """Choose a taxel of the nearest module with the fewest visits: the one farthest from the poked ones of its module.

    Parameters
    ----------
    seconds, asked, own, in_a_row : as for `nearest_open_taxel`; the visits are those of a module
    modules : (n,) index of each taxel's module, from 0
    places : (n, 3) float, metres, believed; NaN if unknown
    """
    of_module = _visits(np.bincount(modules, asked), np.bincount(modules, own), in_a_row)
    first = _fewest(of_module[modules[rows]])
    module = modules[rows[first[seconds[first].argmin()]]]
    here = first[modules[rows[first]] == module]
    here = here[_fewest(np.maximum(own, asked - 1)[rows[here]])]
    poked = (modules == module) & (own > own[rows[here[0]]]) & np.isfinite(places).all(axis=1)
    if not poked.any():
        return int(rows[here[seconds[here].argmin()]])
    off = places[rows[here], None] - places[poked]
    return int(rows[here[np.sum(off * off, axis=2).min(axis=1).argmax()]])


def _visits(asked: IntArray | FloatArray, own: IntArray | FloatArray, in_a_row: int) -> IntArray:
    # A first miss is repeated at once, since the aim may have been off; each later one counts as a visit.
    return (np.maximum(own - in_a_row + 1, 0) + np.maximum(asked - own - 1, 0)).astype(np.int64)


def _fewest(visits: IntArray) -> IntArray:
    return np.flatnonzero(visits == visits.min())
