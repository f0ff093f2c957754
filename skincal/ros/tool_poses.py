"""Poses of a tool from ROS messages: `PoseStamped`, `TransformStamped`, and the frames of a `tf2_msgs/TFMessage`.

All three have metres and a quaternion x y z w, in the frame of their header. A pose names no body. A transform names the child
frame, whose pose it is. A `TFMessage` has those of many bodies, so frame and base must be chosen. They may be some transforms
apart (`TransformTree`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, cast

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.ros.messages import member_of
from skincal.ros.transform_tree import TransformTree
from skincal.ros.types import MessageError, full_type_name

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
TRANSFORM_STAMPED = "geometry_msgs/msg/TransformStamped"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
FRAMES_LISTED_MAX = 6
"""Frames that a sentence lists."""
_PLACE_AND_TURN = {POSE_STAMPED: ("position", "orientation"), TRANSFORM_STAMPED: ("translation", "rotation")}


class StampedPose(NamedTuple):
    """Pose of a child frame in its parent frame."""

    parent: str
    child: str
    """Empty if the message names none."""
    stamp_s: float | None
    """s of the sender's clock; `None` if it is 0."""
    values: FloatArray
    """(7,) float: x y z in metres, quaternion x y z w."""


class ToolPoseReader:
    """Extracts the pose of the tool from the messages of one type.

    Parameters
    ----------
    frame : child frame whose pose is wanted; empty for the only one
    base : parent frame that the poses must have; empty for that of the first one, but not for a `TFMessage`

    Raises InputError: the type has no poses, or the frames are not chosen among many.
    """

    def __init__(self, type_name: str, frame: str = "", base: str = "") -> None:
        self.type_name = full_type_name(type_name)
        self._frame, self._base = frame.removeprefix("/"), base.removeprefix("/")
        self.problem = ""
        """Sentence on the last message without the wanted pose; empty after one with it."""
        self._tree = TransformTree(self._frame, self._base) if self.type_name == TF_MESSAGE else None
        if self.type_name not in (*_PLACE_AND_TURN, TF_MESSAGE):
            raise InputError(
                f"Messages of {self.type_name} hold no pose of a tool; expected {POSE_STAMPED}, {TRANSFORM_STAMPED} or "
                f"{TF_MESSAGE}."
            )
        if self.type_name == TF_MESSAGE and not (frame and base):
            # The nearest parent is often the link before, whose transform never changes.
            raise InputError(
                "A TFMessage has poses of many frames in many others; choose frame and base, as in "
                "ros2:/tf?frame=tool0&base=base."
            )

    @property
    def is_late(self) -> bool:
        """Whether a transform between base and frame has stopped to come."""
        return self._tree is not None and self._tree.is_late

    def find_pose(self, message: Any, *, is_static: bool = False) -> StampedPose | None:
        """Return the wanted pose of a message, or `None` if it gives none.

        Parameters
        ----------
        is_static : of a `TFMessage`, whether it is of `/tf_static`, whose transforms hold for all times

        Raises
        ------
        MessageError
            The message has not the fields of its type.
        """
        found = stamped_poses(message, self.type_name)
        if self._tree is not None:
            return self._find_in_tree(self._tree, found, is_static=is_static)
        of_child = [each for each in found if self._frame in ("", each.child) or not each.child]
        wanted = [each for each in of_child if self._base in ("", each.parent)]
        if not wanted:
            self._describe(found, of_child)
            return None
        self.problem, self._base = "", wanted[-1].parent
        return wanted[-1]

    def _find_in_tree(self, tree: TransformTree, found: list[StampedPose], *, is_static: bool) -> StampedPose | None:
        direct = [each for each in found if (each.parent, each.child) == (self._base, self._frame)]
        changes = [
            tree.add(each.parent, each.child, each.stamp_s, tuple(each.values.tolist()), is_static=is_static) for each in found
        ]
        if direct and not is_static:
            self.problem = ""
            return direct[-1]
        taken = tree.take_pose() if any(changes) else None
        if taken is not None:
            self.problem = ""
            return StampedPose(self._base, self._frame, taken[0], np.array(taken[1]))
        self.problem = tree.problem
        other = next((each.parent for each in found if each.child == self._frame), "")
        if other and not any(changes):
            self.problem = f"The pose comes in the frame {other}; expected {self._base}"
        return None

    def _describe(self, found: list[StampedPose], of_child: list[StampedPose]) -> None:
        """Name the frames in place of the wanted ones; a message of other frames alone is usual on `/tf`."""
        if of_child:
            self.problem = f"The pose comes in the frame {of_child[0].parent}; expected {self._base}"
        elif not self.problem and self.type_name != TF_MESSAGE:
            self.problem = f"The pose is that of {found[0].child}; expected {self._frame}"


def static_topic(topic: str) -> str:
    """Name the topic of the transforms that hold for all times, next to one of moving ones."""
    return f"{topic}_static"


def stamped_poses(message: Any, type_name: str) -> list[StampedPose]:
    """List the poses in a message of one of the three types.

    Raises MessageError: the message has not the fields of its type.
    """
    try:
        if full_type_name(type_name) == TF_MESSAGE:
            return [_stamped_pose(each, TRANSFORM_STAMPED) for each in member_of(message, "transforms")]
        return [_stamped_pose(message, full_type_name(type_name))]
    except MessageError:
        raise
    except (AttributeError, TypeError, ValueError, LookupError, OverflowError):
        raise MessageError("a field is of another kind than in the definition of its type") from None


def _stamped_pose(message: Any, type_name: str) -> StampedPose:
    place_name, turn_name = _PLACE_AND_TURN[type_name]
    header = member_of(message, "header")
    pose = member_of(message, "pose" if type_name == POSE_STAMPED else "transform")
    place, turn = member_of(pose, place_name), member_of(pose, turn_name)
    values = [*(member_of(place, axis) for axis in "xyz"), *(member_of(turn, axis) for axis in "xyzw")]
    child = "" if type_name == POSE_STAMPED else str(member_of(message, "child_frame_id"))
    parent = str(member_of(header, "frame_id"))
    # JSON has null for NaN.
    numbers = np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    return StampedPose(_plain(parent), _plain(child), _seconds(member_of(header, "stamp")), numbers)


def _plain(frame: str) -> str:
    """Remove the slash with which ROS 1 may begin a frame."""
    return frame.strip().removeprefix("/")


def _seconds(stamp: Any) -> float | None:
    """Read a stamp of ROS 2, or of ROS 1 in JSON, seconds; `None` if it is 0."""
    if isinstance(stamp, dict):
        parts = cast("dict[str, Any]", stamp)
        seconds = float(parts.get("sec", parts.get("secs", 0))) + 1e-9 * float(parts.get("nanosec", parts.get("nsecs", 0)))
    else:
        seconds = float(stamp.sec) + 1e-9 * float(stamp.nanosec)
    return seconds if seconds > 0 and math.isfinite(seconds) else None
