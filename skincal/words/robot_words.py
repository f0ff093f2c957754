"""Sentences about a robot's force/torque sensor, shared by window and commands."""

from __future__ import annotations

from skincal.model.urdf import Robot


def sensor_findings(robot: Robot, sensor_name: str, link: str) -> list[str]:
    """List what is unusual about a sensor for a part on a link."""
    sensor = robot.sensor_named(sensor_name, str(robot.path))
    findings: list[str] = []
    if not sensor.is_typed:
        findings.append(f"sensor {sensor.name} has no type; it is taken for a force/torque sensor by its <force_torque>")
    if not robot.feels(sensor, link):
        others = [each.name for each in robot.sensors if robot.feels(each, link)]
        hint = f"; {', '.join(others)} is" if others else ""
        findings.append(f"sensor {sensor_name} is not between the part and the robot's base{hint}: it may not feel the pokes")
    return findings
