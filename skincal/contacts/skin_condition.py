"""Condition of the skin as a whole: noise, drift, frames that were normalised one by one, and the end of its range.

**Normalised frames.** A program that scales each frame by its own smallest and largest value makes noise at rest as large as an
answer. Then these values are the same in every frame, and another channel has them each time.

**End of the range.** A converter sends no more than 255, 1023 or 4095. A value is the end of the range if it is the largest of
the log, pressed taxels keep it in several pokes, and these do not agree by chance: two taxels have it at once, or the forces
differ, or the taxels are noisy at rest. A pressed taxel at the end has no height: how much more it would answer is unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from skincal.contacts.press import FinishedPress
from skincal.contacts.skin_drift import SkinDrift
from skincal.contacts.taxel_answers import TaxelAnswers
from skincal.contacts.value_order import ValueOrderCounts, count_strongest
from skincal.geometry import FloatArray, IntArray
from skincal.model.codec import OPTIONAL_FIELD
from skincal.model.scene import Scene

MIN_FRAMES_TO_CALL_NORMALISED = 100
NORMALISED_MIN_SHARE_OF_FRAMES = 0.95
"""Share of the frames that have the same largest value; a program sends other values while it starts."""
NORMALISED_MIN_SHARE_OF_OTHER_HOLDERS = 0.2
"""Share of the frames with another strongest channel than the frame before: at rest that is by chance."""
RANGE_END_MIN_POKES = 3
"""Pokes with taxels at a value that make it the end of the range."""
RANGE_END_MIN_FORCE_RATIO = 1.15
"""Largest force of these pokes over the smallest from which equal answers are no chance."""
STANDARDISED_MAX_CHANGE = 1e-4
"""Largest change of mean and standard deviation of successive frames, in standard deviations, if both are always the same."""
MAX_REMEMBERED_POKES = 1000
"""Newest pokes whose answers and noise count."""


@dataclass(frozen=True, slots=True)
class SkinCondition:
    """Condition of the skin over a session; NaN for numbers that are not known."""

    pokes: int = 0
    """Pokes that were held still."""
    answer: float = math.nan
    """Raw units, median over these pokes of the largest response of a taxel."""
    noise: float = math.nan
    """Raw units, median over these pokes of the taxels' median standard deviation at rest."""
    answer_over_noise: float = math.nan
    """Median over these pokes of the largest ratio of a taxel's response to its noise."""
    drifting: int = 0
    """Pokes during a drift of the values at rest."""
    drift: float = math.nan
    """Raw units a second, median over these."""
    lowest: float = math.nan
    """Raw value that each frame has as its smallest one."""
    highest: float = math.nan
    """Raw value that each frame has as its largest one."""
    is_standardised: bool = False
    """Each frame has the same mean and standard deviation."""
    range_end: float = math.nan
    """Raw value that pressed taxels cannot exceed."""
    clipped: int = 0
    """Pokes with taxels at that value."""
    clipped_together: int = 0
    """Those of them with several taxels at that value."""
    value_order: ValueOrderCounts | None = field(default=None, metadata=OPTIONAL_FIELD)
    """Order of the values as the pokes show it; `None` for a skin of one axis, and before the first poke on the skin."""
    offset_s: float | None = field(default=None, metadata=OPTIONAL_FIELD)
    """See `find_offset` of `stream_offset`."""

    @property
    def is_known(self) -> bool:
        """Whether there were pokes, or normalised frames."""
        return self.pokes > 0 or self.is_normalised

    @property
    def is_normalised(self) -> bool:
        """Whether a program scaled each frame alone."""
        return self.is_standardised or not math.isnan(self.highest)

    def plus(self, newer: SkinCondition) -> SkinCondition:
        """Add the condition of a later part of the session."""
        larger = self if self.pokes > newer.pokes else newer
        drift = self.drift if self.drifting > newer.drifting else newer.drift
        known = newer if not math.isnan(newer.highest) else self
        return SkinCondition(
            self.pokes + newer.pokes,
            larger.answer,
            larger.noise,
            larger.answer_over_noise,
            self.drifting + newer.drifting,
            drift,
            known.lowest,
            known.highest,
            self.is_standardised or newer.is_standardised,
            self.range_end if math.isnan(newer.range_end) else newer.range_end,
            self.clipped + newer.clipped,
            self.clipped_together + newer.clipped_together,
            newer.value_order if self.value_order is None else self.value_order.plus(newer.value_order),
            self.offset_s if newer.offset_s is None else newer.offset_s,
        )


def _mean_and_sd(values: FloatArray) -> tuple[float, float]:
    """Return mean and standard deviation of the values (n,) that are numbers, as `np.nanmean` and `np.nanstd`.

    Both cost a tenth of these functions where all values are numbers, as in nearly every frame.
    """
    mean = float(np.add.reduce(values)) / len(values)
    if math.isnan(mean):
        return float(np.nanmean(values)), float(np.nanstd(values))
    off = values - mean
    return mean, math.sqrt(float(np.add.reduce(off * off)) / len(values))


@dataclass(frozen=True, slots=True)
class _PokeAtTop:
    """A poke with taxels that kept the largest raw value of its still window."""

    top: float
    channels: IntArray
    force: float
    """N, peak."""
    is_noisy: bool
    """A taxel at the top has noise at rest of half a raw unit and more, and none while it is pressed."""


class SkinWatch:
    """Watches the taxels `candidates` (c,) of every frame and every poke."""

    def __init__(self, scene: Scene, candidates: IntArray, answers: TaxelAnswers, range_end: float = math.nan) -> None:
        self._candidates, self._polarity, self._answers_of_skin = candidates, scene.skin.polarity, answers
        self._given_end = math.nan if scene.skin.range is None else scene.skin.range[1 if scene.skin.polarity > 0 else 0]
        if math.isnan(self._given_end):
            self._given_end = range_end  # found before a break
        self._frames = self._same_highest = self._same_lowest = self._other_holders = 0
        self._lowest: float = math.nan
        self._highest: float = math.nan
        self._mean = self._sd = math.nan
        self._same_mean, self._holder = 0, -1
        self._newest = b""
        self._levels: set[float] = set()
        self._answers: list[tuple[float, float, float]] = []
        self._still_pokes = 0
        self._at_top: dict[int, _PokeAtTop] = {}
        self.range_end = self._given_end
        """Raw value that pressed taxels cannot exceed; NaN while unknown."""
        self._axes = scene.skin.axes
        self.value_order: ValueOrderCounts | None = None
        """See `SkinCondition`."""

    def on_frame(self, skin: FloatArray) -> None:
        """Process the watched values of one skin frame (channels,)."""
        values = skin[self._candidates]
        newest = values.tobytes()
        if newest == self._newest:  # held for several rows of a log: nothing was measured
            return
        self._newest = newest
        lowest, highest = float(np.fmin.reduce(values)), float(np.fmax.reduce(values))
        if not lowest < highest:  # also NaN
            return
        self._frames += 1
        self._same_lowest += lowest == self._lowest
        if highest == self._highest:
            self._same_highest += 1
            at = np.flatnonzero(values == highest)
            # Ties are no normalised noise.
            is_other = len(at) == 1 and self._holder not in (-1, int(at[0]))
            # Coarse steps at rest have two values in a frame, too.
            self._other_holders += is_other and bool(((values > lowest) & (values < highest)).any())
            self._holder = int(at[0]) if len(at) == 1 else -1
        else:
            self._holder = -1
        self._lowest, self._highest = lowest, highest
        mean, sd = _mean_and_sd(values)
        self._same_mean += max(abs(mean - self._mean), abs(sd - self._sd)) < STANDARDISED_MAX_CHANGE * sd
        self._mean, self._sd = mean, sd
        self._note_levels(values)

    def _note_levels(self, values: FloatArray) -> None:
        """Note the different values of the skin up to three: two are a binary skin."""
        if len(self._levels) < 3:
            self._levels |= set(np.unique(values[np.isfinite(values)])[:3].tolist())

    def on_press(self, press: FinishedPress, noise: FloatArray, limit: FloatArray) -> bool:
        """Process a poke, `noise` and `limit` (channels,) raw units, at rest and of an answer.

        Return whether the end of the range changed.
        """
        if press.still is None or not len(press.skin):
            return False
        if self._axes is not None:
            found = count_strongest(self._axes, press.skin - press.before.skin, float(np.nanmax(limit)))
            self.value_order = found if self.value_order is None else self.value_order.plus(found)
        before = self.range_end
        own = self._candidates
        response = self._answers_of_skin.responses(press.skin - press.before.skin)[own]
        sd = noise[own]
        self._still_pokes += 1
        if np.isfinite(response).any():
            ratios = response / np.where(sd > 0, sd, np.nan)
            ratio = float(np.nanmax(ratios)) if np.isfinite(ratios).any() else math.nan
            self._answers.append((float(np.nanmax(response)), float(np.median(sd)), ratio))
            del self._answers[:-MAX_REMEMBERED_POKES]
        if len(press.at_top) and len(self._levels) > 2:
            is_noisy = bool((noise[press.at_top] >= 0.5).any())
            self._at_top[press.number] = _PokeAtTop(press.top, press.at_top, press.peak, is_noisy)
            self.range_end = self._find_range_end()
        return not _same(before, self.range_end)

    def _find_range_end(self) -> float:
        if not math.isnan(self._given_end) or not self._at_top:
            return self._given_end
        end = max((each.top for each in self._at_top.values()), key=lambda top: self._polarity * top)
        found = [each for each in self._at_top.values() if each.top == end]
        forces = [each.force for each in found]
        is_no_chance = any(len(each.channels) > 1 or each.is_noisy for each in found)
        is_no_chance |= max(forces) > RANGE_END_MIN_FORCE_RATIO * min(forces)
        return end if len(found) >= RANGE_END_MIN_POKES and is_no_chance else math.nan

    def clipped(self, poke: int) -> IntArray | None:
        """Channels of a poke that are at the end of the range; `None` if there are none."""
        at = self._at_top.get(poke)
        return None if at is None or at.top != self.range_end else at.channels

    def condition(self, drift: SkinDrift, offset_s: float | None) -> SkinCondition:
        """Summarize the condition so far, with the offset of the skin's times."""
        answer, noise, ratio = np.array(self._answers or [(math.nan,) * 3]).T
        end = self.range_end
        clipped = [each for each in self._at_top.values() if each.top == end]
        found = SkinCondition(
            pokes=self._still_pokes,
            answer=float(np.median(answer)),
            noise=float(np.median(noise)),
            answer_over_noise=float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else math.nan,
            drifting=len(drift.means),
            drift=float(np.median(drift.means)) if drift.means else math.nan,
            range_end=end if clipped else math.nan,
            clipped=len(clipped),
            clipped_together=sum(len(each.channels) > 1 for each in clipped),
            value_order=self.value_order,
            offset_s=offset_s,
        )
        enough = NORMALISED_MIN_SHARE_OF_FRAMES * self._frames
        if self._frames < MIN_FRAMES_TO_CALL_NORMALISED or len(self._levels) < 3:
            return found
        if self._same_mean >= enough:
            return replace(found, is_standardised=True)
        if self._same_highest < enough or self._other_holders < NORMALISED_MIN_SHARE_OF_OTHER_HOLDERS * self._frames:
            return found
        lowest = self._lowest if self._same_lowest >= enough else math.nan
        return replace(found, highest=self._highest, lowest=lowest)


def _same(one: float, other: float) -> bool:
    return one == other or (math.isnan(one) and math.isnan(other))
