"""Patches of a skin that are published on several topics, joined to frames of the whole skin."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from skincal.geometry import FloatArray

WAITING_READINGS_PER_PATCH_MAX = 20
"""Readings of a patch that wait for those of the others."""
SEVERAL_CLOCKS_AFTER_UNPAIRED_READINGS = 25
"""Readings of each patch without a partner, and without a frame between them, after which the stamps are of several clocks."""
NEWEST_PERIOD_WEIGHT_IN_MEAN = 0.1


class SkinPatches:
    """Joins the readings of several patches. A frame is complete when every patch has sent since the last frame.

    Readings of one frame have stamps that differ by at most half the period of the slowest patch. Without stamps, or with
    stamps of several clocks, a reading waits until a newer one of its patch replaces it.

    Parameters
    ----------
    topics : of the patches, in the order of the channels
    """

    def __init__(self, topics: Sequence[str]) -> None:
        self.topics = tuple(topics)
        self.superseded = [0] * len(self.topics)
        """For each patch: readings that are in no frame, since a newer one replaced them or no partner came."""
        self.stamp_s = math.nan
        """Stamp of the first patch in the last frame, seconds."""
        self._waiting: list[deque[tuple[float, FloatArray]]] = [deque() for _ in self.topics]
        self._last_s, self._periods_s = [math.nan] * len(self.topics), [math.nan] * len(self.topics)
        self._unpaired, self._has_one_clock = 0, True

    def add(self, patch: int, values: FloatArray, stamp_s: float = math.nan) -> FloatArray | None:
        """Take the (n,) values of a patch by its number; return the (channels,) values of a frame that is now complete."""
        self._learn_period(patch, stamp_s)
        # The slowest patch sets the rate of the frames. NaN: its period is not known yet.
        tolerance_s = 0.5 * float(np.max(self._periods_s)) if self._has_one_clock else math.nan
        waiting = self._waiting[patch]
        waiting.append((stamp_s, values))
        self._keep_newest(patch, 1 if math.isnan(tolerance_s) else WAITING_READINGS_PER_PATCH_MAX)
        while all(self._waiting):
            unpaired = self._without_partner(tolerance_s)
            if not unpaired:
                return self._take_frame()
            for each in unpaired:
                self._drop(each)
            self._unpaired += len(unpaired)
        if self._unpaired > SEVERAL_CLOCKS_AFTER_UNPAIRED_READINGS * len(self.topics):
            self._has_one_clock = False
            for each in range(len(self.topics)):
                self._keep_newest(each, 1)
        return None

    def _learn_period(self, patch: int, stamp_s: float) -> None:
        step_s, period_s = stamp_s - self._last_s[patch], self._periods_s[patch]
        self._last_s[patch] = stamp_s
        if math.isnan(period_s):
            self._periods_s[patch] = step_s if step_s > 0.0 else math.nan
        elif step_s > 0.0:
            # A pause is no period.
            self._periods_s[patch] += NEWEST_PERIOD_WEIGHT_IN_MEAN * (min(step_s, 2.0 * period_s) - period_s)

    def _without_partner(self, tolerance_s: float) -> list[int]:
        """List the patches whose oldest reading is too old for the others, or whose next one fits better."""
        newest_s = max(waiting[0][0] for waiting in self._waiting)
        return [
            patch
            for patch, waiting in enumerate(self._waiting)
            if newest_s - waiting[0][0] > tolerance_s
            or (len(waiting) > 1 and abs(waiting[1][0] - newest_s) < newest_s - waiting[0][0])
        ]

    def _take_frame(self) -> FloatArray:
        whole = [waiting.popleft() for waiting in self._waiting]
        self.stamp_s, self._unpaired = whole[0][0], 0
        return np.concatenate([values for _, values in whole])

    def _keep_newest(self, patch: int, count: int) -> None:
        while len(self._waiting[patch]) > count:
            self._drop(patch)

    def _drop(self, patch: int) -> None:
        self._waiting[patch].popleft()
        self.superseded[patch] += 1

    @property
    def problem(self) -> str:
        """Sentence on the reason for readings without partners."""
        if not self._has_one_clock:
            return f"The stamps of {', '.join(self.topics)} are of different clocks; messages are joined as they come"
        if self._unpaired:
            return f"Messages of {', '.join(self.topics)} differ by more than half a period and are not joined"
        return f"The skin waits for {', '.join(self.waiting_for)}; the slowest topic sets its rate"

    @property
    def waiting_for(self) -> list[str]:
        """Topics whose reading the next frame still needs."""
        return [topic for topic, waiting in zip(self.topics, self._waiting, strict=True) if not waiting]
