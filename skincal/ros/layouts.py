"""Readings of many messages at once, from the offsets of their numbers in the bytes.

Messages of a topic mostly differ in their numbers alone: names, frame and lengths of arrays stay the same, and so do all
offsets. `find_layout` reads the offsets from one message. `MessageLayout.read` takes messages of the same length whose texts
and array lengths are those of that message, and refuses all others. Values and stamps are those of `MessageReader`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.ros.messages import FIELD_PATH_MAX_DEPTH, LAYOUT_TYPE, MessageReader
from skincal.ros.types import Field, MessageError, MessageTypes

NUMBER_SIZES = {f"{sign}int{8 * size}": size for sign in ("", "u") for size in (1, 2, 4, 8)} | {"float32": 4, "float64": 8}
"""Bytes of the numbers that a layout can read, by type."""
OTHER_SIZES = {"bool": 1, "byte": 1, "octet": 1, "char": 1}
"""Bytes of types that a layout can only skip."""
CDR_HEAD_BYTES = 4
"""Of the encapsulation, from whose end numbers are aligned; its second byte is 1 for little-endian."""


LAYOUT_SEARCH_MIN_MESSAGES = 8
"""For fewer, finding a layout takes longer than reading them one by one."""
FAILED_LAYOUT_SEARCHES_BEFORE_GIVING_UP = 20
"""Searches for a layout in a row that helped one run each: then the messages of a topic differ too often."""


class _LayoutError(ValueError):
    """The offsets of a message are not found."""


@dataclass(slots=True)
class _Walk:
    """A walk through the bytes of a message by the definition of its type."""

    types: MessageTypes
    data: bytes
    at: int
    order: str
    is_fixed: NDArray[np.bool_]
    """(bytes,) bool: encapsulation, texts and lengths of arrays, on which the offsets depend."""
    kinds: dict[int, str]
    """Type of the number at each offset; missing for types that are only skipped."""

    def message(self, type_name: str, depth: int = 0) -> dict[str, Any]:
        """Build the message with the offset of each number in place of its value."""
        if depth > FIELD_PATH_MAX_DEPTH:
            raise _LayoutError
        start = self.at
        found = {field.name: self._field(field, depth) for field in self.types.fields_of(type_name)}
        if type_name == LAYOUT_TYPE:
            self.is_fixed[start : self.at] = True
        return found

    def _field(self, field: Field, depth: int) -> Any:
        count = (field.length or self._fix_length()) if field.is_array else 1
        if field.kind == "number":
            offsets = self._numbers(field.type_name, count)
            return offsets if field.is_array else float(offsets[0])
        if count > len(self.data):
            raise _LayoutError
        found = [self._text(field) if field.kind == "text" else self.message(field.type_name, depth + 1) for _ in range(count)]
        return found if field.is_array else found[0]

    def _numbers(self, kind: str, count: int) -> FloatArray:
        size = NUMBER_SIZES.get(kind) or OTHER_SIZES.get(kind)
        if size is None:
            raise _LayoutError
        if count:
            self._align(size)
        first, self.at = self.at, self.at + count * size
        if self.at > len(self.data):
            raise _LayoutError
        offsets = np.arange(first, self.at, size)
        if kind in NUMBER_SIZES:
            self.kinds.update(dict.fromkeys(offsets.tolist(), kind))
        return offsets.astype(np.float64)

    def _text(self, field: Field) -> str:
        if field.type_name != "string":
            raise _LayoutError
        size, first = self._fix_length(), self.at
        self.at += size
        self.is_fixed[first : self.at] = True
        return bytes(self.data[first : self.at]).rstrip(b"\0").decode()

    def _fix_length(self) -> int:
        self._align(4)
        (length,) = struct.unpack_from(f"{self.order}I", self.data, self.at)
        self.is_fixed[self.at : self.at + 4] = True
        self.at += 4
        return length

    def _align(self, size: int) -> None:
        # The serialisation of ROS 1 has no padding.
        if self.types.ros == 2:
            self.at += -(self.at - CDR_HEAD_BYTES) % size


@dataclass(frozen=True, slots=True, eq=False)
class _Column:
    """Numbers of one type in the bytes of a message."""

    dtype: np.dtype[Any]
    bytes_at: slice | NDArray[np.intp]

    @staticmethod
    def at_offsets(offsets: FloatArray, walk: _Walk) -> _Column:
        """Describe the numbers at (n,) offsets. Raises _LayoutError: they are none, of several types, or of a skipped one."""
        places = offsets.astype(np.intp)
        kinds = {walk.kinds.get(place, "") for place in places.tolist()}
        kind = kinds.pop() if len(kinds) == 1 else ""
        if not kind:
            raise _LayoutError
        dtype = np.dtype(walk.order + np.dtype(kind).str[1:])
        if (np.diff(places) == dtype.itemsize).all():
            return _Column(dtype, slice(int(places[0]), int(places[-1]) + dtype.itemsize))
        return _Column(dtype, (places[:, None] + np.arange(dtype.itemsize)).ravel())

    def read(self, rows: NDArray[np.uint8]) -> FloatArray:
        """Read the numbers of (n, bytes) messages, (n, numbers)."""
        return np.ascontiguousarray(rows[:, self.bytes_at]).view(self.dtype).astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class MessageLayout:
    """Offsets in messages of one type, whose texts and lengths of arrays are those of one message."""

    reader: MessageReader
    size: int
    """Bytes of a message."""
    names: tuple[str, ...]
    """Of the joints of a `JointState`."""
    fixed_at: NDArray[np.intp]
    fixed: NDArray[np.uint8]
    """Bytes at `fixed_at`, which must be the same in every message."""
    values: _Column
    stamps: tuple[_Column, ...]
    """Seconds and nanoseconds, seconds alone, or none."""
    frame: str
    """Frame that the messages name; empty for none."""

    def read(self, messages: Sequence[bytes], arrivals_s: FloatArray | None = None) -> tuple[FloatArray, FloatArray] | None:
        """Read the (n, width) values and (n,) stamps of messages; NaN for no stamp. `None`: one has another layout.

        `arrivals_s` is (n,) float, s of one clock, if it is known.
        """
        rows = self._rows(messages)
        if rows is None:
            return None
        stamps = self._stamps(rows)
        return self.reader.rows_of(self.values.read(rows), self.names, stamps if arrivals_s is None else arrivals_s), stamps

    def _rows(self, messages: Sequence[bytes]) -> NDArray[np.uint8] | None:
        if any(len(each) != self.size for each in messages):
            return None
        rows = np.frombuffer(b"".join(messages), np.uint8).reshape(len(messages), self.size)
        return rows if (rows[:, self.fixed_at] == self.fixed).all() else None

    def _stamps(self, rows: NDArray[np.uint8]) -> FloatArray:
        if not self.stamps:
            return np.full(len(rows), np.nan)
        seconds = self.stamps[0].read(rows)[:, 0]
        if len(self.stamps) > 1:
            seconds += 1e-9 * self.stamps[1].read(rows)[:, 0]
        return np.where((seconds > 0) & np.isfinite(seconds), seconds, np.nan)

    def agrees(self, types: MessageTypes, data: bytes) -> bool:
        """Check the offsets: numbers that are written there must be those that `rosbags` reads."""
        probe = np.frombuffer(data, np.uint8).copy()
        for column in (self.values, *self.stamps):
            count = len(probe[column.bytes_at]) // column.dtype.itemsize
            probe[column.bytes_at] = (np.arange(count) % 100 + 1).astype(column.dtype).view(np.uint8)
        message, rows = types.decode(probe.tobytes(), self.reader.type_name), probe[None]
        stamp = self.reader.stamp_of(message)
        return np.array_equal(self.values.read(rows)[0], self.reader.numbers_of(message)) and np.array_equal(
            self._stamps(rows)[0], np.nan if stamp is None else stamp, equal_nan=True
        )


def find_layout(types: MessageTypes, reader: MessageReader, data: bytes, arrival_s: float = math.nan) -> MessageLayout | None:
    """Find the layout of a message; `reader` reads it. `None` if it has no values, or its offsets are not sure."""
    try:
        # The first message decides on the field of XELA's sensors, and on the order of joints.
        message = types.decode(data, reader.type_name)
        if reader.is_shaped or reader.values_of(message, arrival_s) is None:
            return None
        if reader.elements_of(message, len(reader.numbers_of(message))) is not None:
            return None
    except MessageError:
        return None
    order = "<" if types.ros == 1 or data[1] else ">"
    start = CDR_HEAD_BYTES if types.ros == 2 else 0
    walk = _Walk(types, data, start, order, np.zeros(len(data), np.bool_), {})
    walk.is_fixed[:start] = True
    try:
        shape = walk.message(reader.type_name)
        names = tuple(shape["name"]) if reader.by_name else ()
        offsets = reader.numbers_of(shape)
        if names and len(names) != len(offsets):
            return None
        stamp = reader.find_stamp(shape)
        parts = [stamp] if isinstance(stamp, float) else [] if stamp is None else [stamp["sec"], stamp["nanosec"]]
        stamps = tuple(_Column.at_offsets(np.array([each]), walk) for each in parts)
        fixed_at = np.flatnonzero(walk.is_fixed)
        fixed = np.frombuffer(data, np.uint8)[fixed_at]
        column, frame = _Column.at_offsets(offsets, walk), reader.frame_of(message)
        layout = MessageLayout(reader, len(data), names, fixed_at, fixed, column, stamps, frame)
        return layout if layout.agrees(types, data) else None
    except (_LayoutError, MessageError, InputError, struct.error, UnicodeDecodeError, KeyError, TypeError):
        return None


class RunReader:
    """Reads runs of messages of one topic at once, by the layout of the run before.

    Parameters
    ----------
    reader : reads single messages of the topic
    """

    def __init__(self, types: MessageTypes, reader: MessageReader) -> None:
        self._types, self._reader = types, reader
        self._layout: MessageLayout | None = None
        self._searches_left = FAILED_LAYOUT_SEARCHES_BEFORE_GIVING_UP

    @property
    def frame(self) -> str:
        """Frame that the messages of the last run name; empty for none."""
        return self._layout.frame if self._layout is not None else ""

    def read(self, messages: Sequence[bytes], arrivals_s: FloatArray | None = None) -> tuple[FloatArray, FloatArray] | None:
        """Read (n, width) values and (n,) stamps, NaN for no stamp. `None`: few messages, or they have not one layout.

        `arrivals_s` is as for `MessageLayout.read`.
        """
        if len(messages) < LAYOUT_SEARCH_MIN_MESSAGES:
            return None
        found = self._layout.read(messages, arrivals_s) if self._layout is not None else None
        if found is not None:
            self._searches_left = FAILED_LAYOUT_SEARCHES_BEFORE_GIVING_UP
        elif self._searches_left:
            self._searches_left -= 1
            first_s = math.nan if arrivals_s is None else float(arrivals_s[0])
            self._layout = find_layout(self._types, self._reader, messages[0], first_s)
            found = self._layout.read(messages, arrivals_s) if self._layout is not None else None
        return found
