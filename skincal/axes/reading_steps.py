"""Steps of the readings: the last digit of a device that reports 0.1 N, as PaXini's taxels do.

Noise larger than a step makes the mean of many frames right. Else a mean reading lies near a multiple of the step q, and all
pokes of a taxel that lean alike have the same error. More of them do not make it smaller.

**Step.** The mean of exp(2 pi i r/q) over many readings is near 0 for continuous ones. It is large if they lie near multiples
of q (Kendall's quantogram, 1974). The largest such q is the step.

**Common error.** The error of rounding is a periodic function of the true value, with the Fourier coefficients q/(pi j). Let
the readings of a taxel scatter by the standard deviation w. Then its errors have a part that is constant, and one that grows
with the reading, as another gain does. Their variances over all taxels are

    B^2 = sum over j of q^2/(2 pi^2 j^2) exp(-(2 pi j w/q)^2),                                                    (1)
    L^2 = sum over j of q^2/(2 pi^2 j^2) (2 pi j w/q)^2 exp(-(2 pi j w/q)^2).                                     (2)

Without scatter B^2 is q^2/12. With w = 0.3 q it is a fiftieth of that, and L^2 a fifteenth. Noise of single frames makes both
smaller. That is not counted, so predicted errors are then up to twice too large.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry import FloatArray

MAX_STEPS_OF_RANGE = 300
"""Steps of the largest reading. More of them round a direction by less than 0.1 degrees."""
MIN_STEPS_OF_RANGE = 5
STEPS_TRIED = 4
"""For each step of the largest reading."""
MIN_RESULTANT = 0.4
"""Of readings near multiples: noise of 0.2 steps. With more of it (1) is small."""
MIN_SIGNIFICANCE = 15.0
"""Number of readings times the squared resultant: 1,200 steps are tried, and chance exceeds it with exp(-15)."""
MAX_READINGS = 800


def find_step(pushes: FloatArray) -> float:
    """Find the step of readings from those of z (n,), raw units, which differ by many steps; 0 if none matters."""
    pushes = pushes[:: 1 + len(pushes) // MAX_READINGS]
    span = float(np.ptp(pushes))
    if not span:
        return 0.0
    steps_of_span = np.arange(MIN_STEPS_OF_RANGE, MAX_STEPS_OF_RANGE, 1.0 / STEPS_TRIED)
    resultants = np.abs(np.exp(2j * np.pi * steps_of_span[:, None] * pushes / span).mean(axis=1))
    least = max(MIN_RESULTANT, float(np.sqrt(MIN_SIGNIFICANCE / len(pushes))))
    is_step = resultants > least
    if not is_step.any():
        return 0.0
    first = int(is_step.argmax())
    # The top of this peak, which is about two steps of the span wide.
    top = first + int(resultants[first : first + 2 * STEPS_TRIED].argmax())
    return span / float(steps_of_span[top])


def common_variance(readings: FloatArray, step: float) -> float:
    """Compute the larger of (1) and (2), raw units squared, the mean of x and y, from the readings (n, 3) of a taxel, n > 1."""
    harmonics = np.arange(1, 11)[:, None]
    phases = (2.0 * np.pi * harmonics / step) ** 2 * readings[:, :2].var(axis=0)
    constant = step**2 / (2.0 * np.pi**2 * harmonics**2) * np.exp(-phases)
    return float(max(constant.sum(axis=0).mean(), (phases * constant).sum(axis=0).mean()))
