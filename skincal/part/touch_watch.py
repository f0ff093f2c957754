"""Channels of a skin that answer a touch, before there is a scene: changes from the values at rest, above their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import list_channels, plural
from skincal.model.scene import ContactSettings
from skincal.model.skin import RESPONSE_MIN_OF_UNIT

FRAMES_AT_REST_FIRST = 25
"""Frames without a touch at the start: half a second at 50 Hz."""
ANSWER_MIN_SHARE_OF_LARGEST_CHANGE = 0.25
"""Of the largest change: channels with less did not answer, they only lie near."""
ANSWER_MIN_NOISE_SDS = 6.0
"""Standard deviations of a channel's own noise."""
ANSWER_MIN_SHARE_OF_THRESHOLD = 0.1
"""Of the default threshold of the skin's unit: one step of a device with raw values."""
THRESHOLD_NOISE_SDS = 7.5
"""Proposed threshold over the noise of the noisiest channel: for 0.02 N it is 0.15 N."""
THRESHOLD_STEPS = 1.5
"""Proposed threshold over the step of the device, so that a flicker of one step is no answer."""
THRESHOLD_SHARE_OF_TOUCH = 0.1
"""Proposed threshold over the touch, for a skin whose noise and step are not known."""
STEP_MAX_SHARE_OF_TOUCH = 0.25
ANSWER_MIN_THRESHOLDS = 2.0
"""A touch is clear from this many thresholds on."""


@dataclass(frozen=True, slots=True)
class Touch:
    """Answer of a skin to a touch."""

    channels: IntArray
    """(n,) that answered."""
    falls: bool
    """Their values fell."""

    def sentence(self) -> str:
        """Describe the answer."""
        count = len(self.channels)
        if not count:
            return "No channel has answered yet. Press the skin."
        went = "fell" if self.falls else "rose"
        first, last = int(self.channels[0]), int(self.channels[-1])
        whole = " They are one block, as of one module." if count > 1 and last - first + 1 == count else ""
        return f"{plural(count, 'channel')} answered and {went}: {list_channels(self.channels)}.{whole}"


@dataclass(frozen=True, slots=True)
class TouchThreshold:
    """Threshold of a taxel's answer that noise and touch of a skin suggest, in the unit of the skin."""

    noise: float
    """Standard deviation at rest of the noisiest channel."""
    answer: float
    """Largest change by the touch."""
    proposed: float
    is_clear: bool
    """Whether the touch is well above the proposed threshold."""

    def fits(self, threshold: float) -> bool:
        """Check whether a touch like this one is well above a threshold and the noise, and noise is below the threshold."""
        limit = max(threshold, ContactSettings().response_noises * self.noise)
        return self.noise < threshold and ANSWER_MIN_THRESHOLDS * limit <= self.answer

    def sentence(self, used: float, unit: str) -> str:
        """Compare noise and touch with the threshold in use, and propose another one if it does not fit."""
        name = unit or "raw units"
        begin = f"Noise at rest {self.noise:.2g} {name} (noisiest channel), touch {self.answer:.2g} {name}"
        if self.fits(used):
            return f"{begin}: the threshold of {used:g} {name} fits."
        if not self.is_clear:
            return f"{begin}: the touch is not clear of the noise. Press harder, or check supply and shield of the skin."
        why = "no taxel would answer" if self.answer <= used else "answers would be near the threshold"
        if used <= self.noise:
            why = "noise would count as an answer"
        return f"{begin}. With the threshold of {used:g} {name} {why}: use {self.proposed:g} {name}."


def default_threshold(unit: str) -> float:
    """Return the default of `response_min` for a unit of the skin; empty for raw values."""
    return RESPONSE_MIN_OF_UNIT.get(unit, ContactSettings().response_min)


class TouchWatch:
    """Follows the frames of a skin of `channels` values; the first `FRAMES_AT_REST_FIRST` are those at rest.

    `unit` is that of the values; empty for raw ones.
    """

    def __init__(self, channels: int, unit: str = "") -> None:
        self.unit = unit
        self._step = np.inf
        """Smallest difference of a channel's successive values."""
        self._last = np.full(channels, np.nan)
        self._rest: list[FloatArray] = []
        self._low, self._high = np.full(channels, np.inf), np.full(channels, -np.inf)
        self._mean, self._noise = np.zeros(channels), np.zeros(channels)

    @property
    def is_ready(self) -> bool:
        """Whether the values at rest are known."""
        return len(self._rest) >= FRAMES_AT_REST_FIRST

    def feed(self, frame: FloatArray) -> None:
        """Take a frame, (channels,) values; NaN is missing."""
        if len(frame) != len(self._mean):
            return
        differences = np.abs(frame - self._last)
        self._step = min(self._step, float(np.min(differences, where=differences > 0, initial=np.inf)))
        self._last = frame
        if not self.is_ready:
            self._rest.append(frame)
            if self.is_ready:
                rest = np.nan_to_num(np.stack(self._rest))
                self._mean, self._noise = rest.mean(axis=0), rest.std(axis=0)
            return
        self._low, self._high = np.fmin(self._low, frame), np.fmax(self._high, frame)

    def touch(self) -> Touch:
        """Find the channels that answered since the start."""
        rise, fall = self._high - self._mean, self._mean - self._low
        change = self._largest_changes()
        smallest = ANSWER_MIN_SHARE_OF_THRESHOLD * default_threshold(self.unit)
        least = max(smallest, ANSWER_MIN_SHARE_OF_LARGEST_CHANGE * float(change.max(initial=0.0)))
        channels = np.flatnonzero(change > np.maximum(least, ANSWER_MIN_NOISE_SDS * self._noise))
        falls = bool(len(channels)) and float(fall[channels].sum()) > float(rise[channels].sum())
        return Touch(channels, falls)

    def threshold(self) -> TouchThreshold | None:
        """Propose the threshold of a taxel's answer; `None` before a touch."""
        if not len(self.touch().channels):
            return None
        noise, answer = float(self._noise.max()), float(self._largest_changes().max())
        # Of a device that sends nothing between rest and touch the step is not known.
        step = self._step if self._step <= STEP_MAX_SHARE_OF_TOUCH * answer else 0.0
        least = max(THRESHOLD_NOISE_SDS * noise, THRESHOLD_STEPS * step) or THRESHOLD_SHARE_OF_TOUCH * answer
        proposed = float(f"{least:.2g}")
        return TouchThreshold(noise, answer, proposed, 0 < ANSWER_MIN_THRESHOLDS * proposed <= answer)

    def _largest_changes(self) -> FloatArray:
        """Return the largest change of each channel (channels,) from its value at rest, either way."""
        change = np.maximum(np.fmax(self._high - self._mean, self._mean - self._low), 0.0)
        change[~np.isfinite(change)] = 0.0
        return change
