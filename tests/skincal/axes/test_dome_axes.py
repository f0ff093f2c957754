"""One turn or many on a mesh: a dome with a poke on each taxel shares none, and a flat module with leaning pokes does."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.axes.module_axes import MAX_SHARED_NOISE, find_module_noise, module_turn
from skincal.axes.skin_turns import find_noise, fit_group, joined
from skincal.axes.turn_fit import fit_turn
from skincal.geometry import rotation_by
from tests.skincal.axes.axis_support import FORCE_NOISE_N, NOISE, make_pokes

TAXELS = 12


def odds(seed, bend_deg, own_turn, pokes, lean, with_normals=True):
    """Log odds of a shared turn for taxels whose z leans up to `bend_deg` to both sides, about y."""
    rng = np.random.default_rng([seed, int(bend_deg), pokes])
    leans = np.radians(np.linspace(-bend_deg, bend_deg, TAXELS))
    made, normals = {}, {}
    for channel, angle in enumerate(leans.tolist()):
        turn = rng.uniform(-np.pi, np.pi) if own_turn else 0.3
        axes = rotation_by(np.array([0.0, angle, 0.0])) @ rotation_by(np.array([0.0, 0.0, turn]))
        own = make_pokes(rng, axes, pokes, lean)
        made[channel] = replace(own, pokes=own.pokes + 100 * channel)
        # A mesh of triangles: normals are off by some degrees.
        normal = axes[:, 2] + np.radians(3.0) * rng.normal(size=3)
        normals[channel] = normal / np.linalg.norm(normal)
    noise = find_noise(list(made.values()), FORCE_NOISE_N)
    taxels = {channel: fit_group((channel,), own, noise) for channel, own in made.items()}
    all_pokes = joined(list(made.values()))
    turn = fit_group(tuple(range(TAXELS)), all_pokes, find_module_noise([all_pokes], noise))
    return module_turn(1, turn, taxels, normals if with_normals else {})


@pytest.mark.parametrize("seed", range(3))
def test_a_dome_with_one_poke_on_each_taxel_has_no_shared_turn(seed):
    """Readings along z everywhere are those of one turn with a small ratio of gains, too: more pokes tell."""
    assert not odds(seed, 60.0, True, 1, 15.0).is_shared
    assert not odds(seed, 60.0, True, 2, 15.0).is_shared
    assert odds(seed, 60.0, True, 3, 15.0).is_separate


@pytest.mark.parametrize("with_normals", [True, False])
def test_few_pokes_on_each_taxel_of_a_flat_module_name_no_wrong_turn(with_normals):
    """Turns of their own with one poke each: nothing is certain. One turn that all share is, without a mesh, too."""
    for seed in range(3):
        assert not odds(seed, 0.0, True, 1, 15.0, with_normals).is_shared
        assert odds(seed, 0.0, False, 1, 15.0, with_normals).is_shared
        assert not odds(seed, 60.0, True, 1, 15.0, with_normals).is_shared


@pytest.mark.parametrize("seed", range(3))
def test_a_flat_module_with_leaning_pokes_shares_its_turn_on_a_mesh_too(seed):
    assert odds(seed, 0.0, False, 3, 15.0).is_shared
    assert odds(seed, 0.0, True, 3, 15.0).is_separate


def test_straight_pokes_on_a_flat_module_decide_little():
    assert not odds(1, 0.0, False, 3, 0.0).is_separate
    assert not odds(1, 0.0, True, 3, 0.0).is_separate


def test_modules_are_fitted_with_the_ratio_of_gains_of_their_taxels():
    """Alone, a ratio of 0.02 would press the readings of a dome into one turn."""
    rng = np.random.default_rng(3)
    dome = [make_pokes(rng, rotation_by(np.array([0.0, angle, 0.0])), 4, 5.0) for angle in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    dome = [replace(own, pokes=own.pokes + 100 * place) for place, own in enumerate(dome)]
    own, alone = find_noise(dome, FORCE_NOISE_N), find_noise([joined(dome)], FORCE_NOISE_N)
    assert np.exp(fit_turn(joined(dome), alone).log_ratio) < 0.1
    assert find_module_noise([joined(dome)], own).log_ratio == own.log_ratio == pytest.approx(np.log(0.6), abs=0.3)


def test_the_noise_of_a_shared_turn_has_a_limit():
    rng = np.random.default_rng(4)
    many = joined([make_pokes(rng, rotation_by(np.array([0.0, 0.0, 2.0 * turn])), 4, 30.0) for turn in range(6)])
    alone, found = find_noise([many], FORCE_NOISE_N), find_module_noise([many], NOISE)
    size = float(np.median(np.linalg.norm(many.readings, axis=1)))
    assert alone.angle + alone.reading / size > MAX_SHARED_NOISE
    assert found.angle <= MAX_SHARED_NOISE
    assert found.reading <= MAX_SHARED_NOISE * size
