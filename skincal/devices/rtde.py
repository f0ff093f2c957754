"""Universal Robots' RTDE: the wrench of the flange's sensor, the joints' angles and the pose of the flange, with one clock.

A packet is a uint16, big-endian, its length with this head, one byte of kind, and the payload. The host asks for version 2
(`V`), names what it wants (`O`; the answer has the recipe's number and the kind of each), and starts (`S`); then a `U`
comes at each cycle. The wrench is `ft_raw_wrench`, in the sensor's own frame; `actual_TCP_force` is compensated for a
payload, zeroed at power-on, and its frame depends on the software: it is never requested. Source: the maker's RTDE guide.

The pose of a tool (`--tool`) is that of the flange, in the controller's `base` (not `base_link`), metres:

    flange = actual_TCP_pose x inverse(tcp_offset),

both a position and a rotation vector, rad. So a tool centre point that somebody changes on the pendant changes nothing.
`tcp_offset` needs the software 3.12 or 5.5.1.
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ, TIME_STAMP_MAX_S, FrameDecoder, FrameSplitter, LengthSplitter, ProtocolError
from skincal.devices.family import Family, Form, Handshake, HandshakeError, Route, Vector
from skincal.geometry import FloatArray, rotations
from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.readings import Loss, Stream

HEAD_STRUCT = struct.Struct("!HB")
VERSION, OUTPUTS, START, DATA = b"VOSU"
OUTPUT_RATE_HZ = 125.0
"""Hz. Every controller can send at this rate; e-Series could at 500 Hz."""
FIELD_OF_STREAM = {Stream.WRENCH: "ft_raw_wrench", Stream.JOINTS: "actual_q"}
TOOL_FIELDS = ("actual_TCP_pose", "tcp_offset")
FIELD_KIND = "VECTOR6D"
SHOWN_TYPE_NAME_MAX_CHARS = 60


def packet(kind: int, payload: bytes) -> bytes:
    """Build a packet."""
    return HEAD_STRUCT.pack(HEAD_STRUCT.size + len(payload), kind) + payload


def recipe(carries: tuple[Stream, ...]) -> list[str]:
    """Name the requested fields: the time, one field for each stream, and those of a tool's pose at the end."""
    of_tool = TOOL_FIELDS if Stream.TOOL in carries else ()
    return ["timestamp", *(FIELD_OF_STREAM[stream] for stream in carries if stream in FIELD_OF_STREAM), *of_tool]


def flange_pose(pose: FloatArray, offset: FloatArray) -> FloatArray:
    """Compute the pose of the flange from that of the tool centre point and its offset; each (6,), metres and rad."""
    (turn, of_offset) = rotations(np.array([pose[3:], offset[3:]]))
    flange = turn @ of_offset.T
    return np.concatenate([pose[:3] - flange @ offset[:3], _rotation_vector(flange)])


def _rotation_vector(turn: FloatArray) -> FloatArray:
    """Compute the rotation vector (3,), rad, of a rotation (3, 3)."""
    from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs] - slow to import: only who reads poses pays

    vector: FloatArray = Rotation.from_matrix(turn).as_rotvec()
    return vector


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
                needs = "newer software" if name in TOOL_FIELDS else "newer software, and a sensor at its flange"
                raise HandshakeError(f"the controller has no {name}; it needs {needs}")
            if kind != want:
                raise HandshakeError(f"{name} is of the kind {kind[:SHOWN_TYPE_NAME_MAX_CHARS]!r}; expected {want}")
        if len(kinds) != len(wanted):
            raise HandshakeError(f"the controller sends {len(kinds)} fields; {len(wanted)} were requested")


class RtdeDecoder(FrameDecoder):
    """Decodes the packages of a UR controller."""

    name: ClassVar[str] = "UR RTDE"
    starts_whole: ClassVar[bool] = True
    needs_recipe: ClassVar[bool] = True
    defined_pose: ClassVar[PoseForm | None] = PoseForm(RotationForm.ROTATION_VECTOR)

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._streams = [stream for stream in carries if stream in FIELD_OF_STREAM]
        self._has_tool = Stream.TOOL in carries
        self._offset: bytes | None = None
        """tcp_offset of the last packet; `None` before the first."""
        self._fields = 6 * (len(self._streams) + (len(TOOL_FIELDS) if self._has_tool else 0))
        self.units[Stream.TOOL] = "pose of the flange in base, m"
        self.units[Stream.JOINTS] = "base, shoulder, elbow and the three of the wrist in degrees"

    def _make_splitter(self) -> FrameSplitter:
        return LengthSplitter(_next_packet)

    def _decode(self, frame: bytes) -> Loss | None:
        if frame[0] != DATA:
            return None  # answers of the handshake, and messages to people
        values = np.frombuffer(frame[2:], ">f8") if (len(frame) - 2) % 8 == 0 else np.zeros(0)
        if len(values) != 1 + self._fields:
            self._problem = f"Packets of {len(frame)} bytes arrive where {2 + 8 * (1 + self._fields)} are expected"
            return Loss.BAD_WIDTH
        self.valid_records += 1
        device_s = float(values[0]) if math.isfinite(values[0]) and abs(values[0]) < TIME_STAMP_MAX_S else math.nan
        for index, stream in enumerate(self._streams):
            field = values[1 + 6 * index : 7 + 6 * index].astype(np.float64)
            # As every decoder hands on angles: degrees.
            self._add(stream, NO_SEQ, device_s, np.degrees(field) if stream is Stream.JOINTS else field)
        if self._has_tool:
            self._add_tool(device_s, values[-12:].astype(np.float64))
        return None

    def _add_tool(self, device_s: float, values: FloatArray) -> None:
        pose, offset = values[:6], values[6:]
        if self._offset is not None and offset.tobytes() != self._offset:
            self._problem = (
                "The tool centre point was changed on the controller; poses are those of the flange, and are not affected"
            )
        self._offset = offset.tobytes()
        finite = bool(np.isfinite(values).all())
        self._add(Stream.TOOL, NO_SEQ, device_s, flange_pose(pose, offset) if finite else np.full(6, np.nan))


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
