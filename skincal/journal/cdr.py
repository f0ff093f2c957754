"""Messages of a session as ROS 2 writes them: CDR, little-endian, made by hand.

Each message begins with four bytes that say how it is encoded; every number is aligned to its size, counted from behind
these four bytes. Source: OMG DDS-XTypes 1.3, 7.4.3 (plain CDR), and ROS 2's message definitions, which travel in the file.
"""

from __future__ import annotations

import struct

import numpy as np

from skincal.geometry.arrays import FloatArray
from skincal.model.errors import InputError

_PREFIX = b"\x00\x01\x00\x00"
_SEPARATOR = "=" * 80
_HEADER = (
    f"{_SEPARATOR}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_SEPARATOR}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
SCHEMAS: dict[str, str] = {
    "skincal_msgs/msg/Chunk": "uint64 host_ns\nuint8[] data\n",
    "geometry_msgs/msg/WrenchStamped": (
        "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n"
        f"{_SEPARATOR}\nMSG: geometry_msgs/Wrench\ngeometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n"
        f"{_SEPARATOR}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n{_HEADER}"
    ),
    "skincal_msgs/msg/Taxels": f"std_msgs/Header header\nuint32 seq\nuint64 device_time_us\nfloat32[] values\n{_HEADER}",
    "sensor_msgs/msg/JointState": (
        f"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n{_HEADER}"
    ),
}
"""Definition of each message in `ros2msg`, by its name."""


def encode_chunk(host_ns: int, data: bytes) -> bytes:
    """Return a `skincal_msgs/msg/Chunk`: when bytes arrived (host's monotonic clock, ns), and the bytes."""
    return _PREFIX + struct.pack("<QI", host_ns, len(data)) + data


def decode_chunk(message: bytes) -> tuple[int, bytes]:
    """Return arrival (ns) and bytes of a `skincal_msgs/msg/Chunk`.

    Raises
    ------
    InputError
        It is not one.
    """
    if len(message) < 16 or message[:4] != _PREFIX:
        raise InputError("A chunk in the session is not encoded as expected; the session was written by another program.")
    host_ns, size = struct.unpack_from("<QI", message, 4)
    if len(message) != 16 + size:
        raise InputError(f"A chunk in the session has {len(message) - 16} bytes; expected {size}.")
    return int(host_ns), message[16:]


def encode_wrench(unix_ns: int, frame: str, wrench: FloatArray) -> bytes:
    """Return a `geometry_msgs/msg/WrenchStamped` of a (6,) wrench, N and N m."""
    body = _stamped(unix_ns, frame)
    return _PREFIX + body + bytes(-len(body) % 8) + np.ascontiguousarray(wrench, dtype="<f8").tobytes()


def encode_taxels(unix_ns: int, frame: str, seq: int, device_us: int, values: FloatArray) -> bytes:
    """Return a `skincal_msgs/msg/Taxels` of (channels,) raw values."""
    body = _stamped(unix_ns, frame)
    body += bytes(-len(body) % 4) + struct.pack("<I", seq & 0xFFFFFFFF)
    body += bytes(-len(body) % 8) + struct.pack("<QI", device_us, len(values))
    return _PREFIX + body + np.ascontiguousarray(values, dtype="<f4").tobytes()


def encode_joints(unix_ns: int, frame: str, names: tuple[str, ...], angles: FloatArray) -> bytes:
    """Return a `sensor_msgs/msg/JointState` of (joints,) angles, radians, without velocities and efforts."""
    body = _stamped(unix_ns, frame)
    body += bytes(-len(body) % 4) + struct.pack("<I", len(names))
    for name in names:
        body += bytes(-len(body) % 4) + _text(name)
    body += bytes(-len(body) % 4) + struct.pack("<I", len(angles))
    if len(angles):
        body += bytes(-len(body) % 8) + np.ascontiguousarray(angles, dtype="<f8").tobytes()
    return _PREFIX + body + struct.pack("<II", 0, 0)


def _stamped(unix_ns: int, frame: str) -> bytes:
    seconds, rest = divmod(unix_ns, 1_000_000_000)
    # The seconds of ROS 2 end in 2038; a clock that is set wrong must not stop a recording.
    return struct.pack("<iI", min(seconds, 0x7FFFFFFF), rest) + _text(frame)


def _text(text: str) -> bytes:
    raw = text.encode() + b"\x00"
    return struct.pack("<I", len(raw)) + raw
