"""Which channels cannot be trusted: no number, stuck, or always on; each with a sentence.

A channel is dead while the cause lasts: one that moves again, or gives numbers again, is used again.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from skincal.contacts.tare import TARE_AGE_MAX_S
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.model.scene import Scene

NO_NUMBER_S = 2.0
"""s. A channel that gives no number for so long is dead: a hundred frames at 50 Hz."""
STUCK_END_S = TARE_AGE_MAX_S
"""s. A channel that rests at the pressed end of its range for so long is stuck: longer than any poke that counts."""
STUCK_S = 60.0
"""s. A channel that keeps one exact value for so long on a skin that is never at rest is stuck."""
RESTLESS = 0.75
"""Share of the frames in which the typical channel changes, on a skin that is never at rest: its noise is a raw unit and
more. On a coarser skin a good channel may rest exactly for minutes."""
STUCK_NEAR_POKES = 6
"""Pokes whose strongest taxel is a neighbour, without the slightest change of this one, that make it stuck."""
AWAY_POKES = 5
"""Pokes elsewhere that a channel must have answered to be always on."""
AWAY_SHARE = 0.6
"""Share of the pokes elsewhere that a channel must have answered to be always on."""
BLIND_POKES = 10
"""Without a layout, nothing is known to be elsewhere: pokes before a channel may be called always on."""
BLIND_PEAKS = 5
"""Different strongest taxels that there must be among those pokes."""
BLIND_SHARE = 0.8
"""Share of all pokes that a channel must have answered to be always on, without a layout."""
CROWD = 32
"""Answers. A poke with more, such as a palm, says nothing about single channels."""
NEIGHBOUR = 1.2
"""Spacings of the layout between direct neighbours, at most."""
# How the sentence on each kind begins.
_NO_NUMBER, _STUCK, _ALWAYS_ON = "gives no number", "stuck", "always on"


class ChannelHealth:
    """Watches every frame and every poke.

    Parameters
    ----------
    scene : layout, range and polarity are used
    candidates : (c,) channels that are taxels; the others are ignored
    known : what was found before a break, with the reason; it holds until the channel shows otherwise
    """

    def __init__(self, scene: Scene, candidates: IntArray, known: Mapping[int, str] = MappingProxyType({})) -> None:
        channels = scene.skin.channels
        self._candidates = candidates
        self._far = None if scene.skin.layout is None else 2.0 * scene.contacts.gap_factor * scene.skin.layout.spacing
        self._places = None if scene.skin.layout is None else scene.skin.layout.places[candidates]
        self._near = 0.0 if scene.skin.layout is None else NEIGHBOUR * scene.skin.layout.spacing
        self._end = None if scene.skin.range is None else scene.skin.range[1 if scene.skin.polarity > 0 else 0]
        self._last: FloatArray | None = None
        self._changed_s = np.zeros(channels)
        self._number_s = np.zeros(channels)
        self._changes = np.zeros(channels, dtype=np.int64)
        self._varied = np.zeros(channels, dtype=bool)
        self._frames = 0
        self._near_pokes = np.zeros(channels, dtype=np.int64)
        self._answered = np.zeros(len(candidates), dtype=np.int64)
        self._away = np.zeros(len(candidates), dtype=np.int64)
        self._away_answered = np.zeros(len(candidates), dtype=np.int64)
        self._pokes = 0
        self._peaks: set[int] = set()
        self._looked_s = -np.inf
        self._known = dict(known)
        self.dead: Mapping[int, str] = known
        """Channels that are not to be used, with the reason; a new mapping whenever it changes."""

    def feed(self, host_s: float, skin: FloatArray) -> bool:
        """Take one frame; return whether `dead` changed. It is looked at once a second."""
        if self._last is None:
            self._changed_s[:] = self._number_s[:] = host_s
            self._last = skin
            self._looked_s = host_s
            return False
        moved = skin != self._last  # NaN differs from everything; it has a clock of its own, `_number_s`
        self._changed_s[moved] = host_s
        self._changes += moved
        self._varied |= moved & ~np.isnan(skin) & ~np.isnan(self._last)
        self._frames += 1
        self._near_pokes[moved] = 0
        self._number_s[~np.isnan(skin)] = host_s
        self._last = skin
        return host_s - self._looked_s >= 1.0 and self._look(host_s)

    def poke(self, host_s: float, channels: IntArray, responses: FloatArray) -> bool:
        """Take the answers of one poke, whatever it ended as; return whether `dead` changed."""
        if not 0 < len(channels) <= CROWD:
            return False
        peak = int(channels[np.argmax(responses)])
        answered = np.isin(self._candidates, channels)
        self._pokes += 1
        self._peaks.add(peak)
        self._answered += answered
        if self._places is not None and self._far is not None:
            away = self._others_distance(answered) > self._far
            self._away += away
            self._away_answered += away & answered
            beside = np.linalg.norm(self._places - self._places[self._candidates == peak], axis=1) <= self._near
            self._near_pokes[self._candidates[beside & ~answered]] += 1
        return self._look(host_s)

    def _others_distance(self, answered: np.ndarray) -> FloatArray:
        """(c,) distance of each candidate to the nearest other one that answered; 0 where there is no other."""
        assert self._places is not None
        places = self._places[answered]
        distance = np.linalg.norm(self._places[:, None] - places[None], axis=-1)
        # A taxel is not another one of those that answered.
        distance[np.flatnonzero(answered), np.arange(len(places))] = np.inf
        nearest = distance.min(axis=1)
        return np.where(np.isfinite(nearest), nearest, 0.0)

    def _look(self, host_s: float) -> bool:
        """Judge every channel; return whether `dead` changed."""
        self._looked_s = host_s
        # Where several causes fit, the last one that is found gives the sentence: the plainest comes last.
        dead: dict[int, str] = {}
        self._find_always_on(dead)
        self._find_stuck(host_s, dead)
        self._find_numberless(host_s, dead)
        self._known = {channel: why for channel, why in self._known.items() if self._holds(channel, why)}
        dead = self._known | dead
        dead = {channel: dead[channel] for channel in sorted(dead)}
        if dead.keys() == self.dead.keys():
            return False
        self.dead = dead
        return True

    def _holds(self, channel: int, why: str) -> bool:
        """Return whether what was found before the break still holds: nothing since has shown otherwise."""
        if self._last is None or channel >= len(self._last):
            return self._last is None
        if why.startswith(_NO_NUMBER):
            return bool(np.isnan(self._last[channel]))
        if not why.startswith(_ALWAYS_ON):
            return not self._varied[channel]
        if self._places is None:
            return self._pokes < BLIND_POKES or len(self._peaks) < BLIND_PEAKS
        return bool((self._away[self._candidates == channel] < AWAY_POKES).any())

    def _find_numberless(self, host_s: float, dead: dict[int, str]) -> None:
        without = host_s - self._number_s[self._candidates] >= NO_NUMBER_S
        for channel in self._candidates[without]:
            dead[int(channel)] = f"{_NO_NUMBER} for {NO_NUMBER_S:g} s or more; check its wiring"

    def _find_stuck(self, host_s: float, dead: dict[int, str]) -> None:
        assert self._last is not None
        rest = host_s - self._changed_s[self._candidates]
        value = self._last[self._candidates]
        # Only on a skin whose typical channel changes in most frames does an exact rest mean anything.
        restless = float(np.median(self._changes[self._candidates])) >= RESTLESS * self._frames
        for channel in self._candidates[(rest >= STUCK_S) & restless]:
            dead[int(channel)] = f"{_STUCK}: exactly {self._last[channel]:g} for {STUCK_S:g} s or more while the others vary"
        for channel in self._candidates[self._near_pokes[self._candidates] >= STUCK_NEAR_POKES]:
            dead[int(channel)] = (
                f"{_STUCK}: exactly {self._last[channel]:g} through {STUCK_NEAR_POKES} pokes or more on its neighbours"
            )
        if self._end is not None:
            for channel in self._candidates[(rest >= STUCK_END_S) & (value == self._end)]:
                dead[int(channel)] = f"{_STUCK} at {self._end:g}, the pressed end of its range, for {STUCK_END_S:g} s or more"

    def _find_always_on(self, dead: dict[int, str]) -> None:
        if self._places is not None:
            always = (self._away_answered >= AWAY_POKES) & (self._away_answered >= AWAY_SHARE * self._away)
            for index in np.flatnonzero(always):
                dead[int(self._candidates[index])] = (
                    f"{_ALWAYS_ON}: answered {self._away_answered[index]} of {self._away[index]} pokes that lie elsewhere"
                )
        elif self._pokes >= BLIND_POKES and len(self._peaks) >= BLIND_PEAKS:
            for index in np.flatnonzero(self._answered >= BLIND_SHARE * self._pokes):
                dead[int(self._candidates[index])] = (
                    f"{_ALWAYS_ON}: answered {self._answered[index]} of {self._pokes} pokes at {len(self._peaks)} places"
                )
