"""Lines of one link over time: agreement on a form, frames over several lines, a column that only rises, ends of lines."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from skincal.devices.decoding import MarkSplitter
from skincal.geometry import FloatArray

PLAIN_KEY = ("plain", "")
"""Form and title of a line of numbers alone."""
LONE_RETURNS_MIN = 3
"""Carriage returns without a line feed, before the first line feed, after which they end lines."""
RISING_MIN_LINES = 30
RISING_MIN_STEPS = 20
"""Of these lines, those whose value is larger than the one before: at 2 kHz two lines may have one millisecond."""
NUMBER_SHAPE = "number"
"""Form of a separator that is one number."""
_LONE_RETURN_RE = re.compile(rb"\r(?=[^\r\n])")
_DIGITS_RE = re.compile(r"\d+")


class LineSplitter(MarkSplitter):
    """Cuts bytes at line feeds; at carriage returns if a device sends these alone, until its first line feed."""

    def __init__(self, limit: int) -> None:
        super().__init__(b"\n", limit)
        self._is_decided = False

    def split(self, data: bytes) -> list[bytes | None]:
        if self._mark == b"\n" and not self._is_decided:
            head, feed, _ = (self._rest + data).partition(b"\n")
            if len(_LONE_RETURN_RE.findall(head)) >= LONE_RETURNS_MIN:
                self._mark = b"\r"
            self._is_decided = bool(feed)
        if self._mark == b"\n":
            return super().split(data)
        begin, feed, rest = data.partition(b"\n")
        frames = super().split(begin + (b"\r" if feed else b""))
        if feed:
            self._mark, self._is_decided = b"\n", True
            frames += super().split(rest)
        return frames


class FormAgreement:
    """Form and title of the lines that give one stream.

    Lines of numbers alone are believed at once. Any other form is believed when two lines in a row have it: a board may print
    its offsets once. Lines of another form are then left out, since they may be raw values beside filtered ones.
    """

    def __init__(self) -> None:
        self.key: tuple[str, str] | None = None
        """Form and title; `None` while undecided."""
        self._candidate: tuple[str, str] | None = None

    @property
    def name(self) -> str:
        """Form and title in words."""
        return " ".join(self.key or ()).strip()

    def accept(self, key: tuple[str, str]) -> bool:
        """Check whether a line of this form and title is a reading."""
        if self.key is None and key in (PLAIN_KEY, self._candidate):
            self.key = key
        self._candidate = key
        return self.key == key


class ChannelFrames:
    """Frames of labelled channels, on one line or over several.

    A number is a channel, from 0 or from 1. A missing one is NaN, and never takes the value of its neighbour.
    """

    def __init__(self) -> None:
        self._found: dict[int, float] = {}
        self._first: int | None = None
        self._incomplete = 0

    def pop_incomplete(self) -> int:
        """Count new frames that lack more than half of their channels or a known first number."""
        count, self._incomplete = self._incomplete, 0
        return count

    def add(self, channels: dict[int, float], width: int | None) -> list[list[float]]:
        """Add the channels of a line; return the completed frames."""
        frames: list[list[float]] = []
        if self._found and min(channels) <= max(self._found):
            frames += self._end(width)
        self._found |= channels
        # Without a width, a line of several channels is a frame.
        is_end = len(channels) > 1 if width is None else self._is_end(width)
        return frames + (self._end(width) if is_end else [])

    def _is_end(self, width: int) -> bool:
        first = self._first_of(self._found, width)
        return first is not None and max(self._found) >= first + width - 1

    def _first_of(self, found: dict[int, float], width: int) -> int | None:
        if 0 in found:
            return 0
        return 1 if self._first is None and width in found else self._first

    def _end(self, width: int | None) -> list[list[float]]:
        found, self._found = self._found, {}
        size = len(found) if width is None else width
        first = (min(found) if min(found) <= 1 else None) if width is None else self._first_of(found, size)
        if first is None or max(found) >= first + size or min(found) < first or 2 * len(found) < size:
            self._incomplete += 1
            return []
        self._first = first
        return [[found.get(number, math.nan) for number in range(first, first + size)]]


class SeparatedRows:
    """Frames whose rows are lines, with a title, dashes or a rising number between them.

    Separators have the same words, and any numbers. A frame is complete if all its rows lie between two separators.
    """

    def __init__(self) -> None:
        self.is_agreed = False
        self._shape = ""
        self._rows: list[list[float]] = []
        self._number = math.nan
        self._incomplete = 0

    def pop_incomplete(self) -> int:
        """Count new frames that lack rows, since the separators were agreed."""
        count, self._incomplete = self._incomplete, 0
        return count

    def add_row(self, numbers: list[float], width: int) -> list[float] | None:
        """Add a line of numbers. A single number may be a separator, and then ends a frame, which is returned."""
        if len(numbers) == 1 and (not self._rows or len(self._rows[0]) > 1) and self._shape in ("", NUMBER_SHAPE):
            return self._separate_by(numbers[0], width)
        self._rows.append(numbers)
        # More rows than a frame has are none of the frame, and need no memory.
        if len(self._rows) > width:
            self._rows = self._rows[-1:]
            self._shape = self._shape if self.is_agreed else ""
        return None

    def _separate_by(self, number: float, width: int) -> list[float] | None:
        """End a frame at a number. A number that does not rise ends none: the device began again, or a row was damaged."""
        step, self._number = number - self._number, number
        if not (step == 1 or (self.is_agreed and step > 0)):
            self._incomplete += bool(self._rows) and self.is_agreed
            self._rows, self._shape = [], NUMBER_SHAPE
            return None
        return self._separate(NUMBER_SHAPE, width)

    def add_words(self, line: str, width: int) -> list[float] | None:
        """Add a line that is no row; return the frame that it ends."""
        return self._separate(_DIGITS_RE.sub("0", line), width)

    def _separate(self, shape: str, width: int) -> list[float] | None:
        if self.is_agreed and shape != self._shape:
            return None
        rows, self._rows = self._rows, []
        is_same, self._shape = shape == self._shape, shape
        is_frame = len({*map(len, rows)}) == 1 and len(rows) > 1 and len(rows) * len(rows[0]) == width
        if is_same and is_frame:
            self.is_agreed = True
            return [each for row in rows for each in row]
        self._incomplete += bool(rows) and self.is_agreed
        return None


class RisingColumn:
    """Search for a first column that only rises: a clock or a number, and no value of a sensor."""

    def __init__(self) -> None:
        self.is_found = False
        """Whether the first column, and it alone, rose all the time. A counter may begin again now and then."""
        self._restart(np.empty(0))

    def _restart(self, row: FloatArray) -> None:
        self._last, self._lines = row, 0
        self._steps, self._never_falls = np.zeros(len(row)), np.ones(len(row), bool)

    def add(self, numbers: Sequence[float]) -> bool:
        """Add the numbers of a line; return whether its first column is a clock or a number."""
        row = np.asarray(numbers)
        if len(row) != len(self._last):
            self.is_found = False
            self._restart(row)
            return False
        self._lines += 1
        fell = row[0] < self._last[0]
        self._steps += row > self._last
        self._never_falls &= row >= self._last
        self._last = row
        if self.is_found and fell:
            # A second fall so soon is that of a value.
            self.is_found = self._lines >= RISING_MIN_LINES
            self._restart(row)
        elif not self.is_found and self._lines == RISING_MIN_LINES:
            rises = self._never_falls & (self._steps >= RISING_MIN_STEPS)
            self.is_found = bool(rises[0]) and int(rises.sum()) == 1
            self._restart(row)
        return self.is_found
