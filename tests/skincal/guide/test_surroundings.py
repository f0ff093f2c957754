"""Taxels between touched ones, against convex hulls of scipy; and the guide that asks for touches where they are missing."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from skincal.files.layout_sources import parse_grid
from skincal.guide.surroundings import SURROUNDING_MAX_SPACINGS, Surroundings
from skincal.model.skin import read_layout


def grid(text: str):
    size = parse_grid(text)
    return read_layout(size.layout_text(), Path("grid.modules.toml"), size.rows * size.columns)


def in_hull(place, points) -> bool:
    """Tell by the facets of scipy's hull whether a place lies in it, or on its border."""
    if len(points) < 3 or np.linalg.matrix_rank(points[1:] - points[0], tol=1e-9) < 2:
        return False
    return bool((ConvexHull(points).equations @ [*place, 1.0] <= 1e-9).all())


@pytest.mark.parametrize("seed", range(6))
def test_a_taxel_is_covered_if_the_hull_of_touched_neighbours_holds_it(seed):
    layout, rng = grid("7x9@6mm"), np.random.default_rng(seed)
    touched = rng.random(63) < (0.1, 0.2, 0.3, 0.4, 0.6, 0.8)[seed]
    places, reach = layout.places, SURROUNDING_MAX_SPACINGS * 0.006 + 1e-9
    expected = []
    for channel in range(63):
        near = touched & (np.linalg.norm(places - places[channel], axis=1) <= reach)
        expected.append(bool(touched[channel]) or (near.any() and in_hull(places[channel], places[near])))
    found = Surroundings(layout, layout.channels).touched_or_surrounded(touched)
    assert found.tolist() == expected
    assert np.sum(found) > 0


def test_touched_taxels_on_one_line_do_not_surround_those_between_them():
    """The turn about the line stays open; a layout that is a line has nothing else."""
    layout = grid("5x5@5mm")
    row, and_one_more = np.isin(np.arange(25), [10, 12, 14]), np.isin(np.arange(25), [10, 12, 14, 2])
    around = Surroundings(layout, layout.channels)
    assert not around.touched_or_surrounded(row)[[11, 13]].any()
    assert around.touched_or_surrounded(and_one_more)[[11, 13]].all()
    strip = grid("1x5@5mm")
    assert Surroundings(strip, strip.channels).touched_or_surrounded(np.isin(np.arange(5), [0, 2, 4])).all()


def test_corners_must_be_touched_and_edges_every_few_taxels():
    layout = grid("6x6@5mm")
    corners = np.isin(np.arange(36), [0, 5, 30, 35])
    around = Surroundings(layout, layout.channels)
    # From 0 to 5 are five spacings.
    covered = around.touched_or_surrounded(corners | (np.arange(36) == 14))
    assert covered[[2, 3, 12, 32]].all()
    assert not covered[[1, 4]].any(), "one corner is beyond three spacings"
    without = around.touched_or_surrounded(~corners)
    assert not without[corners].any()
    assert without[~corners].all()
    assert not around.touched_or_surrounded(np.zeros(36, dtype=bool)).any()


def test_a_single_taxel_and_modules_of_other_planes_are_no_neighbours():
    one = grid("1x1@5mm")
    assert Surroundings(one, one.channels).touched_or_surrounded(np.array([False])).tolist() == [False]
    text = parse_grid("1x3@5mm").layout_text()
    anchor = "anchor = { at_mm = [0, 0], point_mm = [0, 0, 0], x = [1, 0, 0], normal = [0, 0, 1] }\n"
    second = (
        text.partition("\n[[modules]]")[2]
        .replace("id = 1", "id = 2")
        .replace("first_channel = 0", "first_channel = 3")
        .replace("[0.0, 0.0]", "[15.0, 0.0]")
    )
    apart = read_layout(f"{text}\n[[modules]]{second}{anchor}", Path("two.modules.toml"), 6)
    touched = np.array([True, False, True, False, False, True])
    assert Surroundings(apart, apart.channels).touched_or_surrounded(touched).tolist() == [True, True, True, False, False, True]
    joined = read_layout(f"{text}\n[[modules]]{second}", Path("two.modules.toml"), 6)
    assert Surroundings(joined, joined.channels).touched_or_surrounded(touched).all(), (
        "without the anchor they are one row of six"
    )


def test_the_number_of_touches_is_that_of_squares_of_three_spacings():
    layout = grid("16x16@5mm")
    around = Surroundings(layout, layout.channels)
    assert around.count_touches(np.ones(256, dtype=bool)) == 25
    assert around.count_touches(np.zeros(256, dtype=bool)) == 0
    assert around.count_touches(np.arange(256) < 1) == 1
