"""Offset of the skin's times against those of the wrench, from the edges of the presses.

A press changes force and skin at once. The changes from one step to the next, of the wrench and of the taxel that changes most,
are correlated at offsets of up to `MAX_OFFSET_S`. Two loggers with clocks of their own shift the best offset from zero. The
sign of the answers does not matter, so a wrong polarity is no offset.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from skincal.geometry import FloatArray

STEP_S, LONGEST_STEP_S = 0.05, 0.5
"""s between the samples that are compared: at least, and at most."""
REMEMBERED_S = 200.0
MAX_OFFSET_S = 3.0
MIN_OFFSET_S = 0.3
"""s. A smaller one loses no poke that is held for `still_s`."""
MIN_STEPS_WITH_CHANGE = 40
"""Steps of each stream that change: those of five presses."""
MIN_CORRELATION, MIN_GAIN = 0.4, 1.3
"""Of the best offset, and over that of no offset."""
MAX_RIVAL_SHARE = 0.9
"""Correlation of another offset over the best one, from which it is open which is right: pokes follow each other evenly."""
NOISE_MEDIANS = 3.0
"""Changes below this multiple of their median are noise."""
STRONG_CHANGE_QUANTILE = 0.9
"""Of the changes above noise: larger ones count as much."""
LOOK_AGAIN_AFTER_S = 20.0


class StreamOffsetWatch:
    """Follows the changes of wrench and skin; the same samples give the same offset, however often it is read."""

    def __init__(self) -> None:
        self.offset_s: float | None = None
        """As `find_offset` gives it, at the last look that had enough presses; `None` before, and if they agree."""
        self._steps: deque[tuple[float, float, float]] = deque(maxlen=round(REMEMBERED_S / STEP_S))
        """Time, s, and the changes of wrench, N, and skin, raw units."""
        self._last: tuple[float, FloatArray, FloatArray] | None = None
        self._look_at_s = -math.inf

    def add(self, host_s: float, force: FloatArray, skin: FloatArray) -> None:
        """Process a sample: force (3,), N, and the watched values of the skin (n,), raw units."""
        if self._last is None:
            self._last, self._look_at_s = (host_s, force, skin), host_s + LOOK_AGAIN_AFTER_S
            return
        since_s = host_s - self._last[0]
        if 0.0 <= since_s < STEP_S:
            return
        if 0.0 <= since_s < LONGEST_STEP_S:
            off = force - self._last[1]
            change = np.fmax.reduce(np.abs(skin - self._last[2]), initial=0.0)
            # A pause of days would be a grid of millions of steps.
            while self._steps and self._steps[0][0] < host_s - REMEMBERED_S:
                self._steps.popleft()
            self._steps.append((host_s, math.sqrt(off @ off), float(change)))
        self._last = (host_s, force, skin)
        if host_s >= self._look_at_s and self._steps:
            self._look_at_s = host_s + LOOK_AGAIN_AFTER_S
            found = find_offset(*np.array(self._steps, dtype=np.float64).T)
            if found is not None:
                self.offset_s = found or None


def find_offset(times: FloatArray, wrench: FloatArray, skin: FloatArray) -> float | None:
    """Find the offset of the skin against the wrench, s, positive if the skin comes late; 0 if they agree, `None` if unknown.

    Infinite if they disagree, and several offsets fit: in a journal NaN would become `None`.

    Parameters
    ----------
    times : (n,) s, ascending
    wrench, skin : (n,) changes since the step before
    """
    grid = np.arange(times[0], times[-1], STEP_S)
    most = round(MAX_OFFSET_S / STEP_S)
    if len(grid) <= 2 * most:
        return None
    one, other = (_edges(np.interp(grid, times, each)) for each in (wrench, skin))
    inner = one[most:-most]
    if min(np.count_nonzero(inner), np.count_nonzero(other)) < MIN_STEPS_WITH_CHANGE:
        return None
    shifts = np.arange(-most, most + 1)
    found = np.array([inner @ other[most + shift : len(other) - most + shift] for shift in shifts])
    found /= np.sqrt((inner @ inner) * (other @ other))
    best = int(shifts[found.argmax()])
    near = found[np.abs(shifts) * STEP_S < MIN_OFFSET_S].max()
    if found.max() < MIN_CORRELATION:
        return None
    if abs(best) * STEP_S < MIN_OFFSET_S or found.max() < MIN_GAIN * near:
        return 0.0
    rival = found[np.abs(shifts - best) * STEP_S >= MIN_OFFSET_S].max()
    return best * STEP_S if rival < MAX_RIVAL_SHARE * found.max() else math.inf


def _edges(changes: FloatArray) -> FloatArray:
    """Reduce changes (n,) to those above noise, each at most 1."""
    above = np.maximum(changes - NOISE_MEDIANS * np.median(changes), 0.0)
    strong = above[above > 0.0]
    return np.minimum(above / np.quantile(strong, STRONG_CHANGE_QUANTILE), 1.0) if len(strong) else above
