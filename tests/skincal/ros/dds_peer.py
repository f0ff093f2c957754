"""A ROS 2 publisher written for the tests with `cyclonedds` alone, as a robot's own node would publish: types by hand.

`python -m tests.skincal.ros.dds_peer DOMAIN HZ NAME=TYPE ...` publishes until its stdin ends.
"""

import os
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

LOOPBACK = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces></General>'
    "</Domain></CycloneDDS>"
)
os.environ["CYCLONEDDS_URI"] = LOOPBACK

from cyclonedds.core import Policy, Qos  # noqa: E402 - after the network is chosen
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct  # noqa: E402
from cyclonedds.idl.annotations import final  # noqa: E402
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402

DOMAIN = 1 + os.getpid() % 100
"""Of this process: runs on one machine do not hear each other. Larger domains have ports that the system lends."""


@dataclass
@final
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
@final
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
@final
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
@final
class Wrench(IdlStruct, typename="geometry_msgs::msg::dds_::Wrench_"):
    force: Vector3
    torque: Vector3


@dataclass
@final
class WrenchStamped(IdlStruct, typename="geometry_msgs::msg::dds_::WrenchStamped_"):
    header: Header
    wrench: Wrench


@dataclass
@final
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)


@dataclass
@final
class Dimension(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayDimension_"):
    label: str
    size: uint32
    stride: uint32


@dataclass
@final
class Layout(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayLayout_"):
    dim: sequence[Dimension] = field(default_factory=list)
    data_offset: uint32 = 0


@dataclass
@final
class Float32MultiArray(IdlStruct, typename="std_msgs::msg::dds_::Float32MultiArray_"):
    layout: Layout
    data: sequence[float32]


@dataclass
@final
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


@dataclass
@final
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
@final
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
@final
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
@final
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header
    pose: Pose


@dataclass
@final
class Cells(IdlStruct, typename="lab_msgs::msg::dds_::Cells_"):
    """A laboratory's own type: `uint8[3] id`, `Pair[] pairs`."""

    id: array[uint8, 3]
    pairs: sequence[Vector3]


def header(seconds=None):
    seconds = time.time() if seconds is None else seconds
    return Header(Time(int(seconds), int(seconds % 1 * 1e9)), "frame")


def wrench(number, stamp=None):
    return WrenchStamped(header(stamp), Wrench(Vector3(1.0, -2.0, float(number)), Vector3(0.25, 0.5, -0.75)))


def skin(number, channels=4):
    return Float32MultiArray(Layout(), [float(number), *range(1, channels)])


def joints(number):
    return JointState(header(), ["wheel", "elbow", "wrist"], [9.0, 0.5, 0.001 * number])


MAKERS = {
    "wrench": wrench,
    "skin": skin,
    "skin64": partial(skin, channels=64),
    "skin384": partial(skin, channels=384),
    "joints": joints,
}


@contextmanager
def process(*topics, hz=200, domain=DOMAIN):
    """Publish from a process of its own."""
    command = [sys.executable, "-m", "tests.skincal.ros.dds_peer", str(domain), str(hz), *topics]
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield child
    finally:
        child.kill()
        child.wait()
        child.stdin.close()
        child.stdout.close()


class Peer:
    """A node with publishers."""

    def __init__(self, domain=DOMAIN):
        self._participant, self._writers = DomainParticipant(domain), {}

    def publish(self, topic, message, *, latched=False):
        if topic not in self._writers:
            durability = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
            qos = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), durability, Policy.History.KeepLast(10))
            self._writers[topic] = DataWriter(self._participant, Topic(self._participant, f"rt{topic}", type(message)), qos)
        self._writers[topic].write(message)

    def reader(self, topic, kind, *, latched=False):
        durability = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
        qos = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), durability, Policy.History.KeepLast(100))
        return DataReader(self._participant, Topic(self._participant, f"rt{topic}", kind), qos)

    def drop(self, topic):
        del self._writers[topic]


def main(domain, hz, *topics):
    over = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
    peer, number, begin_s = Peer(int(domain)), 0, time.monotonic()
    while not over.wait(max(begin_s + (number + 1) / float(hz) - time.monotonic(), 0.0)):
        number += 1
        for topic, kind in (each.split("=") for each in topics):
            peer.publish(topic, MAKERS[kind](number))
    # Ending at once could drop what is still on its way.
    time.sleep(1.0)
    sys.stdout.write(f"{number}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
