"""Pure wrenches: the force axis, the pitch, and a wrench seen from another frame.

Source: Del Prete et al., "Skin spatial calibration using force/torque measurements", IROS 2011. A pure force f at c
makes the wrench (f, m = c x f) (eqs. 1-2); so f . m = 0 (eq. 3), and c lies on the force axis
r = (f x m)/|f|^2 + lambda f.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry.arrays import FloatArray


def cross_matrix(v: FloatArray) -> FloatArray:
    """Return S(v), the matrix with S(v) p = v x p.

    Parameters
    ----------
    v : (..., 3) float

    Returns
    -------
    (..., 3, 3) float
    """
    s = np.zeros((*v.shape[:-1], 3, 3))
    s[..., 0, 1], s[..., 0, 2] = -v[..., 2], v[..., 1]
    s[..., 1, 0], s[..., 1, 2] = v[..., 2], -v[..., 0]
    s[..., 2, 0], s[..., 2, 1] = -v[..., 1], v[..., 0]
    return s


def axis_point(force: FloatArray, moment: FloatArray) -> FloatArray:
    """Return the point of the force axis nearest to the origin, (f x m)/|f|^2, metres.

    Parameters
    ----------
    force, moment : (..., 3) float, N and N m, one frame; the force is not zero
    """
    return np.cross(force, moment) / np.sum(force * force, axis=-1, keepdims=True)


def pitch(force: FloatArray, moment: FloatArray) -> FloatArray:
    """Return f . m/|f|^2, metres: zero for a single contact without torque (eq. 3).

    Parameters
    ----------
    force, moment : (..., 3) float, N and N m, one frame; the force is not zero

    Returns
    -------
    (...) float, signed; beyond the noise it shows a second contact or a torque.
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
    """Return Q v for each of many: not as a matrix product, whose rounding may depend on how many are turned at once."""
    return rotation[..., 0] * v[..., 0:1] + rotation[..., 1] * v[..., 1:2] + rotation[..., 2] * v[..., 2:3]
