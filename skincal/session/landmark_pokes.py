"""The landmarks of a session, and which pokes were at them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from skincal.contacts.outcome import Outcome, Reason, Rejection
from skincal.geometry import FloatArray, axis_point, move_wrench
from skincal.guide.guidance import was_there
from skincal.model.actions import AddLandmark, AtLandmark, FoundAtLandmark, MissedLandmark
from skincal.model.errors import InputError
from skincal.model.scene import Landmark, NoiseSettings
from skincal.model.tables import LENGTH_MAX
from skincal.rig.correction_fit import LandmarkPoke
from skincal.rig.expected_gain import expected_miss
from skincal.session.undo import Step

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

REACTION_S = 0.25
"""s. A poke that is held so soon after another landmark came up was on its way to the one before: a visual reaction."""
ON_SURFACE = 0.010
"""m: what lies farther from the surface is no point of it, such as one of a jig, and may be poked from any side."""
MISS_FACTOR = 3.0
"""A poke passes the landmark that it was asked for at no more than this many times what is expected of an ordinary rig
(`expected_miss`): 34 mm on the forearm. Nine in ten pass at 19 mm; a poke at another landmark passes at 33 to 81."""

WITHIN = 0.020
"""m. A poke is taken to be at the landmark that its axis passes within this..."""
OTHERS_FARTHER = 2.0
"""...if it passes every other one that it pushes at this many times as far. On 40 rigs with the paper's errors that names 90 %
of 840 pokes at landmarks, and none wrongly: axes pass their landmarks at 10 mm in the median, at 19 in nine of ten. The axes of
29 % of the pokes on the skin pass one in the same way, so that a poke that a taxel answered is never taken."""
FACING = -0.5
"""Cosine of the push with what is outward at a landmark: a push that leans by more than 60 degrees slides off."""

Known = TypeVar("Known")


@dataclass(frozen=True, slots=True)
class NearestLandmark:
    """The landmark that a poke's axis passes nearest, of those that it pushes at."""

    poke: int
    name: str
    miss: float
    """m, how far the axis passes it."""
    other: float
    """m, how far it passes the next one; infinite where there is none."""
    sure: bool
    """The poke was at it: no taxel answered, and no other landmark is nearly as near."""


class SessionLandmarks:
    """Known points of the part, those of the scene first, and the pokes that were there."""

    def __init__(self, landmarks: tuple[Landmark, ...]) -> None:
        self.landmarks = landmarks
        self._named: Mapping[int, str] = {}
        self.missed: Mapping[int, MissedLandmark] = {}
        """Pokes that a landmark was asked for and that passed it too far, by their number."""
        self.by_hand = frozenset[int]()
        """Numbers of the pokes of which the operator said where they were."""

    def named(self, outcome: Callable[[int], Outcome | None]) -> Mapping[int, str]:
        """Return the number of each poke that was at a landmark and has an axis, and the landmark's name.

        `outcome` gives what a poke ended as, by its number.
        """
        known = (found for found in map(outcome, self._named) if found is not None)
        return {poke.poke: poke.name for poke in self.pokes(known)}

    def add(self, action: AddLandmark) -> Step:
        """Take another landmark, return how it is taken back; InputError for a name that is taken, a place that is none."""
        place = np.array([action.x, action.y, action.z])
        if not action.name.strip() or any(action.name == landmark.name for landmark in self.landmarks):
            raise InputError(f"A landmark cannot be named {action.name!r}; expected a name that no other one has.")
        if not np.isfinite(place).all() or np.abs(place).max() > LENGTH_MAX:
            raise InputError(f"The landmark {action.name!r} lies at {place.tolist()}; expected metres up to {LENGTH_MAX:g}.")
        before = self.landmarks

        def take_back() -> None:
            self.landmarks = before

        self.landmarks = (*before, Landmark(action.name, place, None))
        return Step(f"landmark {action.name}", take_back)

    def put(self, action: AtLandmark | FoundAtLandmark, outcome: Outcome | None) -> Step:
        """Say at which landmark a poke was, return how that is taken back; InputError where one is missing, or has no axis."""
        self.check_name(action.name)
        if outcome is None or (action.name and poke_at(outcome, self.landmarks[0]) is None):
            raise InputError(
                f"Poke {action.poke} cannot be at a landmark; expected a poke that was accepted, or that no taxel answered."
            )
        poke, told = action.poke, isinstance(action, AtLandmark)
        name, missed, by_hand = self._named.get(poke), self.missed.get(poke), poke in self.by_hand

        def take_back() -> None:
            # Of this poke alone: others may have been found to be far from their landmarks since.
            found_far = poke in self.missed
            self._know(poke, None if found_far else name, self.missed[poke] if found_far else missed, by_hand=by_hand)

        self._know(poke, action.name, None if told else missed, by_hand=told or by_hand)
        return Step(f"poke {poke} at {action.name or 'no landmark'}", take_back)

    def miss(self, action: MissedLandmark) -> None:
        """Take that a poke was not at the landmark that was asked for."""
        self._know(action.poke, None, action, by_hand=action.poke in self.by_hand)

    def _know(self, poke: int, name: str | None, missed: MissedLandmark | None, *, by_hand: bool) -> None:
        """Take the landmark that a poke was at, if any, how it missed one, and whether the operator said so."""
        self._named = {**_without(self._named, poke), **({poke: name} if name else {})}
        self.missed = {**_without(self.missed, poke), **({} if missed is None else {poke: missed})}
        self.by_hand = self.by_hand | {poke} if by_hand else self.by_hand - {poke}

    def check_name(self, name: str) -> None:
        """Refuse a landmark that is not there with an InputError; an empty name is none."""
        if name and all(name != landmark.name for landmark in self.landmarks):
            # In quotes: there are commas in names.
            known = ", ".join(repr(landmark.name) for landmark in self.landmarks)
            expected = f"expected one of {known}" if known else "the scene has none: add one first"
            raise InputError(f"There is no landmark {name!r}; {expected}.")

    def pokes(self, outcomes: Iterable[Outcome]) -> tuple[LandmarkPoke, ...]:
        """Return those of `outcomes` that were at a landmark."""
        return tuple(landmark_pokes(outcomes, self.landmarks, self._named))


def _without(known: Mapping[int, Known], poke: int) -> dict[int, Known]:
    return {each: value for each, value in known.items() if each != poke}


class LandmarkFinder:
    """Finds which new pokes were at the landmark that the operator was asked for.

    Parameters
    ----------
    places : gives (3,) float, metres, of taxels by their channel, where the layout puts them; called when it is first needed
    surface : where it says what is outward at landmarks that do not say so themselves
    """

    def __init__(self, places: Callable[[], Mapping[int, FloatArray]], surface: Surface | None) -> None:
        self._places, self._surface = places, surface
        self._outward: dict[bytes, FloatArray | None] = {}
        self.asked = ""
        """Name of the landmark that is asked for; empty where none is."""
        self._asked_s = math.inf

    def ask(self, name: str, host_s: float) -> None:
        """Take what the operator is asked for since `host_s`, seconds of the host's monotonic clock."""
        self.asked, self._asked_s = name, host_s

    def find(
        self, tries: LandmarkTries, landmarks: Iterable[Landmark], noise: NoiseSettings
    ) -> list[FoundAtLandmark | MissedLandmark]:
        """Return which of the new pokes were at the landmark that is asked for, and which passed it too far.

        They began `REACTION_S` after it was asked for at least, have an axis, and no taxel far from it answered. One that
        passes it at more than `MISS_FACTOR` times what is expected is not taken, unless as many of those before passed as
        far: then the sensor's frame may be wrong, and these pokes show it. Once most pass as expected, the others are taken
        back, but for those that the operator named.
        """
        landmarks = tuple(landmarks)
        landmark = next((landmark for landmark in landmarks if landmark.name == self.asked), None)
        if landmark is None:
            return []
        known = {each.name: each for each in landmarks}
        passes = {poke.poke: self._passing(poke, known[poke.name], noise) for poke in tries.named}
        near = sum(each.right for each in passes.values())
        far = len(passes) - near + len(tries.missed)
        found: list[FoundAtLandmark | MissedLandmark] = []
        for outcome in tries.new:
            poke = poke_at(outcome, landmark)
            if poke is None or not self._may_be(outcome, landmark):
                continue
            passing = self._passing(poke, landmark, noise)
            if passing.right or near <= far:
                found.append(FoundAtLandmark(outcome.poke, landmark.name))
            else:
                found.append(passing.missed)
            near, far = near + passing.right, far + (not passing.right)
        if near > far:
            wrong = (each for poke, each in passes.items() if not each.right and poke not in tries.by_hand)
            found[:0] = [each.missed for each in wrong]
        return found

    def _passing(self, poke: LandmarkPoke, landmark: Landmark, noise: NoiseSettings) -> Passing:
        """Compare a poke with what is expected of one at a landmark."""
        key = landmark.place.tobytes()
        if key not in self._outward:
            (self._outward[key],) = landmark_normals([landmark], self._surface)
        outward = self._outward[key]
        force, _ = move_wrench(poke.link_from_sensor, poke.force, poke.moment)
        behind = outward is not None and float(outward @ force) > FACING * float(np.linalg.norm(force))
        return Passing(poke.poke, poke.name, poke.miss, MISS_FACTOR * expected_miss(poke, noise), behind)

    def _may_be(self, outcome: Outcome, landmark: Landmark) -> bool:
        """Return whether a poke began late enough, and no taxel far from the landmark answered."""
        late = outcome.start_s >= self._asked_s + REACTION_S
        return late and (isinstance(outcome, Rejection) or was_there(outcome, landmark, self._places()))


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkTries:
    """Pokes that landmarks were asked for."""

    new: Sequence[Outcome]
    """In the right frame."""
    named: Sequence[LandmarkPoke]
    """Those before that are taken to have been there."""
    missed: Mapping[int, MissedLandmark]
    """Those before that passed their landmark too far, by their number."""
    by_hand: Collection[int]
    """Numbers of pokes of which the operator said where they were."""


@dataclass(frozen=True, slots=True)
class Passing:
    """How far a poke's axis passes a landmark."""

    poke: int
    name: str
    miss: float
    """m."""
    limit: float
    """m: `MISS_FACTOR` times what is expected."""
    behind: bool
    """It pushes from another side than where the landmark is."""

    @property
    def right(self) -> bool:
        """Whether it passes no farther than it may, from the right side."""
        return self.miss <= self.limit and not self.behind

    @property
    def missed(self) -> MissedLandmark:
        """What is recorded of it where it passes farther."""
        return MissedLandmark(self.poke, self.name, self.miss, self.limit, self.behind)


def landmark_pokes(outcomes: Iterable[Outcome], landmarks: Iterable[Landmark], named: Mapping[int, str]) -> list[LandmarkPoke]:
    """Return those of `outcomes` that were at a landmark, in their order; one of `named`, by their number, may be gone."""
    known = {landmark.name: landmark for landmark in landmarks}
    there = ((outcome, known.get(named.get(outcome.poke, ""))) for outcome in outcomes)
    found = (poke_at(outcome, landmark) for outcome, landmark in there if landmark is not None)
    return [poke for poke in found if poke is not None]


def can_be_at_landmark(outcome: Outcome) -> bool:
    """Return whether a poke has an axis, and was rejected for no more than that no taxel answered."""
    nowhere = Landmark("", np.zeros(3), None)
    return poke_at(outcome, nowhere) is not None


def poke_at(outcome: Outcome, landmark: Landmark) -> LandmarkPoke | None:
    """Return a poke as one at a landmark; None where it was rejected for more than that no taxel answered."""
    if isinstance(outcome, Rejection) and outcome.reason is not Reason.NO_TAXEL:
        return None
    force, moment, pose = outcome.force, outcome.moment, outcome.link_from_sensor
    if force is None or moment is None or pose is None:
        return None
    return LandmarkPoke(outcome.poke, landmark.name, landmark.place, force, moment, pose, outcome.pose)


def nearest_landmarks(
    outcomes: Iterable[Outcome], landmarks: Sequence[Landmark], surface: Surface | None
) -> dict[int, NearestLandmark]:
    """Return for each poke that can be at a landmark, by its number, which its axis passes nearest; see `WITHIN`.

    Parameters
    ----------
    outcomes : in the right frame
    surface : where it says what is outward at landmarks that do not say so themselves
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
        # Where nothing says what is outward, any push may be at it.
        misses[(outward @ push > FACING) & outward.any(axis=1)] = np.inf
        nearest = int(misses.argmin())
        miss, other = float(misses[nearest]), float(np.delete(misses, nearest).min(initial=np.inf))
        if np.isfinite(miss):
            sure = isinstance(outcome, Rejection) and miss <= WITHIN and other >= OTHERS_FARTHER * miss
            found[outcome.poke] = NearestLandmark(outcome.poke, landmarks[nearest].name, miss, other, sure)
    return found


def landmark_normals(landmarks: Sequence[Landmark], surface: Surface | None) -> list[FloatArray | None]:
    """Return which way is outward at each landmark: its own normal, else that of the nearest triangle, else None.

    A landmark that was added by hand has none of its own; without one a sensor that reports the reaction cannot be recognized.
    """
    normals = [landmark.normal for landmark in landmarks]
    missing = [i for i, normal in enumerate(normals) if normal is None]
    if surface is None or not missing:
        return normals
    places = np.array([landmarks[i].place for i in missing])
    from skincal.mesh.search import nearest_points  # a scene without a surface does without

    nearest, triangles = nearest_points(surface, places)
    for i, off, triangle in zip(missing, np.linalg.norm(nearest - places, axis=1), triangles, strict=True):
        if off <= ON_SURFACE:
            normals[i] = surface.normals[triangle]
    return normals
