"""Poses of a tool in a bag: the reader of their messages, and the frames of a `/tf` that move as a tool does.

In a `/tf` the transforms of the joints of an arm turn, and keep their positions. That of a tool in its base moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain, islice
from typing import Any

import numpy as np

from skincal.files.importers.bag_reader import Bag
from skincal.files.importers.registry import RecordedPlace, StreamGuess
from skincal.geometry import FloatArray
from skincal.model.readings import Stream
from skincal.ros.messages import MessageReader
from skincal.ros.tool_poses import POSE_STAMPED, TF_MESSAGE, TRANSFORM_STAMPED, ToolPoseReader, stamped_poses
from skincal.ros.topics import TopicChoice
from skincal.ros.types import MessageError, full_type_name

POSE_TYPES = (POSE_STAMPED, TRANSFORM_STAMPED, TF_MESSAGE)
TOOL_MIN_TRAVEL_M = 0.02
"""m. A tool that pokes a part moves by more along some axis; a joint's transform keeps its position."""
POSE_NUMBERS = 7
MESSAGES_READ_FOR_FRAMES = 2000
"""First messages of a topic that are searched for frames: the transforms of an arm and of others come in turn."""


class BagPoseReader:
    """Reads the messages of one topic, as `MessageReader` does those of other streams.

    Raises InputError: the type has no poses, or the frames of a `/tf` are not chosen.
    """

    field = ""
    joints: tuple[str, ...] = ()
    silences: Mapping[str, Any] = {}
    missing_joints = ""

    def __init__(self, type_name: str, choice: TopicChoice) -> None:
        self._poses, self.type_name = ToolPoseReader(type_name, choice.frame, choice.base), type_name
        self._stamp_s: float | None = None
        self.parent = ""
        """Frame of the poses; empty before the first."""

    def values_of(self, message: Any, _arrival_s: float = 0.0) -> FloatArray | None:
        """Return x y z in metres and the quaternion x y z w, (7,) float; `None` if the message has no wanted pose."""
        found = self._poses.find_pose(message)
        self._stamp_s = None if found is None else found.stamp_s
        if found is None:
            return None
        self.parent = found.parent
        return found.values

    def stamp_of(self, _message: Any) -> float | None:
        """Return the stamp of the pose that was read last, s; `None` without one."""
        return self._stamp_s

    def frame_of(self, _message: Any) -> str:
        """Return the frame of a wrench, which a pose has not."""
        return ""


AnyReader = MessageReader | BagPoseReader


def guess_tools(bag: Bag, spread: Mapping[str, Sequence[bytes]]) -> list[StreamGuess]:
    """Guess the topics, and the frames of a `/tf`, that are poses of a tool; the one that moves most is the likeliest.

    Parameters
    ----------
    spread : by topic, messages from all parts of the bag; those of a `/tf` may all be of one sender, so the first count, too
    """
    found: list[tuple[float, StreamGuess]] = []
    for topic in bag.topics.values():
        if topic.encoding or full_type_name(topic.type_name) not in POSE_TYPES:
            continue
        places: dict[tuple[str, str], list[FloatArray]] = {}
        bag.define(topic.name)
        first = (data for _, _, data in islice(bag.messages([topic.name]), MESSAGES_READ_FOR_FRAMES))
        for data in chain(spread.get(topic.name, ()), first):
            try:
                every = stamped_poses(bag.types.decode(data, topic.type_name), topic.type_name)
            except MessageError:
                continue
            for each in every:
                places.setdefault((each.parent, each.child), []).append(each.values[:3])
        is_tree = full_type_name(topic.type_name) == TF_MESSAGE
        for (parent, child), moved in places.items():
            travel = float(np.nanmax(np.ptp(np.array(moved), axis=0))) if len(moved) > 1 else 0.0
            if is_tree and not travel >= TOOL_MIN_TRAVEL_M:
                continue
            name = str(TopicChoice((topic.name,), frame=child, base=parent)) if is_tree else topic.name
            rank = int(not travel >= TOOL_MIN_TRAVEL_M)
            found.append((-travel, StreamGuess(RecordedPlace(bag.path, name), Stream.TOOL, POSE_NUMBERS, rank=rank)))
    return [guess for _, guess in sorted(found, key=lambda each: each[0])]
