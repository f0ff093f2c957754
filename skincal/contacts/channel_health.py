"""Find channels that cannot be trusted: without numbers, stuck, or answering pokes far away.

A channel is dead while its cause lasts: one that moves again, or gives numbers again, is used again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType

import numpy as np

from skincal.contacts.press import FinishedPress
from skincal.contacts.tare import TARE_AGE_MAX_S
from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import Scene

DEAD_IF_NO_VALUE_FOR_S = 2.0
"""s. A channel without a number for this time is dead: a hundred frames at 50 Hz."""
STUCK_AT_END_AFTER_S = TARE_AGE_MAX_S
"""s, longer than an accepted poke. A channel that stays at the pressed end of its range for this time is stuck."""
STUCK_IF_CONSTANT_FOR_S = 60.0
"""s. A channel that keeps one exact value for this time is stuck, on a skin with noise."""
NOISY_SKIN_MIN_CHANGED_FRAME_SHARE = 0.75
"""Share of the frames in which the typical channel changes, on a skin with noise of a raw unit and more. On a coarser skin a
good channel may keep its value for minutes."""
STUCK_MIN_POKES_WITHOUT_ANY_CHANGE = 10
"""Pokes that must have been seen before a channel that never changed is stuck; short logs end before
`STUCK_IF_CONSTANT_FOR_S`."""
NEVER_CHANGED_MIN_CHANGED_FRAME_SHARE = 0.5
"""Share of frames with a change of the typical channel, for one without any change to be stuck. Such noise is half a raw unit
and more, so a good channel changes hundreds of times during these pokes."""
STUCK_MIN_POKES_ON_NEIGHBOUR = 6
"""Pokes on a neighbour, without any change of this channel, that make it stuck."""
ALWAYS_ON_MIN_FAR_POKES_ANSWERED = 5
"""Far pokes that a channel must have answered to be always on."""
ALWAYS_ON_MIN_SHARE_OF_FAR_POKES = 0.6
"""Share of the far pokes that a channel must have answered to be always on."""
ALWAYS_ON_MIN_POKES_WITHOUT_LAYOUT = 10
"""Pokes before a channel may be called always on without a layout: then no poke is known to be far."""
ALWAYS_ON_MIN_PEAK_TAXELS_WITHOUT_LAYOUT = 5
"""Different strongest taxels that these pokes must have."""
ALWAYS_ON_MAX_MEDIAN_SHARE_WITHOUT_LAYOUT = 0.5
"""Share of all pokes that the median channel may have answered: on a small skin that spreads a press the inner taxels answer
nearly all, and are right."""
ALWAYS_ON_MIN_SHARE_OF_POKES_WITHOUT_LAYOUT = 0.8
"""Share of all pokes that a channel must have answered to be always on, without a layout."""
MAX_ANSWERING_CHANNELS_PER_POKE = 32
"""Channels. A poke that more of them answer, such as a palm, says nothing about single channels."""
NEIGHBOUR_MAX_SPACINGS = 1.2
"""Largest distance of direct neighbours, in spacings of the layout."""


class DeadCause(Enum):
    """Reason why a channel is dead. The journal stores sentences that begin with these words: they must not change."""

    NO_NUMBER = "gives no number"
    STUCK = "stuck"
    ALWAYS_ON = "always on"


class ChannelHealth:
    """Health of the taxels `candidates` (c,), from every frame and every poke.

    `known` are channels that were dead before a break, with the reason. Each stays dead until it shows otherwise.
    """

    def __init__(self, scene: Scene, candidates: IntArray, known: Mapping[int, str] = MappingProxyType({})) -> None:
        channels, layout = scene.skin.channels, scene.skin.layout
        self._candidates = candidates
        self._positions = None if layout is None else layout.places[candidates]
        self._far = 0.0 if layout is None else 2.0 * scene.contacts.gap_factor * layout.spacing
        self._near = 0.0 if layout is None else NEIGHBOUR_MAX_SPACINGS * layout.spacing
        self._pressed_end = None if scene.skin.range is None else scene.skin.range[1 if scene.skin.polarity > 0 else 0]
        self._last: FloatArray = np.empty(0)
        self._frames = 0
        # Of each channel: time of its last change and of its last number, frames with a change, whether it ever changed.
        self._changed_s, self._number_s = np.zeros((2, channels))
        self._changes = np.zeros(channels, dtype=np.int64)
        self._varied = np.zeros(channels, dtype=bool)
        # Pokes: all, on a neighbour, answered; far ones, and those of them that were answered.
        self._pokes = 0
        self._peaks: Counter[int] = Counter()
        self._near_pokes = np.zeros(channels, dtype=np.int64)
        self._answered, self._far_pokes, self._far_answered = np.zeros((3, len(candidates)), dtype=np.int64)
        self._judged_s = 0.0
        self._known = dict(known)
        self.dead: Mapping[int, str] = known
        """Channels that are not used, with the reason; a new mapping whenever it changes."""

    def on_frame(self, host_s: float, skin: FloatArray) -> bool:
        """Process the watched values (channels,) of a frame; return whether `dead` changed. Judges channels once a second."""
        if not len(self._last):
            self._changed_s[:] = self._number_s[:] = self._judged_s = host_s
            self._last = skin
            return False
        moved, is_number = skin != self._last, ~np.isnan(skin)
        np.copyto(self._changed_s, host_s, where=moved)
        np.copyto(self._number_s, host_s, where=is_number)
        self._changes += moved
        self._varied |= moved & is_number & ~np.isnan(self._last)  # NaN differs from everything
        np.copyto(self._near_pokes, 0, where=moved)
        self._frames += 1
        self._last = skin
        return host_s - self._judged_s >= 1.0 and self._judge(host_s)

    def on_poke(self, press: FinishedPress) -> bool:
        """Process the responses to one poke, accepted or not; return whether `dead` changed."""
        return self._count(press, 1) and self._judge(press.end_s)

    def on_other_answers(self, before: FinishedPress, after: FinishedPress) -> bool:
        """Process other responses to a poke in place of those before; return whether `dead` changed."""
        counted = self._count(before, -1) | self._count(after, 1)
        return counted and self._judge(max(self._judged_s, after.end_s))

    def _count(self, press: FinishedPress, by: int) -> bool:
        """Add a poke to the counts, or take it out again (`by` -1); return whether it says something about channels."""
        channels, responses = press.channels, press.responses
        if not 0 < len(channels) <= MAX_ANSWERING_CHANNELS_PER_POKE:
            return False
        peak = int(channels[np.argmax(responses)])
        answered = np.isin(self._candidates, channels)
        self._pokes += by
        self._peaks[peak] += by
        self._answered += by * answered
        if self._positions is not None:
            is_far = _distance_to_others(self._positions, answered) > self._far
            self._far_pokes += by * is_far
            self._far_answered += by * (is_far & answered)
            distance = np.linalg.norm(self._positions - self._positions[self._candidates == peak], axis=1)
            near = self._candidates[(distance <= self._near) & ~answered]
            # A change since the poke has set the number to zero.
            self._near_pokes[near] = np.maximum(self._near_pokes[near] + by, 0)
        return True

    @property
    def _peak_count(self) -> int:
        """Number of different strongest taxels."""
        return sum(count > 0 for count in self._peaks.values())

    def _judge(self, host_s: float) -> bool:
        """Judge every channel; return whether `dead` changed."""
        self._judged_s = host_s
        # If several causes fit, the last one gives the sentence: the plainest comes last.
        dead = self._always_on() | self._stuck(host_s) | self._without_numbers(host_s)
        self._known = {channel: why for channel, why in self._known.items() if self._still_holds(channel, why)}
        dead = dict(sorted((self._known | dead).items()))
        # Another number in a sentence is no change.
        if dead.keys() == self.dead.keys():
            return False
        self.dead = dead
        return True

    def _still_holds(self, channel: int, why: str) -> bool:
        """Whether a reason found before the break still applies, since no later frame contradicts it."""
        if channel >= len(self._last):
            return False
        if why.startswith(DeadCause.NO_NUMBER.value):
            return bool(np.isnan(self._last[channel]))
        if not why.startswith(DeadCause.ALWAYS_ON.value):
            return not self._varied[channel]
        if self._positions is None:
            return (
                self._pokes < ALWAYS_ON_MIN_POKES_WITHOUT_LAYOUT or self._peak_count < ALWAYS_ON_MIN_PEAK_TAXELS_WITHOUT_LAYOUT
            )
        return bool((self._far_pokes[self._candidates == channel] < ALWAYS_ON_MIN_FAR_POKES_ANSWERED).any())

    def _without_numbers(self, host_s: float) -> dict[int, str]:
        without = host_s - self._number_s[self._candidates] >= DEAD_IF_NO_VALUE_FOR_S
        words = f"{DeadCause.NO_NUMBER.value} for {DEAD_IF_NO_VALUE_FOR_S:g} s or more; check its wiring"
        return dict.fromkeys(self._candidates[without].tolist(), words)

    def _stuck(self, host_s: float) -> dict[int, str]:
        own, word = self._candidates, DeadCause.STUCK.value
        value, unchanged_s = self._last[own], host_s - self._changed_s[own]
        # An exact value means something only if the typical channel changes in most frames.
        typical_changes = float(np.median(self._changes[own]))
        is_noisy = typical_changes >= NOISY_SKIN_MIN_CHANGED_FRAME_SHARE * self._frames
        since = f"for {STUCK_IF_CONSTANT_FOR_S:g} s or more while the others vary"
        dead = {
            c: f"{word}: exactly {self._last[c]:g} {since}"
            for c in own[(unchanged_s >= STUCK_IF_CONSTANT_FOR_S) & is_noisy].tolist()
        }
        varies = typical_changes >= NEVER_CHANGED_MIN_CHANGED_FRAME_SHARE * self._frames
        if varies and self._pokes >= STUCK_MIN_POKES_WITHOUT_ANY_CHANGE:
            # Without a layout nothing says which channels are taxels.
            no_taxel = ", or no taxel" if self._positions is None else ""
            never = own[self._changes[own] == 0].tolist()
            dead |= {c: f"{word}{no_taxel}: exactly {self._last[c]:g} in every frame while the others vary" for c in never}
        pokes = f"through {STUCK_MIN_POKES_ON_NEIGHBOUR} pokes or more on its neighbours"
        near = own[self._near_pokes[own] >= STUCK_MIN_POKES_ON_NEIGHBOUR].tolist()
        dead |= {c: f"{word}: exactly {self._last[c]:g} {pokes}" for c in near}
        if self._pressed_end is not None:
            at_end = own[(unchanged_s >= STUCK_AT_END_AFTER_S) & (value == self._pressed_end)].tolist()
            end = f"{word} at {self._pressed_end:g}, the pressed end of its range, for {STUCK_AT_END_AFTER_S:g} s or more"
            dead |= dict.fromkeys(at_end, end)
        return dead

    def _always_on(self) -> dict[int, str]:
        if self._positions is not None:
            answered, of, where = self._far_answered, self._far_pokes, "that lie elsewhere"
            always = (answered >= ALWAYS_ON_MIN_FAR_POKES_ANSWERED) & (answered >= ALWAYS_ON_MIN_SHARE_OF_FAR_POKES * of)
        elif self._pokes >= ALWAYS_ON_MIN_POKES_WITHOUT_LAYOUT and self._peak_count >= ALWAYS_ON_MIN_PEAK_TAXELS_WITHOUT_LAYOUT:
            answered, of, where = self._answered, np.full(len(self._answered), self._pokes), f"at {self._peak_count} places"
            always = answered >= ALWAYS_ON_MIN_SHARE_OF_POKES_WITHOUT_LAYOUT * self._pokes
            always &= np.median(answered) <= ALWAYS_ON_MAX_MEDIAN_SHARE_WITHOUT_LAYOUT * self._pokes
        else:
            return {}
        return {
            int(self._candidates[k]): f"{DeadCause.ALWAYS_ON.value}: answered {answered[k]} of {of[k]} pokes {where}"
            for k in np.flatnonzero(always)
        }


def _distance_to_others(positions: FloatArray, answered: np.ndarray) -> FloatArray:
    """(c,) distance of each position (c, 2) to the nearest other one that answered; 0 without another one."""
    distance = np.linalg.norm(positions[:, None] - positions[answered][None], axis=-1)
    distance[np.flatnonzero(answered), np.arange(int(answered.sum()))] = np.inf  # a taxel is not its own neighbour
    nearest = distance.min(axis=1)
    return np.where(np.isfinite(nearest), nearest, 0.0)
