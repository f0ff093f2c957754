"""The second-best place on a surface: the same as by looking at every triangle."""

from collections import defaultdict

import numpy as np
import pytest
from mesh_support import (
    facing_minima,
    folded,
    part_of,
    poked,
    random_metrics,
    same,
    second_to_rows,
    soup,
    together,
    tube,
)  # fmt: skip

from skincal.mesh.search import nearest_in_metric
from skincal.mesh.surface import make_surface

TIE = 1e-12


def walked(surface, root, offset, push, best, radius, limit):
    """Return the second minimum's distance by walks over the surface in plain Python; None where there is none.

    Triangles with a common corner that are equally near are one place; a place from which no triangle around it is nearer
    is a minimum.
    """
    facing, distance, points = facing_minima(surface, root, offset, push)
    tie = TIE * np.abs(root).max()
    near = np.linalg.norm(points - best, axis=1) <= radius
    around = defaultdict(set)
    for k, triangle in enumerate(facing):
        for vertex in surface.triangles[triangle]:
            around[vertex].add(k)
    wanted = np.flatnonzero((distance**2 <= limit) & ~near)
    for k in wanted[np.argsort(distance[wanted])]:
        # Neither near the first nor lower than k: as long as that holds, the place grows.
        place, ahead, alone = {k}, [k], True
        while ahead and alone:
            met = set().union(*[around[vertex] for vertex in surface.triangles[facing[ahead.pop()]]]) - place
            level = [other for other in met if distance[other] <= distance[k] + tie]
            alone = not near[level].any() and bool((distance[level] >= distance[k] - tie).all())
            place |= set(level)
            ahead += level
        if alone:
            return distance[k]
    return None


SHAPES = {
    "tube": lambda: tube(25, 20, bump=0.003),
    "folded": folded,
    "layers": lambda: together(tube(25, 20), tube(25, 20, radius=0.037)),
    "soup": lambda: soup(np.random.default_rng(3), 200),
}


@pytest.mark.parametrize("kind", ["full rank", "near-parallel", "one axis"])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_second_minimum_is_that_of_walks_over_every_triangle(shape, kind):
    rng = np.random.default_rng(5)
    surface = SHAPES[shape]()
    asked = random_metrics(rng, surface, 40, kind)
    best = nearest_in_metric(surface, *asked)
    radius = rng.uniform(0.002, 0.02, 40)
    limit = best.values + (np.abs(asked[0]).max(axis=(1, 2)) * rng.uniform(0, 0.03, 40)) ** 2
    second = second_to_rows(surface, *asked, best, radius, limit)
    for i in range(40):
        distance = walked(surface, *[part[i] for part in asked], best.points[i], radius[i], limit[i])
        assert (distance is None) == (second.triangles[i] < 0)
        if distance is not None:
            size = np.abs(asked[0][i]).max()
            assert np.sqrt(second.values[i]) == pytest.approx(distance, abs=2 * TIE * size)
            off = asked[0][i] @ second.points[i] - asked[1][i]
            assert np.linalg.norm(off) == pytest.approx(distance, abs=1e-10 * size)
            assert surface.normals[second.triangles[i]] @ asked[2][i] < 0
            assert np.linalg.norm(second.points[i] - best.points[i]) > radius[i]
    if shape == "folded":
        assert (second.triangles >= 0).sum() > 10, "the case has what it is there for"
    every = second_to_rows(surface, *asked, best, radius, limit, every=True)
    assert same(second, every), "the tree leaves nothing out"


def down(count):
    return np.tile([0.0, 0.0, -1.0], (count, 1))


def test_two_valleys_are_both_found_and_one_valley_only_once():
    """A wave along x of which the target sees two crests alike."""
    surface = folded(60, 0.02, 1)
    targets = np.array([[0.0, -0.02, 0.03], [0.02, -0.02, 0.03]])
    asked = np.tile(np.eye(3), (2, 1, 1)), targets, down(2)
    best = nearest_in_metric(surface, *asked)
    for radius in (0.002, 0.01):
        second = second_to_rows(surface, *asked, best, np.full(2, radius), np.full(2, 1.0))
        walks = [walked(surface, *[part[i] for part in asked], best.points[i], radius, 1.0) for i in range(2)]
        for i, distance in enumerate(walks):
            assert (distance is None) == (second.triangles[i] < 0)
            assert distance is None or second.values[i] == pytest.approx(distance**2)
    tight = second_to_rows(surface, *asked, best, np.full(2, 0.002), best.values * (1 + 1e-9))
    assert (tight.triangles < 0).all()
    assert np.isnan(tight.points).all()
    assert np.isinf(tight.values).all()


def test_a_wall_behind_the_first_is_a_second_place_for_a_single_axis():
    far = folded(20, 0.0)
    both = together(make_surface(far.vertices + np.array([0.0, 0.0, 0.05]), far.triangles), far)
    asked = np.diag([1.0, 1.0, 0.0])[None], np.array([[0.0031, 0.0042, 0.0]]), down(1)
    best = nearest_in_metric(both, *asked)
    second = second_to_rows(both, *asked, best, np.array([0.01]), np.array([1e-9]))
    np.testing.assert_allclose(best.points[0], [0.0031, 0.0042, 0.05], atol=1e-12)
    np.testing.assert_allclose(second.points[0], [0.0031, 0.0042, 0.0], atol=1e-12)


def test_a_level_valley_has_no_second_place_however_long_it_is():
    """One direction only is seen: every triangle the line crosses is equally near, and all hang together."""
    surface = folded(30, 0.0)
    asked = np.diag([1.0, 0.0, 0.0])[None], np.array([[0.0011, 0.0, 0.0]]), down(1)
    best = nearest_in_metric(surface, *asked)
    assert best.values[0] < 1e-30
    assert second_to_rows(surface, *asked, best, np.array([0.005]), np.array([1e-9])).triangles[0] == -1


def test_a_smooth_part_has_one_place_for_each_taxel():
    rng = np.random.default_rng(7)
    surface = tube(60, 50)
    asked = poked(rng, surface, 300, 5)
    best = nearest_in_metric(surface, *asked)
    second = second_to_rows(surface, *asked, best, np.full(300, 0.008), best.values + 0.006**2)
    assert (second.triangles == -1).all()


def test_where_there_is_no_first_there_is_no_second():
    surface = folded(10, 0.0)
    asked = np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)), -down(2)
    best = nearest_in_metric(surface, *asked)
    assert (best.triangles == -1).all()
    assert (second_to_rows(surface, *asked, best, np.full(2, 0.001), np.full(2, np.inf)).triangles == -1).all()


def test_a_second_place_does_not_depend_on_the_other_taxels():
    rng = np.random.default_rng(11)
    surface = folded()
    asked = random_metrics(rng, surface, 150, "full rank")
    best = nearest_in_metric(surface, *asked)
    radius, limit = np.full(150, 0.01), best.values + (np.abs(asked[0]).max(axis=(1, 2)) * 0.02) ** 2
    many = second_to_rows(surface, *asked, best, radius, limit)
    assert (many.triangles >= 0).sum() > 20
    for i in range(60):
        part = slice(i, i + 1)
        own = part_of(best, part)
        one = second_to_rows(surface, *[array[part] for array in asked], own, radius[part], limit[part])
        assert same(one, part_of(many, part))
