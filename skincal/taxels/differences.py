"""Differences between two sets of positions of the same taxels: per taxel, of the whole skin, and per module.

Errors of the rig shift whole groups of taxels alike, and a module keeps its shape. So a module's difference has two parts: its
**shift**, the length of the mean difference, and its **shape**, the rms after the rigid motion that fits best (Kabsch 1976).
The same motion over all taxels is what two sets have in common: a part that was mounted again, or an error of the rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray, fit_rotation
from skincal.taxels.result import Estimate

MIN_TAXELS_TO_FIT_ROTATION = 3
COLLINEAR_MAX_EXTENT_RATIO = 1e-9
"""Taxels whose extents have a smaller ratio lie on one line, to the last digits."""


@dataclass(frozen=True, slots=True)
class Summary:
    """Distances between two sets of positions."""

    known: int
    """Taxels known in both; at least one."""
    mean: float
    """m."""
    rms: float
    """m."""
    largest: float
    """m."""
    row: int
    """Of the taxel with the largest distance."""


@dataclass(frozen=True, slots=True)
class ModuleDifference:
    """Difference of one module between two sets of positions."""

    module: int
    """Its index in the layout."""
    known: int
    """Taxels known in both; at least one."""
    mean: float
    """m, of the distances."""
    shift: float
    """m, length of the mean difference."""
    shape: float | None
    """m, rms after the module's own best rigid motion; `None` with fewer than three taxels."""


@dataclass(frozen=True, slots=True)
class CommonMotion:
    """Best rigid motion of all taxels from one set of positions to another, and the rest."""

    turn: float
    """rad."""
    shift: float
    """m, length of the mean difference."""
    mean: float
    """m, of the distances that remain."""
    largest: float
    """m."""


@dataclass(frozen=True, slots=True, eq=False)
class Repeatability:
    """Agreement of two sets of positions."""

    lengths: FloatArray
    """(n,) float, metres: distances; NaN if either position is unknown."""
    summary: Summary | None
    """`None` if no taxel is known in both."""
    motion: CommonMotion | None
    """`None` with fewer than three taxels, or if these lie on one line: the turn is not determined."""
    modules: tuple[ModuleDifference, ...]
    """Those with a taxel known in both, by index."""


def repeatability(here: FloatArray, there: FloatArray, owners: IntArray | None = None) -> Repeatability:
    """Compare two sets of positions of the same taxels.

    Parameters
    ----------
    here, there : (n, 3) float, metres; NaN if unknown
    owners : (n,) int, index of each taxel's module, negative for none; None without modules
    """
    _, lengths = differences(here, there)
    modules = () if owners is None else compare_modules(owners, here, there)
    return Repeatability(lengths, summarise(lengths), common_motion(here, there), modules)


def common_motion(here: FloatArray, there: FloatArray) -> CommonMotion | None:
    """Fit the rigid motion from `here` to `there`; arguments and `None` as for `Repeatability.motion`."""
    rows = np.isfinite(here).all(axis=1) & np.isfinite(there).all(axis=1)
    if int(rows.sum()) < MIN_TAXELS_TO_FIT_ROTATION:
        return None
    first, second = here[rows].mean(axis=0), there[rows].mean(axis=0)
    a, b = here[rows] - first, there[rows] - second
    sizes = np.linalg.svd(a.T @ b, compute_uv=False)
    if sizes[1] <= COLLINEAR_MAX_EXTENT_RATIO * sizes[0]:
        return None
    turn = fit_rotation(a.T @ b)
    # The cosine has no digits for a small turn, the sine none near a half turn.
    sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = float(np.arctan2(sine, np.trace(turn) - 1.0))
    off = np.linalg.norm(a @ turn - b, axis=1)
    return CommonMotion(angle, float(np.linalg.norm(second - first)), float(off.mean()), float(off.max()))


def places_of(estimates: Sequence[Estimate]) -> FloatArray:
    """List the positions of taxels, (n, 3) float, metres, in the order of `estimates`; NaN if unknown."""
    places = np.full((len(estimates), 3), np.nan)
    rows = [row for row, estimate in enumerate(estimates) if estimate.position is not None]
    if rows:
        places[rows] = np.array([estimates[row].position for row in rows])
    return places


def differences(here: FloatArray, there: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the vectors (n, 3) from one set of positions to another, and their lengths (n,), metres; NaN if unknown."""
    ways = there - here
    return ways, np.sqrt(np.sum(ways * ways, axis=1))


def summarise(lengths: FloatArray) -> Summary | None:
    """Summarise distances (n,) float, metres, NaN if unknown; `None` if all are unknown."""
    known = lengths[np.isfinite(lengths)]
    if not len(known):
        return None
    row = int(np.nanargmax(lengths))
    return Summary(len(known), float(known.mean()), float(np.sqrt(np.mean(known * known))), float(lengths[row]), row)


def worst_rows(lengths: FloatArray, count: int) -> IntArray:
    """List the rows of the largest distances, largest first, of equal ones the first row first; without unknown ones."""
    order = np.argsort(-lengths, kind="stable")[:count]
    return order[np.isfinite(lengths[order])]


def compare_modules(owners: IntArray, here: FloatArray, there: FloatArray) -> tuple[ModuleDifference, ...]:
    """Compare each module that has a taxel known in both sets, by index; arguments as for `repeatability`."""
    ways, lengths = differences(here, there)
    rows = np.flatnonzero(np.isfinite(lengths) & (owners >= 0))
    count = int(owners.max(initial=-1)) + 1
    owners, here, there = owners[rows], here[rows], there[rows]
    known = np.bincount(owners, minlength=count)
    share = (1.0 / np.maximum(known, 1))[:, None]
    mean = (share * _sum_by_owner(owners, lengths[rows, None], count))[:, 0]
    shift = np.sqrt(np.sum((share * _sum_by_owner(owners, ways[rows], count)) ** 2, axis=1))
    a, b = (each - (share * _sum_by_owner(owners, each, count))[owners] for each in (here, there))
    products = _sum_by_owner(owners, (a[:, :, None] * b[:, None]).reshape(-1, 9), count).reshape(-1, 3, 3)
    off = np.einsum("ni,nij->nj", a, fit_rotation(products)[owners]) - b
    shape = np.sqrt(share * _sum_by_owner(owners, np.sum(off * off, axis=1)[:, None], count))[:, 0]
    return tuple(
        ModuleDifference(
            index, int(known[index]), float(mean[index]), float(shift[index]),
            float(shape[index]) if known[index] >= MIN_TAXELS_TO_FIT_ROTATION else None,
        )
        for index in np.flatnonzero(known).tolist()
    )  # fmt: skip


def _sum_by_owner(owners: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Sum values (n, d) by their owner: (count, d)."""
    columns = [np.bincount(owners, weights=column, minlength=count) for column in values.T]
    return np.stack(columns, axis=1, dtype=np.float64)
