"""How far two sets of places of the same taxels lie apart: each taxel, all of them, and module by module.

Errors of the rig shift whole groups of taxels alike, and a module keeps its shape in it. So a module's difference has two
parts: its **shift**, the length of the mean difference, and its **shape**, what is left after the rigid motion that fits best
(Kabsch 1976): with a, b the module's places about their means and a' b = U S V' (singular values),

    R = V diag(1, 1, det(V U')) U',   shape^2 = mean |R a - b|^2.

The determinant keeps R from being a reflection: a mirrored module is not a turned one. The same motion over all taxels is what
two sets have in common: a part that was mounted anew, or an error of the rig that moves all taxels alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.skin import Layout
from skincal.taxels.result import Estimate

FEWEST = 3
"""Taxels that determine how a module is turned; with fewer its shape is not known."""
ON_A_LINE = 1e-9
"""Taxels whose extents have this ratio lie on one line, to the last digits."""


@dataclass(frozen=True, slots=True)
class Summary:
    """How far two sets of places lie apart."""

    known: int
    """Taxels that are known in both; at least one."""
    mean: float
    """m, of the lengths of the differences."""
    rms: float
    """m."""
    largest: float
    """m."""
    row: int
    """Of the taxel that lies farthest apart."""


@dataclass(frozen=True, slots=True)
class ModuleDifference:
    """How far one module lies apart in two sets of places."""

    module: int
    """Its index in the layout."""
    known: int
    """Taxels that are known in both; at least one."""
    mean: float
    """m, of the lengths of the differences."""
    shift: float
    """m, length of the mean difference: what the module is moved by as a whole."""
    shape: float | None
    """m, rms after the module's own best rigid motion; None with fewer than three taxels."""


@dataclass(frozen=True, slots=True)
class CommonMotion:
    """The rigid motion of all taxels that fits best from one set of places to another, and what it leaves."""

    turn: float
    """rad."""
    shift: float
    """m, by how far it moves the taxels' middle: the length of the mean difference."""
    mean: float
    """m, of the lengths that are left."""
    largest: float
    """m."""


@dataclass(frozen=True, slots=True, eq=False)
class Repeatability:
    """How well two sets of places repeat each other."""

    lengths: FloatArray
    """(n,) float, metres, of the differences; NaN where either is unknown."""
    summary: Summary | None
    """None where no taxel is known in both."""
    motion: CommonMotion | None
    """None with fewer than three taxels, or where these lie on one line: they do not tell how all is turned."""
    modules: tuple[ModuleDifference, ...]
    """Those with a taxel known in both, in the order of their numbers."""


def repeatability(here: FloatArray, there: FloatArray, owners: IntArray | None = None) -> Repeatability:
    """Return how well two sets of places of the same taxels repeat each other.

    Parameters
    ----------
    here, there : (n, 3) float, metres, of the same taxels; NaN where unknown
    owners : (n,) int, the number of each taxel's module from 0, negative for none; None where there are no modules
    """
    _, lengths = differences(here, there)
    modules = () if owners is None else compare_modules_of(owners, here, there)
    return Repeatability(lengths, summarise(lengths), common_motion(here, there), modules)


def common_motion(here: FloatArray, there: FloatArray) -> CommonMotion | None:
    """Return the rigid motion that fits best from `here` to `there`, both (n, 3) float, metres, NaN where unknown.

    None where fewer than three taxels are known in both, or where they lie on one line.
    """
    rows = np.isfinite(here).all(axis=1) & np.isfinite(there).all(axis=1)
    if int(rows.sum()) < FEWEST:
        return None
    first, second = here[rows].mean(axis=0), there[rows].mean(axis=0)
    a, b = here[rows] - first, there[rows] - second
    left, sizes, right = np.linalg.svd(a.T @ b)
    if sizes[1] <= ON_A_LINE * sizes[0]:
        return None
    left[:, 2] *= np.sign(np.linalg.det(left @ right))
    turn = left @ right
    # Of a small turn the cosine has no digits, of one near a half turn the sine has none.
    sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = float(np.arctan2(sine, np.trace(turn) - 1.0))
    off = np.linalg.norm(a @ turn - b, axis=1)
    return CommonMotion(angle, float(np.linalg.norm(second - first)), float(off.mean()), float(off.max()))


def places_of(estimates: Sequence[Estimate]) -> FloatArray:
    """Return where a method puts taxels, (n, 3) float, metres, in the order of `estimates`; NaN where it does not know."""
    places = np.full((len(estimates), 3), np.nan)
    rows = [row for row, estimate in enumerate(estimates) if estimate.position is not None]
    if rows:
        places[rows] = np.array([estimates[row].position for row in rows])
    return places


def differences(here: FloatArray, there: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ways from one set of places to another, and their lengths.

    Parameters
    ----------
    here, there : (n, 3) float, metres, of the same taxels; NaN where unknown

    Returns
    -------
    (n, 3) and (n,) float, metres; NaN where either is unknown
    """
    ways = there - here
    return ways, np.sqrt(np.sum(ways * ways, axis=1))


def summarise(lengths: FloatArray) -> Summary | None:
    """Return what the lengths of differences, (n,) float, metres, come to; None where no taxel is known in both sets."""
    known = lengths[np.isfinite(lengths)]
    if not len(known):
        return None
    row = int(np.nanargmax(lengths))
    return Summary(len(known), float(known.mean()), float(np.sqrt(np.mean(known * known))), float(lengths[row]), row)


def worst_rows(lengths: FloatArray, count: int) -> IntArray:
    """Return the rows of the largest differences, the largest first and of equal ones the first; unknown ones are none."""
    order = np.argsort(-lengths, kind="stable")[:count]
    return order[np.isfinite(lengths[order])]


def compare_modules(layout: Layout, channels: IntArray, here: FloatArray, there: FloatArray) -> tuple[ModuleDifference, ...]:
    """Return how far each module lies apart, in the layout's order; modules without a taxel known in both are left out.

    Parameters
    ----------
    channels : (n,) int, of the taxels
    here, there : (n, 3) float, metres, of the same taxels; NaN where unknown
    """
    return compare_modules_of(layout.module_of[channels], here, there)


def compare_modules_of(owners: IntArray, here: FloatArray, there: FloatArray) -> tuple[ModuleDifference, ...]:
    """Return how far each module lies apart, as `compare_modules` does; `owners` as for `repeatability`."""
    ways, lengths = differences(here, there)
    rows = np.flatnonzero(np.isfinite(lengths) & (owners >= 0))
    count = int(owners.max(initial=-1)) + 1
    owners = owners[rows]
    known = np.bincount(owners, minlength=count)
    share = 1.0 / np.maximum(known, 1)
    mean = share * _sums(owners, lengths[rows, None], count)[:, 0]
    shift = np.sqrt(np.sum((share[:, None] * _sums(owners, ways[rows], count)) ** 2, axis=1))
    shape = np.sqrt(share * _left_over(owners, here[rows], there[rows], share))
    return tuple(
        ModuleDifference(
            index, int(known[index]), float(mean[index]), float(shift[index]),
            float(shape[index]) if known[index] >= FEWEST else None,
        )
        for index in np.flatnonzero(known).tolist()
    )  # fmt: skip


def _sums(owners: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Return the sums (count, d) of values (n, d) by their owner."""
    columns = [np.bincount(owners, weights=column, minlength=count) for column in values.T]
    return np.stack(columns, axis=1, dtype=np.float64)


def _left_over(owners: IntArray, here: FloatArray, there: FloatArray, share: FloatArray) -> FloatArray:
    """Return the squares (modules,) that are left after each module's best rigid motion from here to there."""
    count = len(share)
    a = here - (share[:, None] * _sums(owners, here, count))[owners]
    b = there - (share[:, None] * _sums(owners, there, count))[owners]
    products = _sums(owners, (a[:, :, None] * b[:, None]).reshape(-1, 9), count).reshape(-1, 3, 3)
    left, _, right = np.linalg.svd(products)
    hand = np.sign(np.linalg.det(left @ right))
    left[:, :, 2] *= hand[:, None]
    turns = left @ right
    off = np.einsum("ni,nij->nj", a, turns[owners]) - b
    return _sums(owners, np.sum(off * off, axis=1)[:, None], count)[:, 0]
