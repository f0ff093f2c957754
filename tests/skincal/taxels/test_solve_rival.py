"""A second place that fits nearly as well: found, reported with the right odds, and only where there is one."""

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.mesh.surface import make_surface
from skincal.model.scene import NoiseSettings
from skincal.taxels.result import Method, State
from skincal.taxels.solve import RIVAL_ESTIMATE_MAX_ODDS
from tests.skincal.estimate_support import solve

NOISE = NoiseSettings()


def plates(*depths: float, cells: int = 12, half: float = 0.06):
    """Square plates that face +z, one below the other."""
    grid = np.linspace(-half, half, cells + 1)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    i = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    flat = np.concatenate(
        [np.stack([i, i + cells + 1, i + 1], axis=1), np.stack([i + 1, i + cells + 1, i + cells + 2], axis=1)]
    )
    count = (cells + 1) ** 2
    vertices = [np.stack([x.ravel(), y.ravel(), np.full(count, z)], axis=1) for z in depths]
    return make_surface(np.concatenate(vertices), np.concatenate([flat + n * count for n in range(len(depths))]))


def press(number, point, push, moment_noise=None):
    force = 8.0 * np.asarray(push, dtype=float) / np.linalg.norm(push)
    moment = np.cross(point, force) + (0 if moment_noise is None else moment_noise)
    return Contact(number, 0, 1, force, moment, np.array([0]), np.array([50.0]), np.eye(4), "", 0.0, True)


def stairs(depth: float = 0.03):
    """Two plates that face +z: one on the left, the other one `depth` below on the right."""
    surface = plates(0.0, -depth)
    moved = surface.vertices + np.where(surface.vertices[:, 2:] < -depth / 2, [0.06, 0, 0], [-0.06, 0, 0])
    return make_surface(moved, surface.triangles)


LEANING = np.array([2 / 3, 0.0, -1.0])
"""Push that meets both stairs, 10 mm from their edges."""


def test_one_axis_through_two_stairs_may_mean_either():
    estimate = solve([press(1, [-0.01, 0, 0], LEANING)], [0], Method.SURFACE, NOISE, stairs())[0]
    assert estimate.state is State.TOUCHED
    np.testing.assert_allclose(estimate.position, [-0.01, 0, 0], atol=1e-12)
    assert estimate.rival is not None
    np.testing.assert_allclose(estimate.rival.position, [0.01, 0.0, -0.03], atol=1e-12)
    assert estimate.rival.odds == pytest.approx(1.0, abs=0.01)


def test_pokes_from_two_sides_leave_no_rival():
    contacts = [press(i, np.zeros(3), [0.4 * s, 0.0, -1.0]) for i, s in enumerate((-1, 1), start=1)]
    estimate = solve(contacts, [0], Method.SURFACE, NOISE, plates(0.0, -0.03))[0]
    np.testing.assert_allclose(estimate.position, 0.0, atol=1e-12)
    assert estimate.rival is None


@pytest.mark.parametrize(("depths", "tilt"), [((0.0,), 0.0), ((0.0,), 0.3), ((0.0, -0.5), 0.3)])
def test_a_single_place_has_no_rival(depths, tilt):
    rng, surface = np.random.default_rng(1), plates(*depths)
    for _ in range(5):
        contacts = [press(i, [0.01, 0.02, 0.0], [*rng.normal(0, tilt, 2), -1.0]) for i in range(1, 6)]
        estimate = solve(contacts, [0], Method.SURFACE, NOISE, surface)[0]
        assert estimate.state is State.TOUCHED
        assert estimate.rival is None


def test_the_far_side_of_a_tube_is_no_rival_since_a_poke_pushes_inward():
    angle = np.linspace(0, 2 * np.pi, 65)[:-1]
    ring = np.stack([0.04 * np.cos(angle), 0.04 * np.sin(angle)], axis=1)
    vertices = np.concatenate([np.c_[ring, np.full(64, z)] for z in (0.0, 0.1)])
    i, j = np.arange(64), (np.arange(64) + 1) % 64
    tube = make_surface(vertices, np.concatenate([np.stack([i, j, i + 64], axis=1), np.stack([j, j + 64, i + 64], axis=1)]))
    estimate = solve([press(1, [0.04, 0.0, 0.05], [-1.0, 0.0, 0.0])], [0], Method.SURFACE, NOISE, tube)[0]
    assert estimate.position[0] > 0
    assert estimate.rival is None


def test_the_odds_are_those_of_being_wrong():
    """The truth is on either plate as often: of estimates with given odds, 1/(1 + odds) must be on the wrong one."""
    # All noise is in the moment, so that what is drawn is what the model says.
    noise = NoiseSettings(force=1e-9, moment=0.02, contact=1e-9, reach=1e-9)
    surface, rng = stairs(), np.random.default_rng(2)
    wrong, expected, variance, seen, alone, missed = 0, 0.0, 0.0, 0, 0, 0
    for _ in range(600):
        upper = bool(rng.integers(2))
        place = np.array([-0.01, 0.0, 0.0]) if upper else np.array([0.01, 0.0, -0.03])
        tilts = rng.normal(0, 0.15, (3, 2))
        pushes = LEANING + np.c_[tilts, np.zeros(3)]
        contacts = [press(i, place, push, 0.02 * rng.standard_normal(3)) for i, push in enumerate(pushes, start=1)]
        estimate = solve(contacts, [0], Method.SURFACE, noise, surface)[0]
        if estimate.position is None:
            continue
        is_wrong = upper != (estimate.position[2] > -0.01)
        if estimate.rival is None:
            alone, missed = alone + 1, missed + is_wrong
            continue
        assert 1.0 <= estimate.rival.odds < RIVAL_ESTIMATE_MAX_ODDS
        share = 1.0 / (1.0 + estimate.rival.odds)
        seen, wrong, expected, variance = seen + 1, wrong + is_wrong, expected + share, variance + share * (1 - share)
    assert seen > 100
    assert abs(wrong - expected) < 3.5 * np.sqrt(variance)
    assert alone > 100
    assert missed <= alone / (1.0 + RIVAL_ESTIMATE_MAX_ODDS), "no rival means odds above the limit"
