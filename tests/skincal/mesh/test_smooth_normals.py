"""Normals of the smooth part behind a mesh: against surfaces whose normal is known by a formula, creases, thin walls, turns."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.mesh.smooth_normals import smooth_normals
from skincal.mesh.surface import make_surface
from tests.skincal.mesh.mesh_support import folded, together, tube

FOOTPRINT_M = 0.0025


def points_on(surface, count=200, seed=3):
    """Random points of a surface with their triangles."""
    rng = np.random.default_rng(seed)
    triangles = rng.integers(0, len(surface.triangles), count)
    return np.einsum("ij,ijk->ik", rng.dirichlet([1, 1, 1], count), surface.corners[triangles]), triangles


def angles_deg(first, second):
    return np.degrees(np.arccos(np.clip(np.sum(first * second, axis=1), -1, 1)))


def round_normals(points):
    """Of a cylinder about z."""
    return np.c_[points[:, :2] / np.linalg.norm(points[:, :2], axis=1, keepdims=True), np.zeros(len(points))]


def wave_normals(points, depth=0.02, length=0.1):
    """Of `folded(waves=1)` at its point nearest to each point: a chord of the mesh lies beside the surface."""
    at, normals = points[:, :2], np.empty_like(points)
    for _ in range(20):
        x, y = 2 * np.pi / length * at[:, 0], np.pi / length * at[:, 1]
        slopes = np.pi * depth / length * np.c_[2 * np.cos(x) * np.cos(y), -np.sin(x) * np.sin(y)]
        normals = np.c_[-slopes, np.ones(len(at))] / np.sqrt(1 + np.sum(slopes**2, axis=1, keepdims=True))
        off = np.sum((points - np.c_[at, depth * np.sin(x) * np.cos(y)]) * normals, axis=1)
        at = (points - off[:, None] * normals)[:, :2]
    return normals


@pytest.mark.parametrize(
    ("surface", "truth", "facets_deg", "smooth_deg"),
    [
        (tube(24, 24, radius=0.07, length=0.12, turn=0.28), round_normals, 1.5, 0.05),  # the bent plate
        (tube(24, 12), round_normals, 4.0, 0.2),
        (tube(40, 2), round_normals, 2.0, 0.5),  # long strips, as CAD makes of a cylinder
        (folded(40, waves=1), wave_normals, 3.0, 1.0),
    ],
    ids=["plate", "coarse tube", "strips", "waves"],
)
def test_normals_of_analytic_surfaces(surface, truth, facets_deg, smooth_deg):
    points, triangles = points_on(surface)
    found = smooth_normals(surface, points, triangles, FOOTPRINT_M)
    errors = angles_deg(found.normals, truth(points))
    assert angles_deg(surface.normals[triangles], truth(points)).max() > facets_deg, "the facets alone are worse"
    assert errors.max() < smooth_deg
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, rtol=1e-14)
    assert np.mean(errors < 2.45 * np.degrees(found.sd)) > 0.9, "the predicted error covers the true one"


def test_neighbours_on_a_coarse_round_part_turn_by_the_part_s_own_bend():
    surface = tube(24, 12)  # facets of 9 degrees, 6.3 mm wide
    angles = np.radians(np.linspace(-60, 60, 41))
    points = 0.04 * np.c_[np.cos(angles), np.sin(angles), np.full(41, 0.7)]
    inside = surface.centres.T
    triangles = np.array([np.linalg.norm(inside - p, axis=1).argmin() for p in points])
    steps = np.diff(np.degrees(np.arctan2(*smooth_normals(surface, points, triangles, FOOTPRINT_M).normals[:, [1, 0]].T)))
    np.testing.assert_allclose(steps, 3.0, atol=0.3)


def test_a_crease_stays_a_crease_and_the_inner_wall_does_not_count():
    # Two faces at a right angle, and a wall 3 mm inside of the first, wound the other way.
    cells = np.linspace(0, 0.04, 9)
    a, b = np.meshgrid(cells, cells, indexing="ij")
    vertices = [
        np.stack([a, b, np.zeros_like(a)], axis=-1),
        np.stack([np.zeros_like(a), b, a - 0.04], axis=-1),
        np.stack([a, b, np.full_like(a, -0.003)], axis=-1),
    ]
    i = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    quads = np.concatenate([np.stack([i, i + 9, i + 1], axis=1), np.stack([i + 1, i + 9, i + 10], axis=1)])
    sides = [quads, quads[:, ::-1], quads[:, ::-1]]
    merged = np.concatenate([v.reshape(-1, 3) for v in vertices])
    unique, back = np.unique(merged.round(9), axis=0, return_inverse=True)
    surface = make_surface(unique, back.ravel()[np.concatenate([s + 81 * k for k, s in enumerate(sides)])])
    points, triangles = points_on(surface, 300)
    found = smooth_normals(surface, points, triangles, 0.004)
    np.testing.assert_allclose(found.normals, surface.normals[triangles], atol=1e-9)


def test_a_turned_and_moved_part_has_turned_normals_and_equal_errors():
    surface, turn = folded(20, waves=1), Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    points, triangles = points_on(surface, 50)
    covariances = np.broadcast_to(np.diag([1e-6, 4e-6, 9e-6]), (50, 3, 3))
    first = smooth_normals(surface, points, triangles, FOOTPRINT_M, covariances)
    moved = make_surface(surface.vertices @ turn.T + [0.3, 0.1, -0.2], surface.triangles)
    second = smooth_normals(moved, points @ turn.T + [0.3, 0.1, -0.2], triangles, FOOTPRINT_M, turn @ covariances @ turn.T)
    np.testing.assert_allclose(second.normals, first.normals @ turn.T, atol=1e-9)
    np.testing.assert_allclose(second.sd, first.sd, rtol=1e-6)


def test_the_error_of_the_position_turns_the_normal_by_the_part_s_bend():
    surface = tube(60, 30)
    points, triangles = points_on(surface, 50)
    around = np.cross([0.0, 0.0, 1.0], round_normals(points))
    covariances = 1e-6 * np.einsum("ni,nj->nij", around, around)  # 1 mm around the tube of 40 mm: 1/40 rad
    found = smooth_normals(surface, points, triangles, FOOTPRINT_M, covariances)
    assert np.median(found.sd) == pytest.approx(1 / 40, rel=0.02)
    along = np.broadcast_to(np.diag([0.0, 0.0, 1e-6]), (50, 3, 3))
    assert np.median(smooth_normals(surface, points, triangles, FOOTPRINT_M, along).sd) < 0.1 / 40


def test_a_lone_triangle_keeps_its_own_normal_without_an_error():
    surface = together(make_surface([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]], [[0, 1, 2]]))
    found = smooth_normals(surface, np.array([[0.002, 0.002, 0.0]]), np.array([0]), FOOTPRINT_M)
    assert found.normals.tolist() == [[0.0, 0.0, 1.0]]
    assert np.isnan(found.sd).all()
