"""XELA uSkin: the maker's server, JSON by websocket.

A message is an object: `message`, its number (a word in the greeting), and by the number of each sensor an object with
`taxels`, `data` (hex words x, y, z of each taxel, separated by commas) and, where the sensor is calibrated, `calibrated`
(N, in the same order). The link hands on packets (`framing.pack`), one for each message. Source: the maker's ROS node
(1.7.6).

A channel is the z of a taxel, or each of x, y and z where the scene has three channels for each taxel; sensors follow one
another by their numbers. Calibrated forces are taken where every sensor of the first message has them. Messages are dated
by their count.
"""

from __future__ import annotations

import json
import math
from typing import Any, ClassVar, cast

from skincal.model.readings import Loss, Stream
from skincal.streams.decoders.base import PieceDecoder, Pieces
from skincal.streams.decoders.framing import Packets
from skincal.streams.decoders.yarp_log import SEQ_MAX, Steps

MESSAGE_MAX = 1 << 18
"""Bytes. Ten sensors of 24 taxels, calibrated, take 15,000."""
AXES = 3


class XelaDecoder(PieceDecoder):
    """Decodes the server's messages."""

    name: ClassVar[str] = "XELA"

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._first = False  # A message comes whole or not at all.
        self._steps = Steps()
        self._calibrated: bool | None = None
        """Whether forces are taken; None before the first reading."""

    def _make_splitter(self) -> Pieces:
        return Packets(MESSAGE_MAX)

    def _decode(self, piece: bytes) -> Loss | None:
        try:
            message: Any = json.loads(piece[1:])
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
        missing = self._steps.missing(number)
        if missing:
            self.counts[Loss.MISSING] += missing
        self.good += 1
        return self._collector.add(Stream.SKIN, number, math.nan, values)

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
        whole = self._collector.width(Stream.SKIN) == len(values)
        unit = "in N" if self._calibrated else "as raw words"
        self.units[Stream.SKIN] = f"{'x y z' if whole else 'the force across the skin'} of each taxel, {unit}"
        return values if whole else values[AXES - 1 :: AXES]


def _is_number(key: str) -> bool:
    return key.isascii() and key.isdigit() and len(key) < 6
