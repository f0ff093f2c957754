"""How much taxels answer to a newton: from answers that were made by a known gain, and from the simulator's."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.simulation.contacts import simulate_contacts
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import PressedPlaces, answer
from skincal.taxels.gains import MIN_NORMAL_LOAD_N, MIN_POKES_TO_ESTIMATE_GAIN, taxel_gains
from skincal.taxels.result import Estimate, Method, State
from tests.skincal.sim_support import make_rig

NORMAL = np.array([0.6, 0.0, 0.8])


def taxel(channel: int, normal: np.ndarray | None = NORMAL, **more: object) -> Estimate:
    return Estimate(channel, Method.SURFACE, State.TOUCHED, 5, position=np.zeros(3), normal=normal, **more)


def pokes(gain: float, count: int, seed: int = 1, channel: int = 7) -> list[Contact]:
    """Leaning pokes of different strength in different arm poses, each answered by `gain` times its load."""
    rng, found = np.random.default_rng(seed), []
    for poke in range(1, count + 1):
        push = -NORMAL + 0.3 * rng.standard_normal(3)
        force = rng.uniform(4, 12) * push / np.linalg.norm(push)
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        pose = np.eye(4)
        pose[:3, :3] = turn * np.linalg.det(turn)
        load = -float(force @ NORMAL)
        answers = np.array([0.4, 1.0]) * gain * load
        channels = np.array([channel - 1, channel])
        contact = Contact(
            poke, poke, poke + 0.3, pose[:3, :3].T @ force, np.zeros(3), channels, answers, pose, "", 0.0, final=True
        )
        found.append(contact)
    return found


def test_a_known_gain_is_found_whatever_the_pose_force_and_lean():
    (gain,) = taxel_gains(pokes(12.5, 9), [taxel(7)])
    assert gain.pokes == 9
    assert gain.mean == pytest.approx(12.5, rel=1e-12)
    assert gain.spread == pytest.approx(0.0, abs=1e-10)


def test_the_spread_is_the_standard_deviation_of_the_pokes():
    contacts = [pokes(gain, 3)[index] for index, gain in enumerate((10.0, 12.0, 17.0))]
    (gain,) = taxel_gains(contacts, [taxel(7)])
    assert gain.mean == pytest.approx(13.0)
    assert gain.spread == pytest.approx(np.std([10.0, 12.0, 17.0], ddof=1))


def test_too_few_pokes_tell_no_gain():
    (gain,) = taxel_gains(pokes(12.5, MIN_POKES_TO_ESTIMATE_GAIN - 1), [taxel(7)])
    assert (gain.pokes, gain.mean, gain.spread) == (MIN_POKES_TO_ESTIMATE_GAIN - 1, None, None)


def test_a_taxel_that_never_answered_most_or_has_no_normal_has_no_gain():
    beside, blind = taxel_gains(pokes(12.5, 9), [taxel(6), taxel(7, normal=None)])
    assert (beside.pokes, beside.mean) == (0, None)
    assert (blind.pokes, blind.mean) == (9, None)


def test_doubted_pokes_and_pokes_that_graze_do_not_count():
    contacts = pokes(12.5, 9)
    wild, grazing = pokes(90.0, 2, seed=2)
    aside = grazing.link_from_sensor[:3, :3].T @ (np.cross(NORMAL, [0.0, 1.0, 0.0]) * 9 - 0.5 * MIN_NORMAL_LOAD_N * NORMAL)
    contacts += [
        Contact(20, 0, 1, wild.force, wild.moment, wild.channels, wild.responses, wild.link_from_sensor, "", 0.0, final=True),
        Contact(21, 0, 1, aside, wild.moment, wild.channels, wild.responses, grazing.link_from_sensor, "", 0.0, final=True),
    ]
    (gain,) = taxel_gains(contacts, [taxel(7, doubted={20: 0.0})])
    assert gain.pokes == 9
    assert gain.mean == pytest.approx(12.5, rel=1e-9)


def test_the_simulators_gains_are_found():
    """Pokes of one force in the middle of each taxel, along its normal: what its own foam answers to a newton."""
    rig, load, rounds = make_rig(replace(RigErrors.none(), gain_spread=0.25)), 9.0, 4
    middle = PressedPlaces(
        np.tile(rig.channels, rounds), np.tile(rig.places, (rounds, 1)), np.tile(rig.normals, (rounds, 1)),
        np.tile(-rig.normals, (rounds, 1)), np.full(rounds * len(rig.channels), load), np.zeros(rounds * len(rig.channels)),
    )  # fmt: skip
    contacts = simulate_contacts(rig, middle, np.random.default_rng(6))
    taxels = [taxel(channel, rig.normals[rig.row_of(channel)]) for channel in rig.channels.tolist()]
    found = taxel_gains(contacts, taxels)
    room = rig.range[1] - rig.baselines if rig.polarity > 0 else rig.baselines - rig.range[0]
    true = rig.gains * room * answer(rig.foam, np.array(load), np.ones(1)) / load
    assert [gain.pokes for gain in found] == [rounds] * len(true)
    assert np.allclose([gain.mean for gain in found], true, rtol=1e-9)
    assert np.std(true) / np.mean(true) > 0.2
