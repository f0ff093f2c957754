"""Optical trackers for `--as`: their encoders, and their dialogue with a host. Each tracks a lost body and the tool, `probe`.

Written from the formats' descriptions without any code of the decoders, so that each checks the other.
`emulated_transports` sends the bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from skincal.model.readings import Stream
from skincal.simulation.board_formats import Encoder
from skincal.simulation.plain_talk import PlainTalk

LOST_BODY, TOOL_BODY = "helmet", "probe"


def _turn_of(pose: list[float]) -> list[list[float]]:
    """Return the rotation matrix of x y z and a quaternion x y z w."""
    x, y, z, w = pose[3:]
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]


def _qtm_packet(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", 8 + len(content), kind) + content


class QtmEncoder(Encoder):
    """Data packets of QTM with two bodies, positions in mm."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        turn = np.array(_turn_of(values))
        bodies = struct.pack("<12f", *[float("nan")] * 12)
        bodies += struct.pack("<12f", *(1000 * place for place in values[:3]), *turn.T.reshape(-1))
        component = struct.pack("<IIIhh", 16 + len(bodies), 5, 2, 0, 0) + bodies
        return _qtm_packet(3, struct.pack("<qII", t_us, self._number(stream) + 1, 1) + component)


class QtmTalk(PlainTalk):
    """The real-time server of QTM."""

    ready = False
    greeting = _qtm_packet(1, b"QTM RT Interface connected\0")

    def on_request(self, data: bytes) -> bytes:
        self.heard += data
        out = b""
        while len(self.heard) >= 8 and len(self.heard) >= (size := int.from_bytes(self.heard[:4], "little")) >= 8:
            said, self.heard = self.heard[8:size].rstrip(b"\0").lower(), self.heard[size:]
            out += self._answer(said)
        return out

    def _answer(self, said: bytes) -> bytes:
        if said.startswith(b"version "):
            return _qtm_packet(1, b"Version set to " + said[8:] + b"\0")
        if said == b"getparameters 6d":
            bodies = "".join(f"<Body><Name>{name}</Name><Point><X>1</X></Point></Body>" for name in (LOST_BODY, TOOL_BODY))
            return _qtm_packet(2, f"<QTM_Parameters><The_6D><Bodies>2</Bodies>{bodies}</The_6D></QTM_Parameters>\0".encode())
        if said.startswith(b"streamframes") and b"6d" in said:
            self.ready = True
            return b""
        return _qtm_packet(0, b"Parse error\0")


def _checked(text: str) -> bytes:
    """Add check sum and end to an answer of an NDI tracker."""
    crc = 0
    for byte in text.encode():
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
    return f"{text}{crc:04X}\r".encode()


class NdiEncoder(Encoder):
    """Answers of an NDI tracker to TX:0001: handle 01 is lost, 02 is the tool."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del t_us
        state = f"00000031{self._number(stream) + 1 & 0xFFFFFFFF:08X}\n"
        turn = "".join(f"{round(1e4 * values[at]):+06d}" for at in (6, 3, 4, 5))
        place = "".join(f"{round(1e5 * value):+07d}" for value in values[:3])
        return _checked(f"0201MISSING{state}02{turn}{place}+00012{state}0000")


class NdiTalk(PlainTalk):
    """An NDI tracker with two wired tools. It hands out the newest answer to each request for poses."""

    ANSWERS: Mapping[str, str] = MappingProxyType({"PHSR:01": "00", "PHSR:02": "020100102001", "PHSR:03": "020101102011"})

    def __init__(self) -> None:
        self._newest = b""
        self._is_tracking = False

    def on_request(self, data: bytes) -> bytes:
        self.heard += data
        out = b""
        while b"\r" in self.heard:
            line, self.heard = self.heard.split(b"\r", 1)
            command = line[:-4].decode(errors="replace")
            out += self._answer(command) if _checked(command) == line + b"\r" else _checked("ERROR04")
        return out

    def _answer(self, command: str) -> bytes:
        name = command.partition(":")[0]
        if name == "TX":
            return self._newest or _checked("000000" if self._is_tracking else "ERROR0C")
        if name in ("TSTART", "TSTOP"):
            self._is_tracking = name == "TSTART"
        return _checked(self.ANSWERS.get(command, "OKAY"))

    def frame(self, data: bytes) -> bytes:
        """Keep the newest answer."""
        self._newest = data[data.rstrip(b"\r").rfind(b"\r") + 1 :] if self._is_tracking and data else self._newest
        return b""


def _sized(count: int, content: bytes) -> bytes:
    """Build a section of NatNet 4.1: its count, its size, its content."""
    return struct.pack("<2i", count, len(content)) + content


class NatNetEncoder(Encoder):
    """Frames of NatNet 4.1 with two rigid bodies. The lost one has a pose, too, as Motive sends it."""

    NUMBERS = 3, 7

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        bodies = struct.pack("<i8fh", self.NUMBERS[0], 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0)
        bodies += struct.pack("<i8fh", self.NUMBERS[1], *values, 0.0004, 1)
        markers = b"all\0" + struct.pack("<i3f", 1, 1.0, 1.0, 1.0)
        labeled = struct.pack("<i4fhf", 1, 1.0, 1.0, 1.0, 0.01, 0, 0.0)
        times = struct.pack("<2id3Q2i", 0, 0, t_us / 1e6, 10 * t_us, 10 * t_us, 10 * t_us, 0, 0)
        empty = _sized(0, b"")
        sections = _sized(1, markers) + empty + _sized(2, bodies) + empty + empty + _sized(1, labeled) + empty + empty
        content = struct.pack("<i", self._number(stream) + 1) + sections + times + bytes(6)
        return struct.pack("<2H", 7, len(content)) + content


def natnet_server_info(group: bytes = bytes(4), port: int = 1511) -> bytes:
    """Build the answer of a NatNet 4.1 server whose clock has 10 MHz; a group says that it multicasts."""
    connection = struct.pack("<QHB4s", 10_000_000, port, group != bytes(4), group)
    content = b"Motive".ljust(256, b"\0") + bytes((3, 1, 0, 0, 4, 1, 0, 0)) + connection
    return struct.pack("<2H", 1, len(content)) + content


def natnet_descriptions() -> bytes:
    """Build the descriptions of the two rigid bodies, with a marker set before them."""
    found = [(0, b"all\0" + struct.pack("<i", 1) + b"Marker1\0")]
    for number, name in zip(NatNetEncoder.NUMBERS, (LOST_BODY, TOOL_BODY), strict=True):
        markers = struct.pack("<i3fi", 1, 0.0, 0.0, 0.0, 0) + b"Marker1\0"
        found.append((1, name.encode() + b"\0" + struct.pack("<2i3f", number, -1, 0.0, 0.0, 0.0) + markers))
    content = struct.pack("<i", len(found))
    content += b"".join(struct.pack("<2i", kind, len(body)) + body for kind, body in found)
    return struct.pack("<2H", 5, len(content)) + content
