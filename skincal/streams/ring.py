"""The newest wrench readings, in memory of fixed size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skincal.geometry.arrays import FloatArray

WRENCH_WIDTH = 6


class WrenchRing:
    """Keeps the last `capacity` readings in order of their stamps, as plain slices.

    The arrays are twice as long as needed: readings are written forward, and when the end is reached the newest half moves
    to the front. So what is kept is always one contiguous slice, and a reading costs the same however long it runs.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._host_s = np.zeros(2 * capacity)
        self._wrench = np.zeros((2 * capacity, WRENCH_WIDTH))
        self._usable = np.zeros(2 * capacity, np.bool_)
        self._flagged = np.zeros(2 * capacity, np.bool_)
        self._end = 0
        self._dropped = False

    def append(self, host_s: FloatArray, wrench: FloatArray, usable: NDArray[np.bool_], flagged: NDArray[np.bool_]) -> None:
        """Add readings that are newer than all before.

        Parameters
        ----------
        host_s : (n,) float, seconds, ascending
        wrench : (n, 6) float, N and N m
        usable : (n,) the reading may be averaged
        flagged : (n,) the device says saturated or invalid
        """
        kept = slice(max(len(host_s) - self._capacity, 0), None)
        count = len(host_s[kept])
        if count < len(host_s):
            # What was kept is older than what is left out: together they would have a hole.
            self._dropped = True
            self._end = 0
        if self._end + count > len(self._host_s):
            self._move_to_front()
        into = slice(self._end, self._end + count)
        self._host_s[into] = host_s[kept]
        self._wrench[into] = wrench[kept]
        self._usable[into] = usable[kept]
        self._flagged[into] = flagged[kept]
        self._end += count

    def _move_to_front(self) -> None:
        count = min(self._capacity, self._end)
        newest = slice(self._end - count, self._end)
        for array in (self._host_s, self._wrench, self._usable, self._flagged):
            array[:count] = array[newest].copy()
        self._dropped |= count < self._end
        self._end = count

    @property
    def newest_s(self) -> float:
        """Stamp of the last reading, seconds; minus infinity before the first."""
        return float(self._host_s[self._end - 1]) if self._end else -np.inf

    def forgot(self, host_s: float) -> bool:
        """Say whether readings from before the oldest kept were dropped and `host_s` lies among them."""
        return self._dropped and host_s < self._host_s[0]

    def between(self, after_s: float, until_s: float) -> slice:
        """Return where the readings with `after_s < stamp <= until_s` lie."""
        first, last = np.searchsorted(self._host_s[: self._end], (after_s, until_s), side="right")
        return slice(int(first), int(last))

    def mean(self, among: slice) -> tuple[FloatArray, int]:
        """Return the mean of the usable readings of a slice, and their number; NaN if there are none."""
        usable = self._usable[among]
        wrench = self._wrench[among]
        if not usable.all():
            wrench = wrench[usable]
        if not len(wrench):
            return np.full(WRENCH_WIDTH, np.nan), 0
        return wrench.mean(axis=0), len(wrench)

    def flagged(self, among: slice) -> bool:
        """Say whether the device flagged a reading of a slice."""
        return bool(self._flagged[among].any())

    def usable_around(self, host_s: float, within_s: float) -> tuple[int, int] | None:
        """Return where the last usable reading before and the first at or after `host_s` lie; None if one is missing.

        Parameters
        ----------
        within_s : s, how far to look on either side
        """
        near = self.between(host_s - within_s, host_s + within_s)
        usable = near.start + np.flatnonzero(self._usable[near])
        right = int(np.searchsorted(self._host_s[usable], host_s))
        return None if right in (0, len(usable)) else (int(usable[right - 1]), int(usable[right]))

    def interpolate(self, pair: tuple[int, int], host_s: float) -> FloatArray:
        """Return the wrench at `host_s` on the straight line between two readings."""
        (left_s, right_s), (left, right) = self._host_s[list(pair)], self._wrench[list(pair)]
        return left + (right - left) * ((host_s - left_s) / (right_s - left_s))

    def gap(self, pair: tuple[int, int]) -> float:
        """Return the time between two readings, seconds."""
        return float(self._host_s[pair[1]] - self._host_s[pair[0]])

    def since(self, host_s: float) -> tuple[FloatArray, FloatArray]:
        """Return copies of the stamps (n,) and wrenches (n, 6) from `host_s` on, usable or not."""
        first = int(np.searchsorted(self._host_s[: self._end], host_s))
        return self._host_s[first : self._end].copy(), self._wrench[first : self._end].copy()
