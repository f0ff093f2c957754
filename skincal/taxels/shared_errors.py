"""How errors that many pokes share move estimates: the sensor's matrix and the arm's poses, which no number of pokes averages.

A poke's two rows E (p - a) change by B x with errors x of independent unit variance that all pokes share. The estimate is the
minimum of sum k |E (p - a)|^2 with the weights k of `contact_table`, so the errors move it by

    dp = M x,   M = -H^-1 sum k E'B,   H = sum k E'E,

on a surface in the plane of its triangle alone. The covariance of all estimates together is that of the pokes' own noise and
M M'. What is the same in the M of all taxels shifts the whole skin; the rest moves taxels against each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.taxels.contact_table import ContactTable, across
from skincal.taxels.result import Estimate, Method

SharedRows: TypeAlias = Callable[[IntArray, FloatArray, FloatArray], FloatArray]
"""Of pokes by number (m,), with the places (m, 3), metres, that they are said to touch and the directions E (m, 2, 3) across
their pushes, link frame: B (m, 2, n), metres for each of n shared errors in its standard deviations."""


def moved_taxels(table: ContactTable, estimates: Sequence[Estimate], shared: SharedRows) -> list[Estimate]:
    """Return the estimates of one method of `PER_TAXEL`, of different channels, with what shared errors add to them.

    Parameters
    ----------
    table : that they were solved from
    """
    known = sorted((estimate for estimate in estimates if estimate.position is not None), key=lambda estimate: estimate.channel)
    if not known:
        return list(estimates)
    evidence = table.evidence([estimate.channel for estimate in known])
    trust = np.ones(len(evidence.pokes))
    for row, estimate in enumerate(known):
        if estimate.doubted:
            own = slice(*evidence.starts[row : row + 2].tolist())
            trust[own] = [estimate.doubted.get(poke, 1.0) for poke in evidence.pokes[own].tolist()]
    places = np.array([estimate.position for estimate in known])[evidence.taxels]
    pairs, across_push = evidence.pairs, evidence.pairs.transpose(0, 2, 1)
    pull = shared(evidence.pokes, places, pairs)
    weights = (trust * evidence.weights**2)[:, None, None]
    held, pulled = (np.add.reduceat(weights * (across_push @ rest), evidence.starts[:-1]) for rest in (pairs, pull))
    free = np.tile(np.eye(3), (len(known), 1, 1))
    if known[0].method is Method.SURFACE:
        free = across(np.array([estimate.normal for estimate in known])).transpose(0, 2, 1)
    inner = free.transpose(0, 2, 1)
    moves = -free @ np.linalg.solve(inner @ held @ free, inner @ pulled)
    moved = {estimate.channel: with_shared(estimate, move) for estimate, move in zip(known, moves, strict=True)}
    return [moved.get(estimate.channel, estimate) for estimate in estimates]


def with_shared(estimate: Estimate, moved: FloatArray) -> Estimate:
    """Return an estimate whose covariance has what shared errors `moved` (3, n), metres, add."""
    if estimate.covariance is None:
        return estimate
    covariance = estimate.covariance + moved @ moved.T
    values, axes = np.linalg.eigh(covariance)
    worst = axes[:, -1]
    return replace(
        estimate,
        covariance=covariance,
        weakest=worst * np.copysign(1.0, worst[np.abs(worst).argmax()]),
        sd=float(np.sqrt(values[-1])),
        rms=float(np.sqrt(np.trace(covariance))),
        moved=moved,
    )


@dataclass(frozen=True, slots=True)
class PredictedError:
    """The predicted error of a skin, told apart; root mean squares over its taxels, metres."""

    whole: float
    """By how much the skin may be shifted as a whole."""
    among: float
    """By how much taxels may lie wrong among each other."""
    every: float
    """Both together."""


def predicted_error(estimates: Sequence[Estimate]) -> PredictedError | None:
    """Return the predicted error of the taxels that are estimated, told apart; None where none is."""
    known = [estimate for estimate in estimates if estimate.rms is not None]
    if not known:
        return None
    every = float(np.mean([(estimate.rms or 0.0) ** 2 for estimate in known]))
    moves = [estimate.moved for estimate in known if estimate.moved is not None]
    whole = 0.0
    if moves:
        width = max(move.shape[1] for move in moves)
        mean = np.sum([np.pad(move, ((0, 0), (0, width - move.shape[1]))) for move in moves], axis=0) / len(known)
        whole = float(np.sum(mean**2))
    return PredictedError(float(np.sqrt(whole)), float(np.sqrt(max(every - whole, 0.0))), float(np.sqrt(every)))
