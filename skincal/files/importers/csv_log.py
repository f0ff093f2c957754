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
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from io import TextIOWrapper
from itertools import islice
from pathlib import Path

import numpy as np

from skincal.devices.decoding import STAMP_MAX_S
from skincal.files.importers.recorded_lines import OpenRecording, RecordedLines, RecordedTimes, check_overlap
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.given import open_regular
from skincal.model.readings import Chunk, Stream
from skincal.streams.links import LinkSpec

MAX_LINE_CHARS = 4 << 20
"""Letters of a row: 100,000 channels have a quarter."""
SHOWN_CHARS = 40
"""Letters of a field that a sentence shows."""
BLOCK_ROWS = 64
"""Rows that are read at a time."""
TEXTS_MAX = 1 << 12
MAX_ROW_INTERVAL_S = 0.2
"""s from row to row. A tool holds still for 0.3 s in a poke: rows further apart, of a time without a unit, are not seconds."""
COLUMN_SEPARATORS = {";": "semicolon", "\t": "tab", ",": "comma"}
"""What may part the columns, by its name: the first of these that is in the first line."""
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
WRENCH_AXES = ("fx", "fy", "fz", "mx", "my", "mz")
UNIX_NS = (1e18, 5e18)
"""Nanoseconds since 1970 of the years 2001 to 2128; as seconds they would be no time of any clock."""
_TIME_COLUMN_RE = re.compile(
    r"(?:t|[%_]*time|datetime|rosbagtimestamp|(?:.*[./])?(?:stamp|timestamp))(?:[ _]*[\[(]?(s|ms|us|ns)[\])]?)?"
)
_COUNTER_COLUMN_RE = re.compile(r"(?:(?:.*[./])?header[./])?seq|index|counter|frame")
_DATE_RE = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d{1,12}))?(Z|[+-]\d\d(?::?\d\d)?)?", re.IGNORECASE)
# What ROS sends with values.
_HEADER_FIELD_RE = re.compile(r"(?:.*[./])?(?:header|layout)[./].*")
_WRENCH_AXIS_RE = re.compile(
    r"(?:.*[./])?(?:wrench_)?([fmt]|force|torque|moment)[._/ ]?([xyz])(?:[ _]*[\[(]?(n|nm|nmm|n\.m|n\*m|n\.mm)[\])]?)?"
)
_NUMBERED_COLUMN_RE = re.compile(r"(?:.*[./])?\D*(\d+)\]?")
_QUOTED_FIELD_RE = re.compile(r'"[^"]*"')
_JOINT_COLUMN_RE = re.compile(r".*[ _]*[\[(]?(deg|rad)[\])]?")
_NEWTON_MILLIMETRES = ("nmm", "n.mm")


@dataclass(frozen=True, slots=True)
class _Columns:
    """Columns of a table: fields of time and values, and their conversion to seconds and log values."""

    # Fields of a row.
    width: int
    time: int
    to_s: float
    number: int | None
    values: tuple[int, ...]
    factors: tuple[float, ...]
    finding: str = ""
    dates: bool = False
    """The times are dates, all with a zone or all without."""


class _Dates(dict[tuple[str, str, str], float | None]):
    """Seconds since 1970 of dates with a time of day, all with a zone or all without; the newest whole seconds are kept."""

    def __init__(self, *, zoned: bool) -> None:
        self._zoned = zoned

    def seconds(self, field: str) -> float | None:
        """Return the time of a field; None where it is no such date."""
        found = _DATE_RE.fullmatch(field)
        if found is None:
            return None
        day, clock, fraction, zone = found.groups(default="")
        whole = self[day, clock, zone] if bool(zone) == self._zoned else None
        return whole if whole is None or not fraction else whole + int(fraction) / 10 ** len(fraction)

    def __missing__(self, key: tuple[str, str, str]) -> float | None:
        day, clock, zone = key
        if len(self) >= TEXTS_MAX:
            self.clear()
        try:
            self[key] = datetime.fromisoformat(f"{day}T{clock}{zone.upper() or 'Z'}").astimezone(UTC).timestamp()
        except (ValueError, OverflowError):  # the 30th of February
            self[key] = None
        return self[key]


class _Texts(dict[str, str]):
    """Text of a field times `factor`, with a cache: raw values of a skin repeat."""

    def __init__(self, factor: float) -> None:
        self._factor = factor

    def __missing__(self, field: str) -> str:
        value = _to_float(field)
        # Text that is no number is passed on, so that the decoder counts it.
        text = repr(value * self._factor) if value is not None else field.replace(" ", "?") or "nan"
        if len(self) >= TEXTS_MAX:
            self.clear()
        self[field] = text
        return text


class _Table:
    """One CSV file and how its rows are read.

    Raises InputError: the file cannot be read, is no text, has no row, or lacks a column or a unit.
    """

    def __init__(self, stream: Stream, path: Path) -> None:
        first = next(_rows(path, "\n"), None)
        header = _commented_header(path)
        if header and first is not None:
            first = [header]
        if first is None:
            raise InputError(f"{path}: the file is empty; expected rows of a time and values, with or without a header.")
        if "\ufffd" in first[0] or not first[0].replace("\t", " ").isprintable():
            raise InputError(f"{path}: is no text; expected rows of a time and values, with or without a header.")
        self.stream, self.path = stream, path
        unquoted = _QUOTED_FIELD_RE.sub("", first[0])
        self._separator = next((mark for mark in COLUMN_SEPARATORS if mark in unquoted), None)
        row = _fields(header, self._separator) if header else next(_rows(path, self._separator))
        self._skips_header = not header
        self.named = any(_to_float(field) is None and _DATE_RE.fullmatch(field) is None for field in row if field)
        """It has a header."""
        if self.named:
            self.columns = _named_columns(stream, [name.lower() for name in row], path)
        else:
            self.columns = _columns_by_place(stream, len(row), path)
        self._time_of: Callable[[str], float | None] = _to_float
        if (date := _DATE_RE.fullmatch(self.first_time)) is not None:
            self._take_dates(row, zoned=date.group(4) is not None)
        elif self.columns.finding:
            self._find_nanoseconds(row)
        known = {factor: _Texts(factor) for factor in self.columns.factors}
        self._texts = [known[factor] for factor in self.columns.factors]
        self.skipped = 0
        """Rows of the last reading that have no time and so no place."""

    def _take_dates(self, names: list[str], *, zoned: bool) -> None:
        time = self.columns.time
        column = f"the time column {names[time].lower()!r}" if self.named else "no header: the first column"
        finding = "" if zoned else f"{column} holds dates without a zone and was read as UTC."
        self.columns = replace(self.columns, to_s=1.0, finding=finding, dates=True)
        self._time_of = _Dates(zoned=zoned).seconds

    def _find_nanoseconds(self, names: list[str]) -> None:
        """Where the time names no unit: take nanoseconds for what they are."""
        time, first = self.columns.time, self.first_time
        stamp = _to_float(first)
        if stamp is not None and UNIX_NS[0] <= stamp <= UNIX_NS[1]:
            column = (
                f"the time column {names[time].lower()!r} names no unit and" if self.named else "no header: the first column"
            )
            finding = f"{column} was read as nanoseconds since 1970, as its values are."
            self.columns = replace(self.columns, to_s=TIME_UNITS["ns"], finding=finding)

    @property
    def first_time(self) -> str:
        """What stands for a time in the first row; empty where there is no row, or no such field."""
        time = self.columns.time
        row = next(self._rows(time + 1), None)
        return row[time] if row is not None and time < len(row) else ""

    @property
    def link(self) -> LinkSpec:
        return LinkSpec(self.stream.value, f"file:{self.path}", (self.stream,), "csv")

    def stamps(self) -> Iterator[FloatArray]:
        """Give the times of the rows; count the rows that have none."""
        self.skipped = 0
        # Of a row nothing is read behind its time.
        rows = self._rows(self.columns.time + 1)
        while block := list(islice(rows, BLOCK_ROWS)):
            stamps = [seconds for row in block if (seconds := self._seconds(row)) is not None]
            if len(stamps) < len(block):
                self.skipped += len(block) - len(stamps)
                self._check_kind(block)
            if stamps:
                yield np.array(stamps)

    def _check_kind(self, rows: list[list[str]]) -> None:
        """Raise InputError: some of these rows have a time, but of another kind than the first row of the file."""
        first = self.first_time
        for row in rows:
            other = row[self.columns.time] if self.columns.time < len(row) else ""
            if _time_kind(other) not in ("", _time_kind(first)):
                raise InputError(
                    f"{self.path}: its times are {first[:SHOWN_CHARS]!r} and {other[:SHOWN_CHARS]!r}; expected one kind in the "
                    "whole column: numbers, dates with a zone, or dates without one. Export them anew."
                )

    def lines(self) -> Iterator[RecordedLines]:
        """Give the rows that have a time."""
        rows = enumerate(self._rows())
        while block := list(islice(rows, BLOCK_ROWS)):
            lines = [(seconds, self._line(*each, seconds)) for each in block if (seconds := self._seconds(each[1])) is not None]
            if lines:
                stamps, data = zip(*lines, strict=True)
                yield RecordedLines(np.array(stamps), data)

    def _rows(self, splits: int = -1) -> Iterator[list[str]]:
        rows = _rows(self.path, self._separator, splits)
        if self.named and self._skips_header:
            next(rows, None)
        return rows

    def _seconds(self, row: list[str]) -> float | None:
        columns = self.columns
        stamp = self._time_of(row[columns.time]) if columns.time < len(row) else None
        return None if stamp is None or not abs(stamp * columns.to_s) <= STAMP_MAX_S else stamp * columns.to_s

    def _line(self, index: int, row: list[str], seconds: float) -> bytes:
        """Return a row as a log line. A row of another width keeps it, so that it is counted."""
        columns = self.columns
        number = _to_float(row[columns.number]) if columns.number is not None and columns.number < len(row) else None
        if len(row) == columns.width:
            values = [texts[row[at]] for texts, at in zip(self._texts, columns.values, strict=True)]
        else:
            values = [texts[row[at]] if at < len(row) else "" for texts, at in zip(self._texts, columns.values, strict=True)]
            values += ["nan"] * (len(row) - columns.width)
        line = f"{index if number is None or not math.isfinite(number) else int(number)} {seconds:.9f} {' '.join(values)}\n"
        return line.encode("ascii", "replace")


def read_csv(
    wrench: Path, skin: Path, joints: Path | None = None
) -> tuple[tuple[LinkSpec, ...], Iterator[Chunk], tuple[str, ...]]:
    """Read the CSV files of one recording: links, chunks of whole lines merged by time, and sentences on what was found.

    Raises InputError: as for `open_csv`.
    """
    opened = open_csv(wrench, skin, joints)
    return opened.links, opened.chunks(), opened.findings


def open_csv(wrench: Path, skin: Path, joints: Path | None = None) -> OpenRecording:
    """Read the CSV files of one recording through.

    Raises InputError: a file cannot be read, has no row, lacks a column or a unit, or the files are of different times.
    """
    places = {Stream.WRENCH: wrench, Stream.SKIN: skin} | ({} if joints is None else {Stream.JOINTS: joints})
    tables = [_Table(stream, path) for stream, path in places.items()]
    findings: list[str] = []
    timelines: list[RecordedTimes] = []
    for table in tables:
        name = table.stream.value
        timeline = RecordedTimes(name, table.stamps())
        if not timeline.lines:
            seen = f"seen {table.first_time[:SHOWN_CHARS]!r} as the time; " if table.first_time else ""
            raise InputError(
                f"{table.path}: no row with a time was found; {seen}expected a number or a date (2024-05-01T12:00:00.5Z), "
                "and values. Numbers that are not seconds need their unit in the column's name: t_ms, t_ns."
            )
        _check_unit(table, timeline)
        _check_dates(table, timeline)
        timelines.append(timeline)
        findings += timeline.sentences()
        if table.columns.finding:
            findings.append(f"{name}: {table.columns.finding}")
        if table.skipped:
            findings.append(f"{name}: {plural(table.skipped, 'row')} without a time: left out.")
    check_overlap(timelines)
    links, sources = (table.link for table in tables), (table.lines for table in tables)
    return OpenRecording(tuple(links), tuple(timelines), tuple(sources), tuple(findings))


def _check_dates(table: _Table, timeline: RecordedTimes) -> None:
    """Raise InputError: the times are dates without fractions of a second."""
    if table.columns.dates and timeline.lines > 1 and not timeline.interval:
        raise InputError(
            f"{table.path}: most of its rows have the same time as the row before, such as {table.first_time[:SHOWN_CHARS]!r}. "
            "Export times with fractions of a second."
        )


def _check_unit(table: _Table, timeline: RecordedTimes) -> None:
    """Raise InputError: the time names no unit, and readings would come too slowly if it were seconds."""
    columns = table.columns
    if (
        columns.finding
        and not columns.dates
        and columns.to_s == TIME_UNITS["s"]
        and table.stream is not Stream.JOINTS
        and timeline.interval > MAX_ROW_INTERVAL_S
    ):
        raise InputError(
            f"{table.path}: its rows lie {timeline.interval:.4g} s apart, since its time names no unit and was read as "
            f"seconds; expected no more than {MAX_ROW_INTERVAL_S:g} s: name the time's column t_ms, t_us or t_ns."
        )


def guess_csv(path: Path) -> tuple[Stream | None, int]:
    """Guess a file's stream from its columns, `None` if they do not tell, and count the values of a row.

    Raises InputError: it cannot be read, or no column is the time.
    """
    table = _Table(Stream.SKIN, path)
    for stream in (Stream.WRENCH, Stream.JOINTS):
        with contextlib.suppress(InputError):
            found = _Table(stream, path)
            if found.named:
                return stream, len(found.columns.values)
    return Stream.SKIN if table.named else None, len(table.columns.values)


def _commented_header(path: Path) -> str:
    """Read a header that stands in a comment, as `numpy.savetxt` writes it; empty if the first line is none."""
    with contextlib.suppress(OSError), TextIOWrapper(open_regular(path), encoding="utf-8-sig", errors="replace") as file:
        line = file.readline(MAX_LINE_CHARS).strip()
        text = line.lstrip("# ")
        names = _fields(text, next((mark for mark in COLUMN_SEPARATORS if mark in text), None))
        if line.startswith("#") and len(names) > 1 and any(_TIME_COLUMN_RE.fullmatch(name.lower()) for name in names):
            return text
    return ""


def _fields(line: str, separator: str | None, splits: int = -1) -> list[str]:
    """Split a line into its fields. A separator within double quotes belongs to its field."""
    if '"' in line and separator is not None:
        quoted = _QUOTED_FIELD_RE.findall(line)
        fields = _QUOTED_FIELD_RE.sub("\0", line).split(separator, splits)
        found = iter(quoted)
        fields = [re.sub("\0", lambda _: next(found), field) for field in fields]
    else:
        fields = line.split(separator, splits)
    return [field.strip(" \t\"'") for field in fields]


def _rows(path: Path, separator: str | None, splits: int = -1) -> Iterator[list[str]]:
    """Yield the fields of each row, in quotes or not. Empty lines and lines that begin with # are left out.

    With `splits` the rest of the line after so many fields stays together.
    """
    marks = [mark for mark in " \t\"'" if mark != separator and separator != "\n"]
    try:
        # Spreadsheets begin a file with a byte order mark.
        with TextIOWrapper(open_regular(path), encoding="utf-8-sig", errors="replace") as file:
            for text in iter(partial(file.readline, MAX_LINE_CHARS), ""):
                if len(text) == MAX_LINE_CHARS:
                    raise InputError(f"{path}: a line has {MAX_LINE_CHARS} letters or more; expected a row a reading.")
                # A tab at an end stands beside an empty field.
                line = text.strip(" \r\n") if separator == "\t" else text.strip()
                if line and not line.startswith("#"):
                    yield (
                        _fields(line, separator, splits)
                        if any(mark in line for mark in marks)
                        else line.split(separator, splits)
                    )
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


def _time_kind(field: str) -> str:
    """Classify the time in a field; empty if it is no time."""
    date = _DATE_RE.fullmatch(field)
    if date is None:
        return "" if _to_float(field) is None else "number"
    return "date with a zone" if date.group(4) else "date without one"


def _columns_by_place(stream: Stream, width: int, path: Path) -> _Columns:
    if width < 2 or (stream is Stream.WRENCH and width != 7):
        expected = "time fx fy fz mx my mz" if stream is Stream.WRENCH else "the time and at least one value"
        raise InputError(f"{path}: has {plural(width, 'column')} and no header; expected {expected}.")
    values = tuple(range(1, width))
    degrees = ", joints degrees" if stream is Stream.JOINTS else ""
    return _Columns(
        width, 0, 1.0, None, values, (1.0,) * len(values), f"no header: the first column was read as seconds{degrees}."
    )


def _named_columns(stream: Stream, names: list[str], path: Path) -> _Columns:
    time = next((index for index, name in enumerate(names) if _TIME_COLUMN_RE.fullmatch(name)), None)
    if time is None:
        seen = ", ".join(names[:8])
        raise InputError(f"{path}: no column is the time; seen {seen}; expected one named t_s, t_ms, t_us or t_ns.")
    found = _TIME_COLUMN_RE.fullmatch(names[time])
    unit = found.group(1) if found else None
    number = next((index for index, name in enumerate(names) if _COUNTER_COLUMN_RE.fullmatch(name)), None)
    others = [k for k, name in enumerate(names) if name and k not in (time, number) and not _HEADER_FIELD_RE.fullmatch(name)]
    values, factors = _VALUE_COLUMNS[stream](names, others, path)
    finding = "" if unit else f"the time column {names[time]!r} names no unit and was read as seconds."
    return _Columns(len(names), time, TIME_UNITS[unit or "s"], number, values, factors, finding)


def _wrench_columns(names: list[str], others: list[int], path: Path) -> tuple[tuple[int, ...], tuple[float, ...]]:
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
    lacking = [axis for axis in WRENCH_AXES if axis not in at]
    if lacking:
        raise InputError(
            f"{path}: columns {', '.join(lacking)} are missing; seen {', '.join(names[:8])}; expected fx fy fz mx my mz, in N "
            "and N m: name them so."
        )
    return tuple(at[axis] for axis in WRENCH_AXES), tuple(factor[axis] for axis in WRENCH_AXES)


def _skin_columns(names: list[str], others: list[int], path: Path) -> tuple[tuple[int, ...], tuple[float, ...]]:
    if not others:
        raise InputError(f"{path}: no column besides the time; expected one a channel, such as t0, t1, ...")
    numbers = {
        index: int(found.group(1)) for index in others if (found := _NUMBERED_COLUMN_RE.fullmatch(names[index])) is not None
    }
    if len(set(numbers.values())) == len(others):
        others = sorted(others, key=numbers.__getitem__)
    return tuple(others), (1.0,) * len(others)


def _joint_columns(names: list[str], others: list[int], path: Path) -> tuple[tuple[int, ...], tuple[float, ...]]:
    factors: list[float] = []
    for index in others:
        found = _JOINT_COLUMN_RE.fullmatch(names[index])
        if found is None:
            raise InputError(f"{path}: column {names[index]!r} names no unit; expected names such as j0_deg or j0_rad.")
        factors.append(1.0 if found.group(1) == "deg" else math.degrees(1.0))
    if not others:
        raise InputError(f"{path}: no column besides the time; expected one a joint, such as j0_deg, j1_deg, ...")
    return tuple(others), tuple(factors)


_VALUE_COLUMNS = {Stream.WRENCH: _wrench_columns, Stream.SKIN: _skin_columns, Stream.JOINTS: _joint_columns}
