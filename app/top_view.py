"""The skin around a taxel as one looks down on it, the tool as a stick upon it: pure functions, without Qt.

A direction is drawn where the tool's upper end stands that pushes along it, as far out as the sine of its tilt. So what the
words say ("toward 17-05") and what the 3D view shows is what the picture shows: up in it is up in the 3D view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.scene3d.camera import Eye
from skincal.guide.coach import Coaching
from skincal.guide.guidance import Guidance, Target
from skincal.readings import FloatArray, IntArray

TOOL = 0.035
"""m. Length of the stick, a tool's tip: as long as the arrow in the 3D view."""
AROUND = 0.022
"""m. Half the width of the picture: a tool of this length that leans by 39 degrees ends at its rim."""
SIDES = 36
"""Corners of a cone's rim."""


def axes_on(normal: FloatArray, eye: Eye) -> FloatArray:
    """Return (2, 3) float: right and up along the skin, unit, seen from outside, as nearly as they stand on the screen.

    Parameters
    ----------
    normal : (3,) float, unit, outward
    """
    right, up = (each - (each @ normal) * normal for each in (eye.right, eye.up))
    # Whichever lies flatter on the skin leads: the other may be seen from its end.
    if right @ right >= up @ up:
        right = right / np.sqrt(right @ right)
        return np.stack([right, np.cross(normal, right)])
    up = up / np.sqrt(up @ up)
    return np.stack([np.cross(up, normal), up])


@dataclass(frozen=True, slots=True, eq=False)
class TopView:
    """What lies and leans around a target, metres from it, right and up."""

    channels: IntArray
    """(k,) the taxels that are near."""
    taxels: FloatArray
    """(k, 2) float, metres."""
    wanted: FloatArray
    """(2,) float, metres: where the tool's upper end is asked to be."""
    room: FloatArray
    """(n, 2) float, metres: the rim of where it may be."""
    tip: FloatArray | None
    """(2,) float, metres: where the tool is; None while nothing presses."""
    upper: FloatArray | None
    """(2,) float, metres: its upper end."""
    right: bool
    """The tool is held as asked."""


def top_view(guidance: Guidance, target: Target, coaching: Coaching | None, leeway: float, eye: Eye) -> TopView:
    """Return the picture of a target and of the tool that presses.

    Parameters
    ----------
    leeway : rad, how far a push may be off the wanted one
    """
    axes = axes_on(target.normal, eye)
    # What is asked of the tool's upper end is asked above its tip, wherever that is.
    tip = np.zeros(2) if coaching is None else -(axes @ coaching.off)
    apart = (guidance.places - target.place) @ axes.T
    near = np.flatnonzero((np.sum(apart * apart, axis=1) < AROUND**2) & (guidance.channels != target.channel))
    return TopView(
        channels=guidance.channels[near],
        taxels=apart[near],
        wanted=tip - TOOL * (axes @ target.push),
        room=tip - TOOL * (cone(target.push, leeway) @ axes.T),
        tip=None if coaching is None else tip,
        upper=None if coaching is None else tip - TOOL * (axes @ coaching.push),
        right=coaching is not None and coaching.error <= leeway,
    )


def cone(push: FloatArray, angle: float) -> FloatArray:
    """Return (36, 3) float, unit: the directions that are `angle`, rad, off a push, around it."""
    helper = np.eye(3)[np.abs(push).argmin()]
    first = np.cross(helper, push)
    first /= np.sqrt(first @ first)
    second = np.cross(push, first)
    turns = np.arange(SIDES) * (2.0 * np.pi / SIDES)
    around = np.cos(turns)[:, None] * first + np.sin(turns)[:, None] * second
    return np.cos(angle) * push + np.sin(angle) * around
