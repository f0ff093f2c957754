"""Landmark pokes of a session: found after a request, or named by the operator."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Outcome, Reason, Rejection
from skincal.geometry import FloatArray, IntArray
from skincal.guide.guidance import may_be_at_landmark
from skincal.model.actions import FoundAtLandmark, MissedLandmark
from skincal.model.scene import Landmark, NoiseSettings
from skincal.pokes import LandmarkPokes, Pokes
from skincal.rig.expected_gain import expected_miss

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface
    from skincal.model.tool_rig import ToolSpec

VISUAL_REACTION_TIME_S = 0.25
"""s, visual reaction time. A poke that starts sooner after a new request was on its way to the landmark before."""
LANDMARK_NORMAL_MAX_MESH_DISTANCE_M = 0.010
"""m. A landmark farther from the surface takes no normal from it; a point of a jig, say, may be poked from any side."""
MAX_MISS_OVER_EXPECTED_MISS = 3.0
"""A landmark poke may miss by this many times the miss that an ordinary rig predicts (`expected_miss`): 34 mm on the forearm.
Nine in ten pass at 19 mm; a poke at another landmark passes at 33 to 81."""

LANDMARK_MATCH_MAX_DISTANCE_M = 0.020
"""m. A poke is matched to the landmark that its axis passes, or its tip touches, within this distance..."""
OTHER_LANDMARK_MIN_DISTANCE_RATIO = 2.0
"""...if it passes every other landmark at this many times that distance. On 40 rigs with the paper's errors this names 90 % of
840 landmark pokes, none wrongly: axes pass their landmarks at 10 mm in the median, at 19 mm in nine of ten. The axes of 29 % of
the pokes on the skin pass a landmark in the same way, so a poke that a taxel answered is never matched."""
BALL_CONTACT_SD_OVER_RADIUS = 0.3
"""Before the part's place is known a ball is taken to touch along its push: pushes lean by up to 20 degrees."""
MAX_PUSH_COSINE = -0.5
"""Largest cosine between the push and the outward normal of a landmark: a push that leans more than 60 degrees slides off."""


@dataclass(frozen=True, slots=True)
class NearestLandmark:
    """The landmark nearest to the tip or the force axis of a poke, of those that it pushes at."""

    poke: int
    name: str
    miss: float
    """m, distance of the tip from it, or of the axis."""
    other: float
    """m, distance from the next one; infinite without one."""
    sure: bool
    """No taxel answered, and no other landmark is nearly as near."""


@dataclass(frozen=True, slots=True)
class LandmarkNames:
    """Landmarks of pokes by the shape of the touched points."""

    names: Mapping[int, str]
    """By poke, of those at a landmark."""
    rival: Mapping[int, str] | None
    """Other names that fit as well; `None` if there are none."""
    miss: float
    """m, rms distance of the touched points from their landmarks."""


class LandmarkFinder:
    """Finds the new pokes at the requested landmark.

    Parameters
    ----------
    places : gives the planned places of taxels, (3,) float, metres, by channel; called when first needed
    surface : for the outward direction at landmarks without a normal
    contact_at : as in `misses_of_landmarks`
    part_sd : gives the standard deviation of the part's place in the frame of the pokes, metres; zero if that is given
    """

    def __init__(
        self,
        places: Callable[[], Mapping[int, FloatArray]],
        surface: Surface | None,
        contact_at: Callable[[int], FloatArray | None] = lambda _: None,
        part_sd: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self._places, self._surface, self._contact_at, self._part_sd = places, surface, contact_at, part_sd
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
        named: LandmarkPokes,
        landmarks: Iterable[Landmark],
        missed: Collection[int],
        by_hand: Collection[int],
        noise: NoiseSettings,
    ) -> list[FoundAtLandmark | MissedLandmark]:
        """Find which new pokes were at the requested landmark, and which missed it.

        A poke counts if it began `VISUAL_REACTION_TIME_S` after the request, has a force axis, and no taxel far from the
        landmark answered. A poke that misses by more than `MAX_MISS_OVER_EXPECTED_MISS` times the expected miss is rejected,
        unless at least half of the earlier pokes missed as much. Then the sensor's frame may be wrong, and these pokes show it.
        A touched point may miss by `LANDMARK_MATCH_MAX_DISTANCE_M`, or by three standard deviations of the part's place.
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
        misses = self._misses(named, known, noise)
        near = sum(each is None for each in misses)
        far = len(misses) - near + len(missed)
        found: list[FoundAtLandmark | MissedLandmark] = []
        for outcome in new:
            if not can_be_at_landmark(outcome) or not self._may_be(outcome, landmark):
                continue
            (miss,) = self._misses(landmark_pokes([outcome], [landmark], {outcome.poke: landmark.name}), known, noise)
            found.append(FoundAtLandmark(outcome.poke, landmark.name) if miss is None or near <= far else miss)
            near, far = near + (miss is None), far + (miss is not None)
        if near > far:
            found[:0] = [miss for miss in misses if miss is not None and miss.poke not in by_hand]
        return found

    def _misses(self, pokes: LandmarkPokes, known: Mapping[str, Landmark], noise: NoiseSettings) -> list[MissedLandmark | None]:
        """Describe how each poke missed its landmark; `None` for a hit."""
        found: list[MissedLandmark | None] = []
        limits = MAX_MISS_OVER_EXPECTED_MISS * expected_miss(pokes, noise)
        # A tip measures the touched point far better than a sensor its force axis.
        has_contact = [self._contact_at(number) is not None for number in pokes.number.tolist()]
        touched = max(LANDMARK_MATCH_MAX_DISTANCE_M, 3.0 * self._part_sd())
        limits = np.where(has_contact, np.minimum(limits, touched), limits)
        off = misses_of_landmarks(pokes, self._contact_at)
        of_poke = zip(pokes.number.tolist(), pokes.name.tolist(), off.tolist(), limits.tolist(), strict=True)
        for (number, name, miss, limit), direction in zip(of_poke, pokes.direction, strict=True):
            outward = self._outward_at(known[name])
            behind = outward is not None and float(outward @ direction) > MAX_PUSH_COSINE
            found.append(MissedLandmark(number, name, miss, limit, behind) if behind or not miss <= limit else None)
        return found

    def _outward_at(self, landmark: Landmark) -> FloatArray | None:
        key = landmark.place.tobytes()
        if key not in self._outward:
            (self._outward[key],) = landmark_normals([landmark], self._surface)
        return self._outward[key]

    def _may_be(self, outcome: Outcome, landmark: Landmark) -> bool:
        late = outcome.start_s >= self._asked_s + VISUAL_REACTION_TIME_S
        return late and (isinstance(outcome, Rejection) or may_be_at_landmark(outcome, landmark, self._places()))


def landmark_pokes(outcomes: Iterable[Outcome], landmarks: Iterable[Landmark], named: Mapping[int, str]) -> LandmarkPokes:
    """Select the landmark pokes from `outcomes`, in their order; `named` gives the landmark's name by poke."""
    known = {landmark.name: landmark for landmark in landmarks}
    there = [(outcome, known[named[outcome.poke]]) for outcome in outcomes if named.get(outcome.poke) in known]
    there = [(outcome, landmark) for outcome, landmark in there if can_be_at_landmark(outcome)]
    pokes = Pokes.collect(outcome for outcome, _ in there)
    return LandmarkPokes.at(pokes, [landmark.name for _, landmark in there], [landmark.place for _, landmark in there])


def misses_of_landmarks(pokes: LandmarkPokes, contact_at: Callable[[int], FloatArray | None]) -> FloatArray:
    """Compute the distance (n,) of each poke from its landmark, metres: of the touched point, or without one of the force axis.

    `contact_at` gives the point (3,) that a tool's tip touched at a poke, metres, link frame; `None` if it is not measured.
    """
    misses = pokes.landmark_miss.copy()
    for row, number in enumerate(pokes.number.tolist()):
        contact = contact_at(number)
        if contact is not None:
            misses[row] = np.linalg.norm(contact - pokes.place[row])
    return misses


def can_be_at_landmark(outcome: Outcome) -> bool:
    """Whether a poke has a force axis and was accepted, or rejected only because no taxel answered."""
    if isinstance(outcome, Rejection) and outcome.reason is not Reason.NO_TAXEL:
        return False
    return outcome.force is not None and outcome.moment is not None and outcome.link_from_sensor is not None


def driven_to_leave_out(named: Mapping[int, str], driven: Collection[int], *, finds_part_pose: bool = True) -> frozenset[int]:
    """Select the landmark pokes that a robot drove to, and that the part's pose is not fitted to.

    Their touches repeat the pose that the robot used. They are used only if no other touches give a pose: three other
    landmarks do, and so does a given pose.

    Parameters
    ----------
    named : name of the landmark of each landmark poke that counts
    finds_part_pose : the scene gives no pose of the part
    """
    from skincal.rig.part_pose import MIN_TOUCHES  # other rigs do without

    others = {name for poke, name in named.items() if poke not in driven}
    return frozenset(driven if len(others) >= MIN_TOUCHES or not finds_part_pose else ()) & named.keys()


def nearest_landmarks(
    outcomes: Iterable[Outcome],
    landmarks: Sequence[Landmark],
    surface: Surface | None,
    contact_of: Callable[[Outcome], FloatArray | None] = lambda _: None,
) -> dict[int, NearestLandmark]:
    """Find the landmark nearest to the tip or the force axis of each poke, by poke number.

    Parameters
    ----------
    outcomes : after the frame's correction
    surface : for the outward direction at landmarks without a normal
    contact_of : gives the point (3,) that a tool's tip touched at a poke, metres, link frame; without one the axis counts
    """
    if not landmarks:
        return {}
    places = np.array([landmark.place for landmark in landmarks])
    outward = np.array([np.zeros(3) if normal is None else normal for normal in landmark_normals(landmarks, surface)])
    found: dict[int, NearestLandmark] = {}
    possible = [outcome for outcome in outcomes if can_be_at_landmark(outcome)]
    for outcome, poke in zip(possible, Pokes.collect(possible), strict=True):
        contact = contact_of(outcome)
        misses = poke.miss(places) if contact is None else np.linalg.norm(places - contact, axis=1)
        # Without an outward direction any push may be at it.
        misses[(outward @ poke.direction > MAX_PUSH_COSINE) & outward.any(axis=1)] = np.inf
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


def name_by_shape(
    outcomes: Iterable[Outcome],
    landmarks: Sequence[Landmark],
    surface: Surface | None,
    contact_of: Callable[[Outcome], FloatArray | None],
    tool: ToolSpec | None,
    known: Mapping[int, str],
) -> LandmarkNames | None:
    """Name the landmarks of pokes by the shape of the points that a tool's tip touched (`landmark_match`).

    Parameters
    ----------
    outcomes : in the base of the tool's poses
    surface : for the outward direction at landmarks without a normal
    contact_of : as in `nearest_landmarks`
    known : landmark of pokes that have a name; an empty one for a poke at none

    Returns
    -------
    `None` if fewer than three landmarks fit.
    """
    possible = [each for each in outcomes if can_be_at_landmark(each) and known.get(each.poke) != ""]
    touched = [contact for each in possible if (contact := contact_of(each)) is not None]
    if tool is None or not touched or len(touched) < len(possible):
        return None
    from skincal.rig.landmark_match import match_landmarks  # rarely needed
    from skincal.rig.part_touches import LANDMARK_SD_M

    names, numbers = [landmark.name for landmark in landmarks], [each.poke for each in possible]
    row_of = {name: row for row, name in enumerate(names)}
    normals = [np.zeros(3) if normal is None else normal for normal in landmark_normals(landmarks, surface)]
    found = match_landmarks(
        np.array(touched),
        Pokes.collect(possible).direction,
        np.array([landmark.place for landmark in landmarks]).reshape(-1, 3),
        np.array(normals).reshape(-1, 3),
        math.hypot(LANDMARK_SD_M, tool.tip_sd, BALL_CONTACT_SD_OVER_RADIUS * tool.tip_radius),
        np.array([row_of.get(known.get(poke, ""), -1) for poke in numbers], dtype=np.int64),
    )
    if found is None:
        return None

    def named(rows: IntArray) -> dict[int, str]:
        return {poke: names[row] for poke, row in zip(numbers, rows.tolist(), strict=False) if row >= 0}

    return LandmarkNames(named(found.landmark), None if found.rival is None else named(found.rival), found.miss)


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
