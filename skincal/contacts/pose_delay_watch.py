"""Delay of a tool's poses against skin and wrench, from the edges of each press.

While a tip presses, the answer y of the skin and the force grow with its depth s along the push, and fall on the same way
back. At a level of y crossed at t_1 on the way in and at t_2 on the way out the depth is the same. With poses stamped d late,

    g(d) = s(t_1 + d) - s(t_2 + d) = 0,   averaged over some levels,

and g grows with d by the speeds of both edges. Foam gives way while it is held, and answers some time after the tip left: the
depths differ then, by `DEPTH_DIFFERENCE_SD_M`, and d errs by that over the speeds.

All follows from the samples in their order, so a replay gives the same delays to the last bit.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.pose_delays import PoseDelay, PoseDelays
from skincal.geometry import FloatArray, mean_rows

PLATEAU_SHARES = (0.4, 0.55, 0.7)
"""Shares of the plateau at which both edges are compared."""
MIN_DELAY_S, MAX_DELAY_S, DELAY_STEP_S = -0.3, 0.5, 0.005
BEFORE_S, AFTER_S = 0.7, 0.7
"""s of the samples before and after a press that are looked at: more than the delays."""
HISTORY_S = 10.0
"""s of samples that are kept. A longer press shows no delay."""
DEPTH_DIFFERENCE_SD_M = 0.0002
"""m, sd of the difference of the depths at both edges: a tenth of foam that is pressed in by 2 mm."""
MIN_EDGE_SPEED_M_S = 0.008
"""m/s, both edges together. Slower ones say little: 0.2 mm take 25 ms."""
MIN_SAMPLES_FOR_NOISE = 4
DIRECTION_WAY_M = 0.002
"""m, way of the tip that gives its direction."""
MIN_FORCE_N, MIN_ANSWER_SHARE = 0.5, 4.0
"""N, plateau of the force; and of an answer, over its scatter before the press."""


class _Moment(NamedTuple):
    host_s: float
    place: FloatArray
    """(3,) float, metres, of a point of the tool."""
    force: float
    answer: float
    shift_s: float
    """s, correction of the delay in this place."""


class Way(NamedTuple):
    """Way of the tip along the push."""

    stamps: FloatArray
    """(n,) float, s, of the poses."""
    depth: FloatArray
    """(n,) float, metres."""

    def in_order(self) -> Way:
        """Sort by the stamps."""
        order = np.argsort(self.stamps, kind="stable")
        return Way(self.stamps[order], self.depth[order])

    def at(self, stamps: FloatArray) -> FloatArray:
        """Interpolate the depth at stamps (k,)."""
        return np.asarray(np.interp(stamps, self.stamps, self.depth), dtype=np.float64)


class PoseDelayWatch:
    """Follows samples and presses, and keeps the delays that these show."""

    def __init__(self, *, has_sensor: bool) -> None:
        self.delays = PoseDelays()
        self._has_sensor = has_sensor
        self._moments: deque[_Moment] = deque()
        self._began_s: float | None = None
        self._ended: tuple[float, float] | None = None
        """Begin and end of the last press, s, until it is looked at."""

    def forget(self) -> None:
        """Forget the way of the tool after a break."""
        self._moments.clear()
        self._began_s = self._ended = None

    def feed(self, host_s: float, place: FloatArray, signals: tuple[float, float], shift_s: float, *, presses: bool) -> bool:
        """Process one sample; tells whether a press showed a delay.

        Parameters
        ----------
        host_s : s, of the skin frame
        place : (3,) float, metres: a point of the tool in a frame that stays, with the correction
        signals : force, N, and answer of the strongest taxel, raw units, above their tares
        shift_s : s, delay that is corrected in `place` already
        presses : whether a press is in progress
        """
        self._moments.append(_Moment(host_s, place, *signals, shift_s))
        while self._moments[0].host_s < host_s - HISTORY_S:
            self._moments.popleft()
        if presses and self._began_s is None:
            self._began_s = host_s
        if not presses and self._began_s is not None:
            self._ended, self._began_s = (self._began_s, host_s), None
        if self._ended is None or host_s < self._ended[1] + AFTER_S:
            return False
        (began_s, ended_s), self._ended = self._ended, None
        return self._look_at_press(began_s, ended_s)

    def _look_at_press(self, began_s: float, ended_s: float) -> bool:
        seen = [each for each in self._moments if began_s - BEFORE_S <= each.host_s <= ended_s + AFTER_S]
        if len(seen) < 3 or seen[0].host_s > began_s - MAX_DELAY_S / 2.0:
            return False
        times, places = np.array([each.host_s for each in seen]), np.array([each.place for each in seen])
        pressed = (times >= began_s) & (times < ended_s)
        depth = depth_along_push(places, pressed)
        answers = np.array([[each.force, each.answer] for each in seen])
        # By the stamps of the poses: the correction may change between two presses.
        way = Way(times + np.array([each.shift_s for each in seen]), depth).in_order()
        of_wrench = find_delay(way, times, answers[:, 0], pressed, MIN_FORCE_N) if self._has_sensor else None
        of_skin = find_delay(way, times, answers[:, 1], pressed, 0.0)
        self.delays = self.delays.with_press(of_skin, of_wrench)
        return of_skin is not None or of_wrench is not None


def depth_along_push(places: FloatArray, pressed: NDArray[np.bool_]) -> FloatArray:
    """Compute the way (n,), metres, of places (n, 3) along the push: from where the tip was before the press."""
    rows = np.flatnonzero(pressed)
    hold = np.median(places[rows], axis=0)
    far = np.linalg.norm(places - hold, axis=1) >= DIRECTION_WAY_M
    before, after = np.flatnonzero(far[: rows[0]]), np.flatnonzero(far[rows[-1] :])
    push = np.zeros(3)
    for row in [*before[-1:].tolist(), *(rows[-1] + after[:1]).tolist()]:
        way = hold - places[row]
        push += way / np.linalg.norm(way)
    size = np.linalg.norm(push)
    return (places - hold) @ (push / size if size > 0.5 else push)


def find_delay(way: Way, times: FloatArray, answer: FloatArray, pressed: NDArray[np.bool_], least: float) -> PoseDelay | None:
    """Find the delay of a press; `None` if its edges do not show one.

    Parameters
    ----------
    times : (n,) float, s, ascending
    answer : (n,) float: force or answer of the skin at these times
    pressed : (n,) bool: samples of the press
    least : smallest plateau of the answer that counts
    """
    rows = np.flatnonzero(pressed)
    rest, plateau = answer[: rows[0]], float(np.median(answer[rows]))
    if len(rest) < 3 or len(rows) < 3:
        return None
    base, scatter = float(np.median(rest)), float(np.std(rest))
    if not plateau - base > max(least, MIN_ANSWER_SHARE * scatter, 0.0):
        return None
    edges = [_edges(times, answer, base + share * (plateau - base)) for share in PLATEAU_SHARES]
    known = [each for each in edges if each is not None]
    if not known:
        return None
    begins, ends = np.array(known, dtype=np.float64).T
    delays = np.arange(MIN_DELAY_S, MAX_DELAY_S + DELAY_STEP_S / 2.0, DELAY_STEP_S)
    inside = (begins.min() + delays >= way.stamps[0]) & (ends.max() + delays <= way.stamps[-1])
    delays = delays[inside]
    gaps = np.array([way.at(begin + delays) - way.at(end + delays) for begin, end in known], dtype=np.float64)
    gap = mean_rows(gaps)
    steps = np.diff(gap)
    crossing = np.flatnonzero((gap[:-1] < 0.0) & (gap[1:] >= 0.0))
    if not len(crossing):
        return None
    # Of several the one with the fastest edges: between presses the tool hardly moves along the push.
    at = int(crossing[np.argmax(steps[crossing])])
    speed = float(np.mean(steps[max(at - 2, 0) : at + 3])) / DELAY_STEP_S
    if speed < MIN_EDGE_SPEED_M_S:
        return None
    delay = float(delays[at] - gap[at] * DELAY_STEP_S / steps[at])
    held = way.at(times[rows[len(rows) // 4 : len(rows) - len(rows) // 4]] + delay)
    noise = float(np.std(np.diff(held))) if len(held) >= MIN_SAMPLES_FOR_NOISE else 0.0
    # The stamps are known to a part of a period.
    sd = np.hypot(DEPTH_DIFFERENCE_SD_M, noise) / speed
    return PoseDelay(delay, float(np.hypot(sd, 0.2 * float(np.median(np.diff(times))))), 1)


def _edges(times: FloatArray, answer: FloatArray, level: float) -> tuple[float, float] | None:
    """Find the first and the last time at which the answer crosses a level, s; `None` if it is above at either end."""
    above = np.flatnonzero(answer >= level)
    if not len(above) or above[0] == 0 or above[-1] == len(answer) - 1:
        return None
    first, last = int(above[0]), int(above[-1])
    begin = np.interp(level, answer[first - 1 : first + 1], times[first - 1 : first + 1])
    end = np.interp(-level, -answer[last : last + 2], times[last : last + 2])
    return float(begin), float(end)
