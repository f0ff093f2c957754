"""Statistics of a taxel's contacts, believed positions and gains of pushes: each by another route."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.guide import candidates
from skincal.guide.believed_positions import PlannedPlaces, _add_to_groups
from skincal.guide.progress import GuideSettings
from skincal.guide.taxel_statistics import TaxelStatistics, axis_diversity
from skincal.mesh.surface import pairs_within
from skincal.model.scene import NoiseSettings
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.noise import offset_square
from skincal.taxels.result import Estimate, Method, State
from skincal.taxels.solve import solve
from tests.skincal.estimate_support import believed_positions
from tests.skincal.taxels.test_solve_uncertainty import pokes, sensor_pose

NOISE = NoiseSettings(radius=1e9)
NORMAL = np.array([0.0, 0.6, 0.8])
TAXEL = np.array([0.03, 0.02, 0.01])


def contacts_and_evidence(count=8, weights=(1.0, 0.8, 0.4)):
    contacts = pokes(np.random.default_rng(1), count, TAXEL, NORMAL, sensor_pose(), NOISE, 0.5, weights)
    return contacts, ContactTable(contacts).evidence([0])


def statistics(evidence, in_plane=False, centres=None):
    found = TaxelStatistics(np.array([0]), NOISE, 1e9, in_plane)
    centres = centres or dict.fromkeys(evidence.pokes.tolist(), TAXEL)
    found.recompute(np.array([0]), evidence, TAXEL[None], TAXEL[None], NORMAL[None], centres)
    return found


def test_information_is_the_sum_over_contacts_of_rows_by_their_noise():
    _, evidence = contacts_and_evidence()
    expected = np.zeros((3, 3))
    for i, (e, lever) in enumerate(zip(evidence.pairs, TAXEL - evidence.sensors, strict=True)):
        # Force noise df moves the row e_j.(p - a) by -(e_k.(p x df))/|f|: written out over the force's three directions.
        size, other = evidence.forces[i], np.stack([e[1], -e[0]])
        moved = np.array([np.cross(lever, axis) for axis in np.eye(3)]) @ other.T / size
        noise = NOISE.force**2 * moved.T @ moved + (NOISE.moment / size) ** 2 * np.eye(2)
        noise += (NOISE.contact**2 - NOISE.reach**2 * np.log(evidence.weights[i])) * np.eye(2)
        expected += e.T @ np.linalg.inv(noise) @ e
    np.testing.assert_allclose(statistics(evidence).information[0], expected, rtol=1e-9)


@pytest.mark.parametrize("angle", [5.0, 15.0, 28.0])
def test_diversity_of_four_axes_on_a_cone_is_its_half_angle(angle):
    _, evidence = contacts_and_evidence(4, weights=(1.0,))
    turn, around = np.radians(angle), 2 * np.pi * np.arange(4) / 4
    columns = evidence.columns.copy()
    columns[0:3] = np.stack([np.sin(turn) * np.cos(around), np.sin(turn) * np.sin(around), np.full(4, np.cos(turn))])
    assert np.degrees(axis_diversity(replace(evidence, columns=columns))[0]) == pytest.approx(angle, rel=1e-9)
    assert np.degrees(axis_diversity(contacts_and_evidence(1, weights=(1.0,))[1])[0]) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("in_plane", [False, True])
def test_the_last_shift_is_what_solving_without_the_last_own_poke_gives(in_plane):
    contacts, evidence = contacts_and_evidence(9)
    last = max(evidence.pokes[evidence.weights == 1.0].tolist())
    some = contacts, [contact for contact in contacts if contact.poke != last]
    answers = [solve(ContactTable(each).evidence([0]), [], NOISE, None, doubting=False).answer[0] for each in some]
    points = [answer["solution"] for answer in answers]
    if in_plane:
        basis = np.linalg.svd(NORMAL[None])[2][1:].T
        points = [np.linalg.lstsq(answer["root"] @ basis, answer["offset"], rcond=None)[0] for answer in answers]
    assert statistics(evidence, in_plane).last_shift[0] == pytest.approx(np.linalg.norm(points[0] - points[1]), rel=1e-4)


def test_the_depth_bias_is_what_solving_with_shifted_axes_gives():
    _, evidence = contacts_and_evidence(9)
    off = 0.002 * np.random.default_rng(3).standard_normal((9, 3))
    centres = dict(zip(evidence.pokes.tolist(), TAXEL + off, strict=True))
    rows = evidence.weights[:, None, None] * evidence.pairs
    sides = [np.sum(rows * places[:, None], axis=2).ravel() for places in (evidence.nearest, evidence.nearest + off)]
    still, shifted = (np.linalg.lstsq(rows.reshape(-1, 3), side)[0] for side in sides)
    found = statistics(evidence, centres=centres).depth_bias[0]
    assert found == pytest.approx((shifted - still) @ NORMAL, rel=1e-6)
    assert abs(found) > 1e-4
    assert statistics(evidence).depth_bias[0] == pytest.approx(0.0, abs=1e-12)
    assert statistics(evidence, True, centres).depth_bias[0] == 0.0, "a mesh holds the depth"


def test_own_pokes_are_those_that_the_taxel_answers_most():
    contacts, evidence = contacts_and_evidence(9)
    found = statistics(evidence)
    assert found.own[0] == sum(contact.responses[0] == contact.responses.max() for contact in contacts)
    assert found.contacts[0] == 9
    assert np.isinf(statistics(contacts_and_evidence(1, weights=(1.0,))[1]).last_shift[0]), "one poke is not settled"


@pytest.mark.parametrize("in_plane", [False, True])
def test_contacts_without_trust_and_removed_contacts_leave_nothing(in_plane):
    _, evidence = contacts_and_evidence()
    found = statistics(evidence.trusted(np.zeros(len(evidence.trust))), in_plane)
    assert (found.diversity[0], found.last_shift[0]) == (0.0, np.inf)
    assert not found.offset[0].any()
    assert np.isfinite(found.information[0]).all()
    found.recompute(np.array([0]), ContactTable().evidence([0]), TAXEL[None], TAXEL[None], NORMAL[None], {})
    fresh = TaxelStatistics(np.array([0]), NOISE, 1e9, in_plane)
    for name in ("information", "diversity", "own", "contacts", "offset", "depth_bias", "last_shift"):
        np.testing.assert_array_equal(getattr(found, name), getattr(fresh, name))


# ---- believed positions ----


def grid(side=5, step=0.005):
    x, y = np.meshgrid(step * np.arange(side), step * np.arange(side), indexing="ij")
    places = np.stack([x.ravel(), y.ravel(), np.zeros(side * side)], axis=1)
    normals = np.tile([0.0, 0.0, 1.0], (side * side, 1))
    return PlannedPlaces(np.arange(side * side), places, normals, np.zeros(side * side, dtype=np.int64))


def estimates(**known):
    """25 estimates, of which some are known: `t3=(position, sd)`."""
    found = [Estimate(i, Method.SURFACE, State.UNSEEN, 0) for i in range(25)]
    for name, (place, sd) in known.items():
        i = int(name[1:])
        found[i] = replace(found[i], state=State.TOUCHED, position=np.array(place), covariance=sd**2 * np.eye(3))
    return found


def test_a_skin_off_its_plan_is_found_from_a_few_taxels():
    plan, shift = grid(), np.array([0.003, -0.002, 0.0])
    np.testing.assert_allclose(believed_positions(plan, estimates()), plan.places, atol=1e-15)
    known = estimates(**{f"t{i}": (plan.places[i] + shift, 0.001) for i in (0, 6, 18)})
    off = np.linalg.norm(believed_positions(plan, known) - plan.places - shift, axis=1)
    assert off.max() < 0.0005
    assert off[[0, 6, 18]].max() < off[24]


def test_one_rough_estimate_moves_the_skin_little_and_a_taxel_without_a_plan_is_where_it_is_estimated():
    plan = grid()
    rough = {"t3": (plan.places[3] + [0.02, 0, 0], 0.02)}
    assert 0.0 < (believed_positions(plan, estimates(**rough)) - plan.places)[20, 0] < 0.002
    bare = replace(plan, places=np.where(np.arange(25)[:, None] == 7, np.nan, plan.places))
    found = believed_positions(bare, estimates(**rough, t7=([0.1, 0.2, 0.3], 0.001)))
    np.testing.assert_allclose(found[7], [0.1, 0.2, 0.3])


# ---- gains ----


def test_answering_taxels_are_the_nearest_within_reach():
    plan = grid()
    found = candidates.find_answering(plan.places, 0.005, NOISE)
    apart = np.linalg.norm(plan.places[:, None] - plan.places, axis=2)
    for row in range(25):
        own = found.rows[row][found.weights[row] > 0]
        near = set(np.flatnonzero((apart[row] <= candidates.NEIGHBOUR_MAX_SPACINGS * 0.005) & (apart[row] > 0)).tolist())
        assert (own[0], set(own[1:].tolist())) == (row, near)
    assert found.weights[12, 1] == pytest.approx(np.exp(-((0.005 / (2 * NOISE.reach)) ** 2)))


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("reach", [0.0, 1e-3, 0.02, 0.1, 50.0])
def test_pairs_are_those_of_comparing_all(rng, reach, flat):
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


def state(information, in_plane=False):
    plan = grid()
    return candidates.PokeChoice(
        plan.places,
        candidates.candidate_pushes(plan.normals, GuideSettings().usable_tilt),
        candidates.find_answering(plan.places, 0.005, NOISE),
        information, plan.normals, np.array([0.0, 0.0, -0.18]), 0.0, in_plane, np.ones(25), np.zeros(25), NOISE,
    )  # fmt: skip


def test_a_gain_is_by_how_much_the_predicted_errors_fall():
    """Each neighbour's information with the poke's rows added, inverted again."""
    rng, force = np.random.default_rng(3), candidates.EXPECTED_PUSH_FORCE_N
    information = np.array([a @ a.T + 1e3 * np.eye(3) for a in 400 * rng.normal(size=(25, 3, 3))])
    here, rows = state(information), np.array([6, 12])
    for row, gain in zip(rows, here.predict_gains(rows, 0.3), strict=True):
        for push in range(candidates.PUSHES_PER_TAXEL):
            e, expected = np.linalg.svd(here.pushes[row, push][None])[2][1:], 0.0
            for place, (other, weight) in enumerate(zip(here.neighbours.rows[row], here.neighbours.weights[row], strict=True)):
                if weight == 0:
                    continue
                q = here.places[other] - here.sensor
                less = NOISE.force / force * np.array([-e[1] @ q, e[0] @ q])
                even = (NOISE.moment / force) ** 2 + (NOISE.force / force) ** 2 * q @ q
                noise = (even + offset_square(np.array([weight]), NOISE)[0]) * np.eye(2) - np.outer(less, less)
                after = information[other] + weight * e.T @ np.linalg.inv(noise) @ e
                lower = np.sqrt(np.trace(np.linalg.inv(information[other]))) - np.sqrt(np.trace(np.linalg.inv(after)))
                expected += lower * (1.0 if place == 0 else 0.3)
            assert gain[push] == pytest.approx(expected, rel=1e-9)
    before, after = here.predict_error(6, 4)
    assert before == pytest.approx(np.sqrt(np.trace(np.linalg.inv(information[6]))))
    assert after < before


def test_an_uncertain_depth_wants_tilt_and_on_a_surface_none():
    information = np.tile(np.diag([1e6, 1e6, 1e4]), (25, 1, 1))
    free, held = (state(information, flat).predict_gains(np.array([12]), 0.0)[0] for flat in (False, True))
    assert free[0] < 0.2 * free.max()
    assert free.argmax() > candidates.PUSH_AZIMUTHS_TRIED, "the largest tilt"
    assert held[0] > 0.95 * held.max()


def test_rows_are_added_to_groups_as_one_after_the_other():
    rng = np.random.default_rng(0)
    for count in (1, 7, 40):
        groups, begin = rng.integers(0, count, 300), rng.normal(size=(count, 9))
        values = rng.normal(size=(300, 9)) * 10.0 ** rng.integers(-8, 8, (300, 1))
        added = begin.copy()
        np.add.at(added, groups, values)
        assert _add_to_groups(begin, groups, values).tolist() == added.tolist()
    assert _add_to_groups(begin, groups[:0], values[:0]).tolist() == begin.tolist()
