"""What is known of each taxel, for the guide: where it is believed to be, and what its contacts add up to.

*Places.* By the layout laid on the part, corrected by what was measured. A skin lies beside its plan as a whole, then module by
module, then taxel by taxel. Each step takes the mean of what the measured taxels are off, weighted by how well they are known,
and drawn to zero by how far off they may be at most.

*Contacts.* A contact says E' D^-1 E of its taxel's place, with E the two rows across its push and D their noise; the sum over
contacts is the information, whose inverse is the predicted covariance. Nothing here estimates a place: that is the solver's.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.lay import PlacedLayout
from skincal.model.scene import NoiseSettings
from skincal.model.skin import Layout
from skincal.taxels.contact_table import Evidence, orthonormal_pair
from skincal.taxels.noise import offset_square, row_precision
from skincal.taxels.result import Estimate


class TaxelStatistics:
    """Numbers of n taxels, renewed for those whose contacts changed.

    Parameters
    ----------
    channels : (n,) ascending
    unknown : m, sd of a place of which nothing is known
    in_plane : whether only the place along the skin counts (surface method)
    """

    def __init__(self, channels: IntArray, noise: NoiseSettings, unknown: float, in_plane: bool) -> None:
        count = len(channels)
        self.channels = channels
        self.noise, self.in_plane = noise, in_plane
        self._row = {int(channel): row for row, channel in enumerate(channels)}
        self._nothing = np.eye(3) / unknown**2
        self.information: FloatArray = np.tile(self._nothing, (count, 1, 1))
        """(n, 3, 3) float, 1/m^2: the sum over contacts, with that of a place of which nothing is known."""
        self.diversity: FloatArray = np.zeros(count)
        """(n,) float, rad: how far the axes spread; 0 for one axis."""
        self.own: IntArray = np.zeros(count, dtype=np.int64)
        """(n,) pokes in which the taxel answered most."""
        self.contacts: IntArray = np.zeros(count, dtype=np.int64)
        """(n,) pokes in which it answered."""
        self.beside: FloatArray = np.zeros((count, 3))
        """(n, 3) float, metres: where the middle of its contacts lies beside it, along the skin."""
        self.pulled: FloatArray = np.zeros(count)
        """(n,) float, metres, outward: how far the places of its contacts pull its depth (`_pulled`)."""
        self.moved: FloatArray = np.full(count, np.inf)
        """(n,) float, metres: how far the last poke of its own moved it; infinite without one, or where it is alone."""

    def has(self, channel: int) -> bool:
        """Whether a channel is one of the taxels."""
        return channel in self._row

    def row(self, channel: int) -> int:
        """Return the index of a channel."""
        return self._row[channel]

    def renew(
        self,
        channels: Collection[int],
        evidence: Evidence,
        places: FloatArray,
        drawn: FloatArray,
        normals: FloatArray,
        centres: Mapping[int, FloatArray],
    ) -> None:
        """Renew what the contacts of `channels` say.

        Parameters
        ----------
        evidence : of those of `channels` that answered
        places, normals : (n, 3) float, metres and unit, believed
        drawn : (n, 3) float, metres: the places in which `centres` are measured
        centres : (3,) float, metres, of each poke: where it was by the answers
        """
        emptied = np.array([self._row[channel] for channel in channels], dtype=np.int64)
        self.information[emptied], self.moved[emptied] = self._nothing, np.inf
        for numbers in (self.diversity, self.own, self.contacts, self.beside, self.pulled):
            numbers[emptied] = 0
        if not len(evidence.channels):
            return
        rows = np.array([self._row[channel] for channel in evidence.channels.tolist()])
        starts, of = evidence.starts[:-1], evidence.taxels
        lever = np.nan_to_num(places[rows])[of] - evidence.sensors
        square = offset_square(evidence.weights, self.noise)
        every = information(evidence.pairs, lever, evidence.forces, square, self.noise) * evidence.trust[:, None, None]
        self.information[rows] += np.add.reduceat(every, starts, axis=0)
        self.diversity[rows] = diversity(evidence)
        # The strongest answer of a poke has weight 1 (k_j = t_j / max t).
        self.own[rows] = np.add.reduceat((evidence.weights == 1.0).astype(np.int64), starts)
        self.contacts[rows] = evidence.counts
        shares = (evidence.weights**2 * evidence.trust)[:, None]
        off = np.array([centres[poke] for poke in evidence.pokes.tolist()]) - drawn[rows][of]
        whole = np.add.reduceat(shares, starts, axis=0)
        # Where the trust of every contact is 0, nothing is known of their middle.
        middle = np.add.reduceat(shares * off, starts, axis=0) / np.where(whole > 0, whole, 1.0)
        middle -= np.sum(middle * normals[rows], axis=1, keepdims=True) * normals[rows]
        self.beside[rows] = middle
        if not self.in_plane:
            self.pulled[rows] = _pulled(evidence, off, normals[rows])
        self.moved[rows] = _moved(evidence, normals[rows], self.in_plane)


def _pulled(evidence: Evidence, off: FloatArray, normals: FloatArray) -> FloatArray:
    """Return (t,) how far contacts that lie `off` (n, 3), metres, beside their taxels pull these outward, metres.

    With P = I - u u' an axis through a + c instead of a changes H p = sum k^2 P a by k^2 P c: the least squares of the taxel
    move by H^-1 sum k^2 P c. Where pushes lean as the places lie, as on bent skin, that has a part along the normal.
    """
    pairs, shares = evidence.pairs, (evidence.weights**2 * evidence.trust)[:, None, None]
    across_push = shares * (pairs.transpose(0, 2, 1) @ pairs)
    whole = np.add.reduceat(across_push, evidence.starts[:-1], axis=0)
    pull = np.add.reduceat((across_push @ off[:, :, None])[:, :, 0], evidence.starts[:-1], axis=0)
    return np.sum(solved(whole + _trace_of(whole), pull) * normals, axis=1)


def _trace_of(squares: FloatArray) -> FloatArray:
    """Return (t, d, d) a trace of the traces: a single axis leaves a direction open, and it must be solved all the same."""
    total = np.trace(squares, axis1=1, axis2=2)
    return np.where(total > 0, 1e-9 * total, 1.0)[:, None, None] * np.eye(squares.shape[1])


def _moved(evidence: Evidence, normals: FloatArray, in_plane: bool) -> FloatArray:
    """Return (t,) how far the last own poke of each taxel moved its least squares; infinite without one, or alone.

    With M the sum of all contacts' rows and m, r the last one's, p - p_without = (M - m)^-1 r, exactly.
    """
    pairs = evidence.pairs
    sides = np.sum(pairs * evidence.nearest[:, None], axis=2)
    if in_plane:
        # Along the skin only: the depth counts as known.
        skin = orthonormal_pair(normals)[evidence.taxels]
        pairs = pairs @ skin.transpose(0, 2, 1)
    shares = (evidence.weights**2 * evidence.trust)[:, None, None]
    squares = shares * (pairs.transpose(0, 2, 1) @ pairs)
    pulls = shares[:, :, 0] * (pairs.transpose(0, 2, 1) @ sides[:, :, None])[:, :, 0]
    whole, pull = (np.add.reduceat(each, evidence.starts[:-1], axis=0) for each in (squares, pulls))
    last = _last_own(evidence)
    there = last >= 0
    held = _trace_of(whole)
    without = whole - np.where(there[:, None, None], squares[last], 0.0)
    rest = pull - np.where(there[:, None], pulls[last], 0.0)
    off = solved(whole + held, pull) - solved(without + held, rest)
    moved = np.sqrt(np.sum(off * off, axis=1))
    return np.where(there & (np.trace(whole, axis1=1, axis2=2) > 0) & (evidence.counts > 1), moved, np.inf)


def solved(matrices: FloatArray, sides: FloatArray) -> FloatArray:
    """Return the solutions (n, d) of n systems (n, d, d) with right sides (n, d)."""
    return np.asarray(np.linalg.solve(matrices, sides[:, :, None])[:, :, 0], dtype=np.float64)


def _last_own(evidence: Evidence) -> IntArray:
    """Return (t,) the answer of each taxel's last poke of its own, -1 without one."""
    numbers = np.where(evidence.weights == 1.0, evidence.pokes, -1)
    latest = np.maximum.reduceat(numbers, evidence.starts[:-1])
    at = np.flatnonzero((numbers == latest[evidence.taxels]) & (numbers >= 0))
    last = np.full(len(evidence.channels), -1, dtype=np.int64)
    last[evidence.taxels[at]] = at
    return last


def information(
    pairs: FloatArray, lever: FloatArray, forces: FloatArray, offsets: FloatArray, noise: NoiseSettings
) -> FloatArray:
    """Return (n, 3, 3) what each contact says of its taxel's place, E' D^-1 E, 1/m^2.

    Parameters and D are those of `row_precision`.
    """
    inverse = row_precision(pairs, lever, forces, offsets, noise)
    return pairs.transpose(0, 2, 1) @ inverse @ pairs


def diversity(evidence: Evidence) -> FloatArray:
    """Return (t,) how far the axes of each taxel spread, rad.

    The square of its sine is the smallest eigenvalue of the weighted mean of I - u u': 0 for parallel axes; for axes in a
    cone about their middle the angle between its side and that middle, times the root of a half.
    """
    starts = evidence.starts[:-1]
    u, shares = evidence.directions, (evidence.weights**2 * evidence.trust)[:, None, None]
    spread = np.add.reduceat(shares * (np.eye(3) - u[:, :, None] * u[:, None]), starts, axis=0)
    whole = np.add.reduceat(shares, starts, axis=0)
    # Axes of which none is trusted spread by nothing.
    spread /= np.where(whole > 0, whole, 1.0)
    least = np.linalg.eigvalsh(spread)[:, 0]
    return np.arcsin(np.sqrt(np.clip(least, 0.0, 1.0)))


WHOLE = 0.006
"""m, sd of the whole skin beside its plan, each direction: by hand it is put on to a few millimetres."""
MODULE = 0.002
"""m, sd of a module beside where the whole puts it: turns of the skin, and its bend."""
SPACING = 0.005
"""m, between neighbouring taxels where no layout says it: the iCub's and most others'."""
TAXEL = 0.001
"""m, sd of a taxel beside where its module puts it: pads are printed to less; the surface is not the part."""
UNLIKE = 0.3
"""Share of what a rig moves the whole skin by that differs between modules: turns of an arm pose of 1 degree (`RigPrior`) move
places 0.1 m apart by 2 mm against each other, and the skin 0.2 to 0.4 m from the sensor by 3 to 7 mm."""
FLOOR = 0.0005
"""m, sd: no estimate counts as better known, so that a single taxel does not outvote the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPlaces:
    """Where the layout puts n taxels, link frame."""

    channels: IntArray
    """(n,)."""
    places: FloatArray
    """(n, 3) float, metres; NaN where the layout does not say."""
    normals: FloatArray
    """(n, 3) float, unit, outward; NaN likewise."""
    modules: IntArray
    """(n,) index of the module, from 0."""


def plan_from_layout(layout: Layout, laid: PlacedLayout) -> PlannedPlaces | None:
    """Return where a laid layout puts the taxels, without those that it puts nowhere; None where it puts none."""
    channels = layout.channels
    channels = channels[np.isfinite(laid.places[channels]).all(axis=1)]
    if not len(channels):
        return None
    return PlannedPlaces(channels, laid.places[channels], laid.normals[channels], layout.module_of[channels])


def plan_without_positions(channels: IntArray, modules: IntArray | None = None) -> PlannedPlaces:
    """Return a plan that puts none of `channels` (n,) anywhere: there is no layout, or it lies nowhere.

    `modules` is (n,) the index of each channel's module; None without a layout.
    """
    nowhere = np.full((len(channels), 3), np.nan)
    return PlannedPlaces(
        channels, nowhere, nowhere.copy(), np.zeros(len(channels), dtype=np.int64) if modules is None else modules
    )


def believed_positions(plan: PlannedPlaces, estimates: Sequence[Estimate], rig: float = 0.0) -> FloatArray:
    """Return (n, 3) the believed places, metres; NaN where neither plan nor estimate says anything.

    A rig's errors move all estimates nearly alike, as if the skin lay elsewhere. Where they are known to be large, what the
    estimates are off in common is theirs rather than the skin's, and the tool is sent where the skin is. Estimates stand in the
    plan's order; `rig` is as in `Guide.update`.
    """
    measured, precision = _measured(estimates)
    off = np.where(np.isfinite(plan.places), measured - plan.places, np.nan)
    known = np.isfinite(off).all(axis=1)
    everyone, module = np.zeros(int(known.sum()), dtype=np.int64), plan.modules
    whole = _drawn(off[known], precision[known], everyone, 1, float(np.hypot(WHOLE, rig)))[0]
    rest = off - whole
    count = int(module.max(initial=-1)) + 1
    own = _drawn(rest[known], precision[known], module[known], count, float(np.hypot(MODULE, UNLIKE * rig)))
    if not count:
        # No channel is on a module: each taxel stands for itself.
        return _with_own(plan.places.copy(), measured, precision, np.zeros(3))
    moved = whole + own
    skin = _share(WHOLE, rig) * whole + _share(MODULE, UNLIKE * rig) * own
    # The tool is sent where the skin is; the rig's share of what the estimates are off stays out of the places.
    return _with_own(plan.places + skin[module], measured, precision, (moved - skin)[module])


def _share(skin: float, rig: float) -> float:
    """Return how much of what estimates are off in common is the skin's, by the sd of both."""
    return skin**2 / (skin**2 + rig**2)


def _measured(estimates: Sequence[Estimate]) -> tuple[FloatArray, FloatArray]:
    """Return (n, 3) positions, NaN without, and (n, 3, 3) their precisions, 1/m^2."""
    positions, covariances = np.full((len(estimates), 3), np.nan), np.zeros((len(estimates), 3, 3))
    for row, estimate in enumerate(estimates):
        if estimate.position is not None and estimate.covariance is not None:
            positions[row], covariances[row] = estimate.position, estimate.covariance
    precision = np.asarray(np.linalg.inv(covariances + FLOOR**2 * np.eye(3)), dtype=np.float64)
    # What was not measured pulls at nothing.
    precision[np.isnan(positions[:, 0])] = 0.0
    return positions, precision


def _drawn(off: FloatArray, precision: FloatArray, groups: IntArray, count: int, sd: float) -> FloatArray:
    """Return (count, 3) the weighted means of `off` (m, 3) in each group, drawn to zero by `sd`."""
    total, pull = np.tile(np.eye(3) / sd**2, (count, 1, 1)), np.zeros((count, 3))
    np.add.at(total, groups, precision)
    np.add.at(pull, groups, (precision @ off[:, :, None])[:, :, 0])
    return solved(total, pull)


def _with_own(places: FloatArray, measured: FloatArray, precision: FloatArray, rig: FloatArray) -> FloatArray:
    """Return the places shifted to each taxel's own estimate, less what the rig moves it, as far as that is better known."""
    off = np.nan_to_num(measured - places - rig)
    own = solved(precision + np.eye(3) / TAXEL**2, (precision @ off[:, :, None])[:, :, 0])
    return np.where(np.isfinite(places), places + own, measured)
