"""Universal Robots' RTDE: the wrench of the flange's sensor and the joints' angles, with one clock.

A packet is a uint16, big-endian, its length with this head, one byte of kind, and the payload. The host asks for version 2
(`V`), names what it wants (`O`; the answer has the recipe's number and the kind of each), and starts (`S`); then a `U`
comes at each cycle. The wrench is `ft_raw_wrench`, in the sensor's own frame; `actual_TCP_force` is compensated for a
payload, zeroed at power-on, and its frame depends on the software: it is never requested. Source: the maker's RTDE guide.
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ, TIME_STAMP_MAX_S, FrameDecoder, FrameSplitter, LengthSplitter, ProtocolError
from skincal.devices.family import Family, Form, Handshake, HandshakeError, Route, Vector
from skincal.model.readings import Loss, Stream

HEAD_STRUCT = struct.Struct("!HB")
VERSION, OUTPUTS, START, DATA = b"VOSU"
OUTPUT_RATE_HZ = 125.0
"""Hz. Every controller can send at this rate; e-Series could at 500 Hz."""
FIELD_OF_STREAM = {Stream.WRENCH: "ft_raw_wrench", Stream.JOINTS: "actual_q"}
FIELD_KIND = "VECTOR6D"
SHOWN_TYPE_NAME_MAX_CHARS = 60


def packet(kind: int, payload: bytes) -> bytes:
    """Build a packet."""
    return HEAD_STRUCT.pack(HEAD_STRUCT.size + len(payload), kind) + payload


def recipe(carries: tuple[Stream, ...]) -> list[str]:
    """Name the requested fields: the time, and one field for each stream."""
    return ["timestamp", *(FIELD_OF_STREAM[stream] for stream in carries if stream in FIELD_OF_STREAM)]


def _next_packet(data: bytes, at: int) -> tuple[bytes, int] | None:
    """Cut the packet at a place: its kind and payload. A length can never exceed 65,535."""
    if len(data) - at < HEAD_STRUCT.size:
        return None
    end = at + int.from_bytes(data[at : at + 2], "big")
    if end - at < HEAD_STRUCT.size:
        raise ProtocolError(f"it announces a packet of {end - at} bytes, which is no RTDE")
    return (data[at + 2 : end], end) if len(data) >= end else None


class RtdeHandshake(Handshake):
    """Handshake of RTDE: sends the next request after each answer."""

    def __init__(self, carries: tuple[Stream, ...]) -> None:
        self._fields = recipe(carries)
        self._packets = LengthSplitter(_next_packet)
        self._started = False

    @property
    def is_ready(self) -> bool:
        return self._started

    def opening(self) -> bytes:
        return packet(VERSION, struct.pack("!H", 2))

    def on_data(self, data: bytes) -> bytes:
        answer = b""
        for frame in self._packets.split(data):
            if frame is None:
                raise HandshakeError(self._packets.fault)
            if not self._started:
                answer += self._answer(frame[0], frame[1:])
        return answer

    def _answer(self, kind: int, payload: bytes) -> bytes:
        if kind == VERSION:
            if payload != b"\x01":
                raise HandshakeError("the controller does not speak version 2 of RTDE; it needs newer software")
            return packet(OUTPUTS, struct.pack("!d", OUTPUT_RATE_HZ) + ",".join(self._fields).encode())
        if kind == OUTPUTS:
            self._check(payload[1:].decode("ascii", "replace").split(","))
            return packet(START, b"")
        if kind == START:
            if payload != b"\x01":
                raise HandshakeError("the controller does not start to send")
            self._started = True
        return b""

    def _check(self, kinds: list[str]) -> None:
        wanted = ["DOUBLE", *[FIELD_KIND] * (len(self._fields) - 1)]
        for name, kind, want in zip(self._fields, kinds, wanted, strict=False):
            if kind == "NOT_FOUND":
                raise HandshakeError(f"the controller has no {name}; it needs newer software, and a sensor at its flange")
            if kind != want:
                raise HandshakeError(f"{name} is of the kind {kind[:SHOWN_TYPE_NAME_MAX_CHARS]!r}; expected {want}")
        if len(kinds) != len(wanted):
            raise HandshakeError(f"the controller sends {len(kinds)} fields; {len(wanted)} were requested")


class RtdeDecoder(FrameDecoder):
    """Decodes the packages of a UR controller."""

    name: ClassVar[str] = "UR RTDE"
    starts_whole: ClassVar[bool] = True
    needs_recipe: ClassVar[bool] = True

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._streams = [stream for stream in carries if stream in FIELD_OF_STREAM]
        self.units[Stream.JOINTS] = "base, shoulder, elbow and the three of the wrist in degrees"

    def _make_splitter(self) -> FrameSplitter:
        return LengthSplitter(_next_packet)

    def _decode(self, frame: bytes) -> Loss | None:
        if frame[0] != DATA:
            return None  # answers of the handshake, and messages to people
        values = np.frombuffer(frame[2:], ">f8") if (len(frame) - 2) % 8 == 0 else np.zeros(0)
        if len(values) != 1 + 6 * len(self._streams):
            self._problem = f"Packets of {len(frame)} bytes arrive where {2 + 8 * (1 + 6 * len(self._streams))} are expected"
            return Loss.BAD_WIDTH
        self.valid_records += 1
        device_s = float(values[0]) if math.isfinite(values[0]) and abs(values[0]) < TIME_STAMP_MAX_S else math.nan
        for index, stream in enumerate(self._streams):
            field = values[1 + 6 * index : 7 + 6 * index].astype(np.float64)
            # As every decoder hands on angles: degrees.
            self._add(stream, NO_SEQ, device_s, np.degrees(field) if stream is Stream.JOINTS else field)
        return None


_ANSWER_BYTES = b"\x00\x04V\x01" + b"\x00\x1cO\x01DOUBLE,VECTOR6D,VECTOR6D" + b"\x00\x04S\x01"
_DATA_BYTES = bytes.fromhex(
    "006c55014029000000000000" "3fe0000000000000bff00000000000003ff8000000000000"
    "00000000000000003fd0000000000000bfe8000000000000"
    "3ff8000000000000c002000000000000403e000000000000"
    "3fc0000000000000bfe00000000000003fb0000000000000"
)  # fmt: skip
"""Recipe 1, 12.5 s, angles, wrench."""

DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="rtde://192.168.1.2",
            form=Form.HOST,
            transport="tcp",
            format="rtde",
            port=30004,
            handshake=RtdeHandshake,
            needs_every_byte=True,
        ),
    ),
    decoders={"rtde": RtdeDecoder},
    vectors=(
        Vector(
            "rtde",
            (Stream.JOINTS, Stream.WRENCH),
            _ANSWER_BYTES + _DATA_BYTES,
            ((0.5, -1.0, 1.5, 0.0, 0.25, -0.75), (1.5, -2.25, 30.0, 0.125, -0.5, 0.0625)),
            repeat=_DATA_BYTES,
        ),
    ),
)
