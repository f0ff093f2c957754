"""Where each channel lies on the flat map: the layout's own plane, or rows of channels where there is no layout."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.model.skin import Layout


@dataclass(frozen=True, slots=True, eq=False)
class MapPlan:
    """The map before it has a size; y points up, any unit."""

    channels: IntArray
    """(n,) channels that are drawn."""
    places: FloatArray
    """(n, 2) float."""
    spacing: float
    """Usual distance of neighbours."""
    outlines: tuple[FloatArray, ...]
    """(v, 2) float a module."""
    labels: tuple[str, ...]
    """One a module."""

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest corner of everything, (2,) float each."""
        points = np.concatenate([self.places, *self.outlines])
        return points.min(axis=0) - self.spacing, points.max(axis=0) + self.spacing


def plan_map(layout: Layout | None, channels: IntArray) -> MapPlan:
    """Place the channels of a skin on a flat map.

    Parameters
    ----------
    layout : None where the scene has none; then channels stand in rows, first at the top left
    channels : (n,) channels that are taxels
    """
    if layout is None:
        columns = max(1, math.ceil(math.sqrt(len(channels) * 1.6)))
        row, column = np.divmod(np.arange(len(channels)), columns)
        return MapPlan(channels, np.stack([column, -row], axis=1).astype(float), 1.0, (), ())
    return MapPlan(
        channels=channels,
        places=layout.places[channels],
        spacing=layout.spacing,
        outlines=tuple(module.outline for module in layout.modules),
        labels=tuple(str(module.id) for module in layout.modules),
    )


@dataclass(frozen=True, slots=True)
class Fit:
    """From the plan to pixels: one scale for both axes, y down, a quarter turn where that shows more."""

    scale: float
    shift: tuple[float, float]
    turned: bool = False

    def pixels(self, points: FloatArray) -> FloatArray:
        """Return (n, 2) pixels of (n, 2) points of the plan."""
        own = points[:, ::-1] if self.turned else points * np.array([1.0, -1.0])
        return own * self.scale + np.array(self.shift)


TURN_GAIN = 1.25
"""The map is turned only where that makes it a quarter larger; a map that looks like the drawing is worth more else."""


def fit(plan: MapPlan, width: float, height: float) -> Fit:
    """Return how a plan fills `width` x `height` pixels, in the middle and with its proportions kept."""
    low, high = plan.bounds()
    size = np.maximum(high - low, 1e-9)
    plain = min(width / size[0], height / size[1])
    turned = min(width / size[1], height / size[0])
    middle = (low + high) / 2
    if turned > TURN_GAIN * plain:
        return Fit(turned, (width / 2 - middle[1] * turned, height / 2 - middle[0] * turned), turned=True)
    return Fit(plain, (width / 2 - middle[0] * plain, height / 2 + middle[1] * plain))
