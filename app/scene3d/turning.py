"""The camera turns to the target by itself: between pokes, never under a hand, and never for long.

A turn is due when the target is another one and is not well seen: on the far side, too slanting, or outside the picture. It
waits while a tool presses and while the operator moves the camera, and is drawn in the window's ticks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from app.scene3d.camera import NEAREST, VIEW_ANGLE
from app.scene3d.entry import entry_points, skin_point
from app.scene3d.ground import Frame
from skincal.geometry.arrays import FloatArray
from skincal.guide.coaching import PRESSING
from skincal.guide.guidance import Target
from skincal.mesh.surface import Surface

if TYPE_CHECKING:
    from vtkmodules.vtkRenderingCore import vtkCamera

TURN_S = 0.36
"""s. A turn takes this long, and its last picture comes a tick later at most: slower ones are waited for, quicker ones the eye
does not follow."""
REST_S = 3.0
"""s. After the operator moved the camera by hand it stays there for so long."""
SLANT = float(np.cos(np.radians(50.0)))
"""Cosine. Skin that is turned away from the camera by more is seen too slanting to aim at."""
LEFT = float(np.radians(20.0))
"""rad. So much of the slant is left: a straight push seen straight from above would be a dot."""
INSIDE = 0.75
"""Share of the picture, from its middle to its edge, in which a target is looked for."""
BACK_TO = 0.5
"""Share to which a target comes that was outside."""
COVER = 0.004
"""m. What lies so much nearer to the camera than the target hides it."""
FLAT = 0.3
"""Sine. The part's level axis is kept level unless the camera looks along it by less than this."""


@dataclass(frozen=True, slots=True, eq=False)
class Stand:
    """Where a camera stands: link frame, metres."""

    axes: FloatArray
    """(3, 3) float, rows right, up and back, unit."""
    focus: FloatArray
    """(3,) float: what it looks at."""
    distance: float

    @property
    def position(self) -> FloatArray:
        """(3,) float, metres."""
        return self.focus + self.distance * self.axes[2]


def stand_of(camera: vtkCamera) -> Stand:
    """Return where a camera stands."""
    back, up = -np.array(camera.GetDirectionOfProjection()), np.array(camera.GetViewUp())
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return Stand(np.stack([right, np.cross(back, right), back]), np.array(camera.GetFocalPoint()), camera.GetDistance())


def place(camera: vtkCamera, stand: Stand) -> None:
    """Put a camera there."""
    camera.SetFocalPoint(*stand.focus)
    camera.SetPosition(*stand.position)
    camera.SetViewUp(*stand.axes[1])


def well_seen(stand: Stand, at: FloatArray, normal: FloatArray, aspect: float, surface: Surface | None) -> bool:
    """Return whether a place on the skin is in the picture, turned to the camera, and not behind the part.

    Parameters
    ----------
    at, normal : (3,) float, metres and unit
    aspect : width over height of the picture
    """
    towards = stand.position - at
    reach = float(np.linalg.norm(towards))
    towards /= reach
    if float(normal @ towards) < SLANT or np.abs(_in_picture(stand, at, aspect)).max() > INSIDE:
        return False
    if surface is None:
        return True
    # What the line of sight enters before it comes to the target.
    before = (entry_points(surface, at, -towards) - at) @ towards
    return not (before > COVER).any()


def turned_to(stand: Stand, at: FloatArray, normal: FloatArray, aspect: float, level: FloatArray | None) -> Stand:
    """Return the nearest stand, at the same distance, from which a place on the skin is well seen.

    Parameters
    ----------
    at, normal : (3,) float, metres and unit
    aspect : width over height of the picture
    level : (3,) float, unit: what lies level in the picture; None where nothing does
    """
    axes = stand.axes
    slant = float(np.arccos(np.clip(normal @ axes[2], -1.0, 1.0)))
    if slant > LEFT:
        axes = _upright(axes, _between(axes[2], normal, 1.0 - LEFT / slant, axes[1]), level)
    found = Stand(axes, stand.focus, stand.distance)
    outside = _in_picture(found, at, aspect)
    if np.abs(outside).max() > INSIDE:
        too_far = (outside - np.clip(outside, -BACK_TO, BACK_TO)) * np.array([aspect, 1.0])
        found = Stand(axes, stand.focus + _half_height(found, at) * too_far @ axes[:2], stand.distance)
    return found


def _in_picture(stand: Stand, at: FloatArray, aspect: float) -> FloatArray:
    """Return (2,) where a point appears, right and up, in shares of the way from the picture's middle to its edge."""
    return (stand.axes[:2] @ (at - stand.focus)) / (_half_height(stand, at) * np.array([aspect, 1.0]))


def _half_height(stand: Stand, at: FloatArray) -> float:
    """Return half the height of the picture at the depth of a place, metres."""
    away = float((stand.position - at) @ stand.axes[2])
    return max(away, NEAREST) * float(np.tan(np.radians(VIEW_ANGLE / 2)))


def _between(start: FloatArray, end: FloatArray, share: float, spare: FloatArray) -> FloatArray:
    """Return (3,) the unit vector `share` of the way from one to another; over `spare` where they are opposite."""
    axis = np.cross(start, end)
    if float(np.linalg.norm(axis)) < 1e-9:
        axis = spare
    axis = axis / np.linalg.norm(axis)
    angle = share * float(np.arccos(np.clip(start @ end, -1.0, 1.0)))
    return np.asarray(np.cos(angle) * start + np.sin(angle) * np.cross(axis, start), dtype=np.float64)


def _upright(axes: FloatArray, back: FloatArray, level: FloatArray | None) -> FloatArray:
    """Return (3, 3) the axes of a camera that looks against `back`: level where it can be, else as upright as it was."""
    right = np.zeros(3) if level is None else np.asarray(level - float(level @ back) * back)
    if float(np.linalg.norm(right)) < FLAT:
        right = np.cross(axes[1], back)
        if float(np.linalg.norm(right)) < FLAT:
            right = axes[0] - (axes[0] @ back) * back
    elif float(right @ axes[0]) < 0.0:
        right = -right
    right = right / np.linalg.norm(right)
    return np.asarray(np.stack([right, np.cross(back, right), back]), dtype=np.float64)


def on_the_way(start: Stand, end: Stand, share: float) -> Stand:
    """Return the stand `share` of the way, 0 to 1, in time: slow at both ends."""
    eased = share * share * (3.0 - 2.0 * share)
    axis, angle = _turn(end.axes.T @ start.axes)
    return Stand(
        start.axes @ _rotation(axis, -eased * angle),
        start.focus + eased * (end.focus - start.focus),
        start.distance + eased * (end.distance - start.distance),
    )


def _turn(rotation: FloatArray) -> tuple[FloatArray, float]:
    """Return the axis (3,), unit, and the angle, rad, of a rotation (3, 3)."""
    angle = float(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))
    # The largest column of R + R' + (1 - tr R) I is along the axis, also at half a turn.
    both = rotation + rotation.T + (1.0 - np.trace(rotation)) * np.eye(3)
    axis = both[:, np.linalg.norm(both, axis=0).argmax()]
    size = float(np.linalg.norm(axis))
    axis = axis / size if size > 1e-12 else np.array([0.0, 0.0, 1.0])
    aside = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return axis * np.copysign(1.0, axis @ aside), angle


def _rotation(axis: FloatArray, angle: float) -> FloatArray:
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross, dtype=np.float64)


class Turner:
    """Turns one camera.

    Parameters
    ----------
    surface : None where the scene has none
    level : (3,) float, unit: what lies level in the picture; None where nothing does
    """

    def __init__(self, surface: Surface | None, level: FloatArray | None) -> None:
        self.wanted = True
        self.held = False
        """A button of the mouse is down on the picture."""
        self._surface, self._level = surface, level
        self._touched_s = -np.inf
        self._target: Target | None = None
        self._due = False
        self._way: tuple[Stand, Stand, float] | None = None
        """From where, to where, and when it began."""

    def touch(self, now_s: float) -> None:
        """Note that the operator moved the camera: a turn that is under way ends where it is."""
        self._touched_s, self._way = now_s, None

    def step(self, camera: vtkCamera, aspect: float, frame: Frame, now_s: float) -> bool:
        """Go on with a turn, or begin one that is due; return whether the camera moved.

        Parameters
        ----------
        aspect : width over height of the picture
        """
        target = frame.target if self.wanted else None
        if not _same(target, self._target):
            self._due, self._way = target is not None, None
        self._target = target
        if target is None or not self._free(frame, now_s):
            return False
        if self._due:
            self._due = False
            self._begin(camera, aspect, target, now_s)
        return self._go_on(camera, now_s)

    def _free(self, frame: Frame, now_s: float) -> bool:
        """Return whether the camera may turn; a turn that a poke interrupts is due again."""
        if frame.live is not None and frame.live.progress.phase in PRESSING:
            self._due, self._way = self._due or self._way is not None, None
            return False
        return not self.held and now_s - self._touched_s >= REST_S

    def _begin(self, camera: vtkCamera, aspect: float, target: Target, now_s: float) -> None:
        stand, at = stand_of(camera), skin_point(self._surface, target.place, target.normal)
        if not well_seen(stand, at, target.normal, aspect, self._surface):
            self._way = stand, turned_to(stand, at, target.normal, aspect, self._level), now_s

    def _go_on(self, camera: vtkCamera, now_s: float) -> bool:
        if self._way is None:
            return False
        start, end, begun_s = self._way
        share = min(1.0, (now_s - begun_s) / TURN_S)
        place(camera, on_the_way(start, end, share))
        if share == 1.0:
            self._way = None
        return True


def _same(one: Target | None, other: Target | None) -> bool:
    if one is None or other is None:
        return one is other
    return one.channel == other.channel and np.array_equal(one.place, other.place)
