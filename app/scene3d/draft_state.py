"""What the 3D view of a part draft shows. Numbers only; imports no VTK."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from app.scene3d.scene_state import StaticScene
from skincal.geometry import FloatArray, IntArray
from skincal.mesh.lay import PlacedLayout
from skincal.mesh.surface import Surface
from skincal.model.skin import Anchor, Layout
from skincal.part.draft_preview import PartPreview

ROBOT_STEPS = ("part", "sensor", "joints")  # Steps that show the robot around the part
SENSOR_STEPS = ("sensor", "joints", "check")  # Steps that show the sensor's axes
NO_PLACES: FloatArray = np.empty((0, 3))


class DraftStatic(StaticScene):
    """Mesh and laid layout of one moment of a draft."""

    is_draft = True

    def __init__(self, surface: Surface | None = None, layout: Layout | None = None, laid: PlacedLayout | None = None) -> None:
        channels: IntArray = np.empty(0, np.int64) if layout is None else layout.channels
        self.surface, self.layout, self.laid, self.channels = surface, layout, laid, channels
        self.row = {int(channel): row for row, channel in enumerate(channels)}


@dataclass(frozen=True, slots=True, eq=False)
class TurnHandle:
    """Ring that turns a layout about its anchor's normal."""

    anchor: Anchor
    radius: float
    """m."""


@dataclass(frozen=True, slots=True, eq=False)
class DraftPicture:
    """Content of one picture of a draft."""

    preview: PartPreview
    step: str
    """Name of the open step."""
    module: int | None = None
    """Index of the module that moves alone; `None` for the whole layout."""
    points: FloatArray = field(default_factory=lambda: NO_PLACES)
    """(n, 3) float, metres: points that were picked for the step."""
    answered: IntArray | None = None
    """Channels that answered a touch; `None` without a skin."""
    handle: TurnHandle | None = None
    """`None` if nothing can be turned."""
