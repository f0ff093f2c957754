"""The simulated skin: where it is mounted, and how its pads respond to the engine's contact.

A force at a point of the outer face presses the pads below through the layer. The normal stress is that in an elastic
half-space (Boussinesq and Cerruti; Johnson, Contact Mechanics, 3.2 and 3.6): sigma = 3 z^2 (F . r) / (2 pi |r|^5), r from the
force to the pad, z its part along the normal. A pad reads the load on its disc, and saturates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from skincal.geometry import FloatArray, IntArray, tangent_axes
from skincal.mesh.lay import place_layout
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.model.skin import Anchor
from skincal.physics.engine import Touch
from skincal.physics.mjcf import FOAM_THICKNESS_M, TIP_RADIUS_M

PAD_RADIUS_M = 0.002
"""m, of an electrode (Maiolino et al., IEEE Sensors Journal 2013: about 4 mm across)."""
PAD_MAX_DISTANCE_FROM_LOAD_M = 0.015
"""m. Farther pads are not computed: there the load is below 0.1 %."""
LOAD_FOR_63_PERCENT_RESPONSE_N = 2.5
"""N on a pad for 63 % of its range: a compressed layer stiffens. Assumed."""
MAX_RESPONSE_OVER_RANGE = 0.75
"""Largest response over the range from rest to the pressed end. Assumed."""
REST_READING_OVER_RANGE = 240.0 / 255.0
"""Reading at rest, from the pressed end (iCub: 235 to 244 of 255)."""
PAD_LOG_GAIN_SD = 0.10
"""sd of the logarithm of a pad's sensitivity. Assumed."""
READING_NOISE_SD_OVER_RANGE = 1.0 / 255.0
"""sd of one reading over the range."""
MOUNT_SHIFT_M, MOUNT_TURN = 0.003, float(np.radians(2.0))
"""sd of the skin's offset from its plan, in each direction, and of its turn: the calibration has to find it."""
DEFAULT_RANGE = (0.0, 255.0)
_RING_ANGLES = np.pi / 3.0 * np.arange(6)
DISC_POINTS = np.vstack([np.zeros((1, 2)), np.sqrt(2.0 / 3.0) * np.column_stack([np.cos(_RING_ANGLES), np.sin(_RING_ANGLES)])])
"""(7, 2) float: points of a quadrature of the unit disc with the weights `DISC_WEIGHTS` (Abramowitz and Stegun, 25.4.61)."""
DISC_WEIGHTS = np.array([1.0 / 4.0, *[1.0 / 8.0] * 6])


class Pads:
    """The pads of a mounted skin. `rng` draws the mounting and the sensitivities.

    Raises InputError: the scene does not say where its taxels are.
    """

    axes: FloatArray | None = None
    """(n, 3, 3) float, true axes of taxels that measure three, in columns; `None` for one axis."""

    def __init__(self, scene: Scene, surface: Surface, rng: np.random.Generator) -> None:
        self.channels, self.places, self.normals = mount_skin(scene, surface, displaced_mount(rng, MOUNT_SHIFT_M))
        low, high = scene.skin.range or DEFAULT_RANGE
        self._low, self._high, self._polarity = low, high, scene.skin.polarity
        rest = REST_READING_OVER_RANGE if self._polarity < 0 else 1.0 - REST_READING_OVER_RANGE
        self._rest = low + rest * (high - low)
        self._idle = np.full(scene.skin.channels, high if self._polarity < 0 else low)
        self._idle[self.channels] = self._rest
        self.gains = np.exp(PAD_LOG_GAIN_SD * rng.standard_normal(len(self.channels)))
        axes = [tangent_axes(np.array([1.0, 0.0, 0.0]), normal, fallback=True) for normal in self.normals]
        x, y = np.moveaxis(np.array(axes), 1, 0)
        offsets = PAD_RADIUS_M * (DISC_POINTS[None, :, :1] * x[:, None] + DISC_POINTS[None, :, 1:] * y[:, None])
        self._cells = self.places[:, None] + offsets

    def loads(self, touch: Touch, patch: float) -> tuple[IntArray, FloatArray]:
        """Compute the loads, N, of the pads near a contact: their rows (k,), and (k,) loads.

        `patch` is the radius of the contact patch as a share of the circle that the tip cuts out of the face; 0: a point.
        """
        rows = np.flatnonzero(np.sum((self.places - touch.point) ** 2, axis=1) < PAD_MAX_DISTANCE_FROM_LOAD_M**2)
        radius = patch * np.sqrt(max(touch.depth * (2.0 * TIP_RADIUS_M - touch.depth), 0.0))
        x, y = tangent_axes(np.array([1.0, 0.0, 0.0]), touch.normal, fallback=True)
        sources = touch.point + radius * (DISC_POINTS[:, :1] * x + DISC_POINTS[:, 1:] * y)
        # Of shape (pads, cells, sources, 3).
        away = self._cells[rows][:, :, None] - sources
        squares = np.sum(away * away, axis=-1)
        depths = -np.einsum("pcsi,pi->pcs", away, self.normals[rows])
        # A hard pad under a thin layer: the stress does not exceed that at half its thickness.
        squares = np.maximum(squares, (FOAM_THICKNESS_M / 2.0) ** 2)
        stress = 3.0 * depths**2 * np.maximum(away @ touch.force, 0.0) / (2.0 * np.pi * squares**2.5)
        stress[depths <= 0] = 0.0
        area = np.pi * PAD_RADIUS_M**2
        return rows, area * np.einsum("pcs,c,s->p", stress, DISC_WEIGHTS, DISC_WEIGHTS)

    def frame(self, touch: Touch | None, patch: float, rng: np.random.Generator) -> FloatArray:
        """Compute one raw frame (width,) with noise, rounded."""
        span = self._high - self._low
        values = self._idle.copy()
        if touch is not None:
            rows, loads = self.loads(touch, patch)
            room = MAX_RESPONSE_OVER_RANGE * span * REST_READING_OVER_RANGE
            values[self.channels[rows]] += (
                self._polarity * room * -np.expm1(-self.gains[rows] * loads / LOAD_FOR_63_PERCENT_RESPONSE_N)
            )
        values[self.channels] += READING_NOISE_SD_OVER_RANGE * span * rng.standard_normal(len(self.channels))
        return np.clip(np.rint(values), self._low, self._high)


def displaced_mount(rng: np.random.Generator, shift_sd: float) -> Callable[[Anchor], Anchor]:
    """Draw the displacement of a skin from its plan: `shift_sd`, m, in each direction, and a turn."""
    shift, turn = shift_sd * rng.standard_normal(2), MOUNT_TURN * rng.standard_normal()

    def displaced(anchor: Anchor) -> Anchor:
        x = np.cos(turn) * anchor.x + np.sin(turn) * np.cross(anchor.normal, anchor.x)
        return replace(anchor, at=anchor.at + shift, x=x)

    return displaced


def mount_skin(
    scene: Scene, surface: Surface, displaced: Callable[[Anchor], Anchor] = lambda anchor: anchor
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Lay the skin from its displaced anchors: channels (n,), positions (n, 3), metres, and normals (n, 3).

    Raises InputError: the scene does not say where its taxels are.
    """
    layout, anchor = scene.skin.layout, scene.skin.anchor
    if layout is None or (anchor is None and all(module.anchor is None for module in layout.modules)):
        raise InputError(f"{scene.path}: a simulated skin needs [skin] modules and an anchor, to know where its taxels are.")
    modules = tuple(m if m.anchor is None else replace(m, anchor=displaced(m.anchor)) for m in layout.modules)
    laid = place_layout(layout.with_modules(modules), None if anchor is None else displaced(anchor), surface)
    if laid is None:
        raise InputError(f"{scene.path}: the layout could not be laid; check its anchor.")
    channels = layout.channels
    known = np.isfinite(laid.places[channels]).all(axis=1)
    return channels[known], laid.places[channels][known], laid.normals[channels][known]
