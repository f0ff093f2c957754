"""A robot that pokes what skincal asks for, by a Cartesian compliance controller under ROS 2.

    skincal record --targets 7010 ...            # or the window: skincal --targets 7010 ...
    python3 ros2_poker.py --port 7010

It reads skincal's lines (docs/wire.md) and publishes `target_frame` (geometry_msgs/PoseStamped) and `target_wrench`
(geometry_msgs/WrenchStamped), which cartesian_compliance_controller and its like follow: to a place before the skin, on to
the skin with the wished force, held, and back. z of the tool points the way of the push.

What it does not do is the robot's own affair: that the way to the place before the skin is free, that forces and speeds stay
below what the part and the people beside it bear, that a stop stops it. Set those limits in the controller, not here. Answer
`skip` where a place cannot be reached and `fault` where the robot has stopped; here only silence of the controller is one.

The protocol and the course of a poke need no ROS, and are tested without it; `main` alone imports rclpy.
"""

from __future__ import annotations

import argparse
import math
import socket
from dataclasses import dataclass
from urllib.parse import unquote

STANDOFF = 0.05
"""m before the skin, along the push: where a poke begins and ends."""
SPEED = 0.05
"""m/s at which the set point moves."""
RAMP_S = 0.3
"""s from touch to the wished force, and back."""


@dataclass(frozen=True)
class Target:
    """One line of skincal's: metres, newtons, seconds, in `frame`."""

    number: int
    channel: int | None
    known_point: bool
    frame: str
    pose: str
    place: tuple[float, float, float]
    push: tuple[float, float, float]
    force: float
    hold: float


def read_target(line: str) -> Target:
    """Return what a line that begins with `target` asks for; ValueError where it is none."""
    word, number, what, frame, pose, *rest = line.split()
    x, y, z, px, py, pz, force, hold = map(float, rest)
    if word != "target" or not all(map(math.isfinite, (x, y, z, px, py, pz, force, hold))):
        raise ValueError(line)
    names = ["" if name == "-" else unquote(name) for name in (frame, pose)]
    channel = None if what in ("-", "+") else int(what)
    return Target(int(number), channel, what == "+", *names, (x, y, z), (px, py, pz), force, hold)


class Lines:
    """The connection to skincal; ConnectionError where it is over."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), 5.0)
        self._socket.setblocking(False)
        self._rest = b""

    def read(self) -> list[str]:
        """Return the lines that came, without waiting."""
        try:
            data = self._socket.recv(4096)
        except BlockingIOError:
            return []
        if not data:
            raise ConnectionError("skincal hung up")
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [line.decode() for line in lines]

    def say(self, line: str) -> None:
        """Send a line."""
        self._socket.sendall(f"{line}\n".encode())

    def close(self) -> None:
        """Hang up."""
        self._socket.close()


@dataclass(frozen=True)
class SetPoint:
    """Where the tool's tip is wanted, which way z of the tool points, and the force along it; in `frame`."""

    frame: str
    place: tuple[float, float, float]
    push: tuple[float, float, float]
    force: float

    def quaternion(self) -> tuple[float, float, float, float]:
        """Return x, y, z, w of the shortest turn that brings z along the push."""
        px, py, pz = self.push
        if pz < -1.0 + 1e-9:
            return 1.0, 0.0, 0.0, 0.0
        x, y, w = -py, px, 1.0 + pz
        size = math.sqrt(x * x + y * y + w * w)
        return x / size, y / size, 0.0, w / size


class Poker:
    """The course of pokes over time: approach, press, hold, let go, back; and what is answered."""

    def __init__(self, lines: Lines) -> None:
        self._lines = lines
        self._target: Target | None = None
        self._begin_s = 0.0
        self.enough = False

    def step(self, now_s: float) -> SetPoint | None:
        """Take what skincal says and return what is wanted at `now_s`; None: nothing, stay where you are."""
        for line in self._lines.read():
            self._hear(line, now_s)
        target = self._target
        if target is None:
            return None
        back, load, over = self._course(now_s - self._begin_s, target)
        place = tuple(p - back * d for p, d in zip(target.place, target.push, strict=True))
        if over:
            self._lines.say(f"reached {target.number}")
            self._target = None
        return SetPoint(target.frame, place, target.push, load * target.force)

    def _hear(self, line: str, now_s: float) -> None:
        word = line.partition(" ")[0]
        if word == "target":
            # One that comes while another is pressed takes its place: the tool is before the skin at first.
            self._target, self._begin_s = read_target(line), now_s
        elif word in ("wait", "any", "enough"):
            self._target = None
            self.enough = word == "enough"
        elif word == "refused":
            raise ConnectionError(line)
        # accepted and rejected tell how it went; the next target says what follows.

    @staticmethod
    def _course(since_s: float, target: Target) -> tuple[float, float, bool]:
        """Return how far before the skin, m, which share of the force, and whether it is over."""
        way_s = STANDOFF / SPEED
        pressed_s = since_s - way_s
        released_s = pressed_s - RAMP_S - target.hold
        if pressed_s < 0:
            return STANDOFF - SPEED * since_s, 0.0, False
        if released_s < RAMP_S:
            return 0.0, max(0.0, min(1.0, pressed_s / RAMP_S, 1.0 - released_s / RAMP_S)), False
        back = min(STANDOFF, SPEED * (released_s - RAMP_S))
        return back, 0.0, back >= STANDOFF


def main() -> None:
    """Run as a ROS 2 node."""
    import rclpy
    from geometry_msgs.msg import PoseStamped, WrenchStamped
    from rclpy.node import Node

    options = argparse.ArgumentParser()
    options.add_argument("--host", default="127.0.0.1")
    options.add_argument("--port", type=int, default=7010)
    given, _ = options.parse_known_args()
    rclpy.init()
    node = Node("skincal_poker")
    poses = node.create_publisher(PoseStamped, "target_frame", 10)
    wrenches = node.create_publisher(WrenchStamped, "target_wrench", 10)
    poker = Poker(Lines(given.host, given.port))

    def publish() -> None:
        now = node.get_clock().now()
        wanted = poker.step(now.nanoseconds * 1e-9)
        if wanted is None:
            return
        pose, wrench = PoseStamped(), WrenchStamped()
        pose.header.stamp = wrench.header.stamp = now.to_msg()
        pose.header.frame_id = wrench.header.frame_id = wanted.frame
        for message, values in ((pose.pose.position, wanted.place), (wrench.wrench.force, wanted.push)):
            message.x, message.y, message.z = (float(value) for value in values)
        for axis in "xyz":
            setattr(wrench.wrench.force, axis, wanted.force * getattr(wrench.wrench.force, axis))
        orientation = pose.pose.orientation
        orientation.x, orientation.y, orientation.z, orientation.w = wanted.quaternion()
        poses.publish(pose)
        wrenches.publish(wrench)

    node.create_timer(0.02, publish)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
