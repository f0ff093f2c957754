"""Statistics of each taxel's contacts, for the guide: information, sides of the pushes, number and offset of the contacts.

A contact adds E' D^-1 E to the information on its taxel's position, with E the two rows across its push and D their noise.
The inverse of the sum is the predicted covariance. Positions are estimated by the solver and not here.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skincal.geometry import FloatArray, IntArray, orthonormal_pair
from skincal.model.scene import NoiseSettings
from skincal.taxels.contact_table import Evidence
from skincal.taxels.noise import offset_square, row_precision


class TaxelStatistics:
    """Statistics of n taxels.

    Parameters
    ----------
    channels : (n,) ascending
    unknown : m, sd of a position before the first contact
    in_plane : whether only the position along the skin counts (surface method)
    """

    def __init__(self, channels: IntArray, noise: NoiseSettings, unknown: float, in_plane: bool) -> None:
        count = len(channels)
        self._noise, self._in_plane = noise, in_plane
        self.row_of = {int(channel): row for row, channel in enumerate(channels)}
        """Index of each channel."""
        self._prior = np.eye(3) / unknown**2
        self.information: FloatArray = np.tile(self._prior, (count, 1, 1))
        """(n, 3, 3) float, 1/m^2: sum over the contacts, and the prior's."""
        self.diversity: FloatArray = np.zeros(count)
        """(n,) float, rad: spread of the force axes; 0 for one axis."""
        self.own: IntArray = np.zeros(count, dtype=np.int64)
        """(n,) own pokes: those that the taxel answered most."""
        self.contacts: IntArray = np.zeros(count, dtype=np.int64)
        """(n,) pokes that the taxel answered."""
        self.offset: FloatArray = np.zeros((count, 3))
        """(n, 3) float, metres, along the skin: from the taxel to the centre of its contacts."""
        self.depth_bias: FloatArray = np.zeros(count)
        """(n,) float, metres, outward: error of the estimated depth that the contacts' positions cause (free method)."""
        self.last_shift: FloatArray = np.full(count, np.inf)
        """(n,) float, metres: shift of the estimate by the last own poke; infinite without an own poke or with one contact."""

    @property
    def offset_size(self) -> FloatArray:
        """(n,) float, metres: length of `offset`."""
        return np.sqrt(np.sum(self.offset**2, axis=1))

    def recompute(
        self,
        emptied: IntArray,
        evidence: Evidence,
        places: FloatArray,
        drawn: FloatArray,
        normals: FloatArray,
        centres: Mapping[int, FloatArray],
    ) -> None:
        """Compute the statistics of the taxels of some indices `emptied` (m,) again.

        Parameters
        ----------
        evidence : of those of them that answered
        places, normals : (n, 3) float, metres and unit: believed positions and outward normals
        drawn : (n, 3) float, metres: the positions that `centres` are relative to
        centres : (3,) float, metres, of each poke: its position by the answers
        """
        self.information[emptied], self.last_shift[emptied] = self._prior, np.inf
        for numbers in (self.diversity, self.own, self.contacts, self.offset, self.depth_bias):
            numbers[emptied] = 0
        if not len(evidence.channels):
            return
        rows = np.array([self.row_of[channel] for channel in evidence.channels.tolist()])
        starts, of, pairs = evidence.starts[:-1], evidence.taxels, evidence.pairs
        lever = np.nan_to_num(places[rows])[of] - evidence.sensors
        precision = row_precision(pairs, lever, evidence.forces, offset_square(evidence.weights, self._noise), self._noise)
        added = (pairs.transpose(0, 2, 1) @ precision @ pairs) * evidence.trust[:, None, None]
        self.information[rows] += np.add.reduceat(added, starts, axis=0)
        self.diversity[rows] = axis_diversity(evidence)
        # The strongest answer of a poke has weight 1 (k_j = t_j / max t).
        self.own[rows] = np.add.reduceat((evidence.weights == 1.0).astype(np.int64), starts)
        self.contacts[rows] = evidence.counts
        shares = (evidence.weights**2 * evidence.trust)[:, None]
        off = np.array([centres[poke] for poke in evidence.pokes.tolist()]) - drawn[rows][of]
        total = np.add.reduceat(shares, starts, axis=0)
        # A taxel without a trusted contact has no centre.
        centre = np.add.reduceat(shares * off, starts, axis=0) / np.where(total > 0, total, 1.0)
        self.offset[rows] = centre - np.sum(centre * normals[rows], axis=1, keepdims=True) * normals[rows]
        if not self._in_plane:
            self.depth_bias[rows] = _depth_biases(evidence, off, normals[rows])
        self.last_shift[rows] = _last_shifts(evidence, normals[rows], self._in_plane)


def axis_diversity(evidence: Evidence) -> FloatArray:
    """Compute (t,) the spread of each taxel's force axes, rad.

    The square of its sine is the smallest eigenvalue of the weighted mean of I - u u'. It is 0 for parallel axes. For axes on a
    cone it is the cone's half angle divided by the square root of 2.
    """
    starts = evidence.starts[:-1]
    u, shares = evidence.directions, (evidence.weights**2 * evidence.trust)[:, None, None]
    spread = np.add.reduceat(shares * (np.eye(3) - u[:, :, None] * u[:, None]), starts, axis=0)
    total = np.add.reduceat(shares, starts, axis=0)
    # Without a trusted axis there is no spread.
    spread /= np.where(total > 0, total, 1.0)
    return np.arcsin(np.sqrt(np.clip(np.linalg.eigvalsh(spread)[:, 0], 0.0, 1.0)))


def _depth_biases(evidence: Evidence, off: FloatArray, normals: FloatArray) -> FloatArray:
    """Compute (t,) how far contacts `off` (n, 3), metres, from their taxels shift the estimates outward, metres.

    With P = I - u u', an axis through a + c instead of a changes H p = sum k^2 P a by k^2 P c. The least-squares solution moves
    by H^-1 sum k^2 P c. On curved skin, where pushes lean as their positions do, this has a part along the normal.
    """
    pairs, shares = evidence.pairs, (evidence.weights**2 * evidence.trust)[:, None, None]
    projected = shares * (pairs.transpose(0, 2, 1) @ pairs)
    total = np.add.reduceat(projected, evidence.starts[:-1], axis=0)
    pull = np.add.reduceat((projected @ off[:, :, None])[:, :, 0], evidence.starts[:-1], axis=0)
    return np.sum(solve_each(total + _regularization(total), pull) * normals, axis=1)


def _last_shifts(evidence: Evidence, normals: FloatArray, in_plane: bool) -> FloatArray:
    """Compute (t,) how far the last own poke of each taxel moved its least-squares estimate, metres.

    With M the sum of all contacts' rows and m, r those of the last one, p - p_without = (M - m)^-1 r, exactly.
    """
    pairs, starts = evidence.pairs, evidence.starts[:-1]
    sides = np.sum(pairs * evidence.nearest[:, None], axis=2)
    if in_plane:
        pairs = pairs @ orthonormal_pair(normals)[evidence.taxels].transpose(0, 2, 1)
    shares = (evidence.weights**2 * evidence.trust)[:, None, None]
    squares = shares * (pairs.transpose(0, 2, 1) @ pairs)
    pulls = shares[:, :, 0] * (pairs.transpose(0, 2, 1) @ sides[:, :, None])[:, :, 0]
    total, pull = (np.add.reduceat(each, starts, axis=0) for each in (squares, pulls))
    # Index of the answer in each taxel's last own poke, -1 without one.
    numbers = np.where(evidence.weights == 1.0, evidence.pokes, -1)
    at = np.flatnonzero((numbers == np.maximum.reduceat(numbers, starts)[evidence.taxels]) & (numbers >= 0))
    last = np.full(len(evidence.channels), -1, dtype=np.int64)
    last[evidence.taxels[at]] = at
    has_own, ridge = last >= 0, _regularization(total)
    without = total - np.where(has_own[:, None, None], squares[last], 0.0)
    rest = pull - np.where(has_own[:, None], pulls[last], 0.0)
    off = solve_each(total + ridge, pull) - solve_each(without + ridge, rest)
    shift = np.sqrt(np.sum(off * off, axis=1))
    return np.where(has_own & (np.trace(total, axis1=1, axis2=2) > 0) & (evidence.counts > 1), shift, np.inf)


def _regularization(squares: FloatArray) -> FloatArray:
    """Make (t, d, d) a small multiple of the identity: one axis alone leaves a direction open."""
    trace = np.trace(squares, axis1=1, axis2=2)
    return np.where(trace > 0, 1e-9 * trace, 1.0)[:, None, None] * np.eye(squares.shape[1])


def solve_each(matrices: FloatArray, sides: FloatArray) -> FloatArray:
    """Solve n systems (n, d, d) with right sides (n, d)."""
    return np.asarray(np.linalg.solve(matrices, sides[:, :, None])[:, :, 0], dtype=np.float64)
