"""Pokes that a soft sheet needs, from its layout and the scene's noise alone.

The covariance of a linear fit depends on where the pokes are, not on their results. So pokes are spread over the sheet, each at
the taxel farthest from those before, until the worst taxel is known as wanted. The scales of the deformation are usual ones.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import MODULE_TURN_TO_LENGTH_RADIUS_M
from skincal.modules.pose_fit import CONTACT_TO_PAD_CENTRE_SD_FACTOR
from skincal.modules.sheet_basis import make_basis
from skincal.modules.sheet_fit import POSE_MAX_SD_M

USUAL_SCALES = 1.7, 1.9
"""Scales k and s that are usually learned from a sheet with a fold (`sheet_fit.py`)."""
USUAL_ANSWERS = 1.5
"""Pads of a sheet that answer a poke: its taxels are usually farther apart than the tip is wide."""
USUAL_PUSH_FORCE_N = 9.0
USUAL_LEVER_M = 0.15
"""From the sensor to the skin."""
MAX_PLANNED_POKES_PER_TAXEL = 4


def count_sheet_pokes(flat: FloatArray, noise: NoiseSettings, wanted: float) -> int:
    """Count the pokes until every taxel of a sheet, at `flat` (n, 2), metres, has an rms error of at most `wanted`, metres."""
    basis = make_basis(flat - flat.mean(axis=0))
    of_contact = (CONTACT_TO_PAD_CENTRE_SD_FACTOR * noise.contact / USUAL_ANSWERS) ** 2
    of_sensor = (noise.moment / USUAL_PUSH_FORCE_N) ** 2 + (noise.force / USUAL_PUSH_FORCE_N * USUAL_LEVER_M) ** 2
    x, y = basis.flat.T / MODULE_TURN_TO_LENGTH_RADIUS_M
    ones, zeros, eye = np.ones(len(flat)), np.zeros(len(flat)), np.eye(2)
    turn = np.stack([-y, x], axis=1)
    pose = np.concatenate([np.stack([[ones, zeros], [zeros, ones]]).transpose(2, 0, 1), turn[:, :, None]], axis=2)
    fields = (basis.modes[:, None, :, None] * eye[:, None]).reshape(len(flat), 2, -1)
    moved = np.concatenate([pose, basis.strains, fields], axis=2)
    prior = np.concatenate([np.full(3, POSE_MAX_SD_M**-2), basis.precisions(*USUAL_SCALES)])
    order = _farthest_first(basis.flat)

    def is_enough(count: int) -> bool:
        pokes = moved[np.resize(order, count)].reshape(2 * count, -1)
        whole = pokes.T @ pokes / (of_contact + of_sensor) + np.diag(prior)
        known = (moved.reshape(2 * len(flat), -1) @ np.linalg.inv(whole)).reshape(moved.shape)
        variances = np.sum(known * moved, axis=(1, 2)) + 2.0 * USUAL_SCALES[1] ** 2 * basis.left_out
        return bool(variances.max() <= wanted**2)

    least, most = 1, MAX_PLANNED_POKES_PER_TAXEL * len(flat)
    while least < most:
        middle = (least + most) // 2
        least, most = (least, middle) if is_enough(middle) else (middle + 1, most)
    return least


def _farthest_first(flat: FloatArray) -> IntArray:
    """Order taxels so that each is the farthest from those before, the first one farthest from the middle."""
    order = [int(np.argmax(np.sum(flat * flat, axis=1)))]
    nearest = np.full(len(flat), np.inf)
    for _ in range(len(flat) - 1):
        nearest = np.minimum(nearest, np.sum((flat - flat[order[-1]]) ** 2, axis=1))
        nearest[order[-1]] = -1.0
        order.append(int(nearest.argmax()))
    return np.array(order)
