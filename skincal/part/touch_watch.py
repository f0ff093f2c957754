"""Channels of a skin that answer a touch, before there is a scene: changes from the values at rest, above their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import list_channels, plural

FRAMES_AT_REST_FIRST = 25
"""Frames without a touch at the start: half a second at 50 Hz."""
ANSWER_MIN_SHARE_OF_LARGEST_CHANGE = 0.25
"""Of the largest change: channels with less did not answer, they only lie near."""
ANSWER_MIN_NOISE_SDS = 6.0
"""Standard deviations of a channel's own noise."""
ANSWER_MIN_RAW_CHANGE = 1.0
"""Raw units: one step of a device."""


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


class TouchWatch:
    """Follows the frames of a skin of `channels` values; the first `FRAMES_AT_REST_FIRST` are those at rest."""

    def __init__(self, channels: int) -> None:
        self._rest: list[FloatArray] = []
        self._low, self._high = np.full(channels, np.inf), np.full(channels, -np.inf)
        self._mean, self._noise = np.zeros(channels), np.zeros(channels)

    @property
    def is_ready(self) -> bool:
        """Whether the values at rest are known."""
        return len(self._rest) >= FRAMES_AT_REST_FIRST

    def feed(self, frame: FloatArray) -> None:
        """Take a frame, (channels,) raw values; NaN is missing."""
        if len(frame) != len(self._mean):
            return
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
        change = np.maximum(np.fmax(rise, fall), 0.0)
        change[~np.isfinite(change)] = 0.0
        least = max(ANSWER_MIN_RAW_CHANGE, ANSWER_MIN_SHARE_OF_LARGEST_CHANGE * float(change.max(initial=0.0)))
        channels = np.flatnonzero(change > np.maximum(least, ANSWER_MIN_NOISE_SDS * self._noise))
        falls = bool(len(channels)) and float(fall[channels].sum()) > float(rise[channels].sum())
        return Touch(channels, falls)
