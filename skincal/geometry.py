"""Vectors, wrenches and arm kinematics.

Wrenches: Del Prete et al., "Skin spatial calibration using force/torque measurements", IROS 2011. A pure force f at c makes the
wrench (f, m = c x f) (eqs. 1-2). So f . m = 0 (eq. 3), and c lies on the force axis r = (f x m)/|f|^2 + lambda f.

Arm: the chain runs sensor -> base of the moving joints -> link. base_from_sensor is constant, and the link's pose in the base
is the product of Denavit-Hartenberg transforms. For the iCub's right forearm this is the authors' own H_8S = inv(DH(j3) DH(j4))
H_6S (`ftSensor2wristTransformation`, and iKinFwd.cpp for the constants).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import permutations, product
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
GIMBAL_MAX_COSINE = 1e-9
"""Cosine of the pitch below which roll and yaw are one turn."""
IDENTITY_ROTATION: FloatArray = np.eye(3)
"""(3, 3), read only: `np.eye` takes as long as a product of matrices."""
IDENTITY_ROTATION.setflags(write=False)

Columns = TypeVar("Columns")
"""A dataclass whose fields are arrays with one row for each of the same things."""


def select_rows(columns: Columns, rows: int | slice | Sequence[int] | NDArray[Any]) -> Columns:
    """Select rows of all arrays of a dataclass; an index gives one row, without the first axis."""
    arrays: Any = columns
    return type(columns)(*(getattr(arrays, each.name)[rows] for each in fields(arrays)))


def cross_matrix(v: FloatArray) -> FloatArray:
    """Make S(v) (..., 3, 3), the matrix with S(v) p = v x p, of `v` (..., 3)."""
    s = np.zeros((*v.shape[:-1], 3, 3))
    s[..., 0, 1], s[..., 0, 2] = -v[..., 2], v[..., 1]
    s[..., 1, 0], s[..., 1, 2] = v[..., 2], -v[..., 0]
    s[..., 2, 0], s[..., 2, 1] = -v[..., 1], v[..., 0]
    return s


def crossed(a: FloatArray, b: FloatArray) -> FloatArray:
    """Compute a x b of vectors (..., 3): the sums of `np.cross`, in half its time."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        product[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return product


def dots(a: FloatArray, b: FloatArray) -> FloatArray:
    """Compute the dot products (...) of vectors (..., k), k small: each row by itself, unlike `np.einsum`."""
    total = a[..., 0] * b[..., 0]
    for k in range(1, a.shape[-1]):
        total += a[..., k] * b[..., k]
    return total


def mean_rows(values: FloatArray) -> FloatArray:
    """Compute the mean of n rows, (n, ...) float: that of `np.mean` to the last bit, in half its time for few rows."""
    return np.add.reduce(values) / len(values)


def length_of(vector: FloatArray) -> float:
    """Compute the length of a vector (k,): that of `np.linalg.norm` to the last bit, in a third of its time."""
    return math.sqrt(vector.dot(vector))


def rotations(vectors: FloatArray) -> FloatArray:
    """Make the rotations (n, 3, 3) about `vectors` (n, 3) by their lengths, radians (Rodrigues)."""
    angles = np.sqrt(np.add.reduce(vectors * vectors, axis=1))[:, None, None]
    s = cross_matrix(vectors)
    squared = vectors[:, :, None] * vectors[:, None] - angles**2 * IDENTITY_ROTATION
    return IDENTITY_ROTATION + _sinc(angles / np.pi) * s + 0.5 * _sinc(angles / (2.0 * np.pi)) ** 2 * squared


def _sinc(x: FloatArray) -> FloatArray:
    """Compute `np.sinc` to the last bit, in half its time for few numbers."""
    angles = np.pi * x
    angles[angles == 0.0] = np.finfo(np.float64).eps
    return np.sin(angles) / angles


def rotation_by(vector: FloatArray) -> FloatArray:
    """Make the rotation (3, 3) about a `vector` (3,) by its length, radians."""
    return rotations(vector[None])[0]


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """Compute the vector (3,), radians, whose `rotation_by` is the rotation (3, 3); its length is at most pi."""
    twice_sine = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    length = length_of(twice_sine)
    angle = math.atan2(length, float(np.trace(rotation)) - 1.0)
    if angle < 3.0:
        # angle/(2 sin(angle)), which is 1/2 at zero.
        return twice_sine * (angle / length if length > 1e-12 else 0.5)
    # Near half a turn the sine is lost in rounding: R + R' = 2 cos I + 2 (1 - cos) a a'.
    values, vectors = np.linalg.eigh(rotation + rotation.T)
    axis: FloatArray = vectors[:, int(values.argmax())]
    return axis * math.copysign(angle, float(axis @ twice_sine))


def angles_of_rotation(rotation: FloatArray) -> FloatArray:
    """Compute roll, pitch and yaw (3,), radians, with R = Rz(yaw) Ry(pitch) Rx(roll)."""
    across = np.hypot(rotation[0, 0], rotation[1, 0])
    pitch = np.arctan2(-rotation[2, 0], across)
    if across < GIMBAL_MAX_COSINE:
        # x is along z: roll and yaw turn about one axis.
        return np.array([0.0, pitch, np.arctan2(-rotation[0, 1], rotation[1, 1])])
    roll, yaw = np.arctan2(rotation[2, 1], rotation[2, 2]), np.arctan2(rotation[1, 0], rotation[0, 0])
    return np.array([roll, pitch, yaw])


def quaternions_of_angles(angles: FloatArray) -> FloatArray:
    """Compute the (n, 4) unit quaternions w x y z, w >= 0, of roll, pitch and yaw (n, 3), radians."""
    half = angles / 2
    (cr, cp, cy), (sr, sp, sy) = np.cos(half).T, np.sin(half).T
    # qz(yaw) qy(pitch) qx(roll)
    found = np.stack(
        [
            cy * cp * cr + sy * sp * sr, cy * cp * sr - sy * sp * cr, cy * sp * cr + sy * cp * sr, sy * cp * cr - cy * sp * sr,
        ],
        axis=1,
    )  # fmt: skip
    return np.where(found[:, :1] < 0, -found, found)


def quaternion_of_rotation(rotation: FloatArray) -> FloatArray:
    """Compute the unit quaternion (4,) w x y z of a rotation (3, 3), with w >= 0."""
    return quaternions_of_angles(angles_of_rotation(rotation)[None])[0]


def rotation_of_quaternion(wxyz: FloatArray) -> FloatArray:
    """Make the rotation (3, 3) of a quaternion w x y z, (4,) float, not zero; its length does not matter."""
    w, x, y, z = wxyz / float(np.linalg.norm(wxyz))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * (w * cross + cross @ cross)


def fit_rotation(products: FloatArray) -> FloatArray:
    """Fit the rotation R (..., 3, 3) of least |A R - B| to `products` A'B (..., 3, 3): no reflection (Kabsch 1976)."""
    left, _, right = np.linalg.svd(products)
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[..., None]
    return left @ right


def cube_rotations() -> list[FloatArray]:
    """List the 24 rotations (3, 3) that exchange axes."""
    signs, orders = list(product((1.0, -1.0), repeat=3)), list(permutations(range(3)))
    made = [np.eye(3)[list(order)] * np.array(sign, dtype=np.float64) for order in orders for sign in signs]
    return [each for each in made if np.linalg.det(each) > 0]


def orthonormal_pair(u: FloatArray) -> FloatArray:
    """Make (n, 2, 3) orthonormal directions e_1, e_2 with e_1 x e_2 = u, for each of `u` (n, 3), unit."""
    # Duff et al., "Building an orthonormal basis, revisited", 2017: no branch on nearly parallel helpers.
    x, y, z = u.T
    sign = np.copysign(1.0, z)
    k = -1.0 / (sign + z)
    xy = x * y * k
    both = np.empty((len(u), 2, 3))
    both[:, 0, 0], both[:, 0, 1], both[:, 0, 2] = 1.0 + sign * x * x * k, sign * xy, -sign * x
    both[:, 1, 0], both[:, 1, 1], both[:, 1, 2] = xy, sign + y * y * k, -y
    return both


def tangent_axes(x: FloatArray, normal: FloatArray, *, fallback: bool = False) -> tuple[FloatArray, FloatArray]:
    """Project `x` (3,) on the plane across `normal` (3,), unit: a unit direction, and normal x that.

    With `fallback`, an arbitrary direction is taken if `x` is nearly along the normal.
    """
    x = x - (x @ normal) * normal
    length = float(np.sqrt(x @ x))
    x = orthonormal_pair(normal[None])[0, 0] if fallback and length <= 0.1 else x / length
    return x, np.asarray(np.cross(normal, x), dtype=np.float64)


def axis_point(force: FloatArray, moment: FloatArray) -> FloatArray:
    """Compute the point of the force axis nearest to the origin, (f x m)/|f|^2, metres.

    Parameters
    ----------
    force, moment : (..., 3) float, N and N m, one frame; the force is not zero
    """
    if force.ndim > 1:
        return np.cross(force, moment) / np.sum(force * force, axis=-1, keepdims=True)
    # The same sums; one vector alone takes numpy ten times as long.
    (a, b, c), (d, e, f) = force.tolist(), moment.tolist()
    return np.array([b * f - c * e, c * d - a * f, a * e - b * d]) / np.add.reduce(force * force)


def pitch(force: FloatArray, moment: FloatArray) -> FloatArray:
    """Compute the pitch f . m/|f|^2, metres: zero for a single contact without torque (eq. 3).

    Beyond the noise it shows a second contact or a torque. Arguments as for `axis_point`.
    """
    return np.asarray(np.sum(force * moment, axis=-1) / np.sum(force * force, axis=-1))


def move_wrench(link_from_sensor: FloatArray, force: FloatArray, moment: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Carry a wrench from the sensor frame s into the link frame w (eq. 6).

    With p_s = o + R p_w: f_w = R' f_s and m_w = R' (m_s - o x f_s), so that f x p = -m holds in w as it does in s.

    Parameters
    ----------
    link_from_sensor : (..., 4, 4) float, metres, p_w = link_from_sensor p_s; one, or one a wrench
    force, moment : (..., 3) float, sensor frame, N and N m

    Returns
    -------
    force, moment : (..., 3) float, link frame, moment about the link's origin
    """
    rotation, shift = link_from_sensor[..., :3, :3], link_from_sensor[..., :3, 3]
    force_link = _turn(rotation, force)
    # p_w = Q p_s + t with Q = R', t = -R' o, so R'(m - o x f) = Q m + t x (Q f).
    return force_link, _turn(rotation, moment) + np.cross(np.broadcast_to(shift, force_link.shape), force_link)


def _turn(rotation: FloatArray, v: FloatArray) -> FloatArray:
    """Compute Q v for each of many: a matrix product's rounding may depend on how many are turned at once."""
    return rotation[..., 0] * v[..., 0:1] + rotation[..., 1] * v[..., 1:2] + rotation[..., 2] * v[..., 2:3]


@dataclass(frozen=True, slots=True, eq=False)
class DhLink:
    """One joint in the standard Denavit-Hartenberg form: lengths in metres, angles in radians."""

    a: float
    d: float
    alpha: float
    offset: float

    def transform(self, angle: float) -> FloatArray:
        """Compute the (4, 4) pose of this joint's outer frame in its inner one at `angle` radians."""
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
    """Invert a rigid (4, 4) pose."""
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return inverse


def pose_between(before: FloatArray, after: FloatArray, share: float) -> FloatArray:
    """Interpolate two rigid poses (4, 4): the place linearly, the rotation about one axis; share 0 is the first.

    Equal poses give the first one itself.
    """
    if (before == after).all():
        return before
    between = before + share * (after - before)
    turn = before[:3, :3].T @ after[:3, :3]
    between[:3, :3] = before[:3, :3] @ rotation_by(share * rotation_vector(turn))
    return between


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
        """Compute the (4, 4) pose of the sensor in the link frame, p_link = T p_sensor.

        `angles` is (len(joints),) float, radians, of these joints alone.
        """
        base_from_link = np.eye(4)
        for link, angle in zip(self.chain, angles, strict=True):
            base_from_link = base_from_link @ link.transform(float(angle))
        return inverse_pose(base_from_link) @ self.base_from_sensor
