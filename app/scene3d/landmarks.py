"""Known points of the part: diamonds on the skin, with a cross inside until the landmark was poked in this arm pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyvista as pv

from app.scene3d.camera import facing
from app.scene3d.lines import crosses, rings
from app.scene3d.mesh_actors import FRONT, NO_POINTS, Label, Layer, Segments
from app.scene3d.scene_state import StaticScene
from skincal.geometry import FloatArray

if TYPE_CHECKING:
    from app.state.view_state import ViewState
    from skincal.mesh.surface import Surface
    from skincal.model.scene import Landmark
    from skincal.session.snapshot import Snapshot

LANDMARK_DIAMOND_RADIUS_M = 2.6e-3
"""m. From the middle of a diamond to its corners: a screw's head, and well inside the target's ring."""
MIN_LANDMARK_DIAMOND_RADIUS_PX = 8.0  # The same on the screen at least, so that it is found on a whole body
MAX_LANDMARKS_WITH_NAMES = 12  # More landmarks than this are drawn without their names, which would hide each other
LANDMARK_TO_NAME_GAP_PX = 6.0  # Between a diamond and its name
MIN_LANDMARK_FACING_COSINE = 0.05
"""Cosine. A landmark that is turned further from the camera is behind the part, or seen as a line."""


class LandmarksLayer(Layer):
    """Diamonds and names; nothing while the session has no landmark."""

    name = "landmarks"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self.marks = Segments(plotter, FRONT, 2.0)
        self.places = NO_POINTS  # (n, 3) float, metres: positions of the landmarks
        self._landmarks: tuple[Landmark, ...] = ()
        self._poked: frozenset[str] = frozenset()
        self._normals = NO_POINTS
        self._moment: tuple[int, str] = -1, ""  # Generation of the session and name of the arm pose that are drawn

    def show(self, state: ViewState) -> bool:
        snapshot = state.snapshot
        moment = snapshot.generation, state.live.pose
        if moment == self._moment:
            return False
        self._moment = moment
        poked, landmarks = poked_here(snapshot, moment[1]), snapshot.decisions.landmarks
        if (landmarks, poked) == (self._landmarks, self._poked):
            return False
        self._poked, self._landmarks = poked, landmarks
        self.places = np.array([landmark.place for landmark in landmarks]).reshape(-1, 3)
        self._normals = normals_of(landmarks, self.static.surface)
        self.draw()
        return True

    def draw(self) -> None:
        """Keep the diamonds large enough to be found, and leave out those on the part's far side."""
        if self.viewpoint is None:
            return
        radius = max(LANDMARK_DIAMOND_RADIUS_M, MIN_LANDMARK_DIAMOND_RADIUS_PX * self.viewpoint.pixel)
        near = facing(self._normals, self.places, self.viewpoint.pose.position) >= MIN_LANDMARK_FACING_COSINE
        fresh = near & np.array([landmark.name not in self._poked for landmark in self._landmarks], dtype=bool)
        diamonds = rings(self.places[near], self._normals[near], radius, sides=4)
        inner = crosses(self.places[fresh], self._normals[fresh], radius)
        ink, faint = np.array(self.colours.ink, float), np.array(self.colours.faint, float)
        sides = np.where(fresh[near][:, None], ink, (ink + 2.0 * faint) / 3.0).astype(np.uint8).repeat(8, axis=0)
        colours = np.concatenate([sides, np.tile(self.colours.ink, (4 * len(inner), 1))])
        self.marks.show(np.concatenate([diamonds.reshape(-1, 3), inner.reshape(-1, 3)]), colours.astype(np.uint8))
        gap = radius / self.viewpoint.pixel + LANDMARK_TO_NAME_GAP_PX
        named = self._landmarks if len(self._landmarks) <= MAX_LANDMARKS_WITH_NAMES else ()
        self.labels = [Label(mark.name, mark.place, gap, 1.0) for mark, seen in zip(named, near, strict=False) if seen]


def poked_here(snapshot: Snapshot, pose: str) -> frozenset[str]:
    """Return the names of the landmarks that were poked in an arm pose, by pokes that count."""
    at = snapshot.at_landmarks
    counting = (record.outcome for record in snapshot.pokes if record.outcome.poke in at and not record.excluded)
    return frozenset(at[outcome.poke] for outcome in counting if outcome.pose == pose)


def normals_of(landmarks: tuple[Landmark, ...], surface: Surface | None) -> FloatArray:
    """Return the outward normal at each of n landmarks, (n, 3) float, unit: the link's z where it is unknown."""
    from skincal.session.landmark_pokes import landmark_normals  # the first picture has no landmark

    up = np.array([0.0, 0.0, 1.0])
    found = landmark_normals(landmarks, surface)
    return np.array([up if normal is None else normal for normal in found]).reshape(-1, 3)
