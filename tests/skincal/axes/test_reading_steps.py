"""Steps of readings: found from rounded values, and the error that readings of one taxel share."""

import numpy as np
import pytest

from skincal.axes.reading_steps import common_variance, find_step


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.018])
def test_rounded_pushes_show_their_step(noise):
    """Means of 15 frames, each rounded to 0.1."""
    rng = np.random.default_rng(1)
    true = rng.uniform(1.6, 3.2, 300)
    frames = true + noise * rng.normal(size=(15, 300))
    found = find_step([-np.mean(np.rint(frames / 0.1) * 0.1, axis=0)])
    assert found == pytest.approx(0.1, rel=0.01)


def test_continuous_pushes_have_none():
    rng = np.random.default_rng(2)
    for count in (1, 2, 30, 600):
        assert find_step([-rng.uniform(1.6, 3.2, count)]) == 0.0
    assert find_step([np.full(20, -2.0)]) == find_step([]) == 0.0


def alike(seed, taxels, scatter):
    """Make the readings of taxels with a gain of their own each, by 20 pushes of nearly the same force."""
    rng = np.random.default_rng(seed)
    return [-6.0 * gain * (1.0 + scatter * rng.normal(size=20)) for gain in rng.uniform(0.25, 0.5, taxels)]


@pytest.mark.parametrize("taxels", [1, 2, 3, 5, 8, 12])
@pytest.mark.parametrize("scatter", [0.001, 0.003, 0.01, 0.03])
def test_pushes_that_are_alike_show_no_step_by_chance(taxels, scatter):
    """Before, half of such skins had one, and their errors were predicted up to twelve times too large."""
    assert [find_step(alike(seed, taxels, scatter)) for seed in range(20)] == [0.0] * 20


@pytest.mark.parametrize("scatter", [0.001, 0.03])
def test_pushes_that_are_alike_on_many_taxels_show_their_step(scatter):
    found = [find_step([np.rint(own / 0.1) * 0.1 for own in alike(seed, 12, scatter)]) for seed in range(20)]
    assert found == pytest.approx([0.1] * 20, rel=0.025), "four steps are tried for each of the 5 to 15 in the span"


@pytest.mark.parametrize("scatter", [0.0, 0.01, 0.02, 0.03])
def test_the_common_error_is_that_of_rounding_values_with_this_scatter(scatter):
    """The constant part for a small scatter, that which grows with the value for a larger one."""
    rng = np.random.default_rng(3)
    constant, growing, expected = [], [], []
    for _ in range(400):
        normal = rng.normal(size=(400, 3))
        true = rng.uniform(-1.0, 1.0, 3) + scatter * normal
        error = np.rint(true / 0.1) * 0.1 - true
        constant.append(np.mean(error[:, :2], axis=0))
        growing.append(np.mean((error * normal)[:, :2], axis=0))
        expected.append(common_variance(true, 0.1))
    found = max(np.mean(np.square(constant)), np.mean(np.square(growing)))
    # A mean of 400 errors with a variance of at most 0.1^2/12 is not 0.
    assert found == pytest.approx(np.mean(expected), rel=0.15, abs=0.1**2 / 12 / 400)
    assert np.mean(expected) > 0.04 * 0.1**2 / 12
