"""The lean of answers to pushes next to the middle of a taxel.

Below a push an elastic pad is pressed away from the tip to all sides. So a taxel whose middle is off from the contact by -d
feels the force in a direction that leans,

    f' = f - b nu d,   nu = -f.n,                                                                                (1)

with the direction f of the force, the outward normal n of the skin, and d (m) along the skin from the middle of the taxel to
the contact. b (rad/m) is one number for all taxels of a skin. In an elastic half-space the stress of a load points away from
it (Boussinesq; Johnson, Contact Mechanics, 3.2): b is then about c/h with the depth h of the taxel and the share c of the
force that comes through the material.

d is measured: the force axis, or the tip, gives the contact, and the estimate of the taxel its middle. The noise of d makes the
fitted b smaller than the true one. That is right for a correction: of all b it leaves the least scatter.

**One step.** (1) is small, so one Gauss-Newton step from the fits without it is enough. With the misses e of the fits in
standard deviations, J their derivatives by (omega, ln rho) and c those by b, the minimum over b and all turns is at

    b = -sum c'M e / (sum c'M c + 1/sd^2),   M = I - J (J'J)^-1 J',                                              (2)

and a turn moves by -b (J'J)^-1 J'c. The noise was found from misses that contain (1), so covariances are scaled by the share of
the squared misses that is left. They grow by the errors of b and of the middle of the taxel: if that is wrong by p, all its
offsets are, and its normal leans by b p. A b that is hardly larger than its error is lowered towards 0, so that a rigid skin
keeps its turns.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.axes.skin_turns import SkinTurns, Turn, joined
from skincal.axes.turn_fit import AxisPokes, LeanSlopes, TurnFit, lean_slopes
from skincal.geometry import FloatArray, orthonormal_pair, rotation_by
from skincal.taxels.contact_table import Evidence
from skincal.taxels.result import Estimate

LEAN_PRIOR_SD = float(np.radians(4.0)) * 1e3
"""rad/m, sd of b before any poke: 4 degrees for each millimetre. Pads of 2 to 3 mm on a bonded base have 2 to 3."""
MAX_OFFSET_M = 0.004
"""m. Farther from the middle the lean is no longer proportional to the offset."""
USUAL_OFFSET_M = 0.001
"""m, of a push in each direction: a smaller scatter of the offsets does not say how large b can be."""
MIN_SHARE_OF_MISSES_LEFT = 0.05
MIN_COSINE_OF_PUSH = 0.5
"""Of the angle between a push and the inward normal."""


@dataclass(frozen=True, slots=True, eq=False)
class TaxelOffsets:
    """Offsets of the n pushes on one taxel, in the order of its pokes."""

    offsets: FloatArray
    """(n, 3) float, m, from the estimated middle of the taxel to the contact, along the skin; NaN if unknown."""
    covariance: FloatArray
    """(3, 3) float, m^2, of the estimated middle."""
    normal: FloatArray
    """(3,) float, unit, outward."""


@dataclass(frozen=True, slots=True)
class PushLean:
    """b of (1) with its standard deviation."""

    value: float
    """rad/m."""
    sd: float
    """rad/m."""


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedTurns:
    """Turns with the correction for offsets."""

    skin: SkinTurns
    modules: Mapping[int, Turn]
    """By id."""
    lean: PushLean


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Turn of a taxel, or of the taxels of a module, with (1) at each of its n readings."""

    slopes: LeanSlopes
    variance: float
    """rad^2, mean of the variances of its readings."""
    by_lean: FloatArray
    """(3 n,) float: c."""
    by_place: FloatArray
    """(3 n, 2) float: change by an error of the middle in each of two directions along the skin, over b."""
    place_covariance: FloatArray
    """(2, 2) float, m^2, of the middle in these directions."""

    def project(self, columns: FloatArray) -> FloatArray:
        """Project columns (3 n, ...) with M."""
        return columns + self.slopes.by_turn @ self.solve_step(columns)

    def solve_step(self, columns: FloatArray) -> FloatArray:
        """Compute the steps (4, ...) of (omega, ln rho) that columns (3 n, ...) cause."""
        return -self.slopes.inverse @ (self.slopes.by_turn.T @ columns)


def measure_offsets(
    evidence: Evidence, estimates: Mapping[int, Estimate], pokes: Mapping[int, AxisPokes]
) -> dict[int, TaxelOffsets]:
    """Measure the offsets of the pokes of each taxel with a position: the contact is where the force axis crosses the skin.

    Parameters
    ----------
    evidence : force axes of these taxels
    estimates : by channel
    """
    found = dict[int, TaxelOffsets]()
    for place, channel in enumerate(evidence.channels.tolist()):
        estimate, own = estimates.get(channel), pokes.get(channel)
        if own is None or estimate is None or estimate.position is None or estimate.normal is None:
            continue
        if estimate.covariance is None:
            continue
        first, last = evidence.starts[place : place + 2].tolist()
        rows = first + np.argsort(evidence.pokes[first:last])
        at = np.searchsorted(evidence.pokes[rows], own.pokes).clip(max=len(rows) - 1)
        is_there = evidence.pokes[rows[at]] == own.pokes
        axes, points = evidence.directions[rows[at]], evidence.nearest[rows[at]] - estimate.position
        towards = axes @ estimate.normal
        # A push along the skin crosses it nowhere.
        along = np.where(is_there & (towards < -MIN_COSINE_OF_PUSH), towards, np.nan)
        offsets = points - axes * ((points @ estimate.normal) / along)[:, None]
        found[channel] = TaxelOffsets(offsets, estimate.covariance, estimate.normal)
    return found


class OffsetCorrection:
    """Corrects the turns of a session; keeps the derivatives of fits that did not change."""

    def __init__(self) -> None:
        self._slopes: dict[tuple[int, ...], tuple[TurnFit, LeanSlopes]] = {}
        """By the channels of a turn."""

    def correct(
        self,
        skin: SkinTurns,
        modules: Mapping[int, Turn],
        shared: Collection[int],
        offsets: Mapping[int, TaxelOffsets],
    ) -> CorrectedTurns:
        """Find b, and correct the turns of taxels and modules for it; taxels of a shared turn keep their own ones.

        Parameters
        ----------
        modules : turns of modules, by id
        shared : ids of the modules whose taxels share a turn; b is found from these, and from the taxels of the others
        offsets : by channel, of taxels whose position is known
        """
        hand = int(skin.is_mirrored)
        known = {channel: own for channel, own in offsets.items() if channel in skin.taxels}
        if not known:
            return CorrectedTurns(skin, modules, PushLean(0.0, LEAN_PRIOR_SD))
        in_shared = {channel for number in shared for channel in modules[number].channels}
        alone = [channel for channel in known if channel not in in_shared]
        of_taxels = {channel: self._group(skin.taxels[channel], hand, skin.pokes, known) for channel in alone}
        of_modules = {
            number: self._group(turn, hand, skin.pokes, known)
            for number, turn in modules.items()
            if not known.keys().isdisjoint(turn.channels)
        }
        judged = [of_modules[number] for number in sorted(shared) if number in of_modules] + list(of_taxels.values())
        lean, left = _find_lean(judged, known)
        taxels = {channel: _corrected(turn, hand, of_taxels.get(channel), lean, left) for channel, turn in skin.taxels.items()}
        corrected = {number: _corrected(turn, hand, of_modules.get(number), lean, left) for number, turn in modules.items()}
        return CorrectedTurns(replace(skin, taxels=taxels), corrected, lean)

    def _group(self, turn: Turn, hand: int, pokes: Mapping[int, AxisPokes], known: Mapping[int, TaxelOffsets]) -> _Group:
        fit = turn.fits[hand]
        kept = self._slopes.get(turn.channels)
        if kept is None or kept[0] is not fit:
            kept = fit, lean_slopes(joined([pokes[channel] for channel in turn.channels]), fit)
            self._slopes[turn.channels] = kept
        return _make_group(kept[1], fit, [(pokes[channel].forces, known.get(channel)) for channel in turn.channels])


def _make_group(slopes: LeanSlopes, fit: TurnFit, taxels: Sequence[tuple[FloatArray, TaxelOffsets | None]]) -> _Group:
    """Compute (1) for the forces (n, 3) and offsets of each taxel; one without offsets has no lean."""
    known = [own for _, own in taxels if own is not None]
    normal = np.sum([own.normal for own in known], axis=0)
    pair = orthonormal_pair(normal[None] / np.linalg.norm(normal))[0]
    leans, places = list[FloatArray](), list[FloatArray]()
    for forces, own in taxels:
        if own is None:
            leans.append(np.zeros_like(forces))
            places.append(np.zeros((len(forces), 3, 2)))
            continue
        push = -(forces @ own.normal) / np.linalg.norm(forces, axis=1)
        near = np.sum(own.offsets**2, axis=1) < MAX_OFFSET_M**2  # NaN is not near
        leans.append(np.where(near[:, None], -push[:, None] * own.offsets, 0.0))
        places.append(push[:, None, None] * pair.T)
    by_lean = np.einsum("nij,nj->ni", slopes.by_force, np.concatenate(leans)).ravel()
    by_place = np.einsum("nij,njk->nik", slopes.by_force, np.concatenate(places)).reshape(-1, 2)
    covariance = pair @ np.mean([own.covariance for own in known], axis=0) @ pair.T
    return _Group(slopes, float(fit.variances.mean()), by_lean, by_place, covariance)


def _find_lean(groups: Sequence[_Group], known: Mapping[int, TaxelOffsets]) -> tuple[PushLean, float]:
    """Find b by (2), and the share of the squared misses that is left with it."""
    misses = float(sum(group.slopes.rows @ group.slopes.rows for group in groups))
    pull = float(sum(group.by_lean @ group.project(group.slopes.rows) for group in groups))
    squares = float(sum(group.by_lean @ group.project(group.by_lean) for group in groups))
    offsets = np.concatenate([0.5 * np.sum(own.offsets**2, axis=1) for own in known.values()])
    near = offsets[offsets < 0.5 * MAX_OFFSET_M**2]
    usual = max(float(near.mean()) if len(near) else 0.0, USUAL_OFFSET_M**2)
    # A larger b would scatter the readings by more than they do, here with twice their noise.
    prior = min(LEAN_PRIOR_SD**2, 4.0 * float(np.mean([group.variance for group in groups])) / usual)
    information = squares + 1.0 / prior
    value = -pull / information
    left = float(np.clip(1.0 + value * pull / misses, MIN_SHARE_OF_MISSES_LEFT, 1.0)) if misses else 1.0
    variance = left / information
    # A value within its own error is noise (James and Stein).
    value = value * max(0.0, 1.0 - variance / value**2) if abs(value) > 0.0 else 0.0
    value += 0.0  # no negative zero
    return PushLean(value, float(np.sqrt(variance))), left


def _corrected(turn: Turn, hand: int, group: _Group | None, lean: PushLean, left: float) -> Turn:
    """Correct the fit of the skin's hand; the other one stays."""
    if group is None:
        return turn
    fits = list(turn.fits)
    fits[hand] = _corrected_fit(turn.fits[hand], group, lean, left)
    return replace(turn, fits=(fits[0], fits[1]))


def _corrected_fit(fit: TurnFit, group: _Group, lean: PushLean, left: float) -> TurnFit:
    by_lean, by_place = group.solve_step(group.by_lean), group.solve_step(group.by_place)
    step = lean.value * by_lean
    more = lean.sd**2 * np.outer(by_lean, by_lean)
    more += (lean.value**2 + lean.sd**2) * (by_place @ group.place_covariance @ by_place.T)
    share = left
    if not fit.is_in_plane_known:
        # The turn in the plane stays unknown.
        step[2] = more[2, :] = more[:, 2] = 0.0
        share = 1.0
    rotation = fit.rotation @ rotation_by(step[:3])
    covariance = share * fit.covariance + more
    return replace(fit, rotation=rotation, log_ratio=fit.log_ratio + float(step[3]), covariance=covariance)
