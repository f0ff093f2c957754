"""Normals of the smooth part behind a mesh: formulas for round parts, creases, fillets, slivers, noise, turns."""

import numpy as np
import pytest
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from skincal.mesh.search import nearest_points
from skincal.mesh.smooth_normals import smooth_normals
from skincal.mesh.surface import make_surface
from tests.skincal.mesh.mesh_support import bent_plate, folded, grid, together, tube, turned_over

FOOTPRINT_M = 0.0025


def points_on(surface, count=300, seed=3):
    """Random points of a surface, evenly by area, with their triangles."""
    rng, (a, b, c) = np.random.default_rng(seed), surface.corners.transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    triangles = rng.choice(len(areas), count, p=areas / areas.sum())
    return np.einsum("ij,ijk->ik", rng.dirichlet([1, 1, 1], count), surface.corners[triangles]), triangles


def angles_deg(first, second):
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(first - second, axis=1) / 2, 0, 1)))


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def cylinder(points, _facets=None):
    """Of a cylinder about z."""
    return unit(points * [1, 1, 0])


def sphere(points, _facets=None):
    return unit(points)


def cone(points, _facets=None):
    """Of `cone_mesh`: its radius grows by 0.3 a metre."""
    return unit(np.c_[unit(points * [1, 1, 0])[:, :2], np.full(len(points), -0.3)])


def torus(points, _facets=None):
    """Of `torus_mesh`: 60 mm about z, 15 mm thick."""
    return unit(points - 0.06 * unit(points * [1, 1, 0]))


def plate(points, facets):
    """Of both walls of `bent_plate`; its rim keeps its own."""
    outward = unit(points * [1, 0, 1])
    along = np.sum(outward * facets, axis=1)
    return np.where(np.abs(along)[:, None] > 0.9, outward * np.sign(along)[:, None], facets)


def wave(points, _facets=None, depth=0.02, length=0.1):
    """Of `folded(waves=1)` at its point nearest to each point: a chord of the mesh lies beside the surface."""
    at, normals = points[:, :2], np.empty_like(points)
    for _ in range(20):
        x, y = 2 * np.pi / length * at[:, 0], np.pi / length * at[:, 1]
        slopes = np.pi * depth / length * np.c_[2 * np.cos(x) * np.cos(y), -np.sin(x) * np.sin(y)]
        normals = unit(np.c_[-slopes, np.ones(len(at))])
        off = np.sum((points - np.c_[at, depth * np.sin(x) * np.cos(y)]) * normals, axis=1)
        at = (points - off[:, None] * normals)[:, :2]
    return normals


def irregular(shape, across, along, count, seed=0):
    """A mesh of random points of `shape(u, v)` in a rectangle, outward where u x v is."""
    rng, cells = np.random.default_rng(seed), int(np.sqrt(count))
    edge = np.linspace(0, 1, cells + 1)
    rim = [np.c_[edge, 0 * edge], np.c_[edge, 0 * edge + 1], np.c_[0 * edge, edge][1:-1], np.c_[0 * edge + 1, edge][1:-1]]
    flat = np.concatenate([*rim, rng.uniform(0.5 / cells, 1 - 0.5 / cells, (count, 2))])
    triangles = Delaunay(flat).simplices
    one, two = (flat[triangles[:, k]] - flat[triangles[:, 0]] for k in (1, 2))
    turned = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0] < 0
    triangles[turned] = triangles[turned][:, ::-1]
    u, v = (low + (high - low) * flat[:, k] for k, (low, high) in enumerate((across, along)))
    return make_surface(shape(u, v), triangles)


def cylinder_mesh(u, v, radius=0.07):
    return np.stack([radius * np.cos(u), radius * np.sin(u), v], axis=-1)


def sphere_mesh(u, v):
    return 0.04 * np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=-1)


def torus_mesh(u, v):
    wide = 0.06 + 0.015 * np.cos(v)
    return np.stack([wide * np.cos(u), wide * np.sin(u), 0.015 * np.sin(v)], axis=-1)


def cone_mesh(u, v):
    return cylinder_mesh(u, v, 0.02 + 0.3 * v)


def on_grid(shape, u, v):
    return grid(shape(*np.meshgrid(u, v, indexing="ij")))


ROUND = {
    # surface, truth, facets' largest error, smooth: rms and 95 % (the plate: all), degrees
    "plate, 8 facets": (bent_plate(8, 6), plate, 6.0, 0.3, 1.0),
    "plate, 32 facets": (bent_plate(32, 24), plate, 1.5, 0.05, 0.2),
    "plate, irregular, coarse": (irregular(cylinder_mesh, (-0.8, 0.8), (0, 0.12), 150), cylinder, 8.0, 0.3, 1.0),
    "plate, irregular, fine": (irregular(cylinder_mesh, (-0.8, 0.8), (0, 0.12), 3000), cylinder, 2.0, 0.1, 0.3),
    "tube of 16 facets": (tube(16, 12, turn=1.0), cylinder, 11.0, 0.9, 1.7),
    "tube of long strips": (tube(40, 1, turn=1.0), cylinder, 4.0, 0.2, 0.4),
    "sphere": (irregular(sphere_mesh, (-0.7, 0.7), (-0.7, 0.7), 1000), sphere, 3.0, 0.3, 0.4),
    "torus": (irregular(torus_mesh, (-1, 1), (-1.3, 1.3), 2000), torus, 6.0, 0.4, 0.6),
    "cone": (on_grid(cone_mesh, np.linspace(0, 2 * np.pi, 25), np.linspace(0, 0.1, 13)), cone, 6.0, 0.6, 1.0),
    "waves": (folded(40, waves=1), wave, 4.0, 0.4, 0.6),
}


@pytest.mark.parametrize("name", ROUND)
def test_normals_of_round_parts(name):
    surface, truth, facets_deg, rms_deg, most_deg = ROUND[name]
    points, triangles = points_on(surface)
    right, found = truth(points, surface.normals[triangles]), smooth_normals(surface, points, triangles, FOOTPRINT_M)
    errors, sd = angles_deg(found.normals, right), np.degrees(found.sd)
    assert angles_deg(surface.normals[triangles], right).max() > facets_deg, "the facets alone are worse"
    assert np.sqrt(np.mean(errors**2)) < rms_deg
    assert np.percentile(errors, 100 if "plate" in name else 95) < most_deg
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, rtol=1e-14)
    assert np.mean(errors <= 2 * sd + 0.02) > 0.93, "two standard deviations hold the error"
    assert np.sqrt(np.mean(sd**2)) < 5 * np.sqrt(np.mean(errors**2)), "and are not much larger"


def shin_mesh(u, v):
    wide = 0.035 + 0.012 * np.sin(12 * v)
    return np.stack([1.2 * wide * np.cos(u), wide * np.sin(u) + 0.008 * np.cos(2 * u), v], axis=-1)


def test_normals_of_neighbours_on_a_coarse_shin_turn_as_the_part_does():
    # Facets of up to 25 degrees; taxels 9 mm apart, around and along.
    surface = irregular(shin_mesh, (-1.2, 1.2), (0.02, 0.2), 220)
    u, v = np.meshgrid(np.linspace(-0.8, 0.8, 8), np.linspace(0.05, 0.17, 12), indexing="ij")
    right_points, step = shin_mesh(u, v).reshape(-1, 3), 1e-6
    right = unit(
        np.cross(
            (shin_mesh(u + step, v) - shin_mesh(u - step, v)).reshape(-1, 3),
            (shin_mesh(u, v + step) - shin_mesh(u, v - step)).reshape(-1, 3),
        )
    )
    points, triangles = nearest_points(surface, right_points)
    found = smooth_normals(surface, points, triangles, FOOTPRINT_M).normals.reshape(8, 12, 3)
    own, facets = right.reshape(8, 12, 3), surface.normals[triangles].reshape(8, 12, 3)
    for axis in (0, 1):
        steps = [np.degrees(np.linalg.norm(np.diff(normals, axis=axis), axis=2)) for normals in (found, own, facets)]
        assert (np.abs(steps[0] - steps[1])).max() < 4.0
        assert (np.abs(steps[2] - steps[1])).max() > 8.0, "the facets alone jump"


def profile(flat, radius, steps, angle_deg=90.0, cells=1, width=0.05):
    """A flat face, a fillet and another flat face, drawn along y; flat faces in `cells` squares."""
    angle = np.radians(angle_deg)
    turns = np.linspace(0, angle, steps + 1)[:, None]
    edge = np.linspace(0, flat, cells + 1)[:, None]
    round_ = radius * np.c_[np.sin(turns), np.cos(turns) - 1]
    line = np.concatenate([np.c_[edge - flat, 0 * edge], round_[1:], round_[-1] + edge[1:] * [np.cos(angle), -np.sin(angle)]])
    y = np.linspace(0, width, cells + 1)
    points = np.stack(
        [np.repeat(line[:, :1], cells + 1, 1), np.tile(y, (len(line), 1)), np.repeat(line[:, 1:], cells + 1, 1)], -1
    )

    def truth(places, _facets):
        at = np.clip(np.arctan2(places[:, 0], places[:, 2] + radius), 0.0, angle)
        return np.c_[np.sin(at), 0 * at, np.cos(at)]

    return grid(points), truth


@pytest.mark.parametrize("cells", [1, 12])
@pytest.mark.parametrize("radius", [0.001, 0.003, 0.01, 0.03])
def test_a_flat_face_beside_a_fillet_stays_flat_and_the_fillet_round(radius, cells):
    surface, truth = profile(0.05, radius, 8, cells=cells)
    points, triangles = points_on(surface, 600)
    found, right = smooth_normals(surface, points, triangles, FOOTPRINT_M), truth(points, surface.normals[triangles])
    errors, on_flat = angles_deg(found.normals, right), (points[:, 0] < 0) | (points[:, 2] < -radius)
    facets = angles_deg(surface.normals[triangles], right)
    assert np.percentile(errors[on_flat], 95) < 0.3
    assert np.sqrt(np.mean(errors**2)) < 0.5 * np.sqrt(np.mean(facets**2))
    assert errors.max() < facets.max() + 0.1, "nowhere worse than the facets"
    assert np.mean(errors <= 2 * np.degrees(found.sd) + 0.02) > 0.97


def test_a_chamfer_a_wall_and_a_crease_keep_their_normals():
    for surface in (profile(0.05, 0.003, 1)[0], profile(0.05, 0.01, 1)[0], profile(0.05, 1e-7, 1, 45.0, cells=5)[0]):
        points, triangles = points_on(surface)
        found = smooth_normals(surface, points, triangles, FOOTPRINT_M)
        np.testing.assert_allclose(found.normals, surface.normals[triangles], atol=1e-6)


def test_walls_at_a_right_angle_and_a_thin_wall_keep_their_normals():
    cells = np.linspace(0, 0.04, 9)
    a, b = np.meshgrid(cells, cells, indexing="ij")
    floor, wall = grid(np.stack([a, b, 0 * a], axis=-1)), grid(np.stack([0 * a, b, 0.04 - a], axis=-1))
    inner = turned_over(grid(np.stack([a, b, 0 * a - 0.003], axis=-1)))
    merged = together(floor, wall, inner)
    vertices, back = np.unique(merged.vertices.round(9), axis=0, return_inverse=True)
    surface = make_surface(vertices, back.ravel()[merged.triangles])
    points, triangles = points_on(surface, 300)
    found = smooth_normals(surface, points, triangles, 0.004)
    np.testing.assert_allclose(found.normals, surface.normals[triangles], atol=1e-9)
    assert found.sd.max() < 1e-6


def test_beside_holes_and_rims_a_round_part_stays_round():
    whole = bent_plate(32, 24)
    kept = np.linalg.norm(whole.centres.T - [0.0, 0.0, 0.07], axis=1) > 0.012
    surface = make_surface(whole.vertices, whole.triangles[kept])
    points, triangles = points_on(surface, 2000)
    near = np.linalg.norm(points - [0, 0, 0.07], axis=1) < 0.02
    found = smooth_normals(surface, points[near], triangles[near], FOOTPRINT_M)
    assert near.sum() > 30
    assert angles_deg(found.normals, plate(points[near], surface.normals[triangles[near]])).max() < 0.5


def test_slivers_do_not_matter():
    # Each cell of a plate has a needle of a micrometre along its diagonal.
    u, v = np.linspace(-0.5, 0.5, 13), np.linspace(0, 0.06, 13)
    clean = on_grid(cylinder_mesh, u, v)
    middle = clean.corners.mean(axis=1)
    rows = np.arange(0, len(clean.triangles), 7)
    a, b, c = clean.triangles[rows].T
    ends = 0.5 * (clean.vertices[b] + clean.vertices[c])
    moved = ends + 1e-6 * unit(middle[rows] - ends)
    extra = len(clean.vertices) + np.arange(len(rows))
    triangles = np.delete(clean.triangles, rows, axis=0)
    cut = [np.stack(each, axis=1) for each in ((a, b, extra), (a, extra, c), (b, c, extra))]
    surface = make_surface(np.concatenate([clean.vertices, moved]), np.concatenate([triangles, *cut]))
    assert surface.is_sliver.sum() == len(rows)
    points, where = points_on(surface, 300)
    slim = np.flatnonzero(surface.is_sliver)
    points, where = np.concatenate([points, surface.centres.T[slim]]), np.concatenate([where, slim])
    found = smooth_normals(surface, points, where, FOOTPRINT_M)
    assert np.percentile(angles_deg(found.normals, cylinder(points)), 90) < 1.0
    assert angles_deg(found.normals[300:], cylinder(points[300:])).max() < 3.0, "on the needles"


@pytest.mark.parametrize("noise_m", [2e-5, 5e-5])
def test_the_noise_of_a_scan_is_smoothed_over_the_footprint_and_its_error_predicted(noise_m):
    clean = on_grid(cylinder_mesh, np.linspace(-0.4, 0.4, 57), np.linspace(0, 0.06, 61))
    rng = np.random.default_rng(5)
    surface = make_surface(clean.vertices + noise_m * rng.standard_normal(clean.vertices.shape), clean.triangles)
    points, triangles = points_on(surface, 400)
    found, right = smooth_normals(surface, points, triangles, FOOTPRINT_M), cylinder(points)
    errors, sd = angles_deg(found.normals, right), np.degrees(found.sd)
    facets = angles_deg(surface.normals[triangles], right)
    assert np.sqrt(np.mean(errors**2)) < 0.4 * np.sqrt(np.mean(facets**2))
    assert np.mean(errors <= 2 * sd) > 0.9
    assert 0.7 < np.sqrt(np.mean(sd**2) / np.mean(errors**2)) < 1.6


def test_a_turned_and_moved_part_has_turned_normals_and_equal_errors():
    surface, turn = folded(20, waves=1), Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    points, triangles = points_on(surface, 50)
    covariances = np.broadcast_to(np.diag([1e-6, 4e-6, 9e-6]), (50, 3, 3))
    first = smooth_normals(surface, points, triangles, FOOTPRINT_M, covariances)
    moved = make_surface(surface.vertices @ turn.T + [0.3, 0.1, -0.2], surface.triangles)
    second = smooth_normals(moved, points @ turn.T + [0.3, 0.1, -0.2], triangles, FOOTPRINT_M, turn @ covariances @ turn.T)
    np.testing.assert_allclose(second.normals, first.normals @ turn.T, atol=1e-8)
    np.testing.assert_allclose(second.sd, first.sd, rtol=1e-5)


def test_the_error_of_the_position_turns_the_normal_by_the_part_s_bend():
    surface = tube(60, 30)
    points, triangles = points_on(surface, 50)
    around = np.cross([0.0, 0.0, 1.0], cylinder(points))
    covariances = 1e-6 * np.einsum("ni,nj->nij", around, around)  # 1 mm around the tube of 40 mm: 1/40 rad
    found = smooth_normals(surface, points, triangles, FOOTPRINT_M, covariances)
    assert np.median(found.sd) == pytest.approx(1 / 40, rel=0.03)
    along = np.broadcast_to(np.diag([0.0, 0.0, 1e-6]), (50, 3, 3))
    assert np.median(smooth_normals(surface, points, triangles, FOOTPRINT_M, along).sd) < 0.1 / 40


def test_a_lone_triangle_keeps_its_own_normal():
    surface = make_surface([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]], [[0, 1, 2]])
    found = smooth_normals(surface, np.array([[0.002, 0.002, 0.0]]), np.array([0]), FOOTPRINT_M)
    np.testing.assert_allclose(found.normals, [[0.0, 0.0, 1.0]], atol=1e-15)
    assert np.isfinite(found.sd).all()


def test_the_answer_of_a_point_depends_on_no_other_one():
    surface = folded(20, waves=1)
    points, triangles = points_on(surface, 40)
    whole = smooth_normals(surface, points, triangles, FOOTPRINT_M)
    alone = smooth_normals(surface, points[7:8], triangles[7:8], FOOTPRINT_M)
    np.testing.assert_allclose(alone.normals[0], whole.normals[7], atol=1e-13)
