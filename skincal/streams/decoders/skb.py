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
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import CRC_CCITT_INITIAL_VALUE, DeviceTime, FrameDecoder, SequenceCounter
from skincal.model.readings import Loss, Stream

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

    def _decode(self, frame: bytes) -> Loss | None:
        if not frame:
            return None
        record = unstuffed(frame)
        if record is None or len(record) < HEAD_STRUCT.size + CRC_BYTES:
            return Loss.UNREADABLE
        body = record[:-CRC_BYTES]
        if binascii.crc_hqx(body, CRC_CCITT_INITIAL_VALUE) != record[-2] | record[-1] << 8:
            return Loss.BAD_CHECKSUM
        return self._record(body)

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
        seq, missing = sequence.step(raw_seq, device_s)
        self._count_missing(missing)
        (stream, dtype), payload, status = STREAM_OF_TYPE[kind], body[HEAD_STRUCT.size :], 0
        if len(payload) % dtype.itemsize or (kind == WRENCH_MESSAGE_TYPE and len(payload) != WRENCH_PAYLOAD_BYTES):
            return Loss.BAD_WIDTH
        if kind == WRENCH_MESSAGE_TYPE:
            payload, status = payload[:-STATUS_BYTES], int.from_bytes(payload[-STATUS_BYTES:], "little")
        self.valid_records += 1
        return self._add(stream, seq, device_s, np.frombuffer(payload, dtype), status)

    def _header(self, body: bytes) -> Loss | None:
        try:
            header = body[HEAD_STRUCT.size :].decode()
        except UnicodeDecodeError:
            return Loss.UNREADABLE
        self.valid_records += 1
        self._read_header(header)
        return None


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
