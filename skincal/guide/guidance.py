"""What the guide says at one moment, which landmark is next, and how the poke in progress differs from the target.

Numbers and reasons, no sentences.

*Landmarks.* A few in each arm pose, at the start and after each change of pose. Three in the first pose show whether the
sensor's frame is right, and a correction of the rig is found from a few in every pose. They come before pokes on the skin,
which are worth more on a corrected rig, and any of them may be skipped.

*The poke in progress* is known by the force/torque sensor alone: while a tool presses, its wrench is an axis. Where that meets
the skin is the tip, the way it runs is how the tool is held.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from skincal.contacts.outcome import Contact, Outcome, PressPhase, Progress
from skincal.geometry import FloatArray, IntArray, axis_point
from skincal.guide.progress import GuideSettings, Need, Why
from skincal.model.scene import Landmark, NoiseSettings
from skincal.rig.closing import ClosingPlace
from skincal.rig.correction import RigPrior
from skincal.rig.correction_fit import MIN_LANDMARK_POKES, MIN_LANDMARKS, LandmarkPoke
from skincal.rig.expected_gain import Gain
from skincal.taxels.result import Method

LANDMARK_POKES_PER_POSE = 3
"""Landmark pokes in each arm pose but the first: with three in each of seven the modules' error on the paper's rig falls to a
tenth (`skincal study paper`)."""
CHI2_2DOF_MEDIAN = 1.3863
"""Median of chi-square with two degrees of freedom."""
LANDMARK_POKE_MAX_OFFSET_M = 0.015
"""m. A poke whose answers have their middle farther from the landmark was on the skin: a taxel is felt from 8 mm away, and its
place is known to 6 mm (sd) by the plan."""


@dataclass(frozen=True, slots=True)
class LandmarkTarget:
    """The landmark that is asked for, and how many there are in this arm pose."""

    landmark: Landmark
    done: int
    """Landmark pokes in this pose so far."""
    wanted: int
    """Landmark pokes that this pose needs."""

    @property
    def left(self) -> int:
        """How many more."""
        return self.wanted - self.done


def landmark_targets(
    landmarks: Sequence[Landmark], poked: Iterable[tuple[str, str]], pose: str, skips: Iterable[tuple[str, str]] = ()
) -> list[LandmarkTarget]:
    """List all landmarks that are asked for in an arm pose, in order.

    The first pose gets as many pokes as a correction takes: perhaps there is no other. Too few landmarks correct nothing, but
    three pokes show whether the frame is right.

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
    wanted = LANDMARK_POKES_PER_POSE - elsewhere
    if len(landmarks) >= MIN_LANDMARKS:
        wanted = max(LANDMARK_POKES_PER_POSE, MIN_LANDMARK_POKES - elsewhere)
    targets = list[LandmarkTarget]()
    open_ = [] if "" in skipped else [landmark for landmark in landmarks if landmark.name not in skipped]
    while open_ and here.total() < wanted:
        done = [known[name].place for name in here if name in known]
        chosen = min(open_, key=lambda mark: (here[mark.name], total[mark.name], -_apart(mark.place, done)))
        targets.append(LandmarkTarget(chosen, here.total(), wanted))
        here[chosen.name] += 1
        total[chosen.name] += 1
    return targets


def rig_error_sd(pokes: Sequence[LandmarkPoke], noise: NoiseSettings) -> float:
    """Return by how much a rig's errors move what it measures, sd in each direction, metres; 0 where there are too few pokes.

    The median of how far landmark pokes pass their landmark, which a single poke at another point does not change, less the
    parts of the sensor's noise and of the hand (`RigPrior.landmark`). The pokes are as the corrections in use have them.
    """
    if len(pokes) < LANDMARK_POKES_PER_POSE:
        return 0.0
    levers = [float(np.linalg.norm(poke.place - poke.link_from_sensor[:3, 3])) for poke in pokes]
    forces = [float(np.linalg.norm(poke.force)) for poke in pokes]
    own = [
        (noise.moment / force) ** 2 + (noise.force * lever / force) ** 2 for force, lever in zip(forces, levers, strict=True)
    ]
    square = float(np.median([poke.miss**2 for poke in pokes])) / CHI2_2DOF_MEDIAN
    return float(np.sqrt(max(0.0, square - float(np.median(own)) - RigPrior().landmark ** 2)))


def _apart(place: FloatArray, others: Sequence[FloatArray]) -> float:
    """Return how far a place lies from the nearest of others, metres; how far from the origin where there is none."""
    return min((float(np.linalg.norm(place - other)) for other in others), default=float(np.linalg.norm(place)))


def may_be_at_landmark(outcome: Outcome, landmark: Landmark, places: Mapping[int, FloatArray]) -> bool:
    """Return whether a poke that a landmark was asked for may have been there: not where taxels farther away answered.

    `places` holds (3,) float, metres, of taxels by their channel, as far as they are known.
    """
    if not isinstance(outcome, Contact):
        return True
    answers = zip(outcome.channels.tolist(), outcome.responses.tolist(), strict=True)
    known = [(places[channel], response) for channel, response in answers if channel in places]
    if not known:
        return True
    middle = np.average([place for place, _ in known], axis=0, weights=[response for _, response in known])
    return float(np.linalg.norm(middle - landmark.place)) <= LANDMARK_POKE_MAX_OFFSET_M


class GuidePhase(Enum):
    """What the guide is after; the value is its name."""

    LANDMARKS = "landmarks"
    COVER = "looking for taxels"
    SWEEP = "sweep"
    OWN = "own pokes"
    CLOSING = "closing check"
    ENOUGH = "enough"


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """The poke that is asked for, link frame."""

    channel: int | None
    """None where it is a place on the part: at which a taxel may be, or a landmark."""
    place: FloatArray
    """(3,) float, metres."""
    normal: FloatArray
    """(3,) float, unit, outward."""
    push: FloatArray
    """(3,) float, unit: which way the tool pushes."""
    tilt: float
    """rad, of the push from the normal."""
    before: float
    """m, the taxel's predicted rms error now; infinite without a taxel."""
    after: float
    """m, and after the poke."""
    landmark: str = ""
    """Name of the landmark that is asked for; empty for a poke on the skin."""


@dataclass(frozen=True, slots=True)
class ClosingStep:
    """How far the closing check is."""

    place: ClosingPlace
    """That is asked for."""
    done: int
    """Places that were poked once more..."""
    places: int
    """...of so many."""
    number: int
    """Of this check, from 1."""
    lone: int | None = None
    """Number of the poke that alone says that something moved, where the place is asked for because of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Guidance:
    """What the guide says at one moment, of n taxels."""

    method: Method
    """The solver it follows."""
    phase: GuidePhase
    target: Target | None
    channels: IntArray
    """(n,) ascending."""
    places: FloatArray
    """(n, 3) float, metres, believed; NaN where nothing is known."""
    rms: FloatArray
    """(n,) float, metres: predicted error; infinite while there is none."""
    diversity: FloatArray
    """(n,) float, rad."""
    own: IntArray
    """(n,) pokes of their own."""
    needs: tuple[tuple[Need, ...], ...]
    """For each taxel what is not met yet; none where it is done."""
    given_up: Mapping[int, Why]
    """Channels that need something and are asked for no more, with the reason."""
    usable_tilt: float
    """rad: the most that a push is asked to lean, as learnt so far."""
    pokes_left: int
    """How many pokes it takes until it is enough, about."""
    seconds_left: float | None
    """s, and how long, at the pace of the last pokes; None while that is unknown."""
    landmark: LandmarkTarget | None = None
    """The landmark that is asked for before the skin; None where none is."""
    gain: Gain | None = None
    """What the landmarks of this arm pose are worth; None where none is asked for, or where it is unknown."""

    closing: ClosingStep | None = None
    """None while no place of the closing check is asked for."""

    @property
    def enough(self) -> bool:
        """Whether no taxel needs anything more, though the closing check may go on."""
        return self.phase in (GuidePhase.ENOUGH, GuidePhase.CLOSING)

    @property
    def done(self) -> int:
        """How many taxels are done."""
        return sum(not each for each in self.needs)

    def before_skin(self, asked: LandmarkTarget, normal: FloatArray, gain: Gain | None) -> Guidance:
        """Return the guidance that asks for a landmark first, where the part's outward normal is `normal` (3,), unit.

        `gain` is that of all landmarks that are asked for in this arm pose.
        """
        place = asked.landmark.place
        target = Target(None, place, normal, -normal, 0.0, float("inf"), float("inf"), asked.landmark.name)
        left = self.pokes_left + asked.left
        pace = None if self.seconds_left is None else self.seconds_left / max(self.pokes_left, 1) * left
        return replace(
            self, phase=GuidePhase.LANDMARKS, target=target, landmark=asked, gain=gain, pokes_left=left, seconds_left=pace
        )


PRESSING = (PressPhase.PRESSING, PressPhase.STILL, PressPhase.HELD)
"""Phases in which a tool presses."""
FELT = 2.0
"""N. Below it a reading gives the tilt to no better than 3 degrees, the tip to no better than a taxel (0.1 N, 10 N mm)."""
KEPT = 0.6
"""Share of what was felt before that stays with the next reading, 30 a second: it halves the noise and lags by 50 ms."""
FLAT = float(np.cos(np.radians(75.0)))
"""Cosine. A push this far off the normal is no push of a tool on this skin, and its axis meets the skin far away."""
NO_WAY = 1e-3
"""Sine. Two pushes that differ by less along the skin give no direction between them."""


@dataclass(frozen=True, slots=True, eq=False)
class PokeError:
    """A poke in progress beside its target, link frame."""

    contact: FloatArray
    """(3,) float, metres: where the axis meets the skin, taken as flat around the target."""
    push: FloatArray
    """(3,) float, unit: which way the tool pushes."""
    tilt: float
    """rad, of the push from the normal."""
    off: FloatArray
    """(3,) float, metres, along the skin: from the contact to the target."""
    error: float
    """rad, between the push and the wanted one."""
    lean: FloatArray
    """(3,) float, unit, along the skin: where the tool's upper end has to go; zeros where no way can be given."""
    landed: int | None
    """Channel that answers most; None while none does."""

    @property
    def away(self) -> float:
        """How far the tip is from the target, metres."""
        return float(np.sqrt(self.off @ self.off))


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """The wrench of a poke in progress, smoothed over the last readings, link frame."""

    force: FloatArray
    """(3,) float, N."""
    moment: FloatArray
    """(3,) float, N m, about the link's origin; what lies along the force is left out."""


def smooth_wrench(before: Smoothed | None, progress: Progress) -> Smoothed | None:
    """Add a reading of the poke in progress; None while nothing presses, or where a reading is no number.

    Force and moment are smoothed, not the axis: an axis of a weak force counts little.
    """
    force, moment = progress.force, np.cross(progress.axis_point, progress.force)
    if progress.phase not in PRESSING or not np.isfinite(moment).all():
        return None
    if before is None:
        return Smoothed(force, moment)
    return Smoothed(KEPT * before.force + (1.0 - KEPT) * force, KEPT * before.moment + (1.0 - KEPT) * moment)


def compare_to_target(felt: Smoothed, progress: Progress, target: Target, skin: FloatArray) -> PokeError | None:
    """Compare the poke in progress with its target; None while nothing presses hard enough.

    `skin` is the target on the skin, (3,) metres, which a believed place may lie above or below.
    """
    size = float(np.sqrt(felt.force @ felt.force))
    if size < FELT:
        return None
    push, normal = felt.force / size, target.normal
    cosine = -float(push @ normal)
    if not cosine > FLAT:
        return None
    point = axis_point(felt.force, felt.moment)
    # Along the axis to the plane through the target on the skin.
    contact = point + float((point - skin) @ normal) / cosine * push
    return PokeError(
        contact=contact,
        push=push,
        tilt=float(np.arccos(min(1.0, cosine))),
        off=_along(skin - contact, normal),
        error=_angle(push, target.push),
        lean=_way(_along(push - target.push, normal)),
        landed=int(progress.channels[progress.responses.argmax()]) if len(progress.channels) else None,
    )


def max_angle_error(guidance: Guidance) -> float:
    """Return how far a push may be off the wanted one, rad: the surface method takes any that does not slide."""
    return GuideSettings().tolerance if guidance.method is Method.FREE else guidance.usable_tilt


def _along(vector: FloatArray, normal: FloatArray) -> FloatArray:
    return vector - float(vector @ normal) * normal


def _way(along: FloatArray) -> FloatArray:
    size = float(np.sqrt(along @ along))
    return along / size if size > NO_WAY else np.zeros(3)


def _angle(first: FloatArray, second: FloatArray) -> float:
    """Return the angle between two unit vectors, rad, to all digits also where it is small."""
    across = np.cross(first, second)
    return float(np.arctan2(np.sqrt(across @ across), first @ second))
