"""The ratio of gains that taxels share: its likelihood by another route, truth, and turns by pokes that hardly lean."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from skincal.axes.skin_turns import find_turns
from skincal.axes.turn_fit import AxisNoise, AxisPokes, fit_turn
from skincal.axes.usual_ratio import LEAN_SDS, LOG_RATIOS, log_likelihood_of_ratio
from skincal.geometry import rotation_by
from tests.skincal.axes.axis_support import FORCE_NOISE_N, make_pokes, random_rotation, turn_between

TAXELS = 24
TRUE_LOG_RATIO = np.log(0.6)


def skin(seed, lean, count, reading_noise, step=0.0):
    """Make pokes about an axis that is 3 degrees (sd) off the z of each taxel: axes and pokes, by channel."""
    rng = np.random.default_rng([seed, int(10 * lean), count])
    axes, pokes = {}, {}
    for channel in range(TAXELS):
        axes[channel] = random_rotation(rng)
        about = rotation_by(np.append(np.radians(3.0) * rng.normal(size=2), 0.0))
        made = make_pokes(rng, axes[channel], count, lean, reading_noise=reading_noise, about=about, step=step)
        pokes[channel] = AxisPokes(made.forces, made.readings, made.pokes + 1000 * channel)
    return axes, pokes


@cache
def true_and_found(seed, lean, reading_noise, step=0.0):
    """The axes of a skin by channel, and its turns by 20 pokes a taxel."""
    axes, pokes = skin(seed, lean, 20, reading_noise, step)
    return axes, find_turns(pokes, FORCE_NOISE_N)


def test_the_likelihood_is_that_of_normal_leans_with_any_turn_about_z():
    """By the density of the slopes about their mean, and a sum over turns and scatters of the leans."""
    rng = np.random.default_rng(1)
    axes, noise = np.eye(3), AxisNoise(0.05, 0.0, 0.02)
    made = make_pokes(rng, axes, 9, 3.0, reading_noise=0.04)
    forces = 5.0 * made.forces / np.linalg.norm(made.forces, axis=1)[:, None]
    pokes = AxisPokes(forces, made.readings, made.pokes)
    fit = fit_turn(pokes, noise)
    assert (fit.trust == 1.0).all()
    local = forces @ fit.rotation
    x, y = local[:, :2] / local[:, 2:], pokes.readings[:, :2] / pokes.readings[:, 2:]
    # Eight differences about the mean, by any orthogonal basis of them.
    basis = np.linalg.svd(np.eye(9) - 1.0 / 9.0)[0][:, :8].T
    z = np.concatenate([basis @ x, basis @ y], axis=1)
    s, k = (0.05 / 5.0) ** 2, 0.02**2
    logs, places = [], [27, 32, 38]
    for log_ratio in LOG_RATIOS[places]:
        rho, each = np.exp(log_ratio), []
        for v in LEAN_SDS**2:
            for turn in np.arange(64) * np.pi / 32.0:
                along, across = rho * v * np.cos(turn), rho * v * np.sin(turn)
                covariance = np.diag([v + s, v + s, rho**2 * v + k, rho**2 * v + k])
                covariance[:2, 2:] = [[along, across], [-across, along]]
                covariance[2:, :2] = covariance[:2, 2:].T
                each.append(multivariate_normal(np.zeros(4), covariance).logpdf(z).sum())
        logs.append(np.logaddexp.reduce(each))
    found = log_likelihood_of_ratio(pokes, fit, noise)[1, places]
    assert np.ptp(found) > 0.3
    assert np.diff(found) == pytest.approx(np.diff(logs), abs=0.05)


def test_pokes_that_lean_by_the_noise_of_the_force_give_the_true_ratio():
    """A mean of the taxels' own ratios, weighted by their expected errors, is too large by 0.09."""
    noises = [true_and_found(10 + seed, 2.0, 0.03)[1].noise for seed in range(6)]
    off = np.array([noise.log_ratio - TRUE_LOG_RATIO for noise in noises])
    sds = np.array([noise.log_ratio_sd for noise in noises])
    assert abs(off.mean()) < 0.06
    assert np.mean(off**2 / sds**2) < 2.0
    assert np.median(sds) < 0.15


@pytest.mark.parametrize("reading_noise", [0.0, 0.01, 0.03])
def test_straight_pokes_say_nothing_about_the_ratio(reading_noise):
    """Before, a skin with little noise had one that was up to four times too large, and normals outside their regions."""
    inside = []
    for seed in range(2):
        axes, pokes = skin(seed, 0.0, 20, reading_noise)
        turns = find_turns(pokes, FORCE_NOISE_N)
        assert turns.noise.log_ratio_sd > 0.35
        assert abs(turns.noise.log_ratio) < 1.5 * turns.noise.log_ratio_sd
        for channel, turn in turns.taxels.items():
            z = turn.fit.rotation.T @ axes[channel][:, 2]
            off = np.array([-z[1], z[0]])
            inside.append(off @ np.linalg.solve(turn.fit.covariance[:2, :2], off) < chi2.ppf(0.95, 2))
    assert np.mean(inside) >= 0.90


def test_one_taxel_has_no_ratio_of_others():
    noise = find_turns({7: skin(1, 15.0, 20, 0.03)[1][7]}, FORCE_NOISE_N).noise
    assert (noise.log_ratio, noise.log_ratio_sd) == (0.0, 0.7)


@pytest.mark.parametrize(
    ("lean", "reading_noise", "step", "seeds"),
    [(2.0, 0.03, 0.0, 6), (2.0, 0.05, 0.0, 6), (2.0, 0.005, 0.1, 6), (5.0, 0.03, 0.0, 10), (15.0, 0.03, 0.0, 4)],
)
def test_true_turns_are_inside_the_95_percent_regions_of_a_skin(lean, reading_noise, step, seeds):
    inside, errors, expected = [], [], []
    for seed in range(seeds):
        axes, turns = true_and_found(10 + seed, lean, reading_noise, step)
        for channel, turn in turns.taxels.items():
            fit = turn.fit
            z = fit.rotation.T @ axes[channel][:, 2]
            off, covariance = np.array([-z[1], z[0]]), fit.covariance[:2, :2]
            if fit.is_in_plane_known:
                off, covariance = turn_between(fit.rotation, axes[channel]), fit.covariance[:3, :3]
                errors.append(off[:2] @ off[:2])
                expected.append(np.trace(covariance[:2, :2]))
            inside.append(off @ np.linalg.solve(covariance, off) < chi2.ppf(0.95, len(off)))
    assert np.mean(inside) >= 0.90
    assert 0.7 < np.sqrt(np.sum(expected) / np.sum(errors)) < 1.5
