"""The gates alone, and stillness against what is drawn by hand."""

import numpy as np
import pytest

from skincal.contacts.gates import widest_gap
from skincal.contacts.press import axis_slide, force_spread, still_share


def test_the_widest_gap_is_that_between_two_groups():
    line = np.array([[0, 0], [1, 0], [2, 0], [7, 0], [8, 0]], float)
    assert widest_gap(line) == 5.0
    assert widest_gap(line[::-1]) == 5.0
    assert widest_gap(line[:1]) == 0.0
    ring = np.array([[np.cos(a), np.sin(a)] for a in np.arange(6) * np.pi / 3])
    assert widest_gap(ring) == pytest.approx(1.0)


def test_the_spread_does_not_depend_on_the_unit_or_the_direction():
    force = np.random.default_rng(1).normal(5, 0.3, (15, 3))
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    size = np.linalg.norm(force, axis=1)
    assert force_spread(force) == pytest.approx(size.std() / size.mean())
    assert force_spread(1000 * force @ turn.T) == pytest.approx(force_spread(force))


def test_the_still_share_counts_back_to_the_last_jerk():
    force = np.zeros((15, 3))
    force[:, 2] = 8.0
    assert still_share(force, 0.05) == 15
    force[9, 2] = 16.0
    assert still_share(force, 0.05) == 5


def _wrenches(points, force):
    return np.broadcast_to(force, points.shape), np.cross(points, force)


def test_the_travel_is_the_way_across_the_force_wherever_the_sensor_is():
    times = np.arange(15) * 0.02
    force = np.array([1.0, -3.0, -7.0])
    unit = force / np.linalg.norm(force)
    way = np.linspace(0, 1, 15)[:, None] * np.array([0.002, 0.001, -0.003])
    across = np.linalg.norm(way[-1] - unit * (way[-1] @ unit))
    for place in ([0.0, 0.0, 0.0], [0.1, 0.2, 0.05], [-0.3, 0.02, 0.1]):
        force_n, moment = _wrenches(way + place, force)
        assert axis_slide(force_n, moment, times) == pytest.approx(across, rel=1e-3)


def test_the_travel_turns_with_everything():
    rng = np.random.default_rng(3)
    times = np.arange(15) * 0.02 + 100.0
    force = rng.normal([0, 0, -8], 0.2, (15, 3))
    moment = np.cross(rng.normal(0, 0.002, (15, 3)) + np.linspace(0, 0.006, 15)[:, None] + [0.05, 0, 0.1], force)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    plain = axis_slide(force, moment, times)
    assert plain > 0.001
    assert axis_slide(force @ turn.T, moment @ turn.T, times) == pytest.approx(plain, rel=1e-9)


def test_a_force_that_turns_about_the_contact_travels_nowhere():
    times = np.arange(15) * 0.02
    angle = np.linspace(0, 0.2, 15)
    force = 8 * np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=1)
    point = np.array([0.02, 0.03, 0.08])
    assert axis_slide(force, np.cross(point, force), times) < 1e-6
