"""What a taxel says when a flat square tip presses the foam above it.

The tip's pressure is uniform over its square; foam and the taxel's own pad spread it, and it dies away exponentially
beyond the tip, as it does in an elastic layer on a hard ground. So the share of the load that a taxel at tangential
distance (x, y) from the tip's middle feels is g = B(x) B(y), a box of half width a with logistic flanks of width s:
B(x) = (tanh((x + a)/2s) - tanh((x - a)/2s)) / (2 tanh(a/2s)), one under the tip, smoothly nothing beyond. The answer
rises with the normal load F g and saturates mildly, as foam stiffens: q (1 - exp(-F g / F0)).

Not modelled: shear of the foam under tilted pushes, pressure that gathers at an edge of a tilted tip, creep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Foam:
    """Tip and foam; SI units."""

    tip_half: float = 0.002
    """m. Half the side of the paper's 4 x 4 mm tip (section IV)."""
    spread: float = 0.0013
    """m. s; the flank's sd is 1.8 times as much: a 2 to 3 mm layer of foam (section III-B) and pads of about 4 mm. With
    it three taxels answer a poke on average, as in the paper."""
    force_scale: float = 8.0
    """N. F0: at the force of an ordinary poke (6 to 12 N) the answer is bent but not flat. Assumed."""
    full_share: float = 0.75
    """q as a share of the way from the baseline to the end of the device's range. Assumed."""
    reach: float = 0.015
    """m. Beyond it a taxel feels nothing; g is below 1e-4 there."""
    lag: float = 0.015
    """s. The foam answers later than the force by this much: a first-order response of 15 ms."""


def felt_share(foam: Foam, offsets: FloatArray, axis_x: FloatArray, axis_y: FloatArray) -> FloatArray:
    """Return the share g of the tip's load that taxels feel, 0 to 1.

    Parameters
    ----------
    offsets : (n, k, 3) float, metres, from the middle of the tip to the taxels
    axis_x, axis_y : (n, 3) float, unit, the sides of the tip, in the plane of the skin

    Returns
    -------
    (n, k) float
    """
    x = np.einsum("nki,ni->nk", offsets, axis_x)
    y = np.einsum("nki,ni->nk", offsets, axis_y)
    near = np.einsum("nki,nki->nk", offsets, offsets) < foam.reach**2
    return np.where(near, _blurred_box(foam, x) * _blurred_box(foam, y), 0.0)


def _blurred_box(foam: Foam, x: FloatArray) -> FloatArray:
    half, width = foam.tip_half, 2 * foam.spread
    return (np.tanh((x + half) / width) - np.tanh((x - half) / width)) / (2 * np.tanh(half / width))


def answer(foam: Foam, normal_load: FloatArray, share: FloatArray) -> FloatArray:
    """Return a taxel's answer as a share of its way to the end of its range, 0 to `full_share`.

    Parameters
    ----------
    normal_load : (...) float, N, pushed along the inward normal
    share : (...) float, `felt_share`
    """
    return foam.full_share * -np.expm1(-np.maximum(normal_load, 0.0) * share / foam.force_scale)
