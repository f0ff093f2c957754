"""Choice of the next poke: the gain of each possible push, and turns of taxels and modules.

A poke at a believed position from some side is expected to be answered by the taxels around it, the weaker the farther. The
predicted covariance S of each of them shrinks by S J'(D + J S J')^-1 J S, with J the poke's two rows and D their noise
(A-optimal design). The gain is by how much the predicted rms error falls, until it is as small as wanted.

The free method has two phases. In the sweep, pokes between taxels are welcome, since they say something about several. Then
come own pokes: pure greed keeps poking between taxels, and pulls their estimates together.

The other methods need even pokes and no tilt: taxels or modules take turns, with a short way for the hand. A missed
taxel is requested once more in a round, and not more often: a taxel out of reach does not delay the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import BoolArray, FloatArray, IntArray, orthonormal_pair
from skincal.mesh.surface import pairs_within
from skincal.model.scene import NoiseSettings
from skincal.taxels.noise import offset_square, row_precision

PUSH_AZIMUTHS_TRIED = 8
"""Directions around the normal that are tried."""
TILT_SHARES = (0.6, 1.0)
"""Shares of the usable tilt that are tried, in addition to no tilt."""
PUSHES_PER_TAXEL = 1 + PUSH_AZIMUTHS_TRIED * len(TILT_SHARES)
NEIGHBOUR_MAX_SPACINGS = 1.35
"""Neighbours within this many spacings may answer: on the simulated forearm nine in ten of those that do are nearer."""
MIN_NEIGHBOUR_ANSWER_WEIGHT = 1e-3
EXPECTED_PUSH_FORCE_N = 9.0
"""Mean force of a hand (6 to 12)."""


@dataclass(frozen=True, slots=True, eq=False)
class AnsweringTaxels:
    """Taxels that are expected to answer a poke at each of n: k per taxel, itself first, padded with weight 0."""

    rows: IntArray
    """(n, k) int."""
    weights: FloatArray
    """(n, k) float, 0 to 1: expected share of the strongest answer."""


def find_answering(places: FloatArray, spacing: float, noise: NoiseSettings, most: int = 6) -> AnsweringTaxels:
    """Find the taxels that answer a poke at each of `places` (n, 3), metres; neighbours are usually `spacing`, m, apart."""
    count = len(places)
    rows, weights = np.tile(np.arange(count)[:, None], (1, most + 1)), np.zeros((count, most + 1))
    weights[:, 0] = 1.0
    known = np.flatnonzero(np.isfinite(places).all(axis=1))
    near, far = known[pairs_within(places[known], NEIGHBOUR_MAX_SPACINGS * spacing)].T
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
    """Compute (n, 3) the offset of the mean expected answer from each taxel if it is poked exactly at its place, metres."""
    off = np.nan_to_num(places[neighbours.rows] - places[:, None])
    shares = neighbours.weights[:, :, None]
    return np.asarray(np.sum(shares * off, axis=1) / np.sum(shares, axis=1), dtype=np.float64)


def candidate_pushes(normals: FloatArray, usable: float) -> FloatArray:
    """List (n, d, 3) unit pushes to try at skin with outward `normals` (n, 3): along the normal, then tilted."""
    east, north = orthonormal_pair(normals).transpose(1, 0, 2)
    tries = [-normals]
    for share in TILT_SHARES:
        tilt = share * usable
        for step in range(PUSH_AZIMUTHS_TRIED):
            turn = 2.0 * np.pi * step / PUSH_AZIMUTHS_TRIED
            aside = np.cos(turn) * east + np.sin(turn) * north
            tries.append(np.sin(tilt) * aside - np.cos(tilt) * normals)
    return np.stack(tries, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class PokeChoice:
    """Choice of the next poke: positions and errors of n taxels, and the predicted gain of each push."""

    places: FloatArray
    """(n, 3) float, metres, believed."""
    pushes: FloatArray
    """(n, d, 3) float, unit: pushes to try at each."""
    neighbours: AnsweringTaxels
    information: FloatArray
    """(n, 3, 3) float, 1/m^2."""
    normals: FloatArray
    """(n, 3) float, unit."""
    sensor: FloatArray
    """(3,) float, metres: the sensor's origin, link frame."""
    wanted: float
    """m, wanted predicted rms error."""
    in_plane: bool
    """Whether only the position along the skin counts (surface method)."""
    open: FloatArray
    """(n,) float: 1 if the taxel still needs something, else 0."""
    solved: FloatArray
    """(n,) float, metres: the solver's predicted error. It counts if it is larger, since the solver weighs contacts its own
    way."""
    noise: NoiseSettings

    def _covariances(self, rows: IntArray) -> FloatArray:
        """Compute (m, 3, 3) predicted covariances, m^2; along the skin alone if `in_plane`."""
        if self.in_plane:
            basis = orthonormal_pair(self.normals[rows])
            flat = _inverse(basis @ self.information[rows] @ basis.transpose(0, 2, 1))
            found = np.asarray(basis.transpose(0, 2, 1) @ flat @ basis, dtype=np.float64)
        else:
            found = _inverse(self.information[rows])
        total = np.trace(found, axis1=1, axis2=2)
        return found * np.maximum(self.solved[rows] ** 2 / total, 1.0)[:, None, None]

    def predict_error(self, row: int, push: int) -> tuple[float, float]:
        """Predict the rms error of a taxel now and after a push at it, metres."""
        alone = np.array([row])
        before = self._covariances(alone)
        _, less = self._lowered(alone, before[:, None], self.neighbours.rows[alone][:, :1], np.ones((1, 1)))
        total = float(np.trace(before[0]))
        return float(np.sqrt(total)), float(np.sqrt(max(total - float(less[0, push, 0]), 0.0)))

    def predict_gains(self, rows: IntArray, others: float) -> FloatArray:
        """Predict (m, d) by how much each push at the taxels `rows` (m,) lowers the sum of the rms errors, metres.

        `others`, 0 to 1, is the weight of the neighbours relative to the taxel itself.
        """
        touched, weights = self.neighbours.rows[rows], self.neighbours.weights[rows]
        before = self._covariances(touched.ravel()).reshape(*touched.shape, 3, 3)
        total, less = self._lowered(rows, before, touched, weights)
        after = np.sqrt(np.maximum(total - less, 0.0))
        # No gain counts below half the wanted error: a well-known taxel needs no more pokes.
        floor = self.wanted / 2.0
        lower = np.maximum(np.sqrt(total), floor) - np.maximum(after, floor)
        lower *= (weights > 0)[:, None] * self.open[touched][:, None]
        return lower[:, :, 0] + others * lower[:, :, 1:].sum(axis=2)

    def _lowered(
        self, rows: IntArray, before: FloatArray, touched: IntArray, weights: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Compute (m, 1, k) the traces of the covariances `before` (m, k, 3, 3), and (m, d, k) their reduction by each push."""
        (m, k), d = touched.shape, self.pushes.shape[1]
        weights = np.maximum(weights, MIN_NEIGHBOUR_ANSWER_WEIGHT)
        pairs = orthonormal_pair(self.pushes[rows].reshape(-1, 3)).reshape(m, d, 1, 2, 3)
        away: FloatArray = self.places[touched] - self.sensor
        lever: FloatArray = np.broadcast_to(away[:, None], (m, d, k, 3))
        offsets: FloatArray = np.broadcast_to(offset_square(weights, self.noise)[:, None], (m, d, k))
        every: FloatArray = np.broadcast_to(pairs, (m, d, k, 2, 3)).reshape(-1, 2, 3)
        forces = np.full(m * d * k, EXPECTED_PUSH_FORCE_N)
        precision = row_precision(every, lever.reshape(-1, 3), forces, offsets.reshape(-1), self.noise)
        # The chance that it answers at all is about its share of the strongest answer.
        beside = _inverse(precision).reshape(m, d, k, 2, 2) / weights[:, None, :, None, None]
        # The trace of S J'(D + J S J')^-1 J S, the decrease of the trace of S by the contact.
        moved: FloatArray = pairs @ before[:, None]
        spread: FloatArray = moved @ pairs.transpose(0, 1, 2, 4, 3) + beside
        inverse = _inverse(spread)
        less = np.sum(moved * (inverse @ moved), axis=(-1, -2))
        return np.trace(before, axis1=-2, axis2=-1)[:, None], less


def _inverse(matrices: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64)


class GainCache:
    """Gains of all pushes at n taxels, computed again only if something near the taxel changed."""

    def __init__(self, count: int) -> None:
        self._gains = np.full((count, PUSHES_PER_TAXEL), -np.inf)
        self._stale = np.ones(count, dtype=bool)
        self._others = np.nan

    def mark_stale(self, rows: BoolArray | slice | int = slice(None)) -> None:
        """Note that the information gains of some taxels, or of all, must be computed again."""
        self._stale[rows] = True

    def gains(self, choice: PokeChoice, rows: IntArray, others: float, skipped: dict[int, BoolArray]) -> FloatArray:
        """Predict (m, d) gains at `rows` (m,) as `PokeChoice.predict_gains`; -inf for the pushes `skipped` (d,) of a taxel."""
        if others != self._others:
            self._others, self._stale[:] = others, True
        stale = rows[self._stale[rows]]
        if stale.size:
            self._gains[stale] = choice.predict_gains(stale, others)
            for row in skipped.keys() & set(stale.tolist()):
                self._gains[row, skipped[row]] = -np.inf
            self._stale[stale] = False
        return self._gains[rows]


def next_taxel(rows: IntArray, seconds: FloatArray, asked: IntArray, own: IntArray) -> int:
    """Choose the next of the taxels `rows` (m,): of those in the earliest round the one that the hand reaches first.

    Parameters
    ----------
    seconds : (m,) until the hand has poked there
    asked, own : (n,) pokes that were meant for each taxel, and own pokes
    """
    first = _earliest(_rounds(asked, own)[rows])
    return int(rows[first[seconds[first].argmin()]])


def next_module_taxel(
    rows: IntArray, seconds: FloatArray, asked: IntArray, own: IntArray, modules: IntArray, places: FloatArray
) -> int:
    """Choose the next of the taxels `rows` (m,) if modules take turns; else as `next_taxel`.

    Pokes side by side say little about the turn of a module. Of its least poked taxels the one farthest from the poked ones is
    next. A taxel that was requested twice in vain counts as poked.

    Parameters
    ----------
    modules : (n,) index of each taxel's module, from 0
    places : (n, 3) float, metres, believed; NaN if unknown
    """
    first = _earliest(_rounds(np.bincount(modules, asked), np.bincount(modules, own))[modules[rows]])
    module = modules[rows[first[seconds[first].argmin()]]]
    here = first[modules[rows[first]] == module]
    each = np.maximum(own, asked - 1)
    here = here[_earliest(each[rows[here]])]
    poked = (modules == module) & (each > each[rows[here[0]]]) & np.isfinite(places).all(axis=1)
    if not poked.any():
        return int(rows[here[seconds[here].argmin()]])
    off = places[rows[here], None] - places[poked]
    return int(rows[here[np.sum(off * off, axis=2).min(axis=1).argmax()]])


def _earliest(rounds: FloatArray | IntArray) -> IntArray:
    return np.flatnonzero(rounds == rounds.min())


def _rounds(asked: IntArray | FloatArray, own: IntArray | FloatArray) -> FloatArray:
    """Count the rounds of each taxel or module: its own pokes, and its missed targets after the first one."""
    return np.maximum(own, np.maximum(np.minimum(asked, own + 1), asked - 1)).astype(np.float64)
