"""The answers of taxels, from the values of a skin frame above their rest.

A taxel of one axis has one value, and its response is this value times the polarity. `vector_answers.py` has taxels of three
axes; `answers_of_skin.py` chooses.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.scene import SkinSpec


class TaxelAnswers:
    """Answers of a skin with one value for each taxel."""

    def __init__(self, skin: SkinSpec) -> None:
        self._polarity = skin.polarity

    def responses(self, change: FloatArray) -> FloatArray:
        """Compute the responses (..., channels), raw units, of frames that are `change` (..., values) above their rest."""
        return self._polarity * change

    def sizes(self, change: FloatArray) -> FloatArray:
        """Compute how far each taxel is from its rest in any direction, (..., channels), raw units."""
        return np.abs(change)

    def noise(self, noise: FloatArray) -> FloatArray:
        """Compute the noise of the responses, (channels,) raw units, of values with the sd `noise` (values,)."""
        return noise

    def watched(self, frame: FloatArray) -> FloatArray:
        """Choose the raw value of each taxel, (..., channels), that tells whether it is alive and in its range."""
        return frame

    def vectors(self, _change: FloatArray, _frame: FloatArray | None, /) -> FloatArray | None:
        """Compute the readings of the taxels, (channels, 3), as `VectorAnswers`; `None` for a skin of one axis."""
        return None
