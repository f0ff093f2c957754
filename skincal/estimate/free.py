"""A taxel's position without knowing the part's shape (paper, II-A): the point nearest to all force axes.

p_j minimises sum k^2 |u x p_j + m/|f||^2 over the contacts of W_j: p_j = -(F' K^2 F)^-1 F' K^2 M, by QR of K F.
"""

from __future__ import annotations

import numpy as np

from skincal.estimate.evidence import Evidence
from skincal.estimate.result import MISS_MAX, SD_MAX, Estimate, Method, State
from skincal.estimate.solution import Solution, Uncertain
from skincal.readings import FloatArray


def estimate_free(solution: Solution, uncertain: Uncertain) -> list[Estimate]:
    """Say of each taxel what the free method knows; blind where its axes do not fix a point or pass it far off.

    Parameters
    ----------
    uncertain : `solution.free`
    """
    evidence, points, ranks = solution.evidence, solution.factors.solutions, solution.factors.ranks
    normals, doubted = solution.outward, solution.doubted
    # Lists, since numbers of arrays one by one take ten times as long.
    numbers = (evidence.channels, evidence.counts, solution.opposed, ranks, uncertain.sds, uncertain.rms, uncertain.misses)
    estimates: list[Estimate] = []
    rows = enumerate(zip(*map(np.ndarray.tolist, numbers), strict=True))
    for i, (channel, contacts, opposed, rank, sd, rms, miss) in rows:
        normal = None if opposed else normals[i]
        if not sd <= SD_MAX:
            one = Estimate(
                channel, Method.FREE, State.BLIND, contacts, normal=normal, weakest=uncertain.weakest[i],
                sd=sd if np.isfinite(sd) else None, reason=_why_blind(evidence.part(i, i + 1), uncertain.weakest[i], sd),
                foot=points[i] if rank == 2 else None, doubted=doubted[i],
            )  # fmt: skip
        elif miss > MISS_MAX:
            reason = (
                f"The axes pass each other at {miss * 1e3:.0f} mm from their middle (limit {MISS_MAX * 1e3:.0f} mm): "
                "check the arm poses, or exclude the wrong pokes."
            )
            one = Estimate(channel, Method.FREE, State.BLIND, contacts, normal=normal, reason=reason, doubted=doubted[i])
        else:
            one = Estimate(
                channel, Method.FREE, State.ESTIMATED, contacts, position=points[i], normal=normal,
                covariance=uncertain.covariances[i], weakest=uncertain.weakest[i], sd=sd, rms=rms, doubted=doubted[i],
            )  # fmt: skip
        estimates.append(one)
    return estimates


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
