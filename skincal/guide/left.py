"""How many pokes are left, foretold from what each taxel still needs: to plan a break by; nothing follows from it."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.guide.settings import GuideSettings
from skincal.readings import FloatArray, IntArray

BoolArray: TypeAlias = NDArray[np.bool_]

MOVES = 0.0042
"""m, sd of what one poke says of a taxel in each direction, hand and sensor together: the n-th moves it by this over n. From
guided sessions of the standard study, as the next one."""
HITS = 0.6
"""Share of the pokes that are own pokes of the taxel asked for; the others are a neighbour's, which may be done."""
BALANCING = 2
"""Own pokes that it takes to balance a taxel's contacts."""
PAUSE_S = 30.0
"""s. A longer time between two pokes is a pause, not work."""
RECENT = 20
"""Pokes whose pace counts."""


def pokes_left(
    open_: BoolArray, own: IntArray, rms: FloatArray, beside: FloatArray, moved: FloatArray, settings: GuideSettings
) -> int:
    """Return how many pokes it takes until nothing is open.

    Parameters
    ----------
    open_ : (n,) which taxels need something and are not given up
    own : (n,) pokes of their own
    rms : (n,) float, metres, predicted; infinite while unknown
    beside : (n,) float, metres, of the middle of their contacts
    moved : (n,) float, metres, by the last poke of their own
    """
    pokes, wanted = np.minimum(own, settings.patience - 1), settings.own_pokes - own
    # The variance falls as one over the pokes.
    error = np.where(np.isfinite(rms), rms, settings.wanted)
    exact = np.ceil(np.maximum(pokes, 1) * ((error / settings.wanted) ** 2 - 1.0))
    balance = np.where((beside > settings.balance) & (pokes > 0), BALANCING, 0)
    first = np.maximum.reduce([wanted, exact, balance, np.zeros(len(own))])
    unsettled = (first > 0) | ~(moved <= settings.settled)
    then = np.minimum(pokes + first, settings.patience).astype(np.int64)
    each = first + np.where(unsettled, _settling(settings)[then], 0.0)
    share = float(open_.mean()) if len(open_) else 0.0
    return int(np.ceil(float(np.minimum(each, settings.patience - pokes)[open_].sum()) / (HITS + (1.0 - HITS) * share)))


def module_pokes_left(open_: BoolArray, modules: IntArray, own: IntArray, rms: FloatArray, settings: GuideSettings) -> int:
    """Return how many pokes it takes until no module is open, by the modules method.

    Parameters
    ----------
    modules : (n,) of each taxel
    own : (n,) pokes of its module
    """
    count = 0
    for module in np.unique(modules[open_]).tolist():
        taxels = modules == module
        pokes, error = int(own[taxels].max()), float(np.max(np.where(np.isfinite(rms[taxels]), rms[taxels], 0.0)))
        # The variance falls as one over the pokes.
        exact = int(np.ceil(max(pokes, 1) * ((error / settings.wanted) ** 2 - 1.0)))
        count += max(settings.module_pokes - pokes, exact, 1)
    return count


def _settling(settings: GuideSettings) -> FloatArray:
    """Return for each number of own pokes how many more it takes until one of them moves the taxel little enough."""
    after = np.zeros(settings.patience + 1)
    for pokes in range(settings.patience - 1, -1, -1):
        moved = MOVES / (pokes + 1)
        unsettled = float(np.exp(-0.5 * (settings.settled / moved) ** 2))
        after[pokes] = unsettled * (1.0 + after[pokes + 1])
    return after


def pace(times: FloatArray) -> float | None:
    """Return the seconds between two pokes, the median of the last ones without pauses; None before the third poke.

    Parameters
    ----------
    times : (n,) float, seconds, ascending: when each poke began
    """
    steps = np.diff(times[-RECENT - 1 :])
    steps = steps[steps <= PAUSE_S]
    return float(np.median(steps)) if len(steps) >= 2 else None


def worked(begins: FloatArray, ends: FloatArray) -> float:
    """Return how long it took, seconds, from the first poke's begin to the last one's end, without pauses."""
    if not len(begins):
        return 0.0
    waits = begins[1:] - ends[:-1]
    return float(np.sum(ends - begins) + np.sum(waits[waits <= PAUSE_S]))
