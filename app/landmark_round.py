"""The landmarks that the window asks for, and which pokes were at them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from app.opening import Part
from skincal.contacts.outcome import Outcome
from skincal.guide.guidance import Guidance
from skincal.guide.landmarks import LandmarkRound, LandmarkWish, was_there
from skincal.readings import FloatArray
from skincal.scene import Landmark
from skincal.session.actions import AtLandmark
from skincal.session.known_points import poke_at
from skincal.session.snapshot import Snapshot
from skincal.surface.nearest import nearest_points


class Landmarks:
    """Follows a session; the guide of the skin stands behind it.

    Parameters
    ----------
    part : what is calibrated
    places : (3,) float, metres, of taxels by their channel, as the layout plans them
    """

    def __init__(self, part: Part, places: Mapping[int, FloatArray]) -> None:
        self._scene, self._surface = part.scene, part.surface
        self._places = places
        self._round = LandmarkRound()
        self._normals: dict[str, FloatArray] = {}
        self._wish: LandmarkWish | None = None
        self._asked_s = np.inf
        """Host's monotonic clock, seconds, since when the landmark is asked for."""
        self._told: tuple[object, ...] = ()
        self._shown: tuple[Guidance, LandmarkWish | None, Guidance] | None = None
        self._seen = 0
        """Number of the newest poke that was looked at."""

    def begin(self, snapshot: Snapshot) -> None:
        """Start with pokes that were there already."""
        self._seen = _newest(snapshot)

    def poked(self, snapshot: Snapshot) -> AtLandmark | None:
        """Return that the newest poke was at the landmark that was asked for; None where it was not, or was told before."""
        newest = snapshot.pokes[-1].outcome if snapshot.pokes else None
        if newest is None or newest.poke <= self._seen:
            return None
        self._seen = newest.poke
        wish = self._wish
        if wish is None or newest.start_s < self._asked_s or not self._was_at(newest, wish.landmark):
            return None
        return AtLandmark(newest.poke, wish.landmark.name)

    def _was_at(self, outcome: Outcome, landmark: Landmark) -> bool:
        return poke_at(outcome, landmark) is not None and was_there(outcome, landmark, self._places)

    def before_skin(self, guidance: Guidance, snapshot: Snapshot, now_s: float) -> Guidance:
        """Return the guidance with a landmark before the skin, where one is asked for.

        Parameters
        ----------
        guidance : of the skin
        now_s : host's monotonic clock, seconds
        """
        told = ([one.name for one in snapshot.landmarks], snapshot.at_landmarks, snapshot.pose, guidance)
        if told != self._told:
            self._told = told
            before, self._wish = self._wish, self._next(snapshot)
            if self._wish is not None and (before is None or before.landmark is not self._wish.landmark):
                self._asked_s = now_s
        if self._shown is None or self._shown[:2] != (guidance, self._wish):
            self._shown = guidance, self._wish, self._with(guidance, self._wish)
        return self._shown[2]

    def _with(self, guidance: Guidance, wish: LandmarkWish | None) -> Guidance:
        return guidance if wish is None else guidance.before_skin(wish, self._normal(wish.landmark))

    def _next(self, snapshot: Snapshot) -> LandmarkWish | None:
        if not snapshot.landmarks or (self._scene.arm is not None and not snapshot.pose):
            return None
        at = snapshot.at_landmarks
        counting = (one.outcome for one in snapshot.pokes if one.outcome.poke in at and not one.excluded)
        poked = [(outcome.pose, at[outcome.poke]) for outcome in counting]
        return self._round.next(snapshot.landmarks, poked, snapshot.pose)

    def skip(self, pose: str, *, all_of_pose: bool = False) -> None:
        """Ask for that landmark no more in this arm pose, or for none."""
        if self._wish is not None:
            if all_of_pose:
                self._round.leave_out(pose)
            else:
                self._round.skip(self._wish.landmark.name, pose)
        self._told = ()

    def _normal(self, landmark: Landmark) -> FloatArray:
        """Return the outward normal at a landmark: its own, else the surface's, else away from the skin's middle."""
        if landmark.normal is not None:
            return landmark.normal
        if landmark.name not in self._normals:
            self._normals[landmark.name] = self._found_normal(landmark.place)
        return self._normals[landmark.name]

    def _found_normal(self, place: FloatArray) -> FloatArray:
        if self._surface is not None:
            return self._surface.normals[nearest_points(self._surface, place[None])[1][0]]
        away = place - np.mean(list(self._places.values()), axis=0) if self._places else place
        size = float(np.linalg.norm(away))
        return away / size if size > 0 else np.array([0.0, 0.0, 1.0])


def _newest(snapshot: Snapshot) -> int:
    return snapshot.pokes[-1].outcome.poke if snapshot.pokes else 0
