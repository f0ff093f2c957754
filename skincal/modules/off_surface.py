"""Variance of a module's height over its surface: a mesh is drawn, scanned or mounted to a millimetre or two.

An estimate on a surface is wrong along its normal by the error of the mesh, and its own covariance has no such direction.
Pushes that lean to several sides meet at a height z over the mesh. With the whitened rows r = A x + h z of a module's pokes, A
their slopes with its unknowns x, h those with the height, T their trust and Q = T - T A (A'T A)^-1 A'T,

    z = h'Q r / h'Q h,   with the variance V = 1/(h'Q h) and the part of slow and shared errors (`shared_errors.py`).

A z beyond two of its standard deviations is an error of the mesh, with the variance z^2 - V. A thick skin is touched above its
taxels and looks like a mesh that is too low, so its thickness is subtracted from a positive z. If pushes hardly lean, V is
large.

The compiled solver finds it with the other errors that pokes share (`spread.h`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import ModulesOnSurface
from skincal.modules.pose_fit import ModuleRows, Touches
from skincal.solver.machine import shared
from skincal.taxels.shared_errors import nothing_shared, shared_rows_in_solver, spread_rules

SUBTRACTED_SKIN_THICKNESS_SDS = 1.0
"""Thickness of the skin that is subtracted, in its standard deviations."""
SIGNIFICANT_HEIGHT_MIN_SDS = 2.0
"""A lower height, in its standard deviations, may be chance."""
HEIGHT_MAX_SD_M = 0.0015
"""A height with a larger sd by the noise of its pokes is ignored: meshes are not wrong by much more."""
MIN_HEIGHT_INFORMATION_SHARE = 1e-6
"""Share of h'T h below which the information on the height is rounding."""


def height_rules() -> Mapping[str, float]:
    """Return the values of `HeightRules` of `skincal/solver/tables.py`."""
    return {
        "min_information_share": MIN_HEIGHT_INFORMATION_SHARE,
        "subtracted_skin_sds": SUBTRACTED_SKIN_THICKNESS_SDS,
        "max_sd": HEIGHT_MAX_SD_M,
        "significant_sds": SIGNIFICANT_HEIGHT_MIN_SDS,
    }


@dataclass(frozen=True, slots=True, eq=False)
class ModuleErrors:
    """Errors that many pokes share, of b modules with d unknowns, and n errors of all pokes."""

    factors: FloatArray
    """(b,) `variance_factors`."""
    added: FloatArray
    """(b, d, d) float, m^2: covariance of the unknowns by slow errors, the skin's thickness and errors of arm poses."""
    moves: FloatArray
    """(b, d, n) float, metres: shifts of the unknowns; n is 0 without a correction."""
    heights: FloatArray
    """(b,) float, m^2: variance of the height over the surface; 0 if the pokes show none, and without a surface."""


def spread_over_modules(
    touches: Touches,
    rows: ModuleRows,
    trust: FloatArray,
    noise: NoiseSettings,
    errors: tuple[FloatArray, FloatArray] | None,
    inverse: FloatArray | None = None,
) -> ModuleErrors:
    """Find how errors that many pokes share move the modules of `touches`.

    Parameters
    ----------
    rows, trust : of the pokes
    errors : result of `SharedRows` for these pokes; `None` without a correction of the rig
    inverse : (b, d, d) of the information of the pokes and the prior of sheets; then factors are 1. `None` for boards
    """
    evidence, at = touches.evidence, touches.rows
    modules, unknowns = len(touches.modules), rows.slopes.shape[2]
    starts = np.searchsorted(touches.of, np.arange(modules + 1))
    is_on_surface = inverse is not None or unknowns == ModulesOnSurface.unknowns
    shared_rows = nothing_shared(len(at)) if errors is None else errors
    found = shared().run(
        "spread_modules",
        modules=modules,
        rows=len(at),
        unknowns=unknowns,
        starts=starts,
        columns=evidence.columns.take(at, axis=1),
        poses=evidence.poses[at],
        pokes=evidence.pokes[at],
        slopes=rows.slopes,
        misses=rows.misses,
        whiten=rows.whiten,
        normals=rows.normals,
        trust=trust,
        rules=spread_rules(noise),
        heights_by=height_rules() if is_on_surface else None,
        given=inverse is not None,
        inverses=(modules, unknowns, unknowns) if inverse is None else inverse,
        factors=np.ones(modules),
        added=(modules, unknowns, unknowns),
        moves=(modules, unknowns, shared_rows[0].shape[2]),
        heights=(modules,),
        **shared_rows_in_solver(shared_rows, is_corrected=errors is not None),
    )
    return ModuleErrors(found["factors"], found["added"], found["moves"], found["heights"])
