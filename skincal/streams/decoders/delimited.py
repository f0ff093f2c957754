"""Delimited lines as makers' sketches send them, without a checksum: lenient, and so the last choice.

One frame a line, or one row a line and a blank line after each frame. Fields are separated by comma, semicolon (then a
comma is a decimal point), tab or spaces. A line's number of values determines its stream: six of a wrench where the link
carries wrenches, the width of the skin where it carries skin, anything constant for joints (degrees). Words, such as a
banner at boot, are passed over. A header line that names leading columns (`seq`, `t`, `time`, `t_s`, `t_ms`, `t_us`;
seconds unless the name says otherwise) makes them the number and the device's clock.

Limits: a line that lost a digit, or two lines joined into one with the right count, are not noticed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import ClassVar

from skincal.devices.decoding import CLOCK_MODULUS_US, NO_SEQ, FrameDecoder
from skincal.model.readings import Loss, Stream

LINE_MAX_BYTES = 65536
"""Bytes. Some 4,200 values of 12 characters fit."""
COLUMN_UNITS_S = {"t": 1.0, "time": 1.0, "t_s": 1.0, "t_ms": 1e-3, "t_us": 1e-6}
SEQ_COLUMN = "seq"
MAX_PARSED_NUMBER = 1e18
"""Largest number or clock that is taken for one: what a batch's integers hold."""


class TextDecoder(FrameDecoder):
    """Decodes delimited lines."""

    name: ClassVar[str] = "text"
    mark: ClassVar[bytes] = b"\n"
    limit: ClassVar[int] = LINE_MAX_BYTES

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._carries = carries
        self._columns = LeadingColumns()
        # Of a skin frame whose rows are lines of their own, until the blank line that ends it.
        self._rows: list[list[float]] = []

    def _decode(self, frame: bytes) -> Loss | None:
        line = frame.strip()
        if not line:
            return None if self._first else self._end_frame()
        if not line.isascii() or not line.decode().replace("\t", " ").isprintable():
            return Loss.UNREADABLE
        fields = split_fields(line.decode())
        # Python reads 1_0 as ten; no device writes that.
        numbers = None if b"_" in line else to_numbers(fields)
        if numbers is None:
            return self._words(fields)
        # Without a checksum nothing shows whether the first line after opening lost its front digits.
        return None if self._first else self._numbers(numbers)

    def _words(self, fields: list[str]) -> Loss | None:
        """Read a header line or pass over a banner; a line that is mostly numbers is a damaged reading."""
        names = [field.strip("\"' ").lower() for field in fields]
        if self._columns.named_by(names, self._stream_of):
            return None
        readable = sum(to_numbers([field]) is not None for field in fields)
        return Loss.UNREADABLE if 2 * readable >= len(fields) else None

    def _numbers(self, numbers: list[float]) -> Loss | None:
        lead = self._columns.count
        stream = self._stream_of(len(numbers) - lead)
        if stream is None:
            if not lead and self._is_row(numbers):
                self._rows.append(numbers)
                return None
            self._problem = f"Lines of {len(numbers)} values arrive where {self._expected(lead)} are expected"
            return Loss.BAD_WIDTH
        if self._rows:
            self.counts[Loss.BAD_WIDTH] += len(self._rows)
            self._rows = []
        seq, device_s, missing = self._columns.read(numbers[:lead])
        self._count_missing(missing)
        return self._add(stream, seq, device_s, numbers[lead:])

    def _is_row(self, numbers: list[float]) -> bool:
        """Check whether a line may be a row of the unfinished frame."""
        width = self._width(Stream.SKIN)
        return width is not None and sum(map(len, self._rows)) + len(numbers) <= width

    def _end_frame(self) -> Loss | None:
        rows, self._rows = self._rows, []
        return self._add(Stream.SKIN, NO_SEQ, math.nan, [each for row in rows for each in row]) if rows else None

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
        self._seq: int | None = None
        self._last_us = math.nan
        self._wraps_us = 0

    def named_by(self, names: list[str], stream_of: Callable[[int], Stream | None]) -> bool:
        """Take the names of a header line; return False if it is none."""
        lead = 0
        while lead < len(names) and (names[lead] == SEQ_COLUMN or names[lead] in COLUMN_UNITS_S):
            lead += 1
        if not lead or stream_of(len(names) - lead) is None:
            return False
        self._names = names[:lead]
        self.count = lead
        return True

    def read(self, numbers: Sequence[float]) -> tuple[int, float, int]:
        """Return number, device's clock in seconds, and how many numbers are missing before this one."""
        seq, device_s, missing = NO_SEQ, math.nan, 0
        for name, number in zip(self._names, numbers, strict=True):
            if not math.isfinite(number) or abs(number) > MAX_PARSED_NUMBER:
                continue
            if name == SEQ_COLUMN:
                seq = int(number)
                missing = max(seq - self._seq - 1, 0) if self._seq is not None else 0
                self._seq = seq
            else:
                device_s = (self._unwrap_us(number) if name == "t_us" else number) * COLUMN_UNITS_S[name]
        return seq, device_s, missing

    def _unwrap_us(self, number: float) -> float:
        """Continue a 32-bit clock of microseconds over its wrap."""
        if number < self._last_us - CLOCK_MODULUS_US / 2:
            self._wraps_us += CLOCK_MODULUS_US
        self._last_us = number
        return number + self._wraps_us


def split_fields(line: str) -> list[str]:
    """Split a stripped line at its separator; one separator at the end is allowed."""
    if ";" in line:
        return line.replace(",", ".").removesuffix(";").split(";")
    if "," in line:
        return line.removesuffix(",").split(",")
    return line.split()


def to_numbers(fields: list[str]) -> list[float] | None:
    """Read all fields as numbers, `nan` and `inf` included; `None` if one is no number."""
    try:
        return [float(field) for field in fields]
    except ValueError:
        return None
