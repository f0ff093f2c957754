"""Leptrino six-axis force/torque sensors (PFS, CFS series): a serial line with stuffed bytes and a check byte.

A message is 10 02, a body, 10 03 and a check byte: the exclusive or of the body and of 03. A byte 10 of the body is sent twice
and counts once. The body is its own length, FF, a command, a result, and data. Command 2B answers the six ratings, float32
little-endian, N and N m. After command 32 the sensor sends six int16 little-endian, values x 10000 / rating, with every
message. 33 stops it. Sources: the maker's sample driver in public ROS packages, the package myLepFT 1.0.1.

The ratings are part of the stream, so that a recording can be read again. Readings before them are not used.
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

from skincal.devices.decoding import (
    INVALID_READING_FLAG,
    NO_SEQ,
    SATURATED_READING_FLAG,
    FrameDecoder,
    FrameSplitter,
    HeadSplitter,
)
from skincal.devices.family import Family, Form, Handshake, Route, Vector, over_tcp
from skincal.model.readings import Loss, Stream

ESCAPE, BEGIN, FINISH = 0x10, b"\x10\x02", 0x03
TERMINAL_NUMBER = 0xFF
RATINGS, STREAM_ON, STREAM_OFF = 0x2B, 0x32, 0x33
"""Commands."""
MESSAGE_MIN_BYTES, MESSAGE_MAX_BYTES = 9, 300
"""Bytes of a message; the longest of the sample driver has 100."""
HEAD_BYTES = 4
"""Bytes of a body before its data."""
RATINGS_STRUCT, COUNTS_STRUCT = struct.Struct("<6f"), struct.Struct("<6h")
COUNTS_AT_RATING = 10_000
MAX_PLAUSIBLE_RATING = 1e6
"""N and N m."""
BAUD_RATES = (460800, 921600)
"""Both are in use: the first in the maker's sample driver, the second in myLepFT."""


def check_byte(body: bytes) -> int:
    """Compute the exclusive or of a body and of the byte 03 that ends it."""
    check = FINISH
    for byte in body:
        check ^= byte
    return check


def message(command: int) -> bytes:
    """Build a request without data."""
    body = bytes((HEAD_BYTES, TERMINAL_NUMBER, command, 0))
    return BEGIN + body + bytes((ESCAPE, FINISH, check_byte(body)))


def _frame_end(buffer: bytes, at: int) -> int | None:
    found = _read_body(buffer, at)
    return found if found is None or isinstance(found, int) else found[1]


def _read_body(buffer: bytes, at: int) -> tuple[bytes, int] | int | None:
    """Return the body of the message at a place, and the place of its end; 0 if it is none, `None` if bytes are missing."""
    body, place, last = bytearray(), at + len(BEGIN), at + MESSAGE_MAX_BYTES
    while place < last:
        escape = buffer.find(ESCAPE, place, last)
        if escape < 0 or escape + 2 >= len(buffer):
            return None if len(buffer) < last else 0
        body += buffer[place:escape]
        if buffer[escape + 1] == ESCAPE:
            body.append(ESCAPE)
            place = escape + 2
            continue
        found = bytes(body)
        is_whole = buffer[escape + 1] == FINISH and HEAD_BYTES <= len(found) == found[0] and found[1] == TERMINAL_NUMBER
        return (found, escape + 3) if is_whole and check_byte(found) == buffer[escape + 2] else 0
    return 0


class LeptrinoHandshake(Handshake):
    """Stops the sensor, asks for its ratings, then starts it; again whenever it is silent. Leaves it stopped."""

    silence_s = 0.4
    closing_bytes = message(STREAM_OFF)

    def __init__(self) -> None:
        self._messages = HeadSplitter(BEGIN, MESSAGE_MIN_BYTES, _frame_end)

    def opening(self) -> bytes:
        return message(STREAM_OFF) + message(RATINGS)

    def on_data(self, data: bytes) -> bytes:
        for frame in self._messages.split(data):
            found = None if frame is None else _read_body(frame, 0)
            if isinstance(found, tuple) and found[0][2] == RATINGS:
                return message(STREAM_ON)
        return b""

    def on_silence(self) -> bytes:
        return self.opening()


class LeptrinoDecoder(FrameDecoder):
    """Decodes a sensor's messages."""

    name: ClassVar[str] = "Leptrino"

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._ratings: tuple[float, ...] = ()

    def _make_splitter(self) -> FrameSplitter:
        return HeadSplitter(BEGIN, MESSAGE_MIN_BYTES, _frame_end)

    def _decode(self, frame: bytes) -> Loss | None:
        found = _read_body(frame, 0)
        if not isinstance(found, tuple):
            return Loss.UNREADABLE
        body = found[0]
        command, result, data = body[2], body[3], body[HEAD_BYTES:]
        if command == RATINGS:
            return self._use_ratings(data)
        if command != STREAM_ON or not data:
            return None  # the answer to a request
        if len(data) < COUNTS_STRUCT.size:
            return Loss.BAD_WIDTH
        if not self._ratings:
            self._problem = "Readings come before the sensor's ratings, and are not used: connect it again"
            return Loss.UNREADABLE
        self.valid_records += 1
        self._status = f"The sensor says: result {result:02X}, see its manual" if result else ""
        counts: tuple[int, ...] = COUNTS_STRUCT.unpack_from(data)
        values = [count * rating / COUNTS_AT_RATING for count, rating in zip(counts, self._ratings, strict=True)]
        flags = INVALID_READING_FLAG if result else 0
        if max(abs(count) for count in counts) > COUNTS_AT_RATING:
            flags |= SATURATED_READING_FLAG
            self._status = self._status or "The force or torque is beyond the sensor's rating"
        return self._add(Stream.WRENCH, NO_SEQ, math.nan, values, flags)

    def _use_ratings(self, data: bytes) -> Loss | None:
        ratings = RATINGS_STRUCT.unpack_from(data) if len(data) == RATINGS_STRUCT.size else (0.0,)
        if not all(0 < rating < MAX_PLAUSIBLE_RATING for rating in ratings):
            self._problem = "The sensor's ratings cannot be read; check the device"
            return Loss.UNREADABLE
        self._ratings, self._problem = ratings, ""
        return None


_RATINGS_BYTES = bytes.fromhex("1002 1CFF2B00 00007A43 00007A43 0000FA43 0000A040 0000A040 0000A040 1003 92".replace(" ", ""))
"""250, 250, 500 N and 5, 5, 5 N m."""
_DATA_BYTES = bytes.fromhex("1002 14FF3200 1010 01 F0FF B004 7D00 0CFE 3F00 0000 0000 1003 C0".replace(" ", ""))
"""Counts 272 (0110), -16, 1200, 125, -500, 63: the byte 10 is sent twice."""

_SERIAL_ROUTE = Route(
    usage="leptrino:/dev/ttyUSB0",
    form=Form.SERIAL,
    transport="serial",
    format="leptrino",
    bauds=BAUD_RATES,
    handshake=lambda _: LeptrinoHandshake(),
    needs_every_byte=True,
)

DEVICE_FAMILY = Family(
    routes=(_SERIAL_ROUTE, over_tcp(_SERIAL_ROUTE)),
    decoders={"leptrino": LeptrinoDecoder},
    vectors=(
        Vector(
            "leptrino",
            (Stream.WRENCH,),
            _RATINGS_BYTES + _DATA_BYTES,
            ((6.8, -0.4, 60.0, 0.0625, -0.25, 0.0315),),
            repeat=_DATA_BYTES,
        ),
    ),
)
