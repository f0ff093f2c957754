"""Times of messages without stamps that arrived in groups: by their count, as those of a device without a clock.

An adapter, a radio or a network hands on several readings at a time. Their arrivals at the recorder lie close together, with
long steps in between, which look like gaps. A device that keeps a pace is dated by its count (`IndexClock`): each reading one
period after the last, as the least delayed arrivals allow. A stream without a pace stays as it arrived, such as one of changes.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry import FloatArray
from skincal.streams.clocks import IndexClock

STEPS_PER_PACE = 64
"""Steps over which the pace is measured: many groups, and a part of a second at 100 Hz."""
GROUPED_MIN_SHARE = 0.2
"""Share of steps below half a period, from which readings come in groups; half of the steps are in pairs."""
LEAST_DELAY_KNOWN_AFTER_S = 2.0
"""s of readings; some groups, and several buckets of the clock."""
PAUSE_MIN_GROUP_STEPS = 3.0
"""A longer step than this many usual ones between two groups is a pause of the stream: the count starts again after it."""
LATE_MAX_GROUP_STEPS = 1.5
"""Delays of a stream that keeps its pace: those of a whole group, and some jitter. One step in twenty may be later."""


def space_evenly(arrivals: FloatArray) -> tuple[FloatArray, float] | None:
    """Date readings by their count if they arrived in groups, at a steady pace.

    Parameters
    ----------
    arrivals : (n,) s; a step back is a clock that was set

    Returns
    -------
    (n,) s, and the period in seconds; `None` if they stay as they arrived
    """
    if len(arrivals) < 2 * STEPS_PER_PACE:
        return None
    steps = np.diff(arrivals)
    period = float(np.median(arrivals[STEPS_PER_PACE:] - arrivals[:-STEPS_PER_PACE])) / STEPS_PER_PACE
    if period <= 0 or np.mean(steps < period / 2) < GROUPED_MIN_SHARE:
        return None
    group_step = float(np.median(steps[steps > period])) if (steps > period).any() else period
    cuts = np.flatnonzero((steps < 0) | (steps > PAUSE_MIN_GROUP_STEPS * group_step)) + 1
    parts = np.split(arrivals, cuts)
    longest = max(parts, key=len)
    if len(longest) < 2 * STEPS_PER_PACE:
        return None
    period = float(longest[-1] - longest[0]) / (len(longest) - 1)
    times = np.concatenate([_count(part, period) for part in parts])
    late = np.quantile(arrivals - times, 0.95)
    return None if late > LATE_MAX_GROUP_STEPS * group_step else (times, period)


def _count(arrivals: FloatArray, period: float) -> FloatArray:
    clock = IndexClock(period)
    times = np.maximum.accumulate([clock.map(arrival) for arrival in arrivals.tolist()])
    # The first readings come before the least delay is known.
    known = min(round(LEAST_DELAY_KNOWN_AFTER_S / period), len(times) - 1)
    times[:known] = times[known] - period * np.arange(known, 0, -1)
    return times
