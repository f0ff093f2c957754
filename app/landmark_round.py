"""The landmarks that the window asks for, and which pokes were at them."""

from __future__ import annotations

from collections import Counter
from itertools import takewhile

import numpy as np

from app.opening import Part
from skincal.contacts.outcome import Contact, Outcome
from skincal.geometry.arrays import FloatArray
from skincal.guide.guidance import Guidance
from skincal.guide.landmark_targets import LandmarkRound, LandmarkTarget, Stances, rig_moves, was_there
from skincal.guide.places import PlannedPlaces
from skincal.model.scene import Landmark
from skincal.rig.correction import RigPrior
from skincal.rig.correction_fit import LandmarkPoke
from skincal.rig.expected_gain import Gain, PlannedPoke, expected_error
from skincal.session.actions import AtLandmark
from skincal.session.known_points import landmark_normals, landmark_pokes, poke_at
from skincal.session.snapshot import Snapshot

POSES = 7
"""Arm poses that the gain is foretold for, those with most contacts, beside the present one: streamed joints make more."""
STILL_S = 1.0
"""s. Landmarks are asked for where the arm has stood so long: on its way it goes through poses in which nobody pokes."""
REACTION_S = 0.25
"""s. A poke that is held so soon after another landmark came up was on its way to the one before: a visual reaction."""


class Landmarks:
    """Follows a session; the guide of the skin stands behind it.

    Parameters
    ----------
    part : what is calibrated
    plan : where the layout puts the taxels
    """

    def __init__(self, part: Part, plan: PlannedPlaces) -> None:
        self._scene, self._surface = part.scene, part.surface
        there = np.isfinite(plan.places).all(axis=1)
        self._taxels, self._outward = plan.places[there], plan.normals[there]
        """(n, 3) float each, metres and unit: of the taxels that the layout places."""
        self._places = dict(zip(plan.channels[there].tolist(), self._taxels, strict=True))
        self._round = LandmarkRound()
        self._stances = Stances()
        self._stance, self._stance_s = "", -np.inf
        """The arm's pose, and since when it holds: host's monotonic clock, seconds."""
        self._normals: dict[bytes, FloatArray] = {}
        self._wishes: list[LandmarkTarget] = []
        """All that is asked for in this arm pose."""
        self._asked_s = np.inf
        """Host's monotonic clock, seconds, since when the landmark is asked for."""
        self._told: tuple[object, ...] = ()
        self._shown: Guidance | None = None
        self._seen = 0
        """Number of the newest poke that was looked at."""

    def begin(self, snapshot: Snapshot) -> None:
        """Start with pokes that were there already."""
        self._seen = _newest(snapshot)

    def forget(self) -> None:
        """Ask for nothing, and take no poke for one at a landmark: nobody guides."""
        self._wishes, self._told, self._asked_s = [], (), np.inf

    def poked(self, snapshot: Snapshot) -> list[AtLandmark]:
        """Return which new pokes were at the landmark that was asked for: mostly one, more where the window was busy."""
        seen, self._seen = self._seen, _newest(snapshot)
        wish = self._wish
        if wish is None or self._seen <= seen:
            return []
        new = takewhile(lambda record: record.outcome.poke > seen, reversed(snapshot.pokes))
        begun = self._asked_s + REACTION_S
        there = [one.outcome for one in new if one.outcome.start_s >= begun and self._was_at(one.outcome, wish.landmark)]
        return [AtLandmark(one.poke, wish.landmark.name) for one in reversed(there)]

    def _was_at(self, outcome: Outcome, landmark: Landmark) -> bool:
        return poke_at(outcome, landmark) is not None and was_there(outcome, landmark, self._places)

    def before_skin(self, guidance: Guidance, snapshot: Snapshot, now_s: float) -> Guidance:
        """Return the guidance with a landmark before the skin, where one is asked for.

        Parameters
        ----------
        guidance : of the skin
        now_s : host's monotonic clock, seconds, when it is seen
        """
        here = self._key(snapshot.pose, snapshot.link_from_sensor)
        if here != self._stance:
            self._stance, self._stance_s = here, now_s if self._stance and not self._is_named(here) else -np.inf
        still = now_s - self._stance_s >= STILL_S
        told = ([one.name for one in snapshot.landmarks], snapshot.at_landmarks, here, still, guidance)
        if told != self._told:
            self._told, before = told, self._wish
            self._wishes = self._plan(snapshot) if still else []
            now = self._wish
            if now is None:
                self._shown = guidance
            else:
                if before is None or before.landmark is not now.landmark:
                    self._asked_s = now_s
                gain = self._gain_of(snapshot)
                self._shown = guidance.before_skin(now, self._normal(now.landmark), gain)
        return self._shown or guidance

    def _is_named(self, pose: str) -> bool:
        """Return whether the scene knows that arm pose; streamed joints pass through others that have no name of their own."""
        return self._scene.arm is None or pose in self._scene.arm.poses

    def _key(self, pose: str, link_from_sensor: FloatArray | None) -> str:
        return pose if not pose or self._is_named(pose) else self._stances.key(pose, link_from_sensor)

    @property
    def _wish(self) -> LandmarkTarget | None:
        return self._wishes[0] if self._wishes else None

    def _plan(self, snapshot: Snapshot) -> list[LandmarkTarget]:
        if not snapshot.landmarks or (self._scene.arm is not None and not snapshot.pose):
            return []
        poked = [(self._key(one.pose, one.link_from_sensor), one.name) for one in self._made(snapshot)]
        return self._round.plan(snapshot.landmarks, poked, self._stance)

    def _made(self, snapshot: Snapshot) -> list[LandmarkPoke]:
        """Return the landmark pokes that count."""
        counting = (one.outcome for one in snapshot.pokes if not one.excluded)
        return landmark_pokes(counting, snapshot.landmarks, snapshot.at_landmarks)

    def rig_moves(self, snapshot: Snapshot) -> float:
        """Return by how much the rig moves estimates, as landmark pokes tell: sd in each direction, metres."""
        return rig_moves(self._made(snapshot), self._scene.noise)

    def _gain_of(self, snapshot: Snapshot) -> Gain | None:
        """Foretell what the landmarks of this arm pose are worth for the taxels that are poked in it and in those before."""
        told = snapshot.link_from_sensor
        if told is None or not len(self._taxels):
            return None
        contacts = [one.outcome for one in snapshot.pokes if isinstance(one.outcome, Contact) and not one.excluded]
        often = [name for name, _ in Counter(one.pose for one in contacts).most_common(POSES)]
        poses = {one.pose: one.link_from_sensor for one in contacts if one.pose in often} | {snapshot.pose: told}
        planned = [PlannedPoke(wish.landmark.place, self._normal(wish.landmark), told, snapshot.pose) for wish in self._wishes]
        made, noise = [one for one in self._made(snapshot) if one.pose in poses], self._scene.noise
        return expected_error(RigPrior(), noise, made, planned, self._taxels, self._outward, poses)

    def skip(self, *, all_of_pose: bool = False) -> None:
        """Ask for that landmark no more in this arm pose, or for none."""
        if self._wish is not None:
            if all_of_pose:
                self._round.leave_out(self._stance)
            else:
                self._round.skip(self._wish.landmark.name, self._stance)
        self._told = ()

    def _normal(self, landmark: Landmark) -> FloatArray:
        """Return the outward normal at a landmark: its own, else the surface's, else away from the skin's middle."""
        key = landmark.place.tobytes()
        if key not in self._normals:
            (found,) = landmark_normals([landmark], self._surface)
            self._normals[key] = self._outward_at(landmark.place) if found is None else found
        return self._normals[key]

    def _outward_at(self, place: FloatArray) -> FloatArray:
        away = place - self._taxels.mean(axis=0) if len(self._taxels) else place
        size = float(np.linalg.norm(away))
        return away / size if size > 0 else np.array([0.0, 0.0, 1.0])


def _newest(snapshot: Snapshot) -> int:
    return snapshot.pokes[-1].outcome.poke if snapshot.pokes else 0
