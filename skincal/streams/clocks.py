"""Dates readings: maps the clock of a device, or its count of readings, to the host's clock.

Reading i is stamped x_i by the device and arrives at y_i = f(x_i) + d_i on the host's clock. f is a straight line over a minute
(two crystals differ by a constant factor). The delay d_i of sensor, wire, adapter and program is never less than a constant d.
So the wanted line, f + d, lies under all points and touches some. Of all lines a + b x under all points the one with the least
sum of y_i - a - b x_i is taken. With n points that sum is sum(y_i) - n (a + b m), m the mean of x_i, so it is the line that is
highest at m: the edge of the lower convex hull above m. Queueing (a timer of 16 ms in a serial adapter, bursts, a busy program)
only makes delays longer, and drops out. The constant d remains; no stamp of arrival can show it. A least-squares line would
keep the mean delay instead.

Live, the points of the last minute count, and the line is extended to the newest one. To keep the work per reading constant,
readings are gathered in buckets of a quarter second. Each keeps the point lowest above the present line: at most 240
points for the hull, which is updated when a bucket ends. What a bucket drops could only matter when the line turns: a change of
slope of 100 parts in a million moves it by 25 microseconds within a bucket. A point below the line pushes the line down at
once, so no reading is ever dated after its arrival.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Sequence
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from skincal.devices.decoding import NO_SEQ
from skincal.geometry import FloatArray, IntArray
from skincal.model.readings import Batch, Stream

CLOCK_FIT_WINDOW_S = 60.0
"""s. Older points no longer count: crystals wander with temperature over minutes."""
CLOCK_FIT_BUCKET_S = 0.25
"""s. Length of a bucket, which keeps one point."""
MAX_CLOCK_RATE_DIFFERENCE = 0.02
"""Largest difference of the two clocks' speeds: a factory-trimmed RC oscillator is within 2 %, a resonator within 0.5 %."""
CLOCK_JUMP_MIN_S = 0.5
"""s. A clock that is off by more has restarted: no stall of a running program or adapter lasts as long."""
CLOCK_BEHIND_MAX_S = 3.0
"""s. A device that stays `CLOCK_JUMP_MIN_S` behind for this long lost its time for good; a stall ends sooner."""
MIN_TIME_STAMP_STEP_S = 1e-6
"""s. Least step between two stamps of a stream: stamps never go back when the line is pushed down."""
PACE_LEARNING_S, PACE_LEARNING_READINGS = 2.0, 20
"""The pace of a device without a clock is learnt over this time and number of readings: within 1 % under a jitter of 16 ms."""
MAX_INITIAL_CLOCK_RATE_ERROR = 0.2
"""Largest relative error of the pace as first learnt: a stall of 0.4 s among the first two seconds."""
LATE_MIN_PERIODS, LATE_MIN_S = 0.7, 0.005
"""A device without a clock that is late by more than both for a whole bucket lost a reading."""
RESTARTS_MAX, RESTARTS_WINDOW_S = 3, 60.0
"""More restarts than this in this many seconds mean that the device keeps no pace."""

MAPPED_TOGETHER_MAX = 256
"""Readings looked at together; a bucket has 250 at 1 kHz."""
DATED_TOGETHER_MIN = 32
"""Readings from which arrays are faster than one reading after the other."""

Point: TypeAlias = tuple[float, float]
"""A reading's time by the device's clock and its arrival, seconds."""


class ConvexHullClock:
    """Maps a device's time to the host's, reading by reading: a line below all arrivals, from their lower convex hull."""

    def __init__(self, slope_change_max: float = MAX_CLOCK_RATE_DIFFERENCE) -> None:
        self._slope_change_max = slope_change_max
        self.reset()

    def reset(self) -> None:
        """Forget everything: the device or its clock restarted."""
        self.jumps = 0
        self._origin: tuple[float, float] | None = None
        self._offset, self._slope = 0.0, 1.0
        self._last_x = -math.inf
        self._behind_since: float | None = None
        self._lowest = (0.0, 0.0)
        self._bucket_start = 0.0
        self._points: deque[Point] = deque()
        # The points in order, and their hull, as the last bucket left them.
        self._ordered: list[Point] = []
        self._hull: list[Point] = []

    def map(self, device_s: float, arrival_s: float) -> float:
        """Return when the reading was made, up to the constant least delay, on the host's clock.

        The device's stamp, seconds, may step back a bit, not by `CLOCK_JUMP_MIN_S`; `arrival_s` is the host's clock, seconds.
        """
        if self._origin is None:
            self._start_line_at(device_s, arrival_s)
        x, y, late = self._place(device_s, arrival_s)
        if self._has_jumped(device_s, y, late):
            jumps = self.jumps + 1
            self._start_line_at(device_s, arrival_s)
            self.jumps = jumps
            x, y, late = 0.0, 0.0, 0.0
        # Nothing is dated after its arrival: a point below the line pushes it down at once, not at the bucket's end.
        if late < 0.0:
            self._offset += late
            late = 0.0
        if late <= self._lowest[1] - self._offset - self._slope * self._lowest[0]:
            self._lowest = x, y
        self._last_x = max(self._last_x, device_s)
        if x - self._bucket_start >= CLOCK_FIT_BUCKET_S:
            self._end_bucket(x, y)
        return arrival_s - (y - self._offset - self._slope * x)

    def map_many(self, device_s: FloatArray, arrival_s: FloatArray, *, until_jump: bool = False) -> FloatArray:
        """Return `map` of each of n successive readings, (n,) seconds, bit for bit; with `until_jump` up to the first jump."""
        made = np.empty(len(device_s))
        at = 0
        while at < len(device_s):
            part = slice(at, at + MAPPED_TOGETHER_MAX)
            end = at + self._map_until_change(device_s[part], arrival_s[part], made[part])
            if end < len(device_s):
                made[end] = self.map(float(device_s[end]), float(arrival_s[end]))
            at = end + 1
            if until_jump and self.jumps:
                return made[:at]
        return made

    def _map_until_change(self, device_s: FloatArray, arrival_s: FloatArray, made: FloatArray) -> int:
        """Map readings until the line changes, into `made`; return their number."""
        if self._origin is None:
            return 0
        x, y = device_s - self._origin[0], arrival_s - self._origin[1]
        late = y - self._offset - self._slope * x
        newest = np.maximum(np.maximum.accumulate(device_s), self._last_x)
        before = np.concatenate([[self._last_x], newest[:-1]])
        changes = (late < 0.0) | (late > CLOCK_JUMP_MIN_S) | (device_s < before - CLOCK_JUMP_MIN_S)
        changes |= x - self._bucket_start >= CLOCK_FIT_BUCKET_S
        count = int(changes.argmax()) if changes.any() else len(late)
        if not count:
            return 0
        lowest = count - 1 - int(late[:count][::-1].argmin())
        if late[lowest] <= self._lowest[1] - self._offset - self._slope * self._lowest[0]:
            self._lowest = float(x[lowest]), float(y[lowest])
        self._behind_since, self._last_x = None, float(newest[count - 1])
        made[:count] = arrival_s[:count] - late[:count]
        return count

    def _start_line_at(self, device_s: float, arrival_s: float) -> None:
        self.reset()
        self._origin = device_s, arrival_s
        self._last_x = device_s

    def _place(self, device_s: float, arrival_s: float) -> tuple[float, float, float]:
        """Return the point, measured from the first one so that products keep their digits for days, and its delay."""
        first_x, first_y = self._origin or (device_s, arrival_s)
        x, y = device_s - first_x, arrival_s - first_y
        return x, y, y - self._offset - self._slope * x

    def _has_jumped(self, device_s: float, y: float, late: float) -> bool:
        if device_s < self._last_x - CLOCK_JUMP_MIN_S or late < -CLOCK_JUMP_MIN_S:
            return True
        if late <= CLOCK_JUMP_MIN_S:
            self._behind_since = None
        elif self._behind_since is None:
            self._behind_since = y
        return self._behind_since is not None and y - self._behind_since > CLOCK_BEHIND_MAX_S

    def _end_bucket(self, x: float, y: float) -> None:
        self._points.append(self._lowest)
        while self._points[0][0] < x - CLOCK_FIT_WINDOW_S:
            self._points.popleft()
            if not self._points:
                # The device was silent for the whole window: only the reading that ends the pause counts.
                self._points.append((x, y))
        self._bucket_start, self._lowest = x, (x, y)
        # Sorted: a skin frame may be stamped a little before the wrench that was sent ahead of it.
        ordered = sorted(self._points)
        # The usual bucket: one point came at the right, and some went at the left.
        is_usual = ordered[:-1] == self._ordered[len(self._ordered) + 1 - len(ordered) :]
        self._hull = lower_hull(ordered, self._hull if is_usual else ())
        self._ordered = ordered
        self._offset, self._slope = supporting_line(ordered, self._hull, self._slope_change_max)
        # The reading that ends the bucket is not among the points yet, and the line may not lie above it either.
        self._offset += min(y - self._offset - self._slope * x, 0.0)


def supporting_line(points: Sequence[Point], hull: Sequence[Point], slope_change_max: float) -> tuple[float, float]:
    """Find offset and slope of the highest line (at the mean x) under all `points` (x, y), seconds, ascending in x.

    `hull` is their lower hull. The slope is held within `slope_change_max` of 1.
    """
    mean = math.fsum([x for x, _ in points]) / len(points)
    slope = 1.0
    for (x0, y0), (x1, y1) in pairwise(hull):
        if x0 <= mean <= x1 and x1 > x0:
            slope = (y1 - y0) / (x1 - x0)
            break
    slope = min(max(slope, 1.0 - slope_change_max), 1.0 + slope_change_max)
    # A line through the edge whose slope was then limited would cut through other points.
    return min(y - slope * x for x, y in hull), slope


def lower_hull(points: Sequence[Point], known: Sequence[Point] = ()) -> list[Point]:
    """Return the lower convex hull, left to right (Andrew's monotone chain).

    `known` is the hull before the last point was added and points at the left were removed. Once both hulls share an edge, the
    rest of `known` is reused.
    """
    places = {id(corner): place for place, corner in enumerate(known)}
    hull: list[Point] = []
    for point in points:
        _add_corner(hull, point)
        place = places.get(id(point))
        if place and len(hull) > 1 and hull[-2] is known[place - 1]:
            hull += known[place + 1 :]
            _add_corner(hull, points[-1])
            break
    return hull


def _add_corner(hull: list[Point], point: Point) -> None:
    x, y = point
    while len(hull) > 1:
        x1, y1 = hull[-1]
        x0, y0 = hull[-2]
        if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
            break
        del hull[-1]
    hull.append(point)


class IndexClock:
    """Dates the readings of a device without a clock by their count, if it keeps a constant pace.

    The pace is learnt first. Until then, and for a device that keeps none, the arrival is used. A device that numbers its
    readings is dated by these numbers as by a clock: they tell a lost reading from a late one. If readings are only counted,
    a lost one makes all later ones late by a period; the line then restarts at the present one. A lasting queue has the same
    effect, and the line lies too late until the queue is gone.

    Parameters
    ----------
    period_s : pace, if it is known already: that of a whole recording
    """

    def __init__(self, period_s: float | None = None) -> None:
        self._hull = ConvexHullClock(MAX_INITIAL_CLOCK_RATE_ERROR)
        self._restarts: deque[float] = deque()
        self._number, self._has_numbers = 0, False
        self._forget_pace()
        self._period = period_s

    def map(self, arrival_s: float, number: int = NO_SEQ) -> float:
        """Return when the next reading was made, up to the constant least delay, on the host's clock, seconds.

        `number` is the device's own, `NO_SEQ` if it has none.
        """
        self._has_numbers = number >= 0
        if self._has_numbers and number < self._number:  # the device restarted
            self._forget_pace()
        self._number = number if self._has_numbers else self._number + 1
        if self._period is None:
            self._learn_pace(arrival_s)
            return arrival_s
        made_s = self._hull.map(self._number * self._period, arrival_s)
        if not self._has_numbers:
            self._check_delay(arrival_s, arrival_s - made_s, self._period)
        elif self._hull.jumps:
            self._restart_line(arrival_s)
        return made_s

    def map_many(self, arrival_s: FloatArray, numbers: IntArray) -> FloatArray:
        """Return `map` of each of n successive readings that arrived at (n,) seconds with (n,) numbers, bit for bit."""
        made, at = np.empty(len(numbers)), 0
        is_ascending = numbers[0] >= max(self._number, 0) and bool((numbers[1:] >= numbers[:-1]).all())
        while at < len(numbers):
            if self._period is None or not self._has_numbers or not is_ascending:
                made[at] = self.map(float(arrival_s[at]), int(numbers[at]))
                at += 1
                continue
            mapped = self._hull.map_many(
                np.multiply(numbers[at:], self._period, dtype=np.float64), arrival_s[at:], until_jump=True
            )
            made[at : at + len(mapped)] = mapped
            at += len(mapped)
            self._number = int(numbers[at - 1])
            if self._hull.jumps:
                self._restart_line(float(arrival_s[at - 1]))
        return made

    def note_loss(self) -> None:
        """Start the fit again after a lost reading. For a device that numbers its readings this does nothing."""
        if self._has_numbers:
            return
        if self._period is None:
            self._forget_pace()
        self._hull.reset()

    def _check_delay(self, arrival_s: float, late_s: float, period_s: float) -> None:
        # By the least delay of a bucket: queueing makes single readings late, a lost reading makes all of them late. Only the
        # last of readings that arrived together, as after a stall, is on time: so a bucket ends between two arrivals.
        if arrival_s > self._arrival_s and self._arrival_s - self._bucket_s >= CLOCK_FIT_BUCKET_S:
            if self._least_late > max(LATE_MIN_PERIODS * period_s, LATE_MIN_S):
                self._restart_line(arrival_s)
            self._bucket_s, self._least_late = self._arrival_s, math.inf
        self._arrival_s, self._least_late = arrival_s, min(self._least_late, late_s)

    def _restart_line(self, arrival_s: float) -> None:
        """Restart the line because of the delay alone; too often means that the pace is another one, or none."""
        self._hull.reset()
        self._restarts.append(arrival_s)
        while self._restarts[0] < arrival_s - RESTARTS_WINDOW_S:
            self._restarts.popleft()
        if len(self._restarts) > RESTARTS_MAX:
            self._restarts.clear()
            self._forget_pace()

    def _forget_pace(self) -> None:
        self._period: float | None = None
        self._first: tuple[int, float] | None = None
        self._bucket_s, self._arrival_s, self._least_late = -math.inf, -math.inf, math.inf

    def _learn_pace(self, arrival_s: float) -> None:
        if self._first is None:
            self._first = self._number, arrival_s
        count, elapsed = self._number - self._first[0], arrival_s - self._first[1]
        if elapsed >= PACE_LEARNING_S and count + 1 >= PACE_LEARNING_READINGS:
            self._period = elapsed / count
            self._hull.reset()
            self._bucket_s = arrival_s


class Timestamper:
    """Dates the readings of one link: one line for the device's clock, which its streams share; counts without a clock."""

    def __init__(self) -> None:
        self._device = ConvexHullClock()
        self._index = defaultdict[Stream, IndexClock](IndexClock)
        self._last: dict[Stream, float] = {}

    def reset_clocks(self) -> None:
        """Forget the clocks, since the link was away. Stamps still ascend."""
        self._device.reset()
        self._index.clear()

    def note_loss(self) -> None:
        """Note that readings were lost, so that counts of readings no longer tell their time."""
        for index in self._index.values():
            index.note_loss()

    def stamp(self, batch: Batch, arrival_s: float | FloatArray) -> FloatArray:
        """Return the host's clock at each reading, (n,) seconds, strictly ascending in each stream from call to call.

        `arrival_s` is when the last reading arrived, or (n,) the arrival of the last one that came with each.
        """
        index, count = self._index[batch.stream], len(batch.seq)
        have_no_clock = np.isnan(batch.device_s)
        if count >= DATED_TOGETHER_MIN and not have_no_clock.any():
            made = self._device.map_many(batch.device_s, np.broadcast_to(arrival_s, count))
            return self._ascending_from_last(batch.stream, made)
        if count >= DATED_TOGETHER_MIN and have_no_clock.all():
            made = index.map_many(np.broadcast_to(arrival_s, count), batch.seq)
            return self._ascending_from_last(batch.stream, made)
        arrivals = arrival_s.tolist() if isinstance(arrival_s, np.ndarray) else [arrival_s] * count
        dates = [
            index.map(arrival, number) if math.isnan(clock) else self._device.map(clock, arrival)
            for clock, arrival, number in zip(batch.device_s.tolist(), arrivals, batch.seq.tolist(), strict=True)
        ]
        return self._ascending_from_last(batch.stream, np.array(dates))

    def _ascending_from_last(self, stream: Stream, made: FloatArray) -> FloatArray:
        stamps = _ascending(made, self._last.get(stream, -math.inf))
        self._last[stream] = float(stamps[-1])
        return stamps


def _ascending(stamps: FloatArray, last: float) -> FloatArray:
    """Move each of the stamps (n,), seconds, n > 0, to `MIN_TIME_STAMP_STEP_S` after the one before it if it is earlier."""
    if stamps[0] >= last + MIN_TIME_STAMP_STEP_S and (stamps[1:] >= stamps[:-1] + MIN_TIME_STAMP_STEP_S).all():
        return stamps
    moved: list[float] = []
    for stamp in stamps.tolist():
        last = max(stamp, last + MIN_TIME_STAMP_STEP_S)
        moved.append(last)
    return np.array(moved)
