"""SKB/1: binary records of makers' devices.

A frame is COBS(body + CRC) and a 0. The body is little-endian: u8 type, u8 source, u16 seq, u32 t_us, payload, at most
1024 bytes; the CRC-16/CCITT-FALSE of the body follows as u16. Types: 1 skin u16[n], 2 wrench float32[6] and u32 status
(bit 0 saturated, bit 1 invalid), 3 skin u8[n], 4 skin float32[n], 5 joints float32[n] in degrees, 16 header, the UTF-8
text `key=value,...`. Other types are skipped. `seq` counts each type of each source alone; `source` is not looked at
otherwise.

COBS writes bytes without the byte 0. A block is a code byte c and c - 1 bytes that are not 0; it stands for those bytes
and a 0 after them, except where c is 255 or the block is the last. Source: Cheshire and Baker, "Consistent Overhead Byte
Stuffing", IEEE/ACM Transactions on Networking 7(2), 1999.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from skincal.devices.decoding import (
    CRC_CCITT_INITIAL_VALUE,
    INVALID_READING_FLAG,
    SATURATED_READING_FLAG,
    DeviceTime,
    FrameDecoder,
    MarkSplitter,
    SequenceCounter,
    unit_of_header,
)
from skincal.geometry import IntArray
from skincal.model.readings import Batch, Loss, Stream

HEAD_STRUCT = struct.Struct("<BBHI")
CRC_BYTES = 2
MAX_BODY_BYTES = 1024
"""Bytes. The longest body of the protocol."""
WRENCH_MESSAGE_TYPE = 2
HEADER_MESSAGE_TYPE = 16
STREAM_OF_TYPE = {
    1: (Stream.SKIN, np.dtype("<u2")),
    WRENCH_MESSAGE_TYPE: (Stream.WRENCH, np.dtype("<f4")),
    3: (Stream.SKIN, np.dtype("u1")),
    4: (Stream.SKIN, np.dtype("<f4")),
    5: (Stream.JOINTS, np.dtype("<f4")),
}
"""Stream of each type, and the type of its values."""
WRENCH_PAYLOAD_BYTES, STATUS_BYTES = 28, 4

COBS_FULL_BLOCK_CODE = 255
"""Code of a block of 254 bytes without a 0 after it."""


class SkbDecoder(FrameDecoder):
    """Decodes SKB/1."""

    name: ClassVar[str] = "SKB/1"
    mark: ClassVar[bytes] = b"\x00"
    limit: ClassVar[int] = MAX_BODY_BYTES + CRC_BYTES + -(-(MAX_BODY_BYTES + CRC_BYTES) // 254)

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._times: dict[int, DeviceTime] = {}
        self._counters: dict[int, tuple[DeviceTime, SequenceCounter]] = {}
        """Clock of the source and counter of its type, by type and source in one number."""

    def feed_many(self, chunks: Sequence[bytes]) -> tuple[Batch, list[int]] | None:
        """Decode chunks of whole, good records of one type, and headers, with no number missing. Else take nothing."""
        splitter = self._splitter
        is_whole = isinstance(splitter, MarkSplitter) and not splitter.has_partial_frame
        if not is_whole or not chunks or not all(chunk.endswith(self.mark) for chunk in chunks):
            return None
        found = _split_records(b"".join(chunks))
        if found is None:
            return None
        records, places, headers = found
        kind, source = records[0, :2].tolist()
        if kind not in STREAM_OF_TYPE or (records[:, :2] != (kind, source)).any():
            return None
        (stream, dtype), payload, status = STREAM_OF_TYPE[kind], records[:, HEAD_STRUCT.size : -CRC_BYTES], None
        if payload.shape[1] % dtype.itemsize or (kind == WRENCH_MESSAGE_TYPE and payload.shape[1] != WRENCH_PAYLOAD_BYTES):
            return None
        if kind == WRENCH_MESSAGE_TYPE:
            payload, status = payload[:, :-STATUS_BYTES], _numbers(payload[:, -STATUS_BYTES:], "<u4")[:, 0]
        values = _numbers(payload, dtype).astype(np.float64)
        ends = np.searchsorted(places, np.cumsum([len(chunk) for chunk in chunks]))
        raw_seq, raw_us = _numbers(records[:, 2:4], "<u2")[:, 0], _numbers(records[:, 4:8], "<u4")[:, 0]
        time, sequence = self._counters.get(kind << 8 | source, (self._times.get(source, DeviceTime()), SequenceCounter()))
        if (
            stream not in self._widths
            or not self._has_width(stream, values.shape[1])
            or not np.isfinite(values).all()
            or not np.diff(ends, prepend=0).all()
            or not sequence.follows(raw_seq.astype(np.int64))
            or any(self._names_new_unit(header) for header in headers)
            or any(self._header(header) is not None for header in headers)
        ):
            return None
        self._times[source], self._counters[kind << 8 | source] = time, (time, sequence)
        self._widths[stream] = values.shape[1]
        self.valid_records += len(values)
        self._first = False
        device_s = time.unwrap_many(raw_us.astype(np.int64))
        numbers = sequence.step_many(raw_seq.astype(np.int64), device_s)
        flags = None if status is None else status.astype(np.int64) & (SATURATED_READING_FLAG | INVALID_READING_FLAG)
        return self._batch(stream, numbers, device_s, values, flags), ends.tolist()

    def _decode(self, frame: bytes) -> Loss | None:
        if not frame:
            return None
        record = unstuffed(frame)
        if record is None or len(record) < HEAD_STRUCT.size + CRC_BYTES:
            return Loss.UNREADABLE
        return self._record(record[:-CRC_BYTES]) if _has_good_checksum(record) else Loss.BAD_CHECKSUM

    def _record(self, body: bytes) -> Loss | None:
        kind, source, raw_seq, raw_us = HEAD_STRUCT.unpack_from(body)
        if kind == HEADER_MESSAGE_TYPE:
            return self._header(body)
        if kind not in STREAM_OF_TYPE:
            return None
        key = kind << 8 | source
        if key not in self._counters:
            self._counters[key] = self._times.setdefault(source, DeviceTime()), SequenceCounter()
        time, sequence = self._counters[key]
        device_s = time.unwrap(raw_us)
        seq, missing = sequence.unwrap(raw_seq, device_s)
        self._count_missing(missing)
        (stream, dtype), payload, status = STREAM_OF_TYPE[kind], body[HEAD_STRUCT.size :], 0
        if len(payload) % dtype.itemsize or (kind == WRENCH_MESSAGE_TYPE and len(payload) != WRENCH_PAYLOAD_BYTES):
            return Loss.BAD_WIDTH
        if kind == WRENCH_MESSAGE_TYPE:
            payload, status = payload[:-STATUS_BYTES], int.from_bytes(payload[-STATUS_BYTES:], "little")
        self.valid_records += 1
        return self._add(stream, seq, device_s, np.frombuffer(payload, dtype), status)

    def _names_new_unit(self, body: bytes) -> bool:
        return unit_of_header(body[HEAD_STRUCT.size :].decode(errors="replace")) not in ("", self.skin_unit)

    def _header(self, body: bytes) -> Loss | None:
        try:
            header = body[HEAD_STRUCT.size :].decode()
        except UnicodeDecodeError:
            return Loss.UNREADABLE
        self.valid_records += 1
        self._read_header(header)
        return None


def _numbers(rows: NDArray[np.uint8], dtype: np.dtype[Any] | str) -> NDArray[Any]:
    """Return the numbers in rows of bytes."""
    return np.ascontiguousarray(rows).view(dtype)


def _split_records(data: bytes) -> tuple[NDArray[np.uint8], IntArray, list[bytes]] | None:
    """Split whole frames into records of one length, with good checksums, and bodies of headers; `None` for other bytes.

    Returns the records with their checksums, (n, bytes), the place of each in `data`, and the bodies of the headers.
    """
    frames = np.frombuffer(data, np.uint8)
    marks = np.flatnonzero(frames == 0)
    begins = np.concatenate([[0], marks[:-1] + 1])
    lengths = marks - begins
    length = int(np.bincount(lengths).argmax())
    # Arrays undo COBS in the usual, short records; the length of a long one depends on its values.
    is_short = (lengths == length) & (HEAD_STRUCT.size + CRC_BYTES < length < COBS_FULL_BLOCK_CODE)
    short = unstuffed_rows(frames[begins[is_short][:, None] + np.arange(length)])
    if short is None or lengths.max() > SkbDecoder.limit:
        return None
    together, size = short.tobytes(), max(length - 1, 1)
    records = [together[at : at + size] for at in range(0, len(together), size)]
    places = begins[is_short].tolist()
    headers: list[bytes] = []
    for begin, end in zip(begins[~is_short].tolist(), marks[~is_short].tolist(), strict=True):
        other = unstuffed(data[begin:end])
        if not other:
            return None
        if other[0] == HEADER_MESSAGE_TYPE and len(other) >= HEAD_STRUCT.size + CRC_BYTES and _has_good_checksum(other):
            headers.append(other[:-CRC_BYTES])
        else:
            records.append(other)
            places.append(begin)
    widths = {len(record) for record in records}
    is_one_kind = len(widths) == 1 and min(widths) > HEAD_STRUCT.size + CRC_BYTES and places == sorted(places)
    if not is_one_kind or not all(map(_has_good_checksum, records)):
        return None
    return np.frombuffer(b"".join(records), np.uint8).reshape(len(records), -1), np.array(places), headers


def _has_good_checksum(record: bytes) -> bool:
    return binascii.crc_hqx(record[:-CRC_BYTES], CRC_CCITT_INITIAL_VALUE) == record[-2] | record[-1] << 8


def unstuffed_rows(frames: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Undo COBS for n frames (n, bytes) of one length below 255 without zeros: (n, bytes - 1); `None` if one is no COBS."""
    rows, end = np.arange(len(frames)), frames.shape[1]
    out, at = frames.copy(), np.zeros(len(frames), np.int64)
    while len(rows):
        at = at + frames[rows, at]
        if (at > end).any():
            return None
        inside = at < end
        rows, at = rows[inside], at[inside]
        out[rows, at] = 0
    return out[:, 1:]


def unstuffed(frame: bytes) -> bytes | None:
    """Undo COBS for the bytes between two zeros; `None` if they are no COBS block."""
    out, at, end = bytearray(), 0, len(frame)
    while at < end:
        code = frame[at]
        stop = at + code
        if code == 0 or stop > end:
            return None
        out += frame[at + 1 : stop]
        if code != COBS_FULL_BLOCK_CODE and stop < end:
            out.append(0)
        at = stop
    return bytes(out) if end and 0 not in frame else None
