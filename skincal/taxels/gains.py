"""Gain of a taxel: its answer per newton, from the pokes that found its position.

A poke shows a taxel's gain if that answered most: the tip was nearer to it than to any other. It is the answer over the force
along the taxel's inward normal, g = t / (-f . n). The mean and standard deviation over the pokes are given. The deviation
contains the offset of the tip and the softening of foam, so it describes single answers and not the precision of the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.taxels.result import Estimate

MIN_POKES_TO_ESTIMATE_GAIN = 3
"""From two pokes a standard deviation says nothing."""
MIN_NORMAL_LOAD_N = 1.0
"""Along the inward normal. A grazing push would divide its answer by nearly zero."""


@dataclass(frozen=True, slots=True)
class TaxelGain:
    """Gain of one taxel, raw units a newton."""

    pokes: int
    """That it answered most."""
    mean: float | None
    """`None` from fewer than `MIN_POKES_TO_ESTIMATE_GAIN` pokes, or without a normal."""
    spread: float | None
    """Standard deviation over the pokes; `None` as `mean`."""


def taxel_gains(contacts: Sequence[Contact], estimates: Sequence[Estimate]) -> tuple[TaxelGain, ...]:
    """Compute the gain of each estimate's taxel, in their order.

    Parameters
    ----------
    contacts : that count, corrected
    estimates : of one method; pokes that an estimate doubts are left out
    """
    strongest: dict[int, list[Contact]] = {}
    for contact in contacts:
        strongest.setdefault(contact.strongest_channel, []).append(contact)
    return tuple(_gain(strongest.get(estimate.channel, ()), estimate) for estimate in estimates)


def _gain(contacts: Sequence[Contact], estimate: Estimate) -> TaxelGain:
    own = [contact for contact in contacts if contact.poke not in estimate.doubted]
    if estimate.normal is None or not own:
        return TaxelGain(len(own), None, None)
    forces = np.array([contact.link_from_sensor[:3, :3] @ contact.force for contact in own])
    answers = np.array([contact.responses.max() for contact in own])
    loads = -(forces @ estimate.normal)
    pressed = loads >= MIN_NORMAL_LOAD_N
    count = int(pressed.sum())
    if count < MIN_POKES_TO_ESTIMATE_GAIN:
        return TaxelGain(count, None, None)
    each = answers[pressed] / loads[pressed]
    return TaxelGain(count, float(each.mean()), float(each.std(ddof=1)))
