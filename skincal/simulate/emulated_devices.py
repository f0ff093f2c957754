"""What makers' devices send, as bytes: the encoders of `--as`, and what each device answers to its host.

Written from the formats' descriptions, as the decoders are, and sharing nothing with them, so that each checks the other.
How the bytes leave is the affair of `maker_outlets`.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError
from skincal.model.readings import Stream

COUNTS = 1_000_000
"""Counts of the simulated Net F/T for each N and N m."""
EPOCH_S = 1_700_000_000
"""s. A robot's clock shows the time of day."""


class MakerEncoder:
    """A maker's device: no header, one kind of reading; it counts its records."""

    def __init__(self) -> None:
        self._count = 0

    def header(self, t_us: int, fields: str, width: int) -> bytes:
        """Return nothing: such a device says nothing of itself."""
        del t_us, fields, width
        return b""

    def wrenches(self, t_us: IntArray, wrenches: FloatArray) -> bytes:
        """Return (n, 6) wrenches, N and N m, stamped (n,) microseconds."""
        return b"".join(self._wrench(t, wrench) for t, wrench in zip(t_us.tolist(), wrenches.tolist(), strict=True))

    def skin(self, t_us: int, values: FloatArray) -> bytes:
        """Return one frame of raw values."""
        raise NotImplementedError

    def joints(self, t_us: int, degrees: FloatArray) -> bytes:
        """Return one set of angles, degrees."""
        raise NotImplementedError

    def _wrench(self, t_us: int, wrench: list[float]) -> bytes:
        raise NotImplementedError

    def _next(self) -> int:
        self._count += 1
        return self._count


class RdtEncoder(MakerEncoder):
    """Records of ATI's RDT."""

    def _wrench(self, t_us: int, wrench: list[float]) -> bytes:
        number = self._next()
        counts = (max(min(round(value * COUNTS), 2**31 - 1), -(2**31)) for value in wrench)
        return struct.pack(">3I6i", number % 2**32, t_us * 7 % 2**32, 0, *counts)


def _table(polynomial: int) -> list[int]:
    """Return the table of a mirrored CRC of 16 bits."""
    table = list(range(256))
    for _ in range(8):
        table = [value >> 1 ^ (polynomial if value & 1 else 0) for value in table]
    return table


X25, MODBUS = _table(0x8408), _table(0xA001)


def _crc(table: list[int], data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ table[(crc ^ byte) & 0xFF]
    return crc


class BotaEncoder(MakerEncoder):
    """Frames of Bota's serial sensors, at 31.5 degrees."""

    def _wrench(self, t_us: int, wrench: list[float]) -> bytes:
        data = struct.pack("<H6fIf", 0, *wrench, t_us % 2**32, 31.5)
        return b"\xaa" + data + struct.pack("<H", _crc(X25, data) ^ 0xFFFF)


class RobotiqEncoder(MakerEncoder):
    """Frames of the FT 300's serial stream."""

    def _wrench(self, t_us: int, wrench: list[float]) -> bytes:
        del t_us
        counts = [value * (100 if axis < 3 else 1000) for axis, value in enumerate(wrench)]
        frame = b"\x20\x4e" + np.clip(np.round(counts), -32768, 32767).astype("<i2").tobytes()
        return frame + struct.pack("<H", _crc(MODBUS, frame))


class RobotiqTextEncoder(MakerEncoder):
    """The text of a UR controller with Robotiq's URCap."""

    def _wrench(self, t_us: int, wrench: list[float]) -> bytes:
        del t_us
        words = [f"{value:.{2 if axis < 3 else 4}f}" for axis, value in enumerate(wrench)]
        return f"({' , '.join(words)})".encode()


class RtdeEncoder(MakerEncoder):
    """Data packets of a UR controller, recipe 1: time and one field."""

    BYTES = 60

    def _wrench(self, t_us: int, wrench: list[float]) -> bytes:
        return struct.pack(">HBB7d", self.BYTES, ord("U"), 1, t_us / 1e6, *wrench)

    def joints(self, t_us: int, degrees: FloatArray) -> bytes:
        """See `MakerEncoder`: a UR has six."""
        angles = np.zeros(6)
        angles[: len(degrees)] = np.radians(degrees[:6])
        return self._wrench(t_us, angles.tolist())


class YarpEncoder(MakerEncoder):
    """Messages of a YARP port: a vector with an envelope."""

    def skin(self, t_us: int, values: FloatArray) -> bytes:
        """See `MakerEncoder`."""
        return self._wrench(t_us, values.tolist())

    def joints(self, t_us: int, degrees: FloatArray) -> bytes:
        """See `MakerEncoder`."""
        return self._wrench(t_us, degrees.tolist())

    def _wrench(self, t_us: int, wrench: list[float]) -> bytes:
        words = b"D %d %.15g\x00" % (self._next(), EPOCH_S + t_us / 1e6)
        command = struct.pack("<i", len(words)) + b"\x7e\x00\x00\x01" + words
        head, body = struct.pack("<2i", 266, len(wrench)), struct.pack(f"<{len(wrench)}d", *wrench)
        lengths = struct.pack("<4i", len(command), len(head), len(body), 0)
        return b"YA\x0a\x00\x00\x00RP\x03\x01" + b"\xff" * 8 + lengths + command + head + body


class XelaEncoder(MakerEncoder):
    """Messages of XELA's server, a line each; one sensor, the pressure in z."""

    def skin(self, t_us: int, values: FloatArray) -> bytes:
        """See `MakerEncoder`."""
        words = ",".join(f"8000,8000,{int(value) & 0xFFFF:04X}" for value in values.tolist())
        sensor = {"sensor": "1", "model": "XR1944", "taxels": len(values), "time": t_us / 1e6, "data": words}
        return json.dumps({"message": self._next(), "1": sensor}).encode() + b"\n"


PILLARS = 64
"""Pillars of a simulated sensor, more than the maker's 9: the scenes' skins are larger."""
PAPILLARRAY_MAX = 256
"""Channels that fit the longest frame."""


class PapillArrayEncoder(MakerEncoder):
    """Frames of Contactile's hub, the pressure in Fz."""

    def skin(self, t_us: int, values: FloatArray) -> bytes:
        """See `MakerEncoder`."""
        if len(values) > PAPILLARRAY_MAX:
            raise InputError(f"A PapillArray has at most {PAPILLARRAY_MAX} channels here; the scene has {len(values)}.")
        sensors = [values[at : at + PILLARS].tolist() for at in range(0, len(values), PILLARS)]
        block = struct.pack("<H", len(sensors)) + bytes(2 * len(sensors))
        for sensor in sensors:
            block += struct.pack("<H", len(sensor)) + bytes(2 * len(sensor))
            block += b"".join(struct.pack("<H6f", 2, 0, 0, -value, 0, 0, 0) for value in sensor)
        hub = struct.pack("<IQ", self._next(), t_us)
        index = struct.pack("<BHHHH", 2, 1, 9, 3, 9 + len(hub))
        data = index + hub + block
        return bytes.fromhex("55667788") + data + struct.pack("<H", sum(data) & 0xFFFF) + bytes.fromhex("aabbccdd")


# ------------------------------------------------------------------ what a device answers its host


class DeviceTalk(Protocol):
    """A device's side of the talk with one host."""

    ready: bool
    """Whether the host has asked for readings."""
    over: bool
    """Whether the device closes the connection once all is sent."""

    def hear(self, data: bytes) -> bytes:
        """Return the answer to what a host said."""
        ...

    def wrap(self, data: bytes) -> bytes:
        """Return readings as they travel."""
        ...


class PlainTalk:
    """A device that sends without being asked."""

    def __init__(self) -> None:
        self.ready, self.over = True, False
        self.heard = b""

    def hear(self, data: bytes) -> bytes:
        """See `DeviceTalk`."""
        self.heard += data
        return b""

    def wrap(self, data: bytes) -> bytes:
        """See `DeviceTalk`."""
        return data


class RtdeTalk(PlainTalk):
    """A UR controller with a sensor at its flange, of which one field moves: the others that are asked for are zeros."""

    KINDS: Mapping[bytes, bytes] = MappingProxyType(
        {b"timestamp": b"DOUBLE", b"ft_raw_wrench": b"VECTOR6D", b"actual_q": b"VECTOR6D"}
    )

    TIME, OTHER = slice(4, 12), bytes(48)

    def __init__(self, field: bytes = b"ft_raw_wrench") -> None:
        super().__init__()
        self.ready = False
        self._field = field
        self._asked: list[bytes] = []

    def hear(self, data: bytes) -> bytes:
        """See `DeviceTalk`."""
        self.heard += data
        out = b""
        while len(self.heard) >= 3 and len(self.heard) >= (length := int.from_bytes(self.heard[:2], "big")):
            kind, payload, self.heard = self.heard[2:3], self.heard[3:length], self.heard[length:]
            answer = b"\x01"
            if kind == b"O":
                self._asked = payload[8:].split(b",")
                answer += b",".join(self.KINDS.get(name, b"NOT_FOUND") for name in self._asked)
            self.ready = self.ready or kind == b"S"
            out += struct.pack(">HB", 3 + len(answer), kind[0]) + answer
        return out

    def wrap(self, data: bytes) -> bytes:
        """See `DeviceTalk`: the fields as they were asked for."""
        if self._asked == [b"timestamp", self._field]:
            return data
        size = RtdeEncoder.BYTES
        return b"".join(self._packet(data[at : at + size]) for at in range(0, len(data), size))

    def _packet(self, packet: bytes) -> bytes:
        known = {b"timestamp": packet[self.TIME], self._field: packet[self.TIME.stop :]}
        body = b"".join(known.get(name, self.OTHER) for name in self._asked)
        return struct.pack(">HBB", 4 + len(body), ord("U"), 1) + body


class YarpTalk(PlainTalk):
    """A YARP port towards a reader."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.ready = False
        self._number = number
        self._greeted = False

    def hear(self, data: bytes) -> bytes:
        """See `DeviceTalk`."""
        self.heard += data
        if not self._greeted and len(self.heard) >= 12:
            length = int.from_bytes(self.heard[8:12], "little")
            if len(self.heard) >= 12 + length:
                self._greeted, self.heard = True, self.heard[12 + length :]
                return b"YA" + struct.pack("<i", self._number) + b"RP"
        self.ready = self._greeted and b"~r\x00\x01" in self.heard
        return b""


class SkinManagerTalk(PlainTalk):
    """The RPC port of a skinManager: one part, its poses and confidences, which all who ask share.

    It answers as icub-main's `skinManager.cpp` does, messages as a port of YARP 3.12 frames them.
    """

    PART, NUMBER = "r_forearm", 5

    def __init__(self, number: int, poses: FloatArray) -> None:
        """Take the port's number and (width, 7) poses with their confidence, which questions change."""
        super().__init__()
        self.ready = False
        self._number, self._poses = number, poses
        self._greeted = False

    def hear(self, data: bytes) -> bytes:
        """See `DeviceTalk`."""
        self.heard += data
        out = b""
        if not self._greeted and len(self.heard) >= 12:
            length = int.from_bytes(self.heard[8:12], "little")
            if len(self.heard) >= 12 + length:
                self._greeted, self.heard = True, self.heard[12 + length :]
                out = b"YA" + struct.pack("<i", self._number) + b"RP"
        while self._greeted and len(self.heard) >= 30:
            first, second = struct.unpack_from("<2i", self.heard, 18)
            if len(self.heard) < 30 + first + second:
                break
            bottle, self.heard = self.heard[30 + first : 30 + first + second], self.heard[30 + first + second :]
            answer = _rpc_bottle(self.answer(_rpc_values(bottle)))
            out += b"YA\x0a\x00\x00\x00RP\x01\x01" + b"\xff" * 8 + struct.pack("<2i", len(answer), 0) + answer
        return out

    def answer(self, words: list[str | int | float]) -> list[str | int | float]:
        """Return what skinManager answers."""
        match words:
            case ["get", "skin"]:
                return [self.NUMBER, self.PART]
            case ["get", "pose", self.NUMBER]:
                return [*self._poses.ravel().tolist()]
            case ["get", "pose", int()]:
                return []
            case ["set", "pose", int() as part, int() as taxel, *numbers]:
                return self._change(part, taxel, numbers, slice(0, 6), (6,))
            case ["set", "position", int() as part, int() as taxel, *numbers]:
                return self._change(part, taxel, numbers, slice(0, 3), (3, 4))
            case _:
                return ["Unknown command. Input 'help' to get a list of the available commands."]

    def _change(
        self, part: int, taxel: int, numbers: list[str | int | float], where: slice, sizes: tuple[int, ...]
    ) -> list[str | int | float]:
        if part != self.NUMBER or not 0 <= taxel < len(self._poses) or len(numbers) not in sizes:
            return [1, "ERROR: pose was not set" if sizes == (6,) else "ERROR: position was not set"]
        self._poses[taxel, where] = numbers[: where.stop]
        if len(numbers) == 4:
            self._poses[taxel, 6] = numbers[3]
        return [0]


def _rpc_values(bottle: bytes) -> list[str | int | float]:
    """Return what a question's bottle holds: words, whole numbers and floats."""
    kind, count = struct.unpack_from("<2i", bottle)
    values: list[str | int | float] = []
    at = 8
    for _ in range(count):
        tag = kind & 255
        if not tag:
            (tag,) = struct.unpack_from("<i", bottle, at)
            at += 4
        if tag == 4:
            (size,) = struct.unpack_from("<i", bottle, at)
            values.append(bottle[at + 4 : at + 4 + size].decode())
            at += 4 + size
        else:
            values += struct.unpack_from("<i" if tag == 1 else "<d", bottle, at)
            at += 4 if tag == 1 else 8
    return values


def _rpc_bottle(values: list[str | int | float]) -> bytes:
    """Return an answer's bottle, every value with its kind but where all of them are floats, as YARP writes it."""
    if values and all(isinstance(value, float) for value in values):
        return struct.pack(f"<2i{len(values)}d", 266, len(values), *values)
    out = struct.pack("<2i", 256, len(values))
    for value in values:
        if isinstance(value, str):
            out += struct.pack("<2i", 4, len(value)) + value.encode()
        else:
            out += struct.pack("<2i", 1, value) if isinstance(value, int) else struct.pack("<id", 10, value)
    return out


class NameTalk(PlainTalk):
    """A YARP name server: a line of its short form, or the lines of a connection."""

    def __init__(self, ports: Mapping[str, int]) -> None:
        super().__init__()
        self.ready = False
        self._ports = ports

    def hear(self, data: bytes) -> bytes:
        """See `DeviceTalk`."""
        self.heard += data
        asked = re.search(rb"(?:NAME_SERVER |d\r?\n)(query (\S+)|list)\r?\n", self.heard)
        if asked is None:
            return b""
        self.over = True
        names = self._ports if asked[2] is None else [asked[2].decode(errors="replace")]
        lines = [
            f"registration name {name} ip 127.0.0.1 port {self._ports[name]} type tcp\r\n"
            for name in names
            if name in self._ports
        ]
        greeting = "Welcome skincal\r\n" if self.heard.startswith(b"CONNECT") else ""
        return (greeting + "".join(lines) + "*** end of message\r\n").encode()


class PageTalk(PlainTalk):
    """The web page of a Net F/T."""

    def __init__(self) -> None:
        super().__init__()
        self.ready = False

    def hear(self, data: bytes) -> bytes:
        """See `DeviceTalk`."""
        self.heard += data
        if b"\r\n\r\n" not in self.heard:
            return b""
        self.over = True
        page = (
            f"<?xml version='1.0'?><netft><prodname>Ethernet Axia80</prodname><cfgcpf>{COUNTS}</cfgcpf>"
            f"<cfgcpt>{COUNTS}</cfgcpt><scfgfu>N</scfgfu><scfgtu>Nm</scfgtu></netft>"
        ).encode()
        return b"HTTP/1.0 200 OK\r\nContent-Type: text/xml\r\n\r\n" + page


class XelaTalk(PlainTalk):
    """XELA's server."""

    def __init__(self) -> None:
        from websockets.server import ServerProtocol

        super().__init__()
        self.ready = False
        self._protocol = ServerProtocol()

    def hear(self, data: bytes) -> bytes:
        """See `DeviceTalk`."""
        from websockets.http11 import Request

        self._protocol.receive_data(data)
        for event in self._protocol.events_received():
            if isinstance(event, Request):
                self._protocol.send_response(self._protocol.accept(event))
                self._protocol.send_text(b'{"message": "Welcome", "sensors": 1}')
                self.ready = True
        return b"".join(self._protocol.data_to_send())

    def wrap(self, data: bytes) -> bytes:
        """See `DeviceTalk`."""
        for message in data.splitlines():
            self._protocol.send_text(message)
        return b"".join(self._protocol.data_to_send())


@dataclass(frozen=True, slots=True)
class Maker:
    """A kind of device that can be simulated."""

    carries: tuple[Stream, ...]
    encoder: Callable[[], MakerEncoder]
    hz: float
    """Readings a second; 0: those of any board."""
    serial: bool = False
    """It has a serial port, whose line may damage bytes."""


WRENCH, SKIN, JOINTS = (Stream.WRENCH,), (Stream.SKIN,), (Stream.JOINTS,)
MAKERS: Mapping[str, Maker] = MappingProxyType(
    {
        "netft": Maker(WRENCH, RdtEncoder, 0.0),
        "bota": Maker(WRENCH, BotaEncoder, 800.0, serial=True),
        "robotiq": Maker(WRENCH, RobotiqEncoder, 100.0, serial=True),
        "robotiq-text": Maker(WRENCH, RobotiqTextEncoder, 125.0),
        "rtde": Maker((*WRENCH, *JOINTS), RtdeEncoder, 125.0),
        "yarp": Maker((*WRENCH, *SKIN, *JOINTS), YarpEncoder, 0.0),
        "xela": Maker(SKIN, XelaEncoder, 100.0),
        "papillarray": Maker(SKIN, PapillArrayEncoder, 100.0, serial=True),
    }
)
"""By the name that `--as` takes."""


def assign_devices(names: tuple[str, ...], streams: tuple[Stream, ...]) -> dict[Stream, str]:
    """Return who sends each stream: of the named ones the first that can, and where none can, nobody.

    Raises
    ------
    InputError
        A name is not known, or has nothing to send.
    """
    spoken: dict[Stream, str] = {}
    for name in names:
        if name not in MAKERS:
            raise InputError(f"--as names {name!r}; expected some of {', '.join(MAKERS)}.")
        free = [stream for stream in MAKERS[name].carries if stream in streams and stream not in spoken]
        if not free:
            can = " or ".join(stream.value for stream in MAKERS[name].carries)
            raise InputError(f"--as names {name}, which sends {can}: the scene has none that no other of --as sends.")
        spoken |= dict.fromkeys(free, name)
    return spoken
