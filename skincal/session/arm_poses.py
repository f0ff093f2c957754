"""Names of the arm's poses: chosen by the operator, streamed by the joints, or the only one that the scene has.

A streamed pose is named once, where it is first used: by the scene's pose that it is within the arm's tolerance, else by the
first used pose that it nearly is, else by its angles in degrees. Everything after that (rig fit, guide, closing check) compares
names alone.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from skincal.geometry import Arm, FloatArray
from skincal.model.scene import ArmSpec, Scene
from skincal.model.urdf_chain import UrdfChain

CurrentPose: TypeAlias = tuple[str, FloatArray | None]
"""Name of the current arm pose, empty while unknown, and its (4, 4) link_from_sensor, metres."""
SAME_POSE_COSINE, SAME_POSE_SHIFT_M = float(np.cos(np.radians(5.0))), 0.010
"""Arm poses that differ by a smaller rotation and shift of the sensor share a name. A rig's errors change little over that."""
STILL_ANGLE = float(np.radians(1.0))
"""rad. A joint that trembles by less around an unused pose does not rename it."""


class ArmPoses:
    """Name and link_from_sensor of the current arm pose."""

    def __init__(self, scene: Scene) -> None:
        self._arm, self._fixed, self._tool = scene.arm, scene.sensor_pose, scene.tool
        self._named = () if scene.robot is None else scene.robot.columns
        self._joints = np.array([] if scene.arm is None else scene.arm.arm.joints, np.int64)
        self.are_grouped = True
        """Nearly equal streamed poses share a name; in sessions of old formats each is named by its rounded angles."""
        self._chosen: dict[str, FloatArray] = {}
        # Names of the used poses, and (n, 4, 4) their link_from_sensor.
        self._used: list[str] = []
        self._sensors: FloatArray = np.empty((0, 4, 4))
        self.forget_stream()

    def forget_stream(self) -> None:
        """Forget the streamed angles: other devices follow."""
        self._angles: FloatArray | None = None
        self._range: tuple[FloatArray, FloatArray] | None = None
        """Lowest and highest streamed angles, (joints,) float each, rad."""
        self.limit_warning = ""
        """Says which streamed angle lies outside the limits of its joint, or that the unit looks wrong; empty otherwise."""
        self._streamed: tuple[str, FloatArray] | None = None
        self._anchor: tuple[str, FloatArray] = "", np.empty(0)
        """The newest name of an unused pose, and the angles that it was made from."""
        self.current: CurrentPose = ("", None)
        self._tool_pose: FloatArray | None = None

    def add_used(self, name: str, link_from_sensor: FloatArray | None) -> None:
        """Remember a pose with a poke or a skip."""
        if link_from_sensor is None or self._arm is None or name in self._arm.poses or not name or name in self._used:
            return
        self._used.append(name)
        self._sensors = np.concatenate([self._sensors, link_from_sensor[None]])

    def at(self, chosen: str, angles: FloatArray | None) -> CurrentPose:
        """Update the current pose: the chosen one, if any, else the streamed one.

        Parameters
        ----------
        angles : (joints,) float, streamed, radians; `None` if the last ones still hold
        """
        if self._tool is None:
            self.current = ("", self._fixed) if self._arm is None else self._pose_at(self._arm, chosen, angles)
        return self.current

    def at_tool(self, base_from_tool: FloatArray) -> CurrentPose:
        """Update the current pose by one of the tool, (4, 4) float, metres. The scene has a tool."""
        assert self._tool is not None
        if base_from_tool is not self._tool_pose:
            self._tool_pose = base_from_tool
            self.current = self._tool.arm_pose, self._tool.link_from_sensor(base_from_tool)
        return self.current

    def _pose_at(self, arm: ArmSpec, chosen: str, angles: FloatArray | None) -> CurrentPose:
        if angles is not None:
            width, angles = len(angles), angles.take(self._joints)
            if self._angles is None or angles.tolist() != self._angles.tolist():
                # Kept while the arm stands: kinematics cost, and the same object tells others that nothing changed.
                self._angles = angles
                self.limit_warning = "" if isinstance(arm.arm, Arm) else self._warn(arm.arm, angles, width)
                sensor = arm.arm.link_from_sensor(angles)
                self._streamed = self._name_of(arm, angles, sensor), sensor
        if not chosen and self._streamed is not None:
            return self._streamed
        name = chosen or (next(iter(arm.poses)) if len(arm.poses) == 1 else "")
        if name and name not in self._chosen:
            self._chosen[name] = arm.arm.link_from_sensor(arm.poses[name])
        return name, self._chosen.get(name)

    def _warn(self, chain: UrdfChain, angles: FloatArray, width: int) -> str:
        """Judge the streamed angles by their limits, the range of all angles so far, and the `width` of the stream."""
        lowest, highest = self._range or (angles, angles)
        self._range = np.minimum(lowest, angles), np.maximum(highest, angles)
        unnamed = self._unnamed(chain, width)
        return chain.limit_warning(angles, unnamed) or chain.unit_warning(*self._range) or (f"{unnamed}." if unnamed else "")

    def _unnamed(self, chain: UrdfChain, width: int) -> str:
        """Doubt the first columns of a wider stream; empty if the scene names others than those of the chain, or all."""
        count = len(self._named)
        if not width > count == len(chain.joints):
            return ""
        return (
            f"the stream has {width} values, and the scene names the first {count}: {', '.join(self._named)}. If other joints "
            "come before, name them, too, in joints of the scene"
        )

    def _name_of(self, arm: ArmSpec, angles: FloatArray, sensor: FloatArray) -> str:
        for name, named in arm.poses.items():
            if np.abs(named - angles).max(initial=0.0) <= arm.turn_max:
                return name
        # Adding zero makes 0 of -0, which would be another name.
        words = ", ".join(f"{angle:.0f} deg" for angle in np.degrees(angles).round() + 0.0)
        if not self.are_grouped:
            return words
        # The trace of a rotation is 1 + 2 cos of its angle.
        cosines = (np.sum(self._sensors[:, :3, :3] * sensor[:3, :3], axis=(1, 2)) - 1.0) / 2.0
        shifts = np.linalg.norm(self._sensors[:, :3, 3] - sensor[:3, 3], axis=1)
        alike = np.flatnonzero((cosines >= SAME_POSE_COSINE) & (shifts <= SAME_POSE_SHIFT_M))
        if alike.size:
            return self._used[int(alike[0])]
        name, anchor = self._anchor
        if name and name not in self._used and np.abs(anchor - angles).max(initial=0.0) <= STILL_ANGLE:
            return name
        number = 1
        while (name := words if number == 1 else f"{words} ({number})") in self._used:
            number += 1
        self._anchor = name, angles
        return name
