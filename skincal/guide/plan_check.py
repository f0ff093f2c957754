"""Check of a skin's plan: whether the pads of its modules lie where their kind says.

A poke passes the centre of the pads that answered, sum s_j P_j. Pads that are off their plan by d_j shift it by sum s_j d_j,
the same for all pokes of a pad. The misses of predicted pokes, whitened by the poke's own noise, are modelled as

    b = A (c + d + R t) + e,   c ~ N(0, `COMMON_SD_M`^2),   d ~ N(0, v),   t ~ N(0, `MODULE_MOTION_SD_M`^2),   e ~ N(0, s^2).

c is the same in all modules of a kind, for each pad: the centre of the answers misses the press in the same way there. R t
moves a module as a whole. With N = A'A/s^2, h = A'b/s^2 and V the covariance of d + R t, a module's part of the likelihood of c
has the information N (I + V N)^-1 and the pull (I + N V)^-1 h. The pads are off if some v makes the misses likelier than v = 0
by `MIN_LOG_LIKELIHOOD_GAIN`. Pokes that many pads or two modules answer do not count: on a skin that spreads a press far, the
centre of the answers depends on the neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.chi_square import CHI2_1DOF_MEDIAN
from skincal.geometry import FloatArray, IntArray, crossed
from skincal.modules.pose import MODULE_TURN_TO_LENGTH_RADIUS_M, ModuleModel
from skincal.modules.pose_fit import Fitted, Touches
from skincal.taxels.predictions import PokePredictions

MIN_LOG_LIKELIHOOD_GAIN = 2.5
"""Pads on their plan gain more by chance in 1 of 80 sessions: half of P(chi2(1) > 5)."""
MAX_ANSWERS = 4
"""Pads that answered a poke, at most."""
COMMON_SD_M = 0.002
"""sd of the distance between press and centre of the answers, in each direction: as for one pad in `offset_variances`."""
MODULE_MOTION_SD_M = 0.003
PAD_SDS_M = (0.0, 0.0003, 0.0004, 0.0005, 0.0006, 0.0008, 0.001, 0.0013, 0.0016, 0.002)
"""Tried distances of pads from their plan, sd in each direction; the first one is "on their plan"."""
NOISE_FACTORS = (0.8, 0.9, 1.0, 1.1, 1.2)
"""Tried noise s, over that of the median miss."""


@dataclass(frozen=True, slots=True, eq=False)
class ModuleMisses:
    """Whitened misses of the pokes on one module, summed up for `log_likelihood`; p pads."""

    motions: FloatArray
    """(2p, 3) float: shifts of the pads by motions of the module in its plane, R."""
    information: FloatArray
    """(2p, 2p) float, 1/m^2: A'A."""
    pull: FloatArray
    """(2p,) float, 1/m: A'b."""
    square: float
    """b'b."""
    count: int
    """Length of b."""


def log_likelihood(modules: Sequence[ModuleMisses], pad_sd: float, noise: float) -> float:
    """Compute the log likelihood of the misses of modules of one kind, up to a constant; `pad_sd` in metres."""
    size = len(modules[0].pull)
    unit, held, pull, total = np.eye(size), np.eye(size) / COMMON_SD_M**2, np.zeros(size), 0.0
    for own in modules:
        spread = pad_sd**2 * unit + MODULE_MOTION_SD_M**2 * own.motions @ own.motions.T
        information, side = own.information / noise**2, own.pull / noise**2
        known = np.linalg.inv(unit + information @ spread)
        freed = known @ side
        held, pull = held + known @ information, pull + freed
        total += own.square / noise**2 - float(side @ spread @ freed) + 2.0 * own.count * float(np.log(noise))
        total -= float(np.linalg.slogdet(known)[1])
    total += float(np.linalg.slogdet(COMMON_SD_M**2 * held)[1]) - float(pull @ np.linalg.solve(held, pull))
    return -0.5 * total


def find_taxels_off_plan(
    touches: Touches, fitted: Fitted, model: ModuleModel, at: IntArray, predicted: PokePredictions, answers: IntArray
) -> float | None:
    """Find the distance of taxels from the plan of their modules, sd in each direction, metres; `None` without evidence.

    Parameters
    ----------
    at : (n,) indices of the touches that are `predicted`
    answers : (n,) number of taxels that answered each poke of `at`, on all modules
    """
    ends = np.append(touches.starts, len(touches.answers))
    misses, own = predicted.misses, predicted.own
    used = np.isfinite(misses).all(axis=1) & (answers <= MAX_ANSWERS) & (np.diff(ends)[at] == answers)
    of_kind: dict[int, list[ModuleMisses]] = {}
    every = [np.empty(0)]
    indices: list[int] = touches.modules.tolist()
    for b, index in enumerate(indices):
        module, pads = model.layout.modules[index], np.flatnonzero(fitted.of == b)
        rows, sign = np.flatnonzero(used & (touches.of[at] == b)), -1.0 if module.mirror else 1.0
        if not len(rows):
            continue
        touched = at[rows]
        shares = np.zeros((len(rows), len(pads)))
        for row, (start, end) in enumerate(zip(ends[touched].tolist(), ends[touched + 1].tolist(), strict=True)):
            shares[row, touches.answers[start:end] - pads[0]] = touches.shares[start:end]
        whiten = np.linalg.inv(np.linalg.cholesky(own[rows])) * np.sqrt(fitted.trust[touched])[:, None, None]
        across = whiten @ touches.evidence.pairs[touches.rows[touched]]
        moved = np.einsum("kac,jdc,kj->kajd", across, _pad_axes(fitted, b, sign), shares)
        slopes, sides = moved.reshape(2 * len(rows), -1), (whiten @ misses[rows][:, :, None]).ravel()
        every.append(sides)
        motions = _motions(model.pads[index] * np.array([sign, 1.0]))
        summed = ModuleMisses(motions, slopes.T @ slopes, slopes.T @ sides, float(sides @ sides), len(sides))
        of_kind.setdefault(id(module.kind), []).append(summed)
    joined = np.concatenate(every)
    return _find_pad_sd(list(of_kind.values()), float(np.median(joined**2))) if joined.any() else None


def _find_pad_sd(kinds: Sequence[Sequence[ModuleMisses]], median: float) -> float | None:
    """Find the likeliest sd of pads about their plan, metres; `None` if it may be 0. `median` is that of the squared misses."""
    typical = float(np.sqrt(median / CHI2_1DOF_MEDIAN))
    found = [
        max(sum(log_likelihood(modules, sd, typical * factor) for modules in kinds) for factor in NOISE_FACTORS)
        for sd in PAD_SDS_M
    ]
    best = int(np.argmax(found))
    return PAD_SDS_M[best] if found[best] - found[0] >= MIN_LOG_LIKELIHOOD_GAIN else None


def _pad_axes(fitted: Fitted, module: int, sign: float) -> FloatArray:
    """Compute (p, 2, 3) the unit axes of a module's plan at its pads; x is turned by `sign`, as in a mirrored module."""
    normals = fitted.pads.normals[fitted.of == module]
    x = fitted.poses.x[module] - (normals @ fitted.poses.x[module])[:, None] * normals
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([sign * x, crossed(normals, x)], axis=1)


def _motions(flat: FloatArray) -> FloatArray:
    """Make the motions of a module with pads at `flat` (p, 2) in its plane: two shifts and a turn."""
    ones, zeros = np.ones(len(flat)), np.zeros(len(flat))
    turn = np.stack([-flat[:, 1], flat[:, 0]], axis=1) / MODULE_TURN_TO_LENGTH_RADIUS_M
    shifts = [np.stack(each, axis=1) for each in ((ones, zeros), (zeros, ones))]
    return np.stack([each.ravel() for each in (*shifts, turn)], axis=1)
