"""What the contacts of one taxel are like beside what it needs: from which sides they came, and where around it they lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.readings import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Sky:
    """The n contacts of a taxel, and d pushes that may come next, link frame."""

    channel: int
    normal: FloatArray
    """(3,) float, unit, outward."""
    pushes: FloatArray
    """(n, 3) float, unit: which way each pushed."""
    offsets: FloatArray
    """(n, 3) float, metres, along the skin: where each was by the answers, from the taxel."""
    own: NDArray[np.bool_]
    """(n,) whether the taxel answered most."""
    trust: FloatArray
    """(n,) float, 0 to 1: how far the method believes it for this taxel."""
    beside: FloatArray
    """(3,) float, metres, along the skin: the middle of the contacts, from the taxel."""
    diversity: float
    """rad, how far the axes spread."""
    usable_tilt: float
    """rad: the most that a push is asked to lean."""
    tried: FloatArray
    """(d, 3) float, unit: pushes that may come next."""
    worth: FloatArray
    """(d,) float, metres: by how much each lowers the sum of the predicted errors; 0 where its side was skipped."""
