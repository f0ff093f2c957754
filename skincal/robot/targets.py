"""Ways to ask a robot: lines over TCP, or topics of ROS 2."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeAlias

from skincal.robot.ros_targets import ROS_TARGETS, RosTargets, parse_ros_targets
from skincal.robot.target_lines import AskedLine, RobotLine
from skincal.robot.target_server import RobotChange, TargetServer, open_port, parse_port


class Targets(Protocol):
    """A connection to a robot that pokes, as the guide uses it: with lines, topics or within one program."""

    def send(self, lines: Sequence[AskedLine]) -> None:
        """Send lines to the robot."""
        ...

    def read_answers(self) -> list[RobotLine | RobotChange | str]:
        """Return the lines since the last call, the coming and going of the robot, and sentences for the operator."""
        ...

    def refuse(self, reason: str) -> None:
        """End the connection to a robot whose line is impossible."""
        ...


OpenTargets: TypeAlias = TargetServer | RosTargets
"""A connection by a port or by ROS 2."""


def check_targets(text: str) -> None:
    """Check what `--targets` names. Raises InputError."""
    if text.startswith(ROS_TARGETS):
        parse_ros_targets(text)
    else:
        parse_port(text)


def open_targets(text: str) -> OpenTargets:
    """Open `PORT`, `HOST:PORT`, `ros2:` or `ros2:?domain=N`. Raises InputError."""
    if text.startswith(ROS_TARGETS):
        return RosTargets(parse_ros_targets(text))
    return TargetServer(open_port(*parse_port(text)))
