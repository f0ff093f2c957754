"""Two sets of positions: known differences are found again, per taxel, per module and as a whole."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.model.scene import load_scene, resource
from skincal.modules.health import neighbours_of
from skincal.taxels.differences import (
    common_motion,
    compare_modules,
    differences,
    places_of,
    repeatability,
    summarise,
    worst_rows,
)
from skincal.taxels.result import Estimate, Method, State

LAYOUT = load_scene(resource("scenes/icub-forearm/scene.toml")).skin.layout
CHANNELS = LAYOUT.channels
OWNERS = LAYOUT.module_of[CHANNELS]


def turn_of(rng):
    return Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()


def bent(rng, layout=LAYOUT):
    """The layout's taxels in space, each board a little bent: three dimensions matter."""
    flat = layout.places[layout.channels]
    return np.concatenate([flat, 0.002 * rng.normal(size=(len(flat), 1))], axis=1)


def figures(found):
    return np.array([(each.mean, each.shift, each.shape) for each in found])


def test_differences_and_their_summary_are_those_that_were_made(rng):
    here = bent(rng)
    ways = np.zeros_like(here)
    ways[3], ways[10], ways[20] = (0.003, 0.0, 0.004), (0.0, 0.002, 0.0), (0.0, 0.0, -0.001)
    there = here + ways
    there[40], here[41] = np.nan, np.nan
    found, lengths = differences(here, there)
    known = np.isfinite(lengths)
    assert np.flatnonzero(~known).tolist() == [40, 41]
    np.testing.assert_allclose(found[known], ways[known], atol=1e-15)
    summary = summarise(lengths)
    assert (summary.known, summary.row) == (len(here) - 2, 3)
    assert summary.largest == pytest.approx(0.005)
    assert summary.mean == pytest.approx(0.008 / summary.known)
    assert summary.rms == pytest.approx(np.sqrt((25 + 4 + 1) * 1e-6 / summary.known))


def test_the_worst_rows_are_known_ones_and_nothing_known_gives_nothing():
    lengths = np.array([np.nan, 0.002, 0.002, 0.005, np.nan, 0.0])
    assert (worst_rows(lengths, 2).tolist(), worst_rows(lengths, 10).tolist()) == ([3, 1], [3, 1, 2, 5])
    nothing = np.full((84, 3), np.nan)
    unknown = differences(nothing, np.zeros((84, 3)))[1]
    assert (summarise(unknown), summarise(np.empty(0)), worst_rows(unknown, 5).tolist()) == (None, None, [])
    assert compare_modules(OWNERS, nothing, np.zeros((84, 3))) == ()


def test_a_module_that_moves_and_grows_has_that_shift_and_that_shape(rng):
    here, there, expected = bent(rng), bent(rng), []
    for index, share in enumerate(np.linspace(0.5, 1.5, 7)):
        rows = np.flatnonzero(index == OWNERS)
        middle, shift = here[rows].mean(axis=0), 0.01 * rng.normal(size=3)
        there[rows] = share * (here[rows] - middle) @ turn_of(rng).T + middle + shift
        mean = np.linalg.norm(there[rows] - here[rows], axis=1).mean()
        spread = np.sqrt(np.mean(np.sum((here[rows] - middle) ** 2, axis=1)))
        expected.append((mean, np.linalg.norm(shift), abs(share - 1.0) * spread))
    found = compare_modules(OWNERS, here, there)
    assert [(each.module, each.known) for each in found] == [(index, 12) for index in range(7)]
    np.testing.assert_allclose(figures(found), expected, rtol=1e-9, atol=1e-12)


def test_scatter_is_what_another_route_finds(rng):
    here = bent(rng)
    there = here @ turn_of(rng).T + 0.002 * rng.normal(size=here.shape)
    for difference in compare_modules(OWNERS, here, there):
        a, b = (each[difference.module == OWNERS] for each in (here, there))
        _, left = Rotation.align_vectors(b - b.mean(axis=0), a - a.mean(axis=0))
        assert difference.shape == pytest.approx(left / np.sqrt(len(a)), rel=1e-6)


def test_a_common_motion_and_the_direction_of_comparison_change_nothing(rng):
    here, there = bent(rng), bent(rng) + 0.003 * rng.normal(size=(84, 3))
    turn, shift = turn_of(rng), rng.normal(size=3)
    plain = figures(compare_modules(OWNERS, here, there))
    np.testing.assert_allclose(
        figures(compare_modules(OWNERS, here @ turn.T + shift, there @ turn.T + shift)), plain, rtol=1e-9
    )
    np.testing.assert_allclose(figures(compare_modules(OWNERS, there, here)), plain, rtol=1e-9)


@pytest.mark.parametrize("crooked", [True, False])
def test_a_mirrored_module_is_not_fitted_by_a_reflection(rng, crooked):
    """A flat one is its own mirror image from behind; `find_misplaced_modules` distinguishes it."""
    here = bent(rng)
    here[:, 2] = 0.01 * rng.normal(size=84) if crooked else 0.0
    shapes = figures(compare_modules(OWNERS, here, here * [-1.0, 1.0, 1.0]))[:, 2]
    assert (shapes > 0.001).all() if crooked else (shapes < 1e-12).all()
    assert (common_motion(here, here * [-1.0, 1.0, 1.0]).mean > 0.001) is crooked


def test_two_taxels_have_a_shift_and_no_shape_and_channels_without_a_module_do_not_count(rng):
    here = bent(rng)
    there, known = here + np.array([0.0, 0.003, 0.004]), np.zeros(84, dtype=bool)
    known[np.flatnonzero(OWNERS == 2)[:2]] = known[np.flatnonzero(OWNERS == 5)[:3]] = True
    there[~known] = np.nan
    found = compare_modules(OWNERS, here, there)
    assert [(difference.module, difference.known) for difference in found] == [(2, 2), (5, 3)]
    assert [difference.shift for difference in found] == pytest.approx([0.005, 0.005])
    assert found[0].shape is None
    assert found[1].shape == pytest.approx(0.0, abs=1e-12)
    every = rng.normal(size=(LAYOUT.width, 3))
    assert [each.known for each in compare_modules(LAYOUT.module_of, every, every + 0.001)] == [12] * 7


def test_positions_are_in_the_order_of_the_estimates():
    known = [Estimate(i, Method.FREE, State.TOUCHED, 3, np.array([i, 2.0, 3.0])) for i in (2, 9)]
    places = places_of([Estimate(4, Method.FREE, State.UNSEEN, 0), *known])
    np.testing.assert_array_equal(places, [[np.nan] * 3, [2, 2, 3], [9, 2, 3]])
    assert places_of([]).shape == (0, 3)


def test_each_module_has_its_own_spacing():
    flat = np.concatenate([LAYOUT.places[CHANNELS], np.zeros((84, 1))], axis=1)
    shares = np.array([0.5, 0.8, 1.0, 1.1, 1.3, 1.0, 0.9])
    ratios = neighbours_of(LAYOUT).ratios(CHANNELS, flat * shares[OWNERS, None])
    np.testing.assert_allclose(ratios, [*shares, shares.mean()])
    flat[OWNERS == 3] = np.nan
    assert np.flatnonzero(np.isnan(neighbours_of(LAYOUT).ratios(CHANNELS, flat))).tolist() == [3]


def test_a_motion_of_all_taxels_is_found_again_and_leaves_nothing(rng):
    here = bent(rng)
    turn = Rotation.from_rotvec(np.radians(7.0) * np.array([1.0, -2.0, 2.0]) / 3.0).as_matrix()
    there = (here - here.mean(axis=0)) @ turn.T + here.mean(axis=0) + np.array([0.003, 0.0, -0.004])
    there[5], here[6] = np.nan, np.nan
    known = np.isfinite(here).all(axis=1) & np.isfinite(there).all(axis=1)
    found = repeatability(here, there, OWNERS)
    assert found.motion == common_motion(here, there)
    assert found.motion.turn == pytest.approx(np.radians(7.0), abs=1e-12)
    assert found.motion.shift == pytest.approx(np.linalg.norm((there - here)[known].mean(axis=0)), rel=1e-9)
    assert found.motion.largest < 1e-15
    assert found.summary.known == known.sum()
    assert max(each.shape for each in found.modules) < 1e-15


@pytest.mark.parametrize("degrees", [1e-6, 90.0, 179.999999])
def test_small_and_large_turns_keep_their_digits(rng, degrees):
    here = bent(rng)
    turn = Rotation.from_rotvec(np.radians([0.0, degrees, 0.0])).as_matrix()
    assert np.degrees(common_motion(here, here @ turn.T).turn) == pytest.approx(degrees, rel=1e-6)


def test_two_taxels_or_a_line_of_them_show_no_motion_and_the_rest_of_a_motion_is_the_least(rng):
    here = bent(rng)
    few, line = np.full_like(here, np.nan), np.outer(np.arange(5.0), [1.0, 2.0, 3.0])
    few[:2] = here[:2]
    assert common_motion(few, here) is common_motion(line, line) is None
    there = here + 0.001 * rng.normal(size=here.shape)
    rest = np.sqrt(np.sum((there - here - (there - here).mean(axis=0)) ** 2, axis=1))
    assert 0.0005 < common_motion(here, there).mean < rest.mean() + 1e-6
    assert repeatability(here, here).modules == ()
