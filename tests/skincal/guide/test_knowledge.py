"""What the guide knows of each taxel, and what a poke would add: by another route each."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.guide import candidates
from skincal.guide.knowledge import PlannedPlaces, TaxelStatistics, believed_positions, diversity
from skincal.guide.progress import Facts, GuideSettings, Need, find_needs
from skincal.mesh.surface import pairs_within
from skincal.model.scene import NoiseSettings
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.noise import offset_square
from skincal.taxels.result import Cause, Estimate, Method, State, StateReason
from skincal.taxels.solve import solve
from tests.skincal.taxels.test_solve_uncertainty import pokes, sensor_pose

NOISE = NoiseSettings(radius=1e9)
NORMAL = np.array([0.0, 0.6, 0.8])
TAXEL = np.array([0.03, 0.02, 0.01])
SETTINGS = GuideSettings()
SKIN = 0.0015


def contacts_and_evidence(count=8, weights=(1.0, 0.8, 0.4), tilt=0.5, seed=1):
    contacts = pokes(np.random.default_rng(seed), count, TAXEL, NORMAL, sensor_pose(), NOISE, tilt, weights)
    return contacts, ContactTable(contacts).evidence([0])


def knowledge(evidence, in_plane=False, unknown=1e9):
    know = TaxelStatistics(np.array([0]), NOISE, unknown, in_plane)
    know.renew([0], evidence, TAXEL[None], TAXEL[None], NORMAL[None], dict.fromkeys(evidence.pokes.tolist(), TAXEL))
    return know


def test_information_is_the_sum_over_contacts_of_rows_by_their_noise():
    _, evidence = contacts_and_evidence()
    expected = np.zeros((3, 3))
    for i, (e, lever) in enumerate(zip(evidence.pairs, TAXEL - evidence.sensors, strict=True)):
        # Force noise df moves the row e_j.(p - a) by -(e_k.(p x df))/|f|: written out over the force's three directions.
        size, other = evidence.forces[i], np.stack([e[1], -e[0]])
        moved = np.array([np.cross(lever, axis) for axis in np.eye(3)]) @ other.T / size
        noise = NOISE.force**2 * moved.T @ moved + (NOISE.moment / size) ** 2 * np.eye(2)
        k = evidence.weights[i]
        noise += (NOISE.contact**2 - NOISE.reach**2 * np.log(k)) * np.eye(2)
        expected += e.T @ np.linalg.inv(noise) @ e
    np.testing.assert_allclose(knowledge(evidence).information[0], expected, rtol=1e-9)


@pytest.mark.parametrize("angle", [5.0, 15.0, 28.0])
def test_diversity_of_a_cone_of_axes_is_its_angle_over_root_two(angle):
    _, evidence = contacts_and_evidence(4, weights=(1.0,))
    turn = np.radians(angle)
    around = 2 * np.pi * np.arange(4) / 4
    u = np.stack([np.sin(turn) * np.cos(around), np.sin(turn) * np.sin(around), np.full(4, np.cos(turn))])
    columns = evidence.columns.copy()
    columns[0:3] = u
    found = diversity(replace(evidence, columns=columns))[0]
    # Of I - mean u u' the eigenvalue along the middle is sin^2; across it more.
    assert np.degrees(found) == pytest.approx(angle, rel=1e-9)
    assert np.degrees(diversity(contacts_and_evidence(1, weights=(1.0,))[1])[0]) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("in_plane", [False, True])
def test_how_far_the_last_own_poke_moved_a_taxel_is_what_solving_without_it_says(in_plane):
    contacts, evidence = contacts_and_evidence(9)
    last = max(evidence.pokes[evidence.weights == 1.0].tolist())
    whole, without = (
        solve(ContactTable(some).evidence([0]), [], NOISE, None, doubting=False).factors
        for some in (contacts, [contact for contact in contacts if contact.poke != last])
    )
    if in_plane:
        basis = np.linalg.svd(NORMAL[None])[2][1:].T
        held = []
        for factors in (whole, without):
            root, offset = factors.roots[0], factors.offsets[0]
            held.append(np.linalg.lstsq(root @ basis, offset, rcond=None)[0])
        expected = np.linalg.norm(held[0] - held[1])
    else:
        expected = np.linalg.norm(whole.solutions[0] - without.solutions[0])
    assert knowledge(evidence, in_plane).moved[0] == pytest.approx(expected, rel=1e-4)


def test_how_far_places_beside_a_taxel_pull_its_depth_is_what_solving_says():
    """Axes shifted by where the pokes were beside it, and solved again."""
    _, evidence = contacts_and_evidence(9)
    off = 0.002 * np.random.default_rng(3).standard_normal((9, 3))
    centres = dict(zip(evidence.pokes.tolist(), TAXEL + off, strict=True))
    know = TaxelStatistics(np.array([0]), NOISE, 1e9, False)
    know.renew([0], evidence, TAXEL[None], TAXEL[None], NORMAL[None], centres)
    rows = evidence.weights[:, None, None] * evidence.pairs
    sides = [np.sum(rows * places[:, None], axis=2).ravel() for places in (evidence.nearest, evidence.nearest + off)]
    still, shifted = (np.linalg.lstsq(rows.reshape(-1, 3), side)[0] for side in sides)
    assert know.pulled[0] == pytest.approx((shifted - still) @ NORMAL, rel=1e-6)
    assert abs(know.pulled[0]) > 1e-4
    assert knowledge(evidence).pulled[0] == pytest.approx(0.0, abs=1e-12), "all of them at its place"
    on_surface = TaxelStatistics(np.array([0]), NOISE, 1e9, True)
    on_surface.renew([0], evidence, TAXEL[None], TAXEL[None], NORMAL[None], centres)
    assert on_surface.pulled[0] == 0.0, "a mesh holds the depth"


def test_own_pokes_are_those_in_which_it_answers_most_and_one_poke_alone_is_not_settled():
    contacts, evidence = contacts_and_evidence(9)
    know = knowledge(evidence)
    assert know.own[0] == sum(contact.responses[0] == contact.responses.max() for contact in contacts)
    assert know.contacts[0] == 9
    assert np.isinf(knowledge(contacts_and_evidence(1, weights=(1.0,))[1]).moved[0])


def test_contacts_of_which_none_is_trusted_say_nothing():
    """By the modules method a module may be mistrusted altogether."""
    _, evidence = contacts_and_evidence()
    for in_plane in (False, True):
        know = knowledge(evidence.trusted(np.zeros(len(evidence.trust))), in_plane)
        assert know.diversity[0] == 0.0
        assert np.isinf(know.moved[0])
        assert not know.beside[0].any()
        assert np.isfinite(know.information[0]).all()


def test_what_is_taken_away_leaves_no_trace():
    _, evidence = contacts_and_evidence()
    know, empty = knowledge(evidence), ContactTable().evidence([0])
    know.renew([0], empty, TAXEL[None], TAXEL[None], NORMAL[None], {})
    fresh = TaxelStatistics(np.array([0]), NOISE, 1e9, False)
    for name in ("information", "diversity", "own", "contacts", "beside", "pulled", "moved"):
        np.testing.assert_array_equal(getattr(know, name), getattr(fresh, name))


def grid(side=5, step=0.005):
    x, y = np.meshgrid(step * np.arange(side), step * np.arange(side), indexing="ij")
    places = np.stack([x.ravel(), y.ravel(), np.zeros(side * side)], axis=1)
    normals = np.tile([0.0, 0.0, 1.0], (side * side, 1))
    return PlannedPlaces(np.arange(side * side), places, normals, np.zeros(side * side, dtype=np.int64))


def known(channel, place, sd):
    return Estimate(channel, Method.SURFACE, State.ESTIMATED, 3, position=np.asarray(place), covariance=sd**2 * np.eye(3))


def unseen(channel):
    return Estimate(channel, Method.SURFACE, State.UNSEEN, 0)


def test_a_skin_beside_its_plan_is_found_from_a_few_taxels():
    plan, shift = grid(), np.array([0.003, -0.002, 0.0])
    estimates = [unseen(i) for i in range(25)]
    np.testing.assert_allclose(believed_positions(plan, estimates), plan.places, atol=1e-15)
    for i in (0, 6, 18):
        estimates[i] = known(i, plan.places[i] + shift, 0.001)
    off = np.linalg.norm(believed_positions(plan, estimates) - plan.places - shift, axis=1)
    assert off.max() < 0.0005
    assert off[[0, 6, 18]].max() < off[24]


def test_a_single_rough_estimate_does_not_carry_the_skin_away():
    plan = grid()
    estimates = [unseen(i) for i in range(25)]
    estimates[3] = known(3, plan.places[3] + [0.02, 0, 0], 0.02)
    moved = believed_positions(plan, estimates) - plan.places
    assert 0.0 < moved[20, 0] < 0.002
    # A taxel that the plan does not know is where it was measured.
    bare = replace(plan, places=np.where(np.arange(25)[:, None] == 7, np.nan, plan.places))
    estimates[7] = known(7, [0.1, 0.2, 0.3], 0.001)
    np.testing.assert_allclose(believed_positions(bare, estimates)[7], [0.1, 0.2, 0.3])


def test_neighbours_are_the_nearest_within_reach():
    plan = grid()
    found = candidates.find_answering(plan.places, 0.005, NOISE)
    apart = np.linalg.norm(plan.places[:, None] - plan.places, axis=2)
    for row in range(25):
        own = found.rows[row][found.weights[row] > 0]
        assert own[0] == row
        assert set(own[1:]) <= set(np.flatnonzero((apart[row] <= candidates.REACHED * 0.005) & (apart[row] > 0)))
        assert len(own) == 1 + ((apart[row] < 0.0051) & (apart[row] > 0)).sum()
    assert found.weights[12, 1] == pytest.approx(np.exp(-((0.005 / (2 * NOISE.reach)) ** 2)))


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("reach", [0.0, 1e-3, 0.02, 0.1, 50.0])
def test_pairs_are_those_of_looking_at_all(rng, reach, flat):
    """Scattered wide and narrow, two at one place, one nowhere, one far away, and grids whose steps are the reach itself."""
    scattered = rng.normal(size=(200, 3)) * [1.0, 0.02, 0.0 if flat else 0.1]
    scattered[3], scattered[5] = scattered[4], np.nan
    steps = np.stack(np.meshgrid(np.arange(12), np.arange(9), 3), axis=-1).reshape(-1, 3) * reach + 0.7
    line = np.arange(1100)[:, None] * [reach, 0.0, 0.0] - 0.3
    far_off = np.concatenate([scattered[:50], [[-1e12, 1e12, 1e12]]])
    for places in (scattered, steps, line, far_off, scattered[:1], scattered[:0], np.ones((3, 3))):
        known = np.flatnonzero(np.isfinite(places).all(axis=1))
        pairs = np.sort(known[pairs_within(places[known], reach)], axis=1)
        far = np.sqrt(np.sum((places[:, None] - places) ** 2, axis=2))
        np.testing.assert_array_equal(pairs[np.lexsort(pairs.T[::-1])], np.argwhere(np.triu(far <= reach, 1)))


def state(information, in_plane=False, wanted=0.0):
    plan = grid()
    return candidates.ChoiceState(
        plan.places,
        candidates.candidate_pushes(plan.normals, SETTINGS.usable_tilt),
        candidates.find_answering(plan.places, 0.005, NOISE),
        information, plan.normals, np.array([0.0, 0.0, -0.18]), wanted, in_plane, np.ones(25), np.zeros(25),
    )  # fmt: skip


def test_a_gain_is_by_how_much_the_predicted_errors_fall():
    """Each neighbour's information with the poke's rows added, inverted once more."""
    rng = np.random.default_rng(3)
    information = np.array([a @ a.T + 1e3 * np.eye(3) for a in 400 * rng.normal(size=(25, 3, 3))])
    here = state(information)
    rows = np.array([6, 12])
    found = candidates.predict_gains(here, rows, NOISE, 0.3)
    for row, gain in zip(rows, found, strict=True):
        for push in range(candidates.TRIES):
            e = np.linalg.svd(here.pushes[row, push][None])[2][1:]
            expected = 0.0
            for place, (other, weight) in enumerate(zip(here.neighbours.rows[row], here.neighbours.weights[row], strict=True)):
                if weight == 0:
                    continue
                q = here.places[other] - here.sensor
                less = NOISE.force / candidates.FORCE * np.array([-e[1] @ q, e[0] @ q])
                even = (NOISE.moment / candidates.FORCE) ** 2 + (NOISE.force / candidates.FORCE) ** 2 * q @ q
                noise = (even + offset_square(np.array([weight]), NOISE)[0]) * np.eye(2) - np.outer(less, less)
                after = information[other] + weight * e.T @ np.linalg.inv(noise) @ e
                lower = np.sqrt(np.trace(np.linalg.inv(information[other]))) - np.sqrt(np.trace(np.linalg.inv(after)))
                expected += lower * (1.0 if place == 0 else 0.3)
            assert gain[push] == pytest.approx(expected, rel=1e-9)
    before, after = candidates.predict_error(here, 6, 4, NOISE)
    assert before == pytest.approx(np.sqrt(np.trace(np.linalg.inv(information[6]))))
    assert after < before


def test_what_is_known_but_for_its_depth_wants_tilt_and_on_a_surface_it_does_not():
    flat = np.diag([1e6, 1e6, 1e4])
    information = np.tile(flat, (25, 1, 1))
    free = candidates.predict_gains(state(information), np.array([12]), NOISE, 0.0)[0]
    assert free[0] < 0.2 * free.max(), "along the normal"
    assert free.argmax() > candidates.AZIMUTHS, "the largest tilt"
    held = candidates.predict_gains(state(information, in_plane=True), np.array([12]), NOISE, 0.0)[0]
    assert held[0] > 0.95 * held.max()


FINE = Facts(own=3, diversity=np.radians(20), beside=0.0, pulled=0.0, moved=0.0)


@pytest.mark.parametrize(
    ("facts", "rms", "need"),
    [
        (FINE, 0.002, None),
        (replace(FINE, own=2), 0.002, Need.POKES),
        (FINE, 0.0031, Need.ACCURACY),
        (replace(FINE, diversity=np.radians(14)), 0.002, Need.SIDES),
        (replace(FINE, beside=0.0011), 0.002, Need.BALANCE),
        (replace(FINE, pulled=0.0011), 0.002, Need.DEPTH),
        (replace(FINE, pulled=-0.0011), 0.002, Need.DEPTH),
        (replace(FINE, moved=0.0006), 0.002, Need.SETTLED),
        (replace(FINE, moved=np.inf), 0.002, Need.SETTLED),
    ],
)
def test_a_taxel_is_done_when_nothing_is_missing(facts, rms, need):
    one = replace(known(0, TAXEL, 0.001), rms=rms)
    assert find_needs(one, facts, Method.FREE, SETTINGS, SKIN) == (() if need is None else (need,))
    on_surface = find_needs(one, facts, Method.SURFACE, SETTINGS, SKIN)
    assert on_surface == (() if need in (None, Need.SIDES, Need.DEPTH) else (need,))


def test_a_dead_taxel_needs_nothing_and_an_unseen_one_does():
    dead = Estimate(0, Method.FREE, State.DEAD, 0, reason=StateReason(Cause.GIVEN, text="stuck"))
    nothing = Facts(0, 0.0, 0.0, 0.0, np.inf)
    assert find_needs(dead, nothing, Method.FREE, SETTINGS, SKIN) == ()
    assert {Need.POKES, Need.ACCURACY, Need.SIDES} <= set(find_needs(unseen(0), nothing, Method.FREE, SETTINGS, SKIN))
