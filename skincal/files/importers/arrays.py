"""Recordings as named arrays: `wrench` (n, 6), `tactile` (n, taxels) or (n, rows, columns), and their times.

`array_file` lists the arrays of a container, `array_streams` chooses among them. Each row becomes a record. Text tables and
workbooks are read as tables (`csv_log`): their columns have names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from math import prod
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skincal.devices.column_names import plain_unit
from skincal.devices.decoding import WRENCH_VALUES
from skincal.devices.pose_names import NO_POSE_NAMES, PoseNames
from skincal.files.importers.array_file import AnyArray, ArrayFile, NamedArray, open_array_file
from skincal.files.importers.array_streams import (
    FEW_ROWS,
    ArraySpec,
    ArrayStreams,
    StreamRows,
    finite_times,
    force_and_torque,
    is_bookkeeping,
    is_image,
    may_be,
    wrench_factors,
)
from skincal.files.importers.registry import RANK_OF_GUESS_BY_CHANNELS, RecordedPlace, StreamGuess
from skincal.files.importers.table_columns import joint_unit
from skincal.files.importers.text_frames import is_text_frames
from skincal.files.importers.timeline import (
    OpenRecording,
    Timeline,
    check_assumed_seconds,
    check_overlap,
    late_streams,
)
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.pose_form import POSE_WIDTHS
from skincal.model.readings import Stream
from skincal.streams.decoders.records import pack_frame, pack_records
from skincal.streams.links import LinkSpec

ROWS_PACKED_AT_ONCE = 4096
_CLAIMED_SUFFIXES = (".txt", ".csv", ".tsv", ".asc")


def claims(path: Path) -> bool:
    """Check by its content whether a file that is named as another importer's is one of arrays."""
    suffix = path.suffix.lower()
    if suffix == ".mat":
        return not _is_robometry(path)
    return suffix in _CLAIMED_SUFFIXES and path.is_file() and is_text_frames(path)


def _is_robometry(path: Path) -> bool:
    """Check whether a MATLAB file is a log of robometry: version 7.3, with a group of data and timestamps."""
    from skincal.files.importers.robometry import is_log

    return is_log(path)


def guess_streams(path: Path) -> list[StreamGuess]:
    """Guess the streams of the arrays of a file by their names, shapes and labels.

    Raises InputError: it cannot be read, or no array may be a wrench, a skin or joints.
    """
    file = open_array_file(path)
    streams = ArrayStreams(file)
    guesses = [each for array in file.arrays.values() for each in _guesses_of(file.path, streams, array)]
    shapes = {name: each.shape for name, each in file.arrays.items() if each.is_number and prod(each.shape)}
    pairs = force_and_torque(list(shapes), shapes)
    guesses += [StreamGuess(RecordedPlace(file.path, text), Stream.WRENCH, WRENCH_VALUES) for text in pairs]
    guesses += _table_guesses(streams)
    if not guesses:
        images = [f"{name} {why}" for name, why in file.details.items()]
        why = f" {'. '.join(images)}." if images else ""
        raise InputError(f"{path}: no array may be a wrench or a skin; it has {file.list_names()}.{why}")
    return guesses


def _guesses_of(path: Path, streams: ArrayStreams, array: NamedArray) -> list[StreamGuess]:
    if not array.is_number or array.name in streams.times or is_bookkeeping(array) or is_image(array):
        return []
    times = {prod(each.shape) for each in streams.times_for(array)} & {*array.shape}
    rows = max(times or {*array.shape}, default=0)
    if rows < FEW_ROWS or len(array.shape) < 2:
        return []
    width = prod(array.shape) // rows
    found = [
        StreamGuess(RecordedPlace(path, array.name), stream, width, array.labels if stream is Stream.JOINTS else (), rank)
        for stream in Stream
        if (rank := may_be(stream, array, width)) is not None
    ]
    # A name says more than a width.
    best = min((each.rank for each in found), default=0)
    return [each for each in found if each.rank == best or each.rank >= RANK_OF_GUESS_BY_CHANNELS]


def _table_guesses(streams: ArrayStreams) -> list[StreamGuess]:
    """Guess the streams of arrays that are the columns of a table."""
    try:
        found = streams.table()
    except InputError:
        return []
    if found is None:
        return []
    table, path, group = found[0], streams.path, found[2]
    guesses: list[StreamGuess] = []
    poses = (Stream.TOOL,) if len(table.named_pose) in POSE_WIDTHS else ()
    for stream in (Stream.WRENCH, Stream.JOINTS, *poses):
        try:
            chosen = table.of_stream(stream, "", 0)
        except InputError:
            continue
        guesses.append(StreamGuess(RecordedPlace(path, f"{group}*"), stream, len(chosen.at)))
    return guesses + [
        StreamGuess(RecordedPlace(path, f"{group}{base}*"), Stream.SKIN, width) for base, width in table.skin_families()
    ]


def open_recording(
    places: Mapping[Stream, RecordedPlace],
    joints: Sequence[str] = (),
    go_on: Callable[[float], bool] = lambda _: True,
    channels: int = 0,
) -> OpenRecording:
    """Read the arrays of the streams of a recording.

    Parameters
    ----------
    joints : names of the columns of the joint stream, empty for an unused column; without them all joints
    go_on : not called, since arrays are read at once
    channels : of the skin; 0 if unknown

    Raises InputError: an array cannot be read, or does not fit the stream; or times, units or axes are not clear.
    """
    del go_on
    files: dict[tuple[Path, int | None], ArrayFile] = {}
    links: list[LinkSpec] = []
    timelines: list[Timeline] = []
    sources: list[Callable[[], Iterator[Sequence[bytes]]]] = []
    findings: list[str] = []
    frame_shape: tuple[int, ...] = ()
    pose_names = NO_POSE_NAMES
    for stream, place in places.items():
        if not place.topic:
            file = files.get((place.path, None)) or open_array_file(place.path)
            raise InputError(f"{place.path}: the array of the {stream.value} is not named; it has {file.list_names()}.")
        spec = ArraySpec.parse(place.topic)
        key = (place.path, spec.episode)
        if key not in files:
            files[key] = open_array_file(*key)
            findings += files[key].findings
        file = files[key]
        rows = ArrayStreams(file).rows_of(stream, spec, channels)
        values, said = _values(file, stream, spec, rows, joints)
        stamps, values, left_out = _readable(rows, values)
        timeline = Timeline(stream.value, [stamps])
        if not timeline.lines:
            raise InputError(f"{file.path}: no row of {spec.text} has a time and a value; choose another array.")
        if rows.time_unit_assumed:
            check_assumed_seconds(file.path, stream, timeline.interval, "state the unit: --time NAME:ms, NAME:us or NAME:ns")
        findings += [*timeline.sentences(), *(f"{stream.value}: {each}" for each in (*said, *rows.findings, *left_out))]
        frame_shape = rows.shape if stream is Stream.SKIN and len(rows.shape) == 2 else frame_shape
        pose_names = _pose_names(file, spec, rows) if stream is Stream.TOOL else pose_names
        links.append(LinkSpec(stream.value, f"file:{file.path}::{spec.text}", (stream,), "records"))
        timelines.append(timeline)
        sources.append(partial(_lines, stamps, values, rows.frame if stream is Stream.WRENCH else ""))
    check_overlap(timelines)
    findings += late_streams(timelines)
    return OpenRecording(tuple(links), tuple(timelines), tuple(sources), tuple(findings), frame_shape, pose_names)


def _values(
    file: ArrayFile, stream: Stream, spec: ArraySpec, rows: StreamRows, joints: Sequence[str]
) -> tuple[AnyArray, list[str]]:
    """Bring the values of a stream into the order and units of the records; with sentences."""
    if stream is Stream.SKIN:
        return rows.values, []
    if stream is Stream.TOOL:
        return _pose_values(file, spec, rows)
    is_table = spec.parts[0].endswith("*")
    if stream is Stream.WRENCH:
        said = "in N and N m, unless the names of the columns state other units"
        values = rows.values
        if not is_table:
            order, factors, said = wrench_factors(file.path, spec, file.arrays, rows.labels, rows.values.shape[1])
            values = rows.values[:, order].astype(np.float64) * factors
        frame = f"frame {rows.frame}" if rows.frame else "no frame and no sign are stated: those of the scene's sensor hold"
        return values, [f"{spec.text}: {said}; {frame}."]
    values, unit = rows.values.astype(np.float64), "deg" if is_table else ""
    unit = unit or _angle_unit(file, spec, rows)
    values = values * (float(np.degrees(1.0)) if unit == "rad" else 1.0)
    if not joints or not rows.labels:
        order = f"the joints are {', '.join(rows.labels)}" if rows.labels else "the joints have no names: kept in their order"
        return values, [f"{spec.text}: {order}; {unit}."]
    names = [label.partition(".")[0] if label not in joints else label for label in rows.labels]
    missing = [name for name in joints if name and name not in names]
    if missing:
        raise InputError(
            f"{file.path}: {spec.text} has no joint {', '.join(missing)}; it has {', '.join(rows.labels[:8])}. Check the joint "
            "names of the scene."
        )
    columns = [names.index(name) if name else -1 for name in joints]
    return np.column_stack([values, np.zeros(len(values))])[:, columns], [f"{spec.text}: {unit}."]


def _pose_values(file: ArrayFile, spec: ArraySpec, rows: StreamRows) -> tuple[AnyArray, list[str]]:
    """Return the numbers of poses in the order of `[tool]`, with a sentence. Raises InputError: their width is of no form."""
    values, width = rows.values.astype(np.float64), rows.values.shape[1]
    if rows.shape == (3, 4):
        values = np.column_stack([values, np.broadcast_to((0.0, 0.0, 0.0, 1.0), (len(values), 4))])
        return values, [f'{spec.text}: poses of 3 x 4, row by row; [tool] needs rotation = "4x4".']
    if width not in POSE_WIDTHS:
        raise InputError(
            f"{file.path}: a row of {spec.text} has {width} values; expected a pose: x y z and the rotation (6, 7 or 12 "
            "values), or a matrix of 3 x 4 or 4 x 4."
        )
    if rows.shape == (4, 4):
        return values, [f'{spec.text}: poses of 4 x 4, row by row; [tool] needs rotation = "4x4", or "4x4-columns".']
    return values, [f"{spec.text}: poses of {width} values, in the form of [tool]: the file does not state one."]


def _pose_names(file: ArrayFile, spec: ArraySpec, rows: StreamRows) -> PoseNames:
    """Read what the labels state on a pose. Raises InputError: they are no pose."""
    found = PoseNames.read([label.lower() for label in rows.labels])
    if found.mistake is not None:
        raise InputError(
            f"{file.path}: the values of {spec.text} are {', '.join(rows.labels)}, {found.mistake.finding}; "
            f"{found.mistake.advice}."
        )
    return found


def _angle_unit(file: ArrayFile, spec: ArraySpec, rows: StreamRows) -> str:
    """Find the unit of angles. Raises InputError: nothing states it."""
    array = file.arrays.get(spec.parts[0].partition("[")[0])
    units = [plain_unit(each) for each in (spec.unit, array.unit if array else "")]
    for unit in units:
        if unit.startswith(("rad", "deg")):
            return unit[:3]
    for name in (spec.parts[0], *rows.labels[:1]):
        if unit := joint_unit(name.lower()):
            return unit
    raise InputError(
        f"{file.path}: the file does not state the unit of the angles {spec.text}; state it: {spec.text}:rad or "
        f"{spec.text}:deg. Without an arm, or with a fixed arm pose, leave the joints out."
    )


def _readable(rows: StreamRows, values: AnyArray) -> tuple[FloatArray, AnyArray, list[str]]:
    """Leave out rows without a time, or without any value; count both in sentences."""
    has_time = finite_times(rows.stamps)
    has_value: NDArray[np.bool_] = np.ones(len(values), np.bool_)
    if values.dtype.kind == "f":
        has_value = ~np.asarray(np.isnan(values).all(axis=1), np.bool_)
    keep = has_time & has_value
    said: list[str] = []
    if not has_time.all():
        said.append(f"{plural(int(np.count_nonzero(~has_time)), 'row')} without a time: left out.")
    if (empty := int(np.count_nonzero(has_time & ~has_value))) > 0:
        said.append(f"{plural(empty, 'row')} without its values: not counted as lost.")
    return rows.stamps[keep], values[keep], said


def _lines(stamps: FloatArray, values: AnyArray, frame: str) -> Iterator[Sequence[bytes]]:
    """Yield blocks of records."""
    for begin in range(0, len(values), ROWS_PACKED_AT_ONCE):
        block = np.asarray(values[begin : begin + ROWS_PACKED_AT_ONCE], np.float64)
        end = begin + len(block)
        records = pack_records(np.arange(begin, end), stamps[begin:end], block)
        if frame and not begin:
            records[0] = pack_frame(frame) + records[0]
        yield records
