"""Datagrams of numbers: each UDP datagram is one reading, numbers of one type without a header.

The link listens on a port of this computer and hands on packets (`decoding.pack`). The first packet, kind 0, has the options of
the address, so that bytes play alone. Readings have no clock of the device. Only the first sender is read; a packet of kind 2
names another one.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar, cast

import numpy as np

from skincal.devices.decoding import DEFAULT_UNITS, NO_SEQ, WRENCH_VALUES, FrameDecoder, FrameSplitter, pack, packet_splitter
from skincal.devices.family import DeviceAddress, Family, Form, Questions, Route, Vector
from skincal.devices.rising_columns import RISING_COLUMNS_MAX, RisingColumns, rising_words
from skincal.model.errors import InputError
from skincal.model.readings import Loss, Stream

HEAD_KIND, READING_KIND, OTHER_SENDER_KIND = 0, 1, 2
DATAGRAM_MAX_BYTES = 65536
NUMPY_TYPES = {
    "float32": "f4", "float64": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
}  # fmt: skip
TEXT_FORMAT = "text"
BYTE_ORDER_OF_ENDIAN = {"little": "<", "big": ">"}
MIN_MAGNITUDE, MAX_MAGNITUDE = 1e-30, 1e30
"""Numbers other than 0 beyond these are floats of another type or byte order, and no readings."""


class DatagramDecoder(FrameDecoder):
    """Decodes datagrams of numbers."""

    name: ClassVar[str] = "datagrams"
    starts_whole: ClassVar[bool] = True

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._type: np.dtype[Any] | None = None
        self._words = ""
        """Type and byte order in words."""
        self._rising, self._rising_inside = RisingColumns(), RisingColumns()

    def _make_splitter(self) -> FrameSplitter:
        return packet_splitter(DATAGRAM_MAX_BYTES)

    def _decode(self, frame: bytes) -> Loss | None:
        kind, payload = frame[0], frame[1:]
        if kind == HEAD_KIND:
            return self._use_head(payload)
        if kind == OTHER_SENDER_KIND:
            self._status = f"{payload.decode(errors='replace')} sends to this port, too, and is not read"
            return None
        if self._type is None or kind != READING_KIND:
            return Loss.UNREADABLE
        if not payload or len(payload) % self._type.itemsize:
            self._problem = f"A datagram of {len(payload)} bytes is not of {self._words} numbers: check ?format="
            return Loss.UNREADABLE
        values = np.frombuffer(payload, self._type).astype(np.float64)
        sizes = np.abs(values[np.isfinite(values) & (values != 0)])
        if ((sizes < MIN_MAGNITUDE) | (sizes > MAX_MAGNITUDE)).any():
            self._problem = f"A value is {sizes.min():.1e} or {sizes.max():.1e} as {self._words}: check ?format= and &endian="
            return Loss.UNREADABLE
        return self._add_values(values.tolist())

    def _use_head(self, payload: bytes) -> Loss | None:
        try:
            head: Any = json.loads(payload)
            options = cast("dict[str, Any]", head)
            name, endian = str(options["format"]), str(options["endian"])
            self._type = np.dtype(BYTE_ORDER_OF_ENDIAN[endian] + NUMPY_TYPES[name])
        except (ValueError, KeyError, TypeError, RecursionError):
            return Loss.UNREADABLE
        self._words = name if self._type.itemsize == 1 else f"{name}, {endian} endian"
        self.units = {stream: f"{words}, from {self._words}" for stream, words in DEFAULT_UNITS.items()}
        return None

    def _add_values(self, values: list[float]) -> Loss | None:
        """Add a reading; a clock or a number before or behind its values is left out, since it only rises."""
        for stream in self._widths:
            width = self._width(stream)
            if width in (None, len(values)):
                if stream in (Stream.SKIN, Stream.WRENCH) and (found := self._rising_inside.add(values)) is not None:
                    self._status = (
                        f"The {rising_words(found, len(values))} only rises: if it is a clock or a number, leave it out"
                    )
                self.valid_records += 1
                return self._add(stream, NO_SEQ, math.nan, values)
        for stream in self._widths:
            excess = len(values) - (self._width(stream) or 0)
            if 0 < excess <= RISING_COLUMNS_MAX and (found := self._rising.add(values, excess)) is not None:
                left_out = f"without the {rising_words(found, len(values))}, which only rises: a clock or a number"
                self.units[stream] = f"{DEFAULT_UNITS[stream]}, from {self._words}, {left_out}"
                self.valid_records += 1
                return self._add(stream, NO_SEQ, math.nan, values[found])
        expected = " or ".join(str(self._width(stream)) for stream in self._widths)
        self._problem = f"Datagrams of {len(values)} values arrive where {expected} are expected"
        return Loss.BAD_WIDTH


def write_head(format_name: str, endian: str) -> bytes:
    """Write the first packet."""
    return pack(HEAD_KIND, json.dumps({"format": format_name, "endian": endian}).encode())


def _check(address: DeviceAddress) -> bool:
    """Check the options. Raises InputError."""
    if address.host:
        raise InputError(
            f"{address.text}: skincal listens for datagrams on a port of this computer. Let the sender send to this computer's "
            f"address and port {address.port}, and type udp://:{address.port}{_query(address)}."
        )
    name, endian = address.options.get("format", TEXT_FORMAT), address.options.get("endian", "little")
    if name not in (TEXT_FORMAT, *NUMPY_TYPES) or endian not in BYTE_ORDER_OF_ENDIAN:
        raise InputError(
            f"{address.text}: format is {name!r} and endian is {endian!r}; expected one of {TEXT_FORMAT}, "
            f"{', '.join(NUMPY_TYPES)}, and little or big."
        )
    return (name == TEXT_FORMAT) == (address.route.format != "datagrams")


def _query(address: DeviceAddress) -> str:
    return "".join(f"{'&' if n else '?'}{key}={value}" for n, (key, value) in enumerate(address.options.items()))


def _with_head(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    del questions
    return replace(address, first_bytes=write_head(address.options["format"], address.options.get("endian", "little")))


_UDP_OPTIONS = ("format", "endian", "channels", "of")
_VECTOR_VALUES: Sequence[float] = (1.5, -2.25, 30.0, 0.125, -0.5, 0.0625)
_VECTOR_BYTES = pack(READING_KIND, struct.pack(f"<{WRENCH_VALUES}f", *_VECTOR_VALUES))

DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="udp://:7000?format=float32&endian=little",
            form=Form.LISTEN,
            transport="udp",
            format="datagrams",
            options=_UDP_OPTIONS,
            check=_check,
            needs_every_byte=True,
            message_max=DATAGRAM_MAX_BYTES,
            message_kind=READING_KIND,
            prepare=_with_head,
        ),
        Route(usage="udp://:7000", form=Form.LISTEN, transport="udp", options=_UDP_OPTIONS, check=_check),
    ),
    decoders={"datagrams": DatagramDecoder},
    vectors=(
        Vector(
            "datagrams",
            (Stream.WRENCH,),
            write_head("float32", "little") + _VECTOR_BYTES,
            (_VECTOR_VALUES,),
            repeat=_VECTOR_BYTES,
        ),
    ),
)
