"""Robotiq TSF-85: tactile fingertips of 7 x 4 taxels for two fingers of a gripper.

A packet is 9A, an unused byte, a command, the number n of bytes that follow, and n bytes of fields. A field is a byte with its
kind (high nibble) and finger (bits 2 and 3), and big-endian values: 10 static pressure 28 uint16, 20 dynamic int16, 30 to 50
acceleration, turn rate and magnetic field 3 int16 each, 60 temperature int16, 70 clock (8 bytes, in older firmware 2). A
reading is several packets. `9A 00 58 01 PERIOD` starts the stream, PERIOD in ms. Sources: Robotiq's public code
(tactile_sensors), the package pyrobotiqtactile 0.1.2.

No check byte is computed, so a packet counts if its fields fill it exactly and the next packet begins right after it. A reading
is the pressure of finger 0 and of finger 1 that follows it; a finger without the other one is counted as missing. The public
code does not say which finger comes first: if it is finger 1, the two are one period apart. The unit of the clock is not
published: readings are dated by their arrival.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ, FrameDecoder, FrameSplitter, HeadSplitter
from skincal.devices.family import Family, Form, Handshake, Route, Vector, over_tcp
from skincal.geometry import FloatArray
from skincal.model.readings import Loss, Stream

START_BYTE = 0x9A
HEAD_BYTES = 4
STREAM_ON = 0x58
PERIOD_MS = 10
"""ms between the requested readings: enough for a skin."""
TAXELS_PER_FINGER, FINGERS = 28, 2
STATIC_PRESSURE = 0x10
CLOCK_FIELD = 0x70
BYTES_OF_FIELD = {STATIC_PRESSURE: 56, 0x20: 2, 0x30: 6, 0x40: 6, 0x50: 6, 0x60: 2}
"""Bytes of the values of a field, by its kind; the clock has `CLOCK_BYTES`."""
CLOCK_BYTES = 8, 2
"""Newer firmware, older firmware."""
MIN_READINGS_OF_ONE_FINGER = 20
"""Readings of one finger in a row that show that the other one does not send."""


def start_request(period_ms: int = PERIOD_MS) -> bytes:
    """Build the request for a stream of both fingers."""
    return bytes((START_BYTE, 0, STREAM_ON, 1, period_ms))


def read_fields(data: bytes) -> list[tuple[int, int, bytes]] | None:
    """Return kind, finger and values of the fields that fill a packet exactly; `None` if it is none."""
    for clock_bytes in CLOCK_BYTES:
        found, at, sizes = list[tuple[int, int, bytes]](), 0, {**BYTES_OF_FIELD, CLOCK_FIELD: clock_bytes}
        while at < len(data):
            kind, finger = data[at] & 0xF0, data[at] >> 2 & 3
            end = at + 1 + sizes.get(kind, len(data))
            if end > len(data) or finger >= FINGERS:
                break
            found.append((kind, finger, data[at + 1 : end]))
            at = end
        if at == len(data):
            return found
    return None


def _frame_end(buffer: bytes, at: int) -> int | None:
    end = at + HEAD_BYTES + buffer[at + 3]
    if end == at + HEAD_BYTES:
        return 0
    if len(buffer) <= end:
        return None
    return end if buffer[end] == START_BYTE and read_fields(buffer[at + HEAD_BYTES : end]) is not None else 0


class Tsf85Handshake(Handshake):
    """Starts the stream, and again when it ends."""

    silence_s = 1.0

    def opening(self) -> bytes:
        return start_request()

    def on_silence(self) -> bytes:
        return start_request()


class Tsf85Decoder(FrameDecoder):
    """Decodes the packets of a gripper's fingertips."""

    name: ClassVar[str] = "Robotiq TSF-85"

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self.units[Stream.SKIN] = "static pressure of 7 x 4 taxels, finger 0, then finger 1, raw values"
        self._first_finger: FloatArray | None = None
        """Pressure of finger 0 of the reading that is not complete."""
        self._is_joining = True
        """Whether no pressure has arrived yet: the first one may be the end of a reading."""
        self._alone = 0
        """Readings of one finger in a row."""

    def _make_splitter(self) -> FrameSplitter:
        return HeadSplitter(bytes((START_BYTE,)), HEAD_BYTES + 1, _frame_end)

    def _decode_frames(self, frames: Sequence[bytes | None]) -> None:
        for frame in frames:
            if frame is None:
                # Fingers before and after lost bytes are of two readings.
                self._first_finger = None
            super()._decode_frames((frame,))

    def _decode(self, frame: bytes) -> Loss | None:
        problem: Loss | None = None
        for kind, finger, values in read_fields(frame[HEAD_BYTES:]) or ():
            if kind == STATIC_PRESSURE:
                problem = self._add_finger(finger, np.frombuffer(values, ">u2").astype(np.float64)) or problem
        return problem

    def _add_finger(self, finger: int, pressure: FloatArray) -> Loss | None:
        first, self._first_finger = self._first_finger, pressure if not finger else None
        if (first is None) == bool(finger):  # the other finger's pressure is missing
            self._alone += 1
            self._count_missing(0 if self._is_joining else 1)
        self._is_joining = False
        if self._alone >= MIN_READINGS_OF_ONE_FINGER:
            self._status = f"Only finger {finger} sends: check the cable of the other fingertip"
        if first is None or not finger:
            return None
        values = np.concatenate([first, pressure])
        self._alone, self._status = 0, ""
        self.valid_records += 1
        if self._width(Stream.SKIN) == TAXELS_PER_FINGER:
            self._problem = (
                "Both fingers send, 56 values, and the scene has those of one: add ?channels=0-27&of=56 (finger 0) or "
                "?channels=28-55&of=56 (finger 1) to the address"
            )
            return Loss.BAD_WIDTH
        return self._add(Stream.SKIN, NO_SEQ, math.nan, values)


def _packet(finger: int, first: int) -> bytes:
    values = np.arange(first, first + TAXELS_PER_FINGER).astype(">u2").tobytes()
    return bytes((START_BYTE, 0, 0x61, 57, STATIC_PRESSURE | finger << 2)) + values


_VECTOR_PACKETS = _packet(0, 300) + _packet(1, 500)
_VECTOR_VALUES = (*map(float, range(300, 328)), *map(float, range(500, 528)))
_SERIAL_ROUTE = Route(
    usage="tsf85:/dev/ttyACM0",
    form=Form.SERIAL,
    transport="serial",
    format="tsf85",
    baud=115200,
    options=("channels", "of"),
    handshake=lambda _: Tsf85Handshake(),
)

DEVICE_FAMILY = Family(
    routes=(_SERIAL_ROUTE, over_tcp(_SERIAL_ROUTE)),
    decoders={"tsf85": Tsf85Decoder},
    vectors=(
        Vector(
            "tsf85",
            (Stream.SKIN,),
            _VECTOR_PACKETS + bytes((START_BYTE,)),
            (_VECTOR_VALUES,),
            repeat=_VECTOR_PACKETS[1:] + bytes((START_BYTE,)),
            channels=56,
        ),
    ),
)
