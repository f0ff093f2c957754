"""Recordings as CSV files as the chunks of a session: one each for wrench, skin and joints, or one table with all of them.

With a header, columns are found by name, in any order and case:

    time     `t`, `time`, `stamp` or `timestamp`, with `_s`, `_ms`, `_us` or `_ns`, or `millis`, `ms`, `micros`, `us`; seconds
             where no unit is named, or nanoseconds where the first value is one of our days in nanoseconds since 1970; or
             `datetime`. Dates with a time of day (ISO 8601, `2024-05-01T12:00:00.123Z`, a space for the T,
             `01.05.2024 12:00:00.5`) are read as what they are, also in two columns; `sec` and `nanosec` are one time
    number   `seq`, `index`, `counter` or `frame`: optional
    wrench   `fx fy fz` (N) and `mx my mz` or `tx ty tz` (N m); also `force_x`, `torque_x`, and other units that are named
    skin     one family of numbered columns, `t0 t1 ...`, in the order of their numbers, or every column without another meaning
    joints   every other column, each with `_deg` or `_rad`

Before a name may stand where ROS or PlotJuggler has it from (`field.wrench.force.x`, `/ft/wrench/force/x`, `%time`); what is of
a message's header or layout, but its time and number, is left out. `FILE::NAMES` are the columns whose names begin so.

Without a header, the first column is the time in seconds and the others follow in this order; joints are degrees. Rows of
`ros2 topic echo --csv` begin with seconds, nanoseconds and frame. Fields are separated by comma, semicolon, tab or spaces.
`table_form` finds header and separator, `table_values` reads numbers, `table_columns` chooses columns.

Each row becomes the line `<number> <seconds> <values>` of a YARP log, joints in degrees: the plainest form of the same content
that a decoder reads. A row without any value of the stream is none of its readings: tables of several streams have such rows.
The session's journal holds these lines, not the rows.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from itertools import islice, pairwise
from pathlib import Path

import numpy as np

from skincal.devices.column_names import MOMENT_UNITS, TIME_UNITS
from skincal.devices.decoding import TIME_STAMP_MAX_S, WRENCH_VALUES
from skincal.devices.netft_page import FORCE_UNITS
from skincal.devices.pose_names import NO_POSE_NAMES
from skincal.files.importers.labview import ABSOLUTE_MIN_S
from skincal.files.importers.registry import RecordedPlace, StreamGuess
from skincal.files.importers.table_columns import (
    UNIX_NS,
    TableColumns,
    TimeColumns,
    ValueColumns,
    comment_units,
    names_time,
)
from skincal.files.importers.table_form import EMPTY_WORDS, TableForm, read_form
from skincal.files.importers.table_values import (
    FIELD_SHOWN_MAX_CHARS,
    date_reader,
    find_slash_order,
    is_time_of_day,
    time_kind,
    time_of_day_reader,
    to_float,
)
from skincal.files.importers.timeline import (
    FINER_TIMES,
    OpenRecording,
    Timeline,
    check_assumed_seconds,
    check_overlap,
    late_streams,
)
from skincal.files.importers.workbook import SHEET_MARK, is_workbook, sheets_of
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.pose_form import POSE_WIDTHS
from skincal.model.readings import Stream
from skincal.streams.links import LinkSpec

ROWS_PARSED_AT_ONCE = 64
MAX_CACHED_FIELDS = 1 << 12
"""Raw values of a skin repeat, so their text is kept."""
NANOSECONDS_MIN = 1000
"""A column of nanoseconds has a value of at least this."""
ECHO_COLUMNS = 3
"""Columns of `ros2 topic echo --csv` before the values: seconds, nanoseconds, frame."""


_NETFT_COUNTER_RE = re.compile(r"(?:rdt|f/t)[ _]?seq(?:uence)?")


class _Table:
    """Rows of one stream in a CSV file.

    Raises InputError: the file cannot be read, is no text, has no row, or lacks a column or a unit; or its numbers have two
    readings.

    Parameters
    ----------
    channels : of the skin; 0 if unknown
    """

    def __init__(self, stream: Stream, place: RecordedPlace, channels: int = 0) -> None:
        self.stream, self.path = stream, place.path
        # A stream of a workbook may name its sheet, as `FT!` or `Log!force`.
        sheet, mark, begin = place.topic.partition(SHEET_MARK)
        sheet, within = (sheet, begin) if mark and is_workbook(place.path) else ("", place.topic)
        self._form = form = read_form(place.path, names_time, sheet)
        self.named = bool(form.names)
        """Whether it has a header."""
        columns = TableColumns(form) if self.named else None
        if columns:
            self._time, self._number = columns.time, columns.number
            values = columns.of_stream(stream, within, channels)
            has_others = len(columns.wrench) + len(columns.joints) + len(columns.others) > len(values.at)
        else:
            self._time, self._number = _unnamed_time(form), None
            values, has_others = _unnamed_values(form, self._time, stream, channels), False
        self.values = values.at
        self.pose_names, self.value_order = values.pose_names, values.value_order
        self._empty_words = EMPTY_WORDS if has_others else frozenset(("",))
        self._uses = form.number_uses()
        self._has_gaps = form.has_gaps()
        if self._has_gaps and has_others:
            # The numbers are those of rows, and not of this stream's readings.
            self._number = None
        texts = {factor: lru_cache(MAX_CACHED_FIELDS)(partial(_scaled_text, factor, self._uses)) for factor in values.factors}
        self._texts = [texts[factor] for factor in values.factors]
        self.first_time = self._time_text(next((row for row in form.examples if self._time_text(row)), ()))
        """Time of the first row as text; empty if there is none."""
        self._seconds_of, finding = self._detect_time()
        self.findings = [*form.findings, *values.findings, *([finding] if finding else [])]
        self.is_of_netft_program = any(map(_NETFT_COUNTER_RE.fullmatch, form.names))
        """Whether its names are those of the maker's program for Net F/T sensors."""
        self.skipped = 0
        """Rows without a time in the last reading..."""
        self.without_values = 0
        """...and rows without a value of the stream."""

    def _detect_time(self) -> tuple[Callable[[str], float | None], str]:
        """Choose the parser of the times, to seconds, by the first of them; say what was assumed."""
        column, unit, first = self._time.title, self._time.unit, self.first_time
        kind, number = time_kind(first, self._uses), to_float(first, self._uses)
        self.dated, self.unit_assumed = kind.startswith("date"), False
        if self.dated:
            finding = "" if kind == "date with a zone" else f"{column} holds dates without a zone and was read as UTC."
            order = self._slash_order()
            said = f"{finding} Dates with slashes were read as {order}/year." if order else finding
            return date_reader(first, order), said.strip()
        if not kind and is_time_of_day(first):
            return time_of_day_reader(first), f"{column} holds times of day."
        no_unit = " names no unit and" if self.named else ""
        if unit is None and number is not None and UNIX_NS[0] <= number <= UNIX_NS[1]:
            return partial(_number_seconds, TIME_UNITS["ns"], self._uses), (
                f"{column}{no_unit} was read as nanoseconds since 1970, as its values are."
            )
        self.unit_assumed = unit is None
        no_unit, degrees = (
            (" names no unit and", "") if self.named else ("", ", joints degrees" * (self.stream is Stream.JOINTS))
        )
        finding = f"{column}{no_unit} was read as seconds{degrees}." if unit is None else ""
        return partial(_number_seconds, TIME_UNITS[unit or "s"], self._uses), finding

    def _slash_order(self) -> str:
        """Find the order of day and month in dates with slashes. Raises InputError: it is unclear."""
        if "/" not in self.first_time:
            return ""
        splits = max(self._time.columns) + 1
        try:
            return find_slash_order(self._time_text(self._form.split(line, splits)) for line in self._form.lines())
        except ValueError as error:
            raise InputError(
                f"{self.path}: {error}; expected one recording: write dates as 2024-05-01, or cut the file at the leap."
            ) from error

    @property
    def link(self) -> LinkSpec:
        return LinkSpec(self.stream.value, f"file:{self.path}", (self.stream,), "csv")

    def stamps(self) -> Iterator[FloatArray]:
        """Give the times of the rows in blocks; count the rows that have none."""
        # Nothing after the time is read, unless a row may be another stream's.
        rows = self._rows() if self._has_gaps else self._rows(max(self._time.columns) + 1)
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
            other = self._time_text(row)
            if time_kind(other, self._uses) not in ("", time_kind(first, self._uses)):
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
        """Yield the rows with a value of the stream."""
        self.without_values = 0
        for line in self._form.lines():
            row = self._form.split(line, splits)
            if self._has_gaps and self._is_without_values(row):
                self.without_values += 1
            else:
                yield row

    def _is_without_values(self, row: Sequence[str]) -> bool:
        words = self._empty_words
        # A row that ends early is damaged, and counted so.
        return len(row) >= self._form.width and all(at < 0 or row[at].lower() in words for at in self.values)

    def _time_text(self, row: Sequence[str]) -> str:
        columns = self._time.columns
        return " ".join(row[at] for at in columns) if max(columns) < len(row) else ""

    def _seconds(self, row: Sequence[str]) -> float | None:
        if self._time.is_split:
            first, second = (to_float(row[at]) if at < len(row) else None for at in self._time.columns)
            seconds = None if first is None or second is None else first + second * TIME_UNITS["ns"]
        else:
            seconds = self._seconds_of(self._time_text(row))
        if seconds is not None and self._form.start_s and abs(seconds) < ABSOLUTE_MIN_S:
            seconds += self._form.start_s
        return None if seconds is None or not abs(seconds) <= TIME_STAMP_MAX_S else seconds

    def _line(self, index: int, row: list[str], seconds: float) -> bytes:
        """Format a row as a log line. A row of another width keeps it, so that it is counted."""
        number = to_float(row[self._number]) if self._number is not None and self._number < len(row) else None
        places = zip(self._texts, self.values, strict=True)
        if len(row) == self._form.width:
            values = [text(row[at]) if at >= 0 else "nan" for text, at in places]
        else:
            values = [(text(row[at]) if at >= 0 else "nan") if at < len(row) else "" for text, at in places]
            values += ["nan"] * (len(row) - self._form.width)
        line = f"{index if number is None or not math.isfinite(number) else int(number)} {seconds:.9f} {' '.join(values)}\n"
        return line.encode("ascii", "replace")


def open_recording(places: Mapping[Stream, RecordedPlace], channels: int = 0) -> OpenRecording:
    """Read the CSV files of one recording through.

    Parameters
    ----------
    channels : of the skin; 0 if unknown

    Raises InputError: a file cannot be read, has no row, lacks a column or a unit, or the files are of different times.
    """
    tables = [_Table(stream, place, channels) for stream, place in places.items()]
    findings: list[str] = []
    timelines: list[Timeline] = []
    for table in tables:
        name = table.stream.value
        timeline = Timeline(name, table.stamps())
        _check_times(table, timeline)
        timelines.append(timeline)
        findings += timeline.sentences()
        findings += [f"{name}: {finding}" for finding in table.findings]
        if table.skipped:
            findings.append(f"{name}: {plural(table.skipped, 'row')} without a time: left out.")
        if table.without_values:
            findings.append(
                f"{name}: {plural(table.without_values, 'row')} of the table without its values: not counted as lost."
            )
    check_overlap(timelines)
    findings += late_streams(timelines)
    return OpenRecording(
        tuple(table.link for table in tables),
        tuple(timelines),
        tuple(table.lines for table in tables),
        tuple(findings),
        pose_names=next((table.pose_names for table in tables if table.stream is Stream.TOOL), NO_POSE_NAMES),
        value_order=next((table.value_order for table in tables if table.stream is Stream.SKIN), None),
    )


def _check_times(table: _Table, timeline: Timeline) -> None:
    """Raise InputError: there are no times, they lack fractions of a second, or they are hardly seconds."""
    if table.is_of_netft_program and (timeline.is_coarse or not timeline.lines):
        raise InputError(
            f"{table.path}: the program of the sensor's maker writes whole seconds (seen "
            f"{table.first_time[:FIELD_SHOWN_MAX_CHARS]!r}): no row can be paired with one of a skin. Record both live "
            "(skincal record --wrench netft://ADDRESS), or log t_s with fractions of a second."
        )
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
    if table.unit_assumed:
        check_assumed_seconds(table.path, table.stream, timeline.interval, "name the time's column t_ms, t_us or t_ns")


def guess_streams(path: Path) -> list[StreamGuess]:
    """Guess the streams of a file from its columns.

    Raises InputError: it cannot be read, or no column is the time.
    """
    if not is_workbook(path):
        return _guesses_of(read_form(path, names_time), "")
    sheets = sheets_of(path)
    guesses: list[StreamGuess] = []
    for sheet in sheets:
        form = read_form(path, names_time, sheet)
        with contextlib.suppress(InputError):
            guesses += _guesses_of(form, f"{sheet}{SHEET_MARK}" if len(sheets) > 1 else "")
    if not guesses:
        raise InputError(f"{path}: no sheet has a column that names a time; it has {', '.join(sheets)}. Name it t_s or t_ms.")
    return guesses


def _guesses_of(form: TableForm, sheet: str) -> list[StreamGuess]:
    path = form.path
    place = RecordedPlace(path, sheet)
    if not form.names:
        return [StreamGuess(place, None, len(_Table(Stream.SKIN, place).values))]
    columns = TableColumns(form)
    guesses: list[StreamGuess] = []
    poses = (Stream.TOOL,) if len(columns.named_pose) in POSE_WIDTHS else ()
    for stream in (Stream.WRENCH, Stream.JOINTS, *poses):
        with contextlib.suppress(InputError):
            guesses.append(StreamGuess(place, stream, len(columns.of_stream(stream, "", 0).at)))
    families = columns.skin_families()
    if guesses and not families:
        return guesses
    if guesses or len(families) > 1:
        return guesses + [StreamGuess(RecordedPlace(path, f"{sheet}{base}"), Stream.SKIN, width) for base, width in families]
    return [StreamGuess(place, Stream.SKIN, len(columns.of_stream(Stream.SKIN, "", 0).at))]


# ------------------------------------------------------------------ tables without names


def _unnamed_time(form: TableForm) -> TimeColumns:
    """Find the time of a table without names: the first column, or whole seconds and nanoseconds as ROS has them."""
    head = [[to_float(field) for field in row[:2]] for row in form.examples if len(row) > 2]
    pairs = [(first, second) for first, second in head if first is not None and second is not None]
    whole = len(pairs) == len(head) > 1 and all(a == int(a) and b == int(b) and 0 <= b < 1e9 for a, b in pairs)
    if whole and max(b for _, b in pairs) >= NANOSECONDS_MIN:
        seconds = np.array([a + b * TIME_UNITS["ns"] for a, b in pairs])
        if len({a for a, _ in pairs}) < len(pairs) and (np.diff(seconds) >= 0).all() and seconds[-1] > seconds[0]:
            return TimeColumns((0, 1), "s", "no header: the first two columns", is_split=True)
    return TimeColumns((0,), None, "no header: the first column")


def _unnamed_values(form: TableForm, time: TimeColumns, stream: Stream, channels: int) -> ValueColumns:
    """Return the columns after the time; of ROS without the frame."""
    first = len(time.columns)
    findings: tuple[str, ...] = ()
    if time.is_split:
        frames = [row[first] for row in form.examples if first < len(row)]
        first += all(to_float(frame) is None for frame in frames)
        findings = (f"no header: read as rows of ros2 topic echo, {'with' if first == ECHO_COLUMNS else 'without'} a frame.",)
    count = form.width - first
    if count < 1 or (stream is Stream.WRENCH and count != WRENCH_VALUES):
        expected = "time fx fy fz mx my mz" if stream is Stream.WRENCH else "the time and at least one value"
        raise InputError(f"{form.path}: has {plural(form.width, 'column')} and no header; expected {expected}.")
    if stream is Stream.TOOL and count not in POSE_WIDTHS:
        raise InputError(
            f"{form.path}: has {plural(count, 'column')} after the time and no header; expected those of a pose: 6, 7, 12 or "
            "16."
        )
    if stream is Stream.SKIN and channels and count != channels:
        raise InputError(
            f"{form.path}: has {plural(count, 'column')} after the time and no header, and the scene has "
            f"{plural(channels, 'channel')}.{_rising_columns(form, first)} Write names above the columns (t_s, t0, t1, ...), "
            "so that the taxels are known."
        )
    factors = (1.0,) * count
    if stream is Stream.WRENCH and (units := comment_units(form.path, form.facts)):
        factors = (FORCE_UNITS[units.get("force", "n")],) * 3 + (MOMENT_UNITS[units.get("torque", "nm")],) * 3
        findings += ("the values are in the units of the lines before the rows.",)
    return ValueColumns(tuple(range(first, form.width)), factors, findings)


def _rising_columns(form: TableForm, first: int) -> str:
    """Name the columns that only rise, as clocks and counters do; empty if there are none."""
    rising: list[int] = []
    for column in range(first, form.width):
        values = [to_float(row[column]) if column < len(row) else None for row in form.examples]
        numbers = [value for value in values if value is not None]
        if len(numbers) == len(values) > 2 and all(b > a for a, b in pairwise(numbers)):
            rising.append(column + 1)
    return f" Column {', '.join(map(str, rising))} only rises, as a clock or a counter does." if rising else ""


def _scaled_text(factor: float, uses: dict[str, str], field: str) -> str:
    """Format a number times `factor`. Text that is no number is passed on, so that the decoder counts it."""
    value = to_float(field, uses)
    return repr(value * factor) if value is not None else field.replace(" ", "?") or "nan"


def _number_seconds(unit_s: float, uses: dict[str, str], field: str) -> float | None:
    value = to_float(field, uses)
    return None if value is None else value * unit_s
