"""Readings to bytes, as makers' boards send them: SKB/1, SKT/1 and, for skins too wide for either, delimited text.

The formats are those of `skincal.streams.decoders`; nothing is shared with the decoders, so each checks the other.
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.model.errors import InputError

CRC_START = 0xFFFF
COBS_RUN = 254
"""Most bytes other than 0 in one block of COBS."""
SKB_BODY_MAX = 1024
SKB_HEAD = struct.Struct("<BBHI")
WRENCH_TYPE, JOINTS_TYPE, HEADER_TYPE = 2, 5, 16
SKIN_TYPES = {"u16": (1, "<u2"), "u8": (3, "u1"), "f32": (4, "<f4")}
SKT_LINE_MAX = 4096


def cobs(data: bytes) -> bytes:
    """Return `data` without zero bytes (consistent overhead byte stuffing), without the closing 0."""
    out = bytearray()
    pieces = data.split(b"\x00")
    for index, piece in enumerate(pieces):
        rest = piece
        while len(rest) >= COBS_RUN:
            out.append(0xFF)
            out += rest[:COBS_RUN]
            rest = rest[COBS_RUN:]
            if not rest and index == len(pieces) - 1:
                return bytes(out)
        out.append(len(rest) + 1)
        out += rest
    return bytes(out)


@dataclass(frozen=True, slots=True)
class About:
    """What a board says of itself in a header."""

    t_us: int
    """Its clock now, microseconds."""
    fields: str
    """`key=value,...`."""
    width: int
    """Values of one reading."""


class Encoder(Protocol):
    """Makes one board's bytes; counts its records."""

    def header(self, about: About) -> bytes:
        """Return the header record."""
        ...

    def wrenches(self, t_us: IntArray, wrenches: FloatArray) -> bytes:
        """Return (n, 6) wrenches, N and N m, stamped (n,) microseconds."""
        ...

    def skin(self, t_us: int, values: FloatArray) -> bytes:
        """Return one frame of (width,) raw values."""
        ...

    def joints(self, t_us: int, degrees: FloatArray) -> bytes:
        """Return (joints,) angles, degrees."""
        ...


class Skb:
    """SKB/1.

    Parameters
    ----------
    values : "u8", "u16" or "f32": how skin values are sent
    """

    name: ClassVar[str] = "skb"

    def __init__(self, values: str = "u8") -> None:
        self._skin_type, self._dtype = SKIN_TYPES[values]
        self._count = {WRENCH_TYPE: 0, JOINTS_TYPE: 0, HEADER_TYPE: 0, self._skin_type: 0}

    def header(self, about: About) -> bytes:
        """Return the header record."""
        return self._frame(HEADER_TYPE, about.t_us, about.fields.encode())

    def wrenches(self, t_us: IntArray, wrenches: FloatArray) -> bytes:
        """Return (n, 6) wrenches, status 0."""
        payloads = np.zeros((len(wrenches), 7), dtype="<f4")
        payloads[:, :6] = wrenches
        raw = payloads.tobytes()
        return b"".join(self._frame(WRENCH_TYPE, t, raw[28 * i : 28 * i + 28]) for i, t in enumerate(t_us.tolist()))

    def skin(self, t_us: int, values: FloatArray) -> bytes:
        """Return one skin frame."""
        return self._frame(self._skin_type, t_us, values.astype(self._dtype).tobytes())

    def joints(self, t_us: int, degrees: FloatArray) -> bytes:
        """Return one set of joint angles."""
        return self._frame(JOINTS_TYPE, t_us, degrees.astype("<f4").tobytes())

    def _frame(self, kind: int, t_us: int, payload: bytes) -> bytes:
        seq = self._count[kind]
        self._count[kind] = seq + 1 & 0xFFFF
        body = SKB_HEAD.pack(kind, 0, seq, t_us & 0xFFFFFFFF) + payload
        return cobs(body + binascii.crc_hqx(body, CRC_START).to_bytes(2, "little")) + b"\x00"


class Skt:
    """SKT/1."""

    name: ClassVar[str] = "skt"

    def __init__(self, values: str = "u8") -> None:
        self._whole = values != "f32"
        self._count = {"T": 0, "F": 0, "J": 0}

    def header(self, about: About) -> bytes:
        """Return the header record; it has no time."""
        return _checked(f"H,skt1,{about.fields}")

    def wrenches(self, t_us: IntArray, wrenches: FloatArray) -> bytes:
        """Return (n, 6) wrenches, status 0, to 0.1 mN and 1 uN m."""
        lines = (f"{fx:.4f},{fy:.4f},{fz:.4f},{tx:.6f},{ty:.6f},{tz:.6f},0" for fx, fy, fz, tx, ty, tz in wrenches.tolist())
        return b"".join(self._line("F", t, line) for t, line in zip(t_us.tolist(), lines, strict=True))

    def skin(self, t_us: int, values: FloatArray) -> bytes:
        """Return one skin frame."""
        return self._line("T", t_us, _joined(values, self._whole))

    def joints(self, t_us: int, degrees: FloatArray) -> bytes:
        """Return one set of joint angles, to 0.0001 degrees."""
        return self._line("J", t_us, ",".join(f"{v:.4f}" for v in degrees.tolist()))

    def _line(self, letter: str, t_us: int, values: str) -> bytes:
        seq = self._count[letter]
        self._count[letter] = seq + 1 & 0xFFFF
        return _checked(f"{letter},{seq},{t_us & 0xFFFFFFFF},{values}")


class Text:
    """Comma-separated lines without a checksum, each with its number and clock; the header names these columns."""

    name: ClassVar[str] = "text"

    def __init__(self, values: str = "u8") -> None:
        self._whole = values != "f32"
        self._seq = 0

    def header(self, about: About) -> bytes:
        """Return the line that names the columns."""
        return ("seq,t_us," + ",".join(f"c{i}" for i in range(about.width)) + "\n").encode()

    def wrenches(self, t_us: IntArray, wrenches: FloatArray) -> bytes:
        """Return (n, 6) wrenches, to 0.1 mN and 1 uN m."""
        return b"".join(
            self._line(t, ",".join(f"{v:.6f}" for v in row)) for t, row in zip(t_us.tolist(), wrenches.tolist(), strict=True)
        )

    def skin(self, t_us: int, values: FloatArray) -> bytes:
        """Return one skin frame."""
        return self._line(t_us, _joined(values, self._whole))

    def joints(self, t_us: int, degrees: FloatArray) -> bytes:
        """Return one set of joint angles, to 0.0001 degrees."""
        return self._line(t_us, ",".join(f"{v:.4f}" for v in degrees.tolist()))

    def _line(self, t_us: int, values: str) -> bytes:
        seq = self._seq
        self._seq += 1
        return f"{seq},{t_us & 0xFFFFFFFF},{values}\n".encode()


def _joined(values: FloatArray, whole: bool) -> str:
    if not whole:
        return ",".join(f"{v:.6g}" for v in values.tolist())
    return ",".join(map(str, values.astype(np.int64).tolist()))


def _checked(text: str) -> bytes:
    raw = text.encode("ascii")
    return raw + b"*%04X\n" % binascii.crc_hqx(raw, CRC_START)


ENCODERS: dict[str, type[Skb] | type[Skt] | type[Text]] = {"skb": Skb, "skt": Skt, "text": Text}


def skin_values(top: float) -> str:
    """Return how raw values up to `top` are sent: the narrowest whole number that holds them."""
    return "u8" if top <= 255 else "u16" if top <= 65535 else "f32"


def fits(name: str, values: str, width: int) -> bool:
    """Say whether a skin frame of this width fits a record of the format."""
    if name == "skb":
        return SKB_HEAD.size + width * np.dtype(SKIN_TYPES[values][1]).itemsize <= SKB_BODY_MAX
    if name == "skt":
        digits = {"u8": 4, "u16": 6, "f32": 13}[values]
        return 24 + width * digits + 5 <= SKT_LINE_MAX
    return True


def make_encoder(name: str, top: float, width: int) -> Encoder:
    """Return a new board's encoder; a skin too wide for its format speaks delimited text instead.

    Parameters
    ----------
    name : "skb", "skt" or "text"
    top : highest raw value of the skin
    width : channels of a skin frame; 0 for a board without skin

    Raises
    ------
    InputError
        There is no such format.
    """
    if name not in ENCODERS:
        raise InputError(f"format {name!r} is not known; expected one of {', '.join(ENCODERS)}.")
    values = skin_values(top)
    return ENCODERS[name if fits(name, values, width) else "text"](values)
