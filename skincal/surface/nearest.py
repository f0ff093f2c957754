"""The surface's point nearest to a target in a metric, exactly: the optimum over all triangles (paper, II-B).

The metric is given by its root: minimise |root p - offset|^2, so nothing is squared. How it is found, and why each answer
has the same bits whichever others are asked with it and wherever the search starts: `skincal/solver/source/search.h`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.solver.machine import INTEGER, Call
from skincal.surface.mesh import Surface
from skincal.surface.resident import resident

GRAZING = 1e-12
"""A triangle faces a push when push . normal is below minus this (both unit); the solver's own, for those who compare."""
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
    tried: IntArray
    """(t,) int: how many triangles were solved."""


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
    every: bool = False,
) -> NearestMany:
    """Minimise |root p - offset|^2 over the surface's points p, exactly, for each of t metrics.

    Parameters
    ----------
    roots : (t, 3, 3) float, of any rank
    offsets : (t, 3) float
    pushes : (t, 3) float or None; where given, only triangles with push . normal < 0 count
    start : (t,) int or None; a triangle where each optimum is likely, -1 for none: quicker, with the same answer
    every : try every triangle: slower, with the same answer

    Returns
    -------
    Among equally near points the one first met by the push, then the triangle that faces it most, then the lowest
    index.
    """
    count = len(roots)
    machine, place = resident(surface)
    with machine.call() as call:
        asked = _asked(call, place, roots, offsets, pushes, every)
        starting = call.give(np.full(count, -1) if start is None else start, INTEGER)
        return _searched(call, "nearest", asked, [starting, 0, 0, 0], np.full(count, -1))


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
    every: bool = False,
) -> NearestMany:
    """Find for each of t metrics the least separate minimum beside the best, where there is one.

    What a minimum is, and when it is separate: `skincal/solver/source/rival.h`.

    Parameters
    ----------
    roots, offsets, pushes, every : as for `nearest_to_rows`
    best : what that found
    radius : (t,) float, metres
    limit : (t,) float: values of |root p - offset|^2 above it do not count

    Returns
    -------
    As `nearest_to_rows`; triangle -1 where there is none.
    """
    machine, place = resident(surface)
    with machine.call() as call:
        asked = _asked(call, place, roots, offsets, pushes, every)
        beside = [0, call.give(best.points), call.give(radius), call.give(limit)]
        return _searched(call, "second", asked, beside, best.triangles)


def _asked(call: Call, place: int, roots: FloatArray, offsets: FloatArray, pushes: FloatArray | None, every: bool) -> list[int]:
    """Return the first words of `Search` in `skincal/solver/source/solver.c`."""
    given = 0 if pushes is None else call.give(pushes)
    return [place, len(roots), int(every), call.give(roots), call.give(offsets), given]


def _searched(call: Call, name: str, asked: list[int], beside: list[int], triangles: IntArray) -> NearestMany:
    count = len(triangles)
    points, values, tried = call.room((count, 3)), call.room((count,)), call.room((count,), INTEGER)
    found = call.changed(triangles, INTEGER)
    call.run(name, [*asked, *beside, points, values, found, tried])
    numbers = [call.taken(place).astype(np.int64) for place in (found, tried)]
    return NearestMany(call.taken(points), numbers[0], call.taken(values), numbers[1])
