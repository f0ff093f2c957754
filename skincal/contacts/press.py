"""The poke in progress: gathers its samples and finds the stillest window, with memory that does not grow."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from skincal.contacts.pose import ArmPose
from skincal.contacts.stillness import axis_travel, force_spread, still_share
from skincal.contacts.tare import Tare, window_length
from skincal.readings import FloatArray, Sample
from skincal.scene import ContactSettings


@dataclass(frozen=True, slots=True, eq=False)
class StillWindow:
    """The stillest `still_s` of a press, raw."""

    samples: tuple[Sample, ...]
    poses: tuple[ArmPose, ...]
    spread: float
    """1, relative spread of the force."""
    travel: float
    """m, travel of the force axis."""
    rank: tuple[float, float, float, float]
    """Smaller is better: 1 outside the force window; the spread in shares of its limit where it is beyond it, so that a slide
    or a hard hold is not hidden in a ramp; how far outside (N); the worse of spread and travel in shares of their limits."""

    @property
    def good(self) -> bool:
        """In the force window, and still."""
        outside, _, _, share = self.rank
        return outside == 0.0 and share <= 1.0


class Press:
    """A poke from its touch to its release.

    Parameters
    ----------
    settings : thresholds
    tare : the tare before the touch
    start : the first sample above `touch_force`
    pose : the arm's pose there
    period_s : s, time between samples
    """

    def __init__(self, settings: ContactSettings, tare: Tare, start: Sample, pose: ArmPose, period_s: float) -> None:
        self.tare = tare
        self.start_s = start.host_s
        self.end_s = start.host_s
        self.pose = pose
        self.peak = 0.0
        """N, largest tared force so far."""
        self.saturated = 0
        """Samples in which a reading was saturated or invalid."""
        self.gap_s = 0.0
        """s, longest hole in the samples."""
        self.moved = 0.0
        """rad, how far the arm moved."""
        self.best: StillWindow | None = None
        self.still = 0.0
        """Share of the still window that is filled, 0 to 1."""
        self.force = np.zeros(3)
        self._settings = settings
        self._length = window_length(settings.still_s, period_s)
        self._window: deque[tuple[Sample, ArmPose]] = deque(maxlen=self._length)

    @property
    def held(self) -> bool:
        """A window is still and in the force window: the operator may release."""
        return self.best is not None and self.best.good

    @property
    def steady(self) -> bool:
        """The force has the same size over the last `still_s`."""
        return self.still >= 1.0

    @property
    def latest(self) -> tuple[tuple[Sample, ArmPose], ...]:
        """The samples of the last `still_s`, or fewer at the beginning."""
        return tuple(self._window)

    def add(self, sample: Sample, pose: ArmPose) -> None:
        """Take one sample of the press."""
        self.end_s = sample.host_s
        if sample.saturated:
            self.saturated += 1
            self.still = 0.0
            self._window.clear()
            return
        self._window.append((sample, pose))
        wrench = np.array([item.wrench for item, _ in self._window]) - self.tare.wrench
        self.force = wrench[-1, :3]
        self.peak = max(self.peak, float(np.linalg.norm(self.force)))
        self.still = still_share(wrench[:, :3], self._settings.still_change) / self._length
        if len(self._window) == self._length:
            self._weigh(wrench)

    def lose(self, gap_s: float) -> None:
        """Note a hole in the samples; a still window does not reach across it."""
        self.gap_s = max(self.gap_s, gap_s)
        self._window.clear()

    def _weigh(self, wrench: FloatArray) -> None:
        """Keep the window that ends now if it is better than the best so far."""
        settings = self._settings
        force = wrench[:, :3]
        size = float(np.linalg.norm(force.mean(axis=0)))
        outside = max(0.0, settings.force_min - size, size - settings.force_max)
        spread = force_spread(force)
        share = spread / settings.still_change
        best = self.best
        first = (float(outside > 0.0), max(share, 1.0), outside)
        if best is not None and (*first, share) >= best.rank:
            return  # the travel can only make it worse
        samples = tuple(item for item, _ in self._window)
        times = np.array([item.host_s for item in samples])
        travel = axis_travel(force, wrench[:, 3:], times)
        rank = (*first, max(share, travel / settings.slide_max))
        if best is None or rank < best.rank:
            self.best = StillWindow(samples, tuple(pose for _, pose in self._window), spread, travel, rank)
