"""XELA uSkin: the maker's server, JSON by websocket.

A message is an object: `message`, its number (a word in the greeting), and by the number of each sensor an object with
`taxels`, `data` (hex words x, y, z of each taxel, separated by commas) and, where the sensor is calibrated, `calibrated`
(N, in the same order). The link hands on packets (`decoding.pack`), one for each message. Source: the maker's ROS node
(1.7.6).

A channel is the z of a taxel, or each of x, y and z where the scene has three channels for each taxel; sensors follow one
another by their numbers. Calibrated forces are taken where every sensor of the first message has them. Messages are dated
by their count.
"""

from __future__ import annotations

import json
import math
from typing import Any, ClassVar, cast

from skincal.devices.decoding import SEQ_MAX, FrameDecoder, FrameSplitter, pack, packet_splitter
from skincal.devices.family import Family, Form, Route, Vector
from skincal.model.readings import Loss, Stream

MESSAGE_MAX_BYTES = 1 << 18
"""Bytes. Ten sensors of 24 taxels, calibrated, take 15,000."""
AXES_PER_TAXEL = 3


class XelaDecoder(FrameDecoder):
    """Decodes the server's messages."""

    name: ClassVar[str] = "XELA"
    starts_whole: ClassVar[bool] = True

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._calibrated: bool | None = None
        """Whether calibrated forces are used; `None` before the first reading."""

    def _make_splitter(self) -> FrameSplitter:
        return packet_splitter(MESSAGE_MAX_BYTES)

    def _decode(self, frame: bytes) -> Loss | None:
        try:
            message: Any = json.loads(frame[1:])
        except (ValueError, RecursionError):
            return Loss.UNREADABLE
        if not isinstance(message, dict):
            return Loss.UNREADABLE
        found = cast("dict[str, Any]", message)
        sensors = [found[key] for key in sorted((key for key in found if _is_number(key)), key=int)]
        number = found.get("message")
        if not sensors or not isinstance(number, int) or not 0 <= number < SEQ_MAX:
            return None  # the greeting
        try:
            values = self._values(sensors)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
            return Loss.UNREADABLE
        self._count_gap(number)
        self.valid_records += 1
        return self._add(Stream.SKIN, number, math.nan, values)

    def _values(self, sensors: list[Any]) -> list[float]:
        if self._calibrated is None:
            self._calibrated = all(sensor.get("calibrated") for sensor in sensors)
        values: list[float] = []
        for sensor in sensors:
            if self._calibrated:
                values += [float(value) for value in sensor["calibrated"]]
            else:
                values += [float(int(word, 16)) for word in sensor["data"].split(",")]
        # Three channels for each taxel where the scene has as many; else the one across the skin.
        whole = self._width(Stream.SKIN) == len(values)
        unit = "in N" if self._calibrated else "as raw words"
        self.units[Stream.SKIN] = f"{'x y z' if whole else 'the force across the skin'} of each taxel, {unit}"
        self.skin_unit = "N" if self._calibrated else ""
        return values if whole else values[AXES_PER_TAXEL - 1 :: AXES_PER_TAXEL]


def _is_number(key: str) -> bool:
    return key.isascii() and key.isdigit() and len(key) < 6


_VECTOR_BYTES = pack(1, b'{"message": 7, "2": {"data": "0003,0004,00FF"}, "1": {"data": "7F3C,7B6C,000A,0001,0002,000B"}}')

DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="xela://127.0.0.1:5000",
            form=Form.HOST,
            transport="websocket",
            format="xela",
            port=5000,
            message_max=MESSAGE_MAX_BYTES,
        ),
    ),
    decoders={"xela": XelaDecoder},
    vectors=(Vector("xela", (Stream.SKIN,), _VECTOR_BYTES, ((10.0, 11.0, 255.0),), repeat=_VECTOR_BYTES, channels=3),),
)
