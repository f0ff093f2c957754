"""The quiet time around each poke: where the force sensor and the skin stand when nothing touches.

A force sensor drifts by tenths of newtons within minutes, which moves the force axis by millimetres; so every poke is
tared by the quiet windows before and after it, linear in time between them. A tare is the mean wrench of one quiet
window, at the mean time of its samples: offset and linear drift vanish exactly.

The skin's baseline is that of the quiet window before the poke alone: foam recovers slowly after a press, so the time
after it is not at rest for the taxels that were pressed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray, length_of, mean_rows
from skincal.model.readings import Sample
from skincal.model.scene import ContactSettings

QUIET_SPREAD = 0.35
"""N. Largest spread (root of the summed variances) of a quiet window: twice that of a sensor with 0.1 N noise an axis."""
QUIET_SHIFT = 0.2
"""N. Largest move of the mean force within and straight after a quiet window: noise of 0.1 N stays below it, a tool
that comes on or lifts off does not."""
ONSET_S = 0.2
"""s. A tare used for a poke ends at least so long before the touch, if there is one: a slow touch needs that long from
the first contact to `touch_force`."""
TARE_AGE_MAX_S = 10.0
"""s. A tare older than this is not used: drift of 0.5 N in ten minutes is 0.01 N in this time."""
LEAST_WINDOW = 4
"""Samples. A window of fewer says nothing about its spread."""
MOST_WINDOW = 1024
"""Samples. A window holds no more, however fast the device says it is: memory stays small."""
NOISE_BLOCKS = 16
"""Quiet windows over which a channel's noise is averaged: ten samples alone give it to 25 %."""
# Interquartile range of a normal distribution in standard deviations.
_IQR_OF_SD = 1.349


@dataclass(frozen=True, slots=True, eq=False)
class Tare:
    """Where the sensors stand when nothing touches, from one quiet window."""

    time_s: float
    """Mean time of the window's samples, host clock."""
    start_s: float
    end_s: float
    wrench: FloatArray
    """(6,) float, mean, N and N m, sensor frame."""
    skin: FloatArray
    """(channels,) float, raw, median; NaN where the channel gave no number."""


def wrench_baseline(before: Tare, after: Tare | None, time_s: float) -> FloatArray:
    """Return the wrench of no touch at `time_s`, (6,) float, N and N m, linear in time between two tares.

    Without a second one it is that of the first.
    """
    if after is None or after.time_s <= before.time_s:
        return before.wrench
    share = (time_s - before.time_s) / (after.time_s - before.time_s)
    return before.wrench + share * (after.wrench - before.wrench)


def force_change(before: Tare, after: Tare | None) -> float:
    """Return how far two tares differ in force, N; NaN where there is no second."""
    return float("nan") if after is None else float(np.linalg.norm(after.wrench[:3] - before.wrench[:3]))


def robust_level(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the median and a robust standard deviation of each column of (n, channels), NaN left out; NaN without a number.

    The standard deviation is the interquartile range over 1.349.
    """
    ordered = np.sort(values, axis=0)  # NaN sort to the end
    count = values.shape[0] - np.isnan(values).sum(axis=0)
    last = np.maximum(count - 1, 0)

    # Linear between the two nearest values in order, each column with its own count where these differ.
    def at(share: float) -> FloatArray:
        if len(last) and last.min() == last.max():
            place = share * float(last[0])
            below, above = ordered[int(place)], ordered[min(int(place) + 1, int(last[0]))]
            return below + (place - int(place)) * (above - below)
        place = share * last
        low = place.astype(np.int64)
        high = np.minimum(low + 1, last)
        columns: IntArray = np.arange(values.shape[1], dtype=np.int64)
        below, above = ordered[low, columns], ordered[high, columns]
        return below + (place - low) * (above - below)

    return at(0.5), (at(0.75) - at(0.25)) / _IQR_OF_SD


def is_quiet(window: FloatArray, following: FloatArray) -> bool:
    """Return whether the force, N, rests through a `window` (n, 3) and through the samples straight after it (m, 3)."""
    mean = mean_rows(window)
    off = window - mean
    spread = math.sqrt(np.add.reduce(mean_rows(off * off)))
    half = len(window) // 2
    within = length_of(mean_rows(window[-half:]) - mean_rows(window[:half]))
    onward = length_of(mean_rows(following) - mean)
    return spread <= QUIET_SPREAD and max(within, onward) <= QUIET_SHIFT


def window_length(seconds: float, period_s: float) -> int:
    """Return how many samples a window of `seconds` holds, within `LEAST_WINDOW` and `MOST_WINDOW`."""
    if period_s * MOST_WINDOW <= seconds:  # also while no period is known
        return MOST_WINDOW
    return max(LEAST_WINDOW, round(seconds / period_s))


class TareKeeper:
    """Watches the time between pokes for quiet windows and keeps the newest tares; a skin frame has `channels` values."""

    def __init__(self, settings: ContactSettings, channels: int) -> None:
        self.quiet_s = settings.quiet_s
        """s, length of a quiet window."""
        self._run: deque[Sample] = deque()
        # Tares follow one another by half a window and more: eight reach back beyond `ONSET_S`.
        self._recent: deque[Tare] = deque(maxlen=8)
        # Samples since the last tare.
        self._fresh = 0
        # Quiet windows that the noise is averaged over so far.
        self._blocks = 0
        self._variance = np.zeros(channels)
        self.noise: FloatArray = np.zeros(channels)
        """(channels,) float, raw units, sd of each channel at rest; 0 before the first tare."""
        self.resting: FloatArray | None = None
        """(channels,) float, raw: the last known skin at rest; stays when the tare is dropped."""

    @property
    def tare(self) -> Tare | None:
        """The newest tare."""
        return self._recent[-1] if self._recent else None

    def before(self, touch_s: float) -> Tare | None:
        """Return the tare for a poke that touches at `touch_s`: the newest that ends clear of it."""
        for tare in reversed(self._recent):
            if tare.end_s <= touch_s - ONSET_S:
                return tare
        return self.tare

    def interrupt(self) -> None:
        """Forget the quiet time so far: something touched, or readings are missing."""
        self._run.clear()

    def drop(self) -> None:
        """Forget the tares: the load on the sensor is not what it was."""
        self._run.clear()
        self._recent.clear()

    def feed(self, sample: Sample, period_s: float) -> Tare | None:
        """Take one sample without a touch; return the new tare if it completes a quiet window."""
        quiet = window_length(self.quiet_s, period_s)
        guard = max(1, quiet // 2)
        self._run.append(sample)
        while len(self._run) > quiet + guard:
            self._run.popleft()
        self._fresh += 1
        if len(self._run) < quiet + guard or (self._recent and self._fresh < guard):
            return None
        return self._try(list(self._run), quiet)

    def _try(self, run: Sequence[Sample], quiet: int) -> Tare | None:
        wrench = np.array([sample.wrench for sample in run])
        if not is_quiet(wrench[:quiet, :3], wrench[quiet:, :3]):
            return None
        window = run[:quiet]
        median, sd = robust_level(np.array([sample.skin for sample in window]))
        self._learn_noise(sd)
        tare = Tare(
            time_s=mean_time(window),
            start_s=window[0].host_s,
            end_s=window[-1].host_s,
            wrench=mean_rows(wrench[:quiet]),
            skin=median,
        )
        self._recent.append(tare)
        self.resting = median
        self._fresh = 0
        return tare

    def _learn_noise(self, sd: FloatArray) -> None:
        self._blocks = min(self._blocks + 1, NOISE_BLOCKS)
        # A running mean of the variance: of the first blocks all alike, then the newest weigh one in `NOISE_BLOCKS`.
        self._variance += np.where(np.isfinite(sd), sd**2 - self._variance, 0.0) / self._blocks
        self.noise = np.sqrt(self._variance)


def mean_time(window: Sequence[Sample]) -> float:
    """Return the mean time of samples, host clock, seconds."""
    # From the first time on, so that seconds since boot keep their last digits.
    first = window[0].host_s
    return first + sum(sample.host_s - first for sample in window) / len(window)
