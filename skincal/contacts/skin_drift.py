"""Drift of the skin: values at rest that rise or fall while the skin warms up, or its supply settles.

A drift of 20 raw units a second lifts every taxel over its limit within a poke. Then the values at rest are a straight line
between the tares before and after the poke, as for the wrench. Before the second tare the line goes on at the rate of the last
pokes.

Foam recovers slowly, so pressed taxels are still above their rest in the second tare. On a skin without drift the line would
take a part of their answers away, so it is used only if unpressed channels change. A press cannot be taken for drift: it is
over in both tares, and the channels that it pressed do not count.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from skincal.contacts.press import FinishedPress
from skincal.contacts.tare import Tare
from skincal.contacts.taxel_answers import TaxelAnswers
from skincal.geometry import FloatArray, IntArray

DRIFT_MIN_SHARE_OF_LIMIT = 0.4
"""Of the response above which a channel answers. A channel that changes by less from tare to tare does not drift: a limit is at
least five standard deviations of a frame, and medians of ten frames differ by 0.6."""
DRIFT_MIN_SHARE_OF_CHANNELS = 0.25
"""Share of the unpressed channels that must drift; fewer are faulty channels."""
DRIFT_MIN_CHANNELS = 2
POKES_FOR_RATE = 5
"""Newest pokes whose median rate is that of the next one."""


class SkinDrift:
    """Drift of the taxels `candidates` (c,) of a skin with these `answers`, whose frames have `width` values."""

    def __init__(self, candidates: IntArray, width: int, answers: TaxelAnswers) -> None:
        self._candidates, self.answers = candidates, answers
        self._rates: deque[FloatArray] = deque(maxlen=POKES_FOR_RATE)
        self.rate: FloatArray = np.zeros(width)
        """(values,) float, raw units a second, of the last pokes; 0 without drift."""
        self.means: list[float] = []
        """Raw units a second: for each drifting poke the median rate of its channels."""

    def rest_at(self, tare: Tare, time_s: float) -> FloatArray:
        """Predict the values at rest (values,), raw, from the tare before."""
        return tare.skin + self.rate * (time_s - tare.time_s) if self._rates else tare.skin

    def with_first_answers(self, press: FinishedPress, time_s: float) -> FinishedPress:
        """Measure the answers of a press at `time_s` from the tare before it: the one after it is not known yet."""
        return self._with_answers(press, press.skin - self.rest_at(press.before, time_s))

    def judge(self, press: FinishedPress, after: Tare | None) -> FinishedPress:
        """Measure the answers of a finished press from the line between its tares if the skin drifts, else from the first one.

        Returns the press itself if its answers stay.
        """
        before, still = press.before, press.still
        if after is None or still is None or not len(press.skin) or after.time_s <= before.time_s:
            return press
        span = after.time_s - before.time_s
        change = after.skin - before.skin
        share = (still.time_s - before.time_s) / span
        above_line = press.skin - before.skin - share * change
        if not self._is_drifting(self.answers.responses(above_line), change, press.limit):
            self._forget()
            return self._with_answers(press, press.skin - before.skin) if press.drifted else press
        self._rates.append(change / span)
        self.rate = np.nan_to_num(np.median(np.array(self._rates), axis=0))
        self.means.append(float(np.nanmedian(self.answers.watched(change)[self._candidates] / span)))
        return replace(self._with_answers(press, above_line), drifted=True)

    def _is_drifting(self, above_line: FloatArray, change: FloatArray, limit: FloatArray) -> bool:
        own = self._candidates
        unpressed = above_line[own] <= limit[own]  # NaN is neither
        changed = unpressed & (self.answers.sizes(change)[own] > DRIFT_MIN_SHARE_OF_LIMIT * limit[own])
        least = max(DRIFT_MIN_CHANNELS, DRIFT_MIN_SHARE_OF_CHANNELS * np.count_nonzero(unpressed))
        return bool(np.count_nonzero(changed) >= least)

    def _forget(self) -> None:
        if self._rates:
            self._rates.clear()
            self.rate = np.zeros_like(self.rate)

    def _with_answers(self, press: FinishedPress, change: FloatArray) -> FinishedPress:
        answers = self.answers
        return press.with_answers(answers.responses(change), self._candidates, answers.vectors(change, press.skin))
