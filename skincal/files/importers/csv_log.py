"""Recordings as CSV files, one each for wrench, skin and joints, as the chunks of a session.

With a header, columns are found by name, in any order and case:

    time     `t`, `time`, `stamp` or `timestamp`, with `_s`, `_ms`, `_us` or `_ns`; seconds where no unit is named, or
             nanoseconds where the first value is one of our days in nanoseconds since 1970; or `datetime`. Dates with a
             time of day (ISO 8601, `2024-05-01T12:00:00.123Z`, a space for the T) are read as what they are
    number   `seq`, `index`, `counter` or `frame`: optional
    wrench   `fx fy fz` (N) and `mx my mz` or `tx ty tz` (N m, or N mm with `_nmm`); also `force_x`, `torque_x`
    skin     every other column; `t0 t1 ...` in the order of their numbers
    joints   every other column, each with `_deg` or `_rad`

Before a name may stand where ROS or PlotJuggler has it from (`field.wrench.force.x`, `/ft/wrench/force/x`, `%time`); what is of
a message's header or layout, but its time and number, is left out.

Without a header, the first column is the time in seconds and the others follow in this order; joints are degrees. Fields
are separated by comma, semicolon (then a comma is a decimal point), tab or spaces.

Each row becomes the line `<number> <seconds> <values>` of a YARP log, joints in degrees: the plainest form of the same content
that a decoder reads. The session's journal holds these lines, not the rows.
"""

from __future__ import annotations

import contextlib
import csv
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import lru_cache, partial
from io import TextIOWrapper
from itertools import islice
from pathlib import Path

import numpy as np

from skincal.devices.decoding import TIME_STAMP_MAX_S
from skincal.files.importers.registry import RecordedPlace, StreamGuess
from skincal.files.importers.timeline import FINER_TIMES, OpenRecording, Timeline, check_overlap, late_streams
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.given import open_regular
from skincal.model.readings import Stream
from skincal.streams.links import LinkSpec

MAX_LINE_CHARS = 4 << 20
"""100,000 channels have a quarter of it."""
FIELD_SHOWN_MAX_CHARS = 40
"""Characters of a field that a sentence shows."""
ROWS_PARSED_AT_ONCE = 64
MAX_CACHED_FIELDS = 1 << 12
"""Raw values of a skin repeat, so their text is kept."""
MAX_ROW_INTERVAL_S = 0.2
"""A tool holds still for 0.3 s in a poke: rows further apart, if their time has no unit, are not seconds."""
COLUMN_SEPARATORS = {";": "semicolon", "\t": "tab", ",": "comma"}
"""The first of these in the first line separates the columns, else spaces do."""
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
WRENCH_AXES = ("fx", "fy", "fz", "mx", "my", "mz")
UNIX_NS = (1e18, 5e18)
"""Nanoseconds since 1970 of the years 2001 to 2128; as seconds they would be no time of any clock."""
_TIME_COLUMN_RE = re.compile(
    r"(?:t|[%_]*time|datetime|rosbagtimestamp|(?:.*[./])?(?:stamp|timestamp))(?:[ _]*[\[(]?(s|ms|us|ns)[\])]?)?"
)
_COUNTER_COLUMN_RE = re.compile(r"(?:(?:.*[./])?header[./])?seq|index|counter|frame")
_DATE_RE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:[.,]\d{1,12})?(Z|[+-]\d\d(?::?\d\d)?)?", re.IGNORECASE)
_HEADER_FIELD_RE = re.compile(r"(?:.*[./])?(?:header|layout)[./].*")
_WRENCH_AXIS_RE = re.compile(
    r"(?:.*[./])?(?:wrench_)?([fmt]|force|torque|moment)[._/ ]?([xyz])(?:[ _]*[\[(]?(n|nm|nmm|n\.m|n\*m|n\.mm)[\])]?)?"
)
_NUMBERED_COLUMN_RE = re.compile(r"(?:.*[./])?\D*(\d+)\]?")
_JOINT_COLUMN_RE = re.compile(r".*[ _]*[\[(]?(deg|rad)[\])]?")
_NEWTON_MILLIMETRES = ("nmm", "n.mm")


class _Table:
    """One CSV file and how its rows are read.

    Raises InputError: the file cannot be read, is no text, has no row, or lacks a column or a unit.
    """

    def __init__(self, stream: Stream, path: Path) -> None:
        self.stream, self.path = stream, path
        header = _commented_header(path)
        first = header or next(_rows(path, "\n"), [""])[0]
        if not first:
            raise InputError(f"{path}: the file is empty; expected rows of a time and values, with or without a header.")
        if "\ufffd" in first or not first.replace("\t", " ").isprintable():
            raise InputError(f"{path}: is no text; expected rows of a time and values, with or without a header.")
        self._separator = _separator_of(first)
        row = _fields(header, self._separator) if header else next(_rows(path, self._separator))
        self.named = any(_time_kind(field) == "" for field in row if field)
        """Whether it has a header."""
        self._skips_row = self.named and not header
        self.width = len(row)
        self._time, self._number = 0, None
        unit = None
        if self.named:
            names = [name.lower() for name in row]
            self._time, unit, self._number, others = _special_columns(names, path)
            self.values, factors = _VALUE_COLUMNS[stream](names, others, path)
            column = f"the time column {names[self._time]!r}"
        else:
            _check_width(stream, self.width, path)
            self.values, column = list(range(1, self.width)), "no header: the first column"
            factors = [1.0] * len(self.values)
        texts = {factor: lru_cache(MAX_CACHED_FIELDS)(partial(_scaled_text, factor)) for factor in factors}
        self._texts = [texts[factor] for factor in factors]
        first_row = next(self._rows(self._time + 1), list[str]())
        self.first_time = first_row[self._time] if self._time < len(first_row) else ""
        """Time field of the first row; empty if there is none."""
        self._seconds_of, self.finding = self._detect_time(unit, column)
        self.skipped = 0
        """Rows without a time in the last reading."""

    def _detect_time(self, unit: str | None, column: str) -> tuple[Callable[[str], float | None], str]:
        """Choose the parser of the times, to seconds, by the first of them; say what was assumed."""
        kind, number = _time_kind(self.first_time), _to_float(self.first_time)
        self.dated, self.unit_assumed = kind.startswith("date"), False
        if self.dated:
            finding = "" if kind == "date with a zone" else f"{column} holds dates without a zone and was read as UTC."
            return partial(_date_seconds, kind), finding
        no_unit = " names no unit and" if self.named else ""
        if unit is None and number is not None and UNIX_NS[0] <= number <= UNIX_NS[1]:
            return partial(_number_seconds, TIME_UNITS["ns"]), (
                f"{column}{no_unit} was read as nanoseconds since 1970, as its values are."
            )
        self.unit_assumed = unit is None
        no_unit, degrees = (
            (" names no unit and", "") if self.named else ("", ", joints degrees" * (self.stream is Stream.JOINTS))
        )
        finding = f"{column}{no_unit} was read as seconds{degrees}." if unit is None else ""
        return partial(_number_seconds, TIME_UNITS[unit or "s"]), finding

    @property
    def link(self) -> LinkSpec:
        return LinkSpec(self.stream.value, f"file:{self.path}", (self.stream,), "csv")

    def stamps(self) -> Iterator[FloatArray]:
        """Give the times of the rows in blocks; count the rows that have none."""
        # Nothing after the time is read.
        rows = self._rows(self._time + 1)
        while block := list(islice(rows, ROWS_PARSED_AT_ONCE)):
            stamps = [seconds for row in block if (seconds := self._seconds(row)) is not None]
            if len(stamps) < len(block):
                self.skipped += len(block) - len(stamps)
                self._check_kind(block)
            yield np.array(stamps)

    def _check_kind(self, rows: list[list[str]]) -> None:
        """Raise InputError: some of these rows have a time of another kind than the first row of the file."""
        first = self.first_time
        for row in rows:
            other = row[self._time] if self._time < len(row) else ""
            if _time_kind(other) not in ("", _time_kind(first)):
                raise InputError(
                    f"{self.path}: its times are {first[:FIELD_SHOWN_MAX_CHARS]!r} and {other[:FIELD_SHOWN_MAX_CHARS]!r}; "
                    "expected one kind in the whole column: numbers, dates with a zone, or dates without one. "
                    "Export them again."
                )

    def lines(self) -> Iterator[list[bytes]]:
        """Give the rows that have a time as log lines, in blocks."""
        rows = enumerate(self._rows())
        while block := list(islice(rows, ROWS_PARSED_AT_ONCE)):
            yield [self._line(*each, seconds) for each in block if (seconds := self._seconds(each[1])) is not None]

    def _rows(self, splits: int = -1) -> Iterator[list[str]]:
        return islice(_rows(self.path, self._separator, splits), int(self._skips_row), None)

    def _seconds(self, row: list[str]) -> float | None:
        seconds = self._seconds_of(row[self._time]) if self._time < len(row) else None
        return None if seconds is None or not abs(seconds) <= TIME_STAMP_MAX_S else seconds

    def _line(self, index: int, row: list[str], seconds: float) -> bytes:
        """Format a row as a log line. A row of another width keeps it, so that it is counted."""
        number = _to_float(row[self._number]) if self._number is not None and self._number < len(row) else None
        if len(row) == self.width:
            values = [text(row[at]) for text, at in zip(self._texts, self.values, strict=True)]
        else:
            values = [text(row[at]) if at < len(row) else "" for text, at in zip(self._texts, self.values, strict=True)]
            values += ["nan"] * (len(row) - self.width)
        line = f"{index if number is None or not math.isfinite(number) else int(number)} {seconds:.9f} {' '.join(values)}\n"
        return line.encode("ascii", "replace")


def open_recording(places: Mapping[Stream, RecordedPlace]) -> OpenRecording:
    """Read the CSV files of one recording through.

    Raises InputError: a file cannot be read, has no row, lacks a column or a unit, or the files are of different times.
    """
    tables = [_Table(stream, place.path) for stream, place in places.items()]
    findings: list[str] = []
    timelines: list[Timeline] = []
    for table in tables:
        name = table.stream.value
        timeline = Timeline(name, table.stamps())
        _check_times(table, timeline)
        timelines.append(timeline)
        findings += timeline.sentences()
        if table.finding:
            findings.append(f"{name}: {table.finding}")
        if table.skipped:
            findings.append(f"{name}: {plural(table.skipped, 'row')} without a time: left out.")
    check_overlap(timelines)
    findings += late_streams(timelines)
    return OpenRecording(
        tuple(table.link for table in tables), tuple(timelines), tuple(table.lines for table in tables), tuple(findings)
    )


def _check_times(table: _Table, timeline: Timeline) -> None:
    """Raise InputError: there are no times, they lack fractions of a second, or they are hardly seconds."""
    if not timeline.lines:
        seen = f"seen {table.first_time[:FIELD_SHOWN_MAX_CHARS]!r} as the time; " if table.first_time else ""
        raise InputError(
            f"{table.path}: no row with a time was found; {seen}expected a number or a date (2024-05-01T12:00:00.5Z), "
            "and values. Numbers that are not seconds need their unit in the column's name: t_ms, t_ns."
        )
    if timeline.is_coarse:
        raise InputError(
            f"{table.path}: most of its rows have the same time as the row before, such as "
            f"{table.first_time[:FIELD_SHOWN_MAX_CHARS]!r}. {FINER_TIMES}"
        )
    if table.unit_assumed and table.stream is not Stream.JOINTS and timeline.interval > MAX_ROW_INTERVAL_S:
        raise InputError(
            f"{table.path}: its rows lie {timeline.interval:.4g} s apart, since its time names no unit and was read as "
            f"seconds; expected no more than {MAX_ROW_INTERVAL_S:g} s: name the time's column t_ms, t_us or t_ns."
        )


def guess_streams(path: Path) -> list[StreamGuess]:
    """Guess the stream of a file from its columns.

    Raises InputError: it cannot be read, or no column is the time.
    """
    table = _Table(Stream.SKIN, path)
    found = Stream.SKIN if table.named else None
    for stream in (Stream.JOINTS, Stream.WRENCH) if table.named else ():
        with contextlib.suppress(InputError):
            table, found = _Table(stream, path), stream
    return [StreamGuess(RecordedPlace(path), found, len(table.values))]


def _separator_of(line: str) -> str | None:
    unquoted = re.sub(r'"[^"]*"', "", line)
    return next((mark for mark in COLUMN_SEPARATORS if mark in unquoted), None)


def _commented_header(path: Path) -> str:
    """Read a header in a comment, as `numpy.savetxt` writes it; empty if the first line is no comment."""
    with contextlib.suppress(OSError), TextIOWrapper(open_regular(path), encoding="utf-8-sig", errors="replace") as file:
        line = file.readline(MAX_LINE_CHARS).strip()
        text = line.lstrip("# ")
        names = _fields(text, _separator_of(text))
        if line.startswith("#") and len(names) > 1 and any(_TIME_COLUMN_RE.fullmatch(name.lower()) for name in names):
            return text
    return ""


def _fields(line: str, separator: str | None, splits: int = -1) -> list[str]:
    """Split a line into its fields. A separator within double quotes belongs to its field."""
    fields = line.split(separator, splits)
    if '"' in line and separator not in (None, "\n"):
        with contextlib.suppress(csv.Error):
            fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [field.strip(" \t\"'") for field in fields]


def _rows(path: Path, separator: str | None, splits: int = -1) -> Iterator[list[str]]:
    """Yield the fields of each row, in quotes or not. Empty lines and lines that begin with # are left out.

    With `splits` the rest of the line after that many fields stays together.
    """
    marks = [mark for mark in " \t\"'" if mark != separator and separator != "\n"]
    try:
        # Spreadsheets begin a file with a byte order mark.
        with TextIOWrapper(open_regular(path), encoding="utf-8-sig", errors="replace") as file:
            for text in iter(partial(file.readline, MAX_LINE_CHARS), ""):
                if len(text) == MAX_LINE_CHARS:
                    raise InputError(f"{path}: a line has {MAX_LINE_CHARS} letters or more; expected a row a reading.")
                # A tab at an end follows or precedes an empty field.
                line = text.strip(" \r\n") if separator == "\t" else text.strip()
                if line and not line.startswith("#"):
                    quoted = any(mark in line for mark in marks)
                    yield _fields(line, separator, splits) if quoted else line.split(separator, splits)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path.") from None


def _to_float(field: str) -> float | None:
    # `float` takes 1_000 for a number.
    if "_" in field:
        return None
    try:
        return float(field.replace(",", "."))
    except ValueError:
        return None


def _scaled_text(factor: float, field: str) -> str:
    """Format a number times `factor`. Text that is no number is passed on, so that the decoder counts it."""
    value = _to_float(field)
    return repr(value * factor) if value is not None else field.replace(" ", "?") or "nan"


def _number_seconds(unit_s: float, field: str) -> float | None:
    value = _to_float(field)
    return None if value is None else value * unit_s


def _date_seconds(kind: str, field: str) -> float | None:
    """Convert a date with a time of day to seconds since 1970; `None` if it is no date of this kind."""
    if _time_kind(field) != kind:
        return None
    try:
        moment = datetime.fromisoformat(field.upper())
        return moment.replace(tzinfo=moment.tzinfo or UTC).timestamp()
    except (ValueError, OverflowError):  # the 30th of February
        return None


def _time_kind(field: str) -> str:
    """Classify the time in a field; empty if it is no time."""
    date = _DATE_RE.fullmatch(field)
    if date is None:
        return "" if _to_float(field) is None else "number"
    return "date with a zone" if date.group(1) else "date without one"


def _check_width(stream: Stream, width: int, path: Path) -> None:
    if width < 2 or (stream is Stream.WRENCH and width != 7):
        expected = "time fx fy fz mx my mz" if stream is Stream.WRENCH else "the time and at least one value"
        raise InputError(f"{path}: has {plural(width, 'column')} and no header; expected {expected}.")


def _special_columns(names: Sequence[str], path: Path) -> tuple[int, str | None, int | None, list[int]]:
    """Find the time's column and unit, the counter's column, and the columns of values."""
    times = ((index, found[1]) for index, name in enumerate(names) if (found := _TIME_COLUMN_RE.fullmatch(name)))
    time, unit = next(times, (-1, None))
    if time < 0:
        seen = ", ".join(names[:8])
        raise InputError(f"{path}: no column is the time; seen {seen}; expected one named t_s, t_ms, t_us or t_ns.")
    number = next((index for index, name in enumerate(names) if _COUNTER_COLUMN_RE.fullmatch(name)), None)
    others = [k for k, name in enumerate(names) if name and k not in (time, number) and not _HEADER_FIELD_RE.fullmatch(name)]
    return time, unit, number, others


def _wrench_columns(names: Sequence[str], others: list[int], path: Path) -> tuple[list[int], list[float]]:
    at: dict[str, int] = {}
    factor: dict[str, float] = {}
    for index in others:
        found = _WRENCH_AXIS_RE.fullmatch(names[index])
        if found is not None:
            axis = ("f" if found.group(1).startswith("f") else "m") + found.group(2)
            if axis in at:
                raise InputError(
                    f"{path}: columns {names[at[axis]]!r} and {names[index]!r} both are {axis}; expected one sensor's: "
                    "leave out those of the other."
                )
            at[axis] = index
            factor[axis] = 1e-3 if found.group(3) in _NEWTON_MILLIMETRES else 1.0
    missing = [axis for axis in WRENCH_AXES if axis not in at]
    if missing:
        raise InputError(
            f"{path}: columns {', '.join(missing)} are missing; seen {', '.join(names[:8])}; expected fx fy fz mx my mz, in N "
            "and N m: name them so."
        )
    return [at[axis] for axis in WRENCH_AXES], [factor[axis] for axis in WRENCH_AXES]


def _skin_columns(names: Sequence[str], others: list[int], path: Path) -> tuple[list[int], list[float]]:
    if not others:
        raise InputError(f"{path}: no column besides the time; expected one a channel, such as t0, t1, ...")
    numbers = {index: int(found[1]) for index in others if (found := _NUMBERED_COLUMN_RE.fullmatch(names[index]))}
    if len(set(numbers.values())) == len(others):
        others = sorted(others, key=numbers.__getitem__)
    return others, [1.0] * len(others)


def _joint_columns(names: Sequence[str], others: list[int], path: Path) -> tuple[list[int], list[float]]:
    factors: list[float] = []
    for index in others:
        found = _JOINT_COLUMN_RE.fullmatch(names[index])
        if found is None:
            raise InputError(f"{path}: column {names[index]!r} names no unit; expected names such as j0_deg or j0_rad.")
        factors.append(1.0 if found.group(1) == "deg" else math.degrees(1.0))
    if not others:
        raise InputError(f"{path}: no column besides the time; expected one a joint, such as j0_deg, j1_deg, ...")
    return others, factors


_VALUE_COLUMNS = {Stream.WRENCH: _wrench_columns, Stream.SKIN: _skin_columns, Stream.JOINTS: _joint_columns}
