"""Readings as binary records: what importers make of recordings whose messages are binary, such as bags of ROS.

A record is a packet (`skincal.devices.decoding.pack`) of kind 1 or 2, little-endian; one of kind 3 is text, the name of the
frame of the wrenches that follow:

    number     int64
    time       float64, seconds
    values     float64 (kind 1) or float32 (kind 2); joint angles in degrees

Kind 4 is a pose of a tool, float64: x y z in metres and the quaternion x y z w. The form of the scene is not used for it.

Records of one width are made and read many at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from itertools import accumulate
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from skincal.devices.decoding import (
    PACKET_HEAD,
    SEQ_MAX,
    TIME_STAMP_MAX_S,
    WRENCH_VALUES,
    FrameDecoder,
    FrameSplitter,
    pack,
    packet_splitter,
)
from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError
from skincal.model.readings import Batch, Loss, Stream

RECORD_MAX_BYTES = 1 << 20
"""Of the values of a record: 131,000 channels."""
FRAME_KIND, POSE_KIND = 3, 4
KIND_DTYPES = {1: "<f8", 2: "<f4", POSE_KIND: "<f8"}
FRAME_NAME_MAX_BYTES = 200
_HEAD_FIELDS = [("kind", "u1"), ("size", "<u4"), ("number", "<i8"), ("seconds", "<f8")]
_STAMP_BYTES = 16
"""Of number and time, with which the payload of a packet begins."""


def record_dtype(kind: int, width: int) -> np.dtype[np.void]:
    """Describe a record of `width` values in memory."""
    return np.dtype([*_HEAD_FIELDS, ("values", KIND_DTYPES[kind], (width,))])


def pack_frame(name: str) -> bytes:
    """Make the packet that names the frame of the wrenches after it; a long name is cut."""
    return pack(FRAME_KIND, name.encode()[:FRAME_NAME_MAX_BYTES])


def pack_records(numbers: IntArray, seconds: FloatArray, values: NDArray[Any], kind: int = 0) -> list[bytes]:
    """Make n records of (n,) numbers, (n,) times and (n, width) values, float64 or float32; `kind` 0 is that of the values."""
    kind = kind or (2 if values.dtype == np.float32 else 1)
    records = np.empty(len(values), record_dtype(kind, values.shape[1]))
    records["kind"], records["size"] = kind, records.itemsize - PACKET_HEAD.size
    records["number"], records["seconds"], records["values"] = numbers, seconds, values
    data, size = records.tobytes(), records.itemsize
    return [data[at : at + size] for at in range(0, len(data), size)]


class RecordsDecoder(FrameDecoder):
    """Decode binary records of one stream."""

    name: ClassVar[str] = "records"
    starts_whole: ClassVar[bool] = True
    single_stream: ClassVar[bool] = True
    names_frames: ClassVar[bool] = True

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        if len(carries) != 1:
            raise InputError("Imported records carry one stream; expected one source each for wrench, skin and joints.")
        self._stream = carries[0]
        self._frame = ""
        """Frame of the wrenches that follow; empty for none."""

    def _make_splitter(self) -> FrameSplitter:
        self._packets = packet_splitter(RECORD_MAX_BYTES)
        return self._packets

    def feed(self, data: bytes) -> list[Batch]:
        """Take the next bytes of the link and return the readings that they complete."""
        records = self._records(data)
        if records is None:
            return super().feed(data)
        self._count_missing(self._gaps.missing_among(records["number"]))
        found = self._batch_of_records(records)
        return [] if found is None else [found]

    def feed_many(self, chunks: Sequence[bytes]) -> tuple[Batch, list[int]] | None:
        """Decode chunks of whole records of one width with finite values, none missing. Else take nothing."""
        records, gaps = self._records(b"".join(chunks)), copy(self._gaps)
        if records is None or not np.isfinite(records["values"]).all() or gaps.missing_among(records["number"]):
            return None
        if any(len(chunk) % records.itemsize for chunk in chunks):
            return None
        if self._stream is Stream.WRENCH and self.wrench_frames.to_sensor(self._frame, np.empty((0, WRENCH_VALUES))) is None:
            return None
        found = self._batch_of_records(records)
        if found is None:
            return None
        self._gaps = gaps
        return found, list(accumulate(len(chunk) // records.itemsize for chunk in chunks))

    def _records(self, data: bytes) -> NDArray[Any] | None:
        """Read whole records of one width; `None` if the bytes are anything else."""
        if self._packets.has_partial_frame or len(data) < PACKET_HEAD.size + _STAMP_BYTES:
            return None
        kind, size = PACKET_HEAD.unpack_from(data)
        if kind not in KIND_DTYPES or not _STAMP_BYTES < size <= RECORD_MAX_BYTES:
            return None
        width, rest = divmod(size - _STAMP_BYTES, np.dtype(KIND_DTYPES[kind]).itemsize)
        if kind == POSE_KIND:
            self._define_poses()
        if rest or len(data) % (PACKET_HEAD.size + size) or not self._has_width(self._stream, width):
            return None
        records = np.frombuffer(data, record_dtype(kind, width))
        if (records["kind"] != kind).any() or (records["size"] != size).any() or not _in_range(records):
            return None
        self._widths[self._stream] = width
        return records

    def _define_poses(self) -> None:
        """Read poses as metres and quaternion x y z w from here on."""
        from skincal.model.pose_form import PoseForm, RotationForm  # only records of poses need it

        if self._stream is Stream.TOOL:
            self.define_pose_form(PoseForm(RotationForm.QUATERNION_XYZW), 1.0)

    def _batch_of_records(self, records: NDArray[Any]) -> Batch | None:
        """Return the readings as a batch; `None` if they are left out, since their frame is another one."""
        seconds, values = records["seconds"].astype(np.float64), records["values"].astype(np.float64)
        if self._stream is Stream.WRENCH:
            known = self._wrenches_from(self._frame, values)
            if known is None:
                return None
            values = known
        self.valid_records += len(records)
        return self._batch(self._stream, records["number"].astype(np.int64), seconds, values)

    def _decode(self, frame: bytes) -> Loss | None:
        if frame[0] == FRAME_KIND:
            self._frame = frame[1:].decode(errors="replace")
            return None
        values_type = KIND_DTYPES.get(frame[0])
        if frame[0] == POSE_KIND:
            self._define_poses()
        if values_type is None or len(frame) <= _STAMP_BYTES:
            return Loss.UNREADABLE
        width, rest = divmod(len(frame) - 1 - _STAMP_BYTES, np.dtype(values_type).itemsize)
        if rest:
            return Loss.UNREADABLE
        record = np.frombuffer(frame[1:], [*_HEAD_FIELDS[2:], ("values", values_type, (width,))])
        if not _in_range(record):
            return Loss.UNREADABLE
        if not width:
            return Loss.BAD_WIDTH
        number = int(record["number"][0])
        self._count_gap(number)
        self.valid_records += 1
        values = record["values"].astype(np.float64)
        if self._stream is Stream.WRENCH and width == WRENCH_VALUES:
            known = self._wrenches_from(self._frame, values)
            if known is None:
                return None
            values = known
        return self._add(self._stream, number, float(record["seconds"][0]), values[0])


def _in_range(records: NDArray[Any]) -> bool:
    """Check whether record numbers and times are within their limits; NaN is not."""
    numbers, seconds = records["number"], records["seconds"]
    return bool((np.abs(seconds) <= TIME_STAMP_MAX_S).all() and (numbers <= SEQ_MAX).all() and (numbers >= -SEQ_MAX).all())
