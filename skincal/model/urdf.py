"""A robot's URDF: its links and joints, the chain between two links, meshes of links.

The file comes from strangers: a document type is refused (entities), so are cycles and links with two parents.

Source: the URDF's XML reference (wiki.ros.org/urdf/XML).
"""

from __future__ import annotations

import contextlib
import difflib
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from skincal.geometry import FloatArray, inverse_pose
from skincal.model.errors import InputError, plural
from skincal.model.given import read_regular
from skincal.model.urdf_chain import JOINT_KINDS, TURNING_JOINT_KINDS, ChainStep, Mimic, UrdfChain, UrdfJoint
from skincal.model.urdf_sensors import ForceTorqueSensor, read_sensors
from skincal.model.urdf_xml import parse_xml, read_attribute, read_numbers, read_origin

MAX_URDF_BYTES = 16 << 20
"""The official URDF of a whole iCub has 0.2 MB."""
URDF_TREE_MAX_DEPTH = 200
"""Joints between the root and a link. The longest chain of a humanoid has 40."""
URDF_MAX_LINKS = 5000
"""A humanoid with all its frames has 250."""
FIXED_MIMIC_MAX_DIFFERENCE_DEG = 0.5
"""Between the given angle of a mimic joint and the one that follows from its leader: angles are typed in whole degrees."""
SHAPES_OF_A_URDF = ("mesh", "box", "cylinder", "sphere", "capsule")


@dataclass(frozen=True, slots=True, eq=False)
class LinkMesh:
    """The first visual or collision mesh of a link."""

    link: str
    filename: str
    origin: FloatArray
    """(4, 4) float, metres: pose of the mesh in the link."""
    scales: FloatArray
    """(3,) float: metres per unit of the file, along each axis; negative ones mirror."""
    others: int = 0
    """Further visual shapes of the link, which are not used."""

    @property
    def is_uniform(self) -> bool:
        """One positive scale holds for all axes."""
        return bool((self.scales > 0).all() and np.allclose(self.scales, self.scales[0], rtol=1e-9))

    def scale_and_pose(self, pose: FloatArray, where: str) -> tuple[float, FloatArray]:
        """Split the scales into metres per unit, and a (4, 4) pose in the link that also stretches and mirrors.

        `pose` is the (4, 4) pose of the mesh in the part's link. Raises InputError: an axis is scaled by 0.
        """
        if not self.scales.all():
            raise InputError(
                f"{where}: the mesh of link {self.link} is scaled by {self.scales.tolist()}; expected numbers that are not 0: "
                "correct the scale in a copy of the URDF, or name another mesh (--mesh)."
            )
        scale = abs(float(self.scales[0]))
        if self.is_uniform:
            return scale, pose
        stretched = pose.copy()
        stretched[:3, :3] = pose[:3, :3] * (self.scales / scale)
        return scale, stretched


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
    """First visual mesh, by link."""
    collisions: Mapping[str, LinkMesh]
    """First collision mesh, by link."""
    shapes: Mapping[str, tuple[str, ...]]
    """Words for all shapes of a link, such as `visual cylinder`, by link; links without one are missing."""

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
                sensor.require_usable(self.joints, self.path)
                return sensor
        if name in self.joints:
            return ForceTorqueSensor(name, name, "child", "", np.eye(4))
        if name in self.links:
            above = self.joint_above(name)
            return ForceTorqueSensor(name, "" if above is None else above.name, "child", "", np.eye(4), is_link=True)
        known = [sensor.name for sensor in self.sensors]
        advice = f"it has the sensors {', '.join(known)}" if known else "name a joint or a link at the sensor"
        raise InputError(f"{where}: {self.path.name} has no force/torque sensor, joint or link {name!r}; {advice}.")

    def sensor_frame(self, name: str, where: str) -> tuple[str, FloatArray]:
        """Find the link that carries a sensor's frame, and the (4, 4) pose of that frame in it; `name` as in `sensor_named`."""
        sensor = self.sensor_named(name, where)
        return sensor.place_frame(self.joints.get(sensor.joint))

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
        at, pose = sensor.place_frame(joint)
        steps = tuple(
            self._find_driver(each, is_up, columns, fixed, where) for each, is_up in self.joints_between(link, at)
        )  # fmt: skip
        drivers = dict.fromkeys(step.driver for step in steps if step.driver)
        moving = sorted((name for name in drivers if name not in fixed), key=columns.index)
        chain = UrdfChain(
            joints=tuple(columns.index(name) for name in moving),
            moving=tuple(self.joints[name] for name in moving),
            steps=steps,
            fixed={name: fixed[name] for name in drivers if name in fixed},
            sensor=pose,
        )
        return chain, self._sign(sensor, joint, link)

    def joints_between(self, link: str, other: str) -> list[tuple[UrdfJoint, bool]]:
        """List the joints from a link to another one, and whether each step goes up to the parent."""
        up, down = self.path_to_root(link), self.path_to_root(other)
        while up and down and up[-1] is down[-1]:
            up.pop()
            down.pop()
        return [(each, True) for each in up] + [(each, False) for each in reversed(down)]

    def pose_between(self, link: str, other: str) -> FloatArray | None:
        """Compute the (4, 4) pose of another link in a link while all joints are at 0; `None` if a name is no link."""
        if link not in self.links or other not in self.links:
            return None
        pose = np.eye(4)
        for joint, is_up in self.joints_between(link, other):
            pose = pose @ (inverse_pose(joint.origin) if is_up else joint.origin)
        return pose

    def _find_driver(
        self, joint: UrdfJoint, is_up: bool, columns: Sequence[str], fixed: Mapping[str, float], where: str
    ) -> ChainStep:
        """Find the joint that drives a joint of the chain: itself, or the streamed or fixed leader that it follows."""
        if joint.kind == "fixed":
            return ChainStep(joint, is_up, "")
        followed = self._follow_mimics(joint, columns, where)
        leader, multiplier, offset = followed[-1]
        for given, own_multiplier, own_offset in followed[:-1]:
            if given.name in fixed:
                self._check_fixed_mimic(given, columns, fixed, where)
                leader, multiplier, offset = given, own_multiplier, own_offset
                break
        if leader.kind == "fixed":
            return ChainStep(joint, is_up, "", 0.0, offset)
        self._require_angle(leader, joint, columns, fixed, where)
        if joint.kind not in TURNING_JOINT_KINDS:
            self._refuse_kind(joint, "", where)
        return ChainStep(joint, is_up, leader.name, multiplier, offset)

    def _follow_mimics(self, joint: UrdfJoint, columns: Sequence[str], where: str) -> list[tuple[UrdfJoint, float, float]]:
        """Follow the rules of mimic joints up to a joint that is streamed, or moves on its own.

        A mimic joint with a column of its own is read from there, as `robot_state_publisher` does.

        Returns
        -------
        Each joint on the way, with multiplier and offset (rad): the angle of `joint` is multiplier x its angle + offset.
        """
        followed = [(joint, 1.0, 0.0)]
        while (rule := followed[-1][0].mimic) is not None:
            at, multiplier, offset = followed[-1]
            if at.kind == "fixed" or at.name in columns:
                break
            names = [each.name for each, _, _ in followed]
            if rule.leader in names:
                raise InputError(
                    f"{where}: the joints {', '.join(names)} mimic one another in a circle; correct <mimic> in a copy of the "
                    "URDF: one of them moves on its own."
                )
            if rule.leader not in self.joints:
                raise InputError(
                    f"{where}: joint {at.name} mimics the joint {rule.leader!r}, which is not there; "
                    f"{_suggest(rule.leader, tuple(self.joints))}: correct <mimic> in a copy of the URDF."
                )
            followed.append((self.joints[rule.leader], multiplier * rule.multiplier, multiplier * rule.offset + offset))
        return followed

    def _check_fixed_mimic(self, joint: UrdfJoint, columns: Sequence[str], fixed: Mapping[str, float], where: str) -> None:
        """Refuse an angle of a mimic joint that its leader contradicts, by its stream or by its given angle."""
        leader, multiplier, offset = self._follow_mimics(joint, columns, where)[-1]
        rule, advice = f"joint {joint.name} follows {leader.name}", f"leave {joint.name} out of [robot.fixed] (--fixed)"
        if leader.name in columns:
            raise InputError(f"{where}: {rule}, which is streamed; {advice}.")
        if leader.name in fixed or leader.kind == "fixed":
            follows = np.degrees(multiplier * fixed.get(leader.name, 0.0) + offset)
            given = np.degrees(fixed[joint.name])
            if abs(follows - given) > FIXED_MIMIC_MAX_DIFFERENCE_DEG:
                raise InputError(f"{where}: {rule}, so it is at {follows:.4g} degrees and not at {given:.4g}; {advice}.")

    def _require_angle(
        self, leader: UrdfJoint, joint: UrdfJoint, columns: Sequence[str], fixed: Mapping[str, float], where: str
    ) -> None:
        """Refuse a driver without an angle: it is neither streamed nor fixed, or both, or does not turn."""
        name = leader.name
        if leader.kind not in TURNING_JOINT_KINDS:
            self._refuse_kind(joint, "" if leader is joint else f"follows {name}, which ", where, leader.kind)
        if name in fixed and name in columns:
            raise InputError(f"{where}: joint {name} is in joints and in [robot.fixed]; leave it in one of them.")
        if name not in fixed and name not in columns:
            why = "moves" if leader is joint else f"follows {name}, and lies"
            raise InputError(
                f"{where}: joint {joint.name} {why} between sensor and part; name {name} in joints (--joints), at the place of "
                f"its column, or give its angle in [robot.fixed] (--fixed {name}=DEGREES)."
            )

    def _refuse_kind(self, joint: UrdfJoint, follows: str, where: str, kind: str = "") -> None:
        raise InputError(
            f"{where}: joint {joint.name} between sensor and part {follows}is {kind or joint.kind}; expected revolute or "
            "continuous joints. Only if it stands still in the whole calibration: make it a fixed joint in a copy of the URDF, "
            "with its origin where it stands."
        )

    def feels(self, sensor: ForceTorqueSensor, link: str) -> bool:
        """Whether a push on a link loads the sensor: it is between the link and the robot's base.

        A sensor at the root is below everything. A frame with nothing behind it, such as `ft_frame`, counts as its body:
        what is rigid to it, and what the body carries, is felt.
        """
        joint, path = self.joints.get(sensor.joint), self.path_to_root(link)
        if joint is None or any(each is joint for each in path):
            return True
        if not self._is_frame(joint.child, sensor.is_link):
            return False
        body = self.fixed_frames(joint.child)
        return link in body or any(each.parent in body for each in path)

    def _is_frame(self, link: str, may_have_shapes: bool) -> bool:
        """Whether no joint moves below a link; and no link has a shape there, unless it `may_have_shapes`."""
        waiting = [link]
        while waiting:
            at = waiting.pop()
            if not may_have_shapes and at in self.shapes:
                return False
            below = [joint for joint in self.joints.values() if joint.parent == at]
            if any(joint.kind != "fixed" for joint in below):
                return False
            waiting += [joint.child for joint in below]
        return True

    def _sign(self, sensor: ForceTorqueSensor, joint: UrdfJoint | None, link: str) -> int | None:
        """Compute the wrench's sign: a child that pushes on its parent passes on the force that acts on the part behind it."""
        if joint is None or not sensor.direction:
            return None
        return 1 if (sensor.direction == "child_to_parent") == self.feels(sensor, link) else -1

    def complete_angles(self, angles: Mapping[str, float]) -> dict[str, float]:
        """Add the angles of mimic joints to those of other joints, radians; a joint without an angle is at 0."""
        whole = dict(angles)
        for joint in self.joints.values():
            if joint.mimic is not None and joint.name not in angles:
                try:
                    leader, multiplier, offset = self._follow_mimics(joint, tuple(angles), "")[-1]
                except InputError:  # a circle, or no such leader: the chain is refused where it is needed
                    continue
                whole[joint.name] = multiplier * angles.get(leader.name, 0.0) + offset
        return whole

    def mesh_for(self, link: str, sensor_joint: str = "", *, is_collision: bool = False) -> tuple[LinkMesh, FloatArray] | None:
        """Find the visual mesh of a link, or the nearest one of the links that are fixed to it on this side of the sensor.

        With `is_collision` it is the collision mesh.

        Returns
        -------
        The mesh and its (4, 4) pose in `link`, metres; `None` without a mesh.
        """
        for at, pose in self.fixed_frames(link, sensor_joint).items():
            mesh = (self.collisions if is_collision else self.meshes).get(at)
            if mesh is not None:
                return mesh, pose @ mesh.origin
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
    elements = root.findall("link")
    links = tuple(read_attribute(element, "name", path) for element in elements)
    joints = [_read_joint(element, path) for element in root.findall("joint")]
    _require_tree(links, joints, path)
    by_name = {joint.name: joint for joint in joints}
    of_link = dict(zip(links, elements, strict=True))
    meshes = {name: mesh for name, each in of_link.items() if (mesh := _read_mesh(name, each, "visual", path)) is not None}
    collisions = dict(_read_collisions(of_link, path))
    shapes = {name: words for name, each in of_link.items() if (words := tuple(_list_shapes(each)))}
    robot = Robot(path, root.get("name", path.stem), links, by_name, (), meshes, collisions, shapes)
    return replace(robot, sensors=tuple(read_sensors(root, by_name, robot.pose_between, path)))


def _read_joint(element: ElementTree.Element, path: Path) -> UrdfJoint:
    name, kind = read_attribute(element, "name", path), read_attribute(element, "type", path)
    where = f"{path}: joint {name}"
    if kind not in JOINT_KINDS:
        raise InputError(f"{where}: type is {kind!r}; expected one of {', '.join(JOINT_KINDS)}.")
    ends = [element.find(end) for end in ("parent", "child")]
    parent, child = ("" if end is None else end.get("link", "") for end in ends)
    if not parent or not child:
        raise InputError(f"{where}: has no parent or no child; expected a link as each.")
    axis_element = element.find("axis")
    axis = read_numbers("1 0 0" if axis_element is None else axis_element.get("xyz", "1 0 0"), 3, f"{where}: axis")
    length = float(np.linalg.norm(axis))
    if kind not in ("fixed", "floating") and not 1e-6 < length < 1e6:
        raise InputError(f"{where}: axis is {axis.tolist()}; expected a direction, which is not zero.")
    limit, mimic = element.find("limit"), element.find("mimic")
    limits = None
    if kind == "revolute" and limit is not None:
        low, high = (float(read_numbers(limit.get(end, "0"), 1, f"{where}: limit")[0]) for end in ("lower", "upper"))
        limits = (low, high) if low < high else None
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=parent,
        child=child,
        origin=read_origin(element, where),
        axis=axis / length if 1e-6 < length < 1e6 else axis,
        limits=limits,
        mimic=None if mimic is None else _read_mimic(mimic, where),
    )


def _read_mimic(element: ElementTree.Element, where: str) -> Mimic:
    multiplier, offset = (
        float(read_numbers(element.get(key, default), 1, f"{where}: {key} of <mimic>")[0])
        for key, default in (("multiplier", "1"), ("offset", "0"))
    )
    return Mimic(element.get("joint", ""), multiplier, offset)


def _read_mesh(link: str, element: ElementTree.Element, kind: str, path: Path) -> LinkMesh | None:
    """Read the first mesh of a link, of the `kind` visual or collision; `None` without one."""
    shapes = element.findall(kind)
    for shape in shapes:
        mesh = shape.find("geometry/mesh")
        if mesh is None:
            continue
        where = f"{path}: link {link}"
        scale = read_numbers(mesh.get("scale", "1 1 1"), 3, f"{where}: scale of the mesh")
        filename = read_attribute(mesh, "filename", path).strip()
        return LinkMesh(link, filename, read_origin(shape, where), scale, len(shapes) - 1)
    return None


def _read_collisions(of_link: Mapping[str, ElementTree.Element], path: Path) -> Iterator[tuple[str, LinkMesh]]:
    """Read the collision meshes, by link. They are only offered in place of visual ones, so a bad one is left out."""
    for link, element in of_link.items():
        with contextlib.suppress(InputError):
            mesh = _read_mesh(link, element, "collision", path)
            if mesh is not None:
                yield link, mesh


def _list_shapes(link: ElementTree.Element) -> Iterator[str]:
    """Describe the shapes of a link, such as `visual cylinder`."""
    for kind in ("visual", "collision"):
        for geometry in link.findall(f"{kind}/geometry"):
            for shape in geometry:
                if shape.tag in SHAPES_OF_A_URDF:
                    name = Path(shape.get("filename", "").replace("\\", "/")).name
                    yield f"{kind} {shape.tag} {name}".rstrip()


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


def _suggest(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, 3, 0.5) or list(known[:5])
    return f"did you mean {' or '.join(near)}" if near else "it has no links"
