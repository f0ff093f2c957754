"""Frame of a tip stream, fitted to the force axes.

A robot or a tracker reports the position t_k of the tip in its own fixed frame. The pose (Q, d) of that frame in the sensor's
frame is unknown. In the link frame the tip of poke k is at x_k = L_k (Q t_k + d), with the arm pose L_k. The poke's force axis
passes through it. With the axis's point a_k nearest to the origin and E_k two unit directions across it,

    E_k (x_k - a_k) = 0,   noise D_k + sigma^2 I.

D_k is the sensor's noise at x_k (`skincal.taxels.noise`). sigma is the standard deviation of a tip position, estimated from the
residuals. The pose is found by Gauss-Newton steps from 24 rotations, with Huber's weights for outliers (Huber 1964). The
position along an axis does not matter here: it is what the tip adds (`tip_fusion`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, cross_matrix, mean_rows, orthonormal_pair, rotations
from skincal.model.scene import NoiseSettings
from skincal.pokes import Pokes
from skincal.taxels.noise import row_precision

TIP_FRAME_MIN_POKES = 12
REFIT_AT_POKE_COUNT_RATIO = 1.25
"""Factor of the number of pokes between two fits: a fit moves every taxel, so there are few of them."""
TIP_SD_MIN_M, TIP_SD_MAX_M = 0.0003, 0.010
"""Below the first no tracker measures; above the second the positions are of another frame, or late."""
TIP_FRAME_SHIFT_MAX_SD_M = 0.005
"""sd of the frame's position at the pokes, across the mean push, above which it is not used."""
OTHER_FRAME_MIN_CHI2_INCREASE = 16.0
"""Another pose of the frame must fit this much worse: 4 standard deviations."""
OTHER_POSE_ANGLE_RAD, OTHER_POSE_SHIFT_M = 0.2, 0.02
WRONG_UNIT_IF_SPREAD_RATIO_ABOVE = 20.0
"""Spread of the force axes over that of the tips, or its inverse, above which the unit is wrong."""
START_STEPS, FIT_STEPS = 12, 30
POKES_IN_FIRST_FRAME_GUESS_MAX = 150
HUBER_THRESHOLD_SDS = 2.5
"""Standard deviations beyond which a poke counts less."""


class TipState(Enum):
    """Use of a tip stream."""

    FEW_POKES = "few pokes"
    AMBIGUOUS = "not determined yet"
    USED = "used"
    WRONG_UNIT = "wrong unit"
    DISAGREES = "disagrees"


@dataclass(frozen=True, eq=False)
class TipPokes(Pokes):
    """Pokes whose tip a robot or a tracker reports."""

    tip: FloatArray
    """(n, 3) float, metres, fixed frame."""

    @staticmethod
    def of_contacts(contacts: Sequence[Contact]) -> TipPokes:
        """Collect contacts, which all have a tip position."""
        pokes, tips = Pokes.collect(contacts), np.array([contact.tip for contact in contacts], dtype=np.float64)
        return TipPokes(pokes.number, pokes.force, pokes.moment, pokes.link_from_sensor, pokes.pose, tips.reshape(-1, 3))

    @cached_property
    def pairs(self) -> FloatArray:
        """(n, 2, 3) float: E."""
        return orthonormal_pair(self.direction)

    @cached_property
    def offsets(self) -> FloatArray:
        """(n, 2) float, metres: E (a - o), with o the sensor's origin."""
        return (self.pairs @ (self.axis_point - self.sensor)[:, :, None])[:, :, 0]

    @cached_property
    def turned(self) -> FloatArray:
        """(n, 2, 3) float: E L, rows for a shift in the sensor's frame."""
        return self.pairs @ self.link_from_sensor[:, :3, :3]


@dataclass(frozen=True, slots=True, eq=False)
class TipFrame:
    """Pose of the tip's fixed frame in the sensor's frame, with its covariance."""

    state: TipState
    pokes: int
    """Pokes with a tip position that it was fitted to."""
    rotation: FloatArray
    """(3, 3) float: Q."""
    shift: FloatArray
    """(3,) float, metres: d."""
    centre: FloatArray
    """(3,) float, metres, sensor frame: mean of Q t + d, about which the covariance is."""
    covariance: FloatArray
    """(6, 6) float: of a small rotation (rad) about the centre and a shift of it (m), sensor frame."""
    tip_sd: float
    """m, of one tip position, each direction."""
    ratio: float = 1.0
    """Spread of the force axes over that of the tips: 0.001 for millimetres."""

    @property
    def places_pokes(self) -> bool:
        """Whether the tip alone says where a poke is: its force axis passes the tip, and the wrench gives its direction."""
        return False

    @property
    def shift_sd(self) -> float:
        """m, rms over the directions of the frame's position at the pokes."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:]) / 3.0))

    @property
    def turn_sd(self) -> float:
        """rad, rms over the axes of its rotation."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3]) / 3.0))

    def places(self, pokes: TipPokes) -> tuple[FloatArray, FloatArray]:
        """Compute the tips of pokes, (n, 3), metres, link frame, and (n, 3, 6) their gradients by the six unknowns."""
        turns, there = pokes.link_from_sensor[:, :3, :3], pokes.tip @ self.rotation.T + self.shift
        gradients = np.concatenate([-cross_matrix(there - self.centre), np.broadcast_to(np.eye(3), (len(pokes), 3, 3))], axis=2)
        return (turns @ there[:, :, None])[:, :, 0] + pokes.sensor, turns @ gradients


def pokes_of_fit(count: int) -> int:
    """Count the first pokes that a fit uses: 0 below `TIP_FRAME_MIN_POKES`, then in steps of `REFIT_AT_POKE_COUNT_RATIO`."""
    used = 0 if count < TIP_FRAME_MIN_POKES else TIP_FRAME_MIN_POKES
    while used and int(used * REFIT_AT_POKE_COUNT_RATIO) <= count:
        used = int(used * REFIT_AT_POKE_COUNT_RATIO)
    return used


def fit_tip_frame(contacts: Sequence[Contact], noise: NoiseSettings) -> TipFrame:
    """Fit the frame of the tip positions of contacts, which all have one.

    Parameters
    ----------
    contacts : accepted and not excluded, in the order of their numbers
    noise : of the scene
    """
    none = TipFrame(TipState.FEW_POKES, len(contacts), np.eye(3), np.zeros(3), np.zeros(3), np.eye(6), np.inf)
    if len(contacts) < TIP_FRAME_MIN_POKES:
        return none
    pokes = TipPokes.of_contacts(contacts)
    ratio = _spread(pokes.axis_point) / max(_spread(pokes.tip), 1e-9)
    if not 1.0 / WRONG_UNIT_IF_SPREAD_RATIO_ABOVE < ratio < WRONG_UNIT_IF_SPREAD_RATIO_ABOVE:
        return TipFrame(TipState.WRONG_UNIT, len(contacts), np.eye(3), np.zeros(3), np.zeros(3), np.eye(6), np.inf, ratio)
    turns, shifts = _start_poses(pokes[:: -(-len(contacts) // POKES_IN_FIRST_FRAME_GUESS_MAX)])
    costs = [float(np.median(np.abs(_misses(pokes, turn, shift)))) for turn, shift in zip(turns, shifts, strict=True)]
    best = int(np.argmin(costs))
    fit = _Fit.at(pokes, turns[best], shifts[best], TIP_SD_MAX_M**2, noise)
    for _ in range(FIT_STEPS):
        fit = fit.next(pokes, noise)
    state, sd = TipState.USED, float(np.sqrt(fit.variance))
    if sd > TIP_SD_MAX_M:
        state = TipState.DISAGREES
    elif _across_sd(pokes, fit.covariance) > TIP_FRAME_SHIFT_MAX_SD_M or _has_rival(pokes, fit, turns, shifts):
        state = TipState.AMBIGUOUS
    return TipFrame(state, len(contacts), fit.turn, fit.shift, fit.centre + fit.shift, fit.covariance, sd, ratio)


def _spread(points: FloatArray) -> float:
    """Compute the rms distance of points (n, 3) from their mean."""
    return float(np.linalg.norm(points - mean_rows(points))) / len(points) ** 0.5


def _misses(pokes: TipPokes, turn: FloatArray, shift: FloatArray) -> FloatArray:
    """Compute (n, 2) E (x - a), metres."""
    there = pokes.tip @ turn.T + shift
    return (pokes.turned @ there[:, :, None])[:, :, 0] - pokes.offsets


def _start_poses(pokes: TipPokes) -> tuple[FloatArray, FloatArray]:
    """Fit the frame from each of 24 rotations without weights: (24, 3, 3) and (24, 3), metres."""
    turns: FloatArray = np.array([made for made in _signed_permutations() if np.linalg.det(made) > 0])
    shifts = np.zeros((len(turns), 3))
    rows = pokes.turned.reshape(-1, 3)
    for step in range(START_STEPS):
        turned = pokes.tip @ turns.transpose(0, 2, 1)
        misses = np.einsum("nij,bnj->bni", pokes.turned, turned + shifts[:, None]) - pokes.offsets
        slopes = pokes.turned[None] @ -cross_matrix(turned - turned.mean(axis=1, keepdims=True))
        for b in range(len(turns)):
            if step == 0:  # the place first: far off, a rotation would go astray
                shifts[b] -= np.linalg.lstsq(rows, misses[b].ravel(), rcond=1e-9)[0]
                continue
            both = np.concatenate([slopes[b].reshape(-1, 3), rows], axis=1)
            move = -np.asarray(np.linalg.lstsq(both, misses[b].ravel(), rcond=1e-9)[0], dtype=np.float64)
            turns[b], shifts[b] = _move_frame(turns[b], shifts[b], turned[b].mean(axis=0), move)
    return turns, shifts


def _signed_permutations() -> list[FloatArray]:
    signs, orders = list(itertools.product((1.0, -1.0), repeat=3)), list(itertools.permutations(range(3)))
    return [np.eye(3)[list(order)] * np.array(sign) for order in orders for sign in signs]


def _move_frame(turn: FloatArray, shift: FloatArray, about: FloatArray, move: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotate by move[:3], rad, about the point Q t = `about`, and shift by move[3:], metres."""
    by = rotations(move[None, :3])[0]
    return by @ turn, shift + move[3:] + about - by @ about


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Weighted equations at a pose of the frame."""

    turn: FloatArray
    shift: FloatArray
    variance: float
    """m^2, of a tip position, each direction."""
    centre: FloatArray
    """(3,) float, metres: mean of Q t."""
    weights: FloatArray
    """(n, 2, 2) float, 1/m^2: with Huber's."""
    covariance: FloatArray
    move: FloatArray
    """(6,) float: the Gauss-Newton step."""

    @classmethod
    def at(cls, pokes: TipPokes, turn: FloatArray, shift: FloatArray, variance: float, noise: NoiseSettings) -> _Fit:
        count, turned = len(pokes.tip), pokes.tip @ turn.T
        centre: FloatArray = turned.mean(axis=0)
        lever = (pokes.link_from_sensor[:, :3, :3] @ (turned + shift)[:, :, None])[:, :, 0]
        misses = _misses(pokes, turn, shift)
        precision = row_precision(pokes.pairs, lever, pokes.force_size, np.full(count, variance), noise)
        squares = np.einsum("ni,nij,nj->n", misses, precision, misses)
        trust = np.minimum(1.0, HUBER_THRESHOLD_SDS / np.sqrt(np.maximum(squares, 1e-12)))
        slopes = np.concatenate([pokes.turned @ -cross_matrix(turned - centre), pokes.turned], axis=2)
        weights = precision * trust[:, None, None]
        information = np.einsum("nik,nij,njl->kl", slopes, weights, slopes)
        covariance = np.asarray(np.linalg.pinv(information, hermitian=True, rcond=1e-12), dtype=np.float64)
        move = -covariance @ np.einsum("nik,nij,nj->k", slopes, weights, misses)
        sensor = np.linalg.inv(row_precision(pokes.pairs, lever, pokes.force_size, np.zeros(count), noise))
        freedom = (2.0 * count - 6.0) / (2.0 * count)
        seen = np.sum(misses**2, axis=1) / freedom - np.trace(sensor, axis1=1, axis2=2)
        variance = max(float(trust @ seen / trust.sum()) / 2.0, TIP_SD_MIN_M**2)
        return cls(turn, shift, variance, centre, weights, covariance, move)

    def next(self, pokes: TipPokes, noise: NoiseSettings) -> _Fit:
        """Give the equations after the Gauss-Newton step."""
        return _Fit.at(pokes, *_move_frame(self.turn, self.shift, self.centre, self.move), self.variance, noise)


def _across_sd(pokes: TipPokes, covariance: FloatArray) -> float:
    """Compute the sd, m, of the frame's position in its worst direction across the mean push."""
    across = np.einsum("nij,nik->jk", pokes.turned, pokes.turned) / len(pokes.tip)
    directions = np.linalg.eigh(across)[1][:, 1:]
    return float(np.sqrt(np.linalg.eigvalsh(directions.T @ covariance[3:, 3:] @ directions)[-1]))


def _has_rival(pokes: TipPokes, best: _Fit, turns: FloatArray, shifts: FloatArray) -> bool:
    """Whether one of the other poses, which differs from the best, fits about as well."""

    def chi2(turn: FloatArray, shift: FloatArray) -> float:
        misses = _misses(pokes, turn, shift)
        return float(np.einsum("ni,nij,nj->", misses, best.weights, misses))

    least, centre = chi2(best.turn, best.shift), pokes.tip.mean(axis=0)
    for turn, shift in zip(turns, shifts, strict=True):
        angle = np.arccos(np.clip((np.trace(turn @ best.turn.T) - 1.0) / 2.0, -1.0, 1.0))
        apart = np.linalg.norm((turn - best.turn) @ centre + shift - best.shift)
        is_other = angle > OTHER_POSE_ANGLE_RAD or apart > OTHER_POSE_SHIFT_M
        if is_other and chi2(turn, shift) - least < OTHER_FRAME_MIN_CHI2_INCREASE:
            return True
    return False
