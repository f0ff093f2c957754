"""Force/torque sensors of a URDF: `<sensor><parent joint>` of iDynTree, and Gazebo's `<gazebo reference><sensor>`.

Sources: for `<sensor type="force_torque">` SDFormat's `force_torque` and `<pose>` (sdformat.org/spec) and the URDF sensor
extension of iDynTree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.urdf_chain import UrdfJoint
from skincal.model.urdf_xml import read_attribute, read_origin, read_pose_text

PoseBetween = Callable[[str, str], "FloatArray | None"]
"""Pose (4, 4) of one link in another while all joints are at 0; `None` if a name is no link."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceTorqueSensor:
    """A force/torque sensor at a joint."""

    name: str
    joint: str
    frame: str
    """Frame of the reported wrench: `child` (the default), `parent` or `sensor`."""
    direction: str
    """`child_to_parent` or `parent_to_child`; empty where the file does not say."""
    origin: FloatArray
    """(4, 4) float, metres: pose of the sensor in the child link."""
    is_gazebo: bool = False
    """Described in Gazebo's form alone."""
    is_typed: bool = True
    """The file says `type="force_torque"`."""
    is_link: bool = False
    """Made of a link that the scene names in place of a sensor."""
    bad_pose: str = ""
    """Sentence about a pose that is not understood; it is raised if the frame needs the pose."""

    def require_usable(self, joints: Mapping[str, UrdfJoint], path: Path) -> None:
        """Raise InputError if the joint is unknown, or frame, direction or pose are not understood."""
        where = f"{path}: sensor {self.name}"
        if self.joint not in joints:
            raise InputError(f"{where}: is at joint {self.joint!r}, which is not there; expected a joint of the robot.")
        if self.frame not in ("child", "parent", "sensor"):
            raise InputError(f"{where}: frame is {self.frame!r}; expected child, parent or sensor.")
        if self.direction not in ("", "child_to_parent", "parent_to_child"):
            raise InputError(f"{where}: measure_direction is {self.direction!r}; expected child_to_parent or parent_to_child.")
        if self.bad_pose and self.frame == "sensor":
            raise InputError(self.bad_pose)

    def place_frame(self, joint: UrdfJoint | None) -> tuple[str, FloatArray]:
        """Find the link that carries the sensor's frame, and the (4, 4) pose of that frame in it.

        Gazebo (SDFormat): the moment is about the joint's origin, `parent` and `sensor` give the axes. iDynTree
        (`<parent joint>`): `parent` is the whole frame of the parent link, `sensor` that of `<origin>` in the child link.
        """
        if joint is None:
            return self.name, np.eye(4)
        pose = np.eye(4)
        if self.frame == "parent":
            if self.is_gazebo:
                pose[:3, 3] = joint.origin[:3, 3]
            return joint.parent, pose
        if self.frame == "sensor":
            pose = self.origin.copy()
            if self.is_gazebo:
                pose[:3, 3] = 0.0
        return joint.child, pose


def read_sensors(
    root: ElementTree.Element, joints: Mapping[str, UrdfJoint], pose_between: PoseBetween, path: Path
) -> Iterator[ForceTorqueSensor]:
    """Read force/torque sensors in both forms; one name may have both.

    A `<sensor>` without a type that has a `<force_torque>` is one, too.
    """
    found: dict[str, ForceTorqueSensor] = {}
    places = [("", root), *((each.get("reference", ""), each) for each in root.findall("gazebo"))]
    for reference, holder in places:
        for element in holder.findall("sensor"):
            kind, details = element.get("type", ""), element.find("force_torque")
            if kind != "force_torque" and (kind or details is None):
                continue
            name = read_attribute(element, "name", path)
            parent = element.find("parent")
            joint = reference or ("" if parent is None else parent.get("joint", ""))
            frame, direction = (
                "" if details is None else (details.findtext(key) or "").strip() for key in ("frame", "measure_direction")
            )
            frame = element.findtext("frame", frame).strip()
            direction = element.findtext("measure_direction", direction).strip()
            before = found.get(name)
            has_origin = element.find("origin") is not None or element.find("pose") is not None
            joint = joint or ("" if before is None else before.joint) or (name if name in joints else "")
            origin, bad_pose = _read_place(element, joints.get(joint), joints, pose_between, f"{path}: sensor {name}")
            if before is not None and not has_origin:
                origin, bad_pose = before.origin, before.bad_pose
            found[name] = ForceTorqueSensor(
                name=name,
                joint=joint,
                frame=frame or ("" if before is None else before.frame),
                direction=direction or ("" if before is None else before.direction),
                origin=origin,
                is_gazebo=bool(reference) and (before is None or before.is_gazebo),
                is_typed=bool(kind) or (before is not None and before.is_typed),
                bad_pose=bad_pose,
            )
    for sensor in found.values():
        yield replace(sensor, frame=sensor.frame or "child")


def _read_place(
    element: ElementTree.Element,
    joint: UrdfJoint | None,
    joints: Mapping[str, UrdfJoint],
    pose_between: PoseBetween,
    where: str,
) -> tuple[FloatArray, str]:
    """Read `<origin>` or `<pose>` as the pose (4, 4) in the joint's child link; add a sentence if it is not understood."""
    pose = element.find("pose")
    try:
        if element.find("origin") is not None:
            return read_origin(element, where), ""
        if pose is None:
            return np.eye(4), ""
        origin = read_pose_text(pose, f"{where}: pose")
        names = [name for key in ("relative_to", "frame") if (name := pose.get(key, ""))]
        if len(set(names)) > 1:
            raise InputError(f"{where}: pose has relative_to={names[0]!r} and frame={names[1]!r}; leave one of them.")
        if names and joint is not None:
            origin = _frame_in_child(names[0], joint, joints, pose_between, where) @ origin
    except InputError as error:
        return np.eye(4), str(error)
    return origin, ""


def _frame_in_child(
    name: str, joint: UrdfJoint, joints: Mapping[str, UrdfJoint], pose_between: PoseBetween, where: str
) -> FloatArray:
    """Compute the pose (4, 4) of a named link or joint in the joint's child link, all joints at 0.

    SDFormat's poses are those of the model before it moves, and a joint's frame is that of its child link.
    """
    of_link, of_joint = pose_between(joint.child, name), None
    if name in joints:
        of_joint = pose_between(joint.child, joints[name].child)
    if of_link is None and of_joint is None:
        raise InputError(
            f"{where}: pose is relative to {name!r}, which is no link or joint of the robot; write the pose relative to the "
            f"link {joint.child}."
        )
    if of_link is not None and of_joint is not None and not np.allclose(of_link, of_joint, atol=1e-9):
        raise InputError(f"{where}: pose is relative to {name!r}, a link and a joint at two places; rename one of them.")
    found = of_link if of_link is not None else of_joint
    assert found is not None
    return found
