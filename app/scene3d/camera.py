"""Camera poses, and the camera that turns to the target.

At first the camera looks at the side with the skin; the part's long axis is level and everything is in the picture. It turns to
a new target between pokes if that is turned away, outside the picture, or drawn too small. It waits while a tool presses, and
for 3 s after the operator moved it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from app.scene3d.scene_state import ESTIMATE_BALL_DIAMETER_M, View3DState
from skincal.geometry import FloatArray, cross_matrix
from skincal.guide.guidance import Target
from skincal.guide.press_coaching import PRESSING_PHASES
from skincal.mesh.surface import Surface, point_on_skin

if TYPE_CHECKING:
    from vtkmodules.vtkRenderingCore import vtkCamera

CAMERA_VIEW_ANGLE_DEG = 24.0  # Narrow, so that sizes compare across the part, but wide enough to show depth
VIEW_SLOPE = float(np.tan(np.radians(CAMERA_VIEW_ANGLE_DEG / 2)))
VIEW_SIZE_OVER_PART_SIZE = 1.08  # Size of the picture over that of the part
LONG_PART_MIN_LENGTH_RATIO = 2.0  # Extent of a long part along its longest axis over that along the next, at least
MIN_DISTANCE, MAX_DISTANCE = 0.02, 20.0  # m, of the camera to what it looks at
CAMERA_TURN_DURATION_S = 0.36  # Slower turns keep the operator waiting; the eye does not follow faster ones
PAUSE_AFTER_MANUAL_MOVE_S = 3.0
MIN_FACING = float(np.cos(np.radians(50.0)))
"""Cosine. Skin that is turned away by more is seen at too flat an angle to aim."""
RESIDUAL_TILT = float(np.radians(20.0))
"""rad between the view and the normal after a turn: a push that is seen from exactly above would be a dot."""
TARGET_MAX_OFFSET_OVER_HALF_VIEW = 0.75
"""Of the way from the middle of the picture to its edge: a target further out is brought to the middle."""
MIN_BALL_PX, TARGET_BALL_PX = 5.0, 14.0
"""A target with a ball smaller than the first is brought closer, until the ball has the second size."""
MIN_SIN_VIEW_TO_LEVEL_AXIS = 0.3  # The part's level axis is kept level unless the camera looks along it by less than this


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """Position and direction of a camera; link frame, metres."""

    axes: FloatArray
    """(3, 3) float, unit, rows: right and up on the screen, and back to the camera."""
    focus: FloatArray
    """(3,) float: the point that it looks at."""
    distance: float

    @property
    def right(self) -> FloatArray:
        return self.axes[0]

    @property
    def up(self) -> FloatArray:
        return self.axes[1]

    @property
    def position(self) -> FloatArray:
        """(3,) float, metres."""
        return self.focus + self.distance * self.axes[2]


PLAIN_POSE = CameraPose(np.eye(3), np.zeros(3), 1.0)  # Before the first picture


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """The camera of one picture, and the picture's size."""

    pose: CameraPose
    size: tuple[int, int]
    """Device pixels, width and height."""
    ratio: float
    """Device pixels a pixel of the desktop."""

    @property
    def pixel(self) -> float:
        """Size of one desktop pixel at the camera's focus, metres."""
        return 2.0 * VIEW_SLOPE * self.pose.distance * self.ratio / self.size[1]

    def pixel_at(self, points: FloatArray) -> FloatArray:
        """Return the size of one desktop pixel at points, (n, 3) float, metres: (n,) float."""
        return self.pixel * ((self.pose.position - points) @ self.pose.axes[2]) / self.pose.distance

    def on_screen(self, points: FloatArray) -> FloatArray:
        """Return (n, 2) float: pixels of the desktop from the focus to points, (n, 3) float, metres; right and up."""
        return (points - self.pose.focus) @ self.pose.axes[:2].T / self.pixel_at(points)[:, None]

    def is_same(self, other: Viewpoint | None) -> bool:
        if other is None or (self.size, self.ratio, self.pose.distance) != (other.size, other.ratio, other.pose.distance):
            return False
        return np.array_equal(self.pose.axes, other.pose.axes) and np.array_equal(self.pose.focus, other.pose.focus)


def facing(normals: FloatArray, places: FloatArray, position: FloatArray) -> FloatArray:
    """Return (n,) the cosine of the angle between each normal and the way from its place, both (n, 3), to a position."""
    ways = position - places
    return np.einsum("ix,ix->i", normals, ways) / np.linalg.norm(ways, axis=1)


def pose_of(camera: vtkCamera) -> CameraPose:
    """Return the pose of a camera."""
    back = -np.array(camera.GetDirectionOfProjection())
    right: FloatArray = np.cross(camera.GetViewUp(), back)
    right /= np.linalg.norm(right)
    return CameraPose(np.stack([right, np.cross(back, right), back]), np.array(camera.GetFocalPoint()), camera.GetDistance())


def place(camera: vtkCamera, pose: CameraPose) -> None:
    """Move a camera to a pose."""
    camera.SetFocalPoint(*pose.focus)
    camera.SetPosition(*pose.position)
    camera.SetViewUp(*pose.up)
    camera.SetViewAngle(CAMERA_VIEW_ANGLE_DEG)


def fit(points: FloatArray, facing_: FloatArray | None, aspect: float, min_half_height: float) -> CameraPose:
    """Return the pose from which all points are in the picture.

    Parameters
    ----------
    points : (n, 3) float, metres; empty looks at the origin
    facing_ : (3,) float, unit: the side to look at; None for the side across the part's two long axes
    aspect : width over height of the picture
    min_half_height : metres, half the height of the picture at least
    """
    return fit_from(points, *first_frame(points, facing_), aspect, min_half_height)


def fit_from(points: FloatArray, centre: FloatArray, axes: FloatArray, aspect: float, min_half_height: float) -> CameraPose:
    """Return the pose with these axes, (3, 3), that looks at `centre`, (3,), and has all points in the picture; see `fit`."""
    seen = (points - centre) @ axes.T if len(points) else np.zeros((1, 3))
    distances = np.maximum(np.abs(seen[:, 1]), np.abs(seen[:, 0]) / aspect) * VIEW_SIZE_OVER_PART_SIZE / VIEW_SLOPE + seen[:, 2]
    return CameraPose(axes, centre, max(float(distances.max()), min_half_height / VIEW_SLOPE))


def first_frame(points: FloatArray, facing_: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return the middle of the points, and the axes of the pose that `fit` returns."""
    if len(points) < 3:
        return points.mean(axis=0) if len(points) else np.zeros(3), np.eye(3)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    variances, principal = np.linalg.eigh(np.cov(points.T))
    back = principal[:, 0] if facing_ is None else facing_
    # The signs of principal axes mean nothing: fix them, so that the same part is always seen the same way.
    back = back if facing_ is not None else back * np.sign(back[np.argmax(np.abs(back))])
    level = _level(variances, principal, back)
    right: FloatArray = level - float(level @ back) * back
    right /= np.linalg.norm(right)
    return centre, np.stack([right, np.cross(back, right), back])


def _level(variances: FloatArray, principal: FloatArray, back: FloatArray) -> FloatArray:
    """Return the axis that is level in the picture: a long part's long axis, else one that keeps the link's z axis upright."""
    if variances[2] < LONG_PART_MIN_LENGTH_RATIO**2 * variances[1] and abs(float(back[2])) < 0.9:
        return np.cross([0.0, 0.0, 1.0], back)
    along = principal[:, 2] if abs(float(principal[:, 2] @ back)) < 0.9 else principal[:, 1]
    return along * np.sign(along[np.argmax(np.abs(along))])


def long_axis(points: FloatArray) -> FloatArray | None:
    """Return (3,) float, unit: the long axis of a long part, (n, 3) float, which `fit` lays level; None for any other part."""
    if len(points) < 3:
        return None
    variances, principal = np.linalg.eigh(np.cov(points.T))
    return principal[:, 2] if variances[2] >= LONG_PART_MIN_LENGTH_RATIO**2 * variances[1] else None


def rotate(camera: vtkCamera, right_deg: float, up_deg: float) -> None:
    """Rotate the camera around its focus."""
    camera.Azimuth(-right_deg)
    camera.Elevation(-up_deg)
    # VTK's Azimuth turns about the view's up, which Elevation leaves where it was.
    camera.OrthogonalizeViewUp()


def pan(camera: vtkCamera, right: float, up: float) -> None:
    """Move the camera sideways; in heights of the picture."""
    pose = pose_of(camera)
    place(camera, replace(pose, focus=pose.focus - 2 * pose.distance * VIEW_SLOPE * (right * pose.right + up * pose.up)))


def zoom(camera: vtkCamera, factor: float) -> None:
    """Bring the camera `factor` times nearer to its focus."""
    pose = pose_of(camera)
    place(camera, replace(pose, distance=float(np.clip(pose.distance / factor, MIN_DISTANCE, MAX_DISTANCE))))


def is_visible(pose: CameraPose, at: FloatArray, normal: FloatArray, aspect: float) -> bool:
    """Return whether a point of the skin, (3,) with its normal, faces the camera and is in the picture."""
    towards = pose.position - at
    return float(normal @ towards) >= MIN_FACING * float(np.linalg.norm(towards)) and is_inside(pose, at, aspect)


def is_inside(pose: CameraPose, at: FloatArray, aspect: float) -> bool:
    """Return whether a point is well inside a picture of this width over height."""
    away = max(float((pose.position - at) @ pose.axes[2]), MIN_DISTANCE)
    offset = pose.axes[:2] @ (at - pose.focus) / (away * VIEW_SLOPE * np.array([aspect, 1.0]))
    return bool(np.abs(offset).max() <= TARGET_MAX_OFFSET_OVER_HALF_VIEW)


def turn_to(pose: CameraPose, at: FloatArray, normal: FloatArray, aspect: float, level: FloatArray | None) -> CameraPose:
    """Return the nearest pose, at the same distance, that sees a point of the skin; see `is_visible`.

    `level` is (3,) float, unit: the axis that is level in the picture, if any.
    """
    slant = float(np.arccos(np.clip(normal @ pose.axes[2], -1.0, 1.0)))
    if slant > RESIDUAL_TILT:
        axis = np.cross(pose.axes[2], normal)
        # Opposite to each other, they are turned over the upper edge.
        axis = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 1e-9 else pose.right
        pose = replace(pose, axes=_upright(pose.axes, _rotation(axis, slant - RESIDUAL_TILT) @ pose.axes[2], level))
    return pose if is_inside(pose, at, aspect) else replace(pose, focus=at)


def _upright(axes: FloatArray, back: FloatArray, level: FloatArray | None) -> FloatArray:
    """Compute (3, 3) the axes of a camera that looks against `back`: level if possible, else turned least from `axes`."""
    right = np.zeros(3) if level is None else level - float(level @ back) * back
    if float(np.linalg.norm(right)) < MIN_SIN_VIEW_TO_LEVEL_AXIS:
        right = np.cross(axes[1], back)
        if float(np.linalg.norm(right)) < MIN_SIN_VIEW_TO_LEVEL_AXIS:
            right = axes[0] - (axes[0] @ back) * back
    elif float(right @ axes[0]) < 0.0:
        right = -right
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def move_closer(pose: CameraPose, at: FloatArray, height: float) -> CameraPose:
    """Return the pose, moved closer if a ball at a point would be smaller than `MIN_BALL_PX` in a picture so high."""
    away = float((pose.position - at) @ pose.axes[2])
    if ESTIMATE_BALL_DIAMETER_M * height >= MIN_BALL_PX * 2.0 * VIEW_SLOPE * away:
        return pose
    return CameraPose(pose.axes, at, max(MIN_DISTANCE, ESTIMATE_BALL_DIAMETER_M * height / (TARGET_BALL_PX * 2.0 * VIEW_SLOPE)))


def interpolate(start: CameraPose, end: CameraPose, share: float) -> CameraPose:
    """Return the pose at a share of the time: slow at both ends, and around the part if the way is far."""
    eased = share * share * (3.0 - 2.0 * share)
    axis, angle = _axis_and_angle(end.axes.T @ start.axes)
    far = max(0.0, float(np.linalg.norm(end.focus - start.focus)) - min(start.distance, end.distance) / 2.0)
    return CameraPose(
        start.axes @ _rotation(axis, -eased * angle),
        start.focus + eased * (end.focus - start.focus),
        start.distance + eased * (end.distance - start.distance) + 4.0 * eased * (1.0 - eased) * far,
    )


def _axis_and_angle(rotation: FloatArray) -> tuple[FloatArray, float]:
    """Return the axis (3,), unit, and the angle, rad, of a rotation (3, 3)."""
    angle = float(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))
    # The largest column of R + R' + (1 - tr R) I is along the axis, also at half a turn.
    both = rotation + rotation.T + (1.0 - np.trace(rotation)) * np.eye(3)
    axis = both[:, np.linalg.norm(both, axis=0).argmax()]
    size = float(np.linalg.norm(axis))
    axis = axis / size if size > 1e-12 else np.array([0.0, 0.0, 1.0])
    skew = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    # `sign` would give 0 at half a turn, where either direction is right.
    return axis * np.copysign(1.0, axis @ skew), angle


def _rotation(axis: FloatArray, angle: float) -> FloatArray:
    """Return the rotation by `angle`, rad, about `axis`, (3,) float, unit."""
    cross = cross_matrix(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross, dtype=np.float64)


class AutoCamera:
    """Turns a camera to the target; keeps the axis `level`, (3,) float, unit, level in the picture if given."""

    def __init__(self, surface: Surface | None, level: FloatArray | None) -> None:
        self.wanted = True
        self.held = False  # A button of the mouse is down on the picture
        self._surface, self._level = surface, level
        self._touched_s = -np.inf
        self._target: Target | None = None
        self._is_due = False
        self._way: tuple[CameraPose, CameraPose, float] | None = None
        """Start, end, and host time of the start in seconds."""

    def note_manual_move(self, now_s: float) -> None:
        """Stop a turn in progress where it is, and wait."""
        self._touched_s, self._way = now_s, None

    def advance(self, camera: vtkCamera, aspect: float, height: float, state: View3DState, now_s: float) -> bool:
        """Continue a turn of the camera, or begin one; return whether the camera moved.

        `aspect` is the picture's width over its height; `height` is in pixels of the desktop.
        """
        target = state.target if self.wanted else None
        if not _is_same(target, self._target):
            self._is_due, self._way = target is not None, None
        self._target = target
        if target is None:
            return False
        if state.live is not None and state.live.progress.phase in PRESSING_PHASES:
            # After the poke an interrupted turn begins again.
            self._is_due, self._way = self._is_due or self._way is not None, None
            return False
        if self.held or now_s - self._touched_s < PAUSE_AFTER_MANUAL_MOVE_S:
            return False
        if self._is_due:
            self._is_due = False
            start, at = pose_of(camera), point_on_skin(self._surface, target.place, target.normal)
            end = start
            if not is_visible(start, at, target.normal, aspect):
                end = turn_to(start, at, target.normal, aspect, self._level)
            end = move_closer(end, at, height)
            self._way = None if end is start else (start, end, now_s)
        if self._way is None:
            return False
        start, end, begun_s = self._way
        share = min(1.0, (now_s - begun_s) / CAMERA_TURN_DURATION_S)
        place(camera, interpolate(start, end, share))
        if share == 1.0:
            self._way = None
        return True


def _is_same(now: Target | None, before: Target | None) -> bool:
    if now is None or before is None:
        return now is before
    return now.channel == before.channel and np.array_equal(now.place, before.place)
