"""Taxels of three axes under the robot's tip: bumps that take the force of the tip in its direction, on a bonded base.

Each taxel is a bump over a round cell at `PLATE_DEPTH_M` below the outer face. In an elastic, incompressible half-space a force
F on the face has at the place r from it the stress 3 (F . r) r r' / (2 pi |r|^5) (Boussinesq and Cerruti; Johnson, Contact
Mechanics, 3.2 and 3.6). On a plane with the outward normal n it gives, with the depth z = -r . n,

    t = 3 (F . r) z r / (2 pi |r|^5).

Integrated over a cell, its part along n is the share s of a push. Bumps that stand apart take the share s of the force in its
own direction. A base that is bonded gives t itself, which points away from the tip: next to its middle a push then has a part
along the skin. A taxel gets (1 - c) s F + c times the integral of t, with the coupling c. Its axes R read
gain diag(rho, rho, 1) R' of it.

The engine gives the force, with its friction and slip. Nothing here is shared with `skincal/simulation`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skincal.geometry import FloatArray, IntArray, rotations, tangent_axes
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.model.skin import Module
from skincal.model.skin_axes import SkinAxes
from skincal.physics.engine import Touch
from skincal.physics.mjcf import FOAM_THICKNESS_M, TIP_RADIUS_M
from skincal.physics.skin import DISC_POINTS, DISC_WEIGHTS, displaced_mount, mount_skin

MOUNT_SHIFT_M = 0.0007
"""m, sd of the skin's offset from its plan, in each direction. Assumed: a fingertip's module has a seat."""
REACH_M = 0.008
"""m. Taxels farther from the contact do not feel it."""
PLATE_DEPTH_M = 0.001
"""m, of the cells below the outer face."""
CELL_RADIUS_M = 0.0014
"""m: cells 3 mm apart nearly touch."""
CELL_RINGS, CELL_SECTORS = 5, 12
RAW_PER_NEWTON = 100.0
"""Raw units of a skin without a unit."""


@dataclass(frozen=True, slots=True)
class VectorPadErrors:
    """Properties of the taxels; the sizes are assumed, unless they name a source."""

    coupling: float = 0.2
    """c: share of the force that reaches the taxels through a bonded base. 0.2 turns a push by 2 to 3 degrees for each
    millimetre from the middle of its taxel."""
    gain: float = 0.5
    gain_spread: float = 0.10
    """sd of the logarithm of a taxel's gain."""
    shear_ratio: float = 0.6
    """Gain along the skin over that across it."""
    ratio_spread: float = 0.05
    """sd of the logarithm of this ratio."""
    axes_sd: float = float(np.radians(3.0))
    """rad, turn of a taxel's axes from those of its module on the skin, about each axis."""
    noise: float = 0.02
    """N, sd of a value."""
    step: float = 0.1
    """N, last digit of a value: a PaXini GEN3's (paxini-sdk 0.1.0). 0: none."""

    @classmethod
    def none(cls) -> VectorPadErrors:
        """Return perfect taxels of the same gain and ratio."""
        return replace(cls(), coupling=0.0, gain_spread=0.0, ratio_spread=0.0, axes_sd=0.0, noise=0.0, step=0.0)


class VectorPads:
    """The taxels of a mounted skin of three axes. `rng` draws the mounting, axes and sensitivities.

    Raises InputError: the scene does not say where its taxels are.
    """

    def __init__(
        self,
        scene: Scene,
        surface: Surface,
        axes: SkinAxes,
        rng: np.random.Generator,
        errors: VectorPadErrors | None = None,
    ) -> None:
        mount, turning, gains, ratios = rng.spawn(4)
        self.errors = errors or VectorPadErrors()
        self.channels, self.places, self.normals = mount_skin(scene, surface, displaced_mount(mount, MOUNT_SHIFT_M))
        count = len(self.channels)
        plans = axes_of_plan(scene, self.channels, self.normals)
        self.axes = plans @ rotations(self.errors.axes_sd * turning.standard_normal((count, 3)))
        """(n, 3, 3) float, true axes of the taxels, in columns, link frame."""
        self._axes, self._width = axes, scene.skin.channels
        scales = np.ones((count, 3))
        scales[:, :2] = (self.errors.shear_ratio * np.exp(self.errors.ratio_spread * ratios.standard_normal(count)))[:, None]
        self._scales = scales * self.errors.gain * np.exp(self.errors.gain_spread * gains.standard_normal(count))[:, None]
        self._unit = 1.0 if axes.unit == "N" else RAW_PER_NEWTON
        radii = CELL_RADIUS_M * np.sqrt((np.arange(CELL_RINGS) + 0.5) / CELL_RINGS)
        angles = 2.0 * np.pi * (np.arange(CELL_SECTORS) + 0.5) / CELL_SECTORS
        # Points of equal areas.
        flat = np.stack([np.outer(radii, np.cos(angles)).ravel(), np.outer(radii, np.sin(angles)).ravel()], axis=1)
        plates = self.places + (FOAM_THICKNESS_M - PLATE_DEPTH_M) * self.normals
        self._cells = plates[:, None] + flat @ plans[:, :, :2].transpose(0, 2, 1)

    def loads(self, touch: Touch, patch: float) -> tuple[IntArray, FloatArray]:
        """Compute the forces on the taxels near a contact: their rows (k,), and (k, 3), N, link frame.

        `patch` is as for `Pads.loads`.
        """
        near = np.sum((self.places - touch.point) ** 2, axis=1) < REACH_M**2
        rows = np.flatnonzero(near & (self.normals @ touch.normal > 0.0))
        radius = patch * np.sqrt(max(touch.depth * (2.0 * TIP_RADIUS_M - touch.depth), 0.0))
        x, y = tangent_axes(np.array([1.0, 0.0, 0.0]), touch.normal, fallback=True)
        # The engine's contact is in the middle of the overlap of tip and layer.
        face = touch.point + 0.5 * touch.depth * touch.normal
        sources = face + radius * (DISC_POINTS[:, :1] * x + DISC_POINTS[:, 1:] * y)
        away = self._cells[rows][:, :, None] - sources
        depth = np.maximum(-np.einsum("pcsi,pi->pcs", away, self.normals[rows]), 0.0)
        squares = np.maximum(np.sum(away * away, axis=-1), (0.5 * PLATE_DEPTH_M) ** 2)
        kernel = 3.0 * depth / (2.0 * np.pi * squares**2.5) * (np.pi * CELL_RADIUS_M**2 / away.shape[1])
        bonded = np.einsum("pcs,pcsi,s->pi", kernel * (away @ touch.force), away, DISC_WEIGHTS)
        # Of a unit push: its part along the normal.
        share = np.einsum("pcs,s->p", kernel * depth**2, DISC_WEIGHTS)
        coupling = self.errors.coupling
        return rows, (1.0 - coupling) * share[:, None] * touch.force + coupling * bonded

    def readings(self, touch: Touch, patch: float) -> tuple[IntArray, FloatArray]:
        """Compute the readings of the taxels near a contact without noise: their rows (k,), and (k, 3), N, their axes."""
        rows, loads = self.loads(touch, patch)
        return rows, self._scales[rows] * np.einsum("pij,pi->pj", self.axes[rows], loads)

    def frame(self, touch: Touch | None, patch: float, rng: np.random.Generator) -> FloatArray:
        """Compute one raw frame (3 channels,) with noise, in steps."""
        own = np.zeros((len(self.channels), 3))
        if touch is not None:
            rows, readings = self.readings(touch, patch)
            own[rows] = readings
        own += self.errors.noise * rng.standard_normal(own.shape)
        if self.errors.step:
            own = np.rint(own / self.errors.step) * self.errors.step
        vectors = np.zeros((self._width, 3))
        vectors[self.channels] = own
        return self._unit * self._axes.as_frames(vectors)


def axes_of_plan(scene: Scene, channels: IntArray, normals: FloatArray) -> FloatArray:
    """Compute the axes (n, 3, 3) of taxels with `normals` (n, 3): z out of the skin, x along the x axis of their module."""
    layout = scene.skin.layout
    if layout is None:
        raise InputError(f"{scene.path}: a simulated skin needs [skin] modules and an anchor, to know where its taxels are.")
    along = {channel: _x_of(scene, module) for module in layout.modules for channel in module.channels.tolist()}
    found = np.empty((len(channels), 3, 3))
    for row, channel in enumerate(channels.tolist()):
        x, y = tangent_axes(along[channel], normals[row], fallback=True)
        found[row] = np.stack([x, y, normals[row]], axis=1)
    return found


def _x_of(scene: Scene, module: Module) -> FloatArray:
    """Give the x axis of a module at its anchor, or at that of the layout."""
    anchor = module.anchor or scene.skin.anchor
    assert anchor is not None
    y = np.cross(anchor.normal, anchor.x)
    return np.asarray(np.cos(module.angle) * anchor.x + np.sin(module.angle) * y, dtype=np.float64)
