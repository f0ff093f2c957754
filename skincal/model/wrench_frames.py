"""Frames that messages name for a wrench, and the way from each into the sensor's frame of the scene.

The rule of ROS (`geometry_msgs/WrenchStamped`): force and moment have the axes of the frame `header.frame_id`, and the moment
is about its origin. The URDF of the scene says where that frame is. Places are compared, not names. The way depends on the
frame's name and the scene alone, so a replay gives the same readings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import TypeAlias

import numpy as np

from skincal.geometry import FloatArray, inverse_pose
from skincal.model.errors import InputError
from skincal.model.robot import RobotSpec
from skincal.model.tables import Table
from skincal.model.urdf import Robot
from skincal.model.urdf_chain import UrdfJoint

SAME_PLACE_MAX_SHIFT_M = 1e-6
SAME_PLACE_MAX_TURN = 1e-6
"""rad. A URDF often has seven digits of pi / 2."""
FRAMES_KEPT_MAX = 20
"""Frames of one link that are kept. A robot publishes one or two; a damaged stream could name millions."""


class FrameKind(Enum):
    """How a wrench's frame is related to the sensor's frame."""

    UNCHECKED = "unchecked"
    """The scene has no URDF."""
    SAME = "same"
    """The frame has the place of the sensor's frame."""
    RIGID = "rigid"
    """No moving joint lies between the frames."""
    MOVING = "moving"
    """Moving joints lie between the frames."""
    UNKNOWN = "unknown"
    """The URDF has no frame of this name."""


@dataclass(frozen=True, slots=True, eq=False)
class WrenchFrame:
    """A frame that the messages of a wrench name."""

    name: str
    kind: FrameKind
    sensor_from_frame: FloatArray = field(default_factory=lambda: np.eye(4))
    """(4, 4) float, metres: axes of the frame and point of its moments in the sensor's frame; the identity unless `RIGID`."""
    joints: tuple[str, ...] = ()
    """Of `MOVING`: the joints between the frames."""
    sensor: str = ""
    """Name of the scene's sensor; empty without a URDF."""
    robot: str = ""
    """File name of the URDF; empty without one."""
    taken_as: str = ""
    """Frame that the scene names in place of this one; empty if it names none."""
    about: str = ""
    """Point of the moments that the scene names; empty for the origin of the frame."""

    @property
    def is_settled(self) -> bool:
        """Whether the readings are known in the sensor's frame, or nothing contradicts that they are in it."""
        return self.kind not in (FrameKind.MOVING, FrameKind.UNKNOWN)

    @property
    def is_in_question(self) -> bool:
        """Whether pokes that fit nowhere may be due to this frame: it is not settled, or the driver may name a wrong one."""
        return not self.is_settled or (self.kind is FrameKind.RIGID and not self.taken_as)

    @property
    def turn(self) -> float:
        """Angle between the axes of the frames, rad."""
        return _angle(self.sensor_from_frame)

    @property
    def shift(self) -> float:
        """Distance, m, between the sensor and the point of the moments."""
        return float(np.linalg.norm(self.sensor_from_frame[:3, 3]))

    def to_sensor(self, wrenches: FloatArray) -> FloatArray:
        """Convert wrenches (n, 6), N and N m, into the sensor's frame. A row's result does not depend on other rows."""
        if self.kind is not FrameKind.RIGID:
            return wrenches
        turn, (x, y, z) = self.sensor_from_frame[:3, :3], self.sensor_from_frame[:3, 3]
        matrix = np.zeros((6, 6))
        matrix[:3, :3] = matrix[3:, 3:] = turn
        matrix[3:, :3] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ turn
        with np.errstate(invalid="ignore", over="ignore"):
            # Not a matrix product: its rounding may depend on the number of rows, and replays read other runs.
            total = wrenches[:, :1] * matrix[:, 0]
            for column in range(1, 6):
                total = total + wrenches[:, column, None] * matrix[:, column]
        return total


@dataclass(frozen=True, slots=True)
class WrenchPlace:
    """Frame of the wrench as the scene's `[wrench]` names it, in place of the frame that messages name."""

    frame: str = ""
    """Link, joint or sensor of the URDF; empty: the messages name it."""
    about: str = ""
    """Link, joint or sensor whose origin the moments are about; empty: that of the frame."""


FindFrame: TypeAlias = Callable[[str], WrenchFrame]


def unchecked_frame(name: str) -> WrenchFrame:
    """Describe a frame without a URDF."""
    return WrenchFrame(name, FrameKind.UNCHECKED)


def find_wrench_frame(robot: RobotSpec | None, place: WrenchPlace, name: str) -> WrenchFrame:
    """Find the frame that messages name (empty: they name none) in the scene's robot."""
    asked = place.frame or name
    if robot is None or not (asked or place.about):
        return unchecked_frame(name)
    poses = [_pose_in_sensor(robot, each) if each else np.eye(4) for each in (asked, place.about or asked)]
    joints = tuple(dict.fromkeys(joint for each in poses if isinstance(each, tuple) for joint in each))
    pose, kind = np.eye(4), FrameKind.UNKNOWN
    axes, point = poses
    if joints:
        kind = FrameKind.MOVING
    elif isinstance(axes, np.ndarray) and isinstance(point, np.ndarray):
        pose[:3, :3], pose[:3, 3] = axes[:3, :3], point[:3, 3]
        is_same = _angle(pose) <= SAME_PLACE_MAX_TURN and np.linalg.norm(pose[:3, 3]) <= SAME_PLACE_MAX_SHIFT_M
        kind = FrameKind.SAME if is_same else FrameKind.RIGID
    return WrenchFrame(name, kind, pose, joints, robot.sensor, robot.urdf.path.name, place.frame, place.about)


def read_wrench_place(table: Table | None, robot: RobotSpec | None) -> WrenchPlace:
    """Read `frame` and `about` of `[wrench]`.

    Raises InputError: the scene has no URDF, which has no such frame, or moving joints lie between it and the sensor.
    """
    if table is None:
        return WrenchPlace()
    place = WrenchPlace(table.take("frame", str, ""), table.take("about", str, ""))
    for key, name in (("frame", place.frame), ("about", place.about)):
        if not name:
            continue
        if robot is None:
            raise InputError(f"{table.where}: {key} is {name!r}, and the scene has no [robot]; expected a URDF that has it.")
        found = _pose_in_sensor(robot, name)
        if found is None:
            raise InputError(
                f"{table.where}: {key} is {name!r}, which is not in {robot.urdf.path.name}; expected a link, joint or sensor."
            )
        if isinstance(found, tuple):
            raise InputError(
                f"{table.where}: {key} is {name!r}, and {', '.join(found)} may move between it and the sensor {robot.sensor}; "
                "expected a frame that is rigid to the sensor."
            )
    return place


def _pose_in_sensor(robot: RobotSpec, name: str) -> FloatArray | tuple[str, ...] | None:
    """Find the (4, 4) pose of a frame in the sensor's frame; the joints if some move between; `None` for an unknown name."""
    urdf = robot.urdf
    found = _place_of(urdf, name)
    if found is None:
        return None
    sensor_link, link_from_sensor = urdf.sensor_frame(robot.sensor, "")
    link, link_from_frame = found
    steps = urdf.joints_between(sensor_link, link)
    moving = tuple(joint.name for joint, _ in steps if not _is_held(urdf, joint, robot.fixed))
    if moving:
        return moving
    angles, pose = urdf.complete_angles(robot.fixed), inverse_pose(link_from_sensor)
    for joint, is_up in steps:
        step = joint.transform(angles.get(joint.name, 0.0))
        pose = pose @ (inverse_pose(step) if is_up else step)
    return pose @ link_from_frame


def _is_held(urdf: Robot, joint: UrdfJoint, fixed: Mapping[str, float]) -> bool:
    """Whether a joint cannot move, or the scene gives its angle, or that of the joint that it follows."""
    seen = set[str]()
    while joint.kind != "fixed" and joint.name not in fixed:
        seen.add(joint.name)
        leader = None if joint.mimic is None else urdf.joints.get(joint.mimic.leader)
        if leader is None or leader.name in seen:
            return False
        joint = leader
    return True


def _place_of(urdf: Robot, name: str) -> tuple[str, FloatArray] | None:
    """Find the link that carries a link's, sensor's or joint's frame, and the (4, 4) pose in it."""
    if name in urdf.links:
        return name, np.eye(4)
    if any(name == sensor.name for sensor in urdf.sensors):
        try:
            return urdf.sensor_frame(name, "")
        except InputError:
            return None
    joint = urdf.joints.get(name)
    return None if joint is None else (joint.child, np.eye(4))


def rigid_points(robot: RobotSpec) -> dict[str, FloatArray]:
    """List the sensor's origin and the origins of links that are rigid to it, (3,) m in its frame; one name for each place."""
    found = {robot.sensor: np.zeros(3)}
    for link in robot.urdf.links:
        pose = _pose_in_sensor(robot, link)
        if isinstance(pose, np.ndarray):
            point = pose[:3, 3]
            if all(np.linalg.norm(point - other) > SAME_PLACE_MAX_SHIFT_M for other in found.values()):
                found[link] = point
    return found


def _angle(pose: FloatArray) -> float:
    turn = pose[:3, :3]
    # arctan2 of both: the cosine is inaccurate for small angles, the sine near half a turn.
    sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return float(np.arctan2(sine, np.trace(turn) - 1.0))


class WrenchFrames:
    """Frames of the wrenches of one link. The first frame decides which others can be used.

    Readings in another frame are used if the URDF knows the way from both frames into the sensor's. Otherwise two frames would
    be mixed in one stream, and they are left out.

    Parameters
    ----------
    find : finds a frame by its name; empty for readings without one
    """

    def __init__(self, find: FindFrame = unchecked_frame) -> None:
        self._find = find
        self._found: dict[str, WrenchFrame] = {}

    @property
    def count(self) -> int:
        """Number of the frames that came, with the one of readings without a name."""
        return len(self._found)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the frames that came, in their order."""
        return tuple(name for name in self._found if name)

    def to_sensor(self, name: str, wrenches: FloatArray) -> FloatArray | None:
        """Convert wrenches (n, 6) of the frame `name` into the sensor's frame; `None`: they are left out."""
        frame = self._found.get(name)
        if frame is None:
            if len(self._found) >= FRAMES_KEPT_MAX:
                return None
            frame = self._found[name] = self._find(name)
        first = next((each for each in self._found.values() if each.name), frame)
        if name and frame is not first and not (_is_certain(first) and _is_certain(frame)):
            return None
        return frame.to_sensor(wrenches)


def _is_certain(frame: WrenchFrame) -> bool:
    return frame.kind in (FrameKind.SAME, FrameKind.RIGID) and not frame.taken_as


def frame_in_question(frames: Sequence[WrenchFrame]) -> str:
    """Return the name of the first frame that may explain pokes that do not fit; empty without one."""
    return next((each.name for each in frames if each.is_in_question), "")
