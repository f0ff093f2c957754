"""The turn of a sensor on the flange by the weight of the tool: truth chosen, forces made from it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.rig.sensor_turn import find_sensor_turn

GRAVITY = np.array([0.3, -0.2, -4.8])
"""N, in a base that does not stand upright."""


def forces(turn, *, count=14, lean=0.5, noise=0.03, weight=1.0, seed=1):
    """Rotations of the sensor as the scene has them, and the forces at rest of one that is turned by `turn`, rad."""
    rng = np.random.default_rng(seed)
    vectors = np.concatenate([lean * rng.standard_normal((count, 2)), rng.uniform(-3.0, 3.0, (count, 1))], axis=1)
    described = Rotation.from_rotvec(vectors)
    true = described * Rotation.from_rotvec(turn)
    rest = true.inv().apply(weight * GRAVITY) + [3.0, -7.0, 20.0] + noise * rng.standard_normal((count, 3))
    return described.as_matrix(), rest


@pytest.mark.parametrize("turn", [[0.0, 0.0, 1.57], [0.0, 0.0, -0.6], [3.1, 0.0, 0.0], [0.5, -0.9, 2.0]])
def test_the_weight_shows_the_turn_within_its_error(turn):
    found = find_sensor_turn(*forces(turn))
    off = (Rotation.from_rotvec(found.turn).inv() * Rotation.from_rotvec(turn)).magnitude()
    assert off < 3.0 * found.sd < 0.15
    assert found.weight == pytest.approx(np.linalg.norm(GRAVITY), rel=0.05)


def test_the_error_is_that_of_many_trials():
    turn = [0.0, 0.0, 1.2]
    trials = [find_sensor_turn(*forces(turn, seed=seed)) for seed in range(1, 41)]
    off = [(Rotation.from_rotvec(each.turn).inv() * Rotation.from_rotvec(turn)).as_rotvec() for each in trials]
    # The worst direction is not the same in all trials.
    assert np.sqrt(np.mean(np.square(off), axis=0)).max() < 1.3 * np.mean([each.sd for each in trials])
    assert np.sqrt(np.mean(np.square(off), axis=0)).max() > 0.5 * np.mean([each.sd for each in trials])


@pytest.mark.parametrize(
    "more", [{"turn": [0.0, 0.0, 0.0]}, {"turn": [0.0, 0.05, 0.1]}, {"weight": 0.0}, {"lean": 0.0}, {"count": 7}]
)
def test_nothing_is_named_that_the_weight_does_not_show(more):
    assert find_sensor_turn(*forces(**{"turn": [0.0, 0.0, 1.57], **more})) is None


def test_a_turn_that_explains_little_of_the_forces_is_not_named():
    turned = {"turn": [0.0, 0.0, 0.3], "count": 300}
    assert find_sensor_turn(*forces(**turned, noise=0.05)) is not None
    assert find_sensor_turn(*forces(**turned, noise=0.5)) is None, "a cable that pulls may look like it"


def test_a_reaction_shows_the_same_turn():
    rotations, rest = forces([0.0, 0.0, 1.57])
    np.testing.assert_allclose(find_sensor_turn(rotations, -rest).turn, find_sensor_turn(rotations, rest).turn, atol=1e-9)
