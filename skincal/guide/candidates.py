"""Which poke says most for the time it takes, and where to poke while it is unknown where the taxels are.

A poke at a believed place from some side is expected to be answered by the taxels around it, the weaker the farther. For each
of them the predicted covariance S shrinks by S J'(D + J S J')^-1 J S, with J the poke's two rows and D their noise
(A-optimal); what counts is by how much the predicted rms error goes down, until it is as small as wanted.

Two phases: a sweep, in which pokes between taxels are welcome since they say something about several; then own pokes, since
pure greed keeps poking between taxels, and pulls their estimates together.

Without a layout the surface is covered evenly (`Cover`), first around the taxels that answered.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.guide.poke_history import PokeAxis
from skincal.mesh.search import nearest_in_metric
from skincal.mesh.surface import Surface, pairs_within
from skincal.model.scene import NoiseSettings
from skincal.taxels.contact_table import orthonormal_pair
from skincal.taxels.noise import offset_square, row_precision

AZIMUTHS = 8
"""Directions around the normal that are tried."""
TILTS = (0.6, 1.0)
"""Shares of the usable tilt that are tried, beside no tilt at all."""
TRIES = 1 + AZIMUTHS * len(TILTS)
"""Pushes tried at each taxel."""
REACHED = 1.35
"""Neighbours within this many times the usual spacing may answer: measured on the simulated forearm, nine in ten of those
that do are nearer."""
# Least weight of a neighbour: it hardly counts.
_HARDLY = 1e-3
FORCE = 9.0
"""N, the middle of what a hand presses (6 to 12)."""


@dataclass(frozen=True, slots=True, eq=False)
class AnsweringTaxels:
    """Which of n taxels are expected to answer a poke at each: k a taxel, itself first, filled up with itself and weight 0."""

    rows: IntArray
    """(n, k) int."""
    weights: FloatArray
    """(n, k) float, 0 to 1: expected share of the strongest answer."""


def find_answering(places: FloatArray, spacing: float, noise: NoiseSettings, most: int = 6) -> AnsweringTaxels:
    """Find the taxels around each of `places` (n, 3), metres; neighbours are usually `spacing` apart."""
    count = len(places)
    rows, weights = np.tile(np.arange(count)[:, None], (1, most + 1)), np.zeros((count, most + 1))
    weights[:, 0] = 1.0
    known = np.flatnonzero(np.isfinite(places).all(axis=1))
    near, far = known[pairs_within(places[known], REACHED * spacing)].T
    apart = np.sqrt(np.sum((places[far] - places[near]) ** 2, axis=1))
    taxel, other, apart = np.concatenate([near, far]), np.concatenate([far, near]), np.concatenate([apart, apart])
    order = np.lexsort((other, apart, taxel))
    taxel, other, apart = taxel[order], other[order], apart[order]
    # How many nearer neighbours the taxel has: the neighbour's place in its row.
    rank = np.arange(len(taxel)) - np.searchsorted(taxel, taxel, side="left")
    kept = rank < most
    rows[taxel[kept], 1 + rank[kept]] = other[kept]
    weights[taxel[kept], 1 + rank[kept]] = np.exp(-((apart[kept] / (2.0 * noise.reach)) ** 2))
    return AnsweringTaxels(rows, weights)


def answer_offsets(places: FloatArray, neighbours: AnsweringTaxels) -> FloatArray:
    """Return (n, 3) how far beside each taxel the middle of the expected answers lies when it is poked at its place, metres."""
    off = np.nan_to_num(places[neighbours.rows] - places[:, None])
    shares = neighbours.weights[:, :, None]
    return np.asarray(np.sum(shares * off, axis=1) / np.sum(shares, axis=1), dtype=np.float64)


def candidate_pushes(normals: FloatArray, usable: float) -> FloatArray:
    """Return (n, 1 + 16, 3) unit pushes to try at skin with outward `normals` (n, 3): along the normal, then tilted."""
    east, north = orthonormal_pair(normals).transpose(1, 0, 2)
    tries = [-normals]
    for share in TILTS:
        tilt = share * usable
        for step in range(AZIMUTHS):
            turn = 2.0 * np.pi * step / AZIMUTHS
            aside = np.cos(turn) * east + np.sin(turn) * north
            tries.append(np.sin(tilt) * aside - np.cos(tilt) * normals)
    return np.stack(tries, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class ChoiceState:
    """What the choice of a poke depends on, of n taxels."""

    places: FloatArray
    """(n, 3) float, metres, believed."""
    pushes: FloatArray
    """(n, d, 3) float, unit: what is tried at each."""
    neighbours: AnsweringTaxels
    information: FloatArray
    """(n, 3, 3) float, 1/m^2."""
    normals: FloatArray
    """(n, 3) float, unit."""
    sensor: FloatArray
    """(3,) float, metres: the sensor's origin, link frame."""
    wanted: float
    """m, the rms below which a taxel needs nothing more."""
    in_plane: bool
    """Whether only the place along the skin counts (surface method)."""
    open: FloatArray
    """(n,) float: 1 where the taxel still needs something, else 0."""
    solved: FloatArray
    """(n,) float, metres: the solver's predicted error, which counts where it is larger: it weighs contacts its own way."""


def _covariances(state: ChoiceState, rows: IntArray) -> FloatArray:
    """Return (m, 3, 3), m^2; along the skin alone where that is what counts."""
    if state.in_plane:
        basis = orthonormal_pair(state.normals[rows])
        flat = _inverse(basis @ state.information[rows] @ basis.transpose(0, 2, 1))
        found = np.asarray(basis.transpose(0, 2, 1) @ flat @ basis, dtype=np.float64)
    else:
        found = _inverse(state.information[rows])
    # Where the solver's own error is larger, it counts.
    total = np.trace(found, axis1=1, axis2=2)
    return found * np.maximum(state.solved[rows] ** 2 / total, 1.0)[:, None, None]


def _inverse(matrices: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64)


def predict_error(state: ChoiceState, row: int, push: int, noise: NoiseSettings) -> tuple[float, float]:
    """Return the predicted rms error of a taxel now and after a push at it, metres."""
    alone = np.array([row])
    before = _covariances(state, alone)
    _, less = _lowered(state, alone, before[:, None], state.neighbours.rows[alone][:, :1], np.ones((1, 1)), noise)
    total = float(np.trace(before[0]))
    return float(np.sqrt(total)), float(np.sqrt(max(total - float(less[0, push, 0]), 0.0)))


def predict_gains(state: ChoiceState, rows: IntArray, noise: NoiseSettings, others: float) -> FloatArray:
    """Return (m, d) by how much each push at the taxels `rows` (m,) lowers the sum of the predicted rms errors, metres.

    The neighbours count `others`, 0 to 1, beside the taxel itself.
    """
    touched, weights = state.neighbours.rows[rows], state.neighbours.weights[rows]
    before = _covariances(state, touched.ravel()).reshape(*touched.shape, 3, 3)
    total, less = _lowered(state, rows, before, touched, weights, noise)
    after = np.sqrt(np.maximum(total - less, 0.0))
    # Nothing is gained below half the wanted error: what is known well is not polished further.
    floor = state.wanted / 2.0
    lower = np.maximum(np.sqrt(total), floor) - np.maximum(after, floor)
    lower *= (weights > 0)[:, None] * state.open[touched][:, None]
    return lower[:, :, 0] + others * lower[:, :, 1:].sum(axis=2)


def _lowered(
    state: ChoiceState, rows: IntArray, before: FloatArray, touched: IntArray, weights: FloatArray, noise: NoiseSettings
) -> tuple[FloatArray, FloatArray]:
    """Return (m, 1, k) the traces of the covariances `before` (m, k, 3, 3), and (m, d, k) by how much each push lowers them."""
    (m, k), d = touched.shape, state.pushes.shape[1]
    weights = np.maximum(weights, _HARDLY)
    pairs = orthonormal_pair(state.pushes[rows].reshape(-1, 3)).reshape(m, d, 1, 2, 3)
    away: FloatArray = state.places[touched] - state.sensor
    lever: FloatArray = np.broadcast_to(away[:, None], (m, d, k, 3))
    offsets: FloatArray = np.broadcast_to(offset_square(weights, noise)[:, None], (m, d, k))
    every: FloatArray = np.broadcast_to(pairs, (m, d, k, 2, 3)).reshape(-1, 2, 3)
    forces = np.full(m * d * k, FORCE)
    precision = row_precision(every, lever.reshape(-1, 3), forces, offsets.reshape(-1), noise)
    # The chance that it answers at all is about its share of the strongest answer.
    beside = _inverse(precision).reshape(m, d, k, 2, 2) / weights[:, None, :, None, None]
    # The trace of S J'(D + J S J')^-1 J S, by which the contact lowers that of S.
    moved: FloatArray = pairs @ before[:, None]
    spread: FloatArray = moved @ pairs.transpose(0, 1, 2, 4, 3) + beside
    inverse = _inverse(spread)
    less = np.sum(moved * (inverse @ moved), axis=(-1, -2))
    return np.trace(before, axis1=-2, axis2=-1)[:, None], less


SPACING = 0.008
"""m, between neighbouring places: a tip is felt within it, and taxels are hardly farther apart."""
APART = 0.8
"""Share of the spacing that two places are apart at least."""
AROUND = 2.2 * SPACING
"""m. Places this near to a poke that was answered come first: where skin is, more skin is likely."""
ASTRAY = 0.025
"""m. Elsewhere a place farther than this from every poke is tried: the smallest patches of skin are larger."""


class Cover:
    """Places spread evenly over a part's surface, and which of them are still to be poked."""

    def __init__(self, surface: Surface) -> None:
        self._surface = surface
        self.places, triangles = spread_over(surface, SPACING)
        self.normals: FloatArray = surface.normals[triangles]
        self._poked: FloatArray = np.full(len(self.places), np.inf)
        # (n,) float, metres, from each place to the nearest poke, and to the nearest that was answered.
        self._answered: FloatArray = np.full(len(self.places), np.inf)
        # Where each poke was, (3,) metres, and whether a taxel answered.
        self._pokes: dict[int, tuple[FloatArray, bool]] = {}
        self._counted = set[int]()
        self._left_out = np.zeros(len(self.places), dtype=bool)

    def poked(self, number: int, axis: PokeAxis, *, answered: bool) -> None:
        """Note a poke: it touched where its axis passes the surface nearest, on the side that faces it."""
        root = np.vstack([orthonormal_pair(axis.direction[None])[0], np.zeros(3)])
        found = nearest_in_metric(self._surface, root[None], (root @ axis.point)[None], axis.direction[None])
        if found.triangles[0] >= 0:
            self._pokes[number] = found.points[0], answered

    def keep(self, numbers: Collection[int]) -> None:
        """Count the pokes among `numbers` alone: others were taken back."""
        # Distances to the nearest poke only shrink while pokes come; once a poke is gone they are computed again.
        there = self._pokes.keys() & set(numbers)
        if not self._counted <= there:
            self._counted = set[int]()
            self._poked[:] = self._answered[:] = np.inf
        for number in sorted(there - self._counted):
            self._mark(*self._pokes[number])
        self._counted = set(there)

    def _mark(self, place: FloatArray, answered: bool) -> None:
        apart = np.sqrt(np.sum((self.places - place) ** 2, axis=1))
        self._poked = np.minimum(self._poked, apart)
        if answered:
            self._answered = np.minimum(self._answered, apart)

    def leave_out(self, place: FloatArray) -> None:
        """Never ask for this place, (3,) metres, again: the operator skipped it."""
        self._left_out[int(np.sum((self.places - place) ** 2, axis=1).argmin())] = True

    def next(self, hand: FloatArray | None) -> int | None:
        """Return which place to poke, the last poke having been at `hand` (3,), metres; None where all are covered."""
        waiting = (self._poked > SPACING) & ~self._left_out
        near = np.flatnonzero(waiting & (self._answered <= AROUND))
        if near.size:
            here = self.places[near[0]] if hand is None else hand
            return int(near[int(np.sum((self.places[near] - here) ** 2, axis=1).argmin())])
        far = np.flatnonzero(waiting & (self._poked > ASTRAY))
        if not far.size:
            return None
        if not np.isfinite(self._poked[far]).all():
            # Nothing was poked yet: begin in the middle of the part.
            middle = self.places.mean(axis=0)
            return int(far[int(np.sum((self.places[far] - middle) ** 2, axis=1).argmin())])
        return int(far[int(self._poked[far].argmax())])


def spread_over(surface: Surface, spacing: float) -> tuple[FloatArray, IntArray]:
    """Return (n, 3) places over a surface, none nearer than `APART` of `spacing` to another, and their triangles (n,)."""
    corners = surface.corners
    longest = np.sqrt(np.sum((corners - np.roll(corners, 1, axis=1)) ** 2, axis=2)).max(axis=1)
    # Pieces of at most half the spacing; what lies too near together is thinned out afterwards.
    steps = np.ceil(2.0 * longest / spacing).astype(np.int64).clip(min=1)
    places, triangles = list[FloatArray](), list[IntArray]()
    for count in np.unique(steps).tolist():
        rows = np.flatnonzero(steps == count)
        shares = _lattice(count)
        places.append((shares @ corners[rows]).reshape(-1, 3))
        triangles.append(rows.repeat(len(shares)))
    every, owners = np.concatenate(places), np.concatenate(triangles)
    kept = _thinned(every, APART * spacing)
    return every[kept], owners[kept]


def _thinned(places: FloatArray, apart: float) -> IntArray:
    """Return which of `places` (n, 3) to keep, in a fixed order, so that none is nearer than `apart` to one kept before."""
    # Only now, and beside the window: a scene with a layout needs none of it.
    spatial: Any = import_module("scipy.spatial")
    tree = spatial.cKDTree(places)
    waiting = np.ones(len(places), dtype=bool)
    kept = list[int]()
    for row in np.lexsort(places.T).tolist():
        if waiting[row]:
            kept.append(row)
            waiting[tree.query_ball_point(places[row], apart)] = False
    return np.array(sorted(kept), dtype=np.int64)


def _lattice(count: int) -> FloatArray:
    """Return (n, 3) barycentric coordinates of the middles of the `count`^2 equal triangles into which a triangle is cut."""
    # Pieces that stand as the triangle does, and those upside down between them.
    up = [(i, j) for i in range(count) for j in range(count - i)]
    down = [(i, j) for i in range(count - 1) for j in range(count - 1 - i)]
    pairs = np.array([(i + 1 / 3, j + 1 / 3) for i, j in up] + [(i + 2 / 3, j + 2 / 3) for i, j in down]) / count
    return np.column_stack([1.0 - pairs.sum(axis=1), pairs])
