"""Names of landmarks by the shape of touched points, against points that were moved, shaken and mixed here."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.rig.landmark_match import match_landmarks

SD = 0.001
PART = np.array([[-40, -35, 0], [45, -30, 0], [30, 35, 12], [-20, 30, 25], [5, -10, 30]]) * 1e-3
UP = np.tile([0.0, 0.0, 1.0], (5, 1))


def touched(order, rng, places=PART, strays=0, error=0.0007):
    """Touches of the landmarks `order` and strays of a part that lies anywhere: points, pushes and true rows."""
    turn, shift = Rotation.random(random_state=int(rng.integers(1 << 31))).as_matrix(), rng.normal(0.0, 0.5, 3)
    true = np.array([*order, *[-1] * strays])
    inside = rng.uniform(places.min(axis=0), places.max(axis=0), (strays, 3))
    points = np.concatenate([places[list(order)] + error * rng.standard_normal((len(order), 3)), inside])
    mixed = rng.permutation(len(points))
    return points[mixed] @ turn.T + shift, np.tile(-UP[:1] @ turn.T, (len(points), 1)), true[mixed]


def match(points, pushes, places=PART, known=None):
    unnamed = np.full(len(points), -1)
    return match_landmarks(points, pushes, places, UP[: len(places)], SD, unnamed if known is None else known)


@pytest.mark.parametrize(("order", "strays"), [((0, 1, 2, 3), 0), ((4, 2, 0, 1, 3), 3), ((0, 0, 3, 1, 3, 4), 1)])
def test_touches_are_named_wherever_the_part_lies_and_in_any_order(order, strays):
    rng = np.random.default_rng(5)
    for _ in range(20):
        points, pushes, true = touched(order, rng, strays=strays)
        found = match(points, pushes)
        assert found.rival is None
        assert found.landmark[true >= 0].tolist() == true[true >= 0].tolist()
        assert found.miss < 0.002


def test_equal_distances_leave_names_open_until_one_is_known():
    square = np.array([[-30, -30, 0], [30, -30, 0], [30, 30, 0], [-30, 30, 0]]) * 1e-3
    points, pushes, true = touched(range(4), np.random.default_rng(6), square)
    found = match(points, pushes, square)
    assert found.rival is not None
    assert (found.rival != found.landmark).all(), "a quarter turn"
    known = np.where(true == 2, true, -1)
    sure = match(points, pushes, square, known)
    assert sure.rival is None, "the pushes are from above"
    assert sure.landmark.tolist() == true.tolist()


def test_a_mirrored_shape_and_another_one_are_not_named():
    points, pushes, _ = touched(range(5), np.random.default_rng(7))
    assert match(1.2 * points, pushes) is None
    mirrored = match(points * [1.0, 1.0, -1.0], pushes * [1.0, 1.0, -1.0])
    assert mirrored is None or (mirrored.landmark < 0).any()
    assert match(points[:2], pushes[:2]) is None
    assert match(points, pushes, np.linspace([0.0, 0, 0], [0.1, 0, 0], 5)) is None, "a line"
