"""Polygons against the even-odd rule: each point of the plane is in as many triangles as the polygon covers it."""

import time

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from test_load import load

from skincal.mesh.findings import FindingKind
from skincal.mesh.polygons import cut_polygons
from skincal.mesh.readers import read_mesh
from tests.approved import approved

L_PLATE = [(0, 80), (0, 0), (80, 0), (80, 30), (30, 30), (30, 80)]
U_PLATE = [(0, 0), (90, 0), (90, 60), (60, 60), (60, 20), (30, 20), (30, 60), (0, 60)]
STRAIGHT_CORNERS = [(0, 80), (0, 40), (0, 0), (40, 0), (80, 0), (80, 30), (50, 30), (30, 30), (30, 50), (30, 80), (10, 80)]
FRAME_WITH_SEAM = [(0, 0), (60, 0), (60, 60), (0, 60), (0, 0), (20, 20), (20, 40), (40, 40), (40, 20), (20, 20)]
DART = [(0, 0), (40, 20), (0, 40), (10, 20)]
BOW_TIE = [(0, 0), (40, 40), (40, 0), (0, 40)]
PENTAGRAM = [(np.cos(4 * np.pi * i / 5), np.sin(4 * np.pi * i / 5)) for i in range(5)]


def cut(points):
    points = np.array(points, dtype=float)
    return cut_polygons(points, np.arange(len(points)), np.array([len(points)]))


def in_space(flat, turn):
    return np.c_[np.array(flat, dtype=float), np.zeros(len(flat))] @ Rotation.from_rotvec(turn).as_matrix().T + [100, -200, 300]


def shoelace(flat):
    x, y = np.array(flat, dtype=float).T
    return (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2


def triangle_areas(points, triangles):
    a, b, c = np.array(points)[triangles].transpose(1, 0, 2)
    return np.cross(b - a, c - a) / 2


def is_inside(outline, points):
    """Count the sides that a ray from each point along +x crosses."""
    inside = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if y0 != y1:
            crosses = (y0 > points[:, 1]) != (y1 > points[:, 1])
            inside ^= crosses & (points[:, 0] < x0 + (points[:, 1] - y0) * (x1 - x0) / (y1 - y0))
    return inside


def assert_covered_once(flat, triangles, rng):
    flat = np.array(flat, dtype=float)
    points = rng.uniform(flat.min(axis=0), flat.max(axis=0), size=(400, 2))
    covered = sum(is_inside(flat[triangle], points).astype(int) for triangle in triangles)
    np.testing.assert_array_equal(covered, is_inside(flat, points))


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("turn", [(0, 0, 0), (0.3, -1.2, 2.0), (np.pi / 2, 0, 0)], ids=["flat", "tilted", "upright"])
@pytest.mark.parametrize("name", ["L_PLATE", "U_PLATE", "STRAIGHT_CORNERS", "FRAME_WITH_SEAM", "DART"])
def test_a_concave_polygon_keeps_its_area_and_its_side(name, turn, reverse):
    flat = globals()[name]
    for start in range(len(flat)):
        outline = [*flat[start:], *flat[:start]][:: -1 if reverse else 1]
        found = cut(in_space(outline, turn))
        assert (found.crossing, found.not_flat, len(found.triangles)) == (0, 0, len(flat) - 2)
        normal = Rotation.from_rotvec(turn).apply([0, 0, -1 if reverse else 1])
        areas = triangle_areas(in_space(outline, turn), found.triangles)
        np.testing.assert_allclose(areas @ normal, np.linalg.norm(areas, axis=1), atol=1e-9)
        np.testing.assert_allclose(areas.sum(axis=0), normal * abs(shoelace(flat)), atol=1e-8)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 40))
def test_random_outlines_are_covered_once(seed, count):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, count) * 0.5 + np.arange(count) / count * np.pi)
    radius = rng.uniform(0.15, 1.0, count)
    # A star about its middle, bent along a parabola: its fan covers what is outside.
    flat = np.c_[radius * np.cos(angle), radius * np.sin(angle)]
    flat[:, 1] += 2.5 * flat[:, 0] ** 2
    # The bend may have made sides cross.
    assume(is_simple(flat))
    found = cut(in_space(flat, rng.uniform(-3, 3, 3)))
    assert (found.crossing, len(found.triangles)) == (0, count - 2)
    assert_covered_once(flat, found.triangles, rng)


def is_simple(flat):
    def turn(a, b, c):
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    n = len(flat)
    sides = [(flat[i], flat[(i + 1) % n]) for i in range(n)]
    return not any(
        turn(*sides[i], sides[j][0]) * turn(*sides[i], sides[j][1]) < 0
        and turn(*sides[j], sides[i][0]) * turn(*sides[j], sides[i][1]) < 0
        for i in range(n)
        for j in range(i + 2, n)
        if (j + 1) % n != i
    )


def spiral(corners):
    angle = np.linspace(0, 6 * np.pi, corners // 2)
    outer = np.c_[(10 + angle) * np.cos(angle), (10 + angle) * np.sin(angle)]
    inner = np.c_[(7 + angle) * np.cos(angle), (7 + angle) * np.sin(angle)]
    return np.r_[outer, inner[::-1]]


@pytest.mark.parametrize("corners", [40, 1000])
def test_a_spiral_is_cut(corners):
    flat = spiral(corners)
    found = cut(in_space(flat, (1, 2, 3)))
    assert (found.crossing, len(found.triangles)) == (0, corners - 2)
    assert_covered_once(flat, found.triangles, np.random.default_rng(1))


def test_a_convex_polygon_stays_the_fan_that_it_was():
    corners = np.array([[np.cos(a), np.sin(a), 0.2] for a in np.linspace(0, 2 * np.pi, 12, endpoint=False)])
    assert cut(corners).triangles.tolist() == [[0, i, i + 1] for i in range(1, 11)]


@pytest.mark.parametrize("flat", [BOW_TIE, PENTAGRAM], ids=["bow tie", "pentagram"])
def test_a_polygon_that_crosses_itself_is_left_out_and_counted(flat):
    found = cut(in_space(flat, (0.1, 0.2, 0.3)))
    assert (found.crossing, len(found.triangles)) == (1, 0)


@pytest.mark.parametrize(("lift", "count"), [(0.0, 0), (0.3, 0), (5.0, 1), (40.0, 1)])
def test_a_polygon_that_is_far_from_flat_is_counted(lift, count):
    points = [(0, 0, 0), (40, 0, lift), (40, 40, 0), (0, 40, lift)]
    found = cut(points)
    assert (found.not_flat, found.crossing, len(found.triangles)) == (count, 0, 2)


def test_a_face_of_very_many_corners_ends():
    rng = np.random.default_rng(3)
    for points in (rng.normal(size=(3000, 3)), np.zeros((3000, 3)), np.full((30, 3), np.nan), 1e300 * rng.normal(size=(30, 3))):
        begin = time.process_time()
        found = cut(points)
        assert found.crossing in (0, 1)
        assert time.process_time() - begin < 60


def plate_obj(flat, height):
    """Write a prism over an outline; each face is one polygon."""
    n = len(flat)
    lines = [f"v {x} {y} {z}" for z in (0, height) for x, y in flat]
    lines += ["f " + " ".join(str(i + 1) for i in reversed(range(n))), "f " + " ".join(str(n + i + 1) for i in range(n))]
    lines += [f"f {i + 1} {(i + 1) % n + 1} {n + (i + 1) % n + 1} {n + i + 1}" for i in range(n)]
    return "\n".join(lines).encode()


def plate_off(flat, height):
    lines = plate_obj(flat, height).decode().splitlines()
    points = [line[2:] for line in lines if line.startswith("v")]
    faces = [[int(word) - 1 for word in line.split()[1:]] for line in lines if line.startswith("f")]
    counts = f"OFF\n{len(points)} {len(faces)} 0"
    return "\n".join([counts, *points, *(f"{len(face)} " + " ".join(map(str, face)) for face in faces)]).encode()


def plate_ply(flat, height):
    _, counts, *lines = plate_off(flat, height).decode().splitlines()
    points, faces, _ = counts.split()
    head = f"ply\nformat ascii 1.0\nelement vertex {points}\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    return (head + "\n".join(lines) + "\n").encode()


@pytest.mark.parametrize("name", ["plate_obj", "plate_off", "plate_ply"])
@pytest.mark.parametrize("outline", ["L_PLATE", "U_PLATE"])
def test_a_plate_of_polygons_has_its_true_volume(tmp_path, name, outline):
    flat, height = globals()[outline], 20.0
    surface, found = load(tmp_path, globals()[name](flat, height), f"plate.{name[-3:]}")
    corners = surface.corners * 1e3
    volume = np.linalg.det(corners).sum() / 6
    assert volume == pytest.approx(abs(shoelace(flat)) * height, rel=1e-9)
    assert set(found) == {FindingKind.SIZE}


def test_polygons_that_cannot_be_trusted_are_reported(tmp_path):
    points = [*((x, y, 0) for x, y in BOW_TIE), (50, 0, 0), (90, 0, 30), (90, 40, 0), (50, 40, 30)]
    text = "\n".join([*(f"v {x} {y} {z}" for x, y, z in points), "f 1 2 3 4", "f 5 6 7 8"]).encode()
    surface, found = load(tmp_path, text, "part.obj")
    assert len(surface.triangles) == 2
    assert found[FindingKind.CROSSING].sentence == approved("mesh.crossing", count=1)
    assert found[FindingKind.NOT_FLAT].sentence == approved("mesh.not_flat", count=1)


def test_a_polygon_with_a_corner_that_is_not_there_is_damage(tmp_path):
    with pytest.raises(Exception, match="name vertices 0 to 8, and there are 4"):
        read_mesh(tmp_path / "a.obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 9\n")
