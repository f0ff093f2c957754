"""What a force/torque sensor adds to the truth over time: white noise, slow noise and drift.

Slow noise is an Ornstein-Uhlenbeck process, drift a random walk; both are drawn at the ends of blocks of readings and
run straight between them.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry.arrays import FloatArray
from skincal.simulate.faults import RigErrors


def _six(force: float, moment: float) -> FloatArray:
    return np.repeat([force, moment], 3)


def drift_step(errors: RigErrors) -> FloatArray:
    """Return (6,) the random walk's sd over one second, N and N m.

    The mean square of a random walk of step s over a session of T is s^2 T/2; the errors state its root.
    """
    return _six(errors.drift_force, errors.drift_moment) * np.sqrt(2.0 / errors.drift_session_s)


def slow_mean_sd(errors: RigErrors, seconds: float) -> FloatArray:
    """Return (6,) the sd of the slow noise's mean over a window, N and N m.

    For the process with correlation time tau over T the variance is 2 sd^2 (tau/T)^2 (T/tau - 1 + exp(-T/tau)).
    """
    ratio = seconds / errors.slow_s
    share = 2.0 / ratio**2 * (ratio + np.expm1(-ratio))
    return _six(errors.slow_force, errors.slow_moment) * np.sqrt(share)


class WrenchNoise:
    """Draws what a sensor adds to its readings, block after block.

    Parameters
    ----------
    errors : sizes
    rng : source of randomness
    """

    def __init__(self, errors: RigErrors, rng: np.random.Generator) -> None:
        self._rng = rng
        self._white = _six(errors.force_noise, errors.moment_noise)
        self._slow_sd = _six(errors.slow_force, errors.slow_moment)
        self._slow_s = errors.slow_s
        self._step = drift_step(errors)
        self._slow = self._slow_sd * rng.standard_normal(6)
        self._drift = np.zeros(6)

    def block(self, times: FloatArray, begin: float, end: float) -> FloatArray:
        """Return (n, 6) noise for readings of one block, N and N m.

        Parameters
        ----------
        times : (n,) float, seconds, in [begin, end)
        begin, end : seconds; a block begins where the last one ended
        """
        before = self._slow + self._drift
        seconds = end - begin
        decay = np.exp(-seconds / self._slow_s)
        self._slow = decay * self._slow + np.sqrt(1 - decay**2) * self._slow_sd * self._rng.standard_normal(6)
        self._drift = self._drift + self._step * np.sqrt(seconds) * self._rng.standard_normal(6)
        share = ((times - begin) / seconds)[:, None]
        wander = before + share * (self._slow + self._drift - before)
        return wander + self._white * self._rng.standard_normal((len(times), 6))
