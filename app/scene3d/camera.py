"""Camera poses, and the camera that turns to the target.

At first the camera looks at the side with the skin; the part's long axis is along the long side of the picture, and the part
fills it. The camera turns to a new target between pokes if that is turned away. The whole part stays in the picture, unless
its taxels would be dots. Without a target the camera returns to its first view. It waits while a tool presses, and for 3 s
after the operator moved it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from app.scene3d.scene_state import ESTIMATE_BALL_DIAMETER_M
from app.state.camera_pose import CameraPose
from skincal.contacts.outcome import PRESSING_PHASES
from skincal.geometry import FloatArray, cross_matrix
from skincal.mesh.surface import Surface, point_on_skin

if TYPE_CHECKING:
    from vtkmodules.vtkRenderingCore import vtkCamera

    from app.state.view_state import ViewState
    from skincal.guide.guidance import Target

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
CENTRING_STEPS = 6  # Each leaves a tenth of the shift from the picture's middle
REST_DELAY_S = 1.5  # Without a target for so long, the camera returns to the first view
LEVEL_TOLERANCE = 1e-6  # Between axes, unit
SAME_VIEW_ANGLE, SAME_VIEW_SHIFT = float(np.radians(1.0)), 0.02
"""rad between two views, and shift over half the height of the picture, below which the camera stays."""


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


class Framing:
    """Views of a part without roll: the axes of a view follow from its direction alone, and the part fills the picture.

    `points`, (n, 3) float, metres, must all be in the picture; empty looks at the origin. `facing` is the side to look at,
    (3,) float, unit; None for the side across the part's two long axes.
    """

    def __init__(self, points: FloatArray, facing: FloatArray | None = None) -> None:
        self.points = points
        self._front = first_axes(points, facing)
        self._long = long_axis(points)

    def axes(self, back: FloatArray, aspect: float) -> FloatArray:
        """Return the axes, (3, 3) float, rows: right, up and back, of the view against `back`, (3,) float, unit.

        A long part lies along the picture's long side. Another part stands upright, as in the first view.
        """
        return _turned_axes(self._reference(aspect), back, self._row(aspect))

    def kept_axis(self, aspect: float) -> FloatArray:
        """Return the axis of the part, (3,) float, unit, that is level or upright in the views."""
        return self._reference(aspect)[self._row(aspect)]

    @staticmethod
    def is_along(axis: FloatArray, back: FloatArray) -> bool:
        """Return whether a view is so nearly along its kept axis that another one is kept."""
        return float(np.linalg.norm(axis - float(axis @ back) * back)) < MIN_SIN_VIEW_TO_LEVEL_AXIS

    def _row(self, aspect: float) -> int:
        """Return the row of the axis that is kept: 0 for a long part that is level, else 1, upright."""
        return 0 if self._long is not None and aspect >= 1.0 else 1

    def _reference(self, aspect: float) -> FloatArray:
        """Return the axes of the straight first view."""
        right, up, back = self._front
        if self._long is None or aspect >= 1.0:
            return self._front
        # In a high picture the long axis is upright, its upper end the one with the larger z.
        sign = 1.0 if right[2] >= 0.0 else -1.0
        return np.stack([-sign * up, sign * right, back])

    def rest(self, aspect: float, min_half_height: float, lean_deg: tuple[float, float] = (0.0, 0.0)) -> CameraPose:
        """Return the first view of the whole part; `lean_deg` is its deviation to the right and up from straight."""
        right, up, back = self._reference(aspect)
        across, along = np.radians(lean_deg)
        back = _rotation(up, -float(across)) @ _rotation(right, float(along)) @ back
        return fit_from(self.points, self.axes(back, aspect), aspect, min_half_height)

    def whole(self, axes: FloatArray, at: FloatArray, aspect: float, min_half_height: float) -> CameraPose:
        """Return the pose with these axes that shows the whole part and the point `at`, (3,) float, metres."""
        return fit_from(np.concatenate([self.points, at[None]]), axes, aspect, min_half_height)

    def at_distance(self, axes: FloatArray, at: FloatArray, distance: float, aspect: float) -> CameraPose:
        """Return the pose so far from a point, with the point in the picture and as little as possible next to the part."""
        here = axes[:2] @ at
        seen = np.concatenate([self.points @ axes[:2].T, here[None]])
        half = distance * VIEW_SLOPE * np.array([aspect, 1.0])
        # Middles of the pictures that end at the part's ends.
        low = seen.min(axis=0) + (2.0 - VIEW_SIZE_OVER_PART_SIZE) * half
        high = seen.max(axis=0) - (2.0 - VIEW_SIZE_OVER_PART_SIZE) * half
        middle = np.where(low < high, np.clip(here, np.minimum(low, high), np.maximum(low, high)), (low + high) / 2.0)
        return CameraPose(axes, axes.T @ np.array([*middle, float(axes[2] @ at)]), distance)


def fit(points: FloatArray, facing_: FloatArray | None, aspect: float, min_half_height: float) -> CameraPose:
    """Return the pose from which all points are in the picture.

    Parameters
    ----------
    points : (n, 3) float, metres; empty looks at the origin
    facing_ : (3,) float, unit: the side to look at; None for the side across the part's two long axes
    aspect : width over height of the picture
    min_half_height : metres, half the height of the picture at least
    """
    return Framing(points, facing_).rest(aspect, min_half_height)


def fit_from(points: FloatArray, axes: FloatArray, aspect: float, min_half_height: float) -> CameraPose:
    """Return the nearest pose with these axes, (3, 3), whose picture has all points, with equal margins on opposite sides."""
    # One coordinate at a time in one buffer: a sixth of the time of arrays (n, 2), which a large mesh makes felt.
    x, y, z = np.ascontiguousarray((points @ axes.T if len(points) else np.zeros((1, 3))).T)
    slopes = np.array([aspect, 1.0]) * VIEW_SLOPE / VIEW_SIZE_OVER_PART_SIZE
    ahead, behind, buffer = np.empty(2), np.empty(2), np.empty_like(z)
    for side, (along, slope) in enumerate(zip((x, y), slopes, strict=True)):
        # A point is inside the right edge of a camera at (x, d) if its own x + slope z is at most x + slope d; left alike.
        ahead[side] = np.add(along, np.multiply(slope, z, out=buffer), out=buffer).max()
        behind[side] = np.subtract(np.multiply(slope, z, out=buffer), along, out=buffer).max()
    depth = float((z.min() + z.max()) / 2.0)
    distance = max(float(((ahead + behind) / (2.0 * slopes)).max()) - depth, min_half_height / VIEW_SLOPE)
    middle, away = (ahead - behind) / 2.0, np.subtract(distance + depth, z, out=z)
    mean_away = float(away.mean())
    for _ in range(CENTRING_STEPS):
        # Across, where there is room, the ends of the part may be at different depths.
        for side, along in enumerate((x, y)):
            np.divide(np.subtract(along, middle[side], out=buffer), away, out=buffer)
            middle[side] += (buffer.min() + buffer.max()) / 2.0 * mean_away
    return CameraPose(axes, axes.T @ np.array([*middle, depth]), distance)


def _turned_axes(reference: FloatArray, back: FloatArray, row: int) -> FloatArray:
    """Return the axes of a view against `back` that keeps an axis, 0 right or 1 up, of the reference level or upright.

    If the view is along that axis, the other one is kept.
    """
    for kept in (row, 1 - row):
        if kept != row or not Framing.is_along(reference[kept], back):
            axis = reference[kept] - float(reference[kept] @ back) * back
            axis = axis / float(np.linalg.norm(axis))
            right = axis if kept == 0 else np.cross(axis, back)
            return np.stack([right, np.cross(back, right), back])
    raise AssertionError


def first_axes(points: FloatArray, facing_: FloatArray | None) -> FloatArray:
    """Return the axes, (3, 3) float, rows: right, up and back, of the straight first view in a wide picture."""
    if len(points) < 3:
        return np.eye(3)
    variances, principal = np.linalg.eigh(np.cov(points.T))
    back = principal[:, 0] if facing_ is None else facing_
    # The signs of principal axes mean nothing: fix them, so that the same part is always seen the same way.
    back = back if facing_ is not None else back * np.sign(back[np.argmax(np.abs(back))])
    level = _level(variances, principal, back)
    right: FloatArray = level - float(level @ back) * back
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


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


def turned_back(pose: CameraPose, at: FloatArray, normal: FloatArray) -> FloatArray:
    """Return (3,) float, unit: the direction back to a camera, nearest to the present one, that sees a point of the skin.

    It is the present one if that sees the point; see `MIN_FACING`.
    """
    towards = pose.position - at
    if float(normal @ towards) >= MIN_FACING * float(np.linalg.norm(towards)):
        return pose.axes[2]
    slant = float(np.arccos(np.clip(normal @ pose.axes[2], -1.0, 1.0)))
    axis = np.cross(pose.axes[2], normal)
    # Opposite to each other, they are turned over the upper edge.
    axis = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 1e-9 else pose.right
    return _rotation(axis, slant - RESIDUAL_TILT) @ pose.axes[2]


def _ball_px(pose: CameraPose, at: FloatArray, height: float) -> float:
    """Return the diameter of an estimate's ball at a point, in pixels of a picture so high."""
    away = max(float((pose.position - at) @ pose.axes[2]), MIN_DISTANCE)
    return ESTIMATE_BALL_DIAMETER_M * height / (2.0 * VIEW_SLOPE * away)


def is_near(first: CameraPose, second: CameraPose) -> bool:
    """Return whether two poses show nearly the same picture, so that a move between them would only disturb."""
    _, angle = _axis_and_angle(second.axes.T @ first.axes)
    shift = float(np.linalg.norm((second.focus - first.focus) @ first.axes[:2].T))
    size = VIEW_SLOPE * first.distance
    return (
        angle < SAME_VIEW_ANGLE
        and shift < SAME_VIEW_SHIFT * size
        and abs(second.distance - first.distance) < (SAME_VIEW_SHIFT * first.distance)
    )


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


def interpolate_level(start: CameraPose, end: CameraPose, share: float, framing: Framing, aspect: float) -> CameraPose:
    """Return the pose as `interpolate`; between two views without roll, there is none on the way either."""
    pose, kept = interpolate(start, end, share), framing.kept_axis(aspect)
    for each in (start, end):
        is_level = np.allclose(framing.axes(each.axes[2], aspect), each.axes, atol=LEVEL_TOLERANCE)
        if not is_level or framing.is_along(kept, each.axes[2]):
            return pose
    # Around the kept axis and along it, as longitude and latitude: the great circle may lead past the axis.
    eased, heights = share * share * (3.0 - 2.0 * share), [float(each.axes[2] @ kept) for each in (start, end)]
    first, last = (each.axes[2] - height * kept for each, height in zip((start, end), heights, strict=True))
    turn = float(np.arctan2(np.cross(first, last) @ kept, first @ last))
    latitude = float(np.interp(eased, (0.0, 1.0), np.arcsin(np.clip(heights, -1.0, 1.0))))
    level = _rotation(kept, eased * turn) @ first / np.linalg.norm(first)
    return replace(pose, axes=framing.axes(np.cos(latitude) * level + np.sin(latitude) * kept, aspect))


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
    """Turns a camera to the target, with the whole part in the picture; without a target the camera returns to rest.

    After the operator zoomed or moved the picture, their distance is kept until the whole part is shown again.
    """

    def __init__(
        self, surface: Surface | None, framing: Framing, min_half_height: float, lean_deg: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        self.wanted = True
        self.held = False  # A button of the mouse is down on the picture
        self.framing, self.keeps_distance = framing, False
        self._surface, self._min_half_height, self._lean_deg = surface, min_half_height, lean_deg
        self._touched_s = -np.inf
        self._target: Target | None = None
        self._is_due = False
        self._rests_at_s = np.inf  # Host time when the camera returns to rest, s
        self._way: tuple[CameraPose, CameraPose, float] | None = None
        """Start, end, and host time of the start in seconds."""

    def note_manual_move(self, now_s: float, *, keeps_distance: bool = False) -> None:
        """Stop a turn in progress where it is, and wait; a turn later keeps the distance that the operator chose."""
        self._touched_s, self._way, self._rests_at_s = now_s, None, np.inf
        self.keeps_distance = self.keeps_distance or keeps_distance

    def rest(self, aspect: float) -> CameraPose:
        """Return the first view of the whole part, and keep the whole part in the picture from now on."""
        self.keeps_distance, self._rests_at_s = False, np.inf
        return self.framing.rest(aspect, self._min_half_height, self._lean_deg)

    def advance(self, camera: vtkCamera, aspect: float, height: float, state: ViewState, now_s: float) -> bool:
        """Continue a turn of the camera, or begin one; return whether the camera moved.

        `aspect` is the picture's width over its height; `height` is in pixels of the desktop.
        """
        target = state.target if self.wanted else None
        if not _is_same(target, self._target):
            self._is_due, self._way = target is not None, None
            self._rests_at_s = now_s + REST_DELAY_S if target is None and self.wanted else np.inf
        self._target = target
        if state.live.progress.phase in PRESSING_PHASES:
            # After the poke an interrupted turn begins again.
            self._is_due, self._way = self._is_due or (self._way is not None and target is not None), None
            return False
        if self.held or now_s - self._touched_s < PAUSE_AFTER_MANUAL_MOVE_S:
            return False
        end = self._due_pose(pose_of(camera), aspect, height, now_s)
        if end is not None:
            start = pose_of(camera)
            self._way = None if is_near(start, end) else (start, end, now_s)
        if self._way is None:
            return False
        start, end, begun_s = self._way
        share = min(1.0, (now_s - begun_s) / CAMERA_TURN_DURATION_S)
        place(camera, interpolate_level(start, end, share, self.framing, aspect))
        if share == 1.0:
            self._way = None
        return True

    def _due_pose(self, start: CameraPose, aspect: float, height: float, now_s: float) -> CameraPose | None:
        """Return the pose where the camera must be now; `None` if it stays."""
        if self._target is not None and self._is_due:
            self._is_due = False
            return self._pose_for(self._target, start, aspect, height)
        if self._target is None and now_s >= self._rests_at_s and not self.keeps_distance:
            return self.rest(aspect)
        return None

    def _pose_for(self, target: Target, start: CameraPose, aspect: float, height: float) -> CameraPose:
        framing, at = self.framing, point_on_skin(self._surface, target.place, target.normal)
        is_seen = is_visible(start, at, target.normal, aspect) and _ball_px(start, at, height) >= MIN_BALL_PX
        if self.keeps_distance and is_seen:
            return start
        # Also without a turn: a drag by hand may have rolled the picture.
        axes = framing.axes(turned_back(start, at, target.normal), aspect)
        near = max(MIN_DISTANCE, ESTIMATE_BALL_DIAMETER_M * height / (TARGET_BALL_PX * 2.0 * VIEW_SLOPE))
        if self.keeps_distance:
            is_dot = ESTIMATE_BALL_DIAMETER_M * height < MIN_BALL_PX * 2.0 * VIEW_SLOPE * start.distance
            return framing.at_distance(axes, at, near if is_dot else start.distance, aspect)
        whole = framing.whole(axes, at, aspect, self._min_half_height)
        if _ball_px(whole, at, height) >= MIN_BALL_PX:
            return whole
        return start if is_seen else framing.at_distance(axes, at, near, aspect)


def _is_same(now: Target | None, before: Target | None) -> bool:
    if now is None or before is None:
        return now is before
    return now.channel == before.channel and np.array_equal(now.place, before.place)
