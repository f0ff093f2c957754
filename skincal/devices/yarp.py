"""A YARP port read without YARP: the name server's line, the handshake of a `fast_tcp` reader, messages and binary bottles.

All integers are little-endian. A "YARP int" is 8 bytes, `YA`, int32, `RP`. A reader sends 7777 + 3 (`fast_tcp`) and its
name, gets the port's number, and asks to be a reader; then messages come, and nothing is ever sent back. A message is the
YARP int 10, the numbers of its blocks (one byte each way) and eight bytes FF, the blocks' lengths, the blocks, which are
joined. The body begins with the port command, which may hold the envelope: sequence number and stamp. Text mode is never
asked for on such a port: publishers that convert themselves on the way out can crash by it. Sources: robotology/yarp 3.0 to
4.0 (`Protocol.cpp`, `PortCommand.cpp`, `BottleImpl.cpp`), and what a name server and ports of 3.12.3 sent.

A port that answers (RPC) is spoken to over the same carrier, without asking to be a reader: a message whose port command is
`d` and whose payload is a bottle; the answer is a message that is a bottle from its first byte.
"""

from __future__ import annotations

import math
import os
import re
import struct
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import ClassVar

import numpy as np

from skincal.devices.bottles import Value, is_measures, values_of
from skincal.devices.decoding import (
    NO_SEQ,
    SEQ_MAX,
    TIME_STAMP_MAX_S,
    FrameDecoder,
    FrameSplitter,
    LengthSplitter,
    ProtocolError,
)
from skincal.devices.family import DeviceAddress, Family, Form, Handshake, HandshakeError, Questions, Route, Vector
from skincal.devices.link import FailureKind, LinkError
from skincal.model.errors import InputError
from skincal.model.given import read_regular
from skincal.model.readings import Batch, Loss, Stream

YARP_INT_STRUCT = struct.Struct("<2si2s")
MESSAGE_START_STRUCT = struct.Struct("<2si2s2B")
NO_PORT = "what answers there is no YARP port"
FAST_TCP, MESSAGE = 7780, 10
INT32_STRUCT = struct.Struct("<i")
HEAD_BYTES = YARP_INT_STRUCT.size + 10
"""YARP int, two counts, eight bytes FF."""
MESSAGE_MAX_BYTES = 1 << 20
"""Bytes. A skin of 4,200 channels has 33,600; a longer message is refused before it is kept."""
NESTED_LIST_MAX_DEPTH = 8
READER_NAME = b"skincal\x00"
"""No slash in front: that would announce a port."""
READER_HELLO = YARP_INT_STRUCT.pack(b"YA", FAST_TCP, b"RP") + INT32_STRUCT.pack(len(READER_NAME)) + READER_NAME
BECOME_READER = struct.pack("<2si2s2B8si4s4s", b"YA", MESSAGE, b"RP", 1, 1, b"\xff" * 8, 8, bytes(4), bytes(4)) + b"~r\x00\x01"
_LIST, _DICT, _STRING, _BLOB, _VOCAB, _DOUBLE = 256, 512, 4, 12, 9, 10
_DTYPE_OF_TAG = {32: "<i1", 64: "<i2", 1: "<i4", 17: "<i8", 128: "<f4", 10: "<f8"}
"""Numbers by their tag; a list of one kind has 256 more."""
NAME_LINE = re.compile(r"registration name (\S+) ip (\S+) port (\d+) type (\S+)")
NAME_END = b"*** end of message"


# ------------------------------------------------------------------ the name server


def name_query(port: str) -> bytes:
    """Build the request to a name server for one port, or for all ports if it is empty."""
    return f"NAME_SERVER query {port}\n".encode() if port else b"CONNECT skincal\nd\nlist\n"


def read_names(answer: bytes) -> dict[str, tuple[str, int]]:
    """Read host and number of each port from a name server's answer."""
    found = NAME_LINE.findall(answer.decode("utf-8", "replace"))
    ports = {name: (host, int(number)) for name, host, number, _ in found if host != "none" and len(number) < 6}
    return {name: place for name, place in ports.items() if 0 < place[1] < 1 << 16}


# ------------------------------------------------------------------ the handshake


class YarpHandshake(Handshake):
    """Handshake of a reader. Later messages are checked for their lengths only."""

    def __init__(self) -> None:
        self._messages = MessageSplitter()
        self._asked = False

    def opening(self) -> bytes:
        return READER_HELLO

    def on_data(self, data: bytes) -> bytes:
        self._messages.split(data)
        if self._messages.fault:
            raise HandshakeError(self._messages.fault)
        if self._messages.port is not None and not self._asked:
            self._asked = True
            return BECOME_READER
        return b""

    @property
    def is_ready(self) -> bool:
        return self._asked


# ------------------------------------------------------------------ messages


class MessageSplitter(LengthSplitter):
    """Cuts the bytes of a port into the bodies of its messages. The port's number comes before the first one."""

    def __init__(self) -> None:
        super().__init__(self.next_message)
        self.port: int | None = None
        """Number of the port; `None` before the port has sent it."""
        self._is_first = True

    def next_message(self, data: bytes, at: int) -> tuple[bytes, int] | None:
        """Return the body of the message at a place of the bytes, and the place of its end; `None` while it is incomplete.

        Raises ProtocolError: it is no message.
        """
        if self._is_first:
            if len(data) < YARP_INT_STRUCT.size:
                return None
            self.port, at = _yarp_int(data, 0), YARP_INT_STRUCT.size
        if len(data) - at < HEAD_BYTES:
            return None
        first, kind, last, count_in, count_out = MESSAGE_START_STRUCT.unpack_from(data, at)
        if first != b"YA" or last != b"RP":
            raise ProtocolError(NO_PORT)
        if kind != MESSAGE:
            raise ProtocolError("what it sends is no YARP message")
        begin = at + HEAD_BYTES + 4 * (count_in + count_out)
        if len(data) < begin:
            return None
        lengths = _lengths_struct(count_in + count_out).unpack_from(data, at + HEAD_BYTES)
        size = sum(lengths)
        if size > MESSAGE_MAX_BYTES or min(lengths, default=0) < 0:
            raise ProtocolError(f"it announces a message of {size} bytes; at most {MESSAGE_MAX_BYTES} are taken")
        end = begin + size
        if len(data) < end:
            return None
        self._is_first = False
        # The block of the other direction comes last and is always empty.
        return data[begin : begin + sum(lengths[:count_in])], end


@cache
def _lengths_struct(count: int) -> struct.Struct:
    return struct.Struct(f"<{count}i")


def _yarp_int(data: bytes, at: int) -> int:
    begin, number, end = YARP_INT_STRUCT.unpack_from(data, at)
    if begin != b"YA" or end != b"RP":
        raise ProtocolError(NO_PORT)
    return number


def split_envelope(body: bytes) -> tuple[int, float, bytes]:
    """Split a message's body into sequence number, stamp in seconds and payload; `NO_SEQ` and NaN without an envelope.

    Raises
    ------
    ProtocolError
        It is no data.
    """
    if len(body) < 8:
        raise ProtocolError("a message is too short")
    (length,) = INT32_STRUCT.unpack_from(body)
    if body[4:5] != b"~" or not 0 <= length <= len(body) - 8:
        raise ProtocolError("a message has no port command")
    if length == 0:
        if body[5:6] not in b"Dd":
            raise ProtocolError("a message is no data")
        return NO_SEQ, math.nan, body[8:]
    words = body[8 : 8 + length].rstrip(b"\x00").split()
    try:
        command, seq, stamp = words[0], int(words[1]), float(words[2])
    except (IndexError, ValueError):
        raise ProtocolError("an envelope cannot be read") from None
    if command not in (b"D", b"d", b"do") or not abs(seq) < SEQ_MAX or not abs(stamp) < TIME_STAMP_MAX_S:
        raise ProtocolError("an envelope cannot be right")
    return seq, stamp, body[8 + length :]


class _Reader:
    """Reads a bottle front to back, never beyond its end."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def read_bytes(self, size: int) -> bytes:
        if not 0 <= size <= len(self._data) - self._at:
            raise ProtocolError("a length goes beyond the message")
        self._at += size
        return self._data[self._at - size : self._at]

    def int32(self) -> int:
        (value,) = INT32_STRUCT.unpack(self.read_bytes(4))
        return value

    def value(self, tag: int, depth: int = 0) -> Value:
        if tag in _DTYPE_OF_TAG:
            dtype = np.dtype(_DTYPE_OF_TAG[tag])
            return float(np.frombuffer(self.read_bytes(dtype.itemsize), dtype)[0])
        if tag == _VOCAB:
            return self.read_bytes(4).rstrip(b"\x00").decode("ascii", "replace")
        if tag in (_STRING, _BLOB):
            return self.read_bytes(self.int32()).decode("utf-8", "replace")
        if tag & (_LIST | _DICT) and depth < NESTED_LIST_MAX_DEPTH:
            return self._list(tag & ~(_LIST | _DICT), depth)
        raise ProtocolError(f"a value is of the unknown kind {tag}")

    def _list(self, tag: int, depth: int) -> Value:
        count = self.int32()
        if count < 0 or count > len(self._data) - self._at:
            raise ProtocolError("a count goes beyond the message")
        if tag in _DTYPE_OF_TAG:
            dtype = np.dtype(_DTYPE_OF_TAG[tag])
            return np.frombuffer(self.read_bytes(count * dtype.itemsize), dtype).astype(np.float64)
        return [self.value(tag or self.int32(), depth + 1) for _ in range(count)]


def read_bottle(payload: bytes) -> Value:
    """Read the list that a message carries. Raises ProtocolError."""
    reader = _Reader(payload)
    tag = reader.int32()
    if not tag & (_LIST | _DICT):
        raise ProtocolError("a message is no list")
    return reader.value(tag)


# ------------------------------------------------------------------ questions and answers


def write_bottle(values: Sequence[str | int | float]) -> bytes:
    """Write a bottle; values of one kind take the short form, as YARP writes it."""
    tags = [_STRING if isinstance(value, str) else 1 if isinstance(value, int) else 10 for value in values]
    alike = tags[0] if len(set(tags)) == 1 else 0
    bodies = [INT32_STRUCT.pack(_LIST | alike), INT32_STRUCT.pack(len(values))]
    for tag, value in zip(tags, values, strict=True):
        if not alike:
            bodies.append(INT32_STRUCT.pack(tag))
        if isinstance(value, str):
            raw = value.encode()
            bodies += [INT32_STRUCT.pack(len(raw)), raw]
        else:
            bodies.append(struct.pack("<i" if tag == 1 else "<d", value))
    return b"".join(bodies)


def write_question(values: Sequence[str | int | float]) -> bytes:
    """Write a message that asks a port for an answer."""
    bottle = write_bottle(values)
    head = struct.pack("<2si2s2B8s3i", b"YA", MESSAGE, b"RP", 2, 1, b"\xff" * 8, 8, len(bottle), 0)
    return head + bytes(4) + b"~d\x00\x01" + bottle


def read_answer(body: bytes) -> list[float | str]:
    """Read the values of an answer's body in their order, lists flattened. Raises ProtocolError."""
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


class YarpPortDecoder(FrameDecoder):
    """Decodes the messages of a YARP port."""

    name: ClassVar[str] = "YARP port"
    starts_whole: ClassVar[bool] = True

    def _make_splitter(self) -> FrameSplitter:
        self._messages = MessageSplitter()
        return self._messages

    def feed_many(self, chunks: Sequence[bytes]) -> tuple[Batch, list[int]] | None:
        """Decode chunks of whole messages, each a vector of doubles, with no number missing. Else take nothing."""
        stream, width = self._carries[0], self._widths[self._carries[0]]
        if len(self._carries) > 1 or width is None or self._messages.port is None or self._messages.has_partial_frame:
            return None
        head = struct.pack("<2i", _LIST | _DOUBLE, width)
        numbers: list[int] = []
        stamps: list[float] = []
        payloads: list[bytes] = []
        ends: list[int] = []
        try:
            for chunk in chunks:
                at = 0
                while at < len(chunk):
                    body, at = self._messages.next_message(chunk, at) or (b"", 0)
                    seq, stamp, payload = split_envelope(body)
                    if len(payload) != len(head) + 8 * width or not payload.startswith(head):
                        return None
                    numbers.append(seq)
                    stamps.append(stamp)
                    payloads.append(payload[len(head) :])
                ends.append(len(numbers))
        except ProtocolError:
            return None
        if not numbers:
            return None
        seq, device_s = np.array(numbers), np.array(stamps)
        values = np.frombuffer(b"".join(payloads), "<f8").reshape(len(numbers), width)
        if not (self._gaps.is_continued_by(seq) and np.isfinite(device_s).all() and np.isfinite(values).all()):
            return None
        self._gaps.missing_among(seq)
        self.valid_records += len(numbers)
        return self._batch(stream, seq, device_s, values), ends

    def _decode(self, frame: bytes) -> Loss | None:
        try:
            seq, stamp, payload = split_envelope(frame)
            value = read_bottle(payload)
        except ProtocolError as error:
            self._problem = f"A message cannot be read: {error}"
            return Loss.UNREADABLE
        self._count_gap(seq)
        found = {stream: values for stream in self._carries if (values := values_of(value, stream)) is not None}
        if not found:
            kind = "measurements hold none of what is wanted; name a port of a sensor or skin"
            other = "messages hold other things than numbers; name a port of a sensor, skin or joints"
            self._problem = f"The port's {kind if is_measures(value) else other}"
            return Loss.BAD_WIDTH
        self.valid_records += 1
        if not is_measures(value):
            # A vector does not name its stream.
            fitting = (stream for stream, (values, _) in found.items() if self._has_width(stream, len(values)))
            stream = next(fitting, self._carries[0])
            found = {stream: found[stream]}
        problems = [
            self._add(stream, seq, stamp if math.isfinite(stamp) else own_stamp, values)
            for stream, (values, own_stamp) in found.items()
        ]
        return next((problem for problem in problems if problem), None)


# ------------------------------------------------------------------ finding a port


CONFIG_MAX_BYTES = 1 << 16
"""Size of a file of YARP's settings: each is a line or two."""
MAX_EXAMPLE_PORTS_NAMED = 3
"""Ports named as examples if a port is unknown."""


def name_server() -> tuple[str, int]:
    """Find host and port of the name server that this machine's YARP uses, by its files; this machine if there are none."""
    folder = _config_folder()
    namespace = (_first_words(folder / "yarp_namespace.conf") or ["/root"])[0]
    name = "yarp.conf" if namespace == "/root" else re.sub("[^A-Za-z0-9]", "_", namespace) + ".conf"
    words = _first_words(folder / name)
    if len(words) > 1 and words[1].isdigit() and len(words[1]) < 6:
        return words[0], int(words[1])
    return "127.0.0.1", 10000


def _config_folder() -> Path:
    given, config = os.environ.get("YARP_CONFIG_HOME"), os.environ.get("XDG_CONFIG_HOME")
    if given:
        return Path(given)
    if config:
        return Path(config) / "yarp"
    if sys.platform == "win32":
        return Path(os.environ.get("APPDATA", "")) / "yarp" / "config"
    return Path.home() / ("Library/Preferences/yarp" if sys.platform == "darwin" else ".config/yarp")


def _first_words(path: Path) -> list[str]:
    """Read the words of a file's first line with content; none if there is no such file, or it is too large."""
    try:
        lines = read_regular(path, CONFIG_MAX_BYTES).decode("utf-8", "replace").splitlines()
    except InputError:
        return []
    words = [line.split() for line in lines if line.strip() and line.strip()[0] not in "#["]
    return words[0] if words else []


def ask_names(where: str, server: tuple[str, int], port: str, questions: Questions) -> dict[str, tuple[str, int]]:
    """Ask a name server for the place of a port, or of all ports if it is empty. Raises LinkError."""
    host, number = server
    answer = questions.ask_tcp(f"{where} (name server {host}:{number})", host, number, name_query(port), NAME_END)
    if NAME_END not in answer:
        sentence = f"{where}: what answers at {host}:{number} is no YARP name server; check the server's host and port."
        raise LinkError(FailureKind.OTHER, sentence)
    return read_names(answer)


def find_port(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    """Fill in host and number of a port, as its name server gives them. Raises LinkError."""
    server = (address.host, address.port) if address.host else name_server()
    found = ask_names(address.text, server, address.path, questions).get(address.path)
    if found is None:
        known = ask_names(address.text, server, "", questions)
        some = ", ".join(islice((name for name in known if len(name) < 80), MAX_EXAMPLE_PORTS_NAMED)) or "none"
        raise LinkError(
            FailureKind.ABSENT,
            f"{address.text}: the name server {server[0]}:{server[1]} knows no port {address.path}; it knows "
            f"{len(known)} ports, such as {some}. Start the robot's part, or check the name (skincal devices lists them).",
        )
    host, port = found
    hint = "The address is the robot's own view of itself: this machine may not reach it."
    return replace(address, host=host, port=port, place=f"(at {host}:{port} by the name server)", connect_hint=hint)


_PORT_NUMBER = bytes.fromhex("5941062900005250")
_MESSAGE_HEAD = bytes.fromhex("59410a0000005250")
_VECTOR_BYTES = _MESSAGE_HEAD + bytes.fromhex(
    "0301ffffffffffffffff1f0000000800000030000000 00000000"
    "170000007e0000014420323336203137393533353334 35322e333030363100"
    "0a01000006000000"
    "3166e2727bcf1940000000000000c0bf0000000000003e40"
    "9a9999999999b93f48afbc9af2d77a3e555555555555d5bf"
)
"""Sent by a port of YARP 3.12.3: a vector of six with an envelope."""

_PORT_ROUTE = Route(
    usage="yarp:/icub/right_arm/analog:o",
    form=Form.PATH,
    transport="tcp",
    format="yarp-port",
    handshake=lambda _: YarpHandshake(),
    needs_every_byte=True,
    prepare=find_port,
)

DEVICE_FAMILY = Family(
    routes=(
        _PORT_ROUTE,
        replace(_PORT_ROUTE, usage="yarp://SERVER:10000/icub/right_arm/analog:o", form=Form.HOST_PATH, port=10000),
    ),
    decoders={"yarp-port": YarpPortDecoder},
    vectors=(
        Vector(
            "yarp-port",
            (Stream.WRENCH,),
            _PORT_NUMBER + _VECTOR_BYTES,
            ((6.452619357174215, -0.125, 30.0, 0.1, 1e-07, -1 / 3),),
            repeat=_VECTOR_BYTES,
        ),
    ),
)
