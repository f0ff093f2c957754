from itertools import product

import numpy as np
import pytest
from mesh_support import Nearest, grid, nearest_to, tube

from skincal.mesh.search import nearest_in_metric, nearest_points
from skincal.mesh.surface import Surface, make_surface


def to_rows(surface, root, offset, push):
    many = nearest_in_metric(surface, root[None], offset[None], push[None])
    return Nearest(many.points[0], int(many.triangles[0]), float(many.values[0]))


def in_one_triangle(corners, metric, target):
    """Minimise (p - t)' M (p - t) over one triangle: interior by the determinant formula, then each edge. Plain Python."""
    a, b, c = (corner - target for corner in corners)
    best, where = np.inf, a
    e, f = b - a, c - a
    gram = np.array([[e @ metric @ e, e @ metric @ f], [e @ metric @ f, f @ metric @ f]])
    det = gram[0, 0] * gram[1, 1] - gram[0, 1] ** 2
    if det > 1e-14 * gram[0, 0] * gram[1, 1]:
        u, v = np.linalg.solve(gram, -np.array([e @ metric @ a, f @ metric @ a]))
        if u >= 0 and v >= 0 and u + v <= 1:
            where = a + u * e + v * f
            best = where @ metric @ where
    for start, end in ((a, b), (b, c), (c, a)):
        along = end - start
        length = along @ metric @ along
        share = 0.0 if length <= 0 else float(np.clip(-(start @ metric @ along) / length, 0, 1))
        p = start + share * along
        if p @ metric @ p < best:
            best, where = p @ metric @ p, p
    return best, where + target


def by_every_triangle(surface, metric, target, push=None):
    found = [
        in_one_triangle(corners, metric, target)
        for corners, normal in zip(surface.corners, surface.normals, strict=True)
        if push is None or normal @ push < -1e-12 * np.linalg.norm(push)
    ]
    return min(found, key=lambda pair: pair[0]) if found else None


def random_metric(rng, spread):
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return axes @ np.diag([1.0, spread ** rng.uniform(0, 1), spread]) @ axes.T


@pytest.mark.parametrize("spread", [1.0, 1e-2, 1e-6])
def test_equals_every_triangle_tried_one_by_one(spread):
    rng = np.random.default_rng(3)
    surface = tube()
    for _ in range(25):
        metric, target = random_metric(rng, spread), rng.normal([0.02, 0, 0.07], 0.04)
        push = rng.normal(size=3)
        found = nearest_to(surface, metric, target, push)
        value, point = by_every_triangle(surface, metric, target, push)
        assert found.value == pytest.approx(value, rel=1e-9, abs=1e-18)
        off = found.point - target
        assert off @ metric @ off == pytest.approx(found.value, rel=1e-9, abs=1e-18)
        assert surface.normals[found.triangle] @ push < 0
        if spread > 1e-3:
            np.testing.assert_allclose(found.point, point, atol=1e-9)


@pytest.mark.parametrize("shares", [[0.2, 0.5, 0.3], [0.4, 0.6, 0.0], [0.0, 1.0, 0.0]], ids=["inside", "edge", "vertex"])
def test_a_target_on_the_surface_is_found_to_the_last_digits(shares):
    surface = tube()
    rng = np.random.default_rng(1)
    for triangle in rng.integers(len(surface.triangles), size=20):
        target = np.array(shares) @ surface.corners[triangle]
        for metric in (np.eye(3), random_metric(rng, 1e-4)):
            np.testing.assert_allclose(nearest_to(surface, metric, target).point, target, atol=1e-13)


def test_beyond_the_rim_the_rim_is_nearest():
    surface = tube()
    vertex = surface.vertices[surface.vertices[:, 2] == 0.0][5]
    for shares in (0.0, 0.3):
        other = surface.vertices[surface.vertices[:, 2] == 0.0][6]
        on_rim = vertex + shares * (other - vertex)
        found = nearest_to(surface, np.eye(3), on_rim - [0, 0, 0.02])
        np.testing.assert_allclose(found.point, on_rim, atol=1e-14)
        assert found.value == pytest.approx(0.02**2)


def test_a_single_axis_ends_where_the_push_enters_the_part():
    ball = sphere(0.05)
    rng = np.random.default_rng(2)
    for _ in range(50):
        push = rng.normal(size=3)
        push /= np.linalg.norm(push)
        through = rng.uniform(-0.02, 0.02, 3)
        metric = np.eye(3) - np.outer(push, push)
        # Any point of the axis is the same target; both where it enters and where it leaves have value zero.
        for along in (-3.0, 0.0, 0.2):
            found = nearest_to(ball, metric, through + along * push, push)
            assert found.value < 1e-24
            assert found.point @ push < 0
            assert ball.normals[found.triangle] @ push < 0
            assert np.linalg.norm(np.cross(found.point - through, push)) < 1e-12


def test_among_two_walls_that_face_the_push_the_first_met_is_taken():
    near, far = square(0.10), square(0.02)
    vertices = np.concatenate([far.vertices, near.vertices])
    both = make_surface(vertices, np.concatenate([far.triangles, near.triangles + len(far.vertices)]))
    push = np.array([0.0, 0.0, -1.0])
    metric = np.diag([1.0, 1.0, 0.0])
    found = nearest_to(both, metric, np.array([0.003, 0.004, 0.0]), push)
    np.testing.assert_allclose(found.point, [0.003, 0.004, 0.10], atol=1e-15)
    assert found.triangle >= len(far.triangles)


def test_no_triangle_faces_the_push():
    flat = square(0.0)
    up = np.array([0.0, 0.0, 1.0])
    assert nearest_to(flat, np.eye(3), np.zeros(3), up) is None
    assert nearest_to(flat, np.eye(3), np.zeros(3), np.array([1.0, 0.0, 0.0])) is None, "tangent is not facing"
    assert nearest_to(flat, np.eye(3), np.zeros(3), -up) is not None


def test_duplicate_triangles_and_needles_change_nothing():
    rng = np.random.default_rng(9)
    surface = tube()
    needle = np.array([[0.04, 0.0, 0.05], [0.04, 0.03, 0.05], [0.04, 0.015, 0.05 + 2e-7]])
    vertices = np.concatenate([surface.vertices, needle])
    last = len(surface.vertices)
    triangles = np.concatenate([surface.triangles, surface.triangles[:40], [[last, last + 1, last + 2]]])
    crowded = make_surface(vertices, triangles)
    for _ in range(20):
        metric, target = random_metric(rng, 1e-3), rng.normal([0.04, 0, 0.06], 0.02)
        value, _ = by_every_triangle(crowded, metric, target)
        found = nearest_to(crowded, metric, target)
        assert found.value == pytest.approx(value, rel=1e-8, abs=1e-18)
        assert found.triangle not in range(len(surface.triangles), last), "of two copies the first"


def test_turns_with_a_rigid_motion_of_everything():
    rng = np.random.default_rng(11)
    surface = tube()
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    shift = np.array([0.3, -1.2, 0.7])
    moved = make_surface(surface.vertices @ rotation.T + shift, surface.triangles)
    for _ in range(30):
        root, target, push = rng.normal(size=(3, 3)), rng.normal([0.03, 0, 0.07], 0.03), rng.normal(size=3)
        one = to_rows(surface, root, root @ target, push)
        turned = root @ rotation.T
        two = to_rows(moved, turned, turned @ (rotation @ target + shift), rotation @ push)
        np.testing.assert_allclose(rotation @ one.point + shift, two.point, atol=1e-11)
        assert one.triangle == two.triangle


def test_euclidean_points_equal_every_triangle():
    rng = np.random.default_rng(4)
    surface = tube()
    # One triangle a hundred times larger than the others: candidates by centre alone would miss it.
    vertices = np.concatenate([surface.vertices, [[-0.5, -0.5, -0.03], [0.5, -0.5, -0.03], [0, 0.9, -0.03]]])
    last = len(surface.vertices)
    mixed = make_surface(vertices, np.concatenate([surface.triangles, [[last, last + 1, last + 2]]]))
    targets = rng.normal([0.02, 0, 0.02], 0.06, size=(40, 3))
    points, triangles = nearest_points(mixed, targets)
    for target, point, triangle in zip(targets, points, triangles, strict=True):
        value, where = by_every_triangle(mixed, np.eye(3), target)
        assert np.linalg.norm(point - target) == pytest.approx(np.sqrt(value), abs=1e-12)
        np.testing.assert_allclose(point, where, atol=1e-9)
        assert in_one_triangle(mixed.corners[triangle], np.eye(3), point)[0] < 1e-28
    assert (triangles == len(mixed.triangles) - 1).any()


def test_large_triangles_are_found_however_far_their_centres():
    """A soup of triangles as large as the space they lie in: the nearest centre is rarely that of the nearest triangle."""
    rng = np.random.default_rng(12)
    corners = rng.uniform(-0.05, 0.05, (150, 1, 3)) + rng.normal(0, 0.05, (150, 3, 3)) * [1, 1, 0.02]
    soup = make_surface(corners.reshape(-1, 3), np.arange(450).reshape(-1, 3))
    targets = rng.uniform(-0.08, 0.08, (40, 3))
    points, _ = nearest_points(soup, targets)
    wrong_centre = 0
    for target, point in zip(targets, points, strict=True):
        value, _ = by_every_triangle(soup, np.eye(3), target)
        assert np.linalg.norm(point - target) == pytest.approx(np.sqrt(value), rel=1e-9, abs=1e-12)
        found = nearest_to(soup, np.eye(3), target)
        assert found.value == pytest.approx(value, rel=1e-9, abs=1e-20)
        ranks = np.argsort(np.linalg.norm(soup.centres.T - target, axis=1))
        wrong_centre += np.flatnonzero(ranks == found.triangle)[0] >= 16
    assert wrong_centre > 3, "the case is as hard as it is meant to be"


def square(z: float, cells: int = 1, side: float = 0.1) -> Surface:
    """A flat square about the z axis, normals along +z."""
    x, y = np.meshgrid(*[np.linspace(-side / 2, side / 2, cells + 1)] * 2, indexing="ij")
    return grid(np.stack([x, y, np.full_like(x, z)], axis=-1))


def sphere(radius: float) -> Surface:
    """A closed ball by three subdivisions of an octahedron, outward normals."""
    signs = product((1.0, -1.0), repeat=3)
    faces = [np.array([[x, 0, 0], [0, y, 0], [0, 0, z]])[:: int(x * y * z)] for x, y, z in signs]
    for _ in range(3):
        finer = []
        for a, b, c in faces:
            ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
            finer += [np.array(t) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        faces = finer
    corners = np.array(faces).reshape(-1, 3)
    corners = radius * corners / np.linalg.norm(corners, axis=1, keepdims=True)
    return make_surface(corners, np.arange(len(corners)).reshape(-1, 3))
