"""How far each contact counts for each taxel: fully, unless it is far off what the taxel's other contacts say.

A poke that touches two places gives one axis between them, off both by millimetres to centimetres, and a pitch (eq. 3). So
a contact's miss z is that of its axis from where the other axes put the taxel and its pitch, each in standard deviations of
the rig's noise,

    z^2 = r' D^-1 r / spread^2 + pitch^2 / (sigma_pitch^2 spread_pitch^2),

with r the two rows' residuals and D their covariance (`uncertainty`). A rig whose matrix or poses are wrong misses by more
than its noise, and must not lose its pokes for that: the spreads are the geometric means of the taxel's own misses over those
of noise alone, and at least 1. (A geometric mean needs no sorting, and a few far misses hardly move it.)

Up to `FULL` a contact counts fully, so that without outliers the estimate is that of (5); from `NONE` on not at all; in
between by a smooth step. The point from which r counts is found by least squares, then by `STEPS` steps with weights 1/z^2.
With few contacts, or where hardly one would be left, none can be told to be the wrong one.

It does not see a second touch that moves the axis by no more than the noise does.
"""

from __future__ import annotations

import numpy as np

from skincal.estimate.evidence import Evidence
from skincal.estimate.segments import dot, spread, total
from skincal.estimate.uncertainty import along_pushes, offset_squares, rows_in_skin, sensor_noise
from skincal.readings import FloatArray, IntArray
from skincal.scene import NoiseSettings

FULL = 2.8
"""Standard deviations, in three directions: noise alone is beyond in 5 %, that of the simulated rig in 2 %."""
NONE = 3.8
"""Standard deviations: noise alone is beyond in 2 of 1000."""
FEWEST = 4
"""Contacts below which all count fully: two of three can agree by chance."""
LEFT = 2.0
"""Sum of the trust below which all count fully: where hardly one is left, nobody can tell which one is right."""
SMALL = 6.0
"""A spread found from few misses may be too small: it is raised as limits of Student's t are, by this over its 2 n - 3 degrees
of freedom."""
EVEN = 2.0
"""Standard deviations up to which all contacts pull alike while the point is sought."""
STEPS = 1
"""Steps of that search; a second one takes 2 % off the worst taxel's error and costs a quarter more time."""
DAMPING = 1e-4
"""Share of the weights that holds a step back where nearly parallel axes do not determine one: those of 0.6 degrees spread."""
USUAL_MISS = 0.1159
"""Mean of the logarithm of chi-square of two degrees of freedom, ln 2 - gamma."""
USUAL_PITCH = -1.2704
"""Mean of the logarithm of chi-square of one, -ln 2 - gamma."""
AT_ONCE = 4_000
"""Answers worked on at once: they stay near the processor."""
_UNIT = np.eye(3)


def trust(evidence: Evidence, noise: NoiseSettings) -> FloatArray:
    """Return (n,) float, 0 to 1, a factor of each contact's share of the sum of squares; exactly 1 for nearly all.

    A taxel's trust depends on its own contacts' numbers alone: not on their order, nor on which other taxels there are.
    """
    parts: list[FloatArray] = []
    first, count = 0, len(evidence.channels)
    while first < count:
        after = int(np.searchsorted(evidence.starts, int(evidence.starts[first]) + AT_ONCE, side="right")) - 1
        after = max(after, first + 1)
        parts.append(_trust(evidence.part(first, after), noise))
        first = after
    return np.concatenate(parts) if parts else np.ones(0)


def _trust(evidence: Evidence, noise: NoiseSettings) -> FloatArray:
    starts = evidence.starts
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        shares = evidence.weights / spread(total(evidence.weights, starts), evidence.taxels)
        points = total(shares * _nearest_to_sensor(evidence), starts)
        rows = evidence.columns[11:17].reshape(2, 3, -1)
        points = points + _step(rows, _outer(rows), shares, _residuals(evidence, rows, points), starts)
        rows, pitch = _whitened(evidence, points, noise)
        outer = _outer(rows)
        for _ in range(STEPS):
            residuals = _residuals(evidence, rows, points)
            pulling = shares / np.maximum((residuals * residuals).sum(axis=0) + pitch, EVEN**2)
            points = points + _step(rows, outer, pulling, residuals, starts)
        residuals = _residuals(evidence, rows, points)
        squares = _relative((residuals * residuals).sum(axis=0), USUAL_MISS, evidence) + pitch
        rest = np.minimum(np.maximum((NONE - np.sqrt(squares)) / (NONE - FULL), 0.0), 1.0)
    counted = rest * rest * (3.0 - 2.0 * rest)
    few = (evidence.counts < FEWEST).take(evidence.taxels)
    counted[~(squares > FULL**2) | few] = 1.0
    counted[(total(counted, starts) < LEFT).take(evidence.taxels)] = 1.0
    return counted


def _nearest_to_sensor(evidence: Evidence) -> FloatArray:
    """Return (3, n) the axes' points nearest to the sensor's origin: the same in every frame."""
    u, nearest = evidence.columns[0:3], evidence.columns[3:6]
    return nearest + dot(u, evidence.columns[8:11] - nearest) * u


def _whitened(evidence: Evidence, points: FloatArray, noise: NoiseSettings) -> tuple[FloatArray, FloatArray]:
    """Return the rows (2, 3, n) in standard deviations of the noise for taxels near `points` (3, t), and the pitch's z^2."""
    sensor, less = sensor_noise(evidence, points.T, noise)
    beside = offset_squares(evidence, noise)
    out = rows_in_skin(evidence, along_pushes(evidence))
    squares = (sensor + beside) - less * less - beside * out * out
    # D = L L' with L lower triangular; the rows are those of L^-1.
    l11 = np.sqrt(squares[0])
    l21 = -(less[0] * less[1] + beside * out[0] * out[1]) / l11
    rows = evidence.columns[11:17].reshape(2, 3, -1).copy()
    rows[0] /= l11
    rows[1] -= l21 * rows[0]
    rows[1] /= np.sqrt(squares[1] - l21 * l21)
    pitch = evidence.pitches**2 / ((noise.moment / evidence.forces) ** 2 + (less * less).sum(axis=0))
    return rows, _relative(pitch, USUAL_PITCH, evidence)


def _relative(squares: FloatArray, usual: float, evidence: Evidence) -> FloatArray:
    """Return squared misses (n,) over their taxel's geometric mean where it is more than usual; 0 of them makes it less."""
    counts = evidence.counts
    wide = np.exp(total(np.log(squares), evidence.starts) / counts - usual) * (1.0 + SMALL / np.maximum(2 * counts - 3, 1))
    return squares / spread(np.maximum(wide, 1.0), evidence.taxels)


def _outer(rows: FloatArray) -> FloatArray:
    """Return (3, 3, n) the sums of each contact's two rows' outer products."""
    return rows[0][:, None] * rows[0] + rows[1][:, None] * rows[1]


def _residuals(evidence: Evidence, rows: FloatArray, points: FloatArray) -> FloatArray:
    """Return (2, n) both rows' residuals h.(a - p) at `points` (3, t)."""
    residuals: FloatArray = (rows * (evidence.columns[3:6] - spread(points, evidence.taxels))).sum(axis=1)
    return residuals


def _step(rows: FloatArray, outer: FloatArray, weights: FloatArray, residuals: FloatArray, starts: IntArray) -> FloatArray:
    """Return (3, t) the step of weighted least squares from where the rows' residuals are counted."""
    matrices = total(weights * outer, starts).transpose(2, 0, 1)
    pulls = total(((weights * residuals)[:, None] * rows).sum(axis=0), starts)
    held = DAMPING * (matrices[:, 0, 0] + matrices[:, 1, 1] + matrices[:, 2, 2])
    solved = np.linalg.solve(matrices + held[:, None, None] * _UNIT, pulls.T[:, :, None])
    return np.asarray(solved[:, :, 0].T, dtype=np.float64)
