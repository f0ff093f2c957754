"""Where the camera stands, what it sees, and how it turns to the target.

At first it looks at the side that carries the skin, the part's long axis level, everything in the picture. It turns by itself
between pokes, never under a hand, and never for long: when the target is another one and is not well seen, that is on the far
side, too slanting, outside the picture, or so far off that a taxel is but a dot: then the camera goes near. A turn waits while
a tool presses and while the operator moves the camera.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from app.scene3d.scene_state import BALL, View3DState
from skincal.geometry import FloatArray, cross_matrix
from skincal.guide.guidance import PRESSING, Target
from skincal.mesh.surface import Surface, entry_points, skin_point

if TYPE_CHECKING:
    from vtkmodules.vtkRenderingCore import vtkCamera, vtkRenderer


VIEW_ANGLE = 24.0
"""Degrees. Narrow, so that sizes compare across the part, yet wide enough to tell near from far."""
MARGIN = 1.08
"""The part takes this much less than the picture."""
LONG = 2.0
"""A part is long when it spreads this much more along its longest axis than along the next."""
NEAREST, FARTHEST = 0.02, 20.0
"""m. The camera stays between these distances of what it looks at."""
BEFORE = 0.98
"""Of the distance to the nearest point of the part: what is drawn before the part lies there, where VTK still draws (measured
down to 0.95 of a flat part)."""
NEAREST_PLANE = 5e-3
"""m. Nothing is brought nearer to the camera: VTK draws from a thousandth of the farthest distance on."""
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
DOT, SEEN = 5.0, 14.0
"""Pixels. A target is gone near to where a ball would be smaller than the one, until it is as large as the other."""
BESIDE = 0.3
"""Of the distance: a target that lies so much before or behind what the camera looks at is what it looks at from then on."""
FLAT = 0.3
"""Sine. The part's level axis is kept level unless the camera looks along it by less than this."""


@dataclass(frozen=True, slots=True, eq=False)
class Eye:
    """What is right and what is up on the screen, (3,) float, unit, link frame."""

    right: FloatArray
    up: FloatArray

    def same(self, other: Eye) -> bool:
        """Return whether a picture drawn for one is right for the other: a hundredth of a radian is not seen."""
        return bool(np.abs([self.right - other.right, self.up - other.up]).max() < 0.01)


PLAIN = Eye(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
"""While there is no picture yet."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """From where one picture is seen; link frame, metres."""

    eye: Eye
    place: FloatArray
    """(3,) float: of the camera."""
    towards: FloatArray
    """(3,) float, unit: from the part to the camera."""
    size: tuple[int, int]
    """Pixels, width and height of the picture."""
    scale: float
    """Pixels a metre, at the distance the camera looks at."""

    def same(self, other: Sight | None) -> bool:
        """Return whether what was laid out for one sight is exact for the other."""
        if other is None or (self.size, self.scale) != (other.size, other.scale):
            return False
        pairs = (self.place, other.place), (self.eye.right, other.eye.right), (self.eye.up, other.eye.up)
        return all(np.array_equal(mine, its) for mine, its in pairs)

    def lift(self, points: FloatArray, by: float | FloatArray) -> FloatArray:
        """Return (..., 3) points, metres nearer to the camera, half of the way at most; in the picture nothing moves.

        `by` is one number, or one for each point, (..., 1).
        """
        way = self.place - points
        return points + way * np.minimum(by / np.linalg.norm(way, axis=-1, keepdims=True), 0.5)

    def bring_before(self, points: FloatArray, part: FloatArray) -> FloatArray:
        """Return (..., 3) points brought before all of a part, (n, 3); in the picture nothing moves.

        They come to lie in one plane; those before it, or behind the camera, stay.
        """
        if not len(part):
            return points
        plane = max(BEFORE * float(((self.place - part) @ self.towards).min()), NEAREST_PLANE)
        away = ((self.place - points) @ self.towards)[..., None]
        return self.place + (points - self.place) * (plane / np.maximum(away, plane))


def eye_of(camera: vtkCamera) -> Eye:
    """Return how a camera stands."""
    right, up, _ = stand_of(camera).axes
    return Eye(right, up)


def sight_of(renderer: vtkRenderer) -> Sight:
    """Return from where a renderer's next picture is seen."""
    camera, size = renderer.GetActiveCamera(), renderer.GetSize()
    scale = size[1] / (2 * camera.GetDistance() * np.tan(np.radians(camera.GetViewAngle() / 2)))
    right, up, towards = stand_of(camera).axes
    return Sight(Eye(right, up), np.array(camera.GetPosition()), towards, size, float(scale))


def project(renderer: vtkRenderer, points: FloatArray) -> FloatArray:
    """Return where (n, 3) points, metres, appear, (n, 3) float.

    x and y are pixels from the lower left; depth is from -1 (near) to 1 in the picture.
    """
    camera = renderer.GetActiveCamera()
    matrix = camera.GetCompositeProjectionTransformMatrix(renderer.GetTiledAspectRatio(), -1, 1)
    transform = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)])
    clip = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ transform.T
    # Behind the camera the division would bring a point into the picture, upside down.
    normal = clip[:, :3] / np.where(clip[:, 3:] > 0, clip[:, 3:], np.nan)
    width, height = renderer.GetSize()
    return np.stack([(normal[:, 0] + 1) * width / 2, (normal[:, 1] + 1) * height / 2, normal[:, 2]], axis=1)


def ray(renderer: vtkRenderer, x: float, y: float) -> tuple[FloatArray, FloatArray]:
    """Return the line of sight through a pixel, from the lower left: the camera's place and a unit vector away from it."""
    camera = renderer.GetActiveCamera()
    width, height = renderer.GetSize()
    right, up, back = stand_of(camera).axes
    half = np.tan(np.radians(camera.GetViewAngle() / 2))
    direction = half * ((2 * x - width) / height * right + (2 * y / height - 1) * up) - back
    return np.array(camera.GetPosition()), direction / np.linalg.norm(direction)


def fit(camera: vtkCamera, points: FloatArray, facing: FloatArray | None, aspect: float, least: float) -> None:
    """Place the camera so that all points are in the picture.

    Parameters
    ----------
    points : (n, 3) float, metres; empty looks at the origin
    facing : (3,) float, unit: the side to look at; None for the side across the part's two long axes
    aspect : width over height of the picture
    least : metres, half the height of the picture at least
    """
    centre, axes = first_frame(points, facing)
    seen = (points - centre) @ axes.T if len(points) else np.zeros((1, 3))
    slope = np.tan(np.radians(VIEW_ANGLE / 2))
    distances = np.maximum(np.abs(seen[:, 1]), np.abs(seen[:, 0]) / aspect) * MARGIN / slope + seen[:, 2]
    camera.SetViewAngle(VIEW_ANGLE)
    place(camera, Stand(axes, centre, max(float(distances.max()), least / slope)))


def first_frame(points: FloatArray, facing: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return the middle of the points, and right, up and back, as rows, unit, of the camera that `fit` places."""
    if len(points) < 3:
        return points.mean(axis=0) if len(points) else np.zeros(3), np.eye(3)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    variances, principal = np.linalg.eigh(np.cov(points.T))
    back = principal[:, 0] if facing is None else facing
    # The signs of principal axes mean nothing: fix them, so that the same part is always seen the same way.
    back = back if facing is not None else back * np.sign(back[np.argmax(np.abs(back))])
    level = _level(variances, principal, back)
    right: FloatArray = level - float(level @ back) * back
    right /= np.linalg.norm(right)
    return centre, np.stack([right, np.cross(back, right), back])


def _level(variances: FloatArray, principal: FloatArray, back: FloatArray) -> FloatArray:
    """Return what lies level in the picture: a long part's long axis, else what leaves the link's z axis upright."""
    if variances[2] < LONG**2 * variances[1] and abs(float(back[2])) < 0.9:
        return np.cross([0.0, 0.0, 1.0], back)
    along = principal[:, 2] if abs(float(principal[:, 2] @ back)) < 0.9 else principal[:, 1]
    return along * np.sign(along[np.argmax(np.abs(along))])


def level_of(points: FloatArray) -> FloatArray | None:
    """Return (3,) float, unit: the long axis of a long part, (n, 3) float, which `fit` lays level; None for any other part."""
    if len(points) < 3:
        return None
    variances, principal = np.linalg.eigh(np.cov(points.T))
    return principal[:, 2] if variances[2] >= LONG**2 * variances[1] else None


def orbit(camera: vtkCamera, right: float, up: float) -> None:
    """Turn the camera around what it looks at; degrees."""
    camera.Azimuth(-right)
    camera.Elevation(-up)
    # VTK's Azimuth turns about the view's up, which Elevation leaves where it was.
    camera.OrthogonalizeViewUp()


def shift(camera: vtkCamera, right: float, up: float) -> None:
    """Move the camera sideways; in heights of the picture."""
    stand = stand_of(camera)
    height = 2 * stand.distance * np.tan(np.radians(camera.GetViewAngle() / 2))
    place(camera, replace(stand, focus=stand.focus - height * (right * stand.axes[0] + up * stand.axes[1])))


def approach(camera: vtkCamera, factor: float) -> None:
    """Bring the camera `factor` times nearer to what it looks at."""
    stand = stand_of(camera)
    place(camera, replace(stand, distance=float(np.clip(stand.distance / factor, NEAREST, FARTHEST))))


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
    back = -np.array(camera.GetDirectionOfProjection())
    right: FloatArray = np.cross(camera.GetViewUp(), back)
    right /= np.linalg.norm(right)
    return Stand(np.stack([right, np.cross(back, right), back]), np.array(camera.GetFocalPoint()), camera.GetDistance())


def place(camera: vtkCamera, stand: Stand) -> None:
    """Put a camera there."""
    camera.SetFocalPoint(*stand.focus)
    camera.SetPosition(*stand.position)
    camera.SetViewUp(*stand.axes[1])


def well_seen(
    stand: Stand, at: FloatArray, normal: FloatArray, aspect: float, surface: Surface | None, covered: float = 0.0
) -> bool:
    """Return whether a place on the skin is in the picture, turned to the camera, and not behind the part.

    `at` and `normal` are (3,) float, metres and unit; `aspect` is width over height of the picture; `covered` is the share
    of its width, from the left, over which something else lies.
    """
    towards = stand.position - at
    reach = float(np.linalg.norm(towards))
    towards /= reach
    if float(normal @ towards) < SLANT or np.abs(_in_picture(stand, at, aspect, covered)).max() > INSIDE:
        return False
    if surface is None:
        return True
    # What the line of sight enters before it comes to the target.
    before = (entry_points(surface, at, -towards) - at) @ towards
    return not (before > COVER).any()


def turned_to(
    stand: Stand, at: FloatArray, normal: FloatArray, aspect: float, level: FloatArray | None, covered: float = 0.0
) -> Stand:
    """Return the nearest stand, at the same distance, from which a place on the skin is well seen; see `well_seen`.

    `level` is (3,) float, unit: what lies level in the picture; None where nothing does.
    """
    axes = stand.axes
    slant = float(np.arccos(np.clip(normal @ axes[2], -1.0, 1.0)))
    if slant > LEFT:
        axes = _upright(axes, _between(axes[2], normal, 1.0 - LEFT / slant, axes[1]), level)
    found = Stand(axes, stand.focus, stand.distance)
    outside = _in_picture(found, at, aspect, covered)
    if np.abs(outside).max() > INSIDE:
        too_far = (outside - np.clip(outside, -BACK_TO, BACK_TO)) * np.array([aspect * (1.0 - covered), 1.0])
        found = Stand(axes, stand.focus + _half_height(found, at) * too_far @ axes[:2], stand.distance)
    return found


def _in_picture(stand: Stand, at: FloatArray, aspect: float, covered: float) -> FloatArray:
    """Return (2,) where a point appears, right and up, in shares of the way from the free picture's middle to its edge."""
    whole = (stand.axes[:2] @ (at - stand.focus)) / (_half_height(stand, at) * np.array([aspect, 1.0]))
    return np.asarray((whole - (covered, 0.0)) / (1.0 - covered, 1.0))


def _half_height(stand: Stand, at: FloatArray) -> float:
    """Return half the height of the picture at the depth of a place, metres."""
    away = float((stand.position - at) @ stand.axes[2])
    return max(away, NEAREST) * float(np.tan(np.radians(VIEW_ANGLE / 2)))


def _between(start: FloatArray, end: FloatArray, share: float, spare: FloatArray) -> FloatArray:
    """Return (3,) the unit vector `share` of the way from `start` to `end`; over `spare` where they are opposite."""
    axis = np.cross(start, end)
    if float(np.linalg.norm(axis)) < 1e-9:
        axis = spare
    axis = axis / np.linalg.norm(axis)
    return _rotation(axis, share * float(np.arccos(np.clip(start @ end, -1.0, 1.0)))) @ start


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
    """Return the stand `share` of the way, 0 to 1, in time: slow at both ends, and around the part where the way is far."""
    eased = share * share * (3.0 - 2.0 * share)
    axis, angle = _turn(end.axes.T @ start.axes)
    far = max(0.0, float(np.linalg.norm(end.focus - start.focus)) - min(start.distance, end.distance) / 2.0)
    return Stand(
        start.axes @ _rotation(axis, -eased * angle),
        start.focus + eased * (end.focus - start.focus),
        start.distance + eased * (end.distance - start.distance) + 4.0 * eased * (1.0 - eased) * far,
    )


def near_to(stand: Stand, at: FloatArray, height: int) -> Stand:
    """Return the stand, or a nearer one from which a ball at a place is more than a dot in a picture `height` pixels high."""
    slope = 2.0 * float(np.tan(np.radians(VIEW_ANGLE / 2)))
    away = float((stand.position - at) @ stand.axes[2])
    if BALL * height >= DOT * slope * away:
        return stand
    return Stand(stand.axes, at, max(NEAREST, BALL * height / (SEEN * slope)))


def _turn(rotation: FloatArray) -> tuple[FloatArray, float]:
    """Return the axis (3,), unit, and the angle, rad, of a rotation (3, 3)."""
    angle = float(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))
    # The largest column of R + R' + (1 - tr R) I is along the axis, also at half a turn.
    both = rotation + rotation.T + (1.0 - np.trace(rotation)) * np.eye(3)
    axis = both[:, np.linalg.norm(both, axis=0).argmax()]
    size = float(np.linalg.norm(axis))
    axis = axis / size if size > 1e-12 else np.array([0.0, 0.0, 1.0])
    aside = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    # `sign` would give 0 at half a turn, where either direction is right.
    return axis * np.copysign(1.0, axis @ aside), angle


def _rotation(axis: FloatArray, angle: float) -> FloatArray:
    """Return the rotation by `angle`, rad, about `axis`, (3,) float, unit."""
    cross = cross_matrix(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross, dtype=np.float64)


class Turner:
    """Turns one camera; `level`, (3,) float, unit, lies level in the picture, where there is one."""

    def __init__(self, surface: Surface | None, level: FloatArray | None) -> None:
        self.wanted = True
        self.held = False
        """A button of the mouse is down on the picture."""
        self.covered = 0.0
        """Share of the picture's width, from the left, over which something lies: no target is brought there."""
        self._surface, self._level = surface, level
        self._touched_s = -np.inf
        self._target: Target | None = None
        self._due = False
        self._way: tuple[Stand, Stand, float] | None = None
        """From where, to where, and when it began."""

    def touch(self, now_s: float) -> None:
        """Note that the operator moved the camera: a turn that is under way ends where it is."""
        self._touched_s, self._way = now_s, None

    def step(self, camera: vtkCamera, size: tuple[int, int], state: View3DState, now_s: float) -> bool:
        """Go on with a turn, or begin one that is due; return whether the camera moved; `size` is the picture's, in pixels."""
        target = state.target if self.wanted else None
        if not _same(target, self._target):
            self._due, self._way = target is not None, None
        self._target = target
        if target is None or not self._free(state, now_s):
            return False
        if self._due:
            self._due = False
            self._begin(camera, size, target, now_s)
        return self._go_on(camera, now_s)

    def _free(self, state: View3DState, now_s: float) -> bool:
        """Return whether the camera may turn; a turn that a poke interrupts is due again."""
        if state.live is not None and state.live.progress.phase in PRESSING:
            self._due, self._way = self._due or self._way is not None, None
            return False
        return not self.held and now_s - self._touched_s >= REST_S

    def _begin(self, camera: vtkCamera, size: tuple[int, int], target: Target, now_s: float) -> None:
        stand, at = stand_of(camera), skin_point(self._surface, target.place, target.normal)
        aspect, end = size[0] / size[1], stand
        if not well_seen(stand, at, target.normal, aspect, self._surface, self.covered):
            end = turned_to(stand, at, target.normal, aspect, self._level, self.covered)
            if abs(float((at - end.focus) @ end.axes[2])) > BESIDE * end.distance:
                end = Stand(end.axes, at, end.distance)
        end = near_to(end, at, size[1])
        if end is not stand:
            self._way = stand, end, now_s

    def _go_on(self, camera: vtkCamera, now_s: float) -> bool:
        if self._way is None:
            return False
        start, end, begun_s = self._way
        share = min(1.0, (now_s - begun_s) / TURN_S)
        place(camera, on_the_way(start, end, share))
        if share == 1.0:
            self._way = None
        return True


def _same(now: Target | None, before: Target | None) -> bool:
    if now is None or before is None:
        return now is before
    return now.channel == before.channel and np.array_equal(now.place, before.place)
