"""PaXini PX-6AX GEN3: one module on the converter board (USB or UART), which answers each request.

A request is 55 AA, length uint16 (of the whole less 5), the number of the module, 0, a function, address uint32, count uint16,
LRC; an answer is AA 55, the same, a status byte, `count` bytes, LRC. Numbers are little-endian; the LRC makes the sum of all
bytes 0 modulo 256. Function FB reads: at 03F0 the sum (Fx, Fy int8, Fz uint8) and 27 other bytes, at 040E three such bytes for
each taxel. A step is 0.1 N. Status 0 and 1 are both good: boards answer 1 to each good read. Source: the package paxini-sdk
0.1.0.

The board does not say how many taxels its module has: `?taxels=` of the address does. Numbers 0 to 8 are tried in turn until
one answers. A channel is as of the high-speed board (`paxini.py`).
"""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from itertools import cycle
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ, FrameDecoder, FrameSplitter, HeadSplitter
from skincal.devices.family import DeviceAddress, Family, Form, Handshake, Questions, Route, Vector, over_tcp
from skincal.devices.paxini import DEAD_BLOCK_MIN_SUM, NEWTONS_PER_STEP, TAXEL_BYTES, forces_of, lrc
from skincal.model.errors import InputError
from skincal.model.readings import Loss, Stream

HEAD_STRUCT = struct.Struct("<2sHBBBIH")
"""Head, length, module, 0, function, address, count."""
REQUEST_HEAD, ANSWER_HEAD = b"\x55\xaa", b"\xaa\x55"
READ_FUNCTION = 0xFB
SUM_ADDRESS, TAXELS_ADDRESS = 0x03F0, 0x040E
BYTES_BEFORE_TAXELS = TAXELS_ADDRESS - SUM_ADDRESS
LENGTH_OFFSET = 5
"""Bytes of a message beyond its length field's value."""
GOOD_STATUS = (0, 1)
STATUS_WORDS = {
    2: "a request with a wrong check byte",
    3: "an unknown command",
    4: "an unknown command",
    5: "a request that is too long",
    6: "a wrong parameter",
    7: "no data",
    10: "an error of its transmission",
}
MODULE_NUMBERS = (1, 3, 0, 2, 4, 5, 6, 7, 8)
"""In the order of the trials: the maker's manual has the first, a public driver the second."""
TAXELS_MAX = 239
"""Taxels of the largest module."""
FRAME_MIN_BYTES = HEAD_STRUCT.size + 2
FRAME_MAX_BYTES = FRAME_MIN_BYTES + BYTES_BEFORE_TAXELS + TAXEL_BYTES * TAXELS_MAX


def read_request(module: int, taxels: int) -> bytes:
    """Build the request for sum and taxels of a module."""
    count = BYTES_BEFORE_TAXELS + TAXEL_BYTES * taxels
    length = HEAD_STRUCT.size + 1 - LENGTH_OFFSET
    body = HEAD_STRUCT.pack(REQUEST_HEAD, length, module, 0, READ_FUNCTION, SUM_ADDRESS, count)
    return body + bytes((lrc(body),))


def _frame_end(buffer: bytes, at: int) -> int | None:
    size = int.from_bytes(buffer[at + 2 : at + 4], "little") + LENGTH_OFFSET
    if not FRAME_MIN_BYTES <= size <= FRAME_MAX_BYTES or buffer[at + 5]:
        return 0
    if len(buffer) < at + size:
        return None
    return at + size if sum(buffer[at : at + size]) & 0xFF == 0 else 0


class ModuleHandshake(Handshake):
    """Asks for the next reading after each answer or a silence; before the first answer each silence tries the next number."""

    silence_s = 0.3

    def __init__(self, taxels: int) -> None:
        self._taxels = taxels
        self._numbers = cycle(MODULE_NUMBERS)
        self._number = next(self._numbers)
        self._has_answered = False
        self._frames = HeadSplitter(ANSWER_HEAD, FRAME_MIN_BYTES, _frame_end)

    def opening(self) -> bytes:
        return read_request(self._number, self._taxels)

    def on_data(self, data: bytes) -> bytes:
        if not any(frame is not None for frame in self._frames.split(data)):
            return b""
        self._has_answered = True
        return self.opening()

    def on_silence(self) -> bytes:
        if not self._has_answered:
            self._number = next(self._numbers)
        return self.opening()


class PaxiniModuleDecoder(FrameDecoder):
    """Decodes the answers of a converter board."""

    name: ClassVar[str] = "PaXini module"

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self.skin_unit = "N"

    def _make_splitter(self) -> FrameSplitter:
        return HeadSplitter(ANSWER_HEAD, FRAME_MIN_BYTES, _frame_end)

    def _decode(self, frame: bytes) -> Loss | None:
        _, _, _, _, function, address, count = HEAD_STRUCT.unpack_from(frame)
        status, data = frame[HEAD_STRUCT.size], frame[HEAD_STRUCT.size + 1 : -1]
        if function != READ_FUNCTION or address not in (SUM_ADDRESS, TAXELS_ADDRESS):
            return None
        if status not in GOOD_STATUS:
            self._status = f"The module reports {STATUS_WORDS.get(status, 'an error')} (status {status:02X})"
            return Loss.INVALID
        self._status = ""
        before = BYTES_BEFORE_TAXELS if address == SUM_ADDRESS else 0
        if len(data) != count or (count - before) % TAXEL_BYTES or count <= before:
            return Loss.BAD_WIDTH
        taxels = forces_of(data[before:])
        if before and not taxels.any() and np.abs(forces_of(data[:TAXEL_BYTES])).max() >= DEAD_BLOCK_MIN_SUM:
            return Loss.DEAD_BLOCK
        values = taxels * NEWTONS_PER_STEP
        whole = self._width(Stream.SKIN) == values.size
        self.units[Stream.SKIN] = f"{'Fx Fy Fz of' if whole else 'the pressure on'} each taxel, in N"
        self.valid_records += 1
        return self._add(Stream.SKIN, NO_SEQ, math.nan, values.ravel() if whole else values[:, 2])


def _check_taxels(address: DeviceAddress) -> bool:
    """Check the option. Raises InputError."""
    text = address.options.get("taxels", "")
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= TAXELS_MAX):
        raise InputError(
            f"{address.text}: taxels is {text or 'missing'}; expected the number of taxels of the module, 1 to {TAXELS_MAX}, "
            "such as ?taxels=52: the board does not tell it."
        )
    return True


def _with_handshake(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    del questions
    return replace(address, handshake=ModuleHandshake(int(address.options["taxels"])))


_VECTOR_BYTES = bytes.fromhex("AA5510000100FB0E040000060001000004FD051EB8")

_SERIAL_ROUTE = Route(
    usage="paxini-module:/dev/ttyUSB0?taxels=52",
    form=Form.SERIAL,
    transport="serial",
    format="paxini-module",
    baud=921600,
    options=("taxels",),
    check=_check_taxels,
    prepare=_with_handshake,
)

DEVICE_FAMILY = Family(
    routes=(_SERIAL_ROUTE, replace(over_tcp(_SERIAL_ROUTE), usage="paxini-module://192.168.1.5:4001?taxels=52")),
    decoders={"paxini-module": PaxiniModuleDecoder},
    vectors=(
        Vector("paxini-module", (Stream.SKIN,), _VECTOR_BYTES, ((0.4, 3.0),), repeat=_VECTOR_BYTES, channels=2),
        Vector("paxini-module", (Stream.SKIN,), _VECTOR_BYTES, ((0.0, 0.0, 0.4, -0.3, 0.5, 3.0),), channels=6),
    ),
)
