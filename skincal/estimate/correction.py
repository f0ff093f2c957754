"""What a wrench and an arm pose really are, of those that a rig tells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from skincal.contacts.outcome import Contact, Rejection
from skincal.readings import FloatArray

if TYPE_CHECKING:
    from skincal.estimate.frame_doctor import FrameCorrection

FRAME, RIG = "frame", "rig"
"""What a correction is of: the sensor's frame, or the rig's small errors."""
Poke = TypeVar("Poke", bound=Contact | Rejection)


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """A linear map of the wrench and a small motion of the arm's poses."""

    matrix: FloatArray
    """(6, 6) float, SI: the true wrench, force above moment, is this times the told one."""
    everywhere: FloatArray = field(default_factory=lambda: np.eye(4))
    """(4, 4) float, metres: link_from_sensor is the one told times this, in every arm pose."""
    motions: Mapping[str, FloatArray] = field(default_factory=dict[str, FloatArray])
    """For some arm poses (4, 4) float, metres: and times this."""

    def pose(self, link_from_sensor: FloatArray, name: str) -> FloatArray:
        """Return link_from_sensor, (4, 4), of the arm pose of that name; of one that is not known, by `everywhere` alone."""
        there = link_from_sensor @ self.everywhere
        return there @ self.motions[name] if name in self.motions else there

    def wrench(self, force: FloatArray, moment: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the true force (3,), N, and moment (3,), N m, of those told, in the sensor's frame."""
        true = self.matrix @ np.concatenate([force, moment])
        return true[:3], true[3:]

    def after(self, first: Correction) -> Correction:
        """Return the correction that is `first`, which moves all arm poses alike, and then this one."""
        return Correction(self.matrix @ first.matrix, first.everywhere @ self.everywhere, self.motions)

    def corrected(self, poke: Poke) -> Poke:
        """Return a poke as a right rig would have told it; one without a force stays as it is."""
        if poke.force is None or poke.moment is None or poke.link_from_sensor is None:
            return poke
        force, moment = self.wrench(poke.force, poke.moment)
        return replace(poke, force=force, moment=moment, link_from_sensor=self.pose(poke.link_from_sensor, poke.pose))


@dataclass(frozen=True, slots=True, eq=False)
class UsedCorrection:
    """A correction that the operator uses, and what spoke for it."""

    of: str
    """`FRAME` or `RIG`."""
    correction: Correction
    before: float
    """m: at what distance pokes pass their landmarks as the rig tells, root mean square."""
    after: float
    """m: the same under the correction; for the rig's errors of pokes that were held out."""
    pokes: int
    """How many landmark pokes it was found from."""

    @property
    def words(self) -> str:
        """What was corrected, with the miss before and after."""
        after, before = f"{self.after * 1e3:.1f} mm", f"{self.before * 1e3:.1f} mm"
        who = "they" if self.of == FRAME else "held-out ones"
        what = "the sensor's frame" if self.of == FRAME else "the rig"
        misses = f"{who} pass their landmarks at {after} with it, at {before} without"
        return f"{what} is corrected from {self.pokes} landmark pokes: {misses}"


def frame_correction(found: FrameCorrection) -> Correction:
    """Return what the frame doctor offers as a correction of every poke."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3], matrix[3:, 3:] = found.force_scale * found.axes, found.moment_scale * found.axes
    return Correction(matrix, found.motion)
