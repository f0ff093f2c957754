"""Ways around a part: hardly longer than the shortest, and the ones of the plain rule."""

from itertools import pairwise

import numpy as np
import pytest

from skincal.mesh.surface import make_surface
from skincal.robot.clearance import MIN_CHORD_M, OUTSIDE_HULL_TOLERANCE_M, Clearance
from skincal.simulation.example_parts import forearm
from tests.skincal.robot.client_benches import BOX, HALF

MARGIN = 0.03
WAYS = 6
"""Starts and goals of each shape."""


def test_a_way_around_a_box_is_hardly_longer_than_the_shortest():
    clearance, margin = Clearance(BOX, MARGIN), MARGIN
    top = np.array([0.0, 0.0, HALF[2] + margin])
    way = clearance.ways(top, -top)[0]
    corners = np.array([top, *(each.position for each in way), -top])
    length = np.linalg.norm(np.diff(corners, axis=0), axis=1).sum()
    shortest = 2.0 * (HALF[0] + HALF[2]) + np.pi * margin
    assert shortest < length < 1.05 * shortest
    assert clearance.ways(top, top + 0.05 * np.eye(3)[0]) == [[]]


class PlainClearance(Clearance):
    """The same ways by the plain rule: every face of the hull counts for every straight line, one line after another."""

    def stays_outside(self, start, goal):
        room, slopes = self._offsets - OUTSIDE_HULL_TOLERANCE_M - self._normals @ start, self._normals @ (goal - start)
        enters, leaves = 0.0, 1.0
        for space, slope in zip(room.tolist(), slopes.tolist(), strict=True):
            if abs(slope) < 1e-12:
                if space < 0.0:
                    return True
            elif slope < 0.0:
                enters = max(enters, space / slope)
            else:
                leaves = min(leaves, space / slope)
        return (leaves - enters) * np.linalg.norm(goal - start) <= MIN_CHORD_M

    def _cut_corners(self, start, outline, goal, *_):
        kept, at, place = [], 0, start
        while not self.stays_outside(place, goal) and at < len(outline):
            free = [n for n in range(at, len(outline)) if self.stays_outside(place, outline[n].position)]
            at = free[-1] if free else at
            kept.append(outline[at])
            place, at = outline[at].position, at + 1
        return kept


def directions(rng, count):
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def round_part(rng):
    """Make a part whose hull has slanted faces of many directions."""
    points = directions(rng, 40) * [0.02, 0.05, 0.03]
    return make_surface(points, np.arange(39).reshape(-1, 3))


@pytest.mark.parametrize("shape", ["box", "round", "forearm"])
def test_ways_are_those_of_the_plain_rule(shape, rng):
    surface = {"box": lambda: BOX, "round": lambda: round_part(rng), "forearm": lambda: forearm().mesh(300)}[shape]()
    quick, plain = Clearance(surface, MARGIN), PlainClearance(surface, MARGIN)
    middle = (surface.vertices.min(axis=0) + surface.vertices.max(axis=0)) / 2.0
    bends = 0
    for _ in range(WAYS):
        start, goal = (quick.exit_point(middle, push) for push in directions(rng, 2))
        found, expected = quick.ways(start, goal), plain.ways(start, goal)
        assert [len(way) for way in found] == [len(way) for way in expected]
        for way, other in zip(found, expected, strict=True):
            bends += len(way)
            for corner, same in zip(way, other, strict=True):
                np.testing.assert_allclose(corner.position, same.position, rtol=0.0, atol=1e-12)
                np.testing.assert_allclose(corner.direction, same.direction, rtol=0.0, atol=1e-12)
            places = [start, *(corner.position for corner in way), goal]
            assert all(plain.stays_outside(*line) for line in pairwise(places))
    assert bends > 8 * WAYS, "the ways go around"
