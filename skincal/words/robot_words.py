"""Sentences about a robot's force/torque sensor and its meshes, shared by window and commands."""

from __future__ import annotations

from pathlib import Path

from skincal.model.urdf import LinkMesh, Robot


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


def replaced_mesh_findings(shape: LinkMesh, file: Path) -> list[str]:
    """Report a mesh that the URDF mirrors or stretches, and that a file with its own unit replaces."""
    if shape.is_uniform:
        return []
    return [
        f"the URDF mirrors or stretches its mesh of link {shape.link} (scale {shape.scales.tolist()}). {file.name} is used "
        "without this scale: check that it has the true shape of the part"
    ]
