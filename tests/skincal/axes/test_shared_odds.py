"""One turn or many, by pokes that press several taxels at once: certain odds are right, for either truth."""

import numpy as np
import pytest

from skincal.axes.module_axes import find_module_noise, module_turn
from skincal.axes.skin_turns import as_pokes, find_turns, fit_group, joined
from skincal.geometry import rotation_by
from tests.skincal.axes.axis_support import FORCE_NOISE_N, READING_NOISE, random_rotation

TAXELS = 12
SEEDS = 3


def press(rng, own_axes, count, together, lean_deg, common, reading_noise=READING_NOISE):
    """Make pokes on `together` taxels in a row, with the measured forces; `common` (rad) turns all readings of a poke alike."""
    module = random_rotation(rng)
    axes = []
    for _ in range(TAXELS):
        tilt = np.append(np.radians(3.0) * rng.normal(size=2), 0.0)
        turn = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        axes.append(module @ rotation_by(turn) @ rotation_by(tilt) if own_axes else module)
    rows = {}
    for poke in range(count):
        cosine, azimuth = rng.uniform(np.cos(np.radians(lean_deg)), 1.0), rng.uniform(0.0, 2.0 * np.pi)
        sine = np.sqrt(1.0 - cosine**2)
        force = rng.uniform(4.0, 8.0) * module @ np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), -cosine])
        measured = force + FORCE_NOISE_N * rng.normal(size=3)
        felt = force + common * np.linalg.norm(force) * rng.normal(size=3)
        for channel in (rng.integers(TAXELS) + np.arange(together)) % TAXELS:
            gains = rng.uniform(0.25, 0.5) * np.array([0.6, 0.6, 1.0])
            reading = gains * (axes[channel].T @ felt) + reading_noise * rng.normal(size=3)
            rows.setdefault(int(channel), []).append((measured, reading, poke))
    return {channel: as_pokes(own) for channel, own in sorted(rows.items())}, module[:, 2]


def log_odds(seed, own_axes, count, together, lean_deg, common, with_normals, reading_noise=READING_NOISE):
    """Log odds of the truth."""
    rng = np.random.default_rng([seed, own_axes, count, together, int(lean_deg)])
    pokes, normal = press(rng, own_axes, count, together, lean_deg, common, reading_noise)
    turns, every = find_turns(pokes, FORCE_NOISE_N), joined(list(pokes.values()))
    turn = fit_group(tuple(pokes), every, find_module_noise([every], turns.noise))
    normals = dict.fromkeys(pokes, normal) if with_normals else {}
    return module_turn(1, turn, turns.taxels, normals).log_odds_shared * (-1.0 if own_axes else 1.0)


@pytest.mark.parametrize("common", [0.0, 0.03])
@pytest.mark.parametrize("own_axes", [False, True])
def test_certain_odds_are_right_in_19_of_20_sessions(own_axes, common):
    """Before, a module with 3 such pokes was said to have separate turns for certain, whatever it had."""
    odds = np.array([
        log_odds(seed, own_axes, count, together, lean, common, seed % 2 == 0)
        for count in (2, 3, 8) for together in (3, 4, 5) for lean in (5.0, 15.0) for seed in range(SEEDS)
    ])  # fmt: skip
    right, wrong = np.sum(odds > np.log(20.0)), np.sum(odds < -np.log(20.0))
    assert wrong <= 0.05 * (right + wrong)
    assert right > 0.25 * len(odds)


@pytest.mark.parametrize("own_axes", [False, True])
def test_ten_leaning_pokes_on_four_taxels_each_decide(own_axes):
    for seed in range(SEEDS):
        assert log_odds(seed, own_axes, 10, 4, 15.0, 0.0, False) > np.log(20.0)


@pytest.mark.parametrize("own_axes", [False, True])
@pytest.mark.parametrize("reading_noise", [0.3, 0.6, 1.0])
def test_readings_as_noisy_as_large_decide_nothing_wrongly(own_axes, reading_noise):
    odds = [log_odds(seed, own_axes, 10, 4, 15.0, 0.0, seed % 2 == 0, reading_noise) for seed in range(SEEDS)]
    assert min(odds) > -np.log(20.0)


def test_taxels_of_one_poke_count_once():
    """The same readings as of pokes of their own say more."""
    pokes, _ = press(np.random.default_rng(1), True, 8, 4, 15.0, 0.0)
    turns, every = find_turns(pokes, FORCE_NOISE_N), joined(list(pokes.values()))
    noise = find_module_noise([every], turns.noise)
    once = module_turn(1, fit_group(tuple(pokes), every, noise), turns.taxels, {})
    apart = type(every)(every.forces, every.readings, np.arange(len(every)))
    each = module_turn(1, fit_group(tuple(pokes), apart, noise), turns.taxels, {})
    assert once.turn.share == pytest.approx(0.25)
    assert once.log_odds_shared == pytest.approx(0.25 * each.log_odds_shared, rel=0.01)
    assert each.log_odds_shared < -20.0
