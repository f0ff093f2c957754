"""Frames of `/tf` and `/tf_static`, and the pose of one frame in another along the transforms between them.

A robot publishes one transform for each joint. The pose of its tool in its base is their product, at one time: the newest time
for which all moving transforms of the chain are known. Newer ones are interpolated to it, as tf2 does for the latest time. A
base need not be an ancestor of the tool: `base` of a UR robot hangs in `base_link`, as the arm does.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, field

Pose = tuple[float, ...]
"""x y z in metres, quaternion x y z w."""
MAX_AGE_DIFFERENCE_S = 1.0
"""s. A moving transform that is older than the newest one of its chain by more is no longer published."""
CLOCK_RESET_S = 0.5
"""s. If a stamp goes back by more, its sender has started again."""
SAMPLES_KEPT = 2048
"""Of each transform: at 1 kHz more than `MAX_AGE_DIFFERENCE_S`, so that the newest of a slow one is among them."""
NORM_TOLERANCE = 0.001
"""Of a quaternion: zeros mark a lost body."""
FRAMES_LISTED_MAX = 8
NO_POSE: Pose = (0.0,) * 7
"""A quaternion of zeros, which every reader of poses drops and counts."""


@dataclass(slots=True)
class Transform:
    """Pose of a child frame in its parent frame, over time."""

    parent: str
    child: str
    is_static: bool
    stamps: deque[float] = field(default_factory=lambda: deque[float](maxlen=SAMPLES_KEPT))
    """s, rising; empty if the transform has no stamps."""
    poses: deque[Pose] = field(default_factory=lambda: deque[Pose](maxlen=SAMPLES_KEPT))

    def add(self, stamp_s: float | None, pose: Pose) -> bool:
        """Add a pose. Return whether its clock went back, so that everything before is forgotten."""
        if self.is_static or stamp_s is None:
            self.stamps.clear()
            self.poses.clear()
        elif self.stamps and stamp_s <= self.stamps[-1]:
            if self.stamps[-1] - stamp_s <= CLOCK_RESET_S:
                return False
            self.stamps.clear()
            self.poses.clear()
            self.stamps.append(stamp_s)
            self.poses.append(pose)
            return True
        if stamp_s is not None and not self.is_static:
            self.stamps.append(stamp_s)
        self.poses.append(pose)
        return False

    def at(self, time_s: float) -> Pose | None:
        """Interpolate the pose at a time, s; `None` before its first stamp."""
        if not self.stamps:
            return self.poses[-1]
        behind = bisect_right(self.stamps, time_s)
        if behind == 0:
            return None
        if behind == len(self.stamps) or self.stamps[behind - 1] == time_s:
            return self.poses[behind - 1]
        begin_s, end_s = self.stamps[behind - 1], self.stamps[behind]
        return _interpolate(self.poses[behind - 1], self.poses[behind], (time_s - begin_s) / (end_s - begin_s))


class TransformTree:
    """Transforms of many frames, and the chain between two of them."""

    def __init__(self, frame: str, base: str) -> None:
        self._frame, self._base = frame, base
        self._transforms: dict[tuple[str, str], Transform] = {}
        self._chain: list[tuple[Transform, bool]] | None = []
        """From the base to the frame; True for a transform that is passed from its child to its parent. `None`: search it."""
        self._newest_s = -math.inf
        """s, time of the last pose."""
        self.problem = ""
        """Sentence on why the last message gave no pose though the chain changed; empty after a pose."""
        self.is_late = False
        """Whether a transform of the chain has stopped to come."""

    def add(self, parent: str, child: str, stamp_s: float | None, pose: Pose, *, is_static: bool) -> bool:
        """Add a transform; return whether it is one of the chain, or may complete it."""
        known = self._transforms.get((parent, child))
        if known is None or (known.is_static and not is_static):
            # As in tf2 a frame hangs in one other frame, in that of its newest transform.
            self._transforms = {pair: each for pair, each in self._transforms.items() if pair[1] != child}
            known = self._transforms[parent, child] = Transform(parent, child, is_static)
            self._chain = None
        if known.add(stamp_s, pose):
            self._newest_s = -math.inf
            for other in self._transforms.values():
                if other is not known and other.stamps and stamp_s is not None and other.stamps[-1] - stamp_s > CLOCK_RESET_S:
                    other.stamps.clear()
                    other.poses.clear()
        chain = self.chain
        return not chain or any(transform is known for transform, _ in chain)

    @property
    def chain(self) -> list[tuple[Transform, bool]]:
        """Transforms from the base to the frame; empty if none lead there."""
        if self._chain is None:
            self._chain = self._find_chain()
        return self._chain

    def _find_chain(self) -> list[tuple[Transform, bool]]:
        """Search the shortest chain, from the base on."""
        reached: dict[str, list[tuple[Transform, bool]]] = {self._base: []}
        waiting = deque([self._base])
        while waiting and self._frame not in reached:
            here = waiting.popleft()
            for transform in self._transforms.values():
                for begin, end, inverted in (
                    (transform.parent, transform.child, False),
                    (transform.child, transform.parent, True),
                ):
                    if begin == here and end not in reached:
                        reached[end] = [*reached[here], (transform, inverted)]
                        waiting.append(end)
        return reached.get(self._frame, [])

    def take_pose(self) -> tuple[float | None, Pose] | None:
        """Return time, s, and pose of the frame in the base if they are newer than the last ones taken; else `None`."""
        chain = self.chain
        if not chain:
            self.problem = self._describe_break()
            return None
        moving = [transform for transform, _ in chain if not transform.is_static]
        if any(not transform.poses for transform, _ in chain):
            return None
        stamped = [transform for transform in moving if transform.stamps]
        time_s = min((transform.stamps[-1] for transform in stamped), default=math.nan)
        newest = max((transform.stamps[-1] for transform in stamped), default=math.nan)
        if newest - time_s > MAX_AGE_DIFFERENCE_S:
            self.is_late = True
            late = min(stamped, key=lambda transform: transform.stamps[-1])
            self.problem = (
                f"The transform of {late.child} in {late.parent} is {newest - time_s:.1f} s older than others of its chain: "
                "is it still published?"
            )
            return None
        if time_s <= self._newest_s:
            return None
        poses = [transform.at(time_s) for transform, _ in chain]
        if any(pose is None for pose in poses):
            return None  # the first stamps do not overlap yet
        self.problem, self.is_late = "", False
        self._newest_s = time_s if stamped else self._newest_s
        found = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        for pose, (_, inverted) in zip(poses, chain, strict=True):
            unit = None if pose is None else _normalised(pose)
            if unit is None:
                return (time_s if stamped else None), NO_POSE
            found = _compose(found, _inverse(unit) if inverted else unit)
        return (time_s if len(stamped) == len(moving) and stamped else None), found

    def _describe_break(self) -> str:
        """Name where the chain ends, and the frames that came."""
        seen = sorted({frame for pair in self._transforms for frame in pair})
        missing = [name for name in (self._frame, self._base) if name not in seen]
        listed = ", ".join(seen[:FRAMES_LISTED_MAX]) + (
            f" and {len(seen) - FRAMES_LISTED_MAX} more" if len(seen) > FRAMES_LISTED_MAX else ""
        )
        if missing:
            return f"No transform of {' or '.join(missing)} has come; frames that came: {listed}"
        roots = [self._ancestors(name)[-1] for name in (self._frame, self._base)]
        return (
            f"No transforms lead from {self._base} to {self._frame}: {self._frame} belongs to the tree of {roots[0]}, "
            f"{self._base} to that of {roots[1]}; frames that came: {listed}"
        )

    def _ancestors(self, frame: str) -> list[str]:
        """List a frame and those that it hangs in, up to the last."""
        found = [frame]
        while True:
            parent = next((parent for parent, child in self._transforms if child == found[-1] and parent not in found), "")
            if not parent:
                return found
            found.append(parent)


def frame_pairs(transforms: set[tuple[str, str]]) -> list[tuple[str, str]]:
    """List root and leaf of each chain of two transforms or more; pairs are (parent, child)."""
    parents = {parent for parent, _ in transforms}
    children = {child for _, child in transforms}
    found: list[tuple[str, str]] = []
    for leaf in sorted(children - parents):
        way = [leaf]
        while parent := next((p for p, c in sorted(transforms) if c == way[-1] and p not in way), ""):
            way.append(parent)
        if len(way) > 2:
            found.append((way[-1], leaf))
    return found


def _normalised(pose: Pose) -> Pose | None:
    """Return the pose with a quaternion of length 1; `None` if it is not finite or no rotation."""
    norm = math.sqrt(sum(value * value for value in pose[3:]))
    if not all(map(math.isfinite, pose)) or abs(norm - 1.0) > NORM_TOLERANCE:
        return None
    return (*pose[:3], *(value / norm for value in pose[3:]))


def _turned(quaternion: Pose, place: Pose) -> Pose:
    """Rotate x y z by a unit quaternion."""
    x, y, z, w = quaternion
    a, b, c = place
    u, v, t = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return a + w * u + y * t - z * v, b + w * v + z * u - x * t, c + w * t + x * v - y * u


def _times(first: Pose, then: Pose) -> Pose:
    """Multiply quaternions x y z w."""
    x, y, z, w = first
    a, b, c, d = then
    return (
        w * a + x * d + y * c - z * b,
        w * b - x * c + y * d + z * a,
        w * c + x * b - y * a + z * d,
        w * d - x * a - y * b - z * c,
    )


def _compose(outer: Pose, inner: Pose) -> Pose:
    """Compute the pose of a frame that is `inner` in a frame that is `outer`."""
    place = _turned(outer[3:], inner[:3])
    return (*(a + b for a, b in zip(outer[:3], place, strict=True)), *_times(outer[3:], inner[3:]))


def _inverse(pose: Pose) -> Pose:
    x, y, z, w = pose[3:]
    back = (-x, -y, -z, w)
    return (*(-value for value in _turned(back, pose[:3])), *back)


def _interpolate(before: Pose, after: Pose, share: float) -> Pose:
    """Interpolate two poses: straight, and along the shorter rotation at constant speed."""
    first, second = _normalised(before), _normalised(after)
    if first is None or second is None:
        return NO_POSE
    place = (a + share * (b - a) for a, b in zip(first[:3], second[:3], strict=True))
    cosine = sum(a * b for a, b in zip(first[3:], second[3:], strict=True))
    sign = 1.0 if cosine >= 0 else -1.0
    angle = math.acos(min(1.0, abs(cosine)))
    if angle < 1e-6:
        weights = 1.0 - share, share
    else:
        weights = math.sin((1.0 - share) * angle) / math.sin(angle), math.sin(share * angle) / math.sin(angle)
    turn = (weights[0] * a + sign * weights[1] * b for a, b in zip(first[3:], second[3:], strict=True))
    return (*place, *turn)
