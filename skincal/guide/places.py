"""Where each taxel is believed to be: by the layout laid on the part, corrected by what was measured.

A skin lies beside its plan as a whole, then module by module, then taxel by taxel. Each step takes the mean of what the
measured taxels are off, weighted by how well they are known, and drawn to zero by how far off they may be at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.guide.knowledge import solved
from skincal.mesh.lay import LaidSkin
from skincal.model.skin import Layout
from skincal.taxels.result import Estimate

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


def plan_from(layout: Layout, laid: LaidSkin) -> PlannedPlaces | None:
    """Return where a laid layout puts the taxels, without those that it puts nowhere; None where it puts none."""
    channels = layout.channels
    channels = channels[np.isfinite(laid.places[channels]).all(axis=1)]
    if not len(channels):
        return None
    return PlannedPlaces(channels, laid.places[channels], laid.normals[channels], layout.module_of[channels])


def unplaced(channels: IntArray, modules: IntArray | None = None) -> PlannedPlaces:
    """Return a plan that puts none of `channels` (n,) anywhere: there is no layout, or it lies nowhere.

    `modules` is (n,) the index of each channel's module; None without a layout.
    """
    nowhere = np.full((len(channels), 3), np.nan)
    return PlannedPlaces(
        channels, nowhere, nowhere.copy(), np.zeros(len(channels), dtype=np.int64) if modules is None else modules
    )


def believed(plan: PlannedPlaces, estimates: Sequence[Estimate], rig: float = 0.0) -> FloatArray:
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
