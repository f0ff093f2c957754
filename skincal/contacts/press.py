"""The poke in progress: its samples, how still it is held, and how far the arm moves meanwhile.

A press is weighed window by window, each `still_s` long: by the relative spread of its force, and by how far its force axis
travels where the contact is. Only the stillest window is kept, so memory does not grow with the length of a press.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from skincal.contacts.tare import Tare, window_length
from skincal.geometry import FloatArray, axis_point, crossed, length_of, mean_rows
from skincal.model.readings import Sample
from skincal.model.scene import ContactSettings


@dataclass(frozen=True, slots=True, eq=False)
class ArmPose:
    """Pose of the arm at one sample."""

    link_from_sensor: FloatArray | None
    """(4, 4) float, metres; None while unknown."""
    name: str
    angles: FloatArray | None
    """(joints,) float, radians, of the arm's joints as streamed; None without a joint stream."""


def turned(before: ArmPose, now: ArmPose) -> float:
    """Return how far the arm turned between two samples, rad: the largest change of a joint.

    Where joints are not streamed, or another pose was chosen than the one streamed, it is the rotation of the link.
    """
    if before is now:
        return 0.0
    joints, change = 0, 0.0
    if before.angles is not None and now.angles is not None:
        pairs = zip(now.angles.tolist(), before.angles.tolist(), strict=True)
        joints, change = len(now.angles), max((abs(there - here) for there, here in pairs), default=0.0)
    if before.link_from_sensor is now.link_from_sensor or before.link_from_sensor is None or now.link_from_sensor is None:
        return change
    rotation = _rotation(before.link_from_sensor, now.link_from_sensor)
    # Turning joints never rotate the link by more than the sum of their changes: beyond it the pose was chosen anew.
    return rotation if rotation > joints * change + 1e-6 else change


def _rotation(first: FloatArray, second: FloatArray) -> float:
    between = first[:3, :3].T @ second[:3, :3]
    # The angle from sine and cosine together: arccos alone loses half the digits near zero.
    axis = np.array([between[2, 1] - between[1, 2], between[0, 2] - between[2, 0], between[1, 0] - between[0, 1]])
    return float(np.arctan2(np.linalg.norm(axis), np.trace(between) - 1.0))


CONTACT_REACH = 0.1
"""m. The contact lies at most so far along the force axis from its point nearest to the sensor's origin: the radius of a
robot's limb and more."""
# Standard errors by which a travel must exceed its limit: noise alone moves few still presses by more.
_SURE = 2.0


def force_spread(force: FloatArray) -> float:
    """Return the relative spread sd(|f|)/mean(|f|) of `force` (n, 3), N, tared; infinite where the mean is zero."""
    size = np.sqrt(np.einsum("ni,ni->n", force, force))
    mean = mean_rows(size)
    off = size - mean
    return math.sqrt(mean_rows(off * off)) / float(mean) if mean > 0.0 else float("inf")


def still_share(force: FloatArray, limit: float) -> int:
    """Return the largest k so that the last k samples, and any fewer of them, have a spread of at most `limit`.

    Force is (n, 3), N, tared; the limit is relative, as for `force_spread`.
    """
    size = np.sqrt(np.einsum("ni,ni->n", force, force))[::-1]
    counts = np.arange(1, len(size) + 1)
    mean = size.cumsum() / counts
    # The difference of two large numbers may come out below zero.
    variance = np.maximum((size * size).cumsum() / counts - mean * mean, 0.0)
    moving = np.sqrt(variance) > limit * mean
    first = int(moving.argmax())
    return first if moving[first] else len(size)


def axis_travel(force: FloatArray, moment: FloatArray, times_s: FloatArray) -> float:
    """Return how far the force axis travels, metres, straight and beyond the noise, where the contact is.

    The axis of sample i passes the point c(lambda) of the mean axis at the distance d_i = f_i x (f_i x c + m_i)/|f_i|^2. A
    hand that only tilts turns the axis about the contact, so lambda is taken where the d_i are smallest, within
    `CONTACT_REACH` of the point nearest to the sensor. The travel is the straight line through the d_i over the window,
    less two standard errors. Force and moment are (n, 3), N and N m, tared, sensor frame; n >= 3; `times_s` is (n,), s.
    """
    mean_force = mean_rows(force)
    along = mean_force / length_of(mean_force)
    start = axis_point(mean_force, mean_rows(moment))
    square = np.einsum("ni,ni->n", force, force)[:, None]
    offset = crossed(force, crossed(force, start) + moment) / square
    sideways = along - force * (force @ along)[:, None] / square
    weight = float(np.add.reduce(sideways * sideways, axis=None))
    # Below this the axes are parallel to rounding: every lambda is as good.
    shift = float(np.add.reduce(offset * sideways, axis=None)) / weight if weight > 1e-12 * len(force) else 0.0
    offset = offset - min(max(shift, -CONTACT_REACH), CONTACT_REACH) * sideways
    return _straight_travel(offset, times_s)


def _straight_travel(offset: FloatArray, times_s: FloatArray) -> float:
    time = times_s - mean_rows(times_s)
    square = float(time @ time)
    slope = time @ offset / square
    rest = offset - mean_rows(offset) - time[:, None] * slope
    span = float(times_s[-1] - times_s[0])
    error = math.sqrt(np.add.reduce(rest * rest, axis=None) / (len(time) - 2) / square) * span
    return max(0.0, length_of(slope) * span - _SURE * error)


@dataclass(frozen=True, slots=True, eq=False)
class StillWindow:
    """The stillest `still_s` of a press, raw."""

    samples: tuple[Sample, ...]
    poses: tuple[ArmPose, ...]
    spread: float
    """1, relative spread of the force."""
    travel: float
    """m, travel of the force axis."""
    rank: tuple[float, float, float, float]
    """Smaller is better: 1 outside the force window; the spread in shares of its limit where it is beyond it, so that a slide
    or a hard hold is not hidden in a ramp; how far outside (N); the worse of spread and travel in shares of their limits."""

    @property
    def good(self) -> bool:
        """In the force window, and still."""
        outside, _, _, share = self.rank
        return outside == 0.0 and share <= 1.0


class Press:
    """A poke from its touch to its release.

    `start` is the first sample above `touch_force`, and `pose` the arm's there; samples are `period_s` apart. It is judged by
    the `settings` that hold as it begins, whatever is changed later.
    """

    def __init__(self, settings: ContactSettings, tare: Tare, start: Sample, pose: ArmPose, period_s: float) -> None:
        self.tare = tare
        self.start_s = start.host_s
        self.end_s = start.host_s
        self.pose = pose
        self.peak = 0.0
        """N, largest tared force so far."""
        self.saturated = 0
        """Samples in which a reading was saturated or invalid."""
        self.gap_s = 0.0
        """s, longest hole in the samples."""
        self.moved = 0.0
        """rad, how far the arm moved."""
        self.best: StillWindow | None = None
        # None where it is not asked for yet.
        self._still: float | None = 0.0
        self.force = np.zeros(3)
        self.settings = settings
        self._length = window_length(settings.still_s, period_s)
        self._window: deque[tuple[Sample, ArmPose]] = deque(maxlen=self._length)
        # (m, 6) tared wrenches: the last are those of the window, and room is left for more.
        self._wrenches, self._end = np.empty((4 * self._length, 6)), 0

    @property
    def held(self) -> bool:
        """A window is still and in the force window: the operator may release."""
        return self.best is not None and self.best.good

    @property
    def still(self) -> float:
        """Share of the still window that is filled, 0 to 1."""
        if self._still is None:
            force = self._wrenches[self._end - len(self._window) : self._end, :3]
            self._still = still_share(force, self.settings.still_change) / self._length
        return self._still

    @property
    def steady(self) -> bool:
        """The force has the same size over the last `still_s`."""
        return self.still >= 1.0

    @property
    def latest(self) -> tuple[tuple[Sample, ArmPose], ...]:
        """The samples of the last `still_s`, or fewer at the beginning."""
        return tuple(self._window)

    def add(self, sample: Sample, pose: ArmPose) -> None:
        """Take one sample of the press."""
        self.end_s = sample.host_s
        if sample.saturated:
            # Its force is not known, and a still window must not reach across it.
            self.saturated += 1
            self._still = 0.0
            self._window.clear()
            return
        wrench = self._append(sample, pose)
        self.force = wrench[-1, :3]
        self.peak = max(self.peak, length_of(self.force))
        self._still = None
        if len(self._window) == self._length:
            self._weigh(wrench)

    def _append(self, sample: Sample, pose: ArmPose) -> FloatArray:
        """Put a sample into the window, and return its tared wrenches (n, 6)."""
        if self._end == len(self._wrenches):
            self._wrenches[: self._length] = self._wrenches[-self._length :]
            self._end = self._length
        self._wrenches[self._end] = sample.wrench - self.tare.wrench
        self._end += 1
        self._window.append((sample, pose))
        return self._wrenches[self._end - len(self._window) : self._end]

    def lose(self, gap_s: float) -> None:
        """Note a hole in the samples; a still window does not reach across it."""
        self.gap_s = max(self.gap_s, gap_s)
        # What was still stays so until the next sample.
        self._still = self.still
        self._window.clear()

    def _weigh(self, wrench: FloatArray) -> None:
        """Keep the window that ends now if it is better than the best so far."""
        settings = self.settings
        force = wrench[:, :3]
        size = length_of(mean_rows(force))
        outside = max(0.0, settings.force_min - size, size - settings.force_max)
        spread = force_spread(force)
        share = spread / settings.still_change
        best = self.best
        first = (float(outside > 0.0), max(share, 1.0), outside)
        if best is not None and (*first, share) >= best.rank:
            return  # the travel can only make it worse
        times = np.array([item.host_s for item, _ in self._window])
        travel = axis_travel(force, wrench[:, 3:], times)
        rank = (*first, max(share, travel / settings.slide_max))
        if best is None or rank < best.rank:
            samples, poses = zip(*self._window, strict=True)
            self.best = StillWindow(samples, poses, spread, travel, rank)
