"""The triangles that may hold the best point of a surface in a metric, for many metrics at once, down a tree.

With a metric |root p - offset|^2, the rows r_i and the largest stretch s of its root, and y = root c - offset at the
centre c of a node, every point p of its ball of radius r has

    |root p - offset| >= |y| - s r    and    >= sqrt(sum_i max(0, |y_i| - |r_i| r)^2),

the first the tighter for a round metric, the second for one that hardly sees a direction. Where all triangles of the
node face the push, |y| bounds the optimum from above. A node whose lower bound exceeds the upper bound of its metric is
left out, as is one whose triangles all turn away from the push. The rest goes on to its children, all metrics at once,
level by level.

Bounds are taken in single precision, with a slack for its rounding: what is left is a superset of the answer, never
the answer itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.readings import FloatArray, IntArray
from skincal.surface.tree import ROUND, WIDTH, Level, Singles, Tree

TIE = 1e-12
"""m. Points whose distances in the metric, scaled so that the root's largest number is near 1, differ by less are equally
near: rounding."""
_DENSE = 1 << 14
"""Pairs of a metric and a node that are tried at once, whatever they are, to spare the first levels."""
_MUCH = 1 << 14
"""Pairs above which the metrics are taken in halves: with all that is known of their children, 60 MB."""
_SLACK = 2e-6
"""Rounding of a distance in single precision, as a share of what went into it, with room to spare."""
_NONE = np.float32(1e12)
"""m. Farther than any distance."""
_AWAY = np.float32(1e30)
"""A factor that makes of the sine of an angle on the wrong side more than `_NONE`."""
_LEAST = 1e-2
"""Largest stretches are 0.5 or more but for a root of nought."""
_FLAT = 1.25
"""Sum of the squared stretches over the largest of them: a metric below this has a second stretch below half the first."""


@dataclass(frozen=True, slots=True, eq=False)
class Metrics:
    """t metrics |root (p - origin) - offset|^2 with their pushes, a column each, of numbers near 1."""

    columns: FloatArray
    """(15, t) float: the rows of the roots (9), the offsets for points from the tree's origin (3), the unit pushes (3)."""
    free: bool
    """Whether every triangle counts, whatever the push."""
    scales: FloatArray
    """(t,) float: the powers of two by which roots and offsets were multiplied."""
    offsets: FloatArray
    """(3, t) float: the offsets for points from the link's origin, multiplied likewise and else as they were given."""

    def some(self, which: IntArray) -> Metrics:
        """Return some of the metrics, in any order and as often as asked."""
        return Metrics(self.columns[:, which], self.free, self.scales[which], self.offsets[:, which])


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """m pairs of a metric and a node that may hold its optimum."""

    metrics: IntArray
    """(m,) ascending."""
    nodes: IntArray
    """(m,)"""


@dataclass(slots=True)
class _Search:
    """What is asked of every level."""

    single: Singles
    """(20, t): rows (9), offsets (3), pushes (3), stretch, the rows' lengths (3), the slack."""
    limits: Singles
    """(t,) bounds from above for the optima; lowered by what is found, unless `fixed`."""
    free: bool
    """Whether every triangle counts."""
    fixed: bool
    flat: bool
    """Whether any of the metrics sees hardly more than one direction: only then does the bound row by row keep less."""
    holes: Singles | None
    """(4, t) balls, middle and radius, whose inside does not count; None where there are none."""

    def part(self, which: slice) -> _Search:
        """Return the same of some of the metrics; `limits` are shared."""
        holes = None if self.holes is None else self.holes[:, which]
        return replace(self, single=self.single[:, which], limits=self.limits[which], holes=holes)

    def within(self) -> Singles:
        """Return (t,) the distances up to which a node is kept."""
        return self.limits * np.float32(1 + ROUND) + self.single[19]


def survivors(tree: Tree, metrics: Metrics, upper: FloatArray | None = None) -> Iterator[Pairs]:
    """Yield the pairs that may hold an optimum or tie with it: by rising metric, all of one metric together.

    Parameters
    ----------
    upper : (t,) float or None: distances that surely bound the optima from above
    """
    limits = np.full(len(metrics.scales), _NONE) if upper is None else np.minimum(upper, _NONE).astype(np.float32)
    return _from_the_top(tree, _search(tree, metrics, limits))


def nearer_than(tree: Tree, metrics: Metrics, limits: FloatArray, middles: FloatArray, radii: FloatArray) -> Iterator[Pairs]:
    """Yield all pairs of which a point may come within `limits` and lie outside a ball, in the same order.

    Parameters
    ----------
    limits : (t,) float: distances, negative where nothing is wanted
    middles : (3, t) float, metres, from the tree's origin
    radii : (t,) float, metres
    """
    search = _search(tree, metrics, np.clip(limits, -_NONE, _NONE).astype(np.float32))
    holes = np.concatenate([middles, radii[None] * (1 - ROUND) - _SLACK * tree.extent])
    return _from_the_top(tree, replace(search, fixed=True, holes=holes.astype(np.float32)))


def _search(tree: Tree, metrics: Metrics, limits: Singles) -> _Search:
    rows = metrics.columns[:9].reshape(3, 3, -1)
    packed = np.empty((20, rows.shape[2]))
    packed[:15] = metrics.columns
    packed[15] = _stretches(rows)
    packed[16:19] = np.sqrt((rows * rows).sum(axis=1))
    reach = packed[16:19].sum(axis=0) * tree.extent + np.abs(metrics.columns[9:12]).sum(axis=0)
    packed[19] = 3 * TIE + _SLACK * reach
    flat = bool((dot(packed[16:19], packed[16:19]) < _FLAT * packed[15] * packed[15]).any())
    return _Search(packed.astype(np.float32), limits, metrics.free, fixed=False, flat=flat, holes=None)


def _from_the_top(tree: Tree, search: _Search) -> Iterator[Pairs]:
    count = len(search.limits)
    level = len(tree.levels) - 1
    while level > 0 and tree.levels[level - 1].radii.size * count <= _DENSE:
        level -= 1
    yield from _down(tree, search, level, _top_tried(tree.levels[level], search))


def _down(tree: Tree, search: _Search, level: int, pairs: Pairs) -> Iterator[Pairs]:
    """Go down to the triangles, in halves where there is much: what a root of nought keeps must fit into the memory."""
    while level > 0 and len(pairs.metrics):
        first = changes(pairs.metrics)
        if len(pairs.metrics) > _MUCH and len(first) > 1:
            cut = int(first[len(first) // 2])
            yield from _down(tree, search, level, Pairs(pairs.metrics[:cut], pairs.nodes[:cut]))
            yield from _down(tree, search, level, Pairs(pairs.metrics[cut:], pairs.nodes[cut:]))
            return
        level -= 1
        pairs = _children_tried(tree.levels[level], search, pairs, first)
    yield pairs


def changes(ascending: IntArray) -> IntArray:
    """Return where runs of equal numbers begin."""
    new = np.empty(len(ascending), dtype=bool)
    new[:1] = True
    np.not_equal(ascending[1:], ascending[:-1], out=new[1:])
    return new.nonzero()[0]


def apply(rows: NDArray[Any], points: NDArray[Any]) -> NDArray[Any]:
    """Return (3, ..., n): the matrices `rows` (3, 3, n) times the points (3, ..., n), each product and sum by itself."""
    shape = (3,) + (1,) * (points.ndim - 2) + rows.shape[2:]
    image = rows[:, 0].reshape(shape) * points[0]
    image += rows[:, 1].reshape(shape) * points[1]
    image += rows[:, 2].reshape(shape) * points[2]
    return image


def dot(p: NDArray[Any], q: NDArray[Any]) -> NDArray[Any]:
    """Return the scalar products along the first axis, which has length 3."""
    total = p[0] * q[0]
    total += p[1] * q[1]
    total += p[2] * q[2]
    return total


def _stretches(rows: FloatArray) -> FloatArray:
    """Return (t,) at least the largest stretch of each root, at most 1.07 times it: |M^4|^(1/8) with M = root' root."""
    roots = np.ascontiguousarray(rows.transpose(2, 0, 1))
    power = roots.transpose(0, 2, 1) @ roots
    for _ in range(2):
        power = power @ power
    # A root of nought has no stretch; any is a bound.
    return np.maximum((power * power).sum(axis=(1, 2)) ** (1 / 16) * (1 + ROUND), _LEAST)


def _length(vectors: Singles) -> Singles:
    return np.sqrt(np.square(vectors).sum(axis=0))


def _top_tried(level: Level, search: _Search) -> Pairs:
    """Try every node with every metric, of which only so many at once that the numbers stay in the cache."""
    count = len(search.limits)
    step = max(1, _DENSE // len(level.radii))
    if count <= step:
        return _all_tried(level, search)
    tried: list[Pairs] = []
    for at in range(0, count, step):
        part = _all_tried(level, search.part(slice(at, at + step)))
        tried.append(replace(part, metrics=part.metrics + at))
    return Pairs(*(np.concatenate([getattr(part, field.name) for part in tried]) for field in fields(Pairs)))


def _all_tried(level: Level, search: _Search) -> Pairs:
    """Try every node with every metric; return the pairs kept, and lower the limits."""
    single = search.single
    count, nodes = single.shape[1], len(level.radii)
    # The offset goes with the row as a fourth number, and -1 with the centre.
    rows = np.empty((3, count, 4), dtype=np.float32)
    rows[:, :, :3], rows[:, :, 3] = single[:9].reshape(3, 3, count).transpose(0, 2, 1), single[9:12]
    images = rows @ level.centres
    toward = np.ascontiguousarray(single[12:15].T) @ level.middles
    distance = _length(images)
    if not search.fixed:
        best = distance if search.free else np.maximum(distance, (toward + level.sines) * _AWAY)
        np.minimum(search.limits, best.min(axis=1), out=search.limits)
    lower = distance - single[15][:, None] * level.radii
    np.maximum(lower, (toward - level.sines) * _AWAY, out=lower)
    kept = (lower <= search.within()[:, None]).ravel().nonzero()[0]
    owner = kept // nodes
    pairs = Pairs(owner, kept - owner * nodes)
    return _thinned(pairs, images.reshape(3, -1), kept, level, search)


def _children_tried(level: Level, search: _Search, pairs: Pairs, first: IntArray) -> Pairs:
    """Try the children of each pair; return the pairs kept, and lower the limits; `first` is where each metric begins."""
    owner = pairs.metrics
    # Whole rows are read, and turned: numbers far apart in memory would take ten times as long.
    child = np.ascontiguousarray(level.groups.take(pairs.nodes, axis=0, mode="clip").T).reshape(8, WIDTH, -1)
    query = search.single.take(owner, axis=1, mode="clip")
    images = apply(query[:9].reshape(3, 3, -1), child[:3])
    images -= query[9:12, None]
    toward = (child[4:7] * query[12:15, None]).sum(axis=0)
    distance = _length(images)
    if not search.fixed:
        best = distance if search.free else np.maximum(distance, (toward + child[7]) * _AWAY)
        those = owner[first]
        search.limits[those] = np.minimum(search.limits[those], np.minimum.reduceat(best.min(axis=0), first))
    lower = distance - query[15] * child[3]
    np.maximum(lower, (toward - child[7]) * _AWAY, out=lower)
    kept = (lower <= search.within().take(owner, mode="clip")).T.ravel().nonzero()[0]
    pair = kept // WIDTH
    number = kept - pair * WIDTH
    left = Pairs(owner[pair], pairs.nodes[pair] * WIDTH + number)
    return _thinned(left, images.reshape(3, -1), number * len(owner) + pair, level, search)


def _thinned(pairs: Pairs, images: Singles, at: IntArray, level: Level, search: _Search) -> Pairs:
    """Keep those of the pairs that the other bounds keep, too; the columns `at` of `images` are their centres'."""
    if search.flat:
        kept = _aside(images.take(at, axis=1), level.radii.take(pairs.nodes), pairs.metrics, search)
        pairs = Pairs(pairs.metrics[kept], pairs.nodes[kept])
    if search.holes is not None:
        centres, radii = level.centres.take(pairs.nodes, axis=1), level.radii.take(pairs.nodes)
        hole = search.holes.take(pairs.metrics, axis=1)
        off = centres[:3] - hole[:3]
        kept = (_length(off) + radii > hole[3]).nonzero()[0]
        pairs = Pairs(pairs.metrics[kept], pairs.nodes[kept])
    return pairs


def _aside(images: Singles, radii: Singles, metrics: IntArray, search: _Search) -> IntArray:
    """Return which of the pairs the bound row by row keeps."""
    aside = np.abs(images)
    aside -= search.single[16:19].take(metrics, axis=1) * radii
    # Twice the positive part: a sum is several times faster than a comparison with nought.
    aside += np.abs(aside)
    return (_length(aside) * np.float32(0.5) <= search.within().take(metrics)).nonzero()[0]
