"""Touched taxels around each taxel: whether its position lies between measured ones or beyond them.

A taxel is *surrounded* if it lies in the convex hull of the touched taxels within `SURROUNDING_MAX_SPACINGS` spacings, in the
plane of the layout. Seen from the taxel, the directions to these neighbours leave no gap above half a turn. Its position is
then between measured ones. The hull must have an area, since neighbours on one line leave the turn about it open. A layout that
is a line itself has nothing else. So the corners of a patch must be touched, and its edges every few taxels. Modules with an
anchor of their own are planes of their own.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry import BoolArray, FloatArray, IntArray
from skincal.mesh.surface import pairs_within
from skincal.model.skin import Layout

SURROUNDING_MAX_SPACINGS = 3.0
"""Farther touched taxels say little: a sheet that is stretched by 3 % is off by half a millimetre over 3 x 5 mm."""
GAP_TOLERANCE_RAD = float(np.radians(2.0))
"""rad, above half a turn: taxels on a straight edge of a layout whose positions are rounded."""
PLANE_DISTANCE_M = 1e3
"""m, between planes of a layout: no taxels of two planes are neighbours."""


class Surroundings:
    """Neighbours of n taxels in their layout.

    Parameters
    ----------
    channels : (n,) taxels of the layout
    """

    def __init__(self, layout: Layout, channels: IntArray) -> None:
        own_plane = np.array([index + 1 if module.anchor is not None else 0 for index, module in enumerate(layout.modules)])
        planes = own_plane[layout.module_of[channels]]
        flat = layout.places[channels]
        self._count = len(channels)
        reach = SURROUNDING_MAX_SPACINGS * layout.spacing * (1.0 + 1e-6) if np.isfinite(layout.spacing) else 0.0
        pairs = pairs_within(np.column_stack([flat, PLANE_DISTANCE_M * planes]), reach)
        taxels, others = np.concatenate([pairs, pairs[:, ::-1]]).T
        away = flat[others] - flat[taxels]
        angles = np.arctan2(away[:, 1], away[:, 0])
        order = np.lexsort((angles, taxels))
        self._others: IntArray = others[order]
        self._angles: FloatArray = angles[order]
        # (n + 1,): taxel i has the neighbours starts[i] to starts[i + 1].
        self._starts: IntArray = np.searchsorted(taxels[order], np.arange(self._count + 1))
        self._cells: IntArray = _number_cells(flat, planes, reach)
        # (n,) taxels whose neighbours, touched or not, are all on one line.
        self._is_on_line: BoolArray = ~self._is_inside(np.ones(self._count, dtype=bool), np.arange(self._count))[1]

    def touched_or_surrounded(self, touched: BoolArray) -> BoolArray:
        """Tell (n,) which taxels are touched, or surrounded by touched ones; `touched` is (n,)."""
        rows = np.arange(self._count)
        between, has_area = self._is_inside(touched, rows)
        return touched | (between & (has_area | self._is_on_line))

    def update_covered(self, covered: BoolArray, touched: BoolArray, changed: IntArray) -> BoolArray:
        """Compute `touched_or_surrounded` again after a change at the taxels `changed` (m,); before it was `covered` (n,)."""
        rows = np.union1d(changed, self._neighbours_of(changed)[1])
        between, has_area = self._is_inside(touched, rows)
        found = covered.copy()
        found[rows] = touched[rows] | (between & (has_area | self._is_on_line[rows]))
        return found

    def _neighbours_of(self, rows: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
        """List the neighbours of the taxels `rows` (m,), by taxel and angle: (k,) index in `rows`, taxel, and angle in rad."""
        first, counts = self._starts[rows], self._starts[rows + 1] - self._starts[rows]
        of = np.repeat(np.arange(len(rows)), counts)
        at = np.arange(len(of)) + (first - (np.cumsum(counts) - counts))[of]
        return of, self._others[at], self._angles[at]

    def _is_inside(self, touched: BoolArray, rows: IntArray) -> tuple[BoolArray, BoolArray]:
        """Tell of the taxels `rows` (m,) which are between touched neighbours, and for which these are not on one line."""
        of, others, angles = self._neighbours_of(rows)
        counted = touched[others]
        of, angles = of[counted], angles[counted]
        between, has_area = np.zeros(len(rows), dtype=bool), np.zeros(len(rows), dtype=bool)
        if not len(of):
            return between, has_area
        starts = np.flatnonzero(np.diff(of, prepend=-1))
        ends = np.append(starts[1:], len(of)) - 1
        gaps = np.diff(angles, append=0.0)
        # The last neighbour of a taxel is followed by its first, a turn later.
        gaps[ends] = angles[starts] + 2.0 * np.pi - angles[ends]
        between[of[starts]] = np.maximum.reduceat(gaps, starts) <= np.pi + GAP_TOLERANCE_RAD
        first = np.repeat(angles[starts], np.diff(np.append(starts, len(of))))
        has_area[of[starts]] = np.maximum.reduceat(np.abs(np.sin(angles - first)), starts) > np.sin(GAP_TOLERANCE_RAD)
        return between, has_area

    def count_touches(self, open_: BoolArray) -> int:
        """Estimate how many touches cover the taxels `open_` (n,): one for each square of `SURROUNDING_MAX_SPACINGS`."""
        return len(np.unique(self._cells[open_]))


def _number_cells(flat: FloatArray, planes: IntArray, side: float) -> IntArray:
    """Find (n,) the number of the grid square around each taxel."""
    if not len(flat) or side <= 0:
        return np.arange(len(flat))
    rows = np.column_stack([np.floor((flat - np.nanmin(flat, axis=0)) / side), planes])
    return np.unique(rows, axis=0, return_inverse=True)[1].ravel()
