"""The arm's pose with a sample, and how far it has moved since another one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.readings import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ArmPose:
    """Pose of the arm at one sample."""

    link_from_sensor: FloatArray | None
    """(4, 4) float, metres; None while unknown."""
    name: str
    angles: FloatArray | None
    """(joints,) float, radians, of the arm's joints as streamed; None without a joint stream."""


def turned(before: ArmPose, now: ArmPose) -> float:
    """Return how far the arm turned between two samples, rad: the largest change of a joint.

    Where joints are not streamed, or another pose was chosen than the one streamed, it is the rotation of the link.
    """
    joints, change = 0, 0.0
    if before.angles is not None and now.angles is not None:
        joints, change = len(now.angles), float(np.abs(now.angles - before.angles).max(initial=0.0))
    if before.link_from_sensor is now.link_from_sensor or before.link_from_sensor is None or now.link_from_sensor is None:
        return change
    rotation = _rotation(before.link_from_sensor, now.link_from_sensor)
    # Turning joints never rotate the link by more than the sum of their changes: beyond it the pose was chosen anew.
    return rotation if rotation > joints * change + 1e-6 else change


def _rotation(first: FloatArray, second: FloatArray) -> float:
    between = first[:3, :3].T @ second[:3, :3]
    # The angle from sine and cosine together: arccos alone loses half the digits near zero.
    axis = np.array([between[2, 1] - between[1, 2], between[0, 2] - between[2, 0], between[1, 0] - between[0, 1]])
    return float(np.arctan2(np.linalg.norm(axis), np.trace(between) - 1.0))
