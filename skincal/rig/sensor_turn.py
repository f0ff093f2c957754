"""Turn of a sensor on the flange of a tool, from the tool's weight at rest.

Before each poke sensor and skin are tared. The force at rest F_k is then the weight of what hangs on the sensor, in the
sensor's axes, and its offset b. With the rotation R_k of the sensor in the base, as poses and `flange` give it,

    F_k = C R_k' g + b,

g the weight in the base (3 unknowns: no assumption on how the base stands), and C the rotation from the axes of `flange` to the
true ones. C is the identity if `flange` is right. It is found in turns: g by linear least squares, then C by `fit_rotation`,
from the 24 rotations that exchange axes.

The turn of a sensor about the axis of a straight tool moves no force axis by more than some millimetres, and a tip that the
scene gives hides that. The weight shows it, if the tool is turned between the pokes and no controller subtracts the weight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skincal.geometry import FloatArray, cube_rotations, fit_rotation, mean_rows, rotation_vector

SENSOR_TURN_MIN_POKES = 8
SENSOR_TURN_MIN_RAD = float(np.radians(10.0))
"""rad. A smaller turn is an error of the mount, not a mistake."""
MIN_WEIGHT_CHANGE_N = 0.3
"""N, rms change of the weight in the sensor's axes over the pokes: three times a sensor's drift between them."""
MIN_RESIDUAL_RATIO = 3.0
"""Residuals with the axes of `flange` over those with the turned ones."""
MAX_TURN_SD_RAD = float(np.radians(5.0))
FIT_STEPS = 25


class SensorTurn(NamedTuple):
    """Turn of a sensor against the one that `flange` gives."""

    turn: FloatArray
    """(3,) float, rad: rotation vector in the sensor's axes of `flange`, of the true axes."""
    sd: float
    """rad, in the worst direction."""
    weight: float
    """N, on the sensor."""

    @property
    def angle(self) -> float:
        """Size of the turn, rad."""
        return float(np.linalg.norm(self.turn))


class _Fit(NamedTuple):
    square: float
    """N^2, sum of the squared residuals."""
    rotation: FloatArray
    weight: FloatArray


def find_sensor_turn(rotations: FloatArray, rest: FloatArray) -> SensorTurn | None:
    """Find the turn of the sensor on the flange; `None` if the weight does not show one.

    Parameters
    ----------
    rotations : (n, 3, 3) float: R, of the sensor in the base at each poke, as poses and `flange` give it
    rest : (n, 3) float, N: forces at rest, in the sensor's axes, of any sign
    """
    count = len(rest)
    if count < SENSOR_TURN_MIN_POKES:
        return None
    back = rotations.transpose(0, 2, 1)
    off, forces = back - mean_rows(back), rest - mean_rows(rest)
    described = _weigh(off, forces, np.eye(3))
    fits = [_fit(off, forces, start) for start in cube_rotations()]
    best = min(fits, key=lambda each: each.square)
    turn = -rotation_vector(best.rotation)
    change = float(np.linalg.norm(off @ best.weight)) / count**0.5
    if np.linalg.norm(turn) < SENSOR_TURN_MIN_RAD or change < MIN_WEIGHT_CHANGE_N:
        return None
    if described.square < MIN_RESIDUAL_RATIO**2 * best.square:
        return None
    sd = _turn_sd(off, best, count)
    return SensorTurn(turn, sd, float(np.linalg.norm(best.weight))) if sd < MAX_TURN_SD_RAD else None


def _weigh(off: FloatArray, forces: FloatArray, rotation: FloatArray) -> _Fit:
    """Fit the weight for a rotation."""
    rows, wanted = off.reshape(-1, 3), (forces @ rotation).ravel()
    weight = np.asarray(np.linalg.lstsq(rows, wanted, rcond=1e-6)[0], dtype=np.float64)
    return _Fit(float(np.sum((rows @ weight - wanted) ** 2)), rotation, weight)


def _fit(off: FloatArray, forces: FloatArray, start: FloatArray) -> _Fit:
    fit = _weigh(off, forces, start)
    for _ in range(FIT_STEPS):
        fit = _weigh(off, forces, fit_rotation((off @ fit.weight).T @ forces).T)
    return fit


def _turn_sd(off: FloatArray, fit: _Fit, count: int) -> float:
    """Compute the largest sd of the turn, rad, with the weight unknown, by the scatter of the residuals."""
    seen = off @ fit.weight
    # C (1 + S(w)) u: the derivative by w is -C S(u), which has the size of S(u).
    of_turn = np.zeros((count, 3, 3))
    of_turn[:, 0, 1], of_turn[:, 0, 2], of_turn[:, 1, 2] = seen[:, 2], -seen[:, 1], seen[:, 0]
    of_turn -= of_turn.transpose(0, 2, 1)
    rows = np.concatenate([of_turn, off], axis=2).reshape(-1, 6)
    variance = fit.square / max(3 * count - 9, 1)
    covariance = variance * np.asarray(np.linalg.pinv(rows.T @ rows, rcond=1e-9, hermitian=True), dtype=np.float64)
    values = np.linalg.eigvalsh(rows.T @ rows)
    if values[0] < 1e-9 * values[-1]:
        return float("inf")
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
