"""How the poke in progress differs from the target, by the force/torque sensor alone.

While a tool presses, its wrench is an axis: where that meets the skin is the tip, the way it runs is how the tool is held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import PressPhase, Progress
from skincal.geometry import FloatArray, axis_point
from skincal.guide.guidance import Guidance, Target
from skincal.guide.progress import GuideSettings
from skincal.taxels.result import Method

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
class Coaching:
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


def smooth(before: Smoothed | None, progress: Progress) -> Smoothed | None:
    """Add a reading of the poke in progress; None while nothing presses, or where a reading is no number.

    Force and moment are smoothed, not the axis: an axis of a weak force counts little.
    """
    force, moment = progress.force, np.cross(progress.axis_point, progress.force)
    if progress.phase not in PRESSING or not np.isfinite(moment).all():
        return None
    if before is None:
        return Smoothed(force, moment)
    return Smoothed(KEPT * before.force + (1.0 - KEPT) * force, KEPT * before.moment + (1.0 - KEPT) * moment)


def coach(felt: Smoothed, progress: Progress, target: Target, skin: FloatArray) -> Coaching | None:
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
    return Coaching(
        contact=contact,
        push=push,
        tilt=float(np.arccos(min(1.0, cosine))),
        off=_along(skin - contact, normal),
        error=_angle(push, target.push),
        lean=_way(_along(push - target.push, normal)),
        landed=int(progress.channels[progress.responses.argmax()]) if len(progress.channels) else None,
    )


def leeway(guidance: Guidance) -> float:
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
