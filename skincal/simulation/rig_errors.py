"""Errors of sensors, arm and links with the sources of their sizes (`docs/noise.md`), and the noise of the sensor.

The noise of a force/torque sensor is white noise, slow noise (an Ornstein-Uhlenbeck process) and drift (a random walk). The
latter two are drawn at the ends of blocks of readings and interpolated between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from skincal.geometry import FloatArray
from skincal.rig.usual_errors import ARM_POSE_SHIFT_SD_M, ARM_POSE_TURN_SD_RAD, FORCE_TO_MOMENT_LENGTH_M, MATRIX_ERROR_SD


@dataclass(frozen=True, slots=True)
class RigErrors:
    """Errors of a rig, SI units. The defaults are `paper()`.

    Every preset displaces the skin from its plan (`mount_shift`, `mount_turn`): a calibration finds this; it is no rig error.
    """

    force_noise: float = 0.25
    """N, sd of each force component of one reading, white. iCub FT45 data sheet: resolution 0.25 N. (A public log of a
    real sensor, `codyco-modules` 2016, jumps by 0.4 to 2.1 N from sample to sample.)"""
    moment_noise: float = 0.005
    """N m, sd of each moment component of one reading, white. FT45 data sheet: resolution 0.005 N m."""
    slow_force: float = 0.09
    """N, sd of each force component that wanders within a poke (`slow_s`) and so does not average out. Chosen so that
    a poke's tared mean has 0.10 N, the default of `NoiseSettings`; the same log holds 0.13 to 0.34 N over quiet 2 s."""
    slow_moment: float = 0.009
    """N m, as `slow_force`: 0.010 N m a poke; the log holds 0.004 to 0.018 N m."""
    slow_s: float = 0.3
    """s, correlation time of the slow noise: the length of a still window, the least favourable. Assumed."""
    offset_force: float = 20.0
    """N, sd of the constant offset of each force component. A real strain sensor's is larger (268, -77 and -109 N in
    the same log); any constant is removed by the tare."""
    offset_moment: float = 0.5
    """N m, sd of the constant offset. Assumed: `offset_force` times the ratio of the FT45's ranges, 35 N m to 1500 N."""
    weight: float = 8.0
    """N: the part beyond the sensor pulls along a direction that every arm pose has its own. Assumed: a forearm with
    its hand."""
    drift_force: float = 0.5
    """N rms over `drift_session_s`, random walk of each force component. The case measured on this project's synthetic rig."""
    drift_moment: float = 0.012
    """N m rms over `drift_session_s`. `drift_force` times the ratio of the FT45's ranges."""
    drift_session_s: float = 1800.0
    """s, length of the session for the drift."""
    matrix: float = MATRIX_ERROR_SD
    """sd of each entry of E in measured = (I + E) true."""
    matrix_arm: float = FORCE_TO_MOMENT_LENGTH_M
    """m: the entries between force and moment count a moment in units of force x this length."""
    pose_turn: float = ARM_POSE_TURN_SD_RAD
    """rad, sd of the turn of each arm pose about each axis through the sensor."""
    pose_shift: float = ARM_POSE_SHIFT_SD_M
    """m, sd of the shift of each arm pose along each axis."""
    scatter: float = 0.0007
    """m, sd of the point at which the force acts about the middle of the tip, each tangent direction: the pressure
    gathers at one side of a tilted flat tip. Assumed: a third of half the 4 mm tip."""
    mount_shift: float = 0.003
    """m, sd of the skin's shift from its plan in each direction. Assumed: a few millimetres by hand."""
    mount_turn: float = float(np.radians(2.0))
    """rad, sd of the skin's turn in its plane. Assumed."""
    skin_noise: float = 1.0
    """Counts of 255, sd of a taxel's reading, white. Assumed: one step of the device."""
    baseline_spread: float = 3.0
    """Counts of 255, sd of the taxels' untouched readings. An untouched iCub taxel reads 235 to 244."""
    gain_spread: float = 0.10
    """Relative sd of the taxels' sensitivity. Assumed: foam is glued by hand."""
    wrench_latency: float = 0.005
    """s from the reading to its bytes at the host. The wire alone takes 0.8 ms (Bota, 460800 baud) to 8.3 ms
    (Robotiq FT 300, 19200 baud)."""
    skin_latency: float = 0.010
    """s, the same for skin and joints: half the iCub's skin period of 20 ms. Assumed."""
    jitter: float = 0.004
    """s, mean of the exponential extra delay of each packet: USB polls and queues; arrivals measured beside a
    busy window have an sd of 5 to 11 ms, most of it from bursts."""
    burst_rate: float = 0.2
    """1/s: how often a link holds its bytes back and then delivers them at once. Assumed."""
    burst_s: float = 0.05
    """s: how long it holds them back. A 16 ms FTDI timer and a busy host. Assumed."""
    clock_skew: float = 100e-6
    """sd of the relative rate error of each device's clock: a cheap crystal, 100 ppm."""
    tool_noise: float = 0.00005
    """m, rms length of the noise of a reported pose of the tool. Repeatability of small cobots: 0.02 to 0.1 mm."""
    tool_turn_noise: float = 0.0003
    """rad, sd of the reported rotation of the tool about each axis. Assumed."""
    tool_delay: float = 0.020
    """s from the tool's motion to its pose: 2 ms (RTDE, 500 Hz) to some 40 ms (a driver with buffers). Assumed."""
    tool_scale: float = 0.002
    """sd of the relative error of a robot's lengths. Assumed."""
    tool_position: float = 0.0005
    """m, rms length of a robot's position error, smooth over its workspace. Assumed; robots miss commanded positions by 0.2
    to 2 mm."""
    tool_tip: float = 0.001
    """m, rms length of the error of the tip in the scene. Four-point calibrations of a pendant: 0.3 to 0.8 mm."""
    dropped: float = 1e-6
    """Share of the bytes that never arrive. Assumed: about one in 20 s at 1 kHz, each a lost record."""
    corrupted: float = 1e-6
    """Share of the bytes that arrive with one bit turned. Assumed."""

    @classmethod
    def none(cls) -> RigErrors:
        """Return a perfect rig: exact readings without delay. The skin is still displaced."""
        # Reference quantities stay because they are divisors; the mounting is no error of the rig.
        kept = {"matrix_arm", "slow_s", "drift_session_s", "burst_s", "mount_shift", "mount_turn"}
        perfect: dict[str, Any] = {item.name: 0.0 for item in fields(cls) if item.name not in kept}
        return cls(**perfect)

    @classmethod
    def noise(cls) -> RigErrors:
        """Return a good rig: sensor noise, clocks and delays, but exact frames, matrix and arm, and no loss."""
        good = replace(cls(), drift_force=0.0, drift_moment=0.0, matrix=0.0, pose_turn=0.0, pose_shift=0.0)
        good = replace(good, tool_scale=0.0, tool_position=0.0, tool_tip=0.0)
        return replace(good, scatter=0.0, dropped=0.0, corrupted=0.0)

    @classmethod
    def paper(cls) -> RigErrors:
        """Return the rig that reproduces the paper's errors."""
        return cls()


def _six(force: float, moment: float) -> FloatArray:
    return np.repeat([force, moment], 3)


def drift_step(errors: RigErrors) -> FloatArray:
    """Return the sd (6,) of the random walk over one second, N and N m.

    The mean square of a random walk of step s over a session of T is s^2 T/2; the errors state its root.
    """
    return _six(errors.drift_force, errors.drift_moment) * np.sqrt(2.0 / errors.drift_session_s)


def slow_mean_sd(errors: RigErrors, seconds: float) -> FloatArray:
    """Return the sd (6,) of the slow noise's mean over a window, N and N m.

    For the process with correlation time tau over T the variance is 2 sd^2 (tau/T)^2 (T/tau - 1 + exp(-T/tau)).
    """
    ratio = seconds / errors.slow_s
    share = 2.0 / ratio**2 * (ratio + np.expm1(-ratio))
    return _six(errors.slow_force, errors.slow_moment) * np.sqrt(share)


class WrenchNoise:
    """Noise of a sensor, drawn block by block."""

    def __init__(self, errors: RigErrors, rng: np.random.Generator) -> None:
        self._rng = rng
        self._white = _six(errors.force_noise, errors.moment_noise)
        self._slow_sd = _six(errors.slow_force, errors.slow_moment)
        self._slow_s = errors.slow_s
        self._step = drift_step(errors)
        self._slow = self._slow_sd * rng.standard_normal(6)
        self._drift = np.zeros(6)

    def block(self, times: FloatArray, begin: float, end: float) -> FloatArray:
        """Draw noise (n, 6), N and N m, at `times` (n,), s, of the next block."""
        return self.blocks(times[None], [begin], [end])[0]

    def blocks(self, times: FloatArray, begins: Sequence[float], ends: Sequence[float]) -> FloatArray:
        """Draw noise (blocks, n, 6), N and N m, at `times` (blocks, n), s, of the next blocks."""
        # One draw for all blocks gives the same numbers as one after the other.
        count, readings = times.shape
        slow, drift, white = np.split(self._rng.standard_normal((count, 12 + 6 * readings)), [6, 12], axis=1)
        # Exact at the ends of a block, so that its length does not change the noise.
        wander = np.empty((count + 1, 6))
        wander[0] = self._slow + self._drift
        seconds = [end - begin for begin, end in zip(begins, ends, strict=True)]
        for at, length in enumerate(seconds):
            decay = np.exp(-length / self._slow_s)
            self._slow = decay * self._slow + np.sqrt(1 - decay**2) * self._slow_sd * slow[at]
            self._drift = self._drift + self._step * np.sqrt(length) * drift[at]
            wander[at + 1] = self._slow + self._drift
        share = ((times - np.array(begins)[:, None]) / np.array(seconds)[:, None])[:, :, None]
        wandering = wander[:-1, None] + share * (wander[1:, None] - wander[:-1, None])
        return wandering + self._white * white.reshape(count, readings, 6)
