"""Robotiq FT 300 and FT 300-S: the stream of the serial port, and the text that a UR controller with Robotiq's URCap serves.

Serial, 19200 baud: 16 bytes, 20 4E, six int16 little-endian (N x 100, N m x 1000), CRC-16/MODBUS little-endian; 100 Hz, no
clock, no number, no word on saturation. The stream is stopped by 50 bytes FF and started by writing register 410 over
Modbus; a sensor that streams hears nothing else, so it is stopped first. TCP 63351: `(fx , fy , fz , mx , my , mz)` without
end, nothing between but the parentheses. Sources: Robotiq's ROS driver and FT 300-S manual; public clients of port 63351.
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

from skincal.model.readings import Loss, Stream
from skincal.streams.decoders.base import NO_SEQ, SATURATED_BIT, WRENCH_WIDTH, PieceDecoder, Pieces
from skincal.streams.decoders.dialogue import Dialogue
from skincal.streams.decoders.framing import Frames

HEAD = b"\x20\x4e"
FRAME = struct.Struct("<2s6hH")
SIZES = (100.0, 100.0, 100.0, 1000.0, 1000.0, 1000.0)
"""Counts for each N and N m."""
COUNT_MAX = 32767
STOP = b"\xff" * 50
START = bytes.fromhex("0910019A0001020200CDCA")
STARTED = bytes.fromhex("0910019A00012152")
"""The answer to that, before the stream."""
TEXT_MAX = 200
"""Bytes of one reading as text."""


def _modbus_table() -> list[int]:
    table: list[int] = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
        table.append(value)
    return table


_TABLE = _modbus_table()


def crc_modbus(data: bytes) -> int:
    """Return the CRC-16/MODBUS: polynomial 8005 mirrored, start FFFF."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc


def _is_frame(frame: bytes) -> bool:
    return crc_modbus(frame[:-2]) == frame[-2] | frame[-1] << 8


class RobotiqDialogue(Dialogue):
    """Stops the stream, starts it once the line is quiet, and does so again when it ends; leaves the sensor stopped."""

    silence_s = 0.15
    farewell = STOP

    def __init__(self) -> None:
        self._stopped = True

    def opening(self) -> bytes:
        """See `Dialogue`."""
        return STOP

    def on_silence(self) -> bytes:
        """See `Dialogue`."""
        self._stopped = not self._stopped
        return STOP if self._stopped else START


class RobotiqDecoder(PieceDecoder):
    """Decodes the serial stream."""

    name: ClassVar[str] = "Robotiq FT 300"
    no_piece: ClassVar[Loss] = Loss.BAD_CHECKSUM

    def _make_splitter(self) -> Pieces:
        return Frames(HEAD, FRAME.size, _is_frame, STARTED)

    def _decode(self, piece: bytes) -> Loss | None:
        _, *counts, _ = FRAME.unpack(piece)
        self.good += 1
        values = [count / size for count, size in zip(counts, SIZES, strict=True)]
        flags = SATURATED_BIT if max(abs(count) for count in counts) >= COUNT_MAX else 0
        return self._collector.add(Stream.WRENCH, NO_SEQ, math.nan, values, flags)


class RobotiqTextDecoder(PieceDecoder):
    """Decodes the text of TCP 63351."""

    name: ClassVar[str] = "Robotiq text"
    mark: ClassVar[bytes] = b")"
    limit: ClassVar[int] = TEXT_MAX

    def _decode(self, piece: bytes) -> Loss | None:
        before, opened, inside = piece.rpartition(b"(")
        if not opened:
            return Loss.UNREADABLE
        try:
            values = [float(word) for word in inside.decode("ascii").split(",")]
        except ValueError:
            return Loss.UNREADABLE
        if len(values) != WRENCH_WIDTH or b"_" in inside:
            return Loss.BAD_WIDTH
        if before.strip():
            self.counts[Loss.UNREADABLE] += 0 if self._first else 1
        self.good += 1
        return self._collector.add(Stream.WRENCH, NO_SEQ, math.nan, values)
