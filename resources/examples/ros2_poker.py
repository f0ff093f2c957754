"""A robot that pokes what skincal asks for, by a Cartesian compliance controller under ROS 2.

    skincal record --targets 7010 ...            # or the window: skincal --targets 7010 ...
    python3 ros2_poker.py --port 7010

It reads skincal's lines (docs/wire.md) and publishes `target_frame` (geometry_msgs/PoseStamped) and `target_wrench`
(geometry_msgs/WrenchStamped) for a controller such as cartesian_compliance_controller. The tool goes to a place before the
skin, presses with the wanted force, holds, and goes back. Its z axis points along the push. On `wait`, `stop`, another target
or a lost connection the force goes to zero at once, and the tool goes back.

It reads no force. Set the limits of force and speed in the controller, and see to it yourself that the way to the place before
the skin is free. Answer `skip` if a place cannot be reached, and `fault` if the robot has stopped.

`main` alone needs ROS (rclpy). The rest is tested without it.
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
"""s from touch to the wanted force, and back."""


@dataclass(frozen=True)
class Target:
    """A request of skincal: metres, newtons, seconds, in `frame`."""

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
    """Read a line that begins with `target`; ValueError for any other."""
    word, number, what, frame, pose, *rest = line.split()
    x, y, z, px, py, pz, force, hold = map(float, rest)
    if word != "target" or not all(map(math.isfinite, (x, y, z, px, py, pz, force, hold))):
        raise ValueError(line)
    names = ["" if name == "-" else unquote(name) for name in (frame, pose)]
    channel = None if what in ("-", "+") else int(what)
    return Target(int(number), channel, what == "+", *names, (x, y, z), (px, py, pz), force, hold)


class Lines:
    """The connection to skincal; ConnectionError once it is closed."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), 5.0)
        self._socket.setblocking(False)
        self._rest = b""

    def read(self) -> list[str]:
        """Return the lines that have arrived, without waiting."""
        try:
            data = self._socket.recv(4096)
        except BlockingIOError:
            return []
        if not data:
            raise ConnectionError("skincal closed the connection")
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [line.decode() for line in lines]

    def say(self, line: str) -> None:
        """Send a line."""
        self._socket.sendall(f"{line}\n".encode())

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


@dataclass(frozen=True)
class SetPoint:
    """Wanted position of the tool's tip, direction of its z axis, and force along it; in `frame`."""

    frame: str
    place: tuple[float, float, float]
    push: tuple[float, float, float]
    force: float

    def quaternion(self) -> tuple[float, float, float, float]:
        """Compute x, y, z, w of the shortest turn that brings z along the push."""
        px, py, pz = self.push
        if pz < -1.0 + 1e-9:
            return 1.0, 0.0, 0.0, 0.0
        x, y, w = -py, px, 1.0 + pz
        size = math.sqrt(x * x + y * y + w * w)
        return x / size, y / size, 0.0, w / size


class Poker:
    """The pokes over time: approach, press, hold, let go, back; and the answers."""

    def __init__(self, lines: Lines) -> None:
        self._lines = lines
        self._target: Target | None = None
        self._next: Target | None = None
        self._begin_s = self._back = 0.0
        self._stopped_s: float | None = None
        self.lost = False
        """skincal is gone: no more targets follow."""

    def step(self, now_s: float) -> SetPoint | None:
        """Read skincal's lines and return the set point at `now_s`; None: stay there."""
        try:
            for line in [] if self.lost else self._lines.read():
                self._follow_line(line, now_s)
        except ConnectionError:
            self.lost = True
            self._let_go(now_s)
        if self._target is None and self._next is not None:
            self._target, self._next, self._begin_s = self._next, None, now_s
        target = self._target
        if target is None:
            return None
        if self._stopped_s is None:
            self._back, load, is_over = self._course(now_s - self._begin_s, target)
            back = self._back
        else:
            load, back = 0.0, min(STANDOFF, self._back + SPEED * (now_s - self._stopped_s))
            is_over = back >= STANDOFF
        place = tuple(p - back * d for p, d in zip(target.place, target.push, strict=True))
        if is_over:
            if self._stopped_s is None:
                self._lines.say(f"reached {target.number}")
            self._target = self._stopped_s = None
        return SetPoint(target.frame, place, target.push, load * target.force)

    def _follow_line(self, line: str, now_s: float) -> None:
        word = line.partition(" ")[0]
        if word == "target":
            self._next = read_target(line)
            self._let_go(now_s)
        elif word in ("wait", "stop", "any", "enough"):
            self._next = None
            self._let_go(now_s)
        elif word == "refused":
            raise ConnectionError(line)
        # accepted and rejected are verdicts on pokes; the next target follows them.

    def _let_go(self, now_s: float) -> None:
        """End the present poke: no force from now on, and back."""
        if self._target is not None and self._stopped_s is None:
            self._stopped_s = now_s

    @staticmethod
    def _course(since_s: float, target: Target) -> tuple[float, float, bool]:
        """Compute the distance before the skin, m, the share of the force, and whether the poke is over."""
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
            if poker.lost:
                raise SystemExit("skincal closed the connection")
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
