"""Synthesised samples of taxels of three axes."""

import numpy as np

from skincal.model.readings import Sample
from tests.skincal.poke_script import PERIOD_S, Script


class VectorScript(Script):
    """A script whose responses are vectors of x, y and z."""

    def step(self, wrench=None, responses=None, *, saturated=False):
        wrench = np.zeros(6) if wrench is None else wrench
        axes = self.scene.skin.axes
        vectors = np.zeros((self.scene.skin.channels, 3))
        for channel, value in (responses or {}).items():
            vectors[channel] = value
        skin = self.resting + axes.as_frames(vectors) + self.skin_noise * self.rng.normal(0, 1, 3 * self.scene.skin.channels)
        self.samples.append(Sample(self.now, skin, self.offset + wrench, 20, saturated, None))
        self.now += PERIOD_S

    def press(self, force, point, responses, **how):
        return super().press(force, point, {channel: np.array(value) for channel, value in responses.items()}, **how)
