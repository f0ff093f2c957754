"""Errors that pokes share: seen in their misses, told apart from white noise, and told apart in what is predicted."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.methods import estimate_from, estimate_taxels
from skincal.model.scene import NoiseSettings
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Cause, Estimate, Method, State
from skincal.taxels.shared_errors import (
    DRIFT_VARIANCE_FACTOR_IF_CORRECTED,
    POKES_PER_DRIFT_BLOCK,
    PredictedError,
    known_error,
    max_known_error,
    predicted_error,
)

EVEN = NoiseSettings(force=1e-4, moment=1e-5, contact=5e-4, reach=1e-6, radius=1e9, skin=0.0)
TAXEL = np.array([0.03, -0.02, 0.05])
SENSOR = np.array([0.0, 0.0, -0.10])


def pokes(rng, count, slow=0.0, white=5e-4, first=1, pose="a"):
    """Pokes of one taxel from all sides above it, off by shared errors of each block and by own ones."""
    together, made = slow * rng.standard_normal((count // POKES_PER_DRIFT_BLOCK + 1, 3)), []
    for number in range(count):
        push = np.array([*(0.5 * rng.standard_normal(2)), -1.0])
        force = 9.0 * push / np.linalg.norm(push)
        point = TAXEL + together[number // POKES_PER_DRIFT_BLOCK] + white * rng.standard_normal(3)
        pose_of = np.eye(4)
        pose_of[:3, 3] = SENSOR
        made.append(
            Contact(
                poke=first + number, start_s=2.0 * number, end_s=2.0 * number + 0.3, force=force,
                moment=np.cross(point - SENSOR, force), channels=np.array([0]), responses=np.array([100.0]),
                link_from_sensor=pose_of, pose=pose, tare_change=0.0, final=True,
            )
        )  # fmt: skip
    return made


def both(contacts, noise=EVEN):
    """The estimate, and what it is without what pokes share."""
    table = ContactTable(contacts)
    alone = estimate_from(table, [0], [Method.FREE], noise, None)[Method.FREE][0]
    return estimate_taxels(contacts, [0], [Method.FREE], noise, None)[Method.FREE][0], alone


@pytest.mark.parametrize("first", [1, 17])
def test_what_thirty_pokes_share_is_in_the_spread(first):
    """Whatever the number that the first of them has. Without it, it would be a fourth of the truth or less."""
    squares, predicted, alone = [], [], []
    for seed in range(60):
        estimate, plain = both(pokes(np.random.default_rng(seed), 6 * POKES_PER_DRIFT_BLOCK, 1e-3, first=first))
        squares.append(np.sum((estimate.position - TAXEL) ** 2))
        predicted.append(estimate.rms**2)
        alone.append(plain.rms**2)
    assert 0.6 < np.mean(predicted) / np.mean(squares) < 1.5
    assert np.mean(alone) < 0.1 * np.mean(squares)


def drifting(rng, poses, per_pose, size):
    """Errors (poses, per_pose, 3) whose correlation falls to 1/e over half of `POKES_PER_DRIFT_BLOCK` pokes."""
    kept, found = np.exp(-2.0 / POKES_PER_DRIFT_BLOCK), rng.standard_normal((poses, per_pose, 3))
    found[:, 1:] *= np.sqrt(1.0 - kept**2)
    for at in range(1, per_pose):
        found[:, at] += kept * found[:, at - 1]
    return size * found


def test_what_a_correction_takes_up_of_slow_errors_stays_in_the_spread():
    """It moves each arm pose until the pokes there agree with the others; landmarks were poked before: all are off by that."""
    squares, predicted, shown, halves = [], [], [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        drift = drifting(rng, 6, 72, 1e-3)
        means = drift.mean(axis=1, keepdims=True)
        halves.append(np.mean(means**2) / 1e-6)
        left = (drift - means + np.mean(means[:, 0] - drift[:, 0], axis=0)).reshape(-1, 3)
        contacts = [
            replace(contact, pose=str(number // 72), moment=contact.moment + np.cross(left[number], contact.force))
            for number, contact in enumerate(pokes(rng, len(left)))
        ]
        estimate = estimate_taxels(contacts, [0], [Method.FREE], EVEN, None, shared=nothing_shared)[Method.FREE][0]
        squares.append(np.sum((estimate.position - TAXEL) ** 2))
        predicted.append(estimate.rms**2)
        shown.append(both(contacts)[0].rms ** 2)
    assert np.mean(halves) == pytest.approx(1.0 - 1.0 / DRIFT_VARIANCE_FACTOR_IF_CORRECTED, abs=0.05)
    assert 0.5 < np.mean(predicted) / np.mean(squares) < 1.5
    assert np.mean(shown) < 0.35 * np.mean(squares), "what misses show is not all"


def nothing_shared(pokes, *_):
    """A correction that knows the rig exactly."""
    return np.zeros((len(pokes), 2, 1)), np.zeros((len(pokes), 2, 6))


def test_white_noise_adds_almost_nothing():
    added = []
    for seed in range(60):
        estimate, plain = both(pokes(np.random.default_rng(seed), 6 * POKES_PER_DRIFT_BLOCK))
        assert np.array_equal(estimate.position, plain.position)
        added.append(estimate.rms**2 / plain.rms**2 - 1.0)
    # The pokes of a block share 30 times what each has: a hundredth of a poke's own variance would be a third here.
    assert np.median(added) < 0.1
    assert np.mean(added) < 0.5


def test_the_order_of_the_list_and_where_numbers_begin_leave_no_trace():
    rng = np.random.default_rng(3)
    contacts = pokes(rng, 5 * POKES_PER_DRIFT_BLOCK, 1e-3)
    straight, _ = both(contacts)
    mixed, _ = both([contacts[i] for i in rng.permutation(len(contacts))])
    later, _ = both([replace(contact, poke=contact.poke + 1007) for contact in contacts])
    assert np.array_equal(straight.covariance, mixed.covariance)
    assert np.array_equal(straight.covariance, later.covariance)
    # Drawn apart in time, they share nothing any more.
    apart, plain = both([replace(contact, poke=POKES_PER_DRIFT_BLOCK * contact.poke) for contact in contacts])
    np.testing.assert_allclose(apart.covariance, (apart.rms / plain.rms) ** 2 * plain.covariance, rtol=1e-9, atol=1e-15)
    assert straight.rms > 1.5 * apart.rms


def test_two_wild_pokes_in_turn_are_not_taken_for_what_all_share():
    """They are doubted, and count as little here."""
    rng = np.random.default_rng(4)
    contacts = pokes(rng, 4 * POKES_PER_DRIFT_BLOCK, 1e-3)
    before, _ = both(contacts)
    for at in (40, 41):
        wild = replace(
            contacts[at], poke=1000 + at, moment=contacts[at].moment + np.cross([0.05, 0.04, 0.0], contacts[at].force)
        )
        contacts[at] = replace(wild, poke=at + 1)
    after, _ = both(contacts)
    assert set(after.doubted) >= {41, 42}
    assert after.rms == pytest.approx(before.rms, rel=0.25)


@pytest.mark.parametrize("lean", [0.0, 0.5])
def test_the_skins_thickness_moves_what_is_pushed_aslant(lean):
    """All pushes lean alike: an axis that enters a millimetre higher passes the taxel by the tangent of the lean."""
    contacts = []
    for number, contact in enumerate(pokes(np.random.default_rng(1), 40, white=0.0)):
        swing = 0.02 * np.array([np.cos(number), np.sin(number), 0.0])
        push = np.array([lean, 0.0, -1.0]) + swing
        force = 9.0 * push / np.linalg.norm(push)
        contacts.append(replace(contact, force=force, moment=np.cross(TAXEL - SENSOR, force)))
    thin, thick = (both(contacts, replace(EVEN, contact=1e-5, skin=skin))[0] for skin in (0.0, 1e-3))
    added = thick.covariance - thin.covariance
    # The free method's taxel follows its axes, and where it is known in depth only by their small swing it goes up with them.
    normal = thick.normal
    assert np.sqrt(normal @ added @ normal) == pytest.approx(1e-3, rel=0.05)
    assert np.sqrt(np.trace(added)) == pytest.approx(1e-3, rel=0.05)


def test_the_pull_of_the_forces_noise_is_in_the_spread():
    """Against sessions drawn anew: the mean place is off by as much as is added, along the lever."""
    noise = NoiseSettings(force=0.4, moment=1e-4, contact=1e-4, reach=1e-6, radius=1e9, skin=0.0)
    off, added, lever = [], [], TAXEL - SENSOR
    for seed in range(300):
        rng = np.random.default_rng(seed)
        contacts = [
            replace(contact, force=contact.force + noise.force * rng.standard_normal(3))
            for contact in pokes(rng, 60, white=1e-4)
        ]
        contacts = [replace(contact, poke=40 * contact.poke) for contact in contacts]
        estimate, plain = both(contacts, noise)
        off.append(estimate.position - TAXEL)
        added.append(np.sqrt(np.linalg.eigvalsh(estimate.covariance - plain.covariance)[-1]))
    pulled = -np.mean(off, axis=0) @ lever / np.linalg.norm(lever)
    assert pulled > 5 * np.std(off) / np.sqrt(len(off))
    assert np.mean(added) == pytest.approx(pulled, rel=0.25)


@pytest.mark.parametrize(("size", "state"), [(0.025, State.TOUCHED), (0.035, State.BLIND)])
def test_a_taxel_that_shared_errors_leave_worse_known_than_a_module_is_blind(rng, size, state):
    """A shift of the whole skin by `size` in each direction, which no poke of the taxel shows."""

    def shifted(numbers, _places, pairs):
        return size * pairs, np.zeros((len(numbers), 2, 0))

    contacts = pokes(rng, 20)
    found = estimate_taxels(contacts, [0], [Method.FREE], EVEN, None, shared=shifted)[Method.FREE][0]
    assert found.state is state
    assert found.sd == pytest.approx(size, rel=0.01)
    known = (found.position, found.covariance, found.rms, found.moved)
    assert all((each is None) is (state is State.BLIND) for each in known)
    if state is State.BLIND:
        assert found.contacts == 20
        assert found.reason.cause is Cause.SHARED_ERRORS


def beside_on_a_limb(rng, count, beside):
    """Pokes on a ball, `beside` the taxel on its top (sd, m, each direction), each leaning with the skin there and tilted."""
    radius, made = NoiseSettings().radius, pokes(rng, count)
    for at, contact in enumerate(made):
        normal = np.append(beside / radius * rng.standard_normal(2), 1.0)
        normal /= np.linalg.norm(normal)
        force = 0.25 * rng.standard_normal(3) - normal
        force *= 9.0 / np.linalg.norm(force)
        point = TAXEL + radius * (normal - np.array([0.0, 0.0, 1.0]))
        made[at] = replace(contact, force=force, moment=np.cross(point - SENSOR, force))
    return made


def test_offsets_larger_than_the_scenes_bend_the_depth_by_their_square():
    """A finger on two taxels lands twice as far beside one: the depth is off by four times as much, and so is its spread."""
    noise = NoiseSettings(force=0.01, moment=0.0005, skin=0.0)
    ratios = {}
    for beside in (0.0015, 0.0035):
        found = [both(beside_on_a_limb(np.random.default_rng(seed), 60, beside), noise)[0] for seed in range(30)]
        off = np.mean([(each.position - TAXEL)[2] ** 2 for each in found])
        ratios[beside] = np.mean([each.covariance[2, 2] for each in found]) / off
    assert 0.3 < ratios[0.0035] / ratios[0.0015] < 2.0, "it is half of a ball's, since a limb bends one way"
    assert ratios[0.0035] > 0.15


def estimate(channel, covariance, moved=None):
    return Estimate(
        channel, Method.FREE, State.TOUCHED, 9, position=np.zeros(3), covariance=covariance,
        rms=float(np.sqrt(np.trace(covariance))), moved=moved,
    )  # fmt: skip


def test_the_whole_and_the_rest_add_up_in_squares(rng):
    moves = [1e-3 * rng.standard_normal((3, n)) for n in (7, 7, 7)]
    found = [estimate(i, move @ move.T + 1e-8 * np.eye(3), move) for i, move in enumerate(moves)]
    apart = predicted_error([*found, Estimate(9, Method.FREE, State.UNSEEN, 0)], np.inf)
    squares = np.array([np.trace(each.covariance) for each in found])
    assert apart.whole**2 + apart.among**2 == pytest.approx(squares.mean(), rel=1e-12)
    assert (apart.mean, apart.worst) == pytest.approx((np.sqrt(squares).mean(), np.sqrt(squares).max()), rel=1e-12)
    # By drawing: how far the middle of the taxels goes.
    x = rng.standard_normal((100_000, 7))
    middle = np.mean([x @ move.T for move in moves], axis=0)
    assert apart.whole == pytest.approx(np.sqrt(np.mean(np.sum(middle**2, axis=1))), rel=0.01)


@pytest.mark.parametrize(
    ("part_size", "largest"), [(0.003, 0.003), (0.02, 0.01), (0.117, 0.0117), (0.4, 0.04), (np.inf, np.inf)]
)
def test_an_error_is_known_up_to_a_share_of_the_part(part_size, largest):
    assert max_known_error(part_size) == pytest.approx(largest)


def test_an_error_that_is_large_for_the_part_is_not_known_yet():
    sizes = (0.001, 0.0116, 0.0118, 0.051)
    found = [estimate(i, np.diag([size, 0.0, 0.0]) ** 2) for i, size in enumerate(sizes)]
    assert [known_error(each, 0.117) for each in found] == [0.001, 0.0116, None, None]
    assert known_error(Estimate(9, Method.FREE, State.UNSEEN, 0), 0.117) is None
    some = predicted_error(found, 0.117)
    assert (some.mean, some.worst, some.unknown) == (pytest.approx(0.0063), 0.0116, 2)
    none = predicted_error(found[2:], 0.117)
    assert (np.isnan([none.mean, none.worst, none.whole, none.among]).all(), none.unknown) == (True, 2)


def test_what_all_taxels_do_alike_is_the_whole_and_what_they_do_against_each_other_is_not():
    move = np.diag([1e-3, 2e-3, 0.0])
    alike = predicted_error([estimate(i, move @ move.T, move) for i in range(4)], np.inf)
    against = predicted_error([estimate(i, move @ move.T, (-1) ** i * move) for i in range(4)], np.inf)
    assert (alike.whole, alike.among) == (pytest.approx(alike.mean), pytest.approx(0.0, abs=1e-9))
    assert (against.whole, against.among) == (pytest.approx(0.0, abs=1e-9), pytest.approx(against.mean))
    size = pytest.approx(np.sqrt(3.0) * 1e-3)
    assert predicted_error([estimate(0, 1e-6 * np.eye(3))], np.inf) == PredictedError(size, size, 0.0, size)
    assert predicted_error([Estimate(9, Method.FREE, State.UNSEEN, 0)], np.inf) is None
