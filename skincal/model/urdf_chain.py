"""The chain of joints between a part and its sensor in a URDF robot: poses from streamed angles, and checks of the angles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from skincal.geometry import FloatArray, inverse_pose

TURNING_JOINT_KINDS = ("revolute", "continuous")
"""Kinds of joints whose angle is streamed."""
JOINT_KINDS = (*TURNING_JOINT_KINDS, "fixed", "prismatic", "floating", "planar")
LIMIT_SLACK = float(np.radians(3.0))
"""Tolerance of the joint limits, rad: encoders have offsets."""
UNLIMITED_JOINT_MAX_TURNS = 3
"""Expected turns of a joint without limits, either way: cables wind up."""
RADIANS_CHECK_MIN_JOINT_RANGE_RAD = 1.0
"""rad, smallest range of a joint that is called moving: 1 degree if the stream is right, 57 degrees if it is in radians."""


@dataclass(frozen=True, slots=True)
class Mimic:
    """Rule of a joint that follows another one: angle = multiplier x angle of the leader + offset."""

    leader: str
    multiplier: float = 1.0
    offset: float = 0.0
    """rad."""


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
    mimic: Mimic | None = None
    """Rule of a mimic joint; `None` for an independent one."""

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
class ChainStep:
    """A joint of a chain, and the joint that drives it."""

    joint: UrdfJoint
    is_up: bool
    """The step goes from the child to the parent."""
    driver: str
    """Joint whose angle is streamed or given: this one, or the leader of a mimic joint; empty if it does not move."""
    multiplier: float = 1.0
    offset: float = 0.0
    """rad."""

    def angle(self, drivers: Mapping[str, float]) -> float:
        """Compute the joint's angle from those of the drivers, radians."""
        return self.multiplier * drivers[self.driver] + self.offset if self.driver else self.offset

    @property
    def follows(self) -> str:
        """The leader of a mimic joint; empty for another joint."""
        return "" if self.driver == self.joint.name else self.driver


@dataclass(frozen=True, slots=True, eq=False)
class UrdfChain:
    """The joints between sensor and part of a URDF robot, in place of an `Arm`."""

    joints: tuple[int, ...]
    """Columns of the joint stream, one for each moving joint."""
    moving: tuple[UrdfJoint, ...]
    """The joints of these columns. A mimic joint follows its leader, which may lie elsewhere."""
    steps: tuple[ChainStep, ...]
    """From the part's link to the sensor's."""
    fixed: Mapping[str, float]
    """rad, angles of the drivers that are not streamed."""
    sensor: FloatArray
    """(4, 4) float, metres: pose of the sensor in the last link."""

    def link_from_sensor(self, angles: FloatArray) -> FloatArray:
        """Compute the (4, 4) pose of the sensor in the link frame, p_link = T p_sensor.

        Parameters
        ----------
        angles : (len(joints),) float, radians, of the moving joints in the order of `joints`
        """
        streamed = {joint.name: float(angle) for joint, angle in zip(self.moving, angles, strict=True)}
        drivers, pose = {**self.fixed, **streamed}, np.eye(4)
        for step in self.steps:
            turn = step.joint.transform(step.angle(drivers))
            pose = pose @ (inverse_pose(turn) if step.is_up else turn)
        return pose @ self.sensor

    def middle_angles(self) -> FloatArray:
        """Compute the (len(joints),) angles in the middle of the limits, radians; 0 for a joint without limits."""
        return np.array([0.0 if joint.limits is None else sum(joint.limits) / 2.0 for joint in self.moving])

    def limit_warning(self, angles: FloatArray, unnamed: str = "") -> str | None:
        """Describe the first angle (rad) outside its joint's limits, with the likely mistake; `None` if all lie inside.

        Parameters
        ----------
        unnamed : advice on columns that the scene does not name; empty without such
        """
        for joint, angle, column in zip(self.moving, np.asarray(angles, dtype=float), self.joints, strict=True):
            if _fits(joint, angle):
                continue
            low, high = np.degrees(_limits(joint))
            advice = self._limit_advice(np.asarray(angles, dtype=float), unnamed)
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

    def _limit_advice(self, angles: FloatArray, unnamed: str) -> str:
        """Name a mistake that would explain angles (rad) outside the limits."""
        if self._fit(np.degrees(angles)):
            return "if the stream is in radians, convert it to degrees (the values fit as radians)"
        if np.abs(angles).max() > 2.0 * np.pi and self._fit(np.radians(angles)):
            return "if the values are in degrees, do not read them as radians (they fit as degrees)"
        if unnamed:
            return unnamed
        for one, other in combinations(range(len(angles)), 2):
            swapped = angles.copy()
            swapped[[one, other]] = angles[[other, one]]
            if self._fit(swapped):
                names = f"{self.moving[one].name} and {self.moving[other].name}"
                return f"the values fit if {names} are exchanged: check the order of the joints"
        return "check the order of the joints and their unit"

    def _fit(self, angles: FloatArray) -> bool:
        return all(_fits(joint, angle) for joint, angle in zip(self.moving, angles.tolist(), strict=True))


def _limits(joint: UrdfJoint) -> tuple[float, float]:
    return joint.limits or (-2.0 * np.pi * UNLIMITED_JOINT_MAX_TURNS, 2.0 * np.pi * UNLIMITED_JOINT_MAX_TURNS)


def _fits(joint: UrdfJoint, angle: float) -> bool:
    low, high = _limits(joint)
    return low - LIMIT_SLACK <= angle <= high + LIMIT_SLACK
