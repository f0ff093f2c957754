"""What the guide says at one moment: numbers and reasons, no sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.guide.landmark_targets import LandmarkTarget
from skincal.guide.progress import Need, Why
from skincal.rig.expected_gain import Gain
from skincal.taxels.result import Method


class GuidePhase(Enum):
    """What the guide is after; the value is its name."""

    LANDMARKS = "landmarks"
    COVER = "looking for taxels"
    SWEEP = "sweep"
    OWN = "own pokes"
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

    @property
    def done(self) -> int:
        """How many taxels are done."""
        return sum(not each for each in self.needs)

    def before_skin(self, asked: LandmarkTarget, normal: FloatArray, gain: Gain | None) -> Guidance:
        """Return the guidance that asks for a landmark first.

        Parameters
        ----------
        normal : (3,) float, unit, outward there
        gain : of all landmarks that are asked for in this arm pose
        """
        place = asked.landmark.place
        target = Target(None, place, normal, -normal, 0.0, float("inf"), float("inf"), asked.landmark.name)
        left = self.pokes_left + asked.left
        pace = None if self.seconds_left is None else self.seconds_left / max(self.pokes_left, 1) * left
        return replace(
            self, phase=GuidePhase.LANDMARKS, target=target, landmark=asked, gain=gain, pokes_left=left, seconds_left=pace
        )
