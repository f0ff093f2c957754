"""The tree over the triangles leaves nothing out that the search needs."""

import pickle

import numpy as np
import pytest
from mesh_support import KINDS, folded, nearest_from, part_of, poked, random_metrics, same, soup, together, tube

from skincal.mesh import search
from skincal.mesh.search import build_tree, find_fans, nearest_in_metric, surface_in_solver
from skincal.mesh.surface import make_surface
from skincal.solver.tables import NODE_CHILDREN


def nodes_of(level):
    """Eight numbers a node: centre, radius, middle of the normals, sine."""
    return level.astype(float).reshape(-1, 8, NODE_CHILDREN).transpose(0, 2, 1).reshape(-1, 8)


@pytest.mark.parametrize("count", [1, 2, 7, 8, 9, 63, 64, 65, 513, 700, 4097])
def test_every_triangle_is_in_the_ball_and_the_cone_of_each_node_above_it(count):
    rng = np.random.default_rng(count)
    surface = soup(rng, count)
    built = build_tree(surface)
    assert sorted(built.order) == list(range(count))
    np.testing.assert_array_equal(built.order[built.places], np.arange(count))
    corners, normals = surface.corners[built.order] - built.origin, surface.normals[built.order]
    for height, level in enumerate(built.levels):
        node = np.arange(count) // NODE_CHILDREN**height
        numbers = nodes_of(level)[node]
        centre, radius, middle, sine = numbers[:, :3], numbers[:, 3], numbers[:, 4:7], numbers[:, 7]
        away = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
        assert (away <= radius + 1e-7 * built.extent).all()
        turned = np.linalg.norm(np.cross(normals, middle), axis=1)
        ahead = np.einsum("ij,ij->i", normals, middle)
        assert ((sine > 1) | ((turned <= sine) & (ahead > 0))).all()


def pair(part, away):
    """A small part on either side of the origin, metres."""
    return together(*[make_surface(0.1 * part.vertices + np.array([x, 0.0, 0.0]), part.triangles) for x in (-away, away)])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", ["tube", "folded", "layers", "soup", "copies", "five", "far", "apart", "far apart"])
def test_the_tree_leaves_nothing_out_to_the_last_bit(kind, shape):
    rng = np.random.default_rng(17)
    # Large enough for three levels of nodes.
    part = tube(80, 60, bump=0.003)
    surface = {
        "tube": lambda: part,
        "folded": lambda: folded(70),
        "layers": lambda: together(part, tube(80, 60, radius=0.037)),
        "soup": lambda: soup(rng, 5000),
        "copies": lambda: make_surface(
            part.vertices, np.concatenate([part.triangles, part.triangles[::-1], part.triangles[:, [1, 0, 2]]])
        ),
        "five": lambda: make_surface(part.vertices, part.triangles[:5]),
        "far": lambda: make_surface(part.vertices + np.array([1000.0, -300.0, 20.0]), part.triangles),
        # Single precision rounds to 0.03 and 0.3 mm there: more than what its slack is not for would forgive.
        "apart": lambda: pair(part, 400.0),
        "far apart": lambda: pair(part, 4000.0),
    }[shape]()
    count = 4 if kind == "zero" else 40
    roots, offsets, pushes = random_metrics(rng, surface, count, kind)
    if "apart" in shape:
        targets = surface.vertices[rng.integers(len(surface.vertices), size=count)] + rng.normal(0, 1e-5, (count, 3))
        offsets = np.einsum("tij,tj->ti", roots, targets)
    for own in (pushes, None):
        found = nearest_in_metric(surface, roots, offsets, own)
        assert same(found, nearest_in_metric(surface, roots, offsets, own, every=True))
    assert (found.triangles >= 0).all()


def test_targets_on_corners_are_found_to_the_last_bit():
    """There the bound of a ball through the corner is as large as the optimum, and a start from another triangle with that
    corner leaves no room: only the slack for rounding keeps the one that faces most."""
    surface = tube(80, 60)
    rng = np.random.default_rng(19)
    start = rng.integers(len(surface.triangles), size=300)
    targets = surface.corners[start, rng.integers(3, size=300)]
    for root in (np.eye(3), np.diag([1.0, 1.0, 0.3]), np.diag([0.0, 1.0, 0.0])):
        asked = np.tile(root, (len(targets), 1, 1)), targets @ root, -targets * [1, 1, 0]
        every = nearest_in_metric(surface, *asked, every=True)
        assert same(nearest_in_metric(surface, *asked), every)
        assert same(nearest_from(surface, *asked, start), every)


def test_targets_far_from_the_part_are_found_to_the_last_bit_too():
    """Bounds in single precision tell less there; they may not tell anything wrong."""
    rng = np.random.default_rng(23)
    surface = tube(20, 20)
    for away in (1.0, 1e3, 1e6, 1e9, 1e13, 1e20, 1e46, 1e100):
        roots, _, pushes = random_metrics(rng, surface, 20, "full rank")
        offsets = np.einsum("tij,tj->ti", roots, rng.normal(0, away, (20, 3)))
        asked = roots, offsets, pushes
        found = nearest_in_metric(surface, *asked)
        assert (found.triangles >= 0).all()
        assert same(found, nearest_in_metric(surface, *asked, every=True))


@pytest.mark.parametrize("scale", [1e-140, 1e-12, 1e12, 1e140])
def test_the_size_of_the_weights_does_not_matter(scale):
    rng = np.random.default_rng(29)
    surface = tube()
    scale = 2.0 ** np.round(np.log2(scale))
    for kind in KINDS:
        roots, offsets, pushes = random_metrics(rng, surface, 20, kind)
        one = nearest_in_metric(surface, roots, offsets, pushes)
        two = nearest_in_metric(surface, roots * scale, offsets * scale, pushes * scale)
        np.testing.assert_array_equal(one.triangles, two.triangles)
        np.testing.assert_array_equal(one.points, two.points)


def test_an_answer_does_not_depend_on_the_others_nor_on_where_the_search_starts():
    rng = np.random.default_rng(31)
    surface = tube(40, 40, bump=0.004)
    asked = [
        np.concatenate(part) for part in zip(*[random_metrics(rng, surface, 120, kind) for kind in KINDS[:-1]], strict=True)
    ]
    many = nearest_in_metric(surface, *asked)
    order = rng.permutation(len(asked[0]))
    for start in (None, many.triangles, np.full(len(order), -1), rng.integers(-1, len(surface.triangles), len(order))):
        mixed = nearest_from(surface, *[part[order] for part in asked], None if start is None else start[order])
        back = np.argsort(order)
        assert same(many, part_of(mixed, back))
    for i in order[:60]:
        one = nearest_in_metric(surface, *[part[i : i + 1] for part in asked])
        assert same(one, part_of(many, slice(i, i + 1)))


def kept(surface, asked):
    return np.mean(nearest_in_metric(surface, *asked).tried)


def test_few_triangles_are_left_however_many_there_are():
    rng = np.random.default_rng(41)
    for pokes in (1, 3, 10):
        few, many = ([kept(surface, poked(rng, surface, 200, pokes, 0.0005))] for surface in (tube(25, 20), tube(250, 200)))
        assert few[0] < 20
        assert many[0] < 2 * few[0], "100 times the triangles"


def test_a_root_of_zeros_for_every_taxel_does_not_fill_the_memory():
    """All triangles are equally near, to each of many metrics: what one keeps is given back before the next."""
    surface = tube(60, 50)
    surface_in_solver(surface)
    count = 1000
    asked = np.zeros((count, 3, 3)), np.ones((count, 3)), np.tile([-1.0, 0.0, 0.0], (count, 1))
    machine = surface_in_solver(surface)[0]
    before = len(machine._memory_view)
    found = nearest_in_metric(surface, *asked)
    # Measured 0.6 MB; if nothing were given back, 360 MB.
    assert len(machine._memory_view) - before < 5e6
    assert (found.triangles == found.triangles[0]).all()
    assert found.points[0, 0] == pytest.approx(surface.vertices[:, 0].max()), "first met by the push"
    np.testing.assert_array_equal(found.values, 3.0)


def test_which_of_equals_comes_first_in_the_tree_leaves_no_trace(monkeypatch):
    """Metrics of rank 1, whose optimum is a valley over many triangles: the mesh's own order decides, not the tree's."""
    rng = np.random.default_rng(59)
    first = tube(40, 30)
    asked = random_metrics(rng, first, 60, "rank 1")
    found = nearest_in_metric(first, *asked)
    halved = search._halved

    def otherwise(centres):
        order = halved(centres)
        # Neighbours in pairs the other way round: as a sort may leave what is equal.
        count = len(order) // 2 * 2
        order[:count] = order[:count].reshape(-1, 2)[:, ::-1].ravel()
        return order

    order = build_tree(first).order
    monkeypatch.setattr(search, "_halved", otherwise)
    again = make_surface(first.vertices, first.triangles)
    assert (build_tree(again).order != order).any()
    assert same(found, nearest_in_metric(again, *asked))


def test_a_surface_that_travelled_gives_the_same_answers():
    surface = tube()
    surface_in_solver(surface)
    again = pickle.loads(pickle.dumps(surface))
    rng = np.random.default_rng(47)
    asked = random_metrics(rng, surface, 30, "full rank")
    assert same(nearest_in_metric(surface, *asked), nearest_in_metric(again, *asked))


def test_fans_hold_the_triangles_around_each_vertex():
    surface = tube(5, 4)
    starts, triangles = find_fans(surface)
    for vertex in range(len(surface.vertices)):
        own = triangles[starts[vertex] : starts[vertex + 1]]
        assert sorted(own) == sorted(np.flatnonzero((surface.triangles == vertex).any(axis=1)))
