"""Lines of one link over time: agreement on a form, frames over several lines, a column that only rises, ends of lines."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from skincal.devices.decoding import MarkSplitter
from skincal.streams.decoders.line_forms import opens_brackets

PLAIN_KEY = ("plain", "")
"""Form and title of a line of numbers alone."""
LONE_RETURNS_MIN = 3
"""Carriage returns without a line feed, before the first line feed, after which they end lines."""
NUMBERED_CYCLES_MIN, NUMBERED_LINES_MIN = 3, 12
"""Cycles and lines whose first values count the lines of a frame, until they are known to do so."""
FRAMES_WITHOUT_CHANNEL_MIN = 20
"""Frames in a row without the same channels, until the link names these."""
BEYOND_LINES_MIN = 3
"""Lines whose numbers are beyond the scene's: one may be damaged."""
COUNTED_TITLES_MIN = 30
"""Titles in a row whose numbers rise, until these count frames and are not those of several sensors."""
CONSTANT_CHECKSUMS_MIN = 10
"""Wrong checksums in a row, all the same, that show that the board computes none."""
OPEN_BRACKETS_MAX_LINES = 256
CHANNELS_MAX = 65536
"""Labels of a frame that are kept: garbage needs no memory."""
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

    def accept(self, key: tuple[str, str], *, is_sure: bool = True) -> bool:
        """Check whether a line of this form and title is a reading. Lines that are not sure follow one that is."""
        if self.key is None and is_sure and key in (PLAIN_KEY, self._candidate):
            self.key = key
        self._candidate = key
        return self.key == key


class LineFrames:
    """Frames that are put together from lines."""

    def __init__(self) -> None:
        self._incomplete = 0

    def pop_incomplete(self) -> int:
        """Count new incomplete frames, since the form of the frames was agreed."""
        count, self._incomplete = self._incomplete, 0
        return count


class LabelledFrames(LineFrames):
    """Frames whose lines have labels or titles that count."""

    def __init__(self) -> None:
        super().__init__()
        self._beyond_lines = 0

    @property
    def is_beyond(self) -> bool:
        """Whether they count further than the scene: these channels are not those of the scene."""
        return self._beyond_lines >= BEYOND_LINES_MIN


class ChannelFrames(LabelledFrames):
    """Frames of labelled channels, on one line or over several.

    A number is a channel, from 0 or from 1. A missing one is NaN, and never takes the value of its neighbour.
    A frame is incomplete if it lacks more than half of its channels, or if its first number is not known yet.
    """

    def __init__(self) -> None:
        super().__init__()
        self._found: dict[int, float] = {}
        self._first: int | None = None
        self._frames_without = 0
        self._without = set[int]()

    def add(self, channels: dict[int, float], width: int | None) -> list[list[float]]:
        """Add the channels of a line; return the completed frames."""
        frames: list[list[float]] = []
        self._beyond_lines += width is not None and max(channels) >= width + (self._first != 0)
        if self._found and min(channels) <= max(self._found):
            frames += self._end(width)
        self._found |= channels
        if len(self._found) > CHANNELS_MAX:
            self._found, self._incomplete = {}, self._incomplete + 1
            return frames
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
        if self.is_beyond or first is None or max(found) >= first + size or min(found) < first or 2 * len(found) < size:
            self._incomplete += 1
            return []
        self._first = first
        self._note_missing({number - first for number in range(first, first + size)} - {each - first for each in found})
        return [[found.get(number, math.nan) for number in range(first, first + size)]]

    def _note_missing(self, channels: set[int]) -> None:
        self._frames_without = self._frames_without + 1 if channels and channels == self._without else 1
        self._without = channels

    @property
    def never_sent(self) -> list[int]:
        """Channels that none of many frames had."""
        return sorted(self._without) if self._frames_without >= FRAMES_WITHOUT_CHANNEL_MIN else []


class SeparatedRows(LineFrames):
    """Frames whose rows are lines, with a title, dashes or a rising number between them.

    Separators have the same words, and any numbers. A frame is complete if all its rows lie between two separators.
    """

    def __init__(self) -> None:
        super().__init__()
        self.is_agreed = False
        self._shape = ""
        self._rows: list[list[float]] = []
        self._number = math.nan

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


class NumberedRows(LabelledFrames):
    """Frames whose lines begin with their number: a row, or one channel.

    Nothing but a number counts 0, 1, 2, ... through the lines of a frame, again and again. With the number in the values it
    is known after `NUMBERED_CYCLES_MIN` frames, with it in the title at once.
    """

    def __init__(self) -> None:
        super().__init__()
        self.is_agreed = False
        self._rows: list[list[float]] = []
        self._first = 0
        self._lines = self._cycles = 0

    def add(self, number: float, values: list[float], width: int, *, is_title: bool = False) -> list[float] | None:
        """Add the values of a line and its number; return the frame that they complete."""
        rows, rest = divmod(width, len(values)) if values else (0, 1)
        if rest or rows < 2 or (self._rows and len(values) != len(self._rows[0])):
            self._restart()
            return None
        self._beyond_lines += is_title and number >= rows + (not self.is_agreed or self._first)
        if self.is_beyond:
            self.is_agreed = False
            return None
        if number != self._first + len(self._rows):
            self._restart()
            # Frames begin at 0, or at 1.
            if number not in (0, 1):
                return None
            self._first = int(number)
        self._rows.append(values)
        self._lines += 1
        if len(self._rows) < rows:
            return None
        frame, self._rows = [each for row in self._rows for each in row], []
        self._cycles += 1
        is_known = self._cycles >= NUMBERED_CYCLES_MIN and self._lines >= NUMBERED_LINES_MIN
        self.is_agreed = self.is_agreed or is_title or is_known
        return frame if self.is_agreed else None

    def _restart(self) -> None:
        self._incomplete += bool(self._rows) and self.is_agreed
        self._rows, self._lines, self._cycles = [], 0, 0


class CyclicColumn:
    """Search for a first value that counts through the lines of a frame, again and again."""

    def __init__(self) -> None:
        self._last = math.nan
        self._steps = self._cycles = 0
        self.lines = 0
        """Lines of a frame; 0 if the first value does not count."""

    def add(self, number: float) -> int:
        """Add the first value of a line; return the lines of a frame, or 0."""
        if number == self._last + 1:
            self._steps += 1
        else:
            is_cycle = number in (0, 1) and self._steps > 0 and self._last - number == self._steps
            self._cycles = self._cycles + 1 if is_cycle else 0
            self.lines = self._steps + 1 if self._cycles >= NUMBERED_CYCLES_MIN else 0
            self._steps = 0
        self._last = number
        return self.lines


def counts_lines(rows: Sequence[Sequence[float]]) -> bool:
    """Check whether the first values of several rows, or every second one of one row, only count."""
    if not rows:
        return False
    numbers = [row[0] for row in rows] if len(rows) > 1 else list(rows[0][::2])
    is_count = len(numbers) > 2 and numbers == [numbers[0] + k for k in range(len(numbers))]
    # Rows of a number and a value may begin anywhere.
    return is_count and ((len(numbers) > 3 and numbers[0] in (0, 1)) or (len(rows) > 1 and len(rows[0]) == 2))


class ContinuedLines(LineFrames):
    """Frames on two or more lines, where a separator at the end or at the begin of a line says that the frame goes on."""

    def __init__(self) -> None:
        super().__init__()
        self._parts: list[float] = []
        self._ends_open = self._began_open = False
        self._complete = 0

    @property
    def is_agreed(self) -> bool:
        return self._complete > 1

    def add(self, line: str, numbers: list[float], width: int) -> list[float] | None:
        """Add a line and its numbers; return the frame that it completes, but not the first one."""
        begins_open = line[0] in ",;"
        # A separator at the begin of all lines, or at the end of all, says nothing.
        goes_on = bool(self._parts) and self._ends_open != begins_open and not (begins_open and self._began_open)
        self._incomplete += bool(self._parts) and not goes_on and self.is_agreed
        self._parts = self._parts + numbers if goes_on else numbers
        self._began_open = self._began_open if goes_on else begins_open
        self._ends_open = line[-1] in ",;"
        if len(self._parts) < width:
            return None
        parts, self._parts = self._parts, []
        if len(parts) > width or not goes_on or self._ends_open:
            self._incomplete += self.is_agreed
            return None
        self._complete += 1
        return parts if self.is_agreed else None


class Cells:
    """Frames of values that are named by row and column; channels count row by row."""

    def __init__(self) -> None:
        self._found: dict[tuple[int, int], float] = {}
        self._shape: tuple[int, int, int, int] | None = None
        """First row and column, and the number of rows and columns, once a whole frame came."""

    def channels_of(self, cells: dict[tuple[int, int], float], width: int | None) -> dict[int, float]:
        """Give the cells of a line the numbers of their channels; empty until the shape of a frame is known."""
        if self._shape is None:
            if self._found.keys() & cells.keys():
                self._shape = self._shape_of(width)
                self._found.clear()
            # More is no skin.
            self._found = self._found | cells if len(self._found) < CHANNELS_MAX else {}
        if self._shape is None:
            return {}
        row, column, rows, columns = self._shape
        is_inside = all(row <= each[0] < row + rows and column <= each[1] < column + columns for each in cells)
        return {(each[0] - row) * columns + each[1] - column: value for each, value in cells.items()} if is_inside else {}

    def _shape_of(self, width: int | None) -> tuple[int, int, int, int] | None:
        rows, columns = (sorted({each[k] for each in self._found}) for k in (0, 1))
        shape = rows[0], columns[0], rows[-1] - rows[0] + 1, columns[-1] - columns[0] + 1
        count = shape[2] * shape[3]
        is_whole = count == len(self._found) and count == (count if width is None else width) and max(shape[:2]) <= 1
        return shape if is_whole else None


class NumberedTitles:
    """Titles with a number: a number that only rises counts frames, another one names a sensor."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[int, int]] = {}
        """Last number, and the numbers in a row that rose, by title."""

    def resolve(self, title: str, number: int, limit: int) -> str:
        """Return the title without a number that counts frames, else with it."""
        last, rises = self._last.get(title, (number, 0))
        rises = min(rises + 1, COUNTED_TITLES_MIN) if number > last else 0
        if title in self._last or len(self._last) < limit:
            self._last[title] = number, rises
        return title if rises >= COUNTED_TITLES_MIN else f"{title} {number}"


class ConstantChecksum:
    """Search for a checksum that is the same in all lines and wrong in all: the board computes none."""

    def __init__(self) -> None:
        self._sum, self._count = "", 0

    def is_none(self, checksum: str) -> bool:
        """Add the wrong checksum of a line, or an empty one for a right one; return whether it is no checksum."""
        self._count = min(self._count + 1, CONSTANT_CHECKSUMS_MIN) if checksum and checksum == self._sum else bool(checksum)
        self._sum = checksum
        return self._count >= CONSTANT_CHECKSUMS_MIN


class OpenBrackets:
    """Lists and objects over several lines, as numpy and indented JSON are printed."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self._open = 0

    @property
    def is_open(self) -> bool:
        return bool(self._lines)

    def close(self) -> None:
        """Forget the lines: they were words."""
        self._lines, self._open = [], 0

    def add(self, line: str) -> str | None:
        """Add a line; return the whole text once its brackets are closed."""
        begins = line[0] in "[{"
        if not self._lines and not begins:
            return None
        depth = self._open + opens_brackets(line)
        if depth < 0 or len(self._lines) >= OPEN_BRACKETS_MAX_LINES:
            return self.close()
        self._lines.append(line)
        self._open = depth
        if depth:
            return None
        whole, self._lines = " ".join(self._lines), []
        return whole
