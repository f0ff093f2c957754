"""Where the camera stands: on the side that carries the skin, the part's long axis level, everything in the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skincal.geometry.arrays import FloatArray

if TYPE_CHECKING:
    from vtkmodules.vtkRenderingCore import vtkCamera

VIEW_ANGLE = 24.0
"""Degrees. Narrow, so that sizes compare across the part, yet wide enough to tell near from far."""
MARGIN = 1.08
"""The part takes this much less than the picture."""
LONG = 2.0
"""A part is long when it spreads this much more along its longest axis than along the next."""
NEAREST, FARTHEST = 0.02, 20.0
"""m. The camera stays between these distances of what it looks at."""
BEFORE = 0.95
"""Of the distance to the nearest point of the part: what is drawn before the part lies there."""
NEAREST_PLANE = 5e-3
"""m. Nothing is brought nearer to the camera: VTK draws from a thousandth of the farthest distance on."""


@dataclass(frozen=True, slots=True, eq=False)
class Eye:
    """What is right and what is up on the screen, (3,) float, unit, link frame."""

    right: FloatArray
    up: FloatArray

    def same(self, other: Eye) -> bool:
        """Return whether a picture drawn for one is right for the other: a hundredth of a radian is not seen."""
        off = np.abs(np.concatenate([self.right - other.right, self.up - other.up]))
        return bool(off.max() < 0.01)


PLAIN = Eye(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
"""While there is no picture yet."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """From where a picture is seen; link frame, metres."""

    place: FloatArray
    """(3,) float: of the camera."""
    towards: FloatArray
    """(3,) float, unit: from the part to the camera."""
    scale: float
    """Pixels a metre, at the distance the camera looks at."""

    def same(self, other: Sight | None) -> bool:
        """Return whether what was laid out for one sight is exact for the other."""
        return (
            other is not None
            and self.scale == other.scale
            and np.array_equal(self.place, other.place)
            and np.array_equal(self.towards, other.towards)
        )

    def lift(self, points: FloatArray, by: float) -> FloatArray:
        """Return (..., 3) points, metres nearer to the camera, half of the way at most; in the picture nothing moves."""
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


def sight_of(camera: vtkCamera, height: int) -> Sight:
    """Return from where a picture `height` pixels high is seen."""
    towards = -np.array(camera.GetDirectionOfProjection())
    return Sight(np.array(camera.GetPosition()), towards, pixels_per_metre(camera, height))


def eye_of(camera: vtkCamera) -> Eye:
    """Return how a camera stands."""
    back, up = -np.array(camera.GetDirectionOfProjection()), np.array(camera.GetViewUp())
    right: FloatArray = np.cross(up, back)
    right /= np.linalg.norm(right)
    return Eye(right, np.cross(back, right))


def fit(camera: vtkCamera, points: FloatArray, facing: FloatArray | None, aspect: float, least: float) -> None:
    """Place the camera so that all points are in the picture.

    Parameters
    ----------
    points : (n, 3) float, metres; empty looks at the origin
    facing : (3,) float, unit: the side to look at; None for the side across the part's two long axes
    aspect : width over height of the picture
    least : metres, half the height of the picture at least
    """
    centre, right, up, back = _frame(points, facing)
    seen = (points - centre) @ np.stack([right, up, back], axis=1) if len(points) else np.zeros((1, 3))
    slope = np.tan(np.radians(VIEW_ANGLE / 2))
    distances = np.maximum(np.abs(seen[:, 1]), np.abs(seen[:, 0]) / aspect) * MARGIN / slope + seen[:, 2]
    camera.SetViewAngle(VIEW_ANGLE)
    camera.SetFocalPoint(*centre)
    camera.SetPosition(*(centre + back * max(float(distances.max()), least / slope)))
    camera.SetViewUp(*up)


def _frame(points: FloatArray, facing: FloatArray | None) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the middle of the points and the camera's right, up and back, unit."""
    if len(points) < 3:
        centre = points.mean(axis=0) if len(points) else np.zeros(3)
        return centre, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, 1.0])
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    variances, principal = np.linalg.eigh(np.cov(points.T))
    back = principal[:, 0] if facing is None else facing
    # The signs of principal axes mean nothing: fix them, so that the same part is always seen the same way.
    back = back if facing is not None else back * np.sign(back[np.argmax(np.abs(back))])
    level = _level(variances, principal, back)
    right: FloatArray = level - float(level @ back) * back
    right /= np.linalg.norm(right)
    up: FloatArray = np.cross(back, right)
    return centre, right, up, back


def _level(variances: FloatArray, principal: FloatArray, back: FloatArray) -> FloatArray:
    """Return what lies level in the picture: a long part's long axis, else what leaves the link's z axis upright."""
    if variances[2] < LONG**2 * variances[1] and abs(float(back[2])) < 0.9:
        return np.cross([0.0, 0.0, 1.0], back)
    along = principal[:, 2] if abs(float(principal[:, 2] @ back)) < 0.9 else principal[:, 1]
    return along * np.sign(along[np.argmax(np.abs(along))])


def level_of(points: FloatArray) -> FloatArray | None:
    """Return (3,) float, unit: the long axis of a long part, which `fit` lays level; None for any other part.

    Parameters
    ----------
    points : (n, 3) float, metres
    """
    if len(points) < 3:
        return None
    variances, principal = np.linalg.eigh(np.cov(points.T))
    return principal[:, 2] if variances[2] >= LONG**2 * variances[1] else None


def orbit(camera: vtkCamera, right: float, up: float) -> None:
    """Turn the camera around what it looks at; degrees."""
    camera.Azimuth(-right)
    camera.Elevation(-up)
    camera.OrthogonalizeViewUp()


def shift(camera: vtkCamera, right: float, up: float) -> None:
    """Move the camera sideways; in heights of the picture."""
    back = np.array(camera.GetDirectionOfProjection()) * -1.0
    upward = np.array(camera.GetViewUp())
    height = 2 * camera.GetDistance() * np.tan(np.radians(camera.GetViewAngle() / 2))
    step = -height * (right * np.cross(upward, back) + up * upward)
    camera.SetPosition(*(np.array(camera.GetPosition()) + step))
    camera.SetFocalPoint(*(np.array(camera.GetFocalPoint()) + step))


def approach(camera: vtkCamera, factor: float) -> None:
    """Bring the camera `factor` times nearer to what it looks at."""
    distance = float(np.clip(camera.GetDistance() / factor, NEAREST, FARTHEST))
    focus, back = np.array(camera.GetFocalPoint()), -np.array(camera.GetDirectionOfProjection())
    camera.SetPosition(*(focus + distance * back))


def pixels_per_metre(camera: vtkCamera, height: int) -> float:
    """Return the scale of a picture `height` pixels high, at the distance the camera looks at."""
    return float(height / (2 * camera.GetDistance() * np.tan(np.radians(camera.GetViewAngle() / 2))))
