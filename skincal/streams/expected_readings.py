"""What a scene says of the values in its streams: numbers of values, columns of joints, form of a tool's poses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skincal.devices.decoding import TOOL_VALUES, WRENCH_VALUES
from skincal.geometry import FloatArray, IntArray
from skincal.model.pose_form import PoseForm
from skincal.model.readings import Batch, Stream
from skincal.model.scene import Scene

TIP_WIDTH = 3


@dataclass(frozen=True)
class ExpectedReadings:
    """Values that a scene expects in the readings of each stream."""

    channels: int
    """Values of a skin frame."""
    joints: int = 0
    """Columns of the joint stream, at least."""
    joint_names: tuple[str, ...] = ()
    """Names of these columns, for formats that name their joints; empty if the scene has none."""
    used_joints: tuple[int, ...] = ()
    """Columns that must be numbers; all of them if it is empty."""
    pose_form: tuple[PoseForm, float] | None = None
    """Form of the tool's poses, and metres per unit of their lengths; `None` if the scene names none."""
    has_wrench: bool = True
    """Whether there is a force/torque sensor; without one the pose of the tool completes a skin frame."""

    @classmethod
    def of_scene(cls, scene: Scene) -> ExpectedReadings:
        """Collect what a scene says of its streams."""
        used = () if scene.arm is None else tuple(scene.arm.arm.joints)
        names = () if scene.robot is None else scene.robot.columns
        form = None if scene.tool is None else scene.tool.streamed_form
        return cls(scene.skin.frame_width, max(used, default=-1) + 1, names, used, form, scene.has_sensor)

    @property
    def widths(self) -> Mapping[Stream, int]:
        """Number of values of a reading, by stream; of joints the least number."""
        return {
            Stream.WRENCH: WRENCH_VALUES, Stream.SKIN: self.channels, Stream.JOINTS: self.joints, Stream.TIP: TIP_WIDTH,
            Stream.TOOL: TOOL_VALUES,
        }  # fmt: skip

    @cached_property
    def _used(self) -> IntArray:
        return np.array(self.used_joints, np.int64)

    def has_angles(self, values: FloatArray) -> bool:
        """Whether a reading of joints has enough columns, and numbers in those that are used."""
        if len(values) < self.joints:
            return False
        return all(map(math.isfinite, (values.take(self._used) if self.used_joints else values).tolist()))

    def count_numberless(self, batch: Batch) -> int:
        """Count the readings that are no use for want of numbers: one channel is enough for a skin."""
        finite = np.isfinite(batch.values)
        if finite.all():
            return 0
        if batch.stream is Stream.SKIN:
            return int(np.count_nonzero(~finite.any(axis=1)))
        if batch.stream is Stream.JOINTS and self.used_joints and batch.values.shape[1] >= self.joints:
            finite = finite[:, self._used]
        return int(np.count_nonzero(~finite.all(axis=1)))
