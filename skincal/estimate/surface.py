"""A taxel's position on the part's surface (paper, II-B): the surface's point nearest to all force axes.

The sum of squares of II-A is |root p - offset|^2 plus a constant, a metric of this taxel's own evidence; its optimum is
found over all triangles at once, on the side that the pokes push on. One axis is enough: it enters the part at one point.

The covariance lies in the plane of the optimum's triangle. Where the optimum lies on an edge or a vertex, the plane of
the triangle named is taken all the same, since facets are of the mesh and not of the part: an edge does not hold a
taxel.

A second minimum elsewhere is a **rival** where the noise could have made it the worse one; `odds_of` in
`skincal/solver/source/solver.c` says how likely that is.
"""

from __future__ import annotations

import numpy as np

from skincal.estimate.result import MISS_MAX, SD_MAX, Estimate, Method, Rival, State
from skincal.estimate.solution import OnSurface, Solution
from skincal.surface.mesh import Surface


def estimate_surface(solution: Solution, found: OnSurface, surface: Surface) -> list[Estimate]:
    """Say of each taxel what the surface method knows.

    Blind where no triangle faces the pokes, where they graze the surface and where their axes miss it.

    Parameters
    ----------
    found : `solution.surface`
    """
    evidence, uncertain, doubted = solution.evidence, found.uncertain, solution.doubted
    normals = surface.normals[found.triangles]
    rivals = {
        i: Rival(found.rivals[i], int(found.rival_triangles[i]), float(found.odds[i]))
        for i in np.flatnonzero(np.isfinite(found.odds)).tolist()
    }
    # Lists, since numbers of arrays one by one take ten times as long.
    known = (uncertain.sds, uncertain.rms, uncertain.misses)
    numbers = (evidence.channels, evidence.counts, solution.opposed, found.triangles, *known)
    estimates: list[Estimate] = []
    rows = enumerate(zip(*map(np.ndarray.tolist, numbers), strict=True))
    for i, (channel, contacts, cancel, triangle, sd, rms, miss) in rows:
        reason = _why_blind(contacts, cancel, triangle, miss, sd)
        if reason:
            grazing = triangle >= 0 and not cancel and miss <= MISS_MAX
            one = Estimate(
                channel, Method.SURFACE, State.BLIND, contacts, weakest=uncertain.weakest[i] if grazing else None,
                sd=sd if grazing and np.isfinite(sd) else None, reason=reason, doubted=doubted[i],
            )  # fmt: skip
        else:
            one = Estimate(
                channel, Method.SURFACE, State.ESTIMATED, contacts, position=found.points[i], normal=normals[i],
                covariance=uncertain.covariances[i], weakest=uncertain.weakest[i], sd=sd, rms=rms,
                triangle=triangle, rival=rivals.get(i), doubted=doubted[i],
            )  # fmt: skip
        estimates.append(one)
    return estimates


def _why_blind(contacts: int, opposed: bool, triangle: int, miss: float, sd: float) -> str:
    """Return why a taxel has no estimate; empty if it has one."""
    if opposed:
        return f"The {contacts} pokes push from opposite sides: exclude the wrong ones."
    if triangle < 0:
        return "No triangle of the surface faces the pokes: check that its normals point outward and the wrench's sign."
    if miss > MISS_MAX:
        return (
            f"The axes pass the surface at {miss * 1e3:.0f} mm (limit {MISS_MAX * 1e3:.0f} mm): check the mesh's unit and pose."
        )
    if not sd <= SD_MAX:
        return (
            f"The pokes graze the surface, so that their axes do not fix a point on it to {SD_MAX * 1e3:.0f} mm: poke steeper."
        )
    return ""
