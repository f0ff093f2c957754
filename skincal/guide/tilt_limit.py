"""Largest usable tilt of a push, learnt from the session's pokes.

A push that leans more than the friction angle usually slides, one that leans less seldom does. The likelihood of the pokes so
far is kept for each possible friction angle. The median angle, less a margin, is usable. A hand that misses the wanted tilts
lowers the limit further.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.guide.progress import GuideSettings

FRICTION_ANGLES_RAD: FloatArray = np.radians(np.linspace(5.0, 60.0, 56))
FRICTION_PRIOR_RAD = (float(np.radians(40.0)), float(np.radians(10.0)))
"""Mean and sd before any poke: a rubber tip on foam. Assumed."""
SLIDE_PROBABILITIES = (0.1, 0.5)
"""Probability that a push slides that leans less, and more, than the friction angle. They are nearer to each other than by
friction alone, since hands slide for other reasons too: one slide changes nothing."""
TILT_MARGIN_RAD = float(np.radians(5.0))
"""Between the friction angle and the usable tilt: somewhat less than a hand's error."""
TILT_STEP_RAD = float(np.radians(2.0))
"""Usable tilts are multiples of it, so that targets are not computed again after each poke."""
MIN_TILT_RAD = float(np.radians(10.0))
"""Smallest limit: a hand's own error is hardly smaller."""
MISSES_IN_A_ROW_TO_LOWER_LIMIT = 2
"""Number of misses after which the limit is lowered."""
HITS_IN_A_ROW_TO_RAISE_LIMIT = 4
"""Number of hits in a row after which the limit is raised by `RAISE_RAD`."""
RAISE_RAD = float(np.radians(4.0))


class TiltLimit:
    """Largest usable angle between a push and the normal, learned from the pokes."""

    def __init__(self, settings: GuideSettings) -> None:
        self._settings = settings
        mean, sd = FRICTION_PRIOR_RAD
        self._log: FloatArray = -0.5 * ((FRICTION_ANGLES_RAD - mean) / sd) ** 2
        self._demand = settings.usable_tilt
        self._missed_tilts: list[float] = []
        self._hits = 0

    @property
    def friction(self) -> float:
        """Median of the friction angle's distribution, rad."""
        # The largest is subtracted first, so that not all exponentials underflow.
        likely = np.exp(self._log - self._log.max()).cumsum()
        return float(FRICTION_ANGLES_RAD[int((likely >= likely[-1] / 2.0).argmax())])

    @property
    def usable(self) -> float:
        """The largest tilt of a target, rad."""
        least = min(self._settings.usable_tilt, self._demand, self.friction - TILT_MARGIN_RAD)
        if least >= self._settings.usable_tilt:
            return self._settings.usable_tilt
        # A rounding error below a whole step is that step.
        return max(MIN_TILT_RAD, TILT_STEP_RAD * float(np.floor(least / TILT_STEP_RAD + 1e-9)))

    def add_pokes(self, tilts: FloatArray, *, slid: bool, remove: bool = False) -> None:
        """Count pokes with `tilts`, (n,) rad from the normal, NaN if unknown; with `remove`, no longer count them."""
        more, less = (SLIDE_PROBABILITIES[1], SLIDE_PROBABILITIES[0]) if slid else (1.0 - p for p in SLIDE_PROBABILITIES[::-1])
        known: FloatArray = tilts[np.isfinite(tilts)]
        beyond: IntArray = np.sum(known[:, None] > FRICTION_ANGLES_RAD, axis=0)
        likelihood = beyond * np.log(more) + (len(known) - beyond) * np.log(less)
        self._log += -likelihood if remove else likelihood

    def compare_aim(self, asked: float, made: float) -> None:
        """Compare the tilt of a poke with the tilt of its target, rad; two misses in a row lower the limit."""
        if made < asked - self._settings.tolerance:
            self._hits = 0
            self._missed_tilts.append(made)
            if len(self._missed_tilts) >= MISSES_IN_A_ROW_TO_LOWER_LIMIT:
                self._demand = max(MIN_TILT_RAD, float(np.mean(self._missed_tilts)) + self._settings.tolerance / 2.0)
                self._missed_tilts = []
            return
        self._missed_tilts = []
        self._hits = self._hits + 1 if made >= asked - self._settings.tolerance / 2.0 else 0
        if self._hits >= HITS_IN_A_ROW_TO_RAISE_LIMIT and self._demand < self._settings.usable_tilt:
            self._hits, self._demand = 0, min(self._demand + RAISE_RAD, self._settings.usable_tilt)
