"""What the compiled solver makes of the evidence: trust, least squares, the point on the surface, uncertainty, rivals.

The mathematics stands above the code that does it: `trust.h`, `factor.h`, `search.h`, `rival.h` and `uncertainty.h` in
`skincal/solver/source`. A taxel's numbers depend on its own contacts alone: not by a bit on which others are solved with it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skincal.estimate.evidence import Evidence
from skincal.estimate.qr import Factors
from skincal.estimate.result import Method
from skincal.readings import FloatArray, IntArray
from skincal.scene import NoiseSettings
from skincal.solver.machine import INTEGER, Call, shared

if TYPE_CHECKING:
    from skincal.surface.mesh import Surface

RIVAL_ODDS = 20.0
"""A place that is less than 20 times less likely than the estimate is a rival: the usual 95 %."""
RIVAL_APART = 0.010
"""m. A second minimum nearer than this is of the same place: facets and bends make many, and taxels are 5 mm apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Uncertain:
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
class OnSurface:
    """The best points of the surface."""

    points: FloatArray
    """(t, 3) float, metres; NaN where there is none."""
    triangles: IntArray
    """(t,) int; -1 where no triangle faces the pokes, and then nothing else has a meaning."""
    uncertain: Uncertain
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
    doubted: list[dict[int, float]]
    """For each taxel the pokes whose trust is below 1: number to trust."""
    factors: Factors
    pushes: FloatArray
    """(t, 3) float: the weighted means of the directions, shorter than 1 the more they differ."""
    outward: FloatArray
    """(t, 3) float, unit: against the pushes; without meaning where these cancel."""
    opposed: NDArray[np.bool_]
    """(t,) whether the pushes cancel, so that no side is outward."""
    free: Uncertain | None
    """Of `factors.solutions`; None where the free method was not asked for."""
    surface: OnSurface | None
    """None where the surface method was not asked for."""


def solve(
    evidence: Evidence,
    methods: Collection[Method],
    noise: NoiseSettings,
    surface: Surface | None,
    last: IntArray | None = None,
    doubting: bool = True,
) -> Solution:
    """Solve each taxel of `evidence`.

    Parameters
    ----------
    surface : needed by the surface method
    last : (t,) the triangles of the last answers, -1 where there are none; they make the search shorter and nothing else
    doubting : whether contacts far off the others count less; else all have the trust of `evidence`
    """
    count, answers = len(evidence.channels), len(evidence.weights)
    free = Method.FREE in methods
    machine, place = shared(), 0
    if surface is not None and Method.SURFACE in methods:
        # Only now: a scene without a mesh loads nothing of it.
        from skincal.surface.resident import resident

        machine, place = resident(surface)
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
    sizes = (
        noise.force, noise.moment, noise.contact, noise.reach, noise.radius, noise.pose_turn, noise.pose_shift
    )  # fmt: skip
    return [
        call.give(evidence.starts, INTEGER),
        call.give(evidence.columns),
        call.give(evidence.weights),
        call.give(evidence.poses, INTEGER),
        call.give(np.array(sizes)),
        call.give(np.array([RIVAL_ODDS, RIVAL_APART])),
    ]


def _known(known: NDArray[Any]) -> Uncertain:
    return Uncertain(known["covariance"], known["weakest"], known["sd"], known["miss"], known["rms"])


def _on_surface(answer: NDArray[Any]) -> OnSurface:
    return OnSurface(
        points=answer["point"],
        triangles=answer["triangle"].astype(np.int64),
        uncertain=_known(answer["held"]),
        rivals=answer["rival"],
        rival_triangles=answer["rival_triangle"].astype(np.int64),
        odds=answer["odds"],
    )
