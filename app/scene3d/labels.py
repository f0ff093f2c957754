"""All words in the picture, in one label mapper, so that no two of them cover each other.

They stand on plates of the background's colour, where they cover least. A label that would cover one of higher priority is left
out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
import pyvista as pv
from vtkmodules.vtkRenderingLabel import vtkLabelPlacementMapper, vtkPointSetToLabelHierarchy

from app.scene3d.camera import Viewpoint
from app.scene3d.mesh_actors import FRONT, Label
from app.scene3d.scene_state import SceneColours
from skincal.geometry import FloatArray

LABEL_FONT_SIZE_PT = 14
LETTER_PX = np.array([8.5, 20.0])  # Width of a letter and height of a line with its plate, at most
BOX_MARGIN = 1.2  # Size of the box around a label over its largest size by the numbers above
LABEL_DIRECTIONS = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)], dtype=float)
"""Right and up: where words are tried, in this order."""
LABEL_OBSTACLE_HALF_WIDTH_PX = 7.0  # Half the width of what labels should not cover
LABEL_BACKGROUND_OPACITY = 0.85  # Words on such a plate have a contrast of 4.5:1 on any colour


class Labels:
    """The labels of all layers that are shown."""

    def __init__(self, plotter: pv.BasePlotter) -> None:
        self.mesh = _mesh_of([Label("0", np.zeros(3))], np.zeros((1, 3)))
        plotter.subplot(0, FRONT)
        self.actor = plotter.add_point_labels(
            self.mesh, "labels", always_visible=True, show_points=False, shape="rect", reset_camera=False, render=False,
            font_size=LABEL_FONT_SIZE_PT, shape_opacity=LABEL_BACKGROUND_OPACITY,
        )  # fmt: skip
        self._mapper = cast("vtkLabelPlacementMapper", self.actor.GetMapper())
        self._mapper.SetMaximumLabelFraction(1.0)
        self._hierarchy = cast("vtkPointSetToLabelHierarchy", self._mapper.GetInputAlgorithm())
        self._hierarchy.SetPriorityArrayName("priority")
        self._scale = 1.0
        self.shown: tuple[str, ...] = ()
        self.version = 0  # Changes with the look of the labels
        self._boxes = np.empty((0, 4))
        """(n, 4) float: left, bottom, right, top of each label, pixels of the desktop from the middle of the picture."""

    def set_colours(self, colours: SceneColours) -> None:
        self.version += 1
        self._mapper.SetBackgroundColor(pv.Color(colours.background).float_rgb)
        self._hierarchy.GetTextProperty().SetColor(pv.Color(colours.ink).float_rgb)

    def set_font_scale(self, scale: float) -> None:
        """Write with letters `scale` times as large as usual."""
        self._scale = scale
        self.version += 1
        self._hierarchy.GetTextProperty().SetFontSize(round(LABEL_FONT_SIZE_PT * scale))
        self._hierarchy.Modified()

    def show(self, labels: Sequence[Label], obstacles: FloatArray, viewpoint: Viewpoint) -> None:
        """Show these labels and no others, where they cover least of the obstacles, (n, 3) float, metres."""
        labels = sorted(labels, key=lambda label: -label.priority)
        self.shown = tuple(label.text for label in labels)
        self.version += 1
        self.set_drawn(True)
        self._boxes = np.empty((0, 4))
        if labels:
            self.mesh.shallow_copy(_mesh_of(labels, self._corners(labels, viewpoint.on_screen(obstacles), viewpoint)))

    def set_drawn(self, is_drawn: bool) -> None:
        """Draw the labels in the next pictures, or leave them out."""
        self.actor.SetVisibility(is_drawn and bool(self.shown))

    def boxes(self, viewpoint: Viewpoint) -> FloatArray:
        """Return (n, 4) float: left, bottom, right and top of each label with a margin, device pixels from the lower left."""
        return self._boxes * viewpoint.ratio + np.tile(viewpoint.size, 2) / 2.0

    def _corners(self, labels: Sequence[Label], obstacles: FloatArray, viewpoint: Viewpoint) -> FloatArray:
        """Return the lower left corner of each label, (n, 3) float, metres."""
        at = np.array([label.at for label in labels])
        middles, halves = viewpoint.on_screen(at), np.array([[len(label.text), 1.0] for label in labels]) * LETTER_PX / 2.0
        halves *= self._scale
        edge = np.array(viewpoint.size) / viewpoint.ratio / 2.0
        taken = np.concatenate([obstacles - LABEL_OBSTACLE_HALF_WIDTH_PX, obstacles + LABEL_OBSTACLE_HALF_WIDTH_PX], axis=1)
        for row, (label, half) in enumerate(zip(labels, halves, strict=True)):
            places = middles[row] + (LABEL_DIRECTIONS * (label.gap + half) if label.gap else np.zeros((1, 2)))
            sides = np.minimum((places + half)[:, None], taken[:, 2:]) - np.maximum((places - half)[:, None], taken[:, :2])
            outside = np.maximum(np.abs(places) + half - edge, 0.0).sum(axis=1)
            middles[row] = places[np.argmin(np.prod(np.maximum(sides, 0.0), axis=-1).sum(axis=1).round() + 100.0 * outside)]
            taken = np.concatenate([taken, [[*middles[row] - half, *middles[row] + half]]])
        wide = BOX_MARGIN * halves
        self._boxes = np.concatenate([middles - wide, middles + wide], axis=1)
        moved = middles - halves - viewpoint.on_screen(at)
        return at + viewpoint.pixel_at(at)[:, None] * moved @ viewpoint.pose.axes[:2]


def _mesh_of(labels: Sequence[Label], points: FloatArray) -> pv.PolyData:
    mesh = pv.PolyData(points)
    mesh["labels"] = np.array([label.text for label in labels])
    mesh["priority"] = np.array([label.priority for label in labels], dtype=float)
    return mesh
