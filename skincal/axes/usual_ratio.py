"""The ratio of gains that the taxels of a skin share, from all their pokes together.

In slopes against the push, x = (R'F)_xy/(R'F)_z and y = r_xy/r_z, equation (1) of `turn_fit.py` is linear: with the turn theta
about z, and a tilt of z that moves every y alike,

    y = rho Q(theta) x + const + noise of the reading,   x = true lean + noise of the force.                     (1)

The noise of the force is often as large as the lean. Then a taxel's own ratio scatters by tens of percent, and its expected
error is that share of itself. So the mean of such ratios by their expected errors is too large, by twice the variance of
ln rho: those that are too large by chance seem to be known best. A prior of each taxel adds to it: the mean does not lower it.

**Likelihood.** The leans of a taxel's pokes scatter by v in each direction. Of two components each, x and y then have the
covariance [[v + s, rho v], [rho v, rho^2 v + k]], with the variances s of the force's direction and k of the reading's. With
their sums of squares X and Y about the mean, Z = |sum x* y| as complex numbers, and D = v k + s rho^2 v + s k,

    ln L = -(n - 1) ln D - ((rho^2 v + k) X + (v + s) Y)/(2 D) + ln I0(rho v Z/D).                                (2)

I0 is the Bessel function: the integral over theta. (2) is averaged over v, each ln v as likely, and k is known to a factor.
Pokes without a lean have v = 0, and say nothing about rho; only an exact k would show that, so all ratios are as likely if x
scatters by hardly more than s. This is the structural model with known noise (Fuller, Measurement Error Models, 1987, 1.3).

**Taxels.** ln rho of a taxel is normal about that of the skin, mu, with a standard deviation tau: (2) is averaged over it, and
the sum of the logarithms over all taxels gives the posterior of mu and tau. Its prediction for one taxel is the result. A
taxel's own pokes count again in its fit. So the N taxels have the weight (N - 1)/N here, as if each had the ratio of the
others. Readings of one poke have the weight of one, and so do those with one error by their steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skincal.axes.turn_fit import LOG_RATIO_SD, MIN_ANGULAR_NOISE, SURPLUS_MARGIN_SDS, AxisNoise, AxisPokes, TurnFit
from skincal.geometry import FloatArray, mean_rows

LOG_RATIOS = np.linspace(-2.4, 2.4, 81)
"""Tried ln rho of a taxel."""
LEAN_SDS = np.radians(np.geomspace(0.1, 40.0, 12))
"""rad, tried sqrt(v)."""
READING_NOISE_FACTORS = np.array([0.8, 1.0, 1.25])
"""Tried sqrt(k), over that of the noise that the fits show: fits of pokes without a lean take up a part of it."""
LOG_RATIO_SDS = np.array([0.05, 0.1, 0.2, 0.4])
"""Tried tau: gains of one batch differ by some percent."""
MIN_SHARE_OF_Z = 0.2
"""Of a force or a reading. With less its slope says nothing."""
MAX_BESSEL_ARGUMENT = 500.0
"""Above it I0(x) is exp(x)/sqrt(2 pi x) to 0.03 %."""


def with_usual_ratio(groups: Sequence[AxisPokes], fits: Sequence[TurnFit], noise: AxisNoise) -> AxisNoise:
    """Set the expected ln rho, and its sd for one taxel, from two or more groups of pokes with axes of their own.

    Parameters
    ----------
    fits : of the groups, with `noise`, all of one hand
    """
    if len(groups) < 2:
        return noise
    likelihoods = np.array([log_likelihood_of_ratio(*each, noise) for each in zip(groups, fits, strict=True)])
    readings, pokes = sum(len(each) for each in groups), len(np.unique(np.concatenate([each.pokes for each in groups])))
    # By the mean: a taxel whose values jump between two steps has a ratio that is too large, and repeats less.
    share = pokes / readings * (1.0 - 1.0 / len(groups)) / float(np.mean([fit.repeats for fit in fits]))
    # (tau, mu, ln rho): the distribution of a taxel's ln rho. The factor of the noise is that of all taxels.
    spread = (LOG_RATIOS - LOG_RATIOS[:, None]) / LOG_RATIO_SDS[:, None, None]
    taxel = np.exp(-0.5 * spread**2)
    taxel /= taxel.sum(axis=2, keepdims=True)
    highest = likelihoods.max(axis=2, keepdims=True)
    averaged = np.log(np.maximum(np.einsum("tml,gkl->ktmg", taxel, np.exp(likelihoods - highest)), 1e-300)).sum(axis=3)
    log_posterior = share * (averaged + highest.sum(axis=0)[..., None]) - 0.5 * (LOG_RATIOS / LOG_RATIO_SD) ** 2
    posterior = np.exp(log_posterior - log_posterior.max())
    predicted = np.einsum("ktm,tml->l", posterior, taxel) / posterior.sum()
    mean = float(predicted @ LOG_RATIOS)
    sd = float(np.sqrt(predicted @ (LOG_RATIOS - mean) ** 2))
    return replace(noise, log_ratio=mean, log_ratio_sd=min(sd, LOG_RATIO_SD))


def log_likelihood_of_ratio(pokes: AxisPokes, fit: TurnFit, noise: AxisNoise) -> FloatArray:
    """Compute the logarithm of the likelihood (2) for pokes that share a turn; z is that of `fit`.

    Returns
    -------
    (factors, ratios) float, for each of `READING_NOISE_FACTORS` and of `LOG_RATIOS`
    """
    hand = pokes.mirrored() if fit.is_mirrored else pokes
    force, reading = hand.forces @ fit.rotation, hand.readings
    size, force_size = np.linalg.norm(reading, axis=1), np.linalg.norm(force, axis=1)
    steep = np.minimum(np.abs(force[:, 2]) / force_size, np.abs(reading[:, 2]) / size) > MIN_SHARE_OF_Z
    count = float(fit.trust[steep].sum())
    nothing = np.zeros((len(READING_NOISE_FACTORS), len(LOG_RATIOS)))
    if count <= 1.0:
        return nothing
    trust, size, force_size = fit.trust[steep], size[steep], force_size[steep]
    x, y = (each[steep, :2] / each[steep, 2:] for each in (force, reading))
    # A slope has a larger error than the angle: by 1 + slope^2 along the lean, and by its square root across it.
    of_force, of_reading = (1.0 + np.sum(each**2, axis=1) for each in (x, y))
    s = (noise.force / force_size) ** 2 * 0.5 * (of_force**2 + of_force) + MIN_ANGULAR_NOISE**2
    k = ((noise.reading / size) ** 2 + noise.angle**2) * 0.5 * (of_reading**2 + of_reading) + MIN_ANGULAR_NOISE**2
    weight = trust / (k + np.exp(2.0 * fit.log_ratio) * s)
    x, y = (each - mean_rows(each * weight[:, None]) / weight.mean() for each in (x, y))
    scatter = float(trust @ (np.sum(x**2, axis=1) / s)) / (2.0 * (count - 1.0))
    if scatter < 1.0 + SURPLUS_MARGIN_SDS / np.sqrt(count - 1.0):
        return nothing
    rho, v = np.exp(LOG_RATIOS)[:, None, None], LEAN_SDS[:, None] ** 2
    k = k * READING_NOISE_FACTORS[:, None, None, None] ** 2
    across = v * k + s * rho**2 * v + s * k
    square_x, square_y = np.sum(x**2, axis=1), np.sum(y**2, axis=1)
    cost = ((rho**2 * v + k) * square_x + (v + s) * square_y) / across
    common = (x[:, 0] - 1j * x[:, 1]) * (y[:, 0] + 1j * y[:, 1])
    turned = np.abs(np.sum(trust * rho * v / across * common, axis=3))
    fixed = np.sum(trust * (np.log(across) * (1.0 - 1.0 / count) + 0.5 * cost), axis=3)
    by_lean = _log_bessel(turned) - fixed
    return np.asarray(np.logaddexp.reduce(by_lean, axis=2), dtype=np.float64)


def _log_bessel(x: FloatArray) -> FloatArray:
    """Compute ln I0(x)."""
    small = np.log(np.i0(np.minimum(x, MAX_BESSEL_ARGUMENT)))
    large = x - 0.5 * np.log(2.0 * np.pi * np.maximum(x, MAX_BESSEL_ARGUMENT))
    return np.where(x < MAX_BESSEL_ARGUMENT, small, large)
