"""The turn of a taxel: exact pokes, another route to the minimum, chance, symmetry, outliers, and states."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2

from skincal.axes.turn_fit import AxisPokes, fit_both_hands, fit_turn
from tests.skincal.axes.axis_support import FORCE_NOISE_N, NOISE, READING_NOISE, make_pokes, random_rotation, turn_between


def rng_of(seed):
    return np.random.default_rng([42, seed])


def of_quaternion(quaternion):
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def sum_of_squares(unknowns, pokes):
    """The sum of squares by quaternion and ln rho: the angle by its cosine, the variance by the sum over two directions."""
    rotation, ratio = of_quaternion(unknowns[:4]), np.exp(unknowns[4])
    gains = np.diag([ratio, ratio, 1.0])
    m = pokes.forces @ rotation @ gains
    size = np.linalg.norm(m, axis=1)[:, None]
    along = m / size
    side = np.cross(along, [0.3, 0.5, -0.8])
    side /= np.linalg.norm(side, axis=1)[:, None]
    moved = np.stack([side, np.cross(along, side)]) @ gains * FORCE_NOISE_N / size
    reading = np.linalg.norm(pokes.readings, axis=1)
    variance = (READING_NOISE / reading) ** 2 + np.sum(moved**2, axis=(0, 2)) / 2
    angle = np.arccos(np.clip(np.sum(along * pokes.readings, axis=1) / reading, -1, 1))
    return (unknowns[4] / NOISE.log_ratio_sd) ** 2 + np.sum(angle**2 / variance)


def test_exact_pokes_give_the_exact_turn_and_ratio():
    axes = random_rotation(rng_of(1))
    fit = fit_turn(make_pokes(rng_of(2), axes, 8, 20.0, ratio=0.4, is_noisy=False), replace(NOISE, log_ratio_sd=1e3))
    assert turn_between(fit.rotation, axes) == pytest.approx(np.zeros(3), abs=1e-5)
    assert fit.log_ratio == pytest.approx(np.log(0.4), abs=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_a_search_over_quaternions_finds_the_same_minimum(seed):
    axes = random_rotation(rng_of(seed))
    pokes = make_pokes(rng_of(seed + 10), axes, 8, 20.0)
    fit = fit_turn(pokes, NOISE)
    assert (fit.trust == 1.0).all()
    best = min(
        (
            minimize(sum_of_squares, np.append(rng_of(100 + start).normal(size=4), 0.0), (pokes,), "BFGS", tol=1e-9)
            for start in range(6)
        ),
        key=lambda found: found.fun,
    )
    assert fit.cost == pytest.approx(best.fun, rel=1e-3)
    assert turn_between(of_quaternion(best.x[:4]), fit.rotation) == pytest.approx(np.zeros(3), abs=2e-4)
    assert fit.log_ratio == pytest.approx(best.x[4], abs=1e-3)


@pytest.mark.parametrize(("count", "lean"), [(6, 15.0), (12, 10.0), (20, 25.0)])
def test_the_true_turn_is_inside_the_95_percent_region_as_often_as_that_says(count, lean):
    inside, scores, runs = 0, [], 120
    for seed in range(runs):
        axes = random_rotation(rng_of(1000 + seed))
        fit = fit_turn(make_pokes(rng_of(2000 + seed), axes, count, lean), NOISE)
        off = turn_between(fit.rotation, axes)
        square = off @ np.linalg.solve(fit.covariance[:3, :3], off)
        inside += square < chi2.ppf(0.95, 3)
        scores.append(square)
    assert inside >= 0.90 * runs
    # Nor are the errors larger than needed: the mean of chi-square with three degrees is 3.
    assert 2.0 < np.mean(scores) < 4.0


def test_the_covariance_in_the_link_frame_is_that_of_turns_before_the_rotation():
    axes = random_rotation(rng_of(5))
    fit = fit_turn(make_pokes(rng_of(6), axes, 12, 15.0), NOISE)
    # The turn about the taxel's z is the least known one: its direction in the link frame is z.
    _, vectors = np.linalg.eigh(fit.turn_covariance)
    assert abs(vectors[:, -1] @ fit.rotation[:, 2]) > 0.95


def test_a_turned_world_turns_the_answer_and_nothing_else():
    axes, world = random_rotation(rng_of(7)), random_rotation(rng_of(8))
    pokes = make_pokes(rng_of(9), axes, 10, 15.0)
    fit = fit_turn(pokes, NOISE)
    turned = fit_turn(AxisPokes(pokes.forces @ world.T, pokes.readings, pokes.pokes), NOISE)
    assert turned.rotation == pytest.approx(world @ fit.rotation, abs=1e-5)
    assert turned.covariance == pytest.approx(fit.covariance, rel=1e-3, abs=1e-9)
    assert turned.turn_covariance == pytest.approx(world @ fit.turn_covariance @ world.T, rel=1e-3, abs=1e-8)


def test_axes_exchanged_in_the_readings_are_exchanged_in_the_answer():
    axes = random_rotation(rng_of(11))
    pokes = make_pokes(rng_of(12), axes, 10, 15.0)
    # x' = y, y' = -x: a quarter turn about z.
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    fit = fit_turn(pokes, NOISE)
    other = fit_turn(AxisPokes(pokes.forces, pokes.readings @ quarter.T, pokes.pokes), NOISE)
    assert other.rotation == pytest.approx(fit.rotation @ quarter.T, abs=1e-5)


def test_the_scale_of_the_readings_does_not_matter():
    axes = random_rotation(rng_of(13))
    pokes = make_pokes(rng_of(14), axes, 10, 15.0)
    larger = AxisPokes(pokes.forces, 1000.0 * pokes.readings, pokes.pokes)
    fit, other = fit_turn(pokes, NOISE), fit_turn(larger, replace(NOISE, reading=1000.0 * READING_NOISE))
    assert other.rotation == pytest.approx(fit.rotation, abs=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_straight_pokes_leave_the_turn_in_the_plane_unknown(seed):
    axes = random_rotation(rng_of(20 + seed))
    fit = fit_turn(make_pokes(rng_of(30 + seed), axes, 20, 0.0), NOISE)
    assert not fit.is_in_plane_known
    assert np.degrees(fit.in_plane_sd) > 90.0
    assert np.degrees(np.arccos(fit.rotation[:, 2] @ axes[:, 2])) < 1.0
    leaning = fit_turn(make_pokes(rng_of(30 + seed), axes, 20, 15.0), NOISE)
    assert leaning.is_in_plane_known
    assert np.degrees(leaning.in_plane_sd) < 3.0


def test_a_taxel_whose_z_leans_from_straight_pokes_has_an_uncertain_normal():
    """The turn about the push is unknown, so the z of the taxel lies on a cone about it, and a point of it is the answer.

    The mean of (1 - cos d)^2 over all turns d is 3/2.
    """
    axes = random_rotation(rng_of(40))
    along = np.array([np.sin(0.1), 0.0, -np.cos(0.1)])
    forces = np.linspace(4.0, 8.0, 12)[:, None] * along
    pokes = AxisPokes(forces @ axes.T, 0.4 * forces, np.arange(12))
    fit = fit_turn(pokes, replace(NOISE, log_ratio_sd=0.05))
    assert not fit.is_in_plane_known
    assert fit.normal_sd == pytest.approx(0.1 * np.sqrt(1.5), rel=0.03)


def test_an_unmodelled_ratio_would_turn_the_normal_and_the_fitted_one_does_not():
    axes = random_rotation(rng_of(41))
    towards = np.array([np.sin(0.3), 0.0, -np.cos(0.3)])
    rng = rng_of(42)
    lean = towards + 0.1 * rng.normal(size=(20, 3))
    forces = 6.0 * lean / np.linalg.norm(lean, axis=1)[:, None]
    pokes = AxisPokes(forces @ axes.T, 0.4 * forces * np.array([0.5, 0.5, 1.0]), np.arange(20))
    fitted = fit_turn(pokes, NOISE)
    held = fit_turn(pokes, replace(NOISE, log_ratio_sd=1e-3))
    assert np.degrees(np.arccos(fitted.rotation[:, 2] @ axes[:, 2])) < 0.5
    assert np.degrees(np.arccos(held.rotation[:, 2] @ axes[:, 2])) > 4.0


def test_pokes_that_contradict_the_others_do_not_count():
    axes = random_rotation(rng_of(50))
    pokes = make_pokes(rng_of(51), axes, 14, 15.0)
    wrong = pokes.readings.copy()
    wrong[[3, 9]] = wrong[[3, 9]] @ np.array([[0.7, 0.0, 0.7], [0.0, 1.0, 0.0], [-0.7, 0.0, 0.7]])
    fit = fit_turn(AxisPokes(pokes.forces, wrong, pokes.pokes), NOISE)
    assert fit.trust[[3, 9]] == pytest.approx(np.zeros(2))
    kept = np.delete(np.arange(14), [3, 9])
    clean = fit_turn(AxisPokes(pokes.forces[kept], pokes.readings[kept], kept), NOISE)
    assert fit.rotation == pytest.approx(clean.rotation, abs=1e-4)


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_leaning_pokes_tell_mirrored_axes_and_straight_ones_do_not(is_mirrored):
    axes = random_rotation(rng_of(60))
    factors = np.array([1.0, -1.0, 1.0]) if is_mirrored else np.ones(3)
    for lean, least in ((15.0, 20.0), (0.0, 0.0)):
        pokes = make_pokes(rng_of(61), axes, 12, lean)
        right, mirrored = fit_both_hands(AxisPokes(pokes.forces, pokes.readings * factors, pokes.pokes), NOISE)
        log_odds = (mirrored.log_evidence - right.log_evidence) * (1 if is_mirrored else -1)
        if least:
            assert log_odds > least
            best = mirrored if is_mirrored else right
            # `axes` are those of the readings as they came.
            assert np.linalg.det(best.axes) == pytest.approx(-1.0 if is_mirrored else 1.0)
            assert best.axes == pytest.approx(axes * factors, abs=0.1)
        else:
            assert abs(log_odds) < 1.0


@pytest.mark.parametrize("lean", [2.0, 15.0])
def test_the_coarse_search_before_pokes_are_judged_leads_to_the_same_turn(lean, monkeypatch):
    """Three of 20 pokes press another place."""
    rng = rng_of(17)
    skin = []
    for _ in range(8):
        made = make_pokes(rng, random_rotation(rng), 20, lean)
        made.readings[:3] = made.readings[:3] @ random_rotation(rng)
        skin.append(made)
    coarse = [fit_turn(pokes, NOISE) for pokes in skin]
    monkeypatch.setattr("skincal.axes.turn_fit.SMALLEST_GAIN_BEFORE_TRUST", 0.0)
    full = [fit_turn(pokes, NOISE) for pokes in skin]
    assert sum((fit.trust < 0.5).any() for fit in full) >= 6
    for found, expected in zip(coarse, full, strict=True):
        off = turn_between(expected.rotation, found.rotation)
        if not expected.is_in_plane_known:
            z = expected.rotation.T @ found.rotation[:, 2]
            off = np.array([-z[1], z[0]])
        covariance = expected.covariance[: len(off), : len(off)]
        assert off @ np.linalg.solve(covariance, off) < 0.1**2, "a tenth of its standard deviation"


def test_a_force_or_a_reading_of_zero_is_refused():
    pokes = make_pokes(rng_of(70), np.eye(3), 3, 10.0)
    for forces, readings in ((0.0 * pokes.forces, pokes.readings), (pokes.forces, np.nan * pokes.readings)):
        with pytest.raises(ValueError, match="finite and not zero"):
            fit_turn(AxisPokes(forces, readings, pokes.pokes), NOISE)
