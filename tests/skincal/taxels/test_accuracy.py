"""How well taxels are found on the simulated forearm: the bars for a good rig, and the paper's errors for the paper's rig.

Contacts are simulated straight, without bytes; `test_simulate_session` and `test_end_to_end` use the whole pipeline. Seeds are
1, 2, 3 ...: none is chosen.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from skincal.simulation.contacts import simulate_contacts, unguided
from skincal.simulation.operator import Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.taxels.result import PER_TAXEL, Method
from tests.skincal.estimate_support import solve
from tests.skincal.sim_support import make_rig

SEEDS = range(1, 7)


def estimate(rig, contacts, method, every=1):
    """(n, 3) positions of every n-th taxel, metres, and their predicted errors; all of them are estimated."""
    # The simulated rig is poked on the surface on which its taxels lie.
    found = solve(contacts, rig.channels[::every], method, replace(rig.scene.noise, skin=0.0), rig.surface)
    positions = [answer.position for answer in found.values()]
    assert all(position is not None for position in positions)
    return np.array(positions), np.array([answer.rms for answer in found.values()])


def errors_mm(rig, positions, every=1):
    return 1e3 * np.linalg.norm(positions - rig.places[::every], axis=1)


@lru_cache
def good_rig(seed):
    """Mean error and mean predicted error in mm, by method: 12 unguided pokes per taxel within 30 degrees of the normal."""
    rng = np.random.default_rng(seed)
    rig = make_rig(RigErrors.noise(), seed)
    pokes = unguided(rig, 12, rng)
    assert len(pokes) == 12 * 84
    assert np.degrees(np.arccos(-np.sum(pokes.directions * pokes.normals, axis=1))).max() < 30.0
    contacts = simulate_contacts(rig, pokes, rng)
    result = {}
    for method in PER_TAXEL:
        positions, predicted = estimate(rig, contacts, method)
        result[method] = errors_mm(rig, positions).mean(), 1e3 * predicted.mean()
    return result


@pytest.mark.parametrize("seed", SEEDS)
def test_sensor_noise_alone_leaves_two_millimetres_free_and_one_on_the_surface(seed):
    # Measured over 12 seeds: 1.51 to 1.87 mm free, 0.66 to 0.73 mm on the surface.
    found = good_rig(seed)
    assert found[Method.FREE][0] < 2.0
    assert found[Method.SURFACE][0] < 1.0


def test_the_predicted_error_is_about_the_error():
    # The prediction is a root mean square, the error a mean, which is 8 to 11 % less for two or three directions.
    for method in PER_TAXEL:
        error, predicted = np.mean([good_rig(seed)[method] for seed in SEEDS], axis=0)
        assert 0.7 < error / predicted < 1.1


def test_a_good_rigs_error_is_noise():
    """It is a simulation, not the plan read back: twice the noise gives twice the error."""
    rng = np.random.default_rng(1)
    quiet, loud = (make_rig(errors, 1) for errors in (RigErrors.noise(), doubled()))
    means = []
    for rig in (quiet, loud):
        contacts = simulate_contacts(rig, unguided(rig, 12, rng, Habits(aim=0.0, slide_rate=0.0, double_rate=0.0)), rng)
        means.append(errors_mm(rig, estimate(rig, contacts, Method.FREE)[0]).mean())
    assert 1.6 < means[1] / means[0] < 2.4


def doubled():
    good = RigErrors.noise()
    names = ("force_noise", "moment_noise", "slow_force", "slow_moment")
    return type(good)(
        **{name: getattr(good, name) * (2.0 if name in names else 1.0) for name in good.__dataclass_fields__ if name != "stuck"}
    )


@lru_cache
def papers_rig(seed):
    """By method: the mean error of each arm pose alone (7,), and of the seven poses averaged (IV-B), in mm.

    Of every second taxel, which takes half the time.
    """
    rng = np.random.default_rng(seed)
    rig = make_rig(RigErrors.paper(), seed)
    alone, positions = {method: [] for method in PER_TAXEL}, {method: [] for method in PER_TAXEL}
    for pose in rig.arm_poses:
        contacts = simulate_contacts(rig, unguided(rig, 3, rng), rng, pose)
        for method in PER_TAXEL:
            found, _ = estimate(rig, contacts, method, every=2)
            positions[method].append(found)
            alone[method].append(errors_mm(rig, found, every=2).mean())
    return {
        method: (np.array(alone[method]), errors_mm(rig, np.mean(positions[method], axis=0), every=2).mean())
        for method in PER_TAXEL
    }


@pytest.mark.parametrize(("method", "low", "high"), [(Method.FREE, 8.1, 18.5), (Method.SURFACE, 5.2, 19.3)])
def test_the_papers_rig_gives_the_papers_errors_per_pose(method, low, high):
    # Del Prete et al., IV-A: the range of seven datasets of one robot. Here are seven poses of six robots, so some lie outside:
    # measured 7.6 to 21.9 mm free, four in five inside, and 3.6 to 20.3 mm on the surface, all but two inside.
    errors = np.concatenate([papers_rig(seed)[method][0] for seed in SEEDS])
    assert low < np.median(errors) < high
    assert np.mean((low <= errors) & (errors <= high)) > 0.7
    assert errors.min() > 0.5 * low
    assert errors.max() < 1.6 * high


def test_the_papers_rig_gives_the_papers_errors_averaged():
    # IV-B: seven poses averaged, 7.2 mm free and 6.6 mm on the surface; better than one pose, and the surface helps.
    free, surface = ([papers_rig(seed)[method][1] for seed in SEEDS] for method in PER_TAXEL)
    assert 5.0 < np.mean(free) < 10.0
    assert 4.5 < np.mean(surface) < 9.5
    assert np.mean(surface) < np.mean(free) < np.mean([papers_rig(seed)[Method.FREE][0] for seed in SEEDS])
