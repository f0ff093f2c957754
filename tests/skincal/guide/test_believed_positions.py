"""Believed positions of a large skin: taxels without an estimate cost nothing, and the others are the same to the last bit."""

import numpy as np

from skincal.guide.believed_positions import TAXEL_OFFSET_FROM_MODULE_SD_M, _add_own_offset
from skincal.guide.taxel_statistics import solve_each


def test_the_own_offset_of_the_few_estimated_taxels_is_that_of_all(rng):
    places, rig = rng.normal(size=(60, 3)), rng.normal(0.0, 1e-3, (60, 3))
    measured, precision = np.full((60, 3), np.nan), np.zeros((60, 3, 3))
    known = rng.permutation(60)[:7]
    measured[known] = places[known] + rng.normal(0.0, 2e-3, (7, 3))
    roots = rng.normal(0.0, 800.0, (7, 3, 3))
    precision[known] = roots @ roots.transpose(0, 2, 1)
    off = np.nan_to_num(measured - places - rig)
    own = solve_each(precision + np.eye(3) / TAXEL_OFFSET_FROM_MODULE_SD_M**2, (precision @ off[:, :, None])[:, :, 0])
    found = _add_own_offset(places, measured, precision, rig)
    np.testing.assert_array_equal(found, places + own)
    np.testing.assert_array_equal(np.flatnonzero((found != places).any(axis=1)), np.sort(known))
