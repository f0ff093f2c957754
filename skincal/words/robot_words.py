"""Sentences about a robot: its force/torque sensor, its meshes and its pokes; shared by window and commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skincal.model.urdf import LinkMesh, Robot


def drove_sentence(landmark: str) -> str:
    """Warn of a robot that drove to a landmark by a pose of the part that it was given."""
    return (
        f"The robot drove to the landmark {landmark} by a pose of the part, so its touch cannot check that pose. "
        "Guide the tip to the landmarks by hand, and look that it touches them (a program for that says `hand N`)."
    )


def silent_robot_sentence(landmark: str) -> str:
    """Report a connected robot's silence about a touch at a landmark."""
    return (
        f"The robot said nothing about the touch at the landmark {landmark}, so it is unknown whether it drove there by a pose "
        "of the part, which the touch then cannot check. Its program sends `hand N` if a person guides the tip to target N, "
        "and `reached N` if the robot drives there."
    )


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
    """Report the place of a file that replaces a mesh of the URDF, and a mirrored or stretched mesh."""
    findings: list[str] = []
    is_same_file = file.name == Path(shape.filename.replace("\\", "/")).name
    if not is_same_file and not np.allclose(shape.origin, np.eye(4), atol=1e-9):
        at = ", ".join(f"{value + 0.0:.4g}" for value in shape.origin[:3, 3] * 1e3)
        turn = np.degrees(np.arccos(np.clip((np.trace(shape.origin[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)))
        findings.append(
            f"{file.name} lies at the pose of the mesh that it replaces: its origin is at ({at}) mm in link {shape.link}, "
            f"turned by {turn:.4g} degrees; check that it is so"
        )
    if not shape.is_uniform:
        findings.append(
            f"the URDF mirrors or stretches its mesh of link {shape.link} (scale {shape.scales.tolist()}). {file.name} is used "
            "without this scale: check that it has the true shape of the part"
        )
    return findings
