"""The poses of rigid boards: each module's least squares over all its pokes.

A poke's middle c (`touches.py`) has two rows, r = E (a - c), with the covariance

    D = E N E' + s^2 (I - o o'),   o = E n,

N the sensor's noise at the lever of c (`uncertainty.h`), s how far a contact lies beside the middle, in the skin with the
normal n. In units of L^-1, D = L L', the sum of squares is minimised over the board's unknowns by Gauss and Newton's steps,
each by QR of the rows (their condition is never squared), with the singular values of the small factor telling which
directions the pokes determine.

Trust is that of `trust.h`, for the whole board: a poke far off what the others say counts less, measured against the board's
own spread. The others are those of the same arm pose, where they are enough: a pose that is told wrong shifts all its pokes,
and none of them is to blame.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.estimate.boards import Boards, Pads, Poses
from skincal.estimate.touches import Touches
from skincal.readings import FloatArray, IntArray
from skincal.scene import NoiseSettings
from skincal.wrench import cross_matrix

BoolArray: TypeAlias = NDArray[np.bool_]

FULL, NONE = 2.8, 3.8
"""Standard deviations up to which a poke counts fully, and from which on not at all: as in `trust.h`."""
FEWEST = 4
"""Pokes of a board below which all count fully."""
OF_POSE = 8
"""Pokes of a board in one arm pose from which on they are judged by themselves: twice the fewest."""
LEFT = 2.0
"""Sum of the trust below which all count fully: nobody can tell which one is right."""
ALIKE = 2.0
"""Standard deviations up to which all pokes pull alike while the pose is sought."""
SEEKING = 4
"""Steps of that search before trust is told."""
SMALL = 6.0
"""A spread found from few misses is raised by this over its 2 n - 3 degrees of freedom."""
USUAL_MISS, USUAL_PITCH = 1.3863, 0.4549
"""Medians of chi-square with two degrees of freedom and with one."""
STEP_MAX = 0.015
"""m, of one step: half a module. Farther off the rows say little of where the minimum is."""
SETTLED = 1e-7
"""m: a step below it is none, a thousandth of how well the best module is known."""
STEPS_MAX = 20
"""A pose that moves after so many steps goes to and fro over an edge of the surface, by less than matters."""
NO_RANK = 1e-9
"""Singular values below this share of the largest: what they belong to, the pokes do not determine."""


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The whitened rows of m pokes."""

    slopes: FloatArray
    """(m, 2, d) float, 1/m: change of the middle across the push with the board's unknowns, in standard deviations."""
    misses: FloatArray
    """(m, 2) float: how far the axis passes the middle, in standard deviations."""
    pitches: FloatArray
    """(m,) float: squared pitch, in standard deviations."""
    whiten: FloatArray
    """(m, 2, 2) float, 1/m: L^-1."""
    distances: FloatArray
    """(m,) float, metres: how far the axis passes the middle."""
    levers: FloatArray
    """(m, 3) float, metres: from the sensor to the middle."""


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """The poses of b boards."""

    poses: Poses
    pads: Pads
    """Of all boards, one after another."""
    of: IntArray
    """(n,) the board of each pad, 0 to b - 1."""
    covariances: FloatArray
    """(b, d, d) float, m^2, of the unknowns (a turn as the way at `LEVER`); infinite along `blind`."""
    blind: tuple[FloatArray, ...]
    """For each board (k, d) the directions of its unknowns that the pokes do not determine."""
    misses: FloatArray
    """(b,) float, metres: at what distance the axes pass the middles, the root mean square by trust."""
    trust: FloatArray
    """(m,) float, 0 to 1, of each poke."""


def fit_boards(touches: Touches, boards: Boards, start: Poses, noise: NoiseSettings, doubting: bool = True) -> Fitted:
    """Find the poses of the boards of `touches`.

    Parameters
    ----------
    start : of each board; within half a module and 60 degrees
    doubting : whether pokes far off the others count less
    """
    ends = np.searchsorted(touches.of, np.arange(len(touches.boards) + 1)).tolist()
    spans = [slice(a, b) for a, b in pairwise(ends)]
    modules: list[int] = touches.boards.tolist()
    own = [boards.pads[module] for module in modules]
    of, flat = np.repeat(np.arange(len(own)), [len(pads) for pads in own]), np.concatenate(own)
    trust = np.ones(len(touches.of))
    poses, going = start, np.ones(len(spans), dtype=bool)
    for turn in range(STEPS_MAX):
        rows = whitened(touches, boards.ground.laid(poses.take(of), flat), noise)
        if doubting and turn == 0:
            trust = np.concatenate([_trust_of(rows, span, touches) for span in spans])
        steps = np.stack([_step(rows.slopes[span], rows.misses[span], trust[span]) for span in spans])
        # Who has settled stays to the last bit, however many steps the others take.
        going &= np.abs(steps).max(axis=1) > SETTLED
        if not going.any():
            break
        poses = _either(going, boards.ground.moved(poses, steps), poses)
    return _fitted(touches, boards, poses, (of, flat), trust, spans, noise)


def _either(first: BoolArray, one: Poses, other: Poses) -> Poses:
    rows = first[:, None]
    return Poses(
        np.where(rows, one.points, other.points),
        np.where(rows, one.x, other.x),
        np.where(rows, one.normals, other.normals),
        np.where(first, one.triangles, other.triangles),
    )


def whitened(touches: Touches, pads: Pads, noise: NoiseSettings) -> Rows:
    """Return the rows of pokes whose boards have their pads at `pads`."""
    evidence, at = touches.evidence, touches.rows
    places, gradients, normals = touches.middles(pads)
    pairs, forces = evidence.pairs[at], evidence.forces[at]
    lever = places - evidence.sensors[at]
    relative = noise.force / forces
    even = (noise.moment / forces) ** 2 + relative**2 * np.sum(lever * lever, axis=1) + touches.offsets
    along = np.sum(pairs * lever[:, None], axis=2)
    less = relative[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1)
    out = np.sqrt(touches.offsets)[:, None] * np.sum(pairs * normals[:, None], axis=2)
    whiten = _inverse_root(
        even - less[:, 0] ** 2 - out[:, 0] ** 2,
        -less[:, 0] * less[:, 1] - out[:, 0] * out[:, 1],
        even - less[:, 1] ** 2 - out[:, 1] ** 2,
    )
    off = np.sum(pairs * (evidence.nearest[at] - places)[:, None], axis=2)
    slopes = np.sum(pairs[:, :, :, None] * gradients[:, None], axis=2)
    pitch_square = (noise.moment / forces) ** 2 + np.sum(less * less, axis=1)
    return Rows(
        slopes=np.sum(whiten[:, :, :, None] * slopes[:, None], axis=2),
        misses=np.sum(whiten * off[:, None], axis=2),
        pitches=evidence.pitches[at] ** 2 / pitch_square,
        whiten=whiten,
        distances=np.sqrt(np.sum(off * off, axis=1)),
        levers=lever,
    )


def _inverse_root(xx: FloatArray, xy: FloatArray, yy: FloatArray) -> FloatArray:
    """Return (m, 2, 2) L^-1 of D = L L' with the entries given, L lower triangular."""
    l11 = np.sqrt(xx)
    l21 = xy / l11
    l22 = np.sqrt(yy - l21 * l21)
    inverse = np.zeros((len(xx), 2, 2))
    inverse[:, 0, 0], inverse[:, 1, 0], inverse[:, 1, 1] = 1.0 / l11, -l21 / (l11 * l22), 1.0 / l22
    return inverse


def _trust_of(rows: Rows, span: slice, touches: Touches) -> FloatArray:
    """Return the trust of one board's pokes, each judged among those of its arm pose, or among all that are left over."""
    poses = touches.evidence.poses[touches.rows[span]]
    names, owner, sizes = np.unique(poses, return_inverse=True, return_counts=True)
    group = np.where(sizes >= OF_POSE, np.arange(len(names)), -1)[owner]
    trust = np.ones(len(poses))
    for own in np.unique(group):
        some = np.flatnonzero(group == own)
        at = some + span.start
        trust[some] = _found_trust(rows.slopes[at], rows.misses[at], rows.pitches[at])
    return trust if trust.sum() >= LEFT else np.ones(len(poses))


def _found_trust(slopes: FloatArray, misses: FloatArray, pitches: FloatArray) -> FloatArray:
    """Return the trust of some of a board's pokes, by steps that far ones pull little in, from where it stands."""
    count = len(misses)
    if count < FEWEST:
        return np.ones(count)
    raised = 1.0 + SMALL / max(2 * count - 3, 1)
    pitches = pitches / max(1.0, raised * float(np.median(pitches)) / USUAL_PITCH)
    left = misses
    for _ in range(SEEKING):
        squares = np.sum(left * left, axis=1) + pitches
        move = _step(slopes, left, 1.0 / np.maximum(squares, ALIKE**2))
        left = left - np.sum(slopes * move, axis=2)
    squares = np.sum(left * left, axis=1)
    squares = squares / max(1.0, raised * float(np.median(squares)) / USUAL_MISS) + pitches
    rest = np.clip((NONE - np.sqrt(squares)) / (NONE - FULL), 0.0, 1.0)
    trust = np.where(squares > FULL**2, rest * rest * (3.0 - 2.0 * rest), 1.0)
    return trust if trust.sum() >= LEFT else np.ones(count)


def _step(slopes: FloatArray, misses: FloatArray, trust: FloatArray) -> FloatArray:
    """Return (d,) the step to the minimum, of the smallest norm where the rows do not determine one, and not too long."""
    singular, axes, right = _decomposed(slopes, misses, trust)
    good = singular > NO_RANK * singular[0]
    step = axes[good].T @ (right[good] / singular[good])
    longest = np.abs(step).max(initial=0.0)
    return step if longest <= STEP_MAX else step * (STEP_MAX / longest)


def _decomposed(slopes: FloatArray, misses: FloatArray, trust: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return singular values (d,), their directions (d, d) as rows and right sides (d,) of the weighted rows."""
    unknowns = slopes.shape[-1]
    root = np.sqrt(trust)[:, None]
    rows = np.concatenate([(root[:, :, None] * slopes).reshape(-1, unknowns), (root * misses).reshape(-1, 1)], axis=1)
    # Rows of nought make the factor whole where there are fewer rows than unknowns.
    rows = np.concatenate([rows, np.zeros((max(unknowns - len(rows), 0), unknowns + 1))])
    factor: Any = np.linalg.qr(rows, mode="r")
    left, singular, axes = np.linalg.svd(factor[:unknowns, :unknowns])
    return singular, axes, left.T @ factor[:unknowns, unknowns]


def _fitted(
    touches: Touches, boards: Boards, poses: Poses, laying: tuple[IntArray, FloatArray], trust: FloatArray,
    spans: list[slice], noise: NoiseSettings,
) -> Fitted:  # fmt: skip
    of, flat = laying
    pads = boards.ground.laid(poses.take(of), flat)
    rows = whitened(touches, pads, noise)
    covariances: list[FloatArray] = []
    blind: list[FloatArray] = []
    misses: list[float] = []
    for span in spans:
        covariance, dark = _spread(touches, rows, span, trust[span], noise)
        covariances.append(covariance)
        blind.append(dark)
        weights = trust[span]
        misses.append(float(np.sqrt(np.sum(weights * rows.distances[span] ** 2) / max(weights.sum(), 1e-300))))
    return Fitted(poses, pads, of, np.stack(covariances), tuple(blind), np.array(misses), trust)


def _spread(
    touches: Touches, rows: Rows, span: slice, trust: FloatArray, noise: NoiseSettings
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance (d, d) of a board's unknowns and the directions (k, d) that are not determined."""
    slopes = rows.slopes[span]
    singular, axes, _ = _decomposed(slopes, rows.misses[span], trust)
    good = singular > NO_RANK * singular[0]
    inverse = axes[good].T / singular[good]
    covariance = inverse @ inverse.T
    if noise.pose_turn > 0 or noise.pose_shift > 0:
        gain = covariance @ (trust[:, None, None] * slopes).reshape(-1, slopes.shape[-1]).T
        covariance = covariance + _of_poses(touches, rows, span, gain, noise)
    return covariance, axes[~good]


def _of_poses(touches: Touches, rows: Rows, span: slice, gain: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Return (d, d) what errors of the arm's poses add, each one for all pokes in it (`NoiseSettings.pose_turn`)."""
    evidence, at = touches.evidence, touches.rows[span]
    pairs = evidence.pairs[at]
    # A pose turned by w about the sensor and shifted by t moves the axis by w x lever + t.
    moved = np.concatenate([-noise.pose_turn * (pairs @ cross_matrix(rows.levers[span])), noise.pose_shift * pairs], axis=2)
    moved = (rows.whiten[span] @ moved).reshape(-1, 6)
    added = np.zeros((len(gain), len(gain)))
    owners = np.repeat(evidence.poses[at], 2)
    for pose in np.unique(owners):
        own = owners == pose
        part = gain[:, own] @ moved[own]
        added += part @ part.T
    return added
