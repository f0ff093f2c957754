"""A taxel's position on the part's surface (paper, II-B): the surface's point nearest to all force axes.

The sum of squares of II-A is |root p - offset|^2 plus a constant, a metric of this taxel's own evidence; its optimum is
found over all triangles at once, on the side that the pokes push on. One axis is enough: it enters the part at one point.

The covariance lies in the plane of the optimum's triangle. Where the optimum lies on an edge or a vertex, the plane of
the triangle named is taken all the same, since facets are of the mesh and not of the part: an edge does not hold a
taxel.
"""

from __future__ import annotations

import numpy as np

from skincal.estimate.evidence import MISS_MAX, Evidence, across
from skincal.estimate.free import OPPOSED
from skincal.estimate.qr import factor
from skincal.estimate.result import Estimate, Method, State
from skincal.estimate.uncertainty import SD_MAX, propagate
from skincal.readings import FloatArray
from skincal.scene import NoiseSettings
from skincal.surface.mesh import Surface
from skincal.surface.nearest import nearest_to_rows


def estimate_surface(channel: int, evidence: Evidence, noise: NoiseSettings, surface: Surface) -> Estimate:
    """Estimate one taxel from at least one contact.

    Blind where no triangle faces the pokes, where they graze the surface and where their axes miss it.
    """
    a, b = evidence.rows()
    solved = factor(a, b)
    push = evidence.push()
    if np.linalg.norm(push) < OPPOSED:
        return _blind(channel, evidence, f"The {evidence.contacts} pokes push from opposite sides: exclude the wrong ones.")
    found = nearest_to_rows(surface, solved.root, solved.offset, push)
    if found is None:
        return _blind(
            channel,
            evidence,
            "No triangle of the surface faces the pokes: check that its normals point outward and the wrench's sign.",
        )
    miss = evidence.miss(found.point)
    if miss > MISS_MAX:
        reason = (
            f"The axes pass the surface at {miss * 1e3:.0f} mm (limit {MISS_MAX * 1e3:.0f} mm): check the mesh's unit and pose."
        )
        return _blind(channel, evidence, reason)
    normal = surface.normals[found.triangle]
    uncertain = propagate(evidence, a, solved.root, found.point, noise, tangent_basis(normal))
    covariance = uncertain.covariance
    if covariance is None or not uncertain.determined:
        reason = (
            f"The pokes graze the surface, so that their axes do not fix a point on it to {SD_MAX * 1e3:.0f} mm: poke steeper."
        )
        return _blind(channel, evidence, reason, uncertain.weakest, uncertain.sd)
    return Estimate(
        channel, Method.SURFACE, State.ESTIMATED, evidence.contacts, position=found.point, normal=normal.copy(),
        covariance=covariance, weakest=uncertain.weakest, sd=uncertain.sd, rms=float(np.sqrt(np.trace(covariance))),
        triangle=found.triangle,
    )  # fmt: skip


def _blind(
    channel: int, evidence: Evidence, reason: str, weakest: FloatArray | None = None, sd: float | None = None
) -> Estimate:
    return Estimate(channel, Method.SURFACE, State.BLIND, evidence.contacts, weakest=weakest, sd=sd, reason=reason)


def tangent_basis(normal: FloatArray) -> FloatArray:
    """Return (3, 2) orthonormal directions across `normal` (3,), unit."""
    return across(normal[None])[0].T
