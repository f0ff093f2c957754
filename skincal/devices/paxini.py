"""PaXini PX-6AX GEN3: fingertips and pads whose taxels measure a force vector, by the high-speed board of a robot's hand.

A request is 55 AA, 0, a function (03 read, 10 write), register uint16, length uint16, data, LRC; an answer begins with AA 55.
A frame of the stream is AA 56, 0, length uint16 (of the payload and the error byte), an error byte, the payload, LRC. The LRC
makes the sum of all bytes 0 modulo 256. Numbers are little-endian. Registers: 0010 four bytes, a bit for each of 28 modules;
0016 bit 0 sums, bit 1 taxels; 0030 the number of taxels of each module, uint16; writing 1 to 0017 starts the stream. The
payload has for each module that is there: six bytes of its sum, whose first, third and fifth are Fx, Fy (int8) and Fz (uint8),
then three such bytes for each taxel. A step is 0.1 N. Source: the package paxini-sdk 0.1.0, tried on hardware by its author.

A channel is the pressure (Fz) of a taxel, or each of Fx, Fy, Fz if the scene has three values for each taxel (`[skin]` with
`axes = 3`). Fz rises when the taxel is pressed and is never negative. The registers are read first, since the board answers
nothing while it streams; their answers are in the stream, so that a recording can be read again. A frame whose length does not
fit them is no reading. Some boards send blocks of taxels that are all 0 below a sum that is not (lerobot-robot-so101-paxini):
that frame would be the end of a contact, so it is dropped and counted.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ, FrameDecoder, FrameSplitter, HeadSplitter
from skincal.devices.family import Family, Form, Handshake, Route, Vector, over_tcp
from skincal.geometry import IntArray
from skincal.model.readings import Loss, Stream

REQUEST, ANSWER, STREAMED = b"\x55\xaa", b"\xaa\x55", b"\xaa\x56"
READ, WRITE, ERROR_BIT = 0x03, 0x10, 0x80
MODULES_REGISTER, CONTENT_REGISTER, STREAM_REGISTER, TAXELS_REGISTER = 0x0010, 0x0016, 0x0017, 0x0030
REGISTERS_READ = ((MODULES_REGISTER, 4), (CONTENT_REGISTER, 1), (TAXELS_REGISTER, 56))
"""Registers that are read before the stream, and their bytes."""
MODULES_MAX = 28
HAS_SUMS, HAS_TAXELS = 1, 2
SUM_BYTES, TAXEL_BYTES = 6, 3
REQUEST_STRUCT = struct.Struct("<2sBBHH")
FRAME_MIN_BYTES = 7
PAYLOAD_MAX_BYTES = 28 * (SUM_BYTES + 239 * TAXEL_BYTES)
"""Bytes: 28 modules of 239 taxels, the largest of the maker."""
NEWTONS_PER_STEP = 0.1
DEAD_BLOCK_MIN_SUM = 10
"""Steps of a module's sum (1 N) from which taxels that are all 0 are a fault: less may be spread below one step a taxel."""


def lrc(data: bytes) -> int:
    """Compute the byte that makes the sum of `data` and itself 0 modulo 256."""
    return -sum(data) & 0xFF


def request(function: int, register: int, length: int, data: bytes = b"") -> bytes:
    """Build a request."""
    body = REQUEST_STRUCT.pack(REQUEST, 0, function, register, length) + data
    return body + bytes((lrc(body),))


def _frame_end(buffer: bytes, at: int) -> int | None:
    """Find the end of an answer or of a frame of the stream."""
    kind = buffer[at : at + 2]
    if kind == STREAMED:
        size = 5 + int.from_bytes(buffer[at + 3 : at + 5], "little") + 1
    elif kind == ANSWER:
        if len(buffer) < at + 8:
            return None
        size = 8 + int.from_bytes(buffer[at + 6 : at + 8], "little") + 1
    else:
        return 0
    if not FRAME_MIN_BYTES <= size <= PAYLOAD_MAX_BYTES + FRAME_MIN_BYTES or buffer[at + 2]:
        return 0
    if len(buffer) < at + size:
        return None
    return at + size if sum(buffer[at : at + size]) & 0xFF == 0 else 0


class PaxiniHandshake(Handshake):
    """Stops the stream, reads the registers, one after each answer, then starts the stream; again after a silence."""

    silence_s = 0.3
    closing_bytes = request(WRITE, STREAM_REGISTER, 1, b"\x00")

    def __init__(self) -> None:
        self._frames = HeadSplitter(b"\xaa", FRAME_MIN_BYTES, _frame_end)
        self._is_stopped = False
        self._step = 0

    def opening(self) -> bytes:
        self._is_stopped, self._step = True, 0
        return self.closing_bytes

    def on_silence(self) -> bytes:
        if not self._is_stopped:
            return self.opening()
        self._is_stopped, self._step = False, 0
        return request(READ, *REGISTERS_READ[0])

    def on_data(self, data: bytes) -> bytes:
        answers = b""
        for frame in self._frames.split(data):
            wanted = REGISTERS_READ[self._step] if self._step < len(REGISTERS_READ) else None
            if frame is None or wanted is None or not frame.startswith(ANSWER):
                continue
            if frame[3] == READ and struct.unpack_from("<HH", frame, 4) == wanted:
                self._step += 1
                is_last = self._step == len(REGISTERS_READ)
                answers += (
                    request(WRITE, STREAM_REGISTER, 1, b"\x01") if is_last else request(READ, *REGISTERS_READ[self._step])
                )
        return answers


@dataclass(frozen=True, slots=True)
class Shape:
    """Content of a frame of the stream, from the registers; `None` for one that was not read yet."""

    modules: tuple[int, ...] | None = None
    """Numbers of the modules that are there."""
    content: int | None = None
    taxels: tuple[int, ...] | None = None
    """Taxels of each of the 28 modules."""

    @property
    def is_known(self) -> bool:
        return self.modules is not None and self.content is not None and self.taxels is not None

    def with_register(self, register: int, data: bytes) -> Shape:
        """Return the shape with the content of one more register."""
        if register == MODULES_REGISTER and len(data) == 4:
            bits = int.from_bytes(data, "little")
            return replace(self, modules=tuple(index for index in range(MODULES_MAX) if bits >> index & 1))
        if register == CONTENT_REGISTER and len(data) == 1:
            return replace(self, content=data[0])
        if register == TAXELS_REGISTER and len(data) == 2 * MODULES_MAX:
            return replace(self, taxels=struct.unpack(f"<{MODULES_MAX}H", data))
        return self

    @property
    def counts(self) -> list[int]:
        """Taxels of each module that is there."""
        return [self.taxels[index] for index in self.modules or ()] if self.taxels is not None else []

    @property
    def sum_bytes(self) -> int:
        """Bytes before the taxels of a module."""
        return SUM_BYTES if (self.content or 0) & HAS_SUMS else 0

    @property
    def payload_bytes(self) -> int:
        return sum(self.sum_bytes + TAXEL_BYTES * count for count in self.counts)


class PaxiniDecoder(FrameDecoder):
    """Decodes the stream of a high-speed board."""

    name: ClassVar[str] = "PaXini GEN3"

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._shape = Shape()
        self.skin_unit = "N"

    def _make_splitter(self) -> FrameSplitter:
        return HeadSplitter(b"\xaa", FRAME_MIN_BYTES, _frame_end)

    def _decode(self, frame: bytes) -> Loss | None:
        if frame.startswith(ANSWER):
            return self._use_answer(frame)
        error, payload = frame[5], frame[6:-1]
        if not payload:
            return None  # the answer to the start
        self._status = f"The board reports error {error:02X}, see its manual" if error else ""
        if error:
            return Loss.INVALID
        shape = self._shape
        if not shape.is_known:
            self._problem = "Readings come before the board's registers, so their modules are not known: connect it again"
            return Loss.UNREADABLE
        if not (shape.content or 0) & HAS_TAXELS:
            self._problem = "The board is set to send the sums of its modules alone; set it to send taxels (register 0016)"
            return Loss.UNREADABLE
        if len(payload) != shape.payload_bytes:
            self._problem = f"Frames of {len(payload)} bytes arrive where its modules need {shape.payload_bytes}"
            return Loss.BAD_WIDTH
        return self._add_modules(payload)

    def _use_answer(self, frame: bytes) -> Loss | None:
        function, (register, length) = frame[3], struct.unpack_from("<HH", frame, 4)
        if function & ERROR_BIT:
            self._problem = f"The board refuses register {register:04X} (error {function & ~ERROR_BIT:02X})"
        elif function == READ and length == len(frame) - 9:
            self._shape, self._problem = self._shape.with_register(register, frame[8:-1]), ""
        return None

    def _add_modules(self, payload: bytes) -> Loss | None:
        shape, forces, at = self._shape, list[IntArray](), 0
        for count in shape.counts:
            begin = at + shape.sum_bytes
            at = begin + TAXEL_BYTES * count
            taxels = forces_of(payload[begin:at])
            if count and shape.sum_bytes and not taxels.any():
                total = forces_of(payload[begin - SUM_BYTES : begin : 2])
                if np.abs(total).max() >= DEAD_BLOCK_MIN_SUM:
                    return Loss.DEAD_BLOCK
            forces.append(taxels)
        values = np.concatenate(forces) * NEWTONS_PER_STEP
        whole = self._width(Stream.SKIN) == values.size
        self.units[Stream.SKIN] = f"{'Fx Fy Fz of' if whole else 'the pressure on'} each taxel, module by module, in N"
        self.valid_records += 1
        return self._add(Stream.SKIN, NO_SEQ, math.nan, values.ravel() if whole else values[:, 2])


def forces_of(data: bytes) -> IntArray:
    """Read Fx, Fy (int8) and Fz (uint8) of n taxels, (n, 3), steps."""
    values = np.frombuffer(data, np.uint8).astype(np.int64).reshape(-1, TAXEL_BYTES)
    values[:, :2] -= 256 * (values[:, :2] > 127)
    return values


_REGISTER_BYTES = bytes.fromhex("AA5500031000040040000000AA") + bytes.fromhex("AA5500031600010003E4")
"""Module 6 is there; sums and taxels."""
_TAXELS_ANSWER = REQUEST_STRUCT.pack(ANSWER, 0, READ, TAXELS_REGISTER, 56) + bytes(12) + b"\x02\x00" + bytes(42)
_FRAME_BYTES = bytes.fromhex("AA56000D00000200FFFF0800000004FD051EC7")

_SERIAL_ROUTE = Route(
    usage="paxini:/dev/ttyUSB0",
    form=Form.SERIAL,
    transport="serial",
    format="paxini",
    baud=921600,
    options=("channels", "of"),
    handshake=lambda _: PaxiniHandshake(),
    needs_every_byte=True,
)

DEVICE_FAMILY = Family(
    routes=(_SERIAL_ROUTE, over_tcp(_SERIAL_ROUTE)),
    decoders={"paxini": PaxiniDecoder},
    vectors=(
        Vector(
            "paxini",
            (Stream.SKIN,),
            _REGISTER_BYTES + _TAXELS_ANSWER + bytes((lrc(_TAXELS_ANSWER),)) + _FRAME_BYTES,
            ((0.4, 3.0),),
            repeat=_FRAME_BYTES,
            channels=2,
        ),
    ),
)
