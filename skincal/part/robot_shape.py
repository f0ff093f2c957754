"""The look of a URDF robot: the visual meshes of its links, and the poses of all links at given joint angles."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skincal.geometry import FloatArray, IntArray, inverse_pose
from skincal.mesh.readers import read_mesh
from skincal.model.errors import InputError, plural
from skincal.model.given import MAX_MESH_BYTES, read_regular
from skincal.model.mesh_lookup import find_mesh, package_of
from skincal.model.urdf import Robot
from skincal.model.urdf_chain import TURNING_JOINT_KINDS

DRAWN_ROBOT_MAX_TRIANGLES = 2_000_000
"""Of a whole robot in the view: an iCub has 300,000. Links beyond it are not drawn."""
MIN_DISTANCE_OF_SIDES_M = 0.03
"""Between the middles of left and right links; nearer, their names mean something else."""
_SIDE_OF_LINK = re.compile(r"(^|[_\-.])(l|r|left|right)(?=[_\-.]|$)|^(Left|Right)(?=[A-Z])", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class LinkShape:
    """Visual mesh of a link."""

    link: str
    vertices: FloatArray
    """(n, 3) float, metres, in the frame of the link."""
    triangles: IntArray
    """(m, 3) int."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotShape:
    """Visual meshes of a robot."""

    links: tuple[LinkShape, ...]
    findings: tuple[str, ...]
    """Sentences about meshes that are not drawn."""


def load_robot_shape(robot: Robot, packages: Mapping[str, Path]) -> RobotShape:
    """Read the visual meshes of all links. Files that cannot be read are reported in the findings and left out."""
    shapes: list[LinkShape] = []
    missing: list[str] = []
    total = 0
    for link, mesh in robot.meshes.items():
        try:
            path = find_mesh(robot, mesh, packages)
            read = read_mesh(path, read_regular(path, MAX_MESH_BYTES, what="mesh file"))
        except InputError as error:
            missing.append(str(error))
            continue
        points, faces = read.points, read.triangles
        total += len(faces)
        if total > DRAWN_ROBOT_MAX_TRIANGLES or not len(faces) or not np.isfinite(points).all():
            missing.append(f"{path}: is too large, empty or not finite")
            continue
        pose = mesh.origin
        faces = faces[:, ::-1] if np.prod(mesh.scales) < 0 else faces  # a mirror turns the winding
        shapes.append(LinkShape(link, points * mesh.scales @ pose[:3, :3].T + pose[:3, 3], faces))
    findings = (
        (f"{plural(len(missing), 'mesh file')} of the robot cannot be drawn; the first: {missing[0]}",) if missing else ()
    )
    return RobotShape(tuple(shapes), findings)


def missing_packages(robot: Robot, packages: Mapping[str, Path]) -> list[str]:
    """List the ROS packages of meshes that are not found."""
    missing: dict[str, None] = {}
    for mesh in robot.meshes.values():
        package = package_of(mesh.filename)
        if package:
            try:
                find_mesh(robot, mesh, packages)
            except InputError:
                missing[package] = None
    return list(missing)


def middle_angles(robot: Robot) -> dict[str, float]:
    """Choose an angle for each joint that moves on its own, radians: 0, or the nearest limit."""
    moving = [joint for joint in robot.joints.values() if joint.kind in TURNING_JOINT_KINDS and joint.mimic is None]
    return {joint.name: 0.0 if joint.limits is None else float(np.clip(0.0, *joint.limits)) for joint in moving}


def left_of_robot(poses: Mapping[str, FloatArray]) -> FloatArray | None:
    """Find the robot's left by the names of its links: `l_hand`, `left_hand`, `LeftHand` and their right partners.

    `poses` are (4, 4), metres, in the frame of its root, whose z axis is upright, by link.

    Returns
    -------
    (3,) float, unit, level: from the right links to the left ones; `None` if the names tell no sides
    """
    sides: dict[str, list[FloatArray]] = {"l": [], "r": []}
    for link, pose in poses.items():
        match = _SIDE_OF_LINK.search(link)
        if match is not None:
            sides[match[0].strip("_-.").lower()[0]].append(pose[:2, 3])
    if not (sides["l"] and sides["r"]):
        return None
    across = np.mean(sides["l"], axis=0) - np.mean(sides["r"], axis=0)
    size = float(np.linalg.norm(across))
    return np.array([*(across / size), 0.0]) if size >= MIN_DISTANCE_OF_SIDES_M else None


def link_poses(robot: Robot, angles: Mapping[str, float], root: str) -> dict[str, FloatArray]:
    """Compute the (4, 4) poses of all links in the frame of the link `root`, metres.

    `angles` are radians, by joint; mimic joints follow theirs; joints without an angle, and joints that slide, are at 0.
    """
    angles = robot.complete_angles(angles)
    children: dict[str, list[str]] = {}
    for joint in robot.joints.values():
        children.setdefault(joint.parent, []).append(joint.name)
    poses, waiting = {robot.root: np.eye(4)}, [robot.root]
    while waiting:
        at = waiting.pop()
        for name in children.get(at, []):
            joint = robot.joints[name]
            angle = angles.get(name, 0.0) if joint.kind in TURNING_JOINT_KINDS else 0.0
            poses[joint.child] = poses[at] @ (joint.transform(angle) if joint.kind in TURNING_JOINT_KINDS else joint.origin)
            waiting.append(joint.child)
    back = inverse_pose(poses[root])
    return {link: back @ pose for link, pose in poses.items()}
