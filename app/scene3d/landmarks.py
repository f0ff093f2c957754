"""Known points of the part: a diamond lying on the skin, its corners joined by a cross until it was poked in this arm pose.

A diamond that has no cross, and is paler, was poked as the arm stands. What lies on the far side of the part is left out.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkProp, vtkRenderer

from app.scene3d.camera import project
from app.scene3d.estimates import EstimatesLayer
from app.scene3d.names import boxes_around, make_readable, name_actor, put
from app.scene3d.scene_state import ColourArray, Look, StaticScene, View3DState
from app.scene3d.shapes import Layer, Segments, closed, tangents
from app.scene3d.target import TargetLayer
from skincal.geometry import FloatArray
from skincal.mesh.surface import Surface
from skincal.model.scene import Landmark
from skincal.session.landmark_pokes import landmark_normals
from skincal.session.snapshot import Snapshot

DIAMOND = 2.6e-3
"""m. From the middle of a diamond to its corners: a screw's head, and well inside the target's ring."""
LEAST_PIXELS = 8.0
"""The same on the screen at least: on a whole body a diamond of its own size would not be found."""
LIFT = 2.5e-3
"""m. How far towards the camera it is drawn: the part's curve must not cut it, the target's ring may."""
MOST_NAMES = 12
"""More landmarks than this are drawn without their names, which would hide each other."""
LETTERS = 13
"""Points, size of the names."""
GAP = 6.0
"""Pixels between a diamond and its name; where the target's ring is there, the name stands beyond that."""
FAR_SIDE = -0.1
"""Cosine. A landmark that is turned further from the camera is behind the part; a little less than 0 since the nearer ones of
a part that fills the picture are seen at such an angle."""


class LandmarksLayer(Layer):
    """Diamonds and names; nothing while the session has no landmark."""

    name = "landmarks"

    def __init__(self, renderer: vtkRenderer, static: StaticScene, target: TargetLayer, estimates: EstimatesLayer) -> None:
        super().__init__()
        self.marks = Segments(pixels=2.0)
        self.names = [name_actor(LETTERS) for _ in range(MOST_NAMES)]
        """The first `named` belong to the landmarks, the others are hidden."""
        self.named = 0
        self.places: FloatArray = np.empty((0, 3))
        """(n, 3) float, metres: where the landmarks are."""
        self._surface = static.surface
        self._renderer = renderer
        self._target, self._estimates = target, estimates
        self._taken = target.boxes
        """What the names made room for."""
        self._landmarks: tuple[Landmark, ...] = ()
        self._poked: frozenset[str] = frozenset()
        self._normals: FloatArray = np.empty((0, 3))
        self._generation = -1

    def props(self) -> Sequence[vtkProp]:
        """Return the diamonds, then the names."""
        return *super().props(), *self.names

    def show(self, state: View3DState) -> bool:
        """Show a session's landmarks; return whether anything changed."""
        if self._target.boxes is not self._taken:
            self.draw()
        snapshot = state.snapshot
        if not (snapshot.landmarks or self._landmarks) or snapshot.generation == self._generation:
            return False
        self._generation = snapshot.generation
        poked = poked_here(snapshot)
        if snapshot.landmarks == self._landmarks and poked == self._poked:
            return False
        self._poked = poked
        if snapshot.landmarks != self._landmarks:
            self._landmarks = snapshot.landmarks
            self.places = np.array([landmark.place for landmark in self._landmarks]).reshape(-1, 3)
            self._normals = normals_of(self._landmarks, self._surface)
            self._put_names()
            self.marks.clear()
        self.draw()
        return True

    def draw(self) -> None:
        """Keep the diamonds large enough to be found when the camera goes away, and leave out those on the part's far side."""
        sight = self.sight
        if sight is None or not self._landmarks:
            return
        # How many times larger than its own size each is drawn.
        scale = max(1.0, LEAST_PIXELS / (DIAMOND * sight.scale))
        near = self._normals @ sight.towards >= FAR_SIDE
        fresh = np.array([landmark.name not in self._poked for landmark in self._landmarks], dtype=bool)[near]
        diamonds, crosses = strokes(self.places[near], self._normals[near], scale * DIAMOND)
        ink, pale = np.array(self.look.ink, np.uint8), _pale(self.look)
        sides = np.where(fresh[:, None, None], ink, pale).repeat(4, axis=1)
        inner = np.tile(ink, (2 * int(fresh.sum()), 1))
        ends = np.concatenate([diamonds.reshape(-1, 2, 3), crosses[fresh].reshape(-1, 2, 3)])
        self.marks.join(sight.lift(ends, LIFT * scale), np.concatenate([sides.reshape(-1, 3), inner]).astype(np.uint8))
        self._place_names(near, scale * DIAMOND * sight.scale)

    def _place_names(self, near: NDArray[np.bool_], radius: float) -> None:
        """Put each name beside its diamond, of so many pixels, and away from the target and from each other."""
        self._taken = self._target.boxes
        at = project(self._renderer, self.places)
        # A diamond outside the picture has no name in it. So, and not `>`: what lies behind the camera has the depth NaN.
        inside = ((at[:, :2] >= 0.0) & (at[:, :2] <= self._renderer.GetSize())).all(axis=1)
        seen = near & (np.abs(at[:, 2]) <= 1.0) & inside
        taken = np.concatenate([self._taken, boxes_around(at[seen, :2], radius), self._estimates.boxes(self._renderer)])
        for row, actor in enumerate(self.names[: self.named]):
            actor.SetVisibility(bool(seen[row]))
            poked = self._landmarks[row].name in self._poked
            make_readable(actor, self.look, _pale(self.look) if poked else self.look.ink)
            if seen[row]:
                taken = np.concatenate([taken, put(actor, self._renderer, at[row, :2], radius + GAP, taken)[None]])

    def _put_names(self) -> None:
        """Write the names beside the diamonds, where there are few."""
        self.named = len(self._landmarks) if len(self._landmarks) <= MOST_NAMES else 0
        for actor in self.names[self.named :]:
            actor.VisibilityOff()
        for actor, landmark in zip(self.names[: self.named], self._landmarks, strict=False):
            actor.SetInput(landmark.name)


def poked_here(snapshot: Snapshot) -> frozenset[str]:
    """Return the names of the landmarks that were poked in the present arm pose, by pokes that count."""
    pokes = snapshot.pokes
    found: set[str] = set()
    for number, name in snapshot.at_landmarks.items():
        # Pokes stand in the order of their numbers, and there may be thousands.
        at = bisect_left(pokes, number, key=lambda record: record.outcome.poke)
        if at == len(pokes) or pokes[at].outcome.poke != number or pokes[at].excluded:
            continue
        if pokes[at].outcome.pose == snapshot.pose:
            found.add(name)
    return frozenset(found)


def normals_of(landmarks: tuple[Landmark, ...], surface: Surface | None) -> FloatArray:
    """Return the outward normal at each of n landmarks, (n, 3) float, unit: the link's z where it is unknown."""
    up = np.array([0.0, 0.0, 1.0])
    found = landmark_normals(landmarks, surface)
    return np.array([up if normal is None else normal for normal in found]).reshape(-1, 3)


def strokes(places: FloatArray, normals: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Return diamonds about `places`, (n, 3), across `normals`, (n, 3) unit, and the crosses that join their corners.

    All in metres: (n, 4, 2, 3) the sides, (n, 2, 2, 3) the crosses; `radius` is from the middle to the corners.
    """
    first, second = tangents(normals)
    corners = places[:, None] + radius * np.stack([first, second, -first, -second], axis=1)
    return closed(corners), np.stack([corners[:, ::2], corners[:, 1::2]], axis=1)


def _pale(look: Look) -> ColourArray:
    return ((np.array(look.ink, float) + 2.0 * np.array(look.faint, float)) / 3.0).astype(np.uint8)
