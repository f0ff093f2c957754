"""The most that a push may lean: what the friction of the tip holds, and what the operator's hand manages.

Friction: a push that leans more than the friction angle slides more often than not, one that leans less seldom does. Of each
angle that friction may have it is kept how likely the pokes so far are; the middle of that, less a margin, is usable.
"""

from __future__ import annotations

import numpy as np

from skincal.guide.settings import GuideSettings
from skincal.readings import FloatArray, IntArray

ANGLES: FloatArray = np.radians(np.linspace(5.0, 60.0, 56))
"""rad, friction angles that are thought of."""
PRIOR = (float(np.radians(40.0)), float(np.radians(10.0)))
"""rad, mean and sd before any poke: a rubber tip on foam. Assumed."""
SLIDES = (0.1, 0.5)
"""Chance that a poke slides that leans less, and more, than friction holds. Nearer to each other than they are, since people
slide for other reasons too: one slide alone changes nothing."""
MARGIN = float(np.radians(5.0))
"""rad, between what is asked for and what just holds: somewhat less than a hand's error."""
STEP = float(np.radians(2.0))
"""rad: usable tilts are whole multiples, so that targets are not worked out anew with every poke."""
LEAST = float(np.radians(10.0))
"""rad: less is asked of nobody; a hand's own error is hardly smaller."""
MISSES = 2
"""So many misses in a row lower what is asked for."""
HITS = 4
"""So many hits in a row raise it again, by `RAISE`."""
RAISE = float(np.radians(4.0))


class Tilt:
    """Learns from pokes how far a push may lean."""

    def __init__(self, settings: GuideSettings) -> None:
        self._settings = settings
        mean, sd = PRIOR
        self._log: FloatArray = -0.5 * ((ANGLES - mean) / sd) ** 2
        self._demand = settings.usable_tilt
        self._short: list[float] = []
        """rad, the tilts of the last pokes, as long as each was far less than asked for."""
        self._hits = 0

    @property
    def friction(self) -> float:
        """The tilt, rad, that friction holds, as likely as not."""
        likely = np.exp(self._log - self._log.max()).cumsum()
        return float(ANGLES[int((likely >= likely[-1] / 2.0).argmax())])

    @property
    def usable(self) -> float:
        """The most that is asked for, rad."""
        least = min(self._settings.usable_tilt, self._demand, self.friction - MARGIN)
        if least >= self._settings.usable_tilt:
            return self._settings.usable_tilt
        # A rounding error below a whole step is that step.
        return max(LEAST, STEP * float(np.floor(least / STEP + 1e-9)))

    def poked(self, tilts: FloatArray, *, slid: bool, taken_out: bool = False) -> None:
        """Take pokes that leaned `tilts`, (n,) rad, from the normal, NaN where that is not known; or take them out again."""
        more, less = (SLIDES[1], SLIDES[0]) if slid else (1.0 - SLIDES[1], 1.0 - SLIDES[0])
        known: FloatArray = tilts[np.isfinite(tilts)]
        beyond: IntArray = np.sum(known[:, None] > ANGLES, axis=0)
        told = beyond * np.log(more) + (len(known) - beyond) * np.log(less)
        self._log += -told if taken_out else told

    def aimed(self, asked: float, made: float) -> None:
        """Take how far a poke was to lean, and how far it did, rad: who misses it twice is asked for less."""
        if made < asked - self._settings.tolerance:
            self._hits = 0
            self._short.append(made)
            if len(self._short) >= MISSES:
                self._demand = max(LEAST, float(np.mean(self._short)) + self._settings.tolerance / 2.0)
                self._short = []
            return
        self._short = []
        self._hits = self._hits + 1 if made >= asked - self._settings.tolerance / 2.0 else 0
        if self._hits >= HITS and self._demand < self._settings.usable_tilt:
            self._hits, self._demand = 0, min(self._demand + RAISE, self._settings.usable_tilt)
