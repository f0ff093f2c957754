"""The skin around a taxel as one looks down on it, the tool as a stick upon it: pure functions, without Qt.

A direction is drawn where the tool's upper end stands that pushes along it, as far out as the sine of its tilt. So what the
words say ("toward 17-05") and what the 3D view shows is what the picture shows: up in it is up in the 3D view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.scene3d.camera import CameraPose
from skincal.geometry import FloatArray, IntArray
from skincal.guide.guidance import Guidance, PokeError, Target
from skincal.guide.progress import AxisDiversity, GuideSettings
from skincal.taxels.result import Method

TOOL = 0.035
"""m. Length of the stick, a tool's tip: as long as the arrow in the 3D view."""
AROUND = 0.022
"""m. Half the width of the picture: a tool of this length that leans by 39 degrees ends at its rim."""
SIDES = 36
"""Corners of a cone's rim."""
EDGE = float(np.sin(np.radians(45.0)))
"""Sine of the tilt at the rim of a plot of axis diversity; what leans more is drawn there."""
AROUND_TAXEL = 0.005
"""m. Half the width of the picture of the contacts around a taxel: as far as its neighbour."""
GRAIN = 48
"""Points across a shade."""
BLUR = 0.18
"""How far what a push is worth is taken to hold around it, in sines of the tilt: half the way to the next that is tried."""


def axes_on(normal: FloatArray, eye: CameraPose) -> FloatArray:
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


def top_view(
    guidance: Guidance, target: Target, coaching: PokeError | None, max_angle_error: float, eye: CameraPose
) -> TopView:
    """Return the picture of a target and of the tool that presses; its push may be off by `max_angle_error`, rad."""
    axes = axes_on(target.normal, eye)
    # What is asked of the tool's upper end is asked above its tip, wherever that is.
    tip = np.zeros(2) if coaching is None else -(axes @ coaching.off)
    apart = (guidance.places - target.place) @ axes.T
    near = np.flatnonzero((np.sum(apart * apart, axis=1) < AROUND**2) & (guidance.channels != target.channel))
    return TopView(
        channels=guidance.channels[near],
        taxels=apart[near],
        wanted=tip - TOOL * (axes @ target.push),
        room=tip - TOOL * (cone(target.push, max_angle_error) @ axes.T),
        tip=None if coaching is None else tip,
        upper=None if coaching is None else tip - TOOL * (axes @ coaching.push),
        right=coaching is not None and coaching.error <= max_angle_error,
    )


def cone(push: FloatArray, angle: float) -> FloatArray:
    """Return (36, 3) float, unit: the directions that are `angle`, rad, off a push, around it."""
    # The axis that lies least along the push, so that their cross product is far from zero.
    helper = np.eye(3)[np.abs(push).argmin()]
    first = np.cross(helper, push)
    first /= np.sqrt(first @ first)
    second = np.cross(push, first)
    turns = np.arange(SIDES) * (2.0 * np.pi / SIDES)
    around = np.cos(turns)[:, None] * first + np.sin(turns)[:, None] * second
    return np.cos(angle) * push + np.sin(angle) * around


@dataclass(frozen=True, slots=True, eq=False)
class AxisDiversityView:
    """The contacts of a taxel as one looks down on it; 1 is the rim."""

    dots: FloatArray
    """(n, 2) float: each contact, right and up, at most 1 from the middle."""
    limit: float
    """Radius of the circle within which dots are wanted: the usable tilt, or where the middle may lie."""
    middle: FloatArray | None
    """(2,) float: the middle of the dots, where its place is what counts."""
    wanted: FloatArray | None
    """(2,) float: the side from which the next one would help most; None where none helps, or place is what counts."""
    shade: FloatArray
    """(g, g) float, 0 to 1: how much a next one would help there, rows from the top; all 0 where nothing is to be said."""


def diversity_view(diversity: AxisDiversity, method: Method, eye: CameraPose) -> AxisDiversityView:
    """Return the picture of what a method needs of a taxel: sides for the free one, places for the others."""
    axes = axes_on(diversity.normal, eye)
    if method is Method.FREE:
        dots, tried = -(diversity.pushes @ axes.T) / EDGE, -(diversity.tried @ axes.T) / EDGE
        limit, middle = float(np.sin(diversity.usable_tilt)) / EDGE, None
        shade = _shade(tried, diversity.worth, limit)
        wanted = tried[diversity.worth.argmax()] if shade.any() else None
    else:
        dots, middle = diversity.offsets @ axes.T / AROUND_TAXEL, diversity.beside @ axes.T / AROUND_TAXEL
        # A module's contacts need not lie around each of its taxels.
        limit = GuideSettings().balance / AROUND_TAXEL if method is Method.SURFACE else 0.0
        shade = np.zeros((GRAIN, GRAIN))
        wanted = None
    return AxisDiversityView(_within(dots), limit, None if middle is None else _within(middle[None])[0], wanted, shade)


def _within(points: FloatArray) -> FloatArray:
    """Return (n, 2) points, those beyond the rim on it."""
    sizes = np.sqrt(np.sum(points * points, axis=1, keepdims=True))
    return np.asarray(points / np.maximum(sizes, 1.0), dtype=np.float64)


def _shade(tried: FloatArray, worth: FloatArray, limit: float) -> FloatArray:
    """Return what is worth how much inside the limit, spread from the (d, 2) pushes that are tried."""
    step = (np.arange(GRAIN) + 0.5) / GRAIN * 2.0 - 1.0
    grid = np.stack(np.meshgrid(step, -step), axis=-1)
    most = float(worth.max())
    if not most > 0.0:
        return np.zeros((GRAIN, GRAIN))
    square = np.sum((grid[:, :, None] - tried) ** 2, axis=-1)
    near = np.exp(-square / (2.0 * (BLUR / EDGE) ** 2))
    spread = (near @ worth) / (most * near.sum(axis=-1))
    return np.where(np.sum(grid**2, axis=-1) <= limit**2, np.clip(spread, 0.0, 1.0), 0.0)
