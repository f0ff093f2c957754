"""Robotiq FT 300 and FT 300-S: the stream of the serial port, and the text that a UR controller with Robotiq's URCap serves.

Serial, 19200 or 115200 baud: 16 bytes, 20 4E, six int16 little-endian (N x 100, N m x 1000), CRC-16/MODBUS little-endian;
100 Hz, no clock, no number, no saturation flag. The stream is stopped by 50 bytes FF and started by writing register 410 over
Modbus; a sensor that streams hears nothing else, so it is stopped first. TCP 63351: `(fx , fy , fz , mx , my , mz)` without
end, nothing between but the parentheses. Sources: Robotiq's ROS driver and FT 300-S manual; public clients of port 63351.
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

from skincal.devices.decoding import NO_SEQ, SATURATED_READING_FLAG, WRENCH_VALUES, FrameDecoder, FrameSplitter, HeadSplitter
from skincal.devices.family import Family, Form, Handshake, Route, Vector
from skincal.model.readings import Loss, Stream

FRAME_HEAD = b"\x20\x4e"
FRAME_STRUCT = struct.Struct("<2s6hH")
COUNTS_PER_SI_UNIT = (100.0, 100.0, 100.0, 1000.0, 1000.0, 1000.0)
"""Counts for each N and N m."""
SATURATED_RAW_COUNT = 32767
BAUD_RATES = (19200, 115200)
"""The FT 300 manual has the first; Robotiq's own reader of 2026 tries both."""
STOP_BYTES = b"\xff" * 50
START_BYTES = bytes.fromhex("0910019A0001020200CDCA")
START_ANSWER = bytes.fromhex("0910019A00012152")
"""The answer to `START_BYTES`, before the stream."""
READING_TEXT_MAX_BYTES = 200
"""Bytes of one reading as text."""


def _modbus_table() -> list[int]:
    table: list[int] = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
        table.append(value)
    return table


_MODBUS_TABLE = _modbus_table()


def crc_modbus(data: bytes) -> int:
    """Compute the CRC-16/MODBUS: polynomial 8005 mirrored, start FFFF."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _MODBUS_TABLE[(crc ^ byte) & 0xFF]
    return crc


def _frame_end(buffer: bytes, at: int) -> int:
    frame = buffer[at : at + FRAME_STRUCT.size]
    return at + FRAME_STRUCT.size if crc_modbus(frame[:-2]) == frame[-2] | frame[-1] << 8 else 0


class RobotiqHandshake(Handshake):
    """Stops the stream, starts it once the line is quiet, and again whenever it ends. Leaves the sensor stopped."""

    silence_s = 0.15
    closing_bytes = STOP_BYTES

    def __init__(self) -> None:
        self._stopped = True

    def opening(self) -> bytes:
        return STOP_BYTES

    def on_silence(self) -> bytes:
        self._stopped = not self._stopped
        return STOP_BYTES if self._stopped else START_BYTES


class RobotiqDecoder(FrameDecoder):
    """Decodes the serial stream."""

    name: ClassVar[str] = "Robotiq FT 300"
    loss_of_garbage: ClassVar[Loss] = Loss.BAD_CHECKSUM

    def _make_splitter(self) -> FrameSplitter:
        return HeadSplitter(FRAME_HEAD, FRAME_STRUCT.size, _frame_end, START_ANSWER)

    def _decode(self, frame: bytes) -> Loss | None:
        _, *counts, _ = FRAME_STRUCT.unpack(frame)
        self.valid_records += 1
        values = [count / size for count, size in zip(counts, COUNTS_PER_SI_UNIT, strict=True)]
        flags = SATURATED_READING_FLAG if max(abs(count) for count in counts) >= SATURATED_RAW_COUNT else 0
        return self._add(Stream.WRENCH, NO_SEQ, math.nan, values, flags)


class RobotiqTextDecoder(FrameDecoder):
    """Decodes the text of TCP 63351."""

    name: ClassVar[str] = "Robotiq text"
    mark: ClassVar[bytes] = b")"
    limit: ClassVar[int] = READING_TEXT_MAX_BYTES

    def _decode(self, frame: bytes) -> Loss | None:
        before, opened, inside = frame.rpartition(b"(")
        if not opened:
            return Loss.UNREADABLE
        try:
            values = [float(word) for word in inside.decode("ascii").split(",")]
        except ValueError:
            return Loss.UNREADABLE
        if len(values) != WRENCH_VALUES or b"_" in inside:
            return Loss.BAD_WIDTH
        if before.strip():
            self.counts[Loss.UNREADABLE] += 0 if self._first else 1
        self.valid_records += 1
        return self._add(Stream.WRENCH, NO_SEQ, math.nan, values)


_VECTOR_BYTES = bytes.fromhex("204ED204C9FD52267B002EFB05007784")
_TEXT_VECTOR = b"(1.50 , -2.25 , 30.00 , 0.1250 , -0.5000 , 0.0625)"

DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="robotiq:/dev/ttyUSB0",
            form=Form.SERIAL,
            transport="serial",
            format="robotiq",
            bauds=BAUD_RATES,
            handshake=lambda _: RobotiqHandshake(),
        ),
        Route(usage="robotiq://192.168.1.2", form=Form.HOST, transport="tcp", format="robotiq-text", port=63351),
    ),
    decoders={"robotiq": RobotiqDecoder, "robotiq-text": RobotiqTextDecoder},
    vectors=(
        Vector("robotiq", (Stream.WRENCH,), _VECTOR_BYTES, ((12.34, -5.67, 98.1, 0.123, -1.234, 0.005),), repeat=_VECTOR_BYTES),
        Vector("robotiq-text", (Stream.WRENCH,), _TEXT_VECTOR, ((1.5, -2.25, 30.0, 0.125, -0.5, 0.0625),), repeat=_TEXT_VECTOR),
    ),
)
