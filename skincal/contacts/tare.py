"""The quiet time around each poke: the levels of force sensor and skin when nothing touches.

A force sensor drifts by tenths of newtons within minutes, which moves the force axis by millimetres. So every poke is tared by
the quiet windows before and after it, linear in time between them. A tare is the mean wrench of one quiet window, at the mean
time of its samples: offset and linear drift vanish exactly.

The skin's baseline is that of the quiet window before the poke only: foam recovers slowly after a press.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skincal.geometry import FloatArray, length_of, mean_rows
from skincal.model.readings import Sample
from skincal.model.scene import ContactSettings

QUIET_WINDOW_MAX_FORCE_SPREAD_N = 0.35
"""N. Largest spread (root of the summed variances) of a quiet window: twice that of 0.1 N noise an axis."""
QUIET_WINDOW_MAX_FORCE_SHIFT_N = 0.2
"""N. Largest change of the mean force within and directly after a quiet window: above noise of 0.1 N, below a tool."""
TARE_TO_TOUCH_MIN_S = 0.2
"""s. Time from the end of a tare to the touch, at least, if there is such a tare: a slow touch needs it to reach
`touch_force`."""
TARE_AGE_MAX_S = 10.0
"""s. Older tares are not used: drift of 0.5 N in ten minutes is 0.01 N in this time."""
MIN_WINDOW_SAMPLES, MAX_WINDOW_SAMPLES = 4, 1024
"""Fewer samples say nothing about their spread; more only take memory, for a device that claims to be fast."""
WINDOWS_IN_NOISE_MEAN = 16
"""Quiet windows over which a channel's noise is averaged: ten samples alone give it to 25 %."""
NORMAL_IQR_OVER_SD = 1.349
"""Interquartile range of a normal distribution, in standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class Tare:
    """Levels of the sensors when nothing touches, from one quiet window."""

    time_s: float
    """Mean time of the window's samples, host clock."""
    start_s: float
    end_s: float
    wrench: FloatArray
    """(6,) float, mean, N and N m, sensor frame."""
    skin: FloatArray = field(default_factory=lambda: np.empty(0), metadata={"stored": False})
    """(values,) float, raw, median; NaN if the channel gave no number. Empty in a tare that was read from a journal."""


def wrench_baseline(before: Tare, after: Tare | None, time_s: float) -> FloatArray:
    """Interpolate the wrench without touch at `time_s`, (6,) float, N and N m; that of `before` without a second tare."""
    if after is None or after.time_s <= before.time_s:
        return before.wrench
    share = (time_s - before.time_s) / (after.time_s - before.time_s)
    return before.wrench + share * (after.wrench - before.wrench)


def force_change(before: Tare, after: Tare | None) -> float:
    """Compute the difference in force of two tares, N; NaN without a second one."""
    return float("nan") if after is None else float(np.linalg.norm(after.wrench[:3] - before.wrench[:3]))


def robust_level(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the median and a robust standard deviation of each column of (n, channels), without NaN; NaN without a number.

    The standard deviation is the interquartile range over 1.349.
    """
    ordered = np.sort(values, axis=0)  # NaN sort to the end
    last = np.maximum(np.count_nonzero(~np.isnan(values), axis=0) - 1, 0)

    def quantile(share: float) -> FloatArray:
        # Linear between two values; numpy's own differ in the last bit, which old sessions hold.
        at = share * last
        low = at.astype(np.int64)
        below, above = np.take_along_axis(ordered, np.array([low, np.minimum(low + 1, last)]), axis=0)
        return below + (at - low) * (above - below)

    return quantile(0.5), (quantile(0.75) - quantile(0.25)) / NORMAL_IQR_OVER_SD


def is_quiet(window: FloatArray, following: FloatArray) -> bool:
    """Whether the force, N, is constant in a `window` (n, 3) and in the samples directly after it (m, 3)."""
    mean = mean_rows(window)
    off = window - mean
    spread = math.sqrt(np.add.reduce(mean_rows(off * off)))
    half = len(window) // 2
    within = length_of(mean_rows(window[-half:]) - mean_rows(window[:half]))
    onward = length_of(mean_rows(following) - mean)
    return spread <= QUIET_WINDOW_MAX_FORCE_SPREAD_N and max(within, onward) <= QUIET_WINDOW_MAX_FORCE_SHIFT_N


def window_length(seconds: float, period_s: float) -> int:
    """Count the samples of a window of `seconds`, within its limits."""
    if period_s * MAX_WINDOW_SAMPLES <= seconds:  # also while no period is known
        return MAX_WINDOW_SAMPLES
    return max(MIN_WINDOW_SAMPLES, round(seconds / period_s))


class TareKeeper:
    """Finds quiet windows between pokes and keeps the newest tares; a skin frame has `width` values."""

    def __init__(self, settings: ContactSettings, width: int) -> None:
        self.quiet_s = settings.quiet_s
        """s, length of a quiet window."""
        self._run: deque[Sample] = deque()
        # Successive tares are half a window apart or more: eight reach back beyond `TARE_TO_TOUCH_MIN_S`.
        self._recent: deque[Tare] = deque(maxlen=8)
        self._samples_since_tare = 0
        self._noise_windows = 0
        self._variance = np.zeros(width)
        self.noise: FloatArray = np.zeros(width)
        """(values,) float, raw units, sd of each value at rest; 0 before the first tare."""
        self.rest_skin: FloatArray | None = None
        """(values,) float, raw: the skin at its last rest; stays when the tare is dropped."""

    @property
    def tare(self) -> Tare | None:
        """The newest tare."""
        return self._recent[-1] if self._recent else None

    def before(self, touch_s: float) -> Tare | None:
        """Find the tare for a poke that touches at `touch_s`: the newest that ends `TARE_TO_TOUCH_MIN_S` before it."""
        for tare in reversed(self._recent):
            if tare.end_s <= touch_s - TARE_TO_TOUCH_MIN_S:
                return tare
        return self.tare

    def interrupt(self) -> None:
        """Forget the quiet time so far: something touched, or readings are missing."""
        self._run.clear()

    def drop(self) -> None:
        """Forget the tares: the load on the sensor changed."""
        self._run.clear()
        self._recent.clear()

    def forget_rest(self) -> None:
        """Forget the skin's values at rest, since the skin was pressed."""
        self.rest_skin = None

    def is_quiet_run(self, run: Sequence[Sample], wrench: FloatArray, quiet: int) -> bool:
        """Whether nothing touches in the first `quiet` samples of a run and directly after them; `wrench` is (n, 6), SI."""
        del run
        return is_quiet(wrench[:quiet, :3], wrench[quiet:, :3])

    def feed(self, sample: Sample, period_s: float) -> Tare | None:
        """Process one sample without contact; return the new tare if the sample completes a quiet window."""
        quiet = window_length(self.quiet_s, period_s)
        guard = max(1, quiet // 2)
        self._run.append(sample)
        while len(self._run) > quiet + guard:
            self._run.popleft()
        self._samples_since_tare += 1
        if len(self._run) < quiet + guard or (self._recent and self._samples_since_tare < guard):
            return None
        wrench = np.array([sample.wrench for sample in self._run])
        if not self.is_quiet_run(self._run, wrench, quiet):
            return None
        window = list(self._run)[:quiet]
        median, sd = robust_level(np.array([sample.skin for sample in window]))
        # A running mean of the variance: first of all windows alike, then the newest has a weight of 1/`WINDOWS_IN_NOISE_MEAN`.
        self._noise_windows = min(self._noise_windows + 1, WINDOWS_IN_NOISE_MEAN)
        self._variance += np.where(np.isfinite(sd), sd**2 - self._variance, 0.0) / self._noise_windows
        self.noise = np.sqrt(self._variance)
        tare = Tare(
            time_s=mean_time(window),
            start_s=window[0].host_s,
            end_s=window[-1].host_s,
            wrench=mean_rows(wrench[:quiet]),
            skin=median,
        )
        self._recent.append(tare)
        self.rest_skin = median
        self._samples_since_tare = 0
        return tare


def mean_time(window: Sequence[Sample]) -> float:
    """Compute the mean time of samples, host clock, seconds."""
    # Relative to the first one, so that seconds since boot keep their last digits.
    first = window[0].host_s
    return first + sum(sample.host_s - first for sample in window) / len(window)
