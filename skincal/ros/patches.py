"""Patches of a skin that are published on several topics, joined to frames of the whole skin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.geometry import FloatArray


class SkinPatches:
    """Joins the readings of several patches. A frame is complete when every patch has sent since the last frame.

    Parameters
    ----------
    topics : of the patches, in the order of the channels
    """

    def __init__(self, topics: Sequence[str]) -> None:
        self.topics = tuple(topics)
        self.superseded = [0] * len(self.topics)
        """For each patch: readings that a newer one replaced before the frame was complete."""
        self._fresh: list[FloatArray | None] = [None] * len(self.topics)

    def add(self, patch: int, values: FloatArray) -> FloatArray | None:
        """Take the (n,) values of a patch by its number; return the (channels,) values of a frame that is now complete."""
        self.superseded[patch] += self._fresh[patch] is not None
        self._fresh[patch] = values
        whole = [each for each in self._fresh if each is not None]
        if len(whole) < len(self._fresh):
            return None
        self._fresh = [None] * len(self.topics)
        return whole[0] if len(whole) == 1 else np.concatenate(whole)

    @property
    def waiting_for(self) -> list[str]:
        """Topics whose reading the next frame still needs."""
        return [topic for topic, values in zip(self.topics, self._fresh, strict=True) if values is None]
