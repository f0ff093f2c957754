"""How far a module lies off the surface that it is laid on: the mesh is drawn, scanned or mounted to a millimetre or two.

An estimate on a surface is wrong along its normal by what the mesh is, and its own covariance has no such direction. Pushes
that lean from several sides meet at a height z over the mesh. With the whitened rows r = A x + h z of a module's pokes, A
their slopes with its unknowns x, h those with the height, T their trust and Q = T - T A (A'T A)^-1 A'T,

    z = h'Q r / h'Q h,   with the variance V = 1/(h'Q h) and what slow and shared errors add (`NormalEquations`).

A z of more than two of its standard deviations is the mesh's, with the variance z^2 - V. A thick skin is touched above its
taxels and looks like a mesh that lies too low: what it explains is taken off a positive z first. Where pushes hardly lean V is
large, and nothing is seen.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.geometry import FloatArray, IntArray, dots
from skincal.modules.pose_fit import ModuleRows
from skincal.taxels.shared_errors import NormalEquations

THICKEST = 1.0
"""Standard deviations that a skin may be thick: it is touched above its taxels, as if the mesh lay too low."""
SEEN = 2.0
"""Standard deviations of a height above which it is no chance."""
TOLD = 0.0015
"""m, standard deviation of a height, by the noise of its pokes alone, from which on it says nothing:
meshes are not wrong by much more."""
NO_HEIGHT = 1e-6
"""Share of h'T h below which pushes say nothing of the height: it is rounding."""


def off_surface_variances(
    held: NormalEquations,
    rows: ModuleRows,
    order: IntArray,
    trust: FloatArray,
    factors: FloatArray,
    skin: float,
    errors: tuple[FloatArray, FloatArray] | None,
) -> FloatArray:
    """Return (b,) the variance of how far b modules lie off their surface, m^2: what their own pokes show of it, or 0.

    Parameters
    ----------
    held : how the pokes hold the modules
    rows, order : of the pokes, and where those of `held` are among them
    trust : (m,) float, 0 to 1, of the pokes of `held`
    factors : (b,) `variance_factors`
    skin : sd of the skin's thickness, m
    errors : what `SharedRows` gives of the pokes of `held`
    """
    slopes, misses, whiten = rows.slopes[order], rows.misses[order], rows.whiten[order]
    outward = dots(held.pairs, held.normals[:, None])[:, None]
    rise = dots(whiten, outward)
    of = np.repeat(np.arange(len(held.starts)), np.diff(np.append(held.starts, len(held.pokes))))
    pull = np.add.reduceat(dots(held.pulls, outward), held.starts)
    along = (held.inverse() @ pull[:, :, None])[:, :, 0]
    alone = trust[:, None] * (rise - dots(slopes, along[of][:, None]))
    known, most = (np.add.reduceat(dots(each, rise), held.starts) for each in (alone, trust[:, None] * rise))
    tells = known > NO_HEIGHT * most
    known = np.where(tells, known, 1.0)
    heights = np.add.reduceat(dots(alone, misses), held.starts) / known
    lifted = replace(held, pulls=(alone[:, None] @ whiten), held=known[:, None, None])
    heights = np.minimum(heights, np.maximum(heights - THICKEST * skin, 0.0))
    white = factors / known
    variances = white + lifted.covariances(0.0)[:, 0, 0]
    if errors is not None:
        moves, of_poses = lifted.moves(*errors)
        variances += np.sum(moves[:, 0] ** 2, axis=1) + of_poses[:, 0, 0]
    seen = tells & (white < TOLD**2) & (heights**2 > SEEN**2 * variances)
    return np.where(seen, heights**2 - variances, 0.0)
