"""Quiet windows, baselines and noise."""

import numpy as np
import pytest

from skincal.contacts.tare import Tare, TareKeeper, is_quiet, robust_level, window_length, wrench_baseline
from skincal.model.readings import Sample
from skincal.model.scene import ContactSettings
from tests.skincal.poke_script import PERIOD_S


def _samples(wrench, skin=None, start=50.0):
    skin = np.zeros((len(wrench), 3)) if skin is None else skin
    return [
        Sample(start + k * PERIOD_S, values, w, 20, saturated=False)
        for k, (w, values) in enumerate(zip(wrench, skin, strict=True))
    ]


def _feed(keeper, samples):
    return [tare for tare in (keeper.feed(sample, PERIOD_S) for sample in samples) if tare is not None]


def test_the_level_is_the_median_and_the_sd_that_of_a_normal_distribution():
    values = np.random.default_rng(2).normal(7.0, 2.0, (4001, 5))
    values[::50] = 1e6  # outliers do not move it
    median, sd = robust_level(values)
    np.testing.assert_allclose(median, np.median(values, axis=0), rtol=1e-12)
    np.testing.assert_allclose(sd, 2.0, rtol=0.1)


def test_nan_is_left_out_of_the_level_and_a_channel_without_numbers_has_none():
    values = np.array([[1.0, np.nan, np.nan], [2.0, 5.0, np.nan], [3.0, np.nan, np.nan], [4.0, 7.0, np.nan]])
    median, sd = robust_level(values)
    assert median[:2].tolist() == [2.5, 6.0]
    assert np.isnan(median[2])
    assert np.isnan(sd[2])


def test_the_baseline_is_linear_in_time_between_two_tares():
    before = Tare(10.0, 9.9, 10.1, np.zeros(6), np.zeros(1))
    after = Tare(14.0, 13.9, 14.1, np.arange(6.0) * 4, np.zeros(1))
    np.testing.assert_allclose(wrench_baseline(before, after, 11.0), np.arange(6.0))
    np.testing.assert_array_equal(wrench_baseline(before, None, 11.0), before.wrench)


def test_a_tare_is_the_mean_of_ten_frames_at_their_mean_time():
    rng = np.random.default_rng(3)
    samples = _samples(rng.normal(0, 0.01, (15, 6)) + 5.0)
    (tare,) = _feed(TareKeeper(ContactSettings(), 3), samples)
    np.testing.assert_allclose(tare.wrench, np.mean([s.wrench for s in samples[:10]], axis=0))
    assert tare.time_s == pytest.approx(np.mean([s.host_s for s in samples[:10]]), abs=1e-12)


def test_nothing_is_quiet_while_the_force_moves():
    rest = np.random.default_rng(4).normal(0, 0.1, (15, 3))
    assert is_quiet(rest[:10], rest[10:])
    ramp = np.outer(np.arange(15) * PERIOD_S, [0, 0, 3.0])
    assert not is_quiet(ramp[:10], ramp[10:])
    lifted = np.r_[np.zeros((10, 3)), np.full((5, 3), 0.5)]
    assert not is_quiet(lifted[:10], lifted[10:])
    shaking = np.outer((-1.0) ** np.arange(15), [0.5, 0.5, 0.5])
    assert not is_quiet(shaking[:10], shaking[10:])


def test_a_restless_start_gives_no_tare_and_the_quiet_after_it_gives_one():
    rng = np.random.default_rng(5)
    keeper = TareKeeper(ContactSettings(), 3)
    assert not _feed(keeper, _samples(rng.normal(0, 1.0, (200, 6))))
    assert _feed(keeper, _samples(rng.normal(0, 0.02, (16, 6)), start=60.0))


def test_a_window_is_as_long_as_the_device_is_fast_within_bounds():
    assert window_length(0.3, 0.02) == 15
    assert window_length(0.3, 0.2) == 4
    assert window_length(0.3, 1e-6) == window_length(0.3, 0.0) == 1024


def test_slow_drift_is_followed():
    drift = np.outer(np.arange(3000) * PERIOD_S, [0.05, 0, 0, 0, 0, 0])
    tares = _feed(TareKeeper(ContactSettings(), 3), _samples(drift))
    assert tares[-1].wrench[0] == pytest.approx(drift[-1, 0], abs=0.05)


def test_the_noise_settles_on_each_channels_own():
    rng = np.random.default_rng(6)
    keeper = TareKeeper(ContactSettings(), 3)
    skin = rng.normal(0, 1, (600, 3)) * [0.5, 2.0, 8.0]
    _feed(keeper, _samples(np.zeros((600, 6)), skin))
    np.testing.assert_allclose(keeper.noise, [0.5, 2.0, 8.0], rtol=0.35)


def test_the_tare_of_a_poke_ends_clear_of_the_touch():
    keeper = TareKeeper(ContactSettings(), 3)
    samples = _samples(np.zeros((200, 6)))
    _feed(keeper, samples)
    touch = samples[-1].host_s + PERIOD_S
    before = keeper.before(touch)
    assert before is not None
    assert touch - 0.4 <= before.end_s <= touch - 0.2
