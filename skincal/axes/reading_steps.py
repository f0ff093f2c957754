"""Steps of the readings: the last digit of a device that reports 0.1 N, as PaXini's taxels do.

Noise larger than a step makes the mean of many frames right. Else a mean reading lies near a multiple of the step q, and all
pokes of a taxel that lean alike have the same error. More of them do not make it smaller.

**Step.** The mean of exp(2 pi i r/q) over many readings is near 0 for continuous ones. It is large if they lie near multiples
of q (Kendall's quantogram, 1974). The largest such q is the step. A robot that pushes always alike gives one reading of each
taxel, again and again: a few of them lie near multiples of many q by chance. So readings of a taxel that scatter by less than
a share of q count as one. Of m readings by chance the mean exceeds R with the probability (1 - R^2)^(m - 2), since the outer
two fit each q that is tried.

**Common error.** The error of rounding is a periodic function of the true value, with the Fourier coefficients q/(pi j). Let
the readings of a taxel scatter by the standard deviation w. Then its errors have a part that is constant, and one that grows
with the reading, as another gain does. Their variances over all taxels are

    B^2 = sum over j of q^2/(2 pi^2 j^2) exp(-(2 pi j w/q)^2),                                                    (1)
    L^2 = sum over j of q^2/(2 pi^2 j^2) (2 pi j w/q)^2 exp(-(2 pi j w/q)^2).                                     (2)

Without scatter B^2 is q^2/12. With w = 0.3 q it is a fiftieth of that, and L^2 a fifteenth. Noise of single frames makes both
smaller. That is not counted, so predicted errors are then up to twice too large.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.geometry import FloatArray

MAX_STEPS_OF_RANGE = 300
"""Steps between the smallest and the largest reading. More of them round a direction by less than 0.1 degrees."""
MIN_STEPS_OF_RANGE = 5
STEPS_TRIED = 4
"""For each step between the smallest and the largest reading."""
MIN_RESULTANT = 0.4
"""Of readings near multiples: noise of 0.2 steps. With more of it (1) is small."""
MIN_SIGNIFICANCE = 15.0
"""Of -ln of the chance: 1,200 steps are tried."""
MIN_SCATTER_OVER_STEP = 0.4
"""Of the readings of a taxel that count one by one. Normal ones have a mean of exp(-(2 pi 0.4)^2/2) = 0.04."""
MIN_SHARE_OF_BEST = 0.9
"""Of the largest resultant of steps down to half as long."""
MAX_READINGS = 800


def find_step(pushes: Sequence[FloatArray]) -> float:
    """Find the step of readings that differ by many steps; 0 if none matters. `pushes` (n,), raw units, are z of each taxel."""
    pushes = [own[:: 1 + sum(map(len, pushes)) // MAX_READINGS] for own in pushes if len(own)]
    every = np.concatenate([*pushes, np.empty(0)])
    span = float(np.ptp(every)) if len(every) else 0.0
    if not span:
        return 0.0
    steps_of_span = np.arange(MIN_STEPS_OF_RANGE, MAX_STEPS_OF_RANGE, 1.0 / STEPS_TRIED)
    turned = np.stack([np.exp(2j * np.pi * steps_of_span[:, None] * own / span).mean(axis=1) for own in pushes], axis=1)
    is_wide = np.array([own.std() for own in pushes]) * steps_of_span[:, None] > MIN_SCATTER_OVER_STEP * span
    counts = np.where(is_wide, [len(own) for own in pushes], 1.0)
    number = counts.sum(axis=1)
    resultants = np.abs((counts * turned).sum(axis=1)) / number
    significance = -(number - 2.0) * np.log1p(-(np.minimum(resultants, 1.0 - 1e-9) ** 2))
    is_step = (resultants > MIN_RESULTANT) & (significance > MIN_SIGNIFICANCE)
    for first in np.flatnonzero(is_step).tolist():
        # The top of this peak, which is about two steps of the span wide.
        top = first + int(resultants[first : first + 2 * STEPS_TRIED].argmax())
        # Few readings lie near multiples of another step by chance, and nearer to those of their own.
        near = resultants[first : first + int(0.5 * STEPS_TRIED * steps_of_span[first])]
        if resultants[top] > MIN_SHARE_OF_BEST * near.max():
            return span / float(steps_of_span[top])
    return 0.0


def common_variance(readings: FloatArray, step: float) -> float:
    """Compute the larger of (1) and (2), raw units squared, the mean of x and y, from the readings (n, 3) of a taxel, n > 1."""
    harmonics = np.arange(1, 11)[:, None]
    phases = (2.0 * np.pi * harmonics / step) ** 2 * readings[:, :2].var(axis=0)
    constant = step**2 / (2.0 * np.pi**2 * harmonics**2) * np.exp(-phases)
    return float(max(constant.sum(axis=0).mean(), (phases * constant).sum(axis=0).mean()))
