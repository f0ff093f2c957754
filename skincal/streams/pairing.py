"""Which wrench acted while a skin frame was taken.

A frame's stamp ends its interval: the wrench of a frame is the mean of the readings in the interval of one frame period
up to the stamp, so no reading from after the frame is needed and the means of neighbouring frames share no reading. Where
the wrench is slower than the skin and no reading falls into an interval, the wrench at its middle is interpolated.
A frame waits until the wrench stream has passed its stamp; a frame that waited too long is counted and left out.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from statistics import median

import numpy as np

from skincal.geometry.arrays import FloatArray
from skincal.model.readings import Loss, Sample, WrenchBatch
from skincal.streams.ring import WrenchRing

WAIT_S = 0.25
"""s. How long a frame waits for the wrench: longer than any adapter holds bytes back, short enough for a live picture."""
PERIOD_FRAMES = 15
"""The frame period is the median of this many intervals: lost frames and a jumpy clock do not move it."""
FIRST_PERIOD_S = 0.02
"""s. Period of the first frame, when no interval is known: skins send 50 frames a second."""
INTERPOLATE_S = 0.05
"""s. Readings further apart are not interpolated: twice the period of a sensor at 50 Hz with one reading lost, and a bit."""
EDGE_S = 1e-6
"""s. A reading this little after an edge counts as on it: stamps are rounded to the microsecond by the devices."""
WAITING_MAX = 4096
"""Frames that may wait, whatever their stamps say: a bound for memory."""
JOINTS_KEPT = 512
RING_READINGS = 16384
"""Readings kept: 10 s at 1.6 kHz."""


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    host_s: float
    arrival_s: float
    period_s: float
    values: FloatArray


class Pairing:
    """Brings wrench and joint angles to the instants of the skin frames. Stamps of each stream must ascend."""

    def __init__(self) -> None:
        self.ring = WrenchRing(RING_READINGS)
        self.counts: Counter[Loss] = Counter()
        """Frames left out: LATE and UNPAIRED."""
        self._waiting: deque[_Frame] = deque()
        self._intervals: deque[float] = deque(maxlen=PERIOD_FRAMES)
        self._last_frame_s: float | None = None
        self._joints: deque[tuple[float, FloatArray]] = deque(maxlen=JOINTS_KEPT)

    def add_wrench(self, host_s: FloatArray, batch: WrenchBatch) -> None:
        """Take wrench readings; those that are not finite or not valid are kept out of every mean."""
        usable = np.isfinite(batch.wrench).all(axis=1) & ~batch.invalid
        self.ring.append(host_s, batch.wrench, usable, batch.saturated | batch.invalid)

    def add_joints(self, host_s: float, angles: FloatArray) -> None:
        """Take joint angles, radians."""
        self._joints.append((host_s, angles))

    def add_frame(self, host_s: float, arrival_s: float, values: FloatArray) -> None:
        """Take a skin frame; it is returned by `advance` when its wrench is known."""
        if self._last_frame_s is not None:
            self._intervals.append(host_s - self._last_frame_s)
        self._last_frame_s = host_s
        period_s = median(self._intervals) if self._intervals else FIRST_PERIOD_S
        self._waiting.append(_Frame(host_s, arrival_s, period_s, values))
        if len(self._waiting) > WAITING_MAX:
            self._waiting.popleft()
            self.counts[Loss.UNPAIRED] += 1

    def advance(self, now_s: float) -> list[Sample]:
        """Return the frames whose wrench is known, in order; count those that waited too long.

        Parameters
        ----------
        now_s : s, arrival of the newest bytes of any link
        """
        samples: list[Sample] = []
        while self._waiting:
            frame = self._waiting[0]
            sample = self._pair(frame) if self.ring.newest_s >= frame.host_s else None
            if sample is not None:
                samples.append(sample)
            elif self.ring.forgot(frame.host_s - frame.period_s):
                self.counts[Loss.LATE] += 1
            elif now_s - max(frame.host_s, frame.arrival_s) > WAIT_S:
                self.counts[Loss.UNPAIRED] += 1
            else:
                break
            self._waiting.popleft()
        return samples

    def _pair(self, frame: _Frame) -> Sample | None:
        if self.ring.forgot(frame.host_s - frame.period_s):
            return None
        among = self.ring.between(frame.host_s - frame.period_s + EDGE_S, frame.host_s + EDGE_S)
        wrench, readings = self.ring.mean(among)
        if not readings:
            middle_s = frame.host_s - frame.period_s / 2
            pair = self.ring.usable_around(middle_s, INTERPOLATE_S)
            if pair is None or self.ring.gap(pair) >= INTERPOLATE_S:
                return None
            wrench, readings = self.ring.interpolate(pair, middle_s), len(pair)
            among = slice(pair[0], pair[1] + 1)
        return Sample(frame.host_s, frame.values, wrench, readings, self.ring.flagged(among), self._angles_at(frame.host_s))

    def _angles_at(self, host_s: float) -> FloatArray | None:
        """Return the last joint angles at or before an instant; older ones are dropped, as frames come in order."""
        while len(self._joints) > 1 and self._joints[1][0] <= host_s:
            self._joints.popleft()
        return self._joints[0][1] if self._joints and self._joints[0][0] <= host_s else None
