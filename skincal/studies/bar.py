"""What holds in the stability study: an error within what the inputs' own last digit does to the exact answer."""

from __future__ import annotations

from skincal.studies.exact import NO_NUMBER

FACTOR = 10.0
"""The error may be that many times what the inputs' last digit does."""
OF_SIZE = 1e-15
"""And that share of the answer's norm: nine roundings of it. Nothing is added where the answer is nought."""


def bar(change: float, size: float) -> float:
    """Return the largest error that holds, for an answer of norm `size` that the inputs' last digit moves by `change`."""
    return FACTOR * change + OF_SIZE * size


def over_bar(error: float, bound: float) -> float:
    """Return an error's share of its bar; `NO_NUMBER` where there is none."""
    return NO_NUMBER if error >= NO_NUMBER else error / bound
