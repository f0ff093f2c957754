"""The expected gain of a poke for a turn: its standard deviation in the plane of the skin before and after.

A poke adds its information on (omega, ln rho) to that of the turn, as in `turn_fit.py`: J'J of its reading, without the part
(4) that noise of the force alone would give. J depends on the lean of the push in the axes of the taxel. The turn about z that
is unknown does not change its size. So z alone, or the normal of the skin before the first poke, is enough.
"""

from __future__ import annotations

import numpy as np

from skincal.axes.skin_turns import Turn
from skincal.axes.turn_fit import START_ANGULAR_NOISE, SURPLUS_MARGIN_SDS, UNKNOWN_ANGLE_SD, AxisNoise, TurnFit
from skincal.geometry import FloatArray, orthonormal_pair, rotations

STEP_RAD = 1e-5
EXPECTED_PUSH_FORCE_N = 9.0
"""Mean force of a hand, as the guide expects it for positions."""


def in_plane_sds(turn: Turn | None, noise: AxisNoise, normal: FloatArray, pushes: FloatArray) -> tuple[float, FloatArray]:
    """Predict the sd of a turn about z, rad: now, and (d,) after each of the pushes.

    Parameters
    ----------
    turn : by the pokes so far; `None` before the first
    normal : (3,) float, unit, outward, of the skin at the taxel
    pushes : (d, 3) float, unit
    """
    rotation, covariance, log_ratio = _frame(None if turn is None else turn.fit, noise, normal)
    information = np.linalg.inv(covariance)
    force_variance = (noise.force / EXPECTED_PUSH_FORCE_N) ** 2
    variance = _reading_variance(turn, noise)
    local = pushes @ rotation
    steps = STEP_RAD * np.concatenate([np.eye(4), -np.eye(4)])
    turned = np.einsum("di,kij->kdj", local, rotations(steps[:, :3]))
    m = turned * np.stack([*(np.exp(log_ratio + steps[:, 3]),) * 2, np.ones(8)], axis=1)[:, None]
    unit = m / np.linalg.norm(m, axis=2, keepdims=True)
    jacobian = (unit[:4] - unit[4:]) / (2.0 * STEP_RAD)
    ratio = float(np.exp(log_ratio))
    square = np.sum((local * [ratio, ratio, 1.0]) ** 2, axis=1)
    total = variance + force_variance * ratio**2 / square
    gained = np.einsum("adi,bdi->dab", jacobian, jacobian) / total[:, None, None]
    surplus = 2.0 * (1.0 + SURPLUS_MARGIN_SDS) * force_variance * ratio**2 / square / total
    gained[:, :3, :3] -= surplus[:, None, None] * np.einsum("di,dj->dij", local, local)
    gained[:, 3, 3] = np.maximum(gained[:, 3, 3] - surplus, 0.0)
    # A push along the normal takes away more than it gives.
    gained[:, 2, 2] = np.maximum(gained[:, 2, 2], 0.0)
    after: FloatArray = np.asarray(np.linalg.inv(information + gained), dtype=np.float64)[:, 2, 2]
    now = float(np.sqrt(covariance[2, 2]))
    return now, np.where(after > 0, np.minimum(np.sqrt(np.abs(after)), now), now)


def _frame(fit: TurnFit | None, noise: AxisNoise, normal: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Give the axes (3, 3) of a taxel, the covariance (4, 4) of its turn and ln rho; unknown ones along the normal."""
    if fit is not None:
        return fit.rotation, fit.covariance, fit.log_ratio
    rotation = np.stack([*orthonormal_pair(normal[None])[0], normal], axis=1)
    sds = np.array([UNKNOWN_ANGLE_SD] * 3 + [noise.log_ratio_sd])
    return rotation, np.diag(sds**2), noise.log_ratio


def _reading_variance(turn: Turn | None, noise: AxisNoise) -> float:
    """Predict the variance of a reading's direction, rad^2: the median of the pokes so far, else that of an unknown taxel."""
    if turn is None:
        return max(noise.angle, START_ANGULAR_NOISE) ** 2
    return float(np.median(turn.fit.variances))
