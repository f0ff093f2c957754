"""Frames of a mat as text: one matrix a frame, with blank lines or titles between them.

    Frame 1, t = 0.00 s
    0 0 3 1
    0 2 9 4

A title may name the time of its frame, with its unit; a line of the head may name the rate (`SECONDS_PER_FRAME 0.01`,
`Rate: 100 Hz`). Values are separated by commas, semicolons, tabs or spaces; `B` is a place without a cell, as Tekscan
writes it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from skincal.files.importers.array_file import ArrayFile, NamedArray
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.given import open_regular

MAX_LINE_CHARS = 1 << 20
PROBED_LINES = 400
"""Of a file that may be of this kind: the first two frames of a mat of 128 rows."""
MIN_FRAME_ROWS = 2
NO_CELL_WORDS = frozenset(("b", "nan", "-", "na"))
_SEPARATORS_RE = re.compile(r"[,;\t ]+")
_TIME_RE = re.compile(
    r"(?:(?<![a-z])t(?:ime)?(?:stamp)?\s*(?:\((?P<unit>s|ms|us)\)|\[(?P<other>s|ms|us)\])?\s*[:=]?\s*|@\s*)"
    r"(?P<value>\d+(?:\.\d+)?(?:e[-+]?\d+)?)\s*(?P<after>s|sec|seconds|ms|us)?(?![a-z\d])",
    re.IGNORECASE,
)
_DURATION_RE = re.compile(r"(?<![\w.])(?P<value>\d+(?:\.\d+)?)\s*(?P<after>s|sec|seconds|ms|us)(?![a-z\d])", re.IGNORECASE)
_NUMBER_RE = re.compile(r"\d+(?:\.\d+)?")
_PERIOD_RE = re.compile(r"seconds[_ ]per[_ ]frame\W*([\d.eE+-]+)", re.IGNORECASE)
_RATE_RE = re.compile(r"(?:rate|frequency|fps)\D{0,20}?([\d.]+)\s*(?:hz|fps|frames)?", re.IGNORECASE)
_UNIT_S = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6}


@dataclass(slots=True)
class _Frames:
    """Frames read so far."""

    path: Path
    frames: list[list[list[float]]] = field(default_factory=list[list[list[float]]])
    times: list[float] = field(default_factory=list[float])
    rate: float | None = None
    units: set[str] = field(default_factory=set[str])
    numbers: list[float] = field(default_factory=list[float])
    """Lines with one number: frame numbers, or times."""

    def read_title(self, line: str) -> None:
        """Read the time or the rate in a line that is no row."""
        period, rate = _PERIOD_RE.search(line), _RATE_RE.search(line)
        time, duration = _TIME_RE.search(line), _DURATION_RE.search(line)
        if period and float(period[1]) > 0:
            self.rate = 1.0 / float(period[1])
        elif time:
            self._add_time(float(time["value"]), time["unit"] or time["other"] or time["after"] or "")
        elif rate and not self.frames:
            self.rate = float(rate[1]) or None
        elif duration:
            self._add_time(float(duration["value"]), duration["after"])
        elif _NUMBER_RE.fullmatch(line):
            self.numbers.append(float(line))

    def _add_time(self, value: float, unit: str) -> None:
        self.units.add(unit.lower())
        self.times.append(value * _UNIT_S.get(unit.lower(), 1.0))


def is_text_frames(path: Path) -> bool:
    """Check by its first lines whether a text file has one matrix a frame."""
    try:
        with open_regular(path) as file:
            lines = [line for _, line in zip(range(PROBED_LINES), _lines_of(file.read(1 << 18)), strict=False)]
    except InputError:
        return False
    blocks = list(_blocks(lines))
    sizes = {(len(rows), len(rows[0])) for _, rows in blocks[: -1 if len(blocks) > 2 else None]}
    return len(blocks) > 1 and len(sizes) == 1 and sizes.pop()[0] >= MIN_FRAME_ROWS


def open_text_frames(path: Path) -> ArrayFile:
    """Read the frames of a mat. Raises InputError: the file is no such text, or its frames differ in size."""
    found = _Frames(path)
    with open_regular(path) as file:
        data = file.read()
    for titles, rows in _blocks(_lines_of(data)):
        for title in titles:
            found.read_title(title)
        found.frames.append(rows)
    if len(found.frames) < 2 or any(len(rows) < MIN_FRAME_ROWS for rows in found.frames[:1]):
        raise InputError(
            f"{path}: no frames were found; expected text with one matrix a frame, and a blank line or a title between two."
        )
    return _checked(found)


def _checked(found: _Frames) -> ArrayFile:
    path, shape, findings = found.path, (len(found.frames[0]), len(found.frames[0][0])), list[str]()
    last = found.frames[-1]
    if len(last) < shape[0]:
        findings.append(f"the last frame has {plural(len(last), 'row')} of {shape[0]}, as the recording was cut off: left out.")
        found.frames.pop()
        found.times = found.times[: len(found.frames)]
    for number, rows in enumerate(found.frames, 1):
        sizes = {len(row) for row in rows}
        if len(rows) != shape[0] or sizes != {shape[1]}:
            raise InputError(
                f"{path}: frame {number} has {len(rows)} x {max(sizes)} values, and the first one {shape[0]} x {shape[1]}; "
                "expected one size: leave out frames that were cut."
            )
    frames: FloatArray = np.array(found.frames)
    arrays = {"frames": NamedArray("frames", frames.shape, "f", lambda: frames)}
    counts_frames = all(number == round(number) for number in found.numbers) and set(np.diff(found.numbers)) <= {1.0}
    if found.numbers and not found.times and not counts_frames:
        found.times, found.units = found.numbers, {""}
    if found.times:
        if len(found.times) != len(frames):
            raise InputError(
                f"{path}: {plural(len(found.times), 'title')} of {plural(len(frames), 'frame')} name a time; expected all of "
                "them, or none and the rate (--time 100, or ?time=100 after the name)."
            )
        times: FloatArray = np.array(found.times)
        name = "time" if "" in found.units else "time_s"
        arrays[name] = NamedArray(name, times.shape, "f", lambda: times)
    return ArrayFile(path, "text with one matrix a frame", arrays, None if found.times else found.rate, tuple(findings))


def _lines_of(data: bytes) -> Iterator[str]:
    for line in data.decode("utf-8-sig", "replace").splitlines():
        if len(line) > MAX_LINE_CHARS:
            raise InputError(f"A line has more than {MAX_LINE_CHARS} letters; expected one row of a matrix a line.")
        yield line.strip()


def _blocks(lines: Iterator[str] | Sequence[str]) -> Iterator[tuple[list[str], list[list[float]]]]:
    """Yield each matrix with the lines before it that are no rows."""
    titles, rows = list[str](), list[list[float]]()
    for line in lines:
        row = _row_of(line)
        # One number above wider rows is the number or the time of the frame.
        if row is not None and rows and len(rows[0]) == 1 < len(row):
            titles, rows = [*titles, *(f"{only:.12g}" for (only,) in rows)], [row]
            continue
        if row is not None and not (rows and len(row) == 1 < len(rows[0])):
            rows.append(row)
            continue
        if rows:
            yield titles, rows
            titles, rows = [], []
        if row is not None:
            rows.append(row)
            continue
        if line:
            titles.append(line)
    if rows:
        yield titles, rows


def _row_of(line: str) -> list[float] | None:
    words = [word for word in _SEPARATORS_RE.split(line.strip("[]() ")) if word]
    if not words:
        return None
    try:
        return [np.nan if word.lower() in NO_CELL_WORDS else float(word) for word in words]
    except ValueError:
        return None
