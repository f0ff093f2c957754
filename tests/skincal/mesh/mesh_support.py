"""Surfaces and metrics for the tests of the search, and the answer by trying every triangle."""

from dataclasses import dataclass

import numpy as np

from skincal.mesh.search import NearestPoints, nearest_in_metric, surface_in_solver
from skincal.mesh.surface import Surface, make_surface


def grid(points) -> Surface:
    """The surface over a grid of points (n + 1, m + 1, 3)."""
    n, m = points.shape[0] - 1, points.shape[1] - 1
    i = (np.arange(n)[:, None] * (m + 1) + np.arange(m)).ravel()
    one, two = np.stack([i, i + m + 1, i + 1], axis=1), np.stack([i + 1, i + m + 1, i + m + 2], axis=1)
    return make_surface(points.reshape(-1, 3), np.concatenate([one, two]))


def tube(around=24, along=12, radius=0.04, length=0.15, turn=0.6, bump=0.0) -> Surface:
    """An open shell like a forearm's cover, outward normals; with bumps where asked."""
    a, h = np.meshgrid(np.linspace(-np.pi * turn, np.pi * turn, around + 1), np.linspace(0, length, along + 1), indexing="ij")
    r = radius + bump * np.sin(3 * a) * np.sin(40 * h)
    return grid(np.stack([r * np.cos(a), r * np.sin(a), h], axis=-1))


def folded(cells=40, depth=0.02, waves=3) -> Surface:
    """A sheet in deep waves, normals along +z."""
    x, y = np.meshgrid(*[np.linspace(-0.05, 0.05, cells + 1)] * 2, indexing="ij")
    z = depth * np.sin(waves * 2 * np.pi * x / 0.1) * np.cos(waves * np.pi * y / 0.1)
    return grid(np.stack([x, y, z], axis=-1))


def together(*surfaces: Surface) -> Surface:
    """All of them as one, no vertex shared."""
    first = np.cumsum([0] + [len(surface.vertices) for surface in surfaces])
    triangles = [surface.triangles + start for surface, start in zip(surfaces, first, strict=False)]
    return make_surface(np.concatenate([surface.vertices for surface in surfaces]), np.concatenate(triangles))


def turned_over(surface: Surface) -> Surface:
    """The same triangles wound the other way."""
    return make_surface(surface.vertices, surface.triangles[:, ::-1])


def bent_plate(around=32, along=24, radius=0.07, thickness=0.003, half_angle_deg=50.0, length=0.12) -> Surface:
    """A closed plate bent about y, its outer face toward +z: 107 x 120 x 27 mm."""
    angles = np.radians(np.linspace(-half_angle_deg, half_angle_deg, around + 1))
    a, y = np.meshgrid(angles, np.linspace(-length / 2, length / 2, along + 1), indexing="ij")
    sheets = [np.stack([r * np.sin(a), y, r * np.cos(a)], axis=-1).reshape(-1, 3) for r in (radius, radius - thickness)]
    number = np.arange(a.size).reshape(a.shape)
    corners = [part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])]
    outer = np.concatenate([np.stack([corners[k] for k in ks], axis=1) for ks in ((0, 1, 2), (0, 2, 3))])
    rim = np.concatenate([number[:, 0], number[-1, 1:], number[-2::-1, -1], number[0, -2:0:-1]])
    after = np.roll(rim, -1)
    sides = [np.stack([rim, rim + a.size, after], axis=1), np.stack([after, rim + a.size, after + a.size], axis=1)]
    return make_surface(np.concatenate(sheets), np.concatenate([outer, outer[:, ::-1] + a.size, *sides]))


def soup(rng, count=300) -> Surface:
    """Triangles of all sizes and shapes, needles among them, no vertex shared."""
    middles = rng.uniform(-0.05, 0.05, (count, 1, 3))
    shape = rng.normal(0, 0.05, (count, 3, 3)) * rng.uniform(0, 1, (count, 1, 1)) ** 3
    shape[::7, :, 1] *= 1e-5
    return make_surface((middles + shape).reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def random_roots(rng, count, kind):
    """Roots (count, 3, 3): of full rank, graded, of nearly parallel axes, of rank 2 and 1, of one axis, of zeros."""
    roots = rng.normal(size=(count, 3, 3))
    axes = rng.normal(size=(count, 3, 1))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    if kind == "graded":
        roots *= 10.0 ** -rng.uniform(0, 12, size=(count, 3, 1))
    if kind == "near-parallel":
        roots -= (1 - 10.0 ** -rng.uniform(1, 12, size=(count, 1, 1))) * (roots @ axes) @ axes.transpose(0, 2, 1)
    if kind == "rank 2":
        roots[:, 2] = 0.0
    if kind == "rank 1":
        roots[:, 1:] = 0.0
    if kind == "one axis":
        roots = np.eye(3) - axes @ axes.transpose(0, 2, 1)
    if kind == "zero":
        roots[:] = 0.0
    return roots


KINDS = ["full rank", "graded", "near-parallel", "rank 2", "rank 1", "one axis", "zero"]


def random_metrics(rng, surface, count, kind):
    """Roots, offsets and pushes whose targets lie in and around the surface's box."""
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    roots = random_roots(rng, count, kind)
    targets = rng.uniform(low - 0.02, high + 0.02, (count, 3))
    return roots, np.einsum("tij,tj->ti", roots, targets), rng.normal(size=(count, 3))


def poked(rng, surface, count, pokes, scatter=0.002):
    """Roots, offsets and pushes of `count` taxels on the surface, each poked from outside within 30 degrees."""
    triangles = rng.integers(len(surface.triangles), size=count)
    places = np.einsum("ti,tij->tj", rng.dirichlet([1, 1, 1], size=count), surface.corners[triangles])
    roots, offsets, pushes = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros((count, 3))
    for i in range(count):
        axes = -surface.normals[triangles[i]] + rng.normal(0, 0.3, (pokes, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        rows = np.concatenate([np.linalg.qr(np.c_[axis, rng.normal(size=(3, 2))])[0][:, 1:].T for axis in axes])
        values = np.sum(rows * np.repeat(places[i] + rng.normal(0, scatter, (pokes, 3)), 2, axis=0), axis=1)
        q, r = np.linalg.qr(rows)
        roots[i, : len(r)], offsets[i, : len(r)], pushes[i] = r, q.T @ values, axes.mean(axis=0)
    return roots, offsets, pushes


def same(one, two) -> bool:
    """Whether two answers are equal to the last bit."""
    return (
        np.array_equal(one.triangles, two.triangles)
        and np.array_equal(one.points, two.points, equal_nan=True)
        and np.array_equal(one.values, two.values)
    )


def part_of(found, which):
    """Some of the answers."""
    return NearestPoints(found.points[which], found.triangles[which], found.values[which], found.tried[which])


def facing_minima(surface, root, offset, push):
    """Triangles that face the push, and the distance and the place of each one's best point."""
    facing = np.flatnonzero(surface.normals @ (push / np.linalg.norm(push)) < -1e-12)
    shares, squared = closest_in_triangles(surface.corners[facing] @ root.T - offset)
    return facing, np.sqrt(squared), (shares[:, :, None] * surface.corners[facing]).sum(axis=1)


@dataclass(frozen=True)
class Nearest:
    """The best point of a surface."""

    point: np.ndarray
    triangle: int
    value: float


def nearest_to(surface, metric, target, push=None) -> Nearest | None:
    """Minimise (p - t)' M (p - t) over the surface's points p; None where no triangle faces the push."""
    values, axes = np.linalg.eigh(metric)
    # Eigenvalues below the rounding of the sums that made the metric are zero.
    values = np.where(values > 1e-15 * values[-1], values, 0.0)
    root = np.sqrt(values)[:, None] * axes.T
    found = nearest_in_metric(surface, root[None], (root @ target)[None], None if push is None else push[None])
    return None if found.triangles[0] < 0 else Nearest(found.points[0], int(found.triangles[0]), float(found.values[0]))


def nearest_from(surface, roots, offsets, pushes, start) -> NearestPoints:
    """`nearest_in_metric`, whose search begins at triangles where each optimum is likely."""
    count = len(roots)
    starts = np.full(count, -1) if start is None else start
    unasked = {"best": None, "radii": None, "limits": None}
    return _searched(
        surface, "nearest", np.full(count, -1), roots=roots, offsets=offsets, pushes=pushes, starting=starts, **unasked
    )


def second_to_rows(surface, roots, offsets, pushes, best, radius, limit, every=False) -> NearestPoints:
    """The least separate minimum beside the best, where there is one: `skincal/solver/source/rival.h`."""
    beside = {"starting": None, "best": best.points, "radii": radius, "limits": limit}
    return _searched(surface, "second", best.triangles, every=every, roots=roots, offsets=offsets, pushes=pushes, **beside)


def _searched(surface, name, triangles, *, every=False, **asked) -> NearestPoints:
    """Run a function of the solver whose question is a `Search`."""
    machine, place = surface_in_solver(surface)
    count = len(triangles)
    room = {"points": (count, 3), "values": (count,), "triangles": triangles, "tried": (count,)}
    found = machine.run(name, surface=place, metrics=count, all=every, **asked, **room)
    numbers = [found[each].astype(np.int64) for each in ("triangles", "tried")]
    return NearestPoints(found["points"], numbers[0], found["values"], numbers[1])


TINY = 1e-300
"""Least squared length that divides."""


def closest_in_triangles(corners):
    """Find for each triangle of `corners` (n, 3, 3) its point nearest to the origin.

    The interior point comes from an orthogonalised pair of edges, the longest first, so that needles keep their digits. The
    best of it and of the three edges' clamped projections is taken by its true distance.

    Returns
    -------
    shares : (n, 3) float, barycentric: the point is `shares @ corners`
    squared : (n,) float, its squared distance
    """
    count, row = len(corners), np.arange(len(corners))
    edges = np.roll(corners, -1, axis=1) - corners
    lengths = np.sum(edges * edges, axis=2)
    along = np.clip(-np.sum(corners * edges, axis=2) / lengths.clip(TINY), 0.0, 1.0)
    squared = np.sum((corners + along[:, :, None] * edges) ** 2, axis=2)
    side = np.argmin(squared, axis=1)
    first = np.argmax(lengths, axis=1)
    corner, long, across = corners[row, first], edges[row, first], -edges[row, (first + 2) % 3]
    length, tilt = lengths[row, first].clip(TINY)[:, None], np.zeros((count, 1))
    # Twice: the first pass leaves rounding of the long edge's size.
    for _ in range(2):
        part = (across * long).sum(axis=1, keepdims=True) / length
        across, tilt = across - part * long, tilt + part
    height = (across * across).sum(axis=1, keepdims=True)
    start = -(corner * long).sum(axis=1, keepdims=True) / length
    offset = corner + start * long
    v = -(offset * across).sum(axis=1, keepdims=True) / height.clip(TINY)
    u = start - v * tilt
    within = np.sum((offset + v * across) ** 2, axis=1)
    inside = ((u >= 0) & (v >= 0) & (u + v <= 1) & (height > 0))[:, 0] & (within <= squared[row, side])
    begin = np.where(inside, first, side)
    one = np.where(inside, u[:, 0], along[row, side])
    other = np.where(inside, v[:, 0], 0.0)
    shares = np.empty((count, 3))
    shares[row, begin], shares[row, (begin + 1) % 3], shares[row, (begin + 2) % 3] = 1.0 - one - other, one, other
    nearest = np.where(inside, within, squared[row, side])
    return shares, nearest
