"""Tip positions: the fitted frame against the true one and another solver, and what the methods make of both."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from skincal.geometry import inverse_pose
from skincal.model.actions import Exclude, Restore
from skincal.rig.tip_frame import TipPokes, TipState, fit_tip_frame, pokes_of_fit
from skincal.rig.tip_fusion import TipFusion
from skincal.session.session import Session
from skincal.simulation.contacts import TipTracker, simulate_contacts, unguided
from skincal.simulation.example_parts import ExamplePart
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.taxels.result import Method, State
from skincal.words.tip_words import tip_sentence
from tests.skincal.poke_script import estimate_key

PART = ExamplePart()
NOISE = PART.scene.noise
FIXED_FROM_SENSOR = np.eye(4)
FIXED_FROM_SENSOR[:3, :3] = Rotation.from_rotvec([1.0, -2.0, 0.7]).as_matrix()
FIXED_FROM_SENSOR[:3, 3] = 0.7, -0.4, 0.3


def contacts_with_tips(sd, errors=None, rounds=2, seed=3):
    rng = np.random.default_rng(seed)
    rig = PART.rig if errors is None else Rig(PART.scene, PART.surface, errors, np.random.default_rng(seed))
    contacts, first = [], 1
    for pose in list(rig.arm_poses)[:rounds]:
        pokes = unguided(rig, 1, rng)
        made = simulate_contacts(rig, pokes, rng, pose, first)
        contacts += TipTracker(FIXED_FROM_SENSOR, sd).add_tips(made, pokes, rig.arm_pose(pose), rng, first)
        first += len(pokes)
    return contacts


def session_of(contacts, tips=True):
    session = Session(PART.scene, PART.surface)
    for contact in contacts:
        session.add(contact if tips else replace(contact, tip=None))
    return session


def offs(estimates):
    """Pairs of an estimate and its error, metres."""
    known = [estimate for estimate in estimates if estimate.position is not None]
    return [(estimate, estimate.position - PART.rig.places[PART.rig.row_of(estimate.channel)]) for estimate in known]


def errors_mm(estimates):
    return [1e3 * np.linalg.norm(off) for _, off in offs(estimates)]


def off_from_true(frame):
    true = inverse_pose(FIXED_FROM_SENSOR)
    turn = Rotation.from_matrix(true[:3, :3] @ frame.rotation.T).as_rotvec()
    there = true[:3, :3] @ frame.rotation.T @ (frame.centre - frame.shift) + true[:3, 3]
    return np.concatenate([turn, there - frame.centre])


@pytest.mark.parametrize("sd", [0.0, 0.001, 0.005])
def test_the_frame_is_the_true_one_within_its_covariance(sd):
    frame = fit_tip_frame(contacts_with_tips(sd), NOISE)
    off = off_from_true(frame)
    assert frame.state is TipState.USED
    assert off @ np.linalg.solve(frame.covariance, off) < 22.5  # 99.9 % of chi-square, six degrees of freedom
    assert frame.tip_sd == pytest.approx(max(sd, 0.0003), rel=0.25, abs=3e-4)


def test_without_noise_the_frame_is_exact():
    exact = contacts_with_tips(0.0, RigErrors.none())
    assert np.abs(off_from_true(fit_tip_frame(exact, NOISE))).max() < 1e-9


def test_another_solver_finds_the_same_frame():
    contacts = contacts_with_tips(0.002)
    frame = fit_tip_frame(contacts, NOISE)

    def misses(unknowns):
        turn, shift = Rotation.from_rotvec(unknowns[:3]).as_matrix(), unknowns[3:]
        rows = []
        for contact in contacts:
            place = turn @ contact.tip + shift  # in the sensor's frame, about whose origin the moment is
            rows.append((np.cross(contact.force, place) + contact.moment) / np.linalg.norm(contact.force))
        return np.concatenate(rows)

    start = np.concatenate([Rotation.from_matrix(inverse_pose(FIXED_FROM_SENSOR)[:3, :3]).as_rotvec(), np.zeros(3)])
    other = least_squares(misses, start, loss="soft_l1", f_scale=0.01)
    place = Rotation.from_rotvec(other.x[:3]).as_matrix() @ frame.rotation.T @ (frame.centre - frame.shift) + other.x[3:]
    assert np.linalg.norm(place - frame.centre) < 3.0 * frame.shift_sd


WRONG = {
    "millimetres": (lambda tip, _: tip * 1e3, TipState.WRONG_UNIT, "look like millimetres"),
    "random": (lambda _, rng: rng.uniform(-0.1, 0.1, 3), TipState.DISAGREES, "Check that they are of the tip"),
    "left-handed": (lambda tip, _: tip * [1, 1, -1], TipState.DISAGREES, "one fixed frame"),
    "late": (lambda tip, rng: tip + rng.normal(0.0, 0.03, 3), TipState.DISAGREES, "not late"),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_a_wrong_stream_is_named_and_left_out(mistake):
    change, state, words = WRONG[mistake]
    rng = np.random.default_rng(1)
    right = contacts_with_tips(0.001)
    wrong = session_of(
        [replace(contact, tip=np.asarray(change(contact.tip, rng), dtype=float)) for contact in right]
    ).snapshot()
    assert wrong.tip_frame.state is state
    assert words in tip_sentence(wrong.tip_frame)
    plain = session_of(right, tips=False).snapshot()
    for method in Method:
        assert list(map(estimate_key, wrong.estimates[method])) == list(map(estimate_key, plain.estimates[method]))


def test_pushes_along_one_direction_do_not_determine_the_frame():
    rng = np.random.default_rng(2)
    (contact, *_) = contacts_with_tips(0.001)
    up, pose = np.array([0.0, 0.0, -8.0]), np.eye(4)
    alike = []
    for poke in range(1, 31):
        place = np.array([*rng.uniform(-0.002, 0.002, 2), 0.1])
        fixed = FIXED_FROM_SENSOR[:3, :3] @ place + FIXED_FROM_SENSOR[:3, 3]
        alike.append(replace(contact, poke=poke, force=up, moment=np.cross(place, up), link_from_sensor=pose, tip=fixed))
    frame = fit_tip_frame(alike, NOISE)
    assert frame.state is TipState.AMBIGUOUS
    assert "Press more sides" in tip_sentence(frame)


def test_few_pokes_and_the_steps_of_the_fit():
    assert fit_tip_frame(contacts_with_tips(0.001)[:11], NOISE).state is TipState.FEW_POKES
    steps = [pokes_of_fit(count) for count in range(200)]
    assert steps[11] == 0
    assert steps[12] == 12
    assert all(count * 0.79 <= used <= count for count, used in enumerate(steps) if count >= 12)


@pytest.mark.parametrize(("sd", "share"), [(0.0003, 0.45), (0.001, 0.5), (0.005, 0.75)])
def test_tips_lower_the_error_of_the_free_method_and_of_no_other_raise_it(sd, share):
    contacts = contacts_with_tips(sd)
    plain, both = session_of(contacts, tips=False).snapshot(), session_of(contacts).snapshot()
    alone = np.mean(errors_mm(plain.estimates[Method.FREE]))
    assert np.mean(errors_mm(both.estimates[Method.FREE])) < share * alone
    for method in (Method.SURFACE, Method.MODULES):
        assert np.mean(errors_mm(both.estimates[method])) < 1.1 * np.mean(errors_mm(plain.estimates[method])) + 0.05


def test_one_poke_a_taxel_is_enough_with_a_tip():
    contacts = contacts_with_tips(0.001, rounds=1)
    plain, both = session_of(contacts, tips=False).snapshot(), session_of(contacts).snapshot()
    found = [e.state is State.TOUCHED for e in both.estimates[Method.FREE]]
    before = [e.state is State.TOUCHED for e in plain.estimates[Method.FREE]]
    assert sum(before) < sum(found)
    assert sum(found) >= len(found) - 2
    inside = [off @ np.linalg.solve(e.covariance, off) < 7.815 for e, off in offs(both.estimates[Method.FREE])]
    assert np.mean(inside) >= 0.90


def test_an_axis_between_two_equal_measurements_goes_half_way():
    contacts = contacts_with_tips(0.001)
    frame = replace(fit_tip_frame(contacts, NOISE), covariance=np.zeros((6, 6)))
    (contact, *_) = contacts
    (place,), _ = frame.places(TipPokes.of_contacts([contact]))
    pushed = contact.link_from_sensor[:3, :3] @ contact.force
    sizes = []
    for sd in (1e-9, 0.001, 10.0):
        (moved,) = TipFusion(replace(frame, tip_sd=sd), NOISE).moved_axes([contact])
        force, moment = pushed, moved.link_from_sensor[:3, :3] @ moved.moment
        lever = place - moved.link_from_sensor[:3, 3]
        miss, push = np.cross(force, lever) + moment, force / np.linalg.norm(force)
        sizes.append(np.linalg.norm(miss - push * (push @ miss)) / np.linalg.norm(force))
    exact, between, none = sizes
    assert exact < 1e-9
    assert exact < between < none


def test_a_tip_far_from_its_axis_is_not_used():
    contacts = contacts_with_tips(0.001)
    frame = fit_tip_frame(contacts, NOISE)
    far = replace(contacts[0], tip=contacts[0].tip + 0.05)
    assert TipFusion(frame, NOISE).moved_axes([far, contacts[1]])[0] is far


def test_the_order_of_pokes_and_an_excluded_poke_leave_no_trace():
    contacts = contacts_with_tips(0.001)
    first, second = session_of(contacts), session_of(contacts[::-1])
    first.snapshot()
    first.act(Exclude(20))
    first.snapshot()
    first.act(Restore(20))
    for method in Method:
        keys = [list(map(estimate_key, session.snapshot().estimates[method])) for session in (first, second)]
        assert keys[0] == keys[1]
