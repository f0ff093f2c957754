"""Streams in named arrays: those that may be a wrench, a skin or joints, their times, and the axis along which time runs.

A stream is written as `NAME`, as part of an array (`data[1:7]`, counted from 0), as several side by side (`force+torque`),
or as columns of a table (`t*`: those whose names begin so). `NAME:UNIT` states a unit that the file lacks. Options follow a
question mark: `?time=NAME`, `time=NAME:ms` or `time=100` (rows a second), and `order=columns` for frames that are counted down
the columns.

No unit, frame, sign, time base or order of axes is assumed in silence: a sentence says each that the file does not state.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

from skincal.devices.column_names import MOMENT_UNITS, TIME_UNITS, WRENCH_AXES, axis_of, plain_unit
from skincal.devices.decoding import TIME_STAMP_MAX_S, WRENCH_VALUES
from skincal.devices.netft_page import FORCE_UNITS
from skincal.files.importers.array_file import AnyArray, ArrayFile, NamedArray
from skincal.files.importers.table_columns import UNIX_NS, TableColumns, is_known_name, time_unit_of
from skincal.files.importers.table_form import TableForm
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.pose_form import POSE_WIDTHS
from skincal.model.readings import Stream

VALUES_PER_ROW_MAX = 100_000
IMAGE_COLOURS = (3, 4)
"""Length of the last axis of a colour image."""
IMAGE_MIN_SIDE = 24
FEW_ROWS = 20
"""An array with fewer rows is no recording of pokes."""
EXAMPLE_ROWS = 20
_TIME_WORDS_RE = re.compile(r"(?:^|[._/ ])(?:t|times?|time_?stamps?|stamps?|clock|secs?|seconds)(?:$|[._/ \[(])", re.IGNORECASE)
_PART_RE = re.compile(r"(?P<name>.+?)(?:\[(?P<begin>\d*):(?P<end>\d*)\]|\[(?P<only>\d+)\])?")
_SKIN_RE = re.compile(r"skin|tactile|taxel|touch|pressure|fsr|frames", re.IGNORECASE)
_WRENCH_RE = re.compile(r"wrench|(?<![a-z])f_?/?t(?![a-z])|force_?torque|ft_?sensor|loadcell|load_cell", re.IGNORECASE)
_FORCE_RE = re.compile(r"(?<![a-z])forces?(?![a-z_]*torque)", re.IGNORECASE)
_TORQUE_RE = re.compile(r"(?<![a-z])(?:torques?|moments?)", re.IGNORECASE)
_JOINTS_RE = re.compile(
    r"joints?(?!.*(?:vel|effort|torque|acc|current))|encoder|(?<![a-z])q(?:pos)?(?![a-z])|observation[./]state$", re.IGNORECASE
)
_POSE_RE = re.compile(r"(?<![a-z])(?:pose|tcp|tool|ee|flange|end_?effector|o_t_ee|base_t_)(?![a-z])", re.IGNORECASE)
UPPER_ROWS_VALUES = 12
"""Of an array (n, 3, 4)."""
_NO_WRENCH_RE = re.compile(r"pose|position|velocity|twist|joint|state|action|command|imu", re.IGNORECASE)
_BOOKKEEPING_NAMES = frozenset(
    ("episode_index", "frame_index", "task_index", "index", "next.done", "next.reward", "next.success")
)


@dataclass(frozen=True, slots=True)
class ArraySpec:
    """A stream as the operator writes it."""

    text: str
    parts: tuple[str, ...]
    unit: str
    time: str
    by_columns: bool
    episode: int | None

    @classmethod
    def parse(cls, text: str) -> ArraySpec:
        """Read a stream. Raises InputError: an option is not known, or a number is none."""
        body, _, query = text.partition("?")
        options = dict(parse_qsl(query, keep_blank_values=True))
        unknown = options.keys() - {"time", "order", "episode"}
        if unknown or options.get("order", "rows") not in ("rows", "columns"):
            raise InputError(
                f"{text}: {', '.join(sorted(unknown)) or 'order'} is no option of an array; expected time=NAME, time=RATE, "
                "order=rows, order=columns or episode=NUMBER."
            )
        episode = options.get("episode", "")
        if episode and not episode.isdecimal():
            raise InputError(f"{text}: the episode {episode!r} is no number; expected episode=0 or a larger one.")
        name, unit = split_unit(body)
        parts = tuple(part.strip() for part in name.split("+"))
        return cls(
            name, parts, unit, options.get("time", ""), options.get("order") == "columns", int(episode) if episode else None
        )


def split_unit(text: str) -> tuple[str, str]:
    """Split `NAME:UNIT`; a colon without a unit behind it belongs to the name."""
    name, colon, unit = text.rpartition(":")
    words = [plain_unit(each) for each in unit.split(",")]
    known = {*TIME_UNITS, "deg", "rad", *FORCE_UNITS, *MOMENT_UNITS}
    return (name, unit) if colon and name and words and all(word in known for word in words) else (text, "")


@dataclass(frozen=True, slots=True, eq=False)
class StreamRows:
    """Rows of a stream: (n,) times in s, and (n, values)."""

    stamps: FloatArray
    values: AnyArray
    frame: str
    labels: tuple[str, ...]
    shape: tuple[int, ...]
    """Of a row, as the file has it."""
    findings: tuple[str, ...]
    time_unit_assumed: bool


class ArrayStreams:
    """Choice of streams in the arrays of a file."""

    def __init__(self, file: ArrayFile) -> None:
        self.file = file
        self.path = file.path
        self.times = {each.name: each for each in file.arrays.values() if self._may_be_time(each)}
        """Arrays that may be times."""

    # ---- times

    @staticmethod
    def _may_be_time(array: NamedArray) -> bool:
        if _long_axis(array.shape) != prod(array.shape) or prod(array.shape) < 2:
            return False
        name = array.last_name.lower()
        return array.is_time or (
            array.is_number and (time_unit_of(name) is not None or _TIME_WORDS_RE.search(name) is not None)
        )

    def times_for(self, array: NamedArray) -> list[NamedArray]:
        """List the times that may be of an array: those in its group or with its name first, the others only without these."""
        fitting = [each for each in self.times.values() if prod(each.shape) in array.shape and each is not array]
        base = array.last_name.lower()
        words = [word for word in re.split(r"[^a-z]+", array.name.lower()) if len(word) > 1]
        named = [each for each in fitting if base in each.name.lower()]
        inside = [each for each in fitting if each.group == array.group and array.group]
        begun = [each for each in fitting if any(word in each.last_name.lower() for word in words)]
        plain = [each for each in fitting if not self._is_of_other(each, array)]
        return next((found for found in (named, inside if len(inside) == 1 else [], begun, inside, plain) if found), fitting)

    def _is_of_other(self, time: NamedArray, array: NamedArray) -> bool:
        """Whether a time is in the group of another array, or has its name."""
        others = [each for each in self.file.arrays.values() if each.is_number and each.name not in self.times]
        inside = time.group and time.group != array.group and any(each.group == time.group for each in others)
        return bool(inside) or any(
            each.last_name.lower() in time.last_name.lower() for each in others if each is not array and len(each.last_name) > 2
        )

    def _time_of(self, array: NamedArray, spec: ArraySpec) -> tuple[NamedArray | float, str]:
        """Find the times of an array, or its rate; and the stated unit."""
        if spec.time:
            try:
                rate = float(spec.time)
            except ValueError:
                name, unit = split_unit(spec.time)
                return self._named(name, "the time"), unit
            if not 0 < rate < 1e5:
                raise InputError(
                    f"{self.path}: {rate:g} is no rate; expected rows a second, such as 100 (--time 100, or ?time=100 "
                    "after the array)."
                )
            return rate, ""
        found = self.times_for(array)
        if len(found) > 1:
            names = " or ".join(each.name for each in found[:4])
            raise InputError(
                f"{self.path}: the time of {array.name} may be {names}; name it: --time {found[0].name}, or for this array "
                f"alone {spec.text}?time={found[0].name}."
            )
        if found:
            return found[0], ""
        if self.file.rate:
            return self.file.rate, ""
        lengths = ", ".join(f"{each.name} has {prod(each.shape)}" for each in list(self.times.values())[:3])
        seen = f"the lengths differ: {lengths}" if lengths else "no array is named as a time (t, time, timestamp)"
        raise InputError(
            f"{self.path}: no time of {array.name} {list(array.shape)} was found; {seen}. Name it (--time NAME, or "
            "?time=NAME after the array), or the rows a second if they have a steady rate (--time 100, or ?time=100)."
        )

    def _named(self, name: str, what: str) -> NamedArray:
        found = self.file.arrays.get(name)
        if found is None:
            part = _PART_RE.fullmatch(name)
            if part and part["only"] and (whole := self.file.arrays.get(part["name"])) is not None:
                return self._column_of(whole, int(part["only"]))
            why = self.file.details.get(name)
            if why:
                raise InputError(f"{self.path}: {name} {why}.")
            raise InputError(f"{self.path}: has no array {name} for {what}; it has {self.file.list_names()}.")
        if found.trouble:
            raise InputError(f"{self.path}: {name} {found.trouble}.")
        if not (found.is_number or found.is_time):
            raise InputError(f"{self.path}: {name} holds texts, and no numbers; it has {self.file.list_names()}.")
        return found

    def _column_of(self, array: NamedArray, column: int) -> NamedArray:
        if len(array.shape) != 2 or column >= min(array.shape):
            raise InputError(f"{self.path}: {array.name} {list(array.shape)} has no column {column}; they are counted from 0.")
        rows = max(array.shape)
        axis = 0 if array.shape[0] == rows else 1

        def read() -> AnyArray:
            values = np.asarray(self.file.read(array))
            return values[:, column] if axis == 0 else values[column]

        name = array.labels[column] if len(array.labels) == min(array.shape) else f"{array.name}[{column}]"
        return NamedArray(name, (rows,), array.kind, read, array.unit)

    def _seconds(self, time: NamedArray, unit: str) -> tuple[FloatArray, str, bool]:
        """Read times in seconds; with a sentence, and whether their unit is assumed."""
        values = np.asarray(self.file.read(time)).ravel()
        if time.is_time:
            missing = np.isnat(values)
            seconds = (values - np.array(0, values.dtype)) / np.timedelta64(1, "s")
            return np.where(missing, np.nan, seconds), f"time {time.name}: read as dates in UTC.", False
        seconds = values.astype(np.float64)
        stated = unit or time.unit or (time_unit_of(time.last_name.lower()) or "")
        word = time_unit_of(f"t_{stated}") or (stated if stated in TIME_UNITS else "")
        if stated and not word:
            raise InputError(
                f"{self.path}: the unit {stated!r} of {time.name} is not known; expected s, ms, us or ns, such as "
                f"{time.name}:s (--time)."
            )
        if word:
            return seconds * TIME_UNITS[word], "" if unit else f"time {time.name}: read as {word}.", False
        first = next((each for each in seconds.tolist() if np.isfinite(each)), 0.0)
        if UNIX_NS[0] <= first <= UNIX_NS[1]:
            return seconds * 1e-9, f"time {time.name}: read as nanoseconds since 1970, as its values are.", False
        advice = f"else name it with its unit: --time {time.name}:ms, or ?time={time.name}:ms after the array"
        return seconds, f"time {time.name} names no unit and was read as seconds; {advice}.", True

    # ---- rows

    def rows_of(self, stream: Stream, spec: ArraySpec, channels: int) -> StreamRows:
        """Read a stream: its arrays side by side, rows first.

        Raises InputError: an array is missing, or none; its axes, its time or a unit are not clear.
        """
        if len(spec.parts) == 1 and spec.parts[0].endswith("*"):
            return self._table_rows(stream, spec, channels)
        arrays = [self._part(part, stream) for part in spec.parts]
        time, unit = self._time_of(arrays[0][0], spec)
        findings: list[str] = []
        if not isinstance(time, NamedArray):
            rows = _single_rows(self.path, arrays[0][0])
            stamps, assumed = np.arange(rows) / time, False
            title = f"the rate {time:g}"
            stated = "as named" if spec.time else "as the file states"
            findings.append(f"no times: counted at {time:g} rows a second, {stated}, from 0 s on.")
        else:
            stamps, said, assumed = self._seconds(time, unit)
            findings += [said] if said else []
            title = f"the time {time.name}"
        blocks: list[AnyArray] = []
        labels: list[str] = []
        for array, columns in arrays:
            block, axis = self._rows_first(array, len(stamps), title)
            if axis:
                findings.append(f"{array.name} {list(array.shape)}: its axis {axis + 1} is time, as {title} is as long.")
            if spec.by_columns and block.ndim == 3:
                block = block.transpose(0, 2, 1)
            flat = block.reshape(len(block), -1)
            names = array.labels if len(array.labels) == flat.shape[1] else ("",) * flat.shape[1]
            blocks.append(flat[:, columns])
            labels += names[columns]
        values = np.column_stack(blocks) if len(blocks) > 1 else blocks[0]
        array = arrays[0][0]
        if values.shape[1] > VALUES_PER_ROW_MAX:
            raise InputError(
                f"{self.path}: a row of {array.name} has {values.shape[1]} values; expected at most {VALUES_PER_ROW_MAX}."
            )
        shape = self._shape_of_row(arrays, len(stamps), values.shape[1], spec)
        if stream is Stream.SKIN:
            findings.append(self._order_sentence(spec, shape, values.shape[1]))
        return StreamRows(stamps, values, array.frame, tuple(labels) if all(labels) else (), shape, tuple(findings), assumed)

    def _part(self, text: str, stream: Stream) -> tuple[NamedArray, slice]:
        """Find an array, and the columns of it that are read."""
        if text in self.file.arrays:
            return self._checked(self._named(text, f"the {stream.value}"), stream), slice(None)
        part = _PART_RE.fullmatch(text)
        if part is None or (part["only"] is None and part["begin"] is None):
            return self._checked(self._named(text, f"the {stream.value}"), stream), slice(None)
        array = self._checked(self._named(part["name"], f"the {stream.value}"), stream)
        if part["only"]:
            begin, end = int(part["only"]), int(part["only"]) + 1
        else:
            begin, end = int(part["begin"] or 0), int(part["end"]) if part["end"] else None
        width = prod(array.shape) // max(_long_axis(array.shape), 1)
        if begin >= (width if end is None else end) or (end is not None and end > width):
            raise InputError(f"{self.path}: a row of {array.name} has {plural(width, 'value')}; {text} is none of them.")
        return array, slice(begin, end)

    def _checked(self, array: NamedArray, stream: Stream) -> NamedArray:
        if prod(array.shape) == 0:
            raise InputError(f"{self.path}: {array.name} {list(array.shape)} is empty; it has {self.file.list_names()}.")
        if stream is Stream.SKIN and is_image(array):
            raise InputError(
                f"{self.path}: {array.name} {list(array.shape)} holds colour images of a camera: pixels are no taxels. Choose "
                "the array with one value a taxel."
            )
        return array

    def _rows_first(self, array: NamedArray, rows: int, title: str) -> tuple[AnyArray, int]:
        """Read an array and move its axis of time to the front; with the axis where that was."""
        axes = [axis for axis, size in enumerate(array.shape) if size == rows]
        if not axes:
            raise InputError(
                f"{self.path}: {array.name} {list(array.shape)} and {title} ({plural(rows, 'row')}) differ in length; expected "
                "one time a row: which belong together is unknown. Save them with equal lengths."
            )
        if len(axes) > 1:
            raise InputError(
                f"{self.path}: {array.name} {list(array.shape)} has {rows} along {len(axes)} axes; which of them is time is "
                "unknown. Save one more row of everything, or each row flat, (rows, values)."
            )
        values = np.asarray(self.file.read(array))
        return np.moveaxis(values, axes[0], 0), axes[0]

    def _shape_of_row(
        self, arrays: Sequence[tuple[NamedArray, slice]], rows: int, width: int, spec: ArraySpec
    ) -> tuple[int, ...]:
        array, columns = arrays[0]
        shape = list(array.shape)
        shape.remove(rows)
        if len(arrays) > 1 or columns != slice(None) or prod(shape) != width or len(shape) < 2:
            return (width,)
        return (*reversed(shape),) if spec.by_columns else tuple(shape)

    def _order_sentence(self, spec: ArraySpec, shape: tuple[int, ...], width: int) -> str:
        if len(shape) < 2:
            return f"{spec.text}: channel 0 is the first value of a row, channel {width - 1} the last."
        first = self.file.first_index
        indices = [first] * len(shape)
        indices[-1] += 1
        second = list(reversed(indices)) if spec.by_columns else indices
        how = "down the columns" if spec.by_columns else "along the rows"
        other = "?order=rows" if spec.by_columns else "?order=columns"
        return (
            f"{spec.text}: frames of {' x '.join(map(str, shape))} are counted {how}: channel 0 is {[first] * len(shape)}, "
            f"channel 1 is {second}; the other way is {spec.text}{other}."
        )

    # ---- tables

    def table(self, prefix: str = "") -> tuple[TableColumns, list[NamedArray], str] | None:
        """Read the arrays of one value a row as the columns of a table; `None` without.

        `prefix` begins their names. The last item is the group of all of them.
        """
        single = [
            each
            for each in self.file.arrays.values()
            if (each.is_number or each.is_time) and len(each.shape) <= 2 and prod(each.shape) == _long_axis(each.shape) > 1
        ]
        lengths = [prod(each.shape) for each in single if each.name.lower().startswith(prefix)]
        usual = max(set(lengths), key=lengths.count, default=0)
        columns = [each for each in single if prod(each.shape) == usual and each.name not in _BOOKKEEPING_NAMES]
        if lengths.count(usual) < 2:
            return None
        common = re.sub(r"[^./]*$", "", _common_begin([each.name for each in columns]))
        names = tuple(each.name.lower()[len(common) :] for each in columns)
        texts = tuple(zip(*(_examples(self.file, each) for each in columns), strict=True))
        # The time is chosen elsewhere: it may be a date, or a rate.
        names = (*("" if each.name in self.times else name for each, name in zip(columns, names, strict=True)), "t_s")
        form = TableForm(self.path, "", None, names, (), len(names), 0, tuple((*row, "0") for row in texts))
        return TableColumns(form), columns, common

    def _table_rows(self, stream: Stream, spec: ArraySpec, channels: int) -> StreamRows:
        prefix = spec.parts[0][:-1].lower()
        found = self.table(prefix)
        if found is None:
            begun = f" that begin with {prefix}" if prefix else ""
            raise InputError(f"{self.path}: has no columns{begun}; it has {self.file.list_names()}.")
        table, columns, common = found
        chosen = table.of_stream(stream, prefix.removeprefix(common.lower()), channels)
        first = columns[next(at for at in chosen.at if at >= 0)]
        time, unit = self._time_of(first, spec)
        if not isinstance(time, NamedArray):
            stamps, said, assumed = np.arange(prod(first.shape)) / time, f"no times: counted at {time:g} rows a second.", False
            title = f"the rate {time:g}"
        else:
            stamps, said, assumed = self._seconds(time, unit)
            title = f"the time {time.name}"
        if len(stamps) != prod(first.shape):
            self._rows_first(first, len(stamps), title)
        values = np.full((len(stamps), len(chosen.at)), np.nan)
        for place, (at, factor) in enumerate(zip(chosen.at, chosen.factors, strict=True)):
            if at >= 0:
                values[:, place] = np.asarray(self.file.read(columns[at])).ravel().astype(np.float64) * factor
        labels = tuple(columns[at].last_name if at >= 0 else "" for at in chosen.at)
        names = f"{first.name} to {columns[chosen.at[-1]].name}"
        findings = (f"columns {names}.", *([said] if said else []), *chosen.findings)
        return StreamRows(stamps, values, "", labels, (len(chosen.at),), findings, assumed)


def _common_begin(names: Sequence[str]) -> str:
    first, last = min(names), max(names)
    return next((first[:k] for k in range(len(first)) if k >= len(last) or first[k] != last[k]), first)


def is_image(array: NamedArray) -> bool:
    """Check whether an array holds colour images: (frames, height, width, 3 or 4), or the colours first."""
    shape = array.shape
    if len(shape) != 4 or array.kind not in "uif":
        return False
    return (shape[-1] in IMAGE_COLOURS and min(shape[1:3]) >= IMAGE_MIN_SIDE) or (
        shape[1] in IMAGE_COLOURS and min(shape[2:]) >= IMAGE_MIN_SIDE
    )


def _long_axis(shape: Sequence[int]) -> int:
    return max(shape, default=0)


def _single_rows(path: object, array: NamedArray) -> int:
    """Count the rows of an array without times: its longest axis.

    Raises InputError: two axes are as long.
    """
    longest = _long_axis(array.shape)
    if list(array.shape).count(longest) > 1:
        raise InputError(
            f"{path}: {array.name} {list(array.shape)} has two axes of {longest}; which of them is time is unknown. Name its "
            "times (--time NAME, or ?time=NAME after the array)."
        )
    return longest


def _examples(file: ArrayFile, array: NamedArray) -> list[str]:
    values = np.asarray(file.read(array)).ravel()[:EXAMPLE_ROWS]
    return ["0" if array.is_time else repr(float(each)) for each in values]


def wrench_factors(
    path: object, spec: ArraySpec, arrays: Mapping[str, NamedArray], labels: Sequence[str], width: int
) -> tuple[list[int], list[float], str]:
    """Order the six columns as fx to mz, and scale them to N and N m; with a sentence on what the file does not state.

    Raises InputError: there are not six columns, their names are no axes, or a unit is not known.
    """
    if width != WRENCH_VALUES:
        raise InputError(f"{path}: a row of {spec.text} has {plural(width, 'value')}; expected six, fx fy fz mx my mz.")
    known = [axis_of(label.lower()) for label in labels]
    axes = [each[0] if each else "" for each in known]
    order = list(range(WRENCH_VALUES))
    named = "read as fx fy fz mx my mz"
    if labels and sorted(axes) == sorted(WRENCH_AXES):
        order = [axes.index(axis) for axis in WRENCH_AXES]
        named = f"its values are {', '.join(labels)}"
    elif len(spec.parts) == 2 and _TORQUE_RE.search(spec.parts[0]) and _FORCE_RE.search(spec.parts[1]):
        order, named = [3, 4, 5, 0, 1, 2], f"{spec.parts[1]} is the force, {spec.parts[0]} the moment"
    label_units = [each[1] if each else "" for each in known] or [""] * WRENCH_VALUES
    stated = [plain_unit(each) for each in spec.unit.split(",")] if spec.unit else []
    if not stated and len(spec.parts) == 2 and order[0] == 0:
        stated = [plain_unit(arrays[part].unit) if part in arrays else "" for part in spec.parts]
    force = label_units[order[0]] or (stated[0] if stated else "")
    moment = label_units[order[3]] or (stated[-1] if stated and len(stated) > 1 else "")
    for unit, table in ((force, FORCE_UNITS), (moment, MOMENT_UNITS)):
        if unit and unit not in table:
            raise InputError(f"{path}: the unit {unit!r} of {spec.text} is not known; state one: {spec.text}:N,Nm.")
    factors = [FORCE_UNITS.get(force, 1.0)] * 3 + [MOMENT_UNITS.get(moment, 1.0)] * 3
    units = "" if force and moment else f", in N and N m, as the file states no unit (else: {spec.text}:N,Nmm)"
    return order, factors, f"{named}{units}"


def finite_times(stamps: FloatArray) -> NDArray[np.bool_]:
    """Select the rows that have a time, (n,)."""
    known = np.isfinite(stamps)
    near: NDArray[np.bool_] = np.abs(np.where(known, stamps, 0.0)) <= TIME_STAMP_MAX_S
    return known & near


def may_be(stream: Stream, array: NamedArray, width: int) -> int | None:
    """Rank an array for a stream by name and width: 0 named so, 1 to 2 by its width; `None` if it is none."""
    name = array.name
    axes = [axis_of(label.lower()) for label in array.labels]
    match stream:
        case Stream.WRENCH:
            if width != WRENCH_VALUES:
                return None
            if _WRENCH_RE.search(name) or (axes and all(axes)):
                return 0
            return None if _NO_WRENCH_RE.search(name) or _SKIN_RE.search(name) else 2
        case Stream.SKIN:
            if width < 2 or _WRENCH_RE.search(name) or (axes and all(axes)):
                return None
            return 0 if _SKIN_RE.search(name) else 3
        case Stream.TOOL:
            return 0 if width in (*POSE_WIDTHS, UPPER_ROWS_VALUES) and _POSE_RE.search(name) else None
        case _:
            return 0 if _JOINTS_RE.search(name) and width <= 32 and not _SKIN_RE.search(name) else None


def force_and_torque(names: Sequence[str], shapes: Mapping[str, tuple[int, ...]]) -> list[str]:
    """Pair arrays of a force and a torque in one group, as `force+torque`."""
    forces = [name for name in names if _FORCE_RE.search(name) and min(shapes[name]) == 3 and len(shapes[name]) == 2]
    found: list[str] = []
    for force in forces:
        torques = [
            name
            for name in names
            if _TORQUE_RE.search(name)
            and shapes[name] == shapes[force]
            and _FORCE_RE.sub("", force) == _TORQUE_RE.sub("", name)
        ]
        found += [f"{force}+{torque}" for torque in torques[:1]]
    return found


def is_bookkeeping(array: NamedArray) -> bool:
    """Check whether an array counts rows, episodes or tasks, or is a time."""
    return array.name in _BOOKKEEPING_NAMES or is_known_name(array.last_name.lower())
