"""A taxel's position without knowing the part's shape (paper, II-A): the point nearest to all force axes.

p_j minimises sum k^2 |u x p_j + m/|f||^2 over the contacts of W_j: p_j = -(F' K^2 F)^-1 F' K^2 M, by QR of K F.
"""

from __future__ import annotations

import numpy as np

from skincal.estimate.evidence import MISS_MAX, Evidence
from skincal.estimate.qr import factor
from skincal.estimate.result import Estimate, Method, State
from skincal.estimate.uncertainty import SD_MAX, Uncertainty, propagate
from skincal.readings import FloatArray
from skincal.scene import NoiseSettings

OPPOSED = 0.05
"""Length of the mean of unit pushes below which they cancel and no side is outward: a mean of 0.05 is chance for 400 pokes."""


def estimate_free(channel: int, evidence: Evidence, noise: NoiseSettings) -> Estimate:
    """Estimate one taxel from at least one contact; blind where its axes do not fix a point or pass it far off."""
    a, b = evidence.rows()
    solved = factor(a, b)
    point = solved.solution
    around = evidence.sensors.mean(axis=0) if point is None else point
    uncertain = propagate(evidence, a, solved.root, around, noise, np.eye(3))
    normal = outward(evidence)
    covariance = uncertain.covariance
    if point is None or covariance is None or not uncertain.determined or not np.isfinite(point).all():
        return Estimate(
            channel, Method.FREE, State.BLIND, evidence.contacts, normal=normal, weakest=uncertain.weakest, sd=uncertain.sd,
            reason=_why_blind(evidence, uncertain),
        )  # fmt: skip
    miss = evidence.miss(point)
    if miss > MISS_MAX:
        reason = (
            f"The axes pass each other at {miss * 1e3:.0f} mm from their middle (limit {MISS_MAX * 1e3:.0f} mm): "
            "check the arm poses, or exclude the wrong pokes."
        )
        return Estimate(channel, Method.FREE, State.BLIND, evidence.contacts, normal=normal, reason=reason)
    return Estimate(
        channel, Method.FREE, State.ESTIMATED, evidence.contacts, position=point, normal=normal, covariance=covariance,
        weakest=uncertain.weakest, sd=uncertain.sd, rms=float(np.sqrt(np.trace(covariance))),
    )  # fmt: skip


def outward(evidence: Evidence) -> FloatArray | None:
    """Return the unit normal against the mean push; None where the pushes cancel."""
    push = evidence.push()
    length = float(np.linalg.norm(push))
    return None if length < OPPOSED else -push / length


def _why_blind(evidence: Evidence, uncertain: Uncertainty) -> str:
    if evidence.contacts == 1:
        return "One axis only: the depth along it is unknown. Poke once more with another tilt."
    axis = uncertain.weakest
    sines = np.linalg.norm(np.cross(evidence.directions, axis), axis=1)
    angle = float(np.degrees(np.arctan2(sines, np.abs(evidence.directions @ axis)).max()))
    known = "is unknown" if uncertain.sd is None else f"is known to {_millimetres(uncertain.sd)} only"
    return (
        f"All {evidence.contacts} axes lie within {_degrees(angle)} of one direction: the depth along it {known} "
        f"(limit {SD_MAX * 1e3:.0f} mm). Poke with another tilt."
    )


def _millimetres(metres: float) -> str:
    return f"{metres * 1e3:.0f} mm" if metres < 1.0 else "over 1 m"


def _degrees(angle: float) -> str:
    return f"{angle:.1f} degrees" if angle >= 0.1 else "0.1 degrees"
