"""Device time to host time: against the truth of simulated arrivals, and for clocks that jump."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from skincal.devices.decoding import NO_SEQ
from skincal.model.readings import Batch, Stream
from skincal.streams.clocks import (
    CLOCK_BEHIND_MAX_S,
    CLOCK_FIT_WINDOW_S,
    ConvexHullClock,
    IndexClock,
    Timestamper,
    lower_hull,
    supporting_line,
)

SETTLED_S = 10.0


def run(clock, *columns):
    return np.array([clock.map(*row) for row in zip(*(column.tolist() for column in columns), strict=True)])


def arrivals(made_s, least_s, timer_s, rng, *, stalls=False):
    """Arrival stamps: a constant least delay, an adapter that hands on when its timer runs out, and a busy program."""
    ready = made_s + least_s
    if timer_s:
        ticks = np.cumsum(timer_s + np.abs(rng.normal(0, 50e-6, int(2 * (made_s[-1] - made_s[0]) / timer_s))))
        ticks += made_s[0] - timer_s
        ready = ticks[np.searchsorted(ticks, ready)]
    if stalls:
        for begin, length in zip(rng.uniform(made_s[0], made_s[-1], 120), rng.exponential(0.04, 120), strict=True):
            ready = np.where((ready > begin) & (ready < begin + length), begin + length, ready)
    return np.maximum.accumulate(ready + rng.exponential(30e-6, len(ready)))


@pytest.mark.parametrize(
    ("name", "rate", "timer_s", "drift", "least_s", "stalls"),
    [
        ("F/T 1 kHz, adapter's timer 16 ms", 1000, 0.016, 20e-6, 0.0005, False),
        ("F/T 1 kHz, adapter's timer 1 ms, stalls", 1000, 0.001, 20e-6, 0.0005, True),
        ("F/T 100 Hz, timer 16 ms", 100, 0.016, -50e-6, 0.009, False),
        ("skin 50 Hz, clock off by 2000 ppm, stalls", 50, 0.0, -2000e-6, 0.004, True),
    ],
)
def test_jitter_is_removed_and_the_least_delay_remains(name, rate, timer_s, drift, least_s, stalls):
    """Bias beyond the least delay < 1 ms and sd < 0.1 ms, where arrival has a sd of milliseconds."""
    rng = np.random.default_rng(7)
    made = 5000.0 + np.arange(60 * rate) / rate + rng.uniform(0, 1e-5, 60 * rate)
    device = 3.0 + (made - made[0]) * (1 + drift)
    arrival = arrivals(made, least_s, timer_s, rng, stalls=stalls)
    clock = ConvexHullClock()
    mapped = run(clock, device, arrival)
    assert (mapped <= arrival + 1e-9).all()
    settled = made > made[0] + SETTLED_S
    error = (mapped - made - least_s)[settled]
    raw = (arrival - made - least_s)[settled]
    assert raw.std() > 4e-3, name
    assert 0 <= error.mean() < 1e-3, name
    assert error.std() < 1e-4, name


def test_device_without_a_clock_is_dated_by_its_count():
    rng = np.random.default_rng(3)
    made = 100 + np.arange(60 * 50) * 0.02
    arrival = arrivals(made, 0.002, 0.016, rng)
    clock = IndexClock()
    mapped = run(clock, arrival)
    error = (mapped - made)[made > 100 + SETTLED_S]
    assert 0.002 <= error.mean() < 0.0035
    assert error.std() < 2e-4


def test_count_without_a_clock_recovers_from_a_lost_reading():
    rng = np.random.default_rng(4)
    made = np.delete(100 + np.arange(60 * 50) * 0.02, [900, 901, 902, 1500])
    arrival = arrivals(made, 0.002, 0.0, rng)
    clock = IndexClock()
    mapped = run(clock, arrival)
    error = np.abs(mapped - made - 0.002)[150:]
    assert np.count_nonzero(error > 0.003) < 60  # a bucket of early stamps after each loss, no more
    assert np.median(error) < 5e-4
    assert np.max(error[-500:]) < 5e-4


@pytest.mark.parametrize("rate", [100, 1000])
def test_readings_that_a_stall_held_up_are_dated_apart(rate):
    """A Robotiq's stream has neither clock nor number; what a busy program reads together was not made together."""
    rng = np.random.default_rng(6)
    made = 100 + np.arange(60 * rate) / rate
    arrival, begin = made + 0.001, 104.0
    while begin < 160.0:
        end = begin + rng.uniform(0.1, 0.6)
        arrival = np.where((arrival > begin) & (arrival < end), end, arrival)
        begin = end + rng.exponential(0.2)
    clock = IndexClock()
    mapped = run(clock, arrival)
    assert np.diff(mapped).max() < 0.04, "no hole in which a skin frame finds no wrench"
    assert np.abs(mapped - made - 0.001).max() < 0.05


def test_reported_loss_is_taken_up_at_once():
    made = np.delete(100 + np.arange(60 * 50) * 0.02, [900])
    clock = IndexClock()
    mapped = []
    for i, y in enumerate((made + 0.002).tolist()):
        if i == 900:
            clock.note_loss()
        mapped.append(clock.map(y))
    np.testing.assert_allclose(mapped[200:], made[200:] + 0.002, atol=1e-3)


def test_device_that_keeps_no_pace_is_dated_by_arrival():
    rng = np.random.default_rng(5)
    made = 100 + np.cumsum(rng.exponential(0.02, 3000))
    clock = IndexClock()
    mapped = run(clock, made + 0.001)
    assert np.quantile(np.abs(mapped - made - 0.001), 0.9) < 0.25
    assert (mapped <= made + 0.001 + 1e-9).all()


def stamped(stream, device):
    none = np.zeros(len(device), bool)
    return Batch(stream, np.full(len(device), -1), device, np.zeros((len(device), 1)), none, none)


HOST = 10 + np.arange(4000) * 0.01
LATE = np.arange(4000) >= 2000
SMALL_STEP_BACK = HOST - np.where(np.arange(4000) % 20 == 1, 0.015, 0.0)


@pytest.mark.parametrize(
    ("device", "arrival", "made"),
    [
        (np.where(LATE, HOST - HOST[2000] + 0.3, 500 + HOST), HOST, HOST),
        (HOST + np.where(LATE, 700.0, 0.0), HOST, HOST),
        (HOST, np.where(LATE & (HOST[2150] > HOST), HOST[2150], HOST), HOST),
        (SMALL_STEP_BACK, HOST, SMALL_STEP_BACK),
    ],
    ids=["the device restarts", "its clock is set forward", "the program stalls for 1.5 s", "records of one board step back"],
)
def test_jumps_are_followed_at_once_and_stalls_and_small_steps_are_none(device, arrival, made):
    np.testing.assert_allclose(run(ConvexHullClock(), device, arrival), made, atol=1e-9)


def test_clock_that_lost_time_is_followed_after_a_while():
    """The device slept for 5 s of which its clock knows nothing: its stamps run on."""
    device = 10 + np.arange(4000) * 0.01
    host = device + np.where(np.arange(4000) < 2000, 0, 5.0)
    mapped = run(ConvexHullClock(), device, host)
    late = host[2000:] > host[2000] + CLOCK_BEHIND_MAX_S + 0.1
    np.testing.assert_allclose(mapped[2000:][late], host[2000:][late], atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 60), st.floats(0, 0.05)), min_size=2, max_size=40))
def test_supporting_line_is_the_optimum_of_the_linear_program(points):
    """Minimise sum(y - a - b x) with a + b x <= y and the slope held: solved by another route."""
    xy = sorted((x, x + d) for x, d in points)
    x, y = np.array(xy).T
    offset, slope = supporting_line(xy, lower_hull(xy), 0.02)
    assert (offset + slope * x <= y + 1e-9).all()
    best = linprog([-len(x), -x.sum()], np.column_stack([np.ones_like(x), x]), y, bounds=[(None, None), (0.98, 1.02)])
    if best.success:
        assert offset + slope * x.mean() >= -best.fun / len(x) - 1e-6


@given(st.lists(st.integers(0, 3), min_size=1, max_size=80), st.lists(st.integers(0, 3), min_size=80, max_size=80))
def test_a_hull_that_goes_on_is_that_of_all_points(delays, drops):
    """Among few delays, so that many points lie on one line: the same corners, rounding and all."""
    points, known = [], []
    for at, (delay, drop) in enumerate(zip(delays, drops, strict=False)):
        points = [*points[1 if drop else 0 :], (at * 0.25, at * 0.25 + delay * 2.4e-7)]
        known = lower_hull(points, known)
        assert known == lower_hull(points)


def test_memory_and_work_stay_flat():
    clock = ConvexHullClock()
    for i in range(30_000):
        clock.map(i * 0.01, i * 0.01 + 0.001 * (i % 7))
    assert len(clock._points) <= CLOCK_FIT_WINDOW_S / 0.25 + 2


def test_stamps_of_a_stream_always_rise():
    rng = np.random.default_rng(1)
    stamper = Timestamper()
    last = -np.inf
    for i in range(2000):
        device = i * 0.02 + np.array([0.0, 0.005, 0.004])
        if i % 500 == 499:
            stamper.reset_clocks()
        stamps = stamper.stamp(stamped(Stream.SKIN, device), i * 0.02 + rng.exponential(0.05))
        assert stamps[0] > last
        assert (np.diff(stamps) > 0).all()
        last = stamps[-1]


def test_streams_of_one_board_share_its_clock():
    """The wrench arrives promptly, the skin through a slow queue: both stamps are of the same line."""
    stamper = Timestamper()
    for i in range(2000):
        t = i * 0.01
        (wrench,) = stamper.stamp(stamped(Stream.WRENCH, np.array([t])), t + 0.001)
        (skin,) = stamper.stamp(stamped(Stream.SKIN, np.array([t])), t + 0.031)
    assert wrench == pytest.approx(t + 0.001, abs=1e-9)
    assert skin == pytest.approx(t + 0.001, abs=1e-9)


@pytest.mark.parametrize("delay_after", [0.0, 0.004, 0.02])
@pytest.mark.parametrize("pause", [59.9, 61.0, 4000.0])
def test_a_device_that_was_silent_for_longer_than_the_window_is_dated_on(pause, delay_after):
    clock = ConvexHullClock()
    for k in range(100):
        clock.map(k * 0.02, 10.0 + k * 0.02)
    later = 2.0 + pause
    first = clock.map(later, 10.0 + later + delay_after)
    assert 10.0 + later - 1e-9 <= first <= 10.0 + later + delay_after + 1e-9
    for k in range(1, 200):
        made = clock.map(later + k * 0.02, 10.0 + later + k * 0.02)
    assert made == pytest.approx(10.0 + later + 199 * 0.02, abs=1e-6)


def test_numbered_device_tells_a_late_reading_from_a_lost_one():
    """Late by 60 ms for a second: without numbers that looks like a loss, and the readings after it like any others."""
    made = np.delete(100 + np.arange(60 * 1000) * 0.001, np.arange(20_000, 20_700))
    arrival = np.maximum.accumulate(made + 0.002 + 0.06 * (made % 5.0 > 4.0))
    numbers = np.round((made - 100) * 1000).astype(int)
    clock = IndexClock()
    mapped = run(clock, arrival, numbers)
    np.testing.assert_allclose(mapped[3000:], made[3000:] + 0.002, atol=1e-3)


def test_device_that_numbers_anew_is_dated_at_once():
    made = np.delete(100 + np.arange(20 * 1000) * 0.001, np.arange(9000, 10_200))
    numbers = np.where(made < 109, 5000 + np.arange(len(made)), np.arange(len(made)) - 9000)
    clock = IndexClock()
    mapped = run(clock, made + 0.002, numbers)
    np.testing.assert_allclose(mapped, made + 0.002, atol=1e-6)


def test_numbered_device_whose_pace_is_halved_is_followed_in_the_end():
    made = 100 + np.cumsum(np.where(np.arange(40_000) < 10_000, 0.001, 0.002))
    clock = IndexClock()
    mapped = run(clock, made + 0.002, np.arange(len(made)))
    np.testing.assert_allclose(mapped[made > 135.0], made[made > 135.0] + 0.002, atol=1e-3)


@pytest.mark.parametrize("seed", range(12))
def test_a_clock_maps_many_readings_as_one_after_the_other(seed):
    rng = np.random.default_rng(seed)
    count = 1200
    device = 100 + np.arange(count) * rng.choice([0.001, 0.01, 0.02]) * (1 + 1e-3 * rng.normal())
    arrival = np.repeat(device[::10] + 0.02 + rng.exponential(0.004, count // 10), 10)
    device[rng.integers(count) :] -= [0.0, 0.3, 0.6, -0.7, 5.0, -8.0][seed % 6]
    arrival = np.maximum.accumulate(arrival + np.where(np.arange(count) > rng.integers(count), [0.0, 4.0][seed % 2], 0.0))
    alone, together = ConvexHullClock(), ConvexHullClock()
    known = [alone.map(*reading) for reading in zip(device.tolist(), arrival.tolist(), strict=True)]
    cuts = [0, *sorted(rng.integers(0, count, 5).tolist()), count]
    made = [together.map_many(device[a:b], arrival[a:b]) for a, b in pairwise(cuts)]
    assert np.concatenate(made).tolist() == known
    assert together.jumps == alone.jumps


@pytest.mark.parametrize("seed", range(10))
def test_counts_map_many_readings_as_one_after_the_other(seed):
    """With losses, restarts of the numbers, pauses, another pace, and without numbers."""
    rng = np.random.default_rng(seed)
    count = 6000
    numbers, made = 7 + np.arange(count), 100 + np.arange(count) * 0.001
    at = 2500 if seed % 5 == 2 else int(rng.integers(2500, count))  # a pause is believed after three seconds
    numbers[at:] += [0, 40, 0, -at, 0][seed % 5]
    made[at:] += [0.0, 0.04, 5.0, 0.0, 0.001 * np.arange(count - at)][seed % 5]
    numbers = np.full(count, NO_SEQ) if seed == 9 else numbers
    arrival = np.repeat((made + 0.002 + rng.exponential(0.004, count))[9::10], 10)
    alone, together = IndexClock(), IndexClock()
    known = [alone.map(*reading) for reading in zip(arrival.tolist(), numbers.tolist(), strict=True)]
    cuts = [0, *sorted(rng.integers(0, count, 9).tolist()), count]
    mapped = [together.map_many(arrival[a:b], numbers[a:b]) for a, b in pairwise(cuts) if a < b]
    assert np.concatenate(mapped).tolist() == known
    assert repr(vars(together._hull)) == repr(vars(alone._hull))
    assert {**vars(together), "_hull": None} == {**vars(alone), "_hull": None}
