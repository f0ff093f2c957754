"""Messages in the MCAP file as ROS 2 writes them, in CDR, little-endian.

Each begins with four bytes that name the encoding. Every number is aligned to its size, counted from behind these four bytes.
Source: OMG DDS-XTypes 1.3, 7.4.3 (plain CDR), and ROS 2's message definitions, which are copied into the file.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError

MAX_ROS_TIME_S = 0x7FFFFFFF
"""s. The seconds of ROS 2 end in 2038; a clock that is set wrong must not stop a recording."""
CDR_HEADER = b"\x00\x01\x00\x00"
_DEFINITION_SEPARATOR = "=" * 80
_HEADER = (
    f"{_DEFINITION_SEPARATOR}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_DEFINITION_SEPARATOR}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
MESSAGE_SCHEMAS: dict[str, str] = {
    "skincal_msgs/msg/Chunk": "uint64 host_ns\nuint8[] data\n",
    "geometry_msgs/msg/WrenchStamped": (
        "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n"
        f"{_DEFINITION_SEPARATOR}\nMSG: geometry_msgs/Wrench\ngeometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n"
        f"{_DEFINITION_SEPARATOR}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n{_HEADER}"
    ),
    "skincal_msgs/msg/Taxels": f"std_msgs/Header header\nuint32 seq\nfloat32[] values\n{_HEADER}",
    "sensor_msgs/msg/Temperature": f"std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n{_HEADER}",
    "sensor_msgs/msg/JointState": (
        f"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n{_HEADER}"
    ),
}
"""Definition of each message in `ros2msg`, by its name."""


def encode_chunk(host_ns: int, data: bytes) -> bytes:
    """Encode a `skincal_msgs/msg/Chunk`: arrival of the bytes (host's monotonic clock, ns), and the bytes."""
    return CDR_HEADER + struct.pack("<QI", host_ns, len(data)) + data


def decode_chunk(message: bytes) -> tuple[int, bytes]:
    """Decode arrival (ns) and bytes of a `skincal_msgs/msg/Chunk`. Raises InputError: it is none."""
    if len(message) < 16 or message[:4] != CDR_HEADER:
        raise InputError("A chunk in the session is not encoded as expected; the session was written by another program.")
    host_ns, size = struct.unpack_from("<QI", message, 4)
    if len(message) != 16 + size:
        raise InputError(f"A chunk in the session has {len(message) - 16} bytes; expected {size}.")
    return int(host_ns), message[16:]


def encode_wrenches(unix_ns: IntArray, frame: str, wrenches: FloatArray) -> NDArray[np.uint8]:
    """Encode `geometry_msgs/msg/WrenchStamped`, (n, bytes), from (n,) times and (n, 6) wrenches, N and N m."""
    body = _header(0, frame)
    prefix = CDR_HEADER + body + bytes(-len(body) % 8)
    messages = np.empty(len(wrenches), np.dtype([("prefix", "u1", (len(prefix),)), ("wrench", "<f8", (6,))]))
    messages["prefix"], messages["wrench"] = np.frombuffer(prefix, np.uint8), wrenches
    rows = messages.view(np.uint8).reshape(len(wrenches), -1)
    seconds, rest = np.divmod(unix_ns, 1_000_000_000)
    clock = np.column_stack([np.minimum(seconds, MAX_ROS_TIME_S), rest]).astype("<u4")
    rows[:, len(CDR_HEADER) : len(CDR_HEADER) + 8] = clock.view(np.uint8)
    return rows


def encode_taxels(unix_ns: int, frame: str, seq: int, values: FloatArray) -> bytes:
    """Encode a `skincal_msgs/msg/Taxels` of (channels,) raw values; `seq` counts the frames of a recording."""
    head = _stamp(unix_ns) + _taxels_head(frame) + struct.pack("<II", seq & 0xFFFFFFFF, len(values))
    return head + np.ascontiguousarray(values, dtype="<f4").tobytes()


@lru_cache(maxsize=16)
def _taxels_head(frame: str) -> bytes:
    """Encode what is between stamp and number of a `skincal_msgs/msg/Taxels`."""
    return _padded(_text(frame), 4)


def encode_joints(unix_ns: int, frame: str, names: Sequence[str], angles: FloatArray) -> bytes:
    """Encode a `sensor_msgs/msg/JointState` of (joints,) angles, radians, without velocities and efforts."""
    head = _stamp(unix_ns) + _joints_head(frame, tuple(names), len(angles))
    return head + np.ascontiguousarray(angles, dtype="<f8").tobytes() + bytes(8)


@lru_cache(maxsize=16)
def _joints_head(frame: str, names: tuple[str, ...], count: int) -> bytes:
    """Encode what is between stamp and angles of a `sensor_msgs/msg/JointState`. The stamp ends at a multiple of 8 bytes."""
    body = _padded(_text(frame), 4) + struct.pack("<I", len(names))
    for name in names:
        body = _padded(body, 4) + _text(name)
    body = _padded(body, 4) + struct.pack("<I", count)
    # CDR aligns written numbers only: an empty sequence has no padding behind its length.
    return _padded(body, 8) if count else body


def encode_temperature(unix_ns: int, frame: str, celsius: float) -> bytes:
    """Encode a `sensor_msgs/msg/Temperature`, degC; its variance 0 means unknown."""
    body = _header(unix_ns, frame)
    return CDR_HEADER + body + bytes(-len(body) % 8) + struct.pack("<dd", celsius, 0.0)


def _header(unix_ns: int, frame: str) -> bytes:
    return _stamp(unix_ns)[len(CDR_HEADER) :] + _text(frame)


def _stamp(unix_ns: int) -> bytes:
    """Encode the beginning of a message with a time."""
    seconds, rest = divmod(unix_ns, 1_000_000_000)
    return CDR_HEADER + struct.pack("<iI", min(seconds, MAX_ROS_TIME_S), rest)


def _padded(body: bytes, size: int) -> bytes:
    return body + bytes(-len(body) % size)


def _text(text: str) -> bytes:
    raw = text.encode() + b"\x00"  # CDR counts the closing zero
    return struct.pack("<I", len(raw)) + raw
