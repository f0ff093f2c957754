"""The ring around a layout that is being placed, with a knob on the layout's x axis: a drag of it turns the layout."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from app.scene3d.camera import VIEW_SLOPE, facing
from app.scene3d.draft_state import NO_PLACES, DraftPicture, TurnHandle
from app.scene3d.lines import circles, closed, tangents
from app.scene3d.mesh_actors import FRONT, Dots, Layer, Segments
from app.scene3d.scene_state import StaticScene, rgb

TURN_RING_CORNERS = 120
RING_PX, KNOB_PX, GRIP_PX = 3.0, 18.0, 11.0  # Line, knob, and distance from the ring within which a press is on it
MIN_RING_FACING_COSINE = 0.2  # Cosine: a ring that is turned away more is hidden


class TurnHandleLayer(Layer):
    """Layer with the ring that turns the layout, and its knob."""

    name = "turn handle"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self.ring, self.knob = Segments(plotter, FRONT, RING_PX), Dots(plotter, FRONT, KNOB_PX, is_lit=False)
        self._handle: TurnHandle | None = None
        self._corners = NO_PLACES

    def show_picture(self, picture: DraftPicture) -> None:
        self._handle = picture.handle
        self.draw()

    def draw(self) -> None:
        handle, self._corners, knob = self._handle, NO_PLACES, NO_PLACES
        if handle is not None and self.viewpoint is not None:
            at, normal = handle.anchor.point[None], handle.anchor.normal[None]
            if facing(normal, at, self.viewpoint.pose.position)[0] >= MIN_RING_FACING_COSINE:
                self._corners = circles(at, normal, handle.radius, TURN_RING_CORNERS)[0]
                knob = at + handle.radius * handle.anchor.x
        colour = rgb(self.colours.window.accent)
        self.ring.show(closed(self._corners).reshape(-1, 3), colour)
        self.knob.show(knob, colour)

    def is_at(self, x: float, y: float) -> bool:
        """Whether the ring is seen at a pixel."""
        view = self.viewpoint
        if view is None or not len(self._corners):
            return False
        pointer = (np.array([x, y]) - np.array(view.size) / 2.0) / view.ratio
        return bool(np.linalg.norm(view.on_screen(self._corners) - pointer, axis=1).min() <= GRIP_PX)

    def angle_at(self, x: float, y: float) -> float | None:
        """Return the angle of a pixel about the ring's middle, degrees, counter-clockwise seen from outside.

        It is `None` without a ring, or if the pixel does not show the ring's plane.
        """
        handle, view = self._handle, self.viewpoint
        if handle is None or view is None:
            return None
        right, up = VIEW_SLOPE * (2.0 * np.array([x, y]) - view.size) / view.size[1]
        ray = np.array([right, up, -1.0]) @ view.pose.axes
        normal, position = handle.anchor.normal, view.pose.position
        depth = float((handle.anchor.point - position) @ normal) / float(ray @ normal)
        if not 0.0 < depth < np.inf:
            return None
        first, second = (axis[0] for axis in tangents(normal[None]))
        way = position + depth * ray - handle.anchor.point
        return float(np.degrees(np.arctan2(way @ second, way @ first)))
