"""Encoders of boards in the three board formats: SKB/1, SKT/1 and delimited text (docs/wire.md).

They share no code with the decoders in `skincal.devices`, so that each checks the other.
"""

from __future__ import annotations

import binascii
import struct
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.model.readings import Stream

CRC_CCITT_INITIAL_VALUE = 0xFFFF
COBS_MAX_NONZERO_RUN_BYTES = 254
"""Maximum number of nonzero bytes in one COBS block."""
SKB_MAX_BODY_BYTES = 1024
ENCODED_TOGETHER_MIN = 16
"""Readings from which arrays are faster than one reading after the other."""
SKB_HEAD = struct.Struct("<BBHI")
SKB_HEADER_MESSAGE_TYPE = 16
SKB_TYPES = {Stream.WRENCH: (2, "<f4"), Stream.JOINTS: (5, "<f4")}
SKB_SKIN_TYPES = {"u16": (1, "<u2"), "u8": (3, "u1"), "f32": (4, "<f4")}
SKT_LETTERS = {Stream.WRENCH: "F", Stream.SKIN: "T", Stream.JOINTS: "J", Stream.TOOL: "P"}
SKT_MAX_LINE_BYTES = 4096


class Encoder:
    """Base of the encoders: encodes the readings of one device and numbers the records of each stream."""

    def __init__(self) -> None:
        self._next_number = Counter[Stream | None]()
        """`None`: headers."""
        self.joint_names: tuple[str, ...] = ()
        """Names of the scene's columns of joint angles; empty if it has none."""
        self.skin_factor = 1.0
        """Value that a maker's device sends for each raw value of the skin."""
        self.skin_unit = ""
        """Unit of the values of a skin of three axes; empty for one axis."""
        self.skin_axes = 1
        """Values of each taxel in a frame of the skin: 1, or 3 in the order x, y, z."""

    def header(self, t_us: int, fields: str, width: int) -> bytes:
        """Encode the header: `key=value,...` and the number of values in a reading. A maker's device has none."""
        del t_us, fields, width
        return b""

    def encode(self, stream: Stream, t_us: IntArray, values: FloatArray) -> list[bytes]:
        """Encode n readings at device times `t_us` (n,), microseconds.

        Wrenches (n, 6), N and N m; raw skin frames (n, width); joint angles (n, width), degrees; or poses (n, 7), metres and a
        quaternion x y z w.
        """
        return [self.record(stream, t, row) for t, row in zip(t_us.tolist(), values.tolist(), strict=True)]

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        """Encode one reading."""
        raise NotImplementedError

    def _taxel_vectors(self, values: list[float]) -> FloatArray:
        """Return x, y and z (n, 3) of the taxels in a frame of the skin, in the device's unit; x and y are 0 with one value."""
        found: FloatArray = np.array(values, dtype=np.float64) * self.skin_factor
        if self.skin_axes == 3:
            return found.reshape(-1, 3)
        return np.column_stack([np.zeros((len(found), 2)), found])

    def _number(self, stream: Stream | None) -> int:
        self._next_number[stream] += 1
        return self._next_number[stream] - 1


def cobs(data: bytes) -> bytes:
    """Return `data` without zero bytes (consistent overhead byte stuffing), without the closing 0."""
    out = bytearray()
    pieces = data.split(b"\x00")
    for index, piece in enumerate(pieces):
        rest = piece
        while len(rest) >= COBS_MAX_NONZERO_RUN_BYTES:
            out.append(0xFF)
            out += rest[:COBS_MAX_NONZERO_RUN_BYTES]
            rest = rest[COBS_MAX_NONZERO_RUN_BYTES:]
            # A full run at the end of the data has no block for a zero after it.
            if not rest and index == len(pieces) - 1:
                return bytes(out)
        out.append(len(rest) + 1)
        out += rest
    return bytes(out)


def cobs_of_rows(rows: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return `cobs` of each row (n, width), with the closing 0: (n, width + 2); width < `COBS_MAX_NONZERO_RUN_BYTES`."""
    width = int(rows.shape[1])
    is_zero = rows == 0
    places = np.where(is_zero, np.arange(width), width)
    next_zero = np.minimum.accumulate(places[:, ::-1], axis=1)[:, ::-1]  # at each place or after it
    # Each zero, and the code before the row, becomes the distance to the next zero or to the end.
    after = np.concatenate([next_zero, np.full((len(rows), 1), width)], axis=1)
    distances = after - np.arange(-1, width)
    data = np.concatenate([np.zeros((len(rows), 1), np.uint8), rows, np.zeros((len(rows), 1), np.uint8)], axis=1)
    codes = np.concatenate([np.ones((len(rows), 1), np.bool_), is_zero], axis=1)
    data[:, :-1][codes] = distances[codes]
    return data


class SkbEncoder(Encoder):
    """SKB/1: binary records with a checksum. Skin values are "u8", "u16" or "f32"."""

    def __init__(self, values: str = "u8") -> None:
        super().__init__()
        self._types = {**SKB_TYPES, Stream.SKIN: SKB_SKIN_TYPES[values]}

    def header(self, t_us: int, fields: str, width: int) -> bytes:
        del width
        return self._frame(None, SKB_HEADER_MESSAGE_TYPE, t_us, fields.encode())

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        kind, dtype = self._types[stream]
        # A wrench is followed by a status of four bytes, 0.
        status = bytes(4) if stream is Stream.WRENCH else b""
        return self._frame(stream, kind, t_us, np.array(values).astype(dtype).tobytes() + status)

    def encode(self, stream: Stream, t_us: IntArray, values: FloatArray) -> list[bytes]:
        kind, dtype = self._types[stream]
        count, payload = len(values), values.astype(dtype).view(np.uint8).reshape(len(values), -1)
        status_bytes = 4 if stream is Stream.WRENCH else 0
        width = SKB_HEAD.size + payload.shape[1] + status_bytes + 2
        if count < ENCODED_TOGETHER_MIN or width >= COBS_MAX_NONZERO_RUN_BYTES:
            return super().encode(stream, t_us, values)
        rows = np.zeros((count, width), np.uint8)
        first = self._next_number[stream]
        self._next_number[stream] += count
        rows[:, 0] = kind
        rows[:, 2:4] = ((first + np.arange(count)) & 0xFFFF).astype("<u2").view(np.uint8).reshape(count, 2)
        rows[:, 4:8] = (t_us & 0xFFFFFFFF).astype("<u4").view(np.uint8).reshape(count, 4)
        rows[:, SKB_HEAD.size : SKB_HEAD.size + payload.shape[1]] = payload
        bodies, body = rows[:, :-2].tobytes(), width - 2
        checksums = [binascii.crc_hqx(bodies[at : at + body], CRC_CCITT_INITIAL_VALUE) for at in range(0, len(bodies), body)]
        rows[:, -2:] = np.array(checksums, "<u2").view(np.uint8).reshape(count, 2)
        frames = cobs_of_rows(rows).tobytes()
        return [frames[at : at + width + 2] for at in range(0, len(frames), width + 2)]

    def _frame(self, stream: Stream | None, kind: int, t_us: int, payload: bytes) -> bytes:
        body = SKB_HEAD.pack(kind, 0, self._number(stream) & 0xFFFF, t_us & 0xFFFFFFFF) + payload
        return cobs(body + binascii.crc_hqx(body, CRC_CCITT_INITIAL_VALUE).to_bytes(2, "little")) + b"\x00"


class TextEncoder(Encoder):
    """Delimited text: lines of number, time and values, without a checksum. The header names the columns."""

    WRENCH_FORMAT = "%.6f,%.6f,%.6f,%.6f,%.6f,%.6f"

    def __init__(self, values: str = "u8") -> None:
        super().__init__()
        self._skin_format = "%.6g" if values == "f32" else "%d"

    def header(self, t_us: int, fields: str, width: int) -> bytes:
        del t_us, fields
        return ("seq,t_us," + ",".join(f"c{i}" for i in range(width)) + "\n").encode()

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        forms = {Stream.SKIN: self._skin_format, Stream.JOINTS: "%.4f", Stream.TOOL: "%.8f"}
        form = self.WRENCH_FORMAT if stream is Stream.WRENCH else forms[stream]
        line_form = form if stream is Stream.WRENCH else ",".join([form] * len(values))
        text = line_form % tuple(values)
        return self._line(SKT_LETTERS[stream], self._number(stream), f"{t_us & 0xFFFFFFFF},{text}")

    def _line(self, letter: str, number: int, rest: str) -> bytes:
        del letter
        return f"{number},{rest}\n".encode()


class SktEncoder(TextEncoder):
    """SKT/1: lines with a letter, a checksum, and a status after each wrench. The header has no time."""

    WRENCH_FORMAT = "%.4f,%.4f,%.4f,%.6f,%.6f,%.6f,0"

    def header(self, t_us: int, fields: str, width: int) -> bytes:
        del t_us, width
        return _add_checksum(f"H,skt1,{fields}")

    def _line(self, letter: str, number: int, rest: str) -> bytes:
        return _add_checksum(f"{letter},{number & 0xFFFF},{rest}")


def _add_checksum(text: str) -> bytes:
    raw = text.encode("ascii")
    return raw + b"*%04X\n" % binascii.crc_hqx(raw, CRC_CCITT_INITIAL_VALUE)


BOARD_ENCODERS: dict[str, type[SkbEncoder | TextEncoder]] = {"skb": SkbEncoder, "skt": SktEncoder, "text": TextEncoder}


def make_encoder(name: str, top: float, width: int) -> Encoder:
    """Return a new board's encoder; a skin too wide for the format gets delimited text instead.

    Raw values reach up to `top`; `width` is 0 for a board without skin.
    """
    values = "u8" if top <= 255 else "u16" if top <= 65535 else "f32"
    skb_bytes = SKB_HEAD.size + width * np.dtype(SKB_SKIN_TYPES[values][1]).itemsize
    skt_bytes = 24 + width * {"u8": 4, "u16": 6, "f32": 13}[values] + 5
    fits = {"skb": skb_bytes <= SKB_MAX_BODY_BYTES, "skt": skt_bytes <= SKT_MAX_LINE_BYTES}.get(name, True)
    return BOARD_ENCODERS[name if fits else "text"](values)
