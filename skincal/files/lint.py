"""Checks on a calibration before it is written; each exists because a published position file had that fault.

Sources: the history of icub-main `app/skinGui/conf/positions` (a typo of 10 cm in the torso 29cc1b07e, a mirrored
patch c89409d3a, swapped patches 60dcc37a5, a wrong column ab19cf6a9), and the statistics of the files themselves:
copies of a neighbour's position, normals of length 0.6 to 1, taxels missing in a module.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.files.calibration import Calibration, PlacedTaxels, placed_taxels
from skincal.files.icub import ORIGIN_RADIUS
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.geometry.wrench import cross_matrix
from skincal.model.errors import list_channels, plural
from skincal.model.skin import Layout, Module
from skincal.taxels.result import Method

BOX_MARGIN = 0.020
"""m. A taxel lies on the part: the paper's largest error is 19.4 mm, a typo is 100 mm."""
SAME_PLACE = 1e-6
"""m. Positions nearer than the file's last digit are one position."""
UNIT_TOLERANCE = 1e-6
"""A unit vector of doubles is unit to 1e-15; more than this was never normalised."""
CHIRALITY_TAXELS = 6
"""Least taxels of a module whose handedness is judged: three more than a plane fit uses up."""
CHIRALITY_RATIO = 0.6
"""The mirrored layout must fit this much better to say so; the paper's modules fit 2.1 mm straight, 10.4 mm mirrored."""
NEIGHBOUR_SPACINGS = 1.3
"""Taxels of one module within this many spacings are neighbours: 1.0 apart, the next ring is 1.7."""
SPACING_RATIOS = (0.7, 1.4)
"""Median distance of neighbours over that of the layout: 4 to 6 mm for 5 mm, and room for scatter, which widens it."""


@dataclass(frozen=True, slots=True, eq=False)
class LintReference:
    """Where the skin should be, as far as it is known otherwise."""

    points: FloatArray
    """(n, 3) float, metres: the surface's vertices, or the places as planned."""
    normals: FloatArray | None
    """(taxels, 3) float, unit, outward: for each placed taxel that of the nearest place; None where unknown."""
    what: str
    """Such as `"the surface"`."""


def lint(calibration: Calibration, method: Method, reference: LintReference | None = None) -> tuple[str, ...]:
    """Return one sentence for each fault of one method's positions; none if it is fit to be loaded."""
    taxels = placed_taxels(calibration.of(method))
    name = method.value
    if not len(taxels.channels):
        return (f"{name}: no taxel has a position; poke some more before you load such a file.",)
    finite = np.asarray(np.isfinite(np.hstack([taxels.positions, taxels.normals])).all(axis=1))
    sentences = _bad_numbers(taxels, finite)
    good = PlacedTaxels(taxels.channels[finite], taxels.positions[finite], taxels.normals[finite], taxels.sd[finite])
    sentences += [*_at_origin(good), *_same_place(good), *_normal_lengths(good)]
    if reference is not None:
        sentences += _outside(good, reference)
        if reference.normals is not None:
            sentences += _inward(good, reference.normals[finite], reference.what)
    layout = calibration.scene.skin.layout
    if layout is not None:
        sentences += [
            *_wrong_channels(good, layout),
            *_mirrored(good, layout),
            *_spacing(good, layout),
            *_centres(good, layout),
        ]
    return tuple(f"{name}: {sentence}" for sentence in sentences)


def _bad_numbers(taxels: PlacedTaxels, finite: NDArray[np.bool_]) -> list[str]:
    bad = taxels.channels[~finite]
    return [f"NaN or infinite position or normal: channels {list_channels(bad)}."] if len(bad) else []


def _at_origin(taxels: PlacedTaxels) -> list[str]:
    zero = taxels.channels[np.abs(taxels.positions).max(axis=1, initial=0.0) <= ORIGIN_RADIUS]
    return [f"at 0 0 0, which readers take as no taxel: channels {list_channels(zero)}."] if len(zero) else []


def _same_place(taxels: PlacedTaxels) -> list[str]:
    # Neighbouring cells are not compared: copies agree in every digit.
    cells = np.round(taxels.positions / SAME_PLACE).astype(np.int64)
    _, group, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    shared = taxels.channels[count[group.ravel()] > 1]
    if not len(shared):
        return []
    return [f"the same position for several taxels, so at most one is right: channels {list_channels(shared)}."]


def _normal_lengths(taxels: PlacedTaxels) -> list[str]:
    lengths = np.linalg.norm(taxels.normals, axis=1)
    off = taxels.channels[(lengths > 0) & (np.abs(lengths - 1.0) > UNIT_TOLERANCE)]
    without = taxels.channels[lengths == 0]
    sentences = [f"a normal that is not unit: channels {list_channels(off)}."] if len(off) else []
    if len(without):
        sentences.append(f"no normal, written as 0 0 0: channels {list_channels(without)}.")
    return sentences


def _outside(taxels: PlacedTaxels, reference: LintReference) -> list[str]:
    low, high = reference.points.min(axis=0) - BOX_MARGIN, reference.points.max(axis=0) + BOX_MARGIN
    beyond = np.maximum(low - taxels.positions, taxels.positions - high).max(axis=1)
    out = beyond > 0
    if not out.any():
        return []
    return [
        f"more than {BOX_MARGIN * 1e3:.0f} mm outside the box of {reference.what}, by up to "
        f"{beyond.max() * 1e3:.0f} mm more: channels {list_channels(taxels.channels[out])}; check units, frame and arm pose."
    ]


def _inward(taxels: PlacedTaxels, outward: FloatArray, what: str) -> list[str]:
    inward = taxels.channels[np.sum(taxels.normals * outward, axis=1) < 0]
    if not len(inward):
        return []
    return [f"a normal that points into the part, against {what}: channels {list_channels(inward)}; check the wrench's sign."]


def _wrong_channels(taxels: PlacedTaxels, layout: Layout) -> list[str]:
    wrong = np.setdiff1d(taxels.channels, layout.channels)
    return [f"a position where the layout has no taxel: channels {list_channels(wrong)}."] if len(wrong) else []


def _pads_of(module: Module, taxels: PlacedTaxels) -> tuple[IntArray, IntArray]:
    """Return the indices of a module's placed taxels among its channels, and among the placed."""
    _, own, placed = np.intersect1d(module.channels, taxels.channels, return_indices=True)
    return own, placed


def _mirrored(taxels: PlacedTaxels, layout: Layout) -> list[str]:
    mirrored: list[int] = []
    for module in layout.modules:
        own, placed = _pads_of(module, taxels)
        normal = taxels.normals[placed].sum(axis=0)
        if len(own) >= CHIRALITY_TAXELS and np.linalg.norm(normal) > 0 and _looks_mirrored(
            module.pads[own], taxels.positions[placed], normal / np.linalg.norm(normal)
        ):  # fmt: skip
            mirrored.append(module.id)
    if not mirrored:
        return []
    return [
        f"mirrored against the layout, seen from outside: modules {list_channels(mirrored)}; check mirror and channel order."
    ]


def _looks_mirrored(pads: FloatArray, positions: FloatArray, normal: FloatArray) -> bool:
    """Return whether the mirror image of `pads` (k, 2) fits `positions` (k, 3), seen against `normal`, clearly better."""
    # Two directions across the normal: the plane in which the pads are compared.
    turn = cross_matrix(normal)
    across = turn @ np.eye(3)[np.abs(normal).argmin()]
    across = across / np.linalg.norm(across)
    flat = np.stack([positions @ across, positions @ (turn @ across)], axis=1)
    straight = _misfit(pads, flat)
    return _misfit(pads * np.array([-1.0, 1.0]), flat) < CHIRALITY_RATIO * straight


def _misfit(pads: FloatArray, flat: FloatArray) -> float:
    """Return the least |R pads + t - flat| over rotations R of the plane and shifts t; both (k, 2)."""
    a, b = pads - pads.mean(axis=0), flat - flat.mean(axis=0)
    # |R a - b|^2 = |a|^2 + |b|^2 - 2 (cos sum(a . b) + sin sum(a x b)), least where the angle has their direction.
    together = np.hypot(np.sum(a * b), np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    least = float(np.sum(a * a) + np.sum(b * b) - 2 * together)
    return max(least, 0.0) ** 0.5


def _spacing(taxels: PlacedTaxels, layout: Layout) -> list[str]:
    ratios: list[float] = []
    for module in layout.modules:
        own, placed = _pads_of(module, taxels)
        # Every pair of the module's taxels once.
        first, second = np.triu_indices(len(own), 1)
        pads, positions = module.pads[own], taxels.positions[placed]
        planned = np.linalg.norm(pads[first] - pads[second], axis=1)
        near = planned < NEIGHBOUR_SPACINGS * layout.spacing
        distances = np.linalg.norm(positions[first[near]] - positions[second[near]], axis=1)
        ratios += (distances / planned[near]).tolist()
    if not ratios:
        return []
    ratio = float(np.median(ratios))
    if SPACING_RATIOS[0] <= ratio <= SPACING_RATIOS[1]:
        return []
    return [
        f"neighbours lie {ratio:.2f} times as far apart as in the layout (median of {plural(len(ratios), 'pair')}); expected "
        f"{SPACING_RATIOS[0]} to {SPACING_RATIOS[1]}: poke more from other sides, or check the layout's unit."
    ]


def _centres(taxels: PlacedTaxels, layout: Layout) -> list[str]:
    placed = set(taxels.channels.tolist())
    lacking = [m.id for m in layout.modules if m.centre_channel not in placed and not placed.isdisjoint(m.channels.tolist())]
    if not lacking:
        return []
    return [f"no position for the centre taxel, which stands for the module in taxel2Repr: modules {list_channels(lacking)}."]
