"""Live comparison of the poke in progress with its target.

While a tool presses, the force/torque sensor alone gives its force axis. The axis meets the skin at the tip, and its direction
is the way the tool is held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import PRESSING_PHASES, Progress
from skincal.geometry import FloatArray, axis_point
from skincal.guide.guidance import Guidance, Target
from skincal.guide.progress import GuideSettings
from skincal.taxels.result import Method

MIN_FORCE_FOR_TILT_N = 2.0
"""Below it a reading gives the tilt to no better than 3 degrees, the tip to no better than a taxel (0.1 N, 10 N mm)."""
LOW_PASS_OLD_VALUE_WEIGHT = 0.6
"""Weight of the former value at each reading, 30 a second: it halves the noise and lags by 50 ms."""
MIN_PUSH_COSINE = float(np.cos(np.radians(75.0)))
"""A push farther off the normal is no push of a tool on this skin, and its axis meets the skin far away."""
MIN_SIN_BETWEEN_PUSHES = 1e-3
"""Sine. Two pushes that differ by less along the skin have no direction between them."""


@dataclass(frozen=True, slots=True, eq=False)
class PokeError:
    """Difference between a poke in progress and its target, link frame."""

    contact: FloatArray
    """(3,) float, metres: intersection of the axis and the skin, taken as flat around the target."""
    push: FloatArray
    """(3,) float, unit: direction of the push."""
    tilt: float
    """rad, of the push from the normal."""
    off: FloatArray
    """(3,) float, metres, along the skin: from the contact to the target."""
    error: float
    """rad, between the push and the wanted one."""
    lean: FloatArray
    """(3,) float, unit, along the skin: where the tool's upper end has to go; zeros if the pushes agree."""
    landed: int | None
    """Channel that answers most; `None` while none does."""

    @property
    def away(self) -> float:
        """Distance of the tip from the target, metres."""
        return float(np.sqrt(self.off @ self.off))


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedWrench:
    """Low-pass filtered wrench of a poke in progress, link frame."""

    force: FloatArray
    """(3,) float, N."""
    moment: FloatArray
    """(3,) float, N m, about the link's origin, without the part along the force."""


def smooth_wrench(before: SmoothedWrench | None, progress: Progress) -> SmoothedWrench | None:
    """Add a reading of the poke in progress; `None` while nothing presses, or for a reading that is not finite.

    Force and moment are filtered, not the axis: the axis of a weak force counts little.
    """
    force, moment = progress.force, np.cross(progress.axis_point, progress.force)
    if progress.phase not in PRESSING_PHASES or not np.isfinite(moment).all():
        return None
    if before is None:
        return SmoothedWrench(force, moment)
    share = LOW_PASS_OLD_VALUE_WEIGHT
    return SmoothedWrench(share * before.force + (1.0 - share) * force, share * before.moment + (1.0 - share) * moment)


def compare_to_target(felt: SmoothedWrench, progress: Progress, target: Target, skin: FloatArray) -> PokeError | None:
    """Compare the poke in progress with its target; `None` while nothing presses hard enough.

    `skin` is the target's projection on the skin, (3,) metres: a believed position may lie above or below.
    """
    size = float(np.sqrt(felt.force @ felt.force))
    if size < MIN_FORCE_FOR_TILT_N:
        return None
    push, normal = felt.force / size, target.normal
    cosine = -float(push @ normal)
    if not cosine > MIN_PUSH_COSINE:
        return None
    point = axis_point(felt.force, felt.moment)
    contact = point + float((point - skin) @ normal) / cosine * push
    lean, off = (vector - float(vector @ normal) * normal for vector in (push - target.push, skin - contact))
    length = float(np.sqrt(lean @ lean))
    across = np.cross(push, target.push)
    return PokeError(
        contact=contact,
        push=push,
        tilt=float(np.arccos(min(1.0, cosine))),
        off=off,
        error=float(np.arctan2(np.sqrt(across @ across), push @ target.push)),
        lean=lean / length if length > MIN_SIN_BETWEEN_PUSHES else np.zeros(3),
        landed=int(progress.channels[progress.responses.argmax()]) if len(progress.channels) else None,
    )


def max_angle_error(guidance: Guidance) -> float:
    """Largest allowed angle between a push and the wanted one, rad: the surface method takes any that does not slide."""
    return GuideSettings().tolerance if guidance.method is Method.FREE else guidance.usable_tilt
