"""The simulated rig as a ROS 2 robot: messages written by hand, and their publishers."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from skincal.model.readings import Stream
from skincal.ros.dds import Participant, default_domain
from skincal.simulation.board_formats import Encoder

TOPIC_OF_STREAM: Mapping[Stream, tuple[str, str]] = MappingProxyType(
    {
        Stream.WRENCH: ("/ft/wrench", "geometry_msgs/msg/WrenchStamped"),
        Stream.SKIN: ("/skin/taxels", "tactile_msgs/msg/TactileState"),
        Stream.JOINTS: ("/joint_states", "sensor_msgs/msg/JointState"),
    }
)
"""Topic and type of each stream."""
ROBOT_CLOCK_START_UNIX_S = 1_700_000_000
"""s since 1970: the robot's clock has the time of day, but not this machine's."""
LENGTH_STRUCT = struct.Struct("<I")


class _Cdr:
    """A message in CDR, little-endian: each value begins at a multiple of its size after the head."""

    def __init__(self) -> None:
        self._body = bytearray()

    def add(self, form: str, *values: float) -> None:
        for value in values:
            self._body += bytes(-len(self._body) % struct.calcsize(form)) + struct.pack(f"<{form}", value)

    def add_text(self, text: str) -> None:
        raw = text.encode() + b"\x00"
        self.add("I", len(raw))
        self._body += raw

    def add_header(self, t_us: int, frame: str) -> None:
        self.add("i", ROBOT_CLOCK_START_UNIX_S + t_us // 1_000_000)
        self.add("I", t_us % 1_000_000 * 1000)
        self.add_text(frame)

    def message(self) -> bytes:
        return b"\x00\x01\x00\x00" + bytes(self._body)


class Ros2Encoder(Encoder):
    """Messages of ROS 2, each after its length."""

    def record(self, stream: Stream, t_us: int, values: list[float]) -> bytes:
        cdr = _Cdr()
        cdr.add_header(t_us, stream.value)
        if stream is Stream.WRENCH:
            cdr.add("d", *values)
        elif stream is Stream.SKIN:
            cdr.add("I", 1)
            cdr.add_text("patch")
            cdr.add("I", len(values))
            cdr.add("f", *values)
        else:
            names = self.joint_names or tuple(f"joint_{index}" for index in range(len(values)))
            # A reader joins named joints by name, so another order than the scene's is published.
            order = range(len(values))[:: -1 if self.joint_names else 1]
            cdr.add("I", len(order))
            for index in order:
                cdr.add_text(names[index])
            cdr.add("I", len(order))
            cdr.add("d", *np.radians([values[index] for index in order]).tolist())
            cdr.add("I", 0, 0)  # no velocities, no efforts
        message = cdr.message()
        return LENGTH_STRUCT.pack(len(message)) + message


class RosOutlet:
    """A topic in the domain of `ROS_DOMAIN_ID`. Raises InputError: DDS is not installed, or refuses."""

    def __init__(self, stream: Stream) -> None:
        domain, (topic, type_name) = default_domain(), TOPIC_OF_STREAM[stream]
        self._participant = Participant(domain)
        self._writer = self._participant.writer(topic, type_name)
        self.address = f"ros2:{topic}?domain={domain}"

    def poll(self) -> tuple[bool, bytes]:
        """Report nothing: a publisher gets nothing from its readers."""
        return False, b""

    def write(self, data: bytes) -> None:
        at = 0
        while at < len(data):
            (length,) = LENGTH_STRUCT.unpack_from(data, at)
            at += LENGTH_STRUCT.size
            self._writer.write_bytes(data[at : at + length])
            at += length

    def close(self) -> None:
        self._participant.close()
