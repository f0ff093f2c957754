"""A YARP port read without YARP: the name server's line, the handshake of a `fast_tcp` reader, messages and binary bottles.

All integers are little-endian. A "YARP int" is 8 bytes, `YA`, int32, `RP`. A reader sends 7777 + 3 (`fast_tcp`) and its
name, gets the port's number, and asks to be a reader; then messages come, and nothing is ever sent back. A message is the
YARP int 10, the numbers of its blocks (one byte each way) and eight bytes FF, the blocks' lengths, the blocks, which are
joined. The body begins with the port command, which may hold the envelope: sequence number and stamp. Text mode is never
asked for on such a port: publishers that convert themselves on the way out can crash by it. Sources: robotology/yarp 3.0 to
4.0 (`Protocol.cpp`, `PortCommand.cpp`, `BottleImpl.cpp`), and what a name server and ports of 3.12.3 sent.

A port that answers (RPC) is spoken to over the same carrier, without asking to be a reader: a message whose port command is
`d` and whose payload is a bottle; the answer is a message that is a bottle from its first byte.

Angles of joint ports are degrees. Of `measures:o` the sixth group holds six-axis sensors, the ninth skin patches, each
measure with a stamp of its own; of `stateExt:o` the first element is the joints' angles.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Sequence
from typing import ClassVar, TypeAlias

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.readings import Loss, Stream
from skincal.streams.decoders.base import NO_SEQ, PieceDecoder, Pieces
from skincal.streams.decoders.dialogue import Dialogue, DialogueError
from skincal.streams.decoders.yarp_log import SEQ_MAX, STAMP_MAX, Steps

Value: TypeAlias = "float | str | FloatArray | list[Value]"
"""One value of a bottle; a list of numbers is an array."""

YARP_INT = struct.Struct("<2si2s")
FAST_TCP, MESSAGE = 7780, 10
INT32 = struct.Struct("<i")
HEAD_BYTES = YARP_INT.size + 10
"""YARP int, two counts, eight bytes FF."""
MESSAGE_MAX = 1 << 20
"""Bytes. A skin of 4,200 channels has 33,600; a longer message is refused before it is kept."""
BLOCK_MAX = 1 << 24
DEPTH_MAX = 8
READER_NAME = b"skincal\x00"
"""No slash in front: that would announce a port."""
HELLO = YARP_INT.pack(b"YA", FAST_TCP, b"RP") + INT32.pack(len(READER_NAME)) + READER_NAME
BECOME_READER = struct.pack("<2si2s2B8si4s4s", b"YA", MESSAGE, b"RP", 1, 1, b"\xff" * 8, 8, bytes(4), bytes(4)) + b"~r\x00\x01"
MEASURES_WRENCH, MEASURES_SKIN, MEASURES_LISTS = 5, 8, 10
"""Places in the groups of `measures:o`, and how many groups older versions have; newer ones have 12."""
STATE_EXT = (22, 24)
"""Elements of `stateExt:o`, of 3.x and of 4.0."""

_LIST, _DICT, _STRING, _BLOB, _VOCAB = 256, 512, 4, 12, 9
_NUMBERS = {32: "<i1", 64: "<i2", 1: "<i4", 17: "<i8", 128: "<f4", 10: "<f8"}
"""Numbers by their tag; a list of one kind has 256 more."""
NAME_LINE = re.compile(r"registration name (\S+) ip (\S+) port (\d+) type (\S+)")
NAME_END = b"*** end of message"


class PortBottleError(ValueError):
    """Bytes are no bottle."""


# ------------------------------------------------------------------ the name server


def name_query(port: str) -> bytes:
    """Return the lines that ask a name server for a port, or for all of them where it is empty."""
    return f"NAME_SERVER query {port}\n".encode() if port else b"CONNECT skincal\nd\nlist\n"


def read_names(answer: bytes) -> dict[str, tuple[str, int]]:
    """Return host and number of each port that a name server's answer registers."""
    found = NAME_LINE.findall(answer.decode("utf-8", "replace"))
    ports = {name: (host, int(number)) for name, host, number, _ in found if host != "none" and len(number) < 6}
    return {name: place for name, place in ports.items() if 0 < place[1] < 1 << 16}


# ------------------------------------------------------------------ the handshake


class YarpDialogue(Dialogue):
    """The few words of a reader; what follows is looked at for its lengths alone."""

    def __init__(self) -> None:
        self._messages = Messages()
        self._asked = False

    def opening(self) -> bytes:
        """See `Dialogue`."""
        return HELLO

    def hear(self, data: bytes) -> bytes:
        """See `Dialogue`."""
        self._messages.split(data)
        if self._messages.fault:
            raise DialogueError(self._messages.fault)
        if self._messages.port is not None and not self._asked:
            self._asked = True
            return BECOME_READER
        return b""

    @property
    def ready(self) -> bool:
        """See `Dialogue`."""
        return self._asked


# ------------------------------------------------------------------ messages


class Messages:
    """Cuts what a port sends into the bodies of its messages; after what is none, nothing is one."""

    def __init__(self) -> None:
        self.port: int | None = None
        """Number of the port, once it said it."""
        self.fault = ""
        """What came that is no message, a sentence; empty if nothing did."""
        self._rest = bytearray()

    @property
    def holds(self) -> bool:
        """See `Pieces`."""
        return bool(self._rest or self.fault)

    def split(self, data: bytes) -> list[bytes | None]:
        """See `Pieces`."""
        pieces: list[bytes | None] = []
        if self.fault:
            return pieces
        self._rest += data
        try:
            while (piece := self._next()) is not None:
                pieces.append(piece)
        except PortBottleError as error:
            self.fault = str(error)
            self._rest.clear()
            pieces.append(None)
        return pieces

    def _next(self) -> bytes | None:
        if self.port is None:
            if len(self._rest) < YARP_INT.size:
                return None
            self.port = self._yarp_int()
            del self._rest[: YARP_INT.size]
        if len(self._rest) < HEAD_BYTES:
            return None
        if self._yarp_int() != MESSAGE:
            raise PortBottleError("what it sends is no YARP message")
        count_in, count_out = self._rest[YARP_INT.size], self._rest[YARP_INT.size + 1]
        start = HEAD_BYTES + 4 * (count_in + count_out)
        if len(self._rest) < start:
            return None
        lengths = struct.unpack_from(f"<{count_in + count_out}i", self._rest, HEAD_BYTES)
        if min(lengths, default=0) < 0 or sum(lengths) > MESSAGE_MAX:
            raise PortBottleError(f"it announces a message of {sum(lengths)} bytes; at most {MESSAGE_MAX} are taken")
        end = start + sum(lengths)
        if len(self._rest) < end:
            return None
        # The block of the reply's direction, always empty, stands behind the others.
        piece = bytes(self._rest[start : start + sum(lengths[:count_in])])
        del self._rest[:end]
        return piece

    def _yarp_int(self) -> int:
        begin, number, end = YARP_INT.unpack_from(self._rest)
        if begin != b"YA" or end != b"RP":
            raise PortBottleError("what answers there is no YARP port")
        return number


def split_envelope(body: bytes) -> tuple[int, float, bytes]:
    """Return sequence number, stamp in seconds and payload of a message's body; `NO_SEQ` and NaN without an envelope.

    Raises
    ------
    PortBottleError
        It is no data.
    """
    if len(body) < 8:
        raise PortBottleError("a message is too short")
    (length,) = INT32.unpack_from(body)
    if body[4:5] != b"~" or not 0 <= length <= len(body) - 8:
        raise PortBottleError("a message has no port command")
    if length == 0:
        if body[5:6] not in b"Dd":
            raise PortBottleError("a message is no data")
        return NO_SEQ, math.nan, body[8:]
    words = body[8 : 8 + length].rstrip(b"\x00").split()
    try:
        command, seq, stamp = words[0], int(words[1]), float(words[2])
    except (IndexError, ValueError):
        raise PortBottleError("an envelope cannot be read") from None
    if command not in (b"D", b"d", b"do") or not abs(seq) < SEQ_MAX or not abs(stamp) < STAMP_MAX:
        raise PortBottleError("an envelope cannot be right")
    return seq, stamp, body[8 + length :]


class _Reader:
    """Reads a bottle front to back, never beyond its end."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def take(self, size: int) -> bytes:
        if not 0 <= size <= len(self._data) - self._at:
            raise PortBottleError("a length goes beyond the message")
        self._at += size
        return self._data[self._at - size : self._at]

    def int32(self) -> int:
        (value,) = INT32.unpack(self.take(4))
        return value

    def value(self, tag: int, depth: int = 0) -> Value:
        if tag in _NUMBERS:
            dtype = np.dtype(_NUMBERS[tag])
            return float(np.frombuffer(self.take(dtype.itemsize), dtype)[0])
        if tag == _VOCAB:
            return self.take(4).rstrip(b"\x00").decode("ascii", "replace")
        if tag in (_STRING, _BLOB):
            return self.take(self.int32()).decode("utf-8", "replace")
        if tag & (_LIST | _DICT) and depth < DEPTH_MAX:
            return self._list(tag & ~(_LIST | _DICT), depth)
        raise PortBottleError(f"a value is of the unknown kind {tag}")

    def _list(self, tag: int, depth: int) -> Value:
        count = self.int32()
        if count < 0 or count > len(self._data) - self._at:
            raise PortBottleError("a count goes beyond the message")
        if tag in _NUMBERS:
            dtype = np.dtype(_NUMBERS[tag])
            return np.frombuffer(self.take(count * dtype.itemsize), dtype).astype(np.float64)
        return [self.value(tag or self.int32(), depth + 1) for _ in range(count)]


def read_bottle(payload: bytes) -> Value:
    """Return the one list that a message carries. Raises PortBottleError."""
    reader = _Reader(payload)
    tag = reader.int32()
    if not tag & (_LIST | _DICT):
        raise PortBottleError("a message is no list")
    return reader.value(tag)


# ------------------------------------------------------------------ questions and answers


def write_bottle(values: Sequence[str | int | float]) -> bytes:
    """Return the bottle of some values; of values of one kind the short form, as YARP writes it."""
    tags = [_STRING if isinstance(value, str) else 1 if isinstance(value, int) else 10 for value in values]
    alike = tags[0] if len(set(tags)) == 1 else 0
    pieces = [INT32.pack(_LIST | alike), INT32.pack(len(values))]
    for tag, value in zip(tags, values, strict=True):
        if not alike:
            pieces.append(INT32.pack(tag))
        if isinstance(value, str):
            raw = value.encode()
            pieces += [INT32.pack(len(raw)), raw]
        else:
            pieces.append(struct.pack("<i" if tag == 1 else "<d", value))
    return b"".join(pieces)


def write_question(values: Sequence[str | int | float]) -> bytes:
    """Return the message that asks a port, and wants an answer."""
    bottle = write_bottle(values)
    head = struct.pack("<2si2s2B8s3i", b"YA", MESSAGE, b"RP", 2, 1, b"\xff" * 8, 8, len(bottle), 0)
    return head + bytes(4) + b"~d\x00\x01" + bottle


def read_answer(body: bytes) -> list[float | str]:
    """Return the values of an answer's body, front to back, lists in it flattened. Raises PortBottleError."""
    # Some versions put a port command in front; no bottle has these bytes there.
    payload = split_envelope(body)[2] if body[4:5] == b"~" and body[6:8] == b"\x00\x01" else body
    return list(_flat(read_bottle(payload)))


def _flat(value: Value) -> Iterator[float | str]:
    if isinstance(value, float | int | str):
        yield value
        return
    for each in value.tolist() if isinstance(value, np.ndarray) else value:
        yield from _flat(each)


# ------------------------------------------------------------------ readings


def as_vector(value: Value) -> FloatArray | None:
    """Return the numbers of a list, integers among them or the list in a list, too; None where there is something else."""
    if isinstance(value, list) and len(value) == 1 and isinstance(value[0], (list, np.ndarray)):
        return as_vector(value[0])
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, list) and value and all(isinstance(each, float) for each in value):
        return np.array(value, np.float64)
    return None


def measures(groups: list[Value], which: int) -> list[tuple[FloatArray, float]]:
    """Return numbers and stamp, seconds, of each measurement of one group of `measures:o`."""
    group = groups[which]
    found: list[tuple[FloatArray, float]] = []
    for measure in group if isinstance(group, list) else []:
        if isinstance(measure, list) and len(measure) == 2 and isinstance(measure[1], float):
            values = as_vector(measure[0])
            if values is not None and abs(measure[1]) < STAMP_MAX:
                found.append((values, measure[1]))
    return found


class YarpPortDecoder(PieceDecoder):
    """Decodes what a YARP port sends to a reader."""

    name: ClassVar[str] = "YARP port"

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        self._messages = Messages()
        super().__init__(channels, carries)
        self._first = False  # A connection begins with its first message, whole.
        self._carries = carries
        self._steps = Steps()

    def _make_splitter(self) -> Pieces:
        return self._messages

    @property
    def note(self) -> str:
        """See `PieceDecoder`."""
        return f"{self._messages.fault[:1].upper()}{self._messages.fault[1:]}" or self._collector.note

    def _decode(self, piece: bytes) -> Loss | None:
        try:
            seq, stamp, payload = split_envelope(piece)
            value = read_bottle(payload)
        except PortBottleError as error:
            self._collector.note = f"A message cannot be read: {error}"
            return Loss.UNREADABLE
        missing = self._steps.missing(seq)
        if missing:
            self.counts[Loss.MISSING] += missing
        readings = self._readings(value, stamp)
        if not readings:
            return Loss.BAD_WIDTH
        self.good += 1
        problems = [self._collector.add(stream, seq, at, values) for stream, values, at in readings]
        return next((problem for problem in problems if problem), None)

    def _readings(self, value: Value, stamp: float) -> list[tuple[Stream, FloatArray, float]]:
        """Return the readings of the streams that the link carries, each with the device's time."""
        if isinstance(value, list) and len(value) >= MEASURES_LISTS and all(isinstance(each, list) for each in value):
            return self._measured(value, stamp)
        vector = as_vector(value)
        if vector is None and isinstance(value, list) and len(value) in STATE_EXT:
            vector = as_vector(value[0])
        if vector is None:
            self._collector.note = "The port's messages hold other things than numbers; name a port of a sensor, skin or joints"
            return []
        # The first stream that fits alone: `fits` would fix the width of every stream whose width is unknown.
        fitting = (stream for stream in self._carries if self._collector.fits(stream, len(vector)))
        return [(next(fitting, self._carries[0]), vector, stamp)]

    def _measured(self, groups: list[Value], stamp: float) -> list[tuple[Stream, FloatArray, float]]:
        readings: list[tuple[Stream, FloatArray, float]] = []
        sensors, patches = measures(groups, MEASURES_WRENCH), measures(groups, MEASURES_SKIN)
        if Stream.WRENCH in self._carries and sensors:
            values, at = sensors[0]
            readings.append((Stream.WRENCH, values, stamp if math.isfinite(stamp) else at))
        if Stream.SKIN in self._carries and patches:
            values = np.concatenate([values for values, _ in patches])
            readings.append((Stream.SKIN, values, stamp if math.isfinite(stamp) else patches[0][1]))
        if not readings:
            self._collector.note = "The port's measurements hold none of what is wanted; name a port of a sensor or skin"
        return readings
