"""How well the contacts determine a position, from the rig's noise and never from the residuals.

Residuals of nearly parallel axes agree beautifully and are wrong, so the noise model speaks. In the sensor frame a
contact's residual is f x p + m; noise df and dm and a contact at p + e instead of p change it by dm - p x df + f x e.
With isotropic df, dm and e tangent to the push its covariance is

    C = sigma_m^2 I + sigma_f^2 S(q) S(q)' + (|f| sigma_contact)^2 (I - u u'),

where the lever q = p - o runs from the sensor's origin o, about which the moment was measured. Eq. (6) turns the residual
into the link frame and no more, so C is turned with it: q and u are just written in the link frame.

The two rows e_i.(p - a) of a contact are T (f x p + m)/|f| with T = [-e_2; e_1], since e_i.(u x v) = (e_i x u).v, so their
covariance is D = T C T'/|f|^2. The estimate is linear in the rows, p = G b with G = (A'A)^-1 A', so its covariance is
Sigma = G (K D K) G': the estimator's own weights k, the rig's own noise. Confined to directions B (3, d), as on a
triangle, A becomes A B and Sigma becomes B (...) B'.

**It leaves out what all contacts share: wrong frames, a wrong arm chain, a wrong mesh, errors of the F/T matrix.**
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.estimate.evidence import Evidence
from skincal.estimate.qr import NO_RANK
from skincal.readings import FloatArray
from skincal.scene import NoiseSettings

SD_MAX = 0.030
"""m. A position whose standard deviation in its worst direction exceeds this is none: it is the side of a whole module."""


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """The covariance of a position and its worst direction."""

    covariance: FloatArray | None
    """(3, 3) float, m^2; None where a direction is not determined at all."""
    weakest: FloatArray
    """(3,) float, unit: the direction known worst."""
    sd: float | None
    """m, along `weakest`; None where it is not determined."""

    @property
    def determined(self) -> bool:
        """The worst direction is known to `SD_MAX` or better."""
        return self.sd is not None and self.sd <= SD_MAX


def row_noise(evidence: Evidence, point: FloatArray, noise: NoiseSettings) -> tuple[FloatArray, FloatArray]:
    """Return the noise of each contact's two rows, before weighting, for a taxel at `point` (3,): D = even I - less less'.

    Returns
    -------
    even : (n,) float, m^2
    less : (n, 2) float, metres
    """
    q = point - evidence.sensors
    # S(q) S(q)' = |q|^2 I - q q', and T turns q into (-e_2.q, e_1.q).
    seen = np.einsum("nij,nj->ni", evidence.across, q)
    relative = noise.force / evidence.forces
    even = (noise.moment / evidence.forces) ** 2 + relative**2 * np.einsum("ni,ni->n", q, q) + noise.contact**2
    return even, relative[:, None] * np.stack([-seen[:, 1], seen[:, 0]], axis=1)


def propagate(
    evidence: Evidence, a: FloatArray, root: FloatArray, point: FloatArray, noise: NoiseSettings, basis: FloatArray
) -> Uncertainty:
    """Carry the rig's noise through the weighted least squares to the position.

    Parameters
    ----------
    a : (2n, 3) float, weighted rows A
    root : (3, 3) float, with root' root = A' A
    point : (3,) float, metres, where the noise is evaluated
    basis : (3, d) float, orthonormal columns: the directions in which the position is free
    """
    triangle = np.asarray(np.linalg.qr(root @ basis, mode="r"))
    diagonal = np.abs(np.diag(triangle))
    if diagonal.min() <= NO_RANK * diagonal.max():
        return Uncertainty(None, _flattest(triangle, basis), None)
    with np.errstate(over="ignore", invalid="ignore"):
        # A B = Q triangle, so G = B triangle^-1 Q': no squared condition.
        spread = basis @ np.linalg.inv(triangle)
        q = (a @ spread).reshape(evidence.contacts, 2, -1) * evidence.weights[:, None, None]
        even, less = row_noise(evidence, point, noise)
        taken = np.einsum("ni,nij->nj", less, q)
        middle = np.einsum("n,nij,nik->jk", even, q, q) - taken.T @ taken
        covariance = spread @ middle @ spread.T
    if not np.isfinite(covariance).all():
        return Uncertainty(None, _flattest(triangle, basis), None)
    covariance = (covariance + covariance.T) / 2
    values, axes = np.linalg.eigh(covariance)
    return Uncertainty(covariance, unsigned(axes[:, -1]), float(np.sqrt(values[-1])))


def _flattest(triangle: FloatArray, basis: FloatArray) -> FloatArray:
    """Return the direction along which the rows change least."""
    return unsigned(basis @ np.linalg.svd(triangle)[2][-1])


def unsigned(direction: FloatArray) -> FloatArray:
    """Return a unit vector along `direction` (3,) whose largest component is positive: a line has no sign."""
    largest = direction[np.argmax(np.abs(direction))]
    return direction / (np.copysign(1.0, largest) * np.linalg.norm(direction))
