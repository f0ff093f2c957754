"""How still a press is: the spread of its force and the travel of its axis over a few samples."""

from __future__ import annotations

import numpy as np

from skincal.readings import FloatArray
from skincal.wrench import axis_point

CONTACT_REACH = 0.1
"""m. The contact lies at most so far along the force axis from its point nearest to the sensor's origin: the radius of a
robot's limb and more."""
_SURE = 2.0
"""Standard errors by which a travel must exceed its limit: noise alone moves few still presses by more."""


def force_spread(force: FloatArray) -> float:
    """Return the relative spread sd(|f|)/mean(|f|).

    Parameters
    ----------
    force : (n, 3) float, N, tared

    Returns
    -------
    float, 1; infinite where the mean force is zero
    """
    size = np.sqrt(np.einsum("ni,ni->n", force, force))
    mean = float(size.mean())
    return float(size.std()) / mean if mean > 0.0 else float("inf")


def still_share(force: FloatArray, limit: float) -> int:
    """Return the largest k so that the last k samples, and any fewer of them, have a spread of at most `limit`.

    Parameters
    ----------
    force : (n, 3) float, N, tared
    limit : relative spread, 1
    """
    size = np.sqrt(np.einsum("ni,ni->n", force, force))[::-1]
    counts = np.arange(1, len(size) + 1)
    mean = np.cumsum(size) / counts
    variance = np.maximum(np.cumsum(size * size) / counts - mean * mean, 0.0)
    moving = np.sqrt(variance) > limit * mean
    return int(np.argmax(moving)) if moving.any() else len(size)


def axis_travel(force: FloatArray, moment: FloatArray, times_s: FloatArray) -> float:
    """Return how far the force axis travels, straight and beyond the noise, where the contact is.

    The axis of sample i passes the point c(lambda) of the mean axis at the distance d_i = f_i x (f_i x c + m_i)/|f_i|^2. A
    hand that only tilts turns the axis about the contact, so lambda is taken where the d_i are smallest, within
    `CONTACT_REACH` of the point nearest to the sensor. The travel is the straight line through the d_i over the window,
    less two standard errors.

    Parameters
    ----------
    force, moment : (n, 3) float, N and N m, tared, sensor frame; n >= 3
    times_s : (n,) float, s

    Returns
    -------
    float, m
    """
    mean_force = force.mean(axis=0)
    along = mean_force / np.linalg.norm(mean_force)
    start = axis_point(mean_force, moment.mean(axis=0))
    square = np.einsum("ni,ni->n", force, force)[:, None]
    offset = np.cross(force, np.cross(force, start) + moment) / square
    sideways = along - force * (force @ along)[:, None] / square
    weight = float(np.sum(sideways * sideways))
    # Below this the axes are parallel to rounding: every lambda is as good.
    shift = float(np.sum(offset * sideways)) / weight if weight > 1e-12 * len(force) else 0.0
    offset = offset - np.clip(shift, -CONTACT_REACH, CONTACT_REACH) * sideways
    return _straight_travel(offset, times_s)


def _straight_travel(offset: FloatArray, times_s: FloatArray) -> float:
    time = times_s - times_s.mean()
    square = float(time @ time)
    slope = time @ offset / square
    rest = offset - offset.mean(axis=0) - time[:, None] * slope
    span = float(times_s[-1] - times_s[0])
    error = np.sqrt(np.sum(rest * rest) / (len(time) - 2) / square) * span
    return max(0.0, float(np.linalg.norm(slope)) * span - _SURE * float(error))
