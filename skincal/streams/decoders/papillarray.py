"""Contactile PapillArray (PTS v2): the force on each pillar of one or two sensors at a hub, with number, clock and checksum.

A frame is 55 66 77 88, data, AA BB CC DD, all little-endian; the last two bytes of data are the sum of those before them,
modulo 65536. Data begins with the size of an index in bytes, then an index of entries, a uint16 kind and an offset each, up
to the smallest offset. Kinds: 1 hub (number uint32, time uint64 in microseconds), 3 pillars (count of sensors uint16 and an
offset each; for each count of pillars and an offset each; for each pillar uint16 2 and six float32 Fx Fy Fz (N) Dx Dy Dz
(mm)); the others are not needed. Offsets count from where their own block begins. Source: the serial driver of a public ROS
2 workspace that cites the maker's PTSCOM_2.0_SPEC.

A channel is the force along a pillar's axis, without its sign, or each of the three components where the scene has three
channels for each pillar; pillars of the second sensor follow those of the first.
"""

from __future__ import annotations

import struct
from typing import ClassVar

from skincal.model.readings import Loss, Stream
from skincal.streams.decoders.base import MICROSECONDS, PieceDecoder, Pieces
from skincal.streams.decoders.dialogue import Dialogue
from skincal.streams.decoders.yarp_log import STAMP_MAX, Steps

BEGIN, END = bytes.fromhex("55667788"), bytes.fromhex("AABBCCDD")
FRAME_MAX = 8192
"""Bytes. Longer, the beginning was none."""
HUB = struct.Struct("<IQ")
PILLAR = struct.Struct("<H6f")
HUB_KIND, PILLARS_KIND = 1, 3
ITEMS_MAX = 64
"""Sensors of a hub, and pillars of a sensor: the maker has 2 and 9."""


class PillarFrames:
    """Cuts frames. The mark of the end may stand inside one: then the next end is tried."""

    def __init__(self) -> None:
        self._rest = b""
        self._tried = 0
        """Up to where ends were tried."""
        self._lost = False

    @property
    def holds(self) -> bool:
        """See `Pieces`."""
        return bool(self._rest) or self._lost

    def split(self, data: bytes) -> list[bytes | None]:
        """See `Pieces`."""
        pieces: list[bytes | None] = []
        # In portions: what is kept is never longer than two frames, however much came.
        for at in range(0, len(data), FRAME_MAX):
            self._rest += data[at : at + FRAME_MAX]
            pieces += self._pieces()
        return pieces

    def _pieces(self) -> list[bytes | None]:
        pieces: list[bytes | None] = []
        while self._to_begin(pieces):
            end = self._rest.find(END, max(self._tried, len(BEGIN)))
            if end >= 0 and _fits(self._rest[len(BEGIN) : end]):
                pieces.append(self._rest[len(BEGIN) : end])
                self._drop(end + len(END))
                self._lost = False
            elif end >= 0:
                self._tried = end + 1
            elif len(self._rest) > FRAME_MAX:
                self._lose(pieces)
                # The last beginning, not the next: else hostile bytes would be searched over and over.
                last = self._rest.rfind(BEGIN, 1)
                self._drop(last if last > 0 else len(self._rest) - len(BEGIN) + 1)
            else:
                self._tried = max(len(self._rest) - len(END) + 1, 0)
                break
        return pieces

    def _to_begin(self, pieces: list[bytes | None]) -> bool:
        """Drop what lies before a beginning; return whether there is one."""
        begin = self._rest.find(BEGIN)
        keep = begin if begin >= 0 else max(len(self._rest) - len(BEGIN) + 1, 0)
        if keep:
            self._lose(pieces)
            self._drop(keep)
        return begin >= 0

    def _lose(self, pieces: list[bytes | None]) -> None:
        if not self._lost:
            pieces.append(None)
        self._lost = True

    def _drop(self, count: int) -> None:
        self._rest = self._rest[count:]
        self._tried = 0


def _fits(data: bytes) -> bool:
    return len(data) > 2 and sum(data[:-2]) & 0xFFFF == data[-2] | data[-1] << 8


class PapillArrayDialogue(Dialogue):
    """Asks for 100 readings a second: what a skin needs, and what a hub may have been set off from."""

    def opening(self) -> bytes:
        """See `Dialogue`."""
        return b"f100\n"


class PapillArrayDecoder(PieceDecoder):
    """Decodes a hub's frames."""

    name: ClassVar[str] = "PapillArray"
    no_piece: ClassVar[Loss] = Loss.BAD_CHECKSUM

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._steps = Steps()

    def _make_splitter(self) -> Pieces:
        return PillarFrames()

    def _decode(self, piece: bytes) -> Loss | None:
        try:
            blocks = _blocks(piece)
            number, time_us = HUB.unpack_from(blocks[HUB_KIND])
            forces = _pillars(blocks[PILLARS_KIND], piece[0])
        except (KeyError, ValueError, struct.error):
            return Loss.UNREADABLE
        self.good += 1
        missing = self._steps.missing(number)
        if missing:
            self.counts[Loss.MISSING] += missing
        values = [value for force in forces for value in force]
        whole = self._collector.width(Stream.SKIN) == len(values)
        self.units[Stream.SKIN] = f"{'Fx Fy Fz of' if whole else 'the force along'} each pillar, in N"
        if not whole:
            values = [abs(force[2]) for force in forces]
        device_s = time_us / MICROSECONDS
        return self._collector.add(Stream.SKIN, number, device_s if device_s < STAMP_MAX else float("nan"), values)


def _blocks(data: bytes) -> dict[int, bytes]:
    """Return the bytes from each block's beginning on, by its kind. Raises ValueError, struct.error."""
    size = data[0]
    if not 1 <= size <= 4:
        raise ValueError("size of an index")
    blocks: dict[int, bytes] = {}
    at, first = 1, len(data)
    while at < first:
        (kind,) = struct.unpack_from("<H", data, at)
        offset = int.from_bytes(data[at + 2 : at + 2 + size], "little")
        at += 2 + size
        if not at <= offset < len(data):
            raise ValueError("offset")
        first = min(first, offset)
        blocks[kind] = data[offset:]
    return blocks


def _count(block: bytes, at: int, size: int) -> tuple[int, int]:
    """Return how many items follow, and where the first one lies: after as many offsets, which say no more than that."""
    (count,) = struct.unpack_from("<H", block, at)
    if count > ITEMS_MAX:
        raise ValueError("count")
    return count, at + 2 + count * size


def _pillars(block: bytes, size: int) -> list[tuple[float, float, float]]:
    """Return Fx Fy Fz, N, of each pillar of each sensor."""
    forces: list[tuple[float, float, float]] = []
    sensors, at = _count(block, 0, size)
    for _ in range(sensors):
        pillars, at = _count(block, at, size)
        for _ in range(pillars):
            kind, x, y, z, *_ = PILLAR.unpack_from(block, at)
            if kind != 2:
                raise ValueError("kind of a pillar")
            at += PILLAR.size
            forces.append((x, y, z))
    return forces
