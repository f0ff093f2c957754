"""Bota Systems' serial sensors (Rokubi, SensONE, MiniONE; "gen0"): 37 bytes a reading, with a checksum and a clock.

A frame is AA, 34 bytes of data and their CRC-16/X-25, little-endian; data is `<H6fIf`: status, Fx Fy Fz Tx Ty Tz (N, N m),
time (microseconds, 32 bits) and temperature (degrees Celsius). The status has a bit each for samples that were skipped, a
force beyond the range, invalid measurements and raw ones. Source: the maker's serial examples in C and Python.
"""

from __future__ import annotations

import binascii
import math
import struct
from typing import ClassVar

from skincal.model.readings import TEMPERATURE, Loss, Stream
from skincal.streams.decoders.base import INVALID_BIT, SATURATED_BIT, DeviceTime, PieceDecoder, Pieces
from skincal.streams.decoders.dialogue import Dialogue
from skincal.streams.decoders.framing import Frames

DATA = struct.Struct("<H6fIf")
FRAME_BYTES = 37
PLAUSIBLE = 1e6
"""N and N m. No sensor has such a range: noise with a checksum that fits by chance has, half the time."""
COLD, HOT = -60.0, 160.0
"""degC, beyond what electronics bear."""
SKIPPED, OVERRANGE, INVALID, RAW = 1, 2, 4, 8
WORDS = {
    SKIPPED: "it skips samples: make its filter (sinc length) longer",
    OVERRANGE: "the force or torque is beyond its range",
    INVALID: "its measurements are invalid",
    RAW: "it sends raw measurements: set its calibration on",
}
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc_x25(data: bytes) -> int:
    """Return the CRC-16/X-25: that of CCITT, start and final xor FFFF, over mirrored bits, itself mirrored."""
    mirrored = binascii.crc_hqx(data.translate(_REVERSED), 0xFFFF)
    return (_REVERSED[mirrored & 0xFF] << 8 | _REVERSED[mirrored >> 8]) ^ 0xFFFF


def _is_frame(frame: bytes) -> bool:
    if crc_x25(frame[1:-2]) != frame[-2] | frame[-1] << 8:
        return False
    _, *wrench, _, temperature = DATA.unpack_from(frame, 1)
    # Sixteen bits fit by chance once in 65,536 bytes AA of a line at the wrong baud rate.
    return COLD < temperature < HOT and all(not math.isfinite(value) or abs(value) < PLAUSIBLE for value in wrench)


class BotaDialogue(Dialogue):
    """Has a sensor that was left in its configuration go on measuring."""

    silence_s = 1.0

    def on_silence(self) -> bytes:
        """See `Dialogue`."""
        return b"R"


class BotaDecoder(PieceDecoder):
    """Decodes gen0 frames."""

    name: ClassVar[str] = "Bota gen0"
    no_piece: ClassVar[Loss] = Loss.BAD_CHECKSUM

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._time = DeviceTime()
        self._state = ""

    def _make_splitter(self) -> Pieces:
        return Frames(b"\xaa", FRAME_BYTES, _is_frame)

    @property
    def note(self) -> str:
        """See `PieceDecoder`."""
        return self._state or self._collector.note

    def _decode(self, piece: bytes) -> Loss | None:
        status, *wrench, raw_us, temperature = DATA.unpack_from(piece, 1)
        self.good += 1
        self._measure(TEMPERATURE, temperature)
        said = [words for bit, words in WORDS.items() if status & bit]
        self._state = f"The sensor says: {'; '.join(said)}" if said else ""
        flags = (SATURATED_BIT if status & OVERRANGE else 0) | (INVALID_BIT if status & (INVALID | RAW) else 0)
        return self._collector.add(Stream.WRENCH, -1, self._time.unwrap(raw_us), wrench, flags)
