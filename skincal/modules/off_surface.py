"""Variance of a module's height over its surface: a mesh is drawn, scanned or mounted to a millimetre or two.

An estimate on a surface is wrong along its normal by the error of the mesh, and its own covariance has no such direction.
Pushes that lean to several sides meet at a height z over the mesh. With the whitened rows r = A x + h z of a module's pokes, A
their slopes with its unknowns x, h those with the height, T their trust and Q = T - T A (A'T A)^-1 A'T,

    z = h'Q r / h'Q h,   with the variance V = 1/(h'Q h) and the part of slow and shared errors (`NormalEquations`).

A z beyond two of its standard deviations is an error of the mesh, with the variance z^2 - V. A thick skin is touched above its
taxels and looks like a mesh that is too low, so its thickness is subtracted from a positive z. If pushes hardly lean, V is
large.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry import FloatArray, dots
from skincal.modules.pose_fit import ModuleRows
from skincal.taxels.shared_errors import NormalEquations

SUBTRACTED_SKIN_THICKNESS_SDS = 1.0
"""Thickness of the skin that is subtracted, in its standard deviations."""
SIGNIFICANT_HEIGHT_MIN_SDS = 2.0
"""A lower height, in its standard deviations, may be chance."""
HEIGHT_MAX_SD_M = 0.0015
"""A height with a larger sd by the noise of its pokes is ignored: meshes are not wrong by much more."""
MIN_HEIGHT_INFORMATION_SHARE = 1e-6
"""Share of h'T h below which the information on the height is rounding."""


def off_surface_variances(
    equations: NormalEquations,
    rows: ModuleRows,
    trust: FloatArray,
    factors: FloatArray,
    skin: float,
    errors: tuple[FloatArray, FloatArray] | None,
) -> FloatArray:
    """Estimate (b,) the variances of the heights of b modules, m^2; 0 if their pokes show none.

    Parameters
    ----------
    rows, trust : of the pokes of `equations`
    factors : (b,) `variance_factors`
    skin : sd of the skin's thickness, m
    errors : result of `SharedRows` for these pokes
    """
    outward = dots(equations.pairs, equations.normals[:, None])[:, None]
    rise = dots(rows.whiten, outward)
    of = equations.group_of_poke
    pull = np.add.reduceat(dots(equations.row_weights, outward), equations.starts)
    along = (equations.inverse @ pull[:, :, None])[:, :, 0]
    alone = trust[:, None] * (rise - dots(rows.slopes, along[of][:, None]))
    known, most = (np.add.reduceat(dots(each, rise), equations.starts) for each in (alone, trust[:, None] * rise))
    tells = known > MIN_HEIGHT_INFORMATION_SHARE * most
    known = np.where(tells, known, 1.0)
    heights = np.add.reduceat(dots(alone, rows.misses), equations.starts) / known
    lifted = equations.of_other_unknowns(alone[:, None] @ rows.whiten, known[:, None, None])
    heights = np.minimum(heights, np.maximum(heights - SUBTRACTED_SKIN_THICKNESS_SDS * skin, 0.0))
    white = factors / known
    variances = white + lifted.covariances(0.0)[:, 0, 0]
    if errors is not None:
        moves, of_poses = lifted.shift_by_errors(*errors)
        variances += np.sum(moves[:, 0] ** 2, axis=1) + of_poses[:, 0, 0]
    seen = tells & (white < HEIGHT_MAX_SD_M**2) & (heights**2 > SIGNIFICANT_HEIGHT_MIN_SDS**2 * variances)
    return np.where(seen, heights**2 - variances, 0.0)
