"""Where each taxel is believed to be: by the layout laid on the part, corrected by what was measured.

A skin lies beside its plan as a whole, then module by module, then taxel by taxel. Each step takes the mean of what the
measured taxels are off, weighted by how well they are known, and drawn to nought by how far off they may be at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.estimate.result import Estimate
from skincal.guide.knowledge import solved
from skincal.readings import FloatArray, IntArray
from skincal.skin import Layout
from skincal.surface.lay import LaidSkin

WHOLE = 0.006
"""m, sd of the whole skin beside its plan, each direction: by hand it is put on to a few millimetres."""
MODULE = 0.002
"""m, sd of a module beside where the whole puts it: turns of the skin, and its bend."""
SPACING = 0.005
"""m, of neighbouring taxels where no layout tells it: the iCub's and most others'."""
TAXEL = 0.001
"""m, sd of a taxel beside where its module puts it: pads are printed to less; the surface is not the part."""
FLOOR = 0.0005
"""m, sd: no estimate is taken for better known, so that one does not outvote the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Where the layout puts n taxels, link frame."""

    channels: IntArray
    """(n,)."""
    places: FloatArray
    """(n, 3) float, metres; NaN where the layout does not say."""
    normals: FloatArray
    """(n, 3) float, unit, outward; NaN likewise."""
    modules: IntArray
    """(n,) index of the module, from 0."""


def plan_from(layout: Layout, laid: LaidSkin) -> Plan | None:
    """Return where a laid layout puts the taxels, without those that it puts nowhere; None where it puts none."""
    channels = layout.channels
    channels = channels[np.isfinite(laid.places[channels]).all(axis=1)]
    if not len(channels):
        return None
    return Plan(channels, laid.places[channels], laid.normals[channels], layout.module_of[channels])


def unplaced(channels: IntArray) -> Plan:
    """Return a plan that puts none of `channels` (n,) anywhere: there is no layout."""
    nowhere = np.full((len(channels), 3), np.nan)
    return Plan(channels, nowhere, nowhere.copy(), np.zeros(len(channels), dtype=np.int64))


def believed(plan: Plan, estimates: Sequence[Estimate]) -> FloatArray:
    """Return (n, 3) the believed places, metres; NaN where neither plan nor estimate says anything.

    Parameters
    ----------
    estimates : one a taxel, in the plan's order
    """
    measured, precision = _measured(estimates)
    off = np.where(np.isfinite(plan.places), measured - plan.places, np.nan)
    known = np.isfinite(off).all(axis=1)
    shift = _drawn(off[known], precision[known], np.zeros(int(known.sum()), dtype=np.int64), 1, WHOLE)[0]
    rest = off - shift
    count = int(plan.modules.max(initial=-1)) + 1
    shifts = shift + _drawn(rest[known], precision[known], plan.modules[known], count, MODULE)
    places = plan.places + shifts[plan.modules] if count else plan.places.copy()
    return _with_own(places, measured, precision)


def _measured(estimates: Sequence[Estimate]) -> tuple[FloatArray, FloatArray]:
    """Return (n, 3) positions, NaN without, and (n, 3, 3) their precisions, 1/m^2."""
    positions, covariances = np.full((len(estimates), 3), np.nan), np.zeros((len(estimates), 3, 3))
    for i, one in enumerate(estimates):
        if one.position is not None and one.covariance is not None:
            positions[i], covariances[i] = one.position, one.covariance
    precision = np.asarray(np.linalg.inv(covariances + FLOOR**2 * np.eye(3)), dtype=np.float64)
    precision[np.isnan(positions[:, 0])] = 0.0
    return positions, precision


def _drawn(off: FloatArray, precision: FloatArray, groups: IntArray, count: int, sd: float) -> FloatArray:
    """Return (count, 3) the weighted means of `off` (m, 3) in each group, drawn to nought by `sd`."""
    total, pull = np.tile(np.eye(3) / sd**2, (count, 1, 1)), np.zeros((count, 3))
    np.add.at(total, groups, precision)
    np.add.at(pull, groups, (precision @ off[:, :, None])[:, :, 0])
    return solved(total, pull)


def _with_own(places: FloatArray, measured: FloatArray, precision: FloatArray) -> FloatArray:
    """Return the places with each taxel's own estimate taken in, as far as it is better known."""
    off = np.nan_to_num(measured - places)
    own = solved(precision + np.eye(3) / TAXEL**2, (precision @ off[:, :, None])[:, :, 0])
    return np.where(np.isfinite(places), places + own, measured)
