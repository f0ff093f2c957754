"""Pairs each skin frame with the wrench that acted while it was taken.

A frame's stamp ends its interval: the wrench of a frame is the mean of the readings in the interval of one frame period up to
the stamp. So no reading from after the frame is needed, and the means of neighbouring frames share no reading. If the wrench
is slower than the skin and no reading falls into an interval, the wrench at its middle is interpolated. A frame waits until
the wrench stream has passed its stamp. A frame that waited too long is counted and left out.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skincal.devices.decoding import WRENCH_VALUES
from skincal.geometry import FloatArray, length_of, mean_rows, pose_between
from skincal.model.readings import Batch, Loss, Sample, ToolReading
from skincal.streams.intervals import usual_interval

FRAME_MAX_WAIT_FOR_WRENCH_S = 0.25
"""s. How long a frame waits for the wrench: longer than any adapter holds bytes back, short enough for a live picture."""
INTERVALS_PER_MEDIAN_FRAME_PERIOD = 15
"""The frame period is the median of this many intervals: lost frames and a jumpy clock do not move it."""
INITIAL_FRAME_PERIOD_S = 0.02
"""s. Period of the first frame, when no interval is known: skins send 50 frames a second."""
MAX_INTERPOLATED_GAP_S = 0.05
"""s. Readings further apart are not interpolated: twice the period of a sensor at 50 Hz with one reading lost, and a bit."""
TIME_STAMP_TOLERANCE_S = 1e-6
"""s. A reading this little after an edge counts as on it: stamps are rounded to the microsecond by the devices."""
MAX_FRAMES_WAITING_FOR_WRENCH = 4096
"""Largest number of waiting frames, independent of their stamps: a bound for memory."""
MAX_STORED_JOINT_READINGS = 512
LATE_ANGLES_MIN_PERIODS, LATE_ANGLES_MIN_S = 5.0, 0.5
"""Angles that are older than both belong to no skin frame for certain: the arm may have moved since then."""
LATE_TOOL_MIN_PERIODS, LATE_TOOL_MIN_S = 5.0, 0.1
"""A pose of the tool that is older than both belongs to no skin frame for certain: a robot moves by centimetres meanwhile."""
POSE_CHANGE_MIN_M = 0.0005
"""m from one pose of the tool to the next, from which it counts as moving."""
POSE_CHANGES_FOR_MEDIAN, POSE_CHANGES_KEPT = 20, 100
"""Changes of the pose of a moving tool from which their period is told, and that are kept."""
TIP_MAX_AGE_S = 0.2
"""s. An older position of the tip does not belong to a skin frame: it moves by millimetres in that time."""
MAX_STORED_WRENCHES = 16384
"""10 s at 1.6 kHz."""


class _Frame(NamedTuple):
    host_s: float
    arrival_s: float
    period_s: float
    values: FloatArray


class Pairing:
    """Brings wrench and joint angles to the instants of the skin frames. Stamps of each stream must ascend."""

    def __init__(self) -> None:
        self.ring = WrenchRing(MAX_STORED_WRENCHES)
        self.counts: Counter[Loss] = Counter()
        """Frames left out: LATE and UNPAIRED."""
        self._waiting: deque[_Frame] = deque()
        self._intervals: deque[float] = deque(maxlen=INTERVALS_PER_MEDIAN_FRAME_PERIOD)
        self._last_frame_s: float | None = None
        self._joints: deque[tuple[float, FloatArray]] = deque(maxlen=MAX_STORED_JOINT_READINGS)
        self._joint_intervals: deque[float] = deque(maxlen=INTERVALS_PER_MEDIAN_FRAME_PERIOD)
        self._last_joints_s: float | None = None
        self._tools: deque[ToolReading] = deque(maxlen=MAX_STORED_JOINT_READINGS)
        self.tool_delay_s = 0.0
        """s. Poses of the tool are taken to be from this much before their stamps."""
        self._pose_changes: deque[float] = deque(maxlen=POSE_CHANGES_KEPT)
        self._changed_pose: ToolReading | None = None
        self._tool_intervals: deque[float] = deque(maxlen=INTERVALS_PER_MEDIAN_FRAME_PERIOD)
        self._tips: deque[tuple[float, FloatArray]] = deque(maxlen=MAX_STORED_JOINT_READINGS)

    @property
    def is_waiting(self) -> bool:
        """Whether a frame waits for its wrench."""
        return bool(self._waiting)

    def add_wrench(self, host_s: FloatArray, batch: Batch) -> None:
        """Add wrench readings. Readings that are not finite or not valid enter no mean."""
        self.ring.append(host_s, *_wrench_columns(batch))

    def hold_wrench(self, host_s: FloatArray, batch: Batch) -> bool:
        """Store wrench readings that `WrenchRing.release` adds part by part; return whether there is room."""
        return self.ring.hold(host_s, *_wrench_columns(batch))

    def add_joints(self, host_s: float, angles: FloatArray) -> None:
        """Add joint angles, radians."""
        if self._last_joints_s is not None:
            self._joint_intervals.append(host_s - self._last_joints_s)
        self._last_joints_s = host_s
        self._joints.append((host_s, angles))

    def add_tip(self, host_s: float, position: FloatArray) -> None:
        """Add a position of the tip, (3,) float, metres."""
        self._tips.append((host_s, position))

    def add_tool(self, host_s: float, rows: FloatArray) -> None:
        """Add a pose of the tool by its upper three rows, (12,) float, metres."""
        pose = np.eye(4)
        pose[:3] = rows.reshape(3, 4)
        max_age_s = LATE_TOOL_MIN_S
        if self._tools:
            self._tool_intervals.append(host_s - self._tools[-1].host_s)
            max_age_s = max(LATE_TOOL_MIN_S, LATE_TOOL_MIN_PERIODS * median(self._tool_intervals))
        self._note_change(reading := ToolReading(host_s, pose, max_age_s))
        self._tools.append(reading)

    def _note_change(self, reading: ToolReading) -> None:
        """Note the time since the pose of a moving tool changed last."""
        before = self._changed_pose
        if before is None:
            self._changed_pose = reading
            return
        step = reading.base_from_tool[:3] - before.base_from_tool[:3]
        if not step.any():
            return
        if length_of(step[:, 3]) >= POSE_CHANGE_MIN_M:
            self._pose_changes.append(reading.host_s - before.host_s)
        self._changed_pose = reading

    @property
    def tool_change_s(self) -> float:
        """Median time, s, from one pose of the moving tool to the next different one; NaN with few of them."""
        return median(self._pose_changes) if len(self._pose_changes) >= POSE_CHANGES_FOR_MEDIAN else math.nan

    def add_frame(self, host_s: float, arrival_s: float, values: FloatArray) -> None:
        """Add a skin frame, which `pop_paired` returns once its wrench is known."""
        if self._last_frame_s is not None:
            self._intervals.append(host_s - self._last_frame_s)
        self._last_frame_s = host_s
        period_s = usual_interval(self._intervals) if self._intervals else INITIAL_FRAME_PERIOD_S
        self._waiting.append(_Frame(host_s, arrival_s, period_s, values))
        if len(self._waiting) > MAX_FRAMES_WAITING_FOR_WRENCH:
            self._waiting.popleft()
            self.counts[Loss.UNPAIRED] += 1

    def pop_paired(self, now_s: float) -> list[Sample]:
        """Return the frames whose wrench is known at `now_s`, in order; count those that waited too long."""
        samples: list[Sample] = []
        while self._waiting:
            frame = self._waiting[0]
            if self._tools and self._waits_for_tool(frame, now_s):
                break
            sample = self._pair(frame) if self.ring.newest_s >= frame.host_s else None
            if sample is not None:
                samples.append(sample)
            elif self.ring.is_older_than_kept(frame.host_s - frame.period_s):
                self.counts[Loss.LATE] += 1
            elif now_s - max(frame.host_s, frame.arrival_s) > FRAME_MAX_WAIT_FOR_WRENCH_S:
                self.counts[Loss.UNPAIRED] += 1
            else:
                break
            self._waiting.popleft()
        return samples

    def _pair(self, frame: _Frame) -> Sample | None:
        begin_s = frame.host_s - frame.period_s
        if self.ring.is_older_than_kept(begin_s):
            return None
        among = self.ring.between(begin_s + TIME_STAMP_TOLERANCE_S, frame.host_s + TIME_STAMP_TOLERANCE_S)
        wrench, readings = self.ring.mean(among)
        if not readings:
            between = self.ring.interpolate(frame.host_s - frame.period_s / 2, MAX_INTERPOLATED_GAP_S)
            if between is None:
                return None
            (wrench, among), readings = between, 2
        flagged, joints = self.ring.has_flagged(among), _last_at(self._joints, frame.host_s)
        tip = _last_at(self._tips, frame.host_s, TIP_MAX_AGE_S)
        position = None if tip is None else tip[1]
        tool = self._tool_at(frame.host_s) if self._tools else None
        if joints is None:
            return Sample(frame.host_s, frame.values, wrench, readings, flagged, None, position, tool=tool)
        angles_s, angles = joints
        age_s = LATE_ANGLES_MIN_S
        if self._joint_intervals:
            age_s = max(age_s, LATE_ANGLES_MIN_PERIODS * median(self._joint_intervals))
        return Sample(frame.host_s, frame.values, wrench, readings, flagged, angles, position, angles_s, age_s, tool)

    def _waits_for_tool(self, frame: _Frame, now_s: float) -> bool:
        """Whether the pose of the tool at a frame may still come."""
        if self._tools and self._tools[-1].host_s - self.tool_delay_s >= frame.host_s:
            return False
        return now_s - max(frame.host_s, frame.arrival_s) <= FRAME_MAX_WAIT_FOR_WRENCH_S + max(self.tool_delay_s, 0.0)

    def _tool_at(self, frame_s: float) -> ToolReading | None:
        """Find the pose of the tool at a frame, between the poses around it, and drop those before.

        Poses that are farther apart than their largest age are not interpolated: then it is the one before.
        """
        host_s = frame_s + self.tool_delay_s
        while len(self._tools) > 1 and self._tools[1].host_s <= host_s:
            self._tools.popleft()
        before = self._tools[0]
        if before.host_s > host_s:
            return None
        made_s, pose = before.host_s, before.base_from_tool
        if len(self._tools) > 1 and self._tools[1].host_s - before.host_s <= before.max_age_s and host_s > before.host_s:
            after, made_s = self._tools[1], host_s
            share = (host_s - before.host_s) / (after.host_s - before.host_s)
            pose = pose_between(pose, after.base_from_tool, share)
        return ToolReading(made_s - self.tool_delay_s, pose, before.max_age_s, self.tool_delay_s)


def _wrench_columns(batch: Batch) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return wrenches (n, 6), and which of them are usable and flagged, (n,) each: see `WrenchRing.append`."""
    usable = np.isfinite(batch.values).all(axis=1) & ~batch.invalid
    return batch.values, usable, batch.saturated | batch.invalid


class PairingWithTool(Pairing):
    """Brings the tool's pose to the instants of the skin frames, where there is no force/torque sensor."""

    def pop_paired(self, now_s: float) -> list[Sample]:
        """Return the frames whose pose is known at `now_s`, or that waited long enough for it, in order."""
        samples: list[Sample] = []
        while self._waiting:
            frame = self._waiting[0]
            if self._waits_for_tool(frame, now_s):
                break
            self._waiting.popleft()
            tool = self._tool_at(frame.host_s) if self._tools else None
            samples.append(Sample(frame.host_s, frame.values, np.zeros(WRENCH_VALUES), 0, saturated=False, tool=tool))
        return samples


def _last_at(
    readings: deque[tuple[float, FloatArray]], host_s: float, max_age_s: float = math.inf
) -> tuple[float, FloatArray] | None:
    """Find the last reading at or before an instant, not older than `max_age_s`; drop those before it: frames come in order.

    Returns its time and its values.
    """
    while len(readings) > 1 and readings[1][0] <= host_s:
        readings.popleft()
    is_there = readings and 0.0 <= host_s - readings[0][0] <= max_age_s
    return readings[0] if is_there else None


class WrenchRing:
    """Keeps the last `capacity` readings in order of their stamps, as one contiguous slice.

    The arrays are twice as long as needed: when the end is reached, the newest half moves to the front.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._host_s = np.zeros(2 * capacity)
        self._wrench = np.zeros((2 * capacity, WRENCH_VALUES))
        self._usable = np.zeros(2 * capacity, np.bool_)
        self._flagged = np.zeros(2 * capacity, np.bool_)
        self._end = 0
        self._dropped = False

    def append(self, host_s: FloatArray, wrench: FloatArray, usable: NDArray[np.bool_], flagged: NDArray[np.bool_]) -> None:
        """Add n readings that are newer than all before: stamps (n,), ascending, seconds; wrenches (n, 6), N and N m.

        `usable` readings may be averaged. `flagged` readings are saturated or invalid, as the device says.
        """
        kept = slice(max(len(host_s) - self._capacity, 0), None)
        count = len(host_s[kept])
        if count < len(host_s):
            # The kept readings are older than those left out: together they would have a hole.
            self._dropped = True
            self._end = 0
        if self._end + count > len(self._host_s):
            self._move_to_front()
        self.hold(host_s[kept], wrench[kept], usable[kept], flagged[kept])
        self.release(count)

    def hold(self, host_s: FloatArray, wrench: FloatArray, usable: NDArray[np.bool_], flagged: NDArray[np.bool_]) -> bool:
        """Store n readings behind the last one, for `release`; return whether there is room for them."""
        into = slice(self._end, self._end + len(host_s))
        if into.stop > len(self._host_s):
            return False
        self._host_s[into] = host_s
        self._wrench[into] = wrench
        self._usable[into] = usable
        self._flagged[into] = flagged
        return True

    def release(self, count: int) -> None:
        """Add the next `count` of the stored readings."""
        self._end += count

    def _move_to_front(self) -> None:
        count = min(self._capacity, self._end)
        newest = slice(self._end - count, self._end)
        for array in (self._host_s, self._wrench, self._usable, self._flagged):
            array[:count] = array[newest].copy()
        self._dropped |= count < self._end
        self._end = count

    @property
    def newest_s(self) -> float:
        """Stamp of the last reading, seconds; minus infinity before the first reading."""
        return float(self._host_s[self._end - 1]) if self._end else -np.inf

    def is_older_than_kept(self, host_s: float) -> bool:
        """Check whether `host_s` is before the oldest kept reading and readings were dropped there."""
        return self._dropped and host_s < self._host_s[0]

    def between(self, after_s: float, until_s: float) -> slice:
        """Find the readings with `after_s < stamp <= until_s`."""
        known = self._host_s[: self._end]
        return slice(int(known.searchsorted(after_s, side="right")), int(known.searchsorted(until_s, side="right")))

    def mean(self, among: slice) -> tuple[FloatArray, int]:
        """Return the mean of the usable readings of a slice, (6,), and their number; NaN if there are none."""
        usable = self._usable[among]
        wrench = self._wrench[among]
        if np.count_nonzero(usable) < len(usable):
            wrench = wrench[usable]
        if not len(wrench):
            return np.full(WRENCH_VALUES, np.nan), 0
        return mean_rows(wrench), len(wrench)

    def has_flagged(self, among: slice) -> bool:
        """Check whether the device flagged a reading of a slice."""
        return bool(np.count_nonzero(self._flagged[among]))

    def interpolate(self, host_s: float, apart_max_s: float) -> tuple[FloatArray, slice] | None:
        """Interpolate linearly between the usable readings around `host_s`; return also their slice.

        `None` if one of the two is missing, or if they are `apart_max_s` seconds or more apart.
        """
        near = self.between(host_s - apart_max_s, host_s + apart_max_s)
        usable = near.start + np.flatnonzero(self._usable[near])
        right = int(np.searchsorted(self._host_s[usable], host_s))
        if right in (0, len(usable)):
            return None
        pair = usable[right - 1 : right + 1]
        (first_s, second_s), (first, second) = self._host_s[pair], self._wrench[pair]
        if second_s - first_s >= apart_max_s:
            return None
        return first + (second - first) * ((host_s - first_s) / (second_s - first_s)), slice(int(pair[0]), int(pair[1]) + 1)

    def since(self, host_s: float) -> tuple[FloatArray, FloatArray]:
        """Return copies of the stamps (n,) and wrenches (n, 6) from `host_s` on, usable or not."""
        first = int(np.searchsorted(self._host_s[: self._end], host_s))
        return self._host_s[first : self._end].copy(), self._wrench[first : self._end].copy()
