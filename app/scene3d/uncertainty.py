"""Uncertainty of the worst estimates and of the selected one: 95 % ellipsoids, discs for the surface method.

The region is {p + L u : |u| <= s} with L L' the covariance; s = 2.80 = sqrt(chi2(3, 0.95)) in space and
2.45 = sqrt(chi2(2, 0.95)) on a surface, where the covariance has no part along the normal. It leaves out what
`Estimate` leaves out.
"""

from __future__ import annotations

import numpy as np
from vtkmodules.vtkRenderingCore import vtkRenderer

from app.scene3d.ground import Frame, Ground
from app.scene3d.looks import ColourArray, Look
from app.scene3d.shapes import Segments
from skincal.geometry.arrays import FloatArray
from skincal.taxels.result import Estimate, Method

WORST = 3
"""Ellipsoids at a time: more hide the taxels that they are about."""
SPACE_95 = 2.7955
"""sqrt of the 95 % quantile of chi-square with 3 degrees of freedom."""
SURFACE_95 = 2.4477
"""sqrt of the 95 % quantile of chi-square with 2 degrees of freedom."""
LARGEST = 0.15
"""m. Half axes are cut here in the picture: beyond it an ellipsoid is a line across the view anyhow."""
LIFT = 6e-4
"""m. Discs float this far above the part."""


def _unit_circles(sides: int = 48) -> FloatArray:
    """Return circles about the three axes as segments, (3, sides, 2, 3) float; the last lies across the third axis."""
    turn = np.arange(sides + 1) * (2 * np.pi / sides)
    zero = np.zeros_like(turn)
    c, s = np.cos(turn), np.sin(turn)
    lines = np.array([np.stack([zero, c, s], axis=1), np.stack([c, zero, s], axis=1), np.stack([c, s, zero], axis=1)])
    return np.stack([lines[:, :-1], lines[:, 1:]], axis=2).astype(np.float64)


CIRCLES = _unit_circles()


class UncertaintyLayer:
    """The outlines of the regions: three circles an ellipsoid, one a disc."""

    name = "uncertainty"

    def __init__(self, renderer: vtkRenderer, ground: Ground) -> None:
        self.ground = ground
        self.lines = Segments(pixels=1.5)
        self._key: object = None
        renderer.AddActor(self.lines.actor)

    def dress(self, look: Look) -> None:
        """Keep the colours: an ellipsoid has its module's hue in every theme."""

    def show(self, frame: Frame) -> bool:
        """Show the regions of a moment; return whether anything changed."""
        key = (frame.snapshot.generation, frame.method, frame.selected)
        if key == self._key:
            return False
        self._key = key
        rows = self.rows(frame)
        estimates = frame.estimates()
        parts = [region(estimates[row]).reshape(-1, 2, 3) for row in rows]
        hues: list[ColourArray] = [
            np.repeat(self.ground.hues[[row]], len(p), axis=0) for row, p in zip(rows, parts, strict=True)
        ]
        # The empty heads keep the shapes where no region is drawn.
        self.lines.join(np.concatenate([np.empty((0, 2, 3)), *parts]), np.concatenate([self.ground.hues[:0], *hues]))
        return True

    def rows(self, frame: Frame) -> list[int]:
        """Return whose regions are drawn: the worst by predicted error, and the selected taxel's."""
        known = {row: e.rms for row, e in enumerate(frame.estimates()) if e.covariance is not None and e.rms is not None}
        worst = sorted(known, key=lambda row: (-known[row], row))[:WORST]
        selected = self.ground.row.get(-1 if frame.selected is None else frame.selected)
        return worst if selected is None or selected not in known or selected in worst else [*worst, selected]


def region(estimate: Estimate) -> FloatArray:
    """Return the outline of an estimate's 95 % region as segments.

    Parameters
    ----------
    estimate : without a position or a covariance it has no region

    Returns
    -------
    (circles, sides, 2, 3) float, metres, link frame
    """
    if estimate.position is None or estimate.covariance is None:
        return np.empty((0, 1, 2, 3))
    variances, axes = np.linalg.eigh(estimate.covariance)
    flat = estimate.method is Method.SURFACE or estimate.triangle is not None
    half = np.minimum((SURFACE_95 if flat else SPACE_95) * np.sqrt(np.maximum(variances, 0.0)), LARGEST)
    if not flat:
        return estimate.position + (CIRCLES * half) @ axes.T
    # eigh sorts upwards: the first axis is the normal, and the disc is the circle across it.
    disc = estimate.position + (CIRCLES[:1] * half) @ axes.T
    return disc if estimate.normal is None else disc + LIFT * estimate.normal
