"""When a reading was made, on the host's clock, from when it arrived.

Theory. Reading i is stamped x_i by the device and arrives at y_i = f(x_i) + d_i on the host's clock. f is a straight line
over a minute (two crystals differ by a constant factor), and the delay d_i of sensor, wire, adapter and program is never
less than a constant d. So the line that is wanted, f + d, lies under all points and touches some. Of all lines a + b x
under all points the one with the least sum of y_i - a - b x_i is taken: with n points that sum is sum(y_i) - n (a + b m),
m the mean of x_i, so it is the line that is highest at m, the edge of the lower convex hull above m. Queueing (a timer of
16 ms in a serial adapter, bursts, a busy program) makes delays longer, never shorter, and drops out; what is left is the
constant d, which no stamp of arrival can show. A least-squares line would keep the mean delay instead.

Live, the points of the last minute count, and the line is carried on to the newest one. To keep the work per reading
constant, readings are gathered in buckets of a quarter second, of which only the point lowest above the present line is
kept: at most 240 points for the hull, which is made anew when a bucket ends. What a bucket drops could only matter when
the line turns: a change of slope of 100 parts in a million moves it by 25 microseconds within a bucket. A point below the
line pushes the line down at once, so no reading is ever dated after its arrival.

A device without a clock is dated by its count times its period, where it keeps a constant pace (`IndexClock`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from skincal.geometry.arrays import FloatArray
from skincal.model.readings import Stream

WINDOW_S = 60.0
"""s. Points older than this no longer count: crystals wander with temperature over minutes."""
BUCKET_S = 0.25
"""s. Time in which one point is kept: see the theory above."""
SLOPE_CHANGE_MAX = 0.02
"""Largest difference of the two clocks' speeds: a factory-trimmed RC oscillator is within 2 %, a resonator within 0.5 %."""
JUMP_S = 0.5
"""s. A clock that is off by more started anew: no stall of a running program or adapter is as long."""
BEHIND_S = 3.0
"""s. A device that stays `JUMP_S` behind for this long lost its time for good; a stall ends sooner."""
STEP_S = 1e-6
"""s. Least step from one stamp to the next of a stream: stamps never go back when the line is pushed down."""

LEARN_S = 2.0
LEARN_READINGS = 20
"""The pace of a device without a clock is learnt over so long and so many: within 1 % under a jitter of 16 ms."""
PACE_ERROR_MAX = 0.1
"""Largest relative error of the pace as first learnt: a stall of 0.2 s among the first two seconds."""
LOST_PERIODS = 0.7
LOST_S = 0.005
"""s. A device without a clock that is late by more than this and by `LOST_PERIODS` for a whole bucket lost a reading."""
RESTARTS_MAX = 3
RESTARTS_S = 60.0
"""s. More restarts than `RESTARTS_MAX` in this time mean that the device keeps no pace."""


class HullClock:
    """Maps a device's time to the host's: the supporting line of the module's theory, for points as they come."""

    def __init__(self, slope_change_max: float = SLOPE_CHANGE_MAX) -> None:
        self._slope_change_max = slope_change_max
        self.reset()

    def reset(self) -> None:
        """Forget everything: the device or its clock started anew."""
        self._origin: tuple[float, float] | None = None
        self._offset, self._slope = 0.0, 1.0
        self._last_x = -math.inf
        self._behind_since: float | None = None
        self._lowest = (0.0, 0.0)
        self._bucket_start = 0.0
        self._points: deque[tuple[float, float]] = deque()

    def map(self, device_s: float, arrival_s: float) -> float:
        """Return when the reading was made, up to the constant least delay, on the host's clock.

        Parameters
        ----------
        device_s : stamp of the device, seconds; may step back a little, not by `JUMP_S`
        arrival_s : host's clock at its arrival, seconds
        """
        if self._origin is None:
            self._begin(device_s, arrival_s)
        x, y, late = self._place(device_s, arrival_s)
        if self._jumped(device_s, y, late):
            self._begin(device_s, arrival_s)
            x, y, late = 0.0, 0.0, 0.0
        if late < 0.0:
            self._offset += late
            late = 0.0
        if late <= self._lowest[1] - self._offset - self._slope * self._lowest[0]:
            self._lowest = x, y
        self._last_x = max(self._last_x, device_s)
        if x - self._bucket_start >= BUCKET_S:
            self._end_bucket(x, y)
        return arrival_s - (y - self._offset - self._slope * x)

    def _begin(self, device_s: float, arrival_s: float) -> None:
        self.reset()
        self._origin = device_s, arrival_s
        self._last_x = device_s

    def _place(self, device_s: float, arrival_s: float) -> tuple[float, float, float]:
        """Return the point measured from the first one, so that products keep their digits for days, and its delay."""
        first_x, first_y = self._origin or (device_s, arrival_s)
        x, y = device_s - first_x, arrival_s - first_y
        return x, y, y - self._offset - self._slope * x

    def _jumped(self, device_s: float, y: float, late: float) -> bool:
        """Say whether the device's clock is no longer the one that the line was made for."""
        if device_s < self._last_x - JUMP_S or late < -JUMP_S:
            return True
        if late <= JUMP_S:
            self._behind_since = None
        elif self._behind_since is None:
            self._behind_since = y
        return self._behind_since is not None and y - self._behind_since > BEHIND_S

    def _end_bucket(self, x: float, y: float) -> None:
        self._points.append(self._lowest)
        while self._points[0][0] < x - WINDOW_S:
            self._points.popleft()
            if not self._points:
                # The device was silent for the whole window: the reading that ends the pause is all that counts.
                self._points.append((x, y))
        self._bucket_start, self._lowest = x, (x, y)
        self._offset, self._slope = supporting_line(sorted(self._points), self._slope_change_max)
        self._offset += min(y - self._offset - self._slope * x, 0.0)


def supporting_line(points: Sequence[tuple[float, float]], slope_change_max: float) -> tuple[float, float]:
    """Find offset and slope of the line under all points that is highest at their mean x.

    Parameters
    ----------
    points : at least one (x, y), seconds, ascending in x
    slope_change_max : the slope is held within this of 1
    """
    hull = _lower_hull(points)
    mean = math.fsum(x for x, _ in points) / len(points)
    slope = 1.0
    for (x0, y0), (x1, y1) in pairwise(hull):
        if x0 <= mean <= x1 and x1 > x0:
            slope = (y1 - y0) / (x1 - x0)
            break
    slope = min(max(slope, 1.0 - slope_change_max), 1.0 + slope_change_max)
    return min(y - slope * x for x, y in hull), slope


def _lower_hull(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the lower convex hull, left to right (Andrew's monotone chain)."""
    hull: list[tuple[float, float]] = []
    for x, y in points:
        while len(hull) >= 2:
            (x0, y0), (x1, y1) = hull[-2], hull[-1]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        hull.append((x, y))
    return hull


class IndexClock:
    """Dates the readings of a device that has no clock by their count, where it keeps a constant pace.

    The pace is learnt first; until then, and for a device that keeps none, the arrival is the best that is known. A lost
    reading makes all later ones late by a period: the line then starts anew at the present one.
    """

    def __init__(self) -> None:
        self._hull = HullClock(PACE_ERROR_MAX)
        self._restarts: deque[float] = deque()
        self._learn_anew()

    def map(self, arrival_s: float) -> float:
        """Return when the next reading was made, up to the constant least delay, on the host's clock, seconds."""
        self._count += 1
        if self._period is None:
            self._learn(arrival_s)
            return arrival_s
        made_s = self._hull.map(self._count * self._period, arrival_s)
        self._least_late = min(self._least_late, arrival_s - made_s)
        if arrival_s - self._bucket_s >= BUCKET_S:
            if self._least_late > max(LOST_PERIODS * self._period, LOST_S):
                self._restart_late(arrival_s)
            self._bucket_s, self._least_late = arrival_s, math.inf
        return made_s

    def lost(self) -> None:
        """Start the line anew: a reading is known to be missing before the next one."""
        if self._period is None:
            self._learn_anew()
        self._hull.reset()

    def _restart_late(self, arrival_s: float) -> None:
        """Start the line anew after a loss that only the delay shows; too many mean that there is no constant pace."""
        self._hull.reset()
        self._restarts.append(arrival_s)
        while self._restarts[0] < arrival_s - RESTARTS_S:
            self._restarts.popleft()
        if len(self._restarts) > RESTARTS_MAX:
            self._restarts.clear()
            self._learn_anew()

    def _learn_anew(self) -> None:
        self._period: float | None = None
        self._count = 0
        self._first_s = math.nan
        self._bucket_s, self._least_late = -math.inf, math.inf

    def _learn(self, arrival_s: float) -> None:
        if self._count == 1:
            self._first_s = arrival_s
        elapsed = arrival_s - self._first_s
        if elapsed >= LEARN_S and self._count >= LEARN_READINGS:
            self._period = elapsed / (self._count - 1)
            self._hull.reset()
            self._bucket_s = arrival_s


class Stamper:
    """Dates the readings of one link: one line for the device's clock, which its streams share, and counts without one."""

    def __init__(self) -> None:
        self._device = HullClock()
        self._index: dict[Stream, IndexClock] = {}
        self._last: dict[Stream, float] = {}

    def reopened(self) -> None:
        """Start the clocks anew, not the order: the link was away."""
        self._device.reset()
        self._index.clear()

    def lost(self) -> None:
        """Say that readings were lost, which a count does not see."""
        for index in self._index.values():
            index.lost()

    def stamp(self, stream: Stream, device_s: FloatArray, arrival_s: float) -> FloatArray:
        """Return the host's clock at each reading, seconds, strictly ascending from call to call.

        Parameters
        ----------
        device_s : (n,) device's clock, seconds; NaN where it has none
        arrival_s : host's clock when the last of them arrived
        """
        last = self._last.get(stream, -math.inf)
        stamps: list[float] = []
        for x in device_s.tolist():
            made_s = self._index_of(stream).map(arrival_s) if math.isnan(x) else self._device.map(x, arrival_s)
            last = made_s if made_s >= last + STEP_S else last + STEP_S
            stamps.append(last)
        self._last[stream] = last
        return np.array(stamps)

    def _index_of(self, stream: Stream) -> IndexClock:
        index = self._index.get(stream)
        if index is None:
            index = self._index[stream] = IndexClock()
        return index
