"""Messages that arrived in groups get the times at which a device with a steady pace made them."""

import numpy as np
import pytest

from skincal.files.importers.even_times import space_evenly

PERIOD = 0.02
COUNT = 3000


def in_groups(made, size, first=0):
    """Arrivals of readings of a buffer that hands on `size` of them, 1 ms apart, when the last one came."""
    arrivals = made.copy()
    for begin in range(-first, len(made), size):
        end = min(begin + size, len(made))
        group = np.arange(max(begin, 0), end)
        arrivals[group] = made[end - 1] + 0.001 * np.arange(len(group))
    return arrivals


@pytest.mark.parametrize("size", [2, 3, 5, 10, 25])
@pytest.mark.parametrize("first", [0, 1])
def test_groups_of_a_steady_device_are_spaced_evenly(size, first):
    made = 100.0 + PERIOD * np.arange(COUNT)
    found = space_evenly(in_groups(made, size, first))
    assert found is not None
    times, period = found
    assert period == pytest.approx(PERIOD, rel=0.05)
    late = times - made
    # Up to a constant delay. The last group may be cut.
    assert np.ptp(late[:-size]) < (0.1 * PERIOD + 0.001 if size <= 5 else PERIOD)


def test_a_timer_of_16_ms_and_a_clock_that_is_set_back():
    made = 0.005 * np.arange(4000)
    arrivals = np.ceil(made / 0.016 + 1e-9) * 0.016
    times, period = space_evenly(np.r_[arrivals + 50, arrivals + 20])
    assert period == pytest.approx(0.005, rel=0.02)
    for part, begin in ((times[:4000], 50), (times[4000:], 20)):
        assert np.ptp(part - made) < 0.003
        assert part[-1] == pytest.approx(made[-1] + begin, abs=0.02)


def test_a_lost_reading_and_a_pause_do_not_shift_the_rest():
    made = np.delete(PERIOD * np.arange(COUNT), [500, 1001])
    made[2000:] += 7.3
    times, _ = space_evenly(in_groups(made, 2))
    late = times - made
    settled = np.r_[late[:480], late[560:980], late[1060:1990], late[2000:]]
    assert np.ptp(settled) < PERIOD + 0.002
    assert np.abs(late).max() < 2 * PERIOD


@pytest.mark.parametrize(
    "arrivals",
    [
        PERIOD * np.arange(COUNT),
        PERIOD * np.arange(COUNT) + np.random.default_rng(1).uniform(0, 0.008, COUNT),
        PERIOD * np.arange(50) // 0.1,
        # Of changes only: fast while something moves, and long rests of any length.
        np.cumsum(np.where(np.arange(COUNT) % 40, 0.01, np.random.default_rng(2).uniform(0.3, 3.0, COUNT))),
    ],
    ids=["steady", "jitter", "few", "changes"],
)
def test_other_streams_stay_as_they_arrived(arrivals):
    assert space_evenly(np.sort(arrivals)) is None
