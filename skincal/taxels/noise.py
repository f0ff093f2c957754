"""Noise of a poke's two rows by the scene: distance of its axis from the taxel that answered.

The solver has the same covariance for the rows that it solves (`contacts.h`); here it is for many places at once, between
solves. `tests/skincal/solver/test_shared_tables.py` compares the two.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray
from skincal.model.scene import NoiseSettings
from skincal.solver.machine import fill_in
from skincal.solver.tables import SHARED_TABLES


def noise_values(noise: NoiseSettings) -> dict[str, float]:
    """Return the values of `Noise` of `skincal/solver/tables.py`."""
    return {name: getattr(noise, name) for name in SHARED_TABLES["Noise"].fields}


@lru_cache(maxsize=16)
def noise_in_solver(noise: NoiseSettings) -> NDArray[Any]:
    """Fill in `Noise` of `skincal/solver/tables.py`."""
    return fill_in("Noise", noise_values(noise))


def offset_square(weights: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Compute (n,) the variance of the offset of contacts of weight k from their taxel, each direction, m^2 (`contacts.h`)."""
    return noise.contact**2 - noise.reach**2 * np.log(weights)


def row_precision(
    pairs: FloatArray, lever: FloatArray, forces: FloatArray, offsets: FloatArray, noise: NoiseSettings
) -> FloatArray:
    """Compute (n, 2, 2) D^-1, 1/m^2, with D the noise of a contact's two rows (`sensor_noise` there), with its offset in both.

    Parameters
    ----------
    pairs : (n, 2, 3) float: e_1 and e_2 across the push
    lever : (n, 3) float, metres, from the sensor's origin to the taxel
    forces : (n,) float, N
    offsets : (n,) float, m^2: `offset_square`
    """
    relative = noise.force / forces
    even = (noise.moment / forces) ** 2 + relative**2 * np.sum(lever * lever, axis=1) + offsets
    along = (pairs @ lever[:, :, None])[:, :, 0]
    less = relative[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1)
    # (even I - l l')^-1 = (I + l l'/(even - l'l)) / even.
    rest = even - np.sum(less * less, axis=1)
    return (np.eye(2) + less[:, :, None] * less[:, None] / rest[:, None, None]) / even[:, None, None]
