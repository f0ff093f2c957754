"""Landmark pokes of a session: found after a request, or named by the operator."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Outcome, Reason, Rejection
from skincal.geometry import FloatArray, axis_point, move_wrench
from skincal.guide.guidance import may_be_at_landmark
from skincal.model.actions import FoundAtLandmark, MissedLandmark
from skincal.model.scene import Landmark, NoiseSettings
from skincal.rig.correction_fit import LandmarkPoke
from skincal.rig.expected_gain import expected_miss

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

VISUAL_REACTION_TIME_S = 0.25
"""s, visual reaction time. A poke that starts sooner after a new request was on its way to the landmark before."""
LANDMARK_NORMAL_MAX_MESH_DISTANCE_M = 0.010
"""m. A landmark farther from the surface takes no normal from it; a point of a jig, say, may be poked from any side."""
MAX_MISS_OVER_EXPECTED_MISS = 3.0
"""A landmark poke may miss by this many times the miss that an ordinary rig predicts (`expected_miss`): 34 mm on the forearm.
Nine in ten pass at 19 mm; a poke at another landmark passes at 33 to 81."""

LANDMARK_MATCH_MAX_DISTANCE_M = 0.020
"""m. A poke is matched to the landmark that its axis passes within this distance..."""
OTHER_LANDMARK_MIN_DISTANCE_RATIO = 2.0
"""...if it passes every other landmark at this many times that distance. On 40 rigs with the paper's errors this names 90 % of
840 landmark pokes, none wrongly: axes pass their landmarks at 10 mm in the median, at 19 mm in nine of ten. The axes of 29 % of
the pokes on the skin pass a landmark in the same way, so a poke that a taxel answered is never matched."""
MAX_PUSH_COSINE = -0.5
"""Largest cosine between the push and the outward normal of a landmark: a push that leans more than 60 degrees slides off."""


@dataclass(frozen=True, slots=True)
class NearestLandmark:
    """The landmark that a poke's axis passes nearest, of those that it pushes at."""

    poke: int
    name: str
    miss: float
    """m, distance of the axis from it."""
    other: float
    """m, distance from the next one; infinite without one."""
    sure: bool
    """No taxel answered, and no other landmark is nearly as near."""


class LandmarkFinder:
    """Finds the new pokes at the requested landmark.

    Parameters
    ----------
    places : gives the planned places of taxels, (3,) float, metres, by channel; called when first needed
    surface : for the outward direction at landmarks without a normal
    """

    def __init__(self, places: Callable[[], Mapping[int, FloatArray]], surface: Surface | None) -> None:
        self._places, self._surface = places, surface
        self._outward: dict[bytes, FloatArray | None] = {}
        self.asked = ""
        """Name of the requested landmark; empty without one."""
        self._asked_s = math.inf

    def ask(self, name: str, host_s: float) -> None:
        """Set the request, made at `host_s`, seconds of the host's monotonic clock."""
        self.asked, self._asked_s = name, host_s

    def find_landmark_pokes(
        self,
        new: Iterable[Outcome],
        named: Iterable[LandmarkPoke],
        landmarks: Iterable[Landmark],
        missed: Collection[int],
        by_hand: Collection[int],
        noise: NoiseSettings,
    ) -> list[FoundAtLandmark | MissedLandmark]:
        """Find which new pokes were at the requested landmark, and which missed it.

        A poke counts if it began `VISUAL_REACTION_TIME_S` after the request, has a force axis, and no taxel far from the
        landmark answered. A poke that misses by more than `MAX_MISS_OVER_EXPECTED_MISS` times the expected miss is rejected,
        unless at least half of the earlier pokes missed as much. Then the sensor's frame may be wrong, and these pokes show it.
        Once most pokes hit, those that missed are removed, except those that the operator named.

        Parameters
        ----------
        new : in the order of their numbers, after the frame's correction
        named : earlier landmark pokes
        missed, by_hand : numbers of the pokes that missed, and of those that the operator named
        """
        known = {landmark.name: landmark for landmark in landmarks}
        landmark = known.get(self.asked)
        if landmark is None:
            return []
        misses = {poke.poke: self._miss(poke, known[poke.name], noise) for poke in named}
        near = sum(each is None for each in misses.values())
        far = len(misses) - near + len(missed)
        found: list[FoundAtLandmark | MissedLandmark] = []
        for outcome in new:
            poke = poke_at(outcome, landmark)
            if poke is None or not self._may_be(outcome, landmark):
                continue
            miss = self._miss(poke, landmark, noise)
            found.append(FoundAtLandmark(outcome.poke, landmark.name) if miss is None or near <= far else miss)
            near, far = near + (miss is None), far + (miss is not None)
        if near > far:
            found[:0] = [miss for poke, miss in misses.items() if miss is not None and poke not in by_hand]
        return found

    def _miss(self, poke: LandmarkPoke, landmark: Landmark, noise: NoiseSettings) -> MissedLandmark | None:
        """Describe how a poke missed a landmark; `None` for a hit."""
        key = landmark.place.tobytes()
        if key not in self._outward:
            (self._outward[key],) = landmark_normals([landmark], self._surface)
        outward = self._outward[key]
        force, _ = move_wrench(poke.link_from_sensor, poke.force, poke.moment)
        behind = outward is not None and float(outward @ force) > MAX_PUSH_COSINE * float(np.linalg.norm(force))
        limit = MAX_MISS_OVER_EXPECTED_MISS * expected_miss(poke, noise)
        return MissedLandmark(poke.poke, poke.name, poke.miss, limit, behind) if behind or not poke.miss <= limit else None

    def _may_be(self, outcome: Outcome, landmark: Landmark) -> bool:
        late = outcome.start_s >= self._asked_s + VISUAL_REACTION_TIME_S
        return late and (isinstance(outcome, Rejection) or may_be_at_landmark(outcome, landmark, self._places()))


def landmark_pokes(outcomes: Iterable[Outcome], landmarks: Iterable[Landmark], named: Mapping[int, str]) -> list[LandmarkPoke]:
    """Select the landmark pokes from `outcomes`, in their order; `named` gives the landmark's name by poke."""
    known = {landmark.name: landmark for landmark in landmarks}
    there = ((outcome, known.get(named.get(outcome.poke, ""))) for outcome in outcomes)
    found = (poke_at(outcome, landmark) for outcome, landmark in there if landmark is not None)
    return [poke for poke in found if poke is not None]


def can_be_at_landmark(outcome: Outcome) -> bool:
    """Whether a poke has a force axis and was accepted, or rejected only because no taxel answered."""
    nowhere = Landmark("", np.zeros(3), None)
    return poke_at(outcome, nowhere) is not None


def poke_at(outcome: Outcome, landmark: Landmark) -> LandmarkPoke | None:
    """Make a landmark poke of an outcome; `None` unless `can_be_at_landmark`."""
    if isinstance(outcome, Rejection) and outcome.reason is not Reason.NO_TAXEL:
        return None
    force, moment, pose = outcome.force, outcome.moment, outcome.link_from_sensor
    if force is None or moment is None or pose is None:
        return None
    return LandmarkPoke(outcome.poke, landmark.name, landmark.place, force, moment, pose, outcome.pose)


def nearest_landmarks(
    outcomes: Iterable[Outcome], landmarks: Sequence[Landmark], surface: Surface | None
) -> dict[int, NearestLandmark]:
    """Find the landmark nearest to the force axis of each poke within `LANDMARK_MATCH_MAX_DISTANCE_M`, by poke number.

    Parameters
    ----------
    outcomes : after the frame's correction
    surface : for the outward direction at landmarks without a normal
    """
    if not landmarks:
        return {}
    places = np.array([landmark.place for landmark in landmarks])
    outward = np.array([np.zeros(3) if normal is None else normal for normal in landmark_normals(landmarks, surface)])
    found: dict[int, NearestLandmark] = {}
    for outcome in outcomes:
        poke = poke_at(outcome, landmarks[0])
        if poke is None:
            continue
        force, moment = move_wrench(poke.link_from_sensor, poke.force, poke.moment)
        push = force / np.linalg.norm(force)
        misses = np.linalg.norm(np.cross(places - axis_point(force, moment), push), axis=1)
        # Without an outward direction any push may be at it.
        misses[(outward @ push > MAX_PUSH_COSINE) & outward.any(axis=1)] = np.inf
        nearest = int(misses.argmin())
        miss, other = float(misses[nearest]), float(np.delete(misses, nearest).min(initial=np.inf))
        if np.isfinite(miss):
            sure = (
                isinstance(outcome, Rejection)
                and miss <= LANDMARK_MATCH_MAX_DISTANCE_M
                and other >= OTHER_LANDMARK_MIN_DISTANCE_RATIO * miss
            )
            found[outcome.poke] = NearestLandmark(outcome.poke, landmarks[nearest].name, miss, other, sure)
    return found


def landmark_normals(landmarks: Sequence[Landmark], surface: Surface | None) -> list[FloatArray | None]:
    """Choose the outward normal of each landmark: its own, else that of the nearest triangle, else `None`.

    A landmark added by hand has none. Without one, a sensor that reports the reaction force is not recognized.
    """
    normals = [landmark.normal for landmark in landmarks]
    missing = [i for i, normal in enumerate(normals) if normal is None]
    if surface is None or not missing:
        return normals
    places = np.array([landmarks[i].place for i in missing])
    from skincal.mesh.search import nearest_points  # a scene without a surface does without

    nearest, triangles = nearest_points(surface, places)
    for i, off, triangle in zip(missing, np.linalg.norm(nearest - places, axis=1), triangles, strict=True):
        if off <= LANDMARK_NORMAL_MAX_MESH_DISTANCE_M:
            normals[i] = surface.normals[triangle]
    return normals
