"""Inspire RH56DFTP: a hand with 1062 taxels in 17 patches, read by Modbus TCP.

Function 03 reads at most 125 registers, so a reading takes eleven requests, one after the other. A taxel is one register, 0 to
4095, big-endian: the manual says little-endian, which a hand of 2026 does not send. Patches in order: tip (3 x 3), nail
(12 x 8) and pad (10 x 8) of little, ring, middle and index finger; tip, nail, middle (3 x 3) and pad (12 x 8) of the thumb;
palm (8 x 14). Sources: the maker's manual PRJ-02-TS-U-010, the package inspire-rh56dftp 0.1.0.

The number of a request says which patches its answer holds, so that a recording can be read again. The hand may answer with the
number of the request before, or one more or less: numbers are `TRANSACTION_STEP` apart, and the palm, which alone has 112
registers, shows the lag. An answer whose length does not fit its number is no reading. The patches of a reading are up to 70 ms
apart, since the hand answers one request after the other.
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ, FrameDecoder, FrameSplitter, LengthSplitter, ProtocolError
from skincal.devices.family import Family, Form, Handshake, HandshakeError, Route, Vector
from skincal.geometry import FloatArray
from skincal.model.readings import Loss, Stream

HEAD_STRUCT = struct.Struct(">HHHB")
"""Transaction, protocol 0, bytes that follow the next field, unit."""
READ_REGISTERS, EXCEPTION_BIT = 0x03, 0x80
ANSWER_MAX_BYTES = 260
"""Bytes of a message of Modbus TCP."""
TAXEL_READS = (
    (3000, 105), (3210, 80), (3370, 105), (3580, 80), (3740, 105), (3950, 80), (4110, 105), (4320, 80),
    (4480, 105), (4690, 105), (4900, 112),
)  # fmt: skip
"""First address, in bytes, and number of registers of each request."""
PALM_INDEX = len(TAXEL_READS) - 1
TRANSACTION_STEP, FIRST_TRANSACTION = 16, 8
"""Numbers of the requests: 8, 24, 40 ..., so that an answer that is off by one or two still names its request."""
VALUE_MAX = 4095


def read_request(index: int) -> bytes:
    """Build a request of `TAXEL_READS`."""
    address, registers = TAXEL_READS[index]
    transaction = FIRST_TRANSACTION + TRANSACTION_STEP * index
    return HEAD_STRUCT.pack(transaction, 0, 6, 1) + struct.pack(">BHH", READ_REGISTERS, address, registers)


def _next_message(data: bytes, at: int) -> tuple[bytes, int] | None:
    if len(data) - at < HEAD_STRUCT.size:
        return None
    _, protocol, length, _ = HEAD_STRUCT.unpack_from(data, at)
    if protocol or not 2 <= length <= ANSWER_MAX_BYTES:
        raise ProtocolError(f"it announces a message of {length} bytes with protocol {protocol}, which is no Modbus TCP")
    end = at + HEAD_STRUCT.size - 1 + length
    return (data[at:end], end) if len(data) >= end else None


class InspireHandshake(Handshake):
    """Asks for the next patches after each answer, and for the same ones again after a silence."""

    silence_s = 0.5

    def __init__(self) -> None:
        self._messages = LengthSplitter(_next_message)
        self._index = 0

    def opening(self) -> bytes:
        return read_request(self._index)

    def on_data(self, data: bytes) -> bytes:
        requests = b""
        for frame in self._messages.split(data):
            if frame is None:
                raise HandshakeError(self._messages.fault)
            self._index = (self._index + 1) % len(TAXEL_READS)
            requests = read_request(self._index)  # one request is open at a time
        return requests

    def on_silence(self) -> bytes:
        return read_request(self._index)


class InspireDecoder(FrameDecoder):
    """Decodes the hand's answers."""

    name: ClassVar[str] = "Inspire RH56DFTP"
    starts_whole: ClassVar[bool] = True

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self.units[Stream.SKIN] = "pressure of each taxel, 0 to 4095, 17 patches from the little finger's tip to the palm"
        self._lag: int | None = None
        """How many requests the hand's numbers are behind; `None` before the first palm."""
        self._patches: list[FloatArray] = []
        """Values of the reading that is not complete, in the order of `TAXEL_READS`."""

    def _make_splitter(self) -> FrameSplitter:
        return LengthSplitter(_next_message)

    def _decode(self, frame: bytes) -> Loss | None:
        transaction, _, _, _ = HEAD_STRUCT.unpack_from(frame)
        function, body = frame[HEAD_STRUCT.size], frame[HEAD_STRUCT.size + 1 :]
        if function & EXCEPTION_BIT:
            self._status = f"The hand refuses to send its taxels (Modbus error {body[0] if body else 0}): is it a RH56DFTP?"
            return self._restart(Loss.UNREADABLE)
        if function != READ_REGISTERS or not body or len(body) != 1 + body[0] or body[0] % 2:
            return self._restart(Loss.UNREADABLE)
        values = np.frombuffer(body, ">u2", offset=1).astype(np.float64)
        if values.max(initial=0.0) > VALUE_MAX:
            self._problem = f"A taxel has the value {values.max():.0f}, expected 0 to {VALUE_MAX}: another hand or byte order"
            return self._restart(Loss.UNREADABLE)
        named = round((transaction - FIRST_TRANSACTION) / TRANSACTION_STEP)
        if len(values) == TAXEL_READS[PALM_INDEX][1]:
            lag = (PALM_INDEX - named) % len(TAXEL_READS)
            if lag not in (0, 1):
                self._problem = "The hand's answers do not name their requests, so their patches are not known"
                return self._restart(Loss.UNREADABLE)
            self._lag = lag
        if self._lag is None:
            return None  # before the first palm
        return self._add_patches((named + self._lag) % len(TAXEL_READS), values)

    def _add_patches(self, index: int, values: FloatArray) -> Loss | None:
        is_first = not index
        if is_first:
            if self._patches:
                self._count_missing(1)
            self._patches = []
        if len(values) != TAXEL_READS[index][1]:
            return self._restart(Loss.UNREADABLE)
        if index != len(self._patches):
            # The end of a reading whose beginning is not here, or an answer that came twice.
            return self._restart(Loss.MISSING if self._patches else None)
        self._patches.append(values)
        if index < PALM_INDEX:
            return None
        whole, self._patches, self._status, self._problem = np.concatenate(self._patches), [], "", ""
        self.valid_records += 1
        return self._add(Stream.SKIN, NO_SEQ, math.nan, whole)

    def _restart(self, loss: Loss | None) -> Loss | None:
        """Drop the reading that is not complete."""
        self._patches = []
        return loss


def _answers(values: FloatArray) -> bytes:
    """Build the answers of one reading."""
    out, at = b"", 0
    for index, (_, registers) in enumerate(TAXEL_READS):
        data = values[at : at + registers].astype(">u2").tobytes()
        transaction = FIRST_TRANSACTION + TRANSACTION_STEP * index
        out += HEAD_STRUCT.pack(transaction, 0, 3 + len(data), 1) + bytes((READ_REGISTERS, len(data))) + data
        at += registers
    return out


_HAND_CHANNELS = sum(registers for _, registers in TAXEL_READS)
_VECTOR_VALUES: FloatArray = np.arange(0.0, 3.0 * _HAND_CHANNELS, 3.0)
_READING_BYTES = _answers(_VECTOR_VALUES)

DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="inspire://192.168.123.211",
            form=Form.HOST,
            transport="tcp",
            format="inspire",
            port=6000,
            options=("channels", "of"),
            handshake=lambda _: InspireHandshake(),
            needs_every_byte=True,
        ),
    ),
    decoders={"inspire": InspireDecoder},
    vectors=(
        Vector(
            "inspire",
            (Stream.SKIN,),
            _READING_BYTES * 2,
            (tuple(_VECTOR_VALUES.tolist()),),
            repeat=_READING_BYTES,
            channels=_HAND_CHANNELS,
        ),
    ),
)
