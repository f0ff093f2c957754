"""Estimates of one method in the order of a plan, and numbers of each that are computed again only if it changed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress
from operator import is_not

import numpy as np

from skincal.geometry import BoolArray, FloatArray, IntArray
from skincal.guide.believed_positions import measured_positions
from skincal.guide.progress import improvable_error
from skincal.taxels.result import Estimate, Method, State, has_touch


class FollowedEstimates:
    """Estimates of one method of the taxels `channels` (n,).

    Parameters
    ----------
    skin : m, as for `improvable_error`
    """

    def __init__(self, channels: IntArray, method: Method, skin: float) -> None:
        count = len(channels)
        self._channels, self._skin = channels.tolist(), skin
        # The same object each time for a taxel without an estimate, since identities are compared.
        self._unseen = [Estimate(channel, method, State.UNSEEN, 0) for channel in self._channels]
        self._given: Sequence[Estimate] | None = None
        self._rows: IntArray = np.empty(0, dtype=np.int64)
        """Row of each given estimate; -1 for a channel that is no taxel of the plan."""
        self.estimates: list[Estimate | None] = [None] * count
        """One a taxel; `None` before the first `update`."""
        self.rms: FloatArray = np.full(count, np.inf)
        """(n,) float, metres: predicted error; infinite without an estimate."""
        self.errors: FloatArray = np.full(count, np.inf)
        """(n,) float, metres: predicted rms error, or sd of the known directions; infinite without an estimate."""
        self.improvable: FloatArray = np.full(count, np.inf)
        """(n,) float, metres: `improvable_error`."""
        self.touched: BoolArray = np.zeros(count, dtype=bool)
        """(n,) whether a trusted contact touched the taxel, and its pokes do not contradict its place."""
        self.positions: FloatArray = np.full((count, 3), np.nan)
        """(n, 3) float, metres; NaN without an estimate."""
        self.precisions: FloatArray = np.zeros((count, 3, 3))
        """(n, 3, 3) float, 1/m^2; 0 without an estimate."""

    def update(self, given: Sequence[Estimate]) -> list[int]:
        """Follow the estimates of the taxels to their present state; return the rows of those that changed, ascending."""
        changed = self._changed_rows(given)
        self._given = given
        now = [estimate for row in changed if (estimate := self.estimates[row]) is not None]
        for row, estimate in zip(changed, now, strict=True):
            self.rms[row] = np.inf if estimate.rms is None else estimate.rms
            error = estimate.sd if estimate.rms is None else estimate.rms
            self.errors[row] = np.inf if error is None else error
            self.improvable[row] = improvable_error(estimate, self._skin)
            self.touched[row] = has_touch(estimate.contacts, estimate.doubted) and not estimate.is_contradicted
        if changed:
            self.positions[changed], self.precisions[changed] = measured_positions(now)
        return changed

    def _changed_rows(self, given: Sequence[Estimate]) -> list[int]:
        """Take over the given estimates; return the rows with another one than before."""
        before = self._given
        if given is before:
            return []
        if before is not None and len(before) == len(given):
            places = list(compress(range(len(given)), map(is_not, given, before)))
            if all(given[place].channel == before[place].channel for place in places):
                pairs = [(int(self._rows[place]), given[place]) for place in places]
                for row, estimate in pairs:
                    if row >= 0:
                        self.estimates[row] = estimate
                return sorted(row for row, _ in pairs if row >= 0)
        row_of = {channel: row for row, channel in enumerate(self._channels)}
        self._rows = np.array([row_of.get(estimate.channel, -1) for estimate in given], dtype=np.int64)
        now = list(self._unseen)
        for row, estimate in zip(self._rows.tolist(), given, strict=True):
            if row >= 0:
                now[row] = estimate
        changed = list(compress(range(len(now)), map(is_not, now, self.estimates)))
        self.estimates[:] = now
        return changed
