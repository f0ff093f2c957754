"""Position and direction of a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """Position and direction of a camera; link frame, metres."""

    axes: FloatArray
    """(3, 3) float, unit, rows: right and up on the screen, and back to the camera."""
    focus: FloatArray
    """(3,) float: the point that it looks at."""
    distance: float

    @property
    def right(self) -> FloatArray:
        return self.axes[0]

    @property
    def up(self) -> FloatArray:
        return self.axes[1]

    @property
    def position(self) -> FloatArray:
        """(3,) float, metres."""
        return self.focus + self.distance * self.axes[2]


PLAIN_POSE = CameraPose(np.eye(3), np.zeros(3), 1.0)  # Before the first picture
