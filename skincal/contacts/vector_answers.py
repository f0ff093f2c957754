"""The answers of taxels that measure three axes: their readings as vectors, and one number of each for thresholds."""

from __future__ import annotations

import numpy as np

from skincal.contacts.taxel_answers import TaxelAnswers
from skincal.geometry import FloatArray
from skincal.model.scene import SkinSpec
from skincal.model.skin_axes import ResponseRule, SkinAxes


class VectorAnswers(TaxelAnswers):
    """Answers of a skin with three values for each taxel."""

    def __init__(self, skin: SkinSpec, axes: SkinAxes) -> None:
        super().__init__(skin)
        self._axes, self._range = axes, skin.range

    def responses(self, change: FloatArray) -> FloatArray:
        """Compute the push into the skin, or the length of the reading, as the scene says."""
        vectors = self._axes.sort_values(change)
        # A push is a force on the taxel against its z.
        return -vectors[..., 2] if self._axes.rule is ResponseRule.PUSH else _lengths(vectors)

    def sizes(self, change: FloatArray) -> FloatArray:
        return np.abs(self.responses(change))

    def noise(self, noise: FloatArray) -> FloatArray:
        """Compute the noise of the responses: that of z, or the largest of the three for the length of the reading."""
        each = np.abs(self._axes.sort_values(noise))
        return each[..., 2] if self._axes.rule is ResponseRule.PUSH else np.fmax.reduce(each, axis=-1)

    def watched(self, frame: FloatArray) -> FloatArray:
        """Choose the raw value of z; NaN if any of the three is no number."""
        place = self._axes.places[2]
        raw = self._axes.by_taxel(frame)
        return np.where(np.isnan(raw).any(axis=-1), np.nan, raw[..., place])

    def vectors(self, change: FloatArray, frame: FloatArray | None, /) -> FloatArray:
        """Compute the readings of the taxels above their rest, (channels, 3) raw units, axes of each taxel.

        NaN for a taxel with a value at an end of the range in the raw `frame`: how much more it would read is unknown.
        """
        vectors = self._axes.sort_values(change)
        if self._range is None or frame is None:
            return vectors
        low, high = self._range
        raw = self._axes.by_taxel(frame)
        at_end = np.logical_or(raw <= low, raw >= high).any(axis=-1, keepdims=True)
        return np.where(at_end, np.nan, vectors)


def _lengths(vectors: FloatArray) -> FloatArray:
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
