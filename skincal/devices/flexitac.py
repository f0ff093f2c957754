"""FlexiTac: a flexible sheet of taxels behind an ATmega, at 2 Mbaud.

A frame is AA 55 and one uint8 for each taxel, row by row: ADC / 4, which rises under pressure. The board is flashed for 12 x 32
taxels, or another matrix. There is neither a checksum nor an escape: two taxels may equal the mark. So a frame counts when the
next mark follows it at once (`marked_frames.py`), and a frame is handed on when the next one begins. Source: the package
flexitac 0.3.1. Its "normalized" values are divided by the peak of each frame; only raw ones are read here.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ
from skincal.devices.family import Family, Form, Route, Vector, over_tcp
from skincal.devices.marked_frames import MarkedFrameDecoder, MarkedFrameSplitter
from skincal.model.readings import Loss, Stream

FRAME_MARK = bytes.fromhex("AA55")


class FlexiTacDecoder(MarkedFrameDecoder):
    """Decodes a board's frames."""

    name: ClassVar[str] = "FlexiTac"
    value_bytes: ClassVar[int] = 1

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self.units[Stream.SKIN] = "pressure of each taxel, 0 to 255, row by row"

    def _make_splitter(self) -> MarkedFrameSplitter:
        return MarkedFrameSplitter(FRAME_MARK, self._width(Stream.SKIN))

    def _decode(self, frame: bytes) -> Loss | None:
        self.valid_records += 1
        return self._add(Stream.SKIN, NO_SEQ, math.nan, np.frombuffer(frame, np.uint8).astype(np.float64))


_FRAME_BYTES = FRAME_MARK + bytes([10, 40, 0, 255, 12, 99])
_VECTOR_VALUES = (10.0, 40.0, 0.0, 255.0, 12.0, 99.0)

_SERIAL_ROUTE = Route(
    usage="flexitac:/dev/ttyUSB0",
    form=Form.SERIAL,
    transport="serial",
    format="flexitac",
    baud=2_000_000,
    options=("channels", "of"),
)

DEVICE_FAMILY = Family(
    routes=(_SERIAL_ROUTE, over_tcp(_SERIAL_ROUTE)),
    decoders={"flexitac": FlexiTacDecoder},
    vectors=(
        Vector(
            "flexitac",
            (Stream.SKIN,),
            _FRAME_BYTES * 3 + FRAME_MARK,
            (_VECTOR_VALUES,) * 3,
            repeat=_FRAME_BYTES[2:] + FRAME_MARK,
            channels=6,
        ),
    ),
)
