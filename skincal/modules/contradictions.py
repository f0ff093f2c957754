"""Taxels whose own pokes contradict the place that their module gives them: most often two exchanged channels.

A poke that a taxel answers most is its own. It **denies** the taxel's place if it is an outlier of the module and its axis
misses the place by more than the tolerance: one and a half spacings, and 2.5 times the median of all own pokes of the module.
So a poke between neighbours denies nothing, nor do rig errors, which all pokes share. An answer **agrees** if it is no outlier
and within the tolerance. A taxel is contradicted if an own poke denies its place and no answer agrees, strong or weak. An
outlier whose axis passes the place does neither: its poke may have touched a second point, or a taxel whose channel is
exchanged answered it, too.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.modules.pose_fit import Touches
from skincal.taxels.contact_table import Evidence
from skincal.taxels.result import MIN_TRUST_OF_A_TOUCH, Cause, StateReason

DENIAL_MISS_OVER_SPACING = 1.5
"""Smallest miss of a poke that denies a place, over the spacing: farther than a direct neighbour, straight or diagonal."""
DENIAL_MISS_OVER_MEDIAN = 2.5
"""Smallest miss of a poke that denies a place, over the median miss: 1 of 75 good pokes misses by more, if both directions of a
miss are normal."""


def find_contradicted(
    touches: Touches, module_of_pad: IntArray, points: FloatArray, trust: FloatArray, spacing: float
) -> dict[int, StateReason]:
    """Find the contradicted taxels of fitted modules: channel to reason.

    Parameters
    ----------
    module_of_pad : (n,) index in `touches.modules` of each pad
    points : (n, 3) float, metres: the pads as the modules place them
    trust : (m,) float, 0 to 1: of the pokes of `touches`
    spacing : m, of the layout; infinite for a single taxel
    """
    evidence = touches.evidence
    pad_of_channel = np.full(int(max(touches.channels.max(), evidence.channels.max())) + 1, -1, dtype=np.int64)
    pad_of_channel[touches.channels] = np.arange(len(touches.channels))
    pads = pad_of_channel[evidence.channels][evidence.taxels]
    placed = np.flatnonzero(pads >= 0)
    pads, own = pads[placed], evidence.weights[placed] >= 1.0
    modules = module_of_pad[pads]
    good = _trust_by_module(touches, trust, modules, evidence.pokes[placed]) >= MIN_TRUST_OF_A_TOUCH
    if not (own & ~good).any():
        return {}
    misses = _misses(evidence, placed, points[pads])
    tolerances = np.full(len(touches.modules), DENIAL_MISS_OVER_SPACING * spacing)
    for module in np.unique(modules[own]).tolist():
        median = float(np.median(misses[own & (modules == module)]))
        tolerances[module] = max(tolerances[module], DENIAL_MISS_OVER_MEDIAN * median)
    near = misses <= tolerances[modules]
    denies = own & ~near & ~good
    if not denies.any():
        return {}
    agrees = near & good
    found = np.setdiff1d(pads[denies], pads[agrees])
    return dict(_reasons(touches, found, pads[denies], misses[denies]))


def _reasons(touches: Touches, found: IntArray, pads: IntArray, misses: FloatArray) -> Iterator[tuple[int, StateReason]]:
    for pad in found.tolist():
        every = misses[pads == pad]
        yield int(touches.channels[pad]), StateReason(Cause.CONTRADICTED, len(every), size=float(np.median(every)))


def _misses(evidence: Evidence, rows: IntArray, points: FloatArray) -> FloatArray:
    """Compute (r,) the distances, metres, of the axes of the answers `rows` (r,) from points (r, 3)."""
    off = evidence.pairs[rows] @ (points - evidence.nearest[rows])[:, :, None]
    return np.sqrt(np.sum(off[:, :, 0] ** 2, axis=1))


def _trust_by_module(touches: Touches, trust: FloatArray, modules: IntArray, pokes: IntArray) -> FloatArray:
    """Look up (r,) the trust of pokes (r,) in the fits of modules (r,); 0 for a poke that counts for another module."""
    step = int(touches.evidence.pokes.max()) + 1
    judged, asked = touches.of * step + touches.evidence.pokes[touches.rows], modules * step + pokes
    order = np.argsort(judged)
    at = np.minimum(np.searchsorted(judged[order], asked), len(judged) - 1)
    return np.where(judged[order][at] == asked, trust[order][at], 0.0)
