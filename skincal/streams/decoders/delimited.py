"""Lines of text as makers' sketches print them, without a checksum: lenient, and so the last choice.

One frame a line, or one row a line and a blank line after each frame. Fields are separated by comma, semicolon (then a
comma is a decimal point), tab or spaces. A line's number of values determines its stream: six of a wrench where the link
carries wrenches, the width of the skin where it carries skin, anything constant for joints (degrees). Words, such as a
banner at boot, are passed over. A header line that names leading columns (`seq`, `t`, `time`, `millis`, `t_us`, ...; `t` and
`time` are seconds) makes them the number and the device's clock. Without a header, first or last values that only
rise are found.

Lines of other forms (`line_forms.py`) are read once two in a row have one form, unless lines of numbers alone came before.

Limits: a line that lost a digit, or two lines joined into one with the right count, are not noticed.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from typing import ClassVar

import numpy as np

from skincal.devices.column_names import (
    CLOCK_COLUMN_RE,
    TIME_COLUMN_RE,
    TIME_UNITS,
    WRENCH_AXES,
    short_unit,
)
from skincal.devices.decoding import CLOCK_MODULUS_US, DEFAULT_UNITS, NO_SEQ, FrameDecoder, FrameSplitter
from skincal.devices.pose_names import PoseNames, clash_in_scene
from skincal.devices.rising_columns import RISING_COLUMNS_MAX, RisingColumns, rising_words
from skincal.geometry import FloatArray
from skincal.model.errors import list_channels
from skincal.model.pose_form import POSE_WIDTHS
from skincal.model.readings import Loss, Stream
from skincal.streams.decoders.line_forms import (
    HEXADECIMAL_FORM,
    LineReading,
    has_hex_letters,
    hex_numbers,
    is_clock_or_counter,
    opens_brackets,
    read_line,
    split_fields,
    to_numbers,
    without_colours,
)
from skincal.streams.decoders.line_streams import (
    PLAIN_KEY,
    Cells,
    ChannelFrames,
    ConstantChecksum,
    ContinuedLines,
    CyclicColumn,
    FormAgreement,
    LineSplitter,
    NumberedRows,
    NumberedTitles,
    OpenBrackets,
    SeparatedRows,
    counts_lines,
)

LINE_MAX_BYTES = 65536
"""Bytes. Some 4,200 values of 12 characters fit."""
SECONDS_COLUMNS = ("t", "time")
SEQ_COLUMN = "seq"
SURE_COLUMNS = frozenset((SEQ_COLUMN, "t", "time", "t_s", "t_ms", "t_us"))
"""Leading columns that are believed also where the number of values is unknown."""
MAX_PARSED_NUMBER = 1e18
"""Largest number or clock that is taken for one: what a batch's integers hold."""
MAX_TITLES = 8
"""Titles of labelled channels that are followed: damaged titles need no memory."""
WHOLE_NUMBERS_MIN_BYTES = 1000
"""Bytes of a line from which its numbers are read in arrays: of a shorter one Python reads them as fast."""
WHOLE_NUMBER_MAX_DIGITS = 15
"""Digits of the longest number that a float surely holds exactly."""
HEX_LINES_MIN = 3
"""Lines with hexadecimal letters among decimal ones that show that these were hexadecimal, too."""
HEX_WINDOW_LINES = 30
RISING_SEARCH_LINES = 300
"""Plain lines of the expected width among which a first value that only rises is searched."""
HEX_KEY = (HEXADECIMAL_FORM, "")
HEX_AFTER_DECIMALS = (
    "Lines have hexadecimal digits (A to F) without 0x, and earlier lines without letters were read as decimals: discard "
    "those readings. Print 0x before each number, or print decimals"
)
MAY_BE_HEX = "Numbers begin with 0 and may be hexadecimal; they are read as decimals. Print 0x before hexadecimal numbers"


class TextDecoder(FrameDecoder):
    """Decodes lines of text."""

    name: ClassVar[str] = "text"
    mark: ClassVar[bytes] = b"\n"
    limit: ClassVar[int] = LINE_MAX_BYTES

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._columns = LeadingColumns()
        self._other_pose = ""
        """Sentence on a header that names other poses than the scene; empty if they agree."""
        self._header: tuple[str, list[str]] = ("", [])
        """Line that named the columns last, and its names: a board repeats it, and of a large skin it has thousands."""
        # Of a skin frame whose rows are lines of their own, until the blank line that ends it.
        self._rows: list[list[float]] = []
        self._has_too_many_rows = self._has_blank_ends = False
        self._separated, self._numbered, self._continued = SeparatedRows(), NumberedRows(), ContinuedLines()
        self._titled_rows: dict[tuple[str, str], NumberedRows] = {}
        self._agreed = {stream: FormAgreement() for stream in carries}
        self._channel_frames: dict[tuple[str, str], ChannelFrames] = {}
        self._cells: dict[tuple[str, str], Cells] = {}
        self._titles, self._checksum, self._brackets = NumberedTitles(), ConstantChecksum(), OpenBrackets()
        self._rising: dict[int, RisingColumns] = {}
        """By number of values: a link may have lines of two streams."""
        self._rising_inside, self._cyclic = RisingColumns(), CyclicColumn()
        self._lines_searched = self._pair_lines = 0
        self._hex_lines = self._lines_since_hex = 0

    def _make_splitter(self) -> FrameSplitter:
        return LineSplitter(self.limit)

    def _decode(self, frame: bytes) -> Loss | None:
        line = (without_colours(frame) if b"\x1b" in frame else frame).strip()
        if not line:
            return None if self._first else self._end_frame()
        if not line.isascii() or not line.decode().replace("\t", " ").isprintable():
            return Loss.UNREADABLE
        if self._hex_lines >= HEX_LINES_MIN:
            self._problem = HEX_AFTER_DECIMALS
            return Loss.UNREADABLE
        if self._columns.count and not self._brackets.is_open and not self._first and len(line) >= WHOLE_NUMBERS_MIN_BYTES:
            values = whole_numbers(line)
            stream = None if values is None else self._stream_of(len(values) - self._columns.count)
            if values is not None and stream is not None:
                return self._add_named(stream, values)
        text = line.decode()
        fields, numbers = _parse(text)
        if self._brackets.is_open or (
            ("[" in text or "{" in text) and opens_brackets(text) > 0 and not self._first and not self._is_all_plain
        ):
            is_frame = numbers is not None and self._stream_of(len(numbers)) is not None and not opens_brackets(text)
            whole = self._brackets.close() if is_frame else self._brackets.add(text)
            if self._brackets.is_open:
                return None
            if whole is not None:
                text = whole
                fields, numbers = _parse(text)
        if numbers is None:
            rest = to_numbers(split_fields(text[1:].strip())) if text[0] in ",;" and "_" not in text else None
            if rest is None or self._first or self._stream_of(len(rest)) is not None:
                return self._words(text, fields)
            return self._other_width(text, rest)
        # Without a checksum nothing shows whether the first line after opening lost its front digits.
        return None if self._first else self._numbers(text, numbers, fields)

    def _words(self, line: str, fields: list[str]) -> Loss | None:
        """Read a header or a line of another form, or pass over a banner. A line that is mostly numbers is damaged."""
        header, names = self._header
        if line != header:
            names = [field.strip("\"' ").lower() for field in fields]
        if Stream.TOOL in self._widths:
            self._read_pose_names(names)
        if self._columns.named_by(names, self._stream_of):
            self._header = line, names
            return None
        if not self._first and self._is_read(line, fields):
            return None
        width = self._width(Stream.SKIN)
        if width is not None and not self._has_blank_ends and not self._first:
            frame = self._separated.add_words(line, width)
            if frame is not None or self._separated.is_agreed:
                return self._end_part(self._separated, frame)
        readable = sum(to_numbers([field]) is not None for field in fields)
        return Loss.UNREADABLE if 2 * readable >= len(fields) else None

    def _read_pose_names(self, names: list[str]) -> None:
        """Compare what a header of a pose names with the scene."""
        columns = [name for name in names if not is_clock_or_counter(name)]
        found = PoseNames.read(columns)
        clash = None if self._pose_form is None else found.clash(*self._pose_form)
        if found.mistake is not None and self._width(Stream.TOOL) in (None, len(columns)):
            self._other_pose = f"The header is {' '.join(columns)}, {found.mistake.finding}; {found.mistake.advice}"
        elif clash is not None:
            self._other_pose = f"The header names {clash_in_scene(clash, 'the scene')}"
        elif len(columns) in POSE_WIDTHS:
            self._other_pose = ""

    # Lines of numbers alone

    def _numbers(self, line: str, numbers: list[float], fields: list[str]) -> Loss | None:
        lead = self._columns.count
        stream = self._stream_of(len(numbers) - lead)
        if stream is None:
            return self._other_width(line, numbers)
        if lead:
            return self._add_named(stream, numbers)
        self._end_rows()
        if self._agreed[stream].key == HEX_KEY:
            return self._add_hex(stream, fields)
        # Digits alone that are below 10 are the same number in both bases.
        is_sure = not all(field.strip().isdigit() and number < 10 for field, number in zip(fields, numbers, strict=True))
        if not self._is_plain(stream, is_sure=is_sure):
            return Loss.UNREADABLE
        self._watch_plain(stream, line, numbers, fields)
        if stream is Stream.SKIN and len(numbers) > 6 and numbers[0] in (0, 1) and counts_lines([numbers]):
            half = len(numbers) // 2
            self._problem = f"Every second value is the number of a channel (0, 1, 2, ...): set [skin] channels to {half}"
            return Loss.UNREADABLE
        return self._add_plain(stream, NO_SEQ, math.nan, numbers)

    def _add_named(self, stream: Stream, numbers: list[float] | FloatArray) -> Loss | None:
        """Add the values of a line whose first columns, clocks and counters, a header has named."""
        self._end_rows()
        if not self._is_plain(stream):
            return Loss.UNREADABLE
        lead = self._columns.count
        seq, device_s, missing = self._columns.read(map(float, numbers[:lead]))
        self._count_missing(missing)
        return self._add_plain(stream, seq, device_s, numbers[lead:])

    def _add_plain(self, stream: Stream, seq: int, device_s: float, values: list[float] | FloatArray) -> Loss | None:
        if stream is Stream.TOOL and self._other_pose:
            self._problem = self._other_pose
            return Loss.NO_POSE
        return self._add(stream, seq, device_s, values)

    def _end_rows(self) -> None:
        """Count the rows of a frame that another line broke off."""
        if self._rows:
            self.counts[Loss.BAD_WIDTH] += len(self._rows)
            self._rows = []

    @property
    def _is_all_plain(self) -> bool:
        """Whether lines of numbers alone are the readings of every stream that gave some."""
        return {agreed.key for agreed in self._agreed.values()} - {None} == {PLAIN_KEY}

    def _is_plain(self, stream: Stream, *, is_sure: bool = True) -> bool:
        """Check whether plain lines are readings of the stream; a line that is surely plain decides that they are."""
        agreed = self._agreed[stream]
        if agreed.accept(PLAIN_KEY) if is_sure else agreed.key in (None, PLAIN_KEY):
            return True
        self._problem = f"Lines of numbers alone are left out, since lines of another form ({agreed.name}) came before"
        return False

    def _watch_plain(self, stream: Stream, line: str, numbers: list[float], fields: list[str]) -> None:
        """Look for signs that plain numbers are something else: hexadecimal digits, or a clock as the first value."""
        # Of the hexadecimal letters a number has an E alone.
        if ("e" in line or "E" in line) and len(fields) > 1 and has_hex_letters(fields):
            self._count_hex_line()
        else:
            self._lines_since_hex += 1
            if self._lines_since_hex > HEX_WINDOW_LINES:
                self._hex_lines = 0
        if self._lines_searched > RISING_SEARCH_LINES:
            return
        self._lines_searched += 1
        if len({*map(len, fields)}) == 1 and len(fields[0]) > 1 and all(map(str.isdigit, fields)):
            self._status = MAY_BE_HEX if any(field[0] == "0" for field in fields) else self._status
        lines = self._cyclic.add(numbers[0]) if stream is Stream.SKIN and len(numbers) > 1 else 0
        if lines:
            count = len(numbers) - 1
            self._status = (
                f"The first of {count + 1} values a line counts again and again and is no value: set [skin] channels to "
                f"{lines * count} if it is the number of a channel or a row, to {count} if it is a counter"
            )
        elif stream in (Stream.SKIN, Stream.WRENCH) and len(numbers) > 2:
            values = self._rising_inside.add(numbers)
            if values is not None:
                advice = (
                    f"set [skin] channels to {len(numbers[values])}" if stream is Stream.SKIN else "name it in a header line"
                )
                self._status = f"The {rising_words(values, len(numbers))} only rises: if it is a clock or a number, {advice}"

    def _count_hex_line(self) -> None:
        self._hex_lines, self._lines_since_hex = self._hex_lines + 1, 0

    def _add_hex(self, stream: Stream, fields: list[str]) -> Loss | None:
        values = hex_numbers(fields)
        return Loss.UNREADABLE if values is None else self._add(stream, NO_SEQ, math.nan, values)

    def _other_width(self, line: str, numbers: list[float]) -> Loss | None:
        """Read a part of a frame, or a line with a clock, a number or the numbers of the channels among its values."""
        lead, width = self._columns.count, self._width(Stream.SKIN)
        stream, values = (None, None) if lead else self._without_rising(numbers)
        if stream is not None and values is not None:
            self._problem = ""
            return self._add(stream, NO_SEQ, math.nan, values)
        if not lead and width is not None and len(numbers) < width:
            for parts, frame in self._parts_of(line, numbers, width):
                if frame is not None or parts.is_agreed:
                    return self._end_part(parts, frame)
        if not lead and self._is_row(numbers):
            self._rows.append(numbers)
            return None
        self._has_too_many_rows |= bool(self._rows)
        if not lead and width is not None and width > 1 and len(numbers) == 2 * width and counts_lines([numbers]):
            self._pair_lines += 1
            # Two lines in a row that count are no values.
            return self._end_part(None, numbers[1::2]) if self._pair_lines > 1 else None
        self._pair_lines = 0
        self._problem = f"Lines of {len(numbers)} values arrive where {self._expected(lead)} are expected"
        widths = [width for width in map(self._width, self._carries) if width is not None]
        if 1 < len(widths) == len(self._carries) and 0 <= len(numbers) - sum(widths) <= RISING_COLUMNS_MAX:
            self._problem += f"; send {' and '.join(each.value for each in self._carries)} on lines of their own"
        return Loss.BAD_WIDTH

    def _without_rising(self, numbers: list[float]) -> tuple[Stream | None, list[float] | None]:
        """Find the stream of a line with clocks or numbers among its values, and its values without them."""
        for stream in self._carries:
            excess = len(numbers) - (self._width(stream) or len(numbers))
            if not 0 < excess <= RISING_COLUMNS_MAX or (len(numbers) not in self._rising and len(self._rising) >= MAX_TITLES):
                continue
            values = self._rising.setdefault(len(numbers), RisingColumns()).add(numbers, excess)
            if values is not None and self._is_plain(stream):
                left_out = f"without the {rising_words(values, len(numbers))}, which only rises: a clock or a number"
                self.units[stream] = f"{DEFAULT_UNITS[stream]}, {left_out}"
                return stream, numbers[values]
            break
        return None, None

    def _parts_of(
        self, line: str, numbers: list[float], width: int
    ) -> Iterator[tuple[SeparatedRows | NumberedRows | ContinuedLines, list[float] | None]]:
        """Add a line to each kind of frames over several lines; give the frames that it completes."""
        yield self._continued, self._continued.add(line, numbers, width)
        if len(numbers) > 1:
            yield self._numbered, self._numbered.add(numbers[0], numbers[1:], width)
        if not self._has_blank_ends:
            yield self._separated, self._separated.add_row(numbers, width)

    def _is_row(self, numbers: list[float]) -> bool:
        """Check whether a line may be a row of the unfinished frame."""
        width = self._width(Stream.SKIN)
        return width is not None and sum(map(len, self._rows)) + len(numbers) <= width

    def _end_frame(self) -> Loss | None:
        rows, self._rows = self._rows, []
        has_too_many, self._has_too_many_rows = self._has_too_many_rows, False
        if not rows:
            return None
        self._has_blank_ends = True
        if has_too_many:
            self._problem = f"Frames have more values than the {self._width(Stream.SKIN)} that are expected"
            return Loss.BAD_WIDTH
        if counts_lines(rows):
            self._problem = "The first value of each row is its number, and is no reading"
            return Loss.UNREADABLE
        if not self._is_plain(Stream.SKIN):
            return Loss.UNREADABLE
        return self._add(Stream.SKIN, NO_SEQ, math.nan, [each for row in rows for each in row])

    def _end_part(self, parts: SeparatedRows | NumberedRows | ContinuedLines | None, frame: list[float] | None) -> Loss | None:
        """Add a frame of several lines, if it is complete, and count those that are not."""
        self._rows, self._problem = [], ""
        if parts is not None and (incomplete := parts.pop_incomplete()):
            self.counts[Loss.BAD_WIDTH] += incomplete
        if frame is None:
            return None
        return self._add(Stream.SKIN, NO_SEQ, math.nan, frame) if self._is_plain(Stream.SKIN) else Loss.UNREADABLE

    # Lines of other forms

    def _is_read(self, line: str, fields: list[str]) -> bool:
        """Read a line of another form; return `False` if it is words or of no use."""
        if self._is_all_plain or self._columns.count:
            if len(fields) > 1 and has_hex_letters(fields) and self._stream_of(len(fields)) is not None:
                self._count_hex_line()
            else:
                # A letter beyond F: lines are damaged, and letters up to F may be, too.
                self._hex_lines = 0
            return False
        found = read_line(line)
        if found is None:
            return False
        if not self._checksum.is_none(found.checksum) and found.fault:
            self.counts[Loss.BAD_CHECKSUM] += 1
            self._problem = found.fault
            return True
        key = found.form, self._title_of(found)
        readings, is_pending = self._readings_of(found, key)
        if readings:
            self._add_agreed(found, key, readings)
        elif not is_pending and any(agreed.key == key for agreed in self._agreed.values()):
            self.counts[Loss.BAD_WIDTH] += 1
        return bool(readings) or is_pending or any(agreed.key == key for agreed in self._agreed.values())

    def _title_of(self, found: LineReading) -> str:
        """Return the title of a line: with its number if this names one of several sensors."""
        if found.number is None or all(self._stream_of(len(values)) is None for values in found.lists.values()):
            return found.title
        return self._titles.resolve(found.title, found.number, MAX_TITLES)

    def _readings_of(self, found: LineReading, key: tuple[str, str]) -> tuple[list[tuple[Stream, list[float]]], bool]:
        """Return the readings of a line, and whether its channels are part of a frame that is not complete."""
        readings = list[tuple[Stream, list[float]]]()
        if found.axes and Stream.WRENCH in self._widths:
            readings.append((Stream.WRENCH, [found.axes[axis] for axis in WRENCH_AXES]))
        frames = self._frames_of(found, key) if Stream.SKIN in self._widths else None
        readings += [(Stream.SKIN, each) for each in frames or ()]
        fitting = defaultdict[Stream, list[list[float]]](list)
        for values in found.lists.values():
            stream = self._stream_of(len(values))
            if stream is Stream.WRENCH and found.unit:
                continue
            if stream is not None and not any(stream is known for known, _ in readings):
                fitting[stream].append(values)
        # If two lists fit, either may be the stream's.
        readings += [(stream, lists[0]) for stream, lists in fitting.items() if len(lists) == 1]
        return readings, frames is not None

    def _frames_of(self, found: LineReading, key: tuple[str, str]) -> list[list[float]] | None:
        """Return the frames that the numbered channels, cells or rows of a line complete; `None` if it has none."""
        width = self._width(Stream.SKIN)
        if len(self._channel_frames) + len(self._titled_rows) >= MAX_TITLES and not (
            key in self._channel_frames or key in self._titled_rows
        ):
            return None
        incomplete, frames, is_beyond = 0, None, False
        if found.channels or found.cells:
            channels = self._cells.setdefault(key, Cells()).channels_of(found.cells, width) if found.cells else found.channels
            collected = self._channel_frames.setdefault(key, ChannelFrames())
            frames = collected.add(channels, width) if channels else []
            incomplete = collected.pop_incomplete()
            is_beyond = collected.is_beyond
            if frames and collected.never_sent:
                channels = list_channels(collected.never_sent)
                self._problem = f"No line has a label of channel {channels} (from 0): these have no readings"
        elif found.number is not None and width is not None and key[1] == found.title:
            (values,) = found.lists.values()
            if self._stream_of(len(values)) is None:
                rows = self._titled_rows.setdefault(key, NumberedRows())
                frame = rows.add(found.number, values, width, is_title=True)
                incomplete, frames = rows.pop_incomplete(), [] if frame is None else [frame]
                is_beyond = rows.is_beyond
        if is_beyond:
            self._problem = f"The numbers in front of the values count further than the {width} channels that are expected"
        if incomplete and self._agreed[Stream.SKIN].key == key:
            self.counts[Loss.BAD_WIDTH] += incomplete
        return frames

    def _add_agreed(self, found: LineReading, key: tuple[str, str], readings: list[tuple[Stream, list[float]]]) -> None:
        """Add the readings of the streams that are agreed to come in this form."""
        for stream, values in readings:
            agreed = self._agreed[stream]
            if agreed.accept(key, is_sure=found.is_sure):
                words = [f"values in {found.unit}"] * bool(found.unit) + ["without a checksum"] * bool(found.checksum)
                self.units[stream] = ", ".join(words) or self.units[stream]
                seq, device_s, missing = self._columns.read_named(found.lead.items())
                self._count_missing(missing)
                loss = self._add(stream, seq, device_s, values)
            else:
                # The first line of a form is not counted, as the first line after opening.
                loss = None if agreed.key is None else Loss.UNREADABLE
            if loss is not None:
                self.counts[loss] += 1

    def _stream_of(self, count: int) -> Stream | None:
        """Find the stream of a line by its number of values: one of this width, else one of unknown width."""
        widths = {stream: self._width(stream) for stream in self._carries}
        for stream, width in widths.items():
            if width == count:
                return stream
        if count > 0:
            for stream, width in widths.items():
                if width is None:
                    return stream
        return None

    def _expected(self, lead: int) -> str:
        widths = (self._width(stream) for stream in self._carries)
        return " or ".join(str(width + lead) for width in widths if width is not None)


class LeadingColumns:
    """The columns before the values, once a header line named them."""

    def __init__(self) -> None:
        self.count = 0
        self._names: list[str] = []
        self._checked: list[str] = []
        """All names of the last header line."""
        self._seq: int | None = None
        self._last_us = math.nan
        self._wraps_us = 0

    def named_by(self, names: list[str], stream_of: Callable[[int], Stream | None]) -> bool:
        """Take the names of a header line; return False if it is none."""
        lead = 0
        while lead < len(names) and is_clock_or_counter(names[lead]):
            lead += 1
        if not lead or stream_of(len(names) - lead) is None:
            return False
        # Numbers are no names, unless they count the channels: `Frame 12` begins a frame.
        if names is not self._checked and not _may_be_names(names[lead:]):
            return False
        # The first line may have lost its begin: `us` may be the rest of `t_us`.
        if not SURE_COLUMNS.issuperset(names[:lead]) and stream_of(len(names)) is not None:
            return False
        self._names, self._checked = names[:lead], names
        self.count = lead
        return True

    def read(self, numbers: Iterable[float]) -> tuple[int, float, int]:
        """Return number, device's clock in seconds, and how many numbers are missing before this one."""
        return self.read_named(zip(self._names, numbers, strict=True))

    def read_named(self, pairs: Iterable[tuple[str, float]]) -> tuple[int, float, int]:
        """Read clocks and counters by their names; return the same as `read`."""
        seq, device_s, missing = NO_SEQ, math.nan, 0
        for name, number in pairs:
            if not math.isfinite(number) or abs(number) > MAX_PARSED_NUMBER:
                continue
            if name == SEQ_COLUMN:
                seq = int(number)
                missing = max(seq - self._seq - 1, 0) if self._seq is not None else 0
                self._seq = seq
            elif (unit := _clock_unit(name)) is not None:
                device_s = (self._unwrap_us(number) if unit == "us" else number) * TIME_UNITS[unit]
        return seq, device_s, missing

    def _unwrap_us(self, number: float) -> float:
        """Continue a 32-bit clock of microseconds over its wrap."""
        if number < self._last_us - CLOCK_MODULUS_US / 2:
            self._wraps_us += CLOCK_MODULUS_US
        self._last_us = number
        return number + self._wraps_us


def _parse(text: str) -> tuple[list[str], list[float] | None]:
    """Split a line into fields, and read them as numbers. Python reads 1_0 as ten; no device writes that."""
    fields = split_fields(text)
    return fields, None if "_" in text else to_numbers(fields)


def whole_numbers(line: bytes) -> FloatArray | None:
    """Read whole numbers without sign that commas separate, (n,) float; `None` for another line. The same as Python reads."""
    if not line:
        return None
    digits = np.frombuffer(line, np.uint8) - np.uint8(ord("0"))
    others = np.flatnonzero(digits > 9)
    if (digits[others] != np.uint8(ord(",") - ord("0") & 0xFF)).any():
        return None
    starts, last = np.append(0, others + 1), np.append(others, len(digits)) - 1
    lengths = last - starts + 1
    if not 0 < lengths.min() <= lengths.max() <= WHOLE_NUMBER_MAX_DIGITS:
        return None
    values = digits[last].astype(np.float64)
    for place in range(1, int(lengths.max())):
        rows = np.flatnonzero(lengths > place)
        values[rows] += digits[last[rows] - place] * 10.0**place
    return values


def _may_be_names(names: list[str]) -> bool:
    if all(to_numbers([name]) is None for name in names):
        return True
    return len(names) > 1 and any(names == [str(k) for k in range(first, first + len(names))] for first in (0, 1))


def _clock_unit(name: str) -> str | None:
    """Return the unit of a clock by its name; `None` for a counter, and for a clock of an unknown unit."""
    found = TIME_COLUMN_RE.fullmatch(name) or CLOCK_COLUMN_RE.fullmatch(name)
    return None if found is None else "s" if name in SECONDS_COLUMNS else short_unit(found[1])
