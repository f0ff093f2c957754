"""Lines of a `yarpdatadumper` log to readings: `<seq> <stamp> <bottle>` or `<seq> <tx> <rx> <bottle>`.

A bottle in text form has numbers, strings, and lists in parentheses; `skincal/devices/bottles.py` finds the readings in it.
Joint angles are degrees in YARP and become radians here. Sources: robotology/yarp `src/yarpdatadumper/main.cpp` and
`BottleImpl.cpp`; the text form of `measures:o` is derived from its serialiser, not observed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import accumulate
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.devices.bottles import Value, is_measures, plain_not_finite, values_of
from skincal.devices.decoding import SEQ_MAX, TIME_STAMP_MAX_S, FrameDecoder, FrameSplitter, MarkSplitter
from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.readings import Batch, Loss, Stream

LINE_MAX = 1 << 20
"""bytes. A longer line is no record: 4,200 channels of 20 digits take 84,000."""
HEADER_WORDS = (b"Type:", b"Source:", b"Stamp:")
"""Old dumpers wrote what is now `info.log` into the log itself."""

_TOKEN_RE = re.compile(
    r'[ \t\r\n,]+|(?P<begin>\()|(?P<end>\))|"(?P<text>(?:\\.|[^"\\])*)"|\[(?P<square>[^]]*)]|{(?P<curly>[^}]*)}'
    r"|(?P<word>[^ \t\r\n,()\"[{][^ \t\r\n,()]*)",
    re.DOTALL,
)
"""A token of a bottle: separator, end of a list, string, name in brackets, or another word."""
_NOT_A_TABLE = (b"\r", b"\x1c", b"\x1d", b"\x1e", b"\x1f", b"_")
"""Marks that no table has: the ASCII separators split words for numpy alone, and Python reads 1_0 as ten."""
_LINE_PREFIX_MAX_CHARS = 64
"""Letters: a line's number and stamps are shorter."""
_LINE_NUMBER_MAX_DIGITS = 18
"""Digits of a line's number: fewer than those of `SEQ_MAX`."""
_EXACT_INTEGER_MAX = 2.0**53
"""Every smaller whole number is a double."""
_NOT_PLAIN = (b"(", b")", b'"', b"[", b"{", b"_")
"""Marks that no payload of plain numbers has."""


class BottleError(ValueError):
    """Text is no bottle: a list or a string has no end."""


def parse_bottle(text: str) -> list[Value]:
    """Read a YARP bottle in text form; a number becomes a float, any other word a string.

    Raises BottleError: a parenthesis, bracket or quote has no partner.
    """
    open_lists: list[list[Value]] = [[]]
    at = 0
    while at < len(text):
        found = _TOKEN_RE.match(text, at)
        if found is None:
            raise BottleError("a bracket or a string has no end")
        at, kind = found.end(), found.lastgroup
        if kind == "begin":
            open_lists.append([])
        elif kind == "end":
            if len(open_lists) == 1:
                raise BottleError("a list ends that never began")
            inner = open_lists.pop()
            open_lists[-1].append(inner)
        elif kind is not None:
            open_lists[-1].append(_item(kind, found[kind]))
    if len(open_lists) > 1:
        raise BottleError("a list has no end")
    return open_lists[0]


def _item(kind: str, word: str) -> Value:
    if kind == "text":
        # A backslash keeps the next character.
        return re.sub(r"\\(.)", r"\1", word, flags=re.DOTALL)
    # Python reads 1_0 as ten; no log has that.
    if kind != "word" or "_" in word:
        return word
    try:
        return float(word)
    except ValueError:
        return word


@dataclass(frozen=True, slots=True)
class LogLine:
    """A log line, its payload unread."""

    seq: int
    stamps: tuple[float, ...]
    """seconds: one, or sender's and receiver's."""
    payload: bytes


def split_line(line: bytes, stamps: int) -> LogLine | None:
    """Split a log line into number, stamps and payload; `None` if it does not begin so."""
    words = line.split(None, 1 + stamps)
    if len(words) < 1 + stamps:
        return None
    try:
        seq = int(words[0])
        times = tuple(float(word) for word in words[1 : 1 + stamps])
    except ValueError:
        return None
    if not all(isfinite(time) and abs(time) <= TIME_STAMP_MAX_S for time in times) or abs(seq) > SEQ_MAX:
        return None
    return LogLine(seq, times, words[1 + stamps] if len(words) > 1 + stamps else b"")


def split_stamps(lines: Sequence[bytes], stamps: int) -> FloatArray | None:
    """Read the stamps (n, stamps), seconds, of n > 0 lines; `None` if `split_line` refuses one of them."""
    times = _even_stamps(lines, stamps)
    if times is not None:
        return times if (times <= TIME_STAMP_MAX_S).all() else None
    try:
        words = [line.split(None, 1 + stamps) for line in lines]
        numbers = [int(each[0]) for each in words]
        times = np.empty((len(words), stamps))
        for index in range(stamps):
            times[:, index] = [float(each[1 + index]) for each in words]
    except (ValueError, IndexError):
        return None
    return times if _in_range(min(numbers), max(numbers), times) else None


def _even_stamps(lines: Sequence[bytes], stamps: int) -> FloatArray | None:
    """Read the stamps at once if the digits of all lines are at the same places, as in nearly every log; else `None`."""
    words = lines[0][:_LINE_PREFIX_MAX_CHARS].split(b" ")[: 1 + stamps]
    ends = np.cumsum([len(word) + 1 for word in words])
    if len(words) <= stamps or not 1 < ends[0] <= _LINE_NUMBER_MAX_DIGITS + 1 or ends[-1] > _LINE_PREFIX_MAX_CHARS:
        return None
    heads = np.array(lines, f"S{ends[-1]}").view(np.uint8).reshape(len(lines), -1)
    # What is below "0" becomes large.
    digits = heads - ord("0")
    if (heads[:, ends - 1] != ord(" ")).any() or (digits[:, : len(words[0])] > 9).any():
        return None
    times = np.empty((len(lines), stamps))
    for index, word in enumerate(words[1:]):
        point = word.find(b".")
        if point >= 0 and (heads[:, ends[index] + point] != ord(".")).any():
            return None
        places = [ends[index] + at for at in range(len(word)) if at != point]
        found = digits[:, places]
        whole = found @ 10.0 ** np.arange(len(places) - 1, -1, -1)
        if not places or (found > 9).any() or not whole.max() < _EXACT_INTEGER_MAX:
            return None
        # Both are exact doubles, so their quotient is the double nearest to the decimal, which is what `float` gives.
        times[:, index] = whole / 10.0 ** (len(word) - 1 - point if point >= 0 else 0)
    return times


def _in_range(least: int, most: int, times: FloatArray) -> bool:
    # NaN and infinity are not within the limit.
    return bool((np.abs(times) <= TIME_STAMP_MAX_S).all()) and most <= SEQ_MAX and least >= -SEQ_MAX


def even_width(data: bytes) -> int:
    """Count the words of each line; 0 unless all lines have as many, with one space between two words and nothing else."""
    letters = np.frombuffer(data, np.uint8)
    at = np.flatnonzero(letters <= ord(" "))
    width = data.count(b" ", 0, data.find(b"\n")) + 1
    if not data.endswith(b"\n") or len(at) % width or at[0] == 0 or (np.diff(at) == 1).any():
        return 0
    marks = letters[at].reshape(-1, width)
    return width if (marks[:, :-1] == ord(" ")).all() and (marks[:, -1] == ord("\n")).all() else 0


def read_table(lines: bytes) -> NDArray[Any] | None:
    """Read whole lines of one width, an integer first, as records of `number` and `values`; `None` if a line has another form.

    numpy reads the same numbers as Python, many at a time.
    """
    # Some letters separate words for numpy alone, or for Python alone.
    if not lines.isascii() or any(mark in lines for mark in _NOT_A_TABLE):
        return None
    rows = lines.decode("ascii").split("\n")
    if rows.pop():
        return None
    width = len(rows[0].split())
    if width < 2:
        return None
    try:
        table = np.loadtxt(rows, [("number", np.int64), ("values", np.float64, (width - 1,))], comments=None, ndmin=1)
    except ValueError:
        return None
    # Blank lines were left out.
    return table if len(table) == len(rows) else None


def is_header(line: bytes) -> bool:
    """Check whether a line is blank or a header, which newer dumpers write into `info.log`."""
    return not line.strip() or line.lstrip().startswith(HEADER_WORDS)


class YarpDecoder(FrameDecoder):
    """Decodes log lines with one stamp, of one stream."""

    name = "YARP log"
    starts_whole = True
    single_stream = True
    mark = b"\n"
    limit = LINE_MAX
    stamps = 1
    """Number of stamps in a line."""
    made = 0
    """Index of the stamp of the reading: the sender's."""

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        if len(carries) != 1:
            raise InputError("An imported file carries one stream; expected one file each for wrench, skin and joints.")
        self._stream = carries[0]

    def _make_splitter(self) -> FrameSplitter:
        self._lines = MarkSplitter(self.mark, self.limit)
        return self._lines

    def feed(self, data: bytes) -> list[Batch]:
        """Decode the next bytes of the link; return the completed readings."""
        table = self._table([data])
        if table is None:
            return super().feed(data)
        self._count_missing(self._gaps.missing_among(table["number"]))
        return [self._batch_of_table(table)]

    def feed_many(self, chunks: Sequence[bytes]) -> tuple[Batch, list[int]] | None:
        """Decode chunks of whole lines of plain, finite numbers of one width, with no number missing. Else take nothing."""
        table, gaps = self._table(chunks), copy(self._gaps)
        if table is None or not np.isfinite(table["values"]).all() or gaps.missing_among(table["number"]):
            return None
        self._gaps = gaps
        return self._batch_of_table(table), list(accumulate(chunk.count(b"\n") for chunk in chunks))

    def _table(self, chunks: Sequence[bytes]) -> NDArray[Any] | None:
        """Read chunks of whole lines of plain numbers, all of one width; `None` if one has another form."""
        if (
            not chunks
            or self._lines.has_partial_frame
            or not all(0 < len(chunk) <= LINE_MAX and chunk.endswith(b"\n") for chunk in chunks)
        ):
            return None
        table = read_table(plain_not_finite(b"".join(chunks)))
        if table is None:
            return None
        numbers, values = table["number"], table["values"]
        width = values.shape[1] - self.stamps
        good = width > 0 and _in_range(numbers.min(), numbers.max(), values[:, : self.stamps])
        if not good or not self._has_width(self._stream, width):
            return None
        self._widths[self._stream] = width
        return table

    def _batch_of_table(self, table: NDArray[Any]) -> Batch:
        self.valid_records += len(table)
        numbers, values = table["number"].copy(), table["values"]
        return self._batch(self._stream, numbers, values[:, self.made].copy(), values[:, self.stamps :].copy())

    def _decode(self, frame: bytes) -> Loss | None:
        line = split_line(frame, self.stamps)
        if line is None:
            return None if is_header(frame) else Loss.UNREADABLE
        self._count_gap(line.seq)
        try:
            values = self._numbers(plain_not_finite(line.payload))
        except ValueError:
            return Loss.UNREADABLE
        if not values:
            return Loss.BAD_WIDTH
        self.valid_records += 1
        return self._add(self._stream, line.seq, line.stamps[self.made], values)

    def _numbers(self, payload: bytes) -> list[float]:
        if not any(mark in payload for mark in _NOT_PLAIN):
            # The usual line: ten times faster than the bottle's grammar.
            return [float(word) for word in payload.replace(b",", b" ").split()]
        bottle = parse_bottle(payload.decode("utf-8", "strict"))
        found = values_of(bottle, self._stream)
        if found is None and bottle and not is_measures(bottle):
            raise BottleError("a word stands among the numbers")
        return [] if found is None else found[0].tolist()


class YarpTxRxDecoder(YarpDecoder):
    """Decode log lines with the sender's and the receiver's stamp (`--txTime --rxTime`)."""

    name = "YARP log, two stamps"
    stamps = 2


class YarpRxDecoder(YarpTxRxDecoder):
    """Decode log lines with both stamps by the receiver's: the sender's is not always there."""

    name = "YARP log, by the receiver's stamp"
    made = 1


class CsvDecoder(YarpDecoder):
    """Decode rows of a CSV file, which `skincal.files.importers.csv_log` has made into lines of a log with one stamp."""

    name = "CSV"
