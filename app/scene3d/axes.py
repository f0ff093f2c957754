"""Force axes: thick for the poke in progress, thin for those of the selected taxel."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
import pyvista as pv

from app.scene3d.lines import DRAWN_TOOL_LENGTH_M
from app.scene3d.mesh_actors import FRONT, NO_POINTS, WITHIN, Dots, Layer, Segments
from app.scene3d.scene_state import SceneColours, StaticScene
from skincal.contacts.outcome import PRESSING_PHASES, Contact, Progress
from skincal.geometry import FloatArray
from skincal.mesh.surface import contact_point
from skincal.pokes import Pokes

if TYPE_CHECKING:
    from app.state.view_state import ViewState
    from skincal.session.snapshot import Snapshot

MAX_DRAWN_FORCE_AXES = 30  # Axes of the selected taxel: more are a tangle, and the newest count most
AXIS_LENGTH_BEYOND_CONTACT_M = 0.012  # m. Length of an axis beyond the contact: enough depth to see where axes cross.


class AxesLayer(Layer):
    """The axis of the poke in progress with its contact, and those of the selected taxel."""

    name = "axes"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self.past, self.current = Segments(plotter, WITHIN, 1.5), Segments(plotter, WITHIN, 5.0)
        self.contact = Dots(plotter, FRONT, 13.0)
        self._middle = static.extent.mean(axis=0) if len(static.extent) else np.zeros(3)
        self._past_key: object = None
        self._axis: bytes | None = b""

    def set_colours(self, colours: SceneColours) -> None:
        self.colours, self._past_key, self._axis = colours, None, None

    def show(self, state: ViewState) -> bool:
        changed = self._show_current(state)
        key = (state.snapshot.generation, state.method, state.selected)
        if key == self._past_key:
            return changed
        self._past_key = key
        self._show_past(state)
        return True

    def _show_current(self, state: ViewState) -> bool:
        progress = state.live.progress
        axis = _key(progress) if state.snapshot.is_placed else b""
        if axis == self._axis:
            return False
        self._axis = axis
        ends = at = NO_POINTS
        if axis:
            direction = progress.force / np.linalg.norm(progress.force)
            at = contact_point(self.static.surface, progress.axis_point, direction, self._mean_place(state, progress))[None]
            ends = _span(at, direction[None])
        self.current.show(ends, self.colours.ink)
        self.contact.show(at, self.colours.ink)
        return True

    def _mean_place(self, state: ViewState, progress: Progress) -> FloatArray:
        """Return the mean position of the taxels that answer; without known positions the middle of the part."""
        places = [place for c in progress.channels.tolist() if (place := self._place_of(state, c)) is not None]
        return np.mean(places, axis=0) if places else self._middle

    def _show_past(self, state: ViewState) -> None:
        channel = state.selected
        if channel is None or channel not in self.static.row or not state.snapshot.is_placed:
            self.past.show(NO_POINTS, self.colours.ink)
            return
        place = self._place_of(state, channel)
        pokes = Pokes.collect(_contacts_of(state.snapshot, channel))
        points, directions = pokes.axis_point, pokes.direction
        along = np.einsum("ix,ix->i", (self._middle if place is None else place) - points, directions)
        self.past.show(_span(points + directions * along[:, None], directions), self.colours.ink)

    def _place_of(self, state: ViewState, channel: int) -> FloatArray | None:
        """Return the position of a taxel by its estimate, else by the plan; `None` if neither is known."""
        row, estimates = self.static.row.get(channel), state.estimates
        if row is None:
            return None
        position = estimates[row].position if row < len(estimates) else None
        return self.static.places[row] if position is None and np.isfinite(self.static.places[row, 0]) else position


def _key(progress: Progress) -> bytes:
    """Return a key that changes with the current axis; empty while nothing presses."""
    known = np.isfinite([progress.force, progress.axis_point]).all() and progress.force.any()
    return progress.force.tobytes() + progress.axis_point.tobytes() if known and progress.phase in PRESSING_PHASES else b""


def _span(at: FloatArray, directions: FloatArray) -> FloatArray:
    """Return the drawn parts of force axes through points, (n, 2, 3) float, metres."""
    return np.stack([at - DRAWN_TOOL_LENGTH_M * directions, at + AXIS_LENGTH_BEYOND_CONTACT_M * directions], axis=1)


def _contacts_of(snapshot: Snapshot, channel: int) -> list[Contact]:
    """Return the newest contacts that a channel answered, without excluded ones."""
    counting = (record.outcome for record in reversed(snapshot.pokes) if not record.excluded)
    return list(islice((c for c in counting if isinstance(c, Contact) and channel in c.channels), MAX_DRAWN_FORCE_AXES))
