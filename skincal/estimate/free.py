"""A taxel's position without knowing the part's shape (paper, II-A): the point nearest to all force axes.

p_j minimises sum k^2 |u x p_j + m/|f||^2 over the contacts of W_j: p_j = -(F' K^2 F)^-1 F' K^2 M, by QR of K F.
"""

from __future__ import annotations

import numpy as np

from skincal.estimate.evidence import MISS_MAX, Evidence
from skincal.estimate.qr import Factors
from skincal.estimate.result import Estimate, Method, State
from skincal.estimate.uncertainty import SD_MAX, Freedom, propagate
from skincal.readings import FloatArray
from skincal.scene import NoiseSettings

OPPOSED = 0.05
"""Length of the mean of unit pushes below which they cancel and no side is outward: a mean of 0.05 is chance for 400 pokes."""


def estimate_free(evidence: Evidence, factors: Factors, space: Freedom, noise: NoiseSettings) -> list[Estimate]:
    """Estimate each taxel of `evidence`; blind where its axes do not fix a point or pass it far off.

    Parameters
    ----------
    space : `in_space(factors)`
    """
    points = factors.solutions
    uncertain = propagate(evidence, space, points, noise)
    misses = evidence.misses(points)
    normals, opposed = outward(evidence)
    rms = np.sqrt(np.trace(uncertain.covariances, axis1=1, axis2=2))
    counts, doubted = evidence.counts.tolist(), evidence.doubted()
    estimates: list[Estimate] = []
    for i, channel in enumerate(evidence.channels.tolist()):
        normal = None if opposed[i] else normals[i]
        sd = float(uncertain.sds[i])
        if not sd <= SD_MAX:
            foot = points[i] if factors.ranks[i] == 2 else None
            one = Estimate(
                channel, Method.FREE, State.BLIND, counts[i], normal=normal, weakest=uncertain.weakest[i],
                sd=sd if np.isfinite(sd) else None, reason=_why_blind(evidence.part(i, i + 1), uncertain.weakest[i], sd),
                foot=foot, doubted=doubted[i],
            )  # fmt: skip
        elif misses[i] > MISS_MAX:
            reason = (
                f"The axes pass each other at {misses[i] * 1e3:.0f} mm from their middle (limit {MISS_MAX * 1e3:.0f} mm): "
                "check the arm poses, or exclude the wrong pokes."
            )
            one = Estimate(channel, Method.FREE, State.BLIND, counts[i], normal=normal, reason=reason, doubted=doubted[i])
        else:
            one = Estimate(
                channel, Method.FREE, State.ESTIMATED, counts[i], position=points[i], normal=normal,
                covariance=uncertain.covariances[i], weakest=uncertain.weakest[i], sd=sd, rms=float(rms[i]),
                doubted=doubted[i],
            )  # fmt: skip
        estimates.append(one)
    return estimates


def outward(evidence: Evidence) -> tuple[FloatArray, FloatArray]:
    """Return the unit normals against the mean pushes, (t, 3), and where the pushes cancel so that there is none, (t,) bool."""
    pushes = evidence.pushes()
    lengths = np.sqrt(np.sum(pushes * pushes, axis=1))
    with np.errstate(invalid="ignore", divide="ignore"):
        return -pushes / lengths[:, None], lengths < OPPOSED


def _why_blind(evidence: Evidence, axis: FloatArray, sd: float) -> str:
    directions = evidence.directions[evidence.trust > 0.0]
    if len(directions) == 1:
        return "One axis only: the depth along it is unknown. Poke once more with another tilt."
    sines = np.linalg.norm(np.cross(directions, axis), axis=1)
    angle = float(np.degrees(np.arctan2(sines, np.abs(directions @ axis)).max()))
    known = f"is known to {_millimetres(sd)} only" if np.isfinite(sd) else "is unknown"
    return (
        f"All {len(directions)} axes lie within {_degrees(angle)} of one direction: the depth along it {known} "
        f"(limit {SD_MAX * 1e3:.0f} mm). Poke with another tilt."
    )


def _millimetres(metres: float) -> str:
    return f"{metres * 1e3:.0f} mm" if metres < 1.0 else "over 1 m"


def _degrees(angle: float) -> str:
    return f"{angle:.1f} degrees" if angle >= 0.1 else "0.1 degrees"
