"""Solve taxels one by one in the compiled solver: outliers, least squares, point on the surface, uncertainty, rivals.

The mathematics is explained in `trust.h`, `factor.h`, `search.h`, `cover.h`, `rival.h` and `uncertainty.h` in
`skincal/solver/source`. A taxel's numbers depend on its own contacts alone: not by a bit on which others are solved with it.

**Free method** (paper, II-A), without the part's shape: the point nearest to all force axes. p_j minimises
sum k^2 |u x p_j + m/|f||^2 over the contacts of W_j: p_j = -(F' K^2 F)^-1 F' K^2 M, by QR of K F.

**Surface method** (paper, II-B): the surface's point nearest to all force axes. The sum of squares of II-B is |root p -
offset|^2 plus a constant. Its minimum is found over all triangles that face the pushes. One axis is enough: it enters the part
at one point. The covariance is in the plane of that point's triangle, also on an edge or a vertex: facets belong to the mesh
and not to the part, so an edge does not hold a taxel.

A push enters from outside, so a place under another wall counts less than one under none (`cover.h`).

A second minimum elsewhere is a **rival** if the noise could have made it the worse one (`odds_of` in `solver.c`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import NoiseSettings
from skincal.solver.machine import shared
from skincal.taxels.contact_table import Evidence
from skincal.taxels.noise import noise_in_solver
from skincal.taxels.result import (
    FORCE_AXIS_MAX_MISS_M,
    POSITION_MAX_SD_M,
    Cause,
    Estimate,
    Method,
    Rival,
    State,
    StateReason,
)

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

RIVAL_ESTIMATE_MAX_ODDS = 20.0
"""A rival is less than 20 times less likely than the estimate: the usual 95 %."""
RIVAL_ESTIMATE_MIN_DISTANCE_M = 0.010
"""A second minimum nearer than this is the same place: facets and bends make many, and taxels are 5 mm apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Answer of the solver for t taxels."""

    evidence: Evidence
    """With the trust that was found."""
    doubted: list[Mapping[int, float]]
    """For each taxel the pokes whose trust is below 1: number to trust."""
    answer: NDArray[Any]
    """(t,) `ANSWER` of `skincal/solver/tables.py`."""
    has_free: bool
    has_surface: bool


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
    last : (t,) triangles of the last answers, -1 without one; they shorten the search and change nothing else
    doubting : whether contacts far off the others count less; else all have the trust of `evidence`
    second : whether this thread runs next to another one that solves
    """
    count, has_free = len(evidence.channels), Method.FREE in methods
    machine, place = shared(), 0
    if surface is not None and Method.SURFACE in methods:
        # Imported only now: a scene without a mesh loads nothing of it.
        from skincal.mesh.search import surface_in_solver

        machine, place = surface_in_solver(surface)
    machine = machine.clone_for_thread() if second else machine
    found = machine.run(
        "solve",
        taxels=count,
        answers=len(evidence.weights),
        starts=evidence.starts,
        columns=evidence.columns,
        weights=evidence.weights,
        poses=evidence.poses,
        noise=noise_in_solver(noise),
        rivals={"max_odds": RIVAL_ESTIMATE_MAX_ODDS, "min_distance": RIVAL_ESTIMATE_MIN_DISTANCE_M},
        trust=evidence.trust,
        trusting=not doubting,
        free=has_free,
        surface=place,
        starting=np.full(count, -1) if last is None else last,
        said=(count,),
    )
    evidence = evidence.trusted(found["trust"])
    return Solution(evidence, evidence.doubted(), found["said"], has_free, bool(place))


def _rows(
    solution: Solution, known: NDArray[Any], field: str
) -> Iterator[tuple[int, int, int, bool, int, float, float, float]]:
    """Yield index, channel, contacts, whether pushes cancel, an integer field, sd, rms and miss of each taxel."""
    numbers = (solution.evidence.channels, solution.evidence.counts, solution.answer["opposed"] != 0)
    whole = solution.answer[field].astype(np.int64)
    # Lists, since numbers of arrays one by one take ten times as long.
    columns = map(np.ndarray.tolist, (*numbers, whole, known["sd"], known["rms"], known["miss"]))
    return zip(range(len(whole)), *columns, strict=True)


def estimate_free(solution: Solution) -> list[Estimate]:
    """Make each taxel's estimate by the free method; blind if its axes do not fix a point or pass it too far off."""
    if not solution.has_free:
        return []
    answer, evidence, known = solution.answer, solution.evidence, solution.answer["free"]
    points, outward, covariances, worst = answer["solution"], answer["outward"], known["covariance"], known["worst_direction"]
    estimates: list[Estimate] = []
    for i, channel, contacts, opposed, rank, sd, rms, miss in _rows(solution, known, "rank"):
        normal, doubted = None if opposed else outward[i], solution.doubted[i]
        if not sd <= POSITION_MAX_SD_M:
            estimate = Estimate(
                channel, Method.FREE, State.BLIND, contacts, normal=normal, worst_direction=worst[i],
                sd=sd if np.isfinite(sd) else None, reason=_why_blind_free(evidence.part(i, i + 1), worst[i], sd),
                line_point=points[i] if rank == 2 else None, doubted=doubted,
            )  # fmt: skip
        elif miss > FORCE_AXIS_MAX_MISS_M:
            reason = StateReason(Cause.AXES_APART, size=miss)
            estimate = Estimate(channel, Method.FREE, State.BLIND, contacts, normal=normal, reason=reason, doubted=doubted)
        else:
            estimate = Estimate(
                channel, Method.FREE, State.TOUCHED, contacts, position=points[i], normal=normal,
                covariance=covariances[i], worst_direction=worst[i], sd=sd, rms=rms, doubted=doubted,
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
    """Make each taxel's estimate by the surface method.

    It is blind if no triangle faces the pokes, if they graze the surface, or if their axes pass it too far off.
    """
    if not solution.has_surface or surface is None:
        return []
    answer, known = solution.answer, solution.answer["on_surface"]
    points, covariances, worst = answer["point"], known["covariance"], known["worst_direction"]
    normals = surface.normals[answer["triangle"].astype(np.int64)]
    rivals = {
        i: Rival(answer["rival"][i], int(answer["rival_triangle"][i]), float(answer["odds"][i]))
        for i in np.flatnonzero(np.isfinite(answer["odds"])).tolist()
    }
    estimates: list[Estimate] = []
    for i, channel, contacts, opposed, triangle, sd, rms, miss in _rows(solution, known, "triangle"):
        reason, doubted = _why_blind_on_surface(contacts, opposed, triangle, miss, sd), solution.doubted[i]
        if reason is not None:
            grazing = reason.cause is Cause.GRAZING
            estimate = Estimate(
                channel, Method.SURFACE, State.BLIND, contacts, worst_direction=worst[i] if grazing else None,
                sd=sd if grazing and np.isfinite(sd) else None, reason=reason, doubted=doubted,
            )  # fmt: skip
        else:
            estimate = Estimate(
                channel, Method.SURFACE, State.TOUCHED, contacts, position=points[i], normal=normals[i],
                covariance=covariances[i], worst_direction=worst[i], sd=sd, rms=rms, triangle=triangle,
                rival=rivals.get(i), doubted=doubted,
            )  # fmt: skip
        estimates.append(estimate)
    return estimates


def _why_blind_on_surface(contacts: int, opposed: bool, triangle: int, miss: float, sd: float) -> StateReason | None:
    if opposed:
        return StateReason(Cause.OPPOSED, contacts)
    if triangle < 0:
        return StateReason(Cause.NO_TRIANGLE)
    if miss > FORCE_AXIS_MAX_MISS_M:
        return StateReason(Cause.OFF_SURFACE, size=miss)
    # An sd that is not a number is none, either.
    return None if sd <= POSITION_MAX_SD_M else StateReason(Cause.GRAZING)
