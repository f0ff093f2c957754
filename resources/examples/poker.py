"""A robot that pokes what skincal asks for: a template for a real arm, in the standard library alone.

    skincal record --targets 7010 ...            # or the window: skincal --targets 7010 ...
    python3 poker.py --port 7010

Fill in the frame and the three functions of `Arm`; docs/robot.md has those for UR by RTDE and for ROS 2. All places of `Arm`
are metres in the robot's base. With `[tool]` in the scene nobody measures the part: skincal finds its pose in the base of
`--tool`, and sends it. Until then the robot waits if `Arm.part` is `None`: guide the tip to the landmarks by hand. Try it
first on a soft part, with a low `FORCE_LIMIT`, and a hand on the emergency stop.

Between other directions the tip goes back by `CLEAR`, more than the part is wide. It skips the far side of the part.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import socket
import time
from urllib.parse import unquote

Vector = tuple[float, float, float]
Pose = tuple[float, float, float, float, float, float, float]
"""Position, m, and quaternion x y z w."""
AT_BASE: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

STANDOFF, SEARCH, CLEAR = 0.03, 0.012, 0.15
"""m: before the place, where a poke begins and ends; behind it, where the search ends; back before another direction."""
SAME_SIDE, NEAR_SIDE = 0.9, -0.3
"""Cosines of the angle between two pushes: no need to go back; the part is not in the way."""
TRAVEL, APPROACH, PRESS = 0.10, 0.015, 0.005
"""m/s."""
TOUCH, FORCE_LIMIT = 1.0, 20.0
"""N above the tare: the part is felt; the tip goes back."""
FORCE_MAX_AGE_S, SILENCE_S, PERIOD_S, TARE_S, SETTLE_S = 0.1, 3.0, 0.02, 0.3, 5.0
"""s: oldest force that allows a motion; silence that is a fault; time of a step; of taring; to reach the force."""


class Arm:
    """Your robot."""

    frame = ""
    """Name of the part's frame: the link that the scene calibrates. A target in another frame is a fault."""
    part: Pose | None = None
    """Pose of the part in the robot's base, as measured; `None` until skincal sends it, after the landmarks. With a rough one
    the robot drives to the landmarks, and its error is in all taxels. `AT_BASE` if the functions work in the part's frame."""

    def read(self) -> tuple[Vector, float, float]:
        """Return the place of the tip's end; the force along the push, N, not tared; and its age, s."""
        raise NotImplementedError

    def move_tip(self, place: Vector, push: Vector) -> None:
        """Set the place of the tip's end and the direction of the tool, for the next period; a set point, not a path."""
        raise NotImplementedError

    def can_reach(self, place: Vector, push: Vector) -> bool:
        """Whether the robot gets there: the answer of its inverse kinematics, with its limits."""
        raise NotImplementedError


class Stop(Exception):  # noqa: N818 - it ends a poke, it is no error
    """The poke ends: another target, `wait`, `stop`, or skincal is gone."""


class Fault(Exception):  # noqa: N818 - as above
    """The robot stops until an operator has looked; the text is for skincal."""


class Poker:
    """The pokes that skincal asks for, over one connection after another."""

    def __init__(self, arm: Arm, host: str, port: int) -> None:
        self.arm, self.place, self.side = arm, (host, port), None
        self.part = arm.part
        """The newest pose of the part: that of the arm, then that of skincal."""
        self._used = self.part or AT_BASE
        self._reported_s = 0.0

    def say(self, line: str) -> None:
        """Send a line."""
        self._socket.sendall(f"{line}\n".encode())

    def run(self) -> None:
        """Connect, and poke until skincal has enough; ConnectionError if it closes the connection."""
        self.target, self.held, self._rest = None, False, b""
        self._socket = socket.create_connection(self.place, 5.0)
        with self._socket:
            self._socket.setblocking(False)
            self.say(f"robot {TRAVEL} 6")
            while self.target != ():
                with contextlib.suppress(Stop):
                    self._serve_target()

    def _serve_target(self) -> None:
        """Wait for a target, poke it, and answer."""
        while self.target is None or self.part is None:
            self._wait()
        (number, place, push, force, hold), self.target, self.held = self.target, None, False
        self._used = self.part
        place, push = _moved(_turned(self._used[3:], place), self._used[:3], 1.0), _turned(self._used[3:], push)
        turn = 1.0 if self.side is None else sum(a * b for a, b in zip(self.side, push, strict=True))
        ends = [_moved(place, push, way) for way in (-CLEAR, -STANDOFF, 0.0)]
        if turn < NEAR_SIDE or not all(self.arm.can_reach(end, push) for end in ends):
            self.say(f"skip {number} out of reach")
            return
        try:
            if turn < SAME_SIDE:
                self._go(_moved(self.arm.read()[0], self.side, -CLEAR), self.side)
                self._go(ends[0], push)
            self._go(ends[1], push)
            self.side = push
            self.say(f"{'reached' if self._poke(place, push, force, hold) else 'skip'} {number}")
        except Fault as fault:
            self.say(f"fault {number} {fault}")

    def _poke(self, place: Vector, push: Vector, force: float, hold: float) -> bool:
        """Poke once; whether something was felt. However it ends, the tip goes back."""
        depth = -STANDOFF
        try:
            tare = self._tare(place, push)
            until_s, pressed_s = math.inf, math.inf
            while depth < SEARCH and time.monotonic() < until_s and not self.held:
                felt = self._fresh_force(place, push, depth, is_pressing=until_s < math.inf) - tare
                if abs(felt) > FORCE_LIMIT:
                    return False
                if felt > TOUCH and until_s == math.inf:
                    until_s = time.monotonic() + SETTLE_S
                if abs(felt - force) < 0.06 * force and pressed_s == math.inf:
                    pressed_s = time.monotonic()
                    until_s = pressed_s + hold + 1.5
                # Slower and slower towards the wanted force.
                speed = APPROACH if felt < TOUCH else max(-PRESS, min(PRESS, (force - felt) * PRESS / force * 2.0))
                if pressed_s == math.inf or abs(felt - force) > 0.06 * force:
                    depth += speed * PERIOD_S
                self._move(place, push, depth)
            return depth < SEARCH
        finally:
            while depth > -STANDOFF:
                depth -= TRAVEL * PERIOD_S
                self.arm.move_tip(_moved(place, push, depth), push)
                time.sleep(PERIOD_S)

    def _go(self, place: Vector, push: Vector) -> None:
        """Move the tip straight, without a touch."""
        start = self.arm.read()[0]
        rest = self._fresh_force(start, push, 0.0)
        steps = max(1, math.ceil(math.dist(start, place) / (TRAVEL * PERIOD_S)))
        way = tuple(b - a for a, b in zip(start, place, strict=True))
        here = start
        for step in range(1, steps + 1):
            if abs(self._fresh_force(here, push, 0.0) - rest) > FORCE_LIMIT:
                raise Fault("something was met on the way")
            here = _moved(start, way, step / steps)
            self._move(here, push, 0.0)

    def _fresh_force(self, place: Vector, push: Vector, depth: float, *, is_pressing: bool = False) -> float:
        """Return the force along the push, N; wait at a place while it is old. A pressing tip does not wait."""
        end_s = time.monotonic() + SILENCE_S
        while True:
            _, force, age_s = self.arm.read()
            if age_s <= FORCE_MAX_AGE_S:
                return force
            if is_pressing or time.monotonic() > end_s:
                raise Fault("no fresh force reading")
            self._move(place, push, depth)

    def _tare(self, place: Vector, push: Vector) -> float:
        """Return the mean force without contact, N."""
        read: list[float] = []
        end_s = time.monotonic() + TARE_S
        while time.monotonic() < end_s or not read:
            read.append(self._fresh_force(place, push, -STANDOFF))
            self._move(place, push, -STANDOFF)
        return sum(read) / len(read)

    def _move(self, place: Vector, push: Vector, depth: float) -> None:
        tip = _moved(place, push, depth)
        self.arm.move_tip(tip, push)
        if time.monotonic() - self._reported_s > 0.1:
            self._reported_s = time.monotonic()
            back = (*(-value for value in self._used[3:6]), self._used[6])
            there = (*_turned(back, _moved(tip, self._used[:3], -1.0)), *_turned(back, push))
            self.say("tip " + " ".join(f"{value:.6f}" for value in there))
        self._wait()

    def _wait(self) -> None:
        """Wait one period and read skincal's lines."""
        time.sleep(PERIOD_S)
        try:
            data = self._socket.recv(4096)
        except BlockingIOError:
            return
        if not data:
            raise ConnectionError("skincal closed the connection")
        *lines, self._rest = (self._rest + data).split(b"\n")
        ends = [self._ends_poke(line.decode()) for line in lines]
        if any(ends):
            raise Stop

    def _ends_poke(self, line: str) -> bool:
        """Follow a line; whether it ends the present poke."""
        word, *rest = line.split() or [""]
        if word == "target":
            frame = unquote(rest[2])
            if frame not in (self.arm.frame, "-"):
                self.target = None
                self.say(
                    f"fault {rest[0]} the target is in the frame {frame}, the robot works in {self.arm.frame or 'no frame'}"
                )
                return True
            x, y, z, px, py, pz, force, hold = map(float, rest[4:])
            self.target = int(rest[0]), (x, y, z), (px, py, pz), force, hold
            return True
        if word == "part" and unquote(rest[0]) == self.arm.frame:
            x, y, z, qx, qy, qz, qw = map(float, rest[1:])
            self.part = x, y, z, qx, qy, qz, qw
        if word in ("wait", "stop", "any", "enough"):
            self.target = () if word == "enough" else None
            return True
        if word == "refused":
            raise ConnectionError(line)
        self.held |= word == "held"
        return False


def _moved(place: Vector, push: Vector, way: float) -> Vector:
    return tuple(p + way * d for p, d in zip(place, push, strict=True))


def _turned(quaternion: tuple[float, ...], point: Vector) -> Vector:
    """Turn a point by a unit quaternion x y z w."""
    x, y, z, w = quaternion
    a, b, c = point
    across = y * c - z * b + w * a, z * a - x * c + w * b, x * b - y * a + w * c
    i, j, k = across
    return a + 2.0 * (y * k - z * j), b + 2.0 * (z * i - x * k), c + 2.0 * (x * j - y * i)


def main() -> None:
    """Poke; connect again if skincal is gone."""
    options = argparse.ArgumentParser()
    options.add_argument("--host", default="127.0.0.1")
    options.add_argument("--port", type=int, default=7010)
    given = options.parse_args()
    poker = Poker(Arm(), given.host, given.port)
    while True:
        try:
            poker.run()
        except OSError as error:
            print(f"{error}; trying again")  # noqa: T201
            time.sleep(1.0)
        else:
            return


if __name__ == "__main__":
    main()
