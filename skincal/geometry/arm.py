"""Joint angles to the pose of the sensor in the link frame.

The chain runs sensor -> base of the moving joints -> link: base_from_sensor is constant, and the link's pose in the
base is the product of Denavit-Hartenberg transforms. For the iCub's right forearm this is the authors' own
H_8S = inv(DH(j3) DH(j4)) H_6S (`ftSensor2wristTransformation`, and iKinFwd.cpp for the constants).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class DhLink:
    """One joint in the standard Denavit-Hartenberg form: lengths in metres, angles in radians."""

    a: float
    d: float
    alpha: float
    offset: float

    def transform(self, angle: float) -> FloatArray:
        """Return the (4, 4) pose of this joint's outer frame in its inner one at `angle` radians."""
        # Turn by theta and shift by d about and along z, then shift by a and turn by alpha along and about x.
        theta = angle + self.offset
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(self.alpha), np.sin(self.alpha)
        return np.array(
            [
                [ct, -st * ca, st * sa, self.a * ct],
                [st, ct * ca, -ct * sa, self.a * st],
                [0.0, sa, ca, self.d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )


def inverse_pose(pose: FloatArray) -> FloatArray:
    """Return the inverse of a rigid (4, 4) pose, from the transpose of its rotation."""
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return inverse


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """The joints between the sensor and the link.

    Parameters
    ----------
    joints : columns of the joint stream that these joints are
    chain : one `DhLink` a joint, from the base outwards
    base_from_sensor : (4, 4) float, metres
    """

    joints: tuple[int, ...]
    chain: tuple[DhLink, ...]
    base_from_sensor: FloatArray

    def link_from_sensor(self, angles: FloatArray) -> FloatArray:
        """Return the (4, 4) pose of the sensor in the link frame, p_link = T p_sensor.

        Parameters
        ----------
        angles : (len(joints),) float, radians, of these joints alone
        """
        base_from_link = np.eye(4)
        for link, angle in zip(self.chain, angles, strict=True):
            base_from_link = base_from_link @ link.transform(float(angle))
        return inverse_pose(base_from_link) @ self.base_from_sensor
