"""Universal Robots' RTDE: the wrench of the flange's sensor and the joints' angles, with one clock.

A packet is a uint16, big-endian, its length with this head, one byte of kind, and the payload. The host asks for version 2
(`V`), names what it wants (`O`; the answer has the recipe's number and the kind of each), and starts (`S`); then a `U`
comes at each cycle. The wrench is `ft_raw_wrench`, in the sensor's own frame; `actual_TCP_force` is compensated for a
payload, zeroed at power-on, and its frame depends on the software: it is never asked for. Source: the maker's RTDE guide.
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

import numpy as np

from skincal.model.readings import Loss, Stream
from skincal.streams.decoders.base import NO_SEQ, PieceDecoder, Pieces
from skincal.streams.decoders.dialogue import Dialogue, DialogueError

HEAD = struct.Struct("!HB")
VERSION, OUTPUTS, START, DATA = b"VOSU"
RATE_HZ = 125.0
"""Hz. What every controller can; e-Series could 500."""
FIELDS = {Stream.WRENCH: "ft_raw_wrench", Stream.JOINTS: "actual_q"}
FIELD_KIND = "VECTOR6D"
TEXT_SHOWN = 60


def packet(kind: int, payload: bytes) -> bytes:
    """Return a packet."""
    return HEAD.pack(HEAD.size + len(payload), kind) + payload


def recipe(carries: tuple[Stream, ...]) -> list[str]:
    """Return the names of what is asked for: the time, and one field for each stream."""
    return ["timestamp", *(FIELDS[stream] for stream in carries if stream in FIELDS)]


class RtdePackets:
    """Cuts packets; a piece is the kind and the payload. A length can never exceed 65,535."""

    def __init__(self) -> None:
        self._rest = b""
        self.fault = ""
        """What came that is no packet, a sentence; empty if nothing did."""

    @property
    def holds(self) -> bool:
        """See `Pieces`."""
        return bool(self._rest or self.fault)

    def split(self, data: bytes) -> list[bytes | None]:
        """See `Pieces`."""
        pieces: list[bytes | None] = []
        rest, at = self._rest + data, 0
        while not self.fault and len(rest) - at >= HEAD.size:
            length = int.from_bytes(rest[at : at + 2], "big")
            if length < HEAD.size:
                self.fault = f"it announces a packet of {length} bytes, which is no RTDE"
                pieces.append(None)
                break
            if len(rest) - at < length:
                break
            pieces.append(rest[at + 2 : at + length])
            at += length
        self._rest = b"" if self.fault else rest[at:]
        return pieces


class RtdeDialogue(Dialogue):
    """The handshake, a step at each answer."""

    def __init__(self, carries: tuple[Stream, ...]) -> None:
        self._fields = recipe(carries)
        self._packets = RtdePackets()
        self._started = False

    @property
    def ready(self) -> bool:
        """See `Dialogue`."""
        return self._started

    def opening(self) -> bytes:
        """See `Dialogue`."""
        return packet(VERSION, struct.pack("!H", 2))

    def hear(self, data: bytes) -> bytes:
        """See `Dialogue`."""
        answer = b""
        for piece in self._packets.split(data):
            if piece is None:
                raise DialogueError(self._packets.fault)
            if not self._started:
                answer += self._answer(piece[0], piece[1:])
        return answer

    def _answer(self, kind: int, payload: bytes) -> bytes:
        if kind == VERSION:
            if payload != b"\x01":
                raise DialogueError("the controller does not speak version 2 of RTDE; it needs newer software")
            return packet(OUTPUTS, struct.pack("!d", RATE_HZ) + ",".join(self._fields).encode())
        if kind == OUTPUTS:
            self._check(payload[1:].decode("ascii", "replace").split(","))
            return packet(START, b"")
        if kind == START:
            if payload != b"\x01":
                raise DialogueError("the controller does not start to send")
            self._started = True
        return b""

    def _check(self, kinds: list[str]) -> None:
        wanted = ["DOUBLE", *[FIELD_KIND] * (len(self._fields) - 1)]
        for name, kind, want in zip(self._fields, kinds, wanted, strict=False):
            if kind == "NOT_FOUND":
                raise DialogueError(f"the controller has no {name}; it needs newer software, and a sensor at its flange")
            if kind != want:
                raise DialogueError(f"{name} is of the kind {kind[:TEXT_SHOWN]!r}; expected {want}")
        if len(kinds) != len(wanted):
            raise DialogueError(f"the controller answers {len(kinds)} fields; it was asked for {len(wanted)}")


class RtdeDecoder(PieceDecoder):
    """Decodes what a controller sends."""

    name: ClassVar[str] = "UR RTDE"

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        self._packets = RtdePackets()
        super().__init__(channels, carries)
        self._first = False  # A connection begins with a packet.
        self._streams = [stream for stream in carries if stream in FIELDS]
        self.units[Stream.JOINTS] = "base, shoulder, elbow and the three of the wrist in degrees"

    def _make_splitter(self) -> Pieces:
        return self._packets

    @property
    def note(self) -> str:
        """See `PieceDecoder`."""
        return self._packets.fault or self._collector.note

    def _decode(self, piece: bytes) -> Loss | None:
        if piece[0] != DATA:
            return None  # answers of the handshake, and messages to people
        values = np.frombuffer(piece[2:], ">f8") if (len(piece) - 2) % 8 == 0 else np.zeros(0)
        if len(values) != 1 + 6 * len(self._streams):
            self._collector.note = (
                f"Packets of {len(piece)} bytes arrive where {2 + 8 * (1 + 6 * len(self._streams))} are expected"
            )
            return Loss.BAD_WIDTH
        self.good += 1
        device_s = float(values[0]) if math.isfinite(values[0]) and abs(values[0]) < MAX_S else math.nan
        for index, stream in enumerate(self._streams):
            field = values[1 + 6 * index : 7 + 6 * index].astype(np.float64)
            # As every decoder hands on angles: degrees.
            self._collector.add(stream, NO_SEQ, device_s, np.degrees(field) if stream is Stream.JOINTS else field)
        return None


MAX_S = 5e9
"""s. A controller that runs for longer is none."""
