"""Lines of a `yarpdatadumper` log to readings: `<seq> <stamp> <bottle>` or `<seq> <tx> <rx> <bottle>`.

The payload is a YARP bottle in text form: numbers, strings, and lists in parentheses, which may be nested. Three shapes
are read: a plain vector, a vector wrapped in one list, and the structure of `/FT/measures:o`, whose sixth list holds the
six-axis sensors as `((fx fy fz mx my mz) stamp)`. Joint angles are degrees in YARP and become radians here.

Sources: robotology/yarp `src/yarpdatadumper/main.cpp` and `BottleImpl.cpp`; the text form of `measures:o` is derived
from its serialiser (12 lists, 10 in older versions), not observed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TypeAlias

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.readings import Batch, Loss, Stream
from skincal.streams.decoders.base import PieceDecoder

Item: TypeAlias = "float | str | list[Item]"
"""One value of a bottle."""

LINE_MAX = 1 << 20
"""bytes. A longer line is no record: 4,200 channels of 20 digits take 84,000."""
MEASURES_WRENCH = 5
"""Index of the six-axis force/torque sensors in the lists of `measures:o`."""
MEASURES_LISTS = 10
"""Fewest lists of `measures:o`: 10 in older versions of YARP, 12 now."""
STAMP_MAX = 5e9
"""s. Times of any clock are nearer to 0 (the year 2128); beyond, a digit is wrong."""
SEQ_MAX = 1 << 62
"""Largest counter that a batch can hold."""
HEADER_WORDS = (b"Type:", b"Source:", b"Stamp:")
"""Old dumpers wrote what is now `info.log` into the log itself."""

_TOKEN = re.compile(
    r'[ \t\r\n,]+|(?P<begin>\()|(?P<end>\))|"(?P<text>(?:\\.|[^"\\])*)"|\[(?P<square>[^]]*)]|{(?P<curly>[^}]*)}'
    r"|(?P<word>[^ \t\r\n,()\"[{][^ \t\r\n,()]*)",
    re.DOTALL,
)
"""Of a bottle: what parts words, the ends of a list, a string, a name in brackets, any other word."""
_INK = bytes(set(range(256)) - set(b" \t\n\r\x0b\x0c"))
"""Every byte but those that part words."""
_NOT_PLAIN = (b"(", b")", b'"', b"[", b"{", b"_")
"""What no payload of plain numbers has."""


class BottleError(ValueError):
    """Text is no bottle: a list or a string has no end."""


def parse_bottle(text: str) -> list[Item]:
    """Read a YARP bottle in text form; a number becomes a float, any other word a string.

    Raises BottleError: a parenthesis, bracket or quote has no partner.
    """
    open_lists: list[list[Item]] = [[]]
    at = 0
    while at < len(text):
        found = _TOKEN.match(text, at)
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


def _item(kind: str, word: str) -> Item:
    if kind == "text":
        # A backslash keeps the next character.
        return re.sub(r"\\(.)", r"\1", word, flags=re.DOTALL)
    # Python takes 1_0 for ten; nobody who writes numbers does.
    if kind != "word" or "_" in word:
        return word
    try:
        return float(word)
    except ValueError:
        return word


def find_vector(bottle: list[Item]) -> list[Item]:
    """Return the list of numbers that a bottle carries: the bottle itself, or the only list in it."""
    if len(bottle) == 1 and isinstance(bottle[0], list):
        return bottle[0]
    return bottle


def find_wrench(bottle: list[Item]) -> list[Item]:
    """Return the six numbers of the first force/torque sensor, from a vector or from `measures:o`; empty where it has none."""
    if len(bottle) < MEASURES_LISTS or not all(isinstance(item, list) for item in bottle):
        return find_vector(bottle)
    sensors = bottle[MEASURES_WRENCH]
    while isinstance(sensors, list) and sensors:
        if isinstance(sensors[0], float):
            return sensors
        sensors = sensors[0]
    return []


@dataclass(frozen=True, slots=True)
class LogLine:
    """A log line, its payload unread."""

    seq: int
    stamps: tuple[float, ...]
    """seconds: one, or sender's and receiver's."""
    payload: bytes


def split_line(line: bytes, stamps: int) -> LogLine | None:
    """Split a log line into number, stamps and payload; None where it does not begin with them."""
    words = line.split(None, 1 + stamps)
    if len(words) < 1 + stamps:
        return None
    try:
        seq = int(words[0])
        times = tuple(float(word) for word in words[1 : 1 + stamps])
    except ValueError:
        return None
    if not all(isfinite(time) and abs(time) <= STAMP_MAX for time in times) or abs(seq) > SEQ_MAX:
        return None
    return LogLine(seq, times, words[1 + stamps] if len(words) > 1 + stamps else b"")


def split_stamps(lines: Sequence[bytes], stamps: int) -> FloatArray | None:
    """Return the stamps (n, stamps), seconds, of n lines; None where `split_line` refuses one of them."""
    try:
        words = [line.split(None, 1 + stamps) for line in lines]
        numbers = [int(each[0]) for each in words]
        times = np.empty((len(words), stamps))
        for index in range(stamps):
            times[:, index] = [float(each[1 + index]) for each in words]
    except (ValueError, IndexError):
        return None
    return times if _in_range(numbers, times) else None


def _in_range(numbers: Sequence[int], times: FloatArray) -> bool:
    # What is not finite is not within the limit, either.
    return bool((np.abs(times) <= STAMP_MAX).all()) and max(numbers) <= SEQ_MAX and min(numbers) >= -SEQ_MAX


def even_words(data: bytes) -> tuple[list[bytes], int] | None:
    """Return the words of whole lines and how many each line has, where all have as many, one space between them; else None."""
    marks = data.translate(None, _INK)
    width = marks.find(b"\n") + 1
    if not data.endswith(b"\n") or marks != (b" " * (width - 1) + b"\n") * (len(marks) // width):
        return None
    words = data.split()
    # As many words as marks: one before each.
    return (words, width) if len(words) == len(marks) else None


def is_header(line: bytes) -> bool:
    """Return whether a line holds no record: it is blank, or says what now stands in `info.log`."""
    return not line.strip() or line.lstrip().startswith(HEADER_WORDS)


class Steps:
    """Counts the numbers missing in a sequence whose usual step is not 1 where the sender publishes on many ports."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._step = 0
        self._usual = 0

    def missing(self, seq: int) -> int:
        """Return how many numbers are missing before `seq`; the usual step is the last that came twice in a row."""
        step = 0 if self._last is None or seq < 0 else seq - self._last
        # A message without an envelope has the number -1, and nobody knows how many of them were lost.
        self._last = seq if seq >= 0 else None
        if step > 0 and step == self._step:
            self._usual = step
        self._step = step
        if self._usual and step > self._usual and step % self._usual == 0:
            return step // self._usual - 1
        return 0

    def all_missing(self, numbers: Sequence[int]) -> int:
        """Return how many numbers are missing before and among `numbers`."""
        step, last = self._usual, self._last
        if step and step == self._step and last is not None and list(numbers) == _counted(last + step, step, len(numbers)):
            self._last = numbers[-1]
            return 0
        return sum(self.missing(number) for number in numbers)


def _counted(first: int, step: int, count: int) -> list[int]:
    return list(range(first, first + step * count, step))


class YarpDecoder(PieceDecoder):
    """Decode log lines with one stamp, of one stream."""

    name = "YARP log"
    mark = b"\n"
    limit = LINE_MAX
    stamps = 1
    """How many times stand in a line."""
    made = 0
    """Which of them says when the reading was taken: the sender's."""

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        if len(carries) != 1:
            raise InputError("An imported file carries one stream; expected one file each for wrench, skin and joints.")
        self._first = False  # A log is read from its first line on: nothing of it is lost.
        self._stream = carries[0]
        self._steps = Steps()

    def feed(self, data: bytes) -> list[Batch]:
        """Take the next bytes of the link and return the readings that they complete."""
        batch = self._even_lines(data)
        return super().feed(data) if batch is None else [batch]

    def _even_lines(self, data: bytes) -> Batch | None:
        """Return the readings of whole lines, all of plain numbers and of one width, at once; None where one is otherwise."""
        if self._splitter.holds or len(data) > LINE_MAX or any(mark in data for mark in _NOT_PLAIN):
            return None
        found = even_words(data)
        if found is None:
            return None
        words, width = found
        try:
            numbers = [int(word) for word in words[::width]]
            table = np.fromiter(map(float, words), np.float64, len(words)).reshape(-1, width)
        except ValueError:
            return None
        times, values = table[:, 1 : 1 + self.stamps], table[:, 1 + self.stamps :]
        if not values.size or not _in_range(numbers, times) or not self._collector.fits(self._stream, values.shape[1]):
            return None
        missing = self._steps.all_missing(numbers)
        if missing:
            self.counts[Loss.MISSING] += missing
        self.good += len(numbers)
        return self._collector.batch(self._stream, np.array(numbers, np.int64), times[:, self.made].copy(), values.copy())

    def _decode(self, piece: bytes) -> Loss | None:
        line = split_line(piece, self.stamps)
        if line is None:
            return None if is_header(piece) else Loss.UNREADABLE
        missing = self._steps.missing(line.seq)
        if missing:
            self.counts[Loss.MISSING] += missing
        try:
            values = self._numbers(line.payload)
        except ValueError:
            return Loss.UNREADABLE
        if not values:
            return Loss.BAD_WIDTH
        self.good += 1
        return self._collector.add(self._stream, line.seq, line.stamps[self.made], values)

    def _numbers(self, payload: bytes) -> list[float]:
        if not any(mark in payload for mark in _NOT_PLAIN):
            # The usual line, ten times faster than the bottle's grammar.
            return [float(word) for word in payload.replace(b",", b" ").split()]
        bottle = parse_bottle(payload.decode("utf-8", "strict"))
        found = find_wrench(bottle) if self._stream is Stream.WRENCH else find_vector(bottle)
        numbers = [item for item in found if isinstance(item, float)]
        if len(numbers) != len(found):
            raise BottleError("a word stands among the numbers")
        return numbers


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
