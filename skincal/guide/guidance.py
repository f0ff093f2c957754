"""Guidance at one moment: the target, the needs of each taxel, and the landmarks of the arm pose. Numbers, no sentences.

A few landmarks are requested in each arm pose, before pokes on the skin, which are worth more on a corrected rig. Three in the
first pose show whether the sensor's frame is right. A correction of the rig is found from a few in each pose. Any may be
skipped.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from skincal.chi_square import CHI2_2DOF_MEDIAN
from skincal.contacts.outcome import Contact, Outcome
from skincal.geometry import FloatArray, IntArray
from skincal.guide.progress import Need, Why
from skincal.model.scene import Landmark, NoiseSettings
from skincal.pokes import LandmarkPokes
from skincal.rig.closing import ClosingPlace
from skincal.rig.correction import RigPrior
from skincal.rig.correction_fit import MIN_LANDMARK_POKES, MIN_LANDMARKS
from skincal.rig.expected_gain import Gain
from skincal.taxels.result import Method

LANDMARK_POKES_IN_LATER_POSE = 3
"""Landmark pokes in each arm pose after the first: with three in each of seven the modules' error on the paper's rig falls to a
tenth (`skincal study paper`)."""
MIN_LANDMARK_POKES_FOR_FRAME = 3
"""Landmark pokes that show whether the sensor's frame is right, and how far the rig is off."""
LANDMARK_POKE_MAX_OFFSET_M = 0.015
"""A poke whose answers have their centre farther from the landmark was on the skin: a taxel is felt from 8 mm away, and its
position is known to 6 mm (sd) by the plan."""


@dataclass(frozen=True, slots=True)
class LandmarkTarget:
    """Landmark to poke next, and the count of landmark pokes in this arm pose."""

    landmark: Landmark
    done: int
    """So far."""
    wanted: int
    """In this pose."""

    @property
    def pokes_left(self) -> int:
        return self.wanted - self.done


def landmark_targets(
    landmarks: Sequence[Landmark], poked: Iterable[tuple[str, str]], pose: str, skips: Iterable[tuple[str, str]] = ()
) -> list[LandmarkTarget]:
    """List the landmarks to poke in an arm pose, in order.

    The first pose gets as many pokes as a correction needs, since it may be the only one. Too few landmarks correct nothing,
    but three pokes show whether the frame is right.

    Parameters
    ----------
    poked : arm pose and landmark of each landmark poke that counts
    skips : arm pose and landmark that are skipped; an empty landmark skips all in that pose
    """
    every, skipped = list(poked), {name for there, name in skips if there == pose}
    known = {landmark.name: landmark for landmark in landmarks}
    here = Counter(name for there, name in every if there == pose)
    total = Counter(name for _, name in every)
    elsewhere = len(every) - here.total()
    wanted = MIN_LANDMARK_POKES_FOR_FRAME - elsewhere
    if len(landmarks) >= MIN_LANDMARKS:
        wanted = max(LANDMARK_POKES_IN_LATER_POSE, MIN_LANDMARK_POKES - elsewhere)
    targets = list[LandmarkTarget]()
    open_ = [] if "" in skipped else [landmark for landmark in landmarks if landmark.name not in skipped]
    while open_ and here.total() < wanted:
        done = [known[name].place for name in here if name in known]
        chosen = min(open_, key=lambda mark: (here[mark.name], total[mark.name], -_distance_to_nearest(mark.place, done)))
        targets.append(LandmarkTarget(chosen, here.total(), wanted))
        here[chosen.name] += 1
        total[chosen.name] += 1
    return targets


def rig_error_sd(pokes: LandmarkPokes, noise: NoiseSettings) -> float:
    """Estimate the position error caused by the rig, sd in each direction, metres; 0 from too few landmark pokes.

    It is the median landmark miss, which one wrong poke does not change, less the noise of the sensor and of the hand
    (`RigPrior.landmark`). The pokes are corrected by the corrections in use.
    """
    if len(pokes) < MIN_LANDMARK_POKES_FOR_FRAME:
        return 0.0
    off = pokes.place - pokes.sensor
    lever, force = np.sqrt(np.vecdot(off, off)), pokes.force_size
    own = (noise.moment / force) ** 2 + (noise.force * lever / force) ** 2
    square = float(np.median(pokes.landmark_miss**2)) / CHI2_2DOF_MEDIAN
    return float(np.sqrt(max(0.0, square - float(np.median(own)) - RigPrior().landmark ** 2)))


def _distance_to_nearest(place: FloatArray, others: Sequence[FloatArray]) -> float:
    """Compute the distance from the nearest of `others`, metres; from the origin if there are none."""
    return min((float(np.linalg.norm(place - other)) for other in others), default=float(np.linalg.norm(place)))


def may_be_at_landmark(outcome: Outcome, landmark: Landmark, places: Mapping[int, FloatArray]) -> bool:
    """Tell whether a poke may have been at a landmark: not if taxels farther away answered.

    `places` are the known positions of taxels by channel, (3,) float, metres.
    """
    if not isinstance(outcome, Contact):
        return True
    answers = zip(outcome.channels.tolist(), outcome.responses.tolist(), strict=True)
    known = [(places[channel], response) for channel, response in answers if channel in places]
    if not known:
        return True
    centre = np.average([place for place, _ in known], axis=0, weights=[response for _, response in known])
    return float(np.linalg.norm(centre - landmark.place)) <= LANDMARK_POKE_MAX_OFFSET_M


class GuidePhase(Enum):
    """Phase of the guide; the value is its name."""

    LANDMARKS = "landmarks"
    COVER = "looking for taxels"
    SWEEP = "sweep"
    OWN = "own pokes"
    TEST = "test pokes"
    CLOSING = "closing check"
    ENOUGH = "enough"


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """Poke to make next, link frame."""

    channel: int | None
    """`None` for a landmark, or a place where a taxel may be."""
    place: FloatArray
    """(3,) float, metres."""
    normal: FloatArray
    """(3,) float, unit, outward."""
    push: FloatArray
    """(3,) float, unit: direction of the push."""
    tilt: float
    """rad, of the push from the normal."""
    rms_now: float
    """m, predicted rms error of the taxel; infinite without a taxel."""
    rms_after: float
    """m, the same after the poke."""
    landmark: str = ""
    """Name of the landmark; empty for a poke on the skin."""
    turn_now: float = np.nan
    """rad, predicted sd of the taxel's turn in the plane, infinite while unknown; NaN if it needs none, and for one axis."""
    turn_after: float = np.nan
    """rad, the same after the poke; NaN before any turn is known."""


@dataclass(frozen=True, slots=True)
class ClosingStep:
    """Progress of the closing check."""

    place: ClosingPlace
    """To poke next."""
    done: int
    """Places poked again, of `places`."""
    places: int
    number: int
    """Of this check, from 1."""
    suspect_poke: int | None = None
    """Poke that alone suggests a movement; its place is poked again. `None` if there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class Guidance:
    """State of the guide at one moment, for n taxels."""

    method: Method
    phase: GuidePhase
    target: Target | None
    channels: IntArray
    """(n,) ascending."""
    places: FloatArray
    """(n, 3) float, metres, believed; NaN if unknown."""
    rms: FloatArray
    """(n,) float, metres: predicted error; infinite without an estimate."""
    diversity: FloatArray
    """(n,) float, rad."""
    own: IntArray
    """(n,) own pokes."""
    needs: tuple[tuple[Need, ...], ...]
    """Needs of each taxel; none if it is finished."""
    given_up: Mapping[int, Why]
    """Channels with needs that are no longer targets, with the reason."""
    usable_tilt: float
    """rad: largest tilt of a target, as learnt so far."""
    pokes_left: int
    """Predicted number of pokes until it is enough."""
    seconds_left: float | None
    """s, the same at the pace of the last pokes; `None` while that is unknown."""
    landmark: LandmarkTarget | None = None
    """Landmark to poke before the skin."""
    gain: Gain | None = None
    """Gain by the landmarks of this arm pose; `None` if it is unknown."""
    closing: ClosingStep | None = None
    """`None` outside the closing check."""
    tests_missing: int = 0
    """Test pokes that the verdict still needs; known once no taxel needs pokes. More are requested in the phase `TEST`."""

    @property
    def enough(self) -> bool:
        """Whether no more pokes are requested for the taxels and their test; the closing check may still go on."""
        return self.phase in (GuidePhase.ENOUGH, GuidePhase.CLOSING)

    @property
    def is_finished(self) -> bool:
        """Whether it is enough, a taxel is finished, and enough pokes test the result."""
        return self.enough and self.finished > 0 and not self.tests_missing

    @property
    def finished(self) -> int:
        """Number of finished taxels."""
        return self.needs.count(())

    def before_skin(self, asked: LandmarkTarget, normal: FloatArray, gain: Gain | None) -> Guidance:
        """Ask for a landmark first.

        Parameters
        ----------
        normal : (3,) float, unit, outward, of the part at the landmark
        gain : of all requested landmarks in this arm pose
        """
        place = asked.landmark.place
        target = Target(None, place, normal, -normal, 0.0, float("inf"), float("inf"), asked.landmark.name)
        left = self.pokes_left + asked.pokes_left
        pace = None if self.seconds_left is None else self.seconds_left / max(self.pokes_left, 1) * left
        return replace(
            self, phase=GuidePhase.LANDMARKS, target=target, landmark=asked, gain=gain, pokes_left=left, seconds_left=pace
        )
