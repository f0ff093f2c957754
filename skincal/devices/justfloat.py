"""JustFloat: boards that send float32 values, little-endian, and end each frame by 00 00 80 7F, as VOFA+ and many gloves do.

A frame has neither a checksum, nor a number, nor a clock. The end of a frame is also the float infinity, so a board that sends
infinity has no readings. A reading counts between two ends that are one frame apart (`marked_frames.py`), if a sensor can have
its values. Sources: the manual of VOFA+ (protocol "JustFloat"); fulai-tactile 1.0.5 for gloves of 415 to 615 values.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ
from skincal.devices.family import Family, Form, Route, Vector, over_tcp
from skincal.devices.marked_frames import MarkedFrameDecoder, MarkedFrameSplitter
from skincal.model.readings import Loss, Stream

FRAME_END = bytes.fromhex("0000807F")
MIN_MAGNITUDE, MAX_MAGNITUDE = 1e-30, 1e30
"""Numbers other than 0 beyond these are no values of a sensor: a byte was damaged."""
BAUD_RATES = (115200, 2_000_000, 921600, 1_000_000, 460800)
"""Boards have the first, Fulai's gloves the second."""


def is_plausible(payload: bytes) -> bool:
    """Check whether each value of a payload is one that a sensor can have."""
    values = np.abs(np.frombuffer(payload, "<f4"))
    return bool(np.isfinite(values).all() and ((values == 0) | ((values > MIN_MAGNITUDE) & (values < MAX_MAGNITUDE))).all())


class JustFloatDecoder(MarkedFrameDecoder):
    """Decodes JustFloat frames, for the stream whose number of values they have."""

    name: ClassVar[str] = "JustFloat"
    value_bytes: ClassVar[int] = 4

    def _make_splitter(self) -> MarkedFrameSplitter:
        widths = [self._width(stream) for stream in self._widths]
        size = None if len(widths) != 1 or widths[0] is None else 4 * widths[0]
        return MarkedFrameSplitter(FRAME_END, size, self.value_bytes, is_plausible)

    def _decode(self, frame: bytes) -> Loss | None:
        if not is_plausible(frame):
            return Loss.UNREADABLE
        values = np.frombuffer(frame, "<f4").astype(np.float64)
        stream = next((each for each in self._widths if self._has_width(each, len(values))), None)
        if stream is None:
            expected = " or ".join(str(self._width(each)) for each in self._widths)
            self._problem = f"Frames of {len(values)} values arrive where {expected} are expected"
            return Loss.BAD_WIDTH
        self.valid_records += 1
        return self._add(stream, NO_SEQ, math.nan, values)


_VECTOR_VALUES = (1.5, -2.25, 30.0, 0.125, -0.5, 0.0625)
_FRAME_BYTES = bytes.fromhex("0000C03F000010C00000F0410000003E000000BF0000803D0000807F")

_SERIAL_ROUTE = Route(
    usage="justfloat:/dev/ttyUSB0",
    form=Form.SERIAL,
    transport="serial",
    format="justfloat",
    bauds=BAUD_RATES,
    options=("channels", "of"),
)

DEVICE_FAMILY = Family(
    routes=(_SERIAL_ROUTE, over_tcp(_SERIAL_ROUTE)),
    decoders={"justfloat": JustFloatDecoder},
    vectors=(
        Vector("justfloat", (Stream.WRENCH,), FRAME_END + _FRAME_BYTES * 3, (_VECTOR_VALUES,) * 3, repeat=_FRAME_BYTES),
        Vector("justfloat", (Stream.SKIN,), FRAME_END + _FRAME_BYTES * 3, (_VECTOR_VALUES,) * 3, channels=6),
    ),
)
