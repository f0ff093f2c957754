"""Columns of readings that only rise: clocks and numbers in front of the values, and no taxels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray

RISING_COLUMNS_MAX = 3
"""Clocks and numbers that a line has at most: a number, a time, and one of a second clock."""
RISING_MIN_LINES = 30
RISING_MIN_STEPS = 20
"""Of these lines, those whose value is larger than the one before: at 2 kHz two lines may have one millisecond."""


class RisingColumns:
    """Search for columns at the begin or the end of a line that only rise: a clock or a number, and no value of a sensor."""

    def __init__(self) -> None:
        self.values: slice | None = None
        """Values of a line without these columns; `None` until some, and they alone, rose all the time."""
        self._restart(np.empty(0))

    def _restart(self, row: FloatArray) -> None:
        self._last, self._lines = row, 0
        self._steps, self._never_falls = np.zeros(len(row)), np.ones(len(row), bool)

    def add(self, numbers: Sequence[float], excess: int | None = None) -> slice | None:
        """Add the numbers of a line; return its values without the columns that rise.

        Parameters
        ----------
        excess : number of columns more than expected; `None` if any number may be
        """
        row = np.asarray(numbers)
        if len(row) != len(self._last):
            self.values = None
            self._restart(row)
            return None
        self._lines += 1
        fell = row < self._last
        self._steps += row > self._last
        self._never_falls &= row >= self._last
        self._last = row
        if self.values is not None:
            is_lead = np.ones(len(row), bool)
            is_lead[self.values] = False
            # A counter may begin again now and then. A second fall so soon is that of a value.
            if (fell & is_lead).any():
                self.values = self.values if self._lines >= RISING_MIN_LINES else None
                self._restart(row)
        elif self._lines == RISING_MIN_LINES:
            self.values = self._values_beside(self._never_falls & (self._steps >= RISING_MIN_STEPS), excess)
            self._restart(row)
        return self.values

    @staticmethod
    def _values_beside(rises: NDArray[np.bool_], excess: int | None) -> slice | None:
        count = int(rises.sum())
        if not 0 < count <= RISING_COLUMNS_MAX or (excess is not None and count != excess):
            return None
        return slice(count, None) if rises[:count].all() else slice(0, -count) if rises[-count:].all() else None


def rising_words(values: slice, count: int) -> str:
    """Name the columns that are not among the values of a line."""
    left = count - len(range(*values.indices(count)))
    side = "first" if values.start else "last"
    return f"{side} of {count} values a line" if left == 1 else f"{side} {left} of {count} values a line"
