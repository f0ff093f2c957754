"""Emulated makers' skins and the Leptrino sensor: their encoders for `--as`, and their dialogue with a host.

Written from the formats' descriptions without any code of the decoders, as `emulated_devices` is.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.simulation.board_formats import Encoder
from skincal.simulation.plain_talk import PlainTalk

CHIP_TEMPERATURE_DEGC = 25.0
TSF85_TAXELS = 56
INSPIRE_TAXELS = 1062
INSPIRE_READS = (105, 80, 105, 80, 105, 80, 105, 80, 105, 105, 112)
"""Registers of each request of a host, in its order."""
INSPIRE_ADDRESSES = tuple(3000 + 2 * sum(INSPIRE_READS[:place]) for place in range(len(INSPIRE_READS)))
"""Addresses of the requests: a register is two bytes."""
LEPTRINO_RATINGS = (200.0, 200.0, 400.0, 8.0, 8.0, 8.0)
"""N and N m."""
PAXINI_MAX_TAXELS = 200
"""Taxels of an emulated module."""
PAXINI_FIRST_MODULE = 4
PAXINI_MODULE_NUMBER = 3
"""Number of the module on the emulated converter board."""


class JustFloatEncoder(Encoder):
    """Frames of a board that speaks JustFloat."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del t_us
        factor = self.skin_factor if stream is Stream.SKIN else 1.0
        return struct.pack(f"<{len(values)}f", *(value * factor for value in values)) + b"\x00\x00\x80\x7f"


class FlexiTacEncoder(Encoder):
    """Frames of a FlexiTac board, flashed for the scene's channels."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del stream, t_us
        return b"\xaa\x55" + np.clip(np.rint(np.array(values) * self.skin_factor), 0, 255).astype("u1").tobytes()


class AnySkinEncoder(Encoder):
    """Frames of an AnySkin board. With one value for each chip, that is the length of its field."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del stream, t_us
        fields = self._taxel_vectors(values)
        if self.skin_axes == 1:
            fields = fields[:, 2:] * (0.6, 0.0, -0.8)
        return b"".join(struct.pack("<4f", CHIP_TEMPERATURE_DEGC, *field) for field in fields.tolist()) + b"\r\n"


def _whole_frame(values: list[float], width: int, name: str, top: int) -> IntArray:
    """Fill a frame of `width` whole numbers with the scene's channels first, and zeros after them."""
    if len(values) > width:
        raise InputError(f"{name} has {width} taxels; the scene has {len(values)} channels.")
    frame = np.zeros(width, np.int64)
    frame[: len(values)] = np.clip(np.rint(values), 0, top)
    return frame


class Tsf85Encoder(Encoder):
    """Packets of Robotiq's fingertips; each finger sends its taxels, then its other sensors."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del stream
        scaled = [value * self.skin_factor for value in values]
        frame = _whole_frame(scaled, TSF85_TAXELS, "Robotiq's pair of fingertips", 65535).astype(">u2").tobytes()
        out = b""
        for finger in (0, 1):
            pressure = bytes((0x10 | finger << 2,)) + frame[56 * finger : 56 * finger + 56]
            motion = struct.pack(">B3hB3h", 0x30 | finger << 2, 10, -20, 16384, 0x40 | finger << 2, 1, 2, 3)
            clock = struct.pack(">BQ", 0x70 | finger << 2, t_us)
            for fields in (pressure, motion + clock):
                out += bytes((0x9A, 0, 0x61, len(fields))) + fields
        return out


class Tsf85Talk(PlainTalk):
    """Fingertips that stream when a host asks for it."""

    ready = False

    def on_request(self, data: bytes) -> bytes:
        self.heard = (self.heard + data)[-64:]
        self.ready = self.ready or b"\x9a\x00\x58\x01" in self.heard
        return b""


def _stuffed(body: bytes) -> bytes:
    """Wrap a Leptrino body."""
    check = 0x03
    for byte in body:
        check ^= byte
    return b"\x10\x02" + body.replace(b"\x10", b"\x10\x10") + b"\x10\x03" + bytes((check,))


class LeptrinoEncoder(Encoder):
    """Messages of a Leptrino sensor in its stream."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del stream, t_us
        counts = np.clip(np.rint(np.array(values) / LEPTRINO_RATINGS * 10000), -32768, 32767).astype("<i2").tobytes()
        return _stuffed(b"\x14\xff\x32\x00" + counts + bytes(4))


class LeptrinoTalk(PlainTalk):
    """A Leptrino sensor: tells its ratings, starts and stops."""

    ready = False

    def on_request(self, data: bytes) -> bytes:
        self.heard += data
        out = b""
        while (end := self.heard.find(b"\x10\x03")) >= 0 and len(self.heard) > end + 2:
            said, self.heard = self.heard[:end], self.heard[end + 3 :]
            command = said[4] if said.startswith(b"\x10\x02\x04\xff") else 0
            if command == 0x2B:
                out += _stuffed(b"\x1c\xff\x2b\x00" + struct.pack("<6f", *LEPTRINO_RATINGS))
            elif command in (0x32, 0x33):
                self.ready = command == 0x32
                out += _stuffed(bytes((4, 0xFF, command, 0)))
        return out


class InspireEncoder(Encoder):
    """Answers of an Inspire hand for one reading, without the numbers of their requests."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del stream, t_us
        scaled = [value * self.skin_factor for value in values]
        data = _whole_frame(scaled, INSPIRE_TAXELS, "Inspire's hand", 4095).astype(">u2").tobytes()
        out, at = b"", 0
        for registers in INSPIRE_READS:
            size = 2 * registers
            out += struct.pack(">HHHBBB", 0, 0, 3 + size, 1, 3, size) + data[at : at + size]
            at += size
        return out


class InspireTalk(PlainTalk):
    """An Inspire hand: answers requests for registers from the newest reading, and begins each reading once."""

    def __init__(self) -> None:
        self._answers: list[bytes] = []
        """Answers of the newest reading, by address."""
        self._left = set[int]()
        """Places of the answers that no request has taken yet."""
        self._requests: dict[int, int] = {}
        """Numbers of the requests that wait for a reading, by the place of their answer."""

    @property
    def is_waiting(self) -> bool:
        """Whether the host still has to fetch a part of the newest reading."""
        return bool(self._left)

    def on_request(self, data: bytes) -> bytes:
        self.heard += data
        while len(self.heard) >= 12:
            number, function, address = struct.unpack_from(">H5xBH", self.heard)
            self.heard = self.heard[12:]
            if function == 3 and address in INSPIRE_ADDRESSES:
                self._requests[INSPIRE_ADDRESSES.index(address)] = number
        return self._answer()

    def frame(self, data: bytes) -> bytes:
        at = 0
        self._answers, self._left = [], set(range(len(INSPIRE_READS)))
        for registers in INSPIRE_READS:
            self._answers.append(data[at : at + 9 + 2 * registers])
            at += 9 + 2 * registers
        return self._answer()

    def _answer(self) -> bytes:
        out = b""
        for place in sorted(self._requests.keys() & self._left):
            # A fault of the hand: the numbers of its answers are off by one.
            out += struct.pack(">H", self._requests.pop(place) + 1) + self._answers[place][2:]
            self._left.discard(place)
        return out


def paxini_modules(channels: int) -> list[int]:
    """Share the taxels of a scene among emulated modules."""
    return [min(PAXINI_MAX_TAXELS, channels - at) for at in range(0, channels, PAXINI_MAX_TAXELS)]


def _paxini_steps(vectors: FloatArray) -> list[bytes]:
    """Encode the forces of taxels (n, 3), N, as steps: x and y int8, z uint8."""
    steps = np.rint(vectors * 10.0)
    across, along = np.clip(steps[:, :2], -128, 127).astype("i1"), np.clip(steps[:, 2:], 0, 255).astype("u1")
    return [across[row].tobytes() + along[row].tobytes() for row in range(len(steps))]


def _with_lrc(frame: bytes) -> bytes:
    return frame + bytes(((256 - sum(frame) % 256) % 256,))


class PaxiniEncoder(Encoder):
    """Frames of PaXini's high-speed board; the pressure is in Fz."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del stream, t_us
        steps = _paxini_steps(self._taxel_vectors(values))
        payload, at = b"", 0
        for count in paxini_modules(len(steps)):
            taxels = steps[at : at + count]
            payload += struct.pack("<3H", 0, 0, min(sum(each[2] for each in taxels), 255)) + b"".join(taxels)
            at += count
        return _with_lrc(b"\xaa\x56\x00" + struct.pack("<HB", len(payload) + 1, 0) + payload)


class PaxiniTalk(PlainTalk):
    """A high-speed board: tells its registers while it does not stream, starts and stops."""

    ready = False

    def __init__(self, channels: int) -> None:
        counts = [0] * 28
        counts[PAXINI_FIRST_MODULE:] = (paxini_modules(channels) + counts)[: 28 - PAXINI_FIRST_MODULE]
        bits = sum(1 << index for index, count in enumerate(counts) if count)
        self._registers = {0x10: struct.pack("<I", bits), 0x16: b"\x03", 0x30: struct.pack("<28H", *counts)}

    def on_request(self, data: bytes) -> bytes:
        self.heard += data
        out = b""
        while len(self.heard) >= 9:
            _, _, function, register, length = struct.unpack_from("<2sBBHH", self.heard)
            size = 9 + (length if function == 0x10 else 0)
            if len(self.heard) < size:
                break
            said, self.heard = self.heard[:size], self.heard[size:]
            if function == 0x10 and register == 0x17:
                self.ready = said[8] == 1
                stopped = b"\xaa\x55" + said[2:6] + b"\x01\x00\x00"
                out += _with_lrc(b"\xaa\x56\x00\x01\x00\x00" if self.ready else stopped)
            elif function == 3 and not self.ready and register in self._registers:
                out += _with_lrc(b"\xaa\x55" + said[2:8] + self._registers[register])
        return out


class PaxiniModuleEncoder(Encoder):
    """Answers of PaXini's converter board, one for each reading; status 1 is that of a good read."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        del stream, t_us
        steps = _paxini_steps(self._taxel_vectors(values))
        data = bytes((0, 0, min(sum(each[2] for each in steps), 255))) + bytes(27) + b"".join(steps)
        head = struct.pack("<2sHBBBIH", b"\xaa\x55", 10 + len(data), PAXINI_MODULE_NUMBER, 0, 0xFB, 0x03F0, len(data))
        return _with_lrc(head + b"\x01" + data)


class PaxiniModuleTalk(PlainTalk):
    """A converter board with one module: each request gets the newest reading, once."""

    def __init__(self) -> None:
        self._has_request = False
        self._reading = b""

    def on_request(self, data: bytes) -> bytes:
        self.heard += data
        while len(self.heard) >= 14:
            said, self.heard = self.heard[:14], self.heard[14:]
            self._has_request |= said[4] == PAXINI_MODULE_NUMBER and said[6] == 0xFB
        return self._answer()

    def frame(self, data: bytes) -> bytes:
        self._reading = data
        return self._answer()

    def _answer(self) -> bytes:
        if not self._has_request or not self._reading:
            return b""
        self._has_request, answer, self._reading = False, self._reading, b""
        return answer


def make_talks(channels: int) -> Mapping[str, Callable[[], PlainTalk]]:
    """Makers of the dialogue of each device behind a serial line, by its name in `--as`."""
    return MappingProxyType(
        {
            "justfloat": PlainTalk,
            "flexitac": PlainTalk,
            "anyskin": PlainTalk,
            "leptrino": LeptrinoTalk,
            "tsf85": Tsf85Talk,
            "paxini": lambda: PaxiniTalk(channels),
            "paxini-module": PaxiniModuleTalk,
        }
    )


def part_query(maker: str, channels: int) -> str:
    """Return the end of an address: the scene's channels of a device with a fixed number of taxels, or their number."""
    if maker == "paxini-module":
        return f"?taxels={channels}"
    whole = {"tsf85": TSF85_TAXELS, "inspire": INSPIRE_TAXELS}.get(maker, channels)
    return "" if channels == whole else f"?channels=0-{channels - 1}&of={whole}"
