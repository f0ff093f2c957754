"""The poke in progress: its samples, its stillest window, and the rotation of the arm during it.

Each window of `still_s` is ranked by the relative spread of its force and by the slide of its force axis at the contact.
Only the stillest window is kept, so memory does not grow with the length of a press.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skincal.contacts.tare import Tare, mean_time, window_length
from skincal.geometry import FloatArray, IntArray, axis_point, crossed, inverse_pose, length_of, mean_rows, move_wrench
from skincal.model.codec import OPTIONAL_FIELD
from skincal.model.readings import Sample
from skincal.model.scene import ContactSettings


@dataclass(frozen=True, slots=True, eq=False)
class ArmPose:
    """Pose of the arm at one sample."""

    link_from_sensor: FloatArray | None
    """(4, 4) float, metres; `None` while unknown."""
    name: str
    angles: FloatArray | None
    """(joints,) float, radians, of the arm's joints as streamed; `None` without a joint stream."""


def arm_turn_between(before: ArmPose, now: ArmPose) -> float:
    """Compute the rotation of the arm between two samples, rad: the largest change of a joint.

    If joints are not streamed, or the operator chose a different pose, it is the rotation angle of the link.
    """
    if before is now:
        return 0.0
    joints, change = 0, 0.0
    if before.angles is not None and now.angles is not None:
        pairs = zip(now.angles.tolist(), before.angles.tolist(), strict=True)
        joints, change = len(now.angles), max((abs(there - here) for there, here in pairs), default=0.0)
    if before.link_from_sensor is now.link_from_sensor or before.link_from_sensor is None or now.link_from_sensor is None:
        return change
    between = before.link_from_sensor[:3, :3].T @ now.link_from_sensor[:3, :3]
    # From sine and cosine: arccos alone loses half the digits near zero.
    axis = np.array([between[2, 1] - between[1, 2], between[0, 2] - between[2, 0], between[1, 0] - between[0, 1]])
    rotation = float(np.arctan2(np.linalg.norm(axis), np.trace(between) - 1.0))
    # Turning joints never rotate the link by more than the sum of their changes: a larger rotation is another chosen pose.
    return rotation if rotation > joints * change + 1e-6 else change


MAX_CONTACT_DISTANCE_ALONG_AXIS_M = 0.1
"""m. Largest distance of the contact, along the force axis, from the axis point nearest to the sensor's origin: more than the
radius of a robot's limb."""
TOOL_MAX_LENGTH_M = 0.5
"""m. Largest distance of the contact from a sensor on the tool, along the force axis."""
AT_TOP_MIN_SHARE_OF_SAMPLES = 0.5
"""A taxel whose noise reaches the end of the range now and then is below it."""
_TRAVEL_NOISE_STD_ERRORS = 2.0
"""Standard errors that are subtracted from a slide, so that noise alone exceeds the limit in few still presses."""


def _seen_from_middle(wrench: FloatArray, poses: Sequence[ArmPose]) -> tuple[FloatArray, FloatArray]:
    """Move wrenches (n, 6) of a moving sensor into its frame at the middle sample; forces and moments, (n, 3) each."""
    known = [pose.link_from_sensor for pose in poses]
    middle = known[len(known) // 2]
    if middle is None or any(pose is None for pose in known):
        return wrench[:, :3], wrench[:, 3:]
    back = inverse_pose(middle)
    moved = np.array([back @ pose for pose in known if pose is not None])
    return move_wrench(moved, wrench[:, :3], wrench[:, 3:])


def force_spread(force: FloatArray) -> float:
    """Compute the relative spread sd(|f|)/mean(|f|) of `force` (n, 3), N, tared; infinite if the mean is zero."""
    size = np.sqrt(np.einsum("ni,ni->n", force, force))
    mean = mean_rows(size)
    off = size - mean
    return math.sqrt(mean_rows(off * off)) / float(mean) if mean > 0.0 else float("inf")


def still_share(force: FloatArray, limit: float) -> int:
    """Count the newest samples that are still: the largest k for which the last 1, 2, ... k samples have a spread <= `limit`.

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


def axis_slide(
    force: FloatArray, moment: FloatArray, times_s: FloatArray, max_along_m: float = MAX_CONTACT_DISTANCE_ALONG_AXIS_M
) -> float:
    """Compute the slide of the force axis at the contact, metres, less two standard errors of noise.

    The axis of sample i passes the point c(lambda) of the mean axis at the distance d_i = f_i x (f_i x c + m_i)/|f_i|^2. A
    hand that only tilts turns the axis about the contact. So lambda is the one with the smallest d_i, within
    `max_along_m` of the point nearest to the sensor. The slide is the slope of a straight line through
    the d_i times the window's length. Force and moment are (n, 3), N and N m, tared, sensor frame; n >= 3; `times_s` is (n,),
    s.
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
    offset = offset - min(max(shift, -max_along_m), max_along_m) * sideways
    return _straight_slide(offset, times_s)


def _straight_slide(offset: FloatArray, times_s: FloatArray) -> float:
    time = times_s - mean_rows(times_s)
    square = float(time @ time)
    slope = time @ offset / square
    rest = offset - mean_rows(offset) - time[:, None] * slope
    span = float(times_s[-1] - times_s[0])
    error = math.sqrt(np.add.reduce(rest * rest, axis=None) / (len(time) - 2) / square) * span
    return max(0.0, length_of(slope) * span - _TRAVEL_NOISE_STD_ERRORS * error)


@dataclass(frozen=True, slots=True, eq=False)
class StillMean:
    """Means of a still window, not tared."""

    start_s: float
    end_s: float
    time_s: float
    """Mean time of the samples."""
    wrench: FloatArray
    """(6,) float, N and N m, sensor frame."""
    link_from_sensor: FloatArray | None
    """(4, 4) float, metres: pose of the window's middle sample."""
    pose: str
    spread: float
    """1, relative spread of the force."""
    slide: float
    """m, slide of the force axis at the contact."""
    tip: FloatArray | None = field(default=None, metadata=OPTIONAL_FIELD)
    """(3,) float, metres, fixed frame: mean position of the tip; `None` unless all its samples have one."""


@dataclass(frozen=True, slots=True, eq=False)
class LateAngles:
    """Angles, or pose of the tool, of a poke that came long before it: arm or tool may have moved since then."""

    angles: FloatArray
    """(joints,) float, radians, of the arm's joints; empty for a tool."""
    angles_s: float
    """Host's clock at their reading, seconds."""
    age_s: float
    """s, their age in the still window, or at the end of a press without one."""
    max_age_s: float
    """s, the limit of the age."""
    moved: bool = False
    """The next angles differ."""


def taxels_at_top(frames: FloatArray, answering: IntArray, polarity: int) -> tuple[float, IntArray]:
    """Find the value of the `answering` taxels in `frames` (n, channels) that is farthest in the direction of a press.

    Returns it, NaN without a taxel, and the taxels that keep it.
    """
    values = polarity * frames[:, answering]
    top = float(np.fmax.reduce(values, axis=None, initial=-math.inf))
    if not math.isfinite(top):
        return math.nan, answering[:0]
    share = np.count_nonzero(values == top, axis=0) / len(values)
    return polarity * top, answering[share >= AT_TOP_MIN_SHARE_OF_SAMPLES]


@dataclass(frozen=True, slots=True, eq=False)
class FinishedPress:
    """Summary of a press after its release: small, and enough to judge it again."""

    number: int
    start_s: float
    end_s: float
    period_s: float
    """s, time between samples."""
    peak: float
    """N, largest force."""
    saturated: int
    """Samples with a saturated or invalid reading."""
    gap_s: float
    """s, longest gap between two samples."""
    moved: float
    """rad, rotation of the arm."""
    before: Tare
    still: StillMean | None
    """`None` if no still window has all its samples."""
    channels: IntArray
    """(k,) every channel that answered, ascending."""
    responses: FloatArray
    """(k,) float, raw units above the baseline."""
    largest: float = math.nan
    """Response of the channel closest to its threshold, raw units. NaN if a channel answered."""
    needed: float = math.nan
    """Threshold of that channel, raw units."""
    thresholds: ContactSettings | None = None
    """Thresholds at the touch; `None` for the scene's."""
    vectors: FloatArray | None = field(default=None, metadata=OPTIONAL_FIELD)
    """(k, 3) float, raw units above the baseline, as in `Contact`; `None` for a skin of one axis."""
    late: LateAngles | None = field(default=None, metadata={"stored": False})
    """Angles that are too old; `None` if they came in time, or are those that came after the poke as well."""
    skin: FloatArray = field(default_factory=lambda: np.empty(0), metadata={"stored": False})
    """(values,) float, raw, mean of the still window; empty without one, and in a press that was read from a journal."""
    limit: FloatArray = field(default_factory=lambda: np.empty(0), metadata={"stored": False})
    """(channels,) float, raw units: response above which each channel answers; empty as `skin`."""
    top: float = field(default=math.nan, metadata={"stored": False})
    """Raw, value of the still window that is farthest in the direction of a press; NaN if no taxel answered."""
    at_top: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64), metadata={"stored": False})
    """Taxels that answered and had this value in `AT_TOP_MIN_SHARE_OF_SAMPLES` of the window."""
    in_row: int = field(default=0, metadata={"stored": False})
    """Most samples without a break in it, up to those of a still window."""
    unplaced: int = field(default=0, metadata={"stored": False})
    """Samples without a pose of the tool, in a press without a force sensor."""
    drifted: bool = field(default=False, metadata={"stored": False})
    """Its answers are measured from rest values that drift."""

    def with_answers(self, responses: FloatArray, candidates: IntArray, vectors: FloatArray | None = None) -> FinishedPress:
        """Replace the answers by the (channels,) `responses`, raw units; `candidates` are the (c,) channels that are taxels.

        `vectors` are (channels, 3), raw units; `None` for a skin of one axis.
        """
        channels = candidates[(responses > self.limit)[candidates]]  # NaN is not above
        largest, needed = math.nan, math.nan
        if not len(channels):
            largest, needed = _closest_to_limit(responses[candidates], self.limit[candidates])
        at_top = self.at_top[np.isin(self.at_top, channels)]
        answered = replace(
            self, channels=channels, responses=responses[channels], largest=largest, needed=needed, at_top=at_top
        )
        return answered if vectors is None else replace(answered, vectors=vectors[channels])

    def without_frames(self) -> FinishedPress:
        """Leave out the frames: a session may keep thousands of presses."""
        return replace(self, skin=np.empty(0), limit=np.empty(0))


def _closest_to_limit(response: FloatArray, limit: FloatArray) -> tuple[float, float]:
    """Find the channel closest to its limit, of (c,) raw units each: its response and limit, NaN if all are unknown.

    If one fell by more than its limit, it is the one that fell most: the skin's polarity may be wrong.
    """
    share = np.where(np.isfinite(response), response / limit, np.nan)
    if np.isnan(share).all():
        return math.nan, math.nan
    nearest = int(np.nanargmin(share) if np.nanmin(share) < -1.0 else np.nanargmax(share))
    return float(response[nearest]), float(limit[nearest])


class Press:
    """A poke from its touch to its release.

    `start` is the first sample above `touch_force`, and `pose` the arm's pose there; samples are `period_s` apart. The
    `settings` at the touch hold for the whole press.
    """

    def __init__(self, settings: ContactSettings, tare: Tare, start: Sample, pose: ArmPose, period_s: float) -> None:
        self.settings = settings
        self.tare = tare
        self.start_s = self.end_s = start.host_s
        self.pose = pose
        self.peak = 0.0
        """N, largest tared force so far."""
        self.saturated = 0
        """Samples with a saturated or invalid reading."""
        self.gap_s = 0.0
        """s, longest gap between samples."""
        self.moved = 0.0
        """rad, largest rotation of the arm so far."""
        self.best: StillMean | None = None
        """The stillest window so far."""
        self.best_skin: FloatArray = np.empty(0)
        """(values,) float, raw, its mean skin frame."""
        self.best_frames: FloatArray = np.empty((0, 0))
        """(n, values) float, raw, its skin frames."""
        self.in_row, self.unplaced = 0, 0
        """As of `FinishedPress`."""
        self.late: LateAngles | None = None
        """Angles of the stillest window, if they came long before it."""
        # Sort key, smaller is better: 1 if the force is outside its range; spread/limit if above 1; distance to the force range
        # in N; the larger of spread and slide as fractions of their limits. So a slide or a hard hold is not hidden in a ramp.
        self._best_rank: tuple[float, float, float, float] = (math.inf, 0.0, 0.0, math.inf)
        self.still = 0.0
        """Share of the still window that is filled, 0 to 1."""
        self.force = np.zeros(3)
        self._length = window_length(settings.still_s, period_s)
        self._window: deque[tuple[Sample, ArmPose]] = deque(maxlen=self._length)
        self._wrenches, self._end = np.empty((2 * self._length, len(start.wrench))), 0
        """Wrenches of the newest samples, before row `_end`, as sent: those of the window are one slice."""

    @property
    def may_release(self) -> bool:
        """A window was still and in the force range: the operator may release."""
        return self._best_rank[0] == 0.0 and self._best_rank[3] <= 1.0

    @property
    def is_steady(self) -> bool:
        """The force kept its size over the last `still_s`."""
        return self.still >= 1.0

    @property
    def latest(self) -> tuple[tuple[Sample, ArmPose], ...]:
        """Samples of the last `still_s`, or fewer at the beginning."""
        return tuple(self._window)

    def note_pose(self, pose: ArmPose) -> float:
        """Note the arm's pose; return its rotation since the touch, rad."""
        turn = arm_turn_between(self.pose, pose)
        self.moved = max(self.moved, turn)
        return turn

    def note_gap(self, gap_s: float) -> None:
        """Note a gap in the samples; no still window reaches across it."""
        self.gap_s = max(self.gap_s, gap_s)
        self._window.clear()

    def add(self, sample: Sample, pose: ArmPose) -> None:
        """Take one sample of the press."""
        self.end_s = sample.host_s
        if sample.saturated:
            # Its force is not known, and a still window must not reach across it.
            self.saturated += 1
            self.still = 0.0
            self._window.clear()
            return
        self._append(sample, pose)
        wrench = self._wrenches[self._end - len(self._window) : self._end] - self.tare.wrench
        self.force = wrench[-1, :3]
        self.peak = max(self.peak, length_of(self.force))
        self.still = still_share(wrench[:, :3], self.settings.still_change) / self._length
        if len(self._window) == self._length:
            self._rank_window(wrench)

    def _append(self, sample: Sample, pose: ArmPose) -> None:
        self._window.append((sample, pose))
        if self._end == len(self._wrenches):
            self._end = self._length - 1
            self._wrenches[: self._end] = self._wrenches[len(self._wrenches) - self._end :]
        self._wrenches[self._end] = sample.wrench
        self._end += 1
        self.in_row = max(self.in_row, len(self._window))

    def _rank_window(self, wrench: FloatArray) -> None:
        """Keep the window that ends now, tared wrenches (n, 6), if it is better than the best so far."""
        settings, force = self.settings, wrench[:, :3]
        size = length_of(mean_rows(force))
        outside = max(0.0, settings.force_min - size, size - settings.force_max)
        spread = force_spread(force)
        share = spread / settings.still_change
        first = (float(outside > 0.0), max(share, 1.0), outside)
        if (*first, share) >= self._best_rank:
            return  # the slide can only make it worse
        times_s = np.array([item.host_s for item, _ in self._window])
        if self._window[0][0].tool is None:
            slide = axis_slide(force, wrench[:, 3:], times_s)
        else:
            # The contact stays at the tip in a sensor on the tool: it moves with the tool only.
            slide = axis_slide(*_seen_from_middle(wrench, [pose for _, pose in self._window]), times_s, TOOL_MAX_LENGTH_M)
        rank = (*first, max(share, slide / settings.slide_max))
        if rank >= self._best_rank:
            return
        samples = [sample for sample, _ in self._window]
        wrench = np.array([sample.wrench for sample in samples]).mean(axis=0)
        self._keep_window(rank, wrench, self._middle_pose.link_from_sensor, spread=spread, slide=slide, tip=_mean_tip(samples))

    @property
    def _middle_pose(self) -> ArmPose:
        """Pose of the arm in the middle of the window: it hardly moves meanwhile."""
        return self._window[len(self._window) // 2][1]

    def _keep_window(
        self,
        rank: tuple[float, float, float, float],
        wrench: FloatArray,
        link_from_sensor: FloatArray | None,
        *,
        spread: float,
        slide: float,
        tip: FloatArray | None,
    ) -> None:
        """Keep the window that ends now as the best so far; the parameters are fields of `StillMean`."""
        self._best_rank = rank
        samples, poses = zip(*self._window, strict=True)
        self.best_frames = np.stack([sample.skin for sample in samples])
        self.best_skin = self.best_frames.mean(axis=0)
        self.late = late_angles(samples, poses)
        self.best = StillMean(
            start_s=samples[0].host_s,
            end_s=samples[-1].host_s,
            time_s=mean_time(samples),
            wrench=wrench,
            link_from_sensor=link_from_sensor,
            pose=self._middle_pose.name,
            spread=spread,
            slide=slide,
            tip=tip,
        )


def late_angles(samples: Sequence[Sample], poses: Sequence[ArmPose]) -> LateAngles | None:
    """Find the oldest angles or pose of the tool of some samples that came too long before; `None` if there are none."""
    tool = next((item for item in samples if item.has_late_tool), None)
    if tool is not None and tool.tool is not None:
        # A tool rarely rests so exactly that its next pose would show it.
        age_s, max_age_s = tool.host_s - tool.tool.host_s, tool.tool.max_age_s
        return LateAngles(np.empty(0), tool.tool.host_s, age_s, max_age_s, moved=True)
    late = [(item.angles_s, item, pose.angles) for item, pose in zip(samples, poses, strict=True) if item.has_late_angles]
    if not late:
        return None
    angles_s, item, angles = late[-1]
    return None if angles is None else LateAngles(angles, angles_s, item.angles_age_s, item.angles_max_age_s)


def _mean_tip(samples: Sequence[Sample]) -> FloatArray | None:
    tips = [sample.tip for sample in samples if sample.tip is not None]
    return np.array(tips).mean(axis=0) if len(tips) == len(samples) else None
