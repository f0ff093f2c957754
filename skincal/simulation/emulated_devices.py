"""Makers' devices: their encoders for `--as`, and their dialogue with a host.

Written from the formats' descriptions without any code of the decoders, so that each checks the other.
`emulated_transports` sends the bytes.
"""

from __future__ import annotations

import json
import math
import re
import struct
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.readings import SENSOR_STREAMS, Stream
from skincal.model.scene import Scene
from skincal.model.skin import RESPONSE_MIN_OF_UNIT
from skincal.simulation.board_formats import Encoder
from skincal.simulation.emulated_skins import (
    INSPIRE_TAXELS,
    TSF85_TAXELS,
    AnySkinEncoder,
    FlexiTacEncoder,
    InspireEncoder,
    JustFloatEncoder,
    LeptrinoEncoder,
    PaxiniEncoder,
    PaxiniModuleEncoder,
    Tsf85Encoder,
)
from skincal.simulation.emulated_trackers import NatNetEncoder, NdiEncoder, QtmEncoder
from skincal.simulation.plain_talk import PlainTalk
from skincal.simulation.ros_outlets import Ros2Encoder

NETFT_COUNTS_PER_UNIT = 1_000_000
"""Counts of the simulated Net F/T per N and per N m."""
ROBOT_CLOCK_START_UNIX_S = 1_700_000_000
"""s since 1970: a robot's clock has the time of day."""


class RdtEncoder(Encoder):
    """Records of ATI's RDT."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        counts = (max(min(round(value * NETFT_COUNTS_PER_UNIT), 2**31 - 1), -(2**31)) for value in values)
        return struct.pack(">3I6i", (self._number(stream) + 1) % 2**32, t_us * 7 % 2**32, 0, *counts)


def _crc_table(polynomial: int) -> list[int]:
    """Return the table of a reflected 16-bit CRC."""
    table = list(range(256))
    for _ in range(8):
        table = [value >> 1 ^ (polynomial if value & 1 else 0) for value in table]
    return table


X25, MODBUS = _crc_table(0x8408), _crc_table(0xA001)


def _crc(table: list[int], data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ table[(crc ^ byte) & 0xFF]
    return crc


class BotaEncoder(Encoder):
    """Frames of Bota's serial sensors, at 31.5 degrees Celsius."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del stream
        data = struct.pack("<H6fIf", 0, *values, t_us % 2**32, 31.5)
        return b"\xaa" + data + struct.pack("<H", _crc(X25, data) ^ 0xFFFF)


class RobotiqEncoder(Encoder):
    """Frames of the FT 300's serial stream."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del stream, t_us
        counts = [value * (100 if axis < 3 else 1000) for axis, value in enumerate(values)]
        frame = b"\x20\x4e" + np.clip(np.round(counts), -32768, 32767).astype("<i2").tobytes()
        return frame + struct.pack("<H", _crc(MODBUS, frame))


class RobotiqTextEncoder(Encoder):
    """Text of a UR controller with Robotiq's URCap."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del stream, t_us
        words = [f"{value:.{2 if axis < 3 else 4}f}" for axis, value in enumerate(values)]
        return f"({' , '.join(words)})".encode()


UR_TCP_OFFSET = (0.0, 0.0, 0.12, 0.0, 0.0, 0.3)
"""m and rotation vector, rad: tool centre point on the pendant of the simulated UR controller."""


class RtdeEncoder(Encoder):
    """Data packets of a UR controller, recipe 1: time and one field of six values; two fields for a pose of the flange."""

    PACKET_BYTES, POSE_PACKET_BYTES = 60, 108

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        if stream is Stream.TOOL:
            fields = *_tcp_pose(values), *UR_TCP_OFFSET
            return struct.pack(">HBB13d", self.POSE_PACKET_BYTES, ord("U"), 1, t_us / 1e6, *fields)
        if stream is Stream.JOINTS:
            values = [*np.radians(values[:6]).tolist(), *[0.0] * (6 - len(values))]
        return struct.pack(">HBB7d", self.PACKET_BYTES, ord("U"), 1, t_us / 1e6, *values)


def _tcp_pose(flange: list[float]) -> list[float]:
    """Compute position and rotation vector of the tool centre point from the flange's: x y z, quaternion x y z w."""
    from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs] - slow to import

    turn = Rotation.from_quat(flange[3:])
    place = np.array(flange[:3]) + turn.apply(UR_TCP_OFFSET[:3])
    return [*place.tolist(), *(turn * Rotation.from_rotvec(UR_TCP_OFFSET[3:])).as_rotvec().tolist()]


class YarpEncoder(Encoder):
    """Messages of a YARP port: a vector with an envelope."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        words = b"D %d %.15g\x00" % (self._number(stream) + 1, ROBOT_CLOCK_START_UNIX_S + t_us / 1e6)
        command = struct.pack("<i", len(words)) + b"\x7e\x00\x00\x01" + words
        head, body = struct.pack("<2i", 266, len(values)), struct.pack(f"<{len(values)}d", *values)
        lengths = struct.pack("<4i", len(command), len(head), len(body), 0)
        return b"YA\x0a\x00\x00\x00RP\x03\x01" + b"\xff" * 8 + lengths + command + head + body


class XelaEncoder(Encoder):
    """Messages of XELA's server, one a line, of one sensor. The pressure is in z. Values in newtons are calibrated ones."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        if self.skin_axes == 3:
            words = ",".join(f"{int(value) & 0xFFFF:04X}" for value in values)
        else:
            words = ",".join(f"8000,8000,{int(value) & 0xFFFF:04X}" for value in values)
        taxels = len(values) // self.skin_axes
        sensor: dict[str, Any] = {"sensor": "1", "model": "XR1944", "taxels": taxels, "time": t_us / 1e6, "data": words}
        if self.skin_unit == "N":
            sensor["calibrated"] = values
        return json.dumps({"message": self._number(stream) + 1, "1": sensor}).encode() + b"\n"


PILLARS_PER_SENSOR = 64
"""More than the maker's 9, because the scenes' skins are larger."""
PAPILLARRAY_MAX_CHANNELS = 256
"""As many fit into the longest frame."""


class PapillArrayEncoder(Encoder):
    """Frames of Contactile's hub. The pressure is in Fz."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        most, pillars = PAPILLARRAY_MAX_CHANNELS, self._taxel_vectors(values).tolist()
        if len(pillars) > most:
            raise InputError(f"A PapillArray has at most {most} channels here; the scene has {len(pillars)}.")
        if self.skin_axes == 1:  # its z is negative under a push
            pillars = [(0.0, 0.0, -z) for _, _, z in pillars]
        sensors = [pillars[at : at + PILLARS_PER_SENSOR] for at in range(0, len(pillars), PILLARS_PER_SENSOR)]
        block = struct.pack("<H", len(sensors)) + bytes(2 * len(sensors))
        for sensor in sensors:
            block += struct.pack("<H", len(sensor)) + bytes(2 * len(sensor))
            block += b"".join(struct.pack("<H6f", 2, *pillar, 0, 0, 0) for pillar in sensor)
        hub = struct.pack("<IQ", self._number(stream) + 1, t_us)
        data = struct.pack("<BHHHH", 2, 1, 9, 3, 9 + len(hub)) + hub + block
        return bytes.fromhex("55667788") + data + struct.pack("<H", sum(data) & 0xFFFF) + bytes.fromhex("aabbccdd")


class RtdeTalk(PlainTalk):
    """A UR controller with a sensor at its flange. One field has readings; other requested fields are zeros."""

    KINDS: Mapping[bytes, bytes] = MappingProxyType(
        {b"timestamp": b"DOUBLE", b"ft_raw_wrench": b"VECTOR6D", b"actual_q": b"VECTOR6D"}
    )
    TIME, OTHER = slice(4, 12), bytes(48)
    ready = False

    def __init__(self, field: bytes = b"ft_raw_wrench") -> None:
        self._field = field
        self._asked: list[bytes] = []

    def on_request(self, data: bytes) -> bytes:
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

    def frame(self, data: bytes) -> bytes:
        if self._asked == [b"timestamp", self._field]:
            return data
        size = RtdeEncoder.PACKET_BYTES
        return b"".join(self._packet(data[at : at + size]) for at in range(0, len(data), size))

    def _packet(self, packet: bytes) -> bytes:
        known = {b"timestamp": packet[self.TIME], self._field: packet[self.TIME.stop :]}
        body = b"".join(known.get(name, self.OTHER) for name in self._asked)
        return struct.pack(">HBB", 4 + len(body), ord("U"), 1) + body


class RtdeController:
    """Joins the packets of single streams, which have equal times, to packets with all fields of a UR controller."""

    FIELDS = (b"ft_raw_wrench", b"actual_q", b"actual_TCP_pose", b"tcp_offset")
    FIELD_OF_STREAM: Mapping[Stream, int] = MappingProxyType({Stream.WRENCH: 0, Stream.JOINTS: 1, Stream.TOOL: 2})
    PACKET_BYTES = 12 + 48 * len(FIELDS)

    def __init__(self) -> None:
        self._waiting: dict[Stream, deque[bytes]] = {}

    def add_stream(self, stream: Stream) -> None:
        """Wait for this stream's packets, too."""
        self._waiting[stream] = deque()

    def join(self, stream: Stream, data: bytes) -> bytes:
        """Take packets of one stream; return the packets that are complete now."""
        size = RtdeEncoder.POSE_PACKET_BYTES if stream is Stream.TOOL else RtdeEncoder.PACKET_BYTES
        self._waiting[stream].extend(data[at : at + size] for at in range(0, len(data), size))
        joined = b""
        while all(self._waiting.values()):
            parts = {each: waiting.popleft() for each, waiting in self._waiting.items()}
            fields = [bytes(48)] * len(self.FIELDS)
            for each, part in parts.items():
                first, body = self.FIELD_OF_STREAM[each], part[12:]
                for number in range(len(body) // 48):
                    fields[first + number] = body[48 * number : 48 * number + 48]
            time = next(iter(parts.values()))[4:12]
            joined += struct.pack(">HBB", self.PACKET_BYTES, ord("U"), 1) + time + b"".join(fields)
        return joined


class ControllerTalk(RtdeTalk):
    """A UR controller that sends wrench, joints and pose of its tool by one port; its data are those of `RtdeController`."""

    KINDS: Mapping[bytes, bytes] = MappingProxyType(
        {b"timestamp": b"DOUBLE", **dict.fromkeys(RtdeController.FIELDS, b"VECTOR6D")}
    )

    def frame(self, data: bytes) -> bytes:
        size = RtdeController.PACKET_BYTES
        return b"".join(self._packet(data[at : at + size]) for at in range(0, len(data), size))

    def _packet(self, packet: bytes) -> bytes:
        known = {name: packet[12 + 48 * number : 60 + 48 * number] for number, name in enumerate(RtdeController.FIELDS)}
        known[b"timestamp"] = packet[self.TIME]
        body = b"".join(known[name] for name in self._asked if name in known)
        return struct.pack(">HBB", 4 + len(body), ord("U"), 1) + body


class YarpTalk(PlainTalk):
    """A YARP port that a reader connects to. `number` is the port's."""

    ready = False
    _greeted = False

    def __init__(self, number: int) -> None:
        self._port = number

    def on_request(self, data: bytes) -> bytes:
        answer = self._greet(data)
        self.ready = self._greeted and b"~r\x00\x01" in self.heard
        return answer

    def _greet(self, data: bytes) -> bytes:
        """Return the answer to the host's greeting once that is complete."""
        self.heard += data
        length = 12 + int.from_bytes(self.heard[8:12], "little")
        if self._greeted or not 12 <= length <= len(self.heard):
            return b""
        self._greeted, self.heard = True, self.heard[length:]
        return b"YA" + struct.pack("<i", self._port) + b"RP"


class SkinManagerTalk(YarpTalk):
    """The RPC port of a skinManager: one part with its poses and confidences, (width, 7), shared by all hosts.

    It answers like icub-main's `skinManager.cpp`; messages are framed like a port of YARP 3.12.
    """

    PART, NUMBER = "r_forearm", 5

    def __init__(self, number: int, poses: FloatArray) -> None:
        super().__init__(number)
        self._poses = poses

    def on_request(self, data: bytes) -> bytes:
        out = self._greet(data)
        while self._greeted and len(self.heard) >= 30:
            first, second = struct.unpack_from("<2i", self.heard, 18)
            if len(self.heard) < 30 + first + second:
                break
            bottle, self.heard = self.heard[30 + first : 30 + first + second], self.heard[30 + first + second :]
            answer = _rpc_bottle(self.answer(_rpc_values(bottle)))
            out += b"YA\x0a\x00\x00\x00RP\x01\x01" + b"\xff" * 8 + struct.pack("<2i", len(answer), 0) + answer
        return out

    def answer(self, words: list[str | int | float]) -> list[str | int | float]:
        """Return the answer to a command."""
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
    """Decode a command's bottle: words, whole numbers and floats."""
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
    """Encode an answer like YARP: each value has a type tag, except in a list of floats only."""
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
    """A YARP name server, in its short form and over a connection."""

    ready = False

    def __init__(self, ports: Mapping[str, int]) -> None:
        self._ports = ports

    def on_request(self, data: bytes) -> bytes:
        self.heard += data
        asked = re.search(rb"(?:NAME_SERVER |d\r?\n)(query (\S+)|list)\r?\n", self.heard)
        if asked is None:
            return b""
        self.closing = True
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

    ready = False

    def on_request(self, data: bytes) -> bytes:
        self.heard += data
        if b"\r\n\r\n" not in self.heard:
            return b""
        self.closing = True
        page = (
            f"<?xml version='1.0'?><netft><prodname>Ethernet Axia80</prodname><cfgcpf>{NETFT_COUNTS_PER_UNIT}</cfgcpf>"
            f"<cfgcpt>{NETFT_COUNTS_PER_UNIT}</cfgcpt><scfgfu>N</scfgfu><scfgtu>Nm</scfgtu>"
            "<cfgtfx>0;0;0;0;0;0</cfgtfx><scfgtdu>mm</scfgtdu><scfgtau>degrees</scfgtau></netft>"
        ).encode()
        return b"HTTP/1.0 200 OK\r\nContent-Type: text/xml\r\n\r\n" + page


class XelaTalk(PlainTalk):
    """XELA's server."""

    ready = False

    def __init__(self) -> None:
        from websockets.server import ServerProtocol

        self._protocol = ServerProtocol()

    def on_request(self, data: bytes) -> bytes:
        from websockets.http11 import Request

        self._protocol.receive_data(data)
        for event in self._protocol.events_received():
            if isinstance(event, Request):
                self._protocol.send_response(self._protocol.accept(event))
                self._protocol.send_text(b'{"message": "Welcome", "sensors": 1}')
                self.ready = True
        return b"".join(self._protocol.data_to_send())

    def frame(self, data: bytes) -> bytes:
        for message in data.splitlines():
            self._protocol.send_text(message)
        return b"".join(self._protocol.data_to_send())


@dataclass(frozen=True, slots=True)
class Maker:
    """A kind of maker's device."""

    carries: tuple[Stream, ...]
    encoder: Callable[[], Encoder]
    hz: float
    """Readings per second; 0: the rate of boards."""
    serial: bool = False
    """It has a serial line, which can damage bytes."""
    skin_unit: str = ""
    """Unit of its skin's values; empty for raw values."""
    skin_max: float = math.inf
    """Largest value of its skin, in that unit."""
    channels_max: float = math.inf
    """Largest number of channels of its skin."""
    has_vectors: bool = False
    """Whether its taxels can have three values."""

    def skin_factor(self, scene: Scene, top: float) -> float:
        """Return its value for each raw value of the simulated skin, whose largest is `top`.

        A threshold in the scene is in the unit of the skin; without one the default thresholds of both are one answer. Raises
        InputError: the scene's values do not fit the device.
        """
        if scene.skin.channels > self.channels_max:
            raise InputError(
                f"The skin of {scene.name} has {scene.skin.channels} channels, and the device of --as {self.channels_max:g} at "
                "most; take another device, or a smaller scene."
            )
        if scene.skin.axes is not None and not self.has_vectors:
            raise InputError(
                f"The skin of {scene.name} has axes = 3, and a taxel of the device of --as one value; take another device, or "
                "leave out axes = 3."
            )
        defaults, given = RESPONSE_MIN_OF_UNIT, scene.contacts.response_min
        factor = 1.0 if scene.states_response_min else defaults.get(self.skin_unit, given) / given
        if top * factor > self.skin_max:
            raise InputError(
                f"The skin of {scene.name} has values up to {top * factor:g}, and the device of --as sends up to "
                f"{self.skin_max:g}; take another device, or a scene with a smaller range."
            )
        return factor


MAKERS: Mapping[str, Maker] = MappingProxyType(
    {
        "netft": Maker((Stream.WRENCH,), RdtEncoder, 0.0),
        "bota": Maker((Stream.WRENCH,), BotaEncoder, 800.0, serial=True),
        "robotiq": Maker((Stream.WRENCH,), RobotiqEncoder, 100.0, serial=True),
        "robotiq-text": Maker((Stream.WRENCH,), RobotiqTextEncoder, 125.0),
        "rtde": Maker((Stream.WRENCH, Stream.JOINTS, Stream.TOOL), RtdeEncoder, 125.0),
        "yarp": Maker(SENSOR_STREAMS, YarpEncoder, 0.0, has_vectors=True),
        "xela": Maker((Stream.SKIN,), XelaEncoder, 100.0, has_vectors=True),
        "papillarray": Maker(
            (Stream.SKIN,),
            PapillArrayEncoder,
            100.0,
            serial=True,
            skin_unit="N",
            channels_max=PAPILLARRAY_MAX_CHANNELS,
            has_vectors=True,
        ),
        "justfloat": Maker((Stream.SKIN, Stream.WRENCH), JustFloatEncoder, 100.0, serial=True, has_vectors=True),
        "flexitac": Maker((Stream.SKIN,), FlexiTacEncoder, 90.0, serial=True, skin_max=255.0),
        "anyskin": Maker((Stream.SKIN,), AnySkinEncoder, 100.0, serial=True, has_vectors=True),
        "leptrino": Maker((Stream.WRENCH,), LeptrinoEncoder, 0.0, serial=True),
        "tsf85": Maker((Stream.SKIN,), Tsf85Encoder, 100.0, serial=True, skin_max=65535.0, channels_max=TSF85_TAXELS),
        "inspire": Maker((Stream.SKIN,), InspireEncoder, 18.0, skin_max=4095.0, channels_max=INSPIRE_TAXELS),
        "paxini": Maker((Stream.SKIN,), PaxiniEncoder, 91.0, serial=True, skin_unit="N", skin_max=25.5, has_vectors=True),
        "paxini-module": Maker(
            (Stream.SKIN,),
            PaxiniModuleEncoder,
            100.0,
            serial=True,
            skin_unit="N",
            skin_max=25.5,
            channels_max=239,
            has_vectors=True,
        ),
        "qtm": Maker((Stream.TOOL,), QtmEncoder, 0.0),
        "natnet": Maker((Stream.TOOL,), NatNetEncoder, 0.0),
        "ndi": Maker((Stream.TOOL,), NdiEncoder, 60.0),
        "ros2": Maker(SENSOR_STREAMS, Ros2Encoder, 0.0, has_vectors=True),
    }
)
"""Key: the name in `--as`."""


def assign_devices(names: tuple[str, ...], streams: tuple[Stream, ...]) -> dict[Stream, str]:
    """Return the device of each stream: the first named one that has it. Other streams come from boards.

    Raises InputError if a name is unknown or has no free stream.
    """
    chosen: dict[Stream, str] = {}
    for name in names:
        if name not in MAKERS:
            raise InputError(f"--as names {name!r}; expected some of {', '.join(MAKERS)}.")
        free = [stream for stream in MAKERS[name].carries if stream in streams and stream not in chosen]
        if not free:
            can = " or ".join(stream.value for stream in MAKERS[name].carries)
            raise InputError(f"--as names {name}, which sends {can}: the scene has none that no other of --as sends.")
        chosen |= dict.fromkeys(free, name)
    return chosen
