"""Two sets of places beside each other: what is known of their difference, found again; and module by module."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.model.scene import load_scene, resource
from skincal.model.skin import KINDS, Layout, Module
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

SCENE = load_scene(resource("scenes/icub-forearm/scene.toml"))
LAYOUT = SCENE.skin.layout
CHANNELS = LAYOUT.channels
OWNERS = LAYOUT.module_of[CHANNELS]


def turn_of(rng: np.random.Generator) -> np.ndarray:
    """A proper rotation, any."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def bent(rng: np.random.Generator, layout: Layout = LAYOUT) -> np.ndarray:
    """The layout's taxels in space, each board a little bent: three dimensions matter."""
    flat = layout.places[layout.channels]
    return np.concatenate([flat, 0.002 * rng.normal(size=(len(flat), 1))], axis=1)


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
    assert worst_rows(lengths, 3).tolist() == [3, 10, 20]


def test_of_nothing_that_both_know_there_is_nothing_to_say():
    nothing = np.full((84, 3), np.nan)
    lengths = differences(nothing, np.zeros((84, 3)))[1]
    assert summarise(lengths) is None
    assert summarise(np.empty(0)) is None
    assert worst_rows(lengths, 5).tolist() == []
    assert compare_modules(LAYOUT, CHANNELS, nothing, np.zeros((84, 3))) == ()


def test_the_worst_are_the_known_ones_and_no_more_than_there_are():
    lengths = np.array([np.nan, 0.002, 0.002, 0.005, np.nan, 0.0])
    assert worst_rows(lengths, 2).tolist() == [3, 1]
    assert worst_rows(lengths, 10).tolist() == [3, 1, 2, 5]


def test_a_module_that_moves_keeps_its_shape_and_its_shift_is_the_way_of_its_middle(rng):
    here, there, shifts = bent(rng), bent(rng), []
    for index in range(len(LAYOUT.modules)):
        rows = np.flatnonzero(index == OWNERS)
        middle, shift = here[rows].mean(axis=0), rng.normal(size=3) * 0.01
        there[rows] = (here[rows] - middle) @ turn_of(rng).T + middle + shift
        shifts.append(np.linalg.norm(shift))
    found = compare_modules(LAYOUT, CHANNELS, here, there)
    assert [difference.module for difference in found] == list(range(len(LAYOUT.modules)))
    assert all(difference.known == 12 for difference in found)
    np.testing.assert_allclose([difference.shift for difference in found], shifts, rtol=1e-9)
    np.testing.assert_allclose([difference.shape for difference in found], 0.0, atol=1e-12)
    lengths = differences(here, there)[1]
    np.testing.assert_allclose([difference.mean for difference in found], [lengths[i == OWNERS].mean() for i in range(7)])


def test_a_module_that_grows_has_a_shape_of_just_that_and_no_shift(rng):
    here, there = bent(rng), bent(rng)
    for index, share in enumerate(np.linspace(0.5, 1.5, 7)):
        rows = np.flatnonzero(index == OWNERS)
        middle = here[rows].mean(axis=0)
        there[rows] = middle + share * (here[rows] - middle) @ turn_of(rng).T
    for index, difference in enumerate(compare_modules(LAYOUT, CHANNELS, here, there)):
        rows = np.flatnonzero(index == OWNERS)
        spread = np.sqrt(np.mean(np.sum((here[rows] - here[rows].mean(axis=0)) ** 2, axis=1)))
        assert difference.shape == pytest.approx(abs(np.linspace(0.5, 1.5, 7)[index] - 1.0) * spread, abs=1e-12)
        assert difference.shift == pytest.approx(0.0, abs=1e-12)


def test_scatter_is_what_another_route_finds(rng):
    """Against the same least squares by scipy, module by module."""
    from scipy.spatial.transform import Rotation

    here = bent(rng)
    there = here @ turn_of(rng).T + 0.002 * rng.normal(size=here.shape)
    for difference in compare_modules(LAYOUT, CHANNELS, here, there):
        a, b = (each[difference.module == OWNERS] for each in (here, there))
        _, left = Rotation.align_vectors(b - b.mean(axis=0), a - a.mean(axis=0))
        assert difference.shape == pytest.approx(left / np.sqrt(len(a)), rel=1e-6)


def test_the_answer_does_not_change_where_everything_is_moved_alike(rng):
    here, there = bent(rng), bent(rng) + 0.003 * rng.normal(size=(84, 3))
    turn, shift = turn_of(rng), rng.normal(size=3)
    for difference, moved in zip(
        compare_modules(LAYOUT, CHANNELS, here, there),
        compare_modules(LAYOUT, CHANNELS, here @ turn.T + shift, there @ turn.T + shift),
        strict=True,
    ):
        assert (moved.mean, moved.shift, moved.shape) == pytest.approx(
            (difference.mean, difference.shift, difference.shape), rel=1e-9
        )


def test_from_one_to_the_other_is_as_far_as_back(rng):
    here, there = bent(rng), bent(rng) + 0.003 * rng.normal(size=(84, 3))
    for difference, back in zip(
        compare_modules(LAYOUT, CHANNELS, here, there), compare_modules(LAYOUT, CHANNELS, there, here), strict=True
    ):
        assert (back.mean, back.shift, back.shape) == pytest.approx(
            (difference.mean, difference.shift, difference.shape), rel=1e-9
        )


def test_a_mirrored_module_is_not_fitted_by_a_reflection(rng):
    here = bent(rng)
    here[:, 2] = 0.01 * rng.normal(size=84)  # So crooked that no turn makes up for a reflection.
    there = here * [-1.0, 1.0, 1.0]
    assert min(difference.shape for difference in compare_modules(LAYOUT, CHANNELS, here, there)) > 0.001


def test_a_flat_module_that_is_turned_over_lies_on_its_mirror_image():
    """A flat module and its mirror image are the same from behind: distinguished by `find_misplaced_modules`."""
    flat = np.concatenate([LAYOUT.places[CHANNELS], np.zeros((84, 1))], axis=1)
    found = compare_modules(LAYOUT, CHANNELS, flat, flat * [-1.0, 1.0, 1.0])
    np.testing.assert_allclose([difference.shape for difference in found], 0.0, atol=1e-12)


def test_two_taxels_have_a_shift_and_no_shape(rng):
    here = bent(rng)
    there = here + np.array([0.0, 0.003, 0.004])
    known = np.zeros(84, dtype=bool)
    known[np.flatnonzero(OWNERS == 2)[:2]] = known[np.flatnonzero(OWNERS == 5)[:3]] = True
    there[~known] = np.nan
    found = compare_modules(LAYOUT, CHANNELS, here, there)
    assert [(difference.module, difference.known) for difference in found] == [(2, 2), (5, 3)]
    assert [difference.shift for difference in found] == pytest.approx([0.005, 0.005])
    assert found[0].shape is None
    assert found[1].shape == pytest.approx(0.0, abs=1e-12)


def test_channels_of_no_module_are_in_no_module(rng):
    here = rng.normal(size=(LAYOUT.width, 3))
    found = compare_modules(LAYOUT, np.arange(LAYOUT.width), here, here + np.array([0.001, 0.0, 0.0]))
    assert [difference.known for difference in found] == [12] * 7


def estimate(channel: int, at) -> Estimate:
    if at is None:
        return Estimate(channel, Method.FREE, State.UNSEEN, 0)
    return Estimate(channel, Method.FREE, State.ESTIMATED, 3, np.array(at, dtype=float))


def test_places_stand_in_the_order_of_the_estimates():
    places = places_of([estimate(4, None), estimate(2, (1, 2, 3)), estimate(9, (4, 5, 6))])
    np.testing.assert_array_equal(places, [[np.nan] * 3, [1, 2, 3], [4, 5, 6]])
    assert places_of([]).shape == (0, 3)


def test_each_module_has_its_own_spacing():
    flat = np.concatenate([LAYOUT.places[CHANNELS], np.zeros((84, 1))], axis=1)
    shares = np.array([0.5, 0.8, 1.0, 1.1, 1.3, 1.0, 0.9])
    ratios = neighbours_of(LAYOUT).ratios(CHANNELS, flat * shares[OWNERS, None])
    np.testing.assert_allclose(ratios[:-1], shares)
    assert ratios[-1] == pytest.approx(shares.mean())
    flat[OWNERS == 3] = np.nan
    ratios = neighbours_of(LAYOUT).ratios(CHANNELS, flat)
    assert np.flatnonzero(np.isnan(ratios)).tolist() == [3]


@pytest.mark.parametrize(("modules", "most_s"), [(7, 0.003), (350, 0.015)])
def test_it_costs_little_enough_for_every_poke(rng, least_time, modules, most_s):
    kind = KINDS["triangle_12"]
    layout = Layout(tuple(Module(i, kind, 12 * i, np.array([0.03 * i, 0.0]), 0.0, False) for i in range(modules)), 12 * modules)
    here, neighbours = bent(rng, layout), neighbours_of(layout)
    there = here + 0.003 * rng.normal(size=here.shape)

    def work():
        lengths = differences(here, there)[1]
        summarise(lengths)
        worst_rows(lengths, 10)
        compare_modules(layout, layout.channels, here, there)
        neighbours.ratios(layout.channels, there)

    assert least_time(work, below=most_s) < most_s


def test_a_motion_of_all_taxels_is_found_again_and_leaves_nothing(rng):
    here = bent(rng)
    axis = np.array([1.0, -2.0, 2.0]) / 3.0
    turn = Rotation.from_rotvec(np.radians(7.0) * axis).as_matrix()
    there = (here - here.mean(axis=0)) @ turn.T + here.mean(axis=0) + np.array([0.003, 0.0, -0.004])
    there[5] = np.nan
    here[6] = np.nan
    known = np.isfinite(here).all(axis=1) & np.isfinite(there).all(axis=1)
    found = common_motion(here, there)
    assert found.turn == pytest.approx(np.radians(7.0), abs=1e-12)
    assert found.shift == pytest.approx(np.linalg.norm((there - here)[known].mean(axis=0)), rel=1e-9)
    assert found.largest < 1e-15
    repeated = repeatability(here, there, OWNERS)
    assert repeated.motion == found
    assert repeated.summary.known == known.sum()
    assert repeated.modules == compare_modules(LAYOUT, CHANNELS, here, there)
    assert max(each.shape for each in repeated.modules) < 1e-15


@pytest.mark.parametrize("degrees", [1e-6, 90.0, 179.999999])
def test_small_and_large_turns_keep_their_digits(rng, degrees):
    here = bent(rng)
    turn = Rotation.from_rotvec(np.radians([0.0, degrees, 0.0])).as_matrix()
    assert np.degrees(common_motion(here, here @ turn.T).turn) == pytest.approx(degrees, rel=1e-6)


def test_what_is_no_motion_is_left_over_and_a_mirror_is_not_taken_for_a_turn(rng):
    here = bent(rng)
    there = here + 0.001 * rng.normal(size=here.shape)
    best = common_motion(here, there)
    rest = np.sqrt(np.sum((there - here - (there - here).mean(axis=0)) ** 2, axis=1))
    assert 0.0005 < best.mean < rest.mean() + 1e-6
    mirrored = common_motion(here, here * [-1.0, 1.0, 1.0])
    assert mirrored.mean > 0.001


def test_two_taxels_or_a_line_of_them_tell_no_motion_and_taxels_without_modules_no_modules(rng):
    here = bent(rng)
    few = np.full_like(here, np.nan)
    few[:2] = here[:2]
    assert common_motion(few, here) is None
    line = np.outer(np.arange(5.0), [1.0, 2.0, 3.0])
    assert common_motion(line, line) is None
    assert repeatability(here, here).modules == ()
    assert [each.known for each in repeatability(here[:4], here[:4], np.array([-1, 1, 1, -1])).modules] == [2]
