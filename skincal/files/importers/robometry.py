"""Logs of robometry, the logger of today's iCub robots, as the chunks of a session; read by `h5py` (the extra `robometry`).

A log is a MATLAB file of version 7.3, which is HDF5. One group, such as `robot_logger_device`, holds all channels, nested by
`::` in their names: `FTs::l_arm_ft_sensor`, `joints_state::positions`. A channel has `data` and `timestamps` (s), in newer logs
also `elements_names` and `units_of_measure`. Text is an array of UTF-16 units; lists of texts are arrays of references to them.
Source: robotology/robometry `src/librobometry/src/BufferManager.cpp` and `src/telemetryDeviceDumper`; the reader of
ami-iit/robot-log-visualizer (`matfile_signal_provider.py`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from skincal.devices.decoding import WRENCH_VALUES
from skincal.files.importers.registry import RecordedPlace, StreamGuess
from skincal.files.importers.timeline import OpenRecording, Timeline, check_overlap, late_streams
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.given import open_regular
from skincal.model.pose_form import POSE_WIDTHS
from skincal.model.readings import Stream
from skincal.streams.decoders.records import pack_records
from skincal.streams.links import LinkSpec

MAT_7_3_MARK = b"MATLAB 7.3"
SEPARATOR_TEXT = "::"
"""Between the names of nested channels."""
CHANNEL_NAME_MAX_DEPTH = 8
LOG_CHANNELS_MAX = 5000
"""With the groups that hold them."""
ROWS_PER_CHANNEL_MAX = 50_000_000
"""Of a channel: a day at 500 Hz has 43 million."""
VALUES_PER_ROW_MAX = 100_000
"""Values of a channel in a row."""
ROWS_READ_AT_ONCE = 4096
RADIANS_ROOT = "robot_logger_device"
"""Group of YarpRobotLoggerDevice, whose angles are radians; telemetryDeviceDumper logs degrees."""
CHANNELS_LISTED_MAX = 8
UNPAIRED_ROWS_MAX = 10
"""Rows without a time, or times without a row, that a log may end with: its logger was stopped between the two..."""
UNPAIRED_MAX_SHARE = 0.05
"""...but no more than this share of them; one is always allowed."""
READ_ERRORS = (OSError, RuntimeError, MemoryError, OverflowError)
"""What h5py raises where a file is damaged."""
_SKIN_RE = re.compile(r"skin|tactile|taxel|touch", re.IGNORECASE)
_WRENCH_RE = re.compile(r"(?:^|::)(?:FTs?|force_?torque)", re.IGNORECASE)
_POSE_RE = re.compile(r"(?:^|::|_)(?:tool|tcp|ee|end_effector|hand)?_?(?:cartesian_)?pose(?:$|::)", re.IGNORECASE)
_POSITIONS_RE = re.compile(r"(?:^|::)joints?_state::(?:joint_)?positions$")


class _NoChannelsError(InputError):
    """A file of MATLAB is no log."""


@dataclass(frozen=True, slots=True)
class _Channel:
    """A channel of a log."""

    name: str
    group: str
    """Path of its group in the file."""
    rows: int
    """Rows that have a time."""
    data_rows: int
    """Rows of its data; 0 if it holds no numbers."""
    times: int
    """Number of its times."""
    width: int
    has_rows_first: bool
    """The first axis of the data is time, as the loggers write it; else the last one is."""
    elements: tuple[str, ...]
    """Names of its values; empty in older logs."""
    unit: str
    """Empty in older logs."""


def guess_streams(path: Path) -> list[StreamGuess]:
    """Guess the streams of the channels of a log by their names.

    Raises InputError: it cannot be read as a log of robometry.
    """
    channels, _ = _read_channels(path)
    guesses = [
        StreamGuess(RecordedPlace(path, name), stream, channel.width)
        for name, channel in channels.items()
        if channel.rows and (stream := _stream_of(channel)) is not None
    ]
    if not guesses:
        raise InputError(f"{path}: no channel of a force/torque sensor, skin or joints; it has {_list_names(channels)}.")
    return guesses


def is_log(path: Path) -> bool:
    """Check whether a MATLAB file has channels of robometry, with data and timestamps.

    One of version 7.3 that cannot be opened counts as a log: its sentence says why.
    """
    try:
        with open_regular(path) as file:
            if not file.read(len(MAT_7_3_MARK)).startswith(MAT_7_3_MARK):
                return False
        _read_channels(path)
    except _NoChannelsError:
        return False
    except InputError:
        return True
    return True


def _stream_of(channel: _Channel) -> Stream | None:
    if _SKIN_RE.search(channel.name):
        return Stream.SKIN
    if _POSITIONS_RE.search(channel.name):
        return Stream.JOINTS
    if channel.width == WRENCH_VALUES and _WRENCH_RE.search(channel.name):
        return Stream.WRENCH
    return Stream.TOOL if channel.width in POSE_WIDTHS and _POSE_RE.search(channel.name) else None


def _list_names(channels: Mapping[str, _Channel]) -> str:
    more = len(channels) - CHANNELS_LISTED_MAX
    return (", ".join(list(channels)[:CHANNELS_LISTED_MAX]) + (f" and {more} more" if more > 0 else "")) or "no channels"


def open_recording(
    places: Mapping[Stream, RecordedPlace], joints: Sequence[str] = (), go_on: Callable[[float], bool] = lambda _: True
) -> OpenRecording:
    """Read the times of the channels of a log.

    Parameters
    ----------
    joints : names of the columns of the joint stream, empty for an unused column; without them all joints of the log
    go_on : not called, since the times of hours are read in a moment

    Raises InputError: the log or a channel cannot be read, or does not fit the stream.
    """
    del go_on
    paths = {place.path for place in places.values()}
    if len(paths) > 1:
        raise InputError(f"The channels are of {len(paths)} logs; expected one log with all of them.")
    path = paths.pop()
    channels, root = _read_channels(path)
    links: list[LinkSpec] = []
    timelines: list[Timeline] = []
    sources: list[Callable[[], Iterator[Sequence[bytes]]]] = []
    findings: list[str] = []
    for stream, place in places.items():
        channel = _find_channel(path, channels, stream, place.topic)
        stamps = _read_stamps(path, channel)
        timeline = Timeline(stream.value, [stamps])
        columns, names = _columns(path, channel, stream, joints)
        factor, unit_finding = _factor(channel, stream, root)
        findings += [f"{stream.value}: channel {channel.name}.", *timeline.sentences()]
        findings += [f"{stream.value}: {sentence}" for sentence in (_unpaired(channel), names, unit_finding) if sentence]
        links.append(LinkSpec(stream.value, f"file:{path}::{channel.name}", (stream,), "records"))
        timelines.append(timeline)
        sources.append(partial(_lines, path, channel, stamps, columns, factor))
    check_overlap(timelines)
    findings += late_streams(timelines)
    return OpenRecording(tuple(links), tuple(timelines), tuple(sources), tuple(findings))


def _find_channel(path: Path, channels: Mapping[str, _Channel], stream: Stream, name: str) -> _Channel:
    if not name and stream is Stream.SKIN:
        raise InputError(
            f"{path}: the log has no channel of a skin; it has {_list_names(channels)}. Record the skin's port with "
            "yarpdatadumper, and the sensor as well, or name a channel that holds it."
        )
    if not name:
        raise InputError(f"{path}: the channel of the {stream.value} is not named; it has {_list_names(channels)}.")
    channel = channels.get(name)
    if channel is None:
        raise InputError(f"{path}: has no channel {name}; it has {_list_names(channels)}.")
    if not channel.data_rows or not channel.times:
        seen = "times" if channel.data_rows else "numbers"
        raise InputError(f"{path}: channel {name} has no {seen}; choose another channel: it has {_list_names(channels)}.")
    if not _can_be_paired(channel.data_rows, channel.times):
        raise InputError(
            f"{path}: channel {name} has {plural(channel.data_rows, 'row')} and {plural(channel.times, 'time')}; expected one "
            "time a row: which belong together is unknown. Record it again, or choose another channel."
        )
    if channel.rows > ROWS_PER_CHANNEL_MAX or channel.width > VALUES_PER_ROW_MAX:
        raise InputError(
            f"{path}: channel {name} announces {channel.rows} rows of {plural(channel.width, 'value')}; expected at most "
            f"{ROWS_PER_CHANNEL_MAX} rows of {VALUES_PER_ROW_MAX} values. The file is damaged, or no log."
        )
    if stream is Stream.WRENCH and channel.width != WRENCH_VALUES:
        raise InputError(f"{path}: channel {name} has {plural(channel.width, 'value')}; expected six, fx fy fz mx my mz.")
    return channel


def _can_be_paired(rows: int, times: int) -> bool:
    return abs(rows - times) <= max(1, min(UNPAIRED_ROWS_MAX, UNPAIRED_MAX_SHARE * min(rows, times)))


def _unpaired(channel: _Channel) -> str:
    """Compare the numbers of rows and times in a sentence; empty if they are equal."""
    if channel.data_rows == channel.times:
        return ""
    return (
        f"channel {channel.name} has {plural(channel.data_rows, 'row')} and {plural(channel.times, 'time')}; "
        f"the first {channel.rows} of both are read, and the rest is left out."
    )


def _columns(path: Path, channel: _Channel, stream: Stream, joints: Sequence[str]) -> tuple[list[int], str]:
    """Choose the columns of a channel, -1 for an unused joint, and describe them."""
    if stream is not Stream.JOINTS:
        return list(range(channel.width)), ""
    known = channel.elements if len(channel.elements) == channel.width else ()
    if not joints or not known:
        names = f"the order of the joints is {', '.join(known)}." if known else "its joints have no names: kept in their order."
        return list(range(channel.width)), names
    missing = [name for name in joints if name and name not in known]
    if missing:
        raise InputError(
            f"{path}: channel {channel.name} has no joint {', '.join(missing)}; "
            f"it has {', '.join(known[:CHANNELS_LISTED_MAX])}. Check the joint names of the scene."
        )
    return [known.index(name) if name else -1 for name in joints], ""


def _factor(channel: _Channel, stream: Stream, root: str) -> tuple[float, str]:
    """Return the factor from the unit of the channel to that of the records, and a sentence if the unit is assumed."""
    if stream is not Stream.JOINTS:
        return 1.0, ""
    unit = channel.unit.lower()
    is_radians = unit.startswith("rad") if unit else root == RADIANS_ROOT
    assumed = "" if unit else f"the log names no unit of the angles; {'radians' if is_radians else 'degrees'} were assumed."
    return float(np.degrees(1.0)) if is_radians else 1.0, assumed


def _read_stamps(path: Path, channel: _Channel) -> FloatArray:
    """Read the times of a channel, (rows,) seconds. Raises InputError: they cannot be read, or are no times."""
    with _open(path) as file:
        try:
            stamps = np.asarray(file[channel.group]["timestamps"], np.float64).ravel()[: channel.rows]
        except READ_ERRORS as error:
            raise InputError(f"{path}: the times of channel {channel.name} cannot be read ({error}).") from None
    if not np.isfinite(stamps).all():
        raise InputError(f"{path}: channel {channel.name} has times that are no numbers; choose another channel.")
    return stamps


def _lines(
    path: Path, channel: _Channel, stamps: FloatArray, columns: Sequence[int], factor: float
) -> Iterator[Sequence[bytes]]:
    """Yield blocks of records."""
    with _open(path) as file:
        data, rows = file[channel.group]["data"], channel.rows
        for begin in range(0, rows, ROWS_READ_AT_ONCE):
            end = min(begin + ROWS_READ_AT_ONCE, rows)
            try:
                block = data[begin:end] if channel.has_rows_first else np.moveaxis(data[..., begin:end], -1, 0)
            except READ_ERRORS as error:
                raise InputError(f"{path}: channel {channel.name} cannot be read ({error}); the file is damaged.") from None
            values = np.asarray(block, np.float64).reshape(end - begin, channel.width) * factor
            values = np.column_stack([values, np.zeros(end - begin)])[:, list(columns)]
            yield pack_records(np.arange(begin, end), stamps[begin:end], values)


# ------------------------------------------------------------------ file


def _open(path: Path) -> Any:
    """Open the file by `h5py`. Raises InputError: it is none of its files, or `h5py` is missing."""
    with open_regular(path, what="log") as file:
        head = file.read(32)
    try:
        import h5py  # pyright: ignore[reportMissingTypeStubs]
    except ImportError:
        raise InputError(
            "Logs of robometry are read by the package h5py, which is not installed; install it: "
            "python -m pip install 'skincal[robometry]' (or python3 start.py --robometry)"
        ) from None
    if head.startswith(b"MATLAB 5.0"):
        raise InputError(
            f"{path}: is a MATLAB file of version 5; expected version 7.3: set mat_file_version to v7_3 in the logger, or in "
            "MATLAB: s = load('FILE'); save('NEW', '-struct', 's', '-v7.3'). Matrices of your own are read by "
            "skincal import arrays."
        )
    try:
        return h5py.File(path, "r")
    except (OSError, RuntimeError) as error:
        why = " ".join(str(error).split()).rstrip(".")
        raise InputError(f"{path}: is no log of robometry, or is cut off ({why}); expected a .mat file, version 7.3.") from None


def _read_channels(path: Path) -> tuple[dict[str, _Channel], str]:
    """Read names and shapes of all channels, and the name of the group that holds them."""
    with _open(path) as file:
        try:
            roots = [name for name in file if name != "#refs#" and hasattr(file[name], "items")]
            root = RADIANS_ROOT if RADIANS_ROOT in roots else roots[0] if roots else ""
            found = [_channel(file, name, group) for name, group in (_walk(file[root]) if root else ())]
            channels = {channel.name: channel for channel in found}
            description = _texts(file, file[root].get("description_list")) if root else ()
        except (*READ_ERRORS, ArithmeticError, LookupError, ValueError, TypeError, AttributeError) as error:
            raise InputError(f"{path}: its channels cannot be read ({error}); the file is damaged.") from None
    if not channels:
        raise _NoChannelsError(f"{path}: has no channel with data and timestamps; expected a log of robometry.")
    for name, channel in channels.items():
        if _POSITIONS_RE.search(name) and not channel.elements:
            # Older logs have the names of the joints once for all channels.
            channels[name] = replace(channel, elements=description)
    return channels, root


def _walk(root: Any) -> Iterator[tuple[str, Any]]:
    """Yield name and group of each channel. A group counts once, and links are left out: they may lead back."""
    import h5py  # pyright: ignore[reportMissingTypeStubs]

    h5: Any = h5py

    waiting: list[tuple[str, Any, int]] = [("", root, 0)]
    seen, members = set[int](), 0
    while waiting:
        prefix, group, depth = waiting.pop()
        address: int = h5.h5o.get_info(group.id).addr
        if address in seen:
            continue
        seen.add(address)
        if "data" in group and "timestamps" in group:
            yield prefix, group
            continue
        inner: list[tuple[str, Any, int]] = []
        for name in group if depth <= CHANNEL_NAME_MAX_DEPTH else ():
            members += 1
            if members > LOG_CHANNELS_MAX:
                raise ValueError(f"more than {LOG_CHANNELS_MAX} groups and arrays")
            if isinstance(group.get(name, getlink=True), h5.HardLink) and hasattr(group[name], "items"):
                inner.append((f"{prefix}{SEPARATOR_TEXT}{name}" if prefix else name, group[name], depth + 1))
        waiting += reversed(inner)


def _channel(file: Any, name: str, group: Any) -> _Channel:
    """Describe a channel. The axis of time is the last one if that alone is as long as the times, else the first."""
    data, times = group["data"], int(getattr(group["timestamps"], "size", 0) or 0)
    names, units = _texts(file, group.get("elements_names")), _texts(file, group.get("units_of_measure"))
    unit = units[0] if units else ""
    shape: tuple[int, ...] = getattr(data, "shape", None) or ()
    if not shape or not data.size or data.dtype.kind not in "iuf":
        return _Channel(name, group.name, 0, 0, times, 0, has_rows_first=True, elements=names, unit=unit)
    fits_last = shape[-1] == times != shape[0] or (_can_be_paired(shape[-1], times) and not _can_be_paired(shape[0], times))
    has_rows_first = not fits_last
    data_rows = shape[0] if has_rows_first else shape[-1]
    rows = min(data_rows, times)
    return _Channel(name, group.name, rows, data_rows, times, data.size // data_rows, has_rows_first, names, unit)


def _texts(file: Any, dataset: Any) -> tuple[str, ...]:
    """Read a list of texts, which are references; empty if there is none."""
    if dataset is None or not hasattr(dataset, "dtype") or dataset.dtype.kind != "O":
        return ()
    return tuple("".join(map(chr, np.asarray(file[reference]).ravel().tolist())) for reference in np.asarray(dataset).ravel())
