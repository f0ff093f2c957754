"""The period of a stream, whose readings may come in groups or be lost."""

import numpy as np
import pytest

from skincal.streams.intervals import longest_interval_of_groups, usual_interval

COUNT = 15


@pytest.mark.parametrize("size", [2, 3, 4, 5])
def test_groups_do_not_shorten_the_period(size):
    """Groups of readings 1 ms apart, of a stream of 50 Hz, from every place in a group."""
    steps = np.tile(np.r_[np.full(size - 1, 0.001), 0.02 * size - 0.001 * (size - 1)], 20)
    for first in range(size):
        intervals = steps[first : first + COUNT]
        assert usual_interval(intervals) == pytest.approx(0.02, rel=0.35)
        assert longest_interval_of_groups(intervals) == pytest.approx(steps.max())


@pytest.mark.parametrize("lost", [(), (3,), (3, 4), (0, 14)])
def test_lost_readings_do_not_lengthen_the_period(lost):
    intervals = np.full(COUNT, 0.02)
    intervals[list(lost)] = 1.0
    assert usual_interval(intervals) == 0.02
    assert longest_interval_of_groups(intervals) == 0.0


def test_jitter_is_no_group():
    intervals = 0.02 + np.random.default_rng(1).uniform(-0.008, 0.008, COUNT)
    assert usual_interval(intervals) == np.median(intervals)
    assert usual_interval([0.02]) == 0.02
