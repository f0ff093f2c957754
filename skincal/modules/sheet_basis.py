"""Deformation of a soft sheet in its own plane: a stretch of the whole, and a smooth random field.

A point b of the sheet, metres from its middle, is moved in the plane by

    d(b) = E b + g(b),   E = [[e_1, e_3], [e_3, e_2]],

before the sheet follows the part by its geodesics. The turn and the shift of the whole are its pose. The three strains e are
random with the standard deviation k `STRAIN_SD`. Each of the two components of the field g is a random walk over the plane:

    sd of g(a) - g(b) = s `FIELD_STEP_SD_M` sqrt(|a - b| / `FIELD_STEP_LENGTH_M`).

So neighbours move nearly alike, far taxels do not, and a fold, where the sheet jumps by millimetres, is a large step and no
contradiction. The scales k and s are learned from the pokes (`sheet_fit.py`).

**Basis.** The mean of g is a shift and belongs to the pose, so g has the covariance s^2 K: the variogram centred over nodes z,

    K(a, b) = -v/2 (|a - b| - mean_z |a - z| - mean_z |b - z| + mean_zz' |z - z'|),
    v = `FIELD_STEP_SD_M`^2 / `FIELD_STEP_LENGTH_M`,

which is not negative (Schoenberg). With K(z, z') = U L U' the modes K(x, z) U L^-1 have independent coefficients of the
variances s^2 L. The nodes are the taxels, at most `NODES_MAX` evenly spread ones. Of more than `MODES_MAX` modes the leading
ones are kept; the variance of the rest is independent between taxels and stays in their covariance (`left_out`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray

STRAIN_SD = 0.01
"""sd of the three strains for k = 1: a sheet is glued by hand without a pull that one sees."""
FIELD_STEP_SD_M, FIELD_STEP_LENGTH_M = 0.001, 0.100
"""sd of the field's difference between two points at that distance, in each direction, for s = 1."""
STRAIN_TO_LENGTH_M = 0.100
"""Strains are counted as the displacement at this distance, so that all unknowns are metres."""
NODES_MAX = 192
"""Nodes of the basis: their eigenvectors take 15 ms, once a sheet."""
MODES_MAX = 64
"""Modes of the field. Up to 65 taxels these are all; of 256 taxels they have nine tenths of the variance."""
MODE_MIN_VARIANCE_RATIO = 1e-9
"""Modes with a smaller share of the largest variance are rounding."""
EQUAL_MODES_RATIO = 1.001
"""Modes whose variances differ by less are kept or left out together: which of them comes first is rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class SheetBasis:
    """Deformations of a sheet with n taxels: 3 strains and M modes for each of two directions."""

    flat: FloatArray
    """(n, 2) float, metres: undeformed positions about the middle."""
    strains: FloatArray
    """(n, 2, 3) float: displacement of each taxel by the three strains."""
    modes: FloatArray
    """(n, M) float: displacement of each taxel by the modes, the same in both directions."""
    variances: FloatArray
    """(M,) float, m^2: of the modes' coefficients for s = 1."""
    left_out: FloatArray
    """(n,) float, m^2: variance of each taxel, in each direction, by the modes that are left out, for s = 1."""

    @property
    def unknowns(self) -> int:
        """Number of coefficients: three strains, then two for each mode."""
        return 3 + 2 * len(self.variances)

    def select(self, taxels: IntArray) -> SheetBasis:
        """Keep the given taxels."""
        rows = self.flat[taxels], self.strains[taxels], self.modes[taxels]
        return SheetBasis(*rows, self.variances, self.left_out[taxels])

    def displaced(self, coefficients: FloatArray) -> FloatArray:
        """Deformed positions (n, 2), metres, in the sheet's plane."""
        return self.flat + self.strains @ coefficients[:3] + self.modes @ coefficients[3:].reshape(-1, 2)

    def precisions(self, stretch: float, field: float) -> FloatArray:
        """Prior precisions, 1/m^2, of the coefficients for the scales k (`stretch`) and s (`field`)."""
        of_strains = np.full(3, (stretch * STRAIN_SD * STRAIN_TO_LENGTH_M) ** -2)
        return np.concatenate([of_strains, np.repeat(1.0 / (field**2 * self.variances), 2)])


def make_basis(flat: FloatArray) -> SheetBasis:
    """Make the basis of a sheet with taxels at `flat` (n, 2), metres, about its middle."""
    x, y = flat.T / STRAIN_TO_LENGTH_M
    nothing = np.zeros(len(flat))
    strains = np.stack([np.stack([x, nothing, y], axis=1), np.stack([nothing, y, x], axis=1)], axis=1)
    nodes = flat[_spread_nodes(flat)]
    between, to_nodes = _distances(nodes, nodes), _distances(flat, nodes)
    mean_of_nodes, mean_of_taxels = between.mean(axis=1), to_nodes.mean(axis=1)
    per_length = FIELD_STEP_SD_M**2 / FIELD_STEP_LENGTH_M
    of_nodes, across = (
        -0.5 * per_length * (apart - own[:, None] - mean_of_nodes + mean_of_nodes.mean())
        for apart, own in ((between, mean_of_nodes), (to_nodes, mean_of_taxels))
    )
    of_taxels = per_length * (mean_of_taxels - 0.5 * mean_of_nodes.mean())
    values, vectors = np.linalg.eigh((of_nodes + of_nodes.T) / 2.0)
    values, vectors = values[::-1], vectors[:, ::-1]
    kept = _count_kept(values)
    # Unit rms over the nodes: the coefficients are metres.
    unit = float(np.sqrt(len(nodes)))
    modes = (across @ vectors[:, :kept]) / values[:kept] * unit
    variances = values[:kept] / unit**2
    left_out = np.maximum(of_taxels - modes**2 @ variances, 0.0)
    return SheetBasis(flat, strains, modes, variances, left_out)


def _count_kept(values: FloatArray) -> int:
    """Count the leading modes to keep, of descending variances."""
    there = int(np.sum(values > MODE_MIN_VARIANCE_RATIO * max(float(values[0]), 0.0)))
    kept = min(there, MODES_MAX)
    while 0 < kept < there and values[kept - 1] < EQUAL_MODES_RATIO * values[kept]:
        kept -= 1
    return kept


def _spread_nodes(flat: FloatArray) -> IntArray:
    """Choose at most `NODES_MAX` taxels, each the farthest from those before."""
    if len(flat) <= NODES_MAX:
        return np.arange(len(flat))
    nodes, nearest = [0], np.full(len(flat), np.inf)
    for _ in range(NODES_MAX - 1):
        nearest = np.minimum(nearest, np.sum((flat - flat[nodes[-1]]) ** 2, axis=1))
        nodes.append(int(nearest.argmax()))
    return np.sort(np.array(nodes))


def _distances(points: FloatArray, others: FloatArray) -> FloatArray:
    return np.sqrt(np.sum((points[:, None] - others[None]) ** 2, axis=2))
