"""The surface's point nearest to a target in a metric, exactly: the optimum over all triangles (paper, II-B).

The metric is given by its root: minimise |root p - offset|^2, so nothing is squared. A tree with certain bounds leaves
out whatever cannot be the best (`search`); the rest is solved in closed form, and what is equally near is told apart by
what it is. Each taxel's answer has the same bits whichever others are asked with it, and wherever the search starts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.readings import FloatArray, IntArray
from skincal.surface.closest import Closest, closest_in_columns
from skincal.surface.mesh import Surface
from skincal.surface.polish import polish
from skincal.surface.search import TIE, Metrics, Pairs, apply, changes, dot, nearer_than, survivors
from skincal.surface.tree import Tree

GRAZING = 1e-12
"""A triangle faces a push when push . normal is below minus this (both unit): what is tangent to the last digit is out,
however the rounding falls."""
STIFF = 0.05
"""A metric whose lightest row is below this share of its heaviest is stiff: its optimum is found once more, in small numbers
(`polish`), and so it is on a sliver. Elsewhere the rounding is at most 20 times that of a length, and a length's is 1e-17 m."""
_SAME_POINT = 4 * float(np.finfo(float).eps)
"""Share of a point's largest coordinate by which two triangles' roundings of one point differ at most."""
_SAME_DEPTH = 1e-9
"""m. Equally near points whose depth along the push differs by less are one place."""
_AT_ONCE = 512
"""Metrics searched at once: their numbers stay in the cache of a core."""
_WARM = 64
"""For fewer metrics than this the first levels of the tree cost less than solving the triangles to start from."""
_PLATEAU = 64
"""Rounds in which triangles equally near are gone over; what is not at its end by then is a valley, not a place."""
_NO_RANK = 1e-15
"""Eigenvalues of a metric below this share of the largest are zero: rounding of the sums that made it."""


@dataclass(frozen=True, slots=True, eq=False)
class NearestMany:
    """The best point of a surface for each of t metrics."""

    points: FloatArray
    """(t, 3) float, metres; NaN where there is none."""
    triangles: IntArray
    """(t,) int; -1 where no triangle faces the push."""
    values: FloatArray
    """(t,) float, |root p - offset|^2 there; infinite where there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class Nearest:
    """The best point of a surface."""

    point: FloatArray
    """(3,) float, metres."""
    triangle: int
    value: float
    """(p - t)' M (p - t) there."""


def nearest_in_metric(
    surface: Surface, metric: FloatArray, target: FloatArray, push: FloatArray | None = None
) -> Nearest | None:
    """Minimise (p - t)' M (p - t) over the surface's points p, exactly.

    Parameters
    ----------
    metric : (3, 3) float, M: symmetric, positive semi-definite, of any rank
    target : (3,) float, t, metres
    push : (3,) float or None; where given, only triangles with push . normal < 0 count

    Returns
    -------
    As `nearest_to_rows`; None where no triangle faces the push.
    """
    values, axes = np.linalg.eigh(metric)
    values = np.where(values > _NO_RANK * values[-1], values, 0.0)
    root = np.sqrt(values)[:, None] * axes.T
    found = nearest_to_rows(surface, root[None], (root @ target)[None], None if push is None else push[None])
    return None if found.triangles[0] < 0 else Nearest(found.points[0], int(found.triangles[0]), float(found.values[0]))


def nearest_to_rows(
    surface: Surface,
    roots: FloatArray,
    offsets: FloatArray,
    pushes: FloatArray | None,
    start: IntArray | None = None,
) -> NearestMany:
    """Minimise |root p - offset|^2 over the surface's points p, exactly, for each of t metrics.

    Parameters
    ----------
    roots : (t, 3, 3) float, of any rank
    offsets : (t, 3) float
    pushes : (t, 3) float or None; where given, only triangles with push . normal < 0 count
    start : (t,) int or None; a triangle where each optimum is likely, -1 for none: quicker, with the same answer

    Returns
    -------
    Among equally near points the one first met by the push, then the triangle that faces it most, then the lowest
    index.
    """
    found = _nothing(len(roots))
    for first in range(0, len(roots), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        metrics = _metrics(surface.tree, roots[part], offsets[part], None if pushes is None else pushes[part])
        upper = None if start is None else _upper(surface.tree, metrics, start[part])
        for pairs in survivors(surface.tree, metrics, upper):
            _choose(surface, metrics, _solve(surface.tree, metrics, pairs), first, found)
    return found


def nearest_points(surface: Surface, points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Find for each of `points` (n, 3), metres, the surface's nearest point, exactly.

    Returns
    -------
    nearest : (n, 3) float, metres
    triangles : (n,) int; of equally near ones the lowest
    """
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    found = nearest_to_rows(surface, np.broadcast_to(np.eye(3), (len(points), 3, 3)), points, None)
    return found.points, found.triangles


def second_to_rows(
    surface: Surface,
    roots: FloatArray,
    offsets: FloatArray,
    pushes: FloatArray,
    best: NearestMany,
    radius: FloatArray,
    limit: FloatArray,
) -> NearestMany:
    """Find for each of t metrics the least separate minimum beside the best, where there is one.

    A walk downhill goes from triangle to triangle that share a corner, among those that face the push, as long as one
    has a nearer point. A minimum is the end of such walks, with all triangles around it that are equally near; it is
    separate where none of them comes within `radius` of the best point.

    Parameters
    ----------
    roots, offsets, pushes : as for `nearest_to_rows`
    best : what that found
    radius : (t,) float, metres
    limit : (t,) float: values of |root p - offset|^2 above it do not count

    Returns
    -------
    As `nearest_to_rows`; triangle -1 where there is none.
    """
    found = _nothing(len(roots))
    for first in range(0, len(roots), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        metrics = _metrics(surface.tree, roots[part], offsets[part], pushes[part])
        there = best.triangles[part] >= 0
        beside = _Beside(
            np.where(there[:, None], best.points[part], 0.0).T,
            radius[part],
            np.where(there, limit[part] * metrics.scales * metrics.scales, -1.0),
        )
        for pairs in beside.pairs(surface.tree, metrics):
            _choose(surface, metrics, _minima(surface, metrics, beside, pairs), first, found)
    return found


def _upper(tree: Tree, metrics: Metrics, start: IntArray) -> FloatArray | None:
    """Return (t,) the distances of the triangles `start`, infinite where one does not face; None where it does not pay."""
    if len(start) < _WARM:
        return None
    which = ((start >= 0) & (start < len(tree.places))).nonzero()[0]
    solved = _solve(tree, metrics, Pairs(which, tree.places[start[which]]))
    upper = np.full(len(start), np.inf)
    upper[solved.pairs.metrics] = solved.distances
    return upper


def _nothing(count: int) -> NearestMany:
    return NearestMany(np.full((count, 3), np.nan), np.full(count, -1), np.full(count, np.inf))


def _metrics(tree: Tree, roots: FloatArray, offsets: FloatArray, pushes: FloatArray | None) -> Metrics:
    columns = np.empty((15, len(roots)))
    rows = columns[:9].reshape(3, 3, -1)
    # Powers of two change no digit, and no square leaves the range of numbers.
    scale = np.ldexp(1.0, -np.frexp(np.abs(roots).max(axis=(1, 2)))[1])
    np.multiply(roots.transpose(1, 2, 0), scale, out=rows)
    np.subtract(offsets.T * scale, apply(rows, tree.origin[:, None]), out=columns[9:12])
    if pushes is None:
        columns[12:] = 0.0
    else:
        length = np.sqrt(dot(pushes.T, pushes.T))
        # A push of no length faces nothing.
        length[length == 0] = np.inf
        np.divide(pushes.T, length, out=columns[12:])
    return Metrics(columns, pushes is None, scale, offsets.T * scale)


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """The best points of m triangles, each in one metric and facing its push."""

    pairs: Pairs
    facing: FloatArray
    """(m,) push . normal, 0 without a push."""
    distances: FloatArray
    """(m,) |root p - offset|, scaled as the metrics are."""
    closest: Closest

    def some(self, which: IntArray) -> _Solved:
        pairs = Pairs(self.pairs.metrics[which], self.pairs.nodes[which])
        return _Solved(pairs, self.facing[which], self.distances[which], self.closest.some(which))

    def points(self, surface: Surface) -> FloatArray:
        """Return the points (3, m), metres."""
        corners = surface.corners[surface.tree.order[self.pairs.nodes]].transpose(2, 1, 0)
        shares = self.closest.shares()
        return shares[0] * corners[:, 0] + shares[1] * corners[:, 1] + shares[2] * corners[:, 2]


def _solve(tree: Tree, metrics: Metrics, pairs: Pairs) -> _Solved:
    """Solve those of the pairs that face the push, in closed form."""
    # Whole rows are read, and turned: numbers far apart in memory would take several times as long.
    triangles = np.ascontiguousarray(tree.triangles.take(pairs.nodes, axis=0, mode="clip").T)
    query = metrics.columns.take(pairs.metrics, axis=1, mode="clip")
    facing = dot(triangles[9:], query[12:])
    if not metrics.free:
        keep = facing < -GRAZING
        if not keep.all():
            which = keep.nonzero()[0]
            triangles, query, facing = triangles[:, which], query[:, which], facing[which]
            pairs = Pairs(pairs.metrics[which], pairs.nodes[which])
    image = apply(query[:9].reshape(3, 3, -1), triangles[:9].reshape(3, 3, -1))
    image -= query[9:12, None]
    closest = closest_in_columns(image)
    return _Solved(pairs, facing, np.sqrt(closest.squared), closest)


def _choose(surface: Surface, metrics: Metrics, solved: _Solved, first: int, found: NearestMany) -> None:
    """Write into `found`, from row `first`, the best of each metric's points."""
    owner = solved.pairs.metrics
    if len(owner) == 0:
        return
    cuts = changes(owner)
    best = np.full(len(metrics.scales), np.inf)
    best[owner[cuts]] = np.minimum.reduceat(solved.distances, cuts) + TIE
    solved = solved.some((solved.distances <= best.take(owner)).nonzero()[0])
    owner = solved.pairs.metrics
    slim = surface.slim[surface.tree.order[solved.pairs.nodes]]
    slim = np.repeat(np.logical_or.reduceat(slim, changes(owner)), np.diff(changes(owner), append=len(owner)))
    stiff = slim | _stiff(metrics).take(owner)
    for part, again in ((~stiff, False), (stiff, True)):
        which = part.nonzero()[0]
        if len(which):
            _write(surface, metrics, solved.some(which), first, found, again)


def _stiff(metrics: Metrics) -> NDArray[np.bool_]:
    """Return (t,) whether rounding of the metric's heavy rows could be seen beside its lightest one."""
    rows = metrics.columns[:9].reshape(3, 3, -1)
    sizes = dot(rows.transpose(1, 0, 2), rows.transpose(1, 0, 2))
    return sizes.min(axis=0) < STIFF * STIFF * sizes.max(axis=0)


def _write(surface: Surface, metrics: Metrics, solved: _Solved, first: int, found: NearestMany, again: bool) -> None:
    """Write into `found` one of each metric's equally near points."""
    if again:
        points, values, solved = _polished(surface, metrics, solved)
    else:
        points, values = solved.points(surface), solved.closest.squared
    owner = solved.pairs.metrics
    if len(owner) > len(changes(owner)):
        keep = _told_apart(surface.tree, solved, points, metrics.columns[12:])
        solved, points, values, owner = solved.some(keep), points[:, keep], values[keep], owner[keep]
    scale = metrics.scales[owner]
    found.points[first + owner] = points.T
    found.triangles[first + owner] = surface.tree.order[solved.pairs.nodes]
    found.values[first + owner] = values / scale / scale


def _polished(surface: Surface, metrics: Metrics, solved: _Solved) -> tuple[FloatArray, FloatArray, _Solved]:
    """Solve the triangles once more about the best of each metric; return points (3, n), values (n,) and which are the best."""
    owner, triangles = solved.pairs.metrics, surface.tree.order[solved.pairs.nodes]
    corners, normals = surface.corners[triangles].transpose(2, 1, 0), surface.normals[triangles].T
    cuts = changes(owner)
    sizes = np.diff(cuts, append=len(owner))
    nearest = np.lexsort((solved.distances, owner))[cuts]
    anchor = np.repeat(solved.some(nearest).points(surface), sizes, axis=1)
    rows = metrics.columns[:9, owner].reshape(3, 3, -1)
    # From the link's origin again: the tree's may be far off.
    rest = apply(rows, anchor) - metrics.offsets[:, owner]
    again = polish(rows, rest, corners - anchor[:, None], normals)
    points = anchor + again.away
    at = (again.corner >= 0).nonzero()[0]
    points[:, at] = corners[:, again.corner[at], at]
    best = np.repeat(np.lexsort((again.rise, owner))[cuts], sizes)
    same = np.abs(points - points[:, best]).max(axis=0) <= _SAME_POINT * np.abs(points).max(axis=0)
    keep = ((again.rise <= again.rise[best] + again.unsure) | same).nonzero()[0]
    image = (rest + apply(rows, again.away))[:, keep]
    return points[:, keep], dot(image, image), solved.some(keep)


def _told_apart(tree: Tree, solved: _Solved, points: FloatArray, alongs: FloatArray) -> IntArray:
    """Return of each metric's points, equally near, the one first met; the most facing; the lowest triangle's."""
    owner, triangle = solved.pairs.metrics, tree.order[solved.pairs.nodes]
    keep = _least(owner, dot(points, alongs[:, owner]))
    keep = keep[_least(owner[keep], solved.facing[keep])]
    keep = keep[np.lexsort((triangle[keep], owner[keep]))]
    return keep[changes(owner[keep])]


def _least(owner: IntArray, measure: FloatArray) -> IntArray:
    cuts = changes(owner)
    least = np.minimum.reduceat(measure, cuts)
    return np.flatnonzero(measure <= np.repeat(least + _SAME_DEPTH, np.diff(cuts, append=len(owner))))


@dataclass(frozen=True, slots=True, eq=False)
class _Beside:
    """Where another minimum counts."""

    middles: FloatArray
    """(3, t) float, metres: not within `radii` of these."""
    radii: FloatArray
    squares: FloatArray
    """(t,) float: where the squared distance, scaled as the metrics are, is at most this."""

    def pairs(self, tree: Tree, metrics: Metrics) -> Iterator[Pairs]:
        limits = np.where(self.squares >= 0, np.sqrt(np.abs(self.squares)), -np.inf)
        return nearer_than(tree, metrics, limits, self.middles - tree.origin[:, None], self.radii)

    def outside(self, owner: IntArray, points: FloatArray) -> NDArray[np.bool_]:
        off = points - self.middles[:, owner]
        return np.sqrt(dot(off, off)) > self.radii[owner]


def _minima(surface: Surface, metrics: Metrics, beside: _Beside, pairs: Pairs) -> _Solved:
    """Return those of the triangles whose best points are separate minima."""
    solved = _solve(surface.tree, metrics, pairs)
    solved = solved.some((solved.closest.squared <= beside.squares[solved.pairs.metrics]).nonzero()[0])
    solved = solved.some(beside.outside(solved.pairs.metrics, solved.points(surface)).nonzero()[0])
    if len(solved.distances) == 0:
        return solved
    solved = solved.some(_lowest_around(surface, solved))
    return solved.some(_ends(surface, metrics, beside, solved))


def _lowest_around(surface: Surface, solved: _Solved) -> IntArray:
    """Return which of the triangles have no lower one at their corners among those given: the rest are no minima."""
    owner = solved.pairs.metrics
    vertices = surface.triangles[surface.tree.order[solved.pairs.nodes]]
    keys = (owner[:, None] * len(surface.vertices) + vertices).ravel()
    _, at = np.unique(keys, return_inverse=True)
    lowest = np.full(len(keys), np.inf)
    np.minimum.at(lowest, at, np.repeat(solved.distances, 3))
    return (solved.distances <= lowest[at].reshape(-1, 3).min(axis=1) + TIE).nonzero()[0]


def _ends(surface: Surface, metrics: Metrics, beside: _Beside, solved: _Solved) -> IntArray:
    """Return which of the triangles are ends of walks away from the best point: none around all equally near is nearer."""
    owner, least = solved.pairs.metrics, solved.distances
    walks = metrics.some(owner)
    alive = np.ones(len(owner), dtype=bool)
    walker, place = np.arange(len(owner)), solved.pairs.nodes
    seen = walker * len(surface.triangles) + place
    for _ in range(_PLATEAU):
        walker, place, seen = _around(surface, walker, place, seen)
        ring = _solve(surface.tree, walks, Pairs(walker, place))
        off = ring.distances - least[ring.pairs.metrics]
        alive[ring.pairs.metrics[off < -TIE]] = False
        level = ring.some((off <= TIE).nonzero()[0])
        walker, place = level.pairs.metrics, level.pairs.nodes
        alive[walker[~beside.outside(owner[walker], level.points(surface))]] = False
        walker, place = walker[alive[walker]], place[alive[walker]]
        if len(walker) == 0:
            break
    # What goes on and on is no place.
    alive[walker] = False
    return alive.nonzero()[0]


def _around(surface: Surface, walker: IntArray, place: IntArray, seen: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return what shares a corner with each walker's triangles and is not among those seen by it, and all that is seen."""
    fans, tree, count = surface.fans, surface.tree, len(surface.triangles)
    vertices = surface.triangles[tree.order[place]].ravel()
    sizes = fans.starts[vertices + 1] - fans.starts[vertices]
    ends = np.cumsum(sizes)
    within = np.arange(int(ends[-1])) - np.repeat(ends - sizes, sizes)
    met = tree.places[fans.triangles[np.repeat(fans.starts[vertices], sizes) + within]]
    keys = np.unique(np.repeat(np.repeat(walker, 3), sizes) * count + met)
    keys = keys[~np.isin(keys, seen)]
    return keys // count, keys % count, np.concatenate([seen, keys])
