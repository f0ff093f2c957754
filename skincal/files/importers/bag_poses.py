"""Poses of a tool in a bag: the reader of their messages, and the frames of a `/tf` that move as a tool does.

In a `/tf` the transforms of the joints of an arm turn, and keep their positions. That of a tool in its base moves, be it one
transform or the product of a chain.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import Any

import numpy as np

from skincal.files.importers.bag_reader import Bag
from skincal.files.importers.registry import RecordedPlace, StreamGuess
from skincal.geometry import FloatArray
from skincal.model.readings import Stream
from skincal.ros.messages import MessageReader
from skincal.ros.tool_poses import (
    POSE_STAMPED,
    TF_MESSAGE,
    TRANSFORM_STAMPED,
    StampedPose,
    ToolPoseReader,
    stamped_poses,
    static_topic,
)
from skincal.ros.topics import TopicChoice
from skincal.ros.transform_tree import TransformTree, frame_pairs
from skincal.ros.types import MessageError, full_type_name

POSE_TYPES = (POSE_STAMPED, TRANSFORM_STAMPED, TF_MESSAGE)
TOOL_MIN_TRAVEL_M = 0.02
"""m. A tool that pokes a part moves by more along some axis; a joint's transform keeps its position."""
POSE_NUMBERS = 7
BASE_MAX_CHANGE = 1e-4
"""m, and of a quaternion. A frame whose transform changes by more is no base."""
CHAINS_TRIED_MAX = 8
"""Chains that are multiplied to see whether they move: a hand has many fingers."""
TOOL_FRAME_RE = re.compile(r"tool0|tcp|flange|ee_link|end_effector|gripper|probe")
"""Frames of usual robot descriptions that a tool has."""
MESSAGES_READ_FOR_FRAMES = 2000
"""First messages of a topic that are searched for frames: the transforms of an arm and of others come in turn."""


class BagPoseReader:
    """Reads the messages of one topic, as `MessageReader` does those of other streams.

    Raises InputError: the type has no poses, or the frames of a `/tf` are not chosen.
    """

    field = ""
    joints: tuple[str, ...] = ()
    silences: Mapping[str, Any] = {}

    def __init__(self, type_name: str, choice: TopicChoice) -> None:
        self._poses, self.type_name = ToolPoseReader(type_name, choice.frame, choice.base), type_name
        self._stamp_s: float | None = None
        self.parent = ""
        """Frame of the poses; empty before the first."""
        self.left_out = 0
        """Messages behind the first pose that changed the chain of transforms and gave no pose."""

    @property
    def missing_joints(self) -> str:
        """Sentence on why the last message gave no pose; empty if it gave one."""
        return self._poses.problem

    def add_static(self, message: Any) -> None:
        """Add the transforms of a message of `/tf_static`. Raises MessageError."""
        self._poses.find_pose(message, is_static=True)

    def values_of(self, message: Any, _arrival_s: float = 0.0) -> FloatArray | None:
        """Return x y z in metres and the quaternion x y z w, (7,) float; `None` if the message has no wanted pose."""
        found = self._poses.find_pose(message)
        self._stamp_s = None if found is None else found.stamp_s
        if found is None:
            self.left_out += bool(self.parent and self._poses.problem)
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
    found: list[tuple[tuple[object, ...], StreamGuess]] = []
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
                places.setdefault((each.parent, each.child), []).append(each.values)
        is_tree = full_type_name(topic.type_name) == TF_MESSAGE
        for (parent, child), moved in places.items():
            travel = _largest_change(moved, 3)
            if is_tree and (not travel >= TOOL_MIN_TRAVEL_M or _is_carried(parent, places)):
                continue
            name = str(TopicChoice((topic.name,), frame=child, base=parent)) if is_tree else topic.name
            rank = int(not travel >= TOOL_MIN_TRAVEL_M)
            guess = StreamGuess(RecordedPlace(bag.path, name), Stream.TOOL, POSE_NUMBERS, rank=rank)
            found.append(((False, False, -travel), guess))
        if is_tree:
            found += _chain_guesses(bag, topic.name)
    return [guess for _, guess in sorted(found, key=lambda each: each[0])]


def _chain_guesses(bag: Bag, topic: str) -> list[tuple[tuple[object, ...], StreamGuess]]:
    """Guess the frames that move along a chain of transforms, in the root of their tree; frames with a tool's name come first.

    Each comes with its place in the order: behind single transforms that move.
    """
    static, moving = (list(_read_transforms(bag, name)) for name in (static_topic(topic), topic))
    transforms = {(each.parent, each.child) for message in (*static, *moving) for each in message}
    found: list[tuple[tuple[object, ...], StreamGuess]] = []
    pairs = sorted(frame_pairs(transforms), key=lambda pair: TOOL_FRAME_RE.search(pair[1]) is None)
    for root, leaf in pairs[:CHAINS_TRIED_MAX]:
        tree, places = TransformTree(leaf, root), list[FloatArray]()
        for is_static, messages in ((True, static), (False, moving)):
            for message in messages:
                for each in message:
                    tree.add(each.parent, each.child, each.stamp_s, tuple(each.values.tolist()), is_static=is_static)
                taken = None if is_static else tree.take_pose()
                places += [] if taken is None else [np.array(taken[1])]
        travel = _largest_change(places, 3)
        if travel >= TOOL_MIN_TRAVEL_M:
            name = str(TopicChoice((topic,), frame=leaf, base=root))
            order = (True, TOOL_FRAME_RE.search(leaf) is None, -travel)
            found.append((order, StreamGuess(RecordedPlace(bag.path, name), Stream.TOOL, POSE_NUMBERS)))
    return found


def _largest_change(poses: Sequence[FloatArray], numbers: int) -> float:
    """Return the largest span of the first numbers of some poses, (7,) each: 3 for the positions, m."""
    return float(np.nanmax(np.ptp(np.array(poses)[:, :numbers], axis=0))) if len(poses) > 1 else 0.0


def _is_carried(frame: str, poses: Mapping[tuple[str, str], Sequence[FloatArray]]) -> bool:
    """Whether a frame moves in one that it hangs in, so that it is no base; poses by parent and child."""
    above, seen = [frame], set[str]()
    while above:
        here = above.pop()
        seen.add(here)
        for (parent, child), found in poses.items():
            if child == here and _largest_change(found, POSE_NUMBERS) > BASE_MAX_CHANGE:
                return True
            above += [parent] if child == here and parent not in seen else []
    return False


def _read_transforms(bag: Bag, topic: str) -> Iterator[list[StampedPose]]:
    """Yield the transforms of the first messages of a topic, if it has such."""
    known = bag.topics.get(topic)
    if known is None or known.encoding or full_type_name(known.type_name) != TF_MESSAGE:
        return
    bag.define(topic)
    for _, _, data in islice(bag.messages([topic]), MESSAGES_READ_FOR_FRAMES):
        with contextlib.suppress(MessageError):
            yield stamped_poses(bag.types.decode(data, known.type_name), known.type_name)
