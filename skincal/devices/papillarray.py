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

from skincal.devices.decoding import TIME_STAMP_MAX_S, US_PER_S, FrameDecoder, FrameSplitter, HeadSplitter
from skincal.devices.family import Family, Form, Handshake, Route, Vector
from skincal.model.readings import Loss, Stream

BEGIN, END = bytes.fromhex("55667788"), bytes.fromhex("AABBCCDD")
FRAME_MAX_BYTES = 8192
"""Bytes. If a frame is longer, its beginning was none."""
MAX_END_MARKS_TRIED_PER_FRAME = 8
"""End marks tried for one frame: four bytes of data look like one once in 4 billion."""
HUB_STRUCT = struct.Struct("<IQ")
PILLAR_STRUCT = struct.Struct("<H6f")
HUB_KIND, PILLARS_KIND = 1, 3
MAX_SENSORS_OR_PILLARS = 64
"""Sensors of a hub, and pillars of a sensor: the maker has 2 and 9."""


def _frame_end(buffer: bytes, at: int) -> int | None:
    """Find the end of a frame. The end mark may also occur inside a frame; then the next end mark is tried."""
    begin, last = at + len(BEGIN), at + FRAME_MAX_BYTES
    if not 1 <= buffer[begin] <= 4:
        return 0
    end = begin
    for _ in range(MAX_END_MARKS_TRIED_PER_FRAME):
        end = buffer.find(END, end + 1, last)
        if end < 0:
            return None if len(buffer) < last else 0
        if end - begin > 2 and sum(buffer[begin : end - 2]) & 0xFFFF == buffer[end - 2] | buffer[end - 1] << 8:
            return end + len(END)
    return 0


class PapillArrayHandshake(Handshake):
    """Asks for 100 readings a second: enough for a skin, and the hub may have been set to another rate."""

    def opening(self) -> bytes:
        return b"f100\n"


class PapillArrayDecoder(FrameDecoder):
    """Decodes a hub's frames."""

    name: ClassVar[str] = "PapillArray"
    loss_of_garbage: ClassVar[Loss] = Loss.BAD_CHECKSUM

    def _make_splitter(self) -> FrameSplitter:
        return HeadSplitter(BEGIN, len(BEGIN) + 1, _frame_end)

    def _decode(self, frame: bytes) -> Loss | None:
        data = frame[len(BEGIN) : -len(END)]
        try:
            blocks = _blocks(data)
            number, time_us = HUB_STRUCT.unpack_from(blocks[HUB_KIND])
            forces = _pillars(blocks[PILLARS_KIND], data[0])
        except (KeyError, ValueError, struct.error):
            return Loss.UNREADABLE
        self.valid_records += 1
        self._count_gap(number)
        values = [value for force in forces for value in force]
        whole = self._width(Stream.SKIN) == len(values)
        self.units[Stream.SKIN] = f"{'Fx Fy Fz of' if whole else 'the force along'} each pillar, in N"
        self.skin_unit = "N"
        if not whole:
            values = [abs(force[2]) for force in forces]
        device_s = time_us / US_PER_S
        return self._add(Stream.SKIN, number, device_s if device_s < TIME_STAMP_MAX_S else float("nan"), values)


def _blocks(data: bytes) -> dict[int, bytes]:
    """Find the blocks by their kind, each from its beginning to the end of the data. Raises ValueError, struct.error."""
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
    """Return the number of items and the place of the first one, which follows as many offsets."""
    (count,) = struct.unpack_from("<H", block, at)
    if count > MAX_SENSORS_OR_PILLARS:
        raise ValueError("count")
    return count, at + 2 + count * size


def _pillars(block: bytes, size: int) -> list[tuple[float, float, float]]:
    """Read Fx Fy Fz, N, of each pillar of each sensor."""
    forces: list[tuple[float, float, float]] = []
    sensors, at = _count(block, 0, size)
    for _ in range(sensors):
        pillars, at = _count(block, at, size)
        for _ in range(pillars):
            kind, x, y, z, *_ = PILLAR_STRUCT.unpack_from(block, at)
            if kind != 2:
                raise ValueError("kind of a pillar")
            at += PILLAR_STRUCT.size
            forces.append((x, y, z))
    return forces


_VECTOR_BYTES = bytes.fromhex(
    "55667788" "02 01000d00 03001900 04005700" "2a000000 b168de3a00000000"
    "01000400 0200 0600 2000"
    "0200 0000803f 00000040 00004040 0000003f 0000803e 0000003e"
    "0200 000080c0 0000a040 0000c040 00000000 000000bf 0000403f"
    "01000400 0200 0000e040 000000c1 00001041 00002041 0000a0c1 0000f041"
    "570f aabbccdd"
)  # fmt: skip
"""Number 42, 987654321 us, one sensor with two pillars."""

DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="papillarray:/dev/ttyACM0",
            form=Form.SERIAL,
            transport="serial",
            format="papillarray",
            baud=115200,
            handshake=lambda _: PapillArrayHandshake(),
        ),
    ),
    decoders={"papillarray": PapillArrayDecoder},
    vectors=(Vector("papillarray", (Stream.SKIN,), _VECTOR_BYTES, ((3.0, 6.0),), repeat=_VECTOR_BYTES, channels=2),),
)
