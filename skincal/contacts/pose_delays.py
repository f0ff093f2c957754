"""Delays of a tool's poses against skin and wrench, as single presses show them (`pose_delay_watch`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from skincal.geometry import FloatArray

DELAY_MIN_PRESSES = 3
"""Presses from which a delay is known."""
MAX_KEPT_PRESSES = 200
"""Newest presses whose delays are kept."""
LATE_POSES_MIN_S = 0.1
"""s. A stream that is later is a fault: the tool moves by millimetres meanwhile."""
USED_DELAY_MAX_SD_S = 0.030
"""s, largest sd of a delay that is corrected."""
REPEATED_POSES_MIN_S = 0.1
"""s. A moving tool whose pose changes less often is sent from a buffer that repeats."""


def _no_presses() -> FloatArray:
    return np.empty(0)


class PoseDelay(NamedTuple):
    """Delay of the poses: they are stamped this much later than another stream."""

    delay_s: float
    sd_s: float
    """s, standard deviation of the delay."""
    presses: int
    """Number of presses that show it."""

    @property
    def is_usable(self) -> bool:
        """Whether it is known well enough to correct the poses."""
        return self.sd_s <= USED_DELAY_MAX_SD_S

    @property
    def is_late(self) -> bool:
        """Whether it is a fault beyond its error."""
        return abs(self.delay_s) - 2.0 * self.sd_s > LATE_POSES_MIN_S


@dataclass(frozen=True, slots=True, eq=False)
class PoseDelays:
    """Delays of single presses, s, with their standard deviations; positive if the poses are late."""

    of_skin: FloatArray = field(default_factory=_no_presses)
    """(n,) float, s, against the skin."""
    of_skin_sd: FloatArray = field(default_factory=_no_presses)
    """(n,) float, s, their standard deviations."""
    of_wrench: FloatArray = field(default_factory=_no_presses)
    """(m,) float, s, against the wrench; empty without a sensor."""
    of_wrench_sd: FloatArray = field(default_factory=_no_presses)
    """(m,) float, s, their standard deviations."""
    repeated_s: float = math.nan
    """s, median time from one pose of the moving tool to the next different one; NaN while it is unknown."""

    @property
    def against_skin(self) -> PoseDelay | None:
        """The delay against the skin; `None` with too few presses."""
        return combine_delays(self.of_skin, self.of_skin_sd)

    @property
    def against_wrench(self) -> PoseDelay | None:
        """The delay against the wrench; `None` with too few presses."""
        return combine_delays(self.of_wrench, self.of_wrench_sd)

    @property
    def leading(self) -> PoseDelay | None:
        """The delay that is corrected if it is usable: against the wrench where there is one, since foam answers slowly."""
        return self.against_wrench or self.against_skin

    @property
    def repeats(self) -> bool:
        """Whether the stream repeats its values while the tool moves."""
        return self.repeated_s > REPEATED_POSES_MIN_S

    def with_press(self, of_skin: PoseDelay | None, of_wrench: PoseDelay | None) -> PoseDelays:
        """Add the delays of one press; `None` for one that it does not show."""
        return replace(
            self,
            of_skin=_newest(self.of_skin, () if of_skin is None else (of_skin.delay_s,)),
            of_skin_sd=_newest(self.of_skin_sd, () if of_skin is None else (of_skin.sd_s,)),
            of_wrench=_newest(self.of_wrench, () if of_wrench is None else (of_wrench.delay_s,)),
            of_wrench_sd=_newest(self.of_wrench_sd, () if of_wrench is None else (of_wrench.sd_s,)),
        )

    def plus(self, later: PoseDelays) -> PoseDelays:
        """Join with those of a later part of the session."""
        return PoseDelays(
            of_skin=_newest(self.of_skin, later.of_skin),
            of_skin_sd=_newest(self.of_skin_sd, later.of_skin_sd),
            of_wrench=_newest(self.of_wrench, later.of_wrench),
            of_wrench_sd=_newest(self.of_wrench_sd, later.of_wrench_sd),
            repeated_s=self.repeated_s if math.isnan(later.repeated_s) else later.repeated_s,
        )


def _newest(before: FloatArray, new: Sequence[float] | FloatArray) -> FloatArray:
    return np.append(before, np.asarray(new, dtype=np.float64))[-MAX_KEPT_PRESSES:]


def combine_delays(delays: FloatArray, sds: FloatArray) -> PoseDelay | None:
    """Combine delays (n,) of presses with their sds (n,), s; `None` below `DELAY_MIN_PRESSES`.

    The median, since a press that slid shows another one. Foam that recovers slowly errs alike in all presses: that part, the
    median sd, does not become less with their number, and the scatter does.
    """
    if len(delays) < DELAY_MIN_PRESSES:
        return None
    middle = float(np.median(delays))
    scatter = 1.4826 * float(np.median(np.abs(delays - middle)))
    return PoseDelay(middle, math.hypot(1.25 * scatter / math.sqrt(len(delays)), float(np.median(sds))), len(delays))
