"""Least squares with rows of very different size and columns that are nearly dependent: Householder QR.

Rows are sorted and columns pivoted; `skincal/solver/source/factor.h` says why.

The compiled solver's answers for taxels by themselves: trust, least squares, point on the surface, uncertainty, rivals.

The mathematics stands above the code that does it: `trust.h`, `factor.h`, `search.h`, `rival.h` and `uncertainty.h` in
`skincal/solver/source`. A taxel's numbers depend on its own contacts alone: not by a bit on which others are solved with it.

**Free method** (paper, II-A), without knowing the part's shape: the point nearest to all force axes. p_j minimises
sum k^2 |u x p_j + m/|f||^2 over the contacts of W_j: p_j = -(F' K^2 F)^-1 F' K^2 M, by QR of K F.

**Surface method** (paper, II-B): the surface's point nearest to all force axes. The sum of squares of II-B is
|root p - offset|^2 plus a constant, a metric of this taxel's own evidence; its optimum is found over all triangles at once,
on the side that the pokes push on. One axis is enough: it enters the part at one point.

The covariance lies in the plane of the optimum's triangle, also where the optimum lies on an edge or a vertex: facets belong
to the mesh and not to the part, so an edge does not hold a taxel.

A second minimum elsewhere is a **rival** where the noise could have made it the worse one; `odds_of` in
`skincal/solver/source/solver.c` says how likely that is.

What is said of a taxel here is its state and a `Cause` with numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import NoiseSettings
from skincal.solver.machine import INTEGER, Call, shared
from skincal.taxels.contact_table import Evidence
from skincal.taxels.result import MISS_MAX, SD_MAX, Cause, Estimate, Method, Rival, State, StateReason

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """The essence of t systems: |A p - b|^2 = |root p - offset|^2 + a constant, for each."""

    roots: FloatArray
    """(t, 3, 3) float: triangular but for the order of its columns, which is that of p."""
    offsets: FloatArray
    """(t, 3) float."""
    ranks: IntArray
    """(t,): how many directions of p the rows determine."""
    solutions: FloatArray
    """(t, 3) float: the p of least squares; of the smallest norm where the rows determine fewer than three directions."""
    blind: FloatArray
    """(t, 3) float, unit: the direction that the rows say nothing of, where the rank is 2; else zeros."""


def factor(a: FloatArray, b: FloatArray, starts: IntArray) -> Factors:
    """Minimise |A p - b| over p for each of t systems.

    Parameters
    ----------
    a : (m, 3) float, the rows A of all systems, one after another
    b : (m,) float
    starts : (t + 1,) int: system i has the rows starts[i] to starts[i + 1], at least one
    """
    count = len(starts) - 1
    with shared().call() as call:
        asked = [count, len(b), call.give(starts, INTEGER), call.give(np.concatenate([a.T, b[None]]))]
        roots, rest = call.room((count, 3, 3)), [call.room((count, 3)) for _ in range(3)]
        ranks = call.room((count,), INTEGER)
        call.run("factor", [*asked, roots, *rest, ranks])
        offsets, solutions, blind = (call.taken(place) for place in rest)
        return Factors(call.taken(roots), offsets, call.taken(ranks).astype(np.int64), solutions, blind)


RIVAL_ODDS = 20.0
"""A place that is less than 20 times less likely than the estimate is a rival: the usual 95 %."""
RIVAL_APART = 0.010
"""m. A second minimum nearer than this is of the same place: facets and bends make many, and taxels are 5 mm apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """How well t positions are known, and how far the axes pass them."""

    covariances: FloatArray
    """(t, 3, 3) float, m^2; without meaning where `sds` is infinite."""
    weakest: FloatArray
    """(t, 3) float, unit: the direction known worst."""
    sds: FloatArray
    """(t,) float, metres, along `weakest`; infinite where a direction is not determined at all."""
    misses: FloatArray
    """(t,) float, metres: at what distance the axes pass, the weighted root mean square."""
    rms: FloatArray
    """(t,) float, metres: the predicted error, the root of the covariance's trace."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """The best points of the surface."""

    points: FloatArray
    """(t, 3) float, metres; NaN where there is none."""
    triangles: IntArray
    """(t,) int; -1 where no triangle faces the pokes, and then nothing else has a meaning."""
    uncertain: Uncertainty
    """In the planes of the triangles."""
    rivals: FloatArray
    """(t, 3) float, metres: second minima that the noise could have made the worse ones."""
    rival_triangles: IntArray
    odds: FloatArray
    """(t,) float: how many times less likely the rival is; infinite where there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What the solver says of t taxels."""

    evidence: Evidence
    """With the trust that was found."""
    doubted: list[Mapping[int, float]]
    """For each taxel the pokes whose trust is below 1: number to trust."""
    factors: Factors
    pushes: FloatArray
    """(t, 3) float: the weighted means of the directions, shorter than 1 the more they differ."""
    outward: FloatArray
    """(t, 3) float, unit: against the pushes; without meaning where these cancel."""
    opposed: NDArray[np.bool_]
    """(t,) whether the pushes cancel, so that no side is outward."""
    free: Uncertainty | None
    """Of `factors.solutions`; None where the free method was not asked for."""
    surface: SurfacePoints | None
    """None where the surface method was not asked for."""


def solve(
    evidence: Evidence,
    methods: Collection[Method],
    noise: NoiseSettings,
    surface: Surface | None,
    last: IntArray | None = None,
    doubting: bool = True,
    second: bool = False,
) -> Solution:
    """Solve each taxel of `evidence`.

    Parameters
    ----------
    surface : needed by the surface method
    last : (t,) the triangles of the last answers, -1 where there are none; they make the search shorter and nothing else
    doubting : whether contacts far off the others count less; else all have the trust of `evidence`
    second : whether this is a second thread, beside one that solves, too
    """
    count, answers = len(evidence.channels), len(evidence.weights)
    free = Method.FREE in methods
    machine, place = shared(), 0
    if surface is not None and Method.SURFACE in methods:
        # Imported only now: a scene without a mesh loads nothing of it.
        from skincal.mesh.search import surface_in_solver

        machine, place = surface_in_solver(surface)
    machine = machine.twin() if second else machine
    with machine.call() as call:
        asked = _asked(call, evidence, noise)
        trust = call.changed(evidence.trust)
        starting = call.give(np.full(count, -1) if last is None else last, INTEGER)
        said = call.room((count,), ANSWER)
        call.run("solve", [count, answers, *asked, trust, int(not doubting), int(free), place, starting, said])
        answer, evidence = call.taken(said), evidence.trusted(call.taken(trust))
    return Solution(
        evidence=evidence,
        doubted=evidence.doubted(),
        factors=Factors(answer["root"], answer["offset"], answer["rank"].astype(np.int64), answer["solution"], answer["blind"]),
        pushes=answer["push"],
        outward=answer["outward"],
        opposed=answer["opposed"] != 0,
        free=_known(answer["free"]) if free else None,
        surface=_on_surface(answer) if place else None,
    )


_KNOWN = np.dtype([("covariance", "f8", (3, 3)), ("weakest", "f8", 3), ("sd", "f8"), ("rms", "f8"), ("miss", "f8")])
ANSWER = np.dtype(
    [
        ("root", "f8", (3, 3)), ("offset", "f8", 3), ("solution", "f8", 3), ("blind", "f8", 3), ("rank", "f8"),
        ("push", "f8", 3), ("outward", "f8", 3), ("opposed", "f8"), ("free", _KNOWN),
        ("point", "f8", 3), ("value", "f8"), ("triangle", "f8"), ("held", _KNOWN),
        ("rival", "f8", 3), ("rival_triangle", "f8"), ("odds", "f8"),
    ]
)  # fmt: skip
"""`Answer` of `skincal/solver/source/solver.c`."""


def _asked(call: Call, evidence: Evidence, noise: NoiseSettings) -> list[int]:
    """Return what `Task` in `skincal/solver/source/solver.c` begins with, after the counts."""
    sizes = (noise.force, noise.moment, noise.contact, noise.reach, noise.radius, noise.pose_turn, noise.pose_shift)
    return [
        call.give(evidence.starts, INTEGER),
        call.give(evidence.columns),
        call.give(evidence.weights),
        call.give(evidence.poses, INTEGER),
        call.give(np.array(sizes)),
        call.give(np.array([RIVAL_ODDS, RIVAL_APART])),
    ]


def _known(known: NDArray[Any]) -> Uncertainty:
    return Uncertainty(known["covariance"], known["weakest"], known["sd"], known["miss"], known["rms"])


def _on_surface(answer: NDArray[Any]) -> SurfacePoints:
    return SurfacePoints(
        points=answer["point"],
        triangles=answer["triangle"].astype(np.int64),
        uncertain=_known(answer["held"]),
        rivals=answer["rival"],
        rival_triangles=answer["rival_triangle"].astype(np.int64),
        odds=answer["odds"],
    )


def estimate_free(solution: Solution) -> list[Estimate]:
    """Return each taxel's estimate by the free method; blind where its axes do not fix a point or pass it far off."""
    uncertain = solution.free
    if uncertain is None:
        return []
    evidence, points, ranks = solution.evidence, solution.factors.solutions, solution.factors.ranks
    normals, doubted = solution.outward, solution.doubted
    # Lists, since numbers of arrays one by one take ten times as long.
    numbers = (evidence.channels, evidence.counts, solution.opposed, ranks, uncertain.sds, uncertain.rms, uncertain.misses)
    estimates: list[Estimate] = []
    rows = enumerate(zip(*map(np.ndarray.tolist, numbers), strict=True))
    for i, (channel, contacts, opposed, rank, sd, rms, miss) in rows:
        normal = None if opposed else normals[i]
        if not sd <= SD_MAX:
            estimate = Estimate(
                channel, Method.FREE, State.BLIND, contacts, normal=normal, worst_direction=uncertain.weakest[i],
                sd=sd if np.isfinite(sd) else None, reason=_why_blind_free(evidence.part(i, i + 1), uncertain.weakest[i], sd),
                line_point=points[i] if rank == 2 else None, doubted=doubted[i],
            )  # fmt: skip
        elif miss > MISS_MAX:
            reason = StateReason(Cause.AXES_APART, size=miss)
            estimate = Estimate(channel, Method.FREE, State.BLIND, contacts, normal=normal, reason=reason, doubted=doubted[i])
        else:
            estimate = Estimate(
                channel, Method.FREE, State.ESTIMATED, contacts, position=points[i], normal=normal,
                covariance=uncertain.covariances[i], worst_direction=uncertain.weakest[i], sd=sd, rms=rms, doubted=doubted[i],
            )  # fmt: skip
        estimates.append(estimate)
    return estimates


def _why_blind_free(evidence: Evidence, axis: FloatArray, sd: float) -> StateReason:
    directions = evidence.directions[evidence.trust > 0.0]
    if len(directions) == 1:
        return StateReason(Cause.ONE_AXIS)
    sines = np.linalg.norm(np.cross(directions, axis), axis=1)
    angle = float(np.arctan2(sines, np.abs(directions @ axis)).max())
    return StateReason(Cause.ALIKE_AXES, len(directions), size=sd if np.isfinite(sd) else None, angle=angle)


def estimate_surface(solution: Solution, surface: Surface | None) -> list[Estimate]:
    """Return each taxel's estimate by the surface method.

    Blind where no triangle faces the pokes, where they graze the surface and where their axes miss it.
    """
    found = solution.surface
    if found is None or surface is None:
        return []
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
        reason = _why_blind_on_surface(contacts, cancel, triangle, miss, sd)
        if reason is not None:
            grazing = reason.cause is Cause.GRAZING
            estimate = Estimate(
                channel, Method.SURFACE, State.BLIND, contacts, worst_direction=uncertain.weakest[i] if grazing else None,
                sd=sd if grazing and np.isfinite(sd) else None, reason=reason, doubted=doubted[i],
            )  # fmt: skip
        else:
            estimate = Estimate(
                channel, Method.SURFACE, State.ESTIMATED, contacts, position=found.points[i], normal=normals[i],
                covariance=uncertain.covariances[i], worst_direction=uncertain.weakest[i], sd=sd, rms=rms,
                triangle=triangle, rival=rivals.get(i), doubted=doubted[i],
            )  # fmt: skip
        estimates.append(estimate)
    return estimates


def _why_blind_on_surface(contacts: int, opposed: bool, triangle: int, miss: float, sd: float) -> StateReason | None:
    """Return why a taxel has no estimate; None if it has one."""
    if opposed:
        return StateReason(Cause.OPPOSED, contacts)
    if triangle < 0:
        return StateReason(Cause.NO_TRIANGLE)
    if miss > MISS_MAX:
        return StateReason(Cause.OFF_SURFACE, size=miss)
    # An sd that is not a number is none, either.
    return None if sd <= SD_MAX else StateReason(Cause.GRAZING)
