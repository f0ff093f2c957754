"""Geometry of the small pictures that look down on a taxel. Pure functions, without Qt.

A push direction is drawn at the upper end of its tool: as far out as the sine of its tilt. Up is up as in the 3D view.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from app.scene3d.lines import DRAWN_TOOL_LENGTH_M, cone_rim
from app.state.camera_pose import CameraPose
from skincal.geometry import FloatArray, IntArray
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from skincal.guide.guidance import Guidance, Target
    from skincal.guide.press_coaching import PokeError
    from skincal.guide.progress import AxisDiversity

DIAL_RADIUS_M = 0.022  # m. Half the width of the dial: a tool that leans by 39 degrees ends at its rim.
RIM_SINE = float(np.sin(np.radians(45.0)))
"""Sine of the tilt at the rim of a picture of axis diversity; directions beyond are drawn at the rim."""
CONTACT_PLOT_RADIUS_M = 0.005
"""m. Half the width of the picture of contacts around a taxel: the distance to its neighbour."""
SHADE_POINTS_PER_SIDE = 48  # Points across a shade
SHADE_SMOOTHING_SIN_TILT = 0.18
"""Smoothing width of the shade, as sine of tilt: half the spacing of the sampled directions."""


def axes_on(normal: FloatArray, eye: CameraPose) -> FloatArray:
    """Return (2, 3) float: unit vectors right and up along the skin, as close as possible to the camera's.

    Parameters
    ----------
    normal : (3,) float, unit, outward
    """
    right, up = (each - (each @ normal) * normal for each in (eye.right, eye.up))
    # The one that is flatter on the skin is used; the other may be nearly along the normal.
    if right @ right >= up @ up:
        right = right / np.sqrt(right @ right)
        return np.stack([right, np.cross(normal, right)])
    up = up / np.sqrt(up @ up)
    return np.stack([np.cross(up, normal), up])


@dataclass(frozen=True, slots=True, eq=False)
class TopView:
    """Taxels and tool around a target; positions are metres right and up from it."""

    channels: IntArray
    """(k,) taxels in the picture."""
    taxels: FloatArray
    """(k, 2) float, metres."""
    wanted: FloatArray
    """(2,) float, metres: wanted position of the tool's upper end."""
    room: FloatArray
    """(n, 2) float, metres: outline of its accepted positions."""
    tip: FloatArray | None
    """(2,) float, metres: the tool's tip; `None` while nothing presses."""
    upper: FloatArray | None
    """(2,) float, metres: its upper end."""
    right: bool
    """The tilt is accepted."""


def top_view(guidance: Guidance, target: Target, coaching: PokeError | None, accepted: float, eye: CameraPose) -> TopView:
    """Return the picture of a target and the tool; pushes within `accepted`, rad, of the wanted one are right."""
    axes = axes_on(target.normal, eye)
    # The upper end is wanted relative to the tip, even if that is off target.
    tip = np.zeros(2) if coaching is None else -(axes @ coaching.off)
    apart = (guidance.places - target.place) @ axes.T
    near = np.flatnonzero((np.sum(apart * apart, axis=1) < DIAL_RADIUS_M**2) & (guidance.channels != target.channel))
    return TopView(
        channels=guidance.channels[near],
        taxels=apart[near],
        wanted=tip - DRAWN_TOOL_LENGTH_M * (axes @ target.push),
        room=tip - DRAWN_TOOL_LENGTH_M * (cone_rim(target.push, accepted) @ axes.T),
        tip=None if coaching is None else tip,
        upper=None if coaching is None else tip - DRAWN_TOOL_LENGTH_M * (axes @ coaching.push),
        right=coaching is not None and coaching.error <= accepted,
    )


@dataclass(frozen=True, slots=True, eq=False)
class AxisDiversityView:
    """Contacts of a taxel from above; the rim is at radius 1."""

    dots: FloatArray
    """(n, 2) float: each contact, right and up, at most 1 from the centre."""
    limit: float
    """Radius of the largest usable tilt, or of the area for the mean contact point."""
    middle: FloatArray | None
    """(2,) float: the mean contact point; `None` for the free method."""
    wanted: FloatArray | None
    """(2,) float: best direction of the next contact; `None` if no direction helps."""
    shade: FloatArray
    """(g, g) float, 0 to 1: benefit of a next contact in each direction, first row on top; 0 if unknown."""


def diversity_view(diversity: AxisDiversity, method: Method, eye: CameraPose) -> AxisDiversityView:
    """Return directions of contacts for the free method, contact points for the others."""
    axes = axes_on(diversity.normal, eye)
    if method is Method.FREE:
        dots, tried = -(diversity.pushes @ axes.T) / RIM_SINE, -(diversity.tried @ axes.T) / RIM_SINE
        limit, middle = float(np.sin(diversity.usable_tilt)) / RIM_SINE, None
        shade = _shade(tried, diversity.worth, limit)
        wanted = tried[diversity.worth.argmax()] if shade.any() else None
    else:
        dots, middle = diversity.offsets @ axes.T / CONTACT_PLOT_RADIUS_M, diversity.beside @ axes.T / CONTACT_PLOT_RADIUS_M
        # The modules method needs no contacts around each taxel.
        from skincal.guide.progress import GuideSettings  # the dial does without

        limit = GuideSettings().balance / CONTACT_PLOT_RADIUS_M if method is Method.SURFACE else 0.0
        shade = np.zeros((SHADE_POINTS_PER_SIDE, SHADE_POINTS_PER_SIDE))
        wanted = None
    return AxisDiversityView(_within(dots), limit, None if middle is None else _within(middle[None])[0], wanted, shade)


def _within(points: FloatArray) -> FloatArray:
    """Move points, (n, 2), that lie outside the dial to its rim."""
    sizes = np.sqrt(np.sum(points * points, axis=1, keepdims=True))
    return np.asarray(points / np.maximum(sizes, 1.0), dtype=np.float64)


def _shade(tried: FloatArray, worth: FloatArray, limit: float) -> FloatArray:
    """Return the benefit inside the limit, smoothed from that of the sampled pushes, (d, 2)."""
    step = (np.arange(SHADE_POINTS_PER_SIDE) + 0.5) / SHADE_POINTS_PER_SIDE * 2.0 - 1.0
    grid = np.stack(np.meshgrid(step, -step), axis=-1)
    most = float(worth.max())
    if not most > 0.0:
        return np.zeros((SHADE_POINTS_PER_SIDE, SHADE_POINTS_PER_SIDE))
    square = np.sum((grid[:, :, None] - tried) ** 2, axis=-1)
    near = np.exp(-square / (2.0 * (SHADE_SMOOTHING_SIN_TILT / RIM_SINE) ** 2))
    spread = (near @ worth) / (most * near.sum(axis=-1))
    return np.where(np.sum(grid**2, axis=-1) <= limit**2, np.clip(spread, 0.0, 1.0), 0.0)
