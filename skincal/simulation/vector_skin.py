"""A simulated skin whose taxels measure a force vector: gains, ratio of shear to push, friction, crosstalk, noise and steps.

A tip on soft skin gives a part of its force to each taxel below it, by the foam's share g of `simulated_rig.Foam`. Its force is
F = -N n + T with the outward normal n, and friction limits the shear, |T| <= mu N. Soft material under the tip also bulges to
all sides, which pulls the taxels next to it outward, along -grad g. A taxel with the axes R then reads

    r = gain X diag(rho, rho, 1) R' q (g (-N n + T) - bulge s N grad g),

with the share q of a taxel right below the tip, the width s of the foam's flank, and the crosstalk X = I + E between its axes.
Neighbours add a share of their readings. The sizes are assumed, unless they name a source.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skincal.geometry import FloatArray, IntArray, rotations
from skincal.simulation.simulated_rig import Foam, PressedPlaces, felt_share, tangents, tip_axes

GRADIENT_STEP_M = 1e-5
NEIGHBOUR_MAX_SPACINGS = 1.5
"""Largest distance of neighbours between which there is crosstalk, in spacings of the skin."""


@dataclass(frozen=True, slots=True)
class VectorErrors:
    """Properties of a skin of three axes; forces in newtons."""

    share: float = 0.4
    """Of the force, on a taxel right below the tip."""
    gain_spread: float = 0.10
    """Relative sd of the taxels' gains."""
    shear_ratio: float = 0.6
    """Gain along the skin over that across it."""
    ratio_spread: float = 0.05
    """Relative sd of this ratio between taxels."""
    friction: float = 0.7
    """Largest shear of the tip over its push: rubber on plastic."""
    bulge: float = 0.15
    """Pull to all sides of the soft material under the tip, over the push and the slope of its share."""
    axis_crosstalk: float = 0.0
    """sd of the entries of E between the axes of a taxel. 0.01 turns its readings by 0.6 degrees, which no poke can tell from a
    turn of the taxel."""
    neighbour_crosstalk: float = 0.02
    """Share of a neighbour's reading in that of a taxel."""
    noise: float = 0.02
    """N, sd of each value."""
    step: float = 0.1
    """N, last digit of each value: a PaXini GEN3's. 0: none."""
    axes_tilt: float = float(np.radians(3.0))
    """rad, sd of the tilt of a taxel's z from the normal of the skin, about each axis."""

    @classmethod
    def none(cls) -> VectorErrors:
        """Return a perfect skin with the same share and ratio."""
        zero = dict.fromkeys(
            ("gain_spread", "ratio_spread", "bulge", "axis_crosstalk", "neighbour_crosstalk", "noise", "step"), 0.0
        )
        return replace(cls(), **zero)


class VectorSkin:
    """Taxels at `places` (n, 3), metres, with outward `normals` (n, 3), link frame.

    `axes` (n, 3, 3) are the taxels' true axes, in columns; `None` draws turns about the normals and small tilts. `rng` draws
    them, gains and crosstalk.
    """

    def __init__(
        self,
        places: FloatArray,
        normals: FloatArray,
        errors: VectorErrors,
        rng: np.random.Generator,
        axes: FloatArray | None = None,
    ) -> None:
        count = len(places)
        self.places, self.normals, self.errors, self.foam = places, normals, errors, Foam()
        turning, gains, ratios, mixing = rng.spawn(4)
        self.axes = random_axes(normals, errors.axes_tilt, turning) if axes is None else axes
        self._gains = np.maximum(1.0 + errors.gain_spread * gains.standard_normal(count), 0.1)
        self.ratios = errors.shear_ratio * np.exp(errors.ratio_spread * ratios.standard_normal(count))
        cross = errors.axis_crosstalk * mixing.standard_normal((count, 3, 3))
        cross[:, range(3), range(3)] = 0.0
        scales = np.ones((count, 3))
        scales[:, :2] = self.ratios[:, None]
        self.response = self._gains[:, None, None] * ((np.eye(3) + cross) * scales[:, None]) @ self.axes.transpose(0, 2, 1)
        """(count, 3, 3) float: reading of a taxel for a force on it in the link frame."""
        self._neighbours = _neighbour_shares(places, errors.neighbour_crosstalk)

    def readings(self, pokes: PressedPlaces, forces: FloatArray, rows: IntArray | None = None) -> FloatArray:
        """Compute the readings (n, k, 3) of taxels to n presses with `forces` (n, 3), N, without noise.

        `rows` (n, k) chooses taxels for each press; `None` for all.
        """
        if rows is None:
            rows = np.tile(np.arange(len(self.places)), (len(pokes), 1))
        loads = self._loads(pokes, forces, rows)
        own = np.einsum("nkij,nkj->nki", self.response[rows], loads)
        return own + np.einsum("nkl,nli->nki", self._neighbours[rows[:, :, None], rows[:, None]], own)

    def _loads(self, pokes: PressedPlaces, forces: FloatArray, rows: IntArray) -> FloatArray:
        """Compute the forces on taxels, (n, k, 3), N, link frame."""
        push = np.maximum(-np.sum(forces * pokes.normals, axis=1), 0.0)
        shear = forces + push[:, None] * pokes.normals
        length = np.linalg.norm(shear, axis=1)
        shear = shear * np.minimum(1.0, self.errors.friction * push / np.maximum(length, 1e-12))[:, None]
        offsets = self.places[rows] - pokes.points[:, None]
        x, y = tip_axes(pokes)
        share = felt_share(self.foam, offsets, x, y)
        total = share[..., None] * (shear - push[:, None] * pokes.normals)[:, None]
        for side in (x, y):
            step = GRADIENT_STEP_M * side[:, None]
            slope = felt_share(self.foam, offsets + step, x, y) - felt_share(self.foam, offsets - step, x, y)
            pull = -self.errors.bulge * self.foam.spread * slope / (2.0 * GRADIENT_STEP_M) * push[:, None]
            total = total + pull[..., None] * side[:, None]
        return self.errors.share * total

    def measured(self, readings: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Add noise to readings (..., 3), N, and round them to the device's steps."""
        noisy = readings + self.errors.noise * rng.standard_normal(readings.shape)
        return np.rint(noisy / self.errors.step) * self.errors.step if self.errors.step else noisy


def random_axes(normals: FloatArray, tilt: float, rng: np.random.Generator) -> FloatArray:
    """Draw axes (n, 3, 3) of taxels: z near the `normals` (n, 3), with `tilt`, rad, of sd, and any turn about it."""
    count = len(normals)
    e1, e2 = tangents(normals)
    flat = np.stack([e1, e2, normals], axis=2)
    angles = np.zeros((count, 3))
    angles[:, 2] = rng.uniform(-np.pi, np.pi, count)
    leans = np.zeros((count, 3))
    leans[:, :2] = tilt * rng.standard_normal((count, 2))
    return flat @ rotations(angles) @ rotations(leans)


def _neighbour_shares(places: FloatArray, share: float) -> FloatArray:
    """Compute the share (n, n) of each taxel's reading in every other one."""
    if not share or len(places) < 2:
        return np.zeros((len(places), len(places)))
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    np.fill_diagonal(distance, np.inf)
    spacing = float(np.median(distance.min(axis=1)))
    return np.where(distance <= NEIGHBOUR_MAX_SPACINGS * spacing, share, 0.0)
