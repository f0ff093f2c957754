"""The poses of rigid boards: each module's least squares over all its pokes.

The sum of squares of the whitened rows A, b (`board_rows.py`) is minimised over the board's unknowns, the noise taken as it is
at the pose. Gauss and Newton's step comes from QR of the rows (their condition is never squared), with the singular values of
the small factor telling which directions the pokes determine. Alone it converges by a constant share each time, and goes to
and fro by millimetres where the pokes tell little of a board's tilt. So how the rows turn with the board is heeded as well,
B (`bends_of`), of the misses that the step would leave:

    step = R^-1 (I - R'^-1 B R^-1)^-1 Q'b,   A = Q R,

where that matrix is positive, else R^-1 Q'b. Both are nought at the same pose, where A'b is: B has no say in the answer, only
in how soon it is found.

Trust is that of `trust.h`, for the whole board: a poke far off what the others say counts less, measured against the board's
own spread. The others are those of the same arm pose, where they are enough: a pose that is told wrong shifts all its pokes,
and none of them is to blame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.estimate.board_rows import Rows, bends_of, whitened
from skincal.estimate.boards import Boards, Pads, Poses
from skincal.estimate.qr import triangle
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
"""m, of one step in each direction: half a module. Farther off the rows say little of where the minimum is."""
SETTLED = 1e-7
"""m: steps below it that no longer shrink to half are rounding."""
DONE = 2e-17
"""m: where the next step would be below this, it is none: the last digit of a place two decimetres away."""
HOLDS = 0.25
"""The least curvature, over that of the rows alone, at which it shapes the step: below, a saddle is near."""
BACK = 0.25
"""A step that takes back this share of the one before is halved: both go too far."""
STEPS_MAX = 20
"""A pose that moves after so many steps goes to and fro over an edge of the surface, by micrometres; or, without a surface,
runs off where few pokes hardly tell how the board is tilted."""
NO_RANK = 1e-9
"""Singular values below this share of the largest: what they belong to, the pokes do not determine."""


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
    moving: FloatArray
    """(b,) float, metres: the last step of a pose that has not settled; 0 of one that has."""


def fit_boards(touches: Touches, boards: Boards, start: Poses, noise: NoiseSettings, doubting: bool = True) -> Fitted:
    """Find the poses of the boards of `touches`.

    Parameters
    ----------
    start : of each board; within half a module and 60 degrees
    doubting : whether pokes far off the others count less
    """
    search = _Search(touches, boards, start, noise)
    if doubting:
        search.trust = np.concatenate([_trust_of(search.rows, span, touches) for span in search.spans])
    for _ in range(STEPS_MAX):
        search.step()
        if not search.going.any():
            break
    held = search.found()
    return Fitted(
        search.poses,
        search.pads,
        search.of,
        np.stack([_covariance(touches, one, search.trust, noise) for one in held]),
        tuple(one.blind for one in held),
        np.array([_miss(one, search.trust) for one in held]),
        search.trust,
        search.moving,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """How the rows hold one board where it stands, in the k directions of its unknowns that they determine."""

    singular: FloatArray
    """(k,) float, 1/m: how firmly."""
    axes: FloatArray
    """(k, d) float, unit: these directions."""
    right: FloatArray
    """(k,) float: how far off along them, in standard deviations."""
    blind: FloatArray
    """(d - k, d) float, unit: the others."""
    rows: Rows
    """Of all boards."""
    span: slice
    """Its own among them."""

    @property
    def inverse(self) -> FloatArray:
        """(d, k) float, metres: its square is the covariance of the unknowns."""
        return self.axes.T / self.singular

    def left(self) -> FloatArray:
        """Return (m, 2) what would be left of the board's misses if its rows did not turn, however far it had to go."""
        return self.rows.misses[self.span] - np.sum(self.rows.slopes[self.span] * (self.inverse @ self.right), axis=2)


class _Search:
    """Boards on their way to where the rows hold them best; who is there stays, however many steps the others take."""

    def __init__(self, touches: Touches, boards: Boards, start: Poses, noise: NoiseSettings) -> None:
        ends = np.searchsorted(touches.of, np.arange(len(touches.boards) + 1)).tolist()
        self.spans = [slice(a, b) for a, b in pairwise(ends)]
        modules: list[int] = touches.boards.tolist()
        own = [boards.pads[module] for module in modules]
        self.of, self._flat = np.repeat(np.arange(len(own)), [len(pads) for pads in own]), np.concatenate(own)
        self._touches, self._ground, self._noise = touches, boards.ground, noise
        self.trust = np.ones(len(touches.of))
        self.poses, self.pads = start, self._laid(start)
        self.rows = whitened(touches, self.pads, noise)
        self.going = np.ones(len(own), dtype=bool)
        self._before, self._last = np.zeros((len(own), boards.ground.unknowns)), np.full(len(own), STEP_MAX)
        self._held: list[_Held | None] = [None] * len(own)

    def _laid(self, poses: Poses) -> Pads:
        return self._ground.laid(poses.take(self.of), self._flat)

    def step(self) -> None:
        """Move the boards that are still going, each by one step; the last one is too short to be walked."""
        held = self.found()
        left = np.concatenate([one.left() for one in held])
        bends = bends_of(self._touches, replace(self.rows, misses=left), self._ground)
        steps = np.stack([_newton(one, bends[one.span], self.trust[one.span]) for one in held])
        back = np.sum(steps * self._before, axis=1) < -BACK * np.sum(self._before * self._before, axis=1)
        steps = np.where(back[:, None], 0.5, 1.0) * steps
        sizes = np.abs(steps).max(axis=1)
        settled = (sizes <= SETTLED) & ((sizes * sizes <= DONE * self._last) | (2.0 * sizes >= self._last))
        # Who is there stays as it was found there, whatever another step of its would be.
        settled |= ~self.going
        ended = self.going & settled
        self.poses = _either(self.going, self._ground.moved(self.poses, steps), self.poses)
        self.pads = _either_pads(ended[self.of], _shifted(self.pads, steps[self.of]), self.pads)
        self._held = [one if end else None for one, end in zip(held, settled, strict=True)]
        self.going, self._before, self._last = self.going & ~settled, steps, sizes
        if self.going.any():
            self.pads = _either_pads(self.going[self.of], self._laid(self.poses), self.pads)
            self.rows = whitened(self._touches, self.pads, self._noise)

    @property
    def moving(self) -> FloatArray:
        """(b,) float, metres: the last step of boards that are still going, 0 of the others."""
        return np.where(self.going, self._last, 0.0)

    def found(self) -> list[_Held]:
        """Return how each board is held; of those that are there, at their last step."""
        return [
            _holding(self.rows, span, self.trust[span]) if one is None else one
            for one, span in zip(self._held, self.spans, strict=True)
        ]


def _either(first: BoolArray, one: Poses, other: Poses) -> Poses:
    """Return `one` where `first` (n,), else `other`."""
    if first.all():
        return one
    rows = first[:, None]
    return Poses(
        np.where(rows, one.points, other.points),
        np.where(rows, one.x, other.x),
        np.where(rows, one.normals, other.normals),
        np.where(first, one.triangles, other.triangles),
    )


def _either_pads(first: BoolArray, one: Pads, other: Pads) -> Pads:
    if first.all() or not first.any():
        return one if first.all() else other
    rows = first[:, None]
    return Pads(
        np.where(rows, one.points, other.points),
        np.where(rows[:, None], one.gradients, other.gradients),
        np.where(rows, one.normals, other.normals),
        np.where(first, one.triangles, other.triangles),
    )


def _shifted(pads: Pads, steps: FloatArray) -> Pads:
    """Return the pads (n,) after steps (n, d) of their boards that are too short for more than the gradient."""
    return replace(pads, points=pads.points + np.sum(pads.gradients * steps[:, None], axis=2))


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
    """Return (d,) Gauss and Newton's step, of the smallest norm where the rows do not determine one, and not too long."""
    singular, axes, right = _decomposed(slopes, misses, trust)
    good = singular > NO_RANK * singular[0]
    return axes[good].T @ _short(right[good] / singular[good])


def _by_size(slopes: FloatArray) -> IntArray:
    """Return an order of pokes in which what is added up does not tell how they are numbered."""
    return np.argsort(-np.sum(slopes * slopes, axis=(1, 2)), kind="stable")


def _holding(rows: Rows, span: slice, trust: FloatArray) -> _Held:
    slopes, misses = rows.slopes[span], rows.misses[span]
    order = _by_size(slopes)
    singular, axes, right = _decomposed(slopes[order], misses[order], trust[order])
    good = singular > NO_RANK * singular[0]
    return _Held(singular[good], axes[good], right[good], axes[~good], rows, span)


def _newton(held: _Held, bends: FloatArray, trust: FloatArray) -> FloatArray:
    """Return (d,) the step of one board, which heeds how its rows turn, `bends` (m, d, d), where that holds it."""
    inverse, right, order = held.inverse, held.right, _by_size(held.rows.slopes[held.span])
    bend = np.sum(trust[order][:, None, None] * bends[order], axis=0)
    curvature = np.eye(len(right)) - inverse.T @ bend @ inverse
    if len(right) and np.linalg.eigvalsh(curvature + curvature.T)[0] > 2.0 * HOLDS:
        right = np.asarray(np.linalg.solve(curvature, right), dtype=np.float64)
    return held.axes.T @ _short(right / held.singular)


def _short(ways: FloatArray) -> FloatArray:
    """Return ways along the directions of singular values, none too long: one hardly told does not hold up the others."""
    return np.clip(ways, -STEP_MAX, STEP_MAX)


def _decomposed(slopes: FloatArray, misses: FloatArray, trust: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return singular values (d,), their directions (d, d) as rows and right sides (d,) of the weighted rows."""
    unknowns = slopes.shape[-1]
    root = np.sqrt(trust)[:, None]
    factor = triangle((root[:, :, None] * slopes).reshape(-1, unknowns), (root * misses).ravel())
    left, singular, axes = np.linalg.svd(factor[:, :unknowns])
    return singular, axes, left.T @ factor[:, unknowns]


def _covariance(touches: Touches, held: _Held, trust: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Return the covariance (d, d) of a board's unknowns."""
    covariance = held.inverse @ held.inverse.T
    if noise.pose_turn > 0 or noise.pose_shift > 0:
        slopes, trust = held.rows.slopes[held.span], trust[held.span]
        gain = covariance @ (trust[:, None, None] * slopes).reshape(-1, slopes.shape[-1]).T
        covariance = covariance + _of_poses(touches, held.rows, held.span, gain, noise)
    return covariance


def _miss(held: _Held, trust: FloatArray) -> float:
    weights, distances = trust[held.span], held.rows.distances[held.span]
    return float(np.sqrt(np.sum(weights * distances**2) / max(weights.sum(), 1e-300)))


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
