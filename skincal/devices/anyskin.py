"""AnySkin and ReSkin: magnetic skins; a board sends temperature and magnetic field of its chips.

A frame has four float32, little-endian, for each chip: temperature, Bx, By, Bz; then 0D 0A. Five chips make 82 bytes. There is
no checksum, and 0D 0A may stand inside a float: frames are found by their length (`marked_frames.py`). The field is in
microtesla or near it; the maker states no unit. Sources: the packages anyskin 1.0.0 and reskin-sensor 2.0.2.

A channel is the length of a chip's field, or each of Bx, By, Bz if the scene has three values for each chip (`[skin] axes = 3`
with `response = "length"`). The length alone may fall or rise under a press, since each chip has a field at rest.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ
from skincal.devices.family import Family, Form, Route, Vector, over_tcp
from skincal.devices.marked_frames import MarkedFrameDecoder, MarkedFrameSplitter
from skincal.geometry import FloatArray
from skincal.model.readings import TEMPERATURE_NAME, Loss, Stream

FRAME_END = b"\r\n"
VALUES_PER_CHIP, CHIP_BYTES = 4, 16
MIN_MAGNITUDE, MAX_MAGNITUDE = 1e-12, 1e6
"""Numbers other than 0 beyond these are no values of a magnetometer: a byte was damaged, or the frame begins elsewhere."""
TEXT_BYTES = frozenset(b"\t\n\r" + bytes(range(32, 127)))
TEMPERATURE_MIN_DEGC, TEMPERATURE_MAX_DEGC = -40.0, 125.0


def is_plausible(payload: bytes) -> bool:
    """Check whether each value of a payload is one that a magnetometer can have. Text, as some boards send it, has none."""
    if all(byte in TEXT_BYTES for byte in payload):
        return False
    values = np.abs(np.frombuffer(payload, "<f4"))
    return bool(np.isfinite(values).all() and ((values == 0) | ((values > MIN_MAGNITUDE) & (values < MAX_MAGNITUDE))).all())


class AnySkinDecoder(MarkedFrameDecoder):
    """Decodes the frames of an AnySkin or ReSkin board."""

    name: ClassVar[str] = "AnySkin"
    value_bytes: ClassVar[int] = CHIP_BYTES

    def _make_splitter(self) -> MarkedFrameSplitter:
        return MarkedFrameSplitter(FRAME_END, None, CHIP_BYTES, is_plausible)

    def _decode(self, frame: bytes) -> Loss | None:
        if len(frame) % CHIP_BYTES or not is_plausible(frame):
            return Loss.UNREADABLE
        chips = np.frombuffer(frame, "<f4").astype(np.float64).reshape(-1, VALUES_PER_CHIP)
        self.valid_records += 1
        temperatures, fields = chips[:, 0], chips[:, 1:]
        if ((temperatures > TEMPERATURE_MIN_DEGC) & (temperatures < TEMPERATURE_MAX_DEGC)).all():
            self._add_side_reading(TEMPERATURE_NAME, float(temperatures.mean()))
        lengths: FloatArray = np.sqrt(np.sum(fields * fields, axis=1))
        whole = self._width(Stream.SKIN) == fields.size
        what = "Bx By Bz" if whole else "the length of the magnetic field"
        self.units[Stream.SKIN] = f"{what} of each chip, as the board sends it"
        return self._add(Stream.SKIN, NO_SEQ, math.nan, fields.ravel() if whole else lengths)


_FRAME_BYTES = bytes.fromhex(
    "0000C841" "00004040" "00008040" "00000000"
    "0000D841" "000040C0" "00000000" "000080C0"
    "0D0A"
)  # fmt: skip
"""Two chips: 25 degC with (3, 4, 0), 27 degC with (-3, 0, -4)."""

_SERIAL_ROUTE = Route(usage="anyskin:/dev/ttyACM0", form=Form.SERIAL, transport="serial", format="anyskin", baud=115200)

DEVICE_FAMILY = Family(
    routes=(_SERIAL_ROUTE, over_tcp(_SERIAL_ROUTE)),
    decoders={"anyskin": AnySkinDecoder},
    vectors=(
        Vector("anyskin", (Stream.SKIN,), FRAME_END + _FRAME_BYTES * 3, ((5.0, 5.0),) * 3, repeat=_FRAME_BYTES, channels=2),
        Vector(
            "anyskin",
            (Stream.SKIN,),
            FRAME_END + _FRAME_BYTES * 3,
            ((3.0, 4.0, 0.0, -3.0, 0.0, -4.0),) * 3,
            channels=6,
        ),
    ),
)
