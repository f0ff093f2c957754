"""OptiTrack Motive: the pose of one rigid body by NatNet 3 and 4 over UDP, unicast or multicast.

A message is its kind and size (uint16 each, little-endian) and the content. The host sends 0 (connect) to the command port,
1510. The server answers 1: its name (256 bytes), two versions of 4 bytes (the second is NatNet's), the frequency of its clock
(uint64), the data port (uint16), and whether and where it multicasts (byte, 4 bytes). 4 asks for the descriptions, 5 has them:
type 1 is a rigid body with its name, a zero, and its number (int32). 7 is a frame: its number (int32), marker sets, other
markers, then the rigid bodies: number, x y z in m, quaternion x y z w, mean error (floats), and a word whose bit 0 says that it
is tracked. Behind skeletons, markers and devices come the times. From 4.1 on each count is followed by a size in bytes; from
4.2 on the description of a body has its turn to its parent, too.

**A lost body is sent with a pose**; only the bit tells. The axes are those of Motive's calibration, y up unless it streams z
up.

Sources: the maker's NatNetTypes.h and its Python client as packed in natnetsdk 4.1.1; natnet 0.3.0; python_natnet, whose tests
read captured packets of Motive 2.1. Motive was not tried.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ, FrameDecoder, FrameSplitter, pack, packet_splitter
from skincal.devices.family import DeviceAddress, Family, Form, Handshake, Questions, Route, Vector
from skincal.devices.tracked_bodies import BodyChoice, write_options
from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.readings import Loss, Stream

OPTIONS_KIND, MESSAGE_KIND = 0, 1
HEAD_STRUCT = struct.Struct("<2H")
CONNECT, SERVER_INFO, DESCRIPTIONS_REQUEST, DESCRIPTIONS, FRAME = 0, 1, 4, 5, 7
MESSAGE_MAX_BYTES = 65536
SERVER_NAME_BYTES = 256
CONNECTION_STRUCT = struct.Struct("<QHB4s")
"""Frequency of the clock, data port, whether it multicasts, group."""
BODY_STRUCT = struct.Struct("<i8fh")
MARKER_BYTES, LABELED_MARKER_BYTES = 12, 26
TIMES_STRUCT = struct.Struct("<2id3Q")
"""Time code and its part, seconds since the start, and ticks at exposure, arrival and sending."""
BYTES_BEHIND_TIMES = (2, 6, 10, 14)
"""Frame flags, with or without a precise time and a closing zero."""
IS_TRACKED = 1
VERSION_OLDEST, VERSION_NEWEST = (3, 0), (4, 99)
VERSION_WITH_SIZES, VERSION_WITH_TURNS = (4, 1), (4, 2)
CONNECT_AGAIN_AFTER_MESSAGES = 200
"""One or two seconds: a unicast server forgets a silent host, and names may have changed."""


def message(kind: int, content: bytes = b"") -> bytes:
    """Build a message."""
    return HEAD_STRUCT.pack(kind, len(content)) + content


def split_message(data: bytes) -> tuple[int, bytes] | None:
    """Return kind and content of a message; `None` if it is cut."""
    if len(data) < HEAD_STRUCT.size:
        return None
    kind, size = HEAD_STRUCT.unpack_from(data)
    return (kind, data[HEAD_STRUCT.size : HEAD_STRUCT.size + size]) if len(data) >= HEAD_STRUCT.size + size else None


@dataclass(frozen=True, slots=True)
class ServerInfo:
    """Answer of a server to a connection."""

    version: tuple[int, int]
    """Of NatNet."""
    ticks_per_s: int
    """Hz of its clock; 0 if it is not known."""
    group: tuple[str, int] | None
    """Address and port of its multicast; `None` if it sends to this host."""

    @classmethod
    def read(cls, content: bytes) -> ServerInfo | None:
        """Read the content of message 1; `None` if it is cut."""
        begin = SERVER_NAME_BYTES + 8
        if len(content) < begin:
            return None
        version = content[begin - 4], content[begin - 3]
        if len(content) < begin + CONNECTION_STRUCT.size:
            return cls(version, 0, None)
        ticks_per_s, port, has_group, group = CONNECTION_STRUCT.unpack_from(content, begin)
        return cls(version, ticks_per_s, (".".join(map(str, group)), port) if has_group else None)


class _Cursor:
    """Place in the content of a message. Each method raises `struct.error` if it ends too early."""

    def __init__(self, content: bytes, version: tuple[int, int]) -> None:
        self.content, self.version, self.at = content, version, 0

    def read_int(self) -> int:
        (value,) = struct.unpack_from("<i", self.content, self.at)
        self.at += 4
        return value

    def read_count(self) -> int:
        """Read a count of at least 0."""
        count = self.read_int()
        if count < 0:
            raise struct.error("a count is below 0")
        return count

    def read_section(self) -> int:
        """Read the count of a section, and its size in bytes if the version has one."""
        count = self.read_count()
        if self.version >= VERSION_WITH_SIZES:
            self.read_count()
        return count

    def read_name(self) -> str:
        end = self.content.find(b"\0", self.at)
        if end < 0:
            raise struct.error("a name has no end")
        name = self.content[self.at : end].decode(errors="replace")
        self.at = end + 1
        return name

    def skip(self, count: int) -> None:
        self.at += count
        if self.at > len(self.content):
            raise struct.error("it is too short")


@dataclass(frozen=True, slots=True)
class TrackedBody:
    """A rigid body in a frame."""

    number: int
    pose: tuple[float, ...]
    """x y z in m, quaternion x y z w."""
    is_tracked: bool


@dataclass(frozen=True, slots=True)
class MocapFrame:
    """A frame: its number, its bodies and its time."""

    number: int
    bodies: tuple[TrackedBody, ...]
    seconds: float
    """Since the start of the server."""
    exposure_ticks: int
    """Server's clock in the middle of the exposure; 0 if it is not known."""


def read_frame(content: bytes, version: tuple[int, int]) -> MocapFrame | None:
    """Read the content of message 7; `None` if it does not fit the version."""
    cursor = _Cursor(content, version)
    try:
        number = cursor.read_int()
        for _ in range(cursor.read_section()):
            cursor.read_name()
            cursor.skip(MARKER_BYTES * cursor.read_count())
        cursor.skip(MARKER_BYTES * cursor.read_section())
        bodies: list[TrackedBody] = []
        for _ in range(cursor.read_section()):
            body, *numbers, flags = BODY_STRUCT.unpack_from(content, cursor.at)
            cursor.skip(BODY_STRUCT.size)
            bodies.append(TrackedBody(body, tuple(numbers[:7]), bool(flags & IS_TRACKED)))
        _skip_to_times(cursor)
        _, _, seconds, exposure_ticks, _, _ = TIMES_STRUCT.unpack_from(content, cursor.at)
        cursor.skip(TIMES_STRUCT.size)
    except struct.error:
        return None
    if len(content) - cursor.at not in BYTES_BEHIND_TIMES:
        return None
    return MocapFrame(number, tuple(bodies), seconds, exposure_ticks)


def _skip_to_times(cursor: _Cursor) -> None:
    """Pass over skeletons, assets, labeled markers, force plates and devices."""
    for _ in range(cursor.read_section()):
        cursor.skip(4)
        cursor.skip(BODY_STRUCT.size * cursor.read_count())
    if cursor.version >= VERSION_WITH_SIZES:
        for _ in range(cursor.read_section()):
            cursor.skip(4)
            cursor.skip(BODY_STRUCT.size * cursor.read_count())
            cursor.skip(LABELED_MARKER_BYTES * cursor.read_count())
    cursor.skip(LABELED_MARKER_BYTES * cursor.read_section())
    for _ in ("force plates", "devices"):
        for _ in range(cursor.read_section()):
            cursor.skip(4)
            for _ in range(cursor.read_count()):
                cursor.skip(4 * cursor.read_count())


def read_body_names(content: bytes, version: tuple[int, int]) -> dict[int, str]:
    """Read the names of the rigid bodies by their number from message 5, up to the first unknown type."""
    cursor, names = _Cursor(content, version), dict[int, str]()
    try:
        for _ in range(cursor.read_count()):
            kind, size = cursor.read_int(), cursor.read_count() if version >= VERSION_WITH_SIZES else 0
            begin = cursor.at
            match kind:
                case 0:
                    cursor.read_name()
                    for _ in range(cursor.read_count()):
                        cursor.read_name()
                case 1:
                    name, number = _read_body(cursor)
                    names[number] = name
                case 2:
                    cursor.read_name()
                    cursor.skip(4)
                    for _ in range(cursor.read_count()):
                        _read_body(cursor)
                case _ if size:
                    cursor.at = begin
                    cursor.skip(size)
                case _:
                    break  # force plates and cameras come after the bodies
    except struct.error:
        pass
    return names


def _read_body(cursor: _Cursor) -> tuple[str, int]:
    """Read name and number of a rigid body, and pass over its parent, its offset and its markers."""
    name, number = cursor.read_name(), cursor.read_int()
    cursor.skip(32 if cursor.version >= VERSION_WITH_TURNS else 16)
    markers = cursor.read_count()
    cursor.skip((MARKER_BYTES + 4) * markers)
    if cursor.version >= (4, 0):
        for _ in range(markers):
            cursor.read_name()
    return name, number


class NatNetHandshake(Handshake):
    """Connects, asks for the descriptions, and connects again from time to time."""

    silence_s = 1.0

    def __init__(self) -> None:
        self._packets = packet_splitter(MESSAGE_MAX_BYTES)
        self._is_connected, self._messages = False, 0

    @property
    def is_ready(self) -> bool:
        return self._is_connected

    def opening(self) -> bytes:
        return message(CONNECT)

    def on_silence(self) -> bytes:
        return message(CONNECT)

    def on_data(self, data: bytes) -> bytes:
        answer = b""
        for frame in self._packets.split(data):
            found = None if frame is None or frame[0] != MESSAGE_KIND else split_message(frame[1:])
            if found is None:
                continue
            self._messages += 1
            if found[0] == SERVER_INFO:
                self._is_connected, answer = True, message(DESCRIPTIONS_REQUEST)
            elif self._messages >= CONNECT_AGAIN_AFTER_MESSAGES:
                self._messages, answer = 0, message(CONNECT)
        return answer


class NatNetDecoder(FrameDecoder):
    """Decodes the messages of a NatNet server."""

    name: ClassVar[str] = "NatNet"
    starts_whole: ClassVar[bool] = True
    defined_pose: ClassVar[PoseForm | None] = PoseForm(RotationForm.QUATERNION_XYZW)

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._choice = BodyChoice()
        self._server: ServerInfo | None = None
        self._names: dict[int, str] | None = None
        """Of the rigid bodies by number; `None` until they are known."""
        self._frame_number: int | None = None
        self.units[Stream.TOOL] = "pose of a rigid body in the frame of Motive's calibration, m"

    def _make_splitter(self) -> FrameSplitter:
        return packet_splitter(MESSAGE_MAX_BYTES)

    def _decode(self, frame: bytes) -> Loss | None:
        if frame[0] == OPTIONS_KIND:
            return None if self._choice.read_options(frame[1:]) else Loss.UNREADABLE
        found = split_message(frame[1:])
        if found is None or frame[0] != MESSAGE_KIND:
            return Loss.UNREADABLE
        kind, content = found
        if kind == SERVER_INFO:
            return self._use_server(content)
        if kind == DESCRIPTIONS and self._server is not None:
            self._names = read_body_names(content, self._server.version)
        return self._decode_frame(content) if kind == FRAME else None

    def _use_server(self, content: bytes) -> Loss | None:
        server = ServerInfo.read(content)
        if server is None:
            return Loss.UNREADABLE
        if self._server is not None and server.version != self._server.version:
            self._names = None
        self._server = server
        if not VERSION_OLDEST <= server.version <= VERSION_NEWEST:
            number = ".".join(map(str, server.version))
            self._status = f"The server speaks NatNet {number}; versions 3 and 4 are read: use Motive 2 or 3"
        return None

    def _decode_frame(self, content: bytes) -> Loss | None:
        server = self._server
        if server is None or not VERSION_OLDEST <= server.version <= VERSION_NEWEST:
            return Loss.UNREADABLE
        found = read_frame(content, server.version)
        if found is None:
            self._problem = f"A frame does not fit NatNet {'.'.join(map(str, server.version))}"
            return Loss.UNREADABLE
        if found.number == self._frame_number:
            return Loss.REPEATED
        self._frame_number = found.number
        self.valid_records += 1
        self._count_gap(found.number)
        numbers = [body.number for body in found.bodies]
        names = ["" if self._names is None else self._names.get(number, "") for number in numbers]
        index = self._choice.index_of(names, numbers)
        if index is None and self._names is None:
            # The first frames may come before the answer to the request for names.
            self._status = "Motive has not named its rigid bodies yet"
            return None
        if index is None:
            self._status = self._choice.problem
            return Loss.NO_POSE
        body, label = found.bodies[index], self._choice.label(names, index)
        if not body.is_tracked:
            self._status = f"Motive does not see the rigid body {label}"
            return Loss.NO_POSE
        self._status = ""
        self.units[Stream.TOOL] = f"pose of {label} in the frame of Motive's calibration, m"
        has_ticks = server.ticks_per_s > 0 and found.exposure_ticks > 0
        time_s = found.exposure_ticks / server.ticks_per_s if has_ticks else found.seconds
        return self._add(Stream.TOOL, NO_SEQ, time_s if math.isfinite(time_s) else math.nan, np.array(body.pose))


def _with_server(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    """Ask the server whether it multicasts, and where. Raises LinkError: nothing answers."""
    answer = questions.ask_udp(
        address.label, address.host, address.port, message(CONNECT), HEAD_STRUCT.pack(SERVER_INFO, 0)[:2]
    )
    found = split_message(answer)
    server = None if found is None else ServerInfo.read(found[1])
    head = pack(OPTIONS_KIND, write_options(address.options.get("body", "")))
    group = None if server is None else server.group
    return replace(address, first_bytes=head, group=group, handshake=NatNetHandshake())


_VECTOR_BODY = bytes.fromhex("07000000cdcccc3dcdcc4cbe9a99993e00331c3debd9413ea00a753eaf98733f17b7d1390100")
"""Number 7, x y z 0.1 -0.2 0.3 m, R = Rz(30) Ry(20) Rx(10) degrees, mean error 0.0004 m, tracked."""
_VECTOR_SERVER = message(
    SERVER_INFO,
    b"Motive".ljust(SERVER_NAME_BYTES, b"\0")
    + bytes((2, 1, 0, 0, 3, 0, 0, 0))
    + CONNECTION_STRUCT.pack(10**7, 1511, 0, bytes(4)),
)
_VECTOR_FRAME = message(
    FRAME,
    struct.pack("<4i", 162734, 0, 0, 1)
    + _VECTOR_BODY
    + struct.pack("<4i", 0, 0, 0, 0)
    + TIMES_STRUCT.pack(0, 0, 1.0, 125_000_000, 0, 0)
    + bytes(6),
)
_VECTOR_POSE = (
    0.8137976760280579, -0.4409696249681162, 0.37852230099006184, 0.10000000149011612,
    0.4698463234440413, 0.8825641122242011, 0.018028315507137113, -0.20000000298023224,
    -0.3420201380583449, 0.16317591019935063, 0.9254165805155881, 0.30000001192092896,
)  # fmt: skip
"""Upper rows of the pose, as the floats of 32 bits have it."""

DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="natnet://192.168.1.2?body=probe",
            form=Form.HOST,
            transport="udp",
            format="natnet",
            port=1510,
            options=("body",),
            message_max=MESSAGE_MAX_BYTES,
            message_kind=MESSAGE_KIND,
            needs_every_byte=True,
            prepare=_with_server,
        ),
    ),
    decoders={"natnet": NatNetDecoder},
    vectors=(
        Vector(
            "natnet",
            (Stream.TOOL,),
            pack(OPTIONS_KIND, write_options("7")) + pack(MESSAGE_KIND, _VECTOR_SERVER) + pack(MESSAGE_KIND, _VECTOR_FRAME),
            (_VECTOR_POSE,),
        ),
    ),
)
