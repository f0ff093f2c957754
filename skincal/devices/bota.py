"""Bota Systems' serial sensors (Rokubi, SensONE, MiniONE; "gen0"): 37 bytes a reading, with a checksum and a clock.

A frame is AA, 34 bytes of data and their CRC-16/X-25, little-endian; data is `<H6fIf`: status, Fx Fy Fz Tx Ty Tz (N, N m),
time (microseconds, 32 bits) and temperature (degrees Celsius). The status has a bit each for samples that were skipped, a
force beyond the range, invalid measurements and raw ones. Source: the maker's serial examples in C and Python.
"""

from __future__ import annotations

import binascii
import json
import math
import struct
import sys
from dataclasses import replace
from importlib.util import find_spec
from typing import ClassVar

from skincal.devices.decoding import (
    INVALID_READING_FLAG,
    SATURATED_READING_FLAG,
    DeviceTime,
    FrameDecoder,
    FrameSplitter,
    HeadSplitter,
)
from skincal.devices.family import Command, DeviceAddress, Family, Form, Handshake, Questions, Route, Vector
from skincal.devices.link import FailureKind, LinkError
from skincal.model.readings import TEMPERATURE_NAME, Loss, Stream

DATA_STRUCT = struct.Struct("<H6fIf")
BOTA_FRAME_BYTES = 37
MAX_PLAUSIBLE_FORCE_OR_MOMENT = 1e6
"""N and N m. No sensor has such a range; half of the noise whose checksum fits by chance exceeds it."""
TEMPERATURE_MIN_DEGC, TEMPERATURE_MAX_DEGC = -60.0, 160.0
SKIPPED, OVERRANGE, INVALID, RAW = 1, 2, 4, 8
STATUS_SENTENCES = {
    SKIPPED: "it skips samples: make its filter (sinc length) longer",
    OVERRANGE: "the force or torque is beyond its range",
    INVALID: "its measurements are invalid",
    RAW: "it sends raw measurements: set its calibration on",
}
_VECTOR_BYTES = bytes.fromhex("AA00000000C03F000010C00000F0410000003E000000BF0000803D40E2010000001242E3F6")
_MIRRORED_BITS = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc_x25(data: bytes) -> int:
    """Compute the CRC-16/X-25: that of CCITT, start and final xor FFFF, over mirrored bits, itself mirrored."""
    mirrored = binascii.crc_hqx(data.translate(_MIRRORED_BITS), 0xFFFF)
    return (_MIRRORED_BITS[mirrored & 0xFF] << 8 | _MIRRORED_BITS[mirrored >> 8]) ^ 0xFFFF


def _frame_end(buffer: bytes, at: int) -> int:
    frame = buffer[at : at + BOTA_FRAME_BYTES]
    if crc_x25(frame[1:-2]) != frame[-2] | frame[-1] << 8:
        return 0
    _, *wrench, _, temperature = DATA_STRUCT.unpack_from(frame, 1)
    # Sixteen bits fit by chance once in 65,536 bytes AA of a line at the wrong baud rate.
    is_plausible = all(not math.isfinite(value) or abs(value) < MAX_PLAUSIBLE_FORCE_OR_MOMENT for value in wrench)
    return at + BOTA_FRAME_BYTES if TEMPERATURE_MIN_DEGC < temperature < TEMPERATURE_MAX_DEGC and is_plausible else 0


class BotaHandshake(Handshake):
    """Restarts a sensor that was left in its configuration mode."""

    silence_s = 1.0

    def on_silence(self) -> bytes:
        return b"R"


class BotaDecoder(FrameDecoder):
    """Decodes gen0 frames."""

    name: ClassVar[str] = "Bota gen0"
    loss_of_garbage: ClassVar[Loss] = Loss.BAD_CHECKSUM

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._time = DeviceTime()

    def _make_splitter(self) -> FrameSplitter:
        return HeadSplitter(b"\xaa", BOTA_FRAME_BYTES, _frame_end)

    def _decode(self, frame: bytes) -> Loss | None:
        status, *wrench, raw_us, temperature = DATA_STRUCT.unpack_from(frame, 1)
        self.valid_records += 1
        self._add_side_reading(TEMPERATURE_NAME, temperature)
        said = [words for bit, words in STATUS_SENTENCES.items() if status & bit]
        self._status = f"The sensor says: {'; '.join(said)}" if said else ""
        flags = (SATURATED_READING_FLAG if status & OVERRANGE else 0) | (
            INVALID_READING_FLAG if status & (INVALID | RAW) else 0
        )
        return self._add(Stream.WRENCH, -1, self._time.unwrap(raw_us), wrench, flags)


DRIVER_NUMBERS = ("mode", "submode", "baud")
DRIVER_OPTIONS = (*DRIVER_NUMBERS, "product", "serial")
DRIVER_START_MAX_S = 10.0
"""s for the maker's driver to find its sensor: one on a serial port restarts for three seconds."""


def _has_whole_numbers(address: DeviceAddress) -> bool:
    options = address.options
    return all(options[key].isascii() and options[key].isdigit() for key in DRIVER_NUMBERS if key in options)


def driver_settings(address: DeviceAddress) -> dict[str, str | int]:
    """Build the settings for `bota_child`. A serial number of digits stays a text."""
    kind = "dummy" if address.host == "dummy" else "socket" if address.host else "binary"
    numbers = {key: int(address.options[key]) for key in DRIVER_NUMBERS if key in address.options}
    return {"kind": kind, "place": address.host or address.path, **address.options, **numbers}


def _with_driver(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    del questions
    if find_spec("bota_driver") is None:
        sentence = (
            f"{address.text}: newer Bota sensors are read by the maker's driver, which is not installed; "
            "python -m pip install bota-driver (the extra bota of skincal) installs it."
        )
        raise LinkError(FailureKind.ADDRESS, sentence)
    words = (sys.executable, "-P", "-m", "skincal.streams.bota_child", json.dumps(driver_settings(address)))
    return replace(address, command=Command(words, "the maker's driver", DRIVER_START_MAX_S, has_input=True, is_driver=True))


DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="bota:/dev/ttyUSB0",
            form=Form.SERIAL,
            transport="serial",
            format="bota",
            baud=460800,
            handshake=lambda _: BotaHandshake(),
        ),
        Route(
            usage="bota://192.168.0.45 or bota:///dev/ttyACM0",
            form=Form.HOST_OR_PORT,
            transport="command",
            format="bota",
            options=DRIVER_OPTIONS,
            check=_has_whole_numbers,
            prepare=_with_driver,
        ),
    ),
    decoders={"bota": BotaDecoder},
    vectors=(
        Vector(
            "bota",
            (Stream.WRENCH,),
            _VECTOR_BYTES,
            ((1.5, -2.25, 30.0, 0.125, -0.5, 0.0625),),
            repeat=_VECTOR_BYTES,
        ),
    ),
)
