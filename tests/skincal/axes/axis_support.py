"""Pokes on taxels of three axes, made without the simulated skin: equation (1) of `skincal/axes/turn_fit.py` written down."""

from __future__ import annotations

import numpy as np

from skincal.axes.turn_fit import AxisNoise, AxisPokes
from skincal.geometry import rotation_vector

FORCE_NOISE_N, READING_NOISE = 0.05, 0.02
NOISE = AxisNoise(FORCE_NOISE_N, READING_NOISE)


def random_rotation(rng):
    """Draw a rotation, uniform: three columns by Gram-Schmidt."""
    x = rng.normal(size=3)
    x /= np.linalg.norm(x)
    y = rng.normal(size=3)
    y -= (y @ x) * x
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def make_pokes(rng, axes, count, lean_deg, ratio=0.6, is_noisy=True, reading_noise=READING_NOISE, about=None, step=0.0):
    """Make pokes with leans up to `lean_deg` from the inward z of a taxel with these `axes` (3, 3).

    The leans are about the inward z of `about` (3, 3), in the axes of the taxel; values are rounded to multiples of `step`.
    """
    cosines = rng.uniform(np.cos(np.radians(lean_deg)), 1.0, count)
    azimuths, sines = rng.uniform(0.0, 2.0 * np.pi, count), np.sqrt(1.0 - cosines**2)
    forces = rng.uniform(4.0, 8.0, count)[:, None] * np.stack(
        [sines * np.cos(azimuths), sines * np.sin(azimuths), -cosines], axis=1
    )
    if about is not None:
        forces = forces @ about.T
    readings = rng.uniform(0.25, 0.5, count)[:, None] * forces * np.array([ratio, ratio, 1.0])
    in_link = forces @ axes.T
    if is_noisy:
        readings = readings + reading_noise * rng.normal(size=(count, 3))
        in_link = in_link + FORCE_NOISE_N * rng.normal(size=(count, 3))
    if step:
        readings = np.rint(readings / step) * step
    return AxisPokes(in_link, readings, np.arange(count))


def turn_between(found, true):
    """Turn (3,), rad, from the found axes to the true ones, in the found axes."""
    return rotation_vector(found.T @ true)
