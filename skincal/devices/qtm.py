"""Qualisys Track Manager (QTM): the pose of one body by its real-time protocol over TCP.

A packet is its size with this head (uint32, little-endian at port 22223), its kind (uint32), and the content: 0 error text,
1 command or its answer, 2 settings in XML, 3 data, 4 no data, 6 event. The server greets; the host asks for a version
(`Version 1.8`), for the names of the bodies (`GetParameters 6D`), and for the stream (`StreamFrames AllFrames 6D`).

A data packet has a time (int64, microseconds since the start), a frame number, a number of components, and these, each with its
size and kind (uint32). Component 5 has the number of bodies, two rates (int16), and 12 floats for each body in the order of the
settings: x y z in mm, and the rotation matrix **column by column**. A lost body is NaN. Axes are those of the calibration,
right-handed.

Sources: the maker's protocol documentation 1.20; the order of the matrix is that of the maker's public clients (QTM Connect for
Unity reads xx yx zx xy ...) and of its TSV export, whose rows also have the angles. The package qtm-rt 3.1.0 hands on the nine
floats as they come. QTM was not tried.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import replace
from html import unescape
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ, US_PER_S, FrameDecoder, FrameSplitter, LengthSplitter, ProtocolError
from skincal.devices.family import DeviceAddress, Family, Form, Handshake, HandshakeError, Questions, Route, Vector
from skincal.devices.tracked_bodies import BodyChoice, write_options
from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.readings import Loss, Stream

HEAD_STRUCT = struct.Struct("<2I")
DATA_STRUCT = struct.Struct("<q2I")
COMPONENT_STRUCT = struct.Struct("<2I")
BODIES_STRUCT = struct.Struct("<I2h")
ERROR, COMMAND, SETTINGS, DATA, NO_MORE_DATA, EVENT = 0, 1, 2, 3, 4, 6
OPTIONS_KIND = 0x736B696E
"""Kind of the packet that the link puts before all others: the options of the address. QTM has none of it."""
BODIES_KIND = 5
BODY_FLOATS = 12
PACKET_MAX_BYTES = 1 << 20
"""Bytes. 20,000 bodies fit."""
VERSION_REQUEST, NAMES_REQUEST, STREAM_REQUEST = "Version 1.8", "GetParameters 6D", "StreamFrames AllFrames 6D"
"""1.8 is the oldest version that the maker's own package speaks; newer servers keep it."""
EVENTS_WITH_OTHER_BODIES = (1, 3, 8, 11)
"""Connected, capture started, real time from a file started, settings changed: then the names are asked again."""
ANSWER_SHOWN_MAX_CHARS = 80
_BODY_RE = re.compile(r"<Body\b[^>]*>.*?</Body>", re.DOTALL)
_NAME_RE = re.compile(r"<Name\b[^>]*>(.*?)</Name>", re.DOTALL)


def packet(kind: int, content: bytes) -> bytes:
    """Build a packet."""
    return HEAD_STRUCT.pack(HEAD_STRUCT.size + len(content), kind) + content


def command(text: str) -> bytes:
    """Build a command, which a zero ends."""
    return packet(COMMAND, text.encode() + b"\0")


def read_names(settings: bytes) -> tuple[str, ...]:
    """Read the names of the bodies from the settings, in the order of the data."""
    bodies: list[str] = _BODY_RE.findall(settings.decode(errors="replace"))
    names = (_NAME_RE.search(body) for body in bodies)
    return tuple("" if name is None else unescape(name[1]).strip() for name in names)


def _next_packet(data: bytes, at: int) -> tuple[bytes, int] | None:
    """Cut the packet at a place: its kind and content."""
    if len(data) - at < HEAD_STRUCT.size:
        return None
    size, kind = HEAD_STRUCT.unpack_from(data, at)
    if not HEAD_STRUCT.size <= size <= PACKET_MAX_BYTES or not (kind <= 9 or kind == OPTIONS_KIND):
        raise ProtocolError(f"it announces a packet of kind {kind} and {size} bytes, which is no QTM")
    end = at + size
    return (data[at + 4 : end], end) if len(data) >= end else None


def _names_may_change(event: bytes) -> bool:
    return event[:1] != b"" and event[0] in EVENTS_WITH_OTHER_BODIES


def _text(content: bytes) -> str:
    return content.rstrip(b"\0").decode(errors="replace")[:ANSWER_SHOWN_MAX_CHARS]


class QtmHandshake(Handshake):
    """Asks for version, names and stream, each after the answer to the one before; later for names that may have changed."""

    def __init__(self) -> None:
        self._packets = LengthSplitter(_next_packet)
        self._requests = [VERSION_REQUEST, NAMES_REQUEST, STREAM_REQUEST]

    @property
    def is_ready(self) -> bool:
        return not self._requests

    def on_data(self, data: bytes) -> bytes:
        answer = b""
        for frame in self._packets.split(data):
            if frame is None:
                raise HandshakeError(self._packets.fault)
            kind, content = int.from_bytes(frame[:4], "little"), frame[4:]
            if kind == ERROR:
                raise HandshakeError(f"QTM answers: {_text(content)}")
            if self._requests and kind in (COMMAND, SETTINGS):
                answer += command(self._requests.pop(0))
            elif kind == EVENT and not self._requests and _names_may_change(content):
                answer += command(NAMES_REQUEST)
        return answer


class QtmDecoder(FrameDecoder):
    """Decodes the packets of a QTM server."""

    name: ClassVar[str] = "QTM"
    starts_whole: ClassVar[bool] = True
    defined_pose: ClassVar[PoseForm | None] = PoseForm(RotationForm.COLUMNS)

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._choice = BodyChoice()
        self._names: tuple[str, ...] | None = None
        """Of the bodies; `None` until they are known."""
        self._frame_number = -1
        self.units[Stream.TOOL] = "pose of a body in the frame of QTM's calibration, m"

    def _make_splitter(self) -> FrameSplitter:
        return LengthSplitter(_next_packet)

    def _decode(self, frame: bytes) -> Loss | None:
        kind, content = int.from_bytes(frame[:4], "little"), frame[4:]
        if kind == OPTIONS_KIND:
            return None if self._choice.read_options(content) else Loss.UNREADABLE
        if kind == DATA:
            return self._decode_data(content)
        if kind == SETTINGS:
            self._names = read_names(content)
        elif kind == NO_MORE_DATA:
            self._status = "QTM does not measure: start a measurement, or play a file with real-time output"
        elif kind == EVENT and _names_may_change(content):
            self._names = None
        return None

    def _decode_data(self, content: bytes) -> Loss | None:
        poses = _find_bodies(content)
        if poses is None or self._names is None:
            self._problem = "A data packet of QTM cannot be read" if poses is None else "QTM has not named its bodies"
            return Loss.UNREADABLE
        time_us, number, _ = DATA_STRUCT.unpack_from(content)
        if number == self._frame_number:
            return Loss.REPEATED
        self._frame_number = number
        self.valid_records += 1
        self._count_gap(number)
        if len(poses) != len(self._names):
            self._status = f"QTM sends {len(poses)} bodies and names {len(self._names)}: enable all of them in its project"
            return Loss.NO_POSE
        index = self._choice.index_of(self._names)
        if index is None:
            self._status = self._choice.problem
            return Loss.NO_POSE
        body = self._choice.label(self._names, index)
        values = np.array(poses[index], dtype=np.float64)
        if not np.isfinite(values).all():
            self._status = f"QTM does not see the body {body}"
            return Loss.NO_POSE
        self._status = ""
        self.units[Stream.TOOL] = f"pose of {body} in the frame of QTM's calibration, m"
        return self._add(Stream.TOOL, NO_SEQ, time_us / US_PER_S, np.concatenate([values[:3] * 1e-3, values[3:]]))


def _find_bodies(content: bytes) -> Sequence[tuple[float, ...]] | None:
    """Return the 12 floats of each body of a data packet; `None` if it has no such component, or sizes do not fit."""
    if len(content) < DATA_STRUCT.size:
        return None
    count, at, found = DATA_STRUCT.unpack_from(content)[2], DATA_STRUCT.size, None
    for _ in range(count):
        if len(content) - at < COMPONENT_STRUCT.size:
            return None
        size, kind = COMPONENT_STRUCT.unpack_from(content, at)
        if size < COMPONENT_STRUCT.size or at + size > len(content):
            return None
        if kind == BODIES_KIND:
            body = content[at + COMPONENT_STRUCT.size : at + size]
            bodies = BODIES_STRUCT.unpack_from(body)[0] if len(body) >= BODIES_STRUCT.size else -1
            if len(body) != BODIES_STRUCT.size + 4 * BODY_FLOATS * bodies:
                return None
            floats = struct.unpack_from(f"<{BODY_FLOATS * bodies}f", body, BODIES_STRUCT.size)
            found = [floats[first : first + BODY_FLOATS] for first in range(0, len(floats), BODY_FLOATS)]
        at += size
    return found if at == len(content) else None


def _with_options(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    del questions
    head = packet(OPTIONS_KIND, write_options(address.options.get("body", "")))
    return replace(address, first_bytes=head, handshake=QtmHandshake())


_VECTOR_BODY = bytes.fromhex(
    "0000c842000048c300009643"
    "0b55503fb28ff03e441dafbec5c6e1beb9ef613f9617273eadcdc13e1cb0933c1ae86c3f"
)  # fmt: skip
"""x y z (100, -200, 300) mm; R = Rz(30) Ry(20) Rx(10) degrees, column by column."""
_VECTOR_SETTINGS = packet(SETTINGS, b"<The_6D><Bodies>1</Bodies><Body><Name>probe</Name></Body></The_6D>\0")
_VECTOR_LIST = b"\x01\x00\x00\x00\x00\x00\x00\x00" + _VECTOR_BODY


def _vector_frame(number: int) -> bytes:
    component = COMPONENT_STRUCT.pack(COMPONENT_STRUCT.size + len(_VECTOR_LIST), BODIES_KIND) + _VECTOR_LIST
    return packet(DATA, DATA_STRUCT.pack(12_500_000, number, 1) + component)


_VECTOR_POSE = (
    0.813797652721405, -0.4409696161746979, 0.3785223066806793, 0.1,
    0.46984630823135376, 0.882564127445221, 0.01802831143140793, -0.2,
    -0.3420201539993286, 0.16317591071128845, 0.9254165887832642, 0.3,
)  # fmt: skip
"""Upper rows of the pose, as the floats of 32 bits have it."""

DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="qtm://192.168.1.2?body=probe",
            form=Form.HOST,
            transport="tcp",
            format="qtm",
            port=22223,
            options=("body",),
            needs_every_byte=True,
            prepare=_with_options,
        ),
    ),
    decoders={"qtm": QtmDecoder},
    vectors=(
        Vector(
            "qtm",
            (Stream.TOOL,),
            packet(OPTIONS_KIND, write_options("probe")) + _VECTOR_SETTINGS + _vector_frame(7),
            (_VECTOR_POSE,),
        ),
    ),
)
