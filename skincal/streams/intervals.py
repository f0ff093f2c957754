"""Usual time between the readings of a stream, also of one whose readings come in groups.

A buffer of an adapter, a radio or a network hands on two or more readings at a time. If these are dated by their arrival, short
and long intervals alternate, and the median is one of them, but never the period. Lost readings make intervals longer, too, but
rarely: at least `GROUPS_MIN_LONG_INTERVALS` of the newest intervals are long in a stream with groups.
"""

from __future__ import annotations

from collections.abc import Collection
from statistics import fmean, median

GROUPS_MIN_LONG_INTERVALS = 3
"""Long intervals among the newest, from which the readings come in groups: every fifth of 15."""
GROUPS_MIN_LONG_OVER_SHORT = 3.0
"""Ratio of a long interval to a short one. Below it, no interval is taken for a gap."""


def usual_interval(intervals: Collection[float]) -> float:
    """Compute the period of a stream from its newest intervals, seconds: their median, or their mean if they come in groups."""
    return fmean(intervals) if longest_interval_of_groups(intervals) else median(intervals)


def longest_interval_of_groups(intervals: Collection[float]) -> float:
    """Find the usual time between two groups of readings, seconds; 0 if the readings do not come in groups."""
    if len(intervals) <= GROUPS_MIN_LONG_INTERVALS:
        return 0.0
    ordered = sorted(intervals)
    short, long = ordered[len(ordered) // 4], ordered[-GROUPS_MIN_LONG_INTERVALS]
    return long if long > GROUPS_MIN_LONG_OVER_SHORT * short else 0.0
