"""A taxel's position on the part's surface (paper, II-B): the surface's point nearest to all force axes.

The sum of squares of II-A is |root p - offset|^2 plus a constant, a metric of this taxel's own evidence; its optimum is
found over all triangles at once, on the side that the pokes push on. One axis is enough: it enters the part at one point.

The covariance lies in the plane of the optimum's triangle. Where the optimum lies on an edge or a vertex, the plane of
the triangle named is taken all the same, since facets are of the mesh and not of the part: an edge does not hold a
taxel.

A second minimum elsewhere is a **rival** where the noise could have made it the worse one. With d from the estimate to it
and A d what the rows differ by, the two sums of squares differ by s, which is normal with mean +|A d|^2 where the
estimate is right, -|A d|^2 where the rival is, and variance tau^2 = 4 d'A' (K D K) A d (`uncertainty`) in both cases. So
the odds for the estimate are exp(2 s |A d|^2 / tau^2).
"""

from __future__ import annotations

import numpy as np

from skincal.estimate.evidence import MISS_MAX, Evidence
from skincal.estimate.free import OPPOSED
from skincal.estimate.qr import Factors
from skincal.estimate.result import Estimate, Method, Rival, State
from skincal.estimate.segments import largest
from skincal.estimate.uncertainty import SD_MAX, Freedom, in_planes, propagate, row_noise
from skincal.readings import FloatArray, IntArray
from skincal.scene import NoiseSettings
from skincal.surface.mesh import Surface
from skincal.surface.nearest import NearestMany, nearest_to_rows, second_to_rows

RIVAL_ODDS = 20.0
"""A place that is less than 20 times less likely than the estimate is a rival: the usual 95 %."""
RIVAL_APART = 0.010
"""m. A second minimum nearer than this is of the same place: facets and bends make many, and taxels are 5 mm apart."""


def estimate_surface(
    evidence: Evidence,
    factors: Factors,
    space: Freedom,
    noise: NoiseSettings,
    surface: Surface,
    last: IntArray | None = None,
) -> list[Estimate]:
    """Estimate each taxel of `evidence`.

    Blind where no triangle faces the pokes, where they graze the surface and where their axes miss it.

    Parameters
    ----------
    space : the freedom of the taxels before they are held on the surface
    last : (t,) the triangles of the last answers, -1 where there are none; they make the search shorter and nothing else
    """
    pushes = evidence.pushes()
    opposed = np.sqrt(np.sum(pushes * pushes, axis=1)) < OPPOSED
    # A taxel whose pushes cancel is blind; any push will do for it meanwhile.
    pushes = np.where(opposed[:, None], evidence.directions[evidence.starts[:-1]], pushes)
    found = nearest_to_rows(surface, factors.roots, factors.offsets, pushes, last)
    normals = surface.normals[found.triangles]
    freedom = in_planes(factors, normals)
    uncertain = propagate(evidence, freedom, found.points, noise)
    misses = evidence.misses(found.points)
    rivals = _rivals(surface, evidence, factors, pushes, found, space, freedom, noise)
    rms = np.sqrt(np.trace(uncertain.covariances, axis1=1, axis2=2)).tolist()
    doubted = evidence.doubted()
    # Lists, since numbers of arrays one by one take ten times as long.
    numbers = (evidence.channels, evidence.counts, opposed, found.triangles, misses, uncertain.sds)
    estimates: list[Estimate] = []
    for i, (channel, contacts, cancel, triangle, miss, sd) in enumerate(zip(*map(np.ndarray.tolist, numbers), strict=True)):
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
                covariance=uncertain.covariances[i], weakest=uncertain.weakest[i], sd=sd, rms=rms[i],
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


def _rivals(
    surface: Surface,
    evidence: Evidence,
    factors: Factors,
    pushes: FloatArray,
    found: NearestMany,
    space: Freedom,
    plane: Freedom,
    noise: NoiseSettings,
) -> dict[int, Rival]:
    """Return the second minima that the noise could have made the worse ones, by index of the taxel."""
    even, _ = row_noise(evidence, found.points, noise)
    # tau^2 <= 4 |A d|^2 max(k^2 even), since D <= even I: beyond this no odds are below the limit.
    slack = 2.0 * np.log(RIVAL_ODDS) * largest(evidence.scales**2 * even, evidence.starts)
    with np.errstate(over="ignore", invalid="ignore"):
        # Within this radius the sum of squares has not risen by the slack yet in the plane's flattest direction.
        steps = np.sqrt(np.sum(plane.inverse * plane.inverse, axis=(0, 1)))
        radius = np.maximum(RIVAL_APART, np.sqrt(slack) * np.where(plane.determined, steps, np.inf))
        # All that fits as well lies within this of the point where the axes meet, wherever the surface is.
        inverse = np.sqrt(np.sum(space.inverse**2, axis=(0, 1)))
        around = np.sqrt(found.values + slack) * inverse + np.sqrt(np.sum((found.points - factors.solutions) ** 2, axis=1))
    some = np.flatnonzero((found.triangles >= 0) & ~(around < radius))
    if not some.size:
        return {}
    best = NearestMany(found.points[some], found.triangles[some], found.values[some])
    limits = (found.values + slack)[some]
    second = second_to_rows(surface, factors.roots[some], factors.offsets[some], pushes[some], best, radius[some], limits)
    rivals: dict[int, Rival] = {}
    for place in np.flatnonzero(second.triangles >= 0).tolist():
        i, other = int(some[place]), second.points[place]
        odds = _odds(evidence.part(i, i + 1), found.points[i], other, float(second.values[place] - found.values[i]), noise)
        if odds < RIVAL_ODDS:
            rivals[i] = Rival(other, int(second.triangles[place]), odds)
    return rivals


def _odds(evidence: Evidence, point: FloatArray, other: FloatArray, worse: float, noise: NoiseSettings) -> float:
    """Return how many times less likely one taxel lies at `other` than at `point`, (3,), where it fits by `worse` less well."""
    if worse <= 0:
        return 1.0
    differ = evidence.scales * (evidence.across @ (other - point)).T
    even, less = row_noise(evidence, point[None], noise)
    scaled = evidence.scales * differ
    variance = 4.0 * float(np.sum(even * (scaled * scaled).sum(axis=0) - (less * scaled).sum(axis=0) ** 2))
    return float(np.exp(np.minimum(2.0 * worse * float(np.sum(differ * differ)) / variance, 700.0)))
