"""A robot's URDF: its links and joints, the chain between two links, force/torque sensors, meshes of links.

The file comes from strangers: a document type is refused (entities), so are cycles, links with two parents, and names of meshes
that leave the folder.

Sources: the URDF's XML reference (wiki.ros.org/urdf/XML); for `<sensor type="force_torque">` SDFormat's `force_torque`
(sdformat.org/spec) and the URDF sensor extension of iDynTree.
"""

from __future__ import annotations

import contextlib
import difflib
import os
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from skincal.geometry import FloatArray, inverse_pose
from skincal.model.errors import InputError, plural
from skincal.model.given import read_regular

MAX_URDF_BYTES = 16 << 20
"""The official URDF of a whole iCub has 0.2 MB."""
URDF_TREE_MAX_DEPTH = 200
"""Joints between the root and a link. The longest chain of a humanoid has 40."""
URDF_MAX_LINKS = 5000
"""A humanoid with all its frames has 250."""
URDF_MAX_LENGTH_M = 100.0
MOVING = ("revolute", "continuous")
"""Kinds of joints whose angle is streamed."""
KINDS = (*MOVING, "fixed", "prismatic", "floating", "planar")


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint:
    """A joint between two links."""

    name: str
    kind: str
    parent: str
    child: str
    origin: FloatArray
    """(4, 4) float, metres: pose of the child in the parent at angle 0."""
    axis: FloatArray
    """(3,) float, unit, in the child's frame."""
    limits: tuple[float, float] | None
    """rad, lowest and highest angle; `None` where the joint turns without end."""
    mimics: str
    """Joint that this one follows; empty for none."""

    def transform(self, angle: float) -> FloatArray:
        """Compute the (4, 4) pose of the child in the parent at `angle` radians, by Rodrigues' formula."""
        if self.kind == "fixed":
            return self.origin
        x, y, z = self.axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = np.eye(4)
        turn[:3, :3] += np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
        return self.origin @ turn


@dataclass(frozen=True, slots=True, eq=False)
class LinkMesh:
    """The first visual mesh of a link."""

    link: str
    filename: str
    origin: FloatArray
    """(4, 4) float, metres: pose of the mesh in the link."""
    scales: FloatArray
    """(3,) float: metres per unit of the file, along each axis."""
    others: int = 0
    """Further visual shapes of the link, which are not used."""

    def scale(self, where: str) -> float:
        """Return the metres per unit; `InputError` if the axes differ or one is mirrored."""
        if not (self.scales > 0).all() or not np.allclose(self.scales, self.scales[0], rtol=1e-9):
            raise InputError(
                f"{where}: the mesh of link {self.link} is scaled by {self.scales.tolist()}; expected one positive number for "
                "all axes. Save the mesh in its true shape."
            )
        return float(self.scales[0])


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


@dataclass(frozen=True, slots=True, eq=False)
class UrdfChain:
    """The joints between sensor and part of a URDF robot, in place of an `Arm`."""

    joints: tuple[int, ...]
    """Columns of the joint stream, one for each moving joint."""
    moving: tuple[UrdfJoint, ...]
    """The joints of these columns."""
    steps: tuple[tuple[UrdfJoint, bool, float], ...]
    """From the part's link to the sensor's: joint, whether the step goes up to its parent, its angle (rad) if not streamed."""
    sensor: FloatArray
    """(4, 4) float, metres: pose of the sensor in the last link."""

    def link_from_sensor(self, angles: FloatArray) -> FloatArray:
        """Compute the (4, 4) pose of the sensor in the link frame, p_link = T p_sensor.

        Parameters
        ----------
        angles : (len(joints),) float, radians, of the moving joints in the order of `joints`
        """
        streamed = {joint.name: float(angle) for joint, angle in zip(self.moving, angles, strict=True)}
        pose = np.eye(4)
        for joint, up, angle in self.steps:
            step = joint.transform(streamed.get(joint.name, angle))
            pose = pose @ (inverse_pose(step) if up else step)
        return pose @ self.sensor

    def middle_angles(self) -> FloatArray:
        """Compute the (len(joints),) angles in the middle of the limits, radians; 0 for a joint without limits."""
        return np.array([0.0 if joint.limits is None else sum(joint.limits) / 2.0 for joint in self.moving])

    def limit_warning(self, angles: FloatArray) -> str | None:
        """Describe the first angle (rad) outside its joint's limits, with the likely mistake; `None` if all lie inside."""
        for joint, angle, column in zip(self.moving, np.asarray(angles, dtype=float), self.joints, strict=True):
            if _fits(joint, angle):
                continue
            low, high = np.degrees(_limits(joint))
            advice = self._limit_advice(np.asarray(angles, dtype=float))
            limits = (
                f"its limits are {low:.0f} to {high:.0f}"
                if joint.limits
                else f"within {UNLIMITED_JOINT_MAX_TURNS} turns are expected"
            )
            return f"joint {joint.name} (column {column}) is at {np.degrees(angle):.1f} degrees; {limits}; {advice}."
        return None

    def unit_warning(self, lowest: FloatArray, highest: FloatArray) -> str | None:
        """Suspect radians read as degrees, from the range of the angles (joints,), rad, of an arm that moves; else `None`.

        Radians lie within half a turn, 3.14; so angles of a right stream would all stay within 3.14 degrees of 0. Of arm poses
        that are drawn evenly from limits of 50 degrees either way, three in a row do so once in 4,000 for one joint, and never
        for two.
        """
        reach, moved = np.degrees(np.abs([lowest, highest]).max()), np.degrees((highest - lowest).max())
        if reach > np.pi or moved < RADIANS_CHECK_MIN_JOINT_RANGE_RAD:
            return None
        return (
            f"the arm moves, and all its angles stay within {reach:.1f} degrees of 0; if the stream is in radians, convert it "
            "to degrees."
        )

    def _limit_advice(self, angles: FloatArray) -> str:
        """Name a mistake that would explain angles (rad) outside the limits."""
        if self._fit(np.degrees(angles)):
            return "if the stream is in radians, convert it to degrees (the values fit as radians)"
        if np.abs(angles).max() > 2.0 * np.pi and self._fit(np.radians(angles)):
            return "if the values are in degrees, do not read them as radians (they fit as degrees)"
        for one, other in combinations(range(len(angles)), 2):
            swapped = angles.copy()
            swapped[[one, other]] = angles[[other, one]]
            if self._fit(swapped):
                names = f"{self.moving[one].name} and {self.moving[other].name}"
                return f"the values fit if {names} are exchanged: check the order of the joints"
        return "check the order of the joints and their unit"

    def _fit(self, angles: FloatArray) -> bool:
        return all(_fits(joint, angle) for joint, angle in zip(self.moving, angles.tolist(), strict=True))


LIMIT_SLACK = float(np.radians(3.0))
"""Tolerance of the joint limits, rad: encoders have offsets."""
UNLIMITED_JOINT_MAX_TURNS = 3
"""Expected turns of a joint without limits, either way: cables wind up."""
RADIANS_CHECK_MIN_JOINT_RANGE_RAD = 1.0
"""rad, smallest range of a joint that is called moving: 1 degree if the stream is right, 57 degrees if it is in radians."""


def _limits(joint: UrdfJoint) -> tuple[float, float]:
    return joint.limits or (-2.0 * np.pi * UNLIMITED_JOINT_MAX_TURNS, 2.0 * np.pi * UNLIMITED_JOINT_MAX_TURNS)


def _fits(joint: UrdfJoint, angle: float) -> bool:
    low, high = _limits(joint)
    return low - LIMIT_SLACK <= angle <= high + LIMIT_SLACK


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """The content of a URDF file."""

    path: Path
    name: str
    links: tuple[str, ...]
    joints: Mapping[str, UrdfJoint]
    """By name."""
    sensors: tuple[ForceTorqueSensor, ...]
    meshes: Mapping[str, LinkMesh]
    """By link."""

    @property
    def root(self) -> str:
        """The link that is no joint's child."""
        children = {joint.child for joint in self.joints.values()}
        return next(link for link in self.links if link not in children)

    def joint_above(self, link: str) -> UrdfJoint | None:
        """Find the joint whose child a link is; `None` for the root."""
        return next((joint for joint in self.joints.values() if joint.child == link), None)

    def path_to_root(self, link: str) -> list[UrdfJoint]:
        """List the joints from a link up to the root."""
        above = {joint.child: joint for joint in self.joints.values()}
        path: list[UrdfJoint] = []
        while link in above:
            path.append(above[link])
            link = above[link].parent
        return path

    def require_link(self, name: str, where: str) -> None:
        """Raise InputError if the robot has no link of this name."""
        if name not in self.links:
            raise InputError(f"{where}: {self.path.name} has no link {name!r}; {_suggest(name, self.links)}.")

    def sensor_named(self, name: str, where: str) -> ForceTorqueSensor:
        """Find the force/torque sensor, or make one of the joint or the link, of this name.

        Raises InputError: nothing has this name.
        """
        for sensor in self.sensors:
            if sensor.name == name:
                _require_usable(sensor, self.joints, self.path)
                return sensor
        if name in self.joints:
            return ForceTorqueSensor(name, name, "child", "", np.eye(4))
        if name in self.links:
            above = self.joint_above(name)
            return ForceTorqueSensor(name, "" if above is None else above.name, "child", "", np.eye(4))
        known = [sensor.name for sensor in self.sensors]
        advice = f"it has the sensors {', '.join(known)}" if known else "name a joint or a link at the sensor"
        raise InputError(f"{where}: {self.path.name} has no force/torque sensor, joint or link {name!r}; {advice}.")

    def chain(
        self, link: str, sensor_name: str, columns: Sequence[str], fixed: Mapping[str, float], where: str
    ) -> tuple[UrdfChain, int | None]:
        """Find the chain between a part's link and its sensor, and the sign of the wrench.

        Parameters
        ----------
        link : frame of all positions
        sensor_name : force/torque sensor, joint or link
        columns : names of the joints in the joint stream, in its order
        fixed : rad, angles of joints that are not streamed
        where : begins the sentence of an error

        Returns
        -------
        The chain, and the sign: 1 if the sensor reports the force on the part, -1 for the reaction, `None` if unknown.

        Raises
        ------
        InputError
            A name is unknown, or a joint of the chain is neither streamed nor fixed, or of a kind that is not supported.
        """
        self.require_link(link, where)
        sensor = self.sensor_named(sensor_name, where)
        joint = self.joints.get(sensor.joint)
        at, pose = _sensor_frame(sensor, joint)
        up, down = self.path_to_root(link), self.path_to_root(at)
        while up and down and up[-1] is down[-1]:
            up.pop()
            down.pop()
        steps = [(each, True) for each in up] + [(each, False) for each in reversed(down)]
        moving: list[UrdfJoint] = []
        done: list[tuple[UrdfJoint, bool, float]] = []
        for each, is_up in steps:
            if each.name in fixed and each.name in columns:
                raise InputError(f"{where}: joint {each.name} is in joints and in [robot.fixed]; leave it in one of them.")
            if each.kind != "fixed" and each.name not in fixed:
                self._require_streamed(each, columns, where)
                moving.append(each)
            done.append((each, is_up, 0.0 if each.kind == "fixed" else self._fixed_angle(each, fixed, where)))
        moving.sort(key=lambda each: columns.index(each.name))
        chain = UrdfChain(tuple(columns.index(each.name) for each in moving), tuple(moving), tuple(done), pose)
        return chain, self._sign(sensor, joint, link)

    def _fixed_angle(self, joint: UrdfJoint, fixed: Mapping[str, float], where: str) -> float:
        if joint.name in fixed and joint.kind not in MOVING:
            raise InputError(
                f"{where}: joint {joint.name} is {joint.kind}; only revolute and continuous joints between sensor and part are "
                "supported. Replace it by a fixed joint in a copy of the URDF."
            )
        return fixed.get(joint.name, 0.0)

    def _require_streamed(self, joint: UrdfJoint, columns: Sequence[str], where: str) -> None:
        if joint.kind not in MOVING or joint.mimics:
            kind = f"mimics {joint.mimics}" if joint.mimics else f"is {joint.kind}"
            raise InputError(
                f"{where}: joint {joint.name} between sensor and part {kind}; expected revolute or continuous joints. "
                "Replace it by a fixed joint in a copy of the URDF."
            )
        if joint.name not in columns:
            raise InputError(
                f"{where}: joint {joint.name} moves between sensor and part; name it in joints, at the place of its column, or "
                "give its angle in [robot.fixed]."
            )

    def _sign(self, sensor: ForceTorqueSensor, joint: UrdfJoint | None, link: str) -> int | None:
        """Compute the wrench's sign: a child that pushes on its parent passes on the force that acts on the part behind it."""
        if joint is None or not sensor.direction:
            return None
        is_behind = any(each is joint for each in self.path_to_root(link))
        return 1 if (sensor.direction == "child_to_parent") == is_behind else -1

    def mesh_for(self, link: str, sensor_joint: str = "") -> tuple[LinkMesh, FloatArray] | None:
        """Find the visual mesh of a link, or the nearest one of the links that are fixed to it on this side of the sensor.

        Returns
        -------
        The mesh and its (4, 4) pose in `link`, metres; `None` without a mesh.
        """
        for at, pose in self.fixed_frames(link, sensor_joint).items():
            if at in self.meshes:
                return self.meshes[at], pose @ self.meshes[at].origin
        return None

    def fixed_frames(self, link: str, sensor_joint: str = "") -> dict[str, FloatArray]:
        """Compute the (4, 4) poses in `link` of all frames that are fixed to it, nearest first; metres.

        The joint of the sensor is not crossed: what is behind it is not the part.
        """
        neighbours: dict[str, list[tuple[str, FloatArray]]] = {}
        for joint in self.joints.values():
            if joint.kind == "fixed" and joint.name != sensor_joint:
                neighbours.setdefault(joint.child, []).append((joint.parent, inverse_pose(joint.origin)))
                neighbours.setdefault(joint.parent, []).append((joint.child, joint.origin))
        frames, waiting = {link: np.eye(4)}, deque([link])
        while waiting:
            at = waiting.popleft()
            for other, step in neighbours.get(at, []):
                if other not in frames:
                    frames[other] = frames[at] @ step
                    waiting.append(other)
        return frames


def _sensor_frame(sensor: ForceTorqueSensor, joint: UrdfJoint | None) -> tuple[str, FloatArray]:
    """Find the link that carries the sensor's frame, and the (4, 4) pose of that frame in it.

    Gazebo (SDFormat): the moment is about the joint's origin, `parent` and `sensor` give the axes. iDynTree (`<parent joint>`):
    `parent` is the whole frame of the parent link, `sensor` that of `<origin>` in the child link.
    """
    if joint is None:
        return sensor.name, np.eye(4)
    pose = np.eye(4)
    if sensor.frame == "parent":
        if sensor.is_gazebo:
            pose[:3, 3] = joint.origin[:3, 3]
        return joint.parent, pose
    if sensor.frame == "sensor":
        pose = sensor.origin.copy()
        if sensor.is_gazebo:
            pose[:3, 3] = 0.0
    return joint.child, pose


def read_urdf(path: Path) -> Robot:
    """Read a URDF file.

    Raises InputError: the file cannot be read, is no URDF, or its links and joints form no tree.
    """
    data = read_regular(path, MAX_URDF_BYTES, what="URDF file", advice="name the robot's .urdf file")
    if b"\0" in data:
        raise InputError(f"{path}: is not UTF-8 text; save the URDF as UTF-8.")
    root = parse_xml(data, path)
    if root.tag != "robot":
        raise InputError(f"{path}: begins with <{root.tag}>; expected a URDF, which begins with <robot>.")
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        raise InputError(f"{path}: is a xacro file; make a URDF of it first: xacro {path.name} > robot.urdf.")
    links = tuple(_attribute(element, "name", path) for element in root.findall("link"))
    joints = [_read_joint(element, path) for element in root.findall("joint")]
    _require_tree(links, joints, path)
    by_name = {joint.name: joint for joint in joints}
    meshes = {
        name: mesh
        for name, element in zip(links, root.findall("link"), strict=True)
        if (mesh := _read_mesh(name, element, path)) is not None
    }
    return Robot(path, root.get("name", path.stem), links, by_name, tuple(_read_sensors(root, by_name, path)), meshes)


def parse_xml(data: bytes, path: Path) -> ElementTree.Element:
    """Parse XML without namespaces: URDFs of other programs use prefixes, such as `drake:`, that no one declares.

    Raises InputError: it is not XML, or has a document type.
    """

    def refuse_doctype(*_: object) -> None:
        raise InputError(f"{path}: has a document type (<!DOCTYPE); remove it: a URDF needs none.")

    parser, builder = expat.ParserCreate(), ElementTree.TreeBuilder()
    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise InputError(f"{path}: not an XML file ({error}); expected a URDF.") from None
    return builder.close()


def _read_joint(element: ElementTree.Element, path: Path) -> UrdfJoint:
    name, kind = _attribute(element, "name", path), _attribute(element, "type", path)
    where = f"{path}: joint {name}"
    if kind not in KINDS:
        raise InputError(f"{where}: type is {kind!r}; expected one of {', '.join(KINDS)}.")
    ends = [element.find(end) for end in ("parent", "child")]
    parent, child = ("" if end is None else end.get("link", "") for end in ends)
    if not parent or not child:
        raise InputError(f"{where}: has no parent or no child; expected a link as each.")
    axis_element = element.find("axis")
    axis = _numbers("1 0 0" if axis_element is None else axis_element.get("xyz", "1 0 0"), 3, f"{where}: axis")
    length = float(np.linalg.norm(axis))
    if kind not in ("fixed", "floating") and not 1e-6 < length < 1e6:
        raise InputError(f"{where}: axis is {axis.tolist()}; expected a direction, which is not zero.")
    limit, mimic = element.find("limit"), element.find("mimic")
    limits = None
    if kind == "revolute" and limit is not None:
        low, high = (float(_numbers(limit.get(end, "0"), 1, f"{where}: limit")[0]) for end in ("lower", "upper"))
        limits = (low, high) if low < high else None
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=parent,
        child=child,
        origin=_read_origin(element, where),
        axis=axis / length if 1e-6 < length < 1e6 else axis,
        limits=limits,
        mimics="" if mimic is None else mimic.get("joint", "?"),
    )


def _read_mesh(link: str, element: ElementTree.Element, path: Path) -> LinkMesh | None:
    visuals = element.findall("visual")
    for visual in visuals:
        mesh = visual.find("geometry/mesh")
        if mesh is None:
            continue
        where = f"{path}: link {link}"
        scale = _numbers(mesh.get("scale", "1 1 1"), 3, f"{where}: scale of the mesh")
        return LinkMesh(link, _attribute(mesh, "filename", path), _read_origin(visual, where), scale, len(visuals) - 1)
    return None


def _read_sensors(root: ElementTree.Element, joints: Mapping[str, UrdfJoint], path: Path) -> Iterator[ForceTorqueSensor]:
    """Read force/torque sensors: `<sensor><parent joint>` and Gazebo's `<gazebo reference><sensor>`; one name may have both."""
    found: dict[str, ForceTorqueSensor] = {}
    places = [("", root), *((each.get("reference", ""), each) for each in root.findall("gazebo"))]
    for reference, holder in places:
        for element in holder.findall("sensor"):
            if element.get("type") != "force_torque":
                continue
            name = _attribute(element, "name", path)
            parent = element.find("parent")
            joint = reference or ("" if parent is None else parent.get("joint", ""))
            details = element.find("force_torque")
            frame, direction = (
                "" if details is None else (details.findtext(key) or "").strip() for key in ("frame", "measure_direction")
            )
            frame = element.findtext("frame", frame).strip()
            direction = element.findtext("measure_direction", direction).strip()
            before = found.get(name)
            where = f"{path}: sensor {name}"
            has_origin = element.find("origin") is not None or element.find("pose") is not None
            origin = _read_pose_text(element, where) if element.find("origin") is None else _read_origin(element, where)
            found[name] = ForceTorqueSensor(
                name=name,
                joint=joint or ("" if before is None else before.joint) or (name if name in joints else ""),
                frame=frame or ("" if before is None else before.frame),
                direction=direction or ("" if before is None else before.direction),
                origin=origin if before is None or has_origin else before.origin,
                is_gazebo=bool(reference) and (before is None or before.is_gazebo),
            )
    for sensor in found.values():
        yield replace(sensor, frame=sensor.frame or "child")


def _require_usable(sensor: ForceTorqueSensor, joints: Mapping[str, UrdfJoint], path: Path) -> None:
    where = f"{path}: sensor {sensor.name}"
    if sensor.joint not in joints:
        raise InputError(f"{where}: is at joint {sensor.joint!r}, which is not there; expected a joint of the robot.")
    if sensor.frame not in ("child", "parent", "sensor"):
        raise InputError(f"{where}: frame is {sensor.frame!r}; expected child, parent or sensor.")
    if sensor.direction not in ("", "child_to_parent", "parent_to_child"):
        raise InputError(f"{where}: measure_direction is {sensor.direction!r}; expected child_to_parent or parent_to_child.")


def _require_tree(links: Sequence[str], joints: Sequence[UrdfJoint], path: Path) -> None:
    """Refuse links that are missing or named twice, have two parents, or go round in a circle."""
    for what, names in (("link", links), ("joint", [joint.name for joint in joints])):
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise InputError(f"{path}: two {what}s are named {twice[0]!r}; expected a name for each.")
    if len(links) > URDF_MAX_LINKS:
        raise InputError(f"{path}: has {len(links)} links; expected at most {URDF_MAX_LINKS}.")
    known, above = set(links), dict[str, UrdfJoint]()
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in known:
                raise InputError(f"{path}: joint {joint.name} names the link {end!r}, which is not there; add it.")
        if joint.child in above:
            raise InputError(
                f"{path}: link {joint.child} has two parents, by the joints {above[joint.child].name} and {joint.name}; "
                "expected a tree."
            )
        above[joint.child] = joint
    for link in links:
        at, depth = link, 0
        while at in above:
            at, depth = above[at].parent, depth + 1
            if at == link or depth > URDF_TREE_MAX_DEPTH:
                what = "is part of a circle" if at == link else f"lies below {plural(depth - 1, 'joint')}"
                raise InputError(
                    f"{path}: link {link} {what}; expected a tree of at most {URDF_TREE_MAX_DEPTH} joints in depth."
                )
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        raise InputError(f"{path}: no joint connects {roots[0]} and {roots[1]}; expected one tree: add the missing joint.")


def _attribute(element: ElementTree.Element, name: str, path: Path) -> str:
    value = element.get(name, "")
    if not value:
        raise InputError(f"{path}: a <{element.tag}> has no {name}; expected one.")
    return value


def _read_pose_text(element: ElementTree.Element, where: str) -> FloatArray:
    """Read SDFormat's `<pose>x y z roll pitch yaw</pose>` as a (4, 4) pose."""
    values = _numbers(element.findtext("pose", "0 0 0 0 0 0"), 6, f"{where}: pose")
    return _pose_of(values[:3], values[3:], where)


def _read_origin(element: ElementTree.Element, where: str) -> FloatArray:
    """Read the `<origin>` of an element as a (4, 4) pose."""
    return element_pose(element.find("origin"), f"{where}: origin")


def element_pose(element: ElementTree.Element | None, where: str) -> FloatArray:
    """Read the attributes `xyz` and `rpy` as a (4, 4) pose: roll, pitch and yaw about the fixed axes x, y and z.

    It is the identity without an element. Raises InputError: they are not three numbers each, or of no robot's size.
    """
    if element is None:
        return np.eye(4)
    xyz, rpy = (_numbers(element.get(key, "0 0 0"), 3, f"{where} {key}") for key in ("xyz", "rpy"))
    return _pose_of(xyz, rpy, where)


def _pose_of(xyz: FloatArray, rpy: FloatArray, where: str) -> FloatArray:
    pose = np.eye(4)
    pose[:3, 3] = xyz
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    pose[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    if np.abs(pose[:3, 3]).max() > URDF_MAX_LENGTH_M:
        raise InputError(f"{where} is {pose[:3, 3].tolist()}; expected metres, at most {URDF_MAX_LENGTH_M:g}.")
    return pose


def _numbers(text: str, count: int, where: str) -> FloatArray:
    try:
        values = np.array([float(word) for word in text.split()[: count + 1]])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"{where}: is {text[:60]!r}; expected {plural(count, 'finite number')}.")
    return values


def _suggest(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, 3, 0.5) or list(known[:5])
    return f"did you mean {' or '.join(near)}" if near else "it has no links"


def find_mesh(robot: Robot, mesh: LinkMesh, packages: Mapping[str, Path]) -> Path:
    """Find the file of a link's mesh: `package://NAME/...`, or a name relative to the URDF.

    A package is looked for in `packages`, next to the URDF, in the folders above it, in ROS_PACKAGE_PATH and in
    AMENT_PREFIX_PATH.

    Raises InputError: there is no such file, or its name leaves the folder.
    """
    where = f"{robot.path}: mesh of link {mesh.link}"
    scheme, separator, rest = mesh.filename.partition("://")
    name = rest if separator else mesh.filename
    if separator and scheme not in ("package", "model"):
        raise InputError(f"{where}: is {mesh.filename}; expected package://NAME/... or a file beside the URDF.")
    parts = Path(name.replace("\\", "/")).parts
    if ".." in parts or Path(name).is_absolute() or not parts:
        raise InputError(
            f"{where}: is {mesh.filename}, outside the robot's folder; copy it next to the URDF, and name it there."
        )
    if not separator:
        candidates = [robot.path.parent / name]
    else:
        package, inner = parts[0], Path(*parts[1:])
        candidates = [folder / inner for folder in _package_folders(package, robot.path, packages)]
        candidates.append(robot.path.parent / inner)
    for candidate in candidates:
        with contextlib.suppress(OSError):  # a name that is too long, a folder without rights
            if candidate.is_file():
                return candidate
    advice = "give the folder of the package in [robot.packages]" if separator else "copy it there"
    raise InputError(f"{where}: {mesh.filename} is not found; {advice}, or name a mesh in [surface].")


def _package_folders(package: str, urdf: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    if package in packages:
        yield packages[package]
    yield urdf.parent / package
    for folder in urdf.resolve().parents:
        if folder.name == package:
            yield folder
        elif (folder / package / "package.xml").is_file():
            yield folder / package
    for folder in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if folder:
            yield from (Path(folder) / package, *([Path(folder)] if Path(folder).name == package else []))
    for folder in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if folder:
            yield Path(folder) / "share" / package
