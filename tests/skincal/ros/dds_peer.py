"""A ROS 2 publisher written for the tests with `cyclonedds` alone, as a robot's own node would publish: types by hand.

`python -m tests.skincal.ros.dds_peer DOMAIN HZ NAME=TYPE ...` publishes until its stdin ends.
"""

import os
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from functools import partial

LOOPBACK = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces></General>'
    "</Domain></CycloneDDS>"
)
os.environ["CYCLONEDDS_URI"] = LOOPBACK

from cyclonedds.core import Policy, Qos  # noqa: E402 - after the network is chosen
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import make_idl_struct  # noqa: E402
from cyclonedds.idl.annotations import final  # noqa: E402
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402

DOMAIN = 1 + os.getpid() % 100
"""Of this process: runs on one machine do not hear each other. Larger domains have ports that the system lends."""


def struct(package, name, /, **fields):
    """Make the type of a message as a node's own code has it."""
    return final(make_idl_struct(f"{name}_", f"{package}::msg::dds_::{name}_", fields))


Time = struct("builtin_interfaces", "Time", sec=int32, nanosec=uint32)
Header = struct("std_msgs", "Header", stamp=Time, frame_id=str)
Vector3 = struct("geometry_msgs", "Vector3", x=float64, y=float64, z=float64)
Wrench = struct("geometry_msgs", "Wrench", force=Vector3, torque=Vector3)
WrenchStamped = struct("geometry_msgs", "WrenchStamped", header=Header, wrench=Wrench)
_DOUBLES = dict.fromkeys(("position", "velocity", "effort"), sequence[float64])
JointState = struct("sensor_msgs", "JointState", header=Header, name=sequence[str], **_DOUBLES)
Dimension = struct("std_msgs", "MultiArrayDimension", label=str, size=uint32, stride=uint32)
Layout = struct("std_msgs", "MultiArrayLayout", dim=sequence[Dimension], data_offset=uint32)
Float32MultiArray = struct("std_msgs", "Float32MultiArray", layout=Layout, data=sequence[float32])
String = struct("std_msgs", "String", data=str)
Point = struct("geometry_msgs", "Point", x=float64, y=float64, z=float64)
Quaternion = struct("geometry_msgs", "Quaternion", x=float64, y=float64, z=float64, w=float64)
Pose = struct("geometry_msgs", "Pose", position=Point, orientation=Quaternion)
PoseStamped = struct("geometry_msgs", "PoseStamped", header=Header, pose=Pose)
Cells = struct("lab_msgs", "Cells", id=array[uint8, 3], pairs=sequence[Vector3])
"""A laboratory's own type: `uint8[3] id`, `Vector3[] pairs`."""


def header(seconds=None):
    seconds = time.time() if seconds is None else seconds
    return Header(Time(int(seconds), int(seconds % 1 * 1e9)), "frame")


def wrench(number, stamp=None):
    return WrenchStamped(header(stamp), Wrench(Vector3(1.0, -2.0, float(number)), Vector3(0.25, 0.5, -0.75)))


def skin(number, channels=4):
    return Float32MultiArray(Layout([], 0), [float(number), *range(1, channels)])


def joints(number):
    return JointState(header(), ["wheel", "elbow", "wrist"], [9.0, 0.5, 0.001 * number], [], [])


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
            self._writers[topic] = self._open(DataWriter, topic, type(message), latched, kept=10)
        self._writers[topic].write(message)

    def reader(self, topic, kind, *, latched=False):
        return self._open(DataReader, topic, kind, latched, kept=100)

    def _open(self, end, topic, kind, latched, kept):
        durability = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
        qos = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), durability, Policy.History.KeepLast(kept))
        return end(self._participant, Topic(self._participant, f"rt{topic}", kind), qos)

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
