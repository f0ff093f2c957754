"""Ways to ask a robot: lines over TCP, or topics of ROS 2."""

from __future__ import annotations

from typing import TypeAlias

from skincal.robot.ros_targets import ROS_TARGETS, RosTargets, parse_ros_targets
from skincal.robot.target_server import TargetServer, parse_port

Targets: TypeAlias = TargetServer | RosTargets


def check_targets(text: str) -> None:
    """Check what `--targets` names. Raises InputError."""
    if text.startswith(ROS_TARGETS):
        parse_ros_targets(text)
    else:
        parse_port(text)


def open_targets(text: str) -> Targets:
    """Open `PORT`, `HOST:PORT`, `ros2:` or `ros2:?domain=N`. Raises InputError."""
    if text.startswith(ROS_TARGETS):
        return RosTargets(parse_ros_targets(text))
    return TargetServer(*parse_port(text))
