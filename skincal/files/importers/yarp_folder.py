"""Recordings of `yarpdatadumper` as the chunks of a session.

A folder holds `data.log`, one message a line, and `info.log`, whose `Stamp:` line says which times it has. Old
dumpers wrote no `Stamp:` line: then a log has two stamps where its third column is a time within seconds of the second.
A sender without an envelope leaves its stamp 0: a log with such lines is read by the receiver's stamps, all of it, since the
two clocks may differ. The dumper then writes the receiver's stamp as a second one, also where `info.log` says `Stamp: tx;`.
Source: robotology/yarp `src/yarpdatadumper/main.cpp` (and `src/commands/yarpdatadumper` later).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO
from itertools import chain, islice
from pathlib import Path

import numpy as np

from skincal.devices.bottles import MEASURES_LISTS, MEASURES_WRENCH
from skincal.devices.decoding import WRENCH_VALUES
from skincal.files.importers.registry import RecordedPlace, StreamGuess
from skincal.files.importers.timeline import OpenRecording, Timeline, check_overlap, late_streams
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.given import open_regular, read_regular
from skincal.model.pose_form import POSE_WIDTHS
from skincal.model.readings import Stream
from skincal.streams.decoders.yarp_log import (
    LINE_MAX,
    BottleError,
    LogLine,
    even_width,
    is_header,
    parse_bottle,
    split_line,
    split_stamps,
)
from skincal.streams.links import LinkSpec

DATA, INFO = "data.log", "info.log"
SENDER_TO_RECEIVER_CLOCK_MAX_S = 10.0
"""s. Sender's and receiver's clocks of one message are nearer than this: the rule for logs without a Stamp line."""
UNIX_TIME_MIN_S = 1e8
"""s. A stamp of a computer's clock is later (1973); no force, angle or raw value of a taxel is as large."""
LINES_READ_TO_FIND_GRAMMAR = 50
"""Lines from which the grammar of an old log is found."""
INFO_LOG_MAX_BYTES = 1 << 16
"""Bytes of `info.log`, which has some lines."""
READ_BLOCK_BYTES = 1 << 16
"""bytes that are read at a time: some 600 wrenches."""
TOO_LONG = b"...\n"
"""Stands for a line that is too long: no record, so that it is counted as unreadable."""
FORMAT_BY_STAMPS = {1: "yarp", 2: "yarp-tx-rx"}
"""Number of stamps to the name of the decoder..."""
BY_RECEIVER = "yarp-rx"
"""...and of that for two stamps, if the sender's may be missing."""
_STAMP_LINE = re.compile(r"^\s*Stamp:\s*([a-z+]+)", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class _Log:
    """One log file and its grammar."""

    name: str
    stream: Stream
    path: Path
    stamps: int
    # `"tx"` or `"rx"`: whose clock the lines are placed by; empty where the log does not say.
    clock: str
    decoder: str
    findings: tuple[str, ...]

    @property
    def link(self) -> LinkSpec:
        return LinkSpec(self.name, f"file:{self.path}", (self.stream,), self.decoder)

    def lines(self) -> Iterator[list[bytes]]:
        """Give the records in blocks.

        A line that is no record has no time: it travels before the next record, so that the decoder counts it.
        """
        before = b""
        for block in _whole_lines(self.path):
            if split_stamps(block, self.stamps) is not None:
                yield [before + block[0], *block[1:]]
                before = b""
                continue
            for data in block:
                if split_line(data, self.stamps) is not None:
                    yield [before + data]
                    before = b""
                elif len(before) < LINE_MAX and not is_header(data):
                    before += data


@dataclass(slots=True)
class _Contents:
    """Counts of the unusual lines of a log, from its first reading."""

    # Lines whose first stamp is 0: their sender gave none.
    untimed: int = 0
    empty: int = 0
    unreadable: int = 0
    cut: bool = False
    nested: bool = False
    # Six-axis sensors in `measures:o`; 0 in a log of plain vectors.
    sensors: int = 0
    # Number of lines by their number of values, plain vectors only.
    widths: Counter[int] = field(default_factory=Counter[int])


def open_recording(places: Mapping[Stream, RecordedPlace]) -> OpenRecording:
    """Read the logs of one recording through: folders of `yarpdatadumper`, or their `data.log`.

    Raises InputError: a folder has no log, a file is not such a log, holds no record, or the logs are of different times.
    """
    logs = [_open_log(stream, place.path) for stream, place in places.items()]
    findings: list[str] = []
    timelines: list[Timeline] = []
    for index, log in enumerate(logs):
        timeline, contents = _read_through(log)
        if contents.untimed:
            logs[index] = replace(log, decoder=BY_RECEIVER)
        timelines.append(timeline)
        findings += [*log.findings, *timeline.sentences(), *_content_findings(log, contents, timeline.lines)]
    check_overlap(timelines)
    findings += [*late_streams(timelines), *_clock_findings(logs)]
    return OpenRecording(tuple(log.link for log in logs), tuple(timelines), tuple(log.lines for log in logs), tuple(findings))


def guess_streams(path: Path) -> list[StreamGuess]:
    """Guess a log's stream from its first record.

    Raises InputError: as for `find_log`, or the log has no record.
    """
    log, _ = find_log(path)
    stamps, _, _ = _grammar(log)
    for line in _first_lines(log, stamps):
        if line.payload.strip():
            if _count_sensors(line.payload):
                return [StreamGuess(RecordedPlace(path), Stream.WRENCH, WRENCH_VALUES)]
            width = len(line.payload.replace(b"(", b" ").replace(b")", b" ").split())
            return [StreamGuess(RecordedPlace(path), None, width)]
    raise InputError(f"{log}: its first lines hold no record; expected a log that yarpdatadumper wrote.")


def _first_lines(path: Path, stamps: int) -> list[LogLine]:
    first = islice(chain.from_iterable(_whole_lines(path)), LINES_READ_TO_FIND_GRAMMAR)
    return [line for data in first if (line := split_line(data, stamps)) is not None]


def _open_log(stream: Stream, place: Path) -> _Log:
    path, findings = find_log(place)
    stamps, clock, found = _grammar(path)
    name = stream.value
    sentences = tuple(f"{name}: {sentence}" for sentence in (*findings, *found))
    return _Log(name, stream, path, stamps, clock, FORMAT_BY_STAMPS[stamps], sentences)


def find_log(place: Path) -> tuple[Path, list[str]]:
    """Return the log that a path means, and sentences on the choice.

    The path is a log file, a folder with `data.log`, or the name of a port's folder that exists only with the numeric suffix
    that the dumper appends (`right_arm_00001`).

    Raises InputError: there is no log there, or more than one.
    """
    if place.is_file():
        return place, []
    if (place / DATA).is_file():
        others = [folder.name for folder in _numbered(place)]
        return place / DATA, [f"{place} was read; there is also {', '.join(others)}."] if others else []
    found = _numbered(place) + (
        [inner for inner in sorted(place.iterdir()) if (inner / DATA).is_file()] if place.is_dir() else []
    )
    if len(found) == 1:
        return found[0] / DATA, [f"{found[0]} was read: it holds the only log for {place}."]
    if found:
        names = ", ".join(str(folder) for folder in found[:5])
        raise InputError(f"{place}: several folders hold a log ({names}); give the one you mean.")
    seen = "there is no such folder" if not place.exists() else f"the folder has no {DATA}"
    raise InputError(f"{place}: {seen}; expected a folder that yarpdatadumper wrote, with {DATA} and {INFO}.")


def _numbered(place: Path) -> list[Path]:
    """Return the folders that the dumper made beside `place`, with a number after its name."""
    if not place.name or not place.parent.is_dir():
        return []
    pattern = re.compile(re.escape(place.name) + r"_\d+")
    return [folder for folder in sorted(place.parent.iterdir()) if pattern.fullmatch(folder.name) and (folder / DATA).is_file()]


def _grammar(path: Path) -> tuple[int, str, list[str]]:
    """Find the number of stamps in a line, and whose clock the last one is ("tx" or "rx"); list what is unusual."""
    text = _read_info(path.with_name(INFO))
    kind = re.search(r"^\s*Type:\s*([^;\n]*)", text, re.MULTILINE)
    if kind is not None and not kind.group(1).strip().startswith("Bottle"):
        raise InputError(f"{path}: its type is {kind.group(1).strip()!r}; expected Bottle, a log of numbers.")
    found = _STAMP_LINE.search(text)
    if found is not None:
        clocks = found.group(1).split("+")
        if len(clocks) in FORMAT_BY_STAMPS and set(clocks) <= {"tx", "rx"}:
            return (2, "rx", []) if clocks == ["tx"] and _lacks_sender_stamps(path) else (len(clocks), clocks[-1], [])
        raise InputError(f"{path.with_name(INFO)}: Stamp is {found.group(1)!r}; expected tx, rx or tx+rx.")
    head = _first_lines(path, 2)
    # No Stamp line: if most of the first lines have a second time, all lines have.
    two = sum(_has_two_stamps(line) for line in head) * 2 > len(head) > 0
    return (2, "rx", []) if two else (1, "", [])


def _read_info(path: Path) -> str:
    try:
        return read_regular(path, INFO_LOG_MAX_BYTES).decode("utf-8", "replace")
    except InputError:
        # Old data sets come without it.
        return ""


def _has_two_stamps(line: LogLine) -> bool:
    tx, rx = line.stamps
    return rx > UNIX_TIME_MIN_S and (tx == 0 or abs(rx - tx) < SENDER_TO_RECEIVER_CLOCK_MAX_S)


def _lacks_sender_stamps(path: Path) -> bool:
    """Check whether the first lines have a sender's stamp of 0 and a time that runs after it."""
    stamps = np.array([line.stamps for line in _first_lines(path, 2)]).reshape(-1, 2)
    return (
        len(stamps) > 1 and not stamps[:, 0].any() and bool((np.diff(stamps[:, 1]) >= 0).all() and stamps[-1, 1] > stamps[0, 1])
    )


def _whole_lines(path: Path) -> Iterator[list[bytes]]:
    """Give the lines of a file that have an end, block by block; the dumper ends every line, so one without is cut.

    Of a line that is too long to be a record, `TOO_LONG` is given.
    """
    try:
        with open_regular(path, advice="check the path and its rights") as file:
            rest, cut = b"", False
            while data := file.read(READ_BLOCK_BYTES):
                lines = BytesIO(rest + data).readlines()
                rest = b"" if lines[-1].endswith(b"\n") else lines.pop()
                if lines and (cut or max(map(len, lines)) > LINE_MAX + 1):
                    lines = [
                        TOO_LONG if len(line) > LINE_MAX + 1 or (cut and not index) else line
                        for index, line in enumerate(lines)
                    ]
                    cut = False
                if lines:
                    yield lines
                if len(rest) > LINE_MAX:
                    rest, cut = b"", True
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path and its rights.") from None


def _ends_open(path: Path) -> bool:
    """Return whether the last line of a file has no end, from its last byte alone."""
    with path.open("rb") as file:
        file.seek(max(file.seek(0, 2) - 1, 0))
        return file.read(1) not in (b"\n", b"")


def _read_through(log: _Log) -> tuple[Timeline, _Contents]:
    """Read a log once: its timeline, and what it holds."""
    contents = _Contents()
    timeline = Timeline(log.name, _stamps(log, contents))
    if not timeline.lines:
        seen = f"has {plural(contents.unreadable, 'line')}, none of them of the form <number> <time> <values>"
        seen = seen if contents.unreadable else "is empty"
        raise InputError(f"{log.path}: {seen}; expected a log that yarpdatadumper wrote.")
    if contents.untimed == timeline.lines and log.stamps == 1:
        raise InputError(f"{log.path}: every time is 0, since the sender gave none; record it again with --rxTime.")
    contents.cut = _ends_open(log.path)
    _check_width(log, contents)
    return timeline, contents


def _stamps(log: _Log, contents: _Contents) -> Iterator[FloatArray]:
    for block in _whole_lines(log.path):
        times = split_stamps(block, log.stamps)
        data = b"".join(block)
        width = 0 if times is None or b"(" in data else even_width(data)
        if times is not None and width > 1 + log.stamps:
            # The usual block: lines of words alone, all of one width.
            contents.untimed += int(np.count_nonzero(times[:, 0] == 0))
            contents.widths[width - 1 - log.stamps] += len(block)
            yield times[:, -1]
            continue
        stamps: list[float] = []
        for data in block:
            line = split_line(data, log.stamps)
            if line is not None:
                contents.untimed += line.stamps[0] == 0
                _count_line(line.payload, contents)
                stamps.append(line.stamps[-1])
            elif not is_header(data):
                contents.unreadable += 1
        yield np.array(stamps)


def _count_line(payload: bytes, contents: _Contents) -> None:
    """Note what a line carries, without reading more of it than is needed."""
    words = payload.split()
    if not words:
        contents.empty += 1
        return
    if b"(" not in payload:
        contents.widths[len(words)] += 1
    elif not contents.nested:
        contents.nested = True
        contents.sensors = _count_sensors(payload)


def _count_sensors(payload: bytes) -> int:
    try:
        bottle = parse_bottle(payload.decode("utf-8", "replace"))
    except BottleError:
        return 0
    sensors = bottle[MEASURES_WRENCH] if len(bottle) >= MEASURES_LISTS else None
    return len(sensors) if isinstance(sensors, list) else 0


def _check_width(log: _Log, contents: _Contents) -> None:
    """Refuse a wrench log whose lines have another width, before each of them is refused by the decoder."""
    if log.stream is Stream.WRENCH and contents.widths and 6 not in contents.widths:
        width = contents.widths.most_common(1)[0][0]
        raise InputError(f"{log.path}: its lines hold {width} values; expected six, fx fy fz mx my mz: is this the F/T log?")
    if log.stream is Stream.TOOL and not POSE_WIDTHS & contents.widths.keys():
        seen = f"its lines hold {contents.widths.most_common(1)[0][0]} values" if contents.widths else "its lines hold lists"
        raise InputError(f"{log.path}: {seen}; expected a pose of the tool: 6, 7, 12 or 16 values, in the form of [tool].")


def _content_findings(log: _Log, contents: _Contents, lines: int) -> list[str]:
    found: list[str] = []
    if contents.untimed and log.stamps == 2:
        found.append(
            f"{contents.untimed} of {plural(lines, 'line')} without a time of the sender (0): "
            "all are placed by the receiver's, which is a little later."
        )
    if len(contents.widths) > 1:
        usual, count = contents.widths.most_common(1)[0]
        found.append(f"{plural(contents.widths.total() - count, 'line')} with another number of values than {usual}.")
    if contents.sensors > 1:
        found.append(f"{contents.sensors} force/torque sensors in one port; the first is read.")
    if contents.empty:
        found.append(f"{plural(contents.empty, 'line')} without values: nothing was sent.")
    if contents.unreadable:
        found.append(f"{plural(contents.unreadable, 'line')} not of the form <number> <time> <values>: left out.")
    if contents.cut:
        found.append("the last line has no end: it was cut while it was written, and is left out.")
    return [f"{log.name}: {sentence}" for sentence in found]


def _clock_findings(logs: list[_Log]) -> list[str]:
    """Warn if two logs are placed by different clocks."""
    clocks = {log.name: log.clock for log in logs if log.clock}
    if len(set(clocks.values())) < 2:
        return []
    words = {"tx": "the sender's clock", "rx": "the recorder's clock"}
    which = ", ".join(f"{name} by {words[clock]}" for name, clock in clocks.items())
    return [f"the logs are placed by different clocks ({which}): where those differ, pokes are paired with the wrong wrench."]
